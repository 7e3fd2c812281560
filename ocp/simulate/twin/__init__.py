"""A virtual cell that shares no code with the planner's model: arm, tracker, contact and controller (docs/virtual_arm.md)."""
