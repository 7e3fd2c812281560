"""`python -m ocp.diagnose`: where the gap between cell and readings lies, which effect causes it, how far it shrinks.

Here: the data set, the answer and its files; engine, verdict, foresee, one room a signal, report. Not here: the catalogue
(ocp.effects) and force logs as such (ocp.calibrate.force).
"""
