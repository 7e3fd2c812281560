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
class TextStatement(Statement):
    """A statement that is kept as its text."""

    text: str


class Header(TextStatement):
    """A line that begins with &."""


class Remark(TextStatement):
    """A comment or fold."""


class Interrupt(TextStatement):
    """The interrupt statements of the INI fold."""


class Other(TextStatement):
    """A statement without motion that only an old program may hold (waits, outputs, triggers)."""


@dataclass(frozen=True)
class KeywordStatement(Statement):
    """A statement that is one keyword, its `kind`."""

    kind: str


class Ending(KeywordStatement):
    """END or ENDDAT."""


@dataclass(frozen=True)
class BlockStart(KeywordStatement):
    """PTP_SPLINE or SPLINE; `clause` as of a motion."""

    clause: str = ""


@dataclass(frozen=True)
class Definition(KeywordStatement):
    """DEF or DEFDAT with the program's name."""

    name: str


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
class MotionStatement(KeywordStatement):
    """PTP, LIN, SPTP, SLIN or SPL to a literal position or to a named one; `approximation` as C_VEL or empty; `clause`: what
    stands behind WITH, which holds for this motion alone."""

    target: Value
    approximation: str
    clause: str = ""


class BlockEnd(Statement):
    """ENDSPLINE."""


@dataclass(frozen=True)
class TimeBlock(Statement):
    """TIME_BLOCK START, PART or END with its seconds."""

    what: str
    value: Number | None


@dataclass(frozen=True)
class PauseStatement(Statement):
    """HALT, WAIT SEC seconds or WAIT FOR $IN[input]: the robot stands still."""

    seconds: Number | None = None
    input: Number | None = None


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
