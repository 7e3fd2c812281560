"""The sections "Parameters", "Terms tried" and "What cannot be told apart".

Believed, estimate, change and one sigma; which terms the model has and why; what the readings tell only together, and whether
other poses could tell it.
"""

from dataclasses import replace

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

from ocp.calibrate.report.view import named, present
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Plot, Table, table
from ocp.report.plotting import Canvas, dots, dressed, log_scale, panels
from ocp.report.section import Section
from ocp.report.style import AFTER, BAD, BEFORE, SOFT
from robots.calibration.evidence import LEAST_GAIN, LEAST_SIGMA, Term
from robots.calibration.fit import Fit
from robots.calibration.identifiability import SEPARATED, UNSEEN, Hidden, described
from robots.calibration.layout import believed_compliance
from robots.calibration.noise import reading_covariance, whitener
from robots.calibration.parameters import COMPLIANCE_NAMES, MDH_NAMES, SYMBOLS
from robots.calibration.residuals import linearise
from robots.pose import Array, abc_from_rotation

SYMBOL = {"th": "θ", "d": "d", "a": "a", "al": "α", "be": "β"}
COLUMNS = ("believed", "estimate", "change", "one sigma")


def parameters_section(c: TrackerCalibration) -> Section:
    """Arm, springs and payloads, nests, stations."""
    words = (
        "Absolute values; the change is against the believed robot. Grey: the readings tell it only in company, or it was held. "
        "One sigma is of the estimate alone; in company many are worth far less than their differences."
    )
    tables = (geometry_table(c), springs_and_payloads_table(c), nests_table(c), stations_table(c))
    return Section("Parameters", (words, *tables))


def geometry_table(c: TrackerCalibration) -> Table:
    """Thirty MD-H parameters, mm and mrad; those that the readings do not determine in grey."""
    fit, believed = c.fit, c.fit.campaign.robot.mdh.ravel()
    hidden = {h.name for h in c.identifiability.hidden}
    rows, quiet = [], []
    for k, name in enumerate(MDH_NAMES):
        stem, joint = name[:-1], name[-1]
        unit = "mm" if stem in ("d", "a") else "mrad"
        fitted = name in fit.layout.names
        sd = f"{1e3 * fit.sd[fit.layout.index(name)]:.4f}" if fitted else "held"
        told = "held" if not fitted else "in company" if name in hidden else "yes"
        before, value = 1e3 * believed[k], 1e3 * fit.state.arm[k]
        numbers = (unsigned_zero(before), unsigned_zero(value), signed(1e3 * (fit.state.arm[k] - believed[k])))
        rows.append((f"{SYMBOL[stem]}{joint}", name, unit, *numbers, sd, told))
        if told != "yes":
            quiet.append(k)
    return table(("", "name", "unit", *COLUMNS, "told by the readings"), rows, text=(0, 1, 2, 7), quiet=quiet)


def springs_and_payloads_table(c: TrackerCalibration) -> Table:
    """Six springs in µrad/(N m), and payloads whose mass and centre were fitted."""
    fit = c.fit
    cell = believed_compliance(fit.campaign.robot)
    rows, quiet = [], []
    for j, name in enumerate(COMPLIANCE_NAMES):
        fitted = name in fit.layout.names
        # What was fitted starts from the cell's value, what was not is rigid in the model, whatever the cell says.
        value, believed = fit.state.arm[30 + j], cell[j]
        estimate = f"{1e6 * value:.4f}" if value > 0 or fitted else "rigid"
        change = signed(1e6 * (value - believed)) if value > 0 or fitted else ""
        sd = f"{1e6 * fit.sd[fit.layout.index(name)]:.4f}" if fitted else "held"
        rows.append((f"joint {j + 1} bends", name, "µrad/(N m)", f"{1e6 * believed:.4f}", estimate, change, sd))
        if not fitted:
            quiet.append(j)
    parts = (("mass", "payload_mass", "kg", 1.0), *((f"centre {x}", f"payload_com_{x}", "mm", 1e3) for x in "xyz"))
    for k, payload in enumerate(fit.campaign.readings.payloads):
        for i, (part, stem, unit, factor) in enumerate(parts):
            name = f"{payload}:{stem}"
            if name in fit.layout.names:
                before, value = factor * fit.start.payloads[k, i], factor * fit.state.payloads[k, i]
                sd = f"{factor * fit.sd[fit.layout.index(name)]:.4f}"
                label = f"{part} of {named(payload, 'payload')}"
                rows.append((label, stem, unit, f"{before:.4f}", f"{value:.4f}", signed(value - before), sd))
    return table(("", "name", "unit", *COLUMNS), rows, text=(0, 1, 2), quiet=quiet, title="Springs and payloads")


def nests_table(c: TrackerCalibration) -> Table:
    """Places of the reflector nests on their links, mm."""
    fit, r = c.fit, c.fit.campaign.readings
    given = c.fit.campaign.instrument.nests or {}
    rows = []
    for k in present(r.target):
        name = r.targets[k]
        nest = given.get(name)
        placed = nest is not None and nest.place is not None
        for i, axis in enumerate("xyz"):
            before, value = 1e3 * fit.start.nests[k, i], 1e3 * fit.state.nests[k, i]
            sd = 1e3 * fit.sd[fit.layout.nest[k, i]]
            link = f"link {nest.link}" if nest is not None and nest.link != 6 else "flange"
            believed = (f"{before:.3f}", signed(value - before, 3)) if placed else ("not given", "")
            rows.append((f"{named(name, 'nest')}, {axis}", link, believed[0], f"{value:.3f}", believed[1], f"{sd:.3f}"))
    return table(("nest", "on", *COLUMNS), rows, text=(0, 1), title="Reflector nests, mm")


def stations_table(c: TrackerCalibration) -> Table:
    """Where the robot's base is in the frame of each tracker station, mm and KUKA angles."""
    fit, r = c.fit, c.fit.campaign.readings
    rows = []
    for k in present(r.station):
        T = fit.state.stations[k]
        sd = fit.sd[fit.layout.station[k]]
        place = [f"{1e3 * v:.3f}" for v in T[:3, 3]]
        angles = [f"{v:.4f}" for v in np.degrees(abc_from_rotation(T[:3, :3]))]
        name = named(r.stations[k], "station")
        size = (f"{1e3 * np.linalg.norm(sd[:3]):.3f}", f"{1e3 * np.linalg.norm(sd[3:]):.4f}")
        rows.append((name, *place, *angles, *size))
    columns = ("station", "x, mm", "y, mm", "z, mm", "A, deg", "B, deg", "C, deg", "sigma, mm", "sigma, mrad")
    return table(columns, rows, title="The robot's base in the tracker's frame")


def terms_section(c: TrackerCalibration) -> Section:
    """What the model has, and what more was tried."""
    given = [f"A{j}" for j in c.fit.choice.joints]
    model = f"The model has the geometry{' and the springs of ' + ', '.join(given) if given else ' without springs'}"
    payloads = [f"'{p}'" for p in c.fit.choice.payloads]
    model += f", and mass and centre of {', '.join(payloads)}." if payloads else "."
    if not c.terms:
        return Section("Terms tried", (f"{model} Method '{c.method}' tries no further terms.",))
    note = (
        f"A term enters when the log density of readings left out grows by more than {LEAST_GAIN:g} and by more "
        f"than {LEAST_SIGMA:g} times the standard error of that growth. A gain of 4 means that the "
        "readings are 55 times as likely with the term."
    )
    rows = [(t.name, signed(t.gain, 1), f"{t.sigma:.1f}" if t.sigma else "not tried", term_verdict(t)) for t in c.terms]
    strong = [k for k, t in enumerate(c.terms) if t.accepted]
    tried = table(("term", "gain", "over its error", "verdict"), rows, text=(0, 3), strong=strong)
    return Section("Terms tried", (f"{model} {note}", tried))


def term_verdict(term: Term) -> str:
    """Why a term entered the model or not."""
    if term.accepted:
        return "in the model: readings left out are predicted better with it"
    if term.gain > LEAST_GAIN:
        return "not in the model: better on the whole, but not on enough blocks of readings to be more than chance"
    if term.gain > 0:
        return "not in the model: helps too little to be told from chance"
    if term.sigma == 0.0:
        return "not in the model: hardly helps even the readings it was fitted to"
    return "not in the model: readings left out are predicted worse with it"


def unsigned_zero(value: float) -> str:
    """Four decimals; what rounds to nothing is 0 without a sign."""
    return f"{round(value, 4) + 0.0:.4f}"


def signed(value: float, decimals: int = 4) -> str:
    """A change with its sign; what rounds to nothing has none."""
    text = f"{value:+.{decimals}f}"
    return text[1:] if float(text) == 0.0 else text


POSES = 400  # made-up postures over the whole range of the axes
CORRELATION = LinearSegmentedColormap.from_list("correlation", ["#8a3d0a", "#e9b98f", "#ffffff", "#9dc0d9", "#123e5c"])


def identifiability_section(c: TrackerCalibration, tellable: dict[str, bool]) -> Section:
    """How many directions the readings determine, and the parameters that hide; `tellable` as `tellable_parameters` gives it."""
    found = c.identifiability
    words = (
        f"The readings determine {found.rank} independent directions of the robot's {found.parameters} parameters. The other "
        "parameters are told only together: any split between them gives the same readings, and the believed values decide it."
    )
    caption = (
        "Left: how strongly the readings see each independent direction of the robot's parameters, over noise and prior; "
        "below the line they see nothing. Right: correlations of the estimates; dark off the diagonal is a pair that goes "
        "together."
    )
    plot = Plot("seen", caption, 3.9, lambda canvas: _draw_seen(canvas, c))
    last = hidden_table(c, tellable) if found.hidden else "Every parameter is determined on its own."
    return Section("What cannot be told apart", (words, plot, last))


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
    bar.tick_params(labelsize=6, pad=3.5, colors=SOFT)
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
