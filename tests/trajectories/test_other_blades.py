"""Blades that are no STL: the same surface from PLY and OBJ, a STEP's own surface, what is done with a scan's openings."""

import numpy as np
import pytest
import trimesh

from ocp.data import CELL
from robots.errors import BadInput
from trajectories.blade import read_blade
from trajectories.blade.mesh import volume

POINTS = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {a}\n" for a in "xyz") + "end_header\n"
STL = CELL.parent / "blade.stl"


@pytest.fixture(scope="module")
def mesh():
    return trimesh.load(STL)


@pytest.mark.parametrize("kind", ["ply", "obj"])
def test_the_same_surface_is_read_from_another_file(tmp_path, mesh, kind):
    mesh.export(tmp_path / f"blade.{kind}")
    one, other = read_blade(STL), read_blade(tmp_path / f"blade.{kind}")
    assert len(other.faces) == len(one.faces) and other.notices == one.notices
    assert volume(other.vertices, other.faces) == pytest.approx(volume(one.vertices, one.faces), rel=1e-6)


def test_a_flat_end_of_a_scan_is_closed_and_told(tmp_path, mesh):
    kept = mesh.faces[mesh.triangles_center[:, 2] > 0.5]
    trimesh.Trimesh(mesh.vertices, kept).export(tmp_path / "scan.ply")
    scan, whole = read_blade(tmp_path / "scan.ply"), read_blade(STL)
    assert volume(scan.vertices, scan.faces) == pytest.approx(volume(whole.vertices, whole.faces), rel=1e-6)
    assert "1 holes were closed" in scan.notices[0] and "56.9" in scan.notices[0].replace("56.88", "56.9")


def test_what_a_scan_did_not_see_is_not_invented(tmp_path, mesh):
    seen = mesh.faces[(mesh.triangles_center - mesh.centroid) @ [0.0, 1.0, 0.0] > 0]
    trimesh.Trimesh(mesh.vertices, seen).export(tmp_path / "scan.ply")
    with pytest.raises(BadInput, match=r"scan.ply: the surface is open: .* scan that side too"):
        read_blade(tmp_path / "scan.ply")


def test_an_open_stl_is_refused_as_ever(tmp_path, mesh):
    kept = mesh.faces[mesh.triangles_center[:, 2] > 0.5]
    trimesh.Trimesh(mesh.vertices, kept).export(tmp_path / "open.stl")
    with pytest.raises(BadInput, match="export a closed solid"):
        read_blade(tmp_path / "open.stl")


def test_a_step_is_laid_with_facets_whose_error_is_told(tmp_path):
    occ = pytest.importorskip("netgen.occ")
    occ.Cylinder(occ.Pnt(0, 0, 0), occ.Z, r=10, h=60).WriteStep(str(tmp_path / "rod.step"))
    rod = read_blade(tmp_path / "rod.step")
    told = float(rod.notices[0].split("up to ")[1].split(" um")[0]) * 1e-6
    round_face = np.abs(rod.vertices[:, 2] - 0.03) < 0.0299
    assert np.hypot(*rod.vertices[round_face, :2].T) == pytest.approx(np.full(round_face.sum(), 0.01), abs=1e-7)
    assert volume(rod.vertices, rod.faces) == pytest.approx(np.pi * 0.01**2 * 0.06, rel=2 * told / 0.01 + 1e-4)
    assert 0 < told < 1e-4


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("points.ply", f"{POINTS}1 2 3\n", "no facet"),
        ("bad.ply", "ply\nformat ascii 1.0\nelement vertex x\n", "cannot be read as PLY"),
        ("bad.obj", "v 1 2\nf a b c\n", "cannot be read as OBJ"),
        ("bad.step", "ISO-10303-21;\nHEADER;", "no surface can be made"),
        ("zip.stp", "PK", "is no STEP file"),
        ("nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "no finite number"),
    ],
)
def test_a_broken_file_is_one_sentence(tmp_path, capfd, name, text, told):
    (tmp_path / name).write_text(text)
    with pytest.raises(BadInput, match=name) as error:
        read_blade(tmp_path / name)
    assert told in str(error.value) and "\n" not in str(error.value)
    assert capfd.readouterr() == ("", "")


def test_a_step_has_its_own_unit(tmp_path):
    (tmp_path / "a.step").write_text("ISO-10303-21;")
    with pytest.raises(BadInput, match="carries its own unit"):
        read_blade(tmp_path / "a.step", "in")
