"""Which arms have a closed inverse: axes 2 and 3 parallel, wrist axes in one point; their reduced geometry."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from robots.errors import BadInput
from robots.pose import Array, invert, make_transform, rot_x, rot_y
from robots.robot import Robot

# A calibrated arm differs from its family by far less; beyond this the branches of the family say nothing
# about it.
LARGEST_ANGLE = np.radians(5.0)
LARGEST_LENGTH = 0.02  # m
EXACT = 1e-12


@dataclass(frozen=True, eq=False)
class ArmFamily:
    """Reduced geometry of an arm with closed inverse, symbols as in docs/robot.md; lengths m, angles rad.

    s1, s3, s4, s5 = sin alpha_i = +-1; link 3 is the vector (a3, -s3 d4), of length l3 and angle psi; lateral
    = d2 + d3. T_flange_link6: constant inverse of what follows the rotation of joint 6. exact: the robot
    itself is such an arm.
    """

    sign: Array
    offset: Array
    d1: float
    a1: float
    a2: float
    l3: float
    psi: float
    lateral: float
    s1: float
    s3: float
    s4: float
    s5: float
    T_flange_link6: Array
    exact: bool


def arm_family(robot: Robot) -> ArmFamily:
    """The family member nearest to a robot: twists rounded to right angles, wrist offsets and beta set to zero.

    Raises BadInput: the robot is not near such an arm (more than 5 deg or 20 mm away).
    """
    family = _family(*(np.asarray(a, float).tobytes() for a in (robot.mdh, robot.sign)))
    if family is None:
        raise BadInput(
            f"robot '{robot.name}' is not of the family with parallel axes 2 and 3 and a spherical wrist, so its postures "
            "have no closed list; use inverse_refined with a seed"
        )
    return family


@lru_cache(maxsize=32)
def _family(mdh_bytes: bytes, sign_bytes: bytes) -> ArmFamily | None:
    mdh, sign = np.frombuffer(mdh_bytes).reshape(6, 5), np.frombuffer(sign_bytes)
    _, d, a, alpha, beta = mdh.T
    quarter = np.round(alpha / (np.pi / 2))
    if not np.array_equal(quarter[:5] % 2, [1, 0, 1, 1, 1]) or quarter[1] % 4 != 0:
        return None
    bent = np.abs(np.concatenate([(alpha - quarter * np.pi / 2)[:5], beta[:5]])).max()
    apart = np.abs([a[3], a[4], d[4]]).max()
    if bent > LARGEST_ANGLE or apart > LARGEST_LENGTH:
        return None
    s = np.round(np.sin(quarter * np.pi / 2))
    last = make_transform(rot_x(alpha[5]) @ rot_y(beta[5]), np.array([a[5], 0.0, d[5]]))
    return ArmFamily(
        sign=sign,
        offset=mdh[:, 0],
        d1=float(d[0]),
        a1=float(a[0]),
        a2=float(a[1]),
        l3=float(np.hypot(a[2], d[3])),
        psi=float(np.arctan2(-s[2] * d[3], a[2])),
        lateral=float(d[1] + d[2]),
        s1=float(s[0]),
        s3=float(s[2]),
        s4=float(s[3]),
        s5=float(s[4]),
        T_flange_link6=invert(last),
        exact=bool(max(bent, apart) < EXACT),
    )
