"""What every scene on a page is made of: WebGL scripts and style (folder scene/), and data packed for them.

The page's script gets one JSON object with the large arrays as base64 of little-endian numbers, made safe to stand inside a
<script> element whatever a user's file is called.
"""

import base64
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

_KIT = Path(__file__).parent / "scene"
_SCRIPTS = ("math.js", "mesh.js", "scene.js", "orbit.js")


def scene_style() -> str:
    """The style of a scene, its controls and its readout."""
    return (_KIT / "viewer.css").read_text(encoding="utf-8")


def scene_script(own: Sequence[Path]) -> str:
    """The kit's scripts, then a page's own, in a scope of their own."""
    script = "\n".join(path.read_text(encoding="utf-8") for path in (*(_KIT / name for name in _SCRIPTS), *own))
    return f'(function () {{\n"use strict";\n{script}}})();\n'


def encode(array: ArrayLike, dtype: str = "<f4") -> dict[str, Any]:
    """Array as {"dtype", "shape", "data"}: numbers little-endian in row order, base64."""
    packed = np.ascontiguousarray(array, dtype=dtype)
    return {"dtype": dtype, "shape": list(packed.shape), "data": base64.b64encode(packed.tobytes()).decode("ascii")}


def encode_index(array: ArrayLike, count: int) -> dict[str, Any]:
    """Indices below `count`, in as few bytes as they need."""
    return encode(array, "<u2" if count < 2**16 else "<u4")


def script_json(payload: Any) -> str:
    """JSON that cannot end the <script> element or open a comment in it: < > & are escaped.

    Infinities and nan are not JSON: ValueError. In arrays they travel as bits.
    """
    text = json.dumps(payload, ensure_ascii=True, allow_nan=False, sort_keys=True, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
