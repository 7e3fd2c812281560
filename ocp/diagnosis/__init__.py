"""Diagnosis of the gap between the believed cell and its readings: where it lies, which effect causes it, how far it shrinks."""
