"""Deriving and evaluating the chain's equations against the number of links: time and memory.

Each size in a process of its own. Evaluation: accelerations at a random state, interpreted and compiled, the least of
300 bursts of a millisecond through CasADi's buffers. Memory: what the process grows by, resident, while chain(n) is
derived and first evaluated; and what one evaluation works in (the interpreter's work vector and its instructions).
Slopes are least-squares fits of log(quantity) against log(n) from 10 links on.

    python benchmarks/cost.py             writes results/benchmarks/cost.md and cost.png
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import casadi as ca
import numpy as np
from machine import load, processor, versions

import orbitfinder as of
from orbitfinder.integrate.compiled import compiled, compiling
from orbitfinder.show.style import dress, new_figure, save_png
from orbitfinder.show.svg import COLOURS

ROOT = Path(__file__).parents[1]
SIZES = (3, 10, 20, 50, 100, 200, 500, 1000)
FIRST, STEEPEST = 10, 1.1
INSTRUCTION = 40
"""Bytes of one instruction of CasADi's scalar interpreter: an operation and three places, padded."""
QUANTITIES = {
    "derive": "deriving, s",
    "interpreted": "evaluation, interpreted, us",
    "compiled": "evaluation, compiled, us",
    "resident": "resident memory, MB",
    "working": "working memory, MB",
}
CHECKED = ("interpreted", "compiled", "resident", "working")


def resident() -> float:
    """Resident memory of this process in MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def evaluation(function: ca.Function, state: np.ndarray, values: np.ndarray) -> float:
    """Least time of one call in us."""
    n = state.size // 2
    arguments = [np.zeros(1), state[:n].copy(), state[n:].copy(), np.asarray(values, float).copy()]
    result = np.zeros(n)
    buffer, call = function.buffer()
    for k, one in enumerate(arguments):
        buffer.set_arg(k, memoryview(one))
    buffer.set_res(0, memoryview(result))
    call()
    assert np.all(np.isfinite(result))
    began = time.perf_counter()
    call()
    count = max(1, int(0.001 / max(time.perf_counter() - began, 1e-7)))
    best = np.inf
    for _ in range(300):
        began = time.perf_counter()
        for _ in range(count):
            call()
        best = min(best, (time.perf_counter() - began) / count)
    return 1e6 * best


def measure(links: int) -> dict[str, float]:
    """Every quantity of one size."""
    of.chain(2).acceleration(0, [0, 0], [0, 0], of.chain(2).parameter_values)  # the libraries are loaded
    before, began = resident(), time.perf_counter()
    model = of.chain(links)
    seconds = time.perf_counter() - began
    random = np.random.default_rng(links)
    state = random.uniform(-1.0, 1.0, 2 * links)
    model.acceleration(0, state[:links], state[links:], model.parameter_values)
    grown = resident() - before
    function = model.acceleration
    with compiling("on"):
        fast = compiled(function)
    if fast is function:
        raise SystemExit("no C compiler")
    working = (8 * function.sz_w() + INSTRUCTION * function.n_instructions()) / 2**20
    return {
        "links": links,
        "derive": seconds,
        "interpreted": evaluation(function, state, model.parameter_values),
        "compiled": evaluation(fast, state, model.parameter_values),
        "resident": grown,
        "working": working,
    }


def slope(rows: list[dict[str, float]], name: str) -> float:
    """Exponent k of quantity ~ n^k from `FIRST` links on."""
    large = [row for row in rows if row["links"] >= FIRST]
    return float(np.polyfit(np.log([row["links"] for row in large]), np.log([row[name] for row in large]), 1)[0])


def report(rows: list[dict[str, float]]) -> str:
    lines = [
        "# Deriving and evaluating chains", "",
        "`python benchmarks/cost.py`; every number on this page is written by that script.",
        f"{processor()}; {load()} at the end. {versions()}.", "",
        *__doc__.splitlines()[2:6], "",
        "| links | " + " | ".join(QUANTITIES.values()) + " |", "|---" * (len(QUANTITIES) + 1) + "|",
        *[f"| {row['links']:g} | " + " | ".join(f"{row[name]:.3g}" for name in QUANTITIES) + " |" for row in rows],
        "| slope | " + " | ".join(f"{slope(rows, name):.3f}" for name in QUANTITIES) + " |", "",
        f"Wanted: slopes of evaluation and memory at most {STEEPEST:g}. Measured: at most "
        f"{max(slope(rows, name) for name in CHECKED):.3f}, {verdict(rows)}.", "",
        "![Cost against the number of links](cost.png)", "",
    ]  # fmt: skip
    return "\n".join(lines)


def verdict(rows: list[dict[str, float]]) -> str:
    """Met or missed."""
    return "met" if all(slope(rows, name) <= STEEPEST for name in CHECKED) else "MISSED"


def draw(rows: list[dict[str, float]], path: Path) -> None:
    links = np.array([row["links"] for row in rows])
    figure = new_figure(8.8, 3.8, "Cost of the equations of a chain")
    times, memory = figure.subplots(1, 2)
    for axes, names, label in (
        (times, ("interpreted", "compiled"), "evaluation (µs)"), (memory, ("resident", "working"), "memory (MB)")
    ):  # fmt: skip
        for k, (name, mark) in enumerate(zip(names, ("o-", "s--"), strict=True)):
            shown = {"color": COLOURS[k], "markersize": 4, "label": f"{name}, slope {slope(rows, name):.2f}"}
            axes.loglog(links, [row[name] for row in rows], mark, **shown)
        dress(axes, "links", label)
        axes.legend(frameon=False)
    save_png(figure, path)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--one", type=int, help="measure one size in this process and print JSON")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    arguments = parser.parse_args()
    if arguments.one:
        print(json.dumps(measure(arguments.one)))
        return 0
    rows = []
    for links in SIZES:
        done = subprocess.run(
            [sys.executable, __file__, "--one", str(links)], check=True, capture_output=True, text=True
        )
        rows.append(json.loads(done.stdout))
        print(f"{links} links: {rows[-1]['interpreted']:.3g} us", file=sys.stderr, flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "cost.md").write_text(report(rows))
    draw(rows, arguments.out / "cost.png")
    print(report(rows))
    return 0 if verdict(rows) == "met" else 1


if __name__ == "__main__":
    sys.exit(main())
