"""What trees of bodies cost: derivation, one evaluation and one step against the number of bodies.

Bars of 1 m in space, turning about two axes by turns, in a row and in a binary tree. Processor time, the least of
several runs. The slope is that of the logarithm of the time of an evaluation against that of the number of bodies.

    python benchmarks/mechanisms.py             prints the table, in half a minute
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

import orbitfinder as of
from orbitfinder.integrate.rk8 import march
from orbitfinder.mechanics.model import vector_field

COUNTS = (30, 60, 120, 240)
ROUNDS = 7
STEPS = 5


def tree(count: int, children: int) -> of.Model:
    """Bodies k whose parent is body (k - 1) // children."""
    bodies = {f"b{k}": {"mass": 1.0, "inertia": [0.01, 0.08, 0.09], "com": [0.5, 0.0, 0.0]} for k in range(count)}
    joints = {
        f"j{k}": {
            "kind": "revolute", "between": [f"b{(k - 1) // children}" if k else "ground", f"b{k}"],
            "at": [[1.0, 0.1 * (k % children), 0.0] if k else [0.0] * 3, [0.0] * 3], "axis": [0.0, k % 2, 1 - k % 2],
        }
        for k in range(count)
    }  # fmt: skip
    return of.mechanism(bodies, joints, dimension=3)


def least(work: Callable[[], object], rounds: int = ROUNDS) -> float:
    """Least processor time (s) of a few runs."""
    found = []
    for _ in range(rounds):
        began = time.process_time()
        work()
        found.append(time.process_time() - began)
    return min(found)


def main() -> None:
    """Print the table and the slopes."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    print("| tree | bodies | derivation (s) | evaluation (ms) | step of RK8 (ms) |\n|---|---|---|---|---|")
    for name, children in (("row", 1), ("binary", 2)):
        times = []
        for count in COUNTS:
            derived = least(lambda n=count, c=children: tree(n, c), 2)
            model = tree(count, children)
            field, state = vector_field(model), 0.1 * np.random.default_rng(0).normal(size=2 * count)
            many = np.tile(state[:count, None], (1, 100)), np.tile(state[count:, None], (1, 100))
            mapped = model.acceleration.map(100)
            one = least(lambda f=mapped, m=model, x=many: f(0.0, *x, m.parameter_values)) / 100
            step = least(lambda f=field, x=state: march(f, x, 1e-3, STEPS, np.zeros(0))) / STEPS
            times.append((one, step))
            print(f"| {name} | {count} | {derived:.2f} | {1e3 * one:.4f} | {1e3 * step:.3f} |")
        slopes = np.polyfit(np.log(COUNTS), np.log(np.array(times)), 1)[0]
        print(f"slope of the {name}: evaluation {slopes[0]:.3f}, step {slopes[1]:.3f}\n")


if __name__ == "__main__":
    main()
