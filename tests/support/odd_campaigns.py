"""Tracker campaigns that a user may well bring and nobody would recommend: arms of other proportions, few or noisy readings, one
nest, one payload, nothing at all to see. Made with the elementary arm, no part of the product's models."""

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robots.pose import make_transform
from robots.robot import Robot, load_robot
from robots.toml_files import toml_text
from robots.tracker_readings import Readings
from tests.support.diagnosis_folder import CELL, SPRINGS, columns_of, joint_columns, write_csv
from tests.support.simulated_campaign import PAYLOADS, Truth

LENGTHS = {"d_mm", "a_mm", "com_mm", "from_mm", "to_mm", "radius_mm", "inertia_kg_m2"}


@dataclass(frozen=True)
class OddCampaign:
    """What is odd about a campaign: catalogue robot and factors of its lengths, readings, noise mm, errors of the arm m and rad,
    ripple and play rad; nests; which postures and approaches there are."""

    name: str
    model: str = "ur5"
    lengths: tuple[float, float] = (1.0, 1.0)
    n: int = 60
    noise: float = 0.01
    errors: float = 3e-4
    background: float = 5e-5
    nests: int = 1
    payloads: int = 1
    approach: str = "both"
    postures: str = "spread"
    stations: int = 1
    time: bool = False
    sessions: bool = False


ODD = (
    OddCampaign("no error, no noise", noise=0.0, errors=0.0, background=0.0, approach="none"),
    OddCampaign("no error, both sides", noise=0.0, errors=0.0, background=0.0),
    OddCampaign("no error, kuka", "kr210_r2700_extra", noise=0.0, errors=0.0, background=0.0, nests=3, payloads=2),
    OddCampaign("no noise", noise=0.0),
    OddCampaign("small, 0.3 mm, 360", lengths=(0.6, 0.8), n=360, noise=0.3),
    OddCampaign("small, 0.3 mm, 360, worn", lengths=(0.5, 1.2), n=360, noise=0.3, background=1e-3),
    OddCampaign("small, 0.3 mm, 360, kuka", "kr210_r2700_extra", (0.25, 0.3), 360, 0.3, background=1e-3),
    OddCampaign("small, 3 mm", lengths=(0.6, 0.8), n=120, noise=3.0),
    OddCampaign("ur10, 3 mm, 400", "ur10", n=400, noise=3.0, nests=2),
    OddCampaign("ur10, worn gears", "ur10", n=300, noise=0.02, background=2e-3),
    OddCampaign("thirty", n=30),
    OddCampaign("thirty, three nests, two payloads", n=30, nests=3, payloads=2),
    OddCampaign("thirty, 3 mm", n=30, noise=3.0),
    OddCampaign("one side", n=100, approach="one side"),
    OddCampaign("never said from where", n=100, approach="none"),
    OddCampaign("one posture repeated", n=60, postures="one"),
    OddCampaign("twenty postures, thrice", n=60, postures="thrice"),
    OddCampaign("every row twice, noiseless", n=80, postures="twice", noise=0.0),
    OddCampaign("one axis stands", n=80, postures="axis 4 stands"),
    OddCampaign("axes one after another", n=90, postures="one at a time"),
    OddCampaign("constant temperature", n=80, time=True),
    OddCampaign("two stations, thirty rows of one", n=160, stations=2),
    OddCampaign("sessions", n=120, sessions=True, time=True),
    OddCampaign("long, kuka", "kr210_r2700_2", (1.4, 1.2), 150, 0.05, nests=2, payloads=3),
    OddCampaign("bent arm", n=100, errors=5e-3),
)


def _scaled(tables: dict, low: float, high: float) -> dict:
    """Robot tables with every second link's lengths times `low`, the others' times `high`; of a capsule or centre, `low`."""
    out = {}
    for key, value in tables.items():
        if isinstance(value, dict):
            out[key] = _scaled(value, low, high)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            out[key] = [_scaled(v, low, high) for v in value]
        elif key in ("d_mm", "a_mm"):
            out[key] = [v * (low if i % 2 else high) for i, v in enumerate(value)]
        elif key in LENGTHS:
            out[key] = [v * low for v in value] if isinstance(value, list) else value * low
        else:
            out[key] = value
    return out


def _robot(folder: Path, odd: OddCampaign) -> Robot:
    """The believed arm, written beside the cell where it is none of the catalogue."""
    text = (resources.files("robots") / "catalogue" / f"{odd.model}.toml").read_text(encoding="utf-8")
    tables = _scaled(tomllib.loads(text), *odd.lengths) | {"name": "odd_arm"}
    (folder / "arm.toml").write_text(toml_text(tables), encoding="utf-8")
    return load_robot(folder / "arm.toml")


def _angles(rng: np.random.Generator, odd: OddCampaign, robot: Robot) -> np.ndarray:
    """Commanded axes (n, 6) rad."""
    low = np.maximum(robot.q_min, np.radians([-120, -120, -100, -170, -110, -170]))
    high = np.minimum(robot.q_max, np.radians([120, -10, 130, 170, 110, 170]))
    q = rng.uniform(low, high, (odd.n, 6))
    middle = 0.5 * (low + high)
    if odd.postures == "one":
        q[:] = q[0]
    elif odd.postures in ("twice", "thrice"):
        times = 2 if odd.postures == "twice" else 3
        q = np.repeat(q[: odd.n // times], times, axis=0)
    elif odd.postures == "axis 4 stands":
        q[:, 3] = middle[3]
    elif odd.postures == "one at a time":
        moves = np.arange(odd.n) % 6
        q = np.where(np.arange(6) == moves[:, None], q, middle)
    return q


def write_odd_campaign(folder: Path, odd: OddCampaign, seed: int = 0) -> None:
    """cell.toml, arm.toml, tracker.csv of the campaign."""
    rng = np.random.default_rng([seed, sum(map(ord, odd.name))])
    folder.mkdir(parents=True, exist_ok=True)
    robot = _robot(folder, odd)
    names, heavy = [f"T{k + 1}" for k in range(odd.nests)], list(PAYLOADS)[: odd.payloads]
    nests = {n: rng.uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.2]) for n in names}
    cell = {
        "name": odd.name,
        "robot": {"model": "arm.toml", "compliant_joints": [2, 3]},
        "payloads": {n: {"mass_kg": PAYLOADS[n].mass / 20, "com_mm": (1e3 * PAYLOADS[n].com).tolist()} for n in heavy},
        "tracker": {"targets": {n: np.round(1e3 * p + rng.normal(size=3) * bool(odd.errors)).tolist() for n, p in nests.items()}},
    }
    if odd.errors == 0.0:
        nests = {n: 1e-3 * np.array(p) for n, p in cell["tracker"]["targets"].items()}
    (folder / "cell.toml").write_text(toml_text(cell), encoding="utf-8")
    q = _angles(rng, odd, robot)
    n = len(q)
    readings = Readings(
        folder / "tracker.csv", q, np.full((n, 3), np.nan), rng.integers(odd.nests, size=n), tuple(names),
        rng.integers(odd.payloads, size=n), tuple(heavy), np.zeros(n, np.int64), ("",), np.zeros(n, np.int64), ("",),
        np.zeros((n, 6)), np.full(n, 6), np.zeros((n, 3)), np.arange(2, n + 2),
        np.ones((n, 6)) if odd.approach != "both" else rng.choice([-1.0, 1.0], (n, 6)),
    )  # fmt: skip
    columns = columns_of(readings, _points(rng, odd, robot, nests, readings))
    columns |= {f"q{j + 1}_deg": np.degrees(q[:, j]) for j in range(6)}
    if odd.approach == "none":
        columns = {c: v for c, v in columns.items() if not c.startswith("approach")}
    if odd.time:
        columns |= {"time_s": np.arange(n) * 30.0, "temperature_C": np.full(n, 22.0)}
    if odd.sessions:
        columns["session"] = ["b" if k > n // 2 else "a" for k in range(n)]
    if odd.stations > 1:
        columns["station"] = ["second" if k >= n - 30 else "first" for k in range(n)]
    write_csv(folder / "tracker.csv", columns)


def _points(rng: np.random.Generator, odd: OddCampaign, robot: Robot, nests: dict, readings: Readings) -> np.ndarray:
    """Reflectors (n, 3) m in the tracker's frame of an arm that errs."""
    compliance = np.zeros(6)
    compliance[1:3] = 1.0 / robot.stiffness[1:3] * (1.0 if odd.errors == 0.0 else rng.uniform(0.8, 1.2, 2))
    T = make_transform(Rotation.random(random_state=int(rng.integers(2**31))).as_matrix(), rng.uniform(-1, 1, 3) + [0, 3.0, 0])
    ripple = np.column_stack([rng.uniform(0, odd.background, 6), rng.integers(1, 40, 6), rng.uniform(0, 2 * np.pi, 6)])
    wrong = replace(robot, mdh=robot.mdh + rng.normal(size=(6, 5)) * odd.errors)
    truth = Truth(wrong, compliance, nests, T, ripple, rng.uniform(0, odd.background, 6), 4e-6 if odd.noise else 0.0)
    hung = {name: replace(h, mass=h.mass / 20) for name, h in PAYLOADS.items()}
    point = truth.points(readings, rng, hung)
    if odd.stations > 1:
        point[-30:] = point[-30:] @ Rotation.from_euler("z", 40, degrees=True).as_matrix() + [0.5, 0.2, 0.0]
    return point + 1e-3 * odd.noise * rng.normal(size=point.shape)


LOGS = {
    "motor and link alike": {},
    "motor and link alike, rigid": {"stiffness": "0, 0, 0, 0, 0, 0"},
    "a constant apart": {"zero": 1e-3},
    "no noise, late": {"delay": 3e-3},
    "coarse link": {"step_deg": 0.01},
    "one link": {"links": 1},
    "no torques": {"torques": False, "delay": 2e-3, "noise": 5e-6},
    "thirty-two rows": {"every": 38, "noise": 5e-6},
    "one a second": {"every": 100, "noise": 5e-6},
    "zeroed anew": {"runs": 2, "delay": 3e-3, "noise": 5e-6},
    "zeroed anew, a run of three rows": {"runs": 3, "delay": 3e-3, "noise": 5e-6},
    "noise of a degree": {"noise": 0.017},
}
"""Odd logs of link-side encoders by what is odd."""


def write_odd_log(
    folder: Path,
    delay: float = 0.0,
    noise: float = 0.0,
    zero: float = 0.0,
    step_deg: float = 0.0,
    links: int = 3,
    torques: bool = True,
    every: int = 1,
    runs: int = 1,
    stiffness: str = SPRINGS,
) -> None:
    """cell.toml and joints.csv of a motion whose link is `delay` s late, rigid but for that, with so many rad of noise; the third
    run has three rows."""
    made = joint_columns(0)
    motor = np.radians(np.stack([made[f"q{j + 1}_deg"] for j in range(6)], axis=1))
    rng, time = np.random.default_rng(0), np.asarray(made["time_s"])
    run = np.arange(len(time)) * min(runs, 2) // len(time)
    if runs == 3:
        run[-3:] = 2
    for j in range(3):
        late = np.interp(time - delay, time, motor[:, j]) if delay else motor[:, j]
        link = np.degrees(late + zero + run * 2e-3 * (j + 1) + rng.normal(size=len(time)) * noise)
        made[f"link{j + 1}_deg"] = np.round(link / step_deg) * step_deg if step_deg else link
        if not (delay or noise or zero or step_deg or runs > 1):  # to the last digit
            made[f"link{j + 1}_deg"] = made[f"q{j + 1}_deg"]
    made["run"] = [f"r{k}" for k in run]
    kept = [c for c in made if not c.startswith("link") or int(c[4]) <= links]
    rows = slice(None, None, every)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cell.toml").write_text(CELL.format(stiffness=stiffness))
    write_csv(folder / "joints.csv", {c: made[c][rows] for c in kept if torques or not c.startswith("tau")})


def written(folder: Path, seed: int = 0) -> Iterator[tuple[str, Path]]:
    """Every odd data set by name with the folder that it was written to; logs with the first seed alone."""
    for k, odd in enumerate(ODD):
        at = folder / f"tracker_{seed}_{k}"
        write_odd_campaign(at, odd, seed)
        yield odd.name, at
    for k, name in enumerate(LOGS if seed == 0 else ()):
        write_odd_log(folder / f"joints_{k}", **LOGS[name])
        yield name, folder / f"joints_{k}"
