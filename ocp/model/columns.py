"""What the columns of every CSV file mean, file by file: the documentation's tables are made from it, readers are held to it."""

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Columns:
    """Columns of one meaning: their names, whether a file must have them, what they hold; example: a value, as text."""

    names: tuple[str, ...]
    needed: bool
    meaning: str
    example: str


def _six(stem: str, unit: str = "") -> tuple[str, ...]:
    return tuple(f"{stem}{i}{unit}" for i in range(1, 7))


def _three(stem: str, unit: str = "", letters: Iterable[str] = "xyz") -> tuple[str, ...]:
    return tuple(f"{stem}{a}{unit}" for a in letters)


_AXES = Columns(_six("q", "_deg"), True, "commanded axis angles", "-12.5")
_CONTACT = (
    Columns(_three("p", "_mm"), True, "planned contact point, blade frame", "4.2"),
    Columns(_three("n"), True, "outward normal there", "0.998"),
    Columns(_three("t"), True, "direction of the feed there", "0.05"),
)
_DEPTH_PLACE = Columns(_three("p", "_mm"), True, "within 0.2 mm of the blade's surface, its frame", "4.2")

TABLES: dict[str, tuple[Columns, ...]] = {
    "tracker.csv": (
        _AXES,
        Columns(_three("", "_mm"), True, "reflector, in the tracker's frame", "1843.217"),
        Columns(("target",), False, "its nest, of [tracker.targets]", "T1"),
        Columns(("payload",), False, "of [payloads]; absent: the first", "weight"),
        Columns(("session", "station"), False, "campaign; place of the tracker", "morning"),
        Columns(("time_s",), False, "since the start of the campaign", "125.0"),
        Columns(("temperature_C",), False, "of the structure", "22.4"),
        Columns(_six("approach"), False, "sign of each axis' last motion before the reading: 1, -1 or 0", "-1"),
        Columns(_three("f", "_N"), False, "known external force, base axes", "100.0"),
        Columns(_three("m", "_Nm"), False, "known external moment, base axes", "10.0"),
        Columns(_three("l", "_mm"), False, "where it acts, in the frame of load_link", "0.0"),
        Columns(("load_link",), False, "link that it acts on, 6 the flange", "6"),
        Columns(("sigma_um",), False, "one sigma of the reading, each direction", "12.0"),
        Columns(_three("r", "_deg"), False, "turn of a 6D target, in the order of [tracker] rotation", "31.2"),
        Columns(("qw", "qx", "qy", "qz"), False, "instead: its quaternion", "0.71"),
        Columns(("sigma_rot_deg",), False, "one sigma of the turn", "0.01"),
    ),
    "force.csv": (
        Columns(("run",), True, "recording; its rows are in time order", "1"),
        Columns(("time_s",), True, "since the recording began", "0.04"),
        _AXES,
        *_CONTACT,
        Columns(("fn_N",), True, "measured normal force", "19.8"),
        Columns(("ft_N",), False, "along axis x outward radial, as belt_m_s", "6.9"),
        Columns(("sigma_fn_N", "sigma_ft_N"), False, "one sigma of the two", "0.1"),
        Columns(("setpoint_N",), False, "that the flange was set to; absent: the cell's", "20.0"),
        Columns(("feed_mm_s",), False, "speed of the contact, 0 or above; absent: from the points", "40.0"),
        Columns(("belt_m_s",), False, "speed of the belt, as commanded; absent: the cell's", "20.0"),
        Columns(("s_mm",), False, "arc length along the pass", "17.5"),
        Columns(("line",), False, "line of plan.csv", "3"),
        Columns(("ground_before",), False, "how often the line was ground", "0"),
        Columns(("contact",), False, "1 in contact, 0 in an air run; absent: by the force", "1"),
        Columns(("session",), False, "a blade gripped anew, a wheel moved", "morning"),
        Columns(("clock_s",), False, "that the wheel has run since the first log", "5400.0"),
        Columns(("temperature_C", "wheel_temperature_C"), False, "of the structure; of the wheel", "22.4"),
    ),
    "joints.csv": (
        Columns(("run",), True, "recording", "1"),
        Columns(("time_s",), True, "since the recording began", "0.04"),
        Columns(_six("q", "_deg"), True, "axis angles, motor side", "-12.5"),
        Columns(_six("link", "_deg"), False, "link side; any of the six", "-12.498"),
        Columns(_six("tau", "_Nm"), False, "torques there; any of the six", "850.0"),
        Columns(_six("qd", "_deg_s"), False, "speeds, to check angles and times", "3.5"),
    ),
    "path.csv": (
        Columns(("line",), True, "its points in the order of the feed", "1"),
        *_CONTACT,
        Columns(("feed_mm_s",), False, "wanted there; absent: the cell's", "40.0"),
        Columns(("force_N",), False, "wanted there; absent: the cell's", "20.0"),
    ),
    "removal.csv": (
        _DEPTH_PLACE,
        Columns(("removal_um",), True, "depth taken off by what the force log holds until then", "18.5"),
        Columns(("sd_um",), True, "its one sigma, above 0", "0.5"),
        Columns(("clock_s",), False, "the log's clock when it was measured; absent: after all that the log holds", "620.0"),
    ),
    "stock.csv": (_DEPTH_PLACE, Columns(("depth_um",), True, "depth to take off", "20.0")),
    "plan.csv": (
        Columns(("time_s",), True, "since the program's first posture", "12.402"),
        Columns(("line",), True, "from its approach to its lift; 0 between passes", "3"),
        Columns(("phase",), True, "travel (approach and lift too), lead_in, pass (full force), lead_out", "pass"),
        Columns(("contact",), True, "1 from touch to lift, by the model; 0 in the air", "1"),
        _AXES,
        Columns(_six("qd", "_deg_s"), True, "their speeds", "3.5"),
        Columns(_six("qdd", "_deg_s2"), True, "their accelerations", "12.0"),
        Columns(_three("p", "_mm"), True, "contact point, blade frame", "4.2"),
        Columns((*_three("n"), *_three("t")), True, "outward normal and direction of the feed there", "0.998"),
        Columns(("s_mm",), True, "arc length, 0 where full force begins, negative before", "17.5"),
        Columns(("feed_mm_s",), True, "of the contact over the blade", "40.0"),
        Columns(("fn_N", "fn_sd_N"), True, "planned force; its one sigma on the real cell", "20.0"),
        Columns(("interference_mm",), True, "overlap of undeformed wheel and blade", "0.412"),
        Columns(("limit_ratio",), True, "largest use of an axis' speed, acceleration or torque limit", "0.41"),
        Columns(("setpoint_N",), True, "of the flange; empty without one", "20.0"),
        Columns(("removal_rel",), False, "depth of all passes over what is wanted", "1.01"),
        Columns(("removal_um",), False, "that depth, with Preston's coefficient or removal_um", "20.2"),
        Columns(
            _three("d_", "_mm", ("normal", "feed", "lateral")),
            False,
            "working error of the command if nothing were calibrated",
            "0.3",
        ),
    ),
    "residuals.csv": (
        Columns(("line",), True, "of tracker.csv", "2"),
        Columns(_three("d", "_mm"), True, "reading less model, by the fit of all readings", "-0.017"),
        Columns(("before_mm",), True, "distance by the believed cell", "0.979"),
        Columns(("after_mm",), True, "by the fitted arm (not held out)", "0.025"),
        Columns(("weight",), True, "in the fit; below 0.05 an outlier", "0.904"),
    ),
    "predictions_tracker.csv": (
        Columns(_three("baseline_", "_mm"), True, "by the believed cell", "1843.2"),
        Columns(_three("corrected_", "_mm"), True, "by the cell that is written", "1843.3"),
        Columns(_three("sigma_", "_mm"), True, "its one sigma against the noise-free truth", "0.03"),
        Columns(_three("patched_", "_mm"), True, "with the patch; without one as corrected", "1843.3"),
        Columns(_three("patched_sigma_", "_mm"), True, "its one sigma", "0.03"),
        Columns(("inside",), True, "1 where all that the patch varies with was measured", "1"),
    ),
}
"""Files by name. A sealed file has the columns of the measured one but for what is to be predicted; predictions_force.csv and
predictions_joints.csv have the columns of predictions_tracker.csv with fn_N and link1_deg to link6_deg."""
