"""The equations of motion as a residual over a period, for harmonic balance and for steps of implicit methods.

With tau = omega t, omega = 2 pi cycles / (the drive's period), and ' for d/dtau,

    G(tau, q, q', q'', p) = M a + h,    v = omega q', a = omega^2 q'';    of a first-order system v - f(t, x, p).

Where nothing drives a conservative system omega is free, and with it the unfolding s of a force -s q_j' on some
coordinate j: free motions have s = 0 (see `orbits.harmonics`).
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from scipy import sparse

from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.mechanics.lagrange import mass_matrix_and_bias
from orbitfinder.mechanics.model import Model


class Residual:
    """G of a Model with parameters free (of "" nothing is), and its slopes, over many times in a call.

    Where nothing drives it (s, omega) are free, and j is `unfolded`.
    """

    def __init__(self, model: Model, names: tuple[str, ...] = ("",), cycles: int = 1, unfolded: int = 0) -> None:
        self.model, self.size, self.unfolded = model, model.degrees_of_freedom, unfolded
        self.names = names if model.forced else ()
        tau, free = ca.SX.sym("tau"), ca.SX.sym("free", len(self.names) or 2)
        shape = [ca.SX.sym(label, self.size) for label in ("q", "dq", "ddq")]
        known = [k for k, name in enumerate(self.names) if name]
        p = model.parameters([self.names[k] for k in known], free[known])
        pace = free[1] if model.forcing_period is None else 2 * np.pi * cycles / model.forcing_period(p)
        q, v, a = shape[0], pace * shape[1], pace**2 * shape[2]
        rows = self._rows(tau / pace, q, v, a, p)
        if not self.names:
            rows[unfolded] += free[0] * shape[1][unfolded]
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
        bent = np.array(ca.which_depends(rows, tau, 1, True), bool)
        bent[self.varying[:, 0]] = True
        bent |= bent.sum() > self.size - 32  # of fewer a sparse product takes longer
        self._straight, self._bent = np.flatnonzero(~bent), np.flatnonzero(bent)
        own = np.flatnonzero(~bent[self.steady[:, 0]])
        own = own[np.argsort(self.steady[own, 0], kind="stable")]  # by rows: a matrix of all at once
        places = self.steady[own, 2] * self.size + self.steady[own, 1]
        self._sums = own, places, np.searchsorted(self.steady[own, 0], np.append(self._straight, self.size))
        rest = ca.substitute(rows[self._straight.tolist()], ca.vertcat(*shape), ca.SX.zeros(3 * self.size))
        rows, still = rows[self._bent.tolist()], [picked[1], rest]
        self._over = ca.Function("over", given, [rows, picked[0], *ca.horzsplit(ca.jacobian(rows, free))])
        self._moving = ca.Function("moving", given, picked[:1])
        self._fixed = ca.Function("fixed", [free], [
            ca.densify(ca.horzcat(part, ca.jacobian(part, free))) for part in still])  # fmt: skip
        self._rows_alone, self._last = ca.Function("rows", given, [ca.densify(rows)]), (b"", [np.zeros((0, 0))] * 2)
        self._pace = ca.Function("pace", [free], [pace, ca.jacobian(ca.SX(pace), free)])
        self._maps, self.patterns = dict[tuple[str, int], Buffered](), dict[Any, Any]()
        self._levels = dict[str, ca.Function]()

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

    @property
    def start(self) -> np.ndarray:
        """The model's own values of what is free."""
        named = self.model.named_parameters
        return np.array([named.get(name, 0.0) for name in self.names]) if self.names else np.array([0.0, 1.0])

    @cached_property
    def level(self) -> str:
        """The energy's name."""
        return next(each.name for each in self.model.invariants if each.generator is None)

    def pace(self, values: np.ndarray) -> float:
        """omega, in rad/s."""
        return float(self._pace(values)[0])

    def rise(self, values: np.ndarray) -> np.ndarray:
        """d omega / d values."""
        return np.asarray(self._pace(values)[1].full().ravel())

    def at_start(self, name: str, state: np.ndarray) -> tuple[float, np.ndarray]:
        """An invariant by name, or a component, of a state (2n), and its slopes (2n)."""
        if name in self.model.state_names:
            unit = np.eye(1, 2 * self.size, self.model.state_index(name))[0]
            return float(unit @ state), unit
        if name not in self._levels:
            x, p = ca.SX.sym("x", 2 * self.size), ca.DM(self.model.parameter_values)
            (level,) = (each.value for each in self.model.invariants if each.name == name)
            number = level(x[: self.size], x[self.size :], p)
            made = ca.Function("level", [x], [number, ca.densify(ca.gradient(number, x))])
            self._levels[name] = made
        number, slopes = self._levels[name](state)
        return float(number), slopes.full().ravel()

    def over(self, times: np.ndarray, motion: list[np.ndarray], values: np.ndarray) -> list[np.ndarray]:
        """At times (s, rad) and q, q', q'' (n x s each): G (n x s), its varying slopes (k x s), dG/dp (n x s) each."""
        rows, varying, *others = (part.T for part in self._mapped(self._over, times, motion, values))
        whole = self._whole([rows, *others], motion, values)
        return [whole[0], varying, *whole[1:]]

    def rows(self, times: np.ndarray, motion: list[np.ndarray], values: np.ndarray) -> np.ndarray:
        """G alone."""
        return self._whole([self._mapped(self._rows_alone, times, motion, values)[0].T], motion, values)[0]

    def moving(self, times: np.ndarray, motion: list[np.ndarray], values: np.ndarray) -> np.ndarray:
        """The varying slopes (k x s) alone."""
        return self._mapped(self._moving, times, motion, values)[0].T

    def _whole(self, bent: list[np.ndarray], motion: list[np.ndarray], values: np.ndarray) -> list[np.ndarray]:
        """G, and dG/dp, of which the rows that are no sums of steady slopes are known."""
        if not self._straight.size:
            return bent
        (own, places, starts), stacked = self._sums, np.concatenate(motion)
        slopes, rest = self._steadily(values)
        parts = list[np.ndarray]()
        for k, known in enumerate(bent):
            parts.append(np.empty((self.size, known.shape[1])))
            sums = sparse.csr_matrix((slopes[own, k], places, starts), shape=(self._straight.size, len(stacked)))
            parts[-1][self._bent], parts[-1][self._straight] = known, sums @ stacked + rest[:, k, None]
        return parts

    def fixed(self, values: np.ndarray) -> np.ndarray:
        """The slopes that are the same at all states."""
        return self._steadily(values)[0][:, 0]

    def _steadily(self, values: np.ndarray) -> list[np.ndarray]:
        """Those, and what G is at rest in rows that are sums of them, each with its changes by what is free."""
        key = np.asarray(values, float).tobytes()
        if self._last[0] != key:
            self._last = key, [part.full() for part in self._fixed.call([values])]
        return self._last[1]

    def _mapped(
        self, function: ca.Function, times: np.ndarray, motion: list[np.ndarray], values: np.ndarray
    ) -> list[np.ndarray]:
        key = (function.name(), times.size)
        if key not in self._maps:
            self._maps[key] = Buffered(function.map(times.size))
        return self._maps[key](times[:, None], *(part.T for part in motion), values)

    @cached_property
    def odd(self) -> bool:
        """Whether G(tau + pi, -q, -q', -q'') = -G."""
        random, values = np.random.default_rng(0), self.start
        times = random.uniform(0, 2 * np.pi, 3)
        motion = [random.normal(size=(self.size, 3)) for _ in range(3)]
        here, there = self.rows(times, motion, values), self.rows(times + np.pi, [-part for part in motion], values)
        return bool(np.abs(here + there).max() <= 1e-9 * np.abs(here).max())

    def slopes(self, times: np.ndarray, motion: list[np.ndarray], values: np.ndarray) -> np.ndarray:
        """All slopes (3 x s x n x n) by q, q' and q'' at times, dense."""
        slopes = np.zeros((3, times.size, self.size, self.size))
        moving, fixed = self.over(times, motion, values)[1], self.fixed(values)[:, None]
        for table, entries in ((self.varying, moving), (self.steady, fixed)):
            slopes[table[:, 2], :, table[:, 0], table[:, 1]] = entries
        return slopes
