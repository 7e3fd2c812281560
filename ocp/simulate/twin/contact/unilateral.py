"""Contact of the cover with a rigid surface by projected conjugate gradients, many problems side by side.

Find cell forces f >= 0 that carry a given force and close the gap where they are not zero:
min 1/2 f C f + g f with sum f cos(angle) = F. Conjugate gradients on the cells in contact, restarted when cells join
(Polonsky and Keer 1999, Wear 231, 206-219). A motion of the wheel by d toward the blade closes the gap by d cos(angle); dividing
by that cosine brings back the plain form.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ocp.simulate.twin.contact.rubber import Rubber
from robots.pose import Array

STEPS = 250
TOLERANCE = 2e-4  # rms opening on the cells in contact over the approach: the approach itself is then right to the square
CHECK = 4  # steps between looks for problems that are done


@dataclass(frozen=True)
class Patches:
    """Solved contacts k: approach (k,) m, cell forces over modulus times cosine (nx, ny, k), steps (k,), residual (k,) opening
    on the cells in contact over the approach's range (rms)."""

    approach: Array
    forces: Array
    steps: Array
    residual: Array


def press(rubber: Rubber, gap: Array, load: Array, start: Array | None = None) -> Patches:
    """Contacts for gaps (nx, ny, k) m, inf where there is no blade, under loads (k,) of force over modulus, m^2.

    `start` (nx, ny, k): cell forces of a similar contact. Every gap must be finite somewhere.
    """
    # Single precision: half the time, and its rounding is a thousandth of TOLERANCE.
    cosine = rubber.cosine[:, None, None].astype(np.float32)
    there = np.isfinite(gap)
    open_gap = np.where(there, gap, 1.0).astype(np.float32) / cosine
    load = load.astype(np.float32)
    count = gap.shape[2]
    f = _guess(rubber, open_gap, there, load)
    if start is not None:
        known = np.where(there, start, 0.0)
        total = known.sum(axis=(0, 1))
        f = np.where(total > 0, known * (load / np.where(total > 0, total, 1.0)), f)
    f = f.astype(np.float32)
    forces, approach = np.zeros(f.shape), np.zeros(count)
    steps, residual = np.full(count, STEPS), np.full(count, np.inf)
    todo = np.arange(count)
    direction = np.zeros_like(f)
    squared, keep = np.ones(count, np.float32), np.zeros(count, np.float32)
    for step in range(STEPS + 1):
        opening = rubber.displace(f / cosine) / cosine + open_gap
        touching = f > 0
        number = touching.sum(axis=(0, 1)).astype(np.float32)
        level = (opening * touching).sum(axis=(0, 1)) / number
        opening -= level
        fresh = ((opening * touching) ** 2).sum(axis=(0, 1))
        if step % CHECK == 0 or step == STEPS:
            lowest = np.where(there, opening, 0.0).min(axis=(0, 1))
            size = level - np.where(there, open_gap, np.inf).min(axis=(0, 1))
            off = np.maximum(np.sqrt(fresh / number), -0.3 * lowest) / size
            done = (off < TOLERANCE) | (step == STEPS)
            if done.any():
                at = todo[done]
                forces[:, :, at], steps[at], residual[at] = f[:, :, done], step, off[done]
                approach[at] = level[done] + (opening * f)[:, :, done].sum(axis=(0, 1)) / load[done]
                left = ~done
                todo, load, squared, keep, fresh = todo[left], load[left], squared[left], keep[left], fresh[left]
                f, direction, opening = f[:, :, left], direction[:, :, left], opening[:, :, left]
                open_gap, there, touching, number = open_gap[:, :, left], there[:, :, left], touching[:, :, left], number[left]
                if not len(todo):
                    break
        # A single cell in contact has no direction to search; a step of its own compliance lets its neighbours in.
        again = keep * fresh / np.where(squared > 0, squared, 1.0)
        direction = np.where(touching, opening + again * direction, 0.0).astype(np.float32)
        squared = fresh
        answer = rubber.displace(direction / cosine) / cosine
        answer -= (answer * touching).sum(axis=(0, 1)) / number
        along = (answer * direction).sum(axis=(0, 1))
        length = (opening * direction).sum(axis=(0, 1)) / np.where(along > 0, along, 1.0)
        length = np.where(number > 1, length, 1.0 / rubber.own).astype(np.float32)
        f = np.maximum(f - length * direction, 0.0)
        joining = there & (f == 0) & (opening < 0)
        keep = np.where(joining.any(axis=(0, 1)), 0.0, 1.0).astype(np.float32)
        f = np.where(joining, -length * opening, f)
        f *= load / f.sum(axis=(0, 1))
    return Patches(approach, forces, steps, residual)


def _guess(rubber: Rubber, gap: NDArray[Any], there: NDArray[Any], load: NDArray[Any]) -> NDArray[Any]:
    """Forces (nx, ny, k) of a Winkler bed of the cover that carry the loads: pressure rises with the depth under a level."""
    nx, ny, count = gap.shape
    bed = rubber.grid.dx * rubber.grid.dy / rubber.thickness
    flat = np.sort(np.where(there, gap, np.inf).reshape(nx * ny, count), axis=0)
    finite = np.where(np.isfinite(flat), flat, 0.0)
    rank = np.arange(1, nx * ny + 1)[:, None]
    carried = bed * (finite * rank - np.cumsum(finite, axis=0))
    enough = (carried < load) & np.isfinite(flat)
    cells = np.maximum(enough.sum(axis=0), 1)
    total = np.cumsum(finite, axis=0)[cells - 1, np.arange(count)]
    level = (load / bed + total) / cells
    f = np.where(there, np.maximum(level - gap, 0.0), 0.0)
    return np.asarray(f * load / f.sum(axis=(0, 1)))
