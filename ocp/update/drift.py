"""How a cell drifts from one blade to the next: a linear process with noise, its forecast, and whether a log can be of it.

State: what the force model knows (wheel, blade, flange, arm, sensor) and the wear rate v of the wheel's radius R. Over dt on the
wheel's clock, and for a blade that is gripped anew,

    R <- R - max(v, 0) dt,   all else stays;     P <- F P F^T + dt Q + G                                                   (1)

The fit of a log then has the moved state as its prior, and v follows R by their correlation: a Kalman filter whose measurement
is the fit of `ocp.calibrate.force`. WALKS has the sources of Q and G.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtrc

from ocp.calibrate.force.assessment import DOES
from ocp.calibrate.force.fit import BIAS, BIAS_SD, FIT_NAMES, ForceSolution, force_prior, offset_columns, surprise
from ocp.calibrate.force.log import ForceLog
from ocp.model.cell import Cell
from ocp.model.theta import BLOCKS, believed_theta
from robots.calibration.store import Calibration
from robots.pose import Array

RADIUS, WEAR = "wheel_radius", "wheel_wear"
HOUR = 3600.0


@dataclass(frozen=True)
class Walk:
    """Parameters that move alike: one sigma per root of an hour of the wheel's clock, one sigma for every blade that is gripped,
    as a share of the value where `relative`; where the figures come from."""

    names: tuple[str, ...]
    hourly: float
    grip: float
    source: str
    relative: bool = False


CENTRE, AXIS = BLOCKS["wheel_centre"], BLOCKS["wheel_axis"]
SHIFT, TURN = BLOCKS["blade_shift"], BLOCKS["blade_rotation"]
WALKS: tuple[Walk, ...] = (
    Walk(CENTRE, 2.5e-5, 0.0, "PHYSICS 2.6: an arm moves 0.12 to 0.5 mm for 5 to 20 K; a hall drifts by some 1 K an hour"),
    Walk(AXIS, 2.5e-5, 0.0, "the same over a metre"),
    Walk(SHIFT, 0.0, 1e-5, "zero-point clamps repeat to 5 um (makers' data); twice that for blade root and chips"),
    Walk(TURN, 0.0, 1e-4, "the same over a root of 0.1 m"),
    Walk((RADIUS,), 1e-5, 0.0, "beside its rate: less than the slowest wear of the catalogue takes in ten minutes"),
    Walk((WEAR,), 5e-8, 0.0, "a tenth of the usual rates in an hour: belts wear fast when new, then slower"),
    Walk(("cover_stiffness_scale",), 0.01, 0.0, "wheel_temperature of the catalogue: 0.3 to 1 % a kelvin"),
    Walk(("flange_stiffness",), 0.002, 0.0, "seals and air spring: our judgement", relative=True),
    Walk(("flange_setpoint_offset",), 0.05, 0.0, "pressure control: a fifth of the 0.25 N that online control holds (PHYSICS 6)"),
    Walk(("sensor_bias",), 0.1, 0.0, "sensor_drift of the catalogue, at its usual least: 0.1 N an hour"),
)
# Wear at first, m/s: middle (of logarithms) and width of the catalogue's 2e-8 to 1e-6 (wheel_wear).
FIRST_WEAR, FIRST_WEAR_SD = 1.4e-7, 3e-7
NEW_BELT = 3e-4  # m, one sigma: belts of one grit differ by some tenths in thickness, and carry on or off the last one's loss
UNUSUAL = 0.02  # chance below which it is told: one log in fifty by itself
MEDIAN_LOSES = 0.5 * np.pi  # by how much more a median varies than a mean
SURPRISE = 1e-4  # chance below which a log is said not to come from the state that was handed in
PARTS = {
    "wheel": ("wheel_centre", "wheel_axis"),
    "blade": ("blade_shift", "blade_rotation"),
    "flange": ("flange_stiffness", "flange_setpoint_offset"),
    "belt": (),
    "sensor": (),
}
"""What the user may say was changed, and the blocks whose doubt starts again at the cell's own."""


def last_state(cell: Cell) -> Calibration:
    """Everything that the cell leaves open, with the joint covariance of its calibration; radius and wear of the wheel."""
    prior, known = force_prior(cell), cell.calibration
    told = () if known is None else known.names
    at = [i for i, n in enumerate(FIT_NAMES) if prior.covariance[i, i] > 0 or n in told or n == RADIUS]
    names = [FIT_NAMES[i] for i in at]
    rest = [n for n in told if n not in FIT_NAMES]
    names += [*rest, *(() if WEAR in rest else (WEAR,))]
    values, covariance = np.zeros(len(names)), np.zeros((len(names), len(names)))
    values[: len(at)], covariance[: len(at), : len(at)] = prior.mean[at], prior.covariance[np.ix_(at, at)]
    if WEAR not in told:
        # A cell whose effects hold wear has only the rest of it here.
        values[-1] = 0.0 if any(e.name == "wheel_wear" for e in cell.effects) else FIRST_WEAR
        covariance[-1, -1] = FIRST_WEAR_SD**2
    if known is not None:
        inside = [names.index(n) for n in known.names]
        values[inside] = known.values
        covariance[np.ix_(inside, inside)] = known.covariance
    base = known or Calibration(cell.robot.name, (), np.zeros(0), np.zeros((0, 0)))
    return replace(base, names=tuple(names), values=values, covariance=covariance)


def carried_on(state: Calibration, seconds: float, grips: int, stood: float = 0.0) -> Calibration:
    """The state after `seconds` of the wheel's running time, so many new grips and a time s in which all stood (eq. 1).

    A wheel does not grow: a rate that the logs put below zero is carried on as none.
    """
    at = {name: i for i, name in enumerate(state.names)}
    F = np.eye(len(at))
    F[at[RADIUS], at[WEAR]] = -seconds
    noise = np.zeros(len(at))
    for walk in WALKS:
        for i in (at[n] for n in walk.names if n in at):
            size = abs(state.values[i]) if walk.relative else 1.0
            noise[i] = size**2 * (walk.hourly**2 * (abs(seconds) + stood) / HOUR + walk.grip**2 * grips)
    covariance = F @ state.covariance @ F.T + np.diag(noise)
    values = state.values.copy()
    values[at[RADIUS]] -= seconds * max(values[at[WEAR]], 0.0)
    return replace(state, values=values, covariance=0.5 * (covariance + covariance.T))


def changed_state(state: Calibration, cell: Cell, parts: tuple[str, ...]) -> Calibration:
    """The state after the user changed some `parts` (of PARTS): their doubt is the cell's own again, beside what it was."""
    fresh = np.sqrt(np.diag(believed_theta(replace(cell, calibration=None)).covariance))
    own = dict(zip(FIT_NAMES[:BIAS], fresh, strict=True))
    more = {name: own[name] for part in parts for block in PARTS[part] for name in BLOCKS[block]}
    if "belt" in parts:
        more |= {RADIUS: NEW_BELT, WEAR: FIRST_WEAR_SD}
    if "sensor" in parts:
        more |= {"sensor_bias": BIAS_SD}
    extra = np.array([more.get(name, 0.0) for name in state.names])
    return replace(state, covariance=state.covariance + np.diag(extra**2))


@dataclass(frozen=True)
class Verdict:
    """Whether a log can have come from the prior: chi-square of the directions that it sees, their number, the chance of more;
    the parameters that would have moved, each by how many of its standard deviations, farthest first."""

    statistic: float
    directions: int
    chance: float
    moves: tuple[tuple[str, float], ...]

    @property
    def possible(self) -> bool:
        """Whether the log may be used."""
        return self.chance >= SURPRISE

    def sentence(self) -> str:
        """What moved, in words."""
        name, size = self.moves[0]
        return f"{name} would have moved by {abs(size):.1f} of its standard deviations ({name} {DOES.get(name, 'is the arm')})"


def verdict_on(solution: ForceSolution, log: ForceLog, run_offset: float) -> Verdict:
    """Of a fitted log: its gap to the prior's prediction against the prior and the noise.

    With whitened residuals e about the prior's mean, sensitivities A to its standard normal unknowns and B to the offsets of
    runs (`run_offset` N, one sigma, of what no model holds), V = 1 + B B^T, and `surprise` of z:

        K = A^T V^-1 A,   (1 + K) z = A^T V^-1 e                                                              (2)

    Or, where that is less likely and unusual, of what it reads in the air, which few rows tell: its median there against the zero
    as last known, twice as likely, as it is one of two.
    """
    root, channel = solution.prior.root, solution.channel
    runs = run_offset * offset_columns(log.run, log.contact)
    white = channel.whitened(log.fn - solution.before, np.hstack([solution.jacobian @ root, runs]))
    A, B = np.split(white.sensitivity, [root.shape[1]], axis=1)
    inner = np.linalg.inv(np.eye(B.shape[1]) + B.T @ B)
    K = A.T @ A - A.T @ B @ inner @ B.T @ A
    g = A.T @ white.residual - A.T @ B @ inner @ B.T @ white.residual
    z = np.asarray(np.linalg.solve(np.eye(len(K)) + K, g))
    step = root @ z
    sd = np.sqrt(np.diag(solution.prior.covariance))
    moves = {n: float(step[i] / sd[i]) for i, n in enumerate(FIT_NAMES) if sd[i] > 0}
    order = tuple(sorted(moves.items(), key=lambda one: -abs(one[1])))
    told, zero = Verdict(*surprise(K, z), order), moved_zero(solution, log)
    if zero is not None and (alone := 2.0 * float(chdtrc(1, zero**2))) < min(told.chance, UNUSUAL):
        return Verdict(zero**2, 1, alone, (("sensor_bias", zero), *(one for one in order if one[0] != "sensor_bias")))
    return told


def moved_zero(solution: ForceSolution, log: ForceLog) -> float | None:
    """By how many standard deviations a log's median in the air is off the sensor's zero before it; None of a log without."""
    air, known = ~log.contact, float(solution.prior.covariance[BIAS, BIAS])
    if not air.any():
        return None
    scatter = float(np.median(solution.channel.sigma()[air]) ** 2) * MEDIAN_LOSES / solution.channel.independent(contact=False)
    return float(np.median(log.fn[air]) - solution.prior.mean[BIAS]) / float(np.sqrt(known + scatter))


def mean_slope(solution: ForceSolution, log: ForceLog, name: str) -> float:
    """Derivative of the mean force in contact in a parameter, N per its unit."""
    return float(solution.jacobian[log.contact, FIT_NAMES.index(name)].mean())


def force_spread(solution: ForceSolution, log: ForceLog, state: Calibration) -> float:
    """One sigma N of the mean force of the rows in contact when the parameters are known as in `state`."""
    J: Array = solution.jacobian[log.contact, :BIAS].mean(axis=0)
    at = [FIT_NAMES.index(n) for n in state.names if n in FIT_NAMES[:BIAS]]
    inside = [i for i, n in enumerate(state.names) if n in FIT_NAMES[:BIAS]]
    variance = float(J[at] @ state.covariance[np.ix_(inside, inside)] @ J[at])
    return float(np.sqrt(max(variance, 0.0)))
