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
from itertools import pairwise

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.collisions import collisions, look, meeting
from orbitfinder.families.crossings import crossings
from orbitfinder.families.passages import Measure, Test, located, passages
from orbitfinder.families.point import FamilySettings, parameter_value
from orbitfinder.families.samples import Interval as Interval
from orbitfinder.families.samples import Probe as Probe
from orbitfinder.families.samples import make_interval as make_interval
from orbitfinder.families.samples import make_probe as make_probe
from orbitfinder.families.samples import parameter_slopes as parameter_slopes
from orbitfinder.families.strips import strips
from orbitfinder.loops.continued import Curve
from orbitfinder.orbits.floquet import ERROR_FLOOR
from orbitfinder.records.family import Event

CRITICAL = ("branch_point", "period_doubling", "torus")
"""Kinds at which a multiplier leaves or enters the unit circle."""
ROUNDS = 4
"""How often collisions are looked for again after orbits between them were seen."""


BLURRED = 1e-6
"""Uncertainty of the stability indices beyond which none of their passages can be told from round-off."""


def blur(probe: Probe) -> float:
    """What round-off in the largest multiplier leaves uncertain in every stability index."""
    return float(np.finfo(float).eps * np.abs(probe.about.floquet.multipliers).max(initial=1.0))


def _slope(name: str) -> Measure:
    return lambda probe: probe.slopes[name]


def folds(interval: Interval) -> Iterator[Test]:
    """Every fold of the interval."""
    free = interval.curve.equations.free
    for name in free or ("energy", "period"):
        if interval.first.slopes[name] * interval.last.slopes[name] < 0:
            yield Test("fold", name, _slope(name))


def bifurcations(interval: Interval, most: int) -> list[tuple[Probe, Test]]:
    """Collisions, bifurcations and resonances up to order `most` of an interval, each with the orbit there.

    Raises `ConvergenceError` when they cannot be told apart within so long a step.
    """
    if interval.first.indices.shape != interval.last.indices.shape:
        return []
    if max(blur(interval.first), blur(interval.last)) > BLURRED:
        return []
    if not interval.first.about.conservative:
        return crossings(interval)
    if not interval.first.indices.size:
        return []
    touched = [(interval.probe(place), test) for test, place in strips(interval)]
    look(interval)
    for _ in range(ROUNDS):
        brackets = collisions(interval)
        met = [located(interval, meeting, low, high) for low, high in brackets]
        passed = passages(interval, most, met)
        if len(collisions(interval)) == len(brackets):  # nothing that was seen meanwhile says otherwise
            return touched + [(probe, Test("collision", "", meeting)) for probe in met] + passed
    raise ConvergenceError("collisions of multipliers cannot be told apart within one step")


def find_events(interval: Interval, settings: FamilySettings, arclength: float) -> list[tuple[float, Event]]:
    """Events of an interval with their distance into it, in order along the family."""
    found = [(located(interval, test.measure, 0.0, interval.length), test) for test in folds(interval)]
    found += bifurcations(interval, settings.resonances)
    found.sort(key=lambda pair: pair[0].distance)
    turns = [probe.distance for probe, test in found if test.kind == "fold" and test.detail != "period"]
    found = [(p, t) for p, t in found if not (t.kind == "branch_point" and _near(p.distance, turns, interval.unit))]
    found = [(p, t) for p, t in found if t.kind != "branch_point" or _told(interval)]
    events = [(p.distance, _event(interval.curve, p, test, settings, arclength)) for p, test in found]
    return sorted(events + _changes(interval, found, settings, arclength), key=lambda pair: pair[0])


def _told(interval: Interval) -> bool:
    """Whether branch points are more than an index that stays at +-2 to within what the monodromy is known to."""
    ends = (interval.first, interval.last)
    if not interval.first.about.conservative or not interval.first.indices.size:
        return True
    margins = [np.abs(np.asarray(probe.indices).real) - 2.0 for probe in ends]
    first, last = (np.sort(np.where(np.abs(one) > ERROR_FLOOR, np.sign(one), 0.0)) for one in margins)
    return not (np.any(first == 0.0) and np.array_equal(first, last))


def _near(distance: float, places: list[float], unit: float) -> bool:
    """Whether a branch point is only the multiplier +1 that every fold has."""
    return any(abs(distance - other) < 1e-5 * unit for other in places)


def _event(curve: Curve, probe: Probe, test: Test, settings: FamilySettings, arclength: float) -> Event:
    place = probe.found.place
    return Event(
        kind=test.kind,
        index=-1,
        arclength=arclength + probe.distance,
        parameter=parameter_value(curve, place, settings.parameter),
        state=place.nodes[0],
        period=place.period,
        energy=parameter_value(curve, place, "energy"),
        detail=test.detail,
        order=test.order,
        multiplier=test.multiplier,
        shooting_nodes=place.nodes,
        mesh=place.mesh,
        tangent=place.head_of(probe.whole),
        symmetry=curve.equations.symmetry.name,
        free=dict(zip(curve.equations.free, map(float, place.free), strict=True)),
    )


def _changes(
    interval: Interval, found: list[tuple[Probe, Test]], settings: FamilySettings, arclength: float
) -> list[tuple[float, Event]]:
    """The located events at which the verdict changes, read halfway to their neighbours."""
    critical = [(p, t) for p, t in found if t.kind in (*CRITICAL, "collision", "fold")]
    a, b = (p.about.floquet.stability == "unstable" for p in (interval.first, interval.last))
    if not critical or (a == b and len(critical) < 2):
        return []
    edges = [0.0, *(p.distance for p, _ in critical), interval.length]
    verdicts = [a]
    for before, after in pairwise(edges[1:-1]):
        inner = interval.probe(0.5 * (before + after)) if after - before > 1e-7 * interval.unit else None
        verdicts.append(verdicts[-1] if inner is None else inner.about.floquet.stability == "unstable")
    verdicts.append(b)
    changes = []
    for k, (probe, _) in enumerate(critical):
        if verdicts[k] != verdicts[k + 1]:
            detail = "becomes unstable" if verdicts[k + 1] else "becomes stable"
            test = Test("stability_change", detail, lambda p: 0.0)
            changes.append((probe.distance, _event(interval.curve, probe, test, settings, arclength)))
    return changes
