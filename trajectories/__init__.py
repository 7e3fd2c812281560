"""What the motion is: blade, passes, timing, robot programs."""
