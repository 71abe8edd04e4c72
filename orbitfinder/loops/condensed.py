"""The linear systems of multiple shooting: condensed to the first node, or whole, dense or sparse.

    dx_{k+1} = Phi_k dx_k + C_k dy + d_k        k = 0 .. N-2, d_k the defect behind segment k
    sum_k F_k dx_k + L (Phi_{N-1} dx_{N-1} + C_{N-1} dy) + G dy = -r

with dy the change of (period, unfolding, freed parameters) and r the closing rows, of which most have an F_0 only.
Rows at the inner ends of segments (guards) come after those. Eliminating the nodes costs N small
products and one small solve. The product of all Phi_k loses the contracting directions where it is very large; beyond
`LARGEST_PRODUCT` the whole matrix is solved instead.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

from orbitfinder.mechanics.newton import Solver, least_squares

LARGEST_PRODUCT = 1e8
CUTOFF = 1e-13
"""Singular values below this, relative to the largest, are taken for 0 (brake orbits at rest have one)"""
SMALL = 150
"""Unknowns up to which a dense factorisation is the faster one"""

Inner = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Segments (g), and the derivatives of a row of each by its node (g x d) and by y (g x m)"""


@dataclass(frozen=True)
class Linearised:
    """Phi_k (N x d x d), C_k (N x d x m), and the closing rows' derivatives F (r x d, by the first node alone,
    or r x N d), L (r x d), G (r x m).

    `inner` are rows (g) of one segment each (its number), by that segment's node (g x d) and by y (g x m).
    """

    transitions: np.ndarray
    columns: np.ndarray
    first: np.ndarray
    last: np.ndarray
    tail: np.ndarray
    inner: Inner | None = None

    def matrix(self) -> np.ndarray:
        """The derivatives of all rows by w."""
        (count, size, _), (closing, extra) = self.transitions.shape, self.tail.shape
        cut, total = (count - 1) * size, count * size
        matrix = np.zeros((cut + closing, total + extra))
        blocks, k = np.zeros((count - 1, size, count, size)), np.arange(count - 1)
        blocks[k, :, k], blocks[k, :, k + 1] = self.transitions[:-1], -np.eye(size)
        matrix[:cut, :total], matrix[:cut, total:] = blocks.reshape(cut, total), self.columns[:-1].reshape(cut, extra)
        matrix[cut:, cut:total] = self.last @ self.transitions[-1]
        matrix[cut:, : self.first.shape[1]] += self.first
        matrix[cut:, total:] = self.last @ self.columns[-1] + self.tail
        return matrix if self.inner is None else np.vstack([matrix, self._inner_matrix(total + extra)])

    def _inner_matrix(self, width: int) -> np.ndarray:
        assert self.inner is not None
        size, rows = self.transitions.shape[1], np.zeros((len(self.inner[0]), width))
        for row, k, slope, by_tail in zip(rows, *self.inner, strict=True):
            row[k * size : (k + 1) * size] = slope
            row[width - by_tail.size :] = by_tail
        return rows


def eliminated(system: Linearised) -> Solver:
    """Newton's step for any residual at this linearisation."""
    count, size, _ = system.transitions.shape
    product, columns = np.eye(size), np.zeros((size, system.tail.shape[1]))
    places, slopes, by_tail = system.inner or (np.zeros(0, int), np.zeros((0, size)), np.zeros((0, columns.shape[1])))
    inner, at = np.zeros((len(places), size + columns.shape[1])), {int(k): j for j, k in enumerate(places)}
    firsts = np.split(system.first, system.first.shape[1] // size, axis=1)
    head, tail = np.zeros(firsts[0].shape), system.tail.copy()
    for k, (transition, own) in enumerate(zip(system.transitions, system.columns, strict=True)):
        if k < len(firsts):
            head, tail = head + firsts[k] @ product, tail + firsts[k] @ columns
        if k in at:
            inner[at[k]] = np.concatenate([slopes[at[k]] @ product, slopes[at[k]] @ columns + by_tail[at[k]]])
        product, columns = transition @ product, transition @ columns + own
    if not np.abs(product).max() <= LARGEST_PRODUCT:
        whole = system.matrix()
        shortest = least_squares(whole, CUTOFF)
        return lambda rows: -shortest(rows)
    matrix = np.hstack([head + system.last @ product, system.last @ columns + tail])
    matrix = np.vstack([matrix, inner]) if len(inner) else matrix
    solved = _solver(matrix) if len(inner) else least_squares(matrix, CUTOFF)

    def solve(rows: np.ndarray) -> np.ndarray:
        defects, closing = rows[: (count - 1) * size].reshape(-1, size), rows[(count - 1) * size :]
        carried, closing = np.zeros(size), closing.copy()
        for k, transition in enumerate(system.transitions):
            if 0 < k < len(firsts):
                closing[: len(system.tail)] += firsts[k] @ carried
            if k in at:
                closing[len(system.tail) + at[k]] += slopes[at[k]] @ carried
            carried = transition @ carried
            if k < count - 1:
                carried += defects[k]
        # not pinv: outside `one_thread` OpenBLAS gives it threads, on a busy machine 100 ms where lstsq takes 0.2
        closing[: len(system.tail)] += system.last @ carried
        change = -solved(closing)
        nodes, tail = [change[:size]], change[size:]
        for transition, own, defect in zip(system.transitions, system.columns, defects, strict=False):
            nodes.append(transition @ nodes[-1] + own @ tail + defect)
        return np.concatenate([*nodes, tail])

    return solve


def _solver(matrix: np.ndarray) -> Solver:
    """A square matrix factorised once, any other solved by least squares."""
    try:
        return Factors(matrix).solve
    except np.linalg.LinAlgError:
        return least_squares(matrix, CUTOFF)


class Factors:
    """The LU factors of a square matrix. Raises `LinAlgError` where it is singular, or not square."""

    def __init__(self, matrix: np.ndarray) -> None:
        if matrix.shape[0] != matrix.shape[1] or not np.all(np.isfinite(matrix)):
            raise np.linalg.LinAlgError("not square or not finite")
        if len(matrix) > SMALL:
            try:
                self._sparse = splu(csc_matrix(matrix))
            except RuntimeError as error:
                raise np.linalg.LinAlgError(str(error)) from None
            return
        self._sparse = None
        self._dense, self._order, fault = dgetrf(matrix)
        if fault:
            raise np.linalg.LinAlgError("singular matrix")

    def solve(self, right: np.ndarray) -> np.ndarray:
        """matrix^-1 right."""
        if self._sparse is not None:
            return np.asarray(self._sparse.solve(right))
        return np.asarray(dgetrs(self._dense, self._order, right)[0])


class Broyden:
    """Full steps of Broyden's method from the factors of one Jacobian, its updates kept as the steps themselves.

    Source: C. T. Kelley, Iterative Methods for Linear and Nonlinear Equations (1995), section 7.3, algorithm brsol.
    """

    def __init__(self, factors: Factors) -> None:
        self._factors = factors
        self._steps: list[np.ndarray] = []

    def step(self, rows: np.ndarray) -> np.ndarray:
        """The step from where the residual is `rows`; the steps before it must have been taken in full."""
        right = -self._factors.solve(rows)
        for step, following in pairwise(self._steps):
            right = right + following * ((step @ right) / (step @ step))
        if self._steps:
            last = self._steps[-1]
            right = right / (1.0 - (last @ right) / (last @ last))
        self._steps.append(right)
        return right
