"""The parameters of a calibration in the order of the MD-H table: believed, estimate, change and one sigma."""

import numpy as np

from ocp.calibrate.report.view import named, present
from ocp.calibrate.tracker import TrackerCalibration
from ocp.report.parts import Table, table
from robots.calibration.layout import believed_compliance
from robots.calibration.parameters import COMPLIANCE_NAMES, MDH_NAMES
from robots.pose import abc_from_rotation

SYMBOL = {"th": "θ", "d": "d", "a": "a", "al": "α", "be": "β"}
COLUMNS = ("believed", "estimate", "change", "one sigma")


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
        numbers = (
            f"{plain(1e3 * believed[k])}",
            f"{plain(1e3 * fit.state.arm[k])}",
            signed(1e3 * (fit.state.arm[k] - believed[k])),
        )
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
            rows.append(
                (
                    f"{named(name, 'nest')}, {axis}", link, f"{before:.3f}" if placed else "not given", f"{value:.3f}",
                    signed(value - before, 3) if placed else "", f"{sd:.3f}",
                )
            )  # fmt: skip
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


def plain(value: float) -> str:
    """Four decimals; what rounds to nothing is 0 without a sign."""
    return f"{round(value, 4) + 0.0:.4f}"


def signed(value: float, decimals: int = 4) -> str:
    """A change with its sign; what rounds to nothing has none."""
    text = f"{value:+.{decimals}f}"
    return text[1:] if float(text) == 0.0 else text
