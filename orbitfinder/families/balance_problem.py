"""Driven motions as a continuation problem by harmonic balance, for large systems: sparse from end to end.

With tau = omega t one period of the drive, q(tau) = sum_k c_k b_k(tau) in cosines and sines b_k of some orders, and

    G(tau, q, q', q'', p) = M a + h,    v = omega q', a = omega^2 q'',    omega = 2 pi cycles / (the drive's period)

(of a first-order system v - f(t, x, p)), the rows are <b_l, G> = 0 (Galerkin), by sums over equal times (AFT). Entries of
the slopes of G that are the same at all states cost a 2 x 2 block an order, the others a full one. Where G(tau + pi, -q,
-q', -q'') = -G odd orders suffice. Sources: T. Cameron, J. Griffin, J. Appl. Mech. 56 (1989) 149-154; M. Krack, J. Gross,
Harmonic Balance for Nonlinear Vibration Problems (2019).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import casadi as ca
import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.problem import Point
from orbitfinder.errors import ConvergenceError
from orbitfinder.mechanics.lagrange import mass_matrix_and_bias
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Settings, Solver

SETTINGS = Settings(floor=1e-14, round_off=1e-11, converged=1e-11, most_evaluations=12, contraction=0.02)
"""Rows are relative to the sizes of their terms"""
SAMPLES = 4
"""Times over a period, in multiples of the highest order: products of three are not taken for others"""
LEAST, REFINED = 1e-3, 2
"""Share of the largest size that a coordinate's counts as at least. Refinements of a bordered solution"""


@dataclass(frozen=True, eq=False)
class Series:
    """Coefficients of all coordinates, one after another, and the parameter last."""

    vector: np.ndarray
    known: dict[str, Any] = field(default_factory=dict)

    def moved(self, step: np.ndarray) -> Series:
        """So much farther."""
        return Series(self.vector + step)


class Equations:
    """G of a Model with one parameter free, and its slopes, over many times in a call."""

    def __init__(self, model: Model, name: str, cycles: int = 1) -> None:
        self.model, self.name, self.size = model, name, model.degrees_of_freedom
        tau, free = ca.SX.sym("tau"), ca.SX.sym("free")
        shape = [ca.SX.sym(label, self.size) for label in ("q", "dq", "ddq")]
        p = model.parameters((name,), free)
        assert model.forcing_period is not None
        pace = 2 * np.pi * cycles / model.forcing_period(p)
        q, v, a = shape[0], pace * shape[1], pace**2 * shape[2]
        rows = self._rows(tau / pace, q, v, a, p)
        entries, places = [], []
        for k, column in enumerate(shape):
            slopes = ca.jacobian(rows, column)
            i, j = slopes.sparsity().get_triplet()
            entries.append(ca.vertcat(*slopes.nonzeros()) if slopes.nnz() else ca.SX(0, 1))
            places += [(row, along, k) for row, along in zip(i, j, strict=True)]
        every, state = ca.vertcat(*entries), ca.vertcat(tau, *shape)
        varies = np.array(ca.which_depends(every, state, 1, True), bool) if every.numel() else np.zeros(0, bool)
        table = np.array(places, int).reshape(-1, 3)
        self.varying, self.steady = table[varies], table[~varies]
        given = [tau, *shape, free]
        picked = [every[np.flatnonzero(which).tolist()] for which in (varies, ~varies)]
        self.free = (name,)
        self._over = ca.Function("over", given, [rows, picked[0], ca.jacobian(rows, free)])
        self._fixed = ca.Function("fixed", [free], [ca.densify(picked[1])])
        self._rows_alone = ca.Function("rows", given, [ca.densify(rows)])
        self._pace = ca.Function("pace", [free], [pace])
        self._maps = dict[tuple[str, int], ca.Function]()

    def _rows(self, t: Any, q: Any, v: Any, a: Any, p: Any) -> Any:
        model = self.model
        if model.rates is not None:
            return v - model.rates(t, q, p)
        x, rate, clock = ca.SX.sym("x", self.size), ca.SX.sym("v", self.size), ca.SX.sym("t")
        kinetic = model.kinetic(x, rate, p)
        if model.gyroscopic is not None:
            kinetic += model.gyroscopic(x, rate, p)
        forces = None if model.forces is None else model.forces(clock, x, rate, p)
        mass, bias = mass_matrix_and_bias(kinetic, model.potential(x, p), x, rate, forces)
        given = ca.mtimes(mass, a) + bias
        return ca.substitute([ca.densify(given)], [x, rate, clock], [q, v, t])[0]

    def pace(self, value: float) -> float:
        """omega, in rad/s."""
        return float(self._pace(value))

    def over(self, times: np.ndarray, motion: list[np.ndarray], value: float) -> list[np.ndarray]:
        """At times (s) and q, q', q'' (n x s each): G (n x s), its varying slopes (k x s), dG/dp (n x s)."""
        return [part.full() for part in self._mapped(self._over, times.size)(times[None], *motion, value)]

    def rows(self, times: np.ndarray, motion: list[np.ndarray], value: float) -> np.ndarray:
        """G alone."""
        return np.asarray(self._mapped(self._rows_alone, times.size)(times[None], *motion, value).full())

    def fixed(self, value: float) -> np.ndarray:
        """The slopes that are the same at all states."""
        return np.asarray(self._fixed(value).full().ravel())

    def _mapped(self, function: ca.Function, count: int) -> ca.Function:
        key = (function.name(), count)
        if key not in self._maps:
            self._maps[key] = function.map(count)
        return self._maps[key]

    @cached_property
    def odd(self) -> bool:
        """Whether G(tau + pi, -q, -q', -q'') = -G."""
        random, value = np.random.default_rng(0), float(self.model.parameter_values[self.model.parameter_index(self.name)])
        times = random.uniform(0, 2 * np.pi, 3)
        motion = [random.normal(size=(self.size, 3)) for _ in range(3)]
        one, other = self.rows(times, motion, value), self.rows(times + np.pi, [-part for part in motion], value)
        return bool(np.abs(one + other).max() <= 1e-9 * np.abs(one).max())


class Basis:
    """Cosines and sines of some orders over equal times, what takes values to coefficients, and their derivatives."""

    def __init__(self, orders: tuple[int, ...]) -> None:
        self.orders = orders
        self.count = sum(2 if k else 1 for k in orders)
        samples = SAMPLES * (max(orders) + 1)
        self.times = 2 * np.pi * np.arange(samples) / samples
        self.values, self.slope = self.at(self.times), np.zeros((self.count, self.count))
        for k, place in zip(orders, self.places, strict=True):
            if k:
                self.slope[place, place + 1], self.slope[place + 1, place] = k, -k
        self.back = np.array([row / (row @ row) for row in self.values.T])
        self.powers = [np.eye(self.count), self.slope, self.slope @ self.slope]

    @cached_property
    def places(self) -> np.ndarray:
        """Where each order begins."""
        return np.cumsum([0] + [2 if k else 1 for k in self.orders])[:-1]

    def at(self, times: np.ndarray) -> np.ndarray:
        """All of them (s x K)."""
        parts = [np.ones((times.size, 1)) if k == 0 else np.column_stack([np.cos(k * times), np.sin(k * times)])
                 for k in self.orders]  # fmt: skip
        return np.hstack(parts)

    def motion(self, coefficients: np.ndarray, times: np.ndarray | None = None) -> list[np.ndarray]:
        """q, q', q'' (n x s) of coefficients (n x K)."""
        values = self.values if times is None else self.at(times)
        return [coefficients @ (power.T @ values.T) for power in self.powers]


class Pattern:
    """Where blocks of slopes go in the sparse matrix of all rows, worked out once.

    `powers` (3 of K x K) are what takes coefficients of a motion to those of q, q', q''; for a motion e^(s tau) q they are
    1, D + s and its square.
    """

    def __init__(self, equations: Equations, basis: Basis, powers: Sequence[np.ndarray] | None = None) -> None:
        self.equations, self.basis, count = equations, basis, basis.count
        powers = basis.powers if powers is None else powers
        self.turning, self.products, rows, columns = [], [], [], []
        block = np.indices((count, count)).reshape(2, -1)
        for k, power in enumerate(powers):
            pairs, (i, j) = equations.steady[equations.steady[:, 2] == k], np.nonzero(power)
            self.turning.append(power[i, j])
            rows.append((pairs[:, :1] * count + i).ravel())
            columns.append((pairs[:, 1:2] * count + j).ravel())
        for k, power in enumerate(powers):
            pairs = equations.varying[equations.varying[:, 2] == k] if power.any() else equations.varying[:0]
            products = np.einsum("as,sb->sab", basis.back, basis.values @ power)
            self.products.append(products.reshape(basis.times.size, -1))
            rows.append((pairs[:, :1] * count + block[0]).ravel())
            columns.append((pairs[:, 1:2] * count + block[1]).ravel())
        self.idle, self.whole = [not power.any() for power in powers], equations.size * count
        places, self.slots = np.unique(np.concatenate(columns) * self.whole + np.concatenate(rows), return_inverse=True)
        self.indices = (places % self.whole).astype(np.int32)
        self.starts = np.searchsorted(places, np.arange(self.whole + 1) * self.whole).astype(np.int32)

    def matrix(self, fixed: np.ndarray, varying: np.ndarray) -> Any:
        """The sparse matrix of steady slopes and of samples (k x s) of the others."""
        steady, moving = self.equations.steady[:, 2], self.equations.varying[:, 2]
        parts = [np.outer(fixed[steady == k], self.turning[k]).ravel() for k in range(3)]
        parts += [(varying[moving == k] @ self.products[k]).ravel() for k in range(3) if not self.idle[k]]
        values = np.concatenate(parts)
        data: Any = np.bincount(self.slots, values.real, self.indices.size)
        if np.iscomplexobj(values):
            data = data + 1j * np.bincount(self.slots, values.imag, self.indices.size)
        return sparse.csc_matrix((data, self.indices, self.starts), shape=(self.whole, self.whole))


class Bordered:
    """The derivatives: a sparse matrix by the coefficients and a column by the parameter, in units."""

    def __init__(self, matrix: Any, column: np.ndarray, sizes: np.ndarray) -> None:
        self.matrix, self.column, self.sizes = matrix, column, sizes

    @cached_property
    def factors(self) -> SuperLU:
        """Of the matrix alone. Raises `ConvergenceError` where it is singular."""
        try:
            return splu(self.matrix)
        except RuntimeError:
            raise ConvergenceError("the equations of the harmonics are singular") from None

    def closed(self, rows: np.ndarray) -> Solver:
        """See `continuation.problem.Linear`."""
        (aim,) = rows * self.sizes
        row, corner = aim[:-1], aim[-1]
        across = self.factors.solve(self.column)
        pivot = corner - row @ across
        if pivot == 0.0 or not np.isfinite(pivot):
            raise ConvergenceError("the equations of the harmonics are singular")

        def once(right: np.ndarray) -> np.ndarray:
            inside = self.factors.solve(right[:-1])
            last = (right[-1] - row @ inside) / pivot
            return np.append(inside - last * across, last)

        def solve(right: np.ndarray) -> np.ndarray:
            found = once(right)
            for _ in range(REFINED):
                left = np.append(self.matrix @ found[:-1] + self.column * found[-1], aim @ found)
                found = found + once(right - left)
            return np.asarray(-found * self.sizes)

        return solve


@dataclass(frozen=True, eq=False)
class Balanced:
    """The problem: sizes of the coordinates (n) and of the parameter, what rows (n) are measured in."""

    pattern: Pattern
    sizes: np.ndarray
    p_size: float
    row_sizes: np.ndarray
    settings: Settings = SETTINGS

    @property
    def basis(self) -> Basis:
        """Of the harmonics."""
        return self.pattern.basis

    @property
    def equations(self) -> Equations:
        """Whose motions they are."""
        return self.pattern.equations

    def coefficients(self, w: Series) -> np.ndarray:
        """Of each coordinate (n x K)."""
        return w.vector[:-1].reshape(-1, self.basis.count)

    def rows(self, w: Series) -> np.ndarray:
        """F(w)."""
        motion, value = self.basis.motion(self.coefficients(w)), float(w.vector[-1])
        return self._measured(self.equations.rows(self.basis.times, motion, value))

    def _measured(self, samples: np.ndarray) -> np.ndarray:
        if not np.isfinite(samples).all():
            raise ConvergenceError("the equations of motion leave the numbers")
        return np.asarray((samples @ self.basis.back.T / self.row_sizes[:, None]).ravel())

    def linearise(self, w: Series) -> tuple[np.ndarray, Bordered]:
        """F(w) and its derivatives, remembered with w."""
        problem, *found = w.known.get("linear", (None,))
        if problem is not self:
            rows, matrix, column = self.slopes(w)
            count = self.basis.count
            across, down = np.repeat(self.sizes, count), np.repeat(1.0 / self.row_sizes, count)
            data = matrix.data * down[matrix.indices] * np.repeat(across, np.diff(matrix.indptr))
            scaled = sparse.csc_matrix((data, matrix.indices, matrix.indptr), shape=matrix.shape)
            found = [rows, Bordered(scaled, column * self.p_size, np.append(across, self.p_size))]
            w.known["linear"] = (self, *found)
        return found[0], found[1]

    def slopes(self, w: Series) -> tuple[np.ndarray, Any, np.ndarray]:
        """F(w), the sparse matrix of <b_l, dG/dc_k> in its own units, and F's change with the parameter."""
        rows, varying, by_p = self.sampled(w)
        fixed = self.equations.fixed(float(w.vector[-1]))
        return self._measured(rows), self.pattern.matrix(fixed, varying), self._measured(by_p)

    def sampled(self, w: Series) -> list[np.ndarray]:
        """What is known of G at the times."""
        return self.equations.over(self.basis.times, self.basis.motion(self.coefficients(w)), float(w.vector[-1]))

    def phases(self, w: Series) -> np.ndarray:
        """None: the drive has the clock."""
        return np.zeros((0, w.vector.size))

    def metric(self, w: Series) -> np.ndarray:  # noqa: ARG002 - of the protocol
        """The mean square of the coordinates over the motion, and of the parameter."""
        return self._metric

    @cached_property
    def _metric(self) -> np.ndarray:
        squares = (self.basis.values**2).mean(axis=0)
        profile = np.outer(1.0 / self.sizes**2, squares).ravel() / self.sizes.size
        return np.append(profile, self.p_size**-2.0)

    def value(self, w: Series, name: str) -> float:  # noqa: ARG002 - of the protocol
        """Of the parameter."""
        return float(w.vector[-1])

    def aim(self, w: Series, name: str, value: float) -> tuple[float, np.ndarray]:  # noqa: ARG002 - of the protocol
        """The parameter at a value, in its unit."""
        row = np.zeros(w.vector.size)
        row[-1] = 1.0 / self.p_size
        return (float(w.vector[-1]) - value) / self.p_size, row

    def at(self, w: Series, tangent: np.ndarray) -> tuple[Self, Series, np.ndarray]:
        """With the sizes of an accepted w."""
        renewed = self.measured(w)  # and with its own tangent: the corrector's is that of its guess, beyond a fold of none
        return renewed, w, Point(renewed, w, tangent).sharp.tangent

    def measured(self, w: Series) -> Self:
        """With the sizes of a motion."""
        coefficients = np.abs(self.coefficients(w))
        sizes = np.sqrt((coefficients**2).sum(axis=1))
        sizes = np.maximum(sizes, LEAST * sizes.max()) if sizes.any() else np.ones_like(sizes)
        matrix = abs(self.slopes(w)[1]) @ np.repeat(sizes, self.basis.count)
        rows = matrix.reshape(-1, self.basis.count).max(axis=1)
        return replace(self, sizes=sizes, row_sizes=nonzero(rows))

    def carried(self, w: Series, onto: Series) -> Series:  # noqa: ARG002 - of the protocol
        """Itself: a curve keeps its harmonics."""
        return w

    def left(self, w: Series) -> float:
        """The largest row of G between the times that it was balanced at, in the sizes of its terms."""
        between = self.basis.times + np.pi / self.basis.times.size
        samples = self.equations.rows(between, self.basis.motion(self.coefficients(w), between), float(w.vector[-1]))
        return float(np.abs(samples / self.row_sizes[:, None]).max())

    def finer(self, w: Series, tangent: np.ndarray | None = None) -> tuple[Self, Series, np.ndarray | None]:
        """With more orders, w and a tangent padded."""
        old, odd = self.basis, 0 not in self.basis.orders
        top = max(old.orders) + max(2, 2 * (max(old.orders) // 4))
        basis = Basis(tuple(range(1, top + 2, 2)) if odd else tuple(range(top + 1)))

        def padded(vector: np.ndarray) -> np.ndarray:
            wide = np.zeros((self.equations.size, basis.count))
            wide[:, : old.count] = vector[:-1].reshape(-1, old.count)
            return np.append(wide.ravel(), vector[-1])

        made, more = replace(self, pattern=Pattern(self.equations, basis)), Series(padded(w.vector))
        return made.measured(more), more, None if tangent is None else padded(tangent)
