"""Speeds of the robot functions; prints one line each. `python benchmarks/robot.py` from the repository root."""

import dataclasses
import time
from collections.abc import Callable

import numpy as np

from robots.compliance import deflect
from robots.gravity import weight_torques
from robots.inverse import inverse_branches
from robots.kinematics import forward, jacobian, link_frames
from robots.reference_kinematics import elementary_forward
from robots.rigid_body import inverse_dynamics
from robots.robot import load_robot

POSTURES = 20_000


def best_of_three(work: Callable[[], object]) -> float:
    seconds = []
    for _ in range(3):
        start = time.perf_counter()
        work()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def main() -> None:
    robot = load_robot("kr210_r2700_extra")
    rng = np.random.default_rng(0)
    q = rng.uniform(robot.q_min, robot.q_max, (POSTURES, 6))
    few = q[:2000]
    T = forward(robot, q)
    own = dataclasses.replace(robot, mdh=robot.mdh + rng.normal(0.0, 1e-3, (6, 5)))
    T_own = forward(own, few)
    compliance, com = 1 / robot.stiffness, np.array([0.0, 0.0, 0.2])
    table: list[tuple[str, Callable[[], object], int]] = [
        ("forward", lambda: forward(robot, q), len(q)),
        ("link_frames", lambda: link_frames(robot, q), len(q)),
        ("jacobian", lambda: jacobian(robot, q), len(q)),
        ("weight_torques", lambda: weight_torques(robot, q), len(q)),
        ("deflect", lambda: deflect(robot, q, compliance, 90.0, com), len(q)),
        ("elementary_forward", lambda: elementary_forward(robot, q), len(q)),
        ("inverse_branches", lambda: inverse_branches(robot, T), len(q)),
        ("inverse_branches, own", lambda: inverse_branches(own, T_own), len(few)),
        ("inverse_dynamics", lambda: inverse_dynamics(robot, 90.0, com, few, few, few), len(few)),
        ("forward, singly", lambda: [forward(robot, row) for row in q[:1000]], 1000),
    ]
    for name, work, count in table:
        print(f"{name:24s} {count / best_of_three(work):10.0f} /s")
    for mass in (0.0, 150.0):
        converged = forward(robot, deflect(robot, q, compliance, mass, com, steps=30))[:, :3, 3]
        for steps in (0, 1, 2):
            bent = forward(robot, deflect(robot, q, compliance, mass, com, steps=steps))[:, :3, 3]
            left = np.linalg.norm(bent - converged, axis=1).max()
            print(f"sag at {mass:3.0f} kg: {steps} fixed-point steps leave {left * 1e6:.3f} um at the flange")


if __name__ == "__main__":
    main()
