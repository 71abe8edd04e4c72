"""An invariant torus as a ring of arcs: a closed curve that the flow over a time T turns by an angle rho.

The curve X(theta) is told by N states at equal angles, N odd, and by its Fourier series between them. The unknowns are
(X, T, rho, freed parameters), of a forced system without T, and the rows

    x_k(T) - X(theta_k + rho)              each arc ends on the curve, turned
    <X - X_ref, f(X_ref)>, 0 if forced     phase of time
    <X - X_ref, dX_ref/dtheta>             phase of the angle
    conditions                             energy or rotation number held, and the aim that picks one torus

Of a conservative system the rows of the arcs are dependent (by the energy, and by the area that the curve encloses):
they are solved in the sense of least squares, which have one solution, and whose rows vanish where there is a torus.
Source: Z. P. Olikara and D. J. Scheeres, "Numerical method for computing quasi-periodic orbits and their stability in
the restricted three-body problem", Advances in the Astronautical Sciences 145 (2012) 911-930.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TypeVar

import numpy as np
import scipy.linalg

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import Varied
from orbitfinder.loops.loop import Equations, Unknowns

T = TypeVar("T")
STEPS = 16
"""Steps of Newton's method at most"""
CONTRACTION = 0.1
"""A step that reduces the rows by less asks for a new Jacobian"""
CONVERGED = 3e-13
"""Largest row, in units of the motion, at which a torus is solved"""
ROUGH = 1e-10
"""Rows below this that a fresh Jacobian does not reduce are round-off"""
CONFIRMED = 1e-12
"""What arcs by twice the steps may end apart, in units of the motion"""
DETERMINED = 1e-11
"""Pivots this small beside the largest leave unknowns undetermined"""
MOST_STEPS = 4096
"""Steps of an arc at most"""


@lru_cache(maxsize=64)
def harmonics(count: int) -> np.ndarray:
    """The wave numbers (N) of a Fourier series over N angles, N odd: -(N-1)/2 ... (N-1)/2."""
    return np.arange(count) - count // 2


def coefficients(curve: np.ndarray) -> np.ndarray:
    """c_k (N x d) of X(theta) = sum_k c_k e^(i k theta), in the order of `harmonics`."""
    return np.asarray(np.fft.fftshift(np.fft.fft(curve, axis=0), axes=0) / len(curve))


def at_angles(curve: np.ndarray, angles: np.ndarray, derivative: bool = False) -> np.ndarray:
    """X (or dX/dtheta) at any angles (m): m x d."""
    waves = harmonics(len(curve))
    factors = 1j * waves if derivative else np.ones(waves.size)
    return np.asarray((np.exp(1j * np.outer(angles, waves)) * factors @ coefficients(curve)).real)


def resampled(curve: np.ndarray, count: int) -> np.ndarray:
    """The same curve at another odd number of equal angles."""
    return at_angles(curve, 2 * np.pi * np.arange(count) / count)


def turning(count: int, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """R (N x N), which turns a curve's states by an angle, and dR/d(angle); both circulant."""
    waves = harmonics(count)
    kernel = np.exp(1j * waves * angle)
    turn, slope = (np.fft.ifft(np.fft.ifftshift(one)).real for one in (kernel, 1j * waves * kernel))
    return scipy.linalg.circulant(turn), scipy.linalg.circulant(slope)


@dataclass(frozen=True)
class Turned:
    """A curve (N x d), the time T of a return (s), the angle rho that a return turns it by, freed parameters."""

    curve: np.ndarray
    period: float
    angle: float
    free: np.ndarray

    @property
    def vector(self) -> np.ndarray:
        """(X, T, rho, free) as one vector."""
        return np.concatenate([self.curve.ravel(), [self.period, self.angle], self.free])

    def moved(self, step: np.ndarray) -> Turned:
        """The same after a step over (X, T, rho, free)."""
        vector, cut = self.vector + step, self.curve.size
        return Turned(vector[:cut].reshape(self.curve.shape), float(vector[cut]), float(vector[cut + 1]),
                      vector[cut + 2 :])  # fmt: skip

    def on(self, count: int) -> Turned:
        """The same at another odd number of angles."""
        return replace(self, curve=resampled(self.curve, count))


@dataclass(frozen=True)
class Aim:
    """One row more: `row` (over X, T, rho, free, in the ring's units) times the step from `origin` is `value`."""

    row: np.ndarray
    origin: np.ndarray
    value: float


@dataclass(frozen=True, eq=False)
class Ring:
    """The rows of a torus and their solution, in units of the motion (d), of time and of the freed parameters.

    `held` are values of "energy", "rotation" (rho, in rad) or freed parameters by name; `steps` the Runge-Kutta steps
    of an arc.
    """

    equations: Equations
    units: np.ndarray
    clock: float
    sizes: np.ndarray
    held: tuple[tuple[str, float], ...] = ()
    steps: int = 32

    @property
    def forced(self) -> bool:
        """Whether the time of a return is that of the forcing."""
        return self.equations.model.forced

    def tail(self, w: Turned) -> np.ndarray:
        """(T, s, free) of the march, nothing unfolded."""
        return np.concatenate([[w.period], np.zeros(self.equations.march.unfolding), w.free])

    def mesh(self, count: int, times: int = 1) -> np.ndarray:
        """One return for each arc, one arc after another: what is forced begins at the same phase."""
        return np.linspace(0.0, count, count * self.steps * times + 1)

    def columns(self, w: Turned) -> np.ndarray:
        """What the unknowns are measured in, 0 for a time that is given."""
        states = np.tile(self.units, len(w.curve))
        return np.concatenate([states, [0.0 if self.forced else self.clock, 1.0], self.sizes])

    def metric(self, w: Turned) -> np.ndarray:
        """Weights of the unknowns in arclength, in these units: a mean over the curve, and the rest as they are."""
        weights = np.concatenate([np.full(w.curve.size, 1.0 / len(w.curve)), np.ones(2 + w.free.size)])
        return weights * (self.columns(w) > 0)

    def rates(self, w: Turned) -> np.ndarray:
        """dx/dt (N x d) where arcs begin, in units of the motion."""
        return np.asarray(self.equations.march.rates(w.curve, self.tail(w)) / self.units)

    def rows(self, w: Turned, reference: Turned, ends: np.ndarray, aims: tuple[Aim, ...]) -> np.ndarray:
        """All rows, in units of the motion."""
        turn, _ = turning(len(w.curve), w.angle)
        arcs = (ends - turn @ w.curve) / self.units
        away = ((w.curve - reference.curve) / self.units).ravel()
        phases = [float(one @ away) for one in self._phases(reference)]
        named = [self._held(w, *one)[0] for one in self.held]
        columns = self.columns(w)
        measured = np.divide(w.vector, columns, out=np.zeros(columns.size), where=columns > 0)
        aimed = [float(one.row @ (measured - one.origin)) - one.value for one in aims]
        return np.concatenate([arcs.ravel(), phases, named, aimed])

    def jacobian(self, w: Turned, reference: Turned, path: Varied, aims: tuple[Aim, ...]) -> np.ndarray:
        """The derivatives of all rows by all unknowns, both measured."""
        (count, size), own = w.curve.shape, self.columns(w)
        phases, cut = self._phases(reference), w.curve.size
        found = np.zeros((cut + len(phases) + len(self.held) + len(aims), own.size))
        turn, by_angle = turning(count, w.angle)
        arcs = found[:cut].reshape(count, size, -1)
        arcs[:, :, :cut] = -np.einsum("kl,ij->kilj", turn, np.eye(size)).reshape(count, size, cut)
        for k in range(count):
            arcs[k, :, k * size : (k + 1) * size] += path.transitions[k]
        arcs[:, :, cut] = path.columns[:, :, 0]
        arcs[:, :, cut + 1] = -by_angle @ w.curve
        arcs[:, :, cut + 2 :] = path.columns[:, :, 1 + self.equations.march.unfolding :]
        arcs *= own / self.units[:, None]
        found[cut : cut + len(phases), :cut] = phases
        others = [self._held(w, *one)[1] * own for one in self.held] + [one.row for one in aims]
        found[cut + len(phases) :] = np.reshape(others, (len(others), own.size))
        return found

    def _phases(self, reference: Turned) -> list[np.ndarray]:
        """Unit rows over the measured curve that fix time (unless forced) and angle."""
        places = 2 * np.pi * np.arange(len(reference.curve)) / len(reference.curve)
        along = at_angles(reference.curve, places, derivative=True) / self.units
        chosen = [along] if self.forced else [self.rates(reference), along]
        return [one.ravel() / max(float(np.linalg.norm(one)), 1e-300) for one in chosen]

    def _held(self, w: Turned, name: str, value: float) -> tuple[float, np.ndarray]:
        """The row of what is held and its derivatives by the unknowns."""
        p, first, slope = self.equations, w.curve[:1], np.zeros(w.vector.size)
        if name != "energy":
            place = w.curve.size + (1 if name == "rotation" else 2 + p.free.index(name))
            slope[place] = 1.0 / (1.0 if name == "rotation" else self.sizes[place - w.curve.size - 2])
            return float((w.vector[place] - value) * slope[place]), slope
        found, by_state, by_free = p.quantities_at(Unknowns(first, w.period, np.zeros(0), w.free, np.zeros(2)))
        slope[: first.size], slope[w.curve.size + 2 :] = by_state[p.energy], by_free[p.energy]
        size = max(float(np.linalg.norm(by_state[p.energy] * self.units)), 1e-300)
        return float(found[p.energy] - value) / size, slope / size

    def value(self, w: Turned, name: str) -> float:
        """What may be held: the energy (J) where the curve begins, the angle (rad), or a freed parameter."""
        if name == "rotation":
            return w.angle
        p = self.equations
        if name in p.free:
            return float(w.free[p.free.index(name)])
        values, _, _ = p.quantities_at(Unknowns(w.curve[:1], w.period, np.zeros(0), w.free, np.zeros(2)))
        return float(values[p.energy])

    def solved(self, w: Turned, aims: tuple[Aim, ...]) -> tuple[Turned, int, Factored]:
        """The torus near w, the steps that it took, and the last factors: Newton's method, a Jacobian kept as long as
        it contracts.

        Raises `ConvergenceError`, also where the unknowns are not determined: a resonance, or a curve that is an orbit.
        """
        reference, best, factors, fresh = w, np.inf, None, False
        for k in range(STEPS):
            rows = self.rows(w, reference, self._marched(w, self.equations.march.ends), aims)
            size = float(np.abs(rows).max())
            if not np.isfinite(size) or size > 1e3 * max(best, CONVERGED):
                break
            done = size <= CONVERGED or (fresh and size < ROUGH and size > CONTRACTION * best)
            if factors is None or (not done and size > CONTRACTION * best):
                path = self._marched(w, self.equations.march.varied)
                factors, fresh = Factored(self.jacobian(w, reference, path, aims), self.columns(w)), True
            else:
                fresh = False
            if done:
                return w, k, factors
            best = min(best, size)
            w = w.moved(factors.step(-rows) * self.columns(w))
        raise ConvergenceError(f"no torus found near (rows of {size:.2g} after {k + 1} iterations)")

    def _marched(self, w: Turned, march: Callable[[np.ndarray, np.ndarray, np.ndarray], T]) -> T:
        if not (np.isfinite(w.vector).all() and w.period > 0):
            raise ConvergenceError("no torus found near: the iteration leaves all numbers")
        try:
            return march(w.curve, self.mesh(len(w.curve)), self.tail(w))
        except IntegrationError as error:
            raise ConvergenceError(f"no torus found near: {error}") from error

    def confirmed(self, w: Turned) -> Ring:
        """The ring with as many steps of an arc as twice as many confirm. Raises `ConvergenceError`."""
        ring = self
        while ring.steps <= MOST_STEPS:
            ends = [self.equations.march.ends(w.curve, ring.mesh(len(w.curve), k), self.tail(w)) for k in (1, 2)]
            if np.abs((ends[0] - ends[1]) / self.units).max() <= CONFIRMED:
                return ring
            ring = replace(ring, steps=2 * ring.steps)
        raise ConvergenceError(f"the motion on this torus needs more than {MOST_STEPS} steps a return")


class Factored:
    """The triangle R of a Jacobian's QR (its Q is never made), which solves measured rows best for any rows.

    x = R^-1 R^-T A^T b and one correction: A. Bjorck, Linear Algebra and its Applications 88/89 (1987) 31-48. Raises
    `ConvergenceError` where there are several solutions.
    """

    def __init__(self, matrix: np.ndarray, columns: np.ndarray) -> None:
        self.known = columns > 0
        self.matrix = matrix[:, self.known]
        (self.triangle,) = scipy.linalg.qr(self.matrix, mode="r", check_finite=False)
        self.triangle = self.triangle[: self.matrix.shape[1]]
        sizes = np.abs(np.diag(self.triangle))
        if not sizes.min() > DETERMINED * sizes.max():
            raise ConvergenceError(
                "a torus is not determined there: its rotation number is resonant, or its curve is that of an orbit"
            )

    def step(self, rows: np.ndarray) -> np.ndarray:
        """The measured step for measured rows, 0 for a time that is given."""
        found = self._solved(rows)
        step = np.zeros(self.known.size)
        step[self.known] = found + self._solved(rows - self.matrix @ found)
        return step

    def _solved(self, rows: np.ndarray) -> np.ndarray:
        half = scipy.linalg.solve_triangular(self.triangle, self.matrix.T @ rows, trans="T", check_finite=False)
        return np.asarray(scipy.linalg.solve_triangular(self.triangle, half, check_finite=False))
