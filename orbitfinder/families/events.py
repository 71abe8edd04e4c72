"""What happens between two neighbouring points of a family, and exactly where.

Folds are sign changes of d(energy)/ds, d(period)/ds, d(parameter)/ds; bifurcations are passages of a
stability index kappa = mu + 1/mu through 2 cos(2 pi k / q); collisions are sign changes of the
discriminant (kappa_i - kappa_j)^2; without an energy (`crossings`) they are passages of multipliers through
the unit circle. Where the orbit is its own mirror image the indices are those of
the half map, whose square is the monodromy: there a multiplier touches -1 without crossing it, and
the half map's index passes 0. Located with Brent's method on the arclength, each trial a corrected orbit.
Collisions come first: passages are counted between them, where indices keep their identity.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.continuation.tests import multiplier_levels
from orbitfinder.errors import ConvergenceError
from orbitfinder.families.motion import noise, rises, watched
from orbitfinder.families.passages import (
    UNTOLD,
    Measure,
    Test,
    collisions,
    grazed,
    located,
    look,
    meeting,
    passages,
    strips,
    zeros,
)
from orbitfinder.families.point import FamilySettings, freed, parameter_value
from orbitfinder.families.registry import KINDS
from orbitfinder.families.run import PASSING, Interval, Sample, ahead, is_real, make_sample
from orbitfinder.loops.conditions import hyperplane
from orbitfinder.loops.continued import AvoidedCrossing, Curve, correct, tangent
from orbitfinder.loops.symmetry import momenta_of
from orbitfinder.orbits.floquet import ERROR_FLOOR
from orbitfinder.records.family import AVOIDED, BECOMES, Event


def slope(name: str) -> Measure:
    """d/ds of a parameter, of the energy or the period."""
    return lambda sample: sample.slopes[name]


def folds(interval: Interval) -> Iterator[Test]:
    """What turns at a fold: each parameter that orbits are told by, or the period."""
    p, held = interval.curve.equations, {condition.name for condition in interval.curve.kept}
    kept = [invariant for invariant in p.model.invariants if invariant.name in held]
    bifurcates = () if "period" in held and not p.model.forced else ("energy", *p.physical)
    swept = momenta_of(p.symmetry, p.model) if any(invariant.generator is None for invariant in kept) else ("energy",)
    names = {invariant.name for invariant in kept}
    for name in p.physical or (*(name for name in swept if name not in names), "period"):
        yield Test("fold" if name in bifurcates else "turn", name, slope(name))


def extrema(interval: Interval) -> Iterator[Test]:
    """Watched numbers that may be extremal in the interval: they change by more than round-off."""
    known: dict[float, dict[str, float]] = {}

    def rise(name: str, sample: Sample) -> float:
        if sample.distance not in known:
            known[sample.distance] = rises(interval.curve, sample.solution, sample.whole)
        return known[sample.distance][name]

    for name in interval.curve.watch:
        ends = [rise(name, sample) for sample in (interval.first, interval.last)]
        if ends[0] * ends[1] < 0 and max(np.abs(ends)) > noise(interval.curve, interval.first.solution)[name]:
            yield Test("extremum", name, partial(rise, name))


def bifurcations(interval: Interval, most: int) -> list[tuple[Sample, Test]]:
    """Collisions, bifurcations and resonances up to order `most` of an interval, each with the orbit there.

    Raises `ConvergenceError` when they cannot be told apart within so long a step.
    """
    if interval.first.indices.shape != interval.last.indices.shape:
        return []
    # uncertainty of the stability indices beyond which none of their passages can be told from round-off
    if max(interval.first.about.blur, interval.last.about.blur) > 1e-6:
        return []
    if not interval.first.about.conservative:
        return crossings(interval)
    if not interval.first.indices.size:
        return []
    strips(interval)
    look(interval)
    # how often collisions are looked for again after orbits between them were seen
    for _ in range(4):
        brackets = collisions(interval)
        met = [located(interval, meeting, low, high) for low, high in brackets]
        passed = passages(interval, most, met)
        if len(collisions(interval)) == len(brackets):  # nothing that was seen meanwhile says otherwise
            return [(sample, Test("collision", "", meeting)) for sample in met] + passed
    raise ConvergenceError("collisions of multipliers cannot be told apart within one step")


def find_events(interval: Interval, settings: FamilySettings) -> list[tuple[Sample, Test]]:
    """What happens in an interval, each with the orbit there."""
    turned = [*zeros(interval, (test for test in folds(interval) if _moves(interval, test)))]
    passed = bifurcations(interval, settings.resonances)
    if not interval.first.about.conservative:
        turned, passed = _by_multiplier(interval, turned, passed)
    seen = sorted(turned + passed, key=lambda pair: pair[0].distance)
    turns = [sample.distance for sample, test in turned if test.detail != "period"]
    seen = [(p, t) for p, t in seen if not KINDS[t.kind].crosses or (_apart(p.distance, turns) and _told(interval))]
    return seen + _changes(interval, seen)


def _moves(interval: Interval, test: Test) -> bool:
    """Whether what may turn moves within a step by more than its round-off, as in the midst of a canard it does not."""
    ends, steepest = (
        (interval.first, interval.last),
        max(abs(test.measure(end)) for end in (interval.first, interval.last)),
    )
    value = max(_value(interval, end, test) for end in ends)
    return bool(steepest * interval.length > FLAT * EPSILON * value)


Located = list[tuple[Sample, Test]]


def _by_multiplier(interval: Interval, turned: Located, passed: Located) -> tuple[Located, Located]:
    """Folds where the multiplier +1 tells them better than their parameter, and what else passes.

    A multiplier passes +1 where the parameter turns or another family crosses: where no other does, it turns, and if
    that is not seen, as in a canard along which it stays what it is to round-off. What turns there without a multiplier
    at +1 is round-off.
    """
    passing = [pair for pair in passed if KINDS[pair[1].kind].crosses and pair[1].multiplier.real > 0]
    known, parameter = Located(), next(folds(interval))
    for sample, test in turned:
        beside = [pair for pair in passing if not _apart(pair[0].distance, [sample.distance])]
        turns = _unsure(interval, sample, test, FLAT * EPSILON * _value(interval, sample, test))
        if beside:
            about = beside[0][0].about
            error = float(about.root_errors[np.abs(about.values - 1.0).argmin()])
            sample = sample if turns <= _unsure(interval, *beside[0], error) else beside[0][0]
        if beside or (turns < 1.0 and np.abs(sample.about.values - 1.0).min(initial=np.inf) < PASSING):
            known.append((sample, test))
    alone = [pair for pair in passing if _apart(pair[0].distance, [sample.distance for sample, _ in known])]
    told = KINDS[parameter.kind].followed is not None
    still = [id(test) for sample, test in alone if told and not interval.crossed(sample)]
    return known, [(sample, parameter if id(test) in still else test) for sample, test in passed]


def _unsure(interval: Interval, sample: Sample, test: Test, error: float) -> float:
    """How well it is known where a measure that is known to an error vanishes: in the steps beside it over which it is
    seen how it changes."""
    middle, beside = sample.distance, BESIDE * interval.length
    low, high = (interval.sample(d) for d in (max(0.0, middle - beside), min(interval.length, middle + beside)))
    return float(error / nonzero(abs(test.measure(high) - test.measure(low))))


def _value(interval: Interval, sample: Sample, test: Test) -> float:
    return abs(parameter_value(interval.curve, sample.solution.place, test.detail))


def _told(interval: Interval) -> bool:
    """Whether branch points are more than an index that stays at +-2 to within what the monodromy is known to."""
    ends = (interval.first, interval.last)
    if not interval.first.about.conservative or not interval.first.indices.size:
        return True
    margins = [np.abs(np.asarray(sample.indices).real) - 2.0 for sample in ends]
    first, last = (np.sort(np.where(np.abs(values) > ERROR_FLOOR, np.sign(values), 0.0)) for values in margins)
    return not (np.any(first == 0.0) and np.array_equal(first, last))


def _apart(distance: float, folds: list[float]) -> bool:
    """Whether a branch point is more than the multiplier +1 that every fold has."""
    return all(abs(distance - fold) >= 1e-5 for fold in folds)


def event_at(curve: Curve, sample: Sample, test: Test, parameter: str) -> Event:
    """The event that a test finds at an orbit, its arclength the distance into the interval."""
    place = sample.solution.place
    return Event(
        kind=test.kind,
        index=-1,
        arclength=sample.distance,
        parameter=parameter_value(curve, place, parameter),
        state=place.nodes[0],
        period=place.period,
        energy=parameter_value(curve, place, "energy"),
        detail=test.detail,
        order=test.order,
        multiplier=test.multiplier,
        shooting_nodes=place.nodes,
        mesh=place.mesh,
        tangent=sample.head,
        symmetry=curve.equations.symmetry.name,
        free=freed(curve, place),
        watch=watched(curve, sample.solution),
    )


def avoiding(curve: Curve, near: AvoidedCrossing, first: Sample, over: bool, parameter: str) -> Event:
    """The event at the orbit of a sample's family at which another one is nearest, which was crossed over to or not."""
    row, guess = near.rows[1], near.centre.moved(np.sign(near.place(first.solution.place)[0]) * near.axes[0])
    solution = correct(curve, guess, hyperplane(float(row @ near.centre.vector), row), reach=near.gap)
    along = tangent(curve, solution, first.whole)
    sample = make_sample(curve, ahead(curve, first, solution), solution, along, first.indices)
    test = Test("avoided_crossing", AVOIDED[over], lambda sample: 0.0)
    return replace(event_at(curve, sample, test, parameter), gap=near.gap)


def _changes(interval: Interval, events: list[tuple[Sample, Test]]) -> list[tuple[Sample, Test]]:
    """The located events at which the verdict changes, read halfway to their neighbours."""
    critical = [(p, t) for p, t in events if KINDS[t.kind].critical and t.detail != "period"]
    a, b = (p.about.floquet.stability == "unstable" for p in (interval.first, interval.last))
    if not critical or (a == b and len(critical) < 2):
        return []
    edges = [0.0, *(p.distance for p, _ in critical), interval.length]
    verdicts = [a]
    for before, after in pairwise(edges[1:-1]):
        inner = interval.sample(0.5 * (before + after)) if after - before > 1e-7 else None
        verdicts.append(verdicts[-1] if inner is None else inner.about.floquet.stability == "unstable")
    verdicts.append(b)
    tests = [Test("stability_change", BECOMES[late], lambda p: 0.0) for late in verdicts[1:]]
    turned = [early != late for early, late in pairwise(verdicts)]
    return [(sample, test) for (sample, _), test, changed in zip(critical, tests, turned, strict=True) if changed]


# Bifurcations of families that conserve no energy: multipliers that pass through the unit circle.
# Sorted by size, the moduli are continuous along the family, whatever meets what: each that passes 1 is an event, and
# the multiplier that does so says which, +1 (fold or branch point), -1 (period doubling) or a complex pair (torus, the
# Neimark-Sacker bifurcation). A neutral saddle, two real multipliers of product 1, passes nothing.
# Source: Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004), sections 5.3 and 10.2.


FLAT, BESIDE = 4.0, 1e-3
"""Round-offs that a number has to change by within a step to turn there; share of a step beside a fold at which it is
seen how its parameter and its multiplier change"""
GRAZED = 0.1
"""A modulus within this share of 1 at one of the two points may have passed it and come back."""
DEEPEST = 6
"""How often a part of a step is halved until the events in it account for what changes across it."""


def multipliers(sample: Sample) -> np.ndarray:
    """Multipliers of the root map, the largest modulus first."""
    return sample.about.ranked


def modulus(rank: int) -> Measure:
    """The logarithm of the modulus of this rank."""
    return lambda sample: float(sample.about.growths[rank])


def crossings(interval: Interval) -> list[tuple[Sample, Test]]:
    """Every passage of a multiplier through the unit circle, with the orbit there.

    Raises `ConvergenceError` where they cannot be told apart within so long a step.
    """
    for rank in range(len(interval.first.about.reduced)):
        grazed(interval, modulus(rank), GRAZED)
    parts = [(a.distance, b.distance) for a, b in pairwise(interval.known())]
    return [passing for low, high in parts for passing in _between(interval, low, high, DEEPEST)]


def _between(interval: Interval, low: float, high: float, depth: int) -> list[tuple[Sample, Test]]:
    """The passages of a part of an interval, halved until they explain what is beyond +1 and -1 at its ends."""
    a, b = interval.sample(low), interval.sample(high)
    inside = _passed(interval, a, b)
    through = [test.multiplier.real for _, test in inside if not _turning(test)]
    if all(sum(mu * sign > 0 for mu in through) % 2 == (_beyond(a, sign) + _beyond(b, sign)) % 2 for sign in (1, -1)):
        return inside
    if depth == 0:
        if interval.length > UNTOLD:
            raise ConvergenceError("multipliers on the unit circle cannot be told apart within one step")
        return inside
    middle = 0.5 * (low + high)
    return _between(interval, low, middle, depth - 1) + _between(interval, middle, high, depth - 1)


def _passed(interval: Interval, a: Sample, b: Sample) -> list[tuple[Sample, Test]]:
    """One passage for each modulus that is on another side of 1; the two of a complex pair are one passage."""
    passed: list[tuple[Sample, Test]] = []
    rank, count = 0, len(a.about.reduced)
    while rank < count:
        measure = modulus(rank)
        rank += 1
        if (measure(a) < 0) == (measure(b) < 0):
            continue
        sample = located(interval, measure, a.distance, b.distance)
        test = _named(sample, rank - 1)
        rank += _turning(test)
        passed.append((sample, test))
    return passed


def _named(sample: Sample, rank: int) -> Test:
    """What the multiplier of this rank does on the unit circle."""
    mu = complex(multipliers(sample)[rank])
    if not is_real(mu):
        return Test("torus", "", modulus(rank), 0, complex(mu.real, abs(mu.imag)))
    _, kind, detail, order, multiplier = multiplier_levels(sample.about.root)[mu.real <= 0]
    return Test(kind, detail, modulus(rank), order, multiplier)


def _turning(test: Test) -> bool:
    """Whether a complex pair passes the unit circle, and no real multiplier."""
    return test.multiplier.imag != 0.0


def _beyond(sample: Sample, sign: int) -> int:
    """How many real multipliers are beyond +1 or -1."""
    values = multipliers(sample)
    return sum(is_real(mu) and sign * mu.real > 1 for mu in values)
