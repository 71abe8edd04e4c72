"""Passages of stability indices kappa = mu + 1/mu through the values at which families branch.

They are counted on stretches between collisions, on which every index stays real or stays complex, so that
what an index does before it meets another one is told apart from what it does afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import gcd

import numpy as np
from scipy.optimize import brentq

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.samples import Interval, Probe, is_real, real_indices
from orbitfinder.families.stability import matching

LOCATION = 2e-11
"""Arclength within which an event is located."""
TOLD_APART = 1e-4
"""An index located at a level is this near to it, unless two indices were taken for each other."""
UNTOLD = 1e-3
"""Steps longer than this are repeated shorter when indices cannot be told apart."""

Measure = Callable[[Probe], float]


@dataclass(frozen=True)
class Test:
    """A number that vanishes at an event, with what the event then is."""

    kind: str
    detail: str
    measure: Measure
    order: int = 1
    multiplier: complex = 1.0 + 0.0j


def passage(level: float) -> Measure:
    """The distance of the nearest index from a level, its sign changed by every real index that is below it.

    It changes sign where one index passes, whichever that is.
    """

    def measure(probe: Probe) -> float:
        gaps = probe.indices - level
        below = int(np.sum(gaps[real_indices(probe)].real < 0))
        return float((-1.0) ** below * np.abs(gaps).min())

    return measure


def index_levels(root: int, most: int) -> Iterator[tuple[float, str, int, complex]]:
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


def level_tests(root: int, most: int) -> list[tuple[Test, float]]:
    """Every bifurcation that an index may pass, with its level."""
    return [
        (Test(kind, f"q = {order}" if kind == "resonance" else "", passage(level), order, multiplier), level)
        for level, kind, order, multiplier in index_levels(root, most)
    ]


def located(interval: Interval, measure: Measure, low: float, high: float) -> Probe:
    """The orbit at which a measure vanishes, by Brent's method between two distances."""
    if low == high:
        return interval.probe(low)

    def value(distance: float) -> float:
        return measure(interval.probe(distance))

    ends = [value(low), value(high)]
    if ends[0] * ends[1] >= 0:  # within round-off of one end
        return interval.probe((low, high)[int(abs(ends[1]) < abs(ends[0]))])
    # round-off may keep the last bracket wider than asked for
    tight = {"xtol": LOCATION * interval.unit, "rtol": 1e-14, "maxiter": 60, "disp": False}
    return interval.probe(float(brentq(value, low, high, **tight)))


@dataclass(frozen=True)
class Stretch:
    """A part of an interval without a collision inside: its ends, and the indices there in one order."""

    low: float
    high: float
    before: np.ndarray
    after: np.ndarray

    @property
    def real(self) -> np.ndarray:
        """Which indices are real all along."""
        pairs = zip(self.before, self.after, strict=True)
        return np.array([is_real(a) and is_real(b) for a, b in pairs], bool)

    def read(self, probe: Probe) -> np.ndarray:
        """The indices of an orbit on the stretch in the order of its ends."""
        share = (probe.distance - self.low) / (self.high - self.low)
        expected, found = (1 - share) * self.before + share * self.after, probe.indices
        kind, seen = self.real, real_indices(probe)
        if kind.sum() != seen.sum():
            return np.asarray(found[matching(expected, found)])
        values = np.empty_like(found)
        for one, other in ((kind, seen), (~kind, ~seen)):
            values[one] = found[other][matching(expected[one], found[other])]
        return values


def stretches(interval: Interval, met: Sequence[Probe]) -> list[Stretch]:
    """The interval cut at the collisions `met` and at every orbit that was looked at in between."""
    knots = {probe.distance: (probe.indices, probe.turns) for probe in interval.known()}
    knots |= {probe.distance: (joined(probe), np.zeros_like(probe.turns)) for probe in met}
    found = []
    for (low, before), (high, after) in pairwise(sorted(knots.items())):
        found.append(Stretch(low, high, before[0], after[0][_continued(*before, *after)]))
    return found


def _continued(before: np.ndarray, turns: np.ndarray, after: np.ndarray, later: np.ndarray) -> np.ndarray:
    """The order in which indices go on: as they stand, unless kinds differ or Krein signatures were exchanged."""
    first, last = (np.array([is_real(one) for one in values], bool) for values in (before, after))
    order = np.arange(before.size)
    if first.sum() == last.sum() and not np.array_equal(first, last):
        for one, other in ((first, last), (~first, ~last)):
            order[one] = np.flatnonzero(other)[matching(before[one], after[other])]
    for i, j in exchanged(before, turns, after[order], later[order]):
        order[[i, j]] = order[[j, i]]
    return order


def exchanged(before: np.ndarray, turns: np.ndarray, after: np.ndarray, later: np.ndarray) -> list[tuple[int, int]]:
    """Pairs on the unit circle whose opposite Krein signatures have changed places: they have passed each other.

    Nearer to +-2 than to each other, each has rather turned over by itself.
    """
    turned = np.flatnonzero((turns != 0) & (turns == -later))
    found = []
    for i in turned:
        for j in turned[(turned > i) & (turns[turned] == -turns[i])]:
            apart = max(abs(before[i] - before[j]), abs(after[i] - after[j]))
            if apart < min(2 - abs(one[k].real) for one in (before, after) for k in (i, j)):
                found.append((int(i), int(j)))
    return found


def joined(probe: Probe) -> np.ndarray:
    """The indices at a collision, where two are one: their mean in place of the two nearest ones."""
    values = probe.indices.copy()
    gaps = np.abs(values[:, None] - values[None, :]) + np.diag(np.full(values.size, np.inf))
    i, j = np.unravel_index(int(gaps.argmin()), gaps.shape)
    values[[i, j]] = 0.5 * (values[i] + values[j]).real
    return values


def passages(interval: Interval, most: int, met: Sequence[Probe] = ()) -> list[tuple[Probe, Test]]:
    """Every passage of an index through a level of resonances up to order `most`, with the orbit there.

    Raises `ConvergenceError` where two indices cannot be told apart within so long a step.
    """
    levels = level_tests(interval.first.about.root, most)
    parts = stretches(interval, met)
    return [(probe, test) for part in parts for test, level in levels for probe in _passed(interval, part, level)]


def _passed(interval: Interval, part: Stretch, level: float) -> list[Probe]:
    """The orbits of a stretch at which an index passes a level."""
    real = part.real
    before, after = part.before[real].real, part.after[real].real
    rises = (after >= level).astype(int) - (before >= level)
    if not rises.any():
        return []
    if abs(int(rises.sum())) < int(np.abs(rises).sum()):  # some rise and some fall: only their own course tells
        return _each(interval, part, level, np.flatnonzero(real)[rises != 0])
    ranks = np.flatnonzero((np.sort(after) >= level) != (np.sort(before) >= level))
    return [located(interval, _ranked(part, int(rank), level), part.low, part.high) for rank in ranks]


def _ranked(part: Stretch, rank: int, level: float) -> Measure:
    """One of the real indices of a stretch, by its rank, above a level."""
    return lambda probe: float(np.sort(part.read(probe)[part.real].real)[rank] - level)


def _each(interval: Interval, part: Stretch, level: float, positions: np.ndarray) -> list[Probe]:
    found = []
    for j in positions:

        def course(probe: Probe, j: int = int(j)) -> float:
            return float(part.read(probe)[j].real - level)

        probe = located(interval, course, part.low, part.high)
        if abs(course(probe)) <= TOLD_APART:
            found.append(probe)
        elif interval.share > UNTOLD:
            raise ConvergenceError(f"two stability indices near {level:.4g} cannot be told apart within one step")
    return found
