"""A URDF becomes the same machine: flange, weight and limits by independent routes; what is none is refused."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from robots.errors import BadInput
from robots.gravity import GRAVITY, weight_torques
from robots.inverse import inverse_branches
from robots.kinematics import forward
from robots.robot import load_robot
from robots.toml_files import toml_text
from robots.urdf import read_urdf
from tests.support.house import ROOT

ARM = ROOT / "docs" / "examples" / "arm.urdf"


def loaded(tables, folder: Path):
    file = folder / "arm.toml"
    file.write_text(toml_text(tables))
    return load_robot(file)


def walked(text: str, q):
    """Flange pose in the root frame by walking the URDF's tree: origin, then the turn about the axis."""
    T, turn = np.eye(4), iter(q)
    for joint in ElementTree.fromstring(text).findall("joint"):
        origin, axis = joint.find("origin"), joint.find("axis")
        step = np.eye(4)
        if origin is not None:
            step[:3, 3] = [float(v) for v in origin.get("xyz", "0 0 0").split()]
            step[:3, :3] = Rotation.from_euler("xyz", [float(v) for v in origin.get("rpy", "0 0 0").split()]).as_matrix()
        T = T @ step
        if joint.get("type") != "fixed":
            a = np.array([float(v) for v in axis.get("xyz").split()])
            T[:3, :3] = T[:3, :3] @ Rotation.from_rotvec(next(turn) * a / np.linalg.norm(a)).as_matrix()
    return T


def test_the_example_is_the_arm_of_the_catalogue(tmp_path):
    arm, known = loaded(read_urdf(ARM).tables, tmp_path), load_robot("kr210_r2700_extra")
    q = np.random.default_rng(3).uniform(-2, 2, (20, 6))
    assert np.abs(forward(arm, q) - forward(known, q)).max() < 1e-9
    assert np.degrees(arm.q_max) == pytest.approx(np.degrees(known.q_max), abs=0.01)
    assert arm.torque_max == pytest.approx(known.torque_max)
    branches, _ = inverse_branches(arm, forward(arm, q))
    assert np.nanmin(np.abs(branches - q[:, None]).max(axis=-1), axis=1) == pytest.approx(np.zeros(20), abs=1e-9)


def test_links_weigh_on_the_joints_what_they_weigh_in_the_urdf(tmp_path):
    arm, model = loaded(read_urdf(ARM).tables, tmp_path), pin.buildModelFromUrdf(str(ARM))
    model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
    q = np.random.default_rng(4).uniform(-2, 2, (20, 6))
    expected = [-pin.computeGeneralizedGravity(model, model.createData(), row) for row in q]
    assert weight_torques(arm, q) == pytest.approx(np.array(expected), abs=1e-6)


place = st.tuples(*[st.sampled_from([-1.0, -0.3, 0.0, 0.0, 0.2, 0.7])] * 3)
turned = st.tuples(*[st.sampled_from([-np.pi / 2, -0.4, 0.0, 0.0, np.pi / 2, 1.0])] * 3)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.tuples(place, turned, st.sampled_from(["1 0 0", "0 1 0", "0 0 -1", "0.6 0 0.8"])), min_size=6, max_size=6))
def test_any_six_axes_keep_their_flange(tmp_path_factory, steps):
    joints = "".join(
        f'<joint name="j{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/><axis xyz="{axis}"/>'
        f'<origin xyz="{" ".join(map(str, xyz))}" rpy="{" ".join(map(str, rpy))}"/>'
        '<limit lower="-2" upper="2" effort="100" velocity="1"/></joint>'
        for i, (xyz, rpy, axis) in enumerate(steps)
    )
    text = '<robot name="any">' + "".join(f'<link name="l{i}"/>' for i in range(7)) + joints + "</robot>"
    folder = tmp_path_factory.mktemp("any")
    (folder / "any.urdf").write_text(text)
    try:
        found = read_urdf(folder / "any.urdf")
    except BadInput as error:
        assert "beside axis 6" in str(error)
        return
    arm = loaded(found.tables, folder)
    base = walked(text, np.zeros(6)) @ np.linalg.inv(forward(arm, np.zeros((1, 6)))[0])
    for q in np.random.default_rng(0).uniform(-2, 2, (5, 6)):
        assert base @ forward(arm, q[None])[0] == pytest.approx(walked(text, q), abs=1e-8)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('type="revolute"', 'type="prismatic"', "is not revolute"),
        ('"joint_a6" type="revolute"', '"joint_a6" type="fixed"', "has 5 moving joints, six are needed"),
        ('velocity="2.1468"', 'velocity="0"', "joint 'joint_a1' has no speed"),
        ('lower="-3.2289" upper="3.2289"', 'lower="0" upper="0"', "joint 'joint_a1' has no range"),
        ('lower="-3.2289" upper="3.2289"', 'lower="-185" upper="185"', "joint 'joint_a1' turns as far as 185 rad; a URDF is in"),
        ("</joint>", '<mimic joint="joint_a2"/></joint>', "joint 'joint_a1' follows another one (mimic)"),
        ("</robot>", "", "is not XML (no element found: line 48"),
        ('<link name="link_5"/>', '<link name="link_6"/>', "is no URDF that can be read"),
        ('<?xml version="1.0"?>', "<machine/><!--", "is not XML"),
        ('<parent link="link_5"/>', '<parent link="link_4"/>', "do not follow each other"),
    ],
)
def test_what_is_no_arm_of_six_axes_is_refused_by_name(tmp_path, capfd, old, new, told):
    file = tmp_path / "arm.urdf"
    file.write_text(ARM.read_text().replace(old, new, 1))
    with pytest.raises(BadInput, match="arm.urdf: ") as error:
        read_urdf(file)
    assert told in str(error.value) and "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")  # nothing beside the one sentence


def test_a_joint_without_ends_turns_once_each_way(tmp_path):
    text = ARM.read_text().replace('"joint_a6" type="revolute"', '"joint_a6" type="continuous"')
    (tmp_path / "arm.urdf").write_text(text)
    found = read_urdf(tmp_path / "arm.urdf").tables
    assert (found["limits"]["q_min_deg"][5], found["limits"]["q_max_deg"][5]) == (-360.0, 360.0)
    assert found["limits"]["q_max_deg"][4] == pytest.approx(125.0, abs=0.01)
    q = np.array([0.3, -0.8, 0.5, 1.0, -0.4, 2.5])
    assert forward(loaded(found, tmp_path), q[None])[0] == pytest.approx(walked(text, q), abs=1e-9)


def test_a_fixed_joint_of_a_gripper_may_mimic_another(tmp_path):
    text = ARM.read_text().replace(
        '<joint name="flange_joint" type="fixed">', '<joint name="flange_joint" type="fixed"><mimic joint="joint_a6"/>'
    )
    (tmp_path / "arm.urdf").write_text(text)
    assert "mimic" in text and read_urdf(tmp_path / "arm.urdf").tables == read_urdf(ARM).tables


def test_another_link_can_be_the_flange_and_a_wrong_one_is_named():
    assert read_urdf(ARM, "link_6").tables["geometry"]["d_mm"][5] == 0.0
    with pytest.raises(BadInput, match="does not hang on the last joint; there link_6, flange hang"):
        read_urdf(ARM, "link_2")
    with pytest.raises(BadInput, match="is no link"):
        read_urdf(ARM, "hand")


def test_a_urdf_without_masses_says_so(tmp_path):
    file = tmp_path / "arm.urdf"
    text = ARM.read_text()
    while "<inertial>" in text:
        text = text[: text.index("<inertial>")] + text[text.index("</inertial>") + len("</inertial>") :]
    file.write_text(text)
    found = read_urdf(file)
    assert "links" not in found.tables and any("no masses" in n for n in found.notices)
