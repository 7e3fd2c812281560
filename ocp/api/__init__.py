"""The Python interface: plan, choose_poses, calibrate, simulate, diagnose, blindtest.

Here: the same functions that the commands call, under one roof. Not here: anything of a command line, and anything that is
not in the rooms of these names.
"""
