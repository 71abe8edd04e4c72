"""Where the time of one refinement goes: equations, integrator, linear algebra, IPOPT, Python.

Processor time of this process, the least of several runs, for the first orbit of the report. The time in the equations
is their number of evaluations times the time of one, measured apart in calls of many states.

    python benchmarks/breakdown.py             writes results/benchmarks/breakdown.md, in half a minute
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
from machine import load, processor, versions
from peers.auto_family import block
from peers.task import ROOT, tasks

import orbitfinder as of
from orbitfinder.integrate.compiled import compiled, compiling, with_derivatives
from orbitfinder.integrate.cvodes import IntegratorSettings, build_flow
from orbitfinder.integrate.rk8 import variational_field
from orbitfinder.loops import newton
from orbitfinder.loops.loop import Loop
from orbitfinder.orbits import find, objectives
from orbitfinder.orbits import shoot as solve

STAGES = {
    "nodes of the guess": (solve, "initial_nodes"),
    "transcription": (objectives, "transcribe"),
    "IPOPT with CVODES": (objectives, "solve_nlp"),
    "polish": (solve, "_polished"),
    "minimal period": (solve, "_minimal"),
    "samples, multipliers": (solve, "measure"),
    "certificate": (find, "certified"),
}
ROUNDS = 15


def least(action: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Least processor time of one call in ms; short ones are called several times."""
    began = time.process_time()
    action()
    count = max(1, int(0.01 / max(time.process_time() - began, 1e-6)))
    best = np.inf
    for _ in range(rounds):
        began = time.process_time()
        for _ in range(count):
            action()
        best = min(best, (time.process_time() - began) / count)
    return 1e3 * best


def evaluation(field: ca.Function, arguments: list[np.ndarray]) -> float:
    """ms of one evaluation, among 1000."""
    many = field.map(1000)
    inputs = [ca.DM(np.tile(np.reshape(one, (-1, 1)), (1, 1000))) for one in arguments]
    return least(lambda: many.call(inputs)) / 1000


def integrators(mode: str) -> list[str]:
    """One period of x and Phi by CVODES at 1e-13 and by 100 eighth-order steps; of x alone by 400 steps."""
    task = tasks()[0]
    model = of.chain(task.links)
    flow = build_flow(model, (), model.invariants)
    size = task.state.size
    varied = variational_field(flow.field)
    start = np.concatenate([task.state, np.eye(size, size + 1).ravel("F")])
    with compiling(mode):
        inside, plain, whole = with_derivatives(varied), compiled(flow.field), compiled(varied)
        marches = {
            "x, Phi: 100 steps": (compiled(block(varied, 100)), 1200, whole, start, 100),
            "x: 400 steps": (compiled(block(flow.field, 400)), 4800, plain, task.state, 400),
        }
    y = ca.MX.sym("y", start.size)
    problem = {"x": y, "ode": task.period * inside(0, y, 0, ca.DM(0, 1))}
    solver = ca.integrator("x_phi", "cvodes", problem, 0, 1, IntegratorSettings().options())
    total = least(lambda: solver(x0=start))
    calls = int(solver.stats()["nfevals"])
    one = evaluation(whole, [np.zeros(1), start, np.zeros(1), np.zeros((0, 1))])
    rows = [row(f"x, Phi: CVODES, {mode}", total, calls, one)]
    for name, (march, number, field, begin, steps) in marches.items():
        first, step = np.concatenate([[0.0], begin]), np.array([task.period / steps, 0.0])
        one = evaluation(field, [np.zeros(1), begin, np.zeros(1), np.zeros((0, 1))])
        total = least(lambda march=march, first=first, step=step: march(first, step))
        rows.append(row(f"{name}, {mode}", total, number, one))
    return rows


def row(name: str, total: float, calls: int, one: float) -> str:
    """Total, evaluations, their time, and what the integrator adds."""
    equations = min(calls * one, total)  # inside a march they are optimised together and may cost less
    return f"| {name} | {total:.2f} | {calls} | {1e3 * one:.2f} | {equations:.2f} | {total - equations:.2f} |"


def stages(mode: str) -> str:
    """One `find_orbit` by stages, each function replaced by itself with a clock."""
    problem = tasks()[0].problem
    spent = dict.fromkeys(STAGES, 0.0)
    kept = [(module, name, getattr(module, name)) for module, name in STAGES.values()]
    parts = []
    with compiling(mode):
        of.find_orbit(problem)
        try:
            for stage, (module, name, plain) in zip(STAGES, kept, strict=True):
                setattr(module, name, clocked(spent, stage, plain))
            for _ in range(7):
                spent.update(dict.fromkeys(STAGES, 0.0))
                began = time.process_time()
                of.find_orbit(problem)
                parts.append([*spent.values(), 1e3 * (time.process_time() - began)])
        finally:
            for module, name, plain in kept:
                setattr(module, name, plain)
    *cells, total = np.min(parts, axis=0)
    numbers = [*cells, max(0.0, total - sum(cells)), total]
    return f"| {mode} | " + " | ".join(f"{one:.0f}" for one in numbers) + " |"


def clocked(spent: dict[str, float], name: str, action: Callable) -> Callable:
    """The same function, its processor time added to `spent[name]` in ms."""

    def call(*arguments: object, **named: object) -> object:
        began = time.process_time()
        result = action(*arguments, **named)
        spent[name] += 1e3 * (time.process_time() - began)
        return result

    return call


def refinement(mode: str) -> str:
    """One warm refinement by parts."""
    task = tasks()[0]
    with compiling(mode):
        refiner = of.Refiner(task.problem)
    refiner.refine()
    spent = dict.fromkeys(("derivatives", "states", "closing", "algebra"), 0.0)

    plain = newton.eliminated

    def elimination(system: object) -> Callable:
        return clocked(spent, "algebra", clocked(spent, "algebra", plain)(system))

    total = least(refiner.refine)
    march = refiner.equations.march
    march.varied = clocked(spent, "derivatives", march.varied)  # type: ignore[method-assign]
    march.ends = clocked(spent, "states", march.ends)  # type: ignore[method-assign]
    rows = Loop.rows
    Loop.rows = clocked(spent, "closing", rows)  # type: ignore[method-assign]
    newton.eliminated = elimination
    parts = []
    try:
        for _ in range(60):
            for name in spent:
                spent[name] = 0.0
            refiner.refine()
            parts.append(list(spent.values()))
    finally:
        newton.eliminated, Loop.rows = plain, rows  # type: ignore[method-assign]
    found = np.min(parts, axis=0)
    cells = " | ".join(f"{one:.2f}" for one in [*found, max(0.0, total - found.sum()), total])
    return f"| {mode} | {cells} |"


def report() -> str:
    lines = [
        "# Where the time goes", "",
        "`python benchmarks/breakdown.py`; every number on this page is written by that script.",
        f"{processor()}; {load()} at the end. {versions()}.", "",
        *(__doc__ or "").splitlines()[2:4], "",
        "## One period of the triple pendulum", "",
        "| what | ms | evaluations | us each | in the equations, ms | in the integrator, ms |", "|---" * 6 + "|",
        *integrators("off"), *integrators("on"), "",
        "## `find_orbit` from the printed digits, in ms", "",
        "| compile | " + " | ".join(STAGES) + " | rest | all |", "|---" * (len(STAGES) + 3) + "|",
        stages("off"), stages("on"), "",
        "## `Refiner.refine` from the printed digits, in ms", "",
        "| compile | march of x, Phi | marches of x | closing rows | linear algebra | rest (Python) | all |",
        "|---" * 7 + "|", refinement("off"), refinement("on"), "",
    ]  # fmt: skip
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    folder = parser.parse_args().out
    folder.mkdir(parents=True, exist_ok=True)
    text = report()
    (folder / "breakdown.md").write_text(text)
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
