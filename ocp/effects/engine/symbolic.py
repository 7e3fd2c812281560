"""A cell's effects inside the one symbolic model: shifts of joints, twists of links, overlap at the contact.

    q_real = q + dq + c (tau(q_real) + dtau),   frames after the twists,   delta + overlap + push / stiffness = parts     (1)

dq, dtau, overlap .. are the hooks at the believed posture times the coefficients, dq under the load torques with dtau in them;
docs/effects.md.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from ocp.effects.cell_effects import CellEffect
from ocp.effects.context import ArmContext, ContactContext
from ocp.effects.engine.compiled import RowLayout
from ocp.effects.engine.evaluate import arm_context
from robots.robot import Robot

# What effects see of an instant beside the model's own symbols.
CONDITIONS = RowLayout.of(
    "approach 6, s 1, feed 1, line 1, ground_before 1, time 1, clock 1, warm 1, wheel_warm 1, travel 1, "
    "setpoint 1, belt 1, speed 6"
)


@dataclass(frozen=True)
class ArmChange:
    """dq (6) rad of the commanded joints, dtau (6) N m, twists {link: (6)} m and rad of `ocp.effects.effect`."""

    dq: ca.SX
    dtau: ca.SX
    twists: dict[int, ca.SX]

    def moved(self, frames: Sequence[ca.SX]) -> list[ca.SX]:
        """Link frames (4, 4) after the twists, each of its link and of all that follows."""
        out = list(frames)
        for link in sorted(self.twists):
            v, w = self.twists[link][:3], self.twists[link][3:]
            at, turn = out[link][:3, 3], ca.SX.eye(3) + ca.skew(w)
            for i in range(link, len(out)):
                R, p = turn @ out[i][:3, :3], at + v + turn @ (out[i][:3, 3] - at)
                out[i] = ca.vertcat(ca.horzcat(R, p), ca.DM([[0, 0, 0, 1]]))
        return out


@dataclass(frozen=True)
class ModelEffects:
    """The effects of a cell with coefficients `a`, numbers or symbols one after the other, and the symbols `conditions` (in the
    order of CONDITIONS) of an instant; without effects both are empty."""

    effects: tuple[CellEffect, ...]
    a: ca.SX
    conditions: ca.SX

    @staticmethod
    def of(effects: tuple[CellEffect, ...], uncertain: bool) -> "ModelEffects":
        """`uncertain`: the coefficients are symbols, to be differentiated in."""
        whole = np.concatenate([e.a for e in effects]) if effects else np.empty(0)
        a = ca.SX.sym("effects", len(whole)) if uncertain else ca.SX(whole)
        return ModelEffects(effects, a, ca.SX.sym("conditions", CONDITIONS.size if effects else 0))

    @property
    def on_contact(self) -> bool:
        """Whether any of them acts at the contact."""
        return any(e.active.effect.overlap is not None or e.active.effect.push is not None for e in self.effects)

    def _values(self, hooks: tuple[str, ...], context: Any) -> Iterator[tuple[str, Any]]:
        """Name and value times coefficients of every one of the hooks that an effect has."""
        start = 0
        for e in self.effects:
            a, effect = self.a[start : start + len(e.a)], e.active.effect
            start += len(e.a)
            for name in hooks:
                hook = getattr(effect, name)
                if hook is not None:
                    value = hook(context, e.joint, e.scanned)
                    yield name, {k: v @ a for k, v in value.items()} if isinstance(value, dict) else value @ a

    def arm(self, context: ArmContext) -> ArmChange:
        """What the effects do to the arm, seen at its believed posture."""
        dtau = sum((value for _, value in self._values(("torque",), context)), ca.SX.zeros(6))
        loaded = replace(context, tau=context.tau + dtau)
        dq = sum((value for _, value in self._values(("joint",), loaded)), ca.SX.zeros(6))
        twists: dict[int, ca.SX] = {}
        for _, value in self._values(("twist",), loaded):
            for link, motion in value.items():
                twists[link] = twists.get(link, ca.SX.zeros(6)) + motion
        return ArmChange(dq, dtau, twists)

    def overlap(self, context: ContactContext, rigid: bool) -> ca.SX:
        """Overlap m that the effects add; a push counts as the stroke of the flange that it takes, in a rigid cell as the
        overlap that brings as much force."""
        give = ca.sum1(context.slopes) if rigid else context.slopes[0]
        found = self._values(("overlap", "push"), context)
        return sum((value * give if name == "push" else value for name, value in found), ca.SX(0))


def planned_arm_context(
    robot: Robot, payload_name: str, frames: list[ca.SX], conditions: dict[str, ca.SX], **state: ca.SX
) -> ArmContext:
    """What arm effects see in the model: `state` are q, q_real, tau, c, payload; frames of the believed posture."""
    state |= {name: conditions[name] for name in ("approach", "warm", "time", "speed")}
    state |= {"hung": ca.SX(0), "settling": ca.SX.zeros(3)}
    r, names = robot, (payload_name,)
    return arm_context(frames, r.sign, r.link_mass, r.link_com, r.gear_ratio, r.gravity_direction, names, **state)
