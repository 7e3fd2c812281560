"""The section "What cannot be told apart": what the readings tell only together, and whether other poses could tell it."""

from dataclasses import replace

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dots, dressed, log_scale, panels
from ocp.report.section import Section
from ocp.report.style import AFTER, BAD, BEFORE, SOFT
from robots.calibration.fit import Fit
from robots.calibration.identifiability import SEPARATED, UNSEEN, Hidden, described
from robots.calibration.noise import reading_covariance, whitener
from robots.calibration.parameters import SYMBOLS
from robots.calibration.residuals import linearise
from robots.pose import Array

POSES = 400  # made-up postures over the whole range of the axes
CORRELATION = LinearSegmentedColormap.from_list("correlation", ["#8a3d0a", "#e9b98f", "#ffffff", "#9dc0d9", "#123e5c"])


def identifiability_section(c: TrackerCalibration, tellable: dict[str, bool]) -> Section:
    """How many directions the readings determine, and the parameters that hide; `tellable` as `tellable_parameters` gives it."""
    found = c.identifiability
    words = (
        f"The readings determine {found.rank} independent directions of the robot's {found.parameters} parameters. The other "
        "parameters are told only together: any split between them gives the same readings, and the believed values decide it."
    )
    last = hidden_table(c, tellable) if found.hidden else "Every parameter is determined on its own."
    return Section("What cannot be told apart", (words, seen_plot(c), last))


def seen_plot(c: TrackerCalibration) -> Plot:
    """Singular values with the rank, and correlations of the robot's parameters."""
    caption = (
        "Left: how strongly the readings see each independent direction of the robot's parameters, over noise and prior; "
        "below the line they see nothing. Right: correlations of the estimates; dark off the diagonal is a pair that goes "
        "together."
    )
    return Plot("seen", caption, 3.9, lambda canvas: _draw_seen(canvas, c))


def _draw_seen(canvas: Canvas, c: TrackerCalibration) -> None:
    left, right = panels(canvas, 1, 2, widths=(1, 1.35), across=0.55, right=0.55)[0]
    found = c.identifiability
    values = np.maximum(found.singular_values, 1e-3)
    place = np.arange(1, len(values) + 1)
    seen = place <= found.rank
    dots(left, place[seen], values[seen], AFTER, 4)
    dots(left, place[~seen], values[~seen], BEFORE, 4)
    left.axhline(1.0 / SEPARATED, color=BAD, lw=0.8)
    left.text(len(values) + 0.5, 1.25 / SEPARATED, f"rank {found.rank} of {found.parameters}", fontsize=7, ha="right", color=BAD)
    log_scale(left)
    dressed(left, "singular value", "direction")
    names, C = correlations(c.fit)
    size = min(6.0, 170.0 / max(len(names), 1))
    image = right.imshow(C, cmap=CORRELATION, vmin=-1, vmax=1, interpolation="none", aspect="auto")
    dressed(right, "correlation", grid="")
    right.set_xticks(range(len(names)), names, rotation=90, fontsize=size)
    right.set_yticks(range(len(names)), names, fontsize=size)
    right.tick_params(length=0, labelsize=size, pad=1)
    bar = right.inset_axes((1.03, 0.0, 0.03, 1.0))
    canvas.figure.colorbar(image, cax=bar, ticks=(-1, -0.5, 0, 0.5, 1))
    bar.tick_params(length=2, labelsize=6, colors=SOFT)
    bar.spines["outline"].set_linewidth(0.4)


def correlations(fit: Fit) -> tuple[list[str], Array]:
    """Names and correlations (m, m) of the robot's parameters that were fitted."""
    pick = [i for i, name in enumerate(fit.layout.names) if name in SYMBOLS]
    sd = np.maximum(fit.sd[pick], 1e-30)
    return [fit.layout.names[i] for i in pick], fit.covariance[np.ix_(pick, pick)] / np.outer(sd, sd)


def hidden_table(c: TrackerCalibration, tellable: dict[str, bool]) -> Table:
    """What the readings do not determine, and whether other poses could."""
    rows = []
    for h in c.identifiability.hidden:
        what = described(h.name).removeprefix(f"{h.name} (").removesuffix(")")
        says = h.sentence().removesuffix("; the believed values share it out")
        rows.append((h.name, what, f"{min(h.ratio, 1.0):.2f}", says, _how_to_tell(h, tellable.get(h.name, False))))
    columns = ("parameter", "what it is", "sigma left of prior", "what the readings say", "would be told by")
    return table(columns, rows, text=(0, 1, 3, 4))


def _how_to_tell(hidden: Hidden, by_poses: bool) -> str:
    """What would determine a parameter."""
    if by_poses:
        return "other poses"
    if any(name.startswith("nest") for name in hidden.company):
        return "measuring the nests on the flange"
    return "no pose"


def tellable_parameters(c: TrackerCalibration) -> dict[str, bool]:
    """For each hidden parameter, whether POSES postures all over the axes' range, with the same nests, payloads and stations,
    would tell it. What they do not tell either no poses do: it hides in the place of base or nests, or beside a twin."""
    fit, campaign = c.fit, c.fit.campaign
    robot, n = campaign.robot, len(campaign.readings)
    rows = np.arange(POSES) % n
    q = np.random.default_rng(0).uniform(robot.q_min, robot.q_max, (POSES, 6))
    made_up = replace(campaign.readings.take(rows), q=q, turn=None, sigma=None, load=np.zeros((POSES, 6)))
    linear = linearise(robot, made_up, campaign.instrument, fit.layout, fit.state)
    seen = replace(made_up, point=linear.point)
    W = whitener(reading_covariance(seen, campaign.instrument, fit.noise, linear.d_joints))
    scale, prior = fit.layout.scale, fit.layout.prior_sd
    J = (W @ linear.J[:, :3] * scale / fit.spread).reshape(-1, fit.layout.size)
    information = J.T @ J + np.diag(np.where(np.isfinite(prior), (scale / prior) ** 2, 1e-6))
    sd = scale * np.sqrt(np.diag(np.linalg.inv(information)))
    return {
        h.name: bool(sd[fit.layout.index(h.name)] < UNSEEN * prior[fit.layout.index(h.name)]) for h in c.identifiability.hidden
    }
