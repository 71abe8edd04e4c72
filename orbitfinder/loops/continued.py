"""The corrector of a family: its loop with one aim more, Newton, tangent and predictor.

The aim is the last condition and picks one orbit of the family; without it the Jacobian has a one-dimensional
kernel, the tangent of the family (Muñoz-Almaraz et al., Physica D 181 (2003) 1-38).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import Varied
from orbitfinder.loops.condensed import Broyden, Factors
from orbitfinder.loops.loop import Condition, Equations, Loop, Unknowns, beyond
from orbitfinder.loops.problem import clocked
from orbitfinder.mechanics.scales import parameter_sizes, snapped

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
class Curve(Loop):
    """One family's loop, and its metric.

    `weights` measures a head (x(0), T, free): coordinates by `mechanics.scales.lengths` (angles in rad), rates by the
    time scale of the starting orbit, period and parameters relative to their starting values.
    """

    weights: np.ndarray = field(kw_only=True)

    @cached_property
    def shares(self) -> np.ndarray:
        """What coordinates (n) are measured in, in rad or relative to the first: 1 where all are measured alike."""
        return np.asarray(np.sqrt(self._unit / self.weights[: self.equations.model.degrees_of_freedom]))

    @cached_property
    def units(self) -> np.ndarray:
        """The same of a state (2n) in powers of 256, so that a system of order one is computed with as it is."""
        return snapped(np.sqrt(self._unit / self.weights[: self.equations.size]))

    @cached_property
    def centre(self) -> np.ndarray:
        """Where coordinates (n) must be centred, nan for those that may be anywhere."""
        return self.equations.symmetry.centre(self.constant)

    @cached_property
    def turns(self) -> tuple[int, ...]:
        """Whole turns of each coordinate in one period (n); zero for orbits that swing back."""
        return tuple(int(k) for k in self.equations.symmetry.turns(self.constant))

    @property
    def _unit(self) -> float:
        return 1.0 if self.equations.model.angular.any() else float(self.weights[0])


@dataclass(frozen=True)
class Solution:
    """A corrected orbit with the integration it came from and the Jacobian of all rows but the aim."""

    place: Unknowns
    march: Varied
    jacobian: np.ndarray
    residual: float
    stepped: float = 0.0
    """how far, in the family's metric, the place is from where `march` was made: Newton's last step"""


def make_curve(
    equations: Equations,
    constant: np.ndarray,
    w: Unknowns,
    conditions: tuple[Condition, ...] = (),
    unit: np.ndarray | float = 1.0,
) -> Curve:
    """The curve through (or near) w; its metric is fixed there once for the whole family.

    `unit` is what coordinates (n) are measured in (see `point.length`).
    """
    n = equations.model.degrees_of_freedom
    sizes = np.tile(np.broadcast_to(unit, n), equations.size // n)
    relative = 1.0 / parameter_sizes(equations.model, equations.free, w.free) ** 2
    with np.errstate(over="ignore"):  # what comes of a period that is too small is said where it is integrated
        pace = np.square(1.0 / w.period)
    weights = np.concatenate([clocked(equations.model, w.period / (2 * np.pi)) ** 2 / sizes**2, [pace], relative])
    return Curve(equations, constant, conditions, weights=weights)


def _row_units(curve: Curve, w: Unknowns, slopes: np.ndarray | None = None) -> np.ndarray:
    """What each row is measured in, an aim's last, when every unknown is measured as the family's metric does."""
    return curve.row_units(w, 1.0 / np.sqrt(curve.weights), slopes)


def _all_rows(curve: Curve, w: Unknowns, ends: np.ndarray, aim: Condition, lost: np.ndarray) -> np.ndarray:
    """The rows of the curve and the aim, without what may be round-off."""
    return beyond(curve.rows(w, ends, aim), lost)


def _approached(
    curve: Curve, guess: Unknowns, aim: Condition, matrix: np.ndarray, measures: tuple[np.ndarray, np.ndarray]
) -> Unknowns:
    """The guess improved by Broyden's method on marches of the state alone, in long steps, from a Jacobian of all rows.

    Stops where a step no longer helps. `measures` are what each row is measured in, and what it loses to round-off.
    """
    coarser = 2 if guess.steps % 2 == 0 and guess.steps >= FEWEST_STEPS else 1
    w, best = guess.on(guess.mesh[::coarser]), np.inf
    cut, size = guess.nodes.size, curve.equations.size
    matrix[cut : cut + len(curve.normals), :size] = curve.normals
    kept, (units, lost) = guess, measures
    try:
        method = Broyden(Factors(matrix))
    except np.linalg.LinAlgError:
        return guess
    for _ in range(MOST_NEWTON):
        try:
            rows = _all_rows(curve, w, curve.equations.ends(w), aim, lost)
        except IntegrationError:
            break
        largest = float(np.abs(rows / units).max())
        if not largest < 0.5 * best:
            break
        kept, best = w, largest
        if largest < APPROACHED:
            break
        w = w.moved(method.step(rows))
    return kept.on(guess.mesh)


def correct(
    curve: Curve,
    guess: Unknowns,
    aim: Condition,
    reference: Unknowns | None = None,
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
    family, curve = curve, curve.through(reference or guess)
    slopes = curve.slopes(guess, (*curve.conditions, aim))
    w, previous, units, lost = guess, np.inf, _row_units(curve, guess, slopes), curve.lost(guess, (aim,), slopes)
    if slope is not None:
        w = _approached(curve, guess, aim, np.vstack([slope, guess.spread(slopes[-1])]), (units, lost))
    for iteration in range(MOST_NEWTON):
        path = curve.equations.varied(w, states=True)
        rows, jacobian = _all_rows(curve, w, path.ends, aim, lost), curve.linearised(w, path).matrix()
        largest = float(np.abs(rows / units).max())
        ready = largest < NEWTON_READY or (largest < NEWTON_FLOOR and largest > 0.1 * previous)
        if not np.isfinite(largest) or (iteration > 2 and largest > 0.5 * previous and not ready):
            raise ConvergenceError(f"the corrector stalled at a residual of {largest:.2g}; take a smaller step")
        if not np.isfinite(jacobian).all():
            raise ConvergenceError("the variations of the corrector's orbit overflow; take a smaller step")
        whole = np.vstack([jacobian, w.spread(curve.slopes(w, (aim,))[0])])
        try:
            step = -Factors(whole).solve(rows)
        except np.linalg.LinAlgError:
            step = np.linalg.lstsq(whole, -rows, rcond=1e-12)[0]
        moved = w.moved(step)
        if ready:
            return Solution(moved, path, jacobian, largest, distance(curve, moved.head, w.head))
        if not distance(curve, moved.head, guess.head) < reach or not moved.period > 0:
            raise ConvergenceError("the corrector left the neighbourhood of its guess; take a smaller step")
        if fit is not None and largest < FITTING:
            moved = moved.on(fit(family, Solution(w, path, jacobian, largest)))
            fit = None
        w, previous = moved, largest
    raise ConvergenceError(f"the corrector did not finish in {MOST_NEWTON} steps; take a smaller step")


def plane(curve: Curve, w: Unknowns, along: np.ndarray, ahead: float = 0.0) -> Condition:
    """The aim in the hyperplane through w, or so far ahead of it, normal to a direction over the head."""
    normal = curve.weights * along
    return Condition(float(normal @ w.head) + ahead, normal)


def scaled(curve: Curve, found: Solution) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian of all rows but the aim in units of the metric, and those of its columns."""
    w, size = found.place, curve.equations.size
    head = 1.0 / np.sqrt(curve.weights)
    columns = w.joined(head[:size], head[size], 1.0 / w.period, head[size + 1 :])
    rows = _row_units(curve.through(w), w)
    return found.jacobian * columns / rows[:, None], columns


def distance(curve: Curve, one: np.ndarray, other: np.ndarray) -> float:
    """Distance of two heads in the family's metric."""
    return float(np.sqrt(curve.weights @ (one - other) ** 2))


def tangent(curve: Curve, found: Solution, along: np.ndarray) -> np.ndarray:
    """The family's direction over all of w, of unit length in its head, with along^T W head > 0."""
    row = found.place.spread(curve.weights * along)
    right = np.zeros(len(found.jacobian) + 1)
    right[-1] = 1.0
    whole = Factors(np.vstack([found.jacobian, row])).solve(right)
    return np.asarray(whole / np.sqrt(curve.weights @ found.place.head_of(whole) ** 2))


def kernel(curve: Curve, found: Solution) -> np.ndarray:
    """The same without a direction to go by: the right singular vector of the smallest singular value."""
    matrix, units = scaled(curve, found)
    whole = units * np.linalg.svd(matrix)[2][-1]
    return np.asarray(whole / np.sqrt(curve.weights @ found.place.head_of(whole) ** 2))


def advanced(w: Unknowns, whole: np.ndarray, length: float, curvature: np.ndarray | None = None) -> Unknowns:
    """The predictor: a step of this length along a tangent, with its curvature where that is known."""
    return w.moved(length * whole if curvature is None else length * whole + length**2 * curvature)


def at_place(curve: Curve, w: Unknowns) -> Solution:
    """A Solution out of unknowns that are already on the family (those read from a file)."""
    path = curve.equations.varied(w, states=True)
    return Solution(w, path, curve.through(w).linearised(w, path).matrix(), 0.0)


def bend(curve: Curve, w: Unknowns, whole: np.ndarray, other: Unknowns) -> np.ndarray:
    """c of w(sigma) = w + sigma t + sigma^2 c through others; zero where the segments differ."""
    moved = w.displacement(other)
    if moved is None:
        return np.zeros_like(whole)
    along = float((curve.weights * w.head_of(whole)) @ w.head_of(moved))
    return np.asarray((moved - along * whole) / along**2) if abs(along) > 1e-9 else np.zeros_like(whole)
