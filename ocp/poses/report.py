"""One printed sheet about chosen poses: accuracy against their number, and where the reflectors will be."""

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.patches import Circle

from ocp.report.sheets import Sheet, new_sheet, number_sheets
from ocp.report.style import CURVE, INK, LIMIT, SIDE_COLOURS, SOFT, STYLE, printable
from robots.kinematics import link_frames
from robots.pose import Array, apply

if TYPE_CHECKING:
    from ocp.poses.planning import PosePlan

VIEWS = (("seen from above", 0, 1), ("seen from the side", 0, 2))


def write_poses_sheet(plan: "PosePlan", path: Path) -> None:
    """Write report.pdf: one A4 sheet; equal plans give equal bytes."""
    title = f"{len(plan.chosen)} poses for {plan.cell.name}"
    with matplotlib.rc_context(STYLE):
        sheet = new_sheet(title[:60], "Where to measure, and what accuracy to expect in the grinding zone")
        _words(sheet, plan)
        _curve(sheet.figure.add_axes((0.1, 0.5, 0.83, 0.24)), plan)
        for k, (name, i, j) in enumerate(VIEWS):
            _view(sheet.figure.add_axes((0.1 + 0.44 * k, 0.1, 0.39, 0.32)), plan, name, i, j, legend=k == 0)
        number_sheets([sheet], title)
        with PdfPages(path, metadata={"Title": printable(title), "Subject": "Measuring poses", "CreationDate": None}) as pages:
            pages.savefig(sheet.figure)


def _words(sheet: Sheet, plan: "PosePlan") -> None:
    curve = plan.curve
    total, own, scatter = (f"{1e3 * v:.3f}" for v in (curve.chosen_total, curve.chosen, plan.design.repeatability))
    if curve.enough is not None:
        enough = f"Beyond {curve.enough} poses ten more improve it by less than 5 %."
    else:
        enough = f"Up to {int(curve.count[-1])} poses, ten more still improve it by more than 5 %."
    lines = [
        f"After calibration the blade's place in the grinding zone is expected within {total} mm (one sigma, 3D):",
        f"{own} mm from the calibration, {scatter} mm that the robot scatters by itself.",
        enough,
        "Mount in this order: " + ", then ".join(f"{c.payload} ({len(c.stops)} poses)" for c in plan.campaigns) + ".",
        f"Tracker: {plan.tracker_from}. Criterion: {plan.options.criterion}.",
        *plan.notices,
    ]
    for k, line in enumerate(lines[:8]):
        sheet.text(0.7, 1.35 + 0.2 * k, line[:125], fontsize=8.5, color=INK)


def _curve(axes: Axes, plan: "PosePlan") -> None:
    curve = plan.curve
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
    axes.set_xlabel("poses, each read twice")
    axes.set_ylabel("one sigma, mm")
    axes.grid(True)
    axes.legend(frameon=False, fontsize=7)


def _view(axes: Axes, plan: "PosePlan", name: str, i: int, j: int, legend: bool) -> None:
    """Reflectors, arm in the first pose of the grinding zone, wheel and tracker projected on base axes i and j."""
    wheel = plan.cell.wheel
    frames = link_frames(plan.cell.robot, plan.zone.q[:1])[0]
    joints = np.vstack([np.zeros(3), frames[:, :3, 3]])
    axes.plot(joints[:, i], joints[:, j], "-", color=SOFT, lw=3, alpha=0.5, solid_capstyle="round", label="arm at the wheel")
    axes.add_patch(Circle((wheel.centre[i], wheel.centre[j]), wheel.radius, fill=False, color=INK, lw=1))
    for k, campaign in enumerate(plan.campaigns):
        p = _reflectors(plan, k)
        axes.plot(p[:, i], p[:, j], "o", ms=3, color=SIDE_COLOURS[k % len(SIDE_COLOURS)], label=f"reflector, {campaign.payload}")
    axes.plot([plan.tracker[i]], [plan.tracker[j]], "^", color=LIMIT, ms=7, label="tracker")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(name, fontsize=8, color=SOFT)
    axes.set_xlabel(f"{'xyz'[i]}, m")
    axes.set_ylabel(f"{'xyz'[j]}, m")
    axes.grid(True)
    if legend:
        axes.legend(frameon=False, fontsize=6.5, loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=4)


def _reflectors(plan: "PosePlan", k: int) -> Array:
    """Places (n, 3) m of the reflectors read in campaign k."""
    campaign = plan.campaigns[k]
    frames = link_frames(plan.cell.robot, np.array([stop.q for stop in campaign.stops]))
    nests = plan.setup.instrument.nests or {}
    places = []
    for frame, target in zip(frames, campaign.targets, strict=True):
        place = nests[target].place
        assert place is not None
        places.append(apply(frame[nests[target].link], place))
    return np.array(places)
