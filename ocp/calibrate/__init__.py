"""`python -m ocp.calibrate`: tracker readings, with a force log or without; a calibrated cell with its covariance out.

Here: the command, its files, the contact's side (force) and the report. Not here: the arm's fit itself (robots.calibration).
"""
