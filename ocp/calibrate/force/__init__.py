"""A force log: how it is read, what its rows mean for the contact, and the fit of wheel, blade and flange.

Here: everything about force logs that calibration and diagnosis share. Not here: effects outside the believed cell
(ocp.diagnose.force).
"""
