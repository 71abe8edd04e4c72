"""Solve M a + h = 0, or M a + h = F lambda and J a = r, for accelerations and forces, in the graph or numerically."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

UNROLLED_FACTORISATION_LIMIT = 16
"""Up to this bandwidth (or size, of a full matrix) matrices are factorised inside the graph; beyond, at run time."""


@dataclass(frozen=True)
class LinearBalances:
    """M (n x n), h (n), F (n x m), J (m x n), r (m) with M a + h = F lambda and J a = r."""

    mass: ca.SX
    bias: ca.SX
    force: ca.SX
    jacobian: ca.SX
    right: ca.SX

    @classmethod
    def of(cls, balances: ca.SX, rows: ca.SX, acceleration: ca.SX, forces: ca.SX) -> LinearBalances:
        """Read off residuals M a + h - F lambda and J a - r, in which a and lambda are symbols and enter linearly."""
        unknowns = ca.vertcat(acceleration, forces)
        rest = ca.substitute(ca.vertcat(balances, rows), unknowns, ca.SX.zeros(unknowns.numel()))
        return cls(
            mass=ca.jacobian(balances, acceleration),
            bias=rest[: acceleration.numel()],
            force=-ca.jacobian(balances, forces),
            jacobian=ca.jacobian(rows, acceleration),
            right=-rest[acceleration.numel() :],
        )

    @classmethod
    def held(cls, mass: ca.SX, bias: ca.SX, phi: ca.SX, q: ca.SX, v: ca.SX) -> LinearBalances:
        """Of Lagrange's equations under phi(q) = 0: M a + h = J^T lambda and J a = -(d(J v)/dq) v."""
        jacobian = ca.jacobian(phi, q)
        return cls(mass, bias, jacobian.T, jacobian, -ca.jtimes(jacobian @ v, q, v))

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
        return ca.Function("algebraic", arguments, [ca.vertcat(*written_out(balances))])
    parts = ca.Function("parts", arguments, [balances.matrix(), balances.vector()])
    inputs = [ca.MX.sym(f"i{k}", *argument.shape) for k, argument in enumerate(arguments)]
    matrix, vector = parts(*inputs)
    return ca.Function("algebraic", inputs, [ca.solve(matrix, vector)])


def written_out(balances: LinearBalances) -> tuple[ca.SX, ca.SX]:
    """a (n) and lambda (m), by the factors of M and then of S."""
    solved = solve_positive_definite(balances.mass, ca.horzcat(balances.force, balances.bias))
    weighted, free = solved[:, :-1], solved[:, -1]
    schur = balances.jacobian @ weighted
    forces = solve_positive_definite(schur, balances.right + balances.jacobian @ free)
    return weighted @ forces - free, forces


def acceleration_function(
    matrix: ca.SX, bias: ca.SX, arguments: Sequence[ca.SX], limit: int = UNROLLED_FACTORISATION_LIMIT
) -> ca.Function:
    """a(t, q, v, p) = -M^-1 h; M is never inverted, and factorised numerically for large n."""
    size = matrix.shape[0]
    if size <= limit:
        return ca.Function("acceleration", list(arguments), [solve_positive_definite(matrix, -bias)])
    parts = ca.Function("mass_and_bias", list(arguments), [matrix, bias])
    inputs = [ca.MX.sym(f"i{k}", *a.shape) for k, a in enumerate(arguments)]
    mass, rest = parts(*inputs)
    return ca.Function("acceleration", inputs, [ca.solve(mass, -rest, "ldl")])


def bandwidth(matrix: ca.SX) -> int:
    """Largest |i - j| over the structural non-zeros of a matrix."""
    rows, columns = matrix.sparsity().get_triplet()
    return int(np.max(np.abs(np.subtract(rows, columns)), initial=0))


def solve_positive_definite(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Y with A Y = B, A symmetric positive definite (n x n), by L D L^T inside its band, written out in the graph.

    Source: Golub and Van Loan, Matrix Computations, 4.3.
    """
    size, band = matrix.shape[0], bandwidth(matrix)
    lower: dict[tuple[int, int], ca.SX] = {}
    scaled: dict[tuple[int, int], ca.SX] = {}  # L D
    diagonal: list[ca.SX] = []
    for i in range(size):
        first = max(0, i - band)
        for j in range(first, i):
            lower[i, j] = (matrix[i, j] - sum(lower[i, k] * scaled[j, k] for k in range(first, j))) / diagonal[j]
            scaled[i, j] = lower[i, j] * diagonal[j]
        diagonal.append(matrix[i, i] - sum(lower[i, k] * scaled[i, k] for k in range(first, i)))
    rows: list[ca.SX] = []
    for i in range(size):
        rows.append(right[i, :] - sum(lower[i, k] * rows[k] for k in range(max(0, i - band), i)))
    rows = [row / pivot for row, pivot in zip(rows, diagonal, strict=True)]
    for i in reversed(range(size)):
        rows[i] = rows[i] - sum(lower[k, i] * rows[k] for k in range(i + 1, min(size, i + band + 1)))
    return ca.vertcat(*rows)
