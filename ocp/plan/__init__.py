"""`python -m ocp.plan`: blade and cell in; a verified program, its table and a report out.

Here: the paths, the rules of safety, the folder that is written, and the rooms clearance, passes, motion, verify and report.
Not here: the model that is optimised (ocp.model) and the program's language (trajectories.program, trajectories.krl).
"""
