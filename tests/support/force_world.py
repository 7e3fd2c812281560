"""Grinding logs made by the verification's route: elementary kinematics, Pinocchio's weights, contacts solved directly.

It shares neither the symbolic model nor the wheel's law with the fit that is tested on them.
"""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from ocp.contact.blade.compliance import HeldBlade, blade_compliance
from ocp.contact.blade.elasticity import Material
from ocp.contact.wheel.cover import Cover
from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell, read_cell
from ocp.model.force_balance import axis_directions
from ocp.model.prepare import typical_patch, wheel_cover
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.plan.second_route import BelievedRobot, believed_robot, bent, verify_pass
from robots.calibration.parameters import COMPLIANCE_NAMES, MDH_NAMES
from robots.calibration.store import Calibration
from robots.pose import make_transform
from robots.reference_kinematics import elementary_forward
from tests.support.all_postures import inverse_all
from tests.support.small_plan import small_cell
from trajectories.passes import BladePath

Array = np.ndarray
OVERLAP = 0.55e-3  # m that brings about 20 N on this wheel
FINE = 0.75  # of the default cell: another grid than the fit's, finer
ARM_SD = 1e-4  # m and rad: the posterior of a good tracker campaign, diagonal


CHOICE = PlanOptions(step=2e-3, even=False)
# Few lines far apart and as long as the blade: a log that tells the parameters apart.
WIDE = {
    "edge_margin_mm = 18.7": "edge_margin_mm = 3.0",
    "root_margin_mm = 40.0": "root_margin_mm = 5.0",
    "pass_spacing_mm = 6.0": "pass_spacing_mm = 25.0",
}


@dataclass(frozen=True)
class World:
    """The believed cell, the true one with the arm as it is, and the blade with all that gives way."""

    cell: Cell
    truth: Cell
    arm: BelievedRobot
    paths: list[BladePath]
    cloud: SurfaceCloud
    cover: Cover
    give: list[Array]
    injected: dict[str, float]


def arm_posterior(cell: Cell, sd: float = ARM_SD) -> Calibration:
    c = 1.0 / cell.robot.stiffness
    values = np.concatenate([cell.robot.mdh.ravel(), c])
    covariance = np.diag(np.concatenate([np.full(30, sd), 0.05 * c]) ** 2)
    return Calibration(cell.robot.name, MDH_NAMES + COMPLIANCE_NAMES, values, covariance, {"poses": 40}, {"th1": "gauge"})


def make_world(folder: Path, rng: np.random.Generator, changes: dict[str, str] | None = None) -> World:
    """A cell of the bundled kind whose truth is drawn from the priors of its file and of `arm_posterior`."""
    cell = read_cell(small_cell(folder, WIDE | (changes or {})))
    laid = lay_paths(cell, cell.workpiece.stl, CHOICE)
    names = [f"wheel_{a}" for a in "xyz"] + [f"blade_{a}" for a in "xyz"]
    injected = {name: 3e-4 * rng.normal() for name in names}
    turns = ("wheel_axis_u", "wheel_axis_v", "blade_c", "blade_b", "blade_a")
    injected |= {name: np.radians(0.05) * rng.normal() for name in turns}
    injected |= {"cover_stiffness_scale": 0.1 * rng.normal(), "blade_stiffness_scale": 0.05 * rng.normal(), "sensor_bias": 0.4}
    injected["flange_stiffness"] = 5600.0 * (1 + 0.05 * rng.normal())
    injected["flange_setpoint_offset"] = 0.2 * rng.normal()
    truth = true_cell(cell, injected)
    mdh = cell.robot.mdh + ARM_SD * rng.normal(size=(6, 5))
    payload = cell.workpiece.payload
    arm = believed_robot(cell, mdh, (1 + 0.05 * rng.normal(size=6)) / cell.robot.stiffness, payload.mass, payload.com)
    cover = wheel_cover(truth, FINE)
    # In quarters of a millimetre: the fit may find the mesh on disk; it solves other patches on it.
    axes = typical_patch(cell, cover, np.vstack([p.curvature for p in laid.paths]))
    patch = (2.5e-4 * round(axes[0] / 2.5e-4), 2.5e-4 * round(axes[1] / 2.5e-4))
    piece = truth.workpiece
    material = Material(piece.youngs_modulus, piece.poisson, piece.density)
    held = HeldBlade(laid.blade.vertices, laid.blade.faces, piece.clamp_normal, piece.clamp_offset, material)
    give = blade_compliance(held, laid.paths, patch)
    return World(cell, truth, arm, laid.paths, laid.cloud, cover, [np.asarray(c) for c in give.per_pass], injected)


def true_cell(cell: Cell, injected: dict[str, float]) -> Cell:
    """The cell with its registration and stiffnesses as they are, written out by hand."""
    wheel, piece, flange = cell.wheel, cell.workpiece, cell.flange
    u, v = axis_directions(wheel.axis)
    turn = Rotation.from_rotvec(injected["wheel_axis_u"] * u + injected["wheel_axis_v"] * v)
    wheel = replace(
        wheel,
        centre=wheel.centre + [injected[f"wheel_{a}"] for a in "xyz"],
        axis=turn.apply(wheel.axis),
        cover_modulus=wheel.cover_modulus * (1 + injected["cover_stiffness_scale"]),
    )
    R = Rotation.from_rotvec([injected[f"blade_{a}"] for a in "cba"]).as_matrix() @ piece.T_flange_blade[:3, :3]
    p = piece.T_flange_blade[:3, 3] + [injected[f"blade_{a}"] for a in "xyz"]
    modulus = piece.youngs_modulus * (1 + injected["blade_stiffness_scale"])
    piece = replace(piece, T_flange_blade=make_transform(R, p), youngs_modulus=modulus)
    if flange is not None:
        setpoint = flange.setpoint + injected["flange_setpoint_offset"]
        flange = replace(flange, stiffness=injected["flange_stiffness"], setpoint=setpoint)
    return replace(cell, wheel=wheel, workpiece=piece, flange=flange)


def taught_joints(world: World, path: BladePath, overlap: float, turn: float = 0.0, arc: float = 0.0) -> Array:
    """Joints (n, 6) that bring each waypoint to the true wheel with the given overlap, as taught on the machine."""
    wheel = world.truth.wheel
    e = Rotation.from_rotvec(arc * wheel.axis).apply(wheel.contact_direction)
    belt = np.cross(wheel.axis, e)
    t = -(np.cos(turn) * belt + np.sin(turn) * wheel.axis)
    frame = np.stack([t, np.cross(-e, t), -e], axis=1)
    on_blade = np.stack([path.t, np.cross(path.n, path.t), path.n], axis=2)
    R = frame @ on_blade.transpose(0, 2, 1)
    at = wheel.centre + (wheel.radius - overlap) * e
    target = make_transform(R, at - np.einsum("kij,kj->ki", R, path.p)) @ np.linalg.inv(world.truth.workpiece.T_flange_blade)
    command = target.copy()
    for _ in range(3):
        q = np.array([_near(world, T) for T in command])
        actual = elementary_forward(world.arm.robot, bent(world.truth, world.arm, q))
        command = target @ np.linalg.inv(actual) @ command
    return q


def _near(world: World, T: Array) -> Array:
    found = inverse_all(world.cell.robot, T).q
    usual = np.radians([0.5, -82.0, 101.0, -2.0, 80.0, -84.0])
    return found[int(np.argmin(np.abs(found - usual).max(axis=1)))]


def true_force(world: World, line: int, q: Array, setpoint: float, belt: float) -> Array:
    """Force (n,) N at the waypoints of a line."""
    path = world.paths[line]
    truth = replace(world.truth, wheel=replace(world.truth.wheel, belt_speed=belt))
    if truth.flange is not None:
        wanted = truth.flange.setpoint + setpoint - world.cell.flange.setpoint
        truth = replace(truth, flange=replace(truth.flange, setpoint=wanted))
    path = replace(path, force=np.full(len(path.s), setpoint))
    time = 0.01 * np.arange(len(q))
    return verify_pass(truth, world.arm, world.cover, world.cloud, path, world.give[line], time, q, path.s).force


def correlated(rng: np.random.Generator, n: int, sigma: float = 0.2, share: float = 0.5, samples: float = 4.0) -> Array:
    """White noise plus an exponentially correlated part, n samples."""
    decay = np.exp(-1.0 / samples)
    slow = np.empty(n)
    slow[0] = rng.normal()
    for k in range(1, n):
        slow[k] = decay * slow[k - 1] + np.sqrt(1 - decay**2) * rng.normal()
    return sigma * (np.sqrt(share) * slow + np.sqrt(1 - share) * rng.normal(size=n))


POINT = ["px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz"]
GIVEN = ["setpoint_N", "feed_mm_s", "belt_m_s", "line", "contact"]
HEADER = ["run", "time_s", *(f"q{i}_deg" for i in range(1, 7)), *POINT, *GIVEN, "fn_N"]


@dataclass(frozen=True)
class Run:
    """One recording: line (index), setpoint N, belt m/s, turn and arc rad, in contact or not."""

    line: int
    setpoint: float = 20.0
    belt: float = 20.0
    turn: float = 0.0
    arc: float = 0.0
    contact: bool = True


def recorded(world: World, run: Run, off: float = 0.0, dense: int = 4) -> tuple[list[list], Array]:
    """Rows of a recording without run, noise and reading, and its true force (n,) N; `off` m is a fault of teaching."""
    path = world.paths[run.line]
    q = taught_joints(world, path, OVERLAP * (run.setpoint / 20.0) ** 0.7 + off, run.turn, run.arc)
    force = true_force(world, run.line, q, run.setpoint, run.belt) if run.contact else np.zeros(len(q))
    s = np.linspace(path.s[0], path.s[-1], dense * (len(q) - 1) + 1)
    q, force, p, n, t = (CubicSpline(path.s, x)(s) for x in (q, force, path.p, path.n, path.t))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    t /= np.linalg.norm(t, axis=1, keepdims=True)
    rows = [
        [
            f"{0.01 * k:.3f}",
            *(f"{a:.6f}" for a in np.degrees(q[k])),
            *(f"{1e3 * a:.4f}" for a in p[k]),
            *(f"{a:.6f}" for a in n[k]),
            *(f"{a:.6f}" for a in t[k]),
            run.setpoint,
            40.0,
            run.belt,
            path.line,
            int(run.contact),
        ]
        for k in range(len(s))
    ]
    return rows, force


def campaign(world: World, runs: list[Run], rng: np.random.Generator) -> tuple[list[list], Array]:
    """Rows of a log (see HEADER) and the noise-free readings (n,) N."""
    rows: list[list] = []
    truth = []
    for i, run in enumerate(runs):
        part, force = recorded(world, run, 1e-4 * rng.normal())
        reading = force + world.injected["sensor_bias"]
        noise = correlated(rng, len(force))
        rows += [[i, *row, f"{reading[k] + noise[k]:.4f}"] for k, row in enumerate(part)]
        truth.append(reading)
    return rows, np.concatenate(truth)


def write_log(path: Path, rows: list[list], header: list[str] | None = None) -> Path:
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header or HEADER, *rows])
    return path
