"""The surface is followed, the solid is filled, the clamp plane is met, and what cannot be meshed is refused."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from ocp.contact.blade import surface_mesh
from ocp.contact.blade import volume_mesh as module
from ocp.contact.blade.elasticity import quadratic_mesh, tetra_volumes
from ocp.contact.blade.surface_mesh import edges_of, remesh, shape_quality
from ocp.contact.blade.volume_mesh import clamp_cut, surface_area, surface_volume, volume_mesh
from ocp.shell import cache
from robots.errors import BadInput
from trajectories.blade.intersections import self_intersections

BLADES = Path(__file__).parents[2].parent / "shared" / "data" / "blades"


@pytest.fixture(autouse=True)
def no_cache(monkeypatch):
    monkeypatch.setenv(cache.VARIABLE, "")


def arrays(shape):
    return np.array(shape.vertices, float), np.array(shape.faces, np.int64)


def wedge():
    """A blade-like prism 60 x 40 mm, 4 mm thick at the back and 0.2 mm at the edge, with a tang."""
    outline = np.array([[0, -2], [40, -0.1], [40, 0.1], [0, 2]]) * 1e-3
    low, high = np.column_stack([outline, np.zeros(4)]), np.column_stack([outline, np.full(4, 0.06)])
    faces = [[0, 2, 1], [0, 3, 2], [4, 5, 6], [4, 6, 7]]
    for i in range(4):
        j = (i + 1) % 4
        faces += [[i, j, j + 4], [i, j + 4, i + 4]]
    return np.vstack([low, high]), np.array(faces)


def test_edges_refuse_an_open_surface():
    _, faces = arrays(trimesh.creation.box((1, 1, 1)))
    edges = edges_of(faces)
    assert len(edges.ends) == 18
    for (a, b), face in zip(edges.ends, edges.face, strict=True):
        assert {a, b} <= set(faces[face[0]]) and {a, b} <= set(faces[face[1]])
    with pytest.raises(ValueError, match="closed"):
        edges_of(faces[:-1])


@pytest.mark.parametrize("size", [2e-3, 4e-3])
def test_remeshing_keeps_a_prism_exactly_and_mends_its_needles(size):
    vertices, faces = wedge()
    points, triangles = remesh(vertices, faces, lambda x: np.full(len(x), size), 1e-5)
    assert surface_volume(points, triangles) == pytest.approx(surface_volume(vertices, faces), rel=1e-9)
    assert surface_area(points, triangles) == pytest.approx(surface_area(vertices, faces), rel=1e-9)
    length = np.linalg.norm(np.diff(points[edges_of(triangles).ends], axis=1), axis=2)
    assert length.max() < 1.4 * size
    quality = shape_quality(points[triangles])
    assert np.median(quality) > 0.75 and np.median(shape_quality(vertices[faces])) < 0.6
    assert len(triangles) < 4.0 * surface_area(points, triangles) / size**2 + 600


def test_remeshed_sphere_stays_within_the_tolerance():
    vertices, faces = arrays(trimesh.creation.icosphere(subdivisions=4, radius=0.02))
    tolerance = 2e-4
    points, triangles = remesh(vertices, faces, lambda x: np.full(len(x), 4e-3), tolerance)
    assert len(triangles) < 0.7 * len(faces)
    middles = points[triangles].mean(axis=1)
    distance = trimesh.proximity.closest_point(trimesh.Trimesh(vertices, faces, process=False), middles)[1]
    assert 1e-5 < distance.max() < tolerance


@pytest.mark.parametrize(("noise", "tolerance"), [(0.0, 4e-5), (1.5e-5, 1e-5)])
def test_a_scan_with_tens_of_facets_for_each_that_is_wanted_is_drawn_together(monkeypatch, noise, tolerance):
    """A scanner's noise is larger than the tolerance: of a blade's million facets 400 000 stayed."""
    monkeypatch.setattr(surface_mesh, "CROWDED", 5000)
    sphere, faces = arrays(trimesh.creation.icosphere(subdivisions=5, radius=0.02))
    scanned = sphere * (1.0 + np.random.default_rng(0).normal(0.0, noise, (len(sphere), 1)) / 0.02)
    points, triangles = remesh(scanned, faces, lambda x: np.full(len(x), 4e-3), tolerance)
    assert len(triangles) < 6000  # 10 156 of the noisy one without being smoothed
    edges_of(triangles)  # closed
    assert np.abs(np.linalg.norm(points, axis=1) - 0.02).max() < 1e-5 + 1.5 * noise  # of the scan's own corners up to 58 um
    assert surface_volume(points, triangles) == pytest.approx(surface_volume(sphere, faces), rel=2e-3)


def test_sharp_edges_of_a_clean_surface_are_no_noise(monkeypatch):
    """The rims of a blade of 645 000 clean facets were moved by 30 um: folded, no mesher filled it."""
    monkeypatch.setattr(surface_mesh, "CROWDED", 5000)
    vertices, faces = wedge()
    for _ in range(5):
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    points, triangles = remesh(vertices, faces, lambda x: np.full(len(x), 4e-3), 1e-5)
    assert not len(self_intersections(points, triangles))
    np.testing.assert_allclose(np.ptp(points, axis=0), np.ptp(vertices, axis=0), atol=1e-5)  # 60 um more


def test_a_real_blade_with_edges_of_a_fifth_of_a_millimetre_is_meshed():
    path = BLADES / "rotor37.stl"
    if not path.exists():
        pytest.skip("the blades of ../shared/data are not there")
    vertices, faces = arrays(trimesh.load(path))
    result = volume_mesh(vertices * 1e-3, faces, 4e-3)
    assert result.mesher == "netgen" and abs(result.volume_error) < 2e-3
    mesh = result.mesh
    assert 1000 < len(mesh.elements) < 15_000
    assert tetra_volumes(mesh.nodes, mesh.elements).min() > 0.0
    corner = mesh.nodes[mesh.surface[:, :3]]
    outward = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert np.abs(outward.sum(axis=0)).max() < 1e-12  # closed
    assert np.sum(corner.mean(axis=1) * outward) / 6.0 == pytest.approx(mesh.volume, rel=1e-9)
    middles = 0.5 * (mesh.nodes[mesh.surface[:, :3]] + mesh.nodes[np.roll(mesh.surface[:, :3], -1, axis=1)])
    np.testing.assert_allclose(mesh.nodes[mesh.surface[:, 3:]], middles, atol=1e-12)
    distance = trimesh.proximity.closest_point(trimesh.Trimesh(vertices * 1e-3, faces), mesh.nodes[mesh.surface[::7, 0]])[1]
    assert distance.max() < 2.0 * module.TOLERANCE


def test_same_surface_gives_the_same_mesh():
    vertices, faces = wedge()
    one, two = volume_mesh(vertices, faces, 8e-3), volume_mesh(vertices, faces, 8e-3)
    np.testing.assert_array_equal(one.mesh.nodes, two.mesh.nodes)
    np.testing.assert_array_equal(one.mesh.elements, two.mesh.elements)


def test_fallback_mesher_fills_the_surface(monkeypatch):
    run = module._run

    def no_netgen(mesher, *rest):
        if mesher == "netgen":
            raise ValueError("gave up")
        return run(mesher, *rest)

    monkeypatch.setattr(module, "_run", no_netgen)
    result = volume_mesh(*arrays(trimesh.creation.box((0.02, 0.01, 0.005))), 4e-3)
    assert result.mesher == "fTetWild" and abs(result.volume_error) < 0.01


def test_a_mesh_of_too_many_elements_is_made_with_longer_edges(monkeypatch):
    surface = arrays(trimesh.creation.box((0.02, 0.01, 0.005)))
    fine = len(volume_mesh(*surface, 2e-3).mesh.elements)
    monkeypatch.setattr(module, "MAX_ELEMENTS", round(0.7 * fine))
    coarser = volume_mesh(*surface, 2e-3)
    assert coarser.mesher == "netgen" and 0.1 * fine < len(coarser.mesh.elements) <= 0.7 * fine
    assert abs(coarser.volume_error) < 0.01


def test_no_mesher_is_a_sentence(monkeypatch):
    monkeypatch.setattr(module, "SECONDS", {"netgen": 0.01, "fTetWild": 0.01})
    monkeypatch.setattr(module, "PATIENCE", 1)
    with pytest.raises(BadInput, match=r"could not be filled .*netgen at 4 mm: not done after .*fTetWild.*repair") as caught:
        volume_mesh(*wedge(), 4e-3)
    assert "\n" not in str(caught.value)


def test_a_mesher_is_given_up_by_what_it_computes_not_by_the_clock(monkeypatch, tmp_path):
    busy = tmp_path / "mesher.py"
    text = Path(module.__file__).with_name("mesher.py").read_text()
    busy.write_text(text.replace("    mesh_file(*sys.argv[1:4])", "    while True:\n        pass"))
    monkeypatch.setattr(module, "__file__", str(busy))
    monkeypatch.setattr(module, "SECONDS", {"netgen": 1, "fTetWild": 1})
    with pytest.raises(BadInput, match=r"netgen at 4 mm: not done after 1 s of computing; .*fTetWild"):
        volume_mesh(*wedge(), 4e-3)


def test_a_batch_queue_may_limit_the_computing_itself(monkeypatch):
    limited = "import resource; resource.setrlimit(resource.RLIMIT_CPU, (600, 600))\n"
    real = module.subprocess.run

    def run(command, **options):
        python, flag, script, *rest = command
        begin = f"{limited}import runpy, sys; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"
        return real([python, flag, "-c", begin, script, *rest], **options)

    monkeypatch.setattr(module.subprocess, "run", run)
    assert volume_mesh(*wedge(), 4.1e-3).mesher == "netgen"


def test_useless_surfaces_and_sizes_are_refused():
    vertices, faces = wedge()
    with pytest.raises(BadInput, match="open"):
        volume_mesh(vertices, faces[1:], 4e-3)
    with pytest.raises(BadInput, match="inwards"):
        volume_mesh(vertices, faces[:, ::-1], 4e-3)
    with pytest.raises(BadInput, match="positive"):
        volume_mesh(vertices, faces, np.nan)
    with pytest.raises(BadInput, match="take at least"):
        volume_mesh(vertices, faces, 1e-4)


def test_clamp_cut_is_exact_and_conforming():
    mesh = volume_mesh(*wedge(), 8e-3).mesh
    corners = mesh.elements[:, :4]
    normal = np.array([0.2, 0.1, 1.0])
    normal /= np.linalg.norm(normal)
    points, tetrahedra = clamp_cut(mesh.nodes[: corners.max() + 1], corners, normal, 0.02)
    volume, height = tetra_volumes(points, tetrahedra), points @ normal - 0.02
    assert volume.min() > 0.0 and volume.sum() == pytest.approx(mesh.volume, rel=1e-6)
    across = height[tetrahedra]
    assert not np.any((across.min(axis=1) < -1e-12) & (across.max(axis=1) > 1e-12))
    whole = quadratic_mesh(points, tetrahedra)
    corner = whole.nodes[whole.surface[:, :3]]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum() / 2
    assert area == pytest.approx(surface_area(*wedge()), rel=1e-5)  # no cracks inside
    with pytest.raises(BadInput, match="holds nothing"):
        clamp_cut(points, tetrahedra, normal, -1.0)
    with pytest.raises(BadInput, match="holds all"):
        clamp_cut(points, tetrahedra, normal, 1.0)
