"""A run along a family: what is asked of it, its last step, and the interval between two steps as a curve to sample."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.motion import rates_along
from orbitfinder.families.point import FamilySettings, make_point, unknowns_of
from orbitfinder.families.stability import Spectrum, matching, spectrum
from orbitfinder.families.start import Start
from orbitfinder.loops.block import Accepted, Blocks
from orbitfinder.loops.condensed import Jacobian
from orbitfinder.loops.conditions import followed, pinned
from orbitfinder.loops.continued import (
    Curve,
    Solution,
    advanced,
    at_place,
    begun,
    bend,
    correct,
    crossed,
    distance,
    jacobian_of,
    nearby,
    plane,
    tangent,
)
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.mesh import carried, needs_mesh, refined, settled
from orbitfinder.loops.scales import Scales
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.records.family import FamilyPoint, Standing

REAL = 1e-7
"""An index counts as real when its imaginary part is below this, relative to its size."""
REFINEMENTS = 2
"""How often the mesh of an orbit that does not close is made finer before its step is made shorter."""
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
    stop: Mapping[str, float] = field(default_factory=dict)
    between: tuple[float, ...] = ()

    @property
    def goals(self) -> list[tuple[str, float]]:
        """Where it ends: values of the parameter and of watched numbers, each with its name."""
        values = self.between if self.until is None else (self.until, *self.between)
        return [*((self.settings.parameter, value) for value in values), *self.stop.items()]


@dataclass(frozen=True)
class Sample:
    """A corrected orbit between two points: distance from the first, tangent (over w), indices, their turns."""

    distance: float
    solution: Solution
    whole: np.ndarray
    about: Spectrum
    indices: np.ndarray
    turns: np.ndarray
    slopes: dict[str, float]

    @property
    def multipliers(self) -> np.ndarray:
        """The non-trivial multipliers of the period; `about.root_multipliers` are those of the root map."""
        return self.about.floquet.multipliers

    @cached_property
    def head(self) -> np.ndarray:
        """The tangent over the head."""
        return self.solution.place.head_of(self.whole)


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

    @property
    def length(self) -> float:
        """Arclength (measured along the first tangent)."""
        return self.last.distance

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
        first, curve, place = self.first, self.curve, self.first.solution.place
        reach = max(0.5 * self.length, 1e-6)
        aim = plane(curve, place, first.whole, distance)
        solution = correct(curve, self.guess(distance), aim, place, reach, self.slope(distance))
        whole = self.heading(distance) if self.crossing else tangent(curve, solution, self.heading(distance))
        sample = make_sample(curve, distance, solution, whole, self.indices(distance))
        if sample.indices.shape != first.indices.shape:
            raise ConvergenceError("the orbit is a relative equilibrium, whose flow is one of its symmetries")
        return sample

    def guess(self, distance: float) -> Unknowns:
        """The cubic through both ends with both tangents."""
        if distance in (0.0, self.length):
            return (self.last if distance else self.first).solution.place
        bent = self.curvature + (distance - self.length) * self.twist
        return advanced(self.first.solution.place, self.first.whole, distance, bent)

    def heading(self, distance: float) -> np.ndarray:
        """The tangent of that cubic, of unit length."""
        d, metric = distance, self.curve.scales.metric(self.first.solution.place)
        whole = self.first.whole + 2 * d * self.curvature + (3 * d - 2 * self.length) * d * self.twist
        return np.asarray(whole / np.sqrt(metric @ whole**2))

    @property
    def crossing(self) -> bool:
        """Whether another family crosses inside, so that the rows there tell neither family's tangent."""
        return self.curve.degenerate and self.curve.test is None

    def slope(self, distance: float) -> Jacobian | None:
        """The Jacobian between those of the ends."""
        if self.crossing:  # it would lead along the family that crosses
            return None
        share, (a, b) = distance / self.length, (self.first.solution.jacobian, self.last.solution.jacobian)
        return nearby(self.curve, a, 1 - share, b, share)

    def crossed(self, sample: Sample) -> bool:
        """Whether another family crosses at an orbit of the interval."""
        passing = np.abs(sample.about.values - 1.0).min(initial=np.inf) < PASSING
        return bool(passing) and self.curve.test is None and crossed(self.curve, sample.solution)

    def strayed(self, sample: Sample) -> bool:
        """Whether the motion of an orbit has left the mesh that was made for it."""
        return not self.curve.equations.gridded and needs_mesh(self.curve, sample.solution, 1)

    def fitted(self, distance: float) -> Sample:
        """The orbit at a distance on a mesh that fits it."""
        if distance in (0.0, self.length):
            return self.sample(distance)
        near, curve = self.computed(distance), self.curve
        solution = settled(curve, near.solution, near.whole, 1)
        return make_sample(curve, distance, solution, tangent(curve, solution, near.head), near.indices)

    def about(self, distance: float, junction: float = JUNCTION) -> Interval:
        """The interval about a place where another family crosses, between orbits that can each be told from it.

        There the aim no longer says which family is meant; the orbits inside stay on the cubic in that direction.
        """
        first, last = (self.computed(place) for place in (distance - junction, distance + junction))
        length = ahead(self.curve, first, last.solution)
        curve = replace(self.curve, degenerate=True)
        return make_interval(curve, replace(first, distance=0.0), replace(last, distance=length))

    def indices(self, distance: float) -> np.ndarray:
        """Indices between those of the ends."""
        share = distance / self.length
        return np.asarray((1 - share) * self.first.indices + share * self.last.indices)


def ahead(curve: Curve, first: Sample, other: Solution) -> float:
    """How far another orbit over the same mesh is along the tangent of a sample."""
    metric = curve.scales.metric(first.solution.place)
    return float((metric * first.whole) @ (other.place.vector - first.solution.place.vector))


def parameter_slopes(curve: Curve, place: Unknowns, head: np.ndarray) -> dict[str, float]:
    """d/ds of energy, period and every freed parameter along a direction over the head."""
    p, size = curve.equations, curve.equations.size
    _, slope, free = p.quantities_at(place)
    energy = float(slope[p.energy] @ head[:size] + free[p.energy] @ head[size + 1 :])
    slopes = {"energy": energy, "period": float(head[size])}
    for invariant, by_state, by_free in zip(p.model.invariants, slope, free, strict=False):
        if invariant.generator is not None:
            slopes[invariant.name] = float(by_state @ head[:size] + by_free @ head[size + 1 :])
    slopes |= {name: float(head[size + 1 + k]) for k, name in enumerate(p.physical)}
    slopes |= {name: float(head[k]) for k, name in enumerate(p.model.state_names)}
    if "others" not in p.derived:
        others = {*followed(p.model)} - {*slopes, *(invariant.name for invariant in p.model.invariants)}
        p.derived["others"] = {name: pinned(p, name, 0.0) for name in sorted(others)}
    rows = p.derived["others"].items()
    return slopes | {name: float(row.slope(p, place) @ place.spread(head)) for name, row in rows}


def make_sample(curve: Curve, distance: float, solution: Solution, whole: np.ndarray, expected: np.ndarray) -> Sample:
    """Everything that the tests read, at one corrected place."""
    about = spectrum(curve, solution)
    slopes = parameter_slopes(curve, solution.place, solution.place.head_of(whole))
    order = matching(expected, about.indices)
    return Sample(distance, solution, whole, about, about.indices[order], about.turns[order], slopes)


def make_interval(curve: Curve, first: Sample, last: Sample) -> Interval:
    """The interval between two samples on one mesh.

    With w(d) = w0 + d t + d^2 c + d^2 (d - D) e, w(D) fixes c and the last tangent, taken per unit of d, fixes e.
    """
    curvature = bend(curve, first.solution.place, first.whole, last.solution.place)
    twist, length = np.zeros_like(curvature), last.distance
    along = float((curve.scales.metric(first.solution.place) * first.whole) @ last.whole)
    if along > 0.5:
        twist = (last.whole / along - first.whole - 2 * length * curvature) / length**2
    return Interval(curve, first, last, curvature, twist)


def is_real(value: complex) -> bool:
    """Whether an index counts as real."""
    return abs(value.imag) <= REAL * max(1.0, abs(value))


def real_indices(sample: Sample) -> np.ndarray:
    """Which indices count as real."""
    return np.array([is_real(index) for index in sample.indices], bool)


@dataclass(frozen=True)
class Walked:
    """The last step of a run: its point, what is read there, the parabola, the trend of the indices.

    `curve` is the family's in the scales that hold from here, `portraits` are those of every step so far (see
    `portrait`), and `drift` is the change of the Jacobian with arclength, where two orbits in a row have one mesh.
    """

    curve: Curve
    point: FamilyPoint
    sample: Sample
    curvature: np.ndarray
    trend: np.ndarray
    portraits: np.ndarray
    drift: Jacobian | None = None

    @property
    def solution(self) -> Solution:
        """The orbit of the point."""
        return self.sample.solution

    @property
    def stretch(self) -> float:
        """The period, in units of the shortest one met."""
        return float(self.point.period / self.portraits[:, 0].min())


def first_point(start: Start, settings: FamilySettings, check: ClosureCheck | None) -> FamilyPoint:
    """The point that a family starts from, its tangent towards a larger value of the parameter."""
    head, curve = start.direction, start.curve
    if parameter_slopes(curve, start.solution.place, head)[settings.parameter] < 0:
        head = -head
    whole, step = start.solution.place.over(head), settings.first_step
    where: dict[str, Any] = {"index": 0, "arclength": 0.0, "step": step}
    return checked_point(curve, start.solution, whole, settings.parameter, check, None, **where)[0]


def checked_point(
    curve: Curve, solution: Solution, whole: np.ndarray, parameter: str, check: ClosureCheck | None,
    about: Spectrum | None, **where: Any,
) -> tuple[FamilyPoint, Solution, np.ndarray]:  # fmt: skip
    """The point of a corrected place, its orbit and tangent, on a finer mesh where it does not close on this one."""
    along = solution.place.head_of(whole)
    for trial in range(REFINEMENTS + 1):
        try:
            return make_point(curve, solution, along, parameter, check, about=about, **where), solution, whole
        except ConvergenceError:
            if trial == REFINEMENTS:
                raise
            finer, about = refined(curve, solution, whole), None
            solution, whole = finer, carried(curve, solution.place, whole, finer.place)
    raise AssertionError("unreachable")


def step_at(run: Run, done: Sequence[tuple[FamilyPoint, Standing | None]], blocks: Blocks | None) -> tuple[Run, Walked]:
    """The last step of a run after those already taken, from which everything follows, and the run in its scales."""
    origin, curve = run.origin, in_scales(run.curve, run.origin)
    solution = at_place(curve, unknowns_of(curve, origin))
    first = portrait(curve, solution)[None]
    whole = tangent(curve, solution, run.direction * origin.tangent)
    sample = make_sample(curve, 0.0, solution, whole, origin.indices)
    step = Walked(curve, origin, sample, np.zeros_like(whole), np.zeros_like(origin.indices), first)
    for point, standing in done:
        run = replace(run, curve=step.curve)
        solution, whole = standing_at(step.curve, point, standing)
        known = None if blocks is None else blocks.accepted(step.curve, step.solution.place, solution, whole)
        step = step_from(run, step, point, solution, whole, None, known)
    return replace(run, curve=step.curve), step


def in_scales(curve: Curve, origin: FamilyPoint) -> Curve:
    """The curve of a family in the scales of its first point, whatever it was in before."""
    curve = replace(curve, scales=Scales.head(curve.weights, curve.equations.size))
    return begun(curve, at_place(curve, unknowns_of(curve, origin)), origin.tangent)[0]


def standing_at(curve: Curve, point: FamilyPoint, standing: Standing | None) -> tuple[Solution, np.ndarray]:
    """The orbit of a step that was taken and the tangent there (over w), as they were."""
    place = unknowns_of(curve, point)
    if standing is None:  # an older orbitfinder took the step
        return at_place(curve, place), place.over(point.tangent)
    marched = place.at(standing.marched)
    path = curve.equations.varied(marched, states=True)
    jacobian = jacobian_of(curve.through(place), place, path)
    if isinstance(jacobian, np.ndarray):
        jacobian = np.vstack([jacobian, standing.rows.reshape(-1, jacobian.shape[1])])
    return Solution(place, path, jacobian, 0.0, distance(curve, place, marched), marched), standing.tangent


def standing_of(curve: Curve, solution: Solution, whole: np.ndarray) -> Standing:
    """What the step after an orbit begins with."""
    last = solution.matrix[-1:] if curve.test else np.zeros((0, whole.size))
    return Standing((solution.marched or solution.place).vector, whole, last)


def step_from(
    run: Run, before: Walked, point: FamilyPoint, solution: Solution, whole: np.ndarray, last: Sample | None,
    known: Accepted | None = None,
) -> Walked:  # fmt: skip
    """The step to a point that was accepted, in scales renewed there; `last` is its sample where it has one, `known`
    how it stands."""
    stands = known or accepted(run.curve, before.solution.place, solution, whole)
    curve, here, whole, trend = stands.curve, stands.solution, stands.whole, trend_of(before.point, point)
    if last is None:
        sample = make_sample(curve, 0.0, here, whole, point.indices)
    else:
        slopes = parameter_slopes(curve, here.place, here.place.head_of(whole))
        sample = replace(last, distance=0.0, solution=here, whole=whole, slopes=slopes)
    return Walked(
        curve, point, sample, stands.bend, trend, np.vstack([before.portraits, portrait(curve, solution)]),
        None if known is not None else drifted(curve, before.solution, here),
    )  # fmt: skip


def accepted(curve: Curve, before: Unknowns, solution: Solution, whole: np.ndarray) -> Accepted:
    """How an orbit with its tangent stands after another."""
    curve = curve.measured(solution)
    jacobian = jacobian_of(curve.through(solution.place), solution.place, solution.march)
    if isinstance(jacobian, np.ndarray) and curve.test is not None:
        jacobian = np.vstack([jacobian, solution.matrix[len(jacobian) :]])
    here = replace(solution, jacobian=jacobian)
    whole = tangent(curve, here, whole)
    return Accepted(curve, here, whole, bend(curve, solution.place, whole, before))


def drifted(curve: Curve, before: Solution, solution: Solution) -> Jacobian | None:
    """The change of the Jacobian with arclength from one orbit to the next, None where their segments differ."""
    if before.place.displacement(solution.place) is None:
        return None
    far = distance(curve, before.place, solution.place)
    return nearby(curve, solution.jacobian, 1 / far, before.jacobian, -1 / far)


def portrait(curve: Curve, solution: Solution) -> np.ndarray:
    """What identifies an orbit wherever its t = 0 lies: T, parameters, action, means and spreads of the motion.

    The last two (d each) are good to the fourth order of the mesh.
    """
    place = solution.place
    times = place.mesh / place.mesh[-1]
    lengths, rates = np.diff(times), rates_along(curve, solution)

    def mean(values: np.ndarray, slopes: np.ndarray) -> np.ndarray:
        parts = lengths * (values[:-1] + values[1:]).T / 2 + lengths**2 * (slopes[:-1] - slopes[1:]).T / 12
        return np.asarray(parts.sum(axis=1))

    paced = rates * place.period * place.mesh[-1]
    middle = mean(solution.march.states, paced)
    away = solution.march.states - middle
    spread = np.sqrt(np.abs(mean(away**2, 2 * away * paced)))
    return np.concatenate([[place.period], place.free, [solution.march.integral], middle, spread])


def trend_of(before: FamilyPoint, last: FamilyPoint) -> np.ndarray:
    """The last change of each index, 0 where it was a jump."""
    if before.indices.shape != last.indices.shape:
        return np.zeros_like(last.indices)
    change = last.indices - before.indices
    return np.asarray(np.where(np.abs(change) < 0.5, change, 0.0))
