"""Answers against opened labels: what was right, how sure it was, with intervals; rivals on the same data.

Here: figures of a check. Not here: how worlds were made (blindtest/worlds).
"""
