"""`python -m ocp.plan`: blade and cell in; a verified program, its table and a report out.

Here: the paths, the folder that is written, and the rooms passes, motion, verify and report. Not here: the model that is
optimised (ocp.model) and the program's language (trajectories.krl).
"""
