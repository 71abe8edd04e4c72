"""Warm refinement of the four report orbits, against what else a user could take.

Everybody gets the report's printed digits and the energy of the printed state, and may build and compile beforehand;
the clock runs while a guess is refined. Methods take turns; medians. Every result is judged by the certificate's
integration: Hamilton's equations by DOP853 at its tightest.

    python benchmarks/warm.py             writes results/benchmarks/warm.md and warm.png, in about four minutes
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from machine import load, processor, said_by, versions
from peers import octave
from peers.auto import INTERVALS, Auto
from peers.task import ROOT, Answer, Task, Unavailable, closure, tasks
from peers.taylor import Taylor
from refine import refine_by_hand

import orbitfinder as of
from orbitfinder.integrate.compiled import available, compiling
from orbitfinder.show.style import dress, new_figure, save_png
from orbitfinder.show.svg import COLOURS

REPEATS = 7
OURS, INTERPRETED = "orbitfinder", "orbitfinder, interpreted"
AUTO, AUTO_COARSE, HEYOKA, SCRIPT, OCTAVE = "AUTO-07p", "AUTO-07p, coarsest mesh", "heyoka", "scipy by hand", "Octave"
WANTED = {AUTO: 1 / 0.7, HEYOKA: 1.0, SCRIPT: 100.0}
"""How many times faster than each ours must be on every orbit, and INTERPRETED at most 5 times slower."""
SLOWER = 5.0
CLOSURE = 1e-12
COLD = """
import os, sys, time
sys.path.insert(0, sys.argv[1])
from peers.task import tasks
import orbitfinder as of
from orbitfinder.integrate.compiled import compiling, statistics
one = next(task for task in tasks() if task.name == sys.argv[2])
problem = one.problem
with compiling("on"):
    began = time.perf_counter()
    refiner = of.Refiner(problem)
    refiner.refine()
    print(time.perf_counter() - began, statistics().made, statistics().loaded)
"""


@dataclass
class Row:
    """One method on one orbit: times in s, the closure of its result, or why there is none."""

    times: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    closure: float = np.nan
    note: str = ""

    @property
    def seconds(self) -> float:
        """The median."""
        return float(np.median(self.times)) if self.times else np.nan


def ours(refiner: of.Refiner, task: Task) -> Answer:
    began, used = time.perf_counter(), time.process_time()
    found = refiner.refine(of.Guess(task.state, task.period))
    used = time.process_time() - used
    return Answer(time.perf_counter() - began, found.state, found.period, used)


def by_hand(task: Task) -> Answer:
    began = time.perf_counter()
    state, period = refine_by_hand(task.state, task.period)
    return Answer(time.perf_counter() - began, state, period)


def contestants(task: Task, built: dict[int, Taylor | str]) -> tuple[dict[str, object], dict[str, str], list[Auto]]:
    """Callables by name, what is missing by name, and what must be closed afterwards."""
    found, missing, opened = {}, {}, []
    with compiling("on"):
        compiled = of.Refiner(task.problem)
    with compiling("off"):
        plain = of.Refiner(task.problem)
    found[OURS], found[INTERPRETED] = lambda: ours(compiled, task), lambda: ours(plain, task)
    try:
        opened.append(Auto(task))
        found[AUTO] = opened[0].refine
        for intervals in INTERVALS[1:]:
            coarse = Auto(task, intervals)
            opened.append(coarse)
            if closure(task, coarse.refine()) <= CLOSURE:
                found[AUTO_COARSE] = coarse.refine
    except Unavailable as error:
        missing[AUTO] = str(error)
    if task.links not in built:
        try:
            built[task.links] = Taylor(task.links)
        except Unavailable as error:
            built[task.links] = str(error)
    taylor = built[task.links]
    if isinstance(taylor, str):
        missing[HEYOKA] = taylor
    else:
        found[HEYOKA] = lambda: taylor.refine(task)
    found[SCRIPT] = lambda: by_hand(task)
    return found, missing, opened


def compare(task: Task, built: dict[int, Taylor | str], repeats: int, with_octave: bool) -> dict[str, Row]:
    """All methods on one orbit, taking turns; the first turn is not counted, except of what takes seconds."""
    methods, missing, opened = contestants(task, built)
    rows = {name: Row() for name in methods} | {name: Row(note=note) for name, note in missing.items()}
    for turn in range(repeats + 1):
        for name, method in methods.items():
            if turn == 0 and name == SCRIPT:
                continue
            answer = method()
            if turn:
                rows[name].times.append(answer.seconds)
                rows[name].processor.append(answer.processor)
            if turn == repeats:
                rows[name].closure = closure(task, answer)
    for one in opened:
        one.close()
    if with_octave:
        rows[OCTAVE] = Row()
        try:
            answer = octave.refine(task)
            rows[OCTAVE] = Row([answer.seconds], closure=closure(task, answer))
        except Unavailable as error:
            rows[OCTAVE].note = str(error)
    said = [f"{name} {milliseconds(row.seconds) if row.times else row.note}" for name, row in rows.items()]
    print(f"{task.name}: {', '.join(said)}", file=sys.stderr, flush=True)
    return rows


def builds(task: Task) -> list[tuple[float, int, int]]:
    """(s, libraries compiled, libraries loaded) to build and refine once: in a new process with an empty cache, and
    in another one after it."""
    import os

    found = []
    with tempfile.TemporaryDirectory() as cache:
        for _ in range(2):
            done = subprocess.run(
                [sys.executable, "-c", COLD, str(Path(__file__).parent), task.name], check=True, text=True,
                capture_output=True, env={**os.environ, "ORBITFINDER_CACHE": cache},
            )  # fmt: skip
            seconds, made, loaded = done.stdout.split()
            found.append((float(seconds), int(made), int(loaded)))
    return found


def verdicts(results: dict[str, dict[str, Row]]) -> list[str]:
    """What was wanted, and whether it was met on every orbit."""
    lines = []
    for name, times in WANTED.items():
        ratios = [row[name].seconds / row[OURS].seconds for row in results.values() if row[name].times]
        if ratios:
            met = "met" if min(ratios) >= times else "MISSED"
            least = f"least {min(ratios):.3g}: {met}."
            lines.append(f"- {name}: wanted {times:.3g} times its speed on every orbit, {least}")
    slower = max(np.median(row[INTERPRETED].processor) / np.median(row[OURS].processor) for row in results.values())
    lines.append(
        f"- interpreted: wanted at most {SLOWER:g} times the compiled time, most {slower:.2f} by processor time: "
        f"{'met' if slower <= SLOWER else 'MISSED'}."
    )
    worst = max(row[OURS].closure for row in results.values())
    lines.append(f"- closure: wanted {CLOSURE:.0e}, worst {worst:.1e}: {'met' if worst <= CLOSURE else 'MISSED'}.")
    return lines


def table(results: dict[str, dict[str, Row]]) -> list[str]:
    lines = ["| orbit | method | median | fastest | slowest | runs | closure | times ours |", "|---" * 8 + "|"]
    for name, rows in results.items():
        for method, row in rows.items():
            if not row.times:
                lines.append(f"| {name} | {method} | {row.note} | | | | | |")
                continue
            shown = [row.seconds, min(row.times), max(row.times)]
            lines.append(
                f"| {name} | {method} | "
                + " | ".join(milliseconds(one) for one in shown)
                + f" | {len(row.times)} | {row.closure:.1e} | {row.seconds / rows[OURS].seconds:.3g} |"
            )
    return lines


def milliseconds(seconds: float) -> str:
    return f"{1e3 * seconds:.2f} ms" if seconds < 1 else f"{seconds:.1f} s"


def report(results: dict[str, dict[str, Row]], built: dict[int, Taylor | str], cold: dict[str, list]) -> str:
    compile_times = [
        f"{links} links {taylor.build_seconds:.1f} s" for links, taylor in built.items() if isinstance(taylor, Taylor)
    ]
    lines = [
        "# Warm refinement of the four report orbits", "",
        "`python benchmarks/warm.py`; every number on this page is written by that script.",
        f"{processor()}; {load()} at the end. {versions('heyoka')}, {said_by('octave', '--version')},",
        f"{said_by('gfortran', '--version')}.", "",
        *__doc__.splitlines()[2:5], "",
        f"- {OURS}: `of.Refiner(problem).refine(guess)`, compiled; {INTERPRETED.partition(', ')[2]}: the same without.",
        *notes(), "",
        *table(results), "",
        *verdicts(results), "",
        "![Times](warm.png)", "",
        "Building and refining once in a new process (the import not counted):", "",
        "| orbit | empty cache | libraries compiled | second run | libraries compiled | loaded |",
        "|---|---|---|---|---|---|",
        *[
            f"| {name} | {one[0][0]:.2f} s | {one[0][1]} | {one[1][0]:.2f} s | {one[1][1]} | {one[1][2]} |"
            for name, one in cold.items()
        ], "",
        f"heyoka compiles for {', '.join(compile_times)} in each process." if compile_times else "", "",
    ]  # fmt: skip
    return "\n".join(lines)


def notes() -> list[str]:
    """How each peer is set up, in a line or two."""
    return [
        f"- {AUTO}: NTST = 100, NCOL = 7, analytic derivatives, one thread, its own clock; {AUTO_COARSE}: the coarsest",
        f"  of NTST = {', '.join(map(str, INTERVALS[1:]))} that closes to {CLOSURE:.0e}, where there is one.",
        f"- {HEYOKA}: Taylor integrators with and without variational equations, compact mode, Newton single shooting.",
        f"- {SCRIPT}: `solve_ivp` (DOP853, 1e-12) in `least_squares`, NumPy equations.",
        f"- {OCTAVE}: `sqp` on single shooting, Dormand-Prince 5(4) at 1e-10, one run, ended after {octave.LIMIT:g} s.",
    ]


def draw(results: dict[str, dict[str, Row]], path: Path) -> None:
    known = {method for rows in results.values() for method, row in rows.items() if row.times}
    methods = [one for one in (OURS, INTERPRETED, HEYOKA, AUTO, SCRIPT, OCTAVE) if one in known]
    figure = new_figure(8.0, 4.2, "One refinement from the report's digits")
    axes = figure.subplots()
    width = 0.7 / len(methods)
    for k, method in enumerate(methods):
        seconds = [row[method].seconds if method in row else np.nan for row in results.values()]
        places = np.arange(len(results)) + (k - (len(methods) - 1) / 2) * width
        axes.plot(places, 1e3 * np.asarray(seconds), "osD^vP"[k], label=method, color=COLOURS[k], markersize=7)
    axes.set_yscale("log")
    dress(axes, "", "time of one refinement (ms)")
    axes.set_xticks(range(len(results)), list(results))
    figure.legend(*axes.get_legend_handles_labels(), ncols=3, fontsize=9, loc="outside lower center", frameon=False)
    save_png(figure, path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument("--without-octave", action="store_true")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    arguments = parser.parse_args()
    if not available()[0]:
        print(f"{available()[1]}; nothing to compare", file=sys.stderr)
        return 1
    built: dict[int, Taylor | str] = {}
    results = {task.name: compare(task, built, arguments.repeats, not arguments.without_octave) for task in tasks()}
    cold = {task.name: builds(task) for task in tasks()}
    arguments.out.mkdir(parents=True, exist_ok=True)
    text = report(results, built, cold)
    (arguments.out / "warm.md").write_text(text)
    draw(results, arguments.out / "warm.png")
    print(text)
    return 0 if "MISSED" not in text else 1


if __name__ == "__main__":
    sys.exit(main())
