"""Maps of 200 x 200 orbits and a brute-force bifurcation diagram of a driven pendulum: seconds, by one process and by
two; results/benchmarks/maps.md. Each is a part of the page: `python benchmarks/maps.py PART ...` measures some anew.
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import machine
import numpy as np

import orbitfinder as of

ROOT = Path(__file__).parents[1]
SIDE = 200
HEAD = """# Maps of a parameter plane and brute-force bifurcation diagrams

Written by `python benchmarks/maps.py`.
"""


def mapped(workers: int) -> tuple[int, str]:
    """A map: how many orbits, and what there is in the end."""
    problem = of.load_problem(ROOT / "problems" / "maps" / "driven-pendulum.toml")
    plane = of.map_plane(
        problem, frequency=np.linspace(3.0, 9.0, SIDE), torque=np.linspace(0.3, 1.6, SIDE), workers=workers
    )
    return plane.blank.size, plane.counts


def settled(workers: int) -> tuple[int, str]:
    """A bifurcation diagram: how many returns, dropped ones included, and what there is in the end."""
    problem = of.load_problem(ROOT / "problems" / "maps" / "pendulum-cascade.toml")
    made = of.bifurcation(problem, torque=np.linspace(1.03, 1.09, 960), workers=workers)
    return made.repeats.size * (made.transient + made.count), made.counts


PARTS = {
    "map": (mapped, "an orbit", f"""`of.map_plane` of `problems/maps/driven-pendulum.toml`, {SIDE} x {SIDE} orbits
over the forcing's frequency (3 to 9 rad/s) and torque (0.3 to 1.6), symmetric ones over half a period; 40 of them are
certified, which is included."""),
    "bifurcation": (settled, "a return", """`of.bifurcation` of `problems/maps/pendulum-cascade.toml`, 960 values of the
torque (1.03 to 1.09), of each 200 returns dropped and 100 kept; the processes' start is included."""),
}  # fmt: skip
"""Of each part what is measured, what of it is counted, and what the page says"""


def spent() -> float:
    """Processor seconds of this process and of those that have ended."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def part(name: str) -> str:
    """What the page says of a part, measured now."""
    work, each, words = PARTS[name]
    rows = []
    for workers in (2, 1):
        began, before = time.perf_counter(), spent()
        count, made = work(workers)
        wall, cpu = time.perf_counter() - began, spent() - before
        rows.append(f"| {workers} | {wall:.1f} | {cpu:.1f} | {1e3 * cpu / count:.3g} |")
    table = "\n".join([f"| processes | wall s | processor s | ms {each} |", "|---|---|---|---|", *rows])
    return (
        f"## {name}\n\n{words} {made}.\n\n{table}\n\n{machine.processor()}; {machine.versions()}; {machine.load()}.\n"
    )


def main() -> None:
    """Measure and write the page, or the parts of it that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", metavar="PART", help="; ".join(PARTS))
    page, chosen = ROOT / "results" / "benchmarks" / "maps.md", parser.parse_args().parts
    kept = {text.split("\n")[0]: f"## {text}" for text in page.read_text(encoding="utf-8").split("\n## ")[1:]}
    fresh = {name: part(name) for name in chosen or PARTS}
    parts = [text.strip() + "\n" for name in PARTS if (text := (kept | fresh).get(name))]
    page.write_text("\n".join([HEAD, *parts]), encoding="utf-8")
    print(page.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
