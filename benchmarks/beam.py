"""A clamped beam as a finite-element program would hand it over: the Matrix Market files of problems/structures/.

Euler and Bernoulli's beam with cubic shape functions, consistent masses, clamped at its left end; of each free node the
deflection (m) and the slope times the element's length (m), so that all coordinates have one unit. Steel, 0.7 m long,
14 mm square; damping is proportional to the masses, 1 % of critical in the first mode. Nothing of orbitfinder is used.

    python benchmarks/beam.py [ELEMENTS]        writes problems/structures/beam-{mass,damping,stiffness}.mtx
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.io import mmwrite
from scipy.linalg import eigh

FOLDER = Path(__file__).parents[1] / "problems" / "structures"
LENGTH, SIDE, DENSITY, YOUNG = 0.7, 0.014, 7800.0, 2.05e11
"""m, m, kg/m^3, Pa"""
SHARE = 0.01
"""of critical damping in the first mode"""


def matrices(elements: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, C, K (2 ELEMENTS square) in kg, N s/m and N/m."""
    h, area, inertia = LENGTH / elements, SIDE**2, SIDE**4 / 12
    stiff = np.array([[12, 6, -12, 6], [6, 4, -6, 2], [-12, -6, 12, -6], [6, 2, -6, 4]]) * YOUNG * inertia / h**3
    mass = np.array([[156, 22, 54, -13], [22, 4, 13, -3], [54, 13, 156, -22], [-13, -3, -22, 4]])
    mass = mass * DENSITY * area * h / 420
    m, k = np.zeros((2, 2 * elements + 2, 2 * elements + 2))
    for e in range(elements):
        at = slice(2 * e, 2 * e + 4)
        m[at, at] += mass
        k[at, at] += stiff
    m, k = m[2:, 2:], k[2:, 2:]
    slowest = np.sqrt(eigh(k, m, eigvals_only=True, subset_by_index=(0, 0))[0])
    return m, 2 * SHARE * slowest * m, k


def main() -> None:
    """Write the files."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("elements", type=int, nargs="?", default=100)
    elements = parser.parse_args().elements
    FOLDER.mkdir(exist_ok=True)
    for name, matrix in zip(("mass", "damping", "stiffness"), matrices(elements), strict=True):
        comment = f"Euler-Bernoulli beam, {elements} elements, clamped: {name}; benchmarks/beam.py"
        mmwrite(FOLDER / f"beam-{name}.mtx", sparse.coo_matrix(matrix), comment, symmetry="symmetric", precision=17)


if __name__ == "__main__":
    main()
