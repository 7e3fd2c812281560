"""The record of answers: a seed that is not for development is answered once, and every further answer to it says so.

Worlds of seeds 1 to 99 are looked at while the diagnosis is built; their figures stand in no table. The answers to any other seed
are entered in `RECORD` when all of them stand and before a label is opened: seed, signals, kinds, readings, worlds, the SHA-256
of the answers, that of the engine's sources, and the date. Every line holds the hash of the line before, so none is changed or
taken out unseen. What was answered first is what counts: an engine changed after a look at some worlds answers those better.
"""

import hashlib
import json
import os
from dataclasses import asdict, dataclass
from datetime import UTC, datetime

from ocp.blindtest.worlds.sealing import Check
from ocp.data import BLINDTEST_RECORD
from ocp.shell.cache import sha256
from robots.errors import BadInput

DEVELOPMENT = range(1, 100)
ENGINE = ("diagnose", "effects", "model")
"""Rooms whose sources are the engine."""
CHAINED = 16  # digits of the hash of the line before


@dataclass(frozen=True)
class RecordEntry:
    """One run's answers; before: the beginning of the hash of the line above."""

    seed: int
    signals: str
    kinds: tuple[str, ...]
    readings: int
    worlds: int
    answers: str
    engine: str
    date: str
    before: str

    def line(self) -> str:
        """As it stands in the record."""
        return json.dumps(asdict(self))


@dataclass(frozen=True)
class Standing:
    """What a check's answers are to its seed, in a word or two and in a sentence; counts: whether its figures do."""

    brief: str
    sentence: str
    counts: bool


def refuse_unrecorded(check: Check) -> None:
    """Raises BadInput: this seed's answers have to be entered, and the record cannot take them."""
    if check.seed in DEVELOPMENT:
        return
    entries()
    if not os.access(BLINDTEST_RECORD, os.W_OK):
        raise BadInput(
            f"--seed {check.seed}: answers to seeds above {DEVELOPMENT[-1]} are entered in {BLINDTEST_RECORD}, which cannot be "
            f"written; give a seed from {DEVELOPMENT[0]} to {DEVELOPMENT[-1]}"
        )


def entries() -> list[RecordEntry]:
    """All entries, the oldest first. Raises BadInput: a line is not what was entered."""
    found: list[RecordEntry] = []
    before = ""
    try:
        lines = BLINDTEST_RECORD.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError):
        raise BadInput(f"{BLINDTEST_RECORD}: cannot be read; take the file from the repository again") from None
    for line in lines:
        try:
            told = json.loads(line)
            entry = RecordEntry(**told | {"kinds": tuple(told["kinds"])})
            follows = entry.before == before
        except (ValueError, TypeError, LookupError):
            follows = False
        if not follows:
            where = f"{BLINDTEST_RECORD}, line {len(found) + 1}"
            raise BadInput(f"{where}: is not what was entered; take the file from the repository again")
        found.append(entry)
        before = _chained(line)
    return found


def entered(check: Check) -> Standing:
    """What the answers to a check's worlds are to their seed; all stand, and are entered where they are not yet."""
    if check.seed in DEVELOPMENT:
        told = f"Seed {check.seed} is one for development: its worlds may be looked at, and its figures stand in no table."
        return Standing("for development", told, False)
    every = entries()
    own = [e for e in every if e.seed == check.seed]
    here = (check.worlds, check.signals, check.kinds, check.readings, _digest(check, check.worlds))
    place = next((k for k, e in enumerate(own) if (e.worlds, e.signals, e.kinds, e.readings, e.answers) == here), len(own))
    if place == len(own):
        last = _chained(every[-1].line()) if every else ""
        date = datetime.now(UTC).date().isoformat()
        entry = RecordEntry(
            check.seed, check.signals, check.kinds, check.readings, check.worlds, here[-1], engine_version(), date, last
        )
        with BLINDTEST_RECORD.open("a", encoding="utf-8") as file:
            file.write(entry.line() + "\n")
    # A run that went on where an earlier one ended holds its answers.
    others = [e for e in own[:place] if e.answers != _digest(check, e.worlds)]
    if not others:
        return Standing("first answer", f"This is the first answer to seed {check.seed}.", True)
    first = f"{others[0].worlds} worlds on {others[0].date}"
    told = f"Seed {check.seed} was answered before ({first}): this is answer {len(others) + 1}, and the first one is what counts."
    return Standing(f"answer {len(others) + 1}", told, False)


def engine_version() -> str:
    """SHA-256 over the engine's sources, their places and contents."""
    root = BLINDTEST_RECORD.parents[1]
    found = hashlib.sha256()
    for path in sorted(path for room in ENGINE for path in (root / room).rglob("*.py")):
        found.update(f"{path.relative_to(root).as_posix()} {sha256(path)}\n".encode())
    return found.hexdigest()


def _digest(check: Check, worlds: int) -> str:
    """SHA-256 over the answers to the first `worlds` worlds, as far as they stand."""
    paths = (check.answer(f"{k:05d}") for k in range(1, worlds + 1))
    return hashlib.sha256("".join(sha256(path) for path in paths if path.is_file()).encode()).hexdigest()


def _chained(line: str) -> str:
    return hashlib.sha256(line.encode()).hexdigest()[:CHAINED]
