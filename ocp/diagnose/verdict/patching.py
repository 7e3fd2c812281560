"""A patch for what has no name: the kernels that stand for it as a correction, with what it promises and where it holds.

What stands for something outside the catalogue is a sum of a kernel's features (`ocp.diagnose.engine.kernels`). As a patch
(`ocp.effects.patch`) it is fitted with geometry and names like any effect, judged on new conditions like one, and written only
where the low end of its promise is above zero. Beyond the measured range it fades; what it may be there is in sigma, as wide as
the prior of its features.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import Search
from ocp.diagnose.engine.channel_system import Channel, ReadingConditions
from ocp.diagnose.engine.evidence import stack
from ocp.diagnose.engine.findings import Alternative, Name
from ocp.diagnose.engine.kernels import is_periodic, kernels, measured_ranges, middle_of
from ocp.diagnose.engine.linearisation import Linearisation, kernel_families
from ocp.diagnose.engine.pool import given, make_pool, scan
from ocp.effects.effect import Active, effects_key
from ocp.effects.patch import ON_ARM, ON_BEAM, PATCH, conditions_of, is_patch, make_patch
from robots.errors import Infeasible


def as_patch(name: Name, variant: int, size: float, channel: Channel) -> Active | None:
    """A kernel as a patch of zero weights, prior sd `size` of its coefficients, a reading's as those that are there already: of
    the force, or of what the sensor shows beside it; None where no patch can hold it."""
    signal, where, source = name.effect.removeprefix("?").split("/")
    c, more, middle = channel.conditions, {}, 0.0
    if signal != channel.name or c.reference is None:
        return None
    kernel = next((k for k in kernels(c) if (k.where, k.source, k.joint) == (where, source, name.joint)), None)
    if kernel is None or not (features := kernel.words(variant)):
        return None
    if source == "reading":
        there = [a.scanned["source"] for a in channel.active if is_patch(a.effect)]
        alone = "sensor" in there if there else variant == 1 and c.pressed is not None and not is_periodic(where)
        source = "sensor" if alone else "force"
    elif source == "axis":
        source = f"axis {('still', 'turning')[variant]}"
    elif source == "beam" and c.point is not None:
        middle, flat = middle_of(c.point), np.linalg.norm(c.point[:, :2], axis=1)
        more["about"] = (middle, float(flat.mean()), float(np.linalg.norm(c.point, axis=1).mean()))
        source = ON_BEAM[variant]
    limits = measured_ranges(c, middle)
    if not limits.keys() >= set(conditions_of(features)):
        return None
    return make_patch(source, where, name.joint, features, limits, size, signal, **more)


def patches_of(problem: Linearisation, search: Search, where: Mapping[Name, float]) -> tuple[Alternative, ...]:
    """What may stand for something outside the catalogue, unfitted, with its share of the probability, the likeliest first;
    where: kernels by name with theirs. Empty where the likeliest can be no patch.

    Where it warmed up in the course of time, whatever varies with temperature varies with time as well, and no reading tells
    which of the two it is: a kernel of one shares what it has with the same kernel of the other."""
    total, found = sum(where.values()), dict[Name, Alternative]()
    ordered = sorted(where, key=lambda n: -where[n])[: rules.MOST_FOLLOWED]
    channel = next((c for c in problem.channels for name in ordered[:1] if name.effect.startswith(f"?{c.name}/")), None)
    for name in ordered:
        member = problem.member(problem.best_with(search.sets, name), name)
        family = problem.pool.families[member.family]
        variant, size = int(family.scans[member.variant]["kernel"]), member.size * float(family.scale[0])
        patch = None if channel is None else as_patch(name, variant, size, channel)
        if channel is None or (patch is None and not found):
            return ()
        if patch is None or name in found or where[name] < rules.FOLLOWED * total:
            continue
        other = in_the_other_course(name, channel.conditions)
        twin = None if other is None else as_patch(other, variant, size, channel)
        if other is None or twin is None:
            found[name] = Alternative(where[name], (patch,))
        else:
            half = (where[name] + where.get(other, 0.0)) / 2.0
            found |= {name: Alternative(half, (patch,)), other: Alternative(half, (twin,))}
    return tuple(sorted(found.values(), key=lambda one: -one.probability)[: rules.MOST_FOLLOWED])


def in_the_other_course(name: Name, c: ReadingConditions) -> Name | None:
    """A kernel of temperature as one of time and the other way round, where in the readings one is a function of the other."""
    if c.clock is None or c.temperature is None or np.ptp(c.clock) == 0 or np.ptp(c.temperature) == 0:
        return None
    from scipy.stats import spearmanr  # half a second, which a diagnosis that patches nothing need not pay

    if abs(spearmanr(c.clock, c.temperature).statistic) < rules.ONE_COURSE:
        return None
    course = "clock" if name.effect.endswith("/reading") else "time"
    swapped = {"temperature": course, course: "temperature"}
    there = next((word for word in swapped if word in name.effect and f"_{word}" not in name.effect), None)
    return None if there is None else replace(name, effect=name.effect.replace(there, swapped[there]))


def with_further(channel: Channel) -> Channel:
    """A channel whose patch leaves something with further patches, as long as a kernel gains more than it costs; of a force log
    all act on the arm, or none does: what it says of an arm is one direction."""
    own = {one.scanned["source"] in ON_ARM for one in channel.active if is_patch(one.effect)}
    kept = "" if channel.name == "tracker" else "joint" if own == {True} else "reading"
    for _ in range(rules.MOST_PATCHES // (1 if channel.name == "tracker" else 2) - 1):
        stacked = stack((channel,), np.zeros(len(channel.system.residual)))
        families = [f for f in kernel_families((channel,), stacked) if f.name.effect.endswith(kept)]
        pool = make_pool(stacked.y, stacked.freedom, families)
        told = scan(pool, given(pool, ()))
        value = told.log + np.array([f.log_odds for f in families])
        k = int(np.argmax(value))
        variant, size = int(told.variant[k]), float(told.size[k]) * float(families[k].scale[0])
        patch = as_patch(families[k].name, variant, size, channel) if value[k] > rules.BACKGROUND_GAIN else None
        if patch is None or patch.key in {a.key for a in channel.active}:
            break
        try:
            channel = channel.with_active((*channel.active, patch))
        except Infeasible:  # no fit with it comes to rest
            break
    return channel


def read_beside(one: Active) -> Active:
    """The patch of a force as one of what the sensor shows beside it."""
    _, where, _, size, *_ = one.effect.name.removeprefix(PATCH).split("|")
    limits = {name: (low, high) for name, low, high in one.scanned["range"]}
    return make_patch("sensor", where, 0, one.scanned["features"], limits, float(size), one.scanned["signal"])


def seen_by(signal: str, alternatives: Sequence[Alternative]) -> tuple[Alternative, ...]:
    """Alternatives as one signal sees them: without the patches of others, those that are then alike as one."""
    found: dict[tuple[object, ...], Alternative] = {}
    for one in alternatives:
        active = tuple(a for a in one.active if not is_patch(a.effect) or a.scanned["signal"] == signal)
        same = found.get(key := effects_key(active))
        found[key] = replace(same or one, active=active, probability=one.probability + (same.probability if same else 0.0))
    return tuple(found.values())


def unfaded(active: Sequence[Active]) -> tuple[Active, ...]:
    """The same effects with patches that stay beyond what was measured as they are at its edge."""
    return tuple(replace(a, scanned={**a.scanned, "stays": True}) if is_patch(a.effect) else a for a in active)
