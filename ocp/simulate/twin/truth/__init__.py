"""What a virtual cell really is: drawn errors, planted effects, or exactly what is believed.

Here: numbers and how they are drawn. Not here: what they do (twin/arm, twin/contact).
"""
