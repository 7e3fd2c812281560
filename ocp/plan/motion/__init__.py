"""The whole motion: engaging and retreating, the way between passes, collisions, time.

Here: moves off contact and the time line. Not here: joints in contact (plan/passes).
"""
