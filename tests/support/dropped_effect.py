"""An effect that the catalogue holds because a file of it was dropped beside the others."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

import ocp.effects
from ocp.effects.catalogue import forget_library


@contextmanager
def dropped_effect(folder: Path, patch: pytest.MonkeyPatch, joints: str, size: str, form: str) -> Iterator[None]:
    """`brand_new`, a joint's error k times `form`, while the context lasts."""
    (folder / "brand_new.py").write_text(
        '"""A joint is off by something new."""\n'
        "from ocp.effects.forms import at_joint, proportional\nfrom ocp.effects.effect import Effect, Parameter\n"
        'EFFECT = Effect(name="brand_new", title="new at joint {joint}", subsystem="joint", physics="dq = k f.",\n'
        f"    joints={joints}, joint=lambda x, j, scanned: at_joint(j, {form}),\n"
        f'    **proportional(Parameter("k", "1/rad", 1e-5, {size})))\n'
    )
    patch.setattr(ocp.effects, "__path__", [*ocp.effects.__path__, str(folder)])
    forget_library()
    try:
        yield
    finally:
        forget_library()
