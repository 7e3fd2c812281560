"""`ocp.api.simulate`: a plan in; the force that a virtual cell would show, and the logs that a day on it would give, out."""

from collections.abc import Sequence
from pathlib import Path

from ocp.data import CELL
from ocp.shell.progress import Phases, Progress
from ocp.simulate.input import Wanted
from ocp.simulate.simulation import SimulationResult, simulate_cell


def simulate(
    plan: str | Path | None = None,
    *,
    out: str | Path,
    cell: str | Path | None = None,
    blade: str | Path | None = None,
    effects: Sequence[str] = (),
    random: str | None = None,
    sealed: bool = False,
    machine: str = "drawn",
    seed: int = 0,
    size: float = 1.0,
    poses: str | Path | int = 40,
    ladder: Sequence[float] | None = None,
    belts: Sequence[float] = (),
    air: bool = True,
    joints: bool = False,
    hz: float = 250.0,
    log_hz: float = 25.0,
    clock: float = 0.0,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> SimulationResult:
    """Rehearse the folder `plan` that `ocp.api.plan` wrote (None: a tracker campaign alone) on a virtual cell that shares no
    code with the planner, and write the data a real cell would give into the folder `out`.

    cell: None: the one the plan was made with; blade: where it is not the cell's own; effects: what to plant, each
    NAME[:JOINT][=SIZE] as backlash:5=2e-4; random: some more at random, as random:2; sealed: tell nothing of what was planted,
    and keep readings back; machine: drawn (real errors), believed (none) or sampled (of the calibration); seed: which machine;
    size: of its own errors, 1 as usual; poses: how many postures of the tracker campaign, or a folder of `choose_poses`;
    ladder: setpoints N of the force ladder (None: usual ones, empty: no ladder); belts: further belt speeds m/s; air: log a
    pass with the flange drawn back; joints: write joints.csv; hz: control rate 1/s; log_hz: rows of force.csv a second; clock:
    seconds that the campaign's clock shows at the start. Raises BadInput: an argument or a file is not what it should be;
    Infeasible: the program would crash or cannot be driven.
    """
    wanted = Wanted(
        plan=None if plan is None else Path(plan),
        cell=None if cell is None else Path(cell),
        blade=None if blade is None else Path(blade),
        effects=tuple(effects),
        random=random,
        sealed=sealed,
        machine=machine,
        seed=seed,
        size=size,
        poses=str(poses),
        ladder=None if ladder is None else tuple(float(v) for v in ladder),
        belts=tuple(float(v) for v in belts),
        air=air,
        joints=joints,
        hz=hz,
        log_hz=log_hz,
        clock=clock,
    )
    return simulate_cell(wanted, CELL, Path(out), overwrite, Phases(progress))
