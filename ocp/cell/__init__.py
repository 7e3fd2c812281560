"""`python -m ocp.cell new|check|show`: a cell of one's own: template, check and page.

Here: the commented template, the examination of a cell file and of all it names, where the wheel may stand, the page. Not here:
what a cell file means (ocp.model.cell) and what can be ground of a blade (ocp.plan.passes.posture).
"""
