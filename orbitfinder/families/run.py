"""A run along a family: what is asked of it, its last step, and the interval between two steps as a curve to sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.point import FamilySettings, make_point, span, unknowns_of
from orbitfinder.families.stability import Spectrum, matching, spectrum
from orbitfinder.families.start import Start
from orbitfinder.loops.continued import Curve, Solution, advanced, at_place, bend, correct, crossed, plane, tangent
from orbitfinder.loops.loop import Unknowns
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.records.family import FamilyPoint

REAL = 1e-7
"""An index counts as real when its imaginary part is below this, relative to its size."""
PASSING = 0.1
"""A root multiplier nearer to +1 than this may be what another family leaves with."""
JUNCTION = 2e-3
"""Arclength from a crossing of two families at which an orbit is told from the other family's: its rows are singular
there in proportion to it, and what errors of 1e-14 make of that and a cubic's of the fourth order are both small."""


@dataclass(frozen=True)
class Run:
    """One direction of a family: its curve, where it began and what is asked of it."""

    curve: Curve
    settings: FamilySettings
    direction: int
    origin: FamilyPoint
    check: ClosureCheck | None = None
    until: float | None = None
    at: tuple[float, ...] = ()


@dataclass(frozen=True)
class Sample:
    """A corrected orbit between two points: distance from the first, tangent (over w), indices, their turns."""

    distance: float
    found: Solution
    whole: np.ndarray
    about: Spectrum
    indices: np.ndarray
    turns: np.ndarray
    slopes: dict[str, float]

    @cached_property
    def head(self) -> np.ndarray:
        """The tangent over the head."""
        return self.found.place.head_of(self.whole)


@dataclass(frozen=True)
class Interval:
    """The part of a family between two corrected places on the same mesh.

    `seen` keeps every orbit that was computed inside it, by distance.
    """

    curve: Curve
    first: Sample
    last: Sample
    curvature: np.ndarray
    twist: np.ndarray
    seen: dict[float, Sample] = field(default_factory=dict, compare=False, repr=False)
    unit: float = 1.0
    """what arclengths are relative to (see `scale.span`)"""

    @property
    def length(self) -> float:
        """Arclength (measured along the first tangent)."""
        return self.last.distance

    @property
    def share(self) -> float:
        """The length relative to the motion."""
        return self.length / self.unit

    def sample(self, distance: float) -> Sample:
        """The orbit at a distance (along the first tangent) into the interval, corrected once."""
        if distance in (0.0, self.length):
            return self.last if distance else self.first
        if distance not in self.seen:
            self.seen[distance] = self.computed(distance)
        return self.seen[distance]

    def known(self) -> list[Sample]:
        """Every orbit that was computed, in order along the interval."""
        return [self.first, *(self.seen[distance] for distance in sorted(self.seen)), self.last]

    def computed(self, distance: float) -> Sample:
        """The same, computed."""
        first, curve, place = self.first, self.curve, self.first.found.place
        reach = max(0.5 * self.length, 1e-6 * self.unit)
        aim = plane(curve, place, first.head, distance)
        found = correct(curve, self.guess(distance), aim, place, reach, self.slope(distance))
        whole = (
            self.heading(distance) if self.crossing else tangent(curve, found, place.head_of(self.heading(distance)))
        )
        sample = make_sample(curve, distance, found, whole, self.indices(distance))
        if sample.indices.shape != first.indices.shape:
            raise ConvergenceError("the orbit is a relative equilibrium, whose flow is one of its symmetries")
        return sample

    def guess(self, distance: float) -> Unknowns:
        """The cubic through both ends with both tangents."""
        if distance in (0.0, self.length):
            return (self.last if distance else self.first).found.place
        bent = self.curvature + (distance - self.length) * self.twist
        return advanced(self.first.found.place, self.first.whole, distance, bent)

    def heading(self, distance: float) -> np.ndarray:
        """The tangent of that cubic, of unit length in its head."""
        d, place = distance, self.first.found.place
        whole = self.first.whole + 2 * d * self.curvature + (3 * d - 2 * self.length) * d * self.twist
        return np.asarray(whole / np.sqrt(self.curve.weights @ place.head_of(whole) ** 2))

    @property
    def crossing(self) -> bool:
        """Whether another family crosses inside, so that the rows there tell neither family's tangent."""
        return self.curve.degenerate and self.curve.test is None

    def slope(self, distance: float) -> np.ndarray | None:
        """The Jacobian between those of the ends."""
        if self.crossing:  # it would lead along the family that crosses
            return None
        share, (a, b) = distance / self.length, (self.first.found.jacobian, self.last.found.jacobian)
        return np.asarray((1 - share) * a + share * b) if a.shape == b.shape else None

    def crossed(self, sample: Sample) -> bool:
        """Whether another family crosses at an orbit of the interval."""
        passing = np.abs(sample.about.values - 1.0).min(initial=np.inf) < PASSING
        return bool(passing) and self.curve.test is None and crossed(self.curve, sample.found)

    def about(self, distance: float) -> Interval:
        """The interval about a place where another family crosses, between orbits that can each be told from it.

        There the aim no longer says which family is meant; the orbits inside stay on the cubic in that direction.
        """
        half = JUNCTION * self.unit
        first, last = (self.computed(one) for one in (distance - half, distance + half))
        length = float((self.curve.weights * first.head) @ (last.found.place.head - first.found.place.head))
        curve = replace(self.curve, degenerate=True)
        return make_interval(curve, replace(first, distance=0.0), replace(last, distance=length))

    def indices(self, distance: float) -> np.ndarray:
        """Indices between those of the ends."""
        share = distance / self.length
        return np.asarray((1 - share) * self.first.indices + share * self.last.indices)


def parameter_slopes(curve: Curve, place: Unknowns, head: np.ndarray) -> dict[str, float]:
    """d/ds of energy, period and every freed parameter along a direction over the head."""
    p, size = curve.equations, curve.equations.size
    _, slope, free = p.quantities_at(place)
    energy = float(slope[p.energy] @ head[:size] + free[p.energy] @ head[size + 1 :])
    slopes = {"energy": energy, "period": float(head[size])}
    for one, by_state, by_free in zip(p.model.invariants, slope, free, strict=False):
        if one.generator is not None:
            slopes[one.name] = float(by_state @ head[:size] + by_free @ head[size + 1 :])
    slopes |= {name: float(head[size + 1 + k]) for k, name in enumerate(p.physical)}
    return slopes | {name: float(head[k]) for k, name in enumerate(p.model.state_names)}


def make_sample(curve: Curve, distance: float, found: Solution, whole: np.ndarray, expected: np.ndarray) -> Sample:
    """Everything that the tests read, at one corrected place."""
    about = spectrum(curve, found)
    slopes = parameter_slopes(curve, found.place, found.place.head_of(whole))
    order = matching(expected, about.indices)
    return Sample(distance, found, whole, about, about.indices[order], about.turns[order], slopes)


def make_interval(curve: Curve, first: Sample, last: Sample) -> Interval:
    """The interval between two samples on one mesh.

    With w(d) = w0 + d t + d^2 c + d^2 (d - D) e, w(D) fixes c and the last tangent, taken per unit of d, fixes e.
    """
    curvature = bend(curve, first.found.place, first.whole, last.found.place)
    twist, length = np.zeros_like(curvature), last.distance
    along = float((curve.weights * first.head) @ last.head)
    if last.whole.shape == first.whole.shape and along > 0.5:
        twist = (last.whole / along - first.whole - 2 * length * curvature) / length**2
    return Interval(curve, first, last, curvature, twist, unit=span(curve, first.found))


def is_real(value: complex) -> bool:
    """Whether an index counts as real."""
    return abs(value.imag) <= REAL * max(1.0, abs(value))


def real_indices(sample: Sample) -> np.ndarray:
    """Which indices count as real."""
    return np.array([is_real(one) for one in sample.indices], bool)


@dataclass(frozen=True)
class Step:
    """The last step of a run: its point, what is read there, the parabola, the trend of the indices.

    `heads` are those of every step so far, and `drift` is the change of the Jacobian with arclength, where two orbits
    in a row have one mesh.
    """

    point: FamilyPoint
    sample: Sample
    curvature: np.ndarray
    trend: np.ndarray
    shortest_period: float
    heads: np.ndarray
    drift: np.ndarray | None = None

    @property
    def found(self) -> Solution:
        """The orbit of the point."""
        return self.sample.found


def first_point(start: Start, settings: FamilySettings, check: ClosureCheck | None) -> FamilyPoint:
    """The point that a family starts from, its tangent towards a larger value of the parameter."""
    head, curve = start.direction, start.curve
    if parameter_slopes(curve, start.found.place, head)[settings.parameter] < 0:
        head = -head
    step = settings.first_step * span(curve, start.found)
    return make_point(curve, start.found, head, settings.parameter, check, index=0, arclength=0.0, step=step)


def step_at(run: Run, points: Sequence[FamilyPoint]) -> Step:
    """The last step of a run over these points, from which everything follows."""
    last, curve = points[-1], run.curve
    found = at_place(curve, unknowns_of(curve, last))
    whole = tangent(curve, found, last.tangent if len(points) > 1 else run.direction * last.tangent)
    curvature, trend = np.zeros_like(whole), np.zeros_like(last.indices)
    if len(points) > 1:
        curvature = bend(curve, found.place, whole, unknowns_of(curve, points[-2]))
        trend = trend_of(points[-2], last)
    sample = make_sample(curve, 0.0, found, whole, last.indices)
    heads = np.array([unknowns_of(curve, point).head for point in points])
    return Step(last, sample, curvature, trend, min(point.period for point in points), heads)


def trend_of(before: FamilyPoint, last: FamilyPoint) -> np.ndarray:
    """The last change of each index, 0 where it was a jump."""
    if before.indices.shape != last.indices.shape:
        return np.zeros_like(last.indices)
    change = last.indices - before.indices
    return np.asarray(np.where(np.abs(change) < 0.5, change, 0.0))
