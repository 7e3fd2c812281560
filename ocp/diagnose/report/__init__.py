"""The report of a diagnosis.

Here: its sections and its words. Not here: what all reports share (ocp.report).
"""
