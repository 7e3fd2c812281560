"""`python -m ocp.robot new|import`: a robot file of one's own.

Here: a template to fill in from a data sheet, and the writing of a robot file from a URDF. Not here: what a robot file means
(robots.robot) and how a URDF becomes one (robots.urdf).
"""
