"""What a robot program is, whatever the controller's language: what is written, and what was read back.

Here: blocks, points, frames and load of a program; timed trajectories turned into one; what a program that was read does,
and the curve a controller lays through its points; the protocol that a language (a dialect) keeps.
Not here: text. Every dialect is a folder of its own beside this one, listed in trajectories.dialects.
"""
