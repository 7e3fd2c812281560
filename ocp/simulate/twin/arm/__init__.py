"""The virtual arm: bodies, springs and motors by a physics engine, errors of its joints, collisions.

Here: where the flange really is. Not here: what the controller believes (twin/controller).
"""
