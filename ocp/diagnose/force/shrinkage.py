"""How far the gap of a force log shrinks: what the named effects change in grinding that comes after it.

Beside them stands what remains in any case, the errors of the unknowns and what recordings differ by (docs/diagnose.md, eq. 2).
"""

import numpy as np

from ocp.diagnose.engine.findings import Alternative
from ocp.diagnose.engine.system import Channel
from ocp.diagnose.force.anticipated import Grinding, anticipated_grinding
from ocp.diagnose.force.believed import RUN_SD
from ocp.diagnose.force.channel import ForceChannel
from ocp.diagnose.rules import NO_GAP
from ocp.diagnose.verdict.shrinkage import DRAWS, Shrinkage, drawn_errors, interval

# Dirichlet weight of a recording in new readings: which of a log's lines, setpoints and feeds come again (Jeffreys).
RECORDING = 0.5


def of_grinding(before: Channel, after: Channel, alternatives: tuple[Alternative, ...]) -> Shrinkage | None:
    """Of a force channel before and with the named effects; alternatives: what else may be true. None: no gap to speak of."""
    assert isinstance(before, ForceChannel) and isinstance(after, ForceChannel)
    return from_grinding(anticipated_grinding(before, after, alternatives), after.noise_floor**2)


def from_grinding(new: Grinding, noise: float, seed: int = 0) -> Shrinkage | None:
    """Of force readings: what is anticipated; noise: mean square N^2. Drawn are which alternative is true, how late the readings
    come, of which recordings they are, the unknowns' errors and what recordings differ by. None: no gap to speak of."""
    rng = np.random.default_rng(seed)
    errors = drawn_errors(new.covariance, rng)
    true = rng.choice(len(new.probability), DRAWS, p=new.probability)
    when = rng.choice(len(new.share), DRAWS, p=new.share)
    runs = int(new.run.max()) + 1
    rows = rng.dirichlet(np.full(runs, RECORDING), DRAWS)[:, new.run] / np.bincount(new.run)[new.run]
    own = RUN_SD * rng.normal(size=(DRAWS, runs))[:, new.run]
    before, after = np.zeros(DRAWS), np.zeros(DRAWS)
    for k, moved in enumerate(new.moved):
        at = when == k
        off, planted = errors[at] @ new.errors[k].T + own[at], moved[true[at]]
        after[at] = np.sum(rows[at] * (new.told @ moved - planted + off) ** 2, axis=1)
        before[at] = np.sum(rows[at] * (off - planted) ** 2, axis=1)
    if np.median(before) <= NO_GAP**2 * noise:
        return None
    return interval(1.0 - np.sqrt(after / before))
