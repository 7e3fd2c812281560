"""What a force fit is worth: its error on blocks left out, and what the log cannot tell, in words.

Blocks are whole runs, lines, sessions, setpoints and belt directions. They are left out in the linearised problem about the
estimate, which is exact Gaussian updating (docs/force_registration.md, eq. 12).
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.sparse.csgraph import connected_components

from ocp.calibrate.force.fit import BIAS, FIT_NAMES, ForceSolution
from ocp.calibrate.force.log import Flags, ForceLog, Index
from ocp.calibrate.force.model import ForceRows
from ocp.calibrate.force.noise import GROSS
from robots.pose import Array


@dataclass(frozen=True)
class HeldOutForce:
    """Rows in contact that were predicted without them: how many, rms and mean of measured minus predicted N, gap N (rms
    without the noise)."""

    rows: int
    rms: float
    mean: float
    gap: float


def blocks_of(log: ForceLog, rows: ForceRows) -> dict[str, Index]:
    """Every way to cut the log that leaves at least two blocks in contact: block (n,) of each row, -1 for none."""
    values = {"line": log.line, "setpoint": np.round(rows.setpoint, 1), "belt direction": rows.belt}
    ways = {"run": log.run, "session": log.session}
    ways |= {by: np.where(log.contact, np.unique(v, return_inverse=True)[1], -1) for by, v in values.items() if v is not None}
    return {by: block for by, block in ways.items() if len(np.unique(block[log.contact])) > 1}


def held_out_blocks(solution: ForceSolution, log: ForceLog, rows: ForceRows) -> dict[str, list[HeldOutForce]]:
    """Errors of each block of each way to cut the log, predicted from the other blocks."""
    return {
        by: [_fold(solution, log, block == b) for b in np.unique(block[log.contact])]
        for by, block in blocks_of(log, rows).items()
    }


def pooled_blocks(folds: list[HeldOutForce]) -> HeldOutForce:
    """All folds of one way to cut the log as one figure; the mean is that of the folds' sizes |mean|."""
    n = np.array([fold.rows for fold in folds], float)

    def together(name: str) -> float:
        return float(np.sqrt(np.sum(n * np.array([getattr(fold, name) for fold in folds]) ** 2) / n.sum()))

    return HeldOutForce(int(n.sum()), *(together(name) for name in ("rms", "mean", "gap")))


def without_rows(information: Array, sensitivity: Array, residual: Array) -> tuple[Array, Array]:
    """By how much unknowns (k,) move when rows are left out, and their covariance (k, k) then (eq. 12).

    information (k, k): of the rows that stay, the prior's in; whitened sensitivity (m, k) and residual (m,) of those left out.
    At the estimate the whole gradient is zero: what these rows pulled is what their absence lets go.
    """
    return np.asarray(-np.linalg.solve(information, sensitivity.T @ residual)), np.asarray(np.linalg.inv(information), float)


def _fold(solution: ForceSolution, log: ForceLog, left: Flags) -> HeldOutForce:
    """The block's readings from the other rows: a downdate of the information, a step of the unknowns."""
    white, channel = solution.whitened, solution.channel
    A, taken = white.sensitivity[left], np.zeros_like(solution.information)
    for kind in channel.kinds.values():
        at = kind.rows[left[kind.rows]]
        taken += kind.noise.information() * white.sensitivity[at].T @ white.sensitivity[at]
    change, _ = without_rows(solution.information - taken, A, white.residual[left])
    at = np.flatnonzero(left & log.contact)
    root = solution.jacobian[at] @ solution.prior.root
    error = log.fn[at] - solution.reading[at] - root @ change[: root.shape[1]]
    rms = float(np.sqrt(np.mean(error**2)))
    usual = error[channel.weight[at] > GROSS]
    more = float(np.mean(usual**2) - np.mean(channel.sigma()[at] ** 2)) if len(usual) else 0.0
    return HeldOutForce(len(at), rms, float(error.mean()), float(np.sqrt(max(more, 0.0))))


UNSEEN = 0.9  # of the prior's standard deviation: a parameter left with more was not seen
ALIKE = 0.98  # cosine between two effects on the whole log, from which they are one to it
TIED = 0.95  # correlation of two estimates from which only one combination of them is known
VISIBLE = 3.0  # whitened length of one prior standard deviation's effect, from which the log would see it

# What a parameter does, for sentences.
DOES = {
    **{f"wheel_{a}": f"moves the wheel along {a} of the base" for a in "xyz"},
    "wheel_radius": "changes the wheel's radius",
    "wheel_axis_u": "turns the wheel's axis",
    "wheel_axis_v": "turns the wheel's axis",
    **{f"blade_{a}": f"moves the blade along {a} of the flange" for a in "xyz"},
    **{f"blade_{r}": f"turns the blade about {a} of the flange" for r, a in zip("cba", "xyz", strict=True)},
    "cover_stiffness_scale": "changes how far the cover gives way",
    "blade_stiffness_scale": "changes how far the blade gives way",
    "flange_stiffness": "changes the flange's force over its stroke",
    "flange_setpoint_offset": "adds a constant to the flange's force",
    "sensor_bias": "adds a constant to the reading",
}


def not_identified(solution: ForceSolution) -> dict[str, str]:
    """One name, or several with spaces between, to the reason; arm and payload are the tracker's and not listed."""
    prior_sd = np.sqrt(np.diag(solution.prior.covariance))
    sd = np.sqrt(np.maximum(np.diag(solution.covariance), 0.0))
    index = [i for i, name in enumerate(FIT_NAMES) if name in DOES and prior_sd[i] > 0]
    columns = solution.jacobian[:, index] * prior_sd[index]
    effect = solution.channel.whitened(np.zeros(len(columns)), columns).sensitivity  # of one prior standard deviation each
    size = np.linalg.norm(effect, axis=0)
    alike = effect.T @ effect / np.maximum(np.outer(size, size), 1e-12)
    out: dict[str, str] = {}
    for k, i in enumerate(index):
        if sd[i] >= UNSEEN * prior_sd[i]:
            out[FIT_NAMES[i]] = _why_unseen(solution, index, k, size, alike, sd[i] / prior_sd[i], prior_sd)
    apart = np.minimum.outer(size, size) * np.sqrt(np.maximum(1.0 - alike**2, 0.0))
    one = (apart < VISIBLE) & (np.minimum.outer(size, size) > VISIBLE) & (np.abs(alike) > ALIKE)
    count, label = connected_components(one, directed=False)
    for group in (np.flatnonzero(label == g).tolist() for g in range(count)):
        if len(group) > 1:
            out[" ".join(FIT_NAMES[index[k]] for k in group)] = _why_alike(group, index, alike)
    for (a, i), (b, j) in combinations(enumerate(index), 2):
        tie = solution.covariance[i, j] / (sd[i] * sd[j])
        if not one[a, b] and abs(tie) > TIED:
            first, second = FIT_NAMES[i], FIT_NAMES[j]
            out[f"{first} {second}"] = (
                f"only their {'difference' if tie > 0 else 'sum'} is seen (correlation {tie:.3f}): {first} {DOES[first]}, "
                f"{second} {DOES[second]}"
            )
    return out


def directions_seen(solution: ForceSolution) -> tuple[int, Array]:
    """How many directions of the parameters the log narrowed to less than half, and by how much each (r,), best first: the
    prior's standard deviation over the one left."""
    r = solution.prior.root.shape[1]
    left = np.linalg.inv(solution.information)[:r, :r]
    gain = 1.0 / np.sqrt(np.linalg.eigvalsh(0.5 * (left + left.T)))
    return int((gain > 2.0).sum()), np.sort(gain)[::-1]


def _why_unseen(
    solution: ForceSolution, index: list[int], k: int, size: Array, alike: Array, share: float, prior_sd: Array
) -> str:
    name = FIT_NAMES[index[k]]
    source = "sensor" if index[k] == BIAS else "cell"
    contact = solution.channel.kinds[True].rows
    newton = float(np.sqrt(np.mean((solution.jacobian[contact, index[k]] * prior_sd[index[k]]) ** 2)))
    left = f"not seen by this log: {share:.0%} of the {source}'s standard deviation is left"
    if size[k] <= VISIBLE:
        return f"{left}; {name} {DOES[name]}, and one standard deviation moves the force by {newton:.2g} N"
    others = [j for j in range(len(index)) if j != k and size[j] > VISIBLE]
    others = sorted(others, key=lambda j: -abs(alike[k, j]))[:3]
    like = ", ".join(f"{FIT_NAMES[index[j]]} ({abs(alike[k, j]):.0%})" for j in others)
    return f"{left}; it moves the force by {newton:.2g} N, but others imitate it, nearest {like or 'the arm'}; it {DOES[name]}"


def _why_alike(group: list[int], index: list[int], alike: Array) -> str:
    names = [FIT_NAMES[index[k]] for k in group]
    worst = min(abs(alike[a, b]) for a in group for b in group)
    does = "; ".join(f"{name} {DOES[name]}" for name in names)
    first = f"{names[0]} cannot be told from {' and '.join(names[1:])}"
    return f"{first}: along this log they change the force alike (to {worst:.1%}), only one combination is seen; {does}"
