"""Effects that the believed cell leaves out, one file each; `ocp.effects.library` finds them."""
