"""What a plan rests on: the wheel's cover and law, the blade's compliance; side by side where there are two cores, and cached."""

from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np

from ocp.contact.blade.compliance import Compliance, HeldBlade, blade_compliance, compliance_kept
from ocp.contact.blade.elasticity import Material
from ocp.contact.wheel.cover import Cover, WheelGeometry, build_cover, default_cell
from ocp.contact.wheel.law import WheelLaw
from ocp.contact.wheel.law_fit import Domain, remembered_law
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.cell import Cell
from ocp.shell.processes import cores, interrupts_held_back, nothing, workers
from ocp.shell.progress import Phases
from robots.pose import Array
from trajectories.blade import Blade
from trajectories.passes import BladePath


@dataclass(frozen=True)
class ContactModel:
    """Wheel: cover for direct solutions, law; compliance of the blade at every waypoint."""

    cover: Cover
    law: WheelLaw
    compliance: Compliance


def prepare_contact(
    cell: Cell, blade: Blade, paths: list[BladePath], phases: Phases, meanwhile: Callable[[WheelLaw], None] | None = None
) -> ContactModel:
    """Everything that gives way between blade and wheel; `meanwhile` is done while the blade is meshed in another process.

    Raises BadInput (the blade cannot be meshed or clamped), Infeasible (the blade is too hollow for the wheel).
    """
    with phases.phase("wheel cover"):
        cover = wheel_cover(cell)
    curvature = np.vstack([path.curvature for path in paths])
    axes = typical_patch(cell, cover, curvature)
    material = Material(cell.workpiece.youngs_modulus, cell.workpiece.poisson, cell.workpiece.density)
    held = HeldBlade(blade.vertices, blade.faces, cell.workpiece.clamp_normal, cell.workpiece.clamp_offset, material)
    task = (held, paths, axes)
    with ExitStack() as stack:
        waiting: Future[Compliance] | None = None
        if cores() > 1 and not compliance_kept(*task):
            pool = stack.enter_context(workers(1, nothing))
            with interrupts_held_back():
                waiting = pool.submit(blade_compliance, *task)
        with phases.phase("wheel table"):
            law = wheel_law(cell, cover, paths)
        if waiting is not None and meanwhile is not None:
            meanwhile(law)
        with phases.phase("blade"):
            compliance = blade_compliance(*task) if waiting is None else waiting.result()
    return ContactModel(cover, law, compliance)


def wheel_law(cell: Cell, cover: Cover, paths: list[BladePath]) -> WheelLaw:
    """The wheel's law over what the blade and the cell's tolerances ask for. Raises Infeasible: the blade is too hollow."""
    process, lateral = cell.process, min(cell.process.lateral_tolerance, 0.5 * cell.wheel.width)
    curvature = np.vstack([path.curvature for path in paths])
    domain = Domain(curvature, process.turn_tolerance, lateral, float(np.tan(process.tilt_tolerance)), process.force)
    return remembered_law(cover, domain)


def wheel_cover(cell: Cell, coarser: float = 1.0) -> Cover:
    """The cover's compliance on the grid that the process force asks for, or on one with `coarser` times larger cells."""
    wheel = cell.wheel
    geometry = WheelGeometry(wheel.radius, wheel.width, wheel.cover_thickness, wheel.cover_modulus, wheel.cover_poisson)
    return build_cover(geometry, coarser * default_cell(geometry, cell.process.force))


def typical_patch(cell: Cell, cover: Cover, curvature: Array) -> tuple[float, float]:
    """Semi-axes (m) of the contact patch on the blade's median curvature, along the feed and across it."""
    k_tt, k_bb, _ = np.median(curvature, axis=0)
    kxx = max(k_tt + 1 / cell.wheel.radius, 0.5 / cell.wheel.radius)
    contact = solve_force(cover, cell.process.force, LocalShape(float(kxx), float(k_bb)))
    return float(contact.semi_axes[0]), float(contact.semi_axes[1])
