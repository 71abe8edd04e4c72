"""Motions as a continuation problem by harmonic balance, for large systems: sparse from end to end.

With tau = omega t a turn of the motion, q(tau) = sum_k c_k b_k(tau) in cosines and sines b_k of some orders, the rows
are <b_l, G> = 0 (Galerkin) of the residual G (`integrate.residual`), by sums over equal times (AFT). Entries of the
slopes of G that are the same at all states cost a 2 x 2 block an order, the others a full block. Where G(tau + pi, -q,
-q', -q'') = -G odd orders and half of the times suffice. A phase that is prescribed is a row more, with an unknown of
its own: of free motions of a conservative system the unfolding, which comes back as 0, as their rows hold <q', G> = 0;
of driven ones a parameter, which makes them the backbone of a resonance where the phase is -pi/2. Sources: T. Cameron,
J. Griffin, J. Appl. Mech. 56 (1989) 149-154; M. Krack, J. Gross, Harmonic Balance for Nonlinear Vibration Problems
(2019).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import SuperLU, splu

from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.continuation.problem import Point, plane, solved
from orbitfinder.errors import ConvergenceError
from orbitfinder.integrate.residual import Residual
from orbitfinder.mechanics.newton import Settings, Solver

SAMPLES, LEAST, REFINED, POWERS, KEPT, TABLED = 4, 1e-3, 2, 4, 0.4, 4e6
"""Times over a period, in multiples of the highest order: products of three are not taken for others. Share of the
largest size that a coordinate's is at least; refinements of a solution; iterations for a kernel; sizes are kept until
their logarithms change by so much; numbers in a table of products, which grows by the cube of the orders"""
LEFT, NOISY, HIGHEST = 3e-14, 0.1, 400
"""The next orders are no larger than this, in the sizes of the coordinates, or than so many round-offs; the highest
order that is tried"""


@dataclass(frozen=True, eq=False)
class Coefficients:
    """Coefficients of all coordinates in their order, then what else is unknown, the parameter last."""

    vector: np.ndarray
    known: dict[str, Any] = field(default_factory=dict)

    def moved(self, step: np.ndarray) -> Coefficients:
        """So much farther."""
        return Coefficients(self.vector + step)


class Fourier:
    """Cosines and sines of some orders over equal times, what takes values to coefficients, and their derivatives."""

    def __init__(self, orders: tuple[int, ...]) -> None:
        self.orders = orders
        self.count = sum(2 if k else 1 for k in orders)
        samples, parts = SAMPLES * (max(orders) + 1), 2 if all(k % 2 for k in orders) else 1
        self.times = 2 * np.pi * np.arange(samples // parts) / samples
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


class Slots:
    """Where entries at some rows and columns, each of them once or more, go in a sparse matrix, worked out once."""

    def __init__(self, rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]) -> None:
        places, self.slots = np.unique(columns * shape[0] + rows, return_inverse=True)
        self.shape, self.indices = shape, (places % shape[0]).astype(np.int32)
        self.starts = np.searchsorted(places, np.arange(shape[1] + 1) * shape[0]).astype(np.int32)

    def matrix(self, entries: np.ndarray, known: Any = 0.0) -> Any:
        """Of their values, beside what is `known` to be there already."""
        data = known + np.bincount(self.slots, entries.real, self.indices.size)
        if np.iscomplexobj(entries):
            data = data + 1j * np.bincount(self.slots, entries.imag, self.indices.size)
        return sparse.csc_matrix((data, self.indices, self.starts), shape=self.shape)


class Pattern:
    """Where blocks of slopes go in the sparse matrix of all rows, worked out once.

    `powers` (3 of K x K) are what takes coefficients of a motion to those of q, q', q''; for a motion e^(s tau) q they
    are 1, D + s and its square.
    """

    def __init__(self, equations: Residual, basis: Fourier, powers: Sequence[np.ndarray] | None = None) -> None:
        self.equations, self.basis, count = equations, basis, basis.count
        powers = basis.powers if powers is None else powers
        self.products, self.moved, turning, sources, rows, columns = [], [], [], [], [], []
        block = np.indices((count, count)).reshape(2, -1)
        for k, power in enumerate(powers):
            own, (i, j) = np.flatnonzero(equations.steady[:, 2] == k), np.nonzero(power)
            turning.append(np.tile(power[i, j], own.size))
            sources.append(np.repeat(own, i.size))
            pairs = equations.steady[own]
            rows.append((pairs[:, :1] * count + i).ravel())
            columns.append((pairs[:, 1:2] * count + j).ravel())
        for k, power in enumerate(powers):
            pairs = equations.varying[equations.varying[:, 2] == k] if power.any() else equations.varying[:0]
            self.moved.append(basis.values @ power)
            small = basis.times.size * count**2 <= TABLED
            products = np.einsum("as,sb->sab", basis.back, self.moved[k]) if small else None
            self.products.append(None if products is None else products.reshape(basis.times.size, -1))
            rows.append((pairs[:, :1] * count + block[0]).ravel())
            columns.append((pairs[:, 1:2] * count + block[1]).ravel())
        self.idle, self.whole = [not power.any() for power in powers], equations.size * count
        self._slots = Slots(np.concatenate(rows), np.concatenate(columns), (self.whole, self.whole))
        still, self._slots.slots = np.split(self._slots.slots, [sum(map(len, sources))])
        numbers = np.concatenate(turning), (still, np.concatenate(sources))
        self.still = sparse.csr_matrix(numbers, shape=(self._slots.indices.size, len(equations.steady)))
        self.derived = dict[Any, Any]()  # what else is worked out once on these orders

    def matrix(self, fixed: np.ndarray, varying: np.ndarray) -> Any:
        """The sparse matrix of steady slopes and of samples (k x s) of the others."""
        moving = self.equations.varying[:, 2]
        values = [self._blocks(k, varying[moving == k]).ravel() for k in range(3) if not self.idle[k]]
        return self._slots.matrix(np.concatenate([np.zeros(0), *values]), self.still @ fixed)

    def _blocks(self, k: int, samples: np.ndarray) -> np.ndarray:
        """What samples (m x s) of slopes by the k-th power take coefficients to (m blocks of K x K)."""
        if (products := self.products[k]) is not None:
            return np.asarray(samples @ products)
        return np.array([(self.basis.back * row) @ self.moved[k] for row in samples])


class Condensed:
    """The derivatives: a sparse matrix by the coefficients and a column by the parameter, in units; of free motions a
    matrix by all unknowns, whose last row is an amplitude, and a column by that."""

    def __init__(self, matrix: Any, column: np.ndarray, sizes: np.ndarray) -> None:
        self.matrix, self.column, self.sizes = matrix, column, sizes

    @cached_property
    def factors(self) -> SuperLU:
        """Of the matrix alone. Raises `ConvergenceError` where it is singular."""
        try:
            return splu(self.matrix)
        except RuntimeError:
            raise ConvergenceError("the equations of the harmonics are singular") from None

    def kernel(self) -> tuple[np.ndarray, np.ndarray]:
        """The left and right vectors that a matrix which is nearly singular takes to almost nothing, of length 1."""
        both = np.random.default_rng(0).normal(size=(2, self.column.size))
        for _ in range(POWERS):
            both = np.array([self.factors.solve(both[0], "T"), self.factors.solve(both[1])])
            both /= np.linalg.norm(both, axis=1, keepdims=True)
        return both[0], both[1]

    def closed(self, rows: np.ndarray) -> Solver:
        """See `continuation.problem.Linear`."""
        aim = np.zeros(self.column.size + 1)
        aim[: self.sizes.size] = rows[0] * self.sizes
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
            right = np.insert(right, -1, np.zeros(aim.size - right.size))
            answer = once(right)
            for _ in range(REFINED):
                left = np.append(self.matrix @ answer[:-1] + self.column * answer[-1], aim @ answer)
                answer = answer + once(right - left)
            return np.asarray(-answer[: self.sizes.size] * self.sizes)

        return solve


@dataclass(frozen=True)
class Phase:
    """The first harmonic of a coordinate is A cos(tau + angle)."""

    coordinate: int
    angle: float = 0.0

    def row(self, basis: Fourier) -> tuple[int, np.ndarray]:
        """What vanishes where that is so, as slopes by its two coefficients, and where they begin."""
        begin = self.coordinate * basis.count + int(basis.places[basis.orders.index(1)])
        return begin, np.array([np.sin(self.angle), np.cos(self.angle)])


@dataclass(frozen=True, eq=False)
class Balanced:
    """The problem: sizes of the coordinates (n) and of what else is free, what rows (n) are measured in, and the phase
    that is prescribed."""

    pattern: Pattern
    sizes: np.ndarray
    p_sizes: np.ndarray
    row_sizes: np.ndarray
    phase: Phase | None = None
    settings: Settings = field(
        default_factory=lambda: Settings(
            floor=1e-17, round_off=1e-11, converged=1e-11, most_evaluations=20, contraction=0.3
        )
    )
    """rows are relative to the sizes of their terms, and those that load a stiff structure far smaller"""

    @property
    def basis(self) -> Fourier:
        """Of the harmonics."""
        return self.pattern.basis

    @property
    def equations(self) -> Residual:
        """Whose motions they are."""
        return self.pattern.equations

    def coefficients(self, w: Coefficients) -> np.ndarray:
        """Of each coordinate (n x K)."""
        return w.vector[: self.pattern.whole].reshape(-1, self.basis.count)

    def values(self, w: Coefficients) -> np.ndarray:
        """Of what else is free."""
        return w.vector[self.pattern.whole :]

    def rows(self, w: Coefficients) -> np.ndarray:
        """F(w)."""
        motion = self.basis.motion(self.coefficients(w))
        return self._closed(w, self._measured(self.equations.rows(self.basis.times, motion, self.values(w))))

    def _closed(self, w: Coefficients, rows: np.ndarray) -> np.ndarray:
        """With the row of the phase."""
        if self.phase is None:
            return rows
        begin, row = self.phase.row(self.basis)
        return np.append(rows, row @ w.vector[begin : begin + 2] / self.sizes[self.phase.coordinate])

    def _measured(self, samples: np.ndarray) -> np.ndarray:
        if not np.isfinite(samples).all():
            raise ConvergenceError("the equations of motion leave the numbers")
        return np.asarray((samples @ self.basis.back.T / self.row_sizes[:, None]).ravel())

    def linearise(self, w: Coefficients) -> tuple[np.ndarray, Condensed]:
        """F(w) and its derivatives, remembered with w."""
        problem, *answer = w.known.get("linear", (None,))
        if problem is not self:
            rows, matrix, *columns = self.slopes(w)
            count = self.basis.count
            across, down = np.repeat(self.sizes, count), np.repeat(1.0 / self.row_sizes, count)
            data = matrix.data * down[matrix.indices] * np.repeat(across, np.diff(matrix.indptr))
            scaled = sparse.csc_matrix((data, matrix.indices, matrix.indptr), shape=matrix.shape)
            columns = [column * size for column, size in zip(columns, self.p_sizes, strict=True)]
            if self.phase is not None:
                (begin, row), within = self.phase.row(self.basis), 1 if self.equations.names else 2
                last = np.vstack([row, row[::-1]])[:within]
                i, j = np.indices(last.shape).reshape(2, -1)
                below = sparse.coo_matrix((last.ravel(), (i, begin + j)), shape=(within, self.pattern.whole))
                beside = np.column_stack(columns[:within])
                scaled = sparse.bmat([[scaled, beside], [below, None]], format="csc")
                columns[-1] = np.append(columns[-1], 0.0) if within == 1 else -np.eye(scaled.shape[0])[-1]
            answer = [self._closed(w, rows), Condensed(scaled, columns[-1], np.append(across, self.p_sizes))]
            w.known["linear"] = (self, *answer)
        return answer[0], answer[1]

    def slopes(self, w: Coefficients) -> list[Any]:
        """<b_l, G>, the sparse matrix of <b_l, dG/dc_k> in its own units, and changes with what else is free."""
        rows, varying, *others = self.sampled(w)
        pattern, matrix = w.known.get("matrix", (None, None))
        if pattern is not self.pattern:
            matrix = self.pattern.matrix(self.equations.fixed(self.values(w)), varying)
            w.known["matrix"] = self.pattern, matrix
        return [self._measured(rows), matrix, *map(self._measured, others)]

    def sampled(self, w: Coefficients) -> list[np.ndarray]:
        """What is known of G at the times, remembered with w."""
        basis, samples = w.known.get("sampled", (None, []))
        if basis is not self.basis:
            motion = self.basis.motion(self.coefficients(w))
            samples = self.equations.over(self.basis.times, motion, self.values(w))
            w.known["sampled"] = self.basis, samples
        return samples  # type: ignore[no-any-return]

    def phases(self, w: Coefficients) -> np.ndarray:
        """None: the drive has the clock, or a row."""
        return np.zeros((0, w.vector.size))

    def metric(self, w: Coefficients) -> np.ndarray:  # noqa: ARG002 - of the protocol
        """The mean square of the coordinates over the motion, and of the parameter."""
        return self._metric

    @cached_property
    def _metric(self) -> np.ndarray:
        squares = (self.basis.values**2).mean(axis=0)
        profile = np.outer(1.0 / self.sizes**2, squares).ravel() / self.sizes.size
        squares = self.p_sizes**-2.0
        if not self.equations.names:
            squares[0] = 0.0  # of the unfolding
        return np.concatenate([profile, squares])

    def value(self, w: Coefficients, name: str) -> float:
        """Of the parameter, or of free motions a quantity of their state at tau = 0 or the period."""
        return self._quantity(w, name)[0]

    def aim(self, w: Coefficients, name: str, value: float) -> tuple[float, np.ndarray]:
        """The same at a value, in what it changes by where a coordinate does by its size."""
        known, row = self._quantity(w, name)
        size = float(np.abs(row * np.append(np.repeat(self.sizes, self.basis.count), self.p_sizes)).max())
        return (known - value) / size, row / size

    def _quantity(self, w: Coefficients, name: str) -> tuple[float, np.ndarray]:
        """A quantity and its slopes over w."""
        row, equations = np.zeros(w.vector.size), self.equations
        row[-1], pace = 1.0, float(w.vector[-1])
        if equations.names:
            return pace, row
        if name == "period":
            return 2 * np.pi / pace, -2 * np.pi / pace**2 * row
        q, rate = (part[:, 0] for part in self.basis.motion(self.coefficients(w), np.zeros(1))[:2])
        known, by_state = equations.at_start(name, np.append(q, pace * rate))
        by_place, by_rate = by_state.reshape(2, -1, 1)
        values = [self.basis.at(np.zeros(1))[0] @ power.T for power in self.basis.powers[:2]]
        row[: self.pattern.whole] = (by_place * values[0] + pace * by_rate * values[1]).ravel()
        row[-1] = float(by_rate[:, 0] @ rate)
        return known, row

    def at(self, w: Coefficients, tangent: np.ndarray) -> tuple[Self, Coefficients, np.ndarray]:
        """With the sizes of an accepted w, and as many orders as it takes. Raises `ConvergenceError`."""
        renewed = self.measured(w)
        sizes = [(renewed.sizes, self.sizes), (renewed.row_sizes, self.row_sizes)]
        if all(np.abs(np.log(new / old)).max() < KEPT for new, old in sizes):
            renewed = self  # with its own tangent: the corrector's is that of its guess, beyond a fold of none
        while not renewed.enough(w):
            renewed, w, tangent = renewed.finer(w, tangent)
            w = solved(renewed, w, plane(renewed, w, tangent)).w
            renewed = renewed.measured(w)
        return renewed, w, Point(renewed, w, tangent).sharp.tangent

    def on(self, orders: tuple[int, ...], vector: np.ndarray) -> tuple[Self, Coefficients]:
        """With these orders and the sizes of coefficients (w) of them."""
        known = self.equations.patterns
        if orders not in known:
            known[orders] = Pattern(self.equations, Fourier(orders))
        w = Coefficients(vector)
        if vector.size != known[orders].whole + self.p_sizes.size:
            raise ValueError("coefficients of another size")
        return replace(self, pattern=known[orders]).measured(w), w

    def known(self, w: Coefficients) -> float:
        """What the parameter of a fold is known to: what round-off and the next orders make of it."""
        rows, linear = self.linearise(w)
        left, _ = linear.kernel()
        lost = EPSILON * np.linalg.norm(left) + abs(left @ rows)
        return float(self.p_sizes[-1] * lost / abs(left @ linear.column))

    def enough(self, w: Coefficients) -> bool:
        """Whether the orders are. Raises `ConvergenceError` where none that are tried would be."""
        left, lost = self.left(w)
        enough = left <= max(LEFT, NOISY * lost)
        if not enough and max(self.basis.orders) > HIGHEST:
            raise ConvergenceError(f"after {max(self.basis.orders)} harmonics the next is still {left:.2g} of the "
                                   "motion; make what has corners smoother, or take method = "
                                   '"shooting", for up to about a hundred coordinates that are not stiff')  # fmt: skip
        return enough

    def measured(self, w: Coefficients) -> Self:
        """With the sizes of a motion."""
        coefficients = np.abs(self.coefficients(w))
        sizes = np.sqrt((coefficients**2).sum(axis=1))
        sizes = np.maximum(sizes, LEAST * sizes.max()) if sizes.any() else np.ones_like(sizes)
        matrix = abs(self.slopes(w)[1]) @ np.repeat(sizes, self.basis.count)
        rows = nonzero(matrix.reshape(-1, self.basis.count).max(axis=1))
        if not self.equations.names:
            j = self.equations.unfolded
            self = replace(self, p_sizes=np.array([rows[j] / sizes[j], self.p_sizes[-1]]))
        return replace(self, sizes=sizes, row_sizes=rows)

    def carried(self, w: Coefficients, onto: Coefficients) -> Coefficients:  # noqa: ARG002 - of the protocol
        """w, or a direction, of as many orders or fewer on its own."""
        return Coefficients(self._padded(w.vector))

    def _padded(self, vector: np.ndarray) -> np.ndarray:
        if vector.size == self.pattern.whole + self.p_sizes.size:
            return vector
        old, last = np.split(vector, [-self.p_sizes.size])
        wide, old = np.zeros((self.equations.size, self.basis.count)), old.reshape(self.equations.size, -1)
        wide[:, : old.shape[1]] = old
        return np.append(wide.ravel(), last)

    def left(self, w: Coefficients) -> tuple[float, float]:
        """About the largest coefficient of the next two orders, and what round-off makes there, in the sizes of the
        coordinates."""
        known = self.pattern.derived
        if "next" not in known:
            top, odd = max(self.basis.orders), 0 not in self.basis.orders
            known["next"] = Pattern(self.equations, Fourier(orders(top + 4 if odd else top + 2, odd)[-2:]))
        after: Pattern = known["next"]
        motion = self.basis.motion(self.coefficients(w), after.basis.times)
        rows, varying, *_ = self.equations.over(after.basis.times, motion, self.values(w))
        steady = np.broadcast_to(varying.mean(axis=1, keepdims=True), varying.shape)
        try:
            factors = splu(after.matrix(self.equations.fixed(self.values(w)), steady))
        except RuntimeError:
            return np.inf, 0.0
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (self.equations.size, after.basis.count))
        noise = EPSILON * self.row_sizes[:, None] * signs
        both = factors.solve(np.column_stack([(rows @ after.basis.back.T).ravel(), noise.ravel()]))
        sizes = np.repeat(self.sizes, after.basis.count)
        largest, lost = np.abs(both / sizes[:, None]).max(axis=0)
        return float(largest), float(lost)

    def finer(self, w: Coefficients, tangent: np.ndarray) -> tuple[Self, Coefficients, np.ndarray]:
        """With more orders, w and a tangent padded."""
        top = max(self.basis.orders)
        basis = Fourier(orders(top + max(2, 2 * (top // 4)), 0 not in self.basis.orders))
        made = replace(self, pattern=Pattern(self.equations, basis))
        more = Coefficients(made._padded(w.vector))
        return made.measured(more), more, made._padded(tangent)


def orders(top: int, odd: bool) -> tuple[int, ...]:
    """All to the highest, or the odd ones."""
    return tuple(range(1, top + 1, 2)) if odd else tuple(range(top + 1))
