"""The report of a calibration: how good it is where it was not fitted, and what it did not see.

Here: its sections and their words. Not here: what all reports share (ocp.report).
"""
