"""`python -m ocp.poses`: where to put the robot before a calibration; a table and KRL programs out.

Here: candidates, line of sight, order, program and the printed sheet. Not here: the criterion of choice
(robots.calibration.pose_choice).
"""
