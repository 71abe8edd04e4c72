"""An invariant torus as a ring of arcs: a closed curve that the flow over a time T turns by an angle rho.

The curve X(theta) is told by N states at equal angles, N odd, and by its Fourier series between them. The unknowns are
(X, T, rho, freed parameters), of a forced system without T, and the rows

    x_k(T) - X(theta_k + rho)              each arc ends on the curve, turned
    <X - X_ref, f(X_ref)>, 0 if forced     phase of time
    <X - X_ref, dX_ref/dtheta>             phase of the angle
    conditions                             energy or rotation number held, and the aim that picks one torus

X_ref is the guess. Of a conservative system the rows of the arcs are dependent (by the energy, and by the area that the
curve encloses): they are solved in the sense of least squares, which have one solution, and whose rows vanish where
there is a torus.
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

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.problem import plane, solved
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import Varied
from orbitfinder.loops.loop import Equations, Unknowns
from orbitfinder.mechanics.newton import Settings

T = TypeVar("T")
CORRECTOR = Settings(floor=3e-13, round_off=3e-13, converged=1e-10, most_evaluations=16)
"""How a torus is solved: rows in units of the motion"""
RESOLVED = 1e-11
"""What the highest harmonics may be of the curve's size"""


@lru_cache(maxsize=64)
def harmonics(count: int) -> np.ndarray:
    """The wave numbers (N) of a Fourier series over N angles, N odd: -(N-1)/2 ... (N-1)/2."""
    return np.arange(count) - count // 2


def coefficients(curve: np.ndarray) -> np.ndarray:
    """c_k (N x d) of X(theta) = sum_k c_k e^(i k theta), in the order of `harmonics`."""
    return np.fft.fftshift(np.fft.fft(curve, axis=0), axes=0) / len(curve)


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
    turn, slope = (np.fft.ifft(np.fft.ifftshift(factors)).real for factors in (kernel, 1j * waves * kernel))
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


@dataclass(frozen=True, eq=False)
class Circle:
    """The rows of a torus, in units of the motion (d), of time and of the freed parameters.

    `held` are values of "energy", "rotation" (rho, in rad) or freed parameters by name; `steps` the Runge-Kutta steps
    of an arc, `most_steps` at most. A continuation problem, whose curves have as many states as their series needs,
    `most` at most.
    """

    equations: Equations
    units: np.ndarray
    clock: float
    sizes: np.ndarray
    held: tuple[tuple[str, float], ...] = ()
    steps: int = 32
    most: int = 151
    most_steps: int = 4096
    settings: Settings = CORRECTOR

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
        """Weights of the unknowns in arclength: a mean over the curve, and the rest as they are."""
        weights = np.concatenate([np.full(w.curve.size, 1.0 / len(w.curve)), np.ones(2 + w.free.size)])
        columns = self.columns(w)
        return np.asarray(np.divide(weights, columns**2, out=np.zeros(columns.size), where=columns > 0))

    def rates(self, w: Turned) -> np.ndarray:
        """dx/dt (N x d) where arcs begin, in units of the motion."""
        return np.asarray(self.equations.march.rates(w.curve, self.tail(w)) / self.units)

    def rows(self, w: Turned) -> np.ndarray:
        """All rows, in units of the motion. Raises `ConvergenceError`."""
        return self._rows(w, self._marched(w, self.equations.march.ends))

    def _rows(self, w: Turned, ends: np.ndarray) -> np.ndarray:
        turn, _ = turning(len(w.curve), w.angle)
        arcs = (ends - turn @ w.curve) / self.units
        return np.concatenate([arcs.ravel(), [self.aim(w, *held)[0] for held in self.held]])

    def linearise(self, w: Turned) -> tuple[np.ndarray, Factored]:
        """All rows and their derivatives, by one march. Raises `ConvergenceError`."""
        path = self._marched(w, self.equations.march.varied)
        return self._rows(w, path.ends), Factored(self.jacobian(w, path), self.columns(w))

    def jacobian(self, w: Turned, path: Varied) -> np.ndarray:
        """The derivatives of all rows by all unknowns, both measured."""
        (count, size), own = w.curve.shape, self.columns(w)
        cut = w.curve.size
        matrix = np.zeros((cut + len(self.held), own.size))
        turn, by_angle = turning(count, w.angle)
        arcs = matrix[:cut].reshape(count, size, -1)
        arcs[:, :, :cut] = -np.einsum("kl,ij->kilj", turn, np.eye(size)).reshape(count, size, cut)
        for k in range(count):
            arcs[k, :, k * size : (k + 1) * size] += path.transitions[k]
        arcs[:, :, cut] = path.columns[:, :, 0]
        arcs[:, :, cut + 1] = -by_angle @ w.curve
        arcs[:, :, cut + 2 :] = path.columns[:, :, 1 + self.equations.march.unfolding :]
        arcs *= own / self.units[:, None]
        for k, aim in enumerate(self.held, start=cut):
            matrix[k] = self.aim(w, *aim)[1] * own
        return matrix

    def phases(self, w: Turned) -> np.ndarray:
        """Rows over w that fix time (unless forced) and angle, of length 1 over the measured curve."""
        places = 2 * np.pi * np.arange(len(w.curve)) / len(w.curve)
        along = at_angles(w.curve, places, derivative=True) / self.units
        chosen = [along] if self.forced else [self.rates(w), along]
        rows = [(direction / self.units / nonzero(float(np.linalg.norm(direction)))).ravel() for direction in chosen]
        return np.pad(rows, ((0, 0), (0, 2 + w.free.size)))

    def aim(self, w: Turned, name: str, value: float) -> tuple[float, np.ndarray]:
        """How far what may be held is from a value, measured, and what that changes by over w."""
        p, first, slope = self.equations, w.curve[:1], np.zeros(w.vector.size)
        if name != "energy":
            place = w.curve.size + (1 if name == "rotation" else 2 + p.free.index(name))
            slope[place] = 1.0 / (1.0 if name == "rotation" else self.sizes[place - w.curve.size - 2])
            return float((w.vector[place] - value) * slope[place]), slope
        values, by_state, by_free = p.quantities_at(Unknowns(first, w.period, np.zeros(0), w.free, np.zeros(2)))
        slope[: first.size], slope[w.curve.size + 2 :] = by_state[p.energy], by_free[p.energy]
        size = nonzero(float(np.linalg.norm(by_state[p.energy] * self.units)))
        return float(values[p.energy] - value) / size, slope / size

    def value(self, w: Turned, name: str) -> float:
        """What may be held: the energy (J) where the curve begins, the angle (rad), or a freed parameter."""
        if name == "rotation":
            return w.angle
        p = self.equations
        if name in p.free:
            return float(w.free[p.free.index(name)])
        values, _, _ = p.quantities_at(Unknowns(w.curve[:1], w.period, np.zeros(0), w.free, np.zeros(2)))
        return float(values[p.energy])

    def at(self, w: Turned, tangent: np.ndarray) -> tuple[Circle, Turned, np.ndarray]:
        """The ring with as many steps as a torus that was met needs, and the torus with as many states.

        Raises `ConvergenceError` where that is more than `most`.
        """
        while (size := unresolved(w.curve / self.units)) > RESOLVED:
            count = 3 * len(w.curve) // 4 * 2 + 1
            if count > self.most:
                raise ConvergenceError(
                    f"the highest harmonics of {len(w.curve)} states are {size:.2g} of the curve; more than "
                    f"{self.most} states are needed"
                )
            along = resampled(tangent[: w.curve.size].reshape(w.curve.shape), count)
            direction, finer = np.concatenate([along.ravel(), tangent[w.curve.size :]]), w.on(count)
            point = solved(self, finer, plane(self, finer, direction))
            w, tangent = point.w, point.tangent if point.inner(direction) >= 0 else -point.tangent
        return self.confirmed(w), w, tangent

    def carried(self, w: Turned, onto: Turned) -> Turned:
        """w with as many states as another."""
        return w if len(w.curve) == len(onto.curve) else w.on(len(onto.curve))

    def _marched(self, w: Turned, march: Callable[[np.ndarray, np.ndarray, np.ndarray], T]) -> T:
        if not (np.isfinite(w.vector).all() and w.period > 0):
            raise ConvergenceError("no torus found near: the iteration leaves all numbers")
        try:
            return march(w.curve, self.mesh(len(w.curve)), self.tail(w))
        except IntegrationError as error:
            raise ConvergenceError(f"no torus found near: {error}") from error

    def confirmed(self, w: Turned) -> Circle:
        """The ring with as many steps of an arc as twice as many confirm. Raises `ConvergenceError`."""
        ring = self
        while ring.steps <= self.most_steps:
            ends = [self.equations.march.ends(w.curve, ring.mesh(len(w.curve), k), self.tail(w)) for k in (1, 2)]
            if np.abs((ends[0] - ends[1]) / self.units).max() <= 1e-12:  # what arcs by twice the steps end apart
                return ring
            ring = replace(ring, steps=2 * ring.steps)
        raise ConvergenceError(f"the motion on this torus needs more than {self.most_steps} steps a return")


def spectrum(curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The orders of a curve's harmonics and their sizes."""
    return np.abs(harmonics(len(curve))), np.abs(coefficients(curve)).max(axis=1)


def unresolved(curve: np.ndarray) -> float:
    """The largest of the highest sixth of the harmonics, relative to the largest of all but the mean."""
    waves, sizes = spectrum(curve)
    return float(sizes[waves > 5 * waves.max() // 6].max() / nonzero(sizes[waves > 0].max()))


class Factored:
    """A measured Jacobian; a row that closes it makes the triangle R of their QR (its Q is never made).

    That solves best for any rows: x = R^-1 R^-T A^T b and one correction: A. Bjorck, Linear Algebra and its
    Applications 88/89 (1987) 31-48.
    """

    def __init__(self, matrix: np.ndarray, columns: np.ndarray) -> None:
        self.known, self.columns = columns > 0, columns
        self.matrix = matrix[:, self.known]

    def closed(self, rows: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """The step over w that takes rows to 0, nothing of a time that is given.

        Raises `ConvergenceError` where there are several: a resonance, or a curve that is an orbit.
        """
        matrix = np.vstack([self.matrix, (rows * self.columns)[:, self.known]])
        (triangle,) = scipy.linalg.qr(matrix, mode="r", check_finite=False)
        triangle = triangle[: matrix.shape[1]]
        sizes = np.abs(np.diag(triangle))
        if not sizes.min() > 1e-11 * sizes.max():  # a pivot this small leaves unknowns undetermined
            raise ConvergenceError(
                "a torus is not determined there: its rotation number is resonant, or its curve is that of an orbit"
            )

        def best(rows: np.ndarray) -> np.ndarray:
            half = scipy.linalg.solve_triangular(triangle, matrix.T @ rows, trans="T", check_finite=False)
            return np.asarray(scipy.linalg.solve_triangular(triangle, half, check_finite=False))

        def step(rows: np.ndarray) -> np.ndarray:
            first, whole = best(rows), np.zeros(self.columns.size)
            whole[self.known] = -(first + best(rows - matrix @ first))
            return np.asarray(whole * self.columns)

        return step
