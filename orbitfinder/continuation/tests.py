"""Tests along a step of a curve, whose zeros are its events.

A test of a spectrum is a value per root, never a product over roots, which a root that crosses out and another that
crosses in leave with its sign. Roots lambda of A x = lambda x, with left vectors y, carry their derivatives along the
curve and their error bars, each by its own condition,

    lambda' = y A' x / y x,     |d lambda| <= |y| |dA| |x| / |y x|,

and are matched from place to place by predictions: what two places predict of each other, and their vectors. An entry
is a root, which crosses the boundary where it is 0, or the sum of two roots that is real, of a conjugate pair and of
two real ones: their sum goes on smoothly where a pair splits. Multipliers are entered as their logarithms.

Along a curve of bifurcations in two parameters a number vanishes that is smooth where roots meet: a product over all
of them, the product of a pair, the squared distance of two stability indices. Source: Yu. A. Kuznetsov, Elements of
Applied Bifurcation Theory (2004), chapters 9 and 10.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from itertools import combinations
from math import gcd, inf

import numpy as np
from scipy.linalg import eig
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.errors import ConvergenceError

SIMPLE, DEEPEST, MOST = EPSILON, 24, 200
"""y x of vectors of a simple root is larger; so often an interval is divided, and so many places looked at"""
ALTERNATIVE, DOUBT = 2.0, 4.0
"""A match that costs up to so many times as much counts as possible; a cubic is wrong by so many times what its parent
misses the middle by"""
REAL = 1e-9
"""A product of two multipliers is real when its imaginary part is below this, relative to its size."""


@dataclass(frozen=True, eq=False)
class Roots:
    """Roots at a place of a curve: real parts are the distances from the boundary.

    Args:
        values: the roots (m), complex ones in conjugate pairs.
        slopes: their derivatives along the arclength (m).
        vectors: their right vectors (d x m), of length 1.
        errors: their error bars (m).
        turn: what imaginary parts are known to, 2 pi of logarithms of multipliers.
    """

    values: np.ndarray
    slopes: np.ndarray
    vectors: np.ndarray
    errors: np.ndarray
    turn: float = inf

    def chosen(self, order: np.ndarray) -> Roots:
        """Those of these numbers, in this order."""
        parts = ("values", "slopes", "vectors", "errors")
        return replace(self, **{part: getattr(self, part)[..., order] for part in parts})

    def apart(self, differences: np.ndarray) -> np.ndarray:
        """Sizes of differences of roots."""
        turned = np.abs(differences.imag)
        return np.asarray(np.hypot(differences.real, np.minimum(turned, np.abs(self.turn - turned))))

    def real(self, labels: np.ndarray) -> np.ndarray:
        """Which two roots (k x 2) are real, multipliers of one sign, or conjugate."""
        first, second = self.values[labels].T
        alike = (np.abs(first.imag) == np.abs(second.imag)) & (np.abs(first.imag) % (self.turn / 2) == 0.0)
        return np.asarray(alike | (first == second.conj()))


def decomposed(a: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The eigenvalues (m) of a matrix, its left vectors (m x d) and right ones (d x m), y x = 1 where they are simple.

    Raises `ConvergenceError`.
    """
    try:
        values, left, right = eig(a, left=True)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ConvergenceError("the eigenvalues do not converge") from error
    own = np.einsum("ji,ji->i", left.conj(), right)
    return values, left.conj().T * (own.conj() / np.maximum(np.abs(own), SIMPLE) ** 2)[:, None], right


def felt(left: np.ndarray, change: np.ndarray, right: np.ndarray) -> np.ndarray:
    """What eigenvalues change by with their matrix, y A' x; with sizes for all three its bound."""
    return np.asarray(np.einsum("ij,jk,ki->i", left, change, right))


def matched(first: Roots, second: Roots, length: float) -> tuple[Roots, bool]:
    """The second in the order of the first, so far along the curve, and whether all likely matches cross alike."""
    ahead, behind = first.values + length * first.slopes, second.values - length * second.slopes
    missed = first.apart(ahead[:, None] - second.values) + first.apart(first.values[:, None] - behind)
    moved = np.add.outer(np.abs(first.slopes), np.abs(second.slopes)) * abs(length)
    moved += first.apart(first.values[:, None] - second.values) + np.add.outer(first.errors, second.errors)
    alike = np.minimum(np.abs(first.vectors.conj().T @ second.vectors), 1.0)
    cost = missed / nonzero(moved) + 1.0 - alike
    if not np.isfinite(cost).all():
        raise ConvergenceError("the eigenvalues of a step are not finite")
    order = linear_sum_assignment(cost)[1]
    cost, second = cost[:, order], second.chosen(order)
    own, exchanged = np.diag(cost), cost + cost.T
    a, b = (roots.values.real > roots.errors for roots in (first, second))
    other = (a[:, None] != a) & (b[:, None] != b)
    return second, not bool(np.any(other & (exchanged <= ALTERNATIVE * (own[:, None] + own))))


class Entries(IntEnum):
    """The entries of a spectrum: its roots, or the sums of two of them."""

    ROOTS = 0
    SUMS = 1


@dataclass(frozen=True, eq=False)
class Crossing:
    """A sum of two roots that vanishes between two shares of a step, or a root twice; `ends` are the roots there."""

    within: tuple[float, float]
    entry: np.ndarray
    ends: tuple[Roots, Roots]

    def value(self, roots: Roots, share: float, length: float) -> tuple[float, complex]:
        """How far below its error bar the sum is by the roots at a share of the step, matched from the nearer end;
        and its root, of two the upper or the larger."""
        k = int(abs(share - self.within[1]) < abs(share - self.within[0]))
        there = matched(self.ends[k], roots, (share - self.within[k]) * length)[0].chosen(self.entry)
        upper = max(there.values.tolist(), key=lambda root: (root.imag, root.real))
        return float(np.sum(there.errors - there.values.real)), upper


def crossings(
    look: Callable[[float], Roots], ends: tuple[Roots, Roots], length: float, kinds: Collection[Entries]
) -> list[Crossing]:  # fmt: skip
    """Where entries vanish along a step of this length, whose roots `look` gives at its shares.

    Between two places an entry is a cubic by its values and slopes. An interval is divided until each entry keeps away
    from 0 by more than its cubic may be wrong, or crosses 0 once; at first it always is.
    """
    events, looks, size = [], 0, ends[0].values.size
    labels = np.column_stack(np.triu_indices(size))
    labels = labels[np.isin(labels[:, 0] != labels[:, 1], list(kinds))]
    todo = [(0.0, 1.0, *ends, np.full(size, inf), 0)]
    while todo:
        low, high, first, second, wrong, depth = todo.pop()
        width = (high - low) * length
        second, sure = matched(first, second, width)
        crossed, known = _crossed(first, second, width, labels, wrong)
        if (sure and known) or depth == DEEPEST or looks == MOST:
            events += [Crossing((low, high), entry, (first, second)) for entry in labels[crossed]]
            continue
        middle, looks = (low + high) / 2, looks + 1
        there, _ = matched(first, look(middle), width / 2)
        cubic = np.array([1, 3, 3, 1]) / 8 @ _hull(first, second, width, np.arange(size)[:, None])
        wrong = DOUBT * (first.apart(cubic - there.values) + there.errors)
        todo += [(middle, high, there, second, wrong, depth + 1), (low, middle, first, there, wrong, depth + 1)]
    return events


def _hull(first: Roots, second: Roots, length: float, labels: np.ndarray) -> np.ndarray:
    """The four numbers in the hull of which the cubic of each sum is."""
    (a, da), (b, db) = (
        (roots.values[labels].sum(axis=1), length / 3 * roots.slopes[labels].sum(axis=1)) for roots in (first, second)
    )
    return np.array([a, a + da, b - db, b])


def _crossed(
    first: Roots, second: Roots, length: float, labels: np.ndarray, wrong: np.ndarray
) -> tuple[np.ndarray, bool]:
    """Which entries change their signs in an interval, and whether that is sure of all."""
    hull, off = _hull(first, second, length, labels), wrong[labels].sum(axis=1)
    bars, others = (roots.errors[labels].sum(axis=1) for roots in (first, second))
    real = first.real(labels) & second.real(labels)
    near = np.abs(hull).min(axis=0) <= DOUBT * np.abs(hull[3] - hull[0]) + off
    partly = (first.real(labels) ^ second.real(labels)) & near
    hull = hull.real
    sure = np.abs(hull).max(axis=0) <= np.maximum(bars, others)
    for values in (hull, np.diff(hull, axis=0)):  # away from 0, or rising or falling all the way
        sure |= (values.min(axis=0) > off) | (values.max(axis=0) < -off)
    return real & ((hull[0] > bars) != (hull[3] > others)), not (real & ~sure | partly).any()


Level = tuple[float, str, str, int, complex]


def index_levels(root: int, most: int) -> Iterator[Level]:
    """(level of the index, kind, detail, order q, critical multiplier of the root map) of every bifurcation."""
    yield 2.0, "branch_point", "", 1, 1.0 + 0.0j
    if root == 1:
        yield -2.0, "period_doubling", "", 2, -1.0 + 0.0j
    else:
        yield -2.0, "branch_point", "", 1, -1.0 + 0.0j
        yield 0.0, "period_doubling", "", 2, 1.0j
    for q in range(3, most + 1):
        for k in range(1, q * root // 2 + 1):
            if gcd(k, q) == 1:
                angle = 2 * np.pi * k / (q * root)
                yield 2 * float(np.cos(angle)), "resonance", f"q = {q}", q, complex(np.exp(1j * angle))


def multiplier_levels(root: int) -> list[Level]:
    """The same of real multipliers, where they are in no pairs."""
    pairs = index_levels(root, 2)
    return [(level / 2, kind, detail, q, mu) for level, kind, detail, q, mu in pairs if abs(level) == 2.0]


def levelled(roots: np.ndarray, level: float) -> float:
    """prod (level - r_i) over roots, each by its size, which is 0 where one of them is there."""
    return float(np.prod((level - roots) / np.hypot(1.0, np.abs(roots))).real)


def doubled(roots: np.ndarray, level: float) -> float:
    """The derivative of that product by the level, which is 0 too where two of the roots are there."""
    sizes = np.hypot(1.0, np.abs(roots))
    parts = (level - roots) / sizes
    return float(sum(np.prod(np.delete(parts, k)) / sizes[k] for k in range(roots.size)).real)


def unit_pair(roots: np.ndarray) -> tuple[float, float, np.ndarray]:
    """Product and sum of the two multipliers whose product is real and nearest to 1, and the others.

    They are conjugate on the unit circle, or real, of a neutral saddle.
    """
    numbers = combinations(range(roots.size), 2)
    pairs = [(np.prod(roots[[*pair]]), np.sum(roots[[*pair]]), np.delete(roots, pair)) for pair in numbers]
    real = [each for each in pairs if abs(each[0].imag) <= REAL * (1 + abs(each[0]))]
    if not real:
        raise ConvergenceError("no two multipliers are left that could leave the unit circle together")
    product, total, others = min(real, key=lambda each: abs(each[0] - 1.0))
    return float(product.real), float(total.real), others


def discriminant(indices: np.ndarray) -> float:
    """(kappa_i - kappa_j)^2 of the two nearest stability indices."""
    first, other = nearest_pair(indices)
    return float(((first - other) ** 2).real)


def nearest_pair(indices: np.ndarray) -> tuple[complex, complex]:
    """The two stability indices that are nearest to each other."""
    if indices.size < 2:
        raise ConvergenceError("no two stability indices are left that could meet")
    return min(combinations(map(complex, indices), 2), key=lambda pair: abs(pair[0] - pair[1]))
