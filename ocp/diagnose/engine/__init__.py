"""Which effects: columns, evidence, sets and their posterior weights, the search with its refits.

Here: the same for every signal. Not here: a signal's own fit (tracker, force, joints) and what is told (verdict).
"""
