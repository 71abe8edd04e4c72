"""Unstable orbits held by one motor: multipliers against another integration, basins, the torque that it takes.

Each orbit gets the motor at the joint that is named. The multipliers of its nonlinear closed loop are found twice: from
the variations, as the certificate does, and by central differences of SciPy's DOP853 on the exported Python controller.
Every disturbance is simulated for 100 periods, 200 samples each.

    python benchmarks/feedback.py             writes results/benchmarks/feedback.md, in about ten minutes
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from machine import load, processor, versions
from scipy.integrate import solve_ivp
from scipy.optimize import linear_sum_assignment

import orbitfinder as of
from orbitfinder.control.export import law_of
from orbitfinder.control.transverse import Reference
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import vector_field

ROOT = Path(__file__).parents[1]
SIZES = (0.01, 0.03, 0.1, 0.3)
DISTURBANCES, PERIODS = 200, 100
CASES = (
    ("report/triple-1", 1, None, 0.0), ("examples/triple-mode-2-strong", 3, None, 0.0),
    ("report/triple-2", 1, None, 0.0), ("report/triple-1", 3, 2.0, 0.001), ("report/triple-1", 2, None, 0.0),
)  # fmt: skip
"""Problem file, joint of the motor, greatest torque (N m), noise of the measurement (extents)"""
STEP = 2e-5
"""of central differences of fourth order, in extents"""


@dataclass(frozen=True)
class Held:
    """A controller with its basin, how far its multipliers are from another program's, and what it took (s)."""

    controller: of.Controller
    torque: float | None
    noise: float
    differ: float
    design: float
    simulation: float


def by_differences(controller: of.Controller) -> np.ndarray:
    """Multipliers of the closed loop by DOP853 and central differences, all pushed motions side by side."""
    model, law = build_model(controller.system), law_of(controller)
    d, units = controller.units.size, controller.units
    own = Reference(model, controller.actuators, controller.period, controller.states[[0, -1]], units, controller.clock)
    basis = own.bases[0]
    pushes = np.concatenate([k * STEP * basis.T for k in (1, -1, 2, -2)])
    starts = controller.states[0] + pushes * units
    rate = vector_field(model, controller.actuators).map(len(starts))

    def field(t: float, flat: np.ndarray) -> np.ndarray:
        x = flat.reshape(-1, d)
        u = law(x, np.full(len(x), t))[0]
        return np.asarray(rate(t, x.T, np.zeros((0, len(x))), u.T).full().T.ravel())

    end = solve_ivp(field, (0.0, controller.period), starts.ravel(), method="DOP853", rtol=1e-12, atol=1e-13)
    one, less, two, twoless = (end.y[:, -1].reshape(4, -1, d) - controller.states[-1]) / units
    slopes = (8 * (one - less) - (two - twoless)) / (12 * STEP)
    return np.linalg.eigvals(basis.T @ slopes.T)


def held(name: str, joint: int, torque: float | None, noise: float) -> Held:
    """One case."""
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / f"{name}.toml"))
    began = time.perf_counter()
    controller = of.stabilise(orbit, [f"torque{joint}"], limits=torque)
    design = time.perf_counter() - began
    apart = np.abs(by_differences(controller)[:, None] - controller.multipliers)
    began = time.perf_counter()
    found = of.basin(controller, SIZES, DISTURBANCES, PERIODS, noise=noise)
    differ = float(apart[linear_sum_assignment(apart)].max())
    return Held(found, torque, noise, differ, design, time.perf_counter() - began)


def report(cases: list[Held]) -> str:
    """The page."""
    lines = [
        "# Orbits held by one motor", "",
        "`python benchmarks/feedback.py`; every number on this page is written by that script.", "",
        f"{processor()}; {versions()}; {load()}.", "",
        "Largest multipliers without and with control; how far those of the nonlinear closed loop are from the linear",
        "design, over their condition, and from central differences of SciPy's DOP853 on the exported controller.",
        "", "| orbit | motor | without | with | from the design | from DOP853 | nodes | design, s | simulation, s |",
        "|---|---|---|---|---|---|---|---|---|",
    ]  # fmt: skip
    for one in cases:
        made = one.controller
        assert made.certificate is not None
        agreement = next(check.value for check in made.certificate.checks if check.name == "agreement")
        lines.append(
            f"| {made.name} | {_motor(one)} | {abs(made.open_loop).max():.6g} | {abs(made.multipliers).max():.6g} "
            f"| {agreement:.1e} | {one.differ:.1e} | {len(made.states) - 1} | {one.design:.1f} | {one.simulation:.0f} |"
        )
    lines += [
        "", "## Basins", "",
        f"{DISTURBANCES} seeded disturbances of each size, in extents of the orbit, {PERIODS} periods each: how many",
        "returned, and the peak and rms torque (N m) of those over all periods.", "",
        "| orbit | motor | " + " | ".join(f"{size:g}" for size in SIZES) + " |", "|---|---|" + "---|" * len(SIZES),
    ]  # fmt: skip
    for one in cases:
        assert one.controller.basin is not None
        cells = [f"{r.returned}, {r.peak[0]:.3g}, {r.rms[0]:.2g}" for r in one.controller.basin.rows]
        lines.append(f"| {one.controller.name} | {_motor(one)} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def _motor(one: Held) -> str:
    limited = "" if one.torque is None else f", at most {one.torque:g} N m"
    return f"{one.controller.actuators[0]}{limited}" + (f", noise {one.noise:g}" if one.noise else "")


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    given = parser.parse_args()
    cases = []
    for case in CASES:
        cases.append(held(*case))
        (given.out / "feedback.md").write_text(report(cases), encoding="utf-8")
        print(report(cases[-1:]).splitlines()[-1], file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
