"""A slip in the clamp over several recordings: the same as if all of them were ground in one call."""

from dataclasses import fields, replace

import numpy as np
import pytest

from ocp.simulate.twin.contact import ContactMoments
from ocp.simulate.twin.run import VirtualMachine, already_slipped, ground_sides
from tests.support.twin_grinding import HERTZ_RATE, Bench, believed, moving

Array = np.ndarray


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench(flange=True)


def _other_side(bench: Bench, c: ContactMoments) -> ContactMoments:
    """The round bar turned about itself: the same contact, on the side that lies opposite."""
    B, turn = bench.cell.workpiece.T_flange_blade, np.diag([-1.0, -1.0, 1.0, 1.0])
    T = c.T_base_flange @ B @ turn @ np.linalg.inv(B)
    return replace(c, T_base_flange=T, p=c.p @ turn[:3, :3], n=c.n @ turn[:3, :3], line=c.line + 1)


def recordings(bench: Bench, first: bool = True) -> list[ContactMoments]:
    """Three recordings at clock 100, 200, 300 s: one side, the other, the first again; `first`: whether the wheel touches in the
    first."""
    whole = replace(moving(bench), clock_s=100 + np.arange(250) / HERTZ_RATE)
    sides = [whole, _other_side(bench, whole), whole]
    count = len(whole.s)
    return [
        replace(c, clock_s=c.clock_s + 100 * k, run=np.full(count, k), contact=np.full(count, first or k > 0))
        for k, c in enumerate(sides)
    ]


def joined(parts: list[ContactMoments]) -> ContactMoments:
    return ContactMoments(*(np.concatenate([getattr(c, f.name) for c in parts]) for f in fields(ContactMoments)))


def one_by_one(bench: Bench, parts: list[ContactMoments], machine: VirtualMachine) -> Array:
    known: dict[int, Array] = {}
    force = []
    for c in parts:
        force.append(already_slipped(machine, known, float(c.clock_s[0])).grinder.force(c).force)
        known = ground_sides(machine, known, c)
    return np.concatenate(force)


@pytest.mark.parametrize("at_s", [50.0, 100.5, 150.0, 200.5, 250.0, 500.0])
@pytest.mark.parametrize("first", [True, False])
def test_recordings_one_by_one_slip_as_all_together(bench, at_s, first):
    truth = believed(bench.cell, f"clamp_slip=1e-4,at_s={at_s}", "clamp_slip=3e-5,at_s=120", "wheel_wear=1e-8")
    grinder = bench.grinder(truth)
    machine = VirtualMachine(bench.cell, truth, bench.blade, None, grinder, np.random.default_rng(0))  # type: ignore[arg-type]
    parts = recordings(bench, first)
    together = grinder.force(joined(parts)).force
    np.testing.assert_allclose(one_by_one(bench, parts, machine), together, atol=1e-6)


def test_the_side_ground_later_does_not_turn_the_slip_round(bench):
    truth = believed(bench.cell, "clamp_slip=1e-4,at_s=100.5")
    machine = VirtualMachine(bench.cell, truth, bench.blade, None, bench.grinder(truth), np.random.default_rng(0))  # type: ignore[arg-type]
    parts = recordings(bench)
    found = np.split(one_by_one(bench, parts, machine), 3)
    plain = np.split(bench.force(joined(parts)).force, 3)
    # Away from the wheel on the side that was ground, toward it on the other.
    assert np.all(found[1] > plain[1] + 0.1) and np.all(found[2] < plain[2] - 0.1)
    assert already_slipped(machine, {}, 1e9) is machine
