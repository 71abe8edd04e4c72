"""Nonlinear normal modes of long chains: time and memory against the number of links.

The first mode of n uniform links, the lowest let go at 1 rad, found, measured and certified as
`orbitfinder run problems/chains/chain-N.toml` does, each size in a process of its own. Every stage is
timed in processor seconds, which other work on the machine changes little, beside the wall clock of the
whole; memory is the process's peak after the stage. The chain's own C is compiled. The command itself is timed as
well, figures included, with whatever threads the machine gives by default. Beside it the ordinary search
(multiple shooting by IPOPT over the same quarter period, without a certificate) from the linear mode.

    python benchmarks/long_chains.py        writes results/benchmarks/long_chains.md, .csv and .png
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import platform
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.show.style import dress, new_figure, save_png
from orbitfinder.show.svg import COLOURS

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "results" / "benchmarks"
SIZES = (12, 20, 50, 100)
ORDINARY = ((5, 0.5), (10, 0.5), (20, 0.5), (10, 1.0))
"""links and amplitude (rad) that the ordinary search is given"""
PATIENCE = 300.0
"""s of wall clock after which the ordinary search is stopped"""
STAGES = ("derive", "balance", "shoot", "multipliers", "certify")
LIMITS = {20: 20.0, 100: 600.0}
"""s allowed by the issue"""


def peak() -> float:
    """Peak memory of this process so far in MB (Linux counts it in kB)."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def spent() -> float:
    """Processor seconds of this process and of the compilers that it ran."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def one_size(links: int, amplitude: float) -> dict[str, Any]:
    """Find, measure and certify one chain; seconds and MB of each stage, and the orbit's numbers."""
    import orbitfinder as of
    from orbitfinder.integrate.evaluate import one_thread
    from orbitfinder.mechanisms import long_chain
    from orbitfinder.orbits.guesses.balance import FEWEST
    from orbitfinder.orbits.guesses.modes import normal_mode

    row: dict[str, Any] = {"links": links, "start_mb": peak()}
    wall, clock = time.perf_counter(), [spent()]

    def stage(name: str, work: Callable[[], Any]) -> Any:
        with one_thread():  # as find_orbit does
            found = work()
        row[f"{name}_s"], row[f"{name}_mb"] = spent() - clock[0], peak()
        clock[0] = spent()
        return found

    def derive() -> Any:
        model = of.chain(links)
        guess = normal_mode(model, 1, amplitude)
        pins = of.pin(**{f"theta{links}": amplitude})
        problem = of.Problem(model, guess, pins, symmetry="brake+reflection", tolerance=1e-11)
        chain = long_chain.build_chain(problem)
        chain.closed.linearised(np.zeros(links), np.zeros(links))
        return chain

    def nothing(*_: Any) -> None:
        pass

    chain = stage("derive", derive)
    series = stage("balance", lambda: long_chain.balanced(chain, nothing))
    start, period = stage("shoot", lambda: long_chain.shot(chain, series.start, series.period, nothing))
    orbit = stage("multipliers", lambda: long_chain.measured(chain, start, period))
    certificate = stage("certify", lambda: of.certify(orbit, chain.problem.model))
    values = {check.name: check.value for check in certificate.checks}
    sizes = np.abs(orbit.floquet_multipliers)
    return row | {
        "total_s": sum(row[f"{name}_s"] for name in STAGES), "wall_s": time.perf_counter() - wall,
        "harmonics": max(FEWEST, len(series.coefficients)), "period": float(period), "passed": certificate.passed,
        "closure": values.get("closure"), "multipliers": sizes.size, "stability": orbit.stability,
        "largest": float(sizes.max()), "pair_defect": orbit.pair_defect,
        "difference": values.get("floquet_multipliers"),
    }  # fmt: skip


def ordinary(links: int, amplitude: float) -> dict[str, Any]:
    """The same problem by multiple shooting, started from the linear mode, without a certificate."""
    import orbitfinder as of
    from orbitfinder.errors import OrbitfinderError
    from orbitfinder.loops.ipopt import SolveSettings
    from orbitfinder.orbits.guesses.modes import normal_mode
    from orbitfinder.orbits.method import METHODS, method_of

    method_of(of.Problem(of.chain(1), of.Guess([0.1, 0.0], 2.0)))  # fills the table
    METHODS.pop("long chain")
    began = time.process_time()
    model = of.chain(links)
    pins = of.pin(**{f"theta{links}": amplitude})
    problem = of.Problem(model, normal_mode(model, 1, amplitude), pins, symmetry="brake+reflection")
    try:
        orbit = of.find_orbit(problem, SolveSettings(with_certificate=False))
        outcome = f"period {orbit.period:.10f} s"
    except OrbitfinderError as error:
        outcome = str(error).split(":")[0]
    return {"links": links, "amplitude": amplitude, "seconds": time.process_time() - began, "memory": peak(),
            "outcome": outcome}  # fmt: skip


def child(arguments: list[str], patience: float | None = None) -> dict[str, Any] | None:
    """The JSON that this script prints in a process of its own, None when it took too long."""
    environment = {**os.environ, "ORBITFINDER_COMPILE": "off" if "--ordinary" in arguments else "auto"}
    try:
        done = subprocess.run(
            [sys.executable, __file__, *arguments], env=environment, stdout=subprocess.PIPE, check=True,
            timeout=patience,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return None
    return dict(json.loads(done.stdout))


def command(links: int) -> dict[str, Any]:
    """`orbitfinder run` on the problem file of so many links, nothing about threads in its environment."""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    began, file = time.perf_counter(), ROOT / "problems" / "chains" / f"chain-{links}.toml"
    with tempfile.TemporaryDirectory() as folder:
        done = subprocess.run(
            [sys.executable, "-m", "orbitfinder", "run", str(file), "--json", "--out", folder],
            env={**environment, "ORBITFINDER_CACHE": folder}, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
            cwd=ROOT, check=False,
        )  # fmt: skip
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "links": links, "wall": time.perf_counter() - began, "passed": done.returncode == 0,
        "processor": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
    }  # fmt: skip


def slope(rows: list[dict[str, Any]], value: Callable[[dict[str, Any]], float]) -> float:
    """Exponent k of value ~ n^k from 20 links on."""
    large = [row for row in rows if row["links"] >= 20]
    return float(np.polyfit(np.log([row["links"] for row in large]), np.log([value(row) for row in large]), 1)[0])


def table(rows: list[dict[str, Any]]) -> list[str]:
    head = "| links | derive | harmonic balance | shooting | multipliers | certificate | all | wall | memory, MB |"
    lines = [head, "|---|---|---|---|---|---|---|---|---|"]
    for row in rows:
        stages = " | ".join(f"{row[f'{name}_s']:.2f}" for name in STAGES)
        memory = row["certify_mb"]
        lines.append(f"| {row['links']} | {stages} | {row['total_s']:.1f} | {row['wall_s']:.1f} | {memory:.0f} |")
    return lines


def orbits(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "| links | period, s | harmonics | certified | closure | multipliers | largest | pair defect | "
        "certificate's multipliers differ by | stability |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        lines.append(
            f"| {row['links']} | {row['period']:.10f} | {row['harmonics']} | {'yes' if row['passed'] else 'NO'} | "
            f"{row['closure']:.1e} | {row['multipliers']} | {row['largest']:.9f} | {row['pair_defect']:.1e} | "
            f"{row['difference']:.1e} | {row['stability']} |"
        )
    return lines


def commands(runs: list[dict[str, Any]]) -> list[str]:
    lines = ["| problem file | certified | wall, s | processor, s | allowed, s |", "|---|---|---|---|---|"]
    for row in runs:
        allowed = f"{LIMITS[row['links']]:.0f}" if row["links"] in LIMITS else ""
        lines.append(
            f"| chain-{row['links']}.toml | {'yes' if row['passed'] else 'NO'} | {row['wall']:.1f} | "
            f"{row['processor']:.1f} | {allowed} |"
        )
    return lines


def report(rows: list[dict[str, Any]], runs: list[dict[str, Any]], others: list[dict[str, Any]]) -> str:
    import casadi as ca
    import scipy

    own = slope(rows, lambda row: row["certify_mb"] - row["start_mb"])
    compared = [
        f"| {row['links']} | {row['amplitude']} | {row['seconds']:.1f} | {row['memory']:.0f} | {row['outcome']} |"
        for row in others
    ]
    return "\n".join([
        "# Nonlinear normal modes of long chains", "",
        "`python benchmarks/long_chains.py`; every number on this page is written by that script.",
        f"Python {platform.python_version()}, casadi {ca.__version__}, numpy {np.__version__}, "
        f"scipy {scipy.__version__}, {platform.machine()}, {os.cpu_count()} processors.", "",
        "First mode of n uniform links of 1 m and 1 kg, the lowest let go at 1 rad. Processor seconds of each stage;",
        "`wall` is the clock on the wall, with other work on the machine. The chain's own C was compiled before;",
        "linear algebra runs on one thread.", "",
        *table(rows), "",
        f"From 20 links on: time ~ n^{slope(rows, lambda row: row['total_s']):.2f}, memory beyond the "
        f"{rows[0]['start_mb']:.0f} MB of the interpreter ~ n^{own:.2f}.", "",
        "By the command, `orbitfinder run problems/chains/chain-N.toml`, nothing set in the environment, from starting",
        "Python to the figures, compilers included:", "", *commands(runs), "",
        "![time and memory](long_chains.png)", "",
        "Multipliers are compared with those of the certificate: the same closed form of the variational equations (at",
        "five states of each orbit compared with the derivatives of the recursion), but by DOP853 instead of a few",
        "long implicit steps of Gauss' method. The closure asked for is 1e-11: the fastest linear mode of 100 links",
        "turns at 103 rad/s, so that its rate loses a hundred times what its angle does.", "",
        *orbits(rows), "",
        "Multiple shooting by IPOPT on the same quarter period, started from the linear mode, not certified:", "",
        "| links | amplitude, rad | processor s | memory, MB | outcome |", "|---|---|---|---|---|", *compared, "",
    ])  # fmt: skip


def figure(rows: list[dict[str, Any]], file: Path) -> None:
    drawn = new_figure(9.4, 4.0, "The first mode of a chain at 1 rad, certified")
    left, right = drawn.subplots(1, 2)
    links = [row["links"] for row in rows]
    labels = ("derive", "harmonic balance", "shooting", "multipliers", "certificate")
    for k, (name, label) in enumerate(zip(STAGES, labels, strict=True)):
        left.loglog(links, [row[f"{name}_s"] for row in rows], "o-", label=label, ms=3, color=COLOURS[k])
    left.loglog(links, [row["total_s"] for row in rows], "ko-", label="all", ms=4)
    right.semilogx(links, [row["certify_mb"] for row in rows], "ko-", ms=4)
    right.set_ylim(bottom=0)
    for axes, label in ((left, "processor time (s)"), (right, "peak memory (MB)")):
        dress(axes, "links", label)
        axes.set_xticks(links, [str(n) for n in links])
        axes.minorticks_off()
    left.legend(fontsize=8, frameon=False)
    save_png(drawn, file)


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--one", type=int, help="run one size in this process and print JSON")
    parser.add_argument("--ordinary", type=int, help="the same by the ordinary search")
    parser.add_argument("--amplitude", type=float, default=1.0)
    parser.add_argument("--out", type=Path, default=FOLDER)
    given = parser.parse_args()
    if given.one or given.ordinary:
        work = one_size if given.one else ordinary
        print(json.dumps(work(given.one or given.ordinary, given.amplitude)))
        return 0
    rows = [row for n in given.sizes if (row := child(["--one", str(n)]))]
    runs = [command(n) for n in given.sizes if (ROOT / "problems" / "chains" / f"chain-{n}.toml").exists()]
    others = []
    for n, amplitude in ORDINARY:
        row = child(["--ordinary", str(n), "--amplitude", str(amplitude)], PATIENCE)
        gave_up = {"links": n, "amplitude": amplitude, "seconds": np.nan, "memory": np.nan}
        others.append(row or gave_up | {"outcome": f"stopped after {PATIENCE:.0f} s of wall clock"})
    given.out.mkdir(parents=True, exist_ok=True)
    with (given.out / "long_chains.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    text = report(rows, runs, others)
    (given.out / "long_chains.md").write_text(text)
    figure(rows, given.out / "long_chains.png")
    print(text)
    quick = all(row["wall"] <= LIMITS[row["links"]] for row in runs if row["links"] in LIMITS)
    return 0 if quick and all(row["passed"] for row in [*rows, *runs]) else 1


if __name__ == "__main__":
    sys.exit(main())
