"""The compliant seven-joint arm: its modes at finite amplitude, warm refinement, derivation.

python benchmarks/robots.py [MODE ...]
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

import orbitfinder as of
from orbitfinder.families.members import whole

AMPLITUDE = 0.5
REPEATS = 20


def amplitude(point, model):
    """Half the largest range of a joint (rad)."""
    return float(np.ptp(whole(point, model).samples[:, :7], axis=0).max() / 2)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("modes", type=int, nargs="*", metavar="MODE", default=range(1, 8))
    modes = parser.parse_args().modes
    began = time.process_time()
    of.robot("problems/robots/iiwa.urdf")
    print(f"derived in {time.process_time() - began:.2f} s")
    print("| mode | period (s) | points | amplitude (rad) | events | CPU s | ms a warm refinement, compiled |")
    print("|---|---|---|---|---|---|---|")
    for mode in modes:
        problem = of.load_problem(f"problems/robots/iiwa-mode-{mode}.toml")
        orbit = of.find_orbit(problem)
        energy = of.energy(problem.model, problem.guess.state * 0 + np.append(rest(problem), np.zeros(7)))
        until = energy + (orbit.energy - energy) * (1.05 * AMPLITUDE / amplitude(orbit, problem.model)) ** 2
        began = time.process_time()
        family = of.follow_family(orbit, parameter="energy", until=until, points=200)
        spent = time.process_time() - began
        reached = max(amplitude(point, problem.model) for point in (family.points[0], family.points[-1]))
        refiner = of.Refiner(replace(problem, pin=of.pin(energy=orbit.energy)))
        near = of.Guess(orbit.state * (1 + 1e-4), orbit.period)
        times = []
        for _ in range(REPEATS):
            began = time.perf_counter()
            refiner.refine(near)
            times.append(time.perf_counter() - began)
        kinds = ", ".join(event.kind for event in family.events) or "none"
        print(f"| {mode} | {orbit.period:.9f} | {len(family.points)} | {reached:.3f} | {kinds} | {spent:.1f} | "
              f"{1e3 * min(times):.1f} |", flush=True)  # fmt: skip


def rest(problem):
    """The equilibrium that the mode is of."""
    from orbitfinder.orbits.guesses.modes import equilibrium

    return equilibrium(problem.model)


if __name__ == "__main__":
    main()
