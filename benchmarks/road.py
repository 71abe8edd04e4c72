"""Equilibria and cycles that AUTO's users know: cost of a point beside AUTO-07p's, and one whole diagram.

Cycles from one orbit to another value of the parameter, by shooting and by collocation, events located, as
`of.follow_family` does without the second integrator and with default settings; AUTO-07p on the coarsest mesh that
closes as well and at its users' 20 x 4. Equilibria over a range, folds and Hopf points located, certified here; AUTO's
users' constants. All in turns (turns.py says what a time is). Closures are judged by SciPy's DOP853 on the plain
equations of `brute_systems.py`, relative to the motion and to max(1, largest multiplier).

    python benchmarks/road.py            writes results/benchmarks/road.md
    python benchmarks/road.py --json     prints the rows instead
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from peers.auto_family import written
from peers.program import Program, needed
from peers.task import Unavailable
from scipy.integrate import solve_ivp
from turns import Run, arguments, conditions, failing, followed, in_turns, processor_time, progress, publish

import orbitfinder as of
from orbitfinder.families.start import begin, full_samples

sys.path.insert(0, str(Path(__file__).parents[1]))
from benchmarks import brute_systems as brute

REPEATS = 3
MESHES = ((20, 4), (50, 4), (100, 4), (100, 7))
"""(NTST, NCOL) that AUTO is tried with"""
WITHOUT, DEFAULT, COLLOCATION, AUTO = "shooting", "shooting, default", "collocation", "AUTO-07p"
WANTED = {WITHOUT: 0.5, COLLOCATION: 3.0}
"""Of AUTO's time a point on the mesh that closes as well"""
EQUILIBRIUM, DIAGRAM = 0.5, 3.0
"""Wanted: ms an equilibrium, s the diagram of Morris-Lecar"""


@dataclass(frozen=True)
class Case:
    """A system: equations of (t, x, p, s) in NumPy and in CasADi, names, a state that goes to the cycle, its parameter
    there, where its family is to go; a state near the equilibrium, and the range of equilibria."""

    name: str
    plain: Callable[..., np.ndarray]
    rates: Callable[[Any, Any], list[Any]]
    names: tuple[str, ...]
    parameter: str
    attracted: tuple[float, ...]
    cycles: tuple[float, float]
    rest: tuple[float, ...]
    equilibria: tuple[float, float]
    settle: float = 1000.0


def fish(_: Any, x: np.ndarray, q: Any, s: Any) -> np.ndarray:
    """Predators and prey, AUTO's demo pp2."""
    return np.array([3 * x[0] * (1 - x[0]) - x[0] * x[1] - q * (1 - np.exp(-5 * x[0])), -x[1] + 3 * x[0] * x[1]])


def squid(x: Any, current: Any) -> list[Any]:
    """`brute.hodgkin_huxley`."""
    v, m, h, n = (x[k] for k in range(4))

    def ramp(u: Any) -> Any:
        return u / (1 - ca.exp(-u))

    return [
        current - 120 * m**3 * h * (v - 50) - 36 * n**4 * (v + 77) - 0.3 * (v + 54.387),
        ramp((v + 40) / 10) * (1 - m) - 4 * ca.exp(-(v + 65) / 18) * m,
        0.07 * ca.exp(-(v + 65) / 20) * (1 - h) - h / (1 + ca.exp(-(v + 35) / 10)),
        0.1 * ramp((v + 55) / 10) * (1 - n) - 0.125 * ca.exp(-(v + 65) / 80) * n,
    ]


def barnacle(x: Any, current: Any) -> list[Any]:
    """`brute.morris_lecar`."""
    v, w = x[0], x[1]
    opened, wanted = (1 + ca.tanh((v + 1.2) / 18)) / 2, (1 + ca.tanh((v - 2) / 30)) / 2
    return [(current - 2 * (v + 60) - 4.4 * opened * (v - 120) - 8 * w * (v + 84)) / 20,
            0.04 * (wanted - w) * ca.cosh((v - 2) / 60)]  # fmt: skip


def circuit(x: Any, nu: Any) -> list[Any]:
    """`brute.circuit`."""
    u, v, w = x[0], x[1], x[2]
    cube = 0.933578 * (v - u) ** 3
    return [(-(0.5 + nu) * u + 0.5 * v - 0.328578 * u**3 + cube) / 0.6, 0.5 * u + 0.1 * v - w - cube, v]


def tube(x: Any, length: Any) -> list[Any]:
    """`brute.diffusing`."""
    u, v = (ca.vertcat(*(x[5 * half + k] for k in range(5))) for half in range(2))
    parts = []
    for diffusion, w, edge, rate in (
        (0.008, u, 2.0, u**2 * v - 6.45 * u + 2.0),
        (0.004, v, 5.45 / 2.0, 5.45 * u - u**2 * v),
    ):
        parts.append(diffusion / length**2 * (ca.mtimes(brute.SECOND, w) + 36 * edge * brute.ENDS) + rate)
    return [parts[k // 5][k % 5] for k in range(10)]


CASES = (
    Case("predator-prey (pp2)", fish,
         lambda x, q: [3 * x[0] * (1 - x[0]) - x[0] * x[1] - q * (1 - ca.exp(-5 * x[0])), -x[1] + 3 * x[0] * x[1]],
         ("fish", "sharks"), "q", (0.3, 0.5), (0.68, 0.7), (0.33, 1.4), (0.1, 0.68)),
    Case("circuit (tor)", brute.circuit, circuit, ("x", "y", "z"), "nu", (0.4, 0.1, 0.1), (-0.62, -0.59),
         (0.0, 0.0, 0.0), (-0.9, -0.45)),
    Case("Brusselator along a tube (brf)", brute.diffusing, tube, tuple(f"{w}{k}" for w in "uv" for k in range(5)), "L",
         (2.2,) * 5 + (2.6,) * 5, (1.0, 1.15), (2.0,) * 5 + (2.7,) * 5, (0.4, 1.0)),
    Case("Lorenz", brute.lorenz, lambda x, rho: [10 * (x[1] - x[0]), x[0] * (rho - x[2]) - x[1],
         x[0] * x[1] - 8 / 3 * x[2]], ("x", "y", "z"), "rho", (-47.1114, -18.5885, 328.3983), (320.0, 250.0),
         (7.0, 7.0, 19.0), (20.0, 28.0), 100.0),
    Case("Brusselator", brute.brusselator, lambda x, b: [1 - (b + 1) * x[0] + x[0] ** 2 * x[1],
         b * x[0] - x[0] ** 2 * x[1]], ("x", "y"), "b", (1.0, 2.0), (3.0, 2.1), (1.0, 1.5), (1.5, 2.5)),
    Case("Morris-Lecar", brute.morris_lecar, barnacle, ("V", "w"), "I", (0.0, 0.1), (150.0, 205.0), (-40.0, 0.05),
         (50.0, 250.0), 2000.0),
    Case("Hodgkin-Huxley", brute.hodgkin_huxley, squid, ("V", "m", "h", "n"), "I", (0.0, 0.592, 0.3, 0.481),
         (60.0, 140.0), (-65.0, 0.05, 0.6, 0.32), (0.0, 180.0), 200.0),
)  # fmt: skip


def model(case: Case, value: float) -> of.Model:
    """The system at a value of its parameter."""
    return of.ode(lambda t, x, p: case.rates(x, p[0]), list(case.names), parameters={case.parameter: value})


def problem(case: Case) -> of.Problem:
    """The cycle to which a simulation goes, as a problem."""
    value = case.cycles[0]

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        return case.plain(t, x, value, 0.0)

    state = solve_ivp(rates, (0.0, case.settle), case.attracted, method="LSODA", rtol=1e-9, atol=1e-11).y[:, -1]
    rate = rates(0.0, state)

    def back(t: float, x: np.ndarray) -> float:
        return float((x - state) @ rate) if t > 1e-3 else 1.0

    back.direction = 1.0  # type: ignore[attr-defined]
    later = solve_ivp(rates, (0.0, case.settle), state, method="LSODA", rtol=1e-9, atol=1e-11, events=back)
    gaps = np.abs(later.y_events[0] - state).max(axis=1) if later.t_events[0].size else np.ones(1)
    first = int(np.argmax(gaps < 10 * gaps.min() + 1e-6))
    found = of.find_orbit(of.Problem(model(case, value), of.Guess(state, float(later.t_events[0][first]))))
    return of.Problem(model(case, value), of.Guess(found.state, found.period))


def closure(case: Case, row: np.ndarray) -> float:
    """Of a point (state, period, parameter)."""
    *state, period, value = row
    d, x = len(state), ca.SX.sym("x", len(state))
    jacobian = ca.Function("j", [x], [ca.densify(ca.jacobian(ca.vertcat(*case.rates(x, value)), x))])

    def field(t: float, y: np.ndarray) -> np.ndarray:
        turned = jacobian(y[:d]).full() @ y[d:].reshape(d, d)
        return np.concatenate([case.plain(t, y[:d], value, 0.0), turned.ravel()])

    start = np.concatenate([state, np.eye(d).ravel()])
    path = solve_ivp(field, (0.0, period), start, method="DOP853", rtol=1e-12, atol=1e-14).y
    grown = np.abs(np.linalg.eigvals(path[d:, -1].reshape(d, d))).max()
    fine = solve_ivp(lambda t, x: case.plain(t, x, value, 0.0), (0.0, period), state, method="DOP853", rtol=3e-14,
                     atol=1e-15).y  # fmt: skip
    return float((np.abs(fine[:, -1] - state) / np.ptp(fine, axis=1)).max() / max(1.0, grown))


def worst(case: Case, rows: np.ndarray) -> float:
    """The largest closure of one point in six."""
    return max(closure(case, row) for row in rows[1::6])


def rows_of(family: of.Family) -> np.ndarray:
    """(state, period, parameter) of its points."""
    return np.array([[*point.state, point.period, point.value] for point in family.points])


def ours(case: Case, origin: of.Problem, **settings: Any) -> tuple[float, np.ndarray]:
    """Seconds a point of the family, and its points; only towards where it is to go."""
    seconds, family = followed(origin, case.parameter, until=case.cycles[1], **settings)
    rows = rows_of(family)
    if family.ends[-1].kind != "target":
        raise Unavailable(f"ends at {rows[-1, -1]:.6g}: {family.ends[-1].kind}")
    return seconds, rows


def of_auto(program: Program, case: Case, mesh: tuple[int, int], step: float) -> tuple[float, np.ndarray]:
    """The same by AUTO."""
    seconds, rows = program.run(mesh, ICP=[1, 11], ILP=1, ISP=2, NMX=2000, DS=step, DSMAX=abs(step), EPSS=1e-8,
                                UZSTOP={1: case.cycles[1]})  # fmt: skip
    if abs(rows[-1, -2] - case.cycles[1]) > 1e-6 * abs(case.cycles[1]):
        raise Unavailable(f"ends at {rows[-1, -2]:.6g}")
    return seconds, rows[:, :-1]


def stepping(program: Program, case: Case, points: int, mesh: tuple[int, int]) -> float:
    """DS with which AUTO goes there in about as many points."""
    size = abs(case.cycles[1] - case.cycles[0]) / points
    step, best, away = float(np.copysign(size, case.cycles[1] - case.cycles[0])), 0.0, np.inf
    for _ in range(8):
        try:
            met = len(of_auto(program, case, mesh, step)[1])
        except Unavailable:
            step /= -1.0 if best == 0.0 and step * (case.cycles[1] - case.cycles[0]) > 0 else 2.0
            continue
        if abs(met - points) < away:
            best, away = step, abs(met - points)
        if away <= 0.1 * points:
            break
        step *= float(np.clip(met / points, 0.2, 5.0))
    if best == 0.0:
        raise Unavailable("AUTO-07p does not get there")
    return best


def cycles(case: Case, folder: Path, repeats: int) -> list[dict[str, Any]]:
    """A row for every method."""
    origin = problem(case)
    methods: dict[str, Callable[[], tuple[float, Any]]] = {
        WITHOUT: partial(ours, case, origin, certify=False),
        DEFAULT: partial(ours, case, origin),
    }
    if "method" in of.FamilySettings.__dataclass_fields__:
        methods[COLLOCATION] = partial(ours, case, origin, certify=False, method="collocation")
    reference = methods[WITHOUT]()[1]
    start = begin(origin, of.FamilySettings(parameter=case.parameter))
    times, states = full_samples(start.curve, start.solution, 400)
    x, p = ca.SX.sym("x", len(case.names)), ca.SX.sym("p")
    code = written(folder, x, p, ca.vertcat(*case.rates(x, p)), f"par[0] = {case.cycles[0]!r};")
    program, asked = Program(folder, code, np.column_stack([times, states])), worst(case, reference)
    meshes: list[tuple[int, int]] = []
    for mesh in MESHES:
        meshes.append(mesh)
        try:
            run = partial(of_auto, program, case, mesh, stepping(program, case, len(reference), mesh))
            good = worst(case, run()[1]) <= asked
        except Unavailable as failure:
            run, good = partial(failing, failure), False
        methods[f"{AUTO}, {mesh[0]} x {mesh[1]}"] = run
        if good:
            break
    for mesh in meshes[1:-1]:
        del methods[f"{AUTO}, {mesh[0]} x {mesh[1]}"]
    taken = in_turns(methods, range(repeats))
    peer = taken[f"{AUTO}, {meshes[-1][0]} x {meshes[-1][1]}"]
    rows = []
    for name, given in taken.items():
        if isinstance(given, Unavailable):
            failed = Run(failed=str(given))
            rows.append({"case": case.name, "method": name, "run": failed, "ratio": np.nan, "met": None})
            continue
        run = Run(seconds=given[0], points=len(given[1]), closure=worst(case, given[1]))
        ratio = np.nan if isinstance(peer, Unavailable) else given[0] / peer[0]
        met = bool(ratio <= WANTED[name]) if name in WANTED else None
        rows.append({"case": case.name, "method": name, "run": run, "ratio": ratio, "met": met})
    return rows


def equilibria(case: Case, folder: Path, repeats: int) -> dict[str, Any]:
    """Both along the equilibria."""
    low, high = case.equilibria
    here = model(case, low)
    x, p = ca.SX.sym("x", len(case.names)), ca.SX.sym("p")

    def follow() -> tuple[float, Any]:
        began = processor_time()
        curve = of.follow_equilibria(here, case.rest, case.parameter, until=high)
        return (processor_time() - began) / len(curve.points), curve

    state = of.follow_equilibria(here, case.rest, case.parameter, until=high, points=1).points[0].state
    start = f"par[0] = {low!r}; " + " ".join(f"u[{k}] = {value!r};" for k, value in enumerate(map(float, state)))
    program = Program(folder, written(folder, x, p, ca.vertcat(*case.rates(x, p)), start),
                      np.zeros((2, 1 + len(case.names))))  # fmt: skip

    def auto() -> tuple[float, Any]:
        size = (high - low) / 50
        return program.run((20, 4), ICP=[1], IPS=1, ILP=1, ISP=2, NMX=1000, DS=size, DSMAX=size, EPSS=1e-8, dat=None,
                           UZSTOP={1: high})  # fmt: skip

    taken = in_turns({"ours": follow, AUTO: auto}, range(repeats))
    mine = taken["ours"]
    told = {
        name: Run(failed=str(given))
        if isinstance(given, Unavailable)
        else Run(seconds=given[0], points=len(getattr(given[1], "points", given[1])))
        for name, given in taken.items()
    }
    special = "" if isinstance(mine, Unavailable) else ", ".join(event.kind for event in mine[1].events)
    return {"case": case.name, "ours": told["ours"], "auto": told[AUTO], "events": special,
            "met": bool(told["ours"].seconds * 1e3 <= EQUILIBRIUM)}  # fmt: skip


def diagram(repeats: int) -> tuple[float, str]:
    """Seconds of Morris-Lecar's whole diagram in a warm process, and what is in it."""
    case, least, seen = CASES[5], np.inf, ""
    for _ in range(repeats + 1):
        began = time.perf_counter()
        made = of.diagram(model(case, case.equilibria[0]), case.rest, case.parameter, until=case.equilibria[1])
        least, seen = min(least, time.perf_counter() - began), repr(made)
    return least, seen


def line(row: dict[str, Any]) -> str:
    """A row of the table of cycles."""
    run, met = row["run"], {True: "yes", False: "no", None: ""}[row["met"]]
    if run.failed:
        return f"| {row['case']} | {row['method']} | failed | | | | {run.failed} |"
    ratio = "" if np.isnan(row["ratio"]) else f"{row['ratio']:.2f}"
    return f"| {row['case']} | {row['method']} | {run.told} | {run.points} | {run.closure:.0e} | {ratio} | {met} |"


def rest_line(row: dict[str, Any]) -> str:
    """A row of the table of equilibria."""
    ours, auto = row["ours"], row["auto"]
    met = "yes" if row["met"] else "no"
    return (f"| {row['case']} | {ours.told} | {ours.points} | {auto.told} | {auto.points} | {row['events']} | {met} | "
            f"{ours.failed or auto.failed} |")  # fmt: skip


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument("--only", nargs="+", default=None, help="names of systems, or their beginnings")
    chosen = parser.parse_args()
    needed()
    rows: list[dict[str, Any]] = []
    rest: list[dict[str, Any]] = []
    for case in CASES:
        if chosen.only and not any(case.name.lower().startswith(word.lower()) for word in chosen.only):
            continue
        with tempfile.TemporaryDirectory() as folder:
            rest.append(equilibria(case, Path(folder), chosen.repeats))
        progress(rest_line(rest[-1]))
        with tempfile.TemporaryDirectory() as folder:
            rows += cycles(case, Path(folder), chosen.repeats)
        for row in rows:
            if row["case"] == case.name:
                progress(line(row))
    whole, seen = diagram(chosen.repeats)
    progress(f"diagram {whole:.2f} s {seen}")
    publish("road", page(rows, rest, whole, seen, chosen.repeats), [*rows, *rest, {"diagram": whole}], chosen)


def page(rows: list[dict[str, Any]], rest: list[dict[str, Any]], whole: float, seen: str, repeats: int) -> str:
    """The report of a run."""
    cycle_lines, rest_lines = "\n".join(map(line, rows)), "\n".join(map(rest_line, rest))
    return f"""# Equilibria and cycles that AUTO's users know

Written by `python benchmarks/road.py`; processor times, the least of {repeats} turns, in a warm process, events
located, multipliers and stability included. Closures are the worst of one point in six.

| system | method | ms a point | points | closure | / AUTO closing as well | met |
|---|---|---|---|---|---|---|
{cycle_lines}

AUTO with NTST x NCOL, ISP = 2, ILP = 1, EPSL = EPSU = 1e-12, one thread, in about as many points. Wanted of AUTO that
closes as well: shooting {WANTED[WITHOUT]:g}, collocation {WANTED[COLLOCATION]:g}. "Default" closes every point and
every event by the second integrator.

## Equilibria

| system | ms a point | points | AUTO's | points | events | at most {EQUILIBRIUM:g} ms | |
|---|---|---|---|---|---|---|---|
{rest_lines}

Ours are certified each, with error bars; AUTO's time is its program's from start to end.

## The whole diagram of Morris-Lecar

`of.diagram` in a warm process: {whole:.2f} s (wanted {DIAGRAM:g}). {seen}

{conditions()}.
"""


if __name__ == "__main__":
    main()
