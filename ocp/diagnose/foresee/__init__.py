"""What measurements that nobody has taken yet could tell: the design table and the next experiment.

Here: planned channels and what they separate. Not here: measured ones (tracker, force, joints).
"""
