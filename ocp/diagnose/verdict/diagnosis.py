"""The main entry of the diagnosis: search, from weighed sets to the findings, and what speaks against a named effect: values no
machine shows, and terms that cancel each other."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np
from scipy.special import fdtrc

from ocp.diagnose import rules
from ocp.diagnose.engine.beam import NOTHING, Search, Weighed
from ocp.diagnose.engine.channel_system import Channel, HeldOut, Resting, Scattering, WeighedReadings
from ocp.diagnose.engine.findings import Diagnosis, Explanation, KernelTest, Location, Name, Options, Ranked, Screened
from ocp.diagnose.engine.linearisation import Linearisation, linearised, names_of, smallest_seen, stacked_columns
from ocp.diagnose.engine.pool import Family, given
from ocp.diagnose.engine.search import Diverged, search_and_refit
from ocp.diagnose.engine.selection import misses_far_more_than_noise, select_effects
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.location import budget, kernel_tests, of_effect, of_group, of_kernel, of_tests, spectra
from ocp.diagnose.verdict.patching import patches_of
from ocp.diagnose.verdict.probabilities import Names, Posterior, alternatives, classes_of, posterior, suspected, without_kernels
from ocp.effects.effect import Active, Effect, effects_key
from robots.errors import Infeasible
from robots.pose import Array

USUAL = Options()
NO_REST = "no fit with it comes to rest"
NONE_RESTS = f"{rules.HOPELESS_FITS} fits in a row come to no rest, so no other name was tried"


def diagnose_channels(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options = USUAL) -> Diagnosis:
    """Where the gap of all channels lies, which effects of `library` cause it, none, or none of these."""
    baseline = tuple(c.with_active(()) if c.active else c for c in channels)
    # Evidence compares minima: where the believed cell's fit has none, a name says nothing.
    lost = {c.name: c for c in baseline if isinstance(c, Resting) and not c.rests}
    if len(lost) == len(baseline):
        library = {}
    elif lost:
        return _scattering(_without(lost, baseline, library, options))
    few = tuple(_thinned(c, rules.MOST_SEARCHED) for c in baseline)
    diverged = Diverged()
    first = linearised(few, library, options)
    problem, search = search_and_refit(first, library, options, diverged, _unknown_leads)
    spoilt = {c.name: c for c in baseline if diverged.hopeless and c.name in diverged.channels}
    if 0 < len(spoilt) < len(baseline):
        return _scattering(_without(spoilt, baseline, library, options), *(f"{name}: {NONE_RESTS}" for name in spoilt))
    if _unknown_leads(problem, search):
        problem, search, refused = select_effects(_thinned(baseline[0], rules.SELECTED_ON), library, options)
        return _scattering(findings(baseline, first, problem, search, library, options, refused))
    found = findings(baseline, first, problem, search, library, options)
    whys = (*(f"{n}: {NO_REST}" for n in diverged.names()), *(f"{name}: {NONE_RESTS}" for name in spoilt))
    return _scattering(replace(found, unknown_reasons=tuple(dict.fromkeys((*found.unknown_reasons, *whys)))))


def _unknown_leads(problem: Linearisation, search: Search) -> bool:
    """Whether, with the names that were found, something else is more likely than not and leaves far more than noise."""
    return posterior(problem, search).p_unknown > rules.LEADS and misses_far_more_than_noise(problem, search)


def _without(
    lost: Mapping[str, Channel], baseline: tuple[Channel, ...], library: Mapping[str, Effect], options: Options
) -> Diagnosis:
    """Findings of the other channels; those by name stay as they are without effects."""
    found = diagnose_channels([c for c in baseline if c.name not in lost], library, options)
    after = {c.name: c for c in found.channels} | dict(lost)
    return replace(found, baseline=baseline, channels=tuple(after[c.name] for c in baseline))


def _scattering(found: Diagnosis, *reasons: str) -> Diagnosis:
    """Findings that take no scatter for noise which no such machine has: what a fit learns of its noise holds whatever is not
    modelled, so that rows of two campaigns under each other would be no gap, nor a log that jumps to and fro, nor a nest that
    flops; told once, though a channel beside it was left out. reasons: others for which something is outside the catalogue."""
    wild = [f"{c.name}: readings scatter {c.scatters}" for c in found.channels if isinstance(c, Scattering) and c.scatters]
    whys = [*reasons, *(f"{why}, and with nothing that was recorded" for why in wild[:1])]
    at = next(((c.name, c.uneven) for c in found.channels if isinstance(c, TrackerChannel) and c.uneven is not None), None)
    whys += [] if at is None else [f"{at[0]}: readings scatter by {at[1].words}"]
    if not whys:
        return found
    told = found.p_unknown > rules.LEADS
    unknown = found.p_unknown if told else 1.0 - (1.0 - found.p_unknown) * (1.0 - rules.SUSPECT)
    found = replace(found, p_unknown=unknown, unknown_reasons=tuple(dict.fromkeys((*found.unknown_reasons, *whys))))
    return found if at is None else _placed(found, of_group(*at), told)


def _placed(found: Diagnosis, at: Location, told: bool) -> Diagnosis:
    """Findings with the place of readings that scatter more than others; told: kernels tell the place already, which stands where
    it is in another part of the cell, or says more than that a joint scatters."""
    if told and found.remainder is not None and (found.remainder.subsystem != at.subsystem or not at.depends_on):
        return found
    return replace(found, remainder=at, location=found.location if found.active else at)


def _thinned(channel: Channel, most: int) -> Channel:
    return channel.thinned(most) if isinstance(channel, WeighedReadings) else channel


def findings(
    baseline: tuple[Channel, ...],
    first: Linearisation,
    problem: Linearisation,
    search: Search,
    library: Mapping[str, Effect],
    options: Options,
    refused: Sequence[tuple[Name, str]] = (),
) -> Diagnosis:
    """All of `Diagnosis`; baseline: all readings without effects; first: the linearisation before anything was accepted;
    refused: impostors with their folds, where the names were chosen by held-out errors. Sets whose names no fit of all readings
    takes go out of the search."""
    failed, tries = dict[Name, str](), 0
    while True:
        found = posterior(problem, search)
        weighed, best = leader(problem, found)
        active = problem.values(weighed)
        channels = refitted(baseline, problem, active)
        if channels is not None:
            break
        failed |= dict.fromkeys(best, NO_REST)
        tries += 1
        names = {problem.index[n] for n in best}
        named = ~(search.kernel | search.background)
        for key in [k for k in search.sets if names <= k or (tries >= rules.HOPELESS_FITS and named[list(k)].any())]:
            del search.sets[key]
    active = as_fitted(active, channels)
    signatures = [problem.signature(weighed, a) for a in active]
    ranked = ranking(problem, search, found, active)
    classes = classes_of(problem, weighed, active) if active else suspected(problem, search, ranked)
    doubts = (*failed.items(), *implausible(active), *cancelling([Name(*a.key) for a in active], signatures))
    hurting = [(n, f"hurts where {f} is left out") for n, f in refused]
    tests = kernel_tests(problem, given(problem.pool, ())) if options.where else []
    known = Weighed(0.0, tuple(problem.named(weighed)))
    after = kernel_tests(problem, problem.taken(known)) if options.where and active else tests
    return Diagnosis(
        explanations=explanations(found, classes),
        ranking=ranked,
        active=active,
        p_none=found.p_none,
        p_unknown=found.p_unknown,
        p_alone=found.beside.get((), 0.0),
        classes=classes,
        location=place(problem, found, active, signatures, tests),
        remainder=place(problem, found, (), (), after) if found.p_unknown > rules.LEADS else of_tests(after),
        budget=tuple(budget(problem, tests, problem.taken(search.sets[search.best()[0]]))),
        kernels=tuple(tests),
        left_over=tuple(after),
        spectrum=tuple(spectra(problem, problem.pool.y)) if options.where else (),
        screened=screened(first),
        impostors=tuple(refused),
        unknown_reasons=tuple(f"{n}: {why}" for n, why in (*doubts, *hurting)),
        blind=blind(baseline, library, options),
        baseline=baseline,
        channels=channels,
        held_out=errors_of_folds(channels, active) if options.folds and active else {},
        alternatives=alternatives(problem, search, found, (weighed, best), active),
        patches=patches_of(problem, search, found.where) if found.p_unknown > rules.LEADS else (),
        instead=without_kernels(problem, search) if found.p_unknown > rules.LEADS else (),
    )


def leader(problem: Linearisation, found: Posterior) -> tuple[Weighed, Names]:
    """The set whose effects are accepted and its explanation: none, or the one that is most probable with all that differ from it
    by names of one class and are less probable: three words for one cause are no three causes. Without the classes force world 24
    of seed 63 (flange_stiffness and backlash) leaves its backlash out."""
    ordered = sorted(found.probability, key=lambda n: -found.probability[n])[: rules.MOST_FOLLOWED]
    if not ordered:
        return NOTHING, ()
    together = {n: found.probability[n] for n in ordered}
    for names in ordered if found.probability[ordered[0]] < rules.EXPLAINED else ():
        weighed = found.best[names]
        alike = next(g for g in _alike(found, classes_of(problem, weighed, problem.values(weighed))) if names in g)
        if alike[0] == names:  # a weak set is imitated by nearly everything
            together[names] = sum(found.probability[n] for n in alike)
    best = max(ordered, key=lambda n: (round(together[n], 3), found.probability[n]))
    return (NOTHING, ()) if found.p_none >= together[best] else (found.best[best], best)


def explanations(found: Posterior, classes: Sequence[tuple[Name, ...]]) -> tuple[Explanation, ...]:
    """By probability; sets that differ by names of one class are one, under the more probable of its names."""
    each = ((g[0], sum(found.probability[n] for n in g), max(found.best[n].log for n in g)) for g in _alike(found, classes))
    return tuple(sorted((Explanation(*one) for one in each), key=lambda e: -e.probability))


def _alike(found: Posterior, classes: Sequence[tuple[Name, ...]]) -> list[list[Names]]:
    """Explanations in groups that differ by names of one class, the more probable first."""
    head = {name: min(c) for c in classes for name in c}
    groups: dict[Names, list[Names]] = {}
    for names in sorted(found.probability, key=lambda n: -found.probability[n]):
        groups.setdefault(tuple(sorted({head.get(n, n) for n in names})), []).append(names)
    return list(groups.values())


def as_fitted(active: Sequence[Active], channels: Sequence[Channel]) -> tuple[Active, ...]:
    """Effects with the values of the fit where the force alone shows them: a contact is curved. Others stay as they are, beside
    the background that a fit of the arm does not hold: of 160 values of tracker worlds 86 % are within their 90 %, by the fit
    79 %."""
    fits = [[(c.name, a) for c in channels for a in c.active if a.key == one.key] for one in active]
    return tuple(f[0][1] if [n for n, _ in f] == ["force"] else one for one, f in zip(active, fits, strict=True))


def ranking(problem: Linearisation, search: Search, found: Posterior, active: Sequence[Active]) -> tuple[Ranked, ...]:
    """Names by probability to a hundredth, then, where they are probable, by how much of the gap is theirs, else by the evidence
    for them against their absence (not against their being in the background); values of names that are not active are those of
    the best set that has them."""
    ranked, fitted = [], {a.key: a for a in active}
    for name in sorted(found.marginal, key=lambda n: (found.marginal[n] < rules.LEADS, -found.gain[n]))[: rules.RANKED]:
        weighed = problem.best_with(search.sets, name)
        one = next(fitted.get(a.key, a) for a in problem.values(weighed) if a.key == (name.effect, name.joint))
        d, sd = problem.signature(weighed, one), problem.deviations(search.sets, one)
        ranked.append(Ranked(name, min(found.marginal[name], 1.0), found.gain[name], one, float(d @ d), sd))
    return tuple(sorted(ranked, key=lambda r: (-round(r.probability, 2), -r.detectability * (r.probability > rules.LEADS))))


def place(
    problem: Linearisation, found: Posterior, active: Sequence[Active], signatures: Sequence[Array], tests: list[KernelTest]
) -> Location | None:
    """Of the largest named effect, else of the kernel that best stands for an unknown one, else of the tests."""
    if active:
        k = int(np.argmax([d @ d for d in signatures]))
        return of_effect(problem, active[k].effect, active[k].joint, signatures[k])
    if found.where and found.p_unknown > rules.LEADS:
        joint = max(found.where, key=lambda one: sum(p for n, p in found.where.items() if n.joint == one.joint)).joint
        likeliest = max((n for n in found.where if n.joint == joint), key=lambda n: found.where[n])
        signal, where, source = likeliest.effect[1:].split("/")
        return of_kernel(signal, where, source, joint)
    return of_tests(tests)


def screened(problem: Linearisation) -> tuple[Screened, ...]:
    """Score tests of every library effect before anything is accepted."""
    pool, found = problem.pool, []
    total = float(pool.y @ pool.y)
    energies = {f.name: float(np.einsum("nvi,nvi->v", f.columns, f.columns).max()) for f in pool.families if f.effect is not None}
    for i, family in enumerate(pool.families):
        if family.effect is None:
            continue
        g, rows = pool.of(i)
        G, b, V = g.G[rows], g.b[rows], family.columns.shape[1]
        gained = np.einsum("vi,vi->v", b, np.linalg.solve(G + 1e-9 * np.eye(g.m), b[..., None])[..., 0])
        best = int(np.argmax(gained))
        ratio = gained[best] / g.m / max((total - gained[best]) / (pool.freedom - g.m), 1e-9)
        p, among = float(fdtrc(g.m, pool.freedom - g.m, ratio)), max(V, family.among)
        energy = float(np.trace(G[best])) / g.m
        others = np.array([e for n, e in energies.items() if n.effect == family.name.effect and n != family.name]) / g.m
        odds = family.log_odds + float(np.log(among / V))
        smallest = smallest_seen(family.effect, family.name.joint, family.scans, among, odds, energy, others)
        left = share_left(problem, family, best, energy * g.m)
        found.append(Screened(family.name, float(gained[best]), g.m, among, min(1.0, 1 - (1 - p) ** among), smallest, left))
    return tuple(sorted(found, key=lambda s: s.p_value))


def share_left(problem: Linearisation, family: Family, variant: int, projected: float) -> float:
    """Share of lambda that the nuisance leaves of a family's signature; projected: mean square over its coefficients with it."""
    assert family.effect is not None
    columns, scans = stacked_columns(problem.channels, family.effect, family.name.joint, [family.scans[variant]])
    whole = float(np.sum((columns[:, 0] * family.scale) ** 2)) if scans else 0.0
    return projected / whole if whole > 0 else np.nan


def blind(channels: Sequence[Channel], library: Mapping[str, Effect], options: Options) -> tuple[str, ...]:
    """Effects that no channel can see, with the reason of the channel that could in principle."""
    every = [[c.blind(effect) for c in channels] for effect in dict.fromkeys(e for e, _ in names_of(library, options))]
    return tuple(max(reasons, key=lambda r: "column" in r) for reasons in every if all(reasons))


def implausible(active: Sequence[Active]) -> list[tuple[Name, str]]:
    """Names with values over three times the range, two standard errors sure, with what is wrong."""
    found = []
    for one in active:
        sd = np.sqrt(np.maximum(np.diag(one.covariance), 0.0))
        if (np.abs(one.a) - rules.IMPLAUSIBLE_SD * sd > rules.IMPLAUSIBLE * np.array(one.effect.prior_sd)).any():
            found.append((Name(*one.key), "its value is over three times what real cells show"))
        for a, s, positive, key in zip(one.a, sd, one.effect.positive, one.effect.coefficients, strict=True):
            if positive and a < -rules.WRONG_SIGN_SD * s:
                name = one.effect.parameters[0].key if key == "share" else key
                found.append((Name(*one.key), f"{name} comes out with the wrong sign"))
        if one.effect.doubt and (why := one.effect.doubt(one.a, sd, one.scanned)):
            found.append((Name(*one.key), why))
    return found


def cancelling(names: Sequence[Name], signatures: Sequence[Array]) -> list[tuple[Name, str]]:
    """Pairs of effects whose signatures (N,) all but cancel: each stands for what the other overdoes."""
    found = []
    for (other, b), (name, a) in combinations(zip(names, signatures, strict=True), 2):
        if np.linalg.norm(a + b) < rules.CANCELS * min(np.linalg.norm(a), np.linalg.norm(b)):
            found.append((name, f"it all but cancels {other}"))
    return found


def refitted(baseline: Sequence[Channel], problem: Linearisation, active: tuple[Active, ...]) -> tuple[Channel, ...] | None:
    """Channels of all readings with the effects active, the baseline where none is; those of the search where they are that
    already; None where no fit with them comes to rest."""
    with suppress(Infeasible):
        return tuple(_refitted(whole, now, active) for whole, now in zip(baseline, problem.channels, strict=True))
    return None


def _refitted(whole: Channel, searched: Channel, active: tuple[Active, ...]) -> Channel:
    visible = tuple(a for a in active if not whole.blind(a.effect))
    same = effects_key(searched.active, 2) == effects_key(visible, 2) and len(searched.gap()) == len(whole.gap())
    return whole if not visible else searched if same else whole.with_active(active)


def errors_of_folds(channels: Sequence[Channel], active: tuple[Active, ...]) -> dict[str, tuple[HeldOut, ...]]:
    """Every fold of every channel that can be judged."""
    judged = {c.name: [c.held_out(fold, active) for fold in c.folds()] for c in channels}
    return {name: tuple(h for h in found if h is not None) for name, found in judged.items()}
