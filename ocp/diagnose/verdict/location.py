"""Where the gap lies: subsystem, joint and the conditions it depends on, with or without a name for the cause."""

import numpy as np

from ocp.diagnose.engine.findings import KernelTest, Location, Name
from ocp.diagnose.engine.problem import Problem
from ocp.diagnose.rules import PLACE_SURE, SHARE_PER_FEATURE
from ocp.diagnose.verdict.tests_without_library import orthonormal
from ocp.effects.effect import Effect
from robots.pose import Array

SUBSYSTEM = {"target x time": "target", "payload": "payload", "session": "tracker", "time": "tracker", "temperature": "tracker"}
READING = {
    "s": "blade", "line": "blade", "wheel_temperature": "wheel", "belt": "wheel", "run": "tool", "session": "tool",
    "setpoint": "flange", "travel": "timing", "feed": "timing", "turn": "wheel", "clock wave": "wheel", "time wave": "wheel",
    "s wave": "blade", "s wave x travel": "flange", "clock x s": "blade", "belt x time": "wheel", "setpoint x clock": "wheel",
    "setpoint x s": "blade", "travel x feed": "timing", "setpoint x belt": "wheel", "travel x s": "flange",
}  # fmt: skip


def of_effect(problem: Problem, effect: Effect, joint: int, signature: Array) -> Location:
    """Of a named effect with its signature (N,): the condition of its joint (or of none) that goes with it best."""
    best, chosen, signal = -np.inf, "", ""
    size = float(signature @ signature)
    for family in problem.pool.families:
        if (
            not family.where
            or " x q" in family.where
            or "ripple" in family.where
            or "wave" in family.where
            or (family.name.joint != joint and family.name.joint and joint)
        ):
            continue
        basis = orthonormal(family.columns[:, 0])
        share = float(np.sum((basis.T @ signature) ** 2)) / max(size, 1e-12) - SHARE_PER_FEATURE * basis.shape[1]
        if share > best:
            best, chosen, signal = share, family.where, family.name.effect[1:].split("/")[0]
    lengths = {c.name: float(signature[b] @ signature[b]) for c, b in zip(problem.channels, problem.stack.blocks, strict=True)}
    signal = max(lengths, key=lambda k: lengths[k])
    return Location(signal, effect.subsystem, joint, conditions(chosen))


def of_kernel(name: Name) -> Location:
    """Of a kernel that stands for an effect nobody catalogued."""
    signal, where, source = name.effect[1:].split("/")
    if source in ("joint", "axis"):
        subsystem = "joint"
    elif source in ("frame", "beam"):
        subsystem = SUBSYSTEM.get(where, "tracker")
    else:
        subsystem = READING.get(where, "sensor")
    return Location(signal, subsystem, name.joint, conditions(where))


def of_tests(tests: list[KernelTest], sure: float = PLACE_SURE) -> Location | None:
    """Of the most telling kernel, the number of kernels allowed for; None where none is sure."""
    if not tests or tests[0].p_value * len(tests) > sure:
        return None
    t = tests[0]
    return of_kernel(Name(f"?{t.channel}/{t.where}/{t.source}", t.joint))


def conditions(where: str) -> tuple[str, ...]:
    """What a kernel's name says it depends on: joints' angles q3, approaches approach5, loads tau2, temperature, time, ..."""
    found = (f"q{p.removeprefix('ripple')}" if p.startswith("ripple") else p for p in where.split(" x ") if p)
    found = (p.removesuffix(" wave") for p in found)
    return tuple(p.rstrip("123456") if p[:4] in ("temp", "time", "payl") else p for p in found)
