"""What is wanted: an even depth in micrometres, a stock map as CSV or PLY; maps that are refused; what is then ground."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest

from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.plan.__main__ import app
from ocp.plan.passes.stretches import whole_lines, without_places
from ocp.plan.paths import PlanOptions, lay_paths
from ocp.plan.removal.dwell import feeds_told
from ocp.plan.removal.wanted import programmed_work, wanted_of
from robots.errors import BadInput, Infeasible
from tests.plan.test_dwell import judged
from tests.support.small_plan import STEP, called, refused, small_cell, undrawn

pytestmark = pytest.mark.usefixtures("unprinted")

OPTIONS = PlanOptions(step=2e-3)
PRESTON = 5e-13  # 1/Pa, 0.5 um mm^2 / (N m)


@pytest.fixture(scope="module")
def cell():
    cell = read_cell(CELL)
    process = replace(cell.process, side="convex", root_margin=0.045, edge_margin=0.008, preston=PRESTON)
    return replace(cell, process=process)


@pytest.fixture(scope="module")
def laid(cell):
    return lay_paths(cell, cell.workpiece.stl, OPTIONS)


def map_rows(laid, depth_um) -> list[list[float]]:
    """Points of the flank in steps of 3.5 mm, depth_um of their z in m."""
    points = laid.flanks[0].points[2::5, 2::5].reshape(-1, 3)
    return [[*(1e3 * p), float(depth_um(p[2]))] for p in points]


def write_csv(file, rows):
    lines = ["px_mm,py_mm,pz_mm,depth_um", *(",".join(f"{v:.6f}" for v in row) for row in rows)]
    file.write_text("\n".join(lines) + "\n")
    return file


def write_ply(file, rows, last="depth_um"):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n"
    head += "".join(f"property float {name}\n" for name in ("x", "y", "z", last)) + "end_header\n"
    file.write_text(head + "\n".join(" ".join(f"{v:.6f}" for v in row) for row in rows) + "\n")
    return file


def test_the_programmed_depth_is_prestons(cell, laid):
    process = cell.process
    work = process.force * cell.wheel.belt_speed / (process.feed * process.pass_spacing)
    assert programmed_work(cell) == pytest.approx(work)
    assert laid.wanted.programmed_um == pytest.approx(1e6 * PRESTON * work)
    assert laid.wanted.at(np.zeros((3, 3)), np.zeros((3, 3))) == pytest.approx(1.0)


def test_an_even_depth_in_micrometres_sets_the_feed(cell, laid):
    """Twice the depth at half the feed; without Preston's coefficient the programmed feed is believed to make it."""
    deep = replace(cell, process=replace(cell.process, removal=2e-6 * laid.wanted.programmed_um))
    slower = lay_paths(deep, cell.workpiece.stl, OPTIONS)
    for one, other in zip(laid.paths, slower.paths, strict=True):
        assert other.feed == pytest.approx(0.5 * one.feed, rel=1e-3)
    unknown = replace(cell, process=replace(deep.process, preston=None))
    wanted = wanted_of(unknown, laid.blade, laid.cloud, None)
    assert (wanted.even, wanted.programmed_um) == (1.0, None)


@pytest.mark.parametrize("kind", ["csv", "ply"])
def test_a_stock_map_is_taken_off(cell, laid, tmp_path, kind):
    """Twice as deep at the tip as at the middle of the blade, each within a few per cent."""
    made = laid.wanted.programmed_um

    def depth(z):
        return made * (0.8 + 0.8 * (z - 0.05) / 0.06)

    write = write_csv if kind == "csv" else write_ply
    stock = write(tmp_path / f"stock.{kind}", map_rows(laid, depth))
    mapped = lay_paths(cell, cell.workpiece.stl, replace(OPTIONS, stock=stock))
    cells = mapped.flanks[0]
    asked = mapped.wanted.at(cells.points[cells.asked], cells.normals[cells.asked])
    assert asked == pytest.approx(depth(cells.points[cells.asked][:, 2]) / made, rel=0.05)
    slower = [path.feed[-1] / path.feed[0] for path in mapped.paths]
    even = [path.feed[-1] / path.feed[0] for path in laid.paths]
    assert np.mean(slower) < 0.75 * np.mean(even)  # the tip is deeper
    figures, _ = judged(cell, mapped)
    assert figures.core_within_10 is not None and figures.core_within_10 > 0.95
    assert "stock map" in feeds_told(cell, mapped.paths, mapped.wanted, laid=True)


def test_a_map_of_removal_um_needs_no_preston(cell, laid, tmp_path):
    stock = write_csv(tmp_path / "stock.csv", map_rows(laid, lambda z: 30.0))
    process = replace(cell.process, preston=None, removal=20e-6)
    wanted = wanted_of(replace(cell, process=process), laid.blade, laid.cloud, stock)
    assert wanted.ratio == pytest.approx(1.5) and wanted.programmed_um is None
    with pytest.raises(BadInput, match="neither process.preston_um_mm2_per_N_m nor process.removal_um"):
        wanted_of(replace(cell, process=replace(process, removal=None)), laid.blade, laid.cloud, stock)


def spoilt(rows, how):
    rows = [list(row) for row in rows]
    if how == "other blade":
        return [[x, y + 4.0, z, d] for x, y, z, d in rows]
    if how == "half":
        return [row for row in rows if row[2] < 70.0]
    rows[7][3] = {"negative": -3.0, "absurd": 5000.0, "nan": np.nan}[how]
    return rows if how != "few" else rows[:3]


REFUSALS = [
    ("negative", "csv", "line 9, column depth_um: -3"),
    ("absurd", "csv", "line 9, column depth_um: 5000"),
    ("nan", "csv", "line 9, column depth_um"),
    ("negative", "ply", "vertex 8: depth_um = -3"),
    ("nan", "ply", "vertex 8: depth_um = nan"),
    ("other blade", "csv", "mm off the surface of blade.stl"),
    ("half", "csv", "has no point of the map within 10 mm"),
]


@pytest.mark.parametrize(("how", "kind", "says"), REFUSALS)
def test_maps_that_are_refused(cell, laid, tmp_path, how, kind, says):
    rows = spoilt(map_rows(laid, lambda z: laid.wanted.programmed_um), how)
    stock = (write_csv if kind == "csv" else write_ply)(tmp_path / f"stock.{kind}", rows)
    with pytest.raises(BadInput, match=says) as error:
        lay_paths(cell, cell.workpiece.stl, replace(OPTIONS, stock=stock))
    assert str(stock) in str(error.value) and str(error.value).count("\n") == 0


def test_a_ply_without_the_property_and_a_file_that_is_none(cell, laid, tmp_path):
    rows = map_rows(laid, lambda z: 10.0)
    with pytest.raises(BadInput, match="its vertices lack depth_um"):
        wanted_of(cell, laid.blade, laid.cloud, write_ply(tmp_path / "stock.ply", rows, "quality"))
    (tmp_path / "noise.ply").write_bytes(b"\x00\x01 no ply")
    with pytest.raises(BadInput, match="no PLY file"):
        wanted_of(cell, laid.blade, laid.cloud, tmp_path / "noise.ply")
    with pytest.raises(BadInput, match="3 points are no map"):
        wanted_of(cell, laid.blade, laid.cloud, write_csv(tmp_path / "few.csv", rows[:3]))


def test_a_depth_beyond_reach_is_left_out_by_name(cell, laid, tmp_path):
    """Nothing is wanted below z = 65 mm: that part of every line is left out, the rest keeps its feeds."""
    made = laid.wanted.programmed_um
    stock = write_csv(tmp_path / "stock.csv", map_rows(laid, lambda z: made if z > 0.065 else 0.0))
    mapped = lay_paths(cell, cell.workpiece.stl, replace(OPTIONS, stock=stock))
    assert len(mapped.beyond) == len(mapped.paths)
    assert "um are wanted" in str(mapped.beyond[0]) and "line 1 (convex)" in str(mapped.beyond[0])
    whole, _ = whole_lines(mapped.paths, [np.zeros((len(path.s), 3)) for path in mapped.paths])
    kept, lost = without_places(whole, mapped.beyond, False)
    assert {one.line for one in lost} == {path.line for path in mapped.paths}
    for stretch in kept:
        assert stretch.path.p[:, 2].min() > 0.06 and stretch.path.feed.max() < 0.3
    with pytest.raises(Infeasible, match="are wanted"):
        without_places(whole, mapped.beyond, True)


def test_a_depth_that_no_feed_makes_leaves_everything_out(cell, laid):
    for removal, remedy in ((5000e-6, "more than once"), (0.02e-6, "leave that place unground")):
        asked = replace(cell, process=replace(cell.process, removal=removal))
        beyond = lay_paths(asked, cell.workpiece.stl, OPTIONS).beyond
        assert len(beyond) == len(laid.paths) and remedy in str(beyond[0])


def test_the_command_refuses_in_one_sentence_and_writes_nothing(tmp_path):
    cell = small_cell(tmp_path)
    told = refused("--cell", str(cell), "--stock", str(tmp_path / "absent.csv"), "--out", str(tmp_path / "plan"))
    assert told.code == 2 and "absent.csv" in told.err and told.err.strip().count("\n") == 0
    assert not (tmp_path / "plan").exists()


def test_the_command_takes_a_stock_map_off_and_says_how_much(tmp_path, laid):
    """plan.csv in micrometres of the map's depth, plan.json with the shares and with what is beyond reach."""
    made = laid.wanted.programmed_um
    cell = small_cell(tmp_path, {'grinding = "down"': f'grinding = "down"\npreston_um_mm2_per_N_m = {1e12 * PRESTON:g}'})
    write_csv(tmp_path / "stock.csv", map_rows(laid, lambda z: 1.2 * made if z > 0.075 else 0.0))
    with undrawn():
        told = called(app, tmp_path, "--cell", str(cell), "--stock", "stock.csv", *STEP)
    assert told.code == 0, told
    content = json.loads((tmp_path / "plan" / "plan.json").read_text())
    assert {"cell", "blade", "stock"} <= {one["role"] for one in content["inputs"]}
    assert content["left_out"] and all("um are wanted" in one["reason"] for one in content["left_out"])
    assert set(content["process"]) == {
        *("ground_share", "core_within_5", "core_within_10", "all_within_10"),
        *("least", "most", "most_beside", "contact_in_travel_s"),
    }
    with (tmp_path / "plan" / "plan.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["contact"] == "1"]
    depth, relative = (np.array([float(row[name] or "nan") for row in rows]) for name in ("removal_um", "removal_rel"))
    deep = np.array([float(row["pz_mm"]) for row in rows])
    middle = (deep > 85.0) & (deep < 98.0)
    assert depth[middle] == pytest.approx(1.2 * made, rel=0.25)
    assert depth[middle] == pytest.approx(relative[middle] * 1.2 * made, rel=0.02)
