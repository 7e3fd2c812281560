"""What a written plan promises, in two statements with a grade each: that it is safe to move, and that it holds its force.

A plan that is not safe to move is never written, so `move` is green, or amber where something of it lies with the controller.
"""

from dataclasses import dataclass

import numpy as np

from ocp.model.cell import Cell, ForceFlange
from ocp.model.theta import BLOCKS
from ocp.plan.passes.optimise import force_tolerance
from ocp.plan.readback import BlendError, Readback
from ocp.plan.rules import FORCE_SHARE, LEAST_STRETCH, STOP_PRELOAD, UNCERTAIN_FORCE
from robots.gravity import GRAVITY

GREEN, AMBER, RED = "green", "amber", "red"
NOT_TO_GRIND = "Safe to move, not to grind."
CALIBRATED = "calibrate: ocp.poses and tracker readings for the arm, a force log of these passes for wheel and blade"


@dataclass(frozen=True)
class Grade:
    """green, amber or red, and why in words."""

    grade: str
    why: str


@dataclass(frozen=True)
class Grades:
    """Whether the program is safe to move, and whether it holds the force asked for; `asked`: that force in words."""

    move: Grade
    force: Grade
    asked: str

    def document(self) -> dict[str, dict[str, str]]:
        """As plan.json has them."""
        return {name: {"grade": one.grade, "why": one.why} for name, one in (("move", self.move), ("force", self.force))}

    def sentences(self) -> str:
        """The verdict: two sentences."""
        holds = {GREEN: "It holds", AMBER: "It may miss", RED: "It is not known to hold"}[self.force.grade]
        moves = f"It is safe to move ({self.move.grade}): {self.move.why}."
        return f"{moves} {holds} {self.asked} ({self.force.grade}): {self.force.why}."

    @property
    def headline(self) -> str:
        """The verdict in a few words."""
        if self.force.grade == RED:
            return NOT_TO_GRIND
        return "Safe to use." if {self.move.grade, self.force.grade} == {GREEN} else "Safe to use, with care."

    @property
    def status(self) -> str:
        """The verdict in a word for programs."""
        return "safe_to_move" if self.force.grade == RED else "safe"


def grade_move(readback: Readback) -> Grade:
    """What reading back, limits and clearances say of the motion; whatever of it is not sound was refused."""
    kept = "arm, holder, blade and wheel keep their margins along the whole of it"
    if np.isfinite(readback.limit_ratio):
        return Grade(
            GREEN,
            f"the text read back is the planned motion within {np.degrees(readback.axis_error):.1g} deg and uses at most "
            f"{100 * readback.limit_ratio:.0f} % of an axis' speed and acceleration; {kept}",
        )
    return Grade(
        AMBER,
        f"the text read back is the planned way within {np.degrees(readback.axis_error):.1g} deg; {kept}; speeds between its "
        "points are the controller's own and were not checked, use --kind axis or run it at reduced speed first",
    )


def grade_force(
    cell: Cell, asked: float, sd: float, off: float, blends: BlendError | None = None, stopped: float = np.inf
) -> Grade:
    """How far the force on the real cell may be from `asked` N: its standard deviation N, and by how much the program read
    back is off by the independent route, N; `blends`: of a program of straight motions, what blending them costs; `stopped`: the
    force N up to which the flange stands at its stop at the postures of the passes, where a weight that is not compensated hangs
    as it does there."""
    doubts = []
    most = force_tolerance(cell)
    if blends is not None and (blends.force > most or blends.dose > FORCE_SHARE):
        doubts.append(
            f"straight motions that blend are off by up to {blends.force:.2g} N on the ramps of a pass and by up to "
            f"{100 * blends.dose:.2g} % in force over feed along {LEAST_STRETCH * 1e3:g} mm of a line (at most {most:g} N and "
            f"{100 * FORCE_SHARE:g} %), as read back: lower the feed, or use --kind cartesian or axis"
        )
    spread = f"one standard deviation on the real cell is up to {sd:.2g} N"
    found = f"read back it is within {off:.2g} N by the independent route, {spread}"
    if sd > FORCE_SHARE * asked:
        doubts.append(_to_measure(cell))
    if off > FORCE_SHARE * asked:
        doubts.append("the two routes differ, look at the force section for where")
    preload = 0.0 if cell.flange is None else min(stop_preload(cell.flange), stopped)
    if preload > STOP_PRELOAD:
        doubts.append(
            f"the flange bears on its stop until {preload:.1f} N, so wheel and blade meet as hard as without it and up to that "
            "force is not held at touch; soften its setpoint, which the program does not change"
        )
    if UNCERTAIN_FORCE * sd > asked:
        return Grade(RED, f"{found}: calibrate the cell before the blade touches the wheel; {'; '.join(doubts)}")
    return Grade(AMBER if doubts else GREEN, "; ".join([found, *doubts]))


def _to_measure(cell: Cell) -> str:
    """What would tell the force better."""
    if cell.calibration is None:
        return CALIBRATED
    if set(BLOCKS["wheel_centre"]) & set(cell.calibration.names):
        return "the cell has drifted or was little measured: a force log of these passes (ocp.update)"
    return "wheel and blade are not registered: a force log of these passes for ocp.calibrate"


def stop_preload(flange: ForceFlange) -> float:
    """Force N below which the flange stays at its stop, P0 = max(0, F_set + w - k stroke/2); PHYSICS 6. w: at most the carried
    weight where that is not compensated."""
    weight = 0.0 if flange.gravity_compensated else flange.carried_mass * GRAVITY
    return max(0.0, flange.setpoint + weight - 0.5 * flange.stiffness * flange.stroke)


SHARED = {
    "shared with the planner": (
        "the wheel cover's stiffness and the solver of its contact, the blade's compliance, the blade's surface, the formulas of "
        "named effects"
    ),
    "its own": (
        "the program's text and its interpolation, the arm's kinematics and its Jacobian, gravity torques, bending, the balance "
        "of the force, places and number of the contacts solved"
    ),
    "the witness": (
        "python -m ocp.simulate: a virtual cell with code of its own for cover, surface, blade, arm and controller; what is "
        "wrong in what is shared shows there"
    ),
}
"""What the verification by the independent route has in common with the plan it verifies, and what not."""
