"""KRL, the language of KUKA controllers: one dialect of trajectories.program (docs/krl.md).

Here: names, writer, reader, interpreter and the refusals before a program leaves the house.
Not here: what a program is (trajectories.program); the virtual cell's reader (ocp.simulate.twin), which shares nothing with this.
"""
