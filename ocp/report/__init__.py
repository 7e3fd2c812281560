"""The kit that reports are made of.

Here: the report as a whole, its usual parts, page, sheets, plots; nothing that knows a command.
Not here: any report (the room `report` of each command).
"""
