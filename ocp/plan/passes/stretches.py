"""Pieces of lines: where a line cannot be ground it is cut there, the rest is planned, and what is left out has a name."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ocp.plan.rules import LEAST_GROUND_SHARE, LEAST_STRETCH, STRETCH_ROOM
from robots.errors import Infeasible
from robots.pose import Array
from trajectories.passes import BladePath, stretch_of

Mask = NDArray[np.bool_]
MOST_CUTS = 5  # of a line, one after the other: each costs the optimiser's time
NO_ROOM = ("the wheel would touch block, platform or shroud", "use a smaller or narrower wheel, or a larger margin there")
LEAST_TOLD = 1e-4  # m of a line
SHOWN = 6  # notices of what is left out
HALVINGS = 3  # where the place is not known; an eighth of a line is then given up


class CannotGrind(Infeasible):
    """A pass that cannot be ground as it is: where along it, why, and what would help.

    line, side, start: whose, and where on the line it begins, m; at (m,): arc lengths m on the path that was tried, in its
    direction of travel, that cannot be ground (none: the place is not known); waypoint: 0-based, the one that the sentence
    names; reason and would_do: two parts of a sentence; others: of other passes, told with this one; turn rad: by how much the
    wheel stood askew at most, inf where that is no matter.
    """

    def __init__(self, message: str, **told: Any) -> None:
        """`told`: the attributes above by name; passed on as they are, so that the error travels between processes."""
        super().__init__(message)
        self.line: int = told.get("line", 0)
        self.side: str = told.get("side", "")
        self.start: float = told.get("start", 0.0)
        self.at: Array = told.get("at", np.zeros(0))
        self.waypoint: int = told.get("waypoint", 0)
        self.reason: str = told.get("reason", message)
        self.would_do: str = told.get("would_do", "")
        self.others: list[CannotGrind] = told.get("others", [])
        self.turn: float = told.get("turn", np.inf)

    @classmethod
    def of(cls, path: BladePath, where: Mask, reason: str, would_do: str, worst: int | None = None, message: str = "") -> Self:
        """At the nodes `where` (n,) of `path` (n nodes, in its direction of travel), `worst` of them named; none of them: the
        place is not known. `message`: the whole sentence, where it says more than reason and remedy."""
        k = int(np.argmax(where)) if worst is None else worst
        named = f", waypoint {k + 1}" if where.any() else ""  # of the path in its direction of travel
        message = message or f"line {path.line} ({path.side}){named}: {reason}; {would_do}"
        told = {"reason": reason, "would_do": would_do, "waypoint": k, "at": path.s[where]}
        return cls(message, line=path.line, side=path.side, start=path.start, **told)

    def with_others(self, others: "list[CannotGrind]") -> "CannotGrind":
        """The same, and others beside it."""
        return CannotGrind(str(self), **(self.__dict__ | {"others": others}))

    @property
    def whose(self) -> tuple[int, float]:
        """Line, and where on it the pass begins."""
        return self.line, self.start

    def turned_round(self, length: float) -> Self:
        """The same of a line of `length` m run from its other end, whatever leads in to it and out of it."""
        return type(self)(str(self), **(self.__dict__ | {"at": length - self.at}))

    def nodes(self, s: Array) -> Mask:
        """Which of the waypoints at arc lengths s (n,) m of the path these are; those beyond its ends count for the ends."""
        found = np.zeros(len(s), bool)
        found[np.abs(s[:, None] - np.clip(self.at, s[0], s[-1])).argmin(axis=0)] = True
        return found


@dataclass(frozen=True)
class LeftOut:
    """A piece of a line that is not ground: from `start` to `end`, m along the line as it was laid; why, and what would do.

    turned: length m of a line that is driven from its far end, else 0.
    """

    line: int
    side: str
    start: float
    end: float
    reason: str
    would_do: str
    turned: float = 0.0

    @property
    def ends_mm(self) -> tuple[float, float]:
        """From and to, mm along the line in the direction in which it is driven, as `s_mm` of plan.csv."""
        if self.turned:
            return 1e3 * (self.turned - self.end), 1e3 * (self.turned - self.start)
        return 1e3 * self.start, 1e3 * self.end

    @property
    def length(self) -> float:
        """Its length m."""
        return self.end - self.start

    def document(self) -> dict[str, object]:
        """As plan.json has it."""
        ends = {name: round(end, 2) for name, end in zip(("from_mm", "to_mm"), self.ends_mm, strict=True)}
        return {"line": self.line, "side": self.side, **ends, "reason": self.reason, "would_do": self.would_do}

    def clause(self) -> str:
        """Tell it to a user, without an end."""
        ends = "{:.1f} to {:.1f} mm".format(*self.ends_mm)
        return f"line {self.line} ({self.side}), {ends}, is left out: {self.reason}; {self.would_do}".removesuffix("; ")

    def sentence(self) -> str:
        """The same as a sentence."""
        return f"L{self.clause()[1:]}."


@dataclass(frozen=True)
class LineStretch:
    """A piece of a line that is to be ground: its path and the blade's compliance (n, 3) along it; how often it was cut."""

    path: BladePath
    compliance: Array
    cuts: int = 0

    def piece(self, first: int, last: int) -> "LineStretch":
        """From waypoint `first` to `last`, both included."""
        return LineStretch(stretch_of(self.path, first, last), self.compliance[first : last + 1], self.cuts + 1)


def whole_lines(paths: list[BladePath], compliance: list[Array], whole: bool = False) -> tuple[list[LineStretch], list[LeftOut]]:
    """Every line in one piece; lines that are too short for a pass are left out, and what no line was laid on for want of room.

    Raises CannotGrind of a line too short if the `whole` of them is asked for.
    """
    stretches, lost = [], []
    for path, give in zip(paths, compliance, strict=True):
        for start, end in ((-path.before, 0.0), (float(path.s[-1]), float(path.s[-1]) + path.after)):
            if end - start > LEAST_TOLD:
                lost.append(LeftOut(path.line, path.side, start, end, *NO_ROOM))
        if path.s[-1] < LEAST_STRETCH:
            error = too_short(path)
            if whole:
                raise error
            lost.append(LeftOut(path.line, path.side, path.start, path.start + path.s[-1], error.reason, error.would_do))
        else:
            stretches.append(LineStretch(path, give))
    return stretches, lost


def too_short(path: BladePath) -> CannotGrind:
    """Why a line shorter than LEAST_STRETCH is no pass."""
    reason = f"a pass needs {LEAST_STRETCH * 1e3:g} mm and here are {path.s[-1] * 1e3:.1f}"
    remedy = "use a smaller or narrower wheel or smaller margins, or grind the other way (passes)"
    return CannotGrind.of(
        path, np.ones(len(path.s), bool), reason, remedy, message=f"line {path.line} ({path.side}): {reason}; {remedy}"
    )


def cut_out(stretch: LineStretch, error: Infeasible) -> tuple[list[LineStretch], list[LeftOut]]:
    """What can still be tried of a stretch that `error` forbids, and what of it is left out.

    Named places are cut out with STRETCH_ROOM to either side, pieces shorter than LEAST_STRETCH go with them. Where the place is
    not known the stretch is halved, which leaves nothing out, until it is too short or was cut too often.
    """
    path, s = stretch.path, stretch.path.s
    known = isinstance(error, CannotGrind) and len(error.at) > 0
    if not known and stretch.cuts < HALVINGS:
        middle = int(np.argmin(np.abs(s - 0.5 * s[-1])))
        # A waypoint belongs to one of them: a place of a line has one arc length and one pass.
        halves = [(0, middle), (min(middle + 1, len(s) - 1), len(s) - 1)]
        if all(s[j] - s[i] >= LEAST_STRETCH for i, j in halves):
            return [stretch.piece(i, j) for i, j in halves], []
    bad = np.ones(len(s), bool)
    if isinstance(error, CannotGrind) and known and stretch.cuts < MOST_CUTS:
        at = s[error.nodes(s)]
        bad = np.abs(s[:, None] - at).min(axis=1) <= STRETCH_ROOM
    kept = [(i, j) for i, j in runs(~bad) if s[j] - s[i] >= LEAST_STRETCH]
    ends = [0.0, *(float(s[k]) for run in kept for k in run), float(s[-1])]
    reason, would_do = (error.reason, error.would_do) if isinstance(error, CannotGrind) else (str(error), "")
    lost = [
        LeftOut(path.line, path.side, path.start + a, path.start + b, reason, would_do)
        for a, b in zip(ends[::2], ends[1::2], strict=True)
        if b > a
    ]
    return [stretch.piece(i, j) for i, j in kept], lost


def without_places(
    stretches: list[LineStretch], errors: list[CannotGrind], whole: bool
) -> tuple[list[LineStretch], list[LeftOut]]:
    """Whole lines without the places that `errors` name on them, and these. Raises the first of them if the `whole` is asked."""
    for error in errors[: int(whole)]:
        raise error
    named = {error.line: error for error in errors}
    kept, lost = [], []
    for stretch in stretches:
        pieces, out = cut_out(stretch, named[stretch.path.line]) if stretch.path.line in named else ([stretch], [])
        kept += pieces
        lost += out
    return kept, lost


def runs(mask: Mask) -> list[tuple[int, int]]:
    """First and last index of every stretch of True in a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]


def joined(lost: list[LeftOut]) -> list[LeftOut]:
    """In order of lines; pieces that touch are one, with the reason of the longest."""
    found: list[LeftOut] = []
    longest = 0.0
    for one in sorted(lost, key=lambda o: (o.line, o.start)):
        last = found[-1] if found else None
        if last is None or last.line != one.line or one.start > last.end + 1e-9:
            found.append(one)
            longest = one.length
            continue
        named = one if one.length > longest else last
        longest = max(longest, one.length)
        found[-1] = replace(named, start=last.start, end=max(last.end, one.end))
    return found


def as_driven(lost: list[LeftOut], lines: list[BladePath], backwards: set[int]) -> list[LeftOut]:
    """With the lines named in `backwards`, which are driven from their far end, measured from there."""
    length = {path.line: float(path.s[-1]) for path in lines}
    return [replace(one, turned=length[one.line]) if one.line in backwards else one for one in lost]


def ungrindable_notices(lost: list[LeftOut]) -> list[str]:
    """A sentence for each of them, for the longest SHOWN of many; want of room is told where the lines are laid."""
    longest = sorted((one for one in lost if one.reason != NO_ROOM[0]), key=lambda one: -one.length)
    told = [one.sentence() for one in sorted(longest[:SHOWN], key=lambda o: (o.line, o.start))]
    more = longest[SHOWN:]
    if more:
        length = 1e3 * sum(one.length for one in more)
        told.append(f"{len(more)} more stretches, {length:.0f} mm in all, are left out; plan.json and the report name them.")
    return told


def ground_share(paths: list[BladePath], lost: list[LeftOut]) -> float:
    """Share of the asked surface that is ground: every line stands for the strip up to half-way to its neighbours, which goes on
    where the line was cut back."""
    area = missing = 0.0
    for path in paths:
        width = _strip(path, paths)
        s = np.concatenate([[path.s[0] - path.before], path.s, [path.s[-1] + path.after]])
        width = np.concatenate([width[:1], width, width[-1:]])
        area += float(np.trapezoid(width, s))
        for one in lost:
            if one.line == path.line:
                a, b = np.clip([one.start - path.start, one.end - path.start], s[0], s[-1])
                within = np.linspace(a, b, 50)
                missing += float(np.trapezoid(np.interp(within, s, width), within))
    return max(1.0 - missing / area, 0.0)


def _strip(path: BladePath, paths: list[BladePath]) -> Array:
    """Half the distance (n,) m to the line before and to the line after on the same side; 1 m for a line alone."""
    same = sorted((other for other in paths if other.side == path.side), key=lambda other: other.line)
    place = next(i for i, other in enumerate(same) if other is path)
    near = [same[i].p for i in (place - 1, place + 1) if 0 <= i < len(same)]
    return np.asarray(sum(0.5 * cKDTree(p).query(path.p)[0] for p in near)) if near else np.ones(len(path.s))


def refuse_mostly_left_out(paths: list[BladePath], lost: list[LeftOut]) -> float:
    """The ground share. Raises Infeasible where less than LEAST_GROUND_SHARE is ground, with what stops most of it."""
    share = ground_share(paths, lost)
    if share < LEAST_GROUND_SHARE:
        worst = max(lost, key=lambda one: one.length)
        raise Infeasible(
            f"only {100 * share:.1f} % of the asked surface can be ground, {100 * LEAST_GROUND_SHARE:g} % are asked at least; "
            f"{len(lost)} stretches are left out, the longest of them: {worst.clause()}"
        )
    return share
