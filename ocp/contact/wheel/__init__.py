"""How far the wheel gives way: the cover's compliance, the Signorini problem, the law fitted to its solutions.

Here: the cover on its hub and the quadratic blade above it. Not here: the blade's real surface (ocp.model.blade_gap).
"""
