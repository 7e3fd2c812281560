"""A fitted wheel law kept on disk: its arrays as they are, its numbers as JSON text, nothing pickled."""

import json
from collections.abc import Callable
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from ocp.contact.wheel.cover import Cover, WheelGeometry
from ocp.contact.wheel.law import LawError, WheelLaw
from ocp.contact.wheel.law_fit import Domain
from ocp.shell.cache import content_key, remember

VERSION = "wheel law 1"  # raise it when the fit changes


def remembered_law(cover: Cover, domain: Domain, fit: Callable[[], WheelLaw]) -> WheelLaw:
    """The law for `cover` over `domain`: kept under everything it depends on, else fitted."""
    key = content_key(
        VERSION, json.dumps(asdict(cover.geometry)), cover.spectrum, domain.curvature, domain.turn, domain.lateral,
        domain.tilt, domain.force,
    )  # fmt: skip
    return _unpacked(remember("law", key, lambda: _packed(fit())))


def _packed(law: WheelLaw) -> dict[str, np.ndarray]:
    arrays = {f.name: getattr(law, f.name) for f in fields(law) if isinstance(getattr(law, f.name), np.ndarray)}
    numbers = {f.name: getattr(law, f.name) for f in fields(law) if f.name not in arrays}
    numbers["geometry"], numbers["error"] = asdict(law.geometry), asdict(law.error)
    return arrays | {"numbers": np.array(json.dumps(numbers, default=float))}


def _unpacked(entry: dict[str, np.ndarray]) -> WheelLaw:
    numbers: dict[str, Any] = json.loads(str(entry["numbers"]))
    numbers["geometry"], numbers["error"] = WheelGeometry(**numbers["geometry"]), LawError(**numbers["error"])
    numbers["limits"] = {name: (float(low), float(high)) for name, (low, high) in numbers["limits"].items()}
    arrays: dict[str, Any] = {name: value for name, value in entry.items() if name != "numbers"}
    return WheelLaw(**numbers, **arrays)
