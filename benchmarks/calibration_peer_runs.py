"""One peer's calibration of given data, for `benchmarks/calibration_peers.py`; run by the Python that has the peer.

`PYTHON benchmarks/calibration_peer_runs.py WAY DATA.npz ANSWER.npz`, WAY of `WAYS`. Imports nothing of the project. DATA: mdh
(6, 5), joints (n, 6) rad with the robot's signs applied, point (n, 3) m near the robot's base frame, nest (3,) m, fresh
(m, 6) rad. ANSWER: predicted (m, 3) m, wall and processor seconds, unknowns, note.
"""

import contextlib
import importlib.metadata
import io
import logging
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Answer = tuple[Array, Array, int, str]


def clock() -> Array:
    """Wall and processor seconds."""
    return np.array([time.perf_counter(), time.process_time()])


def pybotics(data: Mapping[str, Array], by_component: bool = False) -> Answer:
    """Its own example: OptimizationHandler, errors as distances, scipy's least_squares with its defaults.

    `by_component`: its handler and kinematics with x, y, z as residuals, three times the rows, smooth at zero.

    Craig's form alpha_0 a_0 theta_1 d_1 .. is the distal one shifted by a link; there is no beta. Millimetres, as in its
    models. Free: all 24 kinematic numbers, the tool's place, the world frame.
    """
    from pybotics.optimization import OptimizationHandler, optimize_accuracy
    from pybotics.robot import Robot
    from pybotics.tool import Tool
    from scipy.optimize import least_squares

    theta, d, a, alpha, _ = data["mdh"].T
    craig = np.column_stack([np.append(0.0, alpha[:5]), 1e3 * np.append(0.0, a[:5]), theta, 1e3 * d])
    tool = np.eye(4)
    tool[:3, 3] = 1e3 * data["nest"]
    robot = Robot.from_parameters(craig.ravel())
    robot.tool = Tool(matrix=tool)
    handler = OptimizationHandler(
        robot, kinematic_chain_mask=[True] * 24, tool_mask=[True] * 3 + [False] * 3, world_mask=[True] * 6
    )
    start = handler.generate_optimization_vector()

    def components(vector: Array, held: OptimizationHandler, qs: Array, positions: Array) -> Array:
        held.apply_optimization_vector(vector)
        return np.ravel([held.robot.fk(q)[:3, 3] for q in qs] - positions)

    began = clock()
    function = components if by_component else optimize_accuracy
    result = least_squares(function, start, args=(handler, data["joints"], 1e3 * data["point"]))
    seconds = clock() - began
    handler.apply_optimization_vector(result.x)
    predicted = 1e-3 * np.array([handler.robot.fk(q)[:3, 3] for q in data["fresh"]])
    return predicted, seconds, len(start), f"{result.nfev} evaluations, {result.message}"


def figaroh(data: Mapping[str, Array], method: str = "structural") -> Answer:
    """As in its UR10 example: full_params, unknown base and tip, its own selection of identifiable parameters, LM.

    `method` of its estimation: "structural" is its default, "map" has priors instead of a selection.
    """
    from figaroh.calibration.base_calibration import BaseCalibration
    from figaroh.calibration.calibration_tools import calc_updated_fkm
    from figaroh.tools.load_robot import load_robot

    class Calibration(BaseCalibration):
        def cost_function(self, var: Array) -> Array:
            predicted = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
            return np.asarray(self.PEE_measured - predicted)

    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "arm.urdf").write_text(urdf(data["mdh"], data["nest"]))
        header = ",".join(["x1", "y1", "z1", *(f"joint_{i + 1}" for i in range(6))])
        rows = np.column_stack([data["point"], data["joints"]])
        np.savetxt(place / "data.csv", rows, delimiter=",", header=header, comments="", fmt="%.17g")
        (place / "config.yaml").write_text(FIGAROH_CONFIG.format(count=len(rows), method=method, file=place / "data.csv"))
        robot = load_robot(str(place / "arm.urdf"), package_dirs=str(place), load_by_urdf=True)
        began = clock()
        job = Calibration(robot, str(place / "config.yaml"), [])
        job.calib_config["known_baseframe"] = False
        job.calib_config["known_tipframe"] = False
        job.initialize()
        set_up = (clock() - began)[0]
        result = job.solve(enable_logging=False)
        seconds = clock() - began
    count = len(data["fresh"])
    config = dict(job.calib_config, NbSample=count)
    fresh = np.zeros((count, len(robot.q0)))
    fresh[:, config["config_idx"]] = data["fresh"]
    predicted = calc_updated_fkm(job.model, job.data, result.x, fresh, config).reshape(3, count).T
    note = f"selection of parameters {set_up:.2f} s of it; {result.nfev} evaluations, {result.message}"
    return predicted, seconds, len(result.x), note


FIGAROH_CONFIG = """
schema_version: "2.0"
robot:
  name: arm
  properties:
    joints:
      active_joints: [joint_1, joint_2, joint_3, joint_4, joint_5, joint_6]
tasks:
  calibration:
    enabled: true
    parameters:
      calibration_level: full_params
      include_non_geometric: false
      outlier_threshold: 0.05
      estimation: {{method: {method}}}
    kinematics: {{base_frame: universe, tool_frame: reflector}}
    measurements:
      markers:
        - {{name: reflector, reference_joint: joint_6, measurable_dof: [true, true, true, false, false, false]}}
    data: {{source_file: "{file}", validation_data_file: "", sample_configurations_file: "", number_of_samples: {count}}}
"""


def urdf(mdh: Array, nest: Array) -> str:
    """The arm as URDF: joint i about z of what joint i - 1 leaves, the reflector fixed to the last link."""

    def link(name: str) -> str:
        inertia = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        return f'<link name="{name}"><inertial><mass value="1"/>{inertia}</inertial></link>'

    def joint(name: str, kind: str, parent: str, child: str, xyz: Array, rpy: Array) -> str:
        origin = f'<origin xyz="{" ".join(map(repr, xyz.tolist()))}" rpy="{" ".join(map(repr, rpy.tolist()))}"/>'
        limit = '<axis xyz="0 0 1"/><limit lower="-7" upper="7" effort="1" velocity="1"/>' if kind == "revolute" else ""
        ends = f'<parent link="{parent}"/><child link="{child}"/>'
        return f'<joint name="{name}" type="{kind}">{ends}{origin}{limit}</joint>'

    parts = [link("link_0")]
    d, a, alpha = 0.0, 0.0, 0.0
    for i, (theta, *after) in enumerate(mdh[:, :4].tolist()):
        # Tz(d) Tx(a) Rx(alpha) of the link before, then this joint's own offset: Rx(alpha) Rz(theta) as fixed-axis angles.
        xyz, rpy, here = np.array([a, 0.0, d]), fixed_axis_angles(alpha, theta), f"link_{i + 1}"
        parts += [link(here), joint(f"joint_{i + 1}", "revolute", f"link_{i}", here, xyz, rpy)]
        d, a, alpha = after
    xyz, rpy = np.array([a, 0.0, d]), np.array([alpha, 0.0, 0.0])
    parts += [link("flange"), joint("mount", "fixed", "link_6", "flange", xyz, rpy)]
    parts += [link("reflector"), joint("hold", "fixed", "flange", "reflector", nest, np.zeros(3))]
    return f'<robot name="arm">{"".join(parts)}</robot>'


def fixed_axis_angles(alpha: float, theta: float) -> Array:
    """Roll, pitch, yaw of Rx(alpha) Rz(theta)."""
    from scipy.spatial.transform import Rotation

    return np.asarray((Rotation.from_euler("x", alpha) * Rotation.from_euler("z", theta)).as_euler("xyz"))


# Distribution to install, and what is run with it.
WAYS: dict[str, tuple[str, Callable[[Mapping[str, Array]], Answer]]] = {
    "pybotics, its example": ("pybotics", pybotics),
    "pybotics, by component": ("pybotics", lambda data: pybotics(data, True)),
    "figaroh, structural": ("figaroh", figaroh),
    "figaroh, map": ("figaroh", lambda data: figaroh(data, "map")),
}


def main(way: str, source: str, target: str) -> None:
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    data: dict[str, Any] = dict(np.load(source))
    peer, run = WAYS[way]
    with contextlib.redirect_stdout(io.StringIO()):
        predicted, seconds, unknowns, note = run(data)
    version = importlib.metadata.version(peer)
    np.savez(target, predicted=predicted, seconds=seconds, unknowns=unknowns, note=note, version=version)


if __name__ == "__main__":
    main(*sys.argv[1:4])
