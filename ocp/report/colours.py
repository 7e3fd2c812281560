"""Colours of values on a surface, for page and paper alike."""

VIRIDIS = (
    "#440154 #48186a #472d7b #424086 #3b528b #33638d #2c728e #26828e #21918c "
    "#1fa088 #28ae80 #3fbc73 #5ec962 #84d44b #addc30 #d8e219 #fde725"
).split()
"""Every sixteenth colour of viridis (Smith and van der Walt 2015, CC0): even steps, colour-blind safe."""

NOT_GROUND = "#c9ced4"
"""Grey of surface that no pass touches; it has no hue, so it is not mistaken for a value."""

SIDE_COLOURS = ("#1f5f8b", "#c8702a", "#4f4f4f", "#7a5195")
"""Blue and orange differ in lightness too, so a grey copy still tells the sides apart."""
