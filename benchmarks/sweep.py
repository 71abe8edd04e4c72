"""A sweep of the swinging spring's stiffness: orbits a second on one core, and memory; results/benchmarks/sweep.md."""

from __future__ import annotations

import argparse
import gc
import time
from pathlib import Path

import machine
import numpy as np

import orbitfinder as of

ROOT = Path(__file__).parents[1]
VALUES, SWEEPS, WARM = 100, 12, 2


def resident() -> float:
    """MB that this process holds."""
    gc.collect()
    line = next(one for one in Path("/proc/self/status").read_text().splitlines() if one.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def measured() -> list[tuple[float, float, float, int]]:
    """Processor and wall seconds, MB afterwards and certified orbits of each sweep."""
    problem, found = of.load_problem(ROOT / "problems" / "gallery" / "spring-pendulum-swing.toml"), []
    for turn in range(SWEEPS):
        began, cpu = time.perf_counter(), time.process_time()
        study = of.sweep(problem, stiffness=np.linspace(26.0 + 1e-3 * turn, 34.0, VALUES))
        seconds, certified = (time.process_time() - cpu, time.perf_counter() - began), study.certified
        del study
        found.append((*seconds, resident(), certified))
    return found


def main() -> None:
    """Measure and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    rows = measured()
    best = min(cpu for cpu, *_ in rows)
    grown = rows[-1][2] - rows[WARM - 1][2]
    lines = "\n".join(f"| {k} | {cpu:.2f} | {wall:.2f} | {n} of {VALUES} | {mb:.1f} |"
                      for k, (cpu, wall, mb, n) in enumerate(rows, 1))  # fmt: skip
    page = f"""# Parameter studies

Written by `python benchmarks/sweep.py`: `of.sweep` of `problems/gallery/spring-pendulum-swing.toml` (brake orbits of
the elastic pendulum at -11 J) over {VALUES} values of the stiffness from 26 to 34 N/m, {SWEEPS} times in one process.
The search for the problem's own orbit and all certificates are included.

At best {VALUES / best:.0f} certified orbits a second of one core. {VALUES * (SWEEPS - WARM)} orbits after the first
{VALUES * WARM} add {grown:.1f} MB.

| sweep | processor s | wall s | certified | resident MB |
|---|---|---|---|---|
{lines}

{machine.processor()}; {machine.versions()}; {machine.load()}.
"""
    (ROOT / "results" / "benchmarks" / "sweep.md").write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
