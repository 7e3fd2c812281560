"""The report of a plan: what it shows, its page and its print.

Here: its sections, one a file, and what they show (plan_report). `pages` has their order; `viewer` is the scene's script.
Not here: what all reports share (ocp.report).
"""
