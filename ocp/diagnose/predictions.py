"""Blind predictions of sealed conditions, row by row in their order (FORMATS, "What the software writes")."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ocp.diagnose.engine.channel_system import Sealed
from robots.pose import Array


def averaged(parts: Sequence[tuple[float, Sealed]]) -> Sealed:
    """Corrected predictions of several alternatives by their probabilities, sigma with what they differ by; the baseline is
    that of the first."""
    total = sum(p for p, _ in parts)
    corrected = sum(p * s.corrected for p, s in parts) / total
    variance = sum(p * (s.sigma**2 + (s.corrected - corrected) ** 2) for p, s in parts) / total
    lacking = tuple(dict.fromkeys(name for _, s in parts for name in s.lacking))
    return Sealed(parts[0][1].baseline, np.asarray(corrected), np.sqrt(variance), lacking)


def write_tracker_predictions(path: Path, sealed: Sealed) -> None:
    """x, y, z in mm of the baseline, of the corrected model and its one sigma; sealed holds m."""
    axes = [f"{c}_mm" for c in "xyz"]
    _write(path, axes, sealed, 1e3)


def write_force_predictions(path: Path, sealed: Sealed) -> None:
    """fn in N of the baseline, of the corrected model and its one sigma; a tangential column of the channel is left out."""
    first = [np.asarray(a).reshape(len(a), -1)[:, :1] for a in (sealed.baseline, sealed.corrected, sealed.sigma)]
    normal = Sealed(first[0], first[1], first[2])
    _write(path, ["fn_N"], normal, 1.0)


def _write(path: Path, columns: Sequence[str], sealed: Sealed, factor: float) -> None:
    header = [f"{kind}_{c}" for kind in ("baseline", "corrected", "sigma") for c in columns]
    rows: Array = factor * np.hstack([sealed.baseline, sealed.corrected, sealed.sigma])
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        for row in rows:
            writer.writerow([f"{v:.5f}" for v in row])
