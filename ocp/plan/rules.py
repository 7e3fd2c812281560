"""Every number that a plan's safety depends on: value, unit, what it guards, and its reason.

A rule's docstring begins with its unit in brackets ([-]: a pure number) and names what it `Guards:` and its `Reason:`, a formula,
a source, a test, or that it is a judgement. Numerical tolerances, sampling and the weights of the objective stand where they are
used. tests/plan/test_plan_limits.py has for every rule that refuses one case just inside and one just outside.
"""

import numpy as np

# ---------- axes: ranges, singularities, speed
AXIS_MARGIN = np.radians(2.0)
"""[rad] Between an axis in contact and the end of its range. Guards: software limits are not met where the calibrated arm
stands beside the nominal one. Reason: judgement; calibrations move axes by far less."""

WRIST_MARGIN = np.radians(8.0)
"""[rad] Of axis 5 from zero, where axes 4 and 6 fall together. Guards: axes 4 and 6 would have to turn at once to follow the
path. Reason: their speed goes as 1/sin of axis 5, seven times that of a right-angled wrist here."""

SHOULDER_MARGIN = 0.15
"""[m] Of the wrist's centre from axis 1 (overhead singularity). Guards: axis 1 would have to turn at once. Reason: 40 mm/s of
feed need 0.27 rad/s of axis 1 there, an eighth of what a KR 210 has."""

ELBOW_MARGIN = np.radians(5.0)
"""[rad] Of axis 3 from the stretched arm. Guards: the arm cannot reach on, and axes 2 and 3 would change branch. Reason:
judgement."""

SINGULARITY_SHARE = 0.7
"""[-] Of the three margins above, what the optimiser has to keep where the seed had to keep all. Guards: as they do. Reason:
judgement; a start on its bound leaves an interior-point method nowhere to go."""

SEED_SPEED_SHARE = 0.9
"""[-] Of an axis' speed limit that a seed may ask for between its stations. Guards: passes whose feed the arm cannot follow are
refused before they are optimised. Reason: judgement; the optimiser can still gain what SPEED_SHARE asks for beyond."""

SPEED_SHARE = 0.8
"""[-] Of an axis' speed limit that a pass may use at its programmed feed. Guards: the feed is held. Reason: timing may use
LIMIT_SHARE, and a spline through the waypoints is faster between them."""

JERK_TIME = 0.012
"""[s] In which an axis may reach its largest acceleration: jerk is at most that acceleration over this time. Guards: set points
do not jump from one of the controller's cycles to the next. Reason: a KR C4 interpolates every 12 ms; no robot file has a jerk
of its maker."""

LIMIT_SHARE = 0.9
"""[-] Of an axis' limits of speed, acceleration and torque that the timed motion may use. Guards: the controller does not slow
down or stop. Reason: judgement; rigid-body torques leave friction out."""

FEED_TOLERANCE = 0.01
"""[-] Of the planned feed, by which the timed motion may fall short of it under full force. Guards: depth goes with force over
feed. Reason: a twentieth of what the removal may be off by."""

RAMP_FEED_TOLERANCE = 0.05
"""[-] The same where force and feed rise and fall. Guards: as FEED_TOLERANCE. Reason: judgement; without a flange the planned
feed swings there by several per cent within 8 ms, faster than the time law follows, and no axis is near a limit."""

READ_BACK_LIMIT = 1.0
"""[-] Of an axis' limits of speed and acceleration that the program's text, interpolated anew, may use. Guards: points that
were rounded or thinned out do not ask for more than the arm has. Reason: the limit itself."""

# ---------- contact: force, indentation, contact elsewhere, stroke
LEAST_INDENTATION = 3e-5
"""[m] Overlap of the wheel at the planned point. Guards: with less the wheel bears beside it, on the flanks of a hollow blade.
Reason: a tenth of the indentation of a usual cover under 20 N."""

SEED_INDENTATION = 5e-5
"""[m] The same for a seed. Guards: as LEAST_INDENTATION. Reason: more than that, so that the optimiser starts inside."""

DIRECT_TOLERANCE = 0.03
"""[N] Between the force by the wheel's table and by the contact solved directly, at which corrections end. Guards: the table's
error does not reach the program. Reason: a seventh of FLANGE_FORCE_TOLERANCE. It refuses nothing: the verification does."""

SECONDARY_CONTACT_TOLERANCE = 1e-4
"""[m] By how much more than planned a point of the blade may lie in the wheel's cover elsewhere. Guards: contact beside the
planned one. Reason: a cover of 15 mm and 12 MPa gives 0.3 mm under 20 N; a third of that elsewhere is not noise."""

PEAK_FORCE = 1.25
"""[-] Of the programmed force, what may be planned where a pass begins or ends. Guards: the blade. Reason: the mission's 25 N at
20 N."""

GAP_TOLERANCE = 5e-5
"""[m] Planned gap between blade and wheel in the air, beyond which a pass is refused that touches by the independent route.
Guards: nothing touches before its ramp begins. Reason: a hundredth of the flange's way under the force; at less the blade closes
at TOUCH_SPEED."""

STROKE_RESERVE = 1e-3
"""[m] Of the force flange's stroke that is left before its pressed stop. Guards: beyond it nothing yields, and a blade that comes
nearer is pressed as on a rigid mount, without bound. Reason: 2.4 times what registration errors of blade and wheel (0.3 mm each,
one sigma) take together. The other stop needs none: passes begin and end there where the flange has preload, the plan reckons
with it, and a blade that comes nearer meets that preload at most before the flange yields; grades judge it (STOP_PRELOAD)."""

FLANGE_FORCE_TOLERANCE = 0.2
"""[N] Between the force asked for and that of the program read back by the independent route, with a force flange. Guards: the
force on the blade. Reason: the mission's requirement."""

RIGID_FORCE_TOLERANCE = 2.0
"""[N] The same without a force flange. Guards: the force on the blade. Reason: the mission's requirement."""

LEAVING = 1.0
"""[N] Beyond a flange's preload at its stop, up to which a ramp is judged as without a flange. Guards: the flange's tolerance
where it gives. Reason: a program's points round the bend where it leaves its stop."""

RAMP_SHARE = 0.98
"""[-] Of the force of a line, from which on nothing is a ramp any more. Guards: the flange's tolerance along the line. Reason:
judgement; from there the force may be the line's own, which is held unevenly by a percent or two."""

FLANGE_SHARE = 0.5
"""[-] Of the contact's normal along the flange's axis, in the middle of the paths. Guards: the flange holds the force, not the
stiff arm. Reason: judgement; at 60 deg it is four times as stiff as along its axis."""

UNCERTAIN_FORCE = 2.0
"""[sd] So many standard deviations of the force on the real cell below the force asked for: else the verdict is that the cell
has to be calibrated first. Guards: a force that may be double or none. Reason: 95 % of what the covariance allows."""

FEEDS = (0.002, 0.3)
"""[m/s] Of the contact that a wanted depth may ask for. Guards: a blade that burns, a depth that is missed in silence. Reason:
judgement; below, a line takes a minute, above, the arm that turns the blade on a wheel of 40 mm needs half its speed."""

FORCE_SHARE = 0.05
"""[-] Of the force asked for, from which on its standard deviation on the real cell, or the difference of the two routes, is
amber. Guards: a force that is not known as well as the removal has to be. Reason: depth goes with force, and 5 % are wanted."""

STOP_PRELOAD = 1.0
"""[N] That a force flange may bear on its stop with before it is amber, without an output that sets it. Guards: touch, which is
as stiff as without a flange below that force. Reason: the mission's requirement; PHYSICS 6."""

# ---------- what must stay free
ARM_MARGIN = 0.020
"""[m] Between bodies of the arm, wheel, floor and what the arm carries. Guards: collisions. Reason: shapes are simple, and the
arm bends by about a millimetre."""

BLADE_MARGIN = 0.003
"""[m] Between blade or holder and the wheel off contact. Guards: collisions on the way to and from a pass. Reason: the arm
bends by about a millimetre."""

HOLDER_RADIUS = 0.025
"""[m] Of the rod that stands for the holder. Guards: the holder, which the cell file does not describe, does not meet the
wheel. Reason: judgement."""

HOLDER_SHARE = 0.5
"""[-] Of the way from the flange to the clamp that this rod reaches. Guards: as HOLDER_RADIUS. Reason: the wheel needs the
other half to pass beside the clamp."""

FLOOR_BELOW_WHEEL = 0.05
"""[m] Of the plane that is kept free below a wheel that hangs lower than the robot's base, where the cell file gives no floor.
Guards: what the robot stands on. Reason: judgement; the robot then stands on a pedestal."""

UPRIGHT = np.cos(np.radians(45.0))
"""[-] Share of the base's z axis that points up, from which on a robot stands on the floor that the cell gives: with less the
plane of its base, wall or ceiling, is kept free beside that floor. Guards: the wall. Reason: midway between floor and wall."""

COLLISION_STEP = np.radians(1.0)
"""[rad] Largest move of an axis between two postures that are looked at off contact. Guards: nothing thin is passed through.
Reason: a point 2 m from that axis is never more than 17 mm from where it was looked at, less than ARM_MARGIN."""

LIFT_OFF = 0.020
"""[m] Off the wheel where a pass begins to be engaged and ends to be left, straight along the normal. Guards: moves between
passes stay clear of the wheel. Reason: six times BLADE_MARGIN."""

LIFT_RESERVE = 1e-3
"""[m] More than BLADE_MARGIN that has to be free where the blade is lifted off at the ends of a pass. Guards: as LIFT_OFF; these
moves are judged on the nominal arm. Reason: it stands about that far beside the bent one."""

APPROACH_SPEED = 0.05
"""[m/s] Along the normal, at most, between LIFT_OFF and touch. Guards: who stands there. Reason: a fifth of what T1 allows."""

TOUCH_SPEED = 2.5e-3
"""[m/s] At which the blade closes at touch, and leaves. Guards: the blade; the spike of a touch is speed times the root of
stiffness and mass, 1.4 N for 5 kg and 60 N/mm, and what bounces swings as far. Reason: PHYSICS 6; at most 5 mm/s are asked."""

CREEP = 0.12
"""[s] Before touch, and after leaving, in which the blade closes at no more than that. Guards: a real blade that is met early.
Reason: 0.3 mm, twice the standard deviation of a calibrated cell; without it the blade comes at 8 mm/s there."""

LEAST_RAMP = 0.2
"""[s] Over which the force rises and falls at least. Guards: the force follows. Reason: PHYSICS 6, 5 N off in 0.2 s."""

CARRIED_FORCE = 1.0
"""[N] That moving what the flange carries may add or take while the force rises. Guards: as LEAST_RAMP. Reason: a twentieth of
the force; the ramp lasts longer for it, 0.3 s with 5 kg."""

HOME_LIFT = 0.15
"""[m] Off the first contact where a program begins and ends. Guards: whoever stands there; the first move can be watched.
Reason: judgement."""

WHEEL_ROOM = 2e-3
"""[m] Added to the wheel's radius and to either side where passes end beside block and platform. Guards: the wheel does not
touch them. Reason: it turns, tilts and sinks in."""

# ---------- what is left out
LEAST_STRETCH = 5e-3
"""[m] Of a pass. Guards: a pass is not a dwell; what is shorter is left out by name. Reason: half the length of a usual contact
patch to either side, which the force needs to rise and fall while the blade moves."""

STRETCH_ROOM = 1e-3
"""[m] Between a place that cannot be ground and the pass that ends beside it. Guards: passes are planned again where they can
hold. Reason: judgement; a usual waypoint."""

LEAST_GROUND_SHARE = 0.5
"""[-] Of the asked surface that has to be ground. Guards: nobody takes a half-ground blade for a ground one. Reason: the
mission's requirement."""

# ---------- the program
BLOCK_TIME_TOLERANCE = 1e-3
"""[s] By which a block of the program read back may last longer or shorter than planned. Guards: the feed, and with it what is
taken off. Reason: judgement; a controller's cycle is 4 ms or longer."""

STRAY = np.radians(0.05)
"""[rad] By which an axis on a pass of straight motions read back may be off the plan. Guards: it is the planned motion that was
written. Reason: ten times what blending leaves (tests/plan/test_programming.py); 1.7 mm 2 m from that axis, less than
BLADE_MARGIN."""

EMITTED_FORCE_SHARE = 0.25
"""[-] Of the mount's force tolerance, what the thinned-out points of a pass may cost between them; over the stiffness of the
contact a tolerance in m. Guards: the force on the blade. Reason: judgement; without a flange 50 N/mm meet the touch, and points a
controller's cycle apart leave 8 um there, 0.4 of 2 N."""

EMITTED_TOLERANCE = (1e-6, 2e-5)
"""[m] Bounds of that tolerance. Guards: as EMITTED_FORCE_SHARE. Reason: judgement; below a micrometre lies what printing
rounds."""

EMITTED_AIR_TOLERANCE = 2e-4
"""[m] The tolerance off contact. Guards: collisions between emitted points. Reason: a fifteenth of BLADE_MARGIN."""

LEAST_STEP = 5e-5
"""[m] Between waypoints, at least. Guards: time and memory. Reason: judgement; a twentieth of what is usual."""

MOST_STEP = 5e-3
"""[m] Between waypoints, at most. Guards: force and collisions are judged at waypoints. Reason: judgement; five times what
is usual."""
