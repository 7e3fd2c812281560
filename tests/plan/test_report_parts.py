"""The parts behind the report: colour on the surface, tables, ticks, curves; and the page's own arithmetic."""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ocp.plan.report.axes import limit_rows, limit_table
from ocp.plan.report.force import MAX_POINTS, ForcePanels, decimals_of, force_panels, nice_ticks, pass_table
from ocp.plan.report.plan_report import PassReport, PlanReport
from ocp.plan.report.quantities import QUANTITIES, colour_range, common_distance, quantity
from ocp.plan.report.surface import cluster_vertices, paint_blade, pass_spacing, refine_near
from robots.pose import Array, apply, invert, make_transform, rotation_from_abc
from tests.support.report_example import example_report, synthetic_blade

SCRIPTS = Path(__file__).resolve().parents[2] / "ocp" / "report" / "scene"


@pytest.fixture(scope="module")
def report() -> PlanReport:
    return example_report(lines=3, count=30, frames=20)


def volume(vertices: Array, faces: Array) -> float:
    a, b, c = vertices[np.asarray(faces).T]
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


def straight_pass(example: PassReport, y: float, z: float, up: float, reverse: bool = False) -> PassReport:
    """A pass along x from 0 to 0.1 m at (y, z) on a surface facing `up` along z."""
    x = np.linspace(0, 0.1, len(example.s))
    p = np.c_[x[::-1] if reverse else x, np.full_like(x, y), np.full_like(x, z)]
    n, t = np.zeros_like(p), np.zeros_like(p)
    n[:, 2], t[:, 0] = up, -1.0 if reverse else 1.0
    return replace(example, p=p, n=n, t=t, s=x)


def plate(height: float = 0.001) -> tuple[Array, np.ndarray]:
    """A box of 100 x 60 mm with only two triangles a side: coarser than any pass spacing."""
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.06) for z in (0, height)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def test_painting_follows_the_passes_and_keeps_to_their_side(report):
    height = 0.001
    passes = tuple(straight_pass(report.passes[0], y, height, 1.0) for y in (0.02, 0.03))
    painted = paint_blade(*plate(height), passes)
    assert abs(volume(painted.vertices, painted.faces) - 0.1 * 0.06 * height) < 1e-12
    cover = painted.weight.sum(axis=1)
    # One pass has value 0, the other 1: between them the value rises with y, and stays in 0..1.
    values = np.repeat([0.0, 1.0], len(report.passes[0].s))
    y, top = painted.vertices[:, 1], painted.vertices[:, 2] > height - 1e-9
    ground = cover >= 0.5
    shown = (painted.weight * values[painted.waypoint]).sum(axis=1)[ground] / cover[ground]
    assert shown.min() > -1e-12 and shown.max() < 1 + 1e-12
    assert np.corrcoef(shown, y[ground])[0, 1] > 0.9
    # Nothing on the lower side, a millimetre away; on top exactly the band within 0.6 of the spacing.
    assert not ground[~top].any()
    inside = top & (y > 0.0145) & (y < 0.0355)
    assert ground[inside].all() and not ground[(y < 0.0135) | (y > 0.0365)].any()
    assert abs(pass_spacing(passes) - 0.01) < 1e-12


def test_refinement_and_clustering_keep_the_body(report):
    vertices, faces = synthetic_blade()
    points = np.concatenate([item.p for item in report.passes])
    fine, more = refine_near(vertices, faces, points, 0.002)
    assert len(more) > len(faces)
    assert abs(volume(fine, more) / volume(vertices, faces) - 1) < 1e-12
    corners = fine[more]
    near = np.linalg.norm(corners.mean(axis=1)[:, None] - points[None], axis=2).min(axis=1) < 0.0005
    assert near.sum() > 100
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)[near].max() <= 0.001 + 1e-12
    coarse, fewer = cluster_vertices(vertices, faces, 2000)
    assert 500 < len(fewer) <= 2000
    assert abs(volume(coarse, fewer) / volume(vertices, faces) - 1) < 0.1


def test_limit_table_tells_the_worst_use(report):
    motion, limits = report.motion, report.robot
    q, qd = motion.q.copy(), motion.qd.copy()
    q[100, 4], qd[200, 1] = limits.q_max[4], -1.25 * limits.qd_max[1]
    rows = {(row.axis, row.kind): row for row in limit_rows(replace(report, motion=replace(motion, q=q, qd=qd)))}
    assert len(rows) == 24
    assert rows["A5", "position"].ratio == pytest.approx(1.0) and rows["A5", "position"].time == motion.time[100]
    assert rows["A2", "speed"].ratio == pytest.approx(1.25) and rows["A2", "speed"].time == motion.time[200]
    assert rows["A2", "speed"].limit == "115.00 deg/s"
    table = limit_table(tuple(rows.values()))
    assert 5 in table.strong and table.rows[5][4] == "125 % over the limit"
    assert table.bars[4][5] == pytest.approx(1.25)
    free = replace(report, robot=replace(limits, torque_max=np.full(6, np.inf)))
    assert limit_table(limit_rows(free)).rows[3][3:5] == ("none", "not limited")
    assert [row.limit for row in limit_rows(free) if row.kind == "torque"] == ["none"] * 6


def test_pass_table_counts_every_pass(report):
    rows = pass_table(report).rows
    assert [row[0] for row in rows] == ["1", "2", "3", "4", "5", "6"]
    force = report.passes[0].force
    assert rows[0][4] == f"{force.min():.2f} .. {force.max():.2f}"
    unknown = replace(report.passes[0], force=np.full(len(force), np.nan))
    assert pass_table(replace(report, passes=(unknown,))).rows[0][4] == "not known"


def test_force_panels_share_one_scale_and_break_at_gaps(report):
    panels = force_panels(report)
    assert len({panel.target for panel in panels}) == 1 and len({panel.y_ticks for panel in panels}) == 1
    gap = report.passes[0].force.copy()
    gap[10] = np.nan
    broken = force_panels(replace(report, passes=(replace(report.passes[0], force=gap), *report.passes[1:])))[0]
    assert (panels[0].curve.count("M"), broken.curve.count("M"), broken.curve.count("L")) == (1, 2, 27)


def test_force_panels_keep_every_peak():
    """Between the points that are drawn of a long pass a knock would be lost."""
    long = example_report(lines=2, count=5000, frames=20)
    force = long.passes[0].force.copy()
    force[2345] = force.max() + 3.0
    panel = force_panels(replace(long, passes=(replace(long.passes[0], force=force), *long.passes[1:])))[0]
    heights = [float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", panel.curve)]
    assert len(heights) <= MAX_POINTS and min(heights) < np.median(heights) - 30.0


def test_panels_on_paper_are_those_of_the_page(report):
    shown, panels = ForcePanels(report).on_paper()["panels"], force_panels(report)
    assert [one["title"] for one in shown] == [f"Line {p.line}, {p.side}" for p in panels]
    for one, panel, item in zip(shown, panels, report.passes, strict=True):
        drawn = ElementTree.fromstring(one["picture"])  # a whole file: its name spaces are said
        paths = {path.get("class"): path.get("d") for path in drawn.iter("{http://www.w3.org/2000/svg}path")}
        assert paths == {"band": panel.band, "curve": panel.curve}
        styled = set(re.findall(r"\.(\w+) {", drawn.findtext("{http://www.w3.org/2000/svg}style")))
        assert {part.get("class") for part in drawn.iter() if part.get("class")} <= styled
        assert f"{item.force.min():.2f} to {item.force.max():.2f} N" in one["note"]


def test_contact_spans_are_the_passes_in_time(report):
    spans = report.contact_spans()
    assert [line for line, _, _ in spans] == [item.line for item in report.passes]
    for (_, start, end), item in zip(spans, report.passes, strict=True):
        mean_feed = item.s[-1] / (end - start)
        assert item.feed.min() * 0.98 < mean_feed < item.feed.max() * 1.02


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6), st.integers(2, 8))
def test_ticks_are_round_inside_and_few(low, span, wanted):
    ticks = nice_ticks(low, low + span, wanted)
    assert len(ticks) <= 2.5 * wanted + 1
    slack = 1e-6 * span + 1e-9 * abs(low)
    assert ((ticks >= low - slack) & (ticks <= low + span + slack)).all()


def test_colour_ranges_hold_every_value_and_the_target_in_the_middle(report):
    for item in QUANTITIES:
        low, high = colour_range(report, item)
        values = item.factor * np.concatenate([getattr(one, item.key) for one in report.passes])
        assert low <= values.min() and values.max() <= high and high - low >= 0.999 * item.span
    assert sum(colour_range(report, quantity("force"))) / 2 == pytest.approx(report.target_force)
    assert decimals_of(np.array([0.0, 0.05])) == 2 and decimals_of(np.array([0.0, 20.0])) == 0


def test_passes_fed_against_each_other_share_one_distance(report):
    forth = straight_pass(report.passes[0], 0.0, 0.0, 1.0)
    back = straight_pass(report.passes[0], 0.01, 0.0, 1.0, reverse=True)
    along = common_distance([forth, back])
    np.testing.assert_allclose(along[0], forth.p[:, 0])
    np.testing.assert_allclose(along[1], back.p[:, 0], atol=1e-15)


def test_the_pages_arithmetic_agrees_with_numpy(tmp_path):
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node: the page's script is not checked here")
    rng = np.random.default_rng(3)
    poses = make_transform(rotation_from_abc(rng.uniform(-1, 1, (2, 3))), rng.uniform(-1, 1, (2, 3)))
    points = rng.uniform(-0.3, 0.3, (5, 3))
    given_ = {"poses": poses[:, :3].reshape(2, 12).tolist(), "points": points.tolist()}
    code = "\n".join((SCRIPTS / name).read_text() for name in ("math.js", "mesh.js", "orbit.js"))
    code += f"\nconst given = {json.dumps(given_)};\n"
    code += """
    const flat = given.poses.flat(), A = blendPose(flat, 0, 12, 0), M = blendPose(flat, 0, 12, 0.5);
    const camera = createCamera([0.1, 0.2, 0.3], 2, 0.7, 0.4, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    const view = cameraView(camera, 0, 1.5);
    const column = [M[0], M[1], M[2]], other = [M[4], M[5], M[6]];
    const sphere = capsuleMesh([0, 0, 0], [0, 0, 0.2], 0.1);
    let most = 0;
    for (let i = 0; i < sphere.position.length; i += 3) most = Math.max(most, Math.hypot(sphere.position[i], sphere.position[i + 1]));
    console.log(JSON.stringify({
      moved: given.points.map((p) => movePoint(A, p)), back: given.points.map((p) => movePoint(invertRigid(A), p)),
      twice: given.points.map((p) => movePoint(multiply(A, A), p)),
      orthogonal: [norm(column), norm(other), dot(column, other)], middle: project(view.viewProjection, camera.target),
      eye: [...view.eye], most,
    }));
    """  # noqa: E501 - a line of JavaScript
    (tmp_path / "check.js").write_text(code)
    done = subprocess.run([node, str(tmp_path / "check.js")], capture_output=True, check=True, timeout=60)
    told = json.loads(done.stdout)
    np.testing.assert_allclose(told["moved"], apply(poses[0], points), atol=1e-6)
    np.testing.assert_allclose(told["back"], apply(invert(poses[0]), points), atol=1e-6)
    np.testing.assert_allclose(told["twice"], apply(poses[0] @ poses[0], points), atol=1e-6)
    np.testing.assert_allclose(told["orthogonal"], [1, 1, 0], atol=1e-6)
    # The target stands in the middle of the picture, as far away as the camera was set.
    np.testing.assert_allclose(told["middle"], [0, 0, 2], atol=1e-5)
    direction = [np.cos(0.4) * np.cos(0.7), np.cos(0.4) * np.sin(0.7), np.sin(0.4)]
    np.testing.assert_allclose(told["eye"], np.array([0.1, 0.2, 0.3]) + 2 * np.array(direction), atol=1e-6)
    assert told["most"] == pytest.approx(0.1, abs=1e-6)
