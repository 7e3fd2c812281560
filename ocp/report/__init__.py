"""The kit that reports are made of: sections, tables, plots, the page, the print.

Here: nothing that knows a command. Not here: any report (the room `report` of each command).
"""
