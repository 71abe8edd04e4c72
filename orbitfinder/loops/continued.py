"""The equations of a family and their corrector: shooting rows, one aim, Newton, tangent.

The unknowns are w = (nodes, T, s, freed parameters), and only this file knows that order. The rows
are continuity, boundary, phase, held invariants and last the aim that picks one orbit of the family;
without the aim the Jacobian has a one-dimensional kernel, the tangent of the family (Muñoz-Almaraz
et al., Physica D 181 (2003) 1-38).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.loops.graded import March, Propagator, glide, invariants_at, march, rate_at
from orbitfinder.loops.linear import Broyden, Factors

NEWTON_READY = 1e-11
"""Residual, in units of the metric, from which one more Newton step, not evaluated again, reaches round-off."""
APPROACHED = 3e-7
"""Residual at which the approach with an old Jacobian hands over to Newton's method."""
FITTING = 1e-4
"""Residual below which an orbit is known well enough to fit a mesh to it."""
FEWEST_STEPS = 16
"""Steps of a segment from which on the approach takes only half of them."""
NEWTON_FLOOR = 1e-9
"""... or below this, where round-off on an unstable orbit keeps the residual from shrinking further."""
MOST_NEWTON = 12


@dataclass(frozen=True, eq=False)
class Curve:
    """One family's equations: `first` x(0) + `last` x(end) = `constant`, held invariants, metric.

    `weights` measures a head (x(0), T, free): angles count as they are, lengths without angles relative
    to the starting orbit, rates by its time scale, period and parameters relative to their starting values.
    """

    propagator: Propagator
    first: np.ndarray
    last: np.ndarray
    constant: np.ndarray
    held: tuple[tuple[int, float], ...]
    weights: np.ndarray
    period: float | None = None
    """the period, where it is held"""


@dataclass(frozen=True)
class Place:
    """A point of the space of unknowns: nodes (N x 2n) at every M/N-th of the `mesh`, T, s, free."""

    nodes: np.ndarray
    period: float
    unfolding: np.ndarray
    free: np.ndarray
    mesh: np.ndarray

    @property
    def head(self) -> np.ndarray:
        """(x(0), T, free): what identifies the orbit, whatever the number of segments."""
        return np.concatenate([self.nodes[0], [self.period], self.free])

    @property
    def edges(self) -> np.ndarray:
        """Where the segments begin and end (N + 1), in periods."""
        return self.mesh[:: (self.mesh.size - 1) // len(self.nodes)]

    @property
    def tail(self) -> np.ndarray:
        """(T, s, free), the parameters of the flow."""
        return np.concatenate([[self.period], self.unfolding, self.free])


@dataclass(frozen=True)
class Aim:
    """The last row: `normal`.head = `value`, or the invariant number `invariant` (-1: the energy) = `value`."""

    value: float
    normal: np.ndarray | None = None
    invariant: int = -1


@dataclass(frozen=True)
class Solution:
    """A corrected place with the integration it came from and the Jacobian of all rows but the aim."""

    place: Place
    march: March
    jacobian: np.ndarray
    iterations: int
    residual: float


def make_curve(
    propagator: Propagator,
    constant: np.ndarray,
    head: np.ndarray,
    held: tuple[tuple[int, float], ...] = (),
    unit: float = 1.0,
) -> Curve:
    """The curve through (or near) a head; its metric is fixed there once for the whole family.

    `unit` is what coordinates are measured in (see `scale.length`).
    """
    n, size = propagator.size // 2, propagator.size
    period, free = head[size], head[size + 1 :]
    clock = (period / (2 * np.pi)) ** 2
    relative = 1.0 / np.maximum(np.abs(free), 1e-3) ** 2
    weights = np.concatenate([np.ones(n) / unit**2, np.full(n, clock) / unit**2, [1.0 / period**2], relative])
    return Curve(propagator, *propagator.symmetry.rows(n), constant, held, weights)


def phase_rows(curve: Curve, reference: Place) -> np.ndarray:
    """Unit normals (k x 2n) of the hyperplanes through the reference that fix time and other symmetries."""
    p, size = curve.propagator, curve.propagator.size
    x, found = reference.nodes[0], []
    if not p.symmetry.reverses:
        found.append(rate_at(p, x, reference.unfolding, reference.free))
    values = p.model.parameter_values
    found += [one(x[: size // 2], x[size // 2 :], values).full().ravel() for one in p.phases]
    rows = np.asarray(found).reshape(len(found), size)
    return np.asarray(rows / np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), 1e-300))


def _rows(curve: Curve, place: Place, ends: np.ndarray, phases: np.ndarray, reference: Place) -> np.ndarray:
    """All rows but the aim."""
    nodes = place.nodes
    rows = [(ends[:-1] - nodes[1:]).ravel(), curve.first @ nodes[0] + curve.last @ ends[-1] - curve.constant]
    rows.append(phases @ (nodes[0] - reference.nodes[0]))
    if curve.held:
        values = invariants_at(curve.propagator, nodes[0], place.free)[0]
        rows.append(np.array([values[k] - value for k, value in curve.held]))
    if curve.period is not None:
        rows.append(np.array([place.period - curve.period]))
    return np.concatenate(rows)


def _jacobian(curve: Curve, place: Place, path: March, phases: np.ndarray) -> np.ndarray:
    """Derivative of `_rows`; the period's columns follow from dx(end)/dT = (span of the segment) f(end)."""
    p, (count, size) = curve.propagator, place.nodes.shape
    cut, extra = count * size, p.columns - size
    edges = place.edges
    others = len(phases) + len(curve.held)
    matrix = np.zeros((cut + others + (curve.period is not None), cut + 1 + extra))
    for k in range(count):
        rate = rate_at(p, path.ends[k], place.unfolding, place.free)
        block = np.column_stack([path.sensitivities[k], rate * (edges[k + 1] - edges[k])])
        left = np.eye(size) if k < count - 1 else curve.last
        rows = slice(k * size, (k + 1) * size)
        block = left @ block
        matrix[rows, k * size : (k + 1) * size] = block[:, :size]
        matrix[rows, cut] = block[:, -1]
        matrix[rows, cut + 1 :] = block[:, size:-1]
        if k < count - 1:
            matrix[rows, (k + 1) * size : (k + 2) * size] = -np.eye(size)
    matrix[cut - size : cut, :size] += curve.first
    matrix[cut : cut + len(phases), :size] = phases
    if curve.held:
        _, slope, free = invariants_at(p, place.nodes[0], place.free)
        chosen = [k for k, _ in curve.held]
        matrix[cut + len(phases) : cut + others, :size] = slope[chosen]
        matrix[cut + len(phases) : cut + others, matrix.shape[1] - free.shape[1] :] = free[chosen]
    if curve.period is not None:
        matrix[-1, cut] = 1.0
    return matrix


def _spread(head: np.ndarray, place: Place) -> np.ndarray:
    """A row over w out of a row over the head (x(0), T, free)."""
    count, size = place.nodes.shape
    row = np.zeros(count * size + 1 + place.unfolding.size + place.free.size)
    row[:size] = head[:size]
    row[count * size] = head[size]
    row[row.size - place.free.size :] = head[size + 1 :]
    return row


def _row_units(curve: Curve, place: Place, phases: np.ndarray, aim: Aim) -> np.ndarray:
    """What each row is measured in, the aim's last, when every unknown is measured as the family's metric does."""
    size, head = curve.propagator.size, 1.0 / np.sqrt(curve.weights)
    unit = head[:size]
    boundary = np.maximum(np.abs(curve.first) * unit, np.abs(curve.last) * unit).max(axis=1)
    slopes = np.linalg.norm(invariants_at(curve.propagator, place.nodes[0], place.free)[1] * unit, axis=1)
    units = [np.tile(unit, len(place.nodes) - 1), boundary, np.linalg.norm(phases * unit, axis=1)]
    units += [slopes[[k for k, _ in curve.held]], np.full(int(curve.period is not None), head[size])]
    last = slopes[aim.invariant] if aim.normal is None else np.linalg.norm(aim.normal * head)
    return np.maximum(np.concatenate([*units, [last]]), 1e-300)


def _aim(curve: Curve, place: Place, aim: Aim) -> tuple[float, np.ndarray]:
    if aim.normal is not None:
        return float(aim.normal @ place.head - aim.value), _spread(aim.normal, place)
    value, slope, free = invariants_at(curve.propagator, place.nodes[0], place.free)
    k = aim.invariant
    return float(value[k] - aim.value), _spread(np.concatenate([slope[k], [0.0], free[k]]), place)


def _moved(place: Place, step: np.ndarray) -> Place:
    count, size = place.nodes.shape
    cut, last = count * size, step.size - place.free.size
    return replace(
        place,
        nodes=place.nodes + step[:cut].reshape(count, size),
        period=place.period + float(step[cut]),
        unfolding=place.unfolding + step[cut + 1 : last],
        free=place.free + step[last:],
    )


def _approached(curve: Curve, guess: Place, aim: Aim, phases: np.ndarray, reference: Place, slope: np.ndarray) -> Place:
    """The guess improved by Broyden's method on marches of the state alone, in long steps, from the Jacobian `slope`.

    Stops where a step no longer helps.
    """
    steps = (guess.mesh.size - 1) // len(guess.nodes)
    place, best = replace(guess, mesh=guess.mesh[:: 2 if steps % 2 == 0 and steps >= FEWEST_STEPS else 1]), np.inf
    matrix = np.vstack([slope, np.zeros((1, slope.shape[1]))])
    cut, size = guess.nodes.size, curve.propagator.size
    matrix[cut : cut + len(phases), :size] = phases
    matrix[-1] = _aim(curve, guess, aim)[1]
    kept, units = guess, _row_units(curve, guess, phases, aim)
    try:
        method = Broyden(Factors(matrix))
    except np.linalg.LinAlgError:
        return guess
    for _ in range(MOST_NEWTON):
        ends = glide(curve.propagator, place.nodes, place.mesh, place.tail)
        rows = np.append(_rows(curve, place, ends, phases, reference), _aim(curve, place, aim)[0])
        largest = float(np.abs(rows / units).max())
        if not largest < 0.5 * best:
            break
        kept, best = place, largest
        if largest < APPROACHED:
            break
        place = _moved(place, method.step(rows))
    return replace(kept, mesh=guess.mesh)


def correct(
    curve: Curve,
    guess: Place,
    aim: Aim,
    reference: Place | None = None,
    reach: float = 1.0,
    slope: np.ndarray | None = None,
    fit: Callable[[Curve, Solution], np.ndarray] | None = None,
) -> Solution:
    """Newton from a guess onto the family where the aim is met.

    `reference` carries the phase condition; `reach` bounds how far (in the family's metric) the
    result may be from the guess; `slope` is the Jacobian of an orbit nearby over the same segments, with
    which most of the way is cheap; `fit` gives a better mesh over these segments once the orbit is nearly
    known. Raises `ConvergenceError` or `IntegrationError`.
    """
    reference = reference or guess
    phases = phase_rows(curve, reference)
    place, previous, units = guess, np.inf, _row_units(curve, guess, phases, aim)
    if slope is not None:
        place = _approached(curve, guess, aim, phases, reference, slope)
    for iteration in range(MOST_NEWTON):
        path = march(curve.propagator, place.nodes, place.mesh, place.tail)
        missed, last = _aim(curve, place, aim)
        rows = np.append(_rows(curve, place, path.ends, phases, reference), missed)
        jacobian = _jacobian(curve, place, path, phases)
        largest = float(np.abs(rows / units).max())
        ready = largest < NEWTON_READY or (largest < NEWTON_FLOOR and largest > 0.1 * previous)
        if not np.isfinite(largest) or (iteration > 2 and largest > 0.5 * previous and not ready):
            raise ConvergenceError(f"the corrector stalled at a residual of {largest:.2g}; take a smaller step")
        if not np.all(np.isfinite(jacobian)):
            raise ConvergenceError("the variations of the corrector's orbit overflow; take a smaller step")
        try:
            step = -Factors(np.vstack([jacobian, last])).solve(rows)
        except np.linalg.LinAlgError:
            step = np.linalg.lstsq(np.vstack([jacobian, last]), -rows, rcond=1e-12)[0]
        moved = _moved(place, step)
        if ready:
            return Solution(moved, path, jacobian, iteration, largest)
        if not distance(curve, moved.head, guess.head) < reach or not moved.period > 0:
            raise ConvergenceError("the corrector left the neighbourhood of its guess; take a smaller step")
        if fit is not None and largest < FITTING:
            moved = replace(moved, mesh=fit(curve, Solution(place, path, jacobian, iteration, largest)))
            fit = None
        place, previous = moved, largest
    raise ConvergenceError(f"the corrector did not finish in {MOST_NEWTON} steps; take a smaller step")


def scaled(curve: Curve, found: Solution) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian of all rows but the aim in units of the metric, and those of its columns."""
    place, size = found.place, curve.propagator.size
    head = 1.0 / np.sqrt(curve.weights)
    nodes, damping = np.tile(head[:size], len(place.nodes)), np.full(place.unfolding.size, 1.0 / place.period)
    columns = np.concatenate([nodes, [head[size]], damping, head[size + 1 :]])
    rows = _row_units(curve, place, phase_rows(curve, place), Aim(0.0))[:-1]
    return found.jacobian * columns / rows[:, None], columns


def distance(curve: Curve, one: np.ndarray, other: np.ndarray) -> float:
    """Distance of two heads in the family's metric."""
    return float(np.sqrt(curve.weights @ (one - other) ** 2))


def tangent(curve: Curve, found: Solution, along: np.ndarray) -> np.ndarray:
    """The family's direction over all of w, of unit length in its head, with along^T W head > 0."""
    row = _spread(curve.weights * along, found.place)
    right = np.zeros(len(found.jacobian) + 1)
    right[-1] = 1.0
    whole = Factors(np.vstack([found.jacobian, row])).solve(right)
    length = np.sqrt(curve.weights @ head_of(whole, found.place) ** 2)
    return np.asarray(whole / length)


def kernel(curve: Curve, found: Solution) -> np.ndarray:
    """The same without a direction to go by: the right singular vector of the smallest singular value."""
    whole = np.linalg.svd(found.jacobian)[2][-1]
    return np.asarray(whole / np.sqrt(curve.weights @ head_of(whole, found.place) ** 2))


def head_of(whole: np.ndarray, place: Place) -> np.ndarray:
    """The entries of a vector over w that belong to the head."""
    count, size = place.nodes.shape
    return np.concatenate([whole[:size], [whole[count * size]], whole[whole.size - place.free.size :]])


def advanced(place: Place, whole: np.ndarray, length: float, curvature: np.ndarray | None = None) -> Place:
    """The predictor: a step of this length along a tangent, with its curvature where that is known."""
    step = length * whole if curvature is None else length * whole + length**2 * curvature
    return _moved(place, step)


def at_place(curve: Curve, place: Place) -> Solution:
    """A Solution out of a place that is already on the family (one read from a file)."""
    path = march(curve.propagator, place.nodes, place.mesh, place.tail)
    return Solution(place, path, _jacobian(curve, place, path, phase_rows(curve, place)), 0, 0.0)


def blended(place: Place, other: Place, share: float) -> Place:
    """The place a share of the way to another one, or the nearer of them where their segments differ."""
    moved = displacement(place, other)
    if moved is None:
        return place if share < 0.5 else other
    return _moved(place, share * moved)


def displacement(place: Place, other: Place) -> np.ndarray | None:
    """`other` minus `place` over w, or None where their segments differ."""
    if place.nodes.shape != other.nodes.shape or not np.array_equal(place.edges, other.edges):
        return None
    parts = [(other.nodes - place.nodes).ravel(), [other.period - place.period]]
    return np.concatenate([*parts, other.unfolding - place.unfolding, other.free - place.free])


def bend(curve: Curve, place: Place, whole: np.ndarray, other: Place) -> np.ndarray:
    """c of w(sigma) = w + sigma t + sigma^2 c through another place; zero where the segments differ."""
    moved = displacement(place, other)
    if moved is None:
        return np.zeros_like(whole)
    along = float((curve.weights * head_of(whole, place)) @ head_of(moved, place))
    return np.asarray((moved - along * whole) / along**2) if abs(along) > 1e-9 else np.zeros_like(whole)
