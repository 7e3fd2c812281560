"""What must stay free: arm, holder, blade, wheel and floor apart, and the blade off the wheel but for the planned contact.

Here: collisions and secondary contact at given postures. Not here: who looks for postures (plan/passes, plan/motion).
"""
