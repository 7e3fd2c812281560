"""The laser tracker's readings as a channel of the diagnosis."""
