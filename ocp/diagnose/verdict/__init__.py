"""What the search means: names with probabilities, where the gap lies, how far it shrinks, what speaks against it.

Here: conclusions from weighed sets. Not here: their weighing (engine) and their words on paper (report).
"""
