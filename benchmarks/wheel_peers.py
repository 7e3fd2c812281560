"""A rubber wheel pressed on a rounded blade: ours against tamaas and Hertz.

`python benchmarks/wheel_peers.py [--fine 128] [--runs 3]`; full table: `--fine 256 --runs 7`.

Two wheels at 20 N. "thick": radius 100 mm, solid rubber but for a small hub, 160 mm wide, so that it is nearly the elastic
half-space of Hertz (Johnson 1985, section 4.2) and of tamaas (its conjugate gradients of Polonsky and Keer without periodic
images): there all must agree, but for what the hub and the rims do (1 %). "bundled": the wheel of the bundled cell, 15 mm wide
with a cover of 12 mm on a rigid hub, where a half-space is the wrong model.
tamaas runs on ours' cells and on `fine` x `fine` cells of a square of four half-space patches.

Agreement: indentation and largest pressure over Hertz's. Preparing: ours' compliance by finite elements of the ring, which is
kept on disk and made once a wheel; tamaas' transformed kernel. A contact: medians of `runs`. A plan solves few contacts: it
evaluates the law that is fitted to them (`law`, one of many in one call), preparing is then the fit with its direct solutions.
"""

import os
from collections.abc import Callable
from functools import partial

import numpy as np
from peers import NotInstalled, arguments, head, measured, named, row
from scipy.optimize import brentq
from scipy.special import ellipe, ellipk

from ocp.contact.wheel.cover import WheelGeometry, build_cover, default_cell
from ocp.contact.wheel.law_fit import Domain, fit_wheel_law
from ocp.contact.wheel.signorini import LocalShape, solve_force
from ocp.data import CELL
from ocp.model.cell import read_cell
from ocp.model.prepare import wheel_cover

FORCE = 20.0  # N
THICK = WheelGeometry(0.1, 0.16, 0.09, 12e6, 0.47)
EVALUATED = 1000  # contacts in one call of the law
Answer = tuple[float, float]  # indentation m, largest pressure Pa (nan: not known)
Solve = Callable[[], Answer]


def hertz(wheel: WheelGeometry, shape: LocalShape) -> Solve:
    """Closed form but for the eccentricity, by bisection."""
    modulus = wheel.modulus / (1 - wheel.poisson**2)
    low, high = sorted((shape.kxx, shape.kyy))

    def solve() -> Answer:
        def ratio(m: float) -> float:  # m: square of the eccentricity
            K, E = ellipk(m), ellipe(m)
            return float((E / (1 - m) - K) / (K - E))

        m = brentq(lambda m: ratio(m) - high / low, 1e-9, 1 - 1e-9) if high > low else 1e-9
        a3 = 3 * FORCE / (np.pi * modulus * m * low) * (ellipk(m) - ellipe(m))
        a = a3 ** (1 / 3)
        peak = 1.5 * FORCE / (np.pi * a * a * np.sqrt(1 - m))
        return peak * a * np.sqrt(1 - m) * ellipk(m) / modulus, peak

    return solve


def cell_size(wheel: WheelGeometry) -> float:
    """The plan's, m, or half a contact's semi-axis on the thick wheel, which is far wider than wheels that grind."""
    return 1.6e-3 if wheel is THICK else default_cell(wheel, FORCE)


def ours(wheel: WheelGeometry, shape: LocalShape) -> Solve:
    cover = build_cover(wheel, cell_size(wheel))
    _ = cover.kernel

    def solve() -> Answer:
        contact = solve_force(cover, FORCE, shape)
        return contact.indentation, float(contact.pressure.max())

    return solve


def law(wheel: WheelGeometry, shape: LocalShape) -> Solve:
    """Fitted about the shape: half and twice its curvatures, turned by 30 degrees at most, untilted and in the middle."""
    rng = np.random.default_rng(0)
    blade = rng.uniform((0.0, 0.5 * shape.kyy, 0.0), (1e-6, 2 * shape.kyy, 1e-6), (300, 3))
    blade[:, 0] = rng.uniform(0.9, 1.1, 300) * (shape.kxx - 1 / wheel.radius)
    domain = Domain(blade, np.radians(30), 1e-4, 1e-4, FORCE)
    fitted = fit_wheel_law(build_cover(wheel, cell_size(wheel)), domain)
    given = [np.full(EVALUATED, value) for value in (FORCE, shape.kxx, shape.kyy, 0.0, 0.0, 0.0, 0.0)]
    return lambda: (float(np.asarray(fitted.evaluate(*given))[0]), float("nan"))


def tamaas(wheel: WheelGeometry, shape: LocalShape, fine: int | None) -> Solve:
    import tamaas as tm

    tm.set_log_level(tm.LogLevel.warning)
    modulus = wheel.modulus / (1 - wheel.poisson**2)
    low = min(shape.kxx, shape.kyy)
    size = 4 * 2 * (0.75 * FORCE / modulus / low) ** (1 / 3)
    count = fine or int(np.ceil(size / cell_size(wheel)))
    model = tm.ModelFactory.createModel(tm.model_type.basic_2d, [size, size], [count, count])
    model.E, model.nu = wheel.modulus, wheel.poisson
    tm.ModelFactory.registerNonPeriodic(model, "dcfft")
    x = (np.arange(count) - count // 2) * size / count
    gap = shape.gap(x[:, None], x[None, :])

    def solve() -> Answer:
        solver = tm.PolonskyKeerRey(model, -gap, 1e-9)
        solver.setIntegralOperator("dcfft")
        solver.solve(FORCE / size**2)
        pressure = np.array(model.traction)
        moved = np.zeros_like(pressure)
        model.operators["dcfft"](pressure, moved)
        touched = pressure > 0.01 * pressure.max()
        return float(np.mean((moved + gap)[touched])), float(pressure.max())

    return solve


def main() -> None:
    options = arguments(__doc__, fine=128, runs=3)
    os.environ["GRINDPLAN_CACHE"] = ""  # preparing is timed
    wheel = wheel_cover(read_cell(CELL)).geometry
    cases = {"thick": (THICK, LocalShape(10.0, 16.0)), "bundled": (wheel, LocalShape(1 / wheel.radius, 16.0))}
    ways: dict[str, tuple[str, Callable[[WheelGeometry, LocalShape], Solve]]] = {
        "Hertz": ("", hertz),
        "ours": ("", ours),
        f"ours, law, {EVALUATED} at once": ("", law),
        "tamaas, ours' cell size": ("tamaas", partial(tamaas, fine=None)),
        f"tamaas, {options.fine} x {options.fine}": ("tamaas", partial(tamaas, fine=options.fine)),
    }
    columns = ("wheel", "way", "version", "preparing, processor s", "a contact, wall ms", "processor ms", "indentation mm")
    head((*columns, "over Hertz", "pressure over Hertz"))
    for name, (wheel, shape) in cases.items():
        reference = hertz(wheel, shape)()
        for label, (package, prepare) in ways.items():
            if label.startswith("ours, law") and name == "thick":
                continue  # many cells: the direct solutions of a fit take minutes
            try:
                told = named(package) if package else ""
            except NotInstalled as reason:
                row(name, label, reason)
                continue
            solve, _, prepared = measured(partial(prepare, wheel, shape), 1)
            (depth, peak), wall, processor = measured(solve, options.runs)
            each = 1e3 / (EVALUATED if "law" in label else 1)
            over = f"{depth / reference[0]:.4f}", f"{peak / reference[1]:.4f}"
            row(name, label, told, prepared, each * wall, each * processor, 1e3 * depth, *over)


if __name__ == "__main__":
    main()
