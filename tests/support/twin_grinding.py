"""A round bar against the bundled cell's wheel: moments of contact without a robot, and effects planted one at a time."""

from dataclasses import replace

import numpy as np

from ocp.data import CELL
from ocp.model.cell import Cell, read_cell
from ocp.simulate.twin.contact import ContactMoments, ContactResult
from ocp.simulate.twin.contact.grinder import Grinder, make_grinder
from ocp.simulate.twin.contact.table import Tables
from ocp.simulate.twin.planting import parse_effect
from ocp.simulate.twin.truth import Truth, draw_truth
from robots.pose import make_transform
from trajectories.blade import Blade

Array = np.ndarray
BAR, LENGTH, STRIPS = 0.03, 0.12, 400  # radius and length of the bar in m, facets around: 0.9 um between chord and arc
RINGS = 12
SOLID = np.array([4e-6, 3e-7, -2e-7])  # m/N: c_nn, c_nt, c_nb of a blade that gives way a little, instead of finite elements
HERTZ_RATE = 250.0  # rows a second
FEED = 0.04


def bar() -> Blade:
    """A closed bar along z."""
    angle = np.linspace(0, 2 * np.pi, STRIPS, endpoint=False)
    ring = np.stack([BAR * np.cos(angle), BAR * np.sin(angle)], axis=1)
    levels = np.linspace(0, LENGTH, RINGS + 1)
    vertices = [[*xy, z] for z in levels for xy in ring] + [[0, 0, 0], [0, 0, LENGTH]]
    last, faces = RINGS * STRIPS, []
    for k in range(STRIPS):
        j = (k + 1) % STRIPS
        for a in range(0, last, STRIPS):
            faces += [[a + k, a + j, a + STRIPS + j], [a + k, a + STRIPS + j, a + STRIPS + k]]
        faces += [[last + STRIPS, j, k], [last + STRIPS + 1, last + k, last + j]]
    return Blade("bar", "bar", np.array(vertices, float), np.array(faces))


def bundled(flange: bool = True) -> Cell:
    cell = read_cell(CELL)
    return cell if flange else replace(cell, flange=None)


def believed(cell: Cell, *effects: str, **changes: float | Array) -> Truth:
    truth = draw_truth(cell, 7, [parse_effect(text) for text in effects], mode="believed")
    return replace(truth, **changes)


def moments(
    cell: Cell, s: Array, overlap: Array | float, run: Array | None = None, belt: float = 20.0, **changes
) -> ContactMoments:
    """The bar's line x = 0, y = radius at places s m from z = 20 mm, pressed straight into the wheel by `overlap` m."""
    n = len(s)
    wheel = cell.wheel
    e = wheel.contact_direction
    t, normal = -np.cross(wheel.axis, e), -e
    R = np.stack([t, np.cross(normal, t), normal], axis=1) @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
    p = np.column_stack([np.zeros(n), np.full(n, BAR), 0.02 + s])
    at = wheel.centre + (wheel.radius - np.broadcast_to(overlap, (n,)))[:, None] * e
    T = make_transform(np.broadcast_to(R, (n, 3, 3)), at - p @ R.T) @ np.linalg.inv(cell.workpiece.T_flange_blade)
    run = np.zeros(n, int) if run is None else run
    time = np.concatenate([np.arange(np.sum(run == k)) / HERTZ_RATE for k in np.unique(run)])
    nan = np.full(n, np.nan)
    fixed = {"n": [0.0, 1.0, 0.0], "t": [0.0, 0.0, 1.0]}
    made = ContactMoments(
        T,
        np.zeros((n, 6, 6)),
        p,
        np.tile(fixed["n"], (n, 1)),
        np.tile(fixed["t"], (n, 1)),
        s,
        np.ones(n, int),
        nan,
        np.full(n, FEED),
        np.full(n, belt),
        np.ones(n, bool),
        nan,
        time,
        run,
        np.zeros(n),
        nan,
        nan,
    )
    return replace(made, **{k: np.broadcast_to(v, (n, *np.shape(getattr(made, k))[1:])) for k, v in changes.items()})


class Bench:
    """Grinders of one cell on one store of contact solutions; the compliance of the solid is given, not computed."""

    def __init__(self, flange: bool = True, solid: Array = SOLID):
        self.cell, self.blade = bundled(flange), bar()
        self.tables: Tables | None = None
        self.solid = solid

    def grinder(self, truth: Truth | None = None) -> Grinder:
        truth = truth if truth is not None else believed(self.cell)
        made = make_grinder(self.cell, truth, self.blade, self.tables)
        self.tables = made.tables
        made.tables.compliance = lambda at, solve: np.tile(self.solid, (len(at.s), 1))  # type: ignore[method-assign]
        return made

    def force(self, c: ContactMoments, *effects: str, **changes: float | Array) -> ContactResult:
        return self.grinder(believed(self.cell, *effects, **changes)).force(c)


def moving(bench: Bench, length: float = 0.04, overlap: float = 6e-4, **changes) -> ContactMoments:
    return moments(bench.cell, np.arange(0, length, FEED / HERTZ_RATE), overlap, **changes)
