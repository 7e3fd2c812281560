"""The report of `python -m ocp.poses`: accuracy against the number of poses, and where the reflectors will be."""

from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from ocp.poses.planning import PosePlan
from ocp.poses.program import MeasurementCampaign
from ocp.report.parts import Plot
from ocp.report.plotting import Canvas, dressed
from ocp.report.report import Report
from ocp.report.section import Headline, Section
from ocp.report.style import CURVE, INK, LIMIT, SIDE_COLOURS, SOFT, printable, shorten
from robots.kinematics import link_frames
from robots.pose import Array, apply

KIND = "Where to measure, and what accuracy to expect in the grinding zone"


def poses_report(plan: PosePlan) -> Report:
    """The whole report; equal plans give equal bytes."""
    curve = plan.curve
    total, own, scatter = (f"{1e3 * v:.3f}" for v in (curve.chosen_total, curve.chosen, plan.design.repeatability))
    if curve.enough is not None:
        enough = f"Beyond {curve.enough} poses ten more improve it by less than 5 %."
    else:
        enough = f"Up to {int(curve.count[-1])} poses, ten more still improve it by more than 5 %."
    sentence = (
        f"After calibration the blade's place in the grinding zone is expected within {total} mm (one sigma, 3D): {own} mm from "
        f"the calibration, {scatter} mm that the robot scatters by itself. {enough}"
    )
    facts = (
        ("Mount in this order", ", then ".join(f"{c.payload} ({len(c.stops)} poses)" for c in plan.campaigns)),
        ("Tracker", plan.tracker_from),
        ("Criterion", plan.options.criterion),
    )
    expected = "Error to expect of the blade's place, by the number of poses."
    places = "Reflectors in all poses, in the robot's base frame; the circle is the wheel."
    legend = 0.15 * ((len(plan.campaigns) + 3) // 2)  # inch: arm, tracker and every payload in two columns
    sections = (
        Section("Accuracy", (Plot("accuracy", expected, 3.0, partial(_curve, plan)),)),
        Section("Where the reflectors will be", (Plot("reflectors", places, 3.2 + legend, partial(_views, plan, legend)),)),
    )
    title = f"{len(plan.chosen)} poses for {plan.cell.name}"
    return Report(KIND, title, Headline(True, "Chosen.", sentence, facts), plan.notices, sections)


def _curve(plan: PosePlan, canvas: Canvas) -> None:
    curve, axes = plan.curve, canvas.subplots(top=0.08)
    axes.loglog(curve.count, 1e3 * curve.total, "o-", ms=3, color=CURVE, label="in the grinding zone")
    axes.loglog(curve.count, 1e3 * curve.calibration, "o--", ms=3, color=SIDE_COLOURS[1], label="from the calibration alone")
    axes.axhline(1e3 * plan.design.repeatability, color=SOFT, lw=0.6, ls=":", label="robot's own scatter")
    axes.plot([len(plan.chosen)], [1e3 * curve.chosen_total], "s", ms=6, mfc="none", color=LIMIT, label="chosen")
    if curve.enough is not None:
        axes.axvline(curve.enough, color=LIMIT, lw=0.6, ls="--", label="more buys little")
    low, high = 1e3 * curve.calibration.min(), 1e3 * curve.total.max()
    marks = [m for m in (0.002, 0.003, 0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2, 0.5, 1.0) if 0.7 * low < m < 1.5 * high]
    axes.set_yticks(marks, [f"{m:g}" for m in marks])
    counts = [n for n in (12, 16, 20, 30, 40, 60, 80, 100) if curve.count[0] <= n <= curve.count[-1]]
    axes.set_xticks(counts, [str(n) for n in counts])
    axes.minorticks_off()
    dressed(axes, x="poses, each read twice", y="one sigma, mm", grid="both")
    axes.legend(frameon=False, fontsize=7)


def _views(plan: PosePlan, legend: float, canvas: Canvas) -> None:
    """From two sides, above a legend of so many inch."""
    left, right = canvas.subplots(1, 2, bottom=0.5 + legend)
    _view(left, plan, "seen from above", 0, 1)
    _view(right, plan, "seen from the side", 0, 2)
    left.legend(frameon=False, fontsize=6.5, loc="upper left", bbox_to_anchor=(0.0, -0.14), ncols=2)


def _view(axes: Axes, plan: PosePlan, name: str, i: int, j: int) -> None:
    """Reflectors, arm in the first pose of the grinding zone, wheel and tracker projected on base axes i and j."""
    wheel = plan.cell.wheel
    frames = link_frames(plan.cell.robot, plan.zone.q[:1])[0]
    joints = np.vstack([np.zeros(3), frames[:, :3, 3]])
    axes.plot(joints[:, i], joints[:, j], "-", color=SOFT, lw=3, alpha=0.5, solid_capstyle="round", label="arm at the wheel")
    axes.add_patch(Circle((wheel.centre[i], wheel.centre[j]), wheel.radius, fill=False, color=INK, lw=1))
    for k, campaign in enumerate(plan.campaigns):
        p = _reflectors(plan, campaign)
        colour, label = SIDE_COLOURS[k % len(SIDE_COLOURS)], shorten(printable(f"reflector, {campaign.payload}"), 50)
        axes.plot(p[:, i], p[:, j], "o", ms=3, color=colour, label=label)
    axes.plot([plan.tracker[i]], [plan.tracker[j]], "^", color=LIMIT, ms=7, label="tracker")
    axes.set_aspect("equal", adjustable="datalim")
    dressed(axes, name, f"{'xyz'[i]}, m", f"{'xyz'[j]}, m", grid="both")


def _reflectors(plan: PosePlan, campaign: MeasurementCampaign) -> Array:
    """Places (n, 3) m of the reflectors read in a campaign."""
    frames = link_frames(plan.cell.robot, np.array([stop.q for stop in campaign.stops]))
    nests = plan.setup.instrument.nests or {}
    places = []
    for frame, target in zip(frames, campaign.targets, strict=True):
        place = nests[target].place
        assert place is not None
        places.append(apply(frame[nests[target].link], place))
    return np.array(places)
