"""The linearised equations of a chain at several times at once, solved in O(n): for harmonic balance and for stages.

Beside a motion, M a + h = 0 in closed form (`chain_lagrange`) has at each time the rows, for links i,

    r_i = o_i dq_i + m_ii da_i + sum over j of m_ij (s_i x_j - c_i z_j),      m_ij = SHORT_i HEAVY_j for i < j,
    x = (c a - s v^2) dq + 2 c v dv + s da,    z = (s a + c v^2) dq + 2 s v dv - c da,     c, s = cos q, sin q,

o_i the slope by a link's own angle. Where dq, dv and da are linear in as many unknowns of each link as there are
times, sums over j are carried from link to link: with p_i = sum over j < i of SHORT_j (x_j, z_j), what is farther out
makes sum over j > i of HEAVY_j (x_j, z_j) = K p_i+1 + k, tip to root, a small dense matrix K a link. Source:
S. Chandrasekaran, M. Gu, "Fast and stable algorithms for banded plus semiseparable systems of linear equations", SIAM
J. Matrix Anal. Appl. 25 (2003) 373-384.
"""

from __future__ import annotations

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.integrate.collocation import gauss
from orbitfinder.mechanisms.chain_lagrange import ChainLagrange
from orbitfinder.orbits.guesses.balance import PinRow, Series, Stepper


class ChainRows:
    """The rows of a closed form whose links hang in a row, at s states, q and v (n x s each), of given a (n x s)."""

    def __init__(self, closed: ChainLagrange, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        assert closed.hanging is not None
        short, heavy = closed.hanging
        self.short, self.heavy, self.own = short[:, None, None], heavy[:, None, None], np.diag(closed.coupling)
        c, s = np.cos(q), np.sin(q)
        along, across = c * a - s * v * v, s * a + c * v * v
        self.places, self.rates = np.stack([along, across], 1), np.stack([2 * c * v, 2 * s * v], 1)
        self.turned = np.stack([s, -c], 1)  # n x 2 x s, as the two above
        pulls = closed.coupling @ along, closed.coupling @ across
        self.stiff = c * (closed.weights[:, None] + pulls[1]) - s * pulls[0] - self.own[:, None] * v * v

    def _carried(self, place: np.ndarray, rate: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """(x, z) (n x 2s x k) of dq, dv and da (n, or 1, x s x k)."""
        parts = ((self.places, place), (self.rates, rate), (self.turned, bend))
        both = sum(by[..., None] * part[:, None] for by, part in parts)
        return np.asarray(both).reshape(len(self.own), -1, place.shape[-1])

    def _own(self, place: np.ndarray, bend: np.ndarray) -> np.ndarray:
        return np.asarray(self.stiff[:, :, None] * place + self.own[:, None, None] * bend)

    def _turned(self, link: int | slice, both: np.ndarray) -> np.ndarray:
        """s x - c z of (x, z) (2s x k) at links."""
        sine, cosine = self.turned[link, 0, :, None], self.turned[link, 1, :, None]
        size = sine.shape[-2]
        return np.asarray(sine * both[..., :size, :] + cosine * both[..., size:, :])

    def applied(self, place: np.ndarray, rate: np.ndarray, bend: np.ndarray) -> np.ndarray:
        """r (n x s x k) of dq, dv and da (n x s x k)."""
        both = self._carried(place, rate, bend)
        inner, outer = self.short * both, self.heavy * both
        near = np.cumsum(inner, axis=0) - inner
        far = np.cumsum(outer[::-1], axis=0)[::-1] - outer
        return np.asarray(self._own(place, bend) + self._turned(slice(None), self.heavy * near + self.short * far))

    def solved(
        self, place: np.ndarray, rate: np.ndarray, bend: np.ndarray, right: np.ndarray, known: np.ndarray
    ) -> np.ndarray:
        """What (n x s x k) of each link makes r = `right`, where three matrices (s x (s + m)) take it and what is
        `known` (n x m x k) to dq, dv and da. Raises `LinAlgError` where a pivot is singular."""
        carried, own = self._carried(place[None], rate[None], bend[None]), self._own(place[None], bend[None])
        (count, size, _), width = own.shape, right.shape[2]
        pivots, aheads = np.empty((count, size, size)), np.empty((count, size, 2 * size))
        gains, own, whole = np.empty_like(carried), own.copy(), np.zeros((2 * size, 2 * size))
        for i in reversed(range(count)):
            taken = whole @ carried[i]
            own[i] += self.short[i] ** 2 * self._turned(i, taken)
            pivots[i] = np.linalg.inv(own[i, :, :size])
            gains[i] = self.short[i] * taken + self.heavy[i] * carried[i]
            aheads[i] = pivots[i] @ self._turned(i, self.short[i] * whole + self.heavy[i] * np.eye(2 * size))
            whole -= gains[i, :, :size] @ aheads[i]
        backs = self.short * (pivots[:, :, None] * self.turned[:, None]).reshape(aheads.shape)
        answer = np.concatenate([pivots @ (right - own[..., size:] @ known), known], axis=1)
        far, near = np.zeros((2, 2 * size, width))
        for i in reversed(range(count)):
            answer[i, :size] -= backs[i] @ far
            far += gains[i] @ answer[i]
        for i in range(count):
            answer[i, :size] -= aheads[i] @ near
            near += self.short[i] * (carried[i] @ answer[i])
        return answer[:, :size]


def balancing(closed: ChainLagrange) -> Stepper:
    """Newton's steps of a balanced chain, those of its dense matrix up to round-off."""

    @np.errstate(divide="ignore", invalid="ignore", over="ignore")
    def step(series: Series, pin: PinRow) -> np.ndarray:
        n, w = closed.weights.size, series.frequency
        q, v, bend = (part @ series.coefficients for part in series.nodal)
        a = closed.rates.many(np.zeros(len(q)), np.hstack([q, v]))[:, n:]
        rows, none = ChainRows(closed, q.T, v.T, a.T), np.zeros_like(q)
        both = [np.stack(parts).T for parts in ((none, none), (none, v / w), (bend - a, 2 * bend / w))]
        moved = rows.solved(*series.nodal, -rows.applied(*both), np.zeros((n, 0, 2)))
        missed, by_start, by_period = pin(series.start, series.period)
        along = by_start @ moved.sum(axis=1)
        change = -(missed + along[0]) / (along[1] - by_period * series.period / w)
        return np.append((moved[..., 0] + change * moved[..., 1]).T, change)

    return step


def gauss_step(closed: ChainLagrange, states: np.ndarray, h: float, columns: np.ndarray) -> tuple[np.ndarray, float]:
    """Variations (2n x k) after a step h of Gauss' method along a motion of known states (s x 2n) at its nodes, and the
    share of their accelerations in it that is Legendre's last polynomial."""
    count, n = len(states), closed.weights.size
    nodes, inner, weights = gauss(count)
    (q, v), a = np.split(states.T, 2), closed.rates.many(np.zeros(count), states)[:, n:].T
    known = places, rates = np.split(columns, 2)
    ones, none = np.ones((count, 1)), np.zeros((count, 1))
    place = np.hstack([h**2 * inner @ inner, ones, h * nodes[:, None]])
    rate, bend = np.hstack([h * inner, none, ones]), np.hstack([np.eye(count), none, none])
    right = np.zeros((n, 1, columns.shape[1]))
    bends = ChainRows(closed, q, v, a).solved(place, rate, bend, right, np.stack(known, axis=1))
    last = (2 * count - 1) * weights * np.polynomial.legendre.legvander(2 * nodes - 1, count - 1)[:, -1]
    faster, farther, left = np.tensordot([h * weights, h**2 * weights @ inner, last], bends, (1, 1))
    share = float(np.abs(left).max() / nonzero(float(np.abs(bends).max())))
    return np.vstack([places + h * rates + farther, rates + faster]), share
