"""Lagrange's equations of a chain in closed form, in NumPy: the certificate's formulation of long chains.

With absolute angles the energies of every open planar chain of rigid links are

    T = 1/2 sum_ij m_ij cos(theta_i - theta_j) v_i v_j,    V = -sum_i g_i cos theta_i,

so that n (n + 1) / 2 + n numbers, read off the Model's own energies, are all there is to know.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh

from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import Model

AGREEMENT = 1e-10
"""The closed form must give the Model's energies to this, relative, at states it was not read from."""


@dataclass(frozen=True, eq=False)
class ChainLagrange:
    """m (n x n, kg m^2), g (n, N m) and the linear modes of the hanging chain.

    `modes` are the columns of U, slowest first, with diag(g) U = m U diag(w^2) and U^T m U = 1; `squared`
    are the w^2 in rad^2/s^2.
    """

    coupling: np.ndarray
    weights: np.ndarray
    modes: np.ndarray
    squared: np.ndarray

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """M_ij = m_ij cos(q_i - q_j)."""
        return self.coupling * np.cos(q[:, None] - q[None, :])

    def field(self, _: float, x: np.ndarray) -> np.ndarray:
        """x' = (v, a) with M a = -h, h_i = sum_j m_ij sin(q_i - q_j) v_j^2 + g_i sin q_i."""
        q, v = np.split(x, 2)
        cosine, sine = np.cos(q), np.sin(q)
        matrix = self.coupling * (np.outer(cosine, cosine) + np.outer(sine, sine))
        return np.concatenate([v, self._acceleration(matrix, self._swing(cosine, sine), v, sine)[0]])

    def _swing(self, cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
        """S_ij = m_ij sin(q_i - q_j)."""
        return np.asarray(self.coupling * (np.outer(sine, cosine) - np.outer(cosine, sine)))

    def _acceleration(
        self, matrix: np.ndarray, swing: np.ndarray, v: np.ndarray, sine: np.ndarray
    ) -> tuple[np.ndarray, tuple[np.ndarray, bool]]:
        factor = cho_factor(matrix, lower=True, check_finite=False)
        bias = swing @ (v * v) + self.weights * sine
        return -cho_solve(factor, bias, check_finite=False), factor

    def variational(self, _: float, z: np.ndarray) -> np.ndarray:
        """z' for z = (x, vec Y), Y (2n x k) by columns: Y_q' = Y_v, M Y_v' = -(dr/dq Y_q + dr/dv Y_v).

        With r = M a + h: dr_i/dq_k = S_ik a_k - C_ik v_k^2 off the diagonal, the diagonal minus the sum
        of those of its row with the signs of i, plus g_i cos q_i; dr_i/dv_k = 2 S_ik v_k.
        """
        n = self.weights.size
        q, v, columns = z[:n], z[n : 2 * n], z[2 * n :].reshape(2 * n, -1, order="F")
        cosine, sine = np.cos(q), np.sin(q)
        matrix = self.coupling * (np.outer(cosine, cosine) + np.outer(sine, sine))
        swing = self._swing(cosine, sine)
        a, factor = self._acceleration(matrix, swing, v, sine)
        slope = swing * a - matrix * (v * v)
        slope[np.diag_indices(n)] += self.weights * cosine - slope.sum(axis=1)
        found = np.empty_like(z)
        found[:n], found[n : 2 * n] = v, a
        rates = found[2 * n :].reshape(2 * n, -1, order="F")
        rates[:n] = columns[n:]
        right = slope @ columns[:n] + (2.0 * swing * v) @ columns[n:]
        rates[n:] = -cho_solve(factor, right, overwrite_b=True, check_finite=False)
        return found

    def momentum_frame(self, x: np.ndarray) -> np.ndarray:
        """d(eta, pi)/d(q, v) (2n x 2n) at x, the canonical pair q = U eta, pi = U^T M v.

        In these coordinates the high modes, whose momenta are small beside those of the whole chain, keep
        their digits: (theta, momentum) would lose cond(M) = 5e4 of them at 100 links.
        """
        n = self.weights.size
        q, v = np.split(x, 2)
        swing = self.coupling * np.sin(q[:, None] - q[None, :])
        slope = swing * v
        slope[np.diag_indices(n)] -= swing @ v
        return np.block([
            [self.modes.T @ self.coupling, np.zeros((n, n))],
            [self.modes.T @ slope, self.modes.T @ self.mass_matrix(q)],
        ])  # fmt: skip

    def energies(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Kinetic and potential energy (k each, J) along states (k x 2n), the potential without its constant."""
        q, v = np.split(np.atleast_2d(states), 2, axis=1)
        along, across = v * np.cos(q), v * np.sin(q)
        kinetic = 0.5 * (np.sum(along @ self.coupling * along, 1) + np.sum(across @ self.coupling * across, 1))
        return kinetic, -np.cos(q) @ self.weights


def chain_lagrange(model: Model) -> ChainLagrange:
    """The closed form of a chain, from its energies at 2n + 1 states. Raises `InputError` when it is no chain.

    Column j of m is dT/dv at q = 0 for v = e_j; g_i = dV/dq_i at q_i = pi/2, the others 0.
    """
    n, values = model.degrees_of_freedom, model.parameter_values
    q, v = ca.SX.sym("q", n), ca.SX.sym("v", n)
    momenta = ca.Function("momenta", [q, v], [ca.gradient(model.kinetic(q, v, values), v)])
    forces = ca.Function("forces", [q], [ca.gradient(model.potential(q, values), q)])
    coupling = np.column_stack([momenta(np.zeros(n), column).full().ravel() for column in np.eye(n)])
    weights = forces(np.full(n, np.pi / 2)).full().ravel()
    squared, modes = eigh(np.diag(weights), coupling)
    found = ChainLagrange((coupling + coupling.T) / 2, weights, modes, squared)
    _check(found, model)
    return found


def _check(found: ChainLagrange, model: Model) -> None:
    """`InputError` unless the closed form gives the Model's energies at random states."""
    n, values, random = found.weights.size, model.parameter_values, np.random.default_rng(0)
    rest = float(model.potential(np.zeros(n), values)) + float(found.weights.sum())
    for x in random.normal(0.0, 1.0, (3, 2 * n)):
        kinetic, potential = (float(part[0]) for part in found.energies(x))
        wanted = float(model.kinetic(x[:n], x[n:], values)), float(model.potential(x[:n], values))
        size = max(float(np.abs(found.weights).sum()), 1e-300)
        if not max(abs(kinetic - wanted[0]) / abs(wanted[0]), abs(potential + rest - wanted[1]) / size) < AGREEMENT:
            raise InputError("system: the energies are not those of an open planar chain in absolute angles")
