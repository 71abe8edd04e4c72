"""Deriving the chain's equations in O(n): time and operations against the number of links.

For each n the recursive formulation is derived from fresh symbols and made into a CasADi function;
the slopes are least-squares fits of log(time) and log(operations) against log(n). Accelerations at
a random state are compared with an independent dense evaluation in NumPy that shares no code with
the package: M(q) and h(q, v) of the chain in closed form and `np.linalg.solve`. The dense Lagrange
formulation of the package is shown beside it as far as it is reasonable.

    python benchmarks/derivation.py         writes results/benchmarks/derivation.md
"""

from __future__ import annotations

import argparse
import platform
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np

import orbitfinder as of

ROOT = Path(__file__).parents[1]
SIZES = (3, 10, 30, 100, 300, 1000)
LAGRANGE_UP_TO = 30
LIMITS = {100: 1.0, 1000: 5.0}
"""s allowed for deriving and compiling that many links"""
AGREEMENT = 1e-10
GRAVITY = 9.8


@dataclass(frozen=True)
class Row:
    """One size: seconds and operations by both formulations, largest relative difference from NumPy."""

    links: int
    seconds: float
    operations: int
    difference: float
    lagrange_seconds: float | None
    lagrange_operations: int | None
    lagrange_difference: float | None


def dense_accelerations(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Uniform rods (l = 1 m, m = 1 kg, I = 1/12 kg m^2): M a = -h, all in closed form.

    M_ij = A_ij cos(q_i - q_j), h_i = sum_j A_ij sin(q_i - q_j) v_j^2 + b_i sin q_i, with
    A_ij = sum_k m c_ki c_kj + I delta_ij, b_i = sum_k m g c_ki, and c_ki = 1, 1/2, 0 for link i
    above, at or below k: how far the centre of link k moves with angle i.
    """
    n = q.size
    arms = np.tril(np.ones((n, n)), -1) + 0.5 * np.eye(n)
    coupling = arms.T @ arms + np.eye(n) / 12.0
    difference = q[:, None] - q[None, :]
    bias = (coupling * np.sin(difference)) @ v**2 + GRAVITY * arms.sum(axis=0) * np.sin(q)
    return np.linalg.solve(coupling * np.cos(difference), -bias)


def derive(links: int, formulation: str, repeats: int) -> tuple[float, of.Model]:
    """Best time in s to build the Model (its `acceleration` is a CasADi function), and the Model."""
    best, model = np.inf, None
    for _ in range(repeats):
        began = time.perf_counter()
        model = of.chain(links, formulation=formulation)
        best = min(best, time.perf_counter() - began)
    assert model is not None
    return best, model


def difference_from_dense(model: of.Model, links: int) -> float:
    """Largest difference of the accelerations at a random state, relative to the largest one."""
    rng = np.random.default_rng(links)
    q, v = rng.uniform(-np.pi, np.pi, links), rng.uniform(-2.0, 2.0, links)
    found = model.acceleration(0.0, q, v, model.parameter_values).full().ravel()
    wanted = dense_accelerations(q, v)
    return float(np.abs(found - wanted).max() / np.abs(wanted).max())


def measure(links: int, repeats: int) -> Row:
    seconds, model = derive(links, "recursive", repeats)
    row = (links, seconds, model.acceleration.n_instructions(), difference_from_dense(model, links))
    if links > LAGRANGE_UP_TO:
        return Row(*row, None, None, None)
    seconds, model = derive(links, "lagrange", 1)
    operations = model.acceleration.n_instructions() if model.acceleration.is_a("SXFunction") else None
    return Row(*row, seconds, operations, difference_from_dense(model, links))


def slope(sizes: list[int], values: list[float]) -> float:
    """Exponent k of values ~ n^k."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def report(rows: list[Row]) -> str:
    def shown(value: float | int | None, form: str) -> str:
        return "" if value is None else format(value, form)

    large = [row for row in rows if row.links >= 30]
    operations = slope([row.links for row in rows], [row.operations for row in rows])
    seconds = slope([row.links for row in large], [row.seconds for row in large])
    table = [
        f"| {row.links} | {row.seconds:.3g} | {row.operations} | {row.operations / row.links:.1f} | "
        f"{row.difference:.1e} | {shown(row.lagrange_seconds, '.3g')} | {shown(row.lagrange_operations, 'd')} | "
        f"{shown(row.lagrange_difference, '.1e')} |"
        for row in rows
    ]
    return "\n".join(
        [
            "# Deriving the chain's equations",
            "",
            "`python benchmarks/derivation.py`; every number on this page is written by that script.",
            f"Python {platform.python_version()}, casadi {ca.__version__}, numpy {np.__version__}, "
            f"{platform.machine()}.",
            "",
            "Time: `chain(n)` from fresh symbols to CasADi functions of acceleration, energies and positions.",
            "Operations: instructions of the acceleration. Difference: accelerations at a random state from",
            "an independent dense evaluation in NumPy, relative to the largest. Lagrange: the dense",
            f"formulation, up to {LAGRANGE_UP_TO} links (factorised numerically, so not counted, where it is large).",
            "",
            "| links | time, s | operations | per link | difference | Lagrange: time, s | operations | difference |",
            "|---|---|---|---|---|---|---|---|",
            *table,
            "",
            f"Operations grow as n^{operations:.3f}; time as n^{seconds:.2f} from 30 links on.",
            "",
        ]
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks" / "derivation.md")
    arguments = parser.parse_args()
    of.chain(2)  # the first call loads the libraries
    rows = [measure(links, arguments.repeats) for links in SIZES]
    text = report(rows)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    arguments.out.write_text(text)
    print(text)
    agreed = all(row.difference <= AGREEMENT for row in rows)
    quick = all(row.seconds <= LIMITS[row.links] for row in rows if row.links in LIMITS)
    return 0 if agreed and quick else 1


if __name__ == "__main__":
    sys.exit(main())
