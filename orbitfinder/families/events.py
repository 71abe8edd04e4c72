"""What happens between two neighbouring points of a family, and exactly where.

Folds are sign changes of d(energy)/ds, d(period)/ds, d(parameter)/ds; bifurcations are passages of a
stability index kappa = mu + 1/mu through 2 cos(2 pi k / q); collisions are sign changes of the
discriminant (kappa_i - kappa_j)^2. Where the orbit is its own mirror image the indices are those of
the half map, whose square is the monodromy: there a multiplier touches -1 without crossing it, and
the half map's index passes 0. Located with Brent's method on the arclength, each trial a corrected orbit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import gcd

import numpy as np
from scipy.optimize import brentq

from orbitfinder.families.points import Event, FamilySettings, parameter_value
from orbitfinder.families.stability import Spectrum, matching, spectrum
from orbitfinder.families.system import Aim, Curve, Place, Solution, advanced, bend, correct, head_of, tangent

LOCATION = 2e-11
"""Arclength within which an event is located."""
REAL = 1e-7
"""An index counts as real when its imaginary part is below this, relative to its size."""


@dataclass(frozen=True)
class Probe:
    """A corrected orbit between two points: distance from the first, tangent (over w), indices, their turns."""

    distance: float
    found: Solution
    whole: np.ndarray
    about: Spectrum
    indices: np.ndarray
    turns: np.ndarray
    slopes: dict[str, float]


@dataclass(frozen=True)
class Interval:
    """The stretch of a family between two corrected places on the same mesh."""

    curve: Curve
    first: Probe
    last: Probe
    curvature: np.ndarray
    twist: np.ndarray

    @property
    def length(self) -> float:
        """Arclength (measured along the first tangent)."""
        return self.last.distance

    def guess(self, distance: float) -> Place:
        """The cubic through both ends with both tangents."""
        bent = self.curvature + (distance - self.length) * self.twist
        return advanced(self.first.found.place, self.first.whole, distance, bent)

    def slope(self, distance: float) -> np.ndarray | None:
        """The Jacobian between those of the ends."""
        share, (a, b) = distance / self.length, (self.first.found.jacobian, self.last.found.jacobian)
        return np.asarray((1 - share) * a + share * b) if a.shape == b.shape else None

    def indices(self, distance: float) -> np.ndarray:
        """Indices between those of the ends."""
        share = distance / self.length
        return np.asarray((1 - share) * self.first.indices + share * self.last.indices)


Measure = Callable[[Probe], float]


def _slope(name: str) -> Measure:
    return lambda probe: probe.slopes[name]


def passage(j: int, level: float) -> Measure:
    """The real part of one index above a level."""
    return lambda probe: float(probe.indices[j].real - level)


def discriminant(i: int, j: int) -> Measure:
    """(kappa_i - kappa_j)^2, negative where the two have left the real axis together."""
    return lambda probe: float(((probe.indices[i] - probe.indices[j]) ** 2).real)


@dataclass(frozen=True)
class Test:
    """A number that vanishes at an event, with what the event then is."""

    kind: str
    detail: str
    measure: Measure
    order: int = 1
    multiplier: complex = 1.0 + 0.0j


def parameter_slopes(curve: Curve, place: Place, head: np.ndarray) -> dict[str, float]:
    """d/ds of energy, period and every freed parameter along a direction over the head."""
    p, size = curve.propagator, curve.propagator.size
    _, slope, free = (part.full() for part in p.quantities(place.nodes[0], place.free))
    energy = float(slope[0] @ head[:size] + free[0] @ head[size + 1 :])
    slopes = {"energy": energy, "period": float(head[size])}
    slopes |= {name: float(head[size + 1 + k]) for k, name in enumerate(p.free)}
    return slopes | {name: float(head[k]) for k, name in enumerate(p.model.state_names)}


def make_probe(curve: Curve, distance: float, found: Solution, whole: np.ndarray, expected: np.ndarray) -> Probe:
    """Everything that the tests read, at one corrected place."""
    about = spectrum(curve, found)
    slopes = parameter_slopes(curve, found.place, head_of(whole, found.place))
    order = matching(expected, about.indices)
    return Probe(distance, found, whole, about, about.indices[order], about.turns[order], slopes)


def probe_at(interval: Interval, distance: float) -> Probe:
    """The orbit at a distance (along the first tangent) into the interval, corrected."""
    first, curve = interval.first, interval.curve
    normal = curve.weights * head_of(first.whole, first.found.place)
    aim = Aim(float(normal @ first.found.place.head) + distance, normal)
    reach = max(0.5 * interval.length, 1e-6)
    found = correct(curve, interval.guess(distance), aim, first.found.place, reach, interval.slope(distance))
    whole = tangent(curve, found, head_of(first.whole, first.found.place))
    return make_probe(curve, distance, found, whole, interval.indices(distance))


def make_interval(curve: Curve, first: Probe, last: Probe) -> Interval:
    """The interval between two probes on one mesh.

    With w(d) = w0 + d t + d^2 c + d^2 (d - D) e, w(D) fixes c and the last tangent, taken per unit of d, fixes e.
    """
    curvature = bend(curve, first.found.place, first.whole, last.found.place)
    twist, length = np.zeros_like(curvature), last.distance
    along = float((curve.weights * head_of(first.whole, first.found.place)) @ head_of(last.whole, last.found.place))
    if last.whole.shape == first.whole.shape and along > 0.5:
        twist = (last.whole / along - first.whole - 2 * length * curvature) / length**2
    return Interval(curve, first, last, curvature, twist)


def is_real(value: complex) -> bool:
    """Whether an index counts as real."""
    return abs(value.imag) <= REAL * max(1.0, abs(value))


def _index_levels(root: int, most: int) -> Iterator[tuple[float, str, int, complex]]:
    """(level of the index, kind, order q, critical multiplier of the root map) of every bifurcation."""
    yield 2.0, "branch_point", 1, 1.0 + 0.0j
    if root == 1:
        yield -2.0, "period_doubling", 2, -1.0 + 0.0j
    else:
        yield -2.0, "branch_point", 1, -1.0 + 0.0j
        yield 0.0, "period_doubling", 2, 1.0j
    for q in range(3, most + 1):
        for k in range(1, (q if root == 2 else q // 2) + 1):
            if gcd(k, q) == 1 and k < q:
                angle = 2 * np.pi * k / (q * root)
                yield 2 * float(np.cos(angle)), "resonance", q, complex(np.exp(1j * angle))


def level_tests(root: int, most: int, j: int) -> list[tuple[Test, float]]:
    """Every bifurcation that one index may pass, with its level."""
    return [
        (Test(kind, f"q = {order}" if kind == "resonance" else "", passage(j, level), order, multiplier), level)
        for level, kind, order, multiplier in _index_levels(root, most)
    ]


def tests_for(interval: Interval, settings: FamilySettings) -> Iterator[Test]:
    """Every test that changes sign across the interval."""
    a, b = interval.first, interval.last
    names = ["energy", "period", *interval.curve.propagator.free]
    if interval.curve.propagator.free:
        names = [*interval.curve.propagator.free]
    for name in names:
        if a.slopes[name] * b.slopes[name] < 0:
            yield Test("fold", name, _slope(name))
    for j, (before, after) in enumerate(zip(a.indices, b.indices, strict=True)):
        if not (is_real(before) and is_real(after)):
            continue
        for test, level in level_tests(a.about.root, settings.resonances, j):
            if (before.real - level) * (after.real - level) < 0:
                yield test
    for i in range(a.indices.size):
        for j in range(i + 1, a.indices.size):
            before, after = ((p.indices[i] - p.indices[j]) ** 2 for p in (a, b))
            if is_real(before) and is_real(after) and before.real * after.real < 0:
                yield Test("collision", "", discriminant(i, j))


def located(interval: Interval, test: Test, low: float = 0.0, high: float | None = None) -> Probe:
    """The orbit at which a test vanishes, between two distances (default: anywhere in the interval)."""
    seen = {0.0: interval.first, interval.length: interval.last}
    high = interval.length if high is None else high
    if low == high:
        return probe_at(interval, low)

    def value(distance: float) -> float:
        if distance not in seen:
            seen[distance] = probe_at(interval, distance)
        return test.measure(seen[distance])

    # round-off may keep the last bracket wider than asked for
    where = float(brentq(value, low, high, xtol=LOCATION, rtol=1e-14, maxiter=60, disp=False))
    value(where)
    return seen[where]


Bracket = tuple[Test, float, float]


def find_events(
    interval: Interval, settings: FamilySettings, arclength: float, more: Sequence[Bracket] = ()
) -> list[tuple[float, Event]]:
    """Events of an interval with their distance into it, in order along the family; `more` are known brackets."""
    found = [(located(interval, test), test) for test in tests_for(interval, settings)]
    found += [(located(interval, *one), one[0]) for one in more]
    found.sort(key=lambda pair: pair[0].distance)
    turns = [probe.distance for probe, test in found if test.kind == "fold" and test.detail == "energy"]
    found = [(p, t) for p, t in found if not (t.kind == "branch_point" and _near(p.distance, turns))]
    events = [(p.distance, _event(interval.curve, p, test, settings, arclength)) for p, test in found]
    return sorted(events + _changes(interval, found, settings, arclength), key=lambda pair: pair[0])


def _near(distance: float, places: list[float]) -> bool:
    """Whether a branch point is only the multiplier +1 that every fold in energy has."""
    return any(abs(distance - other) < 1e-5 for other in places)


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
        nodes=place.nodes,
        mesh=place.mesh,
        tangent=head_of(probe.whole, place),
        symmetry=curve.propagator.symmetry.name,
        free=dict(zip(curve.propagator.free, map(float, place.free), strict=True)),
    )


def _changes(
    interval: Interval, found: list[tuple[Probe, Test]], settings: FamilySettings, arclength: float
) -> list[tuple[float, Event]]:
    """The located events at which the verdict changes, read halfway to their neighbours."""
    critical = [(p, t) for p, t in found if t.kind in ("branch_point", "period_doubling", "collision", "fold")]
    a, b = (p.about.floquet.stability == "unstable" for p in (interval.first, interval.last))
    if not critical or (a == b and len(critical) < 2):
        return []
    edges = [0.0, *(p.distance for p, _ in critical), interval.length]
    verdicts = [a]
    for before, after in pairwise(edges[1:-1]):
        inner = probe_at(interval, 0.5 * (before + after)) if after - before > 1e-7 else None
        verdicts.append(verdicts[-1] if inner is None else inner.about.floquet.stability == "unstable")
    verdicts.append(b)
    changes = []
    for k, (probe, _) in enumerate(critical):
        if verdicts[k] != verdicts[k + 1]:
            detail = "becomes unstable" if verdicts[k + 1] else "becomes stable"
            test = Test("stability_change", detail, lambda p: 0.0)
            changes.append((probe.distance, _event(interval.curve, probe, test, settings, arclength)))
    return changes
