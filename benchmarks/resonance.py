"""Cost of a point on Duffing's resonance curve x'' + 0.1 x' + x + x^3 = 0.3 cos w t, w from 0.8 over its folds to 2.5.

`of.follow_family` without the second integrator and with default settings, and AUTO-07p on the coarsest mesh that
closes as well and at its users' 20 x 4; from the same first orbit in about as many points, events located by all, in
turns (turns.py says what a time is). Closures are judged by one integration, SciPy's DOP853 on the equations as they
stand here, and the folds by a number of 140 bits (tests/data/forced.json).

    python benchmarks/resonance.py            writes results/benchmarks/resonance.md
    python benchmarks/resonance.py --json     prints the rows instead
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from peers.auto_forced import AutoForced, Curve
from peers.program import needed
from peers.task import Unavailable
from scipy.integrate import solve_ivp
from turns import Run, arguments, conditions, failing, followed, in_turns, publish

import orbitfinder as of
from orbitfinder.families.start import begin, full_samples

ROOT = Path(__file__).parents[1]
NUMBERS = {"stiffness": 1.0, "cubic": 1.0, "damping": 0.1, "force": 0.3, "frequency": 0.8}
LAST = 2.5
REPEATS = 5
MESHES = ((20, 4), (50, 4), (70, 4), (100, 4), (100, 7))
"""(NTST, NCOL) that AUTO is tried with"""
WITHOUT, DEFAULT = "orbitfinder, without the second integrator", "orbitfinder"
WANTED = {WITHOUT: 0.2, DEFAULT: 0.5}
"""... of the time of AUTO that closes as well"""


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    chosen = parser.parse_args()
    needed()
    with tempfile.TemporaryDirectory() as folder:
        rows = measured(Path(folder), chosen.repeats)
    publish("resonance", page(rows, chosen.repeats), rows, chosen)


def measured(folder: Path, repeats: int) -> list[dict[str, Any]]:
    """A row for each method."""
    orbit = of.find_orbit(
        of.Problem(of.systems.forced_duffing(**NUMBERS), of.Guess([0.5, 0.0], 2 * np.pi / NUMBERS["frequency"]))
    )
    methods: dict[str, Callable[[], tuple[float, Any]]] = {
        WITHOUT: partial(followed, orbit, "frequency", until=LAST, certify=False),
        DEFAULT: partial(followed, orbit, "frequency", until=LAST),
    }
    reference = as_curve(methods[WITHOUT]()[1])[0]
    start = begin(orbit, of.FamilySettings(parameter="frequency"))
    times, states = full_samples(start.curve, start.solution, 800)
    program = AutoForced(folder, NUMBERS, np.column_stack([times, states]), LAST)
    peer = usual = f"AUTO-07p, {MESHES[0][0]} x {MESHES[0][1]}"
    for mesh in MESHES:
        name = f"AUTO-07p, {mesh[0]} x {mesh[1]}"
        try:
            methods[name] = partial(program.go, mesh, *program.stepping(mesh, len(reference.points)))
            closing = worst(methods[name]()[1]) <= worst(reference)
        except Unavailable as failure:
            methods[name], closing = partial(failing, failure), False
        if peer != usual:
            del methods[peer]
        peer = name
        if closing:
            break
    taken = in_turns(methods, range(repeats))
    return [row(name, one, taken[peer], taken[usual]) for name, one in taken.items()]


def row(name: str, one: Any, peer: Any, usual: Any) -> dict[str, Any]:
    """What is told of a method: `Run`, folds, ratios to AUTO that closes as well and to its users'."""
    if isinstance(one, Unavailable):
        return {"method": name, "run": Run(failed=str(one)), "folds": [], "ratios": [np.nan, np.nan], "met": False}
    seconds, given = one
    curve, folds = (given, given.folds) if isinstance(given, Curve) else as_curve(given)
    ended = abs(curve.points[-1, 4] - LAST) > 1e-6
    said = f"ends at w = {curve.points[-1, 4]:.4g}" if ended else ""
    run = Run(seconds=seconds, points=len(curve.points), closure=worst(curve), detail=said)
    ratios = [np.nan if isinstance(other, Unavailable) else seconds / other[0] for other in (peer, usual)]
    met = ratios[0] <= WANTED[name] and (name != WITHOUT or ratios[1] < 1) if name in WANTED else None
    return {"method": name, "run": run, "folds": [float(w) for w in folds], "ratios": ratios, "met": met}


def as_curve(family: of.Family) -> tuple[Curve, np.ndarray]:
    """The points of a family, and its folds."""
    rows = np.array([[*point.state, 0.0, point.period, point.value] for point in family.points])
    return Curve(rows), np.array([event.parameter for event in family.events if event.kind == "fold"])


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


def line(row: dict[str, Any], known: list[str]) -> str:
    """A row of the table."""
    run, folds = row["run"], np.array(row["folds"])
    if run.failed:
        return f"| {row['method']} | failed | {run.failed} | | | | | | |"
    errors = [f"{abs(folds - float(w)).min():.0e}" if folds.size else "none located" for w in known]
    met = {True: "yes", False: "no", None: ""}[row["met"]]
    ratios = " | ".join(f"{one:.2f}" for one in row["ratios"])
    said = f"{run.points} {run.detail}".strip()
    return f"| {row['method']} | {run.told} | {said} | {run.closure:.0e} | {' | '.join(errors)} | {ratios} | {met} |"


def page(rows: list[dict[str, Any]], repeats: int) -> str:
    """The report of a run."""
    known = json.loads((ROOT / "tests" / "data" / "forced.json").read_text())["duffing folds"]
    lines = "\n".join(line(row, known) for row in rows)
    return f"""# Cost of a point on Duffing's resonance curve

Written by `python benchmarks/resonance.py`; processor times, the least of {repeats} turns, multipliers and stability
included. w from {NUMBERS["frequency"]} over both folds to {LAST}. Closures are the worst of one point in four, relative
to the motion, divided by max(1, largest multiplier), by SciPy's DOP853; folds against 140 bits.

| | ms a point | points | closure | error of the upper fold | of the lower | / AUTO closing as well | / 20 x 4 | met |
|---|---|---|---|---|---|---|---|---|
{lines}

AUTO with NTST x NCOL, ISP = 2, ILP = 1, EPSL = EPSU = 1e-12, one thread. Wanted: without the second integrator at most
{WANTED[WITHOUT]:g} of AUTO that closes as well and below 20 x 4, with it at most {WANTED[DEFAULT]:g}.
{conditions()}.
"""


if __name__ == "__main__":
    main()
