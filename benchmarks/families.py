"""Cost of a family's points: orbitfinder, compiled and interpreted, against AUTO-07p on the same equations.

Protocol. From the same first orbit orbitfinder takes POINTS points with its own steps, which ends at some energy; AUTO
goes to that energy in as many points, with its own steps too (peers/auto_family.py). Time is that of the whole run
divided by its points, multipliers included, first without and then with the location of events: AUTO's program from
start to end, with one thread and with its own number of threads, whichever is faster, on the coarsest mesh that closes
as asked for; orbitfinder's `follow` without the deferred certificate. Closures of both are judged by one integration:
DOP853 at its tightest on Hamilton's equations, divided by max(1, largest multiplier).

    python benchmarks/families.py             writes results/benchmarks/families.md
    python benchmarks/families.py --quick     three families, 20 points
    python benchmarks/families.py --cpu       processor time on one thread for both, for a busy machine

Every run is taken three times while there is time: each family has its share of what is left of --limit seconds, and
once that is used its runs are taken once. All families, meshes and thread counts are measured either way.
"""

from __future__ import annotations

import argparse
import os
import platform
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca
import numpy as np
from peers.auto_family import AUTO, Clock, Run, auto_runs

from orbitfinder.families.follow import follow
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Run as FamilyRun
from orbitfinder.families.run import first_point
from orbitfinder.families.start import Start, begin
from orbitfinder.integrate.compiled import compiling
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.records.family import FamilyPoint

ROOT = Path(__file__).parents[1]
POINTS = 40
REPEATS = 3
LIMIT = 720.0
"""Seconds of repeated runs; `run.py` gives 900"""
MESHES = ((50, 4), (100, 4), (200, 4), (100, 7))
"""(NTST, NCOL) that AUTO is tried with; the cheapest one whose closures are as asked for is its time."""
CLOSURE = 1e-11
SYMMETRIC_WANTED, GENERAL_WANTED, INTERPRETED_WANTED = 1.0, 1.5, 5.0


@dataclass(frozen=True)
class Case:
    """A family: links, linear mode, amplitude of the first orbit (rad) and the formulation it is followed in."""

    links: int
    mode: int
    amplitude: float
    symmetry: str

    @property
    def name(self) -> str:
        """In words."""
        return f"{('', '', 'double', 'triple', 'quadruple')[self.links]} mode {self.mode}, {self.symmetry}"


CASES = (
    *(Case(3, mode, 0.3, "brake+reflection") for mode in (1, 2, 3)),
    *(Case(4, mode, 0.3, "brake+reflection") for mode in (1, 2, 3, 4)),
    Case(3, 2, 0.3, "brake"),
    *(Case(3, mode, 0.3, "none") for mode in (1, 2, 3)),
    *(Case(4, mode, 0.3, "none") for mode in (2, 3, 4)),
)


@dataclass
class Repeats:
    """How often a run is taken: `REPEATS` times until the share of the time is used, then once."""

    until: float
    taken: list[int] = field(default_factory=list)

    def __iter__(self) -> Iterator[int]:
        count = 0
        while count == 0 or (count < REPEATS and time.monotonic() < self.until):
            yield count
            count += 1
        self.taken.append(count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--cpu", action="store_true")
    parser.add_argument("--limit", type=float, default=LIMIT)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    chosen = parser.parse_args()
    if shutil.which("gfortran") is None or not (AUTO / "lib").is_dir():
        sys.exit(f"AUTO-07p is needed in {AUTO} (Debian: auto-07p, gfortran); set AUTO_DIR")
    cases, points = (CASES, POINTS) if not chosen.quick else ((CASES[1], CASES[4], CASES[-4]), 20)
    rows, fewest, end = [], REPEATS, time.monotonic() + chosen.limit
    for k, case in enumerate(cases):
        now = time.monotonic()
        repeats = Repeats(now + (end - now) / (len(cases) - k))
        rows.append(measured(case, points, Clock(chosen.cpu), repeats))
        fewest = min(fewest, *repeats.taken)
        print(line(*rows[-1]), flush=True)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "families.md").write_text(page(rows, chosen.cpu, fewest), encoding="utf-8")


def measured(case: Case, points: int, clock: Clock, repeats: Repeats) -> tuple[Case, dict[str, Run]]:
    """Every method on one family."""
    model = chain(case.links)
    found: dict[str, Run] = {}
    with compiling("off"):
        start = begin(mode_problem(model, case.mode, case.amplitude), symmetry=case.symmetry)
        found["interpreted"] = ours(start, points, clock, repeats, events=False)
    with compiling("on"):
        start = begin(mode_problem(model, case.mode, case.amplitude), symmetry=case.symmetry)
        found["compiled"] = ours(start, points, clock, repeats, events=False, judge=True)
        found["events"] = ours(start, points, clock, repeats, events=True)
    reach = found["compiled"].points, found["compiled"].energies[1]
    with tempfile.TemporaryDirectory() as name:
        found |= auto_runs(Path(name), start, reach, MESHES, CLOSURE, repeats, clock)
    return case, found


def ours(start: Start, points: int, clock: Clock, repeats: Iterable[int], events: bool, judge: bool = False) -> Run:
    """orbitfinder without the independent check, which is made after the clock has stopped."""
    settings = FamilySettings(events=events, certify=False, points=points)
    origin = first_point(start, settings, None)
    run = FamilyRun(start.curve, settings, 1, origin)
    next(iter(follow(run)))  # functions of the first mesh are built here
    taken = []
    for _ in repeats:
        began = clock()
        found = [point for batch in follow(run) for point in batch.points]
        taken.append(clock() - began)
    seconds = min(taken)
    closure = judged(start.curve.equations.model, found) if judge else float("nan")
    return Run(seconds / len(found), len(found), closure, (found[0].energy, max(point.energy for point in found)))


def judged(model: Model, points: Iterable[FamilyPoint]) -> float:
    """Worst closure over max(1, largest multiplier)."""
    check, turns = ClosureCheck(model), np.zeros(model.degrees_of_freedom)
    return max(check(point.state, point.period, turns, 1e-15) / point.scale for point in points)


# ---- the page --------------------------------------------------------------------------------------


def line(case: Case, found: dict[str, Run]) -> str:
    """One row of the table."""
    compiled, other = found["compiled"], found["auto"]
    wanted = GENERAL_WANTED if case.symmetry == "none" else SYMMETRIC_WANTED
    met = "yes" if compiled.seconds <= wanted * other.seconds and compiled.closure <= CLOSURE else "no"
    timed = ("interpreted", "compiled", "auto", "coarse", "events", "auto events")
    numbers = [f"{1e3 * found[key].seconds:.1f}" for key in timed]
    ratios = [f"{compiled.seconds / other.seconds:.2f}", f"{found['interpreted'].seconds / compiled.seconds:.1f}"]
    closures = [f"{found[key].closure:.0e}" for key in ("compiled", "auto", "coarse")]
    spans = [f"{run.energies[0]:.1f} to {run.energies[1]:.1f}" for run in (compiled, other)]
    counts = f"{compiled.points} / {other.points}"
    return "| " + " | ".join([case.name, *numbers, *ratios, *closures, counts, *spans, other.detail, met]) + " |"


HEADER = (
    "family", "interpreted", "compiled", "AUTO", "AUTO coarse", "with events", "AUTO with events", "compiled / AUTO",
    "interpreted / compiled", "closure", "AUTO's", "AUTO's coarse", "points / AUTO's", "energies (J)",
    "AUTO's energies (J)", "AUTO's mesh", "met",
)  # fmt: skip


def page(rows: list[tuple[Case, dict[str, Run]]], cpu: bool, fewest: int) -> str:
    """The report of a run."""
    worst = max(found["interpreted"].seconds / found["compiled"].seconds for _, found in rows)
    runs = f"{REPEATS} runs" if fewest == REPEATS else f"{fewest} to {REPEATS} runs"
    meshes = ", ".join(f"{intervals} x {order}" for intervals, order in MESHES)
    return f"""# Cost of a point on a family

Written by `python benchmarks/families.py{" --cpu" if cpu else ""}`; {"processor" if cpu else "wall"} times in ms a
point, the least of {runs}, multipliers included. Both go from the same first orbit over the same energies in
about the same number of points, with their own steps. Closures are the worst of all points, divided by max(1, largest
multiplier). Wanted: compiled at most {SYMMETRIC_WANTED} times AUTO where a symmetry is used, at most {GENERAL_WANTED}
times in the general formulation, interpreted at most {INTERPRETED_WANTED:g} times compiled (worst measured
{worst:.1f}), closures at most {CLOSURE:g}.

| {" | ".join(HEADER)} |
{"|---" * len(HEADER)}|
{chr(10).join(line(*row) for row in rows)}

AUTO with NTST x NCOL of {meshes}: the first that closes as asked, or else the last; "coarse" is the first of them.
ISP = 1 and ILP = 0, with events ISP = 2 and ILP = 1; EPSL = EPSU = 1e-12;
{"one thread" if cpu else "one thread or its own number of them, whichever is faster"}.
{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, CasADi {ca.__version__}.
"""


if __name__ == "__main__":
    main()
