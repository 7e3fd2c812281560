"""The nominal robot: geometry, limits, masses, collision shapes, from the catalogue or from a .toml file."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from robots.errors import BadInput
from robots.pose import Array
from robots.robot_schema import LinkTable, RobotTables, read_robot_tables

CATALOGUE = Path(__file__).parent / "catalogue"

# Link index 0..6, end points (3,) m in the link's frame, radius m.
Capsule = tuple[int, Array, Array, float]


@dataclass(frozen=True, eq=False)
class Robot:
    """A serial arm with six revolute axes, SI units and radians; axes q in the controller's (KUKA's) signs.

    MD-H in the distal Hayati form (PHYSICS 2.2): A_i = Rz(theta_i) Tz(d_i) Tx(a_i) Rx(alpha_i) Ry(beta_i)
    with theta_i = sign_i q_i + mdh[i, 0]. "Link frame i" is the frame after A_i; link frame 0 is the base, 6
    the flange. Two robots are never compared or hashed by value (arrays); functions that cache use the
    arrays' bytes.
    """

    name: str
    title: str
    mdh: Array  # (6, 5) theta offset rad, d m, a m, alpha rad, beta rad
    sign: Array  # (6,)
    q_min: Array  # (6,) rad
    q_max: Array  # (6,) rad
    qd_max: Array  # (6,) rad/s
    qdd_max: Array  # (6,) rad/s^2
    torque_max: Array  # (6,) N m at the link side of the gear
    gear_ratio: Array  # (6,) motor turns per turn of the axis, nan where unknown
    link_mass: Array  # (7,) kg: base, links 1..6
    link_com: Array  # (7, 3) m in the link frames
    link_inertia: Array  # (7, 3, 3) kg m^2 about the centre of mass, axes of the link frame
    stiffness: Array  # (6,) N m/rad, 0 = rigid
    link_shapes: tuple[Capsule, ...]
    sources: str


def catalogue() -> list[str]:
    """Names that `load_robot` knows."""
    return sorted(path.stem for path in CATALOGUE.glob("*.toml"))


def load_robot(name_or_path: str | Path) -> Robot:
    """The robot of a catalogue name, or of a path that ends in .toml.

    Raises BadInput: the name is not in the catalogue, or the file is not a sound robot file.
    """
    text = str(name_or_path)
    if text.lower().endswith(".toml"):
        return _robot(read_robot_tables(Path(name_or_path)))
    if text not in catalogue():
        raise BadInput(
            f"robot '{text}' is not in the catalogue ({', '.join(catalogue())}); choose one of these or give the path "
            "of a robot .toml file"
        )
    return _robot(read_robot_tables(CATALOGUE / f"{text}.toml"))


def _robot(tables: RobotTables) -> Robot:
    geometry, limits = tables.geometry, tables.limits
    links = [getattr(tables.links, name) for name in ("base", *(f"link{i}" for i in range(1, 7)))]
    rows = [
        np.radians(geometry.theta_deg),
        np.array(geometry.d_mm) * 1e-3,
        np.array(geometry.a_mm) * 1e-3,
        np.radians(geometry.alpha_deg),
        np.radians(geometry.beta_deg),
    ]
    blocks = [(name, getattr(tables, name)) for name in ("geometry", "limits", "gears", "stiffness", "links")]
    sources = [f"{name}: {block.source}" for name, block in blocks if block is not None]
    return Robot(
        name=tables.name,
        title=tables.title,
        mdh=_fixed(np.stack(rows, axis=1)),
        sign=_fixed(np.array(geometry.sign, float)),
        q_min=_fixed(np.radians(limits.q_min_deg)),
        q_max=_fixed(np.radians(limits.q_max_deg)),
        qd_max=_fixed(np.radians(limits.speed_deg_s)),
        qdd_max=_fixed(np.radians(limits.acceleration_deg_s2)),
        torque_max=_fixed(np.array(limits.torque_Nm)),
        gear_ratio=_fixed(np.array(tables.gears.ratio) if tables.gears is not None else np.full(6, np.nan)),
        link_mass=_fixed(np.array([link.mass_kg for link in links])),
        link_com=_fixed(np.array([link.com_mm for link in links]) * 1e-3),
        link_inertia=_fixed(np.array([_tensor(link) for link in links])),
        stiffness=_fixed(np.array(tables.stiffness.joint_Nm_per_rad)),
        link_shapes=tuple(
            (c.link, _fixed(np.array(c.from_mm) * 1e-3), _fixed(np.array(c.to_mm) * 1e-3), c.radius_mm * 1e-3)
            for c in tables.shape
        ),
        sources="\n".join(sources),
    )


def _tensor(link: LinkTable) -> Array:
    xx, yy, zz, xy, xz, yz = link.inertia_kg_m2
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _fixed(array: Array) -> Array:
    """The array, no longer writable: a robot is shared by every part of a run."""
    array = np.ascontiguousarray(array, float)
    array.setflags(write=False)
    return array
