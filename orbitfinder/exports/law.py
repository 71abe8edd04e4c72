"""A controller that holds a motion on a periodic orbit. Needs Python and NumPy only.

    u = u*(tau) - K(tau) (x - x*(tau)),    tau: the place (s) of the orbit that is nearest to x

    law = Law(TABLE)
    tau = law.start(x)                    # once, from anywhere near the orbit
    u, tau = law(x, tau + dt)             # every dt seconds: hold u until the next time

`x` may be one state (d) or many (k x d), `tau` then k places.
"""

import numpy as np

TURN = 2 * np.pi
REACH = 1 / 16
"""Longest correction of the place at once, in periods"""


class Law:
    """The controller of a table {period, clock, units, angles, states, inputs, gains, actuators, limits}."""

    def __init__(self, table):
        self.period, self.clock = float(table["period"]), bool(table["clock"])
        parts = [np.asarray(table[name], float) for name in ("states", "inputs", "gains")]
        self.size, self.controls = parts[0].shape[1], parts[1].shape[1]
        self.units, self.angles = np.asarray(table["units"], float), np.asarray(table["angles"], float)
        pairs = [table["limits"].get(name, (-np.inf, np.inf)) for name in table["actuators"]]
        self.low, self.high = np.array(pairs, float).T
        self.rows = np.hstack(parts)
        self.count = len(self.rows) - 1
        self.slopes = slopes(self.rows)

    def start(self, x):
        """The place (s) of the orbit that is nearest to a state."""
        x = np.atleast_2d(x)
        apart = ((self._gap(x[:, None], self.rows[None, :-1, : self.size]) / self.units) ** 2).sum(axis=2)
        return self.follow(x, np.argmin(apart, axis=1) * (self.period / self.count), 8)

    def follow(self, x, tau, times=3):
        """The place nearest to x in the neighbourhood of tau: Newton's method on (x - x*) . dx*/dtau = 0."""
        for _ in range(times):
            place, slope, bend = self._piece(tau, self.size, 2)
            gap, slope, bend = self._gap(x, place) / self.units, slope / self.units, bend / self.units
            steep = (slope * slope).sum(axis=1)
            turning = np.maximum(steep - (bend * gap).sum(axis=1), steep / 2)
            move = (slope * gap).sum(axis=1) / turning
            tau = tau + np.clip(move, -REACH * self.period, REACH * self.period)
        return tau % self.period

    def deviation(self, x, tau):
        """x - x*(tau), angles within half a turn."""
        return self._gap(np.atleast_2d(x), self._piece(np.atleast_1d(tau), self.size, 0)[0])

    def __call__(self, x, tau):
        """The controls at a state, and its place near to where it is expected (with a clock: the time itself)."""
        one = np.ndim(x) == 1
        x, tau = np.atleast_2d(x), np.atleast_1d(np.asarray(tau, float))
        tau = tau % self.period if self.clock else self.follow(x, tau)
        values = self._piece(tau, self.rows.shape[1], 0)[0]
        gains = values[:, self.size + self.controls :].reshape(-1, self.controls, self.size)
        gap = self._gap(x, values[:, : self.size])
        u = values[:, self.size : self.size + self.controls] - np.einsum("kij,kj->ki", gains, gap)
        u = np.clip(u, self.low, self.high)
        return (u[0], tau[0]) if one else (u, tau)

    def _gap(self, x, place):
        gap = x - place
        return gap - self.angles * TURN * np.round(gap / TURN)

    def _piece(self, tau, width, order):
        """The first columns of the spline at places tau (k) and its first derivatives up to an order."""
        step = self.period / self.count
        where = (tau % self.period) / step
        k = np.minimum(where.astype(int), self.count - 1)
        s = (where - k)[:, None]
        y0, y1 = self.rows[k, :width], self.rows[k + 1, :width]
        m0, m1 = self.slopes[k, :width], self.slopes[k + 1, :width]
        square, cube = 3 * (y1 - y0) - 2 * m0 - m1, 2 * (y0 - y1) + m0 + m1
        found = [y0 + s * (m0 + s * (square + s * cube))]
        if order:
            found += [(m0 + s * (2 * square + 3 * s * cube)) / step, (2 * square + 6 * s * cube) / step**2]
        return found


def slopes(rows):
    """Slopes, per row, of the periodic cubic spline through rows, the last of which is the first a period later."""
    inner = rows[:-1]
    ahead, behind = np.vstack([inner[1:], rows[-1:]]), np.vstack([inner[-1:] - (rows[-1] - rows[0]), inner[:-1]])
    wave = 4 + 2 * np.cos(TURN * np.fft.rfftfreq(len(inner)))  # the eigenvalues of the circulant matrix (1, 4, 1)
    found = np.fft.irfft(np.fft.rfft(3 * (ahead - behind), axis=0) / wave[:, None], len(inner), axis=0)
    return np.vstack([found, found[:1]])
