"""Every number that the safety of a measurement depends on; what stays free of what is ocp/plan/rules.py's.

As there: the unit in brackets, what a rule `Guards:`, and its `Reason:`. tests/poses/test_poses_limits.py has for every rule
that refuses one case just inside and one just outside.
"""

import numpy as np

AXIS_MARGIN = np.radians(3.0)
"""[rad] Between an axis and the end of its range at a reading, beside the approach. Guards: software limits are not met.
Reason: judgement; more than for a pass, as nobody looks at these postures before."""

WRIST_RANGE = np.radians(180.0)
"""[rad] That axes 4 and 6 may turn either way in postures drawn at random. Guards: cables. Reason: a full turn shows all that
two show."""

HOLDING_SHARE = 0.9
"""[-] Of an axis' torque that weight alone may take while the robot stands. Guards: the drives at a reading. Reason: as
LIMIT_SHARE of a plan."""

BRACKET_RADIUS = 0.025
"""[m] Of the straight rod that stands for a reflector's bracket. Guards: collisions of reflectors. Reason: a 1.5 inch ball has
19 mm."""

APPROACH_SHARE = 0.9
"""[-] Of the approach asked for that every axis of the program read back has to move before a reading. Guards: backlash is
taken up from the side that poses.csv says. Reason: judgement; printing rounds by far less."""

READ_BACK_TOLERANCE = np.radians(1e-5)
"""[rad] By which an axis of the program read back may be off. Guards: the robot stands where poses.csv says. Reason: what
printing may round."""
