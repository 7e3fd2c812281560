"""What the motion is, from the blade's surface to a robot program; nothing of the process force.

Here: the blade's mesh and aerofoil (blade/), passes on it, joints over time, what a program is (program/) and its text (krl/).
Not here: the robot itself (robots); how joints are chosen so that the force holds, and every command (ocp).
"""
