"""The report of a blind check.

Here: its page, table and plots. Not here: what all reports share (ocp.report).
"""
