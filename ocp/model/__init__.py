"""The cell, and the one symbolic model of it: joints and force in, overlap and its parts out.

Here: cell.toml, the parameters theta, calibrations folded in, the force balance. Not here: how blade and wheel give way
(ocp.contact), what no believed cell holds (ocp.effects), and what a command makes of the model.
"""
