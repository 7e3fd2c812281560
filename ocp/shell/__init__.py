"""Exit codes, progress, output folders, cache, worker processes, machine code.

Here: nothing that knows of robots, blades or forces. Not here: what a command does (its own room).
"""
