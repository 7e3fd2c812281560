"""The beam against capsules and wheel, by other code: coal's distances and points along the beam."""

from dataclasses import replace

import coal
import numpy as np
import pytest

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.poses.candidates import BALL, BEAM, Rod, Sight, meets_wheel, nest_direction, segment_distance, visible
from robots.kinematics import link_frames
from robots.pose import apply
from robots.tracker_readings import Nest

NEST = Nest(6, np.array([0.15, -0.05, 0.25]))


@pytest.fixture(scope="module")
def cell():
    return read_cell(CELL)


def test_distances_of_segments_are_those_of_points_along_them():
    rng = np.random.default_rng(0)
    p0, p1, q0, q1 = rng.normal(size=(4, 300, 3))
    q1[:40] = q0[:40] + (p1 - p0)[:40] * rng.normal(size=(40, 1))  # parallel
    p1[40:60], q1[60:80], p1[80:100], q1[80:100] = p0[40:60], q0[60:80], p0[80:100], q0[80:100]  # points
    s = np.linspace(0, 1, 201)
    a = p0[:, None] + s[:, None] * (p1 - p0)[:, None]
    b = q0[:, None] + s[:, None] * (q1 - q0)[:, None]
    coarse = np.linalg.norm(a[:, :, None] - b[:, None], axis=-1).min(axis=(1, 2))
    found = segment_distance(p0, p1, q0, q1)
    assert (found <= coarse + 1e-12).all()
    assert np.abs(found - coarse).max() < 0.03


def test_the_wheel_stops_the_beams_that_pass_through_it(cell):
    wheel, rng = replace(cell.wheel, radius=0.15, width=0.04), np.random.default_rng(1)
    wheel = replace(wheel, axis=np.array([0.0, 0.6, 0.8]))
    start = wheel.centre + np.array([1.0, 1.0, 0.5])
    end = wheel.centre + rng.normal(0, 0.3, (500, 3))
    end[0], end[1] = start + wheel.axis * -3.0, start  # along the axis beside the wheel; no beam at all
    points = start + np.linspace(0, 1, 4001)[:, None, None] * (end - start)
    along = (points - wheel.centre) @ wheel.axis
    radial = np.linalg.norm(points - wheel.centre - along[..., None] * wheel.axis, axis=-1)
    inside = ((np.abs(along) <= wheel.width / 2 + BEAM) & (radial < wheel.radius + BEAM)).any(axis=0)
    found = meets_wheel(wheel, start, end)
    assert 40 < inside.sum() < 450
    assert (found != inside).mean() < 0.01 and found[inside].all()


def test_visible_agrees_with_coal_on_the_arm(cell):
    robot, rng = cell.robot, np.random.default_rng(2)
    q = rng.uniform(robot.q_min, robot.q_max, (200, 6))
    tracker = np.array([2.6, -2.2, 1.4])
    found = visible(robot, cell.wheel, Sight(), NEST, tracker, q)
    frames = link_frames(robot, q)
    ball = apply(frames[:, 6], NEST.place)
    expected = []
    for k in range(len(q)):
        direction = (ball[k] - tracker) / np.linalg.norm(ball[k] - tracker)
        length = np.linalg.norm(ball[k] - tracker) - BALL
        z = direction
        x = np.cross(z, [0.0, 0.0, 1.0])
        x /= np.linalg.norm(x)
        beam = coal.Transform3s(np.stack([x, np.cross(z, x), z], axis=1), tracker + 0.5 * length * direction)
        free = True
        for link, a, b, r in robot.link_shapes:
            pa, pb = apply(frames[k, link], a), apply(frames[k, link], b)
            points = coal.Sphere(r) if np.allclose(pa, pb) else coal.Capsule(r, float(np.linalg.norm(pb - pa)))
            w = (pb - pa) / max(np.linalg.norm(pb - pa), 1e-12)
            u = np.cross(w, [0.3, 0.5, 0.8])
            u /= np.linalg.norm(u)
            place = coal.Transform3s(np.stack([u, np.cross(w, u), w], axis=1), 0.5 * (pa + pb))
            result = coal.DistanceResult()
            request = coal.DistanceRequest()
            request.enable_signed_distance = True
            free &= coal.distance(coal.Capsule(BEAM, length), beam, points, place, request, result) > 0
        expected.append(free)
    wheel_free = ~meets_wheel(cell.wheel, tracker, ball)
    differ = found != (np.array(expected) & wheel_free)
    assert differ.mean() < 0.03  # capsule ends against a plain beam end: the last 40 mm
    assert 0.3 < found.mean() < 0.98


def test_range_acceptance_and_rods_take_readings_away(cell):
    robot, rng = cell.robot, np.random.default_rng(3)
    q, tracker = rng.uniform(robot.q_min, robot.q_max, (300, 6)), np.array([2.5, 2.5, 1.5])
    base = visible(robot, cell.wheel, Sight(), NEST, tracker, q)
    ball = apply(link_frames(robot, q)[:, 6], NEST.place)
    distance = np.linalg.norm(ball - tracker, axis=1)
    near = visible(robot, cell.wheel, Sight((1.0, 3.0)), NEST, tracker, q)
    np.testing.assert_array_equal(near, base & (distance <= 3.0))
    narrow = visible(robot, cell.wheel, Sight(acceptance=np.radians(30)), NEST, tracker, q)
    out = link_frames(robot, q)[:, 6, :3, :3] @ nest_direction(NEST)
    angle = np.degrees(np.arccos(np.einsum("ij,ij->i", out, tracker - ball) / distance))
    np.testing.assert_array_equal(narrow, base & (angle <= 30))
    assert 0 < narrow.sum() < base.sum()
    wall = Rod(0, np.array([1.5, -3.0, 1.5]), np.array([1.5, 3.0, 1.5]), 0.5)
    assert visible(robot, cell.wheel, Sight(rods=(wall,)), NEST, tracker, q).sum() < base.sum()


def test_a_nest_looks_away_from_its_links_axis():
    np.testing.assert_allclose(nest_direction(Nest(6, np.array([0.3, 0.0, 0.2]))), [1, 0, 0])
    np.testing.assert_allclose(nest_direction(Nest(3, np.array([0.0, 0.0, 0.2]))), [0, 0, 1])
