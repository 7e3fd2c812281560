"""What gives way between blade and wheel.

Here: the blade's finite elements and the wheel's cover, by shape and material. Not here: the cell they stand in (ocp.model).
"""
