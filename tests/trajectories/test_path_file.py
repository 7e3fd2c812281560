import csv

import numpy as np
import pytest

from robots.errors import BadInput
from tests.support import blade_samples
from trajectories.blade import Blade, find_shape
from trajectories.passes import PassOptions, passes
from trajectories.path_points import FEED_LIMIT, facet_curvature, read_path_file

HEADER = ["line", "px_mm", "py_mm", "pz_mm", "nx", "ny", "nz", "tx", "ty", "tz"]


@pytest.fixture(scope="module")
def sample():
    blade = Blade("sample", "", *blade_samples.blade_mesh(100, 30))
    shape = find_shape(blade)
    return blade, shape, passes(blade, shape, PassOptions(spacing=20e-3, step=2e-3))[0]


def rows_of(paths):
    return [[path.line, *(1e3 * path.p[k]), *path.n[k], *path.t[k]] for path in paths for k in range(len(path.p))]


def write(tmp_path, rows, header=HEADER):
    path = tmp_path / "path.csv"
    with path.open("w", newline="") as file:
        csv.writer(file).writerows([header, *rows])
    return path


def read(path, sample, step=2e-3):
    return read_path_file(path, sample[0], sample[1], 0.04, 20.0, step)


def test_passes_written_and_read_back_are_the_same(tmp_path, sample):
    paths, notices = read(write(tmp_path, rows_of(sample[2])), sample)
    assert len(paths) == len(sample[2]) and all("is used throughout" in notice for notice in notices)
    for a, b in zip(sample[2], paths, strict=True):
        assert (a.line, a.side) == (b.line, b.side)
        np.testing.assert_allclose(b.p, a.p, atol=1e-9)
        np.testing.assert_allclose(b.n, a.n, atol=1e-7)
        np.testing.assert_allclose(b.t, a.t, atol=1e-7)
        np.testing.assert_allclose(b.s, a.s, atol=2e-6)
        np.testing.assert_allclose(b.curvature, a.curvature, atol=1e-3)
        np.testing.assert_allclose(b.extent, a.extent, atol=1e-6)
        assert (b.feed == 0.04).all() and (b.force == 20.0).all()


def test_columns_in_any_order_with_feed_force_and_more(tmp_path, sample):
    rows = [[*row, 30.0 + row[0], 12.0, "a note"] for row in rows_of(sample[2])]
    header = [*HEADER, "feed_mm_s", "force_N", "remark"]
    order = np.random.default_rng(1).permutation(len(header))
    paths, notices = read(write(tmp_path, [[row[k] for k in order] for row in rows], [header[k] for k in order]), sample)
    assert notices == ["path.csv: columns remark were ignored."]
    assert all((path.feed == 1e-3 * (30.0 + path.line)).all() and (path.force == 12.0).all() for path in paths)


def test_points_far_apart_get_others_between_them_on_the_surface(tmp_path, sample):
    """CAM systems leave out points where the way is straight; waypoints are as near to each other as asked all the same."""
    line = sample[2][0]
    kept = np.unique(np.append(np.arange(0, len(line.s), 6), len(line.s) - 1))
    feed = 30.0 + 1e3 * line.s
    rows = [[1, *(1e3 * line.p[k]), *line.n[k], *line.t[k], feed[k]] for k in kept]
    (path,), _ = read(write(tmp_path, rows, [*HEADER, "feed_mm_s"]), sample)
    assert len(path.s) == len(line.s) and path.side == line.side and np.diff(path.s).max() < 2.2e-3
    np.testing.assert_allclose(path.p, line.p, atol=2e-4)
    np.testing.assert_allclose(path.feed, 1e-3 * feed, atol=1e-5)
    assert np.abs(np.einsum("ni,ni->n", path.t, path.n)).max() < 1e-9


def test_a_way_between_points_that_leaves_the_surface_is_refused(tmp_path, sample):
    other = next(path for path in sample[2] if path.side != sample[2][0].side)
    rows = [[1, *(1e3 * path.p[k]), *path.n[k], *path.t[k]] for path, k in ((sample[2][0], 0), (sample[2][0], 1), (other, 5))]
    with pytest.raises(BadInput, match=r"path.csv, line 3, on the way to the next point: the point .* off the surface"):
        read(write(tmp_path, rows), sample)


def test_small_offsets_are_put_right_and_told(tmp_path, sample):
    rows = np.array(rows_of(sample[2][:1]))
    normals = rows[:, 4:7].copy()
    rows[:, 1:4] += 0.1 * normals
    rows[:, 7:10] += 0.005 * normals
    paths, notices = read(write(tmp_path, rows), sample)
    np.testing.assert_allclose(paths[0].p, sample[2][0].p, atol=2e-6)
    np.testing.assert_allclose(np.sum(paths[0].t * paths[0].n, axis=1), 0.0, atol=1e-12)
    assert "moved onto the surface by up to 0.100 mm" in notices[-1]


def change(row, column, value):
    def apply(rows):
        rows[row][HEADER.index(column)] = value
        return rows

    return apply


def flip(columns):
    def apply(rows):
        for row in rows[5:8]:
            for column in columns:
                row[HEADER.index(column)] *= -1.0
        return rows

    return apply


def off(rows):
    for k in range(3):
        rows[6][1 + k] += 0.3 * rows[6][4 + k]
    return rows


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (change(3, "py_mm", "abc"), r"line 5, column py_mm: 'abc' is not a number"),
        (change(3, "nz", "nan"), r"line 5, column nz: 'nan' is not a finite"),
        (change(0, "line", 0), r"line 2, column line: 0 is not a whole"),
        (change(4, "line", 2.5), r"line 6, column line: 2.5 is not a whole"),
        (change(4, "nx", 5.0), r"line 6: the vector \(nx, ny, nz\) has length"),
        (off, r"line 8: the point .* is 0.300 mm off the surface of sample, the limit is 0.2 mm"),
        (flip(["nx", "ny", "nz"]), r"line 7: the normal .* points into the blade"),
        (
            lambda rows: [[r[0], *(v / 1e3 for v in r[1:4]), *r[4:]] for r in rows],
            r"line 2: all .* points lie .* if they are in metres",
        ),
        (flip(["tx", "ty", "tz"]), r"line \d+: t is 1[78]\d deg off the way"),
        (lambda rows: [*rows[:2]], r"line 2: line 1 has 2 points, at least 3"),
        (lambda rows: [*rows[:4], rows[3], *rows[4:]], r"line 6: this point of line 1 repeats"),
        (lambda rows: [row[:-1] if k == 2 else row for k, row in enumerate(rows)], r"line 4: 9 values where .* 10 columns"),
        (lambda rows: [*rows[:5], [7, *rows[5][1:]], *rows[6:]], r"line 8, column line: line 1 was left and comes again"),
        (lambda rows: [], r"holds no row"),
    ],
)
def test_malformed_rows_are_named(tmp_path, sample, spoil, said):
    path = write(tmp_path, spoil(rows_of(sample[2][:1])))
    with pytest.raises(BadInput, match=said) as error:
        read(path, sample)
    assert str(path) in str(error.value)


def test_headers_are_checked(tmp_path, sample):
    rows = rows_of(sample[2][:1])
    with pytest.raises(BadInput, match="line 1: columns nx, tz missing"):
        read(write(tmp_path, [row[:4] + row[5:9] for row in rows], HEADER[:4] + HEADER[5:9]), sample)
    with pytest.raises(BadInput, match="column px_mm stands there twice"):
        read(write(tmp_path, [[*row, 0] for row in rows], [*HEADER, "px_mm"]), sample)
    (tmp_path / "s.csv").write_text(";".join(HEADER) + "\n" + ";".join(map(str, rows[0])))
    with pytest.raises(BadInput, match="semicolons"):
        read(tmp_path / "s.csv", sample)
    with pytest.raises(BadInput, match="above 0"):
        read(write(tmp_path, [[*row, 0.0] for row in rows], [*HEADER, "feed_mm_s"]), sample)


def test_a_pass_round_the_leading_edge_is_taken_with_a_notice(tmp_path, sample):
    z = np.linspace(0.02, 0.08, 40)
    p = blade_samples.blade_point(np.full(len(z), np.pi), z)
    n, _, along, _ = blade_samples.exact_geometry(np.full(len(z), np.pi), z)
    t = along / np.linalg.norm(along, axis=1, keepdims=True)
    rows = [[1, *(1e3 * p[k]), *n[k], *t[k]] for k in range(len(z))]
    paths, notices = read(write(tmp_path, rows), sample)
    assert paths[0].side == "edge" and "rough" in notices[-1]
    # The nose's radius is (0.5 thick 1.6)^2 / 0.5 of the chord there.
    chord = 0.05 * (1.0 - 0.25 * z / 0.1)
    exact = 1.0 / (chord * (0.5 * 0.12 * 1.6) ** 2 / 0.5)
    assert np.median(np.abs(paths[0].curvature[:, 1] / exact - 1.0)) < 0.3
    assert (paths[0].extent > 0.0).all()


def test_a_path_that_turns_back_on_itself_is_refused(tmp_path, sample):
    rows = rows_of(sample[2][:1])[:3]
    with pytest.raises(BadInput, match="deg off the way from point to point"):
        read(write(tmp_path, [rows[0], rows[1], rows[0]]), sample)


@pytest.mark.parametrize("more", [-1e-3, 1e-3])
def test_a_feed_direction_is_that_of_travel_within_a_limit(tmp_path, sample, more):
    line = sample[2][0]
    b = np.cross(line.n, line.t)
    askew = np.cos(FEED_LIMIT + more) * line.t + np.sin(FEED_LIMIT + more) * b
    rows = [[1, *(1e3 * line.p[k]), *line.n[k], *(askew[k] if k == 9 else line.t[k])] for k in range(len(line.p))]
    if more < 0:
        assert read(write(tmp_path, rows), sample)[0][0].t[9] == pytest.approx(askew[9], abs=1e-3)
    else:
        with pytest.raises(BadInput, match=r"line 11: t is 60 deg off the way .* \(limit 60 deg\)"):
            read(write(tmp_path, rows), sample)


def test_the_curvature_of_facets_is_that_of_a_cylinder_seen_along_the_feed():
    """Half of 1/R along a helix of 45 deg, as much across, and half of it in twist, whose sign is that of the helix."""
    radius, turns, rings = 0.02, 90, 31
    angle, z = np.meshgrid(np.linspace(0, 2 * np.pi, turns, endpoint=False), np.linspace(0, 0.04, rings), indexing="ij")
    corners = np.column_stack([radius * np.cos(angle.ravel()), radius * np.sin(angle.ravel()), z.ravel()])
    i, k = (v.ravel() for v in np.meshgrid(np.arange(turns), np.arange(rings - 1), indexing="ij"))
    a, b, c, d = (((i + di) % turns) * rings + k + dk for di, dk in ((0, 0), (1, 0), (1, 1), (0, 1)))
    tube = Blade("tube", "", corners, np.vstack([np.column_stack([a, b, c]), np.column_stack([a, c, d])]))
    n, around, up = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
    for sense in (1.0, -1.0):
        t = (around + sense * up) / np.sqrt(2)
        found = facet_curvature(tube, radius * n[None] + 0.02 * up, n[None], t[None], np.cross(n, t)[None])[0]
        assert found == pytest.approx(np.array([0.5, 0.5, -0.5 * sense]) / radius, rel=0.03)
