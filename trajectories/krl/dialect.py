"""KRL behind the protocol of trajectories.program.dialect."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from robots.robot import Robot
from trajectories.krl.checks import check_program
from trajectories.krl.interpreter import execute
from trajectories.krl.names import program_names
from trajectories.krl.values import FILE_LIMITS
from trajectories.krl.writer import program_files
from trajectories.program.execution import Execution
from trajectories.program.program import FileLimits, Program


@dataclass(frozen=True)
class KrlDialect:
    """KRL of KSS 5 to 8; the methods are described in `Dialect`."""

    name: str = "krl"
    title: str = "KRL"
    limits: FileLimits = FILE_LIMITS

    def program_names(
        self, text: str, passes: int, parts: Iterable[int] = (), taken: Iterable[str] = ()
    ) -> tuple[str, list[list[str]]]:
        """Names of at most 24 characters, no word of the language."""
        return program_names(text, passes, parts, taken)

    def write(self, program: Program, folder: Path) -> list[Path]:
        """A .src and a .dat for the main program and every sub-program."""
        files = program_files(program)
        for name, data in files.items():
            (folder / name).write_bytes(data)
        return [folder / name for name in files]

    def read(self, source: Path) -> Execution:
        """A .src with the sub-programs of its folder, inline forms included."""
        return execute(source, strict=False)

    def check(self, source: Path, robot: Robot, absolute_accuracy: bool = False, pauses: bool = False) -> Execution:
        """Every .src and .dat of the folder of `source`."""
        return check_program(source, robot, absolute_accuracy, pauses)


KRL = KrlDialect()
