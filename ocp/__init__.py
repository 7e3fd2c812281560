"""The compensator: cell, contact, model, optimal control, report, command lines."""
