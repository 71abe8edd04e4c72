"""Solve M a + h = F lambda, J a = r for the accelerations and the forces, in the graph or numerically."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np

from orbitfinder.mechanics.lagrange import UNROLLED_FACTORISATION_LIMIT


@dataclass(frozen=True)
class LinearBalances:
    """M (n x n), h (n), F (n x m), J (m x n), r (m) with M a + h = F lambda and J a = r."""

    mass: ca.SX
    bias: ca.SX
    force: ca.SX
    jacobian: ca.SX
    right: ca.SX

    def matrix(self) -> ca.SX:
        """[[M, -F], [J, 0]] (n+m square), which multiplies (a, lambda)."""
        return ca.blockcat([[self.mass, -self.force], [self.jacobian, ca.SX(self.right.numel(), self.right.numel())]])

    def vector(self) -> ca.SX:
        """(-h, r) (n+m), the other side."""
        return ca.vertcat(-self.bias, self.right)


def eliminated(balances: LinearBalances, arguments: list[ca.SX], invertible: bool) -> ca.Function:
    """(a, lambda) as a Function of `arguments`: S lambda = r + J M^-1 h with S = J M^-1 F, then a.

    S is banded for a chain of bodies (block-tridiagonal), so its factors cost O(n) in the graph. A
    singular M (massless directions) or a wide band is left to a sparse QR at run time.
    """
    schur_sparsity = ca.mtimes(balances.jacobian, balances.force)
    if invertible and max(bandwidth(balances.mass), bandwidth(schur_sparsity)) <= UNROLLED_FACTORISATION_LIMIT:
        over_mass = factorised(balances.mass)
        weighted = over_mass(balances.force)
        schur = balances.jacobian @ weighted
        free = over_mass(balances.bias)
        forces = factorised(schur)(balances.right + balances.jacobian @ free)
        return ca.Function("algebraic", arguments, [ca.vertcat(weighted @ forces - free, forces)])
    parts = ca.Function("parts", arguments, [balances.matrix(), balances.vector()])
    inputs = [ca.MX.sym(f"i{k}", *argument.shape) for k, argument in enumerate(arguments)]
    matrix, vector = parts(*inputs)
    return ca.Function("algebraic", inputs, [ca.solve(matrix, vector)])


def bandwidth(matrix: ca.SX) -> int:
    """Largest |i - j| over the structural non-zeros of a matrix."""
    rows, columns = matrix.sparsity().get_triplet()
    return int(np.max(np.abs(np.subtract(rows, columns)), initial=0))


def factorised(matrix: ca.SX) -> Callable[[ca.SX], ca.SX]:
    """Solver of A y = b for A symmetric positive definite, by L D L^T inside its band.

    The right side may have several columns. Source: Golub and Van Loan, Matrix Computations, 4.3.
    """
    size, band = matrix.shape[0], bandwidth(matrix)
    if band == 0:
        inverse = ca.diag(1 / ca.diag(matrix))
        return lambda right: inverse @ right
    lower, diagonal = _band_factors(matrix, size, band)

    def solve(right: ca.SX) -> ca.SX:
        rows = [right[i, :] for i in range(size)]
        for i in range(size):
            for k in range(max(0, i - band), i):
                rows[i] = rows[i] - lower[i, k] * rows[k]
        rows = [row / pivot for row, pivot in zip(rows, diagonal, strict=True)]
        for i in reversed(range(size)):
            for k in range(i + 1, min(size, i + band + 1)):
                rows[i] = rows[i] - lower[k, i] * rows[k]
        return ca.vertcat(*rows)

    return solve


def _band_factors(matrix: ca.SX, size: int, band: int) -> tuple[dict[tuple[int, int], ca.SX], list[ca.SX]]:
    """Unit lower triangle (by index, inside the band) and diagonal of A = L D L^T."""
    lower: dict[tuple[int, int], ca.SX] = {}
    diagonal: list[ca.SX] = []
    for i in range(size):
        first = max(0, i - band)
        for j in range(first, i):
            known = sum(lower[i, k] * diagonal[k] * lower[j, k] for k in range(max(first, j - band, 0), j))
            lower[i, j] = (matrix[i, j] - known) / diagonal[j]
        diagonal.append(matrix[i, i] - sum(lower[i, k] ** 2 * diagonal[k] for k in range(first, i)))
    return lower, diagonal
