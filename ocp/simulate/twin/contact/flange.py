"""The mount between arm and blade: a rigid one, or the force-setting flange with what happens to it."""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.contact.moments import ContactMoments, Index
from ocp.simulate.twin.truth.machine import Truth
from robots.pose import Array

GRAVITY = 9.80665  # m/s^2, standard gravity


@dataclass(frozen=True)
class Mount:
    """What carries the blade. along (n,): n.a; preload (n,) N at stroke 0; stiffness N/m; half m: stroke to each side; friction
    (n,) N against the stroke's motion; held (n,) m or None: the stroke where it sticks. stiffness 0: no flange."""

    along: Array
    preload: Array
    stiffness: float
    half: float
    friction: Array
    held: Array | None = None

    def stroke(self, force: Array) -> Array:
        """Stroke (n,) m under contact forces (n,) N; positive gives way to the wheel."""
        if self.held is not None:
            return self.held
        if self.stiffness == 0.0:
            return np.zeros_like(force)
        free = (force * self.along - self.preload - self.friction) / self.stiffness
        return np.asarray(np.clip(free, -self.half, self.half))


def make_mount(truth: Truth, cell: Cell, c: ContactMoments, rows: Index, normal: Array) -> Mount:
    """The mount at the instants `rows`; `normal` (rows, 3): outward normals of the blade there, base axes."""
    flange = cell.flange
    zero = np.zeros(len(rows))
    if flange is None:
        return Mount(zero, zero, 0.0, 0.0, zero)
    if flange.axis is None:
        direction = normal
    else:
        direction = c.T_base_flange[rows, :3, :3] @ flange.axis
        direction = direction * np.where(np.sum(direction * normal, axis=1) < 0, -1.0, 1.0)[:, None]
    mass = 0.0 if flange.gravity_compensated else flange.carried_mass
    mass += sum(effect.number("kg") for effect in truth.planted("flange_gravity"))
    setpoint = np.where(np.isfinite(c.setpoint[rows]), c.setpoint[rows], flange.setpoint) + truth.flange_offset
    stiffness = flange.stiffness * truth.flange_scale
    for effect in truth.planted("flange_stiffness"):
        stiffness *= 1 + effect.number("scale")
    stick = sum(effect.number("N") for effect in truth.planted("flange_friction"))
    return Mount(
        along=np.sum(direction * normal, axis=1),
        preload=setpoint - mass * GRAVITY * direction[:, 2],
        stiffness=float(stiffness),
        half=0.5 * flange.stroke,
        friction=np.full(len(rows), float(stick)),
    )
