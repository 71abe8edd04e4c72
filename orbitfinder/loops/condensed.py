"""The linear system of multiple shooting, condensed to the first node.

    dx_{k+1} = Phi_k dx_k + C_k dy + d_k        k = 0 .. N-2, d_k the defect behind segment k
    F dx_0 + L (Phi_{N-1} dx_{N-1} + C_{N-1} dy) + G dy = -r

with dy the change of (period, unfolding, freed parameters) and r the closing rows. Eliminating the nodes costs N small
products and one small solve. The product of all Phi_k loses the contracting directions where it is very large; beyond
`LARGEST_PRODUCT` the whole matrix is solved instead.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

LARGEST_PRODUCT = 1e8
CUTOFF = 1e-13
"""Singular values below this, relative to the largest, are taken for 0 (brake orbits at rest have one)"""

Solver = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]
"""(defects (N-1 x 2n), closing rows (r)) -> (change of the nodes (N x 2n), change of the tail (m))"""


@dataclass(frozen=True)
class Linearised:
    """Phi_k (N x 2n x 2n), C_k (N x 2n x m), and the closing rows' derivatives F, L (r x 2n), G (r x m)."""

    transitions: np.ndarray
    columns: np.ndarray
    first: np.ndarray
    last: np.ndarray
    tail: np.ndarray


def eliminated(system: Linearised) -> Solver:
    """Newton's step for any residual at this linearisation."""
    count, size, _ = system.transitions.shape
    product, columns = np.eye(size), np.zeros((size, system.tail.shape[1]))
    for transition, own in zip(system.transitions, system.columns, strict=True):
        product, columns = transition @ product, transition @ columns + own
    if not np.abs(product).max() <= LARGEST_PRODUCT:
        return _whole(system)
    matrix = np.hstack([system.first + system.last @ product, system.last @ columns + system.tail])

    def solve(defects: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        carried = np.zeros(size)
        for transition, defect in zip(system.transitions, defects, strict=False):
            carried = transition @ carried + defect
        if count > 1:
            carried = system.transitions[-1] @ carried
        # not pinv: outside `one_thread` OpenBLAS gives it threads, on a busy machine 100 ms where lstsq takes 0.2
        change = -np.linalg.lstsq(matrix, rows + system.last @ carried, rcond=CUTOFF)[0]
        nodes, tail = [change[:size]], change[size:]
        for transition, own, defect in zip(system.transitions, system.columns, defects, strict=False):
            nodes.append(transition @ nodes[-1] + own @ tail + defect)
        return np.asarray(nodes), tail

    return solve


def _whole(system: Linearised) -> Solver:
    """The same without elimination."""
    count, size, _ = system.transitions.shape
    total, extra = count * size, system.tail.shape[1]
    matrix = np.zeros(((count - 1) * size + len(system.tail), total + extra))
    for k in range(count - 1):
        here = slice(k * size, (k + 1) * size)
        matrix[here, here] = system.transitions[k]
        matrix[here, (k + 1) * size : (k + 2) * size] = -np.eye(size)
        matrix[here, total:] = system.columns[k]
    closing = slice((count - 1) * size, None)
    matrix[closing, total - size : total] = system.last @ system.transitions[-1]
    matrix[closing, :size] += system.first
    matrix[closing, total:] = system.last @ system.columns[-1] + system.tail

    def solve(defects: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        change = -np.linalg.lstsq(matrix, np.concatenate([defects.ravel(), rows]), rcond=CUTOFF)[0]
        return change[:total].reshape(count, size), change[total:]

    return solve
