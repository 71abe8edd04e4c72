"""Tori of the double pendulum's fast mode at a noble rotation number, followed in the energy until they break down.

    python benchmarks/tori.py

Prints what docs/how-to/tori.md tells: energy, states of the curve, width of the strip in which its series converges.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import orbitfinder as of

GOLDEN = (1 + 5**0.5) / 2
NOBLE = 1 / (2 + 1 / (6 + 1 / GOLDEN))
PROBLEM = Path(__file__).parents[1] / "problems" / "gallery" / "double-pendulum-fast-mode.toml"


def main() -> None:
    """The table, a line for each torus as it is found."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    problem = of.load_problem(PROBLEM)
    orbit = of.find_orbit(replace(problem, pin=of.pin(energy=-17.0)))
    began = time.perf_counter()
    print("| energy (J) | states of the curve | half-width of the strip | s |\n|---|---|---|---|")

    def row(one: of.Torus) -> None:
        spent = time.perf_counter() - began
        print(f"| {one.energy:.3f} | {len(one.curve)} | {one.strip:.3f} | {spent:.1f} |", flush=True)

    first = of.torus(orbit, NOBLE)
    settings = of.TorusSettings(points=60, most_states=501)
    found = of.follow_tori(
        first, hold="rotation", model=problem.model, settings=settings, progress=row, name="fast-mode-noble"
    )
    certified = sum(one.certificate is not None and one.certificate.passed for one in found.tori)
    print(f"{certified} of {len(found.tori)} certified; {found.end}")


if __name__ == "__main__":
    main()
