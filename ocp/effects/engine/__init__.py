"""What evaluates effects: compiled columns for many rows, symbols for the model, rows of arm and contact.

Here: the same for every effect. Not here: any single effect (one file each, above).
"""
