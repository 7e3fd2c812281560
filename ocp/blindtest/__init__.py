"""`python -m ocp.blindtest`: the diagnosis judged on sealed worlds.

Here: the steps of a check; worlds, oracle, scoring and report. Not here: the diagnosis, which sees folders alone.
"""
