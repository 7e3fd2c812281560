"""What the reader makes of KRL text: typed statements with line numbers."""

from dataclasses import dataclass
from pathlib import Path

MOTIONS = ("PTP", "LIN", "SPTP", "SLIN", "SPL")
BLOCKS = ("PTP_SPLINE", "SPLINE")


@dataclass(frozen=True)
class Number:
    """A literal with the text as it stands in the file."""

    value: float
    text: str


@dataclass(frozen=True)
class Word:
    """A name, an enumeration (#TCP), a string, a truth value or an expression, kept as text."""

    text: str


@dataclass(frozen=True)
class Aggregate:
    """{NAME value, ..}; names in capitals, in order."""

    items: tuple[tuple[str, "Value"], ...]

    def get(self, name: str) -> "Value | None":
        """The value of a component, or None."""
        return dict(self.items).get(name)


Value = Number | Word | Aggregate


@dataclass(frozen=True)
class Statement:
    """Any statement; `line` counts from 1."""

    line: int


@dataclass(frozen=True)
class Header(Statement):
    """A line that begins with &."""

    text: str


@dataclass(frozen=True)
class Remark(Statement):
    """A comment or fold."""

    text: str


@dataclass(frozen=True)
class Definition(Statement):
    """DEF or DEFDAT with the program's name."""

    kind: str
    name: str


@dataclass(frozen=True)
class Ending(Statement):
    """END or ENDDAT."""

    kind: str


@dataclass(frozen=True)
class Declaration(Statement):
    """DECL TYPE NAME[=value], EXT and the like (`type` EXT)."""

    type: str
    name: str
    value: Value | None


@dataclass(frozen=True)
class Assignment(Statement):
    """target = value; the target in capitals with its index, as $VEL_AXIS[1]."""

    target: str
    value: Value


@dataclass(frozen=True)
class Call(Statement):
    """NAME(arguments)."""

    name: str
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Motion(Statement):
    """PTP, LIN, SPTP, SLIN or SPL to a literal position or to a named one; `approximation` as C_VEL or empty."""

    kind: str
    target: Value
    approximation: str


@dataclass(frozen=True)
class BlockStart(Statement):
    """PTP_SPLINE or SPLINE."""

    kind: str


@dataclass(frozen=True)
class BlockEnd(Statement):
    """ENDSPLINE."""


@dataclass(frozen=True)
class TimeBlock(Statement):
    """TIME_BLOCK START, PART or END with its seconds."""

    what: str
    value: Number | None


@dataclass(frozen=True)
class Interrupt(Statement):
    """The interrupt statements of the INI fold."""

    text: str


@dataclass(frozen=True)
class Pause(Statement):
    """HALT, WAIT SEC seconds or WAIT FOR $IN[input]: the robot stands still."""

    seconds: Number | None = None
    input: Number | None = None


@dataclass(frozen=True)
class Other(Statement):
    """A statement without motion that only an old program may hold (waits, outputs, triggers)."""

    text: str


@dataclass(frozen=True)
class Module:
    """One file: its path, its statements in order."""

    path: Path
    statements: tuple[Statement, ...]

    @property
    def name(self) -> str:
        """The name behind DEF or DEFDAT."""
        return next(s.name for s in self.statements if isinstance(s, Definition))

    def declared(self) -> dict[str, Declaration]:
        """Declarations by name in capitals."""
        return {s.name.upper(): s for s in self.statements if isinstance(s, Declaration)}
