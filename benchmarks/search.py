"""Search for periodic orbits for a minute, with orbitfinder and with the loop a user would write by hand.

Both take the same starts (seed 0, in order) of the triple pendulum at -30 J with periods from 0.5 to 6 s, and two
processes on two processors. By hand: Lagrange's equations with NumPy, `solve_ivp` (DOP853, 1e-10) inside
`least_squares` on single shooting for the state and the period with the energy as a further row, at most
`MOST_EVALUATIONS` evaluations a start; an orbit counts when it closes to 1e-7 in the range of periods and its
period and action are new. Nothing checks that it is covered once; orbitfinder's orbits are minimal and certified.

On a machine with other work, `--processor-time` gives each process the budget of processor time instead of a wall
time.

A second target is wider: periods to 10 s, of which nobody knows all; there the measure is an earlier checkout's search,
`--against CHECKOUT|COMMIT`, for the same budget in the same run, the two in turns.

    python benchmarks/search.py             writes results/benchmarks/search.md
    python benchmarks/search.py --against 4a7c61c7 --processor-time     writes results/benchmarks/search_wide.md
    python benchmarks/search.py --memory 100000                         writes results/benchmarks/search_memory.md
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import scipy
from earlier import checkout_of
from refine import make_energy, make_field
from scipy.integrate import solve_ivp, trapezoid
from scipy.optimize import least_squares
from sweep import resident

import orbitfinder as of
from orbitfinder._runtime.processes import NAMES, children_see
from orbitfinder.atlas.report import discovery
from orbitfinder.atlas.starts import Target, context_of, make_start
from orbitfinder.errors import ConvergenceError, IntegrationError

ROOT = Path(__file__).parents[1]
LINKS, ENERGY, PERIODS, SEED, PROCESSES = 3, -30.0, (0.5, 6.0), 0, 2
MOST_EVALUATIONS = 40
CLOSED, SAME, MOVING = 1e-7, 1e-5, 1e-3
WANTED, RATIO_WANTED, WIDE, WIDE_WANTED = 60, 20.0, 10.0, 3.0
FEW, MOST_TIMES = 200, 10.0
"""Starts of the first call, and times that starts that the next asks for"""


@dataclass(frozen=True)
class Result:
    """One method: distinct orbits, hits, starts, wall time in s."""

    distinct: int
    hits: int
    starts: int
    seconds: float


def solved_by_hand(state: np.ndarray, period: float) -> tuple[float, float] | None:
    """Period and action of the orbit that a start leads to, None when it leads nowhere."""
    n = state.size // 2
    field, energy = make_field(n), make_energy(n)

    def path(x, duration, times=None):
        return solve_ivp(field, (0.0, duration), x, method="DOP853", rtol=1e-10, atol=1e-10, t_eval=times).y

    turns = np.append(np.round((path(state, period)[:, -1] - state)[:n] / (2 * np.pi)), np.zeros(n)) * 2 * np.pi

    def residual(unknowns):
        x, duration = unknowns[:-1], unknowns[-1]
        if not 0.1 < duration < 2 * PERIODS[1] or np.abs(x).max() > 1e3:
            return np.full(2 * n + 1, 1e3)
        return np.append(path(x, duration)[:, -1] - x - turns, energy(x) - ENERGY)

    found = least_squares(residual, np.append(state, period), max_nfev=MOST_EVALUATIONS, xtol=1e-13, ftol=1e-13)
    x, duration = found.x[:-1], float(found.x[-1])
    if np.abs(found.fun).max() > CLOSED or not PERIODS[0] <= duration <= PERIODS[1]:
        return None
    times = np.linspace(0.0, duration, 400)
    states = path(x, duration, times)
    if np.ptp(states, axis=1).max() < MOVING:
        return None
    rest = np.zeros(n)
    kinetic = [energy(column) - energy(np.append(column[:n], rest)) for column in states.T]
    return duration, float(trapezoid(2 * np.asarray(kinetic), times))


def by_hand(which: int, budget: float, processor: bool, found: multiprocessing.Queue) -> None:
    """Every `PROCESSES`-th start until the budget is spent; one that ends later does not count."""
    clock = time.process_time if processor else time.time
    one = context_of(of.chain(LINKS), Target(ENERGY, PERIODS))
    number, deadline = which, clock() + budget
    while clock() < deadline:
        try:
            start = make_start(one, SEED, number)
            orbit = solved_by_hand(start.state, start.period)
        except (ConvergenceError, IntegrationError, ValueError, np.linalg.LinAlgError):
            orbit = None
        if clock() < deadline:
            found.put((number, orbit))
        number += PROCESSES
    found.put(None)


def search_by_hand(budget: float, processor: bool) -> Result:
    context = multiprocessing.get_context("spawn")
    found = context.Queue()
    with children_see(dict.fromkeys(NAMES, "1")):
        crew = [context.Process(target=by_hand, args=(which, budget, processor, found)) for which in range(PROCESSES)]
        for process in crew:
            process.start()
    began, left, outcomes = time.time(), PROCESSES, []
    while left:
        entry = found.get()
        left -= entry is None
        outcomes += [] if entry is None else [entry]
    for process in crew:
        process.join()
    kinds: list[tuple[float, float]] = []
    hits = [orbit for _, orbit in sorted(outcomes) if orbit is not None]
    for orbit in hits:
        if not any(abs(orbit[0] - one[0]) < SAME * one[0] and abs(orbit[1] - one[1]) < SAME * one[1] for one in kinds):
            kinds.append(orbit)
    return Result(len(kinds), len(hits), len(outcomes), time.time() - began)


def search_with_orbitfinder(budget: float, processor: bool, longest: float = PERIODS[1]):
    """The same by orbitfinder; by processor time as many starts as it takes, cut where the budget is spent."""
    with tempfile.TemporaryDirectory() as folder:
        path, began = Path(folder) / "triple.sqlite", time.time()
        request = (of.chain(LINKS), ENERGY, (PERIODS[0], longest), path)
        if not processor:
            found = of.search(*request, budget=budget, seed=SEED, workers=PROCESSES)
            tally = found.tallies[0][1]
            return Result(tally.new, tally.hits, tally.done, time.time() - began), found.summary
        starts, spent = FEW, 0.0
        while spent < PROCESSES * budget:  # the same search goes on, by as many as the budget will take at this rate
            starts = int(min(1.1 * PROCESSES * budget / spent, MOST_TIMES) * starts) if spent else starts
            found = of.search(*request, starts=starts, seed=SEED, workers=PROCESSES)
            spent = found.summary.seconds
        with of.Atlas(path) as atlas:
            seconds, distinct, _ = discovery(atlas, 1)
            done = int(np.searchsorted(seconds, PROCESSES * budget))
            hits = atlas.connection.execute(
                "SELECT count(*) FROM starts WHERE orbit IS NOT NULL AND number < ?", [done]
            ).fetchone()[0]
    return Result(int(distinct[done - 1]), hits, done, time.time() - began), found.summary


def wide(against: str, budget: float, processor: bool) -> tuple[str, float]:
    """The page of the wider target, and how many times as many orbits as the earlier checkout's search meets."""
    found = dict[str, dict]()
    with checkout_of(against) as earlier:
        for name, checkout in (("earlier", earlier), ("ours", ROOT)):
            words = [sys.executable, __file__, "--alone", "--budget", f"{budget:g}", *["--processor-time"] * processor]
            surroundings = os.environ | {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1"}
            done = subprocess.run(words, env=surroundings, capture_output=True, text=True, check=True)
            found[name] = json.loads(done.stdout.splitlines()[-1])
    ratio = found["ours"]["distinct"] / max(found["earlier"]["distinct"], 1)
    rows = "\n".join(f"| {name} | {one['starts']} | {one['hits']} | {one['distinct']} | {one['least']:.0f} |"
                     for name, one in found.items())  # fmt: skip
    return (
        f"""# A wider search of {budget:g} seconds{" of processor time in each of two processes" * processor}

`python benchmarks/search.py --against {against} --budget {budget:g}{" --processor-time" * processor}`; every
number is written by that script. Triple pendulum, {ENERGY:g} J, periods {PERIODS[0]:g} to {WIDE:g} s, seed {SEED},
{PROCESSES} processes. Load of the machine at the end: {os.getloadavg()[0]:.1f}.
Python {platform.python_version()}, {platform.machine()}.

| search | starts | hits | distinct certified orbits | in all at least, by Chao |
|---|---|---|---|---|
{rows}

Ratio of distinct orbits: {ratio:.2f} (wanted: {WIDE_WANTED:g}).
""",
        ratio,
    )


def memory(starts: int) -> str:
    """The page of what memory a long search takes: that of its process after every tenth of the starts."""
    rows, began, request = [], time.time(), (of.chain(2), -8.0, (0.5, 4.0))
    with tempfile.TemporaryDirectory() as folder:
        for part in range(1, 11):
            made = starts * part // 10
            found = of.search(*request, Path(folder) / "a.sqlite", starts=made, workers=0)
            rows.append((made, found.summary.orbits, resident()))
            print(*rows[-1], file=sys.stderr, flush=True)
    lines = "\n".join(f"| {made} | {orbits} | {held:.0f} |" for made, orbits, held in rows)
    sizes = [held for *_, held in rows]
    return f"""# Memory of a search of {starts} starts

`python benchmarks/search.py --memory {starts}`: double pendulum, -8 J, periods 0.5 to 4 s, seed 0, in this process,
after every tenth of the starts. {time.time() - began:.0f} s.

From the first tenth to the last {sizes[-1] - sizes[0]:+.0f} MB; the most is {max(sizes) - min(sizes):.0f} MB above the
least (wanted: at most 50).

| starts | orbits | resident, MB |
|---|---|---|
{lines}
"""


def report(ours: Result, hand: Result, summary, budget: float, processor: bool) -> str:
    ratio = ours.distinct / max(hand.distinct, 1)
    rows = [
        f"| {name} | {one.starts} | {one.hits} | {one.distinct} | {one.seconds:.1f} |"
        for name, one in (("orbitfinder, certified", ours), ("by hand", hand))
    ]
    yields = [
        f"| {one.strategy} | {one.starts} | {one.hits} | {one.new} | {one.seconds:.1f} |" for one in summary.yields
    ]
    return "\n".join(
        [
            f"# A search of {budget:g} seconds" + " of processor time in each of two processes" * processor,
            "",
            "`python benchmarks/search.py`; every number on this page is written by that script, which says what",
            f"each method is. Triple pendulum, {ENERGY:g} J, periods {PERIODS[0]:g} to {PERIODS[1]:g} s, seed {SEED}, "
            f"{PROCESSES} processes on {os.cpu_count()} processors, one method after the other.",
            f"Made by `--budget {budget:g}{' --processor-time' * processor}`. Load of the machine at the end: "
            f"{os.getloadavg()[0]:.1f}. Python {platform.python_version()}, numpy {np.__version__}, "
            f"scipy {scipy.__version__}, {platform.machine()}.",
            "",
            "| method | starts | hits | distinct orbits | wall time, s |",
            "|---|---|---|---|---|",
            *rows,
            "",
            f"Ratio of distinct orbits: {ratio:.1f} (wanted: {RATIO_WANTED:g}); distinct certified orbits: "
            f"{ours.distinct} (wanted: at least {WANTED}). All starts of the tables below took {summary.seconds:.0f} s "
            "of processor time.",
            "",
            "| strategy | starts | hits | new | processor time, s |",
            "|---|---|---|---|---|",
            *yields,
            "",
            "; ".join(summary.remarks) + ".",
            "",
        ]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--budget", type=float, default=60.0)
    parser.add_argument("--processor-time", action="store_true", help="the budget is processor time of each process")
    parser.add_argument("--against", metavar="CHECKOUT|COMMIT", help="the wider target, beside an earlier search")
    parser.add_argument("--memory", type=int, metavar="STARTS", help="what a search of so many starts holds in memory")
    parser.add_argument("--alone", action="store_true", help="(for itself)")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    if arguments.alone:
        result, summary = search_with_orbitfinder(arguments.budget, arguments.processor_time, WIDE)
        print(json.dumps(asdict(result) | {"least": summary.estimate[0]}))
        return 0
    name = "search_memory.md" if arguments.memory else "search_wide.md" if arguments.against else "search.md"
    out = arguments.out or ROOT / "results" / "benchmarks" / name
    out.parent.mkdir(parents=True, exist_ok=True)
    if arguments.memory:
        out.write_text(memory(arguments.memory))
        return 0
    if arguments.against:
        text, ratio = wide(arguments.against, arguments.budget, arguments.processor_time)
        out.write_text(text)
        print(text)
        return 0 if ratio >= WIDE_WANTED else 1
    hand = search_by_hand(arguments.budget, arguments.processor_time)
    print(f"by hand: {hand}", file=sys.stderr, flush=True)
    ours, summary = search_with_orbitfinder(arguments.budget, arguments.processor_time)
    text = report(ours, hand, summary, arguments.budget, arguments.processor_time)
    out.write_text(text)
    print(text)
    return 0 if ours.distinct >= WANTED else 1


if __name__ == "__main__":
    sys.exit(main())
