"""Points of codimension two on a curve of bifurcations: found between two of its points, located and named.

cusp                two folds meet: the curve stops in the plane of the two parameters and turns back
isola_centre        a fold's parameter is extremal: an isola shrinks to a point (transcritical: two families cross)
strong_resonance    1:1 to 1:4, the critical multipliers of a torus or of a collision; a second one at +1 or -1
fold_doubling       one multiplier at +1 and another at -1
fold_torus, doubling_torus  one at +1 or -1 beside the pair of a torus
degenerate_doubling the orbit of twice the period is born to the other side from there on: its family folds nearby
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from math import gcd

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.families.critical import REAL, Critical, doubled, levelled, nearest_pair, torus_pair
from orbitfinder.families.doubling import bending, can_bend
from orbitfinder.families.events import slope
from orbitfinder.families.passages import Measure, Test, zeros
from orbitfinder.families.point import parameter_value
from orbitfinder.families.run import Interval, Sample
from orbitfinder.families.stability import Spectrum
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import Curve, advanced, at_place, correct, kernel, plane
from orbitfinder.loops.loop import Unknowns
from orbitfinder.records.family import End, Event

VANISHED = 1e-3
"""A measure that is no smaller where it was located, relative to its ends, has jumped and did not vanish."""
ASIDE = 1e-3
"""How far aside of a curve of folds its surface is looked at, in the metric"""


def find_special(interval: Interval) -> list[tuple[Sample, Test]]:
    """The points of codimension two between two points of a curve, each with the orbit there."""
    wanted = [*tests(_critical(interval), interval.first.about)]
    if can_bend(interval.curve) and not (first := interval.first.about).conservative and first.root == 1:
        measure = partial(_bending, interval.curve)
        wanted.append(Test("degenerate_doubling", "", measure, 2, -1.0 + 0.0j))
    return [*_zeros(interval, wanted), *(_turns(interval) if _critical(interval).kind == "fold" else ())]


def left_circle(curve: Curve, event: Event) -> End | None:
    """The end of a curve of tori, or of Krein collisions, whose multipliers become real: beyond are neutral saddles."""
    test = curve.test
    if not isinstance(test, Critical) or test.kind not in ("torus", "collision") or event.kind != "strong_resonance":
        return None
    if abs(event.multiplier.imag) > REAL:  # of a half period, it goes on round the circle
        return None
    what = "a neutral saddle" if test.kind == "torus" else "real multipliers that meet"
    return End(
        "strong_resonance", f"the critical multipliers become real at a {event.detail} resonance; beyond is {what}"
    )


def _critical(interval: Interval) -> Critical:
    test = interval.curve.test
    assert isinstance(test, Critical)
    return test


def _zeros(interval: Interval, wanted: Iterable[Test]) -> Iterator[tuple[Sample, Test]]:
    for sample, test in zeros(interval, wanted):
        ends = [test.measure(one) for one in (interval.first, interval.last)]
        if abs(test.measure(sample)) < VANISHED * max(map(abs, ends)):
            yield sample, test


def _bending(curve: Curve, sample: Sample) -> float:
    return bending(curve, sample.found)


def tests(one: Critical, about: Spectrum) -> Iterator[Test]:
    """The tests of a curve that are read off its multipliers."""
    if one.kind in ("torus", "collision"):
        yield from _resonances(one, about.root)
        return
    if one.margin is not None or one.kind == "resonance" or about.reduced.shape[0] < 2:
        return
    level = one.roots(about)[1]

    def met(sample: Sample) -> float:
        return doubled(*one.roots(sample.about))

    plus = one.multiplier.real > 0 and one.kind != "period_doubling"
    yield Test("strong_resonance", "1:1" if plus or about.root == 2 else "1:2", met, one.order, one.multiplier)
    other, mu = _opposite(one, about.root, about.conservative)
    if other is None or other == level:
        return

    def both(sample: Sample, other: float = other) -> float:
        return levelled(one.roots(sample.about)[0], other)

    yield Test("fold_doubling", "", both, 2, mu)


def _opposite(one: Critical, root: int, conservative: bool) -> tuple[float | None, complex]:
    """Where another index, or multiplier, makes a fold of a doubling or a doubling of a fold; its multiplier."""
    doubling = 1j if root == 2 else -1.0 + 0.0j
    if root == 2 and not conservative:
        return None, doubling
    mu = 1.0 + 0.0j if one.kind == "period_doubling" else doubling
    return (2.0 if conservative else 1.0) * mu.real, mu


def _resonances(one: Critical, root: int) -> Iterator[Test]:
    """The tests of a pair of multipliers that goes along the unit circle."""

    def total(sample: Sample) -> float:
        if one.kind == "torus":
            return torus_pair(sample.about.multipliers)[1]
        return float(np.mean(nearest_pair(sample.indices)).real)

    for order in (1, 2, 3, 4):
        for k in range(order * root // 2 + 1):
            if gcd(k, order) == 1:
                angle = 2 * np.pi * k / (order * root)
                level = 2 * float(np.cos(angle))
                name = f"1:{order}" if 0 < k < order * root / 2 or root == 1 else "1:1"
                yield Test("strong_resonance", name, _less(total, level), order, complex(np.exp(1j * angle)))
    if one.kind == "torus":
        for kind, mu in (("fold_torus", 1.0), ("doubling_torus", -1.0)):
            yield Test(kind, "", _beside(mu), 1 if mu > 0 else 2, complex(mu))


def _less(measure: Measure, level: float) -> Measure:
    return lambda sample: measure(sample) - level


def _beside(mu: float) -> Measure:
    return lambda sample: levelled(torus_pair(sample.about.multipliers)[2], mu)


def _turns(interval: Interval) -> Iterator[tuple[Sample, Test]]:
    """Cusps, and places where the parameter that folds is extremal along a curve of folds."""
    one = _critical(interval)

    def slopes(sample: Sample) -> np.ndarray:
        return np.array([sample.slopes[name] for name in one.parameters])

    ends = np.array([slopes(sample) for sample in (interval.first, interval.last)])
    sizes = nonzero(np.abs(ends).max(axis=0))
    ends = ends / sizes
    if ends[0] @ ends[1] < 0:
        across = (ends[0] / np.linalg.norm(ends[0]) - ends[1] / np.linalg.norm(ends[1])) / sizes
        for sample, test in _zeros(interval, [Test("cusp", "", lambda sample: float(across @ slopes(sample)))]):
            if np.linalg.norm(slopes(sample) / sizes) < VANISHED * max(map(np.linalg.norm, ends)):
                yield sample, test
        return
    wanted = [Test("transcritical", one.detail, slope(one.detail))] if one.detail in one.parameters else []
    for sample, test in _zeros(interval, wanted):
        rising = interval.last.slopes[one.detail] - interval.first.slopes[one.detail]
        centre = is_centre(interval.curve, sample.found.place, one.detail, rising)
        yield sample, replace(test, kind="isola_centre") if centre else test


def is_centre(curve: Curve, place: Unknowns, name: str, rising: float) -> bool:
    """Whether the parameter that folds is extremal on the whole surface of orbits, and not only along the curve.

    `rising` has the sign of how the curve is bent there.
    """
    assert isinstance(curve.test, Critical)
    (other,) = {*curve.test.parameters} - {name}
    fixed = pinned(curve.equations, other, parameter_value(curve, place, other))
    family = replace(curve, test=None, degenerate=False, conditions=(*curve.conditions, fixed))
    found, bent = at_place(family, place), 0.0
    whole = kernel(family, found)
    for length in (-ASIDE, ASIDE):
        aim = plane(family, place, whole, length)
        aside = correct(family, advanced(place, whole, length), aim, place, slope=found.jacobian)
        bent += parameter_value(curve, aside.place, name) - parameter_value(curve, place, name)
    return bent * rising > 0
