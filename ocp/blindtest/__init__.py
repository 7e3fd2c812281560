"""`python -m ocp.blindtest`: the diagnosis judged on sealed worlds, against its rivals, chance and an oracle.

Here: the steps of a check; worlds, oracle, scoring and report. Not here: the diagnosis, which sees folders alone.
"""
