"""`python -m ocp.poses`: where to measure before a calibration.

Here: candidates, line of sight, order, program and the printed sheet. Not here: the criterion of choice
(robots.calibration.pose_choice).
"""
