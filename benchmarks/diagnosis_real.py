"""Diagnosis of three measured robots (../shared/data/real): the figures of docs/diagnosis_real.md.

`python benchmarks/diagnosis_real.py [ur5] [ur10] [kr300] [--splits N] [--only PART]` from the repository root with PYTHONPATH=.
Parts of a tracker campaign: answer (what the command says), terms (named terms on readings left out), selected (what holds where
conditions are left out), weight (which way it acts), angles (free curves of the joints' own angles), held (before and after on
random splits), patched (what is promised of a third that is left out, and what came), days (of the UR10: names learnt on one day,
on the others).
"""

import argparse
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from ocp.diagnose.answering import answer_of, predict_sealed, tracker_channel
from ocp.diagnose.dataset import DataSet, read_data_set, read_sealed
from ocp.diagnose.engine.channel_system import SCALE, HeldOut
from ocp.diagnose.engine.evidence import stack
from ocp.diagnose.engine.findings import Options
from ocp.diagnose.engine.linearisation import candidates
from ocp.diagnose.engine.selection import SelectedEffects, select_on_held_out
from ocp.diagnose.report.verdict_sentence import diagnosis_headline, shrinkage_words
from ocp.diagnose.rules import MOST_SEARCHED
from ocp.diagnose.tracker.channel import TrackerChannel
from ocp.diagnose.verdict.diagnosis import diagnose_channels
from ocp.diagnose.verdict.shrinkage import ANOTHER_DAY, realised
from ocp.effects.catalogue import library
from ocp.effects.effect import Active
from ocp.shell.progress import Phases
from robots.calibration.noise import Noise, reading_covariance
from robots.gravity import GRAVITY
from robots.pose import Array
from robots.tracker_readings import Index
from tests.support.published_campaigns import (
    ACHIEVED,
    TARGET,
    PublishedCampaign,
    held_rows,
    read_campaign,
    write_data_set,
    write_recordings,
)

DATA = Path(__file__).parents[1].parent / "shared" / "data" / "real"
FILES = {"ur5": "ur5_tracker/3D_UR5_uncalibrated_grid_cleaned.csv", "ur10": "ur10_tracker/measurements_grid.csv"}
TERMS = {
    "ur5": (
        "",
        "gear_1x:2",
        "gear_2x:2",
        "encoder_scale:2",
        "joint_compliance:2",
        "joint_compliance:2 joint_compliance:3",
        "joint_compliance:2 gear_1x:2",
        "joint_compliance:2 gear_harmonic:1:13",
        "joint_compliance:2 gear_harmonic:1:14",
    ),
    "ur10": (
        "",
        "gear_1x:2 gear_1x:3",
        "gear_2x:2",
        "joint_compliance:2",
        "joint_compliance:3",
        "joint_compliance:2 joint_compliance:3",
        "joint_compliance:2 joint_compliance:3 gear_harmonic:1:17 gear_harmonic:2:17 gear_harmonic:3:17",
        "gear_2x:2 gear_harmonic:1:17 gear_harmonic:2:17 gear_harmonic:3:17",
    ),
}
READ = 3000  # readings of a campaign at most for the table of terms
STEP, SIZE = np.radians(3.0), 5e-4  # rad: width and one sigma of the curves' points


def data_set(campaign: PublishedCampaign, folder: Path, held: Index | None = None) -> DataSet:
    """The campaign written as a user would have it, and read again."""
    folder.mkdir(parents=True)
    write_data_set(campaign, folder, held)
    return read_data_set(folder)


def effects(spec: str, channel: TrackerChannel) -> tuple[Active, ...]:
    """Effects of a line such as "joint_compliance:2 gear_harmonic:1:17", to be fitted."""
    found = []
    for name in spec.split():
        kind, joint, *order = name.split(":")
        effect = library()[kind]
        scanned = {"order": int(order[0])} if order else effect.scan(int(joint), channel.surroundings)[0]
        found.append(Active(effect, int(joint), np.zeros(effect.size), scanned, np.eye(effect.size)))
    return tuple(found)


def selected_in(channel: TrackerChannel) -> SelectedEffects:
    """What holds where conditions are left out, found on at most MOST_SEARCHED readings."""
    few = channel.thinned(MOST_SEARCHED)
    return select_on_held_out(few.system, candidates((few,), library(), Options()), few.folds())


def told(one: Active) -> str:
    """An effect with its values."""
    parts = ", ".join(f"{k} {v:.3g}" for k, v in one.effect.values(one.a, one.scanned).items() if isinstance(v, float | int))
    return f"{one.effect.name}:{one.joint} ({parts})"


def answer_part(folder: Path) -> None:
    """What `python -m ocp.diagnose` says of a folder."""
    began = time.process_time()
    answer = answer_of(folder, Phases())
    d, gap = answer.diagnosis, answer.gaps[0]
    s = gap.shrinkage
    where = d.location
    print(f"* {diagnosis_headline(answer).verdict} {diagnosis_headline(answer).sentence}")
    print(f"* p_none {d.p_none:.2g}, none of these {d.p_unknown:.3g}; {time.process_time() - began:.0f} s of processor time")
    if where is not None:
        print(f"* where: {where.subsystem}, joint {where.joint}, goes with {', '.join(where.depends_on)}")
    waves = (f"joint {p.joint} {p.order:g} per turn, {1e6 * p.amplitude:.0f} urad (p {p.p_value:.3f})" for p in d.spectrum[:5])
    print("* spectrum:", "; ".join(waves))
    print("* ranking:", "; ".join(f"{told(r.active)} {r.probability:.2f}" for r in d.ranking[:6]))
    print("* in the corrected model:", "; ".join(told(a) for a in d.active) or "nothing")
    print("* impostors:", "; ".join(f"{n} where {f} is left out" for n, f in d.impostors) or "none")
    rms = [float(np.sqrt(np.mean(x**2))) for x in (gap.before, gap.after)]
    sure = "none to predict" if s is None else f"{s.predicted:.2f} ({s.low:.2f} to {s.high:.2f})"
    print(f"* gap {rms[0]:.4f} -> {rms[1]:.4f} {gap.unit} rms, noise {gap.noise_floor:.4f}; shrinkage predicted {sure}")
    blocks = [h for h in d.held_out.get(gap.name, ()) if h.fold.kind == "block"]
    for h in blocks:
        before, after = (SCALE[gap.unit] * np.sqrt(x) for x in h.means[:2])
        print(f"  {h.fold.name} left out: {before:.4g} -> {after:.4g} {gap.unit}")
    if isinstance(gap.baseline, TrackerChannel):
        print("* blocks left out: shrinkage {:.2f} ({:.2f} to {:.2f})".format(*blocked(blocks, gap.baseline)))


def blocked(blocks: Sequence[HeldOut], channel: TrackerChannel) -> tuple[float, float, float]:
    """Shrinkage of the gap beyond the instrument's noise on blocks that were left out, and its 90 % interval: blocks drawn with
    replacement, and their readings. Errors of the joints count as gap here, as the residual is all that tells them."""
    c = channel
    S = reading_covariance(c.readings, c.task.campaign.instrument, Noise(0.0), c.fit.linear.d_joints)
    noise = float(np.trace(S, axis1=1, axis2=2).mean())
    rng = np.random.default_rng(0)

    def shrinkage(parts: Sequence[tuple[Array, Array]]) -> float:
        before, after = (np.concatenate(x).mean() - noise for x in zip(*parts, strict=True))
        return float(1.0 - np.sqrt(max(after, 0.0) / before))

    rows = [(h.rows[0], h.rows[1]) for h in blocks]
    draws = []
    for _ in range(1000):
        picked = [(rows[k], rng.integers(len(rows[k][0]), size=len(rows[k][0]))) for k in rng.integers(len(rows), size=len(rows))]
        draws.append(shrinkage([(b[i], a[i]) for (b, a), i in picked]))
    low, high = np.quantile(draws, (0.05, 0.95))
    return shrinkage(rows), float(low), float(high)


def terms_part(name: str, channel: TrackerChannel) -> None:
    """Named terms on readings that were left out, rms mm."""
    channel = channel.thinned(READ)
    print("| terms | all readings | random | blocks | halves of joints | worst fold against none | there |\n" + "|---" * 7 + "|")
    first: dict[str, float] = {}
    for spec in TERMS[name]:
        fitted = channel.with_active(effects(spec, channel))
        held = [h for h in (fitted.held_out(f, fitted.active) for f in fitted.folds()) if h is not None]
        first = first or {h.fold.name: h.means[1] for h in held}
        kinds = [
            1e3 * np.sqrt(np.mean([h.means[1] for h in held if h.fold.kind == k])) for k in ("random", "block", "joint range")
        ]
        ratio, there = max((float(np.sqrt(h.means[1] / first[h.fold.name])), h.fold.name) for h in held)
        rms = 1e3 * np.sqrt(np.mean(np.sum(fitted.gap() ** 2, axis=1)))
        cells = " | ".join(f"{x:.3f}" for x in (rms, *kinds))
        what = "; ".join(map(told, fitted.active)) or "none"
        print(f"| {what} | {cells} | {ratio:.2f} | {there if spec else ''} |", flush=True)


def selected_part(channel: TrackerChannel) -> None:
    """Forward selection by folds."""
    began = time.process_time()
    found = selected_in(channel)
    print("| accepted | mean log mean square of the folds |\n|---|---|")
    for one, score in zip(found.active, found.scores, strict=True):
        print(f"| {told(one)} | {score:.2f} |")
    print("\n| refused | gain on all readings | fold | its mean square against none | beside |\n|---|---|---|---|---|")
    for r in found.refused:
        print(f"| {r.name} | {r.gain:.0f} | {r.fold} | {r.ratio:.2f} | {r.beside} |")
    print(f"\n{time.process_time() - began:.0f} s of processor time", flush=True)


def weight_part(channel: TrackerChannel) -> None:
    """Which way weight acts, told by joint 2: its torque for a force along each base axis, after projection."""
    c = channel.thinned(READ)
    robot, (_, _, arm) = c.task.campaign.robot, c.seen.groups[0]
    frames = arm.block("frames").reshape(-1, 7, 3, 4)
    torque = np.zeros((len(c.readings), 3))
    for link in range(2, 7):
        lever = frames[:, link, :, :3] @ robot.link_com[link] + frames[:, link, :, 3] - frames[:, 1, :, 3]
        torque += robot.sign[1] * robot.link_mass[link] * GRAVITY * np.cross(frames[:, 1, :, 2], lever)
    stacked = stack((c,), np.zeros(3 * len(c.readings)))
    columns = stacked.apply(c.whiten(c.fit.linear.d_joints[:, :, 1, None] * torque[:, None]))
    a, left = np.linalg.lstsq(columns, stacked.y, rcond=None)[:2]
    sd = np.sqrt(left[0] / len(stacked.y) * np.diag(np.linalg.inv(columns.T @ columns)))
    told = ", ".join(f"{axis} {v:.2g} +- {e:.1g}" for axis, v, e in zip("xyz", a, sd, strict=True))
    print(f"* joint 2, rad/(N m) for weight along +x, +y, +z of the base: {told}")
    print(f"* {np.degrees(np.arctan2(np.hypot(a[0], a[1]), -a[2])):.0f} deg from straight down")


def hats(q: Array) -> Array:
    """Piecewise linear functions (n, m) of an angle, STEP apart."""
    place = (q - q.min()) / STEP
    k = np.floor(place).astype(int)
    found = np.zeros((len(q), k.max() + 2))
    rows = np.arange(len(q))
    found[rows, k], found[rows, k + 1] = 1.0 - (place - k), place - k
    return found


def angles_part(channel: TrackerChannel, count: int) -> None:
    """A free curve of each joint's own angle, fitted with the geometry: what is left on random fifths that were held out."""
    c = channel
    n, prior = len(c.readings), c.task.layout.prior_sd
    finite = np.isfinite(prior)
    curves = [c.fit.linear.d_joints[:, :, j, None] * SIZE * hats(c.readings.q[:, j])[:, None] for j in range(5)]
    J = np.concatenate([c.fit.linear.J * np.where(finite, prior, 1.0), *curves], axis=2)
    size, p = J.shape[2], len(prior)
    known = np.concatenate([finite.astype(float), np.ones(size - p)])
    pull = np.concatenate([np.where(finite, -c.fit.offset / np.where(finite, prior, 1.0), 0.0), np.zeros(size - p)])
    for label, m in (("geometry", p), ("geometry and curves", size)):
        errors = []
        for held in (held_rows(n, 0.2, seed) for seed in range(count)):
            train = np.setdiff1d(np.arange(n), held)
            rows = (c.fit.W[train] @ J[train, :, :m]).reshape(-1, m)
            y = np.einsum("nij,nj->ni", c.fit.W[train], c.fit.linear.residual[train]).ravel()
            a = np.linalg.lstsq(rows.T @ rows + np.diag(known[:m]), rows.T @ y + pull[:m], rcond=1e-14)[0]
            errors.append(1e3 * np.sqrt(np.mean(np.sum((c.fit.linear.residual[held] - J[held, :, :m] @ a) ** 2, axis=1))))
        print(f"* {label}: {np.mean(errors):.4f} mm rms on held-out fifths ({count} splits), {m} unknowns", flush=True)


def corrections(data: DataSet, believed: DataSet) -> Iterator[tuple[str, Array, Array | None, str]]:
    """Ways to predict what was held out: what is in it, points (r, 3) m, their sigma, the effects. believed: the same readings
    with springs in the cell."""
    base, springs = tracker_channel(data), tracker_channel(believed)
    sealed = read_sealed(data, "tracker")
    yield "calibrated, joints rigid", base.predict(sealed, ()).baseline, None, ""
    yield "calibrated, springs of joints 2 and 3", springs.predict(read_sealed(believed, "tracker"), ()).baseline, None, ""
    for label, channel in (("ocp.diagnose, joints rigid", base), ("ocp.diagnose, springs in the cell", springs)):
        found = diagnose_channels([channel], library(), Options(where=False)).active
        there = channel.predict(sealed, found)
        yield label, there.corrected, there.sigma, "; ".join(map(told, found))


def held_part(campaign: PublishedCampaign, count: int, folder: Path) -> None:
    """Rms 3D error mm of held-out fifths before and after, the splits of calibration_real.py."""
    table: dict[str, list[float]] = {}
    point = 1e-3 * np.stack([campaign.columns[f"{a}_mm"] for a in "xyz"], axis=1)
    for seed in range(count):
        held = held_rows(len(campaign), 0.2, seed)
        data = data_set(campaign, folder / f"split{seed}", held)
        belief = campaign.cell | {"robot": campaign.cell["robot"] | {"compliant_joints": [2, 3]}}
        believed = data_set(replace(campaign, cell=belief), folder / f"springs{seed}", held)
        for label, predicted, sigma, names in corrections(data, believed):
            off = predicted - point[held]
            error = 1e3 * np.sqrt(np.mean(np.sum(off**2, axis=1)))
            table.setdefault(label, []).append(float(error))
            z = "" if sigma is None else f", rms z {np.sqrt(np.mean((off / sigma) ** 2)):.2f}"
            print(f"  split {seed}, {label}: {error:.4f}{z} {names}", flush=True)
    print(f"\n| model | rms mm, mean of {count} splits | worst split |\n|---|---|---|")
    for label, errors in table.items():
        print(f"| {label} | {np.mean(errors):.4f} | {max(errors):.4f} |")


def patched_part(campaign: PublishedCampaign, count: int, folder: Path) -> None:
    """What the command promises of a third that is left out, and what came: rms mm of the baseline, with the written names and
    with the patches; noise out of the shares."""
    point = 1e-3 * np.stack([campaign.columns[f"{a}_mm"] for a in "xyz"], axis=1)
    print("| split | before | names | patches | promised | came | rms z |\n" + "|---" * 7 + "|")
    for seed in range(count):
        held = held_rows(len(campaign), 1.0 / 3.0, seed)
        data_set(campaign, folder / f"third{seed}", held)
        answer = answer_of(folder / f"third{seed}", Phases())
        told, noise = predict_sealed(answer)["tracker"], 1e-3 * answer.gaps[0].noise_floor
        last, sigma = (told.corrected, told.sigma) if told.patched is None else (told.patched, told.patched_sigma)
        squares = [float(np.mean(np.sum((p - point[held]) ** 2, axis=1))) for p in (told.baseline, told.corrected, last)]
        rms = " | ".join(f"{1e3 * np.sqrt(one):.4f}" for one in squares)
        promise = answer.gaps[0].shrinkage if answer.patch is None else answer.patch.shrinkage
        z = np.sqrt(np.mean((last - point[held]) ** 2 / (sigma**2 + noise**2 / 3.0)))
        came = realised(squares[0], squares[2], noise**2)
        print(f"| {seed} | {rms} | {shrinkage_words(promise) if promise else ''} | {came or 0.0:.2f} | {z:.2f} |", flush=True)


def days_part(campaign: PublishedCampaign, path: Path, folder: Path) -> None:
    """Names learnt on one day of the grid and what came on each other day, the tracker placed by that day's own readings: rms mm
    before and after, and the share g of what the names explain that is there again; rms mm with the patches too, where there are
    some."""
    day = np.array([int(line[6:8]) for line in path.read_text(encoding="utf-8").splitlines()[1:]])
    points = 1e-3 * np.stack([campaign.columns[f"{a}_mm"] for a in "xyz"], axis=1)
    print("| learnt on | names | promised | on day | before | after | g | patches |\n" + "|---" * 8 + "|")
    for first in (14, 15, 16, 17):
        held = np.flatnonzero(day != first)
        data_set(campaign, folder / f"day{first}", held)
        answer = answer_of(folder / f"day{first}", Phases())
        told, sealed = answer.gaps[0].promise.get(ANOTHER_DAY), read_sealed(answer.data, "tracker")
        predicted = answer.diagnosis.channels[0].predict(sealed, answer.diagnosis.active)
        names = " ".join(f"{a.effect.name}:{a.joint}" for a in answer.diagnosis.active) or "none"
        made = answer.patch and answer.patch.channel
        last = predicted.corrected if made is None else made.predict(sealed, made.active).corrected
        for other in sorted(set(day[held])):
            rows = held[day[held] == other]
            parts = (points[held] - one for one in (predicted.baseline, predicted.corrected, last))
            before, after, most = (placed(points[rows], part[day[held] == other]) for part in parts)
            moved = before - after
            share = float(np.sum(moved * before) / max(np.sum(moved**2), 1e-30))
            rms = [f"{1e3 * np.sqrt(np.mean(np.sum(e**2, axis=1))):.3f}" for e in (before, after, most)]
            promised = "" if told is None else f"{told.predicted:.2f} ({told.low:.2f} to {told.high:.2f})"
            print(f"| {first} | {names} | {promised} | {other} | {rms[0]} | {rms[1]} | {share:.2f} | {rms[2]} |", flush=True)


def placed(points: Array, errors: Array) -> Array:
    """Errors (n, 3) less a small shift and turn of the points (n, 3)."""
    A = np.concatenate([np.tile(np.eye(3), (len(points), 1, 1)), np.cross(np.eye(3), points[:, None]).swapaxes(1, 2)], axis=2)
    flat = A.reshape(-1, 6)
    return np.asarray(errors - A @ np.linalg.lstsq(flat, errors.ravel(), rcond=None)[0])


def tracker(name: str, options: argparse.Namespace, folder: Path) -> None:
    """All parts of one campaign."""
    campaign = read_campaign(options.data / FILES[name], options.difference)
    data = data_set(campaign, folder / name)
    channel = tracker_channel(data)
    parts = {
        "answer": lambda: answer_part(folder / name),
        "terms": lambda: terms_part(name, channel),
        "selected": lambda: selected_part(channel),
        "weight": lambda: weight_part(channel),
        "angles": lambda: angles_part(channel, options.splits),
        "held": lambda: held_part(campaign, options.splits, folder / "splits" / name),
        "patched": lambda: patched_part(campaign, options.splits, folder / "thirds" / name),
        "days": lambda: None if name != "ur10" else days_part(campaign, options.data / FILES[name], folder),
    }
    for part, job in parts.items():
        if options.only in (None, part):
            print(f"\n{name.upper()}, {part}\n", flush=True)
            job()


@threadpool_limits.wrap(limits=1, user_api="blas")
def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robots", nargs="*", default=["ur5", "ur10", "kr300"])
    parser.add_argument("--splits", type=int, default=5)
    parser.add_argument("--only", choices=("answer", "terms", "selected", "weight", "angles", "held", "patched", "days"))
    parser.add_argument("--difference", choices=(ACHIEVED, TARGET), default=ACHIEVED, help="what x_dif of the UR5 is")
    parser.add_argument("--data", type=Path, default=DATA)
    options = parser.parse_args()
    if not options.data.is_dir():
        raise SystemExit(f"{options.data} is absent; give the folder of the measured robots with --data")
    with tempfile.TemporaryDirectory() as made:
        for robot in options.robots:
            if robot == "kr300":
                (Path(made) / robot).mkdir()
                write_recordings([options.data / "kr300_secondary_encoder" / "FF_A.mat"], Path(made) / robot)
                print("\nKR300, answer\n", flush=True)
                answer_part(Path(made) / robot)
            else:
                tracker(robot, options, Path(made))


if __name__ == "__main__":
    main()
