"""Blind worlds with a grinding-force log, made by the virtual cell's own contact."""
