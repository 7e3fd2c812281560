"""`python benchmarks/blade_parts.py [NUMBER ..] [--keep FOLDER]`: thirty odd blades made, read, and their aerofoils compared.

Prints a table: what each part is, and what was found against what was built (tests/support/blade_parts.py).
With --keep also a cell.toml a part stands in FOLDER, the bundled cell that grips the part at its root and grinds two lines:
`python -m ocp.plan FOLDER/part_02.stl --cell FOLDER/part_02.toml --step 2`.

Ends with exit code 1 where a part is not as it was built.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from ocp.data import CELL
from robots.pose import abc_from_rotation
from tests.support.blade_parts import RECIPES, BladePart, Outcome, build, outcome

HEAD = (
    "part", "length, chord, edge mm", "twist deg", "root", "tip", "cuts", "facets", "span off, deg", "from, to off, mm",
    "passes off, um, 95 % / worst", "lines", "s", "verdict",
)  # fmt: skip


def cell_text(part: BladePart) -> str:
    """The bundled cell with this part gripped by its root, span along the flange's axis, and few short passes."""
    recipe, text = part.recipe, CELL.read_text()
    floor = -0.3 * recipe.depth if recipe.root != "none" else 0.05 * recipe.length
    grip = np.array([0.0, 0.0, 200.0 + recipe.depth]) - part.turn.T @ part.shift
    angles = np.rad2deg(abc_from_rotation(part.turn.T))
    normal, offset = part.axis.tolist(), float(part.axis @ part.shift + floor)
    changes = {
        'stl = "blade.stl"': f'stl = "part_{recipe.seed:02d}.stl"',
        'stl_unit = "mm"': f'stl_unit = "{recipe.unit}"',
        "xyz_mm = [0, 0, 200]": f"xyz_mm = {grip.tolist()}",
        "abc_deg = [0, 0, 0]": f"abc_deg = {angles.tolist()}",
        'clamp_axis = "z"\nclamp_to_mm = 10.0\nclamp_side = "below"': f"clamp_normal = {normal}\nclamp_offset_mm = {offset}",
        "pass_spacing_mm = 6.0": f"pass_spacing_mm = {0.6 * recipe.chord}",
    }
    for old, new in changes.items():
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text


def found(got: Outcome) -> list[str]:
    return [
        f"{got.angle:.1f}",
        f"{got.low:+.1f}, {got.high:+.1f}",
        f"{1e3 * got.off[0]:.1f} / {1e3 * got.off[1]:.0f}",
        str(got.lines),
    ]


def verdict(got: Outcome, fault: str) -> str:
    if fault:
        return f"WRONG: {fault} {got.refusal}"
    return "refused: " + got.refusal.split("this is no blade: ")[-1].split("; hand")[0] if got.refusal else "planned"


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("numbers", type=int, nargs="*")
    parser.add_argument("--keep", type=Path, help="folder for the STL files")
    options = parser.parse_args()
    folder = options.keep or Path(tempfile.mkdtemp())
    folder.mkdir(parents=True, exist_ok=True)
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    wrong = 0
    for recipe in RECIPES:
        if options.numbers and recipe.seed not in options.numbers:
            continue
        part = build(recipe)
        stl = part.write(folder)
        stl.with_suffix(".toml").write_text(cell_text(part))
        start = time.process_time()
        got = outcome(part, stl)
        seconds = time.process_time() - start
        fault = got.wrong(recipe)
        wrong += bool(fault)
        cells = [
            str(recipe.seed) + (", file in m" if recipe.unit == "m" else ""),
            f"{recipe.length:g}, {recipe.chord:g}, {recipe.edge:g}",
            f"{recipe.twist:g}",
            f"{recipe.root}, {recipe.depth:g} mm" if recipe.depth else "none",
            recipe.tip,
            recipe.cuts,
            str(len(part.faces)),
            *(["", "", "", ""] if got.refusal else found(got)),
            f"{seconds:.1f}",
            verdict(got, fault),
        ]
        print(f"| {' | '.join(cells)} |", flush=True)
    print(f"\n{wrong} parts are not as they were built")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
