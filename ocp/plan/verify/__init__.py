"""The written text taken as the only truth: read back, and its force predicted by a second route.

Here: nothing that shares code with the model that planned. Not here: the optimiser's own checks (plan/passes).
"""
