"""A map of 200 x 200 orbits of a driven pendulum: seconds, by one process and by two; results/benchmarks/maps.md."""

from __future__ import annotations

import resource
import time
from pathlib import Path

import machine
import numpy as np

import orbitfinder as of

ROOT = Path(__file__).parents[1]
SIDE = 200


def measured(workers: int) -> tuple[float, float, str]:
    """Wall and processor seconds, its children's included, and what there is in the end."""
    problem = of.load_problem(ROOT / "problems" / "maps" / "driven-pendulum.toml")
    began, before = time.perf_counter(), spent()
    plane = of.map_plane(
        problem, frequency=np.linspace(3.0, 9.0, SIDE), torque=np.linspace(0.3, 1.6, SIDE), workers=workers
    )
    return time.perf_counter() - began, spent() - before, plane.counts


def spent() -> float:
    """Processor seconds of this process and of those that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def main() -> None:
    """Measure and write the page."""
    rows = {workers: measured(workers) for workers in (2, 1)}
    lines = "\n".join(
        f"| {k} | {wall:.1f} | {cpu:.1f} | {1e3 * cpu / SIDE**2:.2f} |" for k, (wall, cpu, _) in rows.items()
    )
    page = f"""# Maps of a parameter plane

Written by `python benchmarks/maps.py`: `of.map_plane` of `problems/maps/driven-pendulum.toml`, {SIDE} x {SIDE} orbits
over the forcing's frequency (3 to 9 rad/s) and torque (0.3 to 1.6), symmetric ones over half a period; 40 of them are
certified, which is included. {rows[1][2]}.

| processes | wall s | processor s | ms an orbit |
|---|---|---|---|
{lines}

{machine.processor()}; {machine.versions()}; {machine.load()}.
"""
    (ROOT / "results" / "benchmarks" / "maps.md").write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
