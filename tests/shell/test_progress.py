"""Progress of long jobs: what is told, and what is timed."""

from ocp.shell.progress import Phases


def test_a_phase_tells_its_beginning_every_step_and_its_end():
    told: list[tuple[str, int, int | None]] = []
    phases = Phases(lambda *what: told.append(what))
    with phases.phase("passes", 2) as advance:
        advance()
        advance()
    with phases.phase("report"):
        pass
    assert told == [("passes", 0, 2), ("passes", 1, 2), ("passes", 2, 2), ("passes", 2, 2), ("report", 0, None), ("report", 1, 1)]


def test_seconds_of_a_phase_that_comes_again_add_up():
    phases = Phases()
    for _ in range(2):
        with phases.phase("fit"):
            pass
    assert list(phases.seconds) == ["fit"] and phases.seconds["fit"] >= 0.0
