"""The protocol that a robot language keeps: all that the planner asks of it."""

from collections.abc import Iterable
from pathlib import Path
from typing import Protocol

from robots.robot import Robot
from trajectories.program.execution import Execution
from trajectories.program.program import FileLimits, Program


class Dialect(Protocol):
    """One language. `read` and `check` must not share code with `write`: they are the witness of what was written."""

    @property
    def name(self) -> str:
        """How cell.toml names it (`controller.dialect`)."""

    @property
    def title(self) -> str:
        """How sentences name it."""

    @property
    def limits(self) -> FileLimits:
        """What its files hold and how finely they are printed."""

    def program_names(
        self, text: str, passes: int, parts: Iterable[int] = (), taken: Iterable[str] = ()
    ) -> tuple[str, list[list[str]]]:
        """Legal names made from any text: the main program's and, pass by pass, those of its sub-programs.

        `parts` (passes,) is into how many files each pass is split (default 1); `taken` are names already in use.
        """

    def write(self, program: Program, folder: Path) -> list[Path]:
        """Write the files of a program, the main program's first. Raises BadInput: a program that must not be written."""

    def read(self, source: Path) -> Execution:
        """What an existing program does, by whomever it was written; what does not move the robot is passed over.

        Raises BadInput, naming file and line, where the text does not say which way the robot goes.
        """

    def check(self, source: Path, robot: Robot, absolute_accuracy: bool = False, pauses: bool = False) -> Execution:
        """What a program written by this house does, after every refusal that the language and the machine ask for.

        `absolute_accuracy`: the controller corrects poses by itself, so a program of poses is refused; `pauses`: the
        program may stand still (measuring). Raises BadInput, naming file and line.
        """
