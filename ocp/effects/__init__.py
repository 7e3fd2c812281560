"""The catalogue: one effect a file, with its keys, priors and place in the model.

Here: what an effect does to joints, readings or forces. Not here: who switches it on (a cell) or looks for it (ocp.diagnose).
"""
