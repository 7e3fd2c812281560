"""`python -m ocp.calibrate`: tracker readings and force log in; a calibrated cell out.

Here: the command, its files, the contact's side (force) and the report. Not here: the arm's fit itself (robots.calibration).
"""
