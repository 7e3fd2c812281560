"""`python -m ocp.simulate`: a plan rehearsed on a virtual cell; the logs a day on it would give.

Here: the command, what it was asked, its report. Not here: the virtual cell itself (twin).
"""
