"""What the search means: names with probabilities, where the gap lies, how far it shrinks, what speaks against it.

Here: the diagnosis from weighed sets, doubts, classes, places, shrinkage, the answer. Not here: how sets are weighed (engine) and
how an answer is worded (report).
"""
