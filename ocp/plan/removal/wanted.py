"""What is wanted to be taken off: an even depth, or that of a stock map; over the depth of the programmed force and feed."""

from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from ocp.model.blade_gap import SurfaceCloud
from ocp.model.cell import Cell
from robots.bounds import MEGABYTE, read_whole
from robots.csv_table import read_csv_table
from robots.errors import BadInput
from robots.pose import Array
from trajectories.blade import Blade
from trajectories.blade.mesh import place_mm
from trajectories.blade.nearest import nearest_on_facets

COLUMNS = ("px_mm", "py_mm", "pz_mm", "depth_um")
PROPERTIES = ("x", "y", "z", "depth_um")  # of a PLY's vertices
OFF_BLADE = 0.2e-3  # m off the surface, FORMATS.md
SUSPECT = 0.1e-3  # m off the plane of the nearest point of the cloud, from which on the mesh itself is asked
MOST_PLY_BYTES = 300 * MEGABYTE  # as an STL
MOST_UM = 2000.0  # a belt that takes off 2 mm mills
NEIGHBOURS = 6  # points of the map that speak for a cell, weighed by 1/distance^2 (Shepard 1968)
COVERED = 0.010  # m from a cell to the nearest point of the map on its wall, at most
OTHER_WALL = 0.020  # m that a normal turned round stands for: the other wall's points are that much farther off


@dataclass(frozen=True)
class Wanted:
    """Depth over that of the programmed force and feed at pass_spacing: `even` everywhere, or `ratio` (k,) at `points` (k, 3) m
    with normals (k, 3) of a map; programmed_um: what 1 is in um where that is known."""

    even: float = 1.0
    programmed_um: float | None = None
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))
    normals: Array = field(default_factory=lambda: np.zeros((0, 3)))
    ratio: Array = field(default_factory=lambda: np.zeros(0))
    source: Path | None = None

    def at(self, points: Array, normals: Array) -> Array:
        """The wanted depth (m,) at surface points (m, 3) m with outward normals."""
        if not len(self.points):
            return np.full(len(points), self.even)
        distance, index = self._nearest(points, normals)
        weight = 1.0 / np.maximum(distance, 1e-6) ** 2
        return np.asarray((weight * self.ratio[index]).sum(axis=1) / weight.sum(axis=1))

    def uncovered(self, points: Array, normals: Array) -> Array:
        """Distance (m,) m to the nearest point of the map on the same wall; zero without a map."""
        return np.zeros(len(points)) if not len(self.points) else self._nearest(points, normals)[0][:, 0]

    def told(self) -> str:
        """Words before "process.feed_mm_s = .. at process.pass_spacing_mm = .."."""
        if len(self.points):
            low, high = float(self.ratio.min()), float(self.ratio.max())
            return f"the depths of the stock map, {low:.2f} to {high:.2f} times that of"
        return (
            "the depth of" if abs(self.even - 1.0) < 1e-9 else f"the depth of process.removal_um, {self.even:.3g} times that of"
        )

    def _nearest(self, points: Array, normals: Array) -> tuple[Array, Array]:
        known, asked = (np.hstack([p, 0.5 * OTHER_WALL * n]) for p, n in ((self.points, self.normals), (points, normals)))
        distance, index = cKDTree(known).query(asked, k=np.arange(1, min(NEIGHBOURS, len(known)) + 1))
        return distance, index


def programmed_work(cell: Cell) -> float:
    """Pressure times slid length, N/m, of an even surface under lines `pass_spacing` apart at the programmed force and feed."""
    process = cell.process
    return process.force * abs(cell.wheel.belt_speed) / (process.feed * process.pass_spacing)


def wanted_of(cell: Cell, blade: Blade, cloud: SurfaceCloud, stock: Path | None) -> Wanted:
    """What the cell and a stock map ask for.

    Without Preston's coefficient the programmed force and feed are taken to make `removal_um`; without either a map has no scale.
    Raises BadInput: the map is malformed, of another blade, negative or absurd, or has no scale.
    """
    preston, asked = cell.process.preston, cell.process.removal
    made = None if preston is None else 1e6 * preston * programmed_work(cell)
    if stock is None:
        even = 1.0 if made is None or asked is None else 1e6 * asked / made
        return Wanted(even, made)
    unit = made if made is not None else None if asked is None else 1e6 * asked
    if unit is None:
        raise BadInput(
            f"{stock}: the cell gives neither process.preston_um_mm2_per_N_m nor process.removal_um, so no one knows what depth "
            "the programmed force and feed take off; add one of them"
        )
    points, depth, places = read_stock(stock)
    normals = _on_blade(stock, blade, cloud, points, places)
    return Wanted(1.0, made, points, normals, depth / unit, stock)


def refuse_uncovered(wanted: Wanted, points: Array, normals: Array) -> None:
    """Raises BadInput where a map says nothing of asked surface points (m, 3)."""
    distance = wanted.uncovered(points, normals)
    if (distance > COVERED).any():
        share, k = float((distance > COVERED).mean()), int(np.argmax(distance))
        raise BadInput(
            f"{wanted.source}: {100 * share:.0f} % of the surface to be ground has no point of the map within {1e3 * COVERED:g} "
            f"mm, farthest {place_mm(points[k])} with {1e3 * distance[k]:.0f} mm; measure there, or widen the margins"
        )


def read_stock(stock: Path) -> tuple[Array, Array, list[str]]:
    """Points (k, 3) m, depths (k,) um, and what to call each point, of a stock map as CSV or PLY. Raises BadInput."""
    if stock.suffix.lower() == ".ply":
        values, places = _read_ply(stock)
    else:
        read = read_csv_table(stock, COLUMNS, ())
        values, places = np.stack([read.numbers[name] for name in COLUMNS], axis=1), [f"line {number}" for number in read.line]
    bad = ~np.isfinite(values).all(axis=1) | (values[:, 3] < 0.0) | (values[:, 3] > MOST_UM)
    if bad.any():
        k = int(np.argmax(bad))
        raise BadInput(
            f"{stock}, {places[k]}: depth_um = {values[k, 3]:g} at ({', '.join(f'{v:g}' for v in values[k, :3])}) mm is not a "
            f"depth from 0 to {MOST_UM:g}; correct the map"
        )
    if len(values) < NEIGHBOURS:
        raise BadInput(f"{stock}: {len(values)} points are no map; give at least {NEIGHBOURS}")
    return 1e-3 * values[:, :3], values[:, 3], places


def _read_ply(stock: Path) -> tuple[Array, list[str]]:
    """x, y, z mm and depth_um (k, 4) of a PLY's vertices."""
    content = read_whole(stock, MOST_PLY_BYTES, "a stock map as PLY")
    try:
        raw = trimesh.exchange.ply.load_ply(BytesIO(content))["metadata"]["_ply_raw"]["vertex"]["data"]
        known = (raw.dtype.names or ()) if isinstance(raw, np.ndarray) else tuple(raw)
        missing = [name for name in PROPERTIES if name not in known]
        columns = [np.asarray(raw[name], float).ravel() for name in PROPERTIES if name in known]
        values = np.stack(columns, axis=1)
    except Exception as error:  # trimesh raises whatever its parser meets
        how = type(error).__name__
        raise BadInput(f"{stock}: this is no PLY file that can be read ({how}); write it anew or use CSV") from None
    if missing:
        raise BadInput(f"{stock}: its vertices lack {', '.join(missing)}; a stock map has {', '.join(PROPERTIES)} at each")
    return values, [f"vertex {k + 1}" for k in range(len(values))]


def _on_blade(stock: Path, blade: Blade, cloud: SurfaceCloud, points: Array, places: list[str]) -> Array:
    """Outward normals (k, 3) at the map's points. Raises BadInput where one lies off the blade."""
    nearest = cloud.tree.query(points)[1]
    normals = cloud.normals[nearest]
    off = np.abs(np.sum((points - cloud.points[nearest]) * normals, axis=1))
    far = np.linalg.norm(points - cloud.points[nearest], axis=1)
    doubtful = np.flatnonzero((off > SUSPECT) | (far > 2e-3))
    if len(doubtful):
        distance = nearest_on_facets(blade, points[doubtful])[1]
        if distance.max() > OFF_BLADE:
            k = int(doubtful[np.argmax(distance > OFF_BLADE)])
            raise BadInput(
                f"{stock}, {places[k]}: the point {place_mm(points[k])} is more than {1e3 * OFF_BLADE:g} mm off the surface of "
                f"{blade.name} ({int((distance > OFF_BLADE).sum())} such points, up to {1e3 * float(distance.max()):.2f} mm): is "
                "it a map of this blade, in its frame?"
            )
    return np.asarray(normals)
