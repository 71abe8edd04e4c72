"""Lagrange's equations of a chain in closed form, in NumPy and in C: the certificate's formulation of long chains.

With absolute angles the energies of every open planar chain of rigid links are

    T = 1/2 sum_ij m_ij cos(theta_i - theta_j) v_i v_j,    V = -sum_i g_i cos theta_i,

so that n (n + 1) / 2 + n numbers, read off the Model's own energies, are all there is to know. NumPy takes them as they
are; of links that hang one on another m_ij = s_i h_j for i < j, with which `chain_lagrange.c` needs O(n) operations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files

import casadi as ca
import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dposv, dpotrs

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError
from orbitfinder.integrate.compiled import Unavailable
from orbitfinder.integrate.field import CompiledField, VectorField, Work, as_table, with_dop853
from orbitfinder.mechanics.kind import system_kind
from orbitfinder.mechanics.model import Model

AGREEMENT, ROUND_OFF, WIDEST, LANES = 1e-10, 1e-13, 40, 8
"""The closed form must give the Model's energies to this, relative, at states it was not read from, in C its rates;
error of the coupling that two numbers a link stand for, relative to its largest entry; columns varied together at most,
and those in a register"""


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
        return _weighed(self.coupling, np.stack([np.cos(q), np.sin(q)]))

    def field(self, _: float, x: np.ndarray) -> np.ndarray:
        """x' = (v, a) with M a = -h, h_i = sum_j m_ij sin(q_i - q_j) v_j^2 + g_i sin q_i."""
        n = self.weights.size
        v, parts = x[n:], np.stack([np.cos(x[:n]), np.sin(x[:n])])
        return np.concatenate([v, _solved(_weighed(self.coupling, parts), self._pull(parts, v))[1]])

    def _pull(self, parts: np.ndarray, v: np.ndarray) -> np.ndarray:
        """-h from (cos q, sin q) (2 x n): the sines of differences written out, so that no matrix of them is made."""
        along, across = (parts * (v * v)) @ self.coupling
        cosine, sine = parts
        return np.asarray(cosine * across - sine * (along + self.weights))

    def linearised(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Accelerations a(q, v) (n) and their slopes da/dq and da/dv (n x n each)."""
        factor, a, slopes = self._slopes(q, v)
        by_state = -_backed(factor, slopes)
        return a, by_state[:, : q.size], by_state[:, q.size :]

    def _slopes(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cholesky factor of M, accelerations a, and [dr/dq | dr/dv] (n x 2n) of r = M a + h at fixed a.

        dr_i/dq_k = S_ik a_k - M_ik v_k^2 with S_ik = m_ik sin(q_i - q_k) off the diagonal, the diagonal
        minus the sum of those of its row plus g_i cos q_i; dr_i/dv_k = 2 S_ik v_k.
        """
        n = q.size
        parts = np.stack([np.cos(q), np.sin(q)])
        matrix = _weighed(self.coupling, parts)
        swing = self.coupling * (parts[::-1].T @ (parts * [[1.0], [-1.0]]))
        factor, a = _solved(matrix.copy(), self._pull(parts, v))
        slopes = np.empty((n, 2 * n))
        by_place, by_rate = slopes[:, :n], slopes[:, n:]
        np.multiply(swing, a, out=by_place)
        by_place -= matrix * (v * v)
        by_place[np.diag_indices(n)] += self.weights * parts[0] - by_place.sum(axis=1)
        np.multiply(swing, 2.0 * v, out=by_rate)
        return factor, a, slopes

    def variational(self, _: float, z: np.ndarray) -> np.ndarray:
        """z' for z = (x, Y), Y (2n x k) row by row: Y_q' = Y_v, M Y_v' = -(dr/dq Y_q + dr/dv Y_v)."""
        n = self.weights.size
        columns = z[2 * n :].reshape(2 * n, -1)
        factor, a, slopes = self._slopes(z[:n], z[n : 2 * n])
        bent = _backed(factor, np.asfortranarray(slopes @ columns))
        return np.concatenate([z[n : 2 * n], a, columns[n:].ravel(), -bent.ravel()])

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

    def carried(self, before: np.ndarray, after: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Phi in the coordinates of `momentum_frame` between two states, from variations (2n x 2n) of the modes."""
        modes = np.kron(np.eye(2), self.modes)
        first, last = self.momentum_frame(before) @ modes, self.momentum_frame(after) @ columns
        return np.linalg.solve(first.T, last.T).T

    def canonical(self, states: np.ndarray) -> np.ndarray:
        """(eta, pi) along states (k x 2n): the coordinates of `momentum_frame`."""
        q, v = np.split(states, 2, axis=1)
        cosine, sine = np.cos(q), np.sin(q)
        momenta = cosine * ((v * cosine) @ self.coupling) + sine * ((v * sine) @ self.coupling)
        return np.hstack([q @ self.coupling @ self.modes, momenta @ self.modes])

    @cached_property
    def rates(self) -> CompiledField:
        """`field`, in C where there is a compiler."""
        return _ClosedField(self.field, Work("chain", lambda: self._code(0), np.inf))

    @cached_property
    def width(self) -> int:
        """Columns that are varied together: in C as many as a cache holds along the stages of a step."""
        return self._whole if self.varied_rates.library() is None else min(WIDEST, self._whole)

    @property
    def _whole(self) -> int:
        return -(-2 * self.weights.size // LANES) * LANES

    @cached_property
    def varied_rates(self) -> CompiledField:
        """`variational` of `width` columns, in C where there is a compiler."""
        return _ClosedField(self.variational, Work("variations", lambda: self._code(min(WIDEST, self._whole)), np.inf))

    def varied(self, columns: np.ndarray, march: Callable[[np.ndarray], np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """The state (2n) and the columns of a matrix (2n x k) that a march of Y to (x, Y) ends with, `width` of them at
        a time."""
        count, ends = columns.shape[1], list[np.ndarray]()
        for first in range(0, count, self.width):
            some = columns[:, np.arange(first, first + self.width) % count]  # of the last block some come again
            ends.append(march(some.ravel()))
        size = 2 * self.weights.size
        return ends[0][:size], np.hstack([end[size:].reshape(size, -1) for end in ends])[:, :count]

    @cached_property
    def hanging(self) -> tuple[np.ndarray, np.ndarray] | None:
        """s and h (n each) with m_ij = s_i h_j for i < j; None where links do not hang in a row."""
        above = np.triu(self.coupling, 1)
        heavy = above[0]
        short = (above @ heavy) / nonzero(np.cumsum((heavy**2)[::-1])[::-1] - heavy**2)
        off = np.abs(np.triu(np.outer(short, heavy) - above, 1)).max(initial=0.0)
        return (short, heavy) if off <= ROUND_OFF * np.abs(self.coupling).max() else None

    def _code(self, columns: int) -> str:
        """C of the field with variations of so many columns. Raises `Unavailable` where links do not hang in a row."""
        if self.hanging is None:
            raise Unavailable("links do not hang one on another")
        short, heavy = self.hanging
        tables = {"OWN": np.diag(self.coupling), "SHORT": short, "HEAVY": heavy, "WEIGHTS": self.weights}
        own = (files("orbitfinder.mechanisms") / "chain_lagrange.c").read_text(encoding="utf-8")
        sizes = {"LINKS": self.weights.size, "LANES": LANES, "GROUP": columns // LANES}
        lines = [f"#define {name} {size}" for name, size in sizes.items()]
        return with_dop853("\n".join([*lines, *(as_table(*each) for each in tables.items()), own]))

    def energies(self, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Kinetic and potential energy (k each, J) along states (k x 2n), the potential without its constant."""
        q, v = np.split(np.atleast_2d(states), 2, axis=1)
        along, across = v * np.cos(q), v * np.sin(q)
        kinetic = 0.5 * (np.sum(along @ self.coupling * along, 1) + np.sum(across @ self.coupling * across, 1))
        return kinetic, -np.cos(q) @ self.weights


class _ClosedField(CompiledField):
    """One of the two fields as NumPy has it, with its library."""

    agreement = AGREEMENT

    def __init__(self, field: VectorField, work: Work, units: np.ndarray | None = None) -> None:
        super().__init__(work, None, units)
        self._field = field

    @cached_property
    def rate(self) -> VectorField:
        """The field without its library."""
        field, units = self._field, self._units
        return field if units is None else lambda t, y: field(t, y * units) / units

    def within(self, units: np.ndarray) -> _ClosedField:
        """The same in units (n)."""
        return _ClosedField(self._field, self._work, units)


def _weighed(coupling: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """M from m and (cos q, sin q)."""
    return np.asarray(coupling * (parts.T @ parts))


def _solved(matrix: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cholesky factor and solution of a symmetric matrix, which is overwritten; NaN where it is not positive definite.

    LAPACK without SciPy's checks, which at 100 links take as long as the solution.
    """
    factor, solution, info = dposv(matrix.T, right, lower=True, overwrite_a=True)
    return factor, solution if info == 0 else np.full_like(solution, np.nan)


def _backed(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The solution for more right-hand sides (n x k), which are overwritten where they are stored by columns."""
    return np.asarray(dpotrs(factor, right, lower=True, overwrite_b=True)[0])


def is_long(model: Model) -> bool:
    """True for chains that are certified on these equations: Hamilton's as a graph take seconds to derive and more."""
    plain = model.forces is None and model.gyroscopic is None and not model.forced
    return plain and system_kind(model.system).pendulum and model.degrees_of_freedom > 10


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
    closed_form = ChainLagrange((coupling + coupling.T) / 2, weights, modes, squared)
    _check(closed_form, model)
    return closed_form


def _check(closed_form: ChainLagrange, model: Model) -> None:
    """`InputError` unless the closed form gives the Model's energies at random states."""
    n, values, random = closed_form.weights.size, model.parameter_values, np.random.default_rng(0)
    if closed_form.hanging is None:
        raise InputError("system: the links of this chain do not hang in a row")
    rest = float(model.potential(np.zeros(n), values)) + float(closed_form.weights.sum())
    for x in random.normal(0.0, 1.0, (3, 2 * n)):
        kinetic, potential = (float(part[0]) for part in closed_form.energies(x))
        wanted = float(model.kinetic(x[:n], x[n:], values)), float(model.potential(x[:n], values))
        far, size = abs(potential + rest - wanted[1]), float(np.abs(closed_form.weights).sum())
        if not (abs(kinetic - wanted[0]) < AGREEMENT * abs(wanted[0]) and far <= AGREEMENT * size):
            raise InputError("system: the energies are not those of an open planar chain in absolute angles")
