"""Points of codimension two on a curve of bifurcations: located between two of its points and named (see `entries`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from math import gcd

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.families.critical import REAL, Critical, doubled, levelled, nearest_pair, torus_pair
from orbitfinder.families.doubling import bending
from orbitfinder.families.events import slope
from orbitfinder.families.passages import Measure, Test, zeros
from orbitfinder.families.point import parameter_value
from orbitfinder.families.registry import KINDS
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
    test = _critical(interval)
    return [*_zeros(interval, test.followed.tests(test, interval.first.about)), *test.followed.special(interval)]


def left_circle(curve: Curve, event: Event) -> End | None:
    """The end of a curve of tori, or of Krein collisions, whose multipliers become real: beyond are neutral saddles."""
    beyond = curve.test.followed.beyond if isinstance(curve.test, Critical) else ""
    if not beyond or not KINDS[event.kind].leaves:
        return None
    if abs(event.multiplier.imag) > REAL:  # of a half period, it goes on round the circle
        return None
    return End(event.kind, f"the critical multipliers become real at a {event.detail} resonance; beyond is {beyond}")


def _critical(interval: Interval) -> Critical:
    test = interval.curve.test
    assert isinstance(test, Critical)
    return test


def _zeros(interval: Interval, wanted: Iterable[Test]) -> Iterator[tuple[Sample, Test]]:
    for sample, test in zeros(interval, wanted):
        ends = [test.measure(end) for end in (interval.first, interval.last)]
        if abs(test.measure(sample)) < VANISHED * max(map(abs, ends)):
            yield sample, test


def doublings_turn(interval: Interval) -> Iterator[tuple[Sample, Test]]:
    """Where doublings degenerate: of whole periods without resets, of what dissipates."""
    about, p = interval.first.about, interval.curve.equations
    if not (p.links or about.conservative or p.model.conservative) and p.symmetry.fraction == 1 and about.root == 1:
        turn = Test("degenerate_doubling", "", lambda sample: bending(interval.curve, sample.solution), 2, -1.0 + 0.0j)
        yield from _zeros(interval, [turn])


def beside_level(test: Critical, about: Spectrum) -> Iterator[Test]:
    """The tests of a curve along which a root is at +1 or -1: what another root does."""
    if about.root_multipliers.size < 2:
        return
    level = test.roots(about)[1]

    same = "1:1" if test.multiplier.real > 0 or about.root == 2 else "1:2"
    yield Test("strong_resonance", same, lambda sample: doubled(*test.roots(sample.about)), test.order, test.multiplier)
    if about.root == 2 and not about.conservative:
        return
    doubling = 1j if about.root == 2 else -1.0 + 0.0j
    mu = 1.0 + 0.0j if test.order == 2 else doubling  # where another root makes a fold of a doubling, or the reverse
    other = (2.0 if about.conservative else 1.0) * mu.real
    if other != level:
        yield Test("fold_doubling", "", lambda sample: levelled(test.roots(sample.about)[0], other), 2, mu)


def along_circle(_: Critical, about: Spectrum) -> Iterator[Test]:
    """The tests of a curve of tori: where the pair goes along the unit circle, and what another multiplier does."""
    yield from _resonances(about.root, lambda sample: torus_pair(sample.about.root_multipliers)[1])
    for kind, mu in (("fold_torus", 1.0), ("doubling_torus", -1.0)):
        yield Test(kind, "", _beside(mu), 1 if mu > 0 else 2, complex(mu))


def along_collisions(_: Critical, about: Spectrum) -> Iterator[Test]:
    """The tests of a curve of collisions: where the two pairs that meet go along the unit circle."""
    yield from _resonances(about.root, lambda sample: float(np.mean(nearest_pair(sample.about.indices)).real))


def _resonances(root: int, total: Measure) -> Iterator[Test]:
    """The strong resonances of a pair of multipliers on the unit circle whose sum is `total`."""
    for order in (1, 2, 3, 4):
        for k in range(order * root // 2 + 1):
            if gcd(k, order) == 1:
                angle = 2 * np.pi * k / (order * root)
                name = f"1:{order}" if 0 < k < order * root / 2 or root == 1 else "1:1"
                less = partial(lambda level, sample: total(sample) - level, 2 * float(np.cos(angle)))
                yield Test("strong_resonance", name, less, order, complex(np.exp(1j * angle)))


def _beside(mu: float) -> Measure:
    return lambda sample: levelled(torus_pair(sample.about.root_multipliers)[2], mu)


def folds_turn(interval: Interval) -> Iterator[tuple[Sample, Test]]:
    """Cusps, and places where the parameter that folds is extremal along a curve of folds."""
    critical = _critical(interval)

    def slopes(sample: Sample) -> np.ndarray:
        return np.array([sample.slopes[name] for name in critical.parameters])

    ends = np.array([slopes(sample) for sample in (interval.first, interval.last)])
    sizes = nonzero(np.abs(ends).max(axis=0))
    ends = ends / sizes
    if ends[0] @ ends[1] < 0:
        across = (ends[0] / np.linalg.norm(ends[0]) - ends[1] / np.linalg.norm(ends[1])) / sizes
        for sample, test in _zeros(interval, [Test("cusp", "", lambda sample: float(across @ slopes(sample)))]):
            if np.linalg.norm(slopes(sample) / sizes) < VANISHED * max(map(np.linalg.norm, ends)):
                yield sample, test
        return
    folding = critical.detail
    wanted = [Test("transcritical", folding, slope(folding))] if folding in critical.parameters else []
    for sample, test in _zeros(interval, wanted):
        rising = interval.last.slopes[folding] - interval.first.slopes[folding]
        centre = is_centre(interval.curve, sample.solution.place, folding, rising)
        yield sample, replace(test, kind="isola_centre") if centre else test


def is_centre(curve: Curve, place: Unknowns, name: str, rising: float) -> bool:
    """Whether the parameter that folds is extremal on the whole surface of orbits, and not only along the curve.

    `rising` has the sign of how the curve is bent there.
    """
    assert isinstance(curve.test, Critical)
    (other,) = {*curve.test.parameters} - {name}
    fixed = pinned(curve.equations, other, parameter_value(curve, place, other))
    family = replace(curve, test=None, degenerate=False, conditions=(*curve.conditions, fixed))
    solution, bent = at_place(family, place), 0.0
    whole = kernel(family, solution)
    for length in (-ASIDE, ASIDE):
        aim = plane(family, place, whole, length)
        aside = correct(family, advanced(place, whole, length), aim, place, slope=solution.jacobian)
        bent += parameter_value(curve, aside.place, name) - parameter_value(curve, place, name)
    return bent * rising > 0
