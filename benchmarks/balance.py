"""Harmonic balance of large driven systems: what a point with its verdict costs, and a beam's curve, beside pyHarm.

The driven masses of `large.py` in the frequency, events and the second integrator left out, a point's time as there;
first harmonics against two programs' (`tests/data/road.json`). And the finite-element beam of
problems/structures/beam.toml through both folds with everything, as the problem file asks for it.

    python benchmarks/balance.py                       writes results/benchmarks/balance.md
    python benchmarks/balance.py --pyharm PYTHON       beside pyHarm, by a Python that has `pyharm-os`
"""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from large import FEW, MASSES, POINTS, masses
from turns import arguments, conditions, followed, publish

import orbitfinder as of

ROOT = Path(__file__).parents[1]
WANTED, CURVE, LAST = {100: 40.0, 1000: 500.0}, 30.0, 300.0
"""ms a point by the number of masses, s for the beam's curve, the frequency (rad/s) where it ends"""
TURNING = 1e-6
"""The verdict changes as near to where the curve turns, relative to the frequency"""
PEER = ((3, 5), (7, 2))
"""Highest harmonics and steps of pyHarm's"""


def first_harmonic(point: Any, coordinate: int) -> float:
    """Its size, of a coordinate from 1, by states at equal times."""
    nodes = point.shooting_nodes[:, coordinate - 1]
    return float(2 * np.abs(np.fft.rfft(nodes))[1] / len(nodes))


def point_of(count: int, repeats: int) -> dict[str, Any]:
    """ms a point of masses, its verdict, and how far its first harmonic is off the reference's, relative."""
    problem, parameter = masses(count)
    spent = dict.fromkeys((FEW, FEW + POINTS), np.inf)
    for _ in range(1 + repeats):  # the first builds
        for points in spent:
            chosen = {"method": "balance", "events": False, "certify": False, "points": points, "directions": "forward"}
            each, family = followed(problem, parameter, **chosen)
            spent[points] = min(spent[points], each * len(family.points))
    entries = json.loads((ROOT / "tests" / "data" / "road.json").read_text(encoding="utf-8"))
    known = {entry["id"]: entry["values"] for entry in entries}.get(f"chain-{count}", [])
    off = [abs(first_harmonic(family.points[0], 1) / float(value["first_harmonic_x1_H15"]) - 1.0)
           for value in known if value["w"] == MASSES[count]]  # fmt: skip
    least = 1e3 * (spent[FEW + POINTS] - spent[FEW]) / POINTS
    said = sorted({point.stability for point in family.points})
    return {"name": f"{count} masses", "ms": least, "wanted": WANTED[count], "verdict": ", ".join(said),
            "off": off[0] if off else None}  # fmt: skip


def beam() -> dict[str, Any]:
    """The beam's curve as the command follows it: s of the processor, the folds and how near the verdict changes."""
    problem = of.load_problem(ROOT / "problems" / "structures" / "beam.toml")
    spent, family = followed(problem, "frequency", until=LAST, method="balance")
    folds, changes = ([event for event in family.events if event.kind == kind] for kind in ("fold", "stability_change"))
    apart = [min(abs(fold.parameter / change.parameter - 1.0) for change in changes) for fold in folds]
    return {"name": "beam", "seconds": spent * len(family.points), "points": len(family.points),
            "folds": [(fold.parameter, fold.error) for fold in folds], "apart": max(apart, default=np.nan),
            "certified": all(event.certified for event in family.events)}  # fmt: skip


def beside(python: str, highest: int, steps: int) -> dict[str, Any]:
    """pyHarm's steps from the problem file's frequency, and ours at its frequencies."""
    path = ROOT / "problems" / "structures" / "beam.toml"
    problem = of.load_problem(path)
    first = problem.model.parameter_values[problem.model.parameter_index("frequency")]
    command = [python, str(Path(__file__).parent / "peers" / "pyharm_beam.py"), str(first), str(highest), str(steps)]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as folder:  # it leaves a file where it runs
        run = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, cwd=folder)
    peer = json.loads(run.stdout.splitlines()[-1])
    frequencies = [point["frequency"] for point in peer["points"]][1:]
    settings = of.FamilySettings(method="balance", events=False, certify=False)
    began = time.process_time()
    family = of.follow_family(problem, "frequency", until=frequencies[-1], at=frequencies[:-1], settings=settings)
    ours = (time.process_time() - began) / len(family.points)
    tips = {point.value: first_harmonic(point, 199) for point in family.points}
    off = max(abs(tips[point["frequency"]] / point["tip"] - 1.0) for point in peer["points"])
    return {"name": f"pyHarm, harmonics to {highest}", "seconds": peer["seconds"], "accepted": len(frequencies),
            "steps": steps, "ours": ours, "off": off}  # fmt: skip


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--pyharm", default="", help="a Python that has pyharm-os")
    parser.add_argument("--repeats", type=int, default=1)
    chosen = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    MASSES[1000] = 0.03
    rows = [point_of(count, chosen.repeats) for count in WANTED]
    curve = beam()
    peers = [beside(chosen.pyharm, *each) for each in PEER] if chosen.pyharm else []
    publish("balance", page(rows, curve, peers), [*rows, curve, *peers], chosen)


def page(rows: list[dict[str, Any]], curve: dict[str, Any], peers: list[dict[str, Any]]) -> str:
    """The report of a run."""
    masses_ = "\n".join(
        f"| {row['name']} | {row['ms']:.0f} | {row['wanted']:.0f} | {'yes' if row['ms'] <= row['wanted'] else 'no'} | "
        f"{row['verdict']} | {'' if row['off'] is None else format(row['off'], '.0e')} |"
        for row in rows
    )
    folds = " and ".join(f"{value:.9g} +- {error:.1g}" for value, error in curve["folds"])
    sound = "certified" if curve["certified"] else "NOT certified"
    met = "met" if curve["seconds"] <= CURVE else "not met"
    turning = "met" if curve["apart"] <= TURNING else "not met"
    other = "\n".join(
        f"| {row['name']} | {row['seconds']:.2f} | {row['accepted']} of {row['steps']} | {row['ours']:.3f} | "
        f"{row['seconds'] / row['ours']:.0f} | {row['off']:.0e} |"
        for row in peers
    )
    table = (
        ""
        if not peers
        else f"""
## Beside pyHarm

s of processor time a point from 120 rad/s on, one thread; pyHarm follows harmonics with dense matrices and tells no
stability; ours with Hill's verdict. Steps that pyHarm did not accept count with those that it did.

| | s a point | accepted | ours | ratio | tips apart, relative |
|---|---|---|---|---|---|
{other}
"""
    )
    return f"""# Large driven systems by harmonic balance

Written by `python benchmarks/balance.py`; ms of processor time a point of a family, verdict included, one thread.

| | now | wanted | met | verdict | first harmonic off the reference's |
|---|---|---|---|---|---|
{masses_}

The beam of problems/structures/beam.toml, 200 coordinates, to {LAST:.0f} rad/s through both folds, events, closures and
certificates of both ends included: {curve["points"]} points in {curve["seconds"]:.0f} s of processor time (wanted
{CURVE:.0f}: {met}). Folds at {folds} rad/s, {sound}; the verdict changes
within {curve["apart"]:.0e} of them (wanted {TURNING:.0e}: {turning}).
{table}
{conditions()}.
"""


if __name__ == "__main__":
    main()
