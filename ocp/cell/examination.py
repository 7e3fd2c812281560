"""What is wrong, doubtful or not measured yet in a cell file and in the files it names.

A mistake is something with which nothing can be ground, or with which the robot may not be run. A doubt is a number that is
allowed and hardly meant. What is not measured yet is believed with the spread that the cell or its default says.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from ocp.effects.cell_effects import effect_of
from ocp.model.cell import Cell, TrackerSetup, payloads_of, read_cell, read_tracker_setup
from ocp.model.cell_schema import CellTables, LinkTarget
from ocp.model.prepare import wheel_cover, wheel_law
from ocp.plan.clearance import CollisionScene
from ocp.plan.passes.posture import Seed, seeds_of_stretches
from ocp.plan.passes.stretches import LEAST_GROUND_SHARE, NO_ROOM, LeftOut, LineStretch, ground_share, joined, whole_lines
from ocp.plan.paths import LaidPaths, PlanOptions, lay_paths, refuse_flange
from ocp.shell.progress import Phases
from robots.errors import BadInput, Infeasible
from robots.inverse import planned_family
from robots.payload import overload
from robots.pose import Array, apply, invert
from robots.robot import MOVES, Robot, left_out_notices
from robots.tracker_readings import Hanging
from trajectories.blade import Blade, read_blade
from trajectories.blade.mesh import volume

STEP = 2e-3  # m between waypoints that reach is looked at with
METRES = 10.0  # mm: a place of a wheel this near to the base's origin is written in metres
QUARTERS = 1e-3  # of a right angle in radians: angles this near to it, not zero, are written in radians
NESTS = 3  # reflectors on the last link that place the flange
APART = 5.0  # mm that these leave their common line by, at least
COLLAPSE = 50.0  # setpoints by which the force of a flange would change from stop to stop: its stiffness is written in N/m
LIMP = 0.01  # of the setpoint by which it would change at least: its stiffness is written in kN/mm or N/um
STIFF = (1.0, 700.0)  # GPa: from what barely holds its shape to tungsten carbide
THICK = 1.0  # m: a load whose radius of gyration is larger is written in kg mm^2
FAR = 0.5  # m between a payload's centre and the blade that it holds
SPRING = 1e3  # N m/rad: a joint's spring below is written in MN m/rad
HOT = 100.0  # C: no hall is as warm, 295 are kelvin
SMALL = 1.0  # deg: an arc or a tolerance below is written in radians
LONG = 1.0  # m from the flange to a blade's frame: what holds it is no holder
LEANING = 5.0  # deg out of the wheel's plane, from which a contact direction and an axis do not belong together
BROAD = 3.0  # diameters: a contact wheel wider than that is a drum
HUGE = 10.0  # times the upper end of what real cells show of an effect
GROUND = 0.999  # of the asked surface: what is less is told


@dataclass(frozen=True)
class Finding:
    """A mistake, doubt, unmeasured number or thing to know: the key it is about, and a sentence that says what to do."""

    kind: str
    key: str
    text: str

    def sentence(self) -> str:
        """As it is told: kind, key, text."""
        return f"{self.kind}: {self.key}: {self.text}"


MISTAKE, DOUBT, UNMEASURED, KNOWN = "mistake", "doubt", "not measured yet", "to know"


@dataclass(frozen=True)
class Grindable:
    """What a cell can grind of its blade: the cell, the laid lines, the stretches that have postures with the seeds of each, what
    is left out and why, and the share of the asked surface that is left."""

    cell: Cell
    laid: LaidPaths
    stretches: list[LineStretch]
    seeds: list[list[Seed]]
    left_out: list[LeftOut]
    share: float


@dataclass(frozen=True)
class Examined:
    """A cell file that was read with all it names: its setup, findings, and what can be ground (None: nothing could be tried)."""

    path: Path
    setup: TrackerSetup
    findings: tuple[Finding, ...]
    grindable: Grindable | None

    def of(self, kind: str) -> list[Finding]:
        """Findings of one kind."""
        return [f for f in self.findings if f.kind == kind]


def examine(path: Path, phases: Phases) -> Examined:
    """Read a cell file and all it names, and look at it as an engineer would before the first run.

    Raises BadInput: a file that cannot be read, a key that is unknown or out of range, a blade that is none.
    """
    with phases.phase("reading"):
        setup = read_tracker_setup(path)
        tables = setup.tables
        found = findings_of_tables(tables, setup.robot)
    if setup.calibration is not None:
        found += (Finding(UNMEASURED, "robot.calibration", notice) for notice in setup.calibration.notices)
    if tables.workpiece is None or tables.wheel is None:
        lacking = "workpiece" if tables.workpiece is None else "wheel"
        what = f"the table [{lacking}] is missing; without it the cell serves calibration and diagnosis of the arm alone"
        return Examined(path, setup, (*found, Finding(UNMEASURED, lacking, what)), None)
    cell = read_cell(path)
    found += _unmeasured(tables, () if setup.calibration is None else setup.calibration.names)
    if cell.workpiece.stl is None:
        return Examined(path, setup, (*found, Finding(DOUBT, "workpiece.stl", "names no blade; name one, or hand it in")), None)
    if planned_family(cell.robot) is None:
        why = "axes 2 and 3 are not parallel or the wrist's axes do not meet, so no program can be planned with this arm; "
        why += "calibrate and diagnose need none"
        return Examined(path, setup, (*found, Finding(MISTAKE, "robot.model", why)), None)
    with phases.phase("blade"):
        blade = read_blade(cell.workpiece.stl, cell.workpiece.stl_unit)
    found += (Finding(KNOWN, "workpiece.stl", notice) for notice in blade.notices)
    found += findings_of_frames(cell, blade)
    if any(f.kind == MISTAKE and f.key.startswith("workpiece.clamp") for f in found):  # no elasticity, so nothing can be tried
        return Examined(path, setup, tuple(found), None)
    key = "workpiece"
    try:
        with phases.phase("lines"):
            laid = lay_paths(cell, cell.workpiece.stl, PlanOptions(even=False, step=STEP))
        key = "force_flange"
        refuse_flange(cell, laid.paths)
        key = "wheel"
        grindable = _grindable(cell, laid, phases)
    except (BadInput, Infeasible) as reason:  # the blade itself was read: what is left is the cell's doing
        return Examined(path, setup, (*found, Finding(MISTAKE, key, str(reason))), None)
    return Examined(path, setup, (*found, *_reach_findings(grindable)), grindable)


def findings_of_tables(tables: CellTables, robot: Robot) -> list[Finding]:
    """What the file itself shows: the robot, units, exchanged places, loads, the tracker."""
    found = [*_robot_findings(tables, robot), *_unit_findings(tables), *_flange_findings(tables)]
    found += _place_findings(tables, robot)
    return [*found, *_load_findings(robot, tables), *_tracker_findings(tables), *_effect_findings(tables)]


def _grindable(cell: Cell, laid: LaidPaths, phases: Phases) -> Grindable:
    """Lines as a plan lays them, `pass_spacing` apart, and the postures with which they can be ground."""
    with phases.phase("wheel"):
        law = wheel_law(cell, wheel_cover(cell), laid.paths)
    with phases.phase("postures"):
        rigid = [np.zeros((len(path.s), 3)) for path in laid.paths]
        whole, short = whole_lines(laid.paths, rigid)
        scene = CollisionScene(cell, laid.blade.vertices)
        stretches, seeds, lost = seeds_of_stretches(cell, scene, law, whole, False)
    lost = joined([*short, *lost])
    return Grindable(cell, laid, stretches, seeds, lost, ground_share(laid.paths, lost))


def _reach_findings(found: Grindable) -> Iterator[Finding]:
    """Whether the blade can be ground at all, and what of it cannot: beside its own platform a wheel has no room in any cell."""
    for beside in (True, False):
        lost = [one for one in found.left_out if (one.reason == NO_ROOM[0]) == beside]
        share = ground_share(found.laid.paths, lost)
        if share >= GROUND:
            continue
        worst = max(lost, key=lambda one: one.length)
        told = f"{100 * (1 - share):.1f} % of the asked surface is left out; the longest of it: {worst.clause()}"
        kind = MISTAKE if share < LEAST_GROUND_SHARE else KNOWN if beside else DOUBT
        yield Finding(kind, "wheel.radius_mm" if beside else "wheel.centre_mm", told)


def _robot_findings(tables: CellTables, robot: Robot) -> Iterator[Finding]:
    if "example numbers" in robot.sources:
        text = "the robot file still holds the template's example numbers; replace them by the data sheet's, and its source"
        yield Finding(MISTAKE, "robot.model", text)
    if tables.robot.calibration is None:
        text = "the arm is believed as its data sheet draws it, about a millimetre off; calibrate it with a laser tracker"
        yield Finding(UNMEASURED, "robot.calibration", text)
    if tables.robot.stiffness_Nm_per_rad is None and tables.robot.calibration is None:
        text = "springs of the joints are a catalogue's order of magnitude; the same campaign with a payload measures them"
        yield Finding(UNMEASURED, "robot.stiffness_Nm_per_rad", text)
    planned = tables.workpiece is not None and tables.wheel is not None
    for key, notice in zip(robot.left_out, left_out_notices(robot), strict=True):
        without = MISTAKE if planned else DOUBT  # `plan` refuses such an arm
        yield Finding(without if key in MOVES else UNMEASURED, "robot.model", notice)


def _unit_findings(tables: CellTables) -> Iterator[Finding]:
    """Numbers that look like metres, radians or newtons per metre, and what no check can tell from a sound number."""
    if tables.wheel is not None:
        r, place = tables.wheel.radius_mm, list(tables.wheel.centre_mm)
        yield Finding(KNOWN, "wheel.radius_mm", f"{r:g} is a wheel {2 * r:g} mm across with cover and belt: look whether it is")
        if 0 < max(map(abs, place)) < METRES:
            yield Finding(DOUBT, "wheel.centre_mm", f"{place} lies inside the robot's foot: metres? millimetres are asked for")
    turn = () if tables.workpiece is None else tables.workpiece.abc_deg
    if any(0.5 < abs(v) < 4.5 and abs(v - round(v)) < QUARTERS for v in np.array(turn) / (0.5 * np.pi)):
        yield Finding(DOUBT, "workpiece.abc_deg", f"{list(turn)} looks like radians; degrees are asked for")
    yield from _angle_findings(tables)
    springs = tables.robot.stiffness_Nm_per_rad or ()
    if any(0 < k < SPRING for k in springs):
        text = f"{min(k for k in springs if k > 0):g} is no gear's: MN m/rad? N m/rad are asked for"
        yield Finding(DOUBT, "robot.stiffness_Nm_per_rad", text)
    if tables.reference_temperature_C > HOT:
        text = f"{tables.reference_temperature_C:g} is no hall's: kelvin? degrees Celsius are asked for"
        yield Finding(DOUBT, "reference_temperature_C", text)
    for key, offset in _offsets(tables).items():
        if 0 < max(map(abs, offset)) < 1.0:
            yield Finding(DOUBT, key, f"{_plain(offset)} is next to nothing: metres? millimetres are asked for")
    if tables.floor is not None and tables.floor.z_mm > 0:
        text = f"{tables.floor.z_mm:g} is above the robot's foot; a floor below it counts negative"
        yield Finding(DOUBT, "floor.z_mm", text)
    elif tables.floor is not None and -METRES < tables.floor.z_mm < 0:
        text = f"{tables.floor.z_mm:g} is hardly below the robot's foot: metres? millimetres are asked for"
        yield Finding(DOUBT, "floor.z_mm", text)
    if tables.workpiece is not None and not STIFF[0] <= tables.workpiece.youngs_modulus_GPa <= STIFF[1]:
        text = f"{tables.workpiece.youngs_modulus_GPa:g} is no metal's: MPa or TPa? GPa are asked for (titanium 114, steel 210)"
        yield Finding(DOUBT, "workpiece.youngs_modulus_GPa", text)
    if tables.wheel is not None and tables.wheel.belt_speed_m_s == 0:
        yield Finding(DOUBT, "wheel.belt_speed_m_s", "the belt stands, so nothing is ground; give its speed, with its sign")


def _angle_findings(tables: CellTables) -> Iterator[Finding]:
    """An arc or tolerances that are next to nothing in degrees and usual in radians."""
    angles: dict[str, tuple[float, ...]] = {} if tables.wheel is None else {"wheel.contact_arc_deg": tables.wheel.contact_arc_deg}
    angles |= {f"process.{name}": (getattr(tables.process, name),) for name in ("turn_tolerance_deg", "tilt_tolerance_deg")}
    for key, values in angles.items():
        if 0 < max(map(abs, values)) < SMALL:
            yield Finding(DOUBT, key, f"{_plain(values)} is next to nothing: radians? degrees are asked for")


def _place_findings(tables: CellTables, robot: Robot) -> Iterator[Finding]:
    """A wheel that stands in the robot, a blade far from its flange: one given in the other's frame, or the two exchanged."""
    foot = max((radius for link, _, _, radius in robot.link_shapes if link == 0), default=0.0)
    if tables.wheel is not None and max(map(abs, tables.wheel.centre_mm)) >= METRES:
        x, y, z = (1e-3 * v for v in tables.wheel.centre_mm)
        if np.hypot(x, y) < foot and 0 <= z <= robot.mdh[0, 1]:
            text = f"{list(tables.wheel.centre_mm)} lies inside the robot's column: is it the blade's place, in the flange frame?"
            yield Finding(DOUBT, "wheel.centre_mm", text)
    if tables.workpiece is not None:
        away = 1e-3 * float(np.linalg.norm(tables.workpiece.xyz_mm))
        if away > LONG:
            text = f"is {away:.2g} m from the flange: is it the wheel's place, in the base frame?"
            yield Finding(DOUBT, "workpiece.xyz_mm", text)
    if tables.wheel is not None:
        axis, towards = (np.array(v) / np.linalg.norm(v) for v in (tables.wheel.axis, tables.wheel.contact_direction))
        leaning = float(np.degrees(np.arcsin(abs(axis @ towards))))
        if leaning > LEANING:
            text = f"leans {leaning:.0f} deg along the wheel's axis, which is left out of it: is one of them another?"
            yield Finding(DOUBT, "wheel.contact_direction", text)
    if tables.wheel is not None and tables.wheel.width_mm > BROAD * 2 * tables.wheel.radius_mm:
        text = f"{tables.wheel.width_mm:g} is a drum, {2 * tables.wheel.radius_mm:g} mm across; width along the axle is asked for"
        yield Finding(DOUBT, "wheel.width_mm", text)


def _offsets(tables: CellTables) -> dict[str, tuple[float, ...]]:
    """Places mm, by key, of what lies some way from its frame if it is not in it."""
    found: dict[str, tuple[float, ...]] = {f"payloads.{name}.com_mm": load.com_mm for name, load in tables.payloads.items()}
    if tables.workpiece is not None:
        piece = tables.workpiece
        ends = {"clamp_to_mm": piece.clamp_to_mm, "clamp_offset_mm": piece.clamp_offset_mm}
        found["workpiece.xyz_mm"] = piece.xyz_mm
        found |= {f"workpiece.{key}": (value,) for key, value in ends.items() if value is not None}
    return found | {f"tracker.targets.{name}": place for name, place in _nests(tables).items()}


def _nests(tables: CellTables) -> dict[str, tuple[float, ...]]:
    """Places mm of the nests, by name, each in its link's frame."""
    targets = {} if tables.tracker is None else tables.tracker.targets
    return {name: t.xyz_mm if isinstance(t, LinkTarget) else t for name, t in targets.items()}


def _plain(numbers: tuple[float, ...]) -> str:
    return f"{numbers[0]:g}" if len(numbers) == 1 else str(list(numbers))


def _flange_findings(tables: CellTables) -> Iterator[Finding]:
    """A flange that cannot set the force, or whose spring is written in another unit."""
    flange = tables.force_flange
    if flange is None:
        return
    grown = flange.stiffness_N_per_mm * flange.stroke_mm
    if not LIMP * flange.setpoint_N <= grown <= COLLAPSE * flange.setpoint_N:
        unit = "N/m" if grown > flange.setpoint_N else "kN/mm or N/um"
        text = f"{flange.stiffness_N_per_mm:g} changes the force by {grown:.3g} N from stop to stop: {unit}? N/mm is asked for"
        yield Finding(DOUBT, "force_flange.stiffness_N_per_mm", text)
    elif flange.setpoint_output is None and abs(tables.process.force_N - flange.setpoint_N) > 0.5 * grown:
        text = (
            f"{flange.setpoint_N:g}, and the spring changes that by {0.5 * grown:.3g} N either way: process.force_N = "
            f"{tables.process.force_N:g} is out of its reach"
        )
        yield Finding(DOUBT, "force_flange.setpoint_N", text)
    name = tables.hanging
    load = None if name is None else tables.payloads.get(name)
    if load is not None and flange.carried_mass_kg > load.mass_kg:
        text = f"{flange.carried_mass_kg:g} is more than the payload '{name}' has in all ({load.mass_kg:g} kg)"
        yield Finding(DOUBT, "force_flange.carried_mass_kg", text)


def _load_findings(robot: Robot, tables: CellTables) -> Iterator[Finding]:
    """Payloads that the arm cannot carry, or whose centre or inertia nobody gave or gave in another unit; which hangs there."""
    if tables.workpiece is not None and tables.workpiece.payload is None and tables.payloads:
        first, table = next(iter(tables.payloads.items()))
        text = f"left out: '{first}' ({table.mass_kg:g} kg), the first of [payloads], is taken to hang there while grinding"
        yield Finding(DOUBT, "workpiece.payload", text)
    for name, load in payloads_of(tables).items():
        reason = overload(robot, load) if load.mass > 0 else ""
        if reason:
            yield Finding(MISTAKE, f"payloads.{name}", f"{reason}; hang less on the flange or choose a stronger robot")
        if load.mass > 0 and "com_mm" not in tables.payloads[name].model_fields_set:
            yield Finding(UNMEASURED, f"payloads.{name}.com_mm", "taken in the flange's face; take it from the drawing")
        key = f"payloads.{name}.inertia_kg_m2"
        if load.mass > 0 and not load.inertia.any():
            yield Finding(UNMEASURED, key, "taken as a point; take it from the drawing, the controller limits speeds by it")
        if load.inertia.max() > load.mass * THICK**2:
            text = f"{load.inertia.max():g} for {load.mass:g} kg: kg mm^2? kg m^2 are asked for"
            yield Finding(DOUBT, key, text)


def _effect_findings(tables: CellTables) -> Iterator[Finding]:
    """Believed effects that stand twice, have a sign that they cannot have, or are larger than any that was seen."""
    seen = set[tuple[str, int]]()
    for k, table in enumerate(tables.effects):
        one = effect_of(table.model_dump()).active
        key = f"effects[{k}].{one.effect.name}"
        if one.key in seen:
            yield Finding(DOUBT, key, "stands there twice; both act")
        seen.add(one.key)
        for p in one.effect.parameters:
            size = np.abs(np.asarray(one.parameters.get(p.key, 0.0), float)).max() if p.unit != "name" else 0.0
            if not p.signed and p.length == 1 and p.unit != "name" and one.parameters.get(p.key, 0.0) < 0 <= p.low:
                yield Finding(DOUBT, key, f"{p.key} is negative, which it never is")
            elif p.key not in one.scanned and size > HUGE * max(abs(p.low), abs(p.high)):
                text = f"{p.key} = {size:g} {p.unit} is over {HUGE:g} times what real cells show ({p.high:g} {p.unit})"
                yield Finding(DOUBT, key, text)


def _tracker_findings(tables: CellTables) -> Iterator[Finding]:
    if tables.tracker is None:
        yield Finding(
            UNMEASURED, "tracker", "no tracker is described; add [tracker] with its reflector nests to calibrate the arm"
        )
        return
    placed = [_nests(tables)[n] for n, t in tables.tracker.targets.items() if not isinstance(t, LinkTarget) or t.link == 6]
    spread = np.linalg.svd(np.array(placed) - np.mean(placed, axis=0), compute_uv=False) if len(placed) >= NESTS else np.zeros(2)
    if spread[1] < APART:
        where = "" if len(placed) < NESTS else " in one line or place"
        text = f"{len(placed)} nests on the last link{where}; a calibration needs {NESTS} apart to tell how the flange is turned"
        yield Finding(DOUBT, "tracker.targets", text)
    links = {name: t.link if isinstance(t, LinkTarget) else 6 for name, t in tables.tracker.targets.items()}
    for (one, here), (other, there) in combinations(_nests(tables).items(), 2):
        if links[one] == links[other] and len(placed) >= NESTS and spread[1] >= APART and np.allclose(here, there, atol=1.0):
            yield Finding(DOUBT, f"tracker.targets.{other}", f"stands where {one} does; is one of them typed twice?")
    far = [name for name, place in _nests(tables).items() if np.linalg.norm(place) > 1500]
    if far:
        yield Finding(
            DOUBT, f"tracker.targets.{far[0]}", "stands more than 1.5 m from its link's frame; is it given in the base frame?"
        )


def _unmeasured(tables: CellTables, calibrated: Sequence[str]) -> Iterator[Finding]:
    """Numbers whose spread nobody gave and that were not calibrated, by a parameter of each, and tables that are absent."""
    assert tables.workpiece is not None and tables.wheel is not None
    given = {"workpiece": tables.workpiece.model_fields_set, "wheel": tables.wheel.model_fields_set}
    for table, key, spread, parameter in (
        ("workpiece", "xyz_mm", "xyz_sd_mm", "blade_x"),
        ("workpiece", "abc_deg", "abc_sd_deg", "blade_a"),
        ("wheel", "centre_mm", "centre_sd_mm", "wheel_x"),
        ("wheel", "axis", "axis_sd_deg", "wheel_axis_u"),
    ):
        if spread not in given[table] and parameter not in calibrated:
            default = getattr(getattr(tables, table), spread)
            text = f"measure it and say how well as {spread}; until then one sigma of {default:g} is believed"
            yield Finding(UNMEASURED, f"{table}.{key}", text)
    if tables.floor is None:
        yield Finding(UNMEASURED, "floor.z_mm", "no floor is given; only the plane that the base stands on is kept free")
    flange = tables.force_flange
    if flange is not None and not {"bandwidth_hz", "delay_ms", "friction_N"} & flange.model_fields_set:
        yield Finding(UNMEASURED, "force_flange.bandwidth_hz", "the flange is taken to set its force at once; step it and log")
    if tables.process.preston_um_mm2_per_N_m is None:
        yield Finding(UNMEASURED, "process.preston_um_mm2_per_N_m", "depths are relative until removal of one blade is measured")


def findings_of_frames(cell: Cell, blade: Blade) -> Iterator[Finding]:
    """Frames and sides that look swapped."""
    piece, wheel = cell.workpiece, cell.wheel
    placed = apply(piece.T_flange_blade, blade.vertices)
    inverse = apply(invert(piece.T_flange_blade), blade.vertices)
    if placed[:, 2].max() < 0:
        swapped = "; the inverse lies before it: is this the flange in the blade's frame?" if inverse[:, 2].min() > 0 else ""
        yield Finding(DOUBT, "workpiece.xyz_mm", f"the whole blade lies behind the flange's face{swapped}")
    along = blade.vertices @ piece.clamp_normal
    held = along < piece.clamp_offset
    if not held.any() or held.all():
        what = "nothing" if not held.any() else "all"
        sense = -1.0 if cell.tables.workpiece is not None and cell.tables.workpiece.clamp_side == "above" else 1.0
        ends = sorted(round(1e3 * sense * float(v), 1) + 0.0 for v in (along.min(), along.max()))  # no -0.0
        plane = f"{'above' if sense < 0 else 'below'} {1e3 * sense * piece.clamp_offset:.6g} mm"
        reach = f"which reaches from {ends[0]:.1f} to {ends[1]:.1f} mm across its plane"
        text = f"the clamp, {plane}, holds {what} of the blade, {reach}; move or turn it"
        yield Finding(MISTAKE, f"workpiece.{_clamp_key(cell, 'clamp_offset_mm', 'clamp_to_mm')}", text)
    elif np.linalg.norm(placed[held], axis=1).mean() > np.linalg.norm(placed[~held], axis=1).mean():
        text = "the held end stands farther from the flange than the free one; is the side of the clamp, or the blade, turned?"
        yield Finding(DOUBT, f"workpiece.{_clamp_key(cell, 'clamp_normal', 'clamp_side')}", text)
    shoulder = cell.robot.mdh[0, 1] * cell.up
    if wheel.contact_direction @ (shoulder - wheel.centre) < 0 and np.linalg.norm(wheel.centre) > 0:
        yield Finding(DOUBT, "wheel.contact_direction", "points away from the robot, which would have to reach round the wheel")
    yield from _weight_findings(piece.payload, piece.payload_name, blade, piece.density, placed)


def _clamp_key(cell: Cell, plane: str, axis: str) -> str:
    """The key by which the file gives the clamp: by a plane or along an axis."""
    table = cell.tables.workpiece
    return plane if table is None or table.clamp_normal is not None else axis


def _weight_findings(load: Hanging, name: str, blade: Blade, density: float, placed: Array) -> Iterator[Finding]:
    mass = density * abs(volume(blade.vertices, blade.faces))
    if load.mass < mass:
        text = f"{load.mass:g} kg with the blade, which alone has {mass:.2f} kg; weigh holder and blade"
        yield Finding(DOUBT, f"payloads.{name}" if name else "workpiece.payload", text)
    away = float(np.linalg.norm(placed - load.com, axis=1).min())
    if load.mass > 0 and away > FAR:
        text = f"its centre stands {1e3 * away:.0f} mm from the nearest part of the blade; is one of them in another frame?"
        yield Finding(DOUBT, f"payloads.{name}.com_mm", text)
