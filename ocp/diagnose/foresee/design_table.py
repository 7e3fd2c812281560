"""The design table in words: one line an effect, one column a planned measurement."""

from collections.abc import Sequence
from dataclasses import dataclass

from ocp.effects.effect import Effect, Parameter

NOT = "cannot be seen"
NARROWEST = 12  # characters of a column
NEVER = frozenset({"speed"})  # no column of readings at rest


@dataclass(frozen=True)
class Line:
    """What a plan sees of an effect at a joint: smallest share of the usual upper end that would be named (inf: none), or why
    it is blind."""

    effect: Effect
    joint: int
    smallest: float
    blind: str


@dataclass(frozen=True)
class Column:
    """A planned measurement: head, what it sees of effects that it can show at all, its name in sentences (empty: only held
    against), what stands where an effect does not change its readings."""

    head: str
    lines: Sequence[Line]
    what: str
    elsewhere: str


def table(known: Sequence[Effect], columns: Sequence[Column], notes: Sequence[str]) -> str:
    """One line an effect: usual range, smallest size each plan sees and at which joints; then what cannot be seen, and why."""
    rows = [("effect", "usual range", *(c.head for c in columns))]
    for effect in known:
        p = size_parameter(effect)
        cells = []
        for c in columns:
            mine = [x for x in c.lines if x.effect.name == effect.name]
            cells.append(_seen(mine, p.high) if mine else c.elsewhere)
        rows.append((effect.name, f"{p.key} {p.low:g}..{p.high:g}", *cells))
    widths = [max(*(len(row[k]) for row in rows[1:]), NARROWEST) for k in range(len(rows[0]))]
    out = [*_wrapped_head(rows[0], widths), *(_row(row, widths) for row in rows[1:])]
    for k, c in enumerate(columns, start=2):
        hidden = [row[0] for row in rows[1:] if row[k] == NOT]
        if c.what and hidden:
            out.append(f"With {c.what} {', '.join(hidden)} cannot be seen.")
    reasons = dict.fromkeys(line.blind.split(":")[0] for c in columns for line in c.lines if line.blind)
    told = [reason for reason in reasons if reason.rpartition("column ")[2] not in NEVER]
    return "\n".join([*out, *(f"note: {_of_plan(reason)}" for reason in told), *notes])


def size_parameter(effect: Effect) -> Parameter:
    """The key that says how large an effect is."""
    return next(p for p in effect.parameters if p.unit != "name" and p.high > 0 and p.key not in ("order", "phase_rad"))


def _of_plan(reason: str) -> str:
    """A channel's reason, of files that are not measured yet."""
    return reason.replace("tracker.csv", "the plan of readings").replace("force.csv", "the planned log")


def _seen(lines: Sequence[Line], high: float) -> str:
    """Smallest sizes over the joints at which a usual size shows, and those joints."""
    seen = [line for line in lines if line.smallest <= 1.0]
    if not seen:
        return NOT
    sizes = sorted(line.smallest * high for line in seen)
    words = f"{sizes[0]:.2g}" if len(sizes) == 1 else f"{sizes[0]:.2g} to {sizes[-1]:.2g}"
    hidden = [line.joint for line in lines if line not in seen]
    at = [str(j) for j in hidden if j]
    blind = (["not common"] if 0 in hidden else []) + ([f"not at joint {', '.join(at)}"] if at else [])
    return f"{words} ({'; '.join(blind)})" if blind else words


def _wrapped_head(head: Sequence[str], widths: Sequence[int]) -> list[str]:
    """The head over as many lines as its cells need."""
    cells = []
    for words, width in zip(head, widths, strict=True):
        lines = [""]
        for word in words.split():
            joined = f"{lines[-1]} {word}".strip()
            if len(joined) <= width:
                lines[-1] = joined
            else:
                lines.append(word)
        cells.append(lines)
    height = max(len(c) for c in cells)
    return [_row([c[k] if k < len(c) else "" for c in cells], widths) for k in range(height)]


def _row(cells: Sequence[str], widths: Sequence[int]) -> str:
    return "  ".join(f"{cell:<{w}}" for cell, w in zip(cells, widths, strict=True)).rstrip()
