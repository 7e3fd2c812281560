"""The grinding-force log as a channel of the diagnosis: nuisance, columns of effects, folds, sealed rows.

Here: how the log answers effects. Not here: the log's file, rows and believed contact (ocp.calibrate.force).
"""
