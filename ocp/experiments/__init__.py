"""`python -m ocp.experiments`: the paper's experiments on many virtual robots.

Here: a trial's course and its summary. Not here: the virtual robots (ocp.simulate.twin).
"""
