"""Before any data: what a planned measurement could see of every effect, and what it cannot (docs/diagnose.md, eq. 4).

The planned readings make the same linear system as measured ones would. An effect of relative size t (share of the usual upper
end, mean over its coefficients) has the detectability t^2 |M C|^2 / m; it is named nine times of ten above what
`ocp.diagnose.engine.evidence` says, for this many variants and against the background of a good machine.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from ocp.calibrate.force.log import ForceLog, read_force_log
from ocp.calibrate.force.planned import log_of_plan
from ocp.diagnose.engine.channel_system import UNSEEN, Channel, needs_motion
from ocp.diagnose.engine.evidence import project
from ocp.diagnose.engine.linearisation import log_odds, smallest_seen
from ocp.diagnose.foresee.planned_tracker import arm_expected, default_poses, planned_channel
from ocp.diagnose.foresee.separation import few_of
from ocp.diagnose.rules import LEAST_CONTACT_ROWS, LEAST_READINGS
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.effects.catalogue import library
from ocp.effects.effect import Effect, Scanned
from ocp.model.cell import TrackerSetup, read_cell, read_tracker_setup
from ocp.shell.text_table import table_lines
from robots.csv_table import columns_named
from robots.errors import BadInput
from robots.pose import Array
from robots.tracker_readings import read_readings

POSES, FULL = 50, 150  # the plan looked at where none is given; the campaign held against it
MOST_SCANS = 24  # variants looked at; the median of them is told
FORCE = "force"  # the channel of a planned log
FREE_LIMIT = 1e-9  # lambda at the upper end below which nothing shows
NOT = "cannot be seen"


@dataclass(frozen=True)
class DesignLine:
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
    lines: Sequence[DesignLine]
    what: str
    elsewhere: str


@threadpool_limits.wrap(limits=1, user_api="blas")  # as the diagnosis: threads only fight over matrices as small as these
def design_text(cell: Path, poses: Path | None, log: Path | None = None) -> str:
    """The table as text: of planned tracker readings (default: `POSES` of them, unless a log alone is planned), of a planned
    force log, or of both. Raises BadInput: cell, poses or log malformed; Infeasible as the force model."""
    setup = read_tracker_setup(cell)
    known = list(library().values())
    rows = None if log is None else read_planned_log(log)
    columns, notes, arm = list[Column](), list[str](), None
    if poses is not None or rows is None:
        channel, what = _tracker_plan(setup, poses)
        full = planned_channel(setup, default_poses(setup, FULL, full=True))
        every = f"{FULL} poses, all payloads, both directions, warm-up: from"
        columns.append(Column(f"{what} see it from", visible_in(channel, known), what, "needs a force log (--log)"))
        columns.append(Column(every, visible_in(full, known), "", "needs a force log (--log)"))
        arm = None if poses is None else arm_expected(channel)
    if rows is not None:
        what = f"the {len(rows)} rows of {rows.path.name} ({len(rows.runs)} recording{'s' if len(rows.runs) > 1 else ''})"
        from ocp.diagnose.foresee.planned_grinding import planned_force_channel  # the contact: only for those who plan a log

        planned = planned_force_channel(read_cell(cell), rows, [_with_few(e) for e in known], arm)
        seen = visible_in(planned, known)
        columns.append(Column(f"{what} see it from", seen, what, "needs the tracker (--poses)"))
        notes += _assumed(rows)
    return design_table(known, columns, notes)


def _tracker_plan(setup: TrackerSetup, poses: Path | None) -> tuple[TrackerChannel, str]:
    """The channel that planned readings would make, and what they are."""
    if poses is None:
        return planned_channel(setup, default_poses(setup, POSES, full=False)), f"{POSES} unidirectional poses with one payload"
    planned = read_readings(poses, setup.payloads, setup.instrument, sealed=True)
    if len(planned) < LEAST_READINGS:
        raise BadInput(f"{poses}: {len(planned)} readings tell nothing of an arm; plan at least {LEAST_READINGS}")
    return planned_channel(setup, planned), f"the {len(planned)} readings of {poses.name}"


def _with_few(effect: Effect) -> Effect:
    """The effect with the variants that are looked at alone: of families of many only these have their patterns kept."""
    return replace(effect, scan=lambda joint, seen: few_of(tuple(effect.scan(joint, seen)), MOST_SCANS))


def _assumed(log: ForceLog) -> list[str]:
    """What the sizes of a force log rest on beside the file."""
    from ocp.diagnose.foresee.planned_grinding import LASTS, SIGMA

    told = []
    if log.sigma_fn is None:
        lasts = f"half of its variance lasting {1e3 * LASTS:.0f} ms"
        told.append(f"note: a reading's noise is taken to be {SIGMA:g} N, {lasts}; columns sigma_fn_N, sigma_ft_N say other")
    if log.ft is None:
        told.append("note: no column ft_N: the tangential force is taken not to be logged; add it (any number) if it will be")
    return told


def visible_in(channel: Channel, known: Sequence[Effect]) -> list[DesignLine]:
    """What planned readings see of every effect that changes them; why not of those that lack a column."""
    system = channel.system
    projection = project(system.nuisance, system.prior_sd)
    kinds = sum(not channel.blind(e) for e in known)
    found = []
    for effect in known:
        if not _shows(channel, effect):
            continue
        # A delay of all joints is nothing that a reading at rest sees.
        places = [j for j in effect.places if j or not effect.joints or channel.name == FORCE]
        blind = channel.blind(effect)
        energies = {j: 0.0 if blind else energy_of(channel, projection.apply, effect, j) for j in places}
        found += [DesignLine(effect, j, smallest_visible(channel, effect, j, energies, kinds), blind) for j in places]
    return found


def _shows(channel: Channel, effect: Effect) -> bool:
    """Whether an effect changes this signal at all."""
    return effect.on_arm or (effect.on_contact if channel.name == FORCE else effect.reading is not None)


def energy_of(channel: Channel, project_out: Callable[[Array], Array], effect: Effect, joint: int) -> float:
    """Detectability |M C|^2 / m of an effect at the usual upper end, the median of its variants."""
    picked = few_of(_scans(channel, effect, joint), MOST_SCANS)
    found, columns = channel.variants(effect, joint, picked) if picked else UNSEEN
    sizes = [(project_out(columns[:, v] * np.asarray(effect.prior_sd)) ** 2).sum() for v in range(len(found))]
    return float(np.median(sizes)) / effect.size if found else 0.0


def smallest_visible(channel: Channel, effect: Effect, joint: int, energies: Mapping[int, float], kinds: int) -> float:
    """Share of the usual upper end from which the effect is named nine times of ten; inf: never. energies: `energy_of` it at its
    joints; `kinds` effects compete."""
    energy = energies[joint]
    if energy < FREE_LIMIT:
        return np.inf
    scans = _scans(channel, effect, joint)
    others = np.array([e for j, e in energies.items() if j != joint])
    among = max(len(scans), channel.surroundings.among.get(effect.name, 0))
    return smallest_seen(effect, joint, scans, among, log_odds(effect, kinds), energy, others)


def _scans(channel: Channel, effect: Effect, joint: int) -> tuple[Scanned, ...]:
    """Variants that the diagnosis would try."""
    if channel.name != FORCE:
        return tuple(effect.scan(joint, channel.surroundings))
    from ocp.diagnose.force.channel import ForceChannel

    assert isinstance(channel, ForceChannel)
    return channel.scan(effect, joint)


def design_table(known: Sequence[Effect], columns: Sequence[Column], notes: Sequence[str]) -> str:
    """One line an effect: usual range, smallest size each plan sees and at which joints; then what cannot be seen, and why."""
    rows = [("effect", "usual range", *(c.head for c in columns))]
    for effect in known:
        p = effect.sized_by
        cells = []
        for c in columns:
            mine = [x for x in c.lines if x.effect.name == effect.name]
            cells.append(_seen(mine, p.high) if mine else c.elsewhere)
        rows.append((effect.name, f"{p.key} {p.low:g}..{p.high:g}", *cells))
    out = table_lines(rows)
    for k, c in enumerate(columns, start=2):
        hidden = [row[0] for row in rows[1:] if row[k] == NOT]
        if c.what and hidden:
            out.append(f"With {c.what} {', '.join(hidden)} cannot be seen.")
    reasons = dict.fromkeys(line.blind.split(":")[0] for c in columns for line in c.lines if line.blind)
    told = "\n".join(f"note: {reason}" for reason in reasons if not needs_motion(reason))
    told = told.replace("tracker.csv", "the plan of readings").replace("force.csv", "the planned log")
    return "\n".join([*out, *told.splitlines(), *notes])


def _seen(lines: Sequence[DesignLine], high: float) -> str:
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


def read_planned_log(path: Path) -> ForceLog:
    """Planned rows; forces nan (fn) or what stands there (ft, which says that it will be logged).

    A file without a column run is taken for a plan.csv: every passage in contact is a recording, the program's clock that of the
    campaign, no line was ground before. Raises BadInput: as `read_force_log`, and where too few rows are in contact.
    """
    log = read_force_log(path, sealed=True) if "run" in columns_named(path) else log_of_plan(path)
    count = int(log.contact.sum())
    if count < LEAST_CONTACT_ROWS:
        raise BadInput(f"{path}, column contact: {count} rows in contact tell nothing; plan at least {LEAST_CONTACT_ROWS}")
    return log
