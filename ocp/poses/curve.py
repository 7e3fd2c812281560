"""What accuracy follows from how many poses, and where more of them buy little."""

from dataclasses import dataclass

import numpy as np

from ocp.poses.design import Design
from robots.calibration.observability import identifiable_basis
from robots.calibration.pose_choice import choose
from robots.errors import BadInput
from robots.pose import Array
from robots.tracker_readings import Index

COUNTS = (10, 12, 14, 16, 18, 20, 25, 30, 35, 40, 50, 60, 80, 100)
MORE, LITTLE = 10, 0.05  # so many more poses that improve the accuracy by less than this part buy little
PASSES = 2  # of exchanges for a point of the curve


@dataclass(frozen=True)
class Curve:
    """Poses n (k,) and one sigma (k,) m of the blade's place in the zone: of the calibration alone, and with what the robot
    scatters by itself; `enough`: the least n from which ten more improve the latter by less than 5 %, None if beyond the curve;
    `chosen` the calibration's at the number asked for."""

    count: Array
    calibration: Array
    total: Array
    enough: int | None
    chosen: float
    chosen_total: float


def least_poses(design: Design) -> int:
    """Fewest poses whose coordinates are as many as the directions that readings can tell apart."""
    rank = identifiable_basis(design.pool.rows, design.pool.prior, 1000).shape[1]
    return -(-rank // 3)


def refuse_too_few(design: Design, count: int) -> None:
    """Raises BadInput where `count` poses cannot fix what a calibration looks for."""
    least = least_poses(design)
    if count < least:
        raise BadInput(
            f"-n {count}: {count} poses give {3 * count} coordinates, and robot, springs, nests and tracker have at least "
            f"{3 * least - 2} combinations to be told apart; choose at least {least} poses"
        )


def error_curve(design: Design, count: int, criterion: str, chosen: Index) -> Curve:
    """The curve from the fewest poses to well beyond `count`; its point at `count` is the choice itself."""
    postures = len(np.unique(design.posture))
    counts = [n for n in COUNTS if least_poses(design) <= n <= min(max(2 * count, 40), postures)]
    error = {n: design.error(choose(design.pool, n, criterion, PASSES)) for n in counts if n != count}
    error[count] = design.error(chosen)
    n = np.array(sorted(error))
    calibration = np.array([error[k] for k in n.tolist()])
    total = np.hypot(calibration, design.repeatability)
    at = float(error[count])
    return Curve(n, calibration, total, enough(n, total), at, float(np.hypot(at, design.repeatability)))


def enough(count: Array, total: Array) -> int | None:
    """Least whole n of a curve from which `MORE` poses improve `total` by less than `LITTLE`; between points log-log."""
    for n in range(int(count[0]), int(count[-1]) - MORE + 1):
        now, later = np.exp(np.interp(np.log([n, n + MORE]), np.log(count), np.log(total)))
        if later > (1 - LITTLE) * now:
            return n
    return None
