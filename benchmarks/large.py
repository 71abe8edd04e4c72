"""Large systems by shooting: what a point of a family costs, against an earlier checkout.

First nonlinear mode of a hanging chain in its energy, brake and reflection symmetric; a row of masses between two walls
joined by springs d + 0.1 d^3, damped and driven, in the frequency (the "forced chain" of docs/how-to/structures.md). A
point's time is the difference of two whole calls of `of.follow_family`, of 3 and of 3 + POINTS points, events and the
second integrator left out, multipliers and stability read. And the command, with an empty cache, from the problem file
of 32 links to ten points with everything.

    python benchmarks/large.py                       writes results/benchmarks/large.md
    python benchmarks/large.py --before FOLDER       and measures the checkout in FOLDER beside it, as far as it goes
    python benchmarks/large.py --json --only "16 links"     prints a row
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse
from turns import arguments, conditions, followed, known, processor_time, progress, publish

import orbitfinder as of

FEW, POINTS, REPEATS, PATIENCE = 3, 8, 2, 600.0
"""Points of a short family, and how many more a long one has; turns, of which the least counts; s that an earlier
checkout has for a row"""
LINKS, MASSES = (16, 32, 64), {20: 0.148, 40: 0.075, 100: 0.03}
"""Sizes; of the masses the frequency (rad/s)"""
WANTED = {"16 links": 30.0, "32 links": 150.0, "64 links": 1000.0, "20 masses": 10.0, "40 masses": 50.0,
          "100 masses": 400.0}  # fmt: skip
"""ms a point"""
RELEASED = {"16 links": 550.0, "20 masses": 93.0, "40 masses": 610.0}
"""The same by 0.2.0, of another row of masses"""
COLD, COMMAND = 20.0, "orbitfinder continue links-32.toml --points 10 --direction forward"
FILE = """name = "links-32"
[system]
kind = "chain"
links = 32
[guess]
mode = 1
amplitude = 0.3
[find]
symmetry = "brake+reflection"
"""


def chain(links: int) -> tuple[Any, str]:
    """The mode at 0.3 rad of its tip as a problem, and the parameter of its family."""
    model = of.chain(links)
    guess = of.guesses.normal_mode(model, 1, 0.3)
    return of.Problem(model, guess, of.pin(energy=of.energy(model, guess.state)), symmetry="brake+reflection"), "energy"


def masses(count: int) -> tuple[Any, str]:
    """The driven masses as a problem that the response of the linear ones starts."""
    ones = np.ones(count)
    springs = {f"s{k}": {"kind": "cubic", "at": f"q{k + 1}", "to": f"q{k}"} for k in range(1, count)}
    springs |= {"first": {"kind": "cubic", "at": "q1"}, "last": {"kind": "cubic", "at": f"q{count}"}}
    model = of.structure(
        sparse.eye(count), 0.02 * sparse.eye(count),
        sparse.diags([-ones[1:], 2 * ones, -ones[1:]], offsets=[-1, 0, 1]),
        {name: {**spring, "stiffness": "cubic"} for name, spring in springs.items()},
        {"at": "q1", "amplitude": 0.3, "frequency": MASSES[count]}, parameters={"cubic": 0.1},
    )  # fmt: skip
    return of.Problem(model, of.guesses.linear_response(model)), "frequency"


CASES = {f"{n} links": (chain, n) for n in LINKS} | {f"{n} masses": (masses, n) for n in MASSES}


def measured(name: str, repeats: int) -> dict[str, Any]:
    """ms a point, the least of some turns, and what the last point is, for comparison."""
    make, size = CASES[name]
    origin, parameter = make(size)
    spent = dict.fromkeys((FEW, FEW + POINTS), np.inf)
    for _ in range(1 + repeats):  # the first builds
        for points in spent:
            chosen = {"events": False, "certify": False, "points": points, "directions": "forward"}
            each, family = followed(origin, parameter, **chosen)
            spent[points] = min(spent[points], each * len(family.points))
    last, least = family.points[-1], (spent[FEW + POINTS] - spent[FEW]) / POINTS
    return {"name": name, "ms": 1e3 * least, "nodes": len(last.shooting_nodes), "steps": last.mesh.size - 1,
            "period": last.period, "value": last.value}  # fmt: skip


def elsewhere(folder: Path, name: str) -> dict[str, Any]:
    """The same by the checkout in a folder."""
    command = [sys.executable, __file__, "--json", "--only", name]
    try:
        run = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(folder)}, capture_output=True, text=True,
                             timeout=PATIENCE, check=True)  # fmt: skip
    except subprocess.TimeoutExpired:
        return {"failed": f"not in {PATIENCE:.0f} s"}
    except subprocess.CalledProcessError as error:
        return {"failed": error.stderr.strip().splitlines()[-1][:80]}
    return dict(json.loads(run.stdout)["rows"][0])


def cold() -> dict[str, Any]:
    """The command with an empty cache: s by the clock and of processors, compilers included."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "links-32.toml").write_text(FILE, encoding="utf-8")
        environment = os.environ | {"ORBITFINDER_CACHE": folder, "PYTHONPATH": os.pathsep.join(sys.path)}
        began, used = time.perf_counter(), processor_time(children=True)
        run = subprocess.run([sys.executable, "-m", *COMMAND.split(), "--out", folder], cwd=folder, text=True,
                             env=environment, capture_output=True, check=False)  # fmt: skip
        wall, spent = time.perf_counter() - began, processor_time(children=True) - used
    return {"name": "command", "wall": wall, "processor": spent, "code": run.returncode}


def line(row: dict[str, Any], before: dict[str, Any] | None) -> str:
    """A row of the table."""
    name, wanted = row["name"], WANTED[row["name"]]
    earlier = "" if before is None else before.get("failed") or f"{before['ms']:.0f}"
    peer, released = (before or {}).get("ms", RELEASED.get(name, np.nan)), known(RELEASED.get(name, np.nan), ".0f")
    ratio = known(peer / row["ms"], ".1f")
    met = "yes" if row["ms"] <= wanted else "no"
    return (f"| {name} | {released} | {earlier} | {row['ms']:.1f} | {ratio} | {wanted:.0f} | {met} | {row['nodes']} | "
            f"{row['steps']} |")  # fmt: skip


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--only", nargs="+", default=list(CASES), help="names of rows, such as '16 links'")
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument("--warm", action="store_true", help="leave the command out")
    parser.add_argument("--before", type=Path, default=None, help="an earlier checkout")
    chosen = parser.parse_args()
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rows, lines = list[dict[str, Any]](), list[str]()
    for name in chosen.only:
        rows.append(measured(name, chosen.repeats))
        before = elsewhere(chosen.before, name) if chosen.before else None
        lines.append(line(rows[-1], before))
        progress(lines[-1])
    command = {} if chosen.json or chosen.warm else cold()
    publish("large", page(lines, command, chosen.repeats), rows, chosen)


def page(lines: list[str], command: dict[str, Any], repeats: int) -> str:
    """The report of a run."""
    told = "" if not command else (
        f"`{COMMAND}` with an empty cache, compiling, events and the second integrator included: "
        f"{command['wall']:.0f} s by the clock, {command['processor']:.0f} s of processors, "
        f"{'done' if command['code'] == 0 else 'FAILED'} (wanted {COLD:.0f})."
    )  # fmt: skip
    table = "\n".join(lines)
    return f"""# Large systems by shooting

Written by `python benchmarks/large.py`; ms of processor time a point of a family, one thread, compiled, the least of
{repeats} turns of {POINTS} points more; no events, no second integrator. 0.2.0's times are of another row
of masses; the ratio is to the time before, where there is such, else to 0.2.0's.

| | 0.2.0 | before | now | ratio | wanted | met | nodes | steps |
|---|---|---|---|---|---|---|---|---|
{table}

{told}

{conditions()}.
"""


if __name__ == "__main__":
    main()
