"""What speaks against a named effect: values no machine shows, and terms that cancel each other; its fit of all readings, and the
errors of its folds."""

from collections.abc import Sequence

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.channel_system import Channel, HeldOut, effects_key
from ocp.diagnose.engine.findings import Name
from ocp.diagnose.engine.linearisation import Linearisation, positive_of
from ocp.effects.effect import Active
from robots.errors import Infeasible
from robots.pose import Array


def implausible(active: Sequence[Active]) -> list[tuple[Name, str]]:
    """Names with values over three times the range, two standard errors sure, with what is wrong."""
    found = []
    for one in active:
        upper = np.asarray(one.effect.prior_sd, float)
        sd = np.sqrt(np.maximum(np.diag(one.covariance), 0.0))
        if (np.abs(one.a) - rules.IMPLAUSIBLE_SD * sd > rules.IMPLAUSIBLE * upper).any():
            found.append((Name(*one.key), "its value is over three times what real cells show"))
        for a, s, positive, key in zip(one.a, sd, positive_of(one.effect), one.effect.coefficients, strict=True):
            if positive and a < -rules.WRONG_SIGN_SD * s:
                name = one.effect.parameters[0].key if key == "share" else key
                found.append((Name(*one.key), f"{name} comes out with the wrong sign"))
        why = one.effect.doubt(one.a, sd, one.scanned) if one.effect.doubt else ""
        if why:
            found.append((Name(*one.key), why))
    return found


def cancelling(names: Sequence[Name], signatures: Sequence[Array]) -> list[tuple[Name, str]]:
    """Pairs of effects whose signatures (N,) all but cancel: each stands for what the other overdoes."""
    found = []
    for i in range(len(names)):
        for k in range(i):
            a, b = signatures[i], signatures[k]
            if np.linalg.norm(a + b) < rules.CANCELS * min(np.linalg.norm(a), np.linalg.norm(b)):
                found.append((names[i], f"it all but cancels {names[k]}"))
    return found


def refitted(baseline: Sequence[Channel], problem: Linearisation, active: tuple[Active, ...]) -> tuple[Channel, ...] | None:
    """Channels of all readings with the effects active; those of the search where they are that already; None where no fit with
    them comes to rest."""
    found = []
    for whole, searched in zip(baseline, problem.channels, strict=True):
        visible = tuple(a for a in active if not whole.blind(a.effect))
        same = effects_key(searched.active, 2) == effects_key(visible, 2) and len(searched.gap()) == len(whole.gap())
        try:
            found.append(searched if same else whole.with_active(active))
        except Infeasible:
            return None
    return tuple(found)


def errors_of_folds(channels: Sequence[Channel], active: tuple[Active, ...]) -> dict[str, tuple[HeldOut, ...]]:
    """Every fold of every channel that can be judged."""
    judged = {c.name: [c.held_out(fold, active) for fold in c.folds()] for c in channels}
    return {name: tuple(h for h in found if h is not None) for name, found in judged.items()}
