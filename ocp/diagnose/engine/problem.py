"""One linearisation of all channels: library and kernels projected together, ready to be searched; sets back to effects."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ocp.diagnose.engine.beam import Key, Weighed
from ocp.diagnose.engine.channel_system import Channel
from ocp.diagnose.engine.evidence import coefficients_given, size_grid
from ocp.diagnose.engine.families import candidates, library_families, put_back
from ocp.diagnose.engine.findings import Name, Options
from ocp.diagnose.engine.kernels import Kernel, kernels
from ocp.diagnose.engine.pool import CandidatePool, Family, Given, Member, given, make_pool
from ocp.diagnose.engine.projection import Stack, stack
from ocp.diagnose.rules import BROKEN_ORDER_ODDS
from ocp.effects.effect import Active, Effect
from robots.pose import Array


@dataclass(frozen=True)
class Linearisation:
    """Channels about their current fits, their stack and the pool of candidates (y about zero effects)."""

    channels: tuple[Channel, ...]
    stack: Stack
    pool: CandidatePool

    @property
    def index(self) -> dict[Name, int]:
        """Family by name."""
        return {f.name: i for i, f in enumerate(self.pool.families)}

    def names(self, key: Key) -> tuple[Name, ...]:
        """Names of a set of families, sorted; kernels are named after their condition."""
        return tuple(sorted(self.pool.families[f].name for f in key))

    def named(self, weighed: Weighed) -> list[Member]:
        """Members from the library."""
        return [m for m in weighed.members if self.pool.families[m.family].effect is not None]

    def values(self, weighed: Weighed) -> tuple[Active, ...]:
        """Effects of a set with their values and covariance, everything in the set fitted together, priors at the upper ends;
        in the order of their names."""
        members = list(weighed.members)
        if not members:
            return ()
        C = np.hstack([self.pool.columns(m) for m in members])
        mean, covariance = coefficients_given(C, self.pool.y, np.ones(C.shape[1]))
        found, start = [], 0
        for m in members:
            family = self.pool.families[m.family]
            block = slice(start, start + len(family.scale))
            start = block.stop
            if family.effect is not None:
                scaled = covariance[block, block] * np.outer(family.scale, family.scale)
                scanned = family.scans[m.variant]
                found.append(Active(family.effect, family.name.joint, mean[block] * family.scale, scanned, scaled))
        return tuple(sorted(found, key=lambda a: a.key))

    def taken(self, weighed: Weighed) -> Given:
        """The set as given, with priors at the upper ends: what a fit of it takes from the data."""
        return given(self.pool, [Member(m.family, m.variant, 1.0) for m in weighed.members])


def linearised(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options) -> Linearisation:
    """Linearise about the channels' current fits."""
    back = np.concatenate([put_back([c], c.active) for c in channels])
    found = candidates(channels, library, options)
    stacked = stack(tuple(channels), back)
    families = library_families(found, stacked, options)
    families += kernel_families(channels, stacked, options)
    return Linearisation(tuple(channels), stacked, make_pool(stacked.y, stacked.freedom, families))


def kernel_families(channels: Sequence[Channel], stacked: Stack, options: Options) -> list[Family]:
    """Library-free kernels of each channel as candidates for an effect outside the catalogue."""
    made = list(kernel_columns(channels, stacked))
    kinds: dict[str, int] = {}
    for _, kernel, _ in made:
        kinds[_kind(kernel)] = kinds.get(_kind(kernel), 0) + 1
    found = []
    for name, kernel, columns in made:
        share = options.prior_unknown / len(kinds) / kinds[_kind(kernel)]
        share *= BROKEN_ORDER_ODDS if "ripple" in kernel.where else 1.0
        share *= columns.shape[1] / max(kernel.among, columns.shape[1])
        m, sizes = columns.shape[2], size_grid(kernel.low / kernel.high)
        scans = tuple({"kernel": v} for v in range(columns.shape[1]))
        full, scale, odds = Name(f"?{name}", kernel.joint), np.full(m, kernel.high), float(np.log(share))
        found.append(Family(full, None, scans, columns * kernel.high, scale, sizes, np.zeros(m, bool), odds, kernel.where))
    return found


def kernel_columns(channels: Sequence[Channel], stacked: Stack) -> Iterator[tuple[str, Kernel, Array]]:
    """Name, kernel and projected columns (N, V, m) per unit size, zero in other channels."""
    for channel, block in zip(channels, stacked.blocks, strict=True):
        for kernel in kernels(channel.conditions):
            n, k, V, m = kernel.changes.shape
            whole = np.zeros((len(stacked.y), V * m))
            whole[block] = channel.whiten(kernel.changes.reshape(n, k, V * m))
            yield f"{channel.name}/{kernel.where}/{kernel.source}", kernel, stacked.apply(whole).reshape(-1, V, m)


def _kind(kernel: Kernel) -> str:
    return f"{kernel.source}:{''.join(c for c in kernel.where if not c.isdigit())}"
