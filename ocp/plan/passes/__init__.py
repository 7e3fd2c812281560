"""The optimal control of single passes: seed, stage, transcription, Ipopt, the joints that hold the force.

Here: contact alone. Not here: the way between passes (plan/motion.py).
"""
