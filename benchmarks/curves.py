"""Curves of bifurcations in two parameters: orbitfinder beside AUTO-07p, and both beside numbers of 140 bits.

Doublings of two coupled pendula (AUTO's demo `pen`) from damping 0.1 to 0.5 and folds of Duffing's oscillator from a
force of 0.3 to 0.5. Each program starts from one orbit, finds the event, frees the second parameter and goes on with
its own steps. Time is that of the second run divided by its points: AUTO's from its start to its end on the coarsest
mesh that is right to TOLERANCE, with one thread; orbitfinder's `follow` after one run that compiles, first without and
then with what AUTO has not, the independent closure of every point.

    python benchmarks/curves.py           prints the table
    python benchmarks/curves.py --cpu     processor time for both, for a busy machine
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from peers.auto_curves import DUFFING, PENDULA, AutoLocus, Locus
from peers.auto_family import AUTO, Clock

import orbitfinder as of
from orbitfinder.families.branches import Branch
from orbitfinder.families.critical import Critical
from orbitfinder.families.curves import curve_start
from orbitfinder.families.follow import follow
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Run, first_point
from orbitfinder.families.start import begin, full_samples
from orbitfinder.orbits.evidence import ClosureCheck

ROOT = Path(__file__).parents[1] / "problems" / "families"
TOLERANCE = 1e-8
REPEATS = 3
MESHES = ((20, 4), (50, 4), (100, 4), (50, 7))


@dataclass(frozen=True)
class Case:
    """A curve: problem file, kind of event, parameters (first, second), ends of the second, first there, steps."""

    name: str
    file: str
    kind: str
    until: float
    parameters: tuple[str, str]
    ends: tuple[float, float]
    expected: tuple[float, float]
    equations: str
    steps: tuple[float, float]


CASES = (
    Case("doublings of two pendula", "coupled-pendula.toml", "period_doubling", 0.17, ("torque", "damping"), (0.1, 0.5),
         (0.1791637762686538, 0.7966132828830927), PENDULA, (-0.01, 0.02)),
    Case("folds of Duffing's oscillator", "duffing-resonance.toml", "fold", 2.5, ("frequency", "force"), (0.3, 0.5),
         (1.7797195242985731, 2.2119353170197306), DUFFING, (0.02, 0.02)),
)  # fmt: skip


def auto(case: Case, folder: Path, clock: Clock) -> tuple[Locus, tuple[int, int]]:
    """AUTO's curve on the coarsest mesh that is right, and that mesh."""
    problem = of.load_problem(ROOT / case.file)
    start = begin(problem, FamilySettings(parameter=case.parameters[0]))
    times, states = full_samples(start.curve, start.solution)
    if case.kind == "fold":
        drive = 2 * np.pi * times / times[-1]
        table = np.column_stack([times, states, np.cos(drive), np.sin(drive)])
    else:
        table = np.column_stack([times, _turned(states)])
    first = float(start.solution.place.free[0])
    program = AutoLocus(folder, case.equations, table, (first, case.ends[0]), clock)
    for mesh in MESHES:
        label = program.reach(case.kind, mesh, case.steps[0])
        runs = [program.follow(label, mesh, case.steps[1], case.ends[1:]) for _ in range(REPEATS)]
        found = min(runs, key=lambda one: one.seconds)
        if abs(found.at(case.ends[1]) - case.expected[1]) < TOLERANCE:
            break
    return found, mesh


def _turned(states: np.ndarray) -> np.ndarray:
    """A turn of the pendula from -pi to pi: AUTO's phase condition is the integral of u u'."""
    half = int(np.searchsorted(states[:, 0], np.pi))
    later = states[half:] - 2 * np.pi * np.array([1, 1, 0, 0])
    return np.vstack([later, states[1 : half + 1]])


def ours(case: Case, clock: Clock, checked: bool) -> Locus:
    """The same curve by orbitfinder, with or without the independent closure of every point."""
    family = of.follow_family(of.load_problem(ROOT / case.file), case.parameters[0], until=case.until)
    number = next(k for k, event in enumerate(family.events) if event.kind == case.kind)
    begun = curve_start(family, number, (case.parameters[1], case.parameters[0]))
    check = ClosureCheck(begun.start.curve.equations.model) if checked else None
    runs = [timed(begun, case.ends[1], check, clock) for _ in range(1 + REPEATS)]
    return min(runs, key=lambda one: one.seconds)


def timed(begun: Branch, last: float, check: ClosureCheck | None, clock: Clock) -> Locus:
    """The points of a curve until the first of its parameters has a value, and seconds a point."""
    test = begun.start.curve.test
    assert isinstance(test, Critical)
    settings, began = FamilySettings(parameter=test.parameters[0]), clock()
    origin = first_point(begun.start, settings, check)
    run = Run(begun.start.curve, settings, 1, origin, check, last)
    points = [origin, *(point for batch in follow(run) for point in batch.points)]
    seconds = (clock() - began) / len(points)
    return Locus(seconds, np.array([[one.free[name] for name in test.parameters[::-1]] for one in points]))


def main() -> None:
    """The table on the screen."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cpu", action="store_true", help="processor time instead of wall time")
    clock = Clock(parser.parse_args().cpu)
    if shutil.which("gfortran") is None or not (AUTO / "lib").is_dir():
        sys.exit(f"AUTO-07p is needed in {AUTO} (Debian: auto-07p, gfortran); set AUTO_DIR")
    print("| curve | ms a point | with closure | AUTO's | ours / AUTO | points | AUTO's | error | AUTO's | mesh |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for case in CASES:
        with tempfile.TemporaryDirectory() as folder:
            theirs, mesh = auto(case, Path(folder), clock)
        mine, checked = (ours(case, clock, one) for one in (False, True))
        errors = [abs(one.at(case.ends[1]) - case.expected[1]) for one in (mine, theirs)]
        print(
            f"| {case.name} | {1e3 * mine.seconds:.2f} | {1e3 * checked.seconds:.2f} | {1e3 * theirs.seconds:.2f} "
            f"| {mine.seconds / theirs.seconds:.2f} | {len(mine.points)} | {len(theirs.points)} | {errors[0]:.1e} "
            f"| {errors[1]:.1e} | {mesh[0]} x {mesh[1]} |"
        )


if __name__ == "__main__":
    main()
