"""The virtual controller: reads KRL text by itself, and makes axes over time of it.

Here: a reader and an interpolator that share nothing with trajectories. Not here: the arm that follows (twin/arm).
"""
