"""What happens to the wheel and the belt: stiffness, law, radius, pushes, friction, relaxation."""

from dataclasses import replace

import numpy as np

from ocp.model.cell import Cell
from ocp.simulate.twin.contact.chain import Chain, Equilibrium, solve_sticking
from ocp.simulate.twin.contact.contact_instants import ContactMoments
from ocp.simulate.twin.contact.sensor import memory
from ocp.simulate.twin.truth.truth import Truth
from robots.pose import Array

LAW_CENTRE = 20.0  # N, the catalogue's wheel_law turns the curve about this force
SPLICE_SHARE = 0.1  # of the belt's revolution that a splice takes under the wheel, as a raised cosine
ITERATIONS, SETTLED = 40, 1e-6  # of the relaxation, N


def _warmer(cell: Cell, c: ContactMoments) -> Array:
    """Wheel temperature over the reference, K; 0 where none is given."""
    return np.nan_to_num(c.wheel_temperature_C - cell.tables.reference_temperature_C)


def modulus_factor(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """Cover's force over the believed one at the same indentation (n,): truth's scale, wheel_stiffness, wheel_temperature."""
    factor = np.full(len(c.s), truth.cover_scale)
    for effect in truth.planted("wheel_stiffness"):
        factor *= 1 + effect.number("scale")
    for effect in truth.planted("wheel_temperature"):
        factor *= np.maximum(1 + effect.number("per_K") * _warmer(cell, c), 0.05)
    return factor


def law_power(truth: Truth) -> float:
    """Power of the believed force in the true one, about LAW_CENTRE."""
    return float(np.prod([1 + effect.number("exponent") for effect in truth.planted("wheel_law")]))


def radius_change(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """Radius over the cell's (n,) m: wear with the clock (contact time where there is none), heat, run-out."""
    change = np.zeros(len(c.s))
    worn = np.where(np.isfinite(c.clock_s), c.clock_s, _contact_time(c))
    for effect in truth.planted("wheel_wear"):
        change -= effect.number("m_per_s") * worn
    for effect in truth.planted("wheel_temperature"):
        change += effect.number("radius_per_K") * _warmer(cell, c)
    for effect in truth.planted("wheel_runout"):
        turned = belt_travel(c) / cell.wheel.radius
        change += effect.number("m") * np.cos(turned + effect.number("phase_rad"))
    return change


def _contact_time(c: ContactMoments) -> Array:
    """Time spent in contact since the first row (n,) s, over all runs."""
    total, spent = 0.0, np.zeros(len(c.s))
    for run in c.runs():
        step = np.diff(c.time_s[run], prepend=c.time_s[run][0]) * c.contact[run]
        spent[run] = total + np.cumsum(step)
        total = float(spent[run][-1])
    return spent


def belt_travel(c: ContactMoments) -> Array:
    """Way of the belt since the run's time zero (n,) m; the speed between two rows is that of the later one."""
    way = np.zeros(len(c.s))
    for run in c.runs():
        time, speed = c.time_s[run], c.belt[run]
        way[run] = speed[0] * time[0] + np.concatenate([[0.0], np.cumsum(speed[1:] * np.diff(time))])
    return way


def friction(truth: Truth, cell: Cell, c: ContactMoments) -> Array:
    """Signed tangential over normal force (n,) along axis x outward radial; none where the belt stands."""
    size = cell.wheel.friction + sum(effect.number("dmu") for effect in truth.planted("tangential_force"))
    return np.asarray(max(size, 0.0) * np.sign(c.belt))


def push(truth: Truth, c: ContactMoments, crowding: Array) -> Array:
    """Force of the belt beside the cover's (n,) N wherever there is contact: splice and tension; crowding (n,) is 0..1."""
    total = np.zeros(len(c.s))
    for effect in truth.planted("belt_tension"):
        total += effect.number("N") * crowding
    for effect in truth.planted("belt_splice"):
        turn = np.mod(effect.number("hz") * c.time_s + 0.5, 1.0) - 0.5
        bump = np.where(np.abs(turn) < 0.5 * SPLICE_SHARE, 0.5 + 0.5 * np.cos(2 * np.pi * turn / SPLICE_SHARE), 0.0)
        total += effect.number("N") * bump * (c.belt != 0)
    return total


def solve_relaxing(truth: Truth, chain: Chain, time_s: Array, restart: Array) -> Equilibrium:
    """Forces of a cover that relaxes as a standard linear solid on top of its elastic law, with memory along each run.

    F = F_elastic - g q,  dq/dt = (F_elastic - q) / tau,  q = 0 where `restart` is True. The memory is causal and weak (g < 1), so
    solving all instants for a given q and renewing q from the forces settles at once.
    """
    solids = [(effect.number("g"), effect.number("tau")) for effect in truth.planted("wheel_relaxation")]
    result = solve_sticking(chain, restart)
    if not solids:
        return result
    before = result.elastic
    for _ in range(ITERATIONS):
        slack = np.zeros_like(before)
        for g, tau in solids:
            slack += g * memory(before, time_s, restart, tau)
        result = solve_sticking(replace(chain, cover=replace(chain.cover, slack=slack)), restart)
        if np.abs(result.elastic - before).max(initial=0.0) < SETTLED:
            break
        before = result.elastic
    return result
