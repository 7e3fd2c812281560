"""Mistakes people make with readings, reported instead of fitted: units, axes, signs, columns, rows, robot variant.

Each guess changes the readings as its mistake would and asks how well a rigid arm then fits (median distance). Where what
was handed in does not fit and a guess does, the sentence names it.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from robots.calibration.fit import located, robust_motion
from robots.calibration.layout import Choice, nominal_state
from robots.calibration.residuals import residuals
from robots.calibration.solver import Campaign
from robots.errors import BadInput
from robots.pose import Array
from robots.robot import Robot, catalogue, load_robot
from robots.tracker_readings import Readings

TURNS_FIT = np.radians(1.0)  # an uncalibrated arm's hand is off by a tenth of it
FITS = 15e-3  # m; an uncalibrated arm with roughly placed nests stays below
NEST_SHARE = 5.0  # nests farther off than this many of their sds speak for another robot
CLOSER = 3  # of the guesses are looked at with the nests fitted too
ROWS = 400  # readings looked at; more would say the same
WRONG_SHARE = 0.2  # of readings that may be far off before the file is refused
SCALES = {1e3: "in metres, not millimetres", 1e-3: "in micrometres, not millimetres", 1e3 / 39.3701: "in inches, not millimetres"}


def refuse_mistakes(campaign: Campaign) -> None:
    """Raises BadInput with the mistake that explains the readings, where the arm as believed does not fit them."""
    thin = _thinned(campaign)
    where = str(campaign.readings.path)
    _refuse_units(thin, where)
    plain, off = misfit(thin)
    if plain < FITS:
        share = float(np.mean(off > 10 * max(plain, 1e-3)))
        if share > WRONG_SHARE:
            raise BadInput(
                f"{where}: {share:.0%} of the readings lie far from where the arm can be while the others fit within "
                f"{plain * 1e3:.1f} mm; rows or columns were mixed up, compare the file with the measuring protocol"
            )
        _refuse_other_robot(thin, where)
        _refuse_turns(campaign, where)
        return
    rough = sorted(((_roughly(c), text, c) for text, c in _guesses(thin)), key=lambda g: g[0])
    best, text = min((misfit(c)[0], text) for _, text, c in rough[:CLOSER])
    if best < FITS and best < 0.3 * plain:
        raise BadInput(
            f"{where}: {text}; so read, the arm fits within {best * 1e3:.1f} mm instead of {plain * 1e3:.0f} mm; correct the "
            "file or the cell"
        )
    worst = int(np.argmax(off))
    nest = ", one reflector nest (else name it in the column target)" if thin.readings.targets == ("",) else ""
    raise BadInput(
        f"{where}: no place of the tracker fits the readings better than {plain * 1e3:.0f} mm (median), farthest line "
        f"{thin.readings.line[worst]}; check axis angles (degrees, KUKA signs), units (mm), robot.model '{campaign.robot.name}', "
        f"that rows belong together{nest}, and that one place of the tracker saw them all (else name it in the column station)"
    )


def misfit(campaign: Campaign) -> tuple[float, Array]:
    """Median distance m of the readings from a rigid arm with the tracker put where most want it; distances (n,) m."""
    off = np.linalg.norm(_rigid(campaign)[0], axis=1)
    return float(np.median(off)), off


def _roughly(campaign: Campaign) -> float:
    """Median distance m with the nests where they are believed, the worst of the stations."""
    c = campaign
    state = nominal_state(c.robot, c.readings, c.payloads, c.instrument, Choice(joints=()))
    nominal = c.readings.point - residuals(c.robot, c.readings, c.instrument, state)[:, :3]
    groups = [c.readings.station == k for k in np.unique(c.readings.station)]
    return max(robust_motion(nominal[rows], c.readings.point[rows])[1] for rows in groups)


def _rigid(campaign: Campaign) -> tuple[Array, Array]:
    """Residuals (n, 3) m and nests (m, 3) m of the rigid fit."""
    c = campaign
    state = located(c, nominal_state(c.robot, c.readings, c.payloads, c.instrument, Choice(joints=())))
    return residuals(c.robot, c.readings, c.instrument, state)[:, :3], state.nests


def _thinned(campaign: Campaign) -> Campaign:
    return replace(campaign, readings=replace(campaign.readings.thinned(ROWS), turn=None))


def _refuse_units(campaign: Campaign, where: str) -> None:
    """Lengths and angles by themselves: distances between readings against those between the arm's nests."""
    readings = campaign.readings
    if np.abs(readings.q).max() < np.radians(2 * np.pi * 1.05) and np.ptp(readings.q, axis=0).max() > np.radians(0.5):
        turned = replace(campaign, readings=replace(readings, q=np.degrees(readings.q)))
        if _limits_hold(turned) and misfit(turned)[0] < FITS < misfit(campaign)[0]:
            raise BadInput(f"{where}: the axis angles are in radians, not degrees; write q1_deg .. q6_deg in degrees")
    state = nominal_state(campaign.robot, readings, campaign.payloads, campaign.instrument, Choice(joints=()))
    nominal = readings.point - residuals(campaign.robot, readings, campaign.instrument, state)[:, :3]
    i, j = np.triu_indices(min(len(readings), 60), 1)
    same = readings.station[i] == readings.station[j]
    i, j = i[same], j[same]
    if not len(i):
        return
    seen, believed = (np.linalg.norm(p[i] - p[j], axis=1) for p in (readings.point, nominal))
    far = believed > 0.2
    if not far.any():
        return
    ratio = float(np.median(seen[far] / believed[far]))
    for scale, text in SCALES.items():
        if abs(np.log(ratio * scale)) < 0.3:
            raise BadInput(
                f"{where}: the readings lie {1 / ratio:.3g} times as close together as the arm moved: x, y, z are {text}; "
                "write x_mm, y_mm, z_mm in millimetres"
            )


def _limits_hold(campaign: Campaign) -> bool:
    robot, q = campaign.robot, campaign.readings.q
    slack = np.radians(5.0)
    return bool(((q > robot.q_min - slack) & (q < robot.q_max + slack)).mean() > 0.95)


def _refuse_other_robot(campaign: Campaign, where: str) -> None:
    """A variant that differs in the hand alone shows in the nests' places only."""
    places = {name: nest.place for name, nest in (campaign.instrument.nests or {}).items() if nest.place is not None}
    used = [k for k in np.unique(campaign.readings.target) if campaign.readings.targets[k] in places]
    if not used:
        return
    limit = NEST_SHARE * campaign.instrument.nest_sd

    def far(robot: Robot) -> float:
        """Mean vector by which the nests come out off their places: what another hand would do to all alike."""
        c = replace(campaign, robot=robot)
        off, nests = _rigid(c)
        if np.median(np.linalg.norm(off, axis=1)) > FITS:
            return np.inf
        given = np.array([places[c.readings.targets[k]] for k in used])
        return float(np.linalg.norm((nests[used] - given).mean(axis=0)))

    here = far(campaign.robot)
    if here < limit:
        return
    for name, robot in _variants(campaign.robot):
        there = far(robot)
        if there < 0.2 * here:
            raise BadInput(
                f"{where}: the reflector nests come out {here * 1e3:.1f} mm from where the cell puts them; with robot '{name}' "
                f"it is {there * 1e3:.1f} mm: correct robot.model '{campaign.robot.name}' or the nests in [tracker.targets]"
            )


def _refuse_turns(campaign: Campaign, where: str) -> None:
    """Orientations of 6D targets: seen from the flange each target has one turn, the same in all postures."""
    if campaign.readings.turn is None:
        return
    readings = campaign.readings.take(np.flatnonzero(campaign.readings.turned))
    c = replace(campaign, readings=replace(readings, turn=None))
    state = located(c, nominal_state(c.robot, c.readings, c.payloads, c.instrument, Choice(joints=())))
    unturned = replace(readings, turn=np.tile(np.eye(3), (len(readings), 1, 1)))
    frames = replace(state, turns=np.tile(np.eye(3), (len(readings.targets), 1, 1)))
    # Residual turn of an identity reading: the predicted frame backwards.
    predicted = Rotation.from_rotvec(-residuals(c.robot, unturned, c.instrument, frames)[:, 3:])
    seen = predicted.inv() * Rotation.from_matrix(readings.turn)
    off = np.empty(len(readings))
    for k in np.unique(readings.target):
        rows = np.flatnonzero(readings.target == k)
        off[rows] = (_middle(seen[rows]).inv() * seen[rows]).magnitude()
    if np.median(off) > TURNS_FIT:
        raise BadInput(
            f"{where}: the orientations rx, ry, rz scatter by {np.degrees(np.median(off)):.1f} deg (median) as seen from the "
            "flange, while the points fit; write them in degrees as R = Rz(rz) Ry(ry) Rx(rx) in the tracker's frame, or leave "
            "them out"
        )


def _middle(turns: Rotation) -> Rotation:
    """The one of up to 50 turns that is nearest to most of them."""
    few = turns[np.unique(np.linspace(0, len(turns) - 1, min(len(turns), 50)).astype(int))]
    return few[int(np.argmin([np.median((one.inv() * turns).magnitude()) for one in few]))]


def _variants(robot: Robot) -> Iterator[tuple[str, Robot]]:
    """Other arms of the catalogue."""
    for name in catalogue():
        if name != robot.name:
            yield name, load_robot(name)


def _guesses(campaign: Campaign) -> Iterator[tuple[str, Campaign]]:
    """Readings as each mistake would have made them right, with the sentence that names the mistake."""
    readings = campaign.readings

    def with_q(q: Array) -> Campaign:
        return replace(campaign, readings=replace(readings, q=q))

    mirrored = replace(readings, point=readings.point * [-1.0, 1.0, 1.0])
    yield (
        "x, y, z form a left-handed frame: one axis has the wrong sign or two are exchanged",
        replace(campaign, readings=mirrored),
    )
    yield "the axis angles are in radians, not degrees", with_q(np.degrees(readings.q))
    for j in range(6):
        q = readings.q.copy()
        q[:, j] *= -1
        yield f"axis {j + 1} has the opposite sign (KUKA's signs are wanted)", with_q(q)
    flipped = readings.q * campaign.robot.sign
    yield "the axes have mathematical signs instead of KUKA's", with_q(flipped)
    for i in range(6):
        for j in range(i + 1, 6):
            q = readings.q.copy()
            q[:, [i, j]] = q[:, [j, i]]
            yield f"columns q{i + 1}_deg and q{j + 1}_deg are exchanged", with_q(q)
    for j in range(6):
        for turn in (-90.0, 90.0, 180.0):
            q = readings.q.copy()
            q[:, j] += np.radians(turn)
            yield f"axis {j + 1} counts from a zero {-turn:g} deg away", with_q(q)
    for shift in (-2, -1, 1, 2):
        yield (
            f"the points stand {abs(shift)} row{'s' * (abs(shift) > 1)} too {'early' if shift < 0 else 'late'}",
            _shifted(campaign, shift),
        )
    for name, robot in _variants(campaign.robot):
        yield f"the robot is a '{name}', not a '{campaign.robot.name}'", replace(campaign, robot=robot)


def _shifted(campaign: Campaign, shift: int) -> Campaign:
    """Points moved by rows against everything else; both ends cut."""
    readings: Readings = campaign.readings
    n = len(readings)
    kept = np.arange(max(0, -shift), min(n, n - shift))
    moved = replace(readings.take(kept), point=readings.point[kept + shift])
    return replace(campaign, readings=moved)
