"""Effects, conditions and figures of a diagnosis as a person says them."""

from collections.abc import Mapping, Sequence
from typing import Any

from ocp.calibrate.report.view import listed
from ocp.diagnose.engine.findings import Name
from ocp.effects.catalogue import library

SHORT = {"tracker": "tracker", "force": "force", "joint": "link encoders"}
DEPENDS = {
    "approach": "the direction of approach of joint",
    "q": "the angle of joint",
    "motor": "the motor angle of joint",
    "tau": "the load of joint",
    "step": "how far it came from the last reading, of joint",
    "moment": "the weight's moment across the axis of joint",
}
PLAIN = {
    "wait": "the time since the last reading",
    "range": "the distance from the tracker",
    "target": "the reflector nest",
    "sight": "the side from which a reflector is seen",
    "azimuth": "the tracker's azimuth",
    "elevation": "the tracker's elevation",
}


def effect_words(name: Name) -> str:
    """An effect in words: 'backlash of joint 5'."""
    effect = library().get(name.effect)
    if effect is None:
        return str(name)
    return effect.title.format(joint=name.joint) if name.joint else effect.title.replace("joint {joint}", "all joints")


def effects_words(names: Sequence[Name]) -> str:
    """'backlash of joint 5 and growth of all lengths with temperature'."""
    return listed([effect_words(name) for name in names]) if names else "nothing"


def figure(value: float) -> str:
    """Three significant digits without an exponent."""
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def percent(share: float) -> str:
    """A share of one in percent; certainty is never claimed."""
    return "over 99.9 %" if share > 0.999 else "below 0.1 %" if share < 0.001 else f"{100 * share:.{1 if share > 0.99 else 0}f} %"


def condition_words(name: str) -> str:
    """A condition in words: 'approach5' is the direction of approach of joint 5."""
    stem, digits = name.rstrip("0123456789"), name[len(name.rstrip("0123456789")) :]
    return f"{DEPENDS[stem]} {digits}" if digits and stem in DEPENDS else PLAIN.get(name, name.replace("_", " "))


def values_words(values: Mapping[str, Any], deviations: Mapping[str, Any]) -> str:
    """'half_width_rad 2.1e-4 ± 4e-6'."""
    parts = []
    for key, value in values.items():
        sd = deviations.get(key)
        shown = _number_words(value)
        if isinstance(sd, float):
            shown += f" ± {sd:.2g}"
        elif isinstance(sd, list | tuple):
            shown = f"({shown}) ± ({', '.join(f'{s:.2g}' for s in sd)})"
        parts.append(f"{key} {shown}")
    return ", ".join(parts)


def _number_words(value: Any) -> str:
    if isinstance(value, str):
        return value
    return ", ".join(f"{v:.3g}" for v in value) if isinstance(value, list | tuple) else f"{value:.4g}"
