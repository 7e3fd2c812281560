"""A blade that slips in its clamp does so once in a campaign, though its recordings are worked on one after the other.

The wheel pushes it against the normal that is ground at that instant (`ocp.simulate.twin.contact.workpiece`). In every later
recording it stands where it slipped to, whatever side is ground then: that is a shift of the blade in its grip like any other.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.run import Machine
from robots.pose import Array

SLIP = "clamp_slip"


def ground_sides(machine: Machine, known: Mapping[int, Array], c: ContactMoments) -> dict[int, Array]:
    """For every planted slip (its place among the slips) the normal (3,), blade frame, of the last contact at or before its
    instant, else of the first contact of all; `known` before the recording `c`, which comes after those that made it."""
    found, touching = dict(known), np.flatnonzero(c.contact)
    if len(touching):
        clock = c.campaign_time()[touching]
        for k, effect in enumerate(machine.truth.planted(SLIP)):
            earlier = touching[clock <= effect.number("at_s")]
            if len(earlier):
                found[k] = c.n[earlier[-1]]
            elif k not in found:
                found[k] = c.n[touching[0]]
    return found


def already_slipped(machine: Machine, known: Mapping[int, Array], begin: float) -> Machine:
    """The machine for a recording whose first contact is at clock `begin` s: slips before it have happened, against the normals
    `known` of `ground_sides`; the same machine where none has."""
    truth, slips = machine.truth, machine.truth.planted(SLIP)
    done = [k for k, effect in enumerate(slips) if k in known and effect.number("at_s") < begin]
    if not done:
        return machine
    R = Rotation.from_rotvec(truth.blade_turn).as_matrix() @ machine.cell.workpiece.T_flange_blade[:3, :3]
    shift = truth.blade_shift - sum(slips[k].number("m") * (R @ known[k]) for k in done)
    gone = {id(slips[k]) for k in done}
    left = tuple(effect for effect in truth.effects if id(effect) not in gone)
    truth = replace(truth, blade_shift=np.asarray(shift), effects=left)
    return replace(machine, truth=truth, grinder=replace(machine.grinder, truth=truth))
