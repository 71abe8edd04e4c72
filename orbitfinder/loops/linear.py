"""The linear systems of shooting: dense while they are small, sparse when many segments make them large."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.linalg.lapack import dgetrf, dgetrs
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

SMALL = 150
"""Unknowns up to which a dense factorisation is the faster one"""


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
        found = -self._factors.solve(rows)
        for one, following in pairwise(self._steps):
            found = found + following * ((one @ found) / (one @ one))
        if self._steps:
            last = self._steps[-1]
            found = found / (1.0 - (last @ found) / (last @ last))
        self._steps.append(found)
        return found
