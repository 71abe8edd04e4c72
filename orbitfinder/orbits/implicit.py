"""Motions of large structures by steps that no fast mode limits: Gauss' method on the accelerations as given.

With stages a_i (accelerations, n each) of a step h from (q, v), t_i = t + c_i h and A the matrix of the method,

    v_i = v + h sum_j A_ij a_j,    q_i = q + c_i h v + h^2 sum_j (A^2)_ij a_j,    a_i = a(t_i, q_i, v_i).

The iteration's matrix is of the equations by the energies (`integrate.residual`), sparse, with a factorisation for each
pair of eigenvalues of A; what it ends with, and so the motion, is of the accelerations alone. Variations solve all
stages together; none is carried beside a motion where an energy falls. Source: E. Hairer, G. Wanner, Solving Ordinary
Differential Equations II (1996), sections IV.5, IV.8.

Where steps follow the fastest mode, variations of coordinates far apart do not come to meet in a few of them, and are
carried together (`Compressed`).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, cast

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra
from scipy.sparse.linalg import splu

from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.collocation import tableau
from orbitfinder.integrate.equations import accelerations, invariant_gradients
from orbitfinder.integrate.field import rates_of, vector_field
from orbitfinder.integrate.residual import Residual
from orbitfinder.loops.symmetry import symplectic
from orbitfinder.mechanics.kind import system_kind, with_parameters
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.closure import Closure, closes
from orbitfinder.orbits.decay import Decay, decay
from orbitfinder.orbits.evidence import Recomputed, Tour
from orbitfinder.orbits.floquet import Floquet, analyse
from orbitfinder.orbits.harmonics import Balanced, Coefficients, Fourier, Pattern, Slots, orders
from orbitfinder.orbits.measure import action

STAGES, STEPS, PIECES, FEW = 6, 64, 16, 0.2
"""Of a step; steps and state-transition matrices of a period; stages of rows that are few, in the rows of all"""
SETTLED, MOST, SLOW, SLOWER, WAVERS = 1e-15, 60, 0.7, 0.15, 4.0
"""Change of the coordinates, in extents, after which an iteration has ended; its steps at most; what a step leaves that
no longer contracts, or that asks for new factors; by how much changes that are round-off's differ"""
RESOLVED, POWERS, FINEST, FREE, SMALL, ERROR = 1.5, 30, 512, 4096, 40, 1.74e-13
"""Radians of the fastest mode in a step of a driven motion, of others it is 1; iterations that find it, the most steps
that follow it, of either, of few coordinates 16 times as many; coordinates up to which motions are certified by
explicit steps and all their variations; a step of z radians is off by this times z^13: 6!^2 / 12! 13!"""
TOLD, HIGHEST, TOGETHER, TAILS = 1e-10, 48, 8, 1e-14
"""Share of the largest harmonic of a motion that is none; as many as an energy is asked of; steps in which variations
are carried together, and what they may be off by that are told apart again"""


def truncated(turned: float, steps: int) -> float:
    """What so many steps over so many radians are off by."""
    return steps * ERROR * (turned / steps) ** (2 * STAGES + 1)


class Variations:
    """Small motions M u'' + C u' + K u = 0 beside some motion, over steps of Gauss' method.

    Entries (k) of all three matrices are in the order of a residual's `table`.
    """

    def __init__(self, residual: Residual) -> None:
        self.rule, self.size = tableau(STAGES, "legendre"), residual.size
        self.table = np.concatenate([residual.varying, residual.steady])
        (i, j, kinds), stages, n = self.table.T, np.arange(STAGES), residual.size
        self._single = Slots(i, j, (n, n))
        row, along = ((each[:, None] * STAGES + stages) for each in (i, j))  # the stages of a row together
        across, down = np.broadcast_arrays(row[:, :, None], along[:, None, :])
        self._stages = Slots(across.ravel(), down.ravel(), (STAGES * n, STAGES * n))
        stiff, both = kinds == 0, np.concatenate([j[kinds == 0], j[kinds < 2] + n])
        across = np.concatenate([row[stiff], row[kinds < 2]])
        self._given = Slots(across.ravel(), np.repeat(both, STAGES), (STAGES * n, 2 * n))
        self._varying, self._steady = residual.varying, cast(Any, ())  # of an earlier step

    def matrix(self, entries: np.ndarray) -> sparse.csc_matrix:
        """The sum of the three (n x n) with these entries."""
        return self._single.matrix(entries)

    def fastest(self, slopes: np.ndarray) -> float:
        """About the largest frequency, of entries (k) at an instant."""
        stiff, mass = (self.matrix(slopes * (self.table[:, 2] == kind)) for kind in (0, 2))
        shape, size = np.random.default_rng(0).normal(size=self.size), 0.0
        factors = splu(mass)
        for _ in range(POWERS):
            shape = factors.solve(stiff @ shape)
            size = float(np.linalg.norm(shape))
            shape = shape / size
        return float(np.sqrt(size))

    def over(self, h: float, slopes: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """A matrix (2n x m) of u, u' after a step h with entries (k x s) at its stages.

        Where few rows vary, these add forces f = D y to steps that are all the same, D what slopes of coordinates y are
        off those: y = Y w - Z f, and w goes to S w - B f.
        """
        n, varying = self.size, self._varying
        (rows, i), (seen, j) = (np.unique(x, axis=0, return_inverse=True) for x in (varying[:, 0], varying[:, 1:]))
        count, stages = rows.size * STAGES, np.arange(STAGES)
        if count > FEW * n:
            return self._ends(h, whole, self._stages_of(h, slopes, whole))
        fixed = slopes[len(varying) :, 0]
        if not self._steady or self._steady[0] != h or not np.array_equal(self._steady[1][len(varying) :, 0], fixed):
            same, begin, push = slopes[:, :1], np.eye(2 * n, 2 * n + count), np.zeros((n, STAGES, 2 * n + count))
            push[rows[:, None], stages, 2 * n + np.arange(count).reshape(-1, STAGES)] = 1.0
            carried = self._stages_of(h, np.repeat(same, STAGES, axis=1), begin, push)
            # what is seen of u (0), u' (1) or u'' (2) at the stages, in rows
            (along, kinds), inner = seen.T, self.rule.inner
            (place, rate), a = (part[along, None] for part in np.split(begin, 2)), carried[along]
            q = place + h * self.rule.points[:, None] * rate + h**2 * inner @ inner @ a
            every = np.stack([q, rate + h * inner @ a, a])
            ends, felt = self._ends(h, begin, carried), every[kinds, np.arange(len(seen))].reshape(-1, begin.shape[1])
            self._steady = h, same, *np.split(ends, [2 * n], axis=1), *np.split(felt, [2 * n], axis=1)
        _, same, step, pushed, known, answers = self._steady
        apart = np.zeros((rows.size, STAGES, len(seen), STAGES))
        apart[i[:, None], stages, j[:, None], stages] = (slopes - same)[: len(varying)]
        off = apart.reshape(count, len(seen) * STAGES)
        forces = np.linalg.solve(np.eye(count) + off @ answers, off @ (known @ whole))
        return np.asarray(step @ whole - pushed @ forces)

    def _stages_of(self, h: float, slopes: np.ndarray, whole: np.ndarray, push: Any = 0.0) -> np.ndarray:
        """u'' (n x s x m) at the stages of a step that begins with u, u' (2n x m), and of what pushes at them."""
        kinds, inner = self.table[:, 2], self.rule.inner
        parts = np.array([h**2 * inner @ inner, h * inner, np.eye(STAGES)])
        matrix = self._stages.matrix((slopes[:, :, None] * parts[kinds]).ravel())  # (row, stage i) by (column, stage j)
        stiff, damping = (slopes * (kinds == kind)[:, None] for kind in (0, 1))
        carried = (self.rule.points * h * stiff + damping)[kinds < 2]
        right = self._given.matrix(-np.concatenate([stiff[kinds == 0], carried]).ravel()) @ whole
        right = right.reshape(self.size, STAGES, -1) + push
        return np.asarray(splu(matrix).solve(right.reshape(self.size * STAGES, -1)).reshape(right.shape))

    def _ends(self, h: float, whole: np.ndarray, stages: np.ndarray) -> np.ndarray:
        """What u, u' that begin a step become, by u'' at its stages."""
        (place, rate), weights = np.split(whole, 2), self.rule.weights
        moved, faster = (np.einsum("nik,i->nk", stages, by) for by in (weights @ self.rule.inner, weights))
        return np.vstack([place + h * rate + h**2 * moved, rate + h * faster])


class Compressed:
    """Variations of single coordinates, those that do not come to meet carried as a single column and told apart again.

    In so many steps one comes so far along the structure, its `reach`, and beyond it is round-off: columns whose
    coordinates are twice as far apart are added (A. Curtis, M. Powell, J. Reid, J. Inst. Maths Applics 13 (1974)
    117-119). A column of all coordinates goes along and says what that is off.
    """

    def __init__(self, table: np.ndarray, n: int, reach: int) -> None:
        i, j = table[:, 0], table[:, 1]
        joined = sparse.csr_matrix((np.ones(2 * i.size), (np.append(i, j), np.append(j, i))), (n, n))
        away = dijkstra(joined, unweighted=True, limit=2 * reach)
        colours = np.full(n, -1)
        for k in range(n):
            taken = set(colours[np.isfinite(away[k])].tolist())
            colours[k] = next(colour for colour in range(n) if colour not in taken)
        count = int(colours.max()) + 1
        where, of = np.nonzero(away <= reach)  # what a coordinate comes to
        self.reach, self.n, self._where, self._of, self._by = reach, n, where, of, colours[of]
        begin = np.zeros((n, count))
        begin[np.arange(n), colours] = 1.0
        self.told = np.random.default_rng(0).choice([-1.0, 1.0], 2 * n)
        self._begin, self.count = begin, count

    def begin(self, units: np.ndarray) -> np.ndarray:
        """What is carried (2n x m), from unit vectors and a vector of the size of the motion."""
        nothing = np.zeros_like(self._begin)
        seeds = np.block([[self._begin, nothing], [nothing, self._begin]])
        return np.column_stack([seeds, self.told * units])

    def whole(self, carried: np.ndarray, units: np.ndarray) -> tuple[np.ndarray, float]:
        """What became of all unit vectors (2n x 2n), and what it is off by, in extents of what it moves."""
        n, whole = self.n, np.zeros((2 * self.n, 2 * self.n))
        for rows in (0, n):
            for half, columns in ((0, 0), (self.count, n)):
                whole[rows + self._where, columns + self._of] = carried[rows + self._where, half + self._by]
        off = np.abs(whole @ (self.told * units) - carried[:, -1]) / (np.abs(whole) @ units)
        return whole, float(off.max())


class Implicit:
    """The motions of a mechanical Model, from a state for a period, by its equations (at `values` of what
    is free there)."""

    def __init__(self, model: Model, residual: Residual, values: np.ndarray) -> None:
        self.residual, self.values = residual, values
        self.many, self.pace = rates_of(vector_field(accelerations(model)))[0], residual.pace(values)
        self.linear = Variations(residual)
        rule, self.table = self.linear.rule, self.linear.table
        self.places, self.inner, self.weights = rule.points, rule.inner, rule.weights
        self.square = self.inner @ self.inner
        values, vectors = np.linalg.eig(self.inner)
        own = values.imag > 0  # the others are their conjugates
        self.eigenvalues, self.out, self.into = values[own], vectors[:, own], np.linalg.inv(vectors)[own]
        self._factors, self._noise = cast(Any, ()), SETTLED  # of an earlier step; changes that are none

    def _slopes(self, times: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """dG/dq, dG/dv, dG/da (k x s, by `table`) at times (s) and s x n of each."""
        motion = [q.T, v.T / self.pace, a.T / self.pace**2]
        varying = self.residual.moving(self.pace * times, motion, self.values)
        fixed = np.broadcast_to(self.residual.fixed(self.values)[:, None], (len(self.residual.steady), times.size))
        return np.concatenate([varying, fixed]) / self.pace ** self.table[:, 2:]

    def _stepped(
        self, t: float, state: np.ndarray, h: float, a: np.ndarray, units: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The state after a step and its stages (s x n), from a guess of them. Raises `IntegrationError`."""
        n, times = self.residual.size, t + h * self.places
        still = np.hstack([state[:n] + h * self.places[:, None] * state[n:], np.tile(state[n:], (STAGES, 1))])
        moves, sizes = np.stack([h**2 * self.square, h * self.inner], axis=1).reshape(-1, STAGES), h**2 / units[:n]
        states = still + (moves @ a).reshape(still.shape)
        before, fresh = np.inf, not self._factors or self._factors[0] != h
        for _ in range(MOST):
            if fresh and np.isinf(before):
                # the masses and the factors of an iteration's matrices, in the middle of a step
                middle = slice(STAGES // 2, STAGES // 2 + 1)
                q, v = np.hsplit(states[middle], 2)
                slopes = self._slopes(times[middle], q, v, a[middle])[:, 0]
                weights = (h * self.eigenvalues[:, None]) ** (2 - self.table[:, 2])
                every = sparse.block_diag([self.linear.matrix(slopes * weight) for weight in weights], format="csc")
                self._factors = h, self.linear.matrix(slopes * (self.table[:, 2] == 2)), splu(every)
            _, mass, factors = self._factors
            missed = self.many(times, states)[:, n:] - a
            right = self.into @ (mass @ missed.T).T
            change = 2 * (self.out @ factors.solve(right.ravel()).reshape(right.shape)).real
            moved = float(np.abs(change * sizes).max())
            slow = not moved <= SLOWER * before
            if slow and not fresh and moved > self._noise:  # of an earlier step, far from here
                before, fresh = np.inf, True
                continue
            if not np.isfinite(moved):
                break
            a = a + change
            states = still + (moves @ a).reshape(still.shape)
            rests = moved > SLOW * before and moved < 1e-6
            self._noise = max(self._noise, WAVERS * moved) if rests and fresh else self._noise
            drowned = moved <= self._noise and not slow and before < np.inf
            if moved <= SETTLED or rests or drowned or (slow and not fresh):
                end = np.concatenate([state[:n] + h * state[n:] + h**2 * (self.weights @ self.inner) @ a,
                                      state[n:] + h * self.weights @ a])  # fmt: skip
                return end, a
            before = moved
        raise IntegrationError("the steps of an implicit method do not converge; start nearer to the motion")

    def path(self, state: np.ndarray, period: float, steps: int, units: np.ndarray) -> np.ndarray:
        """States (steps + 1 x 2n) at equal times over a period. Raises `IntegrationError`."""
        now = np.asarray(state, float)
        path, a = [now], self._start(now)
        for k in range(steps):
            now, _, a = self.both(k * period / steps, now, period / steps, a, units, None)
            path.append(now)
        return np.array(path)

    def carried(
        self, state: np.ndarray, period: float, steps: int, units: np.ndarray, resolved: bool
    ) -> tuple[np.ndarray, list[np.ndarray], float]:
        """States as of `path`, what becomes of all variations (2n x 2n) in each of its pieces, and what that is off by
        beside the steps. Where these have `resolved` the fastest mode, variations of some of them are told apart."""
        now, h, pieces, off = np.asarray(state, float), period / steps, [], 0.0
        path, a, reach = [now], self._start(now), 2 * TOGETHER if resolved else self.residual.size
        local = self._compressed(reach)
        for begin in range(0, steps, steps // PIECES):
            k, end, whole = begin, begin + steps // PIECES, np.eye(2 * self.residual.size)
            while k < end:
                count = min(TOGETHER, end - k) if local else end - k
                part, states, ahead = local.begin(units) if local else np.eye(len(whole)), [now], a
                for step in range(k, k + count):
                    after, part, ahead = self.both(step * h, states[-1], h, ahead, units, part)
                    states.append(after)
                part, missed = local.whole(part, units) if local else (part, 0.0)
                if not missed <= TAILS:  # they came farther
                    reach *= 2
                    local = self._compressed(reach)
                    continue
                now, a, k, whole, off = states[-1], ahead, k + count, part @ whole, off + missed
                path += states[1:]
            pieces.append(whole)
        return np.array(path), pieces, off

    def _compressed(self, reach: int) -> Compressed | None:
        """Variations so compressed, None where they are not half as many."""
        n = self.residual.size
        local = None if 2 * reach > n else Compressed(self.table, n, reach)
        return local if local and 2 * local.count < n else None

    def _start(self, state: np.ndarray) -> np.ndarray:
        """The stages (s x n) that a first step begins with."""
        return np.repeat(self.many(np.zeros(1), state[None])[:, self.residual.size :], STAGES, axis=0)

    def both(
        self, t: float, state: np.ndarray, h: float, a: np.ndarray, units: np.ndarray, varied: np.ndarray | None
    ) -> tuple[np.ndarray, Any, np.ndarray]:
        """A state (2n) and variations (2n x k) after a step, and the stages (s x n) that the next begins with."""
        limit.check()
        end, a = self._stepped(t, state, h, a, units)
        return end, None if varied is None else self._varied(t, state, h, a, varied), self._ahead @ a

    def steps(self, state: np.ndarray, period: float) -> tuple[int, float]:
        """As many steps of a period as follow the fastest mode, of driven motions a power of two, and what they are off
        by; infinitely so where that is stiff and there are fewer."""
        n = self.residual.size
        slopes = self._slopes(np.zeros(1), state[None, :n], state[None, n:], np.zeros((1, n)))[:, 0]
        turned = self.linear.fastest(slopes) * period
        wanted, most = (turned / RESOLVED, FINEST) if self.residual.names else (turned, FREE * (1 + 15 * (n <= SMALL)))
        if wanted > most:
            return STEPS, np.inf
        wanted = max(wanted, STEPS)
        steps = int(2 ** np.ceil(np.log2(wanted)) if self.residual.names else PIECES * np.ceil(wanted / PIECES))
        return steps, truncated(turned, steps)

    def decay(self, states: np.ndarray) -> Decay:
        """Of small motions beside one whose states (k + 1 x 2n) are at equal times over its period."""
        harmonics = np.fft.rfft(states[:-1, : self.residual.size].T, axis=1, norm="forward")
        worth, gap = np.abs(harmonics).max(axis=0), np.abs(states[-1] - states[0])[: self.residual.size].max()
        top = int(np.flatnonzero(worth > max(TOLD * worth.max(), gap)).max(initial=1))  # of a jump each is less
        if top > HIGHEST:
            return Decay(0.0, f"it has more than {HIGHEST} harmonics")
        parts = 2 * np.stack([harmonics.real, -harmonics.imag], axis=2)[:, 1 : top + 1]
        vector = np.hstack([harmonics[:, :1].real, parts.reshape(self.residual.size, -1)]).ravel()
        ones, basis = np.ones(self.residual.size), Fourier(orders(top, False))
        problem = Balanced(Pattern(self.residual, basis), ones, np.ones(self.values.size), ones)
        return decay(problem, Coefficients(np.concatenate([vector, self.values])))

    @cached_property
    def _ahead(self) -> np.ndarray:
        """What takes stages of a step to the polynomial's values at those of the next."""
        powers = self.places[:, None] ** np.arange(STAGES)
        return (1 + self.places)[:, None] ** np.arange(STAGES) @ np.linalg.inv(powers)

    def _varied(self, t: float, state: np.ndarray, h: float, a: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """A matrix (2n x k) of variations carried over a step with stages a."""
        n = self.residual.size
        q = state[:n] + h * self.places[:, None] * state[n:] + h**2 * self.square @ a
        slopes = self._slopes(t + h * self.places, q, state[n:] + h * self.inner @ a, a)
        return self.linear.over(h, slopes, whole)


def suits(model: Model, known: int) -> bool:
    """Whether a motion of which so many multipliers are recorded is certified so: driven and free ones of many
    coordinates, or stiff, which have none; but of chains, whose masses are full matrices."""
    plain = model.smooth and model.scalar and model.constraint is None and model.rates is None
    alone = not model.invariants if model.forced else model.conservative and len(model.invariants) == 1
    large = model.degrees_of_freedom > (SMALL if known else 1) and not system_kind(model.system).pendulum
    return bool(plain and alone and large)


def stepped(model: Model, state: np.ndarray, period: float) -> tuple[Implicit, np.ndarray]:
    """The motions from states (2n) for a period, and roughly that from one. Raises `IntegrationError`."""
    residual = Residual(model, cycles=model.forcing_cycles(period))
    motion = Implicit(model, residual, residual.start if model.forced else np.array([0.0, 2 * np.pi / period]))
    return motion, motion.path(state, period, STEPS, np.abs(state) + np.abs(state).max() + SETTLED)


def gathered(model: Model, state: np.ndarray, period: float, damped: bool = False) -> tuple[Recomputed, float]:
    """What `Implicit` says of a state (2n) and a period; and how far half as many steps, those of the variations, end
    elsewhere, in extents. Raises `IntegrationError`.

    Of what is said to be `damped` an energy is asked first. Where it tells, no variation is carried: no multipliers are
    known, the distance to the true orbit is the energy's bound, and A is taken for the least that it can be.
    """
    (motion, rough), n = stepped(model, state, period), model.degrees_of_freedom
    units = extents_of(model, rough, period)
    steps, off = motion.steps(state, period)
    states = motion.path(state, period, 2 * steps, units)
    proof = motion.decay(states) if damped else Decay(0.0)
    if proof.rate > 0:
        coarse, pieces = motion.path(state, period, steps, units), list[np.ndarray]()
    else:
        coarse, pieces, missing = motion.carried(state, period, steps, units, np.isfinite(off))
        off += missing
    missed, kept, sizes = (states[-1] - states[0]) / units, np.zeros((0, 2 * n)), np.abs(states / units)
    flow, rate, conservative = kept, None, symplectic(model)
    if not model.forced:
        flow, kept = motion.many(np.zeros(1), states[:1]) / units, invariant_gradients(model)(states[0]).full() * units
        rate = flow[0] * period
    if proof.rate > 0:
        paces, gap, grown = np.repeat([1.0, motion.pace], n), float(np.abs(missed).max()), max(float(sizes.max()), 1.0)
        off = proof.distance((states[-1] - states[0]) / paces, units / paces)
        closure, scaled = Closure(gap, grown, off, (gap, grown), off), []
        floquet = Floquet(np.zeros(0, complex), 0.0, kept, "asymptotically stable")
    else:
        scaled = [piece * units / units[:, None] for piece in pieces]
        closure = closes(missed, scaled, states / units, rate, kept)
    ended = kept if model.forced else invariant_gradients(model)(states[-1]).full() * units
    loop = Tour(closure, scaled, kept, flow, conservative, units, np.eye(2 * n), ended=ended)
    if not proof.rate > 0:
        floquet = analyse(loop.map(), conservative, off)
    times = np.linspace(0.0, period, len(states))
    seen = Recomputed(
        times, states, units, loop, float(np.abs(states[-1] - states[0]).max()), action(model, times, states),
        energy(model, states[0]), floquet,
    )  # fmt: skip
    return seen, float(np.abs((states[-1] - coarse[-1]) / units).max())


class ImplicitCheck:
    """The closure of orbits of a large structure by `Implicit`, at values of its parameters."""

    def __init__(self, model: Model, names: tuple[str, ...], cycles: int = 1) -> None:
        self.model, self.cycles, self._residual = model, cycles, Residual(model, names, cycles)

    def _at(self, free: Mapping[str, float], period: float = 1.0) -> Implicit:
        values = np.array([free[name] for name in self._residual.names] or [0.0, 2 * np.pi / period])
        return Implicit(with_parameters(self.model, free), self._residual, values)

    def period(self, free: Mapping[str, float]) -> float:
        """Of the motions there."""
        return 2 * float(np.pi) / self._at(free).pace

    def __call__(
        self, state: np.ndarray, period: float, free: Mapping[str, float], units: np.ndarray, allowed: float
    ) -> float:
        """The largest gap after a period, in `units` (2n), by more steps where it is not `allowed`. Raises
        `IntegrationError`."""
        motion, steps, gap = self._at(free, period), STEPS, np.inf
        while gap > allowed and steps <= FINEST:
            path = motion.path(state, period, steps, units)
            gap, steps = float(np.abs((path[-1] - path[0]) / units).max()), 2 * steps
        return gap

    def kept(
        self, state: np.ndarray, period: float, free: Mapping[str, float], units: np.ndarray, along: np.ndarray
    ) -> float:
        """By what share of it a variation (2n) comes back changed after a period, all in `units` (2n)."""
        motion = self._at(free, period)
        begin = along[:, None] / float(np.abs(along / units).max())
        now, back = np.asarray(state, float), begin
        h = period / STEPS
        a = motion._start(now)
        for k in range(STEPS):
            now, back, a = motion.both(k * h, now, h, a, units, back)
        return float(np.abs((back - begin)[:, 0] / units).max())
