"""`python -m ocp.update`: the cell after one more blade, from that blade's force log.

Here: how the cell drifts, whether a log can have come from it, what measured removal tells of the blade's place and of Preston's
coefficient, the files and the report. Not here: the fit of a force log (ocp.calibrate.force) and footprints (ocp.plan.removal).
"""
