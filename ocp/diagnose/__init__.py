"""`python -m ocp.diagnose`: where cell and readings differ, which effect causes it, how far the gap shrinks.

Here: the data set, the answer and its files; engine, verdict, foresee, one room a signal, report. Not here: the catalogue
(ocp.effects) and force logs as such (ocp.calibrate.force).
"""
