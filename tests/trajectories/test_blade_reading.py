from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robots.errors import BadInput
from robots.pose import rotation_from_abc
from tests.support import blade_samples
from trajectories.blade import read_blade
from trajectories.blade.intersections import overlapping_boxes, self_intersections
from trajectories.blade.mesh import volume

BLADES = Path(__file__).parents[2].parent / "shared" / "data" / "blades"
needs_data = pytest.mark.skipif(not BLADES.is_dir(), reason="the shared data folder is not beside this repository")


@pytest.fixture(scope="module")
def sample():
    return blade_samples.blade_mesh(60, 20)


def write(tmp_path, vertices, faces, unit=1e-3):
    return blade_samples.write_stl(tmp_path / "b.stl", vertices, faces, unit)


def as_ascii(vertices, faces):
    lines = ["solid a blade of mine"]
    for corners in np.float32(1e3 * vertices).astype(float)[faces]:
        lines += ["facet normal 0 0 0", " outer loop"]
        lines += [f"  vertex {x:.17g} {y:.17g} {z:.17g}" for x, y, z in corners]
        lines += [" endloop", "endfacet"]
    return "\n".join([*lines, "endsolid a blade of mine"])


def refusal(path, unit="mm"):
    with pytest.raises(BadInput) as error:
        read_blade(path, unit)
    text = str(error.value)
    assert str(path) in text and "\n" not in text and text.endswith(".")
    return text


def test_binary_and_ascii_give_the_same_blade(tmp_path, sample):
    binary = read_blade(write(tmp_path, *sample))
    (tmp_path / "a.stl").write_text(as_ascii(*sample))
    text = read_blade(tmp_path / "a.stl")
    assert binary.notices == text.notices == ()
    np.testing.assert_array_equal(binary.vertices, text.vertices)
    np.testing.assert_array_equal(binary.faces, text.faces)
    assert len(binary.vertices) == len(sample[0]) and len(binary.faces) == len(sample[1])
    assert volume(binary.vertices, binary.faces) == pytest.approx(volume(*sample), rel=1e-6)


def test_a_binary_file_that_starts_with_solid_is_binary(tmp_path, sample):
    path = write(tmp_path, *sample)
    data = path.read_bytes()
    path.write_bytes(b"solid from a careless exporter".ljust(80) + data[80:])
    assert len(read_blade(path).faces) == len(sample[1])


@pytest.mark.parametrize(("unit", "metres"), [("mm", 1e-3), ("m", 1.0), ("in", 0.0254)])
def test_units(tmp_path, sample, unit, metres):
    blade = read_blade(write(tmp_path, *sample, metres), unit)
    assert np.ptp(blade.vertices[:, 2]) == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize(("metres", "said"), [(1.0, '"m"'), (0.0254, '"in"')])
def test_a_file_in_another_unit_is_told_apart(tmp_path, sample, metres, said):
    text = refusal(write(tmp_path, *sample, metres))
    assert f"set stl_unit = {said}" in text and " mm " in text


def test_unknown_unit(tmp_path, sample):
    with pytest.raises(BadInput, match="stl_unit = 'cm' is not known"):
        read_blade(write(tmp_path, *sample), "cm")


def test_empty_cut_short_and_foreign_files(tmp_path, sample):
    path = write(tmp_path, *sample)
    data = path.read_bytes()
    path.write_bytes(b"")
    assert "empty" in refusal(path)
    path.write_bytes(data[: 84 + 50 * 100 + 17])
    text = refusal(path)
    assert "byte 5101" in text and "facet 101 of the" in text
    path.write_bytes(data[:84][:80] + b"\0\0\0\0")
    assert "no facet" in refusal(path)
    path.write_bytes(b"PK\x03\x04" + data[:500])
    assert "zip" in refusal(path)
    path.write_text("# notes\nhello\n")
    assert "no STL file" in refusal(path)
    path.write_bytes(bytes(range(256)) * 40)
    assert "no STL file" in refusal(path)
    path.write_bytes(data + b"tail")
    assert "4 bytes after the last" in read_blade(path).notices[0]
    assert "cannot be read" in refusal(tmp_path / "nowhere.stl")


@pytest.mark.parametrize(
    ("at", "new", "said"),
    [
        (703, "vertex 1 2 zwei", "'zwei' is not a number"),
        (703, "vertex 1 2", "2 numbers after 'vertex'"),
        (705, "endloop", "'vertex' is expected"),
        (701, "facet normal 0 0", "2 numbers after 'facet normal'"),
    ],
)
def test_ascii_errors_name_the_line(tmp_path, sample, at, new, said):
    lines = as_ascii(*sample).split("\n")  # line 1 is the title, then 7 lines a facet
    lines[at] = new
    (tmp_path / "a.stl").write_text("\n".join(lines))
    text = refusal(tmp_path / "a.stl")
    assert f"line {at + 1}:" in text and said in text


def test_ascii_cut_short(tmp_path, sample):
    (tmp_path / "a.stl").write_text("\n".join(as_ascii(*sample).split("\n")[:500]))
    assert "ends at line 500 inside a facet" in refusal(tmp_path / "a.stl")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_values_that_are_no_place(tmp_path, sample, value):
    vertices, faces = sample[0].copy(), sample[1]
    vertices[faces[41, 0]] = value
    first = int(np.argmax((faces == faces[41, 0]).any(axis=1)))
    assert f"facet {first + 1}:" in refusal(write(tmp_path, vertices, faces))


def test_faults_that_are_mended(tmp_path, sample):
    vertices, faces = sample
    exact = volume(np.float32(1e3 * vertices).astype(float) * 1e-3, faces)
    turned = faces.copy()
    turned[::7] = turned[::7, ::-1]
    cases = {
        "inside-out": faces[:, ::-1],
        "wound the other way": turned,
        "without area": np.vstack([faces, [[0, 0, 5], [7, 8, 7]]]),
        "repeated": np.vstack([faces, faces[:3]]),
    }
    for said, bad in cases.items():
        blade = read_blade(write(tmp_path, vertices, bad))
        assert any(said in notice for notice in blade.notices), (said, blade.notices)
        assert volume(blade.vertices, blade.faces) == pytest.approx(exact, rel=1e-9)
        assert len(blade.faces) == len(faces)


@pytest.mark.parametrize("copies", [2, 3])
def test_a_surface_that_stands_there_several_times_is_read_once(tmp_path, sample, copies):
    vertices, faces = sample
    again = [np.roll(faces, k, axis=1) for k in range(copies)]  # the same winding, begun at another corner
    blade = read_blade(write(tmp_path, vertices, np.concatenate(again)))
    assert blade.notices == (f"{(copies - 1) * len(faces)} repeated facets were removed.",)
    assert volume(blade.vertices, blade.faces) == pytest.approx(volume(*sample), rel=1e-6)


def test_a_surface_with_its_own_inside_is_refused_for_what_it_is(tmp_path, sample):
    vertices, faces = sample
    text = refusal(write(tmp_path, vertices, np.concatenate([faces, faces[:, ::-1]])))
    n = 2 * len(faces)
    assert f"{n} facets leave 0 ({n} repeated facets were removed), which is no solid body" in text


def test_a_facet_whose_corners_lie_on_a_line_is_mended_closed(tmp_path, sample):
    vertices, faces = sample
    a, b, c = faces[500]
    middle = len(vertices)
    # A vertex on the edge a-b, known to one of the two neighbours only, and a flat facet to keep the mesh closed.
    more = np.vstack([np.float32(1e3 * vertices), [0.5 * (np.float32(1e3 * vertices[a]) + np.float32(1e3 * vertices[b]))]])
    split = np.vstack([np.delete(faces, 500, 0), [[a, middle, c], [middle, b, c], [a, b, middle]]])
    blade = read_blade(write(tmp_path, 1e-3 * more, split))
    assert any("without area" in notice for notice in blade.notices)
    edges = np.sort(np.concatenate([blade.faces[:, [0, 1]], blade.faces[:, [1, 2]], blade.faces[:, [2, 0]]]), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_stray_parts_are_dropped_and_two_bodies_refused(tmp_path, sample):
    vertices, faces = sample
    both = np.vstack([faces, faces + len(vertices)])
    stray = np.vstack([vertices, 0.05 * vertices + np.array([0.2, 0.0, 0.0])])
    blade = read_blade(write(tmp_path, stray, both))
    assert "stray" in blade.notices[0] and len(blade.faces) == len(faces)
    text = refusal(write(tmp_path, np.vstack([vertices, vertices + np.array([0.2, 0.0, 0.0])]), both))
    assert "2 separate bodies" in text and "mm" in text


def test_facets_on_a_line_are_no_blade(tmp_path):
    line = np.outer(np.arange(12.0), [1.0, 2.0, 0.5]) * 1e-3
    assert "no facet has an area" in refusal(write(tmp_path, line, np.array([[k, k + 1, k + 2] for k in range(10)])))


def test_a_large_hole_is_refused_with_its_place(tmp_path, sample):
    vertices, faces = sample
    centres = vertices[faces].mean(axis=1)
    keep = np.linalg.norm(centres - centres[1000], axis=1) > 0.008
    text = refusal(write(tmp_path, vertices, faces[keep]))
    assert "the surface is open: a hole" in text and "mm" in text


def test_an_edge_with_three_facets_is_refused(tmp_path, sample):
    vertices, faces = sample
    fin = np.vstack([vertices, vertices[faces[300, :2]].mean(axis=0) + np.array([0.0, 0.01, 0.0])])
    assert "facets meet at the edge" in refusal(
        write(tmp_path, fin, np.vstack([faces, [[faces[300, 0], faces[300, 1], len(vertices)]]]))
    )


def test_crossing_walls_are_refused_with_the_place(tmp_path, sample):
    vertices, faces = sample[0].copy(), sample[1]
    row = np.abs(vertices[:, 2] - vertices[60 * 10, 2]) < 1e-9
    lower = row & (vertices[:, 1] < vertices[row, 1].mean())
    vertices[lower, 1] += 0.012
    text = refusal(write(tmp_path, vertices, faces))
    assert "cuts through itself" in text and "mm" in text


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_box_pairs_equal_brute_force(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 120))
    low = rng.uniform(size=(n, 3))
    high = low + rng.uniform(0.0, 0.5, (n, 3)) * rng.integers(0, 2, (n, 1))
    meet = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    expected = {(i, j) for i, j in np.argwhere(meet) if i < j}
    found = overlapping_boxes(low, high)
    assert len(found) == len(expected) and set(map(tuple, found.tolist())) == expected


def test_two_crossing_triangles_and_two_that_touch():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.2, 0.2, 1], [0.3, 0.3, 2.0]], float)
    for pair in ([[0, 1, 2], [3, 4, 5]], [[3, 4, 5], [0, 1, 2]]):  # here only the second one's edge pierces the first
        assert len(self_intersections(vertices, np.array(pair))) == 1
    vertices[3:5, 2] = 0.0, 1.0  # only its tip reaches the first triangle
    assert len(self_intersections(vertices, np.array([[0, 1, 2], [3, 4, 5]]))) == 0


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
@settings(max_examples=10, deadline=None)
def test_crossings_do_not_depend_on_the_position(angles):
    vertices, faces = blade_samples.blade_mesh(24, 6)
    bent = vertices.copy()
    bent[24 * 3 + 6] -= [0.0, 0.02, 0.0]
    count = len(self_intersections(bent, faces))
    assert count > 0
    assert len(self_intersections(bent @ rotation_from_abc(angles).T + 0.3, faces)) == count


@needs_data
def test_blades_of_the_data_folder():
    for name in ("twisted", "rotor37"):
        assert read_blade(BLADES / f"{name}.stl").notices == ()
    whole = read_blade(BLADES / "twisted.stl")
    mended = read_blade(BLADES / "holes.stl")
    assert "2 holes were closed with 3 facets" in mended.notices[0]
    assert volume(mended.vertices, mended.faces) == pytest.approx(volume(whole.vertices, whole.faces), rel=1e-6)
    assert len(mended.faces) == len(whole.faces)
    assert "cuts through itself" in refusal(BLADES / "self_intersecting.stl")
