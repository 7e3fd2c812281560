"""Mistakes people make with readings, reported instead of fitted: units, axes, signs, columns, rows, robot variant.

Each guess changes the readings as its mistake would and asks how well a rigid arm then fits (median distance). Where what
was handed in does not fit and a guess does, the sentence names it.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.spatial.transform import Rotation

from robots.calibration.fit import Fit, fit_campaign, located, robust_motion
from robots.calibration.layout import Choice, nominal_state
from robots.calibration.residuals import residuals
from robots.calibration.solver import Campaign
from robots.errors import BadInput
from robots.pose import ROTATION_ORDERS, Array, rotations_in_order
from robots.robot import Robot, catalogue, load_robot
from robots.tracker_readings import Index, Readings

MEDIAN_TURN = 3.0  # standard deviations of each axis: their length has its median at 1.54, about another reading's at twice that
TURNS_FIT = np.radians(1.0)  # an uncalibrated arm's hand is off by a tenth of it
FITS = 15e-3  # m; an uncalibrated arm with roughly placed nests stays below
NEST_SHARE = 5.0  # nests farther off than this many of their sds speak for another robot
CLOSER = 6  # of the guesses are looked at with the nests fitted too
ALIKE = 2.0  # times the best guess' misfit: guesses that fit as well are told beside it
FREE_NEST = 0.1  # m; a nest so loosely held is found where it is
IS_ANGLE = np.array([True, False, False, True, True])  # of a row of MD-H
ROWS = 400  # readings looked at; more would say the same
WRONG_SHARE = 0.2  # of readings that may be far off before the file is refused
LOADS_FIT = 0.3  # of what the loaded readings are off, as another reading of their loads leaves it: then that one is meant
SCALES = {1e3: "metres", 1e-3: "micrometres", 25.4: "inches", 10.0: "centimetres"}  # mm

LOADS = {  # what fx_N to mz_Nm were meant as, and by what they are to be multiplied
    "the loads are in kilonewtons and kN m, not N and N m": np.array(6 * [1e3]),
    "the loads are in millinewtons and N mm, not N and N m": np.array(6 * [1e-3]),
    "the loads are in kilograms-force (or decanewtons), not newtons": np.array(6 * [9.80665]),
    "the loads are in pounds-force and lbf ft, not N and N m": np.array(3 * [4.44822] + 3 * [1.35582]),
    "the moments of the loads are in N mm, not N m": np.array(3 * [1.0] + 3 * [1e-3]),
    "the loads point the other way: write what pulls at the robot, not what it pulls with": np.array(6 * [-1.0]),
}


def refuse_mistakes(campaign: Campaign) -> None:
    """Raises BadInput with the mistake that explains the readings, where the arm as believed does not fit them."""
    thin = _thinned(campaign)
    where = str(campaign.readings.path)
    refuse_units(thin)
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
    _refuse_nests(thin, where)
    rough = sorted(((_roughly(c), text, c) for text, c in _guesses(thin)), key=lambda g: g[0])
    close = sorted((misfit(c)[0], text) for _, text, c in rough[:CLOSER])
    best = close[0][0]
    if best < FITS and best < 0.3 * plain:
        text = ", or ".join(text for off, text in close if off < ALIKE * best)
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


def refuse_loads(fit: Fit) -> None:
    """Raises BadInput where external loads or payloads, read otherwise, let the calibrated arm meet its readings several times
    nearer: what they bend it by is a millimetre, less than any arm that is not calibrated is off by."""
    readings, tried = fit.campaign.readings, []
    for rows, text, meant in _other_loads(fit.campaign):
        with suppress(np.linalg.LinAlgError):  # so read an unknown may be left open
            again = fit_campaign(replace(fit.campaign, readings=meant), fit.choice, fit.priors, begin=fit.start)
            left, off = (float(np.median(np.linalg.norm(one.residual[rows, :3], axis=1))) for one in (again, fit))
            tried.append((left, off, int(readings.line[rows[0]]), text))
    told = min((one for one in tried if one[0] < LOADS_FIT * one[1]), default=None)
    if told is not None:
        left, off, line, text = told
        raise BadInput(
            f"{readings.path}, from line {line} on: {text}; so read, the readings under load are met within {left * 1e3:.2g} mm "
            f"instead of {off * 1e3:.2g} mm (median); correct the file"
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


def refuse_units(campaign: Campaign) -> None:
    """Lengths and angles by themselves: distances between readings against those between the arm's nests. Raises BadInput."""
    readings, where = campaign.readings, str(campaign.readings.path)
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
            apart = f"{1 / ratio:.0f} times as close together" if ratio < 1 else f"{ratio:.0f} times as far apart"
            raise BadInput(
                f"{where}: the readings lie {apart} as the arm moved: x, y, z are in {text}, not millimetres; write x_mm, y_mm, "
                "z_mm in millimetres"
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


def _refuse_nests(campaign: Campaign, where: str) -> None:
    """Nests whose names are exchanged come out where the cell puts the other one."""
    c, nests = campaign, campaign.instrument.nests or {}
    used = [k for k in np.unique(c.readings.target) if (nest := nests.get(c.readings.targets[k])) and nest.place is not None]
    if len(used) < 2:
        return
    given = np.array([nests[c.readings.targets[k]].place for k in used])
    off, places = _rigid(replace(c, instrument=replace(c.instrument, nest_sd=FREE_NEST)))
    if np.median(np.linalg.norm(off, axis=1)) > FITS:
        return
    found = places[used]
    apart = np.linalg.norm(found[:, None] - given[None], axis=2)
    nearest, here = apart.argmin(axis=1), np.diag(apart)
    far = here > max(NEST_SHARE * c.instrument.nest_sd, FITS)
    moved = np.flatnonzero(far & (apart.min(axis=1) < 0.3 * here))
    if len(moved) >= 2 and {*nearest[moved]} == {*moved}:
        names = [f"'{c.readings.targets[used[k]]}'" for k in moved]
        raise BadInput(
            f"{where}, column target: the nests {' and '.join(names)} are exchanged: each is found within "
            f"{1e3 * apart.min(axis=1)[moved].max():.1f} mm of where the cell puts another and {1e3 * here[moved].min():.0f} mm "
            "or more from its own place; correct the column, or the places in [tracker.targets]"
        )


def _refuse_turns(campaign: Campaign, where: str) -> None:
    """Orientations of 6D targets: seen from the flange each target has one turn, the same in all postures."""
    if campaign.readings.turn is None:
        return
    readings = campaign.readings.take(np.flatnonzero(campaign.readings.turned))
    c = replace(campaign, readings=replace(campaign.readings, turn=None))
    state = located(c, nominal_state(c.robot, c.readings, c.payloads, c.instrument, Choice(joints=())))
    unturned = replace(readings, turn=np.tile(np.eye(3), (len(readings), 1, 1)))
    frames = replace(state, turns=np.tile(np.eye(3), (len(readings.targets), 1, 1)))
    # Residual turn of an identity reading: the predicted frame backwards.
    predicted = Rotation.from_rotvec(-residuals(c.robot, unturned, c.instrument, frames)[:, 3:])
    plain = _scatter(predicted, Rotation.from_matrix(readings.turn), readings.target)
    if plain < TURNS_FIT / 10:
        return
    tried = [(_scatter(predicted, turns, readings.target), text) for text, turns in _conventions(readings)]
    best, text = min(tried, default=(np.inf, ""))
    if best < TURNS_FIT and best < 0.3 * plain:
        raise BadInput(
            f"{where}: the orientations scatter by {np.degrees(plain):.3g} deg (median) as seen from the flange, while the "
            f"points fit, and by {np.degrees(best):.2g} deg {text}, or leave them out"
        )
    stated = 0.0 if readings.sigma_turn is None else float(np.nanmedian(readings.sigma_turn))
    if plain > max(TURNS_FIT, MEDIAN_TURN * stated):
        columns, orders, form = "qw, qx, qy, qz", "", "the target"
        if readings.angles is not None:
            columns, orders, form = "rx, ry, rz", ", in every order of their turns", "them in degrees as R = Rz(rz) Ry(ry) Rx(rx)"
        raise BadInput(
            f"{where}: the orientations {columns} scatter by {np.degrees(plain):.1f} deg (median) as seen from the flange, while "
            f"the points fit{orders}; write {form} in the tracker's frame, leave them out, or state sigma_rot_deg where they "
            "really are that poor"
        )


def _scatter(predicted: Rotation, turns: Rotation, target: Index) -> float:
    """Median angle rad of the turns (n,) about the middle of their target's, as seen from the links they sit on."""
    seen = predicted.inv() * turns
    off = np.empty(len(target))
    for k in np.unique(target):
        rows = np.flatnonzero(target == k)
        off[rows] = (_middle(seen[rows]).inv() * seen[rows]).magnitude()
    return float(np.median(off))


def _conventions(readings: Readings) -> Iterator[tuple[str, Rotation]]:
    """The orientations as other conventions would have them, and what to change then."""
    assert readings.turn is not None
    yield (
        "turned about: give the target in the tracker's frame, not the tracker in the target's",
        Rotation.from_matrix(readings.turn).inv(),
    )
    if readings.angles is None:
        given = Rotation.from_matrix(readings.turn).as_quat()  # x, y, z, w, where the columns are w, x, y, z
        last = Rotation.from_quat(np.roll(given, 1, axis=1))
        yield "with the columns read as x, y, z and the scalar last: name the last one qw", last
        return
    for unit, angles in (("", readings.angles), (" and the angles in degrees, not radians", np.degrees(readings.angles))):
        for order in ROTATION_ORDERS:
            yield (
                f"with rotation = '{order}' in [tracker] of the cell{unit}: state that",
                Rotation.from_matrix(rotations_in_order(angles, order)),
            )


def _middle(turns: Rotation) -> Rotation:
    """The one of up to 50 turns that is nearest to most of them."""
    few = turns[np.unique(np.linspace(0, len(turns) - 1, min(len(turns), 50)).astype(int))]
    apart = 2 * np.arccos(np.minimum(np.abs(few.as_quat() @ turns.as_quat().T), 1.0))
    return few[int(np.argmin(np.median(apart, axis=1)))]


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
    for i in range(6):
        for j in range(i + 1, 6):
            q = readings.q.copy()
            q[:, [i, j]] *= -1
            yield f"axes {i + 1} and {j + 1} both have the opposite sign (KUKA's signs are wanted)", with_q(q)
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
    for text, mdh in _tables(campaign.robot):
        yield f"the robot file's geometry {text}", replace(campaign, robot=replace(campaign.robot, mdh=mdh))
    for name, robot in _variants(campaign.robot):
        yield f"the robot is a '{name}', not a '{campaign.robot.name}'", replace(campaign, robot=robot)


def _other_loads(campaign: Campaign) -> Iterator[tuple[Index, str, Readings]]:
    """Readings with loads as each mistake would have made them right: whom it concerns, and the sentence that names it."""
    readings = campaign.readings
    rows = np.flatnonzero(np.abs(readings.load).max(axis=1) > 0)
    if len(rows):
        for text, factors in LOADS.items():
            yield rows, text, replace(readings, load=readings.load * factors)
    hung = [int(k) for k in np.unique(readings.payload) if readings.payloads[k] in campaign.payloads]
    for i, j in combinations(hung, 2):
        swapped = readings.payload.copy()
        swapped[readings.payload == i], swapped[readings.payload == j] = j, i
        names = f"'{readings.payloads[i]}' and '{readings.payloads[j]}'"
        yield (
            np.flatnonzero(swapped != readings.payload),
            f"the payloads {names} are exchanged",
            replace(readings, payload=swapped),
        )


def _tables(robot: Robot) -> Iterator[tuple[str, Array]]:
    """Geometries (6, 5) that were meant where a robot file was written otherwise than [geometry] wants it."""
    craig = robot.mdh.copy()
    craig[:5, 2:4], craig[5, 2:4] = robot.mdh[1:, 2:4], 0.0  # what lies before joint 1 only moves the base
    yield "has the lengths and twists of Craig's (modified) convention: write a and alpha of each row one row up", craig
    yield "has d_mm and a_mm in metres", robot.mdh * [1.0, 1e3, 1e3, 1.0, 1.0]
    degrees = np.where(IS_ANGLE, np.degrees(robot.mdh), robot.mdh)
    yield "has its angles in radians", degrees
    yield "has d_mm and a_mm in metres and its angles in radians", degrees * [1.0, 1e3, 1e3, 1.0, 1.0]


def _shifted(campaign: Campaign, shift: int) -> Campaign:
    """Points moved by rows against everything else; both ends cut."""
    readings: Readings = campaign.readings
    n = len(readings)
    kept = np.arange(max(0, -shift), min(n, n - shift))
    moved = replace(readings.take(kept), point=readings.point[kept + shift])
    return replace(campaign, readings=moved)
