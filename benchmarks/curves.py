"""Curves of bifurcations in two parameters: orbitfinder beside AUTO-07p, and both beside numbers of 140 bits.

Doublings of two coupled pendula (AUTO's demo `pen`) from damping 0.1 to 0.5 and folds of Duffing's oscillator from a
force of 0.3 to 0.5. Each program starts from one orbit, finds the event, frees the second parameter and goes on with
its own steps. Time is that of this second run (turns.py): `of.follow_family` from the event with default settings,
which close every point by the second integrator and locate codimension two; AUTO's on the coarsest mesh that is right
to TOLERANCE, its events on. Closures of both are judged by SciPy's DOP853 on the equations as they stand here.

    python benchmarks/curves.py           writes results/benchmarks/curves.md
    python benchmarks/curves.py --json    prints the rows instead
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from peers.auto_curves import DUFFING, PENDULA, AutoLocus, Locus
from peers.program import needed
from peers.task import Unavailable
from scipy.integrate import solve_ivp
from turns import Run, arguments, conditions, failing, followed, in_turns, progress, publish

import orbitfinder as of
from orbitfinder.families.branches import Branch
from orbitfinder.families.curves import curve_start
from orbitfinder.families.start import begin, full_samples

ROOT = Path(__file__).parents[1] / "problems" / "families"
TOLERANCE = 1e-8
REPEATS = 3
MESHES = ((20, 4), (50, 4), (100, 4), (50, 7))
OURS, AUTO = "orbitfinder", "AUTO-07p"


@dataclass(frozen=True)
class Case:
    """A curve: problem file, kind of event, parameters (first, second), ends of the second, first there, steps, and the
    share of AUTO's time that is wanted."""

    name: str
    file: str
    kind: str
    until: float
    parameters: tuple[str, str]
    ends: tuple[float, float]
    expected: tuple[float, float]
    equations: str
    steps: tuple[float, float]
    wanted: float


CASES = (
    Case("doublings of two pendula", "coupled-pendula.toml", "period_doubling", 0.17, ("torque", "damping"), (0.1, 0.5),
         (0.1791637762686538, 0.7966132828830927), PENDULA, (-0.01, 0.02), 0.7),
    Case("folds of Duffing's oscillator", "duffing-resonance.toml", "fold", 2.5, ("frequency", "force"), (0.3, 0.5),
         (1.7797195242985731, 2.2119353170197306), DUFFING, (0.02, 0.02), 0.5),
)  # fmt: skip


def auto(case: Case, folder: Path) -> tuple[partial[tuple[float, Locus]], tuple[int, int]]:
    """AUTO's second run on the coarsest mesh that is right, and that mesh."""
    start = begin(of.load_problem(ROOT / case.file), of.FamilySettings(parameter=case.parameters[0]))
    times, states = full_samples(start.curve, start.solution)
    if case.kind == "fold":
        drive = 2 * np.pi * times / times[-1]
        table = np.column_stack([times, states, np.cos(drive), np.sin(drive)])
    else:
        table = np.column_stack([times, _turned(states)])
    program = AutoLocus(folder, case.equations, table, (float(start.solution.place.free[0]), case.ends[0]))
    for mesh in MESHES:
        label = program.reach(case.kind, mesh, case.steps[0])
        run = partial(program.follow, label, mesh, case.steps[1], case.ends[1])
        if error(case, run()[1]) < TOLERANCE:
            break
    return run, mesh


def _turned(states: np.ndarray) -> np.ndarray:
    """A turn of the pendula from -pi to pi: AUTO's phase condition is the integral of u u'."""
    half = int(np.searchsorted(states[:, 0], np.pi))
    later = states[half:] - 2 * np.pi * np.array([1, 1, 0, 0])
    return np.vstack([later, states[1 : half + 1]])


def begun(case: Case) -> Branch:
    """The event of a family, the second parameter freed."""
    family = of.follow_family(of.load_problem(ROOT / case.file), case.parameters[0], until=case.until)
    number = next(k for k, event in enumerate(family.events) if event.kind == case.kind)
    return curve_start(family, number, case.parameters[::-1])


def ours(case: Case, start: Branch) -> tuple[float, Locus]:
    """The same curve by orbitfinder."""
    seconds, curve = followed(start, case.parameters[1], until=case.ends[1])
    drive = (1.0, 0.0) if case.kind == "fold" else ()
    points = [[*map(one.free.get, case.parameters), one.period, *one.state, *drive] for one in curve.points]
    return seconds, Locus(np.array(points), len(curve.events))


def error(case: Case, locus: Locus) -> float:
    """Of the first parameter at the end, where it is known."""
    return abs(locus.at(case.ends[1]) - case.expected[1])


def duffing(_: float, u: np.ndarray, w: float, force: float) -> list[float]:
    """Rates of Duffing's oscillator and of its drive (cos, sin)."""
    x, v, c, s = u
    grown = 1 - c * c - s * s
    return [v, force * c - 0.1 * v - x - x**3, grown * c - w * s, grown * s + w * c]


def pendula(_: float, u: np.ndarray, torque: float, damping: float) -> list[float]:
    """Rates of two coupled pendula."""
    a, b, p, q = u
    pull = 0.175 * (b - a)
    return [p, q, torque - damping * p - np.sin(a) + pull, torque - damping * q - np.sin(b) - pull]


def closure(case: Case, locus: Locus) -> float:
    """The worst gap round the loop of one point in four, whole turns apart, relative to the extents of the motion."""
    field, worst = duffing if case.kind == "fold" else pendula, 0.0
    for first, second, period, *state in locus.points[::4]:
        path = solve_ivp(field, (0.0, period), state, method="DOP853", rtol=3e-14, atol=1e-15, args=(first, second)).y
        gaps = path[:, -1] - state
        if case.kind != "fold":
            gaps[:2] -= 2 * np.pi * np.round(gaps[:2] / (2 * np.pi))
        worst = max(worst, float((np.abs(gaps) / np.ptp(path, axis=1)).max()))
    return worst


def measured(case: Case, repeats: int) -> dict[str, Any]:
    """Both on one curve."""
    mesh = (0, 0)
    with tempfile.TemporaryDirectory() as folder:
        methods: dict[str, Any] = {OURS: partial(ours, case, begun(case))}
        try:
            methods[AUTO], mesh = auto(case, Path(folder))
        except Unavailable as failure:
            methods[AUTO] = partial(failing, failure)
        taken = in_turns(methods, range(repeats))
    runs, errors = {}, {}
    for name, one in taken.items():
        if isinstance(one, Unavailable):
            runs[name], errors[name] = Run(failed=str(one)), np.nan
        else:
            seconds, locus = one
            said, gap = "x".join(map(str, mesh)) if name == AUTO else "", closure(case, locus)
            runs[name] = Run(seconds=seconds, points=len(locus.points), closure=gap, detail=said)
            errors[name] = error(case, locus)
    special = {name: one[1].special for name, one in taken.items() if not isinstance(one, Unavailable)}
    ratio = runs[OURS].seconds / runs[AUTO].seconds
    return {"curve": case.name, "runs": runs, "errors": errors, "codimension two": special, "ratio": ratio,
            "wanted": case.wanted, "met": bool(ratio <= case.wanted)}  # fmt: skip


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    ours, theirs = (row["runs"][name] for name in (OURS, AUTO))
    pairs = [
        f"{ours.points} / {theirs.points}", f"{ours.closure:.0e} / {theirs.closure:.0e}",
        " / ".join(f"{row['errors'][name]:.1e}" for name in (OURS, AUTO)),
        " / ".join(str(row["codimension two"].get(name, "")) for name in (OURS, AUTO)),
    ]  # fmt: skip
    said = "; ".join(one.failed or one.detail for one in (ours, theirs) if one.failed or one.detail)
    met = "yes" if row["met"] else "no"
    times = f"{ours.told} | {theirs.told} | {row['ratio']:.2f} | {row['wanted']:g} | {met}"
    return f"| {row['curve']} | {times} | {' | '.join(pairs)} | {said} |"


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    chosen = parser.parse_args()
    needed()
    rows = []
    for case in CASES:
        rows.append(measured(case, chosen.repeats))
        progress(line(rows[-1]))
    lines = "\n".join(map(line, rows))
    publish("curves", f"""# Cost of a point on a curve in two parameters

Written by `python benchmarks/curves.py`; processor times in ms a point, the least of {chosen.repeats} turns.
Points, closures, the error of the first parameter at the end and located points of codimension two are ours / AUTO's.

| curve | ours | AUTO's | ours / AUTO's | wanted | met | points | closure | error | codimension two | mesh |
|---|---|---|---|---|---|---|---|---|---|---|
{lines}

AUTO with ISP = 2, ILP = 1, EPSL = EPSU = 1e-11, one thread. {conditions()}.
""", rows, chosen)  # fmt: skip


if __name__ == "__main__":
    main()
