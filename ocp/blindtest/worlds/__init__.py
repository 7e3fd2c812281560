"""Worlds of a blind check: machines and effects drawn, brought to a detectability, written and sealed.

Here: what is true of a world, by the virtual cell. Not here: what anyone answers.
"""
