"""Candidates of the library for all channels together: columns stacked, projected, with their priors."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ocp.diagnose.engine.channel_system import Channel, scan_key
from ocp.diagnose.engine.evidence import SIZES, size_grid
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.pool import Family
from ocp.diagnose.engine.projection import Stack
from ocp.diagnose.engine.visible import Rival
from ocp.diagnose.rules import BACKGROUND_PLAY, BACKGROUND_RIPPLE, PLAY_ODDS, RIPPLE_ODDS, SEEN_LAMBDA
from ocp.effects.effect import Active, Effect, Scanned
from robots.pose import Array


def names_of(library: Mapping[str, Effect], options: Options) -> list[tuple[Effect, int]]:
    """Every effect at every joint it may have, impostors left out."""
    places = [(e, j) for n, e in library.items() if n not in options.withheld for j in (e.joints or (0,))]
    return [(e, j) for e, j in places if Name(e.name, j) not in options.barred]


@dataclass(frozen=True)
class Candidate:
    """An effect at a joint that the channels can see: scanned values of its variants, whitened columns (N, V, m) per unit
    coefficient; among: of how many variants these are the most telling (0: all)."""

    effect: Effect
    joint: int
    scans: tuple[Scanned, ...]
    columns: Array
    among: int = 0


def candidates(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options) -> list[Candidate]:
    """Everything of the library that any channel can see."""
    found = []
    held = {a.key: a.scanned for c in channels for a in c.active}
    for effect, joint in names_of(library, options):
        columns, scans = stacked_columns(channels, effect, joint, None)
        refined = held.get((effect.name, joint))
        if scans and refined is not None and scan_key(refined) not in {scan_key(s) for s in scans}:
            more, _ = stacked_columns(channels, effect, joint, [refined])
            columns, scans = np.concatenate([columns, more], axis=1), (*scans, refined)
        if scans:
            among = max(c.surroundings.among.get(effect.name, 0) for c in channels)
            found.append(Candidate(effect, joint, scans, columns, among))
    return found


def play(found: Sequence[Candidate], stack: Stack) -> list[Family]:
    """A little play in all joints at once, as one family that stays in the background: its size is one number for the machine, so
    that one joint with much more than the others stands out."""
    parts = [c for c in found if len(c.scans) == 1 and c.effect.size == 1 and "approach" in c.effect.needs and c.joint]
    if len(parts) < 3:  # no population
        return []
    columns = np.hstack([c.columns[:, 0] * c.effect.prior_sd[0] * ratio_of(c.effect, c.scans) for c in parts])
    m = columns.shape[1]
    odds, positive = float(np.log(PLAY_ODDS)), np.ones(m, bool)
    projected = stack.apply(columns)[:, None]
    return [Family(Name("~play"), None, ({},), projected, np.ones(m), BACKGROUND_PLAY, positive, odds, background=True)]


def library_families(found: Sequence[Candidate], stack: Stack, options: Options) -> list[Family]:
    """Families with projected columns; ripples of many orders with a twin each that stays in the background."""
    families = []
    kinds = len({c.effect.name for c in found})
    for c in found:
        n, count, m = c.columns.shape
        projected = stack.apply(c.columns.reshape(n, -1)).reshape(n, count, m)
        visible = ((projected * np.asarray(c.effect.prior_sd)) ** 2).sum(axis=0).max(axis=1) > SEEN_LAMBDA
        if not visible.any():
            continue
        scans = tuple(s for s, k in zip(c.scans, visible, strict=True) if k)
        odds = log_odds(c.effect, kinds, options) + float(np.log(len(c.scans) / max(c.among, len(c.scans))))
        family = family_of(c.effect, c.joint, scans, projected if visible.all() else projected[:, visible], odds)
        family = replace(family, among=c.among)
        families.append(family)
        if has_twin(c.effect, c.joint, scans):
            small = np.full(SIZES, BACKGROUND_RIPPLE * ratio_of(c.effect, scans))
            twin, odds = Name(f"~{c.effect.name}", c.joint), float(np.log(RIPPLE_ODDS))
            families.append(replace(family, name=twin, effect=None, sizes=small, log_odds=odds, background=True))
    return families + play(found, stack)


def rival_of(effect: Effect, joint: int, scans: Sequence[Scanned]) -> Rival | None:
    """What of the background takes an effect's gap: its own twin below the usual range, or play in all joints."""
    if has_twin(effect, joint, scans):
        return Rival(np.full(SIZES, BACKGROUND_RIPPLE * ratio_of(effect, scans)), float(np.log(RIPPLE_ODDS)), 0, len(scans))
    if joint and "approach" in effect.needs:
        return Rival(BACKGROUND_PLAY * ratio_of(effect, scans), float(np.log(PLAY_ODDS)), 6 - effect.size, 1)
    return None


def has_twin(effect: Effect, joint: int, scans: Sequence[Scanned]) -> bool:
    """Whether every machine has a little of it: ripples of many orders."""
    return len(scans) > 1 and joint > 0 and "amplitude_rad" in {p.key for p in effect.parameters}


def log_odds(effect: Effect, kinds: int, options: Options) -> float:
    """Prior odds of an effect at one joint, `kinds` effects being possible."""
    return float(np.log(options.prior_effects / kinds / len(effect.places)))


def family_of(effect: Effect, joint: int, scans: Sequence[Scanned], projected: Array, odds: float) -> Family:
    """A family from projected columns (N, V, m) per unit coefficient."""
    scale = np.asarray(effect.prior_sd, float)
    name, sizes = Name(effect.name, joint), size_grid(ratio_of(effect, scans))
    return Family(name, effect, tuple(scans), projected * scale, scale, sizes, positive_of(effect), odds)


def ratio_of(effect: Effect, scans: Sequence[Scanned]) -> float:
    """Lower over upper end of the typical range, the least over the parameters that are sizes."""
    sizes = [p.low / p.high for p in effect.parameters if p.low > 0 and p.key not in scans[0]]
    return float(np.clip(min(sizes, default=0.03), 0.01, 0.5))


def positive_of(effect: Effect) -> Array:
    """Coefficients (m,) that may not be negative: those that are an unsigned parameter, and the share of the only one. A
    parameter with a sign of its own beside it (share, share_sign) may be either."""
    unsigned = {p.key for p in effect.parameters if not p.signed and p.length == 1}
    unsigned -= {p.key.removesuffix("_sign") for p in effect.parameters if p.key.endswith("_sign")}
    if effect.coefficients == ("share",) and len(effect.parameters) == 1:
        return np.array([bool(unsigned)])
    return np.array([c in unsigned for c in effect.coefficients])


def stacked_columns(
    channels: Sequence[Channel], effect: Effect, joint: int, scans: Sequence[Scanned] | None
) -> tuple[Array, tuple[Scanned, ...]]:
    """Whitened columns (N, V, m) of all channels one below the other, and the scanned values of each variant; zero where a
    channel cannot see the effect. Without `scans` the union of the channels' own."""
    if scans is None and len(channels) > 1:
        scans = _union(s.scanned for c in channels for s in c.variants(effect, joint))
    parts = [c.variants(effect, joint, scans) for c in channels]
    chosen = tuple(scans) if scans is not None else tuple(v.scanned for v in parts[0])
    if not chosen or not any(parts):
        return np.zeros((0, 0, effect.size)), ()
    rows = []
    for channel, variants in zip(channels, parts, strict=True):
        if variants:
            rows.append(np.stack([v.columns for v in variants], axis=1))
        else:
            rows.append(np.zeros((len(channel.system.residual), len(chosen), effect.size)))
    return np.concatenate(rows), chosen


def _union(scans: Iterable[Scanned]) -> list[Scanned]:
    """Each set of scanned values once, in order."""
    return list({scan_key(s): s for s in scans}.values())


def put_back(channels: Sequence[Channel], active: Sequence[Active]) -> Array:
    """What the active effects add to the whitened predictions (N,)."""
    total = np.zeros(sum(len(c.system.residual) for c in channels))
    for one in active:
        columns, scans = stacked_columns(channels, one.effect, one.joint, [one.scanned])
        if scans:
            total += columns[:, 0] @ one.a
    return total
