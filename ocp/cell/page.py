"""The page of a cell: what was found, the cell to be turned, the numbers for the controller, where the wheel may stand."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from ocp.cell.examination import DOUBT, KNOWN, MISTAKE, UNMEASURED, Examined, Grindable
from ocp.cell.new import WheelRegion, arm_length, wheel_region
from ocp.model.cell import Cell, payloads_of, wheel_frame
from ocp.plan.report.scene import arm_drawn, wheel_drawn
from ocp.report.parts import Plot, made_from, table
from ocp.report.plotting import Canvas, dressed, panels
from ocp.report.report import Report
from ocp.report.scene_kit import encode, encode_index, scene_script, scene_style, script_json
from ocp.report.section import Headline, Part, Section
from ocp.report.style import COLOUR_MAP, INK, VIRIDIS
from robots.inverse import arm_family
from robots.kinematics import link_frames
from robots.pose import Array, abc_from_rotation
from robots.tracker_readings import Hanging

_VIEWER = Path(__file__).parent / "viewer"
AXES_OF_FRAMES = 0.15  # m, drawn
VERDICTS = {MISTAKE: "Not to be run", DOUBT: "Look at the doubts first", "": "No mistake was found"}


def cell_page(seen: Examined, hashes: Mapping[str, str], line: str) -> Report:
    """The page; hashes: SHA-256 by name of what was read; line: what the examination found in short."""
    worst = MISTAKE if seen.of(MISTAKE) else DOUBT if seen.of(DOUBT) else ""
    tables, robot = seen.setup.tables, seen.setup.robot
    facts = [("Robot", robot.title), ("File", str(seen.path))]
    found = seen.grindable
    if found is not None:
        blade = found.laid.blade
        facts.append(("Blade", f"{blade.name}, {np.ptp(blade.vertices, axis=0).max() * 1e3:.0f} mm long"))
        facts.append(("Wheel", f"{2e3 * found.cell.wheel.radius:g} mm across, {1e3 * found.cell.wheel.width:g} mm wide"))
    head = Headline(worst != MISTAKE, VERDICTS[worst], f"{line[0].upper()}{line[1:]}.", tuple(facts), doubtful=worst == DOUBT)
    sections = []
    if found is not None:
        region = wheel_region(found.cell, found.laid.paths, arm_length(arm_family(robot)))
        sections = [_scene(found, region), _controller(found.cell), _where(found.cell, region)]
    sections += [_findings(seen), made_from(hashes)]
    notices = [f.sentence() for kind in (DOUBT, MISTAKE) for f in seen.of(kind)]
    return Report("Cell", tables.name, head, notices, sections)


def _findings(seen: Examined) -> Section:
    parts: list[Part | str] = []
    if rows := [(f.key, f.text) for f in seen.of(UNMEASURED)]:
        parts.append("These are believed as they stand, with the spread that the file or its default says. Each can be measured.")
        parts.append(table(("key", "what to do"), rows, text=(0, 1)))
    if rows := [(f.key, f.text) for f in seen.of(KNOWN)]:
        parts.append(table(("key", "to know"), rows, text=(0, 1)))
    return Section("What to measure", tuple(parts) or ("Every number has a spread of its own.",))


def _controller(cell: Cell) -> Section:
    """Frames and load as the controller's own tables hold them."""
    control, load = cell.controller, cell.workpiece.payload
    rows = [
        (f"TOOL_DATA[{control.tool_no}]", "the blade's frame on the flange", *_frame_words(cell.workpiece.T_flange_blade)),
        (f"BASE_DATA[{control.base_no}]", "the wheel's frame in the robot's base", *_frame_words(wheel_frame(cell))),
    ]
    loads = [(name, *_load_words(one)) for name, one in payloads_of(cell.tables).items()]
    words = (
        "The programs set these frames themselves and never write the controller's tables. Type them in all the same: jogging "
        "then moves in the same frames. The wheel's frame lies where blade and wheel touch at arc zero: x "
        "along the belt, y along the axle, z out of the wheel. With $ROBROOT = 0 base and world are one."
    )
    hung = f"LOAD_DATA[{control.tool_no}] is what hangs on the flange while grinding: {cell.workpiece.payload_name or 'nothing'}"
    return Section(
        "Numbers for the controller",
        (
            words,
            table(("", "is", "X mm", "Y mm", "Z mm", "A deg", "B deg", "C deg"), rows, text=(0, 1)),
            f"{hung}, {load.mass:g} kg.",
            table(("payload", "M kg", "X mm", "Y mm", "Z mm", "JX kg m^2", "JY", "JZ"), loads),
        ),
    )


def _frame_words(T: Array) -> list[str]:
    return [f"{v + 0.0:.3f}" for v in (*(1e3 * T[:3, 3]), *np.degrees(abc_from_rotation(T[:3, :3])))]


def _load_words(load: Hanging) -> list[str]:
    """An inertia that nobody gave is a dash: as zero the controller would believe it."""
    inertia = [f"{v:g}" if load.inertia.any() or load.mass == 0 else "-" for v in load.inertia]
    return [f"{load.mass:g}", *(f"{1e3 * v:g}" for v in load.com), *inertia]


def _where(cell: Cell, region: WheelRegion) -> Section:
    """Where the wheel could stand as well."""
    columns, rows = len(np.unique(region.across)), len(np.unique(region.up))
    x, z, share = (v.reshape(columns, rows) for v in (1e3 * region.across, 1e3 * region.up, 100 * region.share))
    middle = len(region.share) // 2

    def draw(canvas: Canvas) -> None:
        ((ax,),) = panels(canvas, 1, 1, left=0.55, right=0.75, bottom=0.4)
        image = ax.pcolormesh(x, z, share, cmap=COLOUR_MAP, vmin=0, vmax=100, shading="nearest", rasterized=True)
        ax.plot([x.ravel()[middle]], [z.ravel()[middle]], "o", mfc="none", mec=INK, ms=8)
        ax.annotate(
            "the wheel", (x.ravel()[middle], z.ravel()[middle]), (6, 6), textcoords="offset points", fontsize=7, color=INK
        )
        ax.set_aspect("equal")
        dressed(ax, x="away from the base, mm", y="above the base's origin, mm", grid="")
        canvas.figure.colorbar(image, ax=ax, fraction=0.05, pad=0.02).set_label("contacts reached, %", fontsize=7)

    words = (
        "Share of the blade's contacts that the arm reaches within its ranges, wrist and elbow off their singularities, with the "
        "wheel's centre elsewhere in the vertical plane through it, its axis and direction kept. Collisions are looked at only "
        "where the wheel stands now."
    )
    caption = "Where the wheel's centre may stand; the ring is where it stands now"
    return Section("Where the wheel may stand", (words, Plot("wheel-region", caption, 3.6, draw)))


def _scene(found: Grindable, region: WheelRegion) -> Section:
    postures = tuple(
        (seeds[0].q, f"line {one.path.line}, {one.path.side}") for one, seeds in zip(found.stretches, found.seeds, strict=True)
    )
    script = scene_script([_VIEWER / "cell.js"])
    return Section("The cell", (CellView(found, region, postures),), style=scene_style(), script=script)


@dataclass(frozen=True)
class CellView(Part):
    """The cell to be looked at from all sides, the arm in the postures with which it touches the blade."""

    found: Grindable
    region: WheelRegion
    postures: tuple[tuple[Array, str], ...]

    def on_paper(self) -> dict[str, Any]:
        """Words: a scene is for the page, and a cell has no print of its own."""
        return {"is": "paragraph", "words": "The cell stands in cell.html, where it can be turned."}

    def on_page(self) -> Markup:
        """Canvas, controls and the script's data."""
        page = (_VIEWER / "cell.html").read_text(encoding="utf-8")
        return Markup(page).format(payload=Markup(script_json(self._payload())))

    def _payload(self) -> dict[str, Any]:
        cell, blade = self.found.cell, self.found.laid.blade
        q = np.vstack([q for q, _ in self.postures]) if self.postures else 0.5 * (cell.robot.q_min + cell.robot.q_max)[None]
        names = [name for q, name in self.postures for _ in range(len(q))] or ["middle of the ranges"]
        links = link_frames(cell.robot, q)
        return {
            "colours": VIRIDIS,
            "axes": AXES_OF_FRAMES,
            "links": encode(links[:, :, :3, :]),
            "blade": encode((links[:, -1] @ cell.workpiece.T_flange_blade)[:, :3, :]),
            "bladeInFlange": encode(cell.workpiece.T_flange_blade[:3]),
            "wheelFrame": encode(wheel_frame(cell)[:3]),
            "q": encode(np.degrees(q)),
            "names": names,
            "capsules": arm_drawn(cell.robot),
            "wheel": wheel_drawn(cell.wheel),
            "floor": 0.0 if cell.floor is None else cell.floor,
            "up": cell.up.tolist(),
            "vertices": encode(blade.vertices),
            "faces": encode_index(blade.faces, len(blade.vertices)),
            "places": encode(self.region.centre),
            "share": encode(self.region.share),
        }
