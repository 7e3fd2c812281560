"""The grinding of a virtual cell: from the arm's pose, free of contact, to the force between blade and wheel."""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.contact.chain import Chain, CoverForce, make_mount
from ocp.simulate.twin.contact.contact_instants import ContactMoments, ContactResult, Index
from ocp.simulate.twin.contact.sensor import lagging
from ocp.simulate.twin.contact.stations import SolvedStations, depth_curves, place_stations
from ocp.simulate.twin.contact.surface import Postures, postures
from ocp.simulate.twin.contact.table import Tables, make_tables
from ocp.simulate.twin.contact.wheel import LAW_CENTRE, friction, law_power, modulus_factor, push, radius_change, solve_relaxing
from ocp.simulate.twin.contact.workpiece import (
    arm_compliance_along,
    blade_compliance_along,
    blade_poses,
    blade_stiffness,
    clamp_compliance,
    solid_compliance,
    surface_change,
    wheel_frames,
)
from ocp.simulate.twin.truth.truth import Truth
from robots.pose import Array
from trajectories.blade import Blade

PAUSE = 0.5  # s without a row in contact after which the cover and the flange have forgotten


@dataclass(frozen=True)
class Grinder:
    """Wheel, blade and mount of one virtual cell; `tables` may be shared with other cells of the same blade and wheel."""

    cell: Cell
    truth: Truth
    blade: Blade
    tables: Tables

    def force(self, c: ContactMoments) -> ContactResult:
        """Force at n instants. Raises BadInput: the blade cannot be meshed or clamped."""
        rows = np.flatnonzero(c.contact)
        count = len(c.s)
        force, stroke = np.zeros(count), np.zeros(count)
        overlap, indentation = np.full(count, np.nan), np.full(count, np.nan)
        mu = friction(self.truth, self.cell, c)
        if len(rows):
            moved = lagging(self.truth, c)
            stations = place_stations(c, rows, moved.s[rows])
            chain, at = self._chain(moved, rows, stations, mu[rows])
            result = solve_relaxing(self.truth, chain, c.time_s[rows], _restarts(c, rows))
            force[rows], stroke[rows], indentation[rows] = result.force, result.stroke, result.indentation
            overlap[rows] = at.overlap
        return ContactResult(force, mu * force, overlap, stroke, indentation)

    def _chain(self, c: ContactMoments, rows: Index, stations: SolvedStations, mu: Array) -> tuple[Chain, Postures]:
        """The equation of every instant in contact, and the postures."""
        truth, cell = self.truth, self.cell
        T = blade_poses(truth, cell, c)[rows]
        centre, axis = wheel_frames(truth, cell, c)
        radius = cell.wheel.radius + radius_change(truth, cell, c)[rows]
        p, n, t = c.p[rows], c.n[rows], c.t[rows]
        at = postures(T, p, n, t, centre[rows], axis[rows], radius)
        indentation, crowding = depth_curves(self.tables, stations, at.shape)
        compliance = blade_compliance_along(self._solid(stations), stations, T[:, :3, :3], n, t, at, mu) / blade_stiffness(truth)
        compliance += clamp_compliance(truth, cell, p) + arm_compliance_along(c, rows, T, at, mu)
        everywhere = np.zeros(len(c.s))
        everywhere[rows] = crowding
        cover = CoverForce(
            unit=cell.process.force * modulus_factor(truth, cell, c)[rows],
            centre=LAW_CENTRE,
            power=law_power(truth),
            push=push(truth, c, everywhere)[rows],
            slack=np.zeros(len(rows)),
        )
        normal = np.einsum("kij,kj->ki", T[:, :3, :3], n)
        mount = make_mount(truth, cell, c, rows, normal)
        return Chain(at.depth + surface_change(truth, c)[rows], indentation, compliance, cover, mount), at

    def _solid(self, stations: SolvedStations) -> Array:
        """Compliance of the blade's solid at the stations (k, 3), kept with the tables."""
        piece, patch = self.cell.workpiece, self.tables.patch
        return self.tables.compliance(
            stations.p, stations.n, stations.t, lambda: solid_compliance(piece, self.blade, stations, patch)
        )


def make_grinder(cell: Cell, truth: Truth, blade: Blade, tables: Tables | None = None) -> Grinder:
    """The grinding of a virtual cell. `tables` of an earlier grinder of the same blade and wheel save the solutions they hold;
    None begins with those kept in this process."""
    return Grinder(cell, truth, blade, tables if tables is not None else make_tables(cell, blade))


def _restarts(c: ContactMoments, rows: Index) -> Array:
    """Rows (k,) at which a contact begins: another run, or a pause."""
    new = np.diff(c.run[rows], prepend=c.run[rows][0] - 1) != 0
    return np.asarray(new | (np.diff(c.time_s[rows], prepend=-np.inf) > PAUSE))
