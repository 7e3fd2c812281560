"""Every number of docs/wheel.md: `python benchmarks/wheel_table.py [accuracy|convergence|law|real|drop]`, default all."""

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import numpy as np

from ocp.contact.wheel.cover import Cover, WheelGeometry, build_cover, default_cell
from ocp.contact.wheel.law import WheelLaw
from ocp.contact.wheel.law_fit import FORCE_RANGE, Domain, draw, fit_wheel_law
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.model.cell import read_cell
from ocp.plan.paths import PlanOptions, lay_paths

FLANGE_STIFFNESS = 5600.0  # N/m, the published cell's (PHYSICS 3.2); errors are quoted on it and on a rigid cell
LARGE = WheelGeometry(radius=0.150, width=0.040, cover_thickness=0.015, modulus=12e6, poisson=0.47)
SMALL = WheelGeometry(radius=0.075, width=0.025, cover_thickness=0.015, modulus=3.43e6, poisson=0.47)
SHAPES = {
    "convex 60 mm": LocalShape(6.67, 16.0),
    "flat": LocalShape(6.67, 0.0),
    "flat, tilt 0.6 deg": LocalShape(6.67, 0.0, tilt_y=0.01),
    "hollow -4/m": LocalShape(6.67, -4.0),
    "convex, turned": LocalShape(8.0, 10.0, 5.0, lateral=0.004, tilt_x=0.02, tilt_y=-0.01),
    "convex at the edge": LocalShape(6.67, 16.0, lateral=0.018),
}


def convergence() -> None:
    """Indentation, micrometres, against the cell size at 20 N on the large wheel, and time a solve."""
    print(f"{'cell mm':>8} " + " ".join(f"{name:>20}" for name in SHAPES) + "   slowest ms")
    for cell in (2e-3, 1.4e-3, 0.93e-3, 0.62e-3, 0.45e-3):
        cover = build_cover(LARGE, cell)
        _ = cover.kernel
        found, slowest = [], 0.0
        for shape in SHAPES.values():
            start = time.perf_counter()
            found.append(solve_force(cover, 20.0, shape).indentation * 1e6)
            slowest = max(slowest, 1e3 * (time.perf_counter() - start))
        print(f"{cell * 1e3:8.2f} " + " ".join(f"{d:20.2f}" for d in found) + f" {slowest:12.1f}")


def accuracy() -> None:
    """PHYSICS 3.4: blade rounded to 60 mm across the belt on a wheel of 100 mm at 20 N, in mm, against thickness."""
    print(f"{'Shore A':>8} {'half-space':>11} {'h 25 mm':>8} {'h 15 mm':>8} {'h 10 mm':>8}")
    for shore in (40, 60, 70, 80, 90):
        modulus = 1e6 * 10 ** (0.0235 * shore - 0.6403)
        row = []
        for thickness in (0.09, 0.025, 0.015, 0.010):
            width = 0.16 if thickness == 0.09 else 0.04
            wheel = WheelGeometry(0.1, width, thickness, modulus, 0.47)
            row.append(solve_force(build_cover(wheel, 1.5e-3), 20.0, LocalShape(10.0, 1 / 0.06)).indentation * 1e3)
        print(f"{shore:8d} {row[0]:11.3f} {row[1]:8.3f} {row[2]:8.3f} {row[3]:8.3f}")


def blades(wheel: WheelGeometry) -> dict[str, Domain]:
    """Three kinds of blade surface with the cell's freedoms: turn 30 deg, tilt 3 deg, lateral 10 mm (6 on the small wheel)."""
    rng = np.random.default_rng(0)

    def curvature(low: float, high: float) -> np.ndarray:
        return np.column_stack([rng.uniform(-1, 1, 3000), rng.uniform(low, high, 3000), rng.uniform(-3, 3, 3000)])

    kinds = {
        "convex 7..45/m": curvature(7, 45),
        "hollow -10..-2/m": curvature(-10, -2),
        "nearly flat -6..20/m": curvature(-6, 20),
    }
    kinds["convex and hollow"] = np.vstack([kinds["convex 7..45/m"], kinds["hollow -10..-2/m"]])
    lateral = 0.010 if wheel.width > 0.03 else 0.006
    return {name: Domain(k, np.radians(30), lateral, float(np.tan(np.radians(3))), 20.0) for name, k in kinds.items()}


@dataclass(frozen=True)
class LawError:
    """Held-out error of a law against direct solutions: at the process force, and (`wide_*`) over the force range; rms and max
    in m, on the flange and on a rigid cell in N; combinations outside the law's limits."""

    rms: float
    max: float
    flange_rms: float
    flange_max: float
    rigid_rms: float
    rigid_max: float
    wide_rms: float
    wide_max: float
    wide_flange_max: float
    wide_rigid_max: float
    dropped: int

    @staticmethod
    def of(fitted: WheelLaw, cover: Cover, domain: Domain) -> "LawError":
        figures, dropped = [], 0
        for count, seed, forces in ((300, 2, (1.0, 1.0)), (150, 3, FORCE_RANGE)):
            samples = draw(cover, domain, count, seed, False, forces)
            F, *shape = samples.inputs.T
            miss = fitted.evaluate(F, *shape) - samples.indentation
            stiffness = 0.04 * F / (fitted.evaluate(1.02 * F, *shape) - fitted.evaluate(0.98 * F, *shape))
            for error in (miss, miss / (1 / FLANGE_STIFFNESS + 1 / stiffness), miss * stiffness):
                figures += [rms(error), float(np.abs(error).max())]
            dropped += samples.dropped
        return LawError(*figures[:8], figures[9], figures[11], dropped)


def law() -> None:
    """Held-out error of the law, cost of building and of evaluating it."""
    for title, wheel in (("R 150 w 40 h 15 mm, 12 MPa", LARGE), ("R 75 w 25 h 15 mm, Shore 50", SMALL)):
        start = time.perf_counter()
        cover = build_cover(wheel, default_cell(wheel, 20.0))
        print(f"{title}: cell {cover.dx * 1e3:.2f} mm, cover built in {time.perf_counter() - start:.1f} s")
        print(f"{'':22}{'at the process force':>46}{'0.2..3 x process force':>30}")
        print(f"{'surface':22}{'um rms max':>14}{'flange N rms max':>17}{'rigid N rms max':>17}", end="")
        print(f"{'um rms max':>14}{'flange rigid':>13}  terms build s  operations: value Hessian")
        for name, domain in blades(wheel).items():
            start = time.perf_counter()
            fitted = fit_wheel_law(cover, domain)
            seconds, e = time.perf_counter() - start, LawError.of(fitted, cover, domain)
            value, hessian = operations(fitted)
            print(
                f"{name:22}{e.rms * 1e6:7.2f}{e.max * 1e6:7.1f}{e.flange_rms:10.4f}{e.flange_max:7.3f}{e.rigid_rms:10.3f}"
                f"{e.rigid_max:7.2f}{e.wide_rms * 1e6:7.2f}{e.wide_max * 1e6:7.1f}{e.wide_flange_max:7.3f}"
                f"{e.wide_rigid_max:6.2f}{len(fitted.terms):7d}{seconds:8.1f}{value:12d}{hessian:8d}"
            )


def operations(fitted: WheelLaw) -> tuple[int, int]:
    """Instructions of the value and of the dense 7 x 7 Hessian."""
    x = ca.SX.sym("x", 7)
    d = fitted.indentation(*ca.vertsplit(x))
    value = ca.Function("d", [x], [d], {"cse": True})
    hessian = ca.Function("H", [x], [ca.hessian(d, x)[0]], {"cse": True})
    return value.n_instructions(), hessian.n_instructions()


def drop() -> None:
    """What it would cost, in N, to leave a dimension out: direct solutions with and without it, flange and rigid cell."""
    for title, wheel in (("R 150 w 40", LARGE), ("R 75 w 25", SMALL)):
        cover = build_cover(wheel, default_cell(wheel, 20.0))
        for name, domain in blades(wheel).items():
            print(f"{title} mm, {name}")
            _drop(cover, domain)


def _drop(cover: Cover, domain: Domain) -> None:
    samples = draw(cover, domain, 150, 7, False, FORCE_RANGE)
    inputs = samples.inputs.copy()
    inputs[:, 0] = domain.force
    reference = np.array([solve_force(cover, F, LocalShape(*shape)) for F, *shape in inputs])
    d = np.array([c.indentation for c in reference])
    stiffness = np.array([c.stiffness for c in reference])
    typical = inputs.mean(axis=0)
    for column, label in enumerate(("kxx", "kyy", "kxy", "lateral", "tilt_x", "tilt_y"), start=1):
        frozen = inputs.copy()
        frozen[:, column] = typical[column] if column < 4 else 0.0
        without = np.array([solve_force(cover, F, LocalShape(*shape)).indentation for F, *shape in frozen])
        miss = without - d
        flange, rigid = miss / (1 / FLANGE_STIFFNESS + 1 / stiffness), miss * stiffness
        print(f"    {label:8} rms {rms(flange):7.2f} N on the flange, {rms(rigid):8.1f} N rigid")
    frozen = inputs.copy()
    frozen[:, 2] -= frozen[:, 3] ** 2 / frozen[:, 1]
    frozen[:, 6] -= frozen[:, 3] / frozen[:, 1] * frozen[:, 5]
    lean = frozen[:, 5] - frozen[:, 3] * frozen[:, 4]
    shift = -0.5 * lean**2 / frozen[:, 1] + 0.5 * (inputs[:, 2] - frozen[:, 2]) * frozen[:, 4] ** 2
    shift += (frozen[:, 6] - inputs[:, 6]) * frozen[:, 4]
    frozen[:, 3] = frozen[:, 5] = 0.0
    without = np.array([solve_force(cover, F, LocalShape(*shape)).indentation for F, *shape in frozen]) + shift
    miss = without - d
    print(f"    shear (ridge kept) rms {rms(miss / (1 / FLANGE_STIFFNESS + 1 / stiffness)):.3f} N on the flange, ", end="")
    print(f"{rms(miss * stiffness):.2f} N rigid")
    thin = build_cover(replace(cover.geometry, cover_thickness=0.999 * cover.geometry.radius), cover.dx)
    without = np.array([solve_force(thin, F, LocalShape(*shape)).indentation for F, *shape in inputs])
    miss = without - d
    print(f"    thickness (solid rubber instead) rms {rms(miss / (1 / FLANGE_STIFFNESS + 1 / stiffness)):.2f} N, ", end="")
    print(f"{rms(miss * stiffness):.1f} N rigid")


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def real() -> None:
    """The law on real blades with the bundled cell's passes, in the whole box of freedoms and in a quarter of it."""
    root = Path(__file__).resolve().parents[1]
    cell = read_cell(root / "ocp" / "data" / "cell.toml")
    for name in ("twisted", "rotor37"):
        paths = lay_paths(cell, root.parent / "shared" / "data" / "blades" / f"{name}.stl", PlanOptions(step=1e-3)).paths
        curvature = np.vstack([path.curvature for path in paths])
        for title, wheel in (("small", SMALL), ("large", LARGE)):
            cover = build_cover(wheel, default_cell(wheel, 20.0))
            whole = replace(blades(wheel)["convex 7..45/m"], curvature=curvature)
            for box, domain in (("whole", whole), ("quarter", replace(whole, lateral=whole.lateral / 4, tilt=whole.tilt / 4))):
                e = LawError.of(fit_wheel_law(cover, domain), cover, domain)
                print(
                    f"{name:8} {title} {box:8} um {e.rms * 1e6:.2f} {e.max * 1e6:.1f}, flange N {e.flange_rms:.4f} "
                    f"{e.flange_max:.3f}, rigid N {e.rigid_rms:.2f} {e.rigid_max:.2f}, "
                    f"wide {e.wide_flange_max:.3f} {e.wide_rigid_max:.2f}, dropped {e.dropped}"
                )


TABLES = {"accuracy": accuracy, "convergence": convergence, "law": law, "real": real, "drop": drop}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or TABLES:
        print(f"== {wanted}")
        TABLES[wanted]()
