"""`python -m ocp.plan`: blade and cell in; a verified program and a report out.

Here: paths, rules of safety, clearance, motion, the folder that is written and its reading back; the rooms passes and report.
Not here: the model that is optimised (ocp.model) and the program's language (trajectories.program, trajectories.krl).
"""
