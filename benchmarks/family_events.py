"""Events and ends of families against brute force: what is missed and what is invented, counted apart.

Thirteen families, six of them shipped, seven not, are followed by orbitfinder in the ordinary way and compared, as sets
by kind, parameter and period, with `brute_force.py`, which follows them by short steps, another integrator and other
equations (`brute_systems.py`) and is kept in tests/data/brute_force.json. `tests/data/cycles.json` and
`curves.json` have numbers of AUTO-07p and of 140 bits for five of them. Writes results/validation/family_events.md;
exit 1 when anything is missed or invented.

    python -m benchmarks.family_events [NAME ...]                    the comparison, a minute or two
    python -m benchmarks.family_events --again [NAME ...]            brute force computed again first, five minutes
    python -m benchmarks.family_events --dense [NAME ...] [--points 150] [--step 0.05]

`--dense` instead follows problems of problems/families, which are conservative, by short steps without looking for
events. At each orbit the
multipliers come from DOP853 on Hamilton's equations (for orbits that are their own mirror image those of half a
period), and what changed since the orbit before is counted: real stability indices beyond +2 and -2, complex ones,
verdicts, and turns of the energy or the freed parameter. Beside it stands how often `continue` says so. An event that
comes and goes between two dense orbits is in one column only.

    python -m benchmarks.family_events --switch FAMILY.json ...      every event switched, or why not
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

import orbitfinder as of
from benchmarks.brute_force import recorded as brute_forced
from benchmarks.brute_systems import OWN, SHIPPED
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.branches import SWITCHABLE, branches, described
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.evidence import gather
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import Family, FamilyPoint, load_family

ROOT = Path(__file__).parents[1]
REAL = 1e-6
READABLE = 1e5
"""Largest multiplier up to which the others of a product of that size are read"""


# ---- against brute force -----------------------------------------------------------------------------

KEPT = ROOT / "tests" / "data" / "brute_force.json"
PAGE = ROOT / "results" / "validation" / "family_events.md"
VALUE, PERIOD, HOPF = 1e-7, 1e-4, 1e-8
"""Within what an event is the same one: its parameter, its period (which at a fold moves with the parameter's root),
both relative; and of Hopf points the parameter"""
FILES = {"hodgkin-huxley": "gallery"}
"""Where problem files are that are not in problems/families"""


def _oscillator(t: Any, x: Any, p: Any) -> list[Any]:
    return [x.v, -(100.0**2) * x.x + (p.mu - x.x**2) * x.v]


def _morris_lecar(t: Any, x: Any, p: Any) -> list[Any]:
    opened, wanted = (1 + ca.tanh((x.V + 1.2) / 18)) / 2, (1 + ca.tanh((x.V - 2) / 30)) / 2
    through = 2 * (x.V + 60) + 4.4 * opened * (x.V - 120) + 8 * x.w * (x.V + 84)
    return [(p.current - through) / 20, 0.04 * (wanted - x.w) * ca.cosh((x.V - 2) / 60)]


def _bonhoeffer(t: Any, x: Any, p: Any) -> list[Any]:
    return [3 * (x.x - x.x**3 / 3 + x.y), -(x.x - p.a + 0.8 * x.y) / 3]


def _circuit(t: Any, x: Any, p: Any) -> list[Any]:
    be, ga, r, a3, b3 = 0.5, -0.6, 0.6, 0.328578, 0.933578
    return [
        (-(be + p.nu) * x.x + be * x.y - a3 * x.x**3 + b3 * (x.y - x.x) ** 3) / r,
        be * x.x - (be + ga) * x.y - x.z - b3 * (x.y - x.x) ** 3,
        x.y,
    ]


def _tube(t: Any, x: Any, p: Any) -> list[Any]:
    a, b, h = 2.0, 5.45, 1 / 6
    mass = (np.diag([10.0] * 5) + np.diag([1.0] * 4, 1) + np.diag([1.0] * 4, -1)) / 12
    second = (np.diag([-2.0] * 5) + np.diag([1.0] * 4, 1) + np.diag([1.0] * 4, -1)) / h**2
    edge = np.array([1.0, 0.0, 0.0, 0.0, 1.0]) / h**2
    u, v = ca.vertcat(*[x[k] for k in range(5)]), ca.vertcat(*[x[k] for k in range(5, 10)])
    made = u**2 * v
    found = [
        d / p.L**2 * (ca.DM(np.linalg.solve(mass, second)) @ w + ca.DM(np.linalg.solve(mass, edge)) * level) + react
        for d, w, level, react in ((0.008, u, a, made - (b + 1) * u + a), (0.004, v, b / a, b * u - made))
    ]
    return [one for part in found for one in ca.vertsplit(part)]


FIELDS: dict[str, tuple[Callable[..., Any], list[str]]] = {
    "oscillator in SI": (_oscillator, ["x", "v"]),
    "Morris-Lecar": (_morris_lecar, ["V", "w"]),
    "FitzHugh, AUTO's fhn": (_bonhoeffer, ["x", "y"]),
    "circuit, AUTO's tor": (_circuit, ["x", "y", "z"]),
    "Brusselator along a tube, AUTO's brf": (_tube, [f"{name}{k}" for name in "XY" for k in range(1, 6)]),
}
"""The equations that are not shipped, as a user writes them, and the names of their components"""
BUILT: dict[str, Callable[[float], Model]] = {
    "Rossler": lambda c: of.systems.rossler(c=c), "Brusselator": lambda rate: of.systems.brusselator(rate=rate),
}  # fmt: skip


def problem_of(name: str, kept: dict[str, Any]) -> Problem:
    """The problem that orbitfinder is given: a shipped file, or the equations and brute force's first orbit."""
    if name not in FIELDS and name not in BUILT:
        return load_problem(ROOT / "problems" / FILES.get(name, "families") / f"{name}.toml", False)
    if name in BUILT:
        model = BUILT[name](kept["start"])
    else:
        field, states = FIELDS[name]
        model = of.ode(field, states, {kept["parameter"]: kept["start"]})
    return Problem(model, of.Guess(kept["state"], kept["period"]))


@dataclass(frozen=True)
class Row:
    """One family in one direction: what agrees, what is missed, what is invented, and its end."""

    name: str
    direction: int
    agreed: tuple[str, ...]
    missed: tuple[str, ...]
    invented: tuple[str, ...]
    off: float
    end: str
    ended: str
    right: bool
    seconds: float


def named(event: Any, parameter: str) -> str:
    """The kind by which brute force names an event, "" for what it does not look for."""
    if event.kind in ("fold", "turn"):
        return "fold" if event.kind == "fold" and event.detail == parameter else "turn"
    return "" if event.kind == "resonance" else event.kind


def matched(truth: list[dict[str, Any]], events: list[tuple[str, float, float]]) -> tuple[list[Any], ...]:
    """Pairs, what of the truth is left over, what of the events; each event stands for one of the truth at most."""
    left, pairs, missed = list(events), [], []
    for one in truth:
        near = [
            (abs(value - one["value"]), k) for k, (kind, value, period) in enumerate(left)
            if kind == one["kind"] and abs(value - one["value"]) <= VALUE * max(1.0, abs(one["value"]))
            and abs(period - one["period"]) <= PERIOD * one["period"]
        ]  # fmt: skip
        if near:
            pairs.append((one, left.pop(min(near)[1])))
        else:
            missed.append(one)
    return pairs, missed, left


def said(kind: str, value: float) -> str:
    """An event in a cell."""
    return f"{kind.replace('_', ' ')} {value:.10g}"


def judged(name: str, kept: dict[str, Any], direction: int) -> Row:
    """One direction of a family, followed by orbitfinder and compared."""
    truth = kept["directions"][str(direction)]
    until = truth["value"] if truth["end"] == "target" else None
    settings = FamilySettings(directions="forward" if direction > 0 else "backward")
    began = time.monotonic()
    family = of.follow_family(problem_of(name, kept), kept["parameter"], until=until, points=300, settings=settings)
    parameter = kept["parameter"]
    events = [(named(one, parameter), one.parameter, one.period) for one in family.events]
    pairs, missed, invented = matched(truth["events"], [one for one in events if one[0]])
    end = family.ends[-1]
    value = getattr(end, "parameter", None)
    value = max(family.points, key=lambda point: abs(point.arclength)).value if value is None else value
    near = end.kind != "hopf" or abs(value - truth["value"]) <= HOPF * max(1.0, abs(value))
    return Row(
        name, direction,
        tuple(said(one["kind"], one["value"]) for one, _ in pairs),
        tuple(said(one["kind"], one["value"]) for one in missed),
        tuple(said(kind, value) for kind, value, _ in invented),
        max((abs(one["value"] - other[1]) / max(1.0, abs(one["value"])) for one, other in pairs), default=0.0),
        said(truth["end"], truth["value"]), said(end.kind, float(value)), near and end.kind == truth["end"],
        time.monotonic() - began,
    )  # fmt: skip


def rows_of(names: list[str]) -> Iterator[Row]:
    """Every row, as it is found; a family that raises has missed everything."""
    kept = json.loads(KEPT.read_text(encoding="utf-8"))
    for name, one in kept.items():
        for direction in map(int, one["directions"] if not names or name in names else ()):
            try:
                yield judged(name, one, direction)
            except Exception as error:  # whatever it is, nothing of this family is known then
                truth = one["directions"][str(direction)]
                missed = tuple(said(event["kind"], event["value"]) for event in truth["events"])
                end = said(truth["end"], truth["value"])
                yield Row(name, direction, (), missed, (), 0.0, end, f"{type(error).__name__}: {error}", False, 0.0)


def page(rows: list[Row]) -> str:
    """results/validation/family_events.md."""
    missed, invented = (sum(len(getattr(row, which)) for row in rows) for which in ("missed", "invented"))
    agreed, ends = sum(len(row.agreed) for row in rows), sum(row.right for row in rows)
    lines = [
        "# Events of families against brute force\n",
        "Written by `python -m benchmarks.family_events`: families followed in the ordinary way, compared as sets by "
        "kind, parameter and period with a second program that shares no line and no equation with the first "
        "(`benchmarks/brute_force.py`: short steps, multiple shooting, an eighth-order method with complex-step "
        f"derivatives; every kind but resonances). An event is the same within {VALUE:g} of its parameter and "
        f"{PERIOD:g} of its period, an end within {HOPF:g}.\n",
        f"**{len({row.name for row in rows})} families, {len(rows)} directions: {agreed} events agree, {missed} "
        f"missed, {invented} invented; {ends} of {len(rows)} ends agree.**\n",
        "| family | direction | agree | largest difference | missed | invented | end by brute force | end | seconds |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        cells = [
            row.name, "up" if row.direction > 0 else "down", str(len(row.agreed)), f"{row.off:.1e}",
            f"{len(row.missed)}" + (f": {'; '.join(row.missed)}" if row.missed else ""),
            f"{len(row.invented)}" + (f": {'; '.join(row.invented)}" if row.invented else ""),
            row.end, row.ended if row.right else f"**{row.ended}**", f"{row.seconds:.0f}",
        ]  # fmt: skip
        lines.append(f"| {' | '.join(cells)} |")
    lines += ["", "## What agrees", ""]
    for row in rows:
        if row.agreed:
            lines.append(f"- {row.name}, {'up' if row.direction > 0 else 'down'}: {'; '.join(row.agreed)}")
    return "\n".join(lines) + "\n"


def computed_again(names: list[str]) -> None:
    """tests/data/brute_force.json, for the named families or all of them."""
    kept = json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}
    for system in (*SHIPPED, *OWN):
        if not names or system.name in names:
            kept[system.name] = brute_forced(system)
            print(f"brute force: {system.name}", file=sys.stderr, flush=True)
    order = [system.name for system in (*SHIPPED, *OWN) if system.name in kept]
    KEPT.write_text(json.dumps({name: kept[name] for name in order}, indent=1) + "\n", encoding="utf-8")


def against_brute_force(names: list[str], again: bool, target: Path) -> int:
    """The comparison; 1 when anything is missed, invented or ends otherwise."""
    if again:
        computed_again(names)
    rows = []
    for row in rows_of(names):
        rows.append(row)
        print(f"{row.name} {row.direction:+d}: {len(row.agreed)} agree, missed {row.missed}, invented {row.invented}, "
              f"end {row.ended} ({row.end}), {row.seconds:.0f} s", flush=True)  # fmt: skip
    if not names:
        target.write_text(page(rows), encoding="utf-8")
    return int(any(row.missed or row.invented or not row.right for row in rows))


# ---- conservative families by short steps ------------------------------------------------------------


def seen(model: Model, point: FamilyPoint) -> tuple[int, int, int, bool] | None:
    """(indices beyond +2, beyond -2, complex pairs, unstable) of an orbit, of its half map where it has one."""
    there = with_parameters(model, dict(point.free))
    half = point.root == 2
    try:
        found = gather(there, point.state, point.period / point.root, np.zeros(model.degrees_of_freedom)).floquet
    except IntegrationError:  # too near a saddle
        return None
    indices = -found.indices if half else found.indices
    if np.abs(found.multipliers).max(initial=1.0) > READABLE:
        return None
    real = np.abs(indices.imag) < REAL * np.maximum(1.0, np.abs(indices))
    beyond = [int(np.sum(real & (sign * indices.real > 2))) for sign in (1, -1)]
    return beyond[0], beyond[1], int(np.sum(~real)) // 2, sum(beyond) + int(np.sum(~real)) > 0


def brute(family: Family, model: Model) -> tuple[Counter[str], float]:
    """What changes from orbit to orbit, up to the arclength at which the multipliers are no longer readable."""
    counts: Counter[str] = Counter()
    before, level = None, family.parameter
    last = family.points[0].arclength
    values = [point.value for point in family.points]
    for k, point in enumerate(family.points):
        now = seen(model, point)
        if now is None:
            break
        if before is not None:
            passed = [abs(now[j] - before[j]) % 2 for j in (0, 1)]
            counts["+1"] += passed[0]
            counts["-1"] += passed[1]
            counts["collision"] += abs(now[2] - before[2])
            between = 2 * (sum(passed) == 2 and now[3] == before[3])  # from one side of the circle to the other
            counts["stability"] += int(now[3] != before[3]) + between
        if 0 < k < len(values) - 1:
            counts[f"fold {level}"] += (values[k] - values[k - 1]) * (values[k + 1] - values[k]) < 0
        before, last = now, point.arclength
    return counts, last


def recorded(family: Family, last: float) -> Counter[str]:
    """The same from the events."""
    counts: Counter[str] = Counter()
    for event in family.events:
        if event.arclength > last:
            continue
        critical = event.kind in ("branch_point", "period_doubling") and abs(event.multiplier.imag) < 1e-9
        counts["+1"] += critical and event.multiplier.real > 0
        counts["-1"] += critical and event.multiplier.real < 0
        counts["collision"] += event.kind == "collision" and not event.detail
        counts["stability"] += event.kind == "stability_change"
        turn = event.kind in ("fold", "turn") and event.detail == family.parameter
        counts[f"fold {family.parameter}"] += turn
        counts["+1"] += turn and family.parameter == "energy"
    return counts


def compared(problem: Problem, points: int, step: float, folder: Path) -> str:
    """One row: the problem, its dense orbits, and what either says."""
    settings = FamilySettings(directions="forward", certify=False)
    dense = FamilySettings(directions="forward", certify=False, events=False, longest_step=step, first_step=step)
    fine = follow_family(problem, points=points, out=folder / "fine", settings=dense)
    until = max(point.arclength for point in fine.points)
    told = follow_family(problem, points=points, out=folder / "told", settings=settings)
    model = problem.model if problem.model.constraint is None else None
    if model is None:
        from orbitfinder.mechanics.kind import build_model

        model = build_model(fine.system)
    counts, last = brute(fine, model)
    events = recorded(told, min(last, until))
    keys = sorted(set(counts) | set(events))
    cells = ", ".join(f"{key} {counts[key]}/{events[key]}" for key in keys if counts[key] or events[key])
    same = all(counts[key] == events[key] for key in keys)
    return f"| {problem.name} | {len(fine.points)} | {cells or 'none'} | {'yes' if same else 'NO'} |"


def switched(file: Path) -> None:
    """Every event whose kind has a branch: how many were found there, or why none."""
    family = load_family(file)
    for k, event in enumerate(family.events):
        if event.kind not in SWITCHABLE:
            continue
        began = time.perf_counter()
        try:
            found = branches(file, k)
            told = ", ".join(one.start.curve.equations.symmetry.name for one in found)
        except (ConvergenceError, IntegrationError) as error:
            told = f"none: {error}"
        print(f"| {family.name} | {described(family, k)} | {told} | {time.perf_counter() - began:.1f} s |", flush=True)


def main() -> None:
    """The table on standard output."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--points", type=int, default=150)
    parser.add_argument("--step", type=float, default=0.05)
    for flag in ("--switch", "--dense", "--again"):
        parser.add_argument(flag, action="store_true")
    parser.add_argument("--out", type=Path, default=PAGE)
    chosen = parser.parse_args()
    if chosen.switch:
        print("| family | event | branches | time |\n|---|---|---|---|")
        for name in chosen.names:
            switched(Path(name))
        return
    if not chosen.dense:
        raise SystemExit(against_brute_force(chosen.names, chosen.again, chosen.out))
    print("| family | dense orbits | counted / recorded | same |\n|---|---|---|---|")
    for file in sorted((ROOT / "problems" / "families").glob("*.toml")):
        if chosen.names and file.stem not in chosen.names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            print(compared(load_problem(file, False), chosen.points, chosen.step, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
