"""What the passes take off the blade, by Preston's law: planned, summed over all lines, judged.

Here: the footprint of a contact and what a line's rows make of it. Not here: the contact itself (ocp.contact.wheel).
"""
