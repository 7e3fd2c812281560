"""The report of a plan: what it shows, its page and its print.

Here: a plan's own charts and tables. Not here: what all reports share (ocp.report).
"""
