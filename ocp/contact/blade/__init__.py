"""How far the blade gives way: meshes of its solid, linear elasticity, compliance at every waypoint.

Here: closed surfaces, tetrahedra and solvers. Not here: the blade's shape and its passes (trajectories.blade).
"""
