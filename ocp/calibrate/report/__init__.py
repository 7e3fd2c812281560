"""The report of a calibration: how good it is where it was not fitted, and what it did not see.

Here: its sections, one a file; `pages` has their order, `headline` the verdict.
Not here: what all reports share (ocp.report).
"""
