"""Events of the shipped families against brute force: multipliers by another integrator at many more orbits.

Every problem of problems/families is followed again by short steps without looking for events. At each orbit the
multipliers come from DOP853 on Hamilton's equations (for orbits that are their own mirror image those of half a
period), and what changed since the orbit before is counted: real stability indices beyond +2 and -2, complex ones,
verdicts, and turns of the energy or the freed parameter. Beside it stands how often `continue` says so. An event that
comes and goes between two dense orbits is in one column only.

    python benchmarks/family_events.py [NAME ...] [--points 150] [--step 0.05]
    python benchmarks/family_events.py --switch FAMILY.json ...      every event switched, or why not
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.branches import SWITCHABLE, branches, described
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.evidence import gather
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import Family, FamilyPoint, load_family

ROOT = Path(__file__).parents[1]
REAL = 1e-6
READABLE = 1e5
"""Largest multiplier up to which the others of a product of that size are read"""


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
        from orbitfinder.mechanics.catalogue import build_model

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
    parser.add_argument("--switch", action="store_true")
    chosen = parser.parse_args()
    if chosen.switch:
        print("| family | event | branches | time |\n|---|---|---|---|")
        for name in chosen.names:
            switched(Path(name))
        return
    print("| family | dense orbits | counted / recorded | same |\n|---|---|---|---|")
    for file in sorted((ROOT / "problems" / "families").glob("*.toml")):
        if chosen.names and file.stem not in chosen.names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            print(compared(load_problem(file, False), chosen.points, chosen.step, Path(folder)), flush=True)


if __name__ == "__main__":
    main()
