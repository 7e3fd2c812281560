"""Link-side encoders as a channel of the diagnosis: the angle of a link against that of its motor through the gear.

Here: joints.csv, its noise and its fit. Not here: the effects (ocp.effects).
"""
