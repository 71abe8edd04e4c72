"""A controller that holds a motion on a periodic orbit. Needs Python and NumPy only.

    u = u*(tau) - K(tau) (x - x*(tau)),    tau: the place (s) of the orbit that is nearest to x

    law = Law(TABLE)
    tau = law.start(x)                    # once, from anywhere near the orbit
    u, tau = law(x, tau + dt)             # every dt seconds: hold u until the next time
    tau = 0.0                             # with an event in the table, where it happens (the foot strikes)

`x` may be one state (d) or many (k x d), `tau` then k places.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

TURN = 2 * np.pi
REACH = 1 / 16
"""Longest correction of the place at once, in periods"""


class Law:
    """The controller of a table {period, clock, event, units, angles, states, inputs, gains, actuators, limits}."""

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.period, self.clock, self.event = float(table["period"]), bool(table["clock"]), bool(table["event"])
        parts = [np.asarray(table[name], float) for name in ("states", "inputs", "gains")]
        self.size, self.controls = parts[0].shape[1], parts[1].shape[1]
        self.units, self.angles = np.asarray(table["units"], float), np.asarray(table["angles"], float)
        pairs = [table["limits"].get(name, (-np.inf, np.inf)) for name in table["actuators"]]
        self.low, self.high = np.array(pairs, float).T
        self.rows = np.hstack(parts)
        self.count, self.spline = len(self.rows) - 1, spline(self.rows, self.event)

    def start(self, x: np.ndarray) -> np.ndarray:
        """The place (s) of the orbit that is nearest to a state."""
        x = np.atleast_2d(x)
        nodes = self.rows[: self.count + self.event, : self.size]
        apart = ((self.gap(x[:, None], nodes[None]) / self.units) ** 2).sum(axis=2)
        return self.follow(x, np.argmin(apart, axis=1) * (self.period / self.count), 8)

    def follow(self, x: np.ndarray, tau: np.ndarray, times: int = 2) -> np.ndarray:
        """The place nearest to x in the neighbourhood of tau: Newton's method on (x - x*) . dx*/dtau = 0."""
        for _ in range(times):
            place, slope, bend = self.piece(tau, self.size, 2)
            apart, slope, bend = self.gap(x, place) / self.units, slope / self.units, bend / self.units
            steep = (slope * slope).sum(axis=1)
            turning = np.maximum(steep - (bend * apart).sum(axis=1), steep / 2)
            move = (slope * apart).sum(axis=1) / turning
            tau = tau + np.clip(move, -REACH * self.period, REACH * self.period)
        return self.within(tau)

    def within(self, tau: np.ndarray) -> np.ndarray:
        """Places (k) in the period, over and over; with an event those beyond an end are at that end."""
        return np.asarray(np.clip(tau, 0.0, self.period) if self.event else tau % self.period)

    def at(self, tau: np.ndarray) -> np.ndarray:
        """The row (x*, u*, K) of the table at places tau (k)."""
        return self.piece(tau, self.rows.shape[1], 0)[0]

    def __call__(self, x: np.ndarray, tau: Any) -> tuple[np.ndarray, Any]:
        """The controls at a state, and its place near to where it is expected (with a clock: the time itself)."""
        one = np.ndim(x) == 1
        x, tau = np.atleast_2d(x), np.atleast_1d(np.asarray(tau, float))
        tau = self.within(tau) if self.clock else self.follow(x, tau)
        values = self.piece(tau, self.rows.shape[1], 0)[0]
        gains = values[:, self.size + self.controls :].reshape(-1, self.controls, self.size)
        apart = self.gap(x, values[:, : self.size])
        u = values[:, self.size : self.size + self.controls] - np.einsum("kij,kj->ki", gains, apart)
        u = np.clip(u, self.low, self.high)
        return (u[0], tau[0]) if one else (u, tau)

    def gap(self, x: np.ndarray, place: np.ndarray) -> np.ndarray:
        """x - place, angles within half a turn."""
        apart = x - place
        return np.asarray(apart - self.angles * TURN * np.round(apart / TURN))

    def piece(self, tau: np.ndarray, width: int, order: int) -> list[np.ndarray]:
        """The first columns of the spline at places tau (k), and its derivatives up to an order."""
        step = self.period / self.count
        where = self.within(tau) / step
        k = np.minimum(where.astype(int), self.count - 1)
        near, powers = self.spline[k[:, None] + np.arange(6), :width], np.vander(where - k, 6, increasing=True)
        return [np.einsum("kj,kjw->kw", powers @ TERMS[n], near) / step**n for n in range(order + 1)]


BASIS = np.array([
    [1, 26, 66, 26, 1, 0], [-5, -50, 0, 50, 5, 0], [10, 20, -60, 20, 10, 0],
    [-10, 20, 0, -20, 10, 0], [5, -20, 30, -20, 5, 0], [-1, 5, -10, 10, -5, 1],
]) / 120  # fmt: skip
"""The six splines of degree 5 that are not 0 between two of their equally spaced knots: row k are their terms in s^k"""
DERIVED = np.diag(np.arange(1.0, 6.0), 1)
TERMS = [BASIS, DERIVED @ BASIS, DERIVED @ DERIVED @ BASIS]
"""and those of their first and second derivatives"""


def spline(rows: np.ndarray, ends: bool = False) -> np.ndarray:
    """Coefficients (N + 5 x w) of the spline through rows (N + 1 x w): periodic, the last the first a period later; or
    with `ends`, whose next two nodes are no knots: what is between the nodes of no row dies out from the ends inwards.
    """
    count, moved = len(rows) - 1, rows[-1] - rows[0]
    back = (rows - np.outer(np.arange(count + 1) / count, moved))[:-1]
    angle = TURN * np.fft.rfftfreq(count)
    wave = (66 + 52 * np.cos(angle) + 2 * np.cos(2 * angle)) / 120  # eigenvalues of the circulant (1, 26, 66, 26, 1)
    weights = np.fft.irfft(np.fft.rfft(back, axis=0) / wave[:, None], count, axis=0)
    places = np.arange(-2, count + 3)
    weights = weights[places % count] + np.outer(places / count, moved)
    if not ends:
        return weights
    decay = np.roots([1, 26, 66, 26, 1])[2:] ** np.arange(count + 5)[:, None]
    modes = np.hstack([decay, decay[::-1]])
    odd, own = (np.diff(each, 6, axis=0)[[0, 1, -2, -1]] for each in (weights, modes))
    return np.asarray(weights - modes @ np.linalg.solve(own, odd))
