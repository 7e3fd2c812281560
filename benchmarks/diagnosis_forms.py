"""Effects in the plainest forms, added to the readings of a force log that has none: does the diagnosis know them again?

The catalogue's forms are ours, the virtual cell's are ours too. Here a formula of one line is added to the normal reading of a
log made by others, and its friction to the tangential one; the overlap's stiffness is one number.

    python benchmarks/diagnosis_forms.py ../shared/data/worlds/force_no_effect [NAME ...]
"""

import csv
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ocp.diagnose.answering import channels_of
from ocp.diagnose.dataset import read_data_set
from ocp.diagnose.engine.findings import Options
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.effects.catalogue import library
from ocp.shell.progress import Phases

STIFFNESS = 5200.0  # N/m: dF per m of overlap in a cell with this flange
RADIUS, FRICTION = 0.15, 0.35
Rows = SimpleNamespace  # columns of force.csv by name


def knock(d: Rows, height: float, hz: float, seconds: float, clock: str) -> np.ndarray:
    turns = getattr(d, clock) * hz
    return d.contact * height * np.exp(-0.5 * ((turns - np.round(turns)) / hz / seconds) ** 2)


def press(d: Rows, overlap: np.ndarray | float) -> np.ndarray:
    return d.contact * STIFFNESS * overlap


def profile(d: Rows, size: float) -> np.ndarray:
    rng, out = np.random.default_rng(3), np.zeros(len(d.line))
    for line in np.unique(d.line):
        k, a = np.arange(1, 5), rng.normal(size=(2, 4)) / np.arange(1, 5)
        x = np.pi * np.outer(d.s_mm / d.s_mm.max(), k)
        shape = np.cos(x) @ a[0] + np.sin(x) @ a[1]
        out += np.where(d.line == line, shape / np.abs(shape).max(), 0.0)
    return size * out


def later(d: Rows, values: np.ndarray, seconds: float | np.ndarray) -> np.ndarray:
    """What a log reads of `values` that comes `seconds` late, recording by recording, less the values."""
    out = np.zeros(len(values))
    for run in np.unique(d.run):
        at = d.run == run
        out[at] = np.interp((d.time_s - seconds)[at], d.time_s[at], values[at]) - values[at]
    return d.contact * out


def moved(d: Rows, shift: tuple[float, float, float], since: float) -> np.ndarray:
    """A displacement m of the blade in its own frame from an instant of the clock on."""
    return press(d, (d.clock_s >= since) * (np.stack([d.nx, d.ny, d.nz], axis=1) @ np.array(shift)))


def pause(d: Rows) -> float:
    """An instant between two recordings in the middle of the log."""
    starts = np.sort([d.clock_s[d.run == r].min() for r in np.unique(d.run)])
    return float(starts[len(starts) // 2]) - 0.05


# name: what is added to fn (n,) N; whether the contact carries it, so that friction shows it too
FORMS: dict[str, tuple[Callable[[Rows], np.ndarray], bool]] = {
    "belt_splice 3 N, 4 ms": (lambda d: knock(d, 3.0, 8.3, 0.004, "time_s"), True),
    "belt_splice 2 N, 12 ms, clock": (lambda d: knock(d, 2.0, 11.2, 0.012, "clock_s"), True),
    "belt_splice 9 N, 6 ms": (lambda d: knock(d, 9.0, 6.7, 0.006, "time_s"), True),
    "wheel_runout 4e-5 m, clock": (lambda d: press(d, 4e-5 * np.cos(d.belt_m_s / RADIUS * d.clock_s + 1.0)), True),
    "wheel_runout 4e-5 m, run": (lambda d: press(d, 4e-5 * np.cos(d.belt_m_s / RADIUS * d.time_s + 1.0)), True),
    "wheel_wear 2e-7 m/s": (lambda d: press(d, -2e-7 * d.clock_s), True),
    "material_removal 3e-5 m": (lambda d: press(d, -3e-5 * d.ground_before * 40.0 / d.feed_mm_s), True),
    "stock_profile 1e-4 m": (lambda d: press(d, profile(d, 1e-4)), True),
    "sensor_bias 0.6 N": (lambda d: np.full(len(d.line), 0.6), False),
    "sensor_drift 1 N/h": (lambda d: d.clock_s / 3600.0, False),
    "sensor_gain 3 %": (lambda d: 0.03 * d.fn_N, False),
    "sensor_crosstalk 5 %": (lambda d: 0.05 * d.ft_N, False),
    "time_delay 20 ms": (lambda d: later(d, d.fn_N, 0.02), True),
    "path_lag 3e-4 m": (lambda d: later(d, d.fn_N, 0.3 / np.maximum(d.feed_mm_s, 1.0)), True),
    "wheel_temperature 6e-6 m/K": (lambda d: press(d, 6e-6 * (d.wheel_temperature_C - 25.0)), True),
    "tool_frame_shift 1.5e-4 m": (lambda d: moved(d, (1e-4, 1e-4, 0.0), pause(d)), True),
    "clamp_slip 2e-4 m, 11 rows before a pause": (lambda d: moved(d, (0.0, 2e-4, 0.0), pause(d) + 1.0), True),
    "clamp that gives way 2e-6 m/N": (lambda d: press(d, -2e-6 * d.fn_N * (d.s_mm / d.s_mm.max()) ** 2), True),
    "chatter 0.2 N, 17 Hz": (lambda d: d.contact * 0.2 * np.cos(2 * np.pi * 17.0 * d.time_s), True),
    "oval wheel 3e-5 m": (lambda d: press(d, 3e-5 * np.cos(2 * d.belt_m_s / RADIUS * d.time_s)), True),
}


def main() -> None:
    """Print a line for each form."""
    source, known = Path(sys.argv[1]), library()
    table = np.genfromtxt(source / "force.csv", delimiter=",", names=True)
    names = list(table.dtype.names or ())
    rows = SimpleNamespace(**{column: np.asarray(table[column], float) for column in names})
    print("| planted | verdict | said | value | s of processor |\n|---|---|---|---|---|")
    for name in sys.argv[2:] or FORMS:
        form, carried = FORMS[name]
        with tempfile.TemporaryDirectory() as folder:
            for copied in ("cell.toml", "blade.stl", "tracker.csv"):
                shutil.copy(source / copied, folder)
            added = np.asarray(form(rows), float)
            friction = FRICTION * np.sign(rows.belt_m_s) * added if carried else 0.0
            changed = vars(rows) | {"fn_N": rows.fn_N + added, "ft_N": rows.ft_N + friction}
            with (Path(folder) / "force.csv").open("w", newline="", encoding="utf-8") as file:
                out = csv.writer(file)
                out.writerow(names)
                out.writerows([f"{v:.10g}" for v in row] for row in zip(*(changed[n] for n in names), strict=True))
            start = time.process_time()
            found = diagnose_channels(channels_of(read_data_set(Path(folder)), Phases()), known, Options())
        said = ", ".join(f"{r.name} {r.probability:.2f}" for r in found.ranking[:2]) + f", none of these {found.p_unknown:.2f}"
        first = {a.effect.name: f"{a.parameters[a.effect.parameters[0].key]:.3g}" for a in found.active if a.effect.size == 1}
        value = ", ".join(f"{k} {v}" for k, v in first.items())
        print(f"| {name} | {found.verdict} | {said} | {value} | {time.process_time() - start:.0f} |", flush=True)


if __name__ == "__main__":
    main()
