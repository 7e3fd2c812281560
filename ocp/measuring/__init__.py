"""Measuring the arm: what the cell says of the tracker, and where readings tell most."""
