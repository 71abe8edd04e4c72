"""Curves of bifurcations in two parameters: what vanishes along them, read off reduced maps of orbits (see
`stability.reduced_maps`), and their points of codimension two, located between two of their points (see `entries`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.tests import (
    REAL,
    discriminant,
    doubled,
    index_levels,
    levelled,
    nearest_pair,
    unit_pair,
)
from orbitfinder.errors import ConvergenceError
from orbitfinder.families.changes import margins
from orbitfinder.families.doubling import bending
from orbitfinder.families.events import slope
from orbitfinder.families.passages import Measure, Test, zeros
from orbitfinder.families.point import parameter_value
from orbitfinder.families.registry import FOLLOWED, KINDS, Followed
from orbitfinder.families.run import Interval, Sample
from orbitfinder.families.stability import Spectrum, keeps_pairs, reduced_maps
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import Curve, Solution, advanced, at_place, correct, kernel, plane
from orbitfinder.loops.loop import Unknowns
from orbitfinder.orbits.floquet import reciprocal_pairs
from orbitfinder.records.family import End, Event

VANISHED = 1e-3
"""A measure that is no smaller where it was located, relative to its ends, has jumped and did not vanish."""
ASIDE = 1e-3
"""How far aside of a curve of folds its surface is looked at, in the metric"""


@dataclass(frozen=True)
class Critical:
    """The test function of a curve of bifurcations; `parameters` are the two that vary.

    `multiplier` is the critical one of the root map. `margin` names what is grazed: arc, event and which.
    """

    _sparse = ("margin",)

    kind: str
    parameters: tuple[str, str]
    detail: str = ""
    order: int = 1
    multiplier: complex = 1.0 + 0.0j
    margin: tuple[int, str, str] | None = None

    def _check(self) -> None:
        if self.kind not in FOLLOWED:
            raise ValueError(f"kind: no curve leads along a {self.kind}")
        if (self.margin is None) != (self.followed.margin is None):
            raise ValueError(f"margin: does not go with a {self.kind}")

    @property
    def followed(self) -> Followed:
        """What the kind says of its curves."""
        followed: Followed = FOLLOWED[self.kind]
        return followed

    def __call__(self, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
        """The test at orbits (k). Raises `ConvergenceError` where it has no value."""
        return self.followed.vanishes(self, curve, orbits)

    def level(self, conservative: bool) -> float:
        """The value that a stability index, or a multiplier, has along the curve."""
        return float((2.0 if conservative else 1.0) * self.multiplier.real)

    def roots(self, about: Spectrum) -> tuple[np.ndarray, float]:
        """Indices (conservative) or multipliers of an orbit, and the value that one of them has along the curve."""
        return about.indices if about.conservative else about.root_multipliers, self.level(about.conservative)


def at_level(test: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """A root has the value that it has along the curve."""
    roots, conservative = _roots(curve, orbits)
    return np.array([levelled(own, test.level(conservative)) for own in roots])


def pair_at_circle(_: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """The product of a pair is 1."""
    return np.array([unit_pair(multipliers)[0] - 1.0 for multipliers in _multipliers(curve, orbits)])


def neutral(curve: Curve, orbit: Solution) -> str:
    """Of a pair of product 1 that is real that it is no torus's."""
    real = abs(unit_pair(_multipliers(curve, [orbit])[0])[1]) >= 2.0
    return "two real multipliers of product 1, a neutral saddle and no torus" if real else ""


def indices_meet(_: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """Two stability indices are one."""
    return np.array([discriminant(roots) for roots in _roots(curve, orbits)[0]])


def grazed(test: Critical, curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """The margin of the curve."""
    assert test.margin is not None
    known = [margins(curve, orbit).get(test.margin) for orbit in orbits]
    if None in known:
        raise ConvergenceError(f"what is grazed is no longer near {test.margin[1]}; take a smaller step")
    return np.array([margin.value for margin in known if margin])


def _multipliers(curve: Curve, orbits: Sequence[Solution]) -> np.ndarray:
    """Those of each orbit's root map (k x r)."""
    return np.linalg.eigvals(reduced_maps(curve, orbits)[0]).astype(complex)


def _roots(curve: Curve, orbits: Sequence[Solution]) -> tuple[np.ndarray, bool]:
    """Stability indices (k x ...) where multipliers of all orbits come in pairs, as is said, else multipliers."""
    reduced = reduced_maps(curve, orbits)[0]
    roots, conservative = np.linalg.eigvals(reduced).astype(complex), keeps_pairs(curve, reduced)
    if conservative:
        pairs = [(own, *reciprocal_pairs(own)) for own in roots]
        roots = np.array([own[first] + own[second] for own, first, second in pairs])
    return roots, conservative


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
    same = "1:1" if test.multiplier.real > 0 or about.root == 2 else "1:2"
    yield Test("strong_resonance", same, lambda sample: doubled(*test.roots(sample.about)), test.order, test.multiplier)
    if about.root == 2 and not about.conservative:
        return
    doubling = 1j if about.root == 2 else -1.0 + 0.0j
    mu = 1.0 + 0.0j if test.order == 2 else doubling  # where another root makes a fold of a doubling, or the reverse
    other = replace(test, multiplier=mu).level(about.conservative)
    if other != test.level(about.conservative):
        yield Test("fold_doubling", "", lambda sample: levelled(test.roots(sample.about)[0], other), 2, mu)


def along_circle(_: Critical, about: Spectrum) -> Iterator[Test]:
    """The tests of a curve of tori: where the pair goes along the unit circle, and what another multiplier does."""
    yield from _resonances(about.root, lambda sample: unit_pair(sample.about.root_multipliers)[1])
    for kind, order, mu in (("fold_torus", 1, 1.0), ("doubling_torus", 2, -1.0)):
        beside = partial(lambda mu, sample: levelled(unit_pair(sample.about.root_multipliers)[2], mu), mu)
        yield Test(kind, "", beside, order, complex(mu))


def along_collisions(_: Critical, about: Spectrum) -> Iterator[Test]:
    """The tests of a curve of collisions: where the two pairs that meet go along the unit circle."""
    yield from _resonances(about.root, lambda sample: float(np.mean(nearest_pair(sample.about.indices)).real))


def _resonances(root: int, total: Measure) -> Iterator[Test]:
    """The strong resonances of a pair of multipliers on the unit circle whose sum is `total`."""
    for level, _, _, order, multiplier in index_levels(root, 4):
        less = partial(lambda level, sample: total(sample) - level, level)
        yield Test("strong_resonance", f"1:{order}", less, order, multiplier)


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
