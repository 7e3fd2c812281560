"""The catalogue as the table of docs/effects.md, made from the library: `python -m ocp.effects.listing docs/effects.md`."""

import sys
from pathlib import Path

from ocp.effects.effect import Effect, Parameter
from ocp.effects.library import library

BEGIN, END = "<!-- table: python -m ocp.effects.listing docs/effects.md -->", "<!-- end of table -->"
HOOKS = ("joint", "torque", "twist", "reading", "overlap", "push", "sensor", "shear", "along", "along_shear")


def effects_table() -> str:
    """Markdown: what every effect is, its keys with usual ranges, where it enters the model, and its physics."""
    lines = ["| effect | keys, usual range | enters by | what it is |", "|---|---|---|---|"]
    for effect in library().values():
        keys = "; ".join(_key(p) for p in effect.parameters)
        hooks = ", ".join(h for h in HOOKS if getattr(effect, h) is not None)
        needs = f" (needs {', '.join(effect.needs)})" if effect.needs else ""
        lines.append(f"| {effect.name}{_joints(effect)} | {keys} | {hooks}{needs} | {effect.physics} |")
    return "\n".join(line.replace("|tau|", "abs(tau)").replace("|b - a|", "abs(b - a)") for line in lines)


def with_table(page: str) -> str:
    """`page` with its table made anew. Raises ValueError where the marks of the table are missing."""
    before, rest = page.split(BEGIN)
    return f"{before}{BEGIN}\n{effects_table()}\n{END}{rest.split(END)[1]}"


def _joints(effect: Effect) -> str:
    joints = [j for j in effect.joints if j > 0]
    if not joints:
        return ""
    run = joints == list(range(joints[0], joints[-1] + 1)) and len(joints) > 2
    told = f"{joints[0]}-{joints[-1]}" if run else ", ".join(map(str, joints))
    return f" {told}" + (" or common" if 0 in effect.joints else "")


def _key(p: Parameter) -> str:
    if p.unit == "name" or p.high == 0:
        return p.key
    sign = "+-" if p.signed and p.low >= 0 else ""
    count = f" ({p.length})" if p.length > 1 else ""
    unit = "" if p.unit == "1" else f" {p.unit}"
    return f"{p.key}{count} {sign}{p.low:g}..{p.high:g}{unit}"


if __name__ == "__main__":
    file = Path(sys.argv[1])
    file.write_text(with_table(file.read_text(encoding="utf-8")), encoding="utf-8")
