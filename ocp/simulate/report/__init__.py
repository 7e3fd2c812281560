"""rehearsal.html: what force a program would be seen to make, and where it is worst.

Here: pictures of a rehearsal. Not here: what all reports share (ocp.report).
"""
