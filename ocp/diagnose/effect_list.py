"""The catalogue as text: every effect with its keys, units, usual range and the signal that shows it."""

from ocp.effects.effect import Effect, Parameter
from ocp.effects.library import library


def effect_list() -> str:
    """One line an effect; a new file in ocp/effects appears here by itself."""
    rows = [(f"{e.name}{_joints(e)}", ", ".join(_range(p) for p in e.parameters), _signals(e)) for e in library().values()]
    width = max(len(row[0]) for row in rows)
    return "\n".join(f"{name:<{width}}  {shown:<22}  {keys}" for name, keys, shown in rows)


def _joints(effect: Effect) -> str:
    """':1-6', ':2', or nothing for effects of no joint."""
    joints = [j for j in effect.joints if j]
    if not joints:
        return ""
    run = joints == list(range(joints[0], joints[-1] + 1)) and len(joints) > 1
    return f":{joints[0]}-{joints[-1]}" if run else ":" + ",".join(map(str, joints))


def _range(p: Parameter) -> str:
    if p.unit == "name":
        return p.key
    sign = "+-" if p.signed and p.low > 0 else ""
    length = f" ({p.length})" if p.length > 1 else ""
    return f"{p.key}{length} {sign}{p.low:g}..{p.high:g}"


def _signals(effect: Effect) -> str:
    """Signals that may show it."""
    arm = ["tracker", "force"] if effect.on_arm else []
    arm += ["joints"] if effect.joint is not None else []
    arm += ["tracker"] if effect.reading is not None and not effect.on_arm else []
    return " ".join(dict.fromkeys(arm + (["force"] if effect.on_contact else [])))
