"""Cost of a point on Duffing's resonance curve x'' + 0.1 x' + x + x^3 = 0.3 cos w t, w from 0.8 over its folds to 2.5.

orbitfinder (`follow`, without the deferred certificate, compiled and interpreted) and AUTO-07p, from the same first
orbit in about as many points. Closures of both are judged by one integration, SciPy's DOP853 on the equations as they
stand here, and the folds by a number of 140 bits (tests/data/forced.json).

    python benchmarks/resonance.py            writes results/benchmarks/resonance.md
    python benchmarks/resonance.py --cpu      processor time on one thread for both, for a busy machine
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
from machine import processor, versions
from peers.auto_family import AUTO, Clock
from peers.auto_forced import AutoForced, Curve
from scipy.integrate import solve_ivp

from orbitfinder.families.follow import follow
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Run, first_point
from orbitfinder.families.start import Start, begin, full_samples
from orbitfinder.integrate.compiled import compiling
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanisms.library import forced_duffing

ROOT = Path(__file__).parents[1]
NUMBERS = {"stiffness": 1.0, "cubic": 1.0, "damping": 0.1, "force": 0.3, "frequency": 0.8}
LAST = 2.5
REPEATS = 5
MESHES = ((20, 4), (50, 4), (70, 4), (100, 4), (100, 7))
"""(NTST, NCOL) that AUTO is tried with; the cheapest one that closes as well is its time."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cpu", action="store_true")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    chosen = parser.parse_args()
    if shutil.which("gfortran") is None or not (AUTO / "lib").is_dir():
        sys.exit(f"AUTO-07p is needed in {AUTO} (Debian: auto-07p, gfortran); set AUTO_DIR")
    clock, found = Clock(chosen.cpu), {}
    for name, mode in (("interpreted", "off"), ("compiled", "on")):
        with compiling(mode):
            for events in (False, True):
                start = started()
                found[f"orbitfinder, {name}{', events located' * events}"] = ours(start, events, clock)
    wanted = worst(found["orbitfinder, compiled"])
    with tempfile.TemporaryDirectory() as folder:
        times, states = full_samples(start.curve, start.solution, 800)
        program = AutoForced(Path(folder), NUMBERS, np.column_stack([times, states]), LAST, clock)
        steps = program.stepping(MESHES[0], len(found["orbitfinder, compiled"].points))
        for mesh in MESHES:
            for events in (False, True):
                asked = program.stepping(mesh, steps.points // 4)
                name = f"AUTO-07p, {mesh[0]} x {mesh[1]}{', events located' * events}"
                found[name] = program.best(type(asked)(asked.points, mesh, asked.step, 1, events), REPEATS)
            if worst(found[name]) <= wanted:
                break
    text = page(found, chosen.cpu)
    print(text)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "resonance.md").write_text(text, encoding="utf-8")


def started() -> Start:
    """The first orbit, below resonance."""
    model = forced_duffing(**NUMBERS)
    guess = Guess([0.5, 0.0], 2 * np.pi / NUMBERS["frequency"])
    return begin(Problem(model, guess), FamilySettings(parameter="frequency"))


def ours(start: Start, events: bool, clock: Clock) -> Curve:
    """orbitfinder without the independent check, which is made after the clock has stopped."""
    settings = FamilySettings(parameter="frequency", events=events, certify=False)
    run = Run(start.curve, settings, 1, first_point(start, settings, None), until=LAST)
    list(follow(run))  # functions are built here
    taken = []
    for _ in range(REPEATS):
        began = clock()
        batches = list(follow(run))
        taken.append(clock() - began)
    points = [point for batch in batches for point in batch.points]
    folds = [event for batch in batches for event in batch.events if event.kind == "fold"]
    rows = [[*point.state, 0.0, point.period, point.value] for point in points]
    for event in folds:
        place = next(k for k, point in enumerate(points) if point.arclength > event.arclength)
        rows.insert(place + len(rows) - len(points), [*event.state, 0.0, event.period, event.parameter])
    return Curve(min(taken) / len(points), np.array(rows))


def closure(row: np.ndarray) -> float:
    """|x(T) - x(0)| of a point, relative to the extent of coordinate and rate, over max(1, largest multiplier)."""
    x, v, phase, period, w = row
    stiffness, cubic, damping, force = (NUMBERS[name] for name in ("stiffness", "cubic", "damping", "force"))

    def field(t: float, y: np.ndarray) -> np.ndarray:
        slope = np.array([[0.0, 1.0], [-stiffness - 3 * cubic * y[0] ** 2, -damping]])
        push = force * np.cos(w * t + phase) - damping * y[1] - stiffness * y[0] - cubic * y[0] ** 3
        return np.concatenate([[y[1], push], (slope @ y[2:].reshape(2, 2)).ravel()])

    start = np.concatenate([[x, v], np.eye(2).ravel()])
    found = solve_ivp(field, (0.0, period), start, method="DOP853", rtol=3e-14, atol=1e-15)
    extents = np.ptp(found.y[:2], axis=1)
    grown = np.abs(np.linalg.eigvals(found.y[2:, -1].reshape(2, 2))).max()
    return float((np.abs(found.y[:2, -1] - start[:2]) / extents).max() / max(1.0, grown))


def worst(curve: Curve) -> float:
    """The largest closure of one point in four."""
    return max(closure(row) for row in curve.points[1::4])


def page(found: dict[str, Curve], cpu: bool) -> str:
    """The report of a run."""
    known = json.loads((ROOT / "tests" / "data" / "forced.json").read_text())["duffing folds"]
    rows = []
    for name, curve in found.items():
        errors = [min(np.abs(curve.folds - float(one))) if curve.folds.size else np.nan for one in known]
        told = [f"{one:.0e}" if "events" in name else "" for one in errors]
        rows.append(
            f"| {name} | {1e3 * curve.seconds:.2f} | {len(curve.points)} | {worst(curve):.0e} | {' | '.join(told)} |"
        )
    return f"""# Cost of a point on Duffing's resonance curve

Written by `python benchmarks/resonance.py{" --cpu" if cpu else ""}`; {"processor" if cpu else "wall"} times, the least
of {REPEATS} runs, multipliers included. w from {NUMBERS["frequency"]} over both folds to {LAST}. Closures are the worst
of one point in four, relative to the motion, divided by max(1, largest multiplier), by SciPy's DOP853; folds against
140 bits.

| | ms a point | points | closure | error of the upper fold | of the lower fold |
|---|---|---|---|---|---|
{chr(10).join(rows)}

AUTO with NTST x NCOL, ISP = 1 and ILP = 0, with events 2 and 1; EPSL = EPSU = 1e-12.
{processor()}; {versions()}.
"""


if __name__ == "__main__":
    main()
