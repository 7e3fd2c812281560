"""A virtual cell that shares no code with the planner's model (docs/virtual_arm.md).

Here: arm, tracker, controller, contact, and what of them is hidden; a reader of KRL and an interpolator that share nothing with
trajectories. Not here: what the product believes of a cell.
"""
