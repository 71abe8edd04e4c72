"""Passages of stability indices kappa = mu + 1/mu through the values at which families branch.

They are counted on subintervals between collisions, on which every index stays real or stays complex, so that
what an index does before it meets another one is told apart from what it does afterwards.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from orbitfinder._runtime.arguments import check
from orbitfinder.continuation.follow import zero
from orbitfinder.continuation.tests import index_levels
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.run import JUNCTION, Interval, Sample, ahead, is_real, real_indices
from orbitfinder.families.stability import matching
from orbitfinder.loops.continued import AvoidedCrossing, Curve, avoided_crossing, crossed

LOCATION = 2e-11
"""Arclength within which an event is located."""
TOLD, WIDER = 1e-4, (1, 2, 4)
"""Smallest singular value, relative to the next, with which an orbit is known to 1e-10 beside a crossing family; times
the usual way from a crossing at which orbits are looked for that are"""
STRAIGHT = 0.02
"""Share of the little way past a crossing family by which a measure that vanishes there is off its straight line."""
EXTREMUM, MOST_LOOKS, TOLD_LOW = 1e-3, 25, 0.1
"""Share of a step to which the extremum of a measure is located, orbits that are looked at for it, and share of its
height by which a parabola may miss it that tells it"""
UNTOLD = 1e-3
"""Steps longer than this are repeated shorter when indices cannot be told apart."""

Measure = Callable[[Sample], float]


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

    def measure(sample: Sample) -> float:
        gaps = sample.indices - level
        below = int(np.sum(gaps[real_indices(sample)].real < 0))
        return float((-1.0) ** below * np.abs(gaps).min())

    return measure


def located(
    interval: Interval, measure: Measure, low: float, high: float, sampled: Callable[[float], Sample] | None = None
) -> Sample:
    """The orbit at which a measure vanishes, by Brent's method between two distances."""
    sampled, fit = sampled or interval.sample, interval.fitted
    if low == high:
        return sampled(low)

    def value(distance: float) -> float:
        return measure(sampled(distance))

    ends = [value(low), value(high)]
    if ends[0] * ends[1] >= 0 and sampled == fit and high - low < interval.length:
        return located(interval, measure, 0.0, interval.length, fit)
    if ends[0] * ends[1] >= 0:  # within round-off of one end
        return sampled((low, high)[int(abs(ends[1]) < abs(ends[0]))])
    sample = sampled(zero(value, low, high, LOCATION))
    if interval.crossed(sample):
        sample = replace(sample, whole=interval.heading(sample.distance))  # its rows tell neither family's tangent
        with suppress(ConvergenceError, IntegrationError):  # as of a step that is too short to look beyond
            return _across(interval, measure, sample)
    if sampled != fit and interval.strayed(sample):
        return located(interval, measure, low, high, fit)
    return sample


def zeros(interval: Interval, tests: Iterable[Test]) -> Iterator[tuple[Sample, Test]]:
    """The tests that change their sign across an interval, each with the orbit at which it vanishes."""
    for test in tests:
        ends = [test.measure(sample) for sample in (interval.first, interval.last)]
        for value in ends:
            check(f"EventKind {test.kind!r}, measure of its Test", "float", value)
        if ends[0] * ends[1] < 0:
            yield located(interval, test.measure, 0.0, interval.length), test


def _across(interval: Interval, measure: Measure, near: Sample) -> Sample:
    """The orbit `near` a crossing of two families at which a measure vanishes, as orbits on both sides tell."""
    for wide in WIDER:
        about = interval.about(near.distance, wide * JUNCTION)
        if not any(crossed(interval.curve, end.solution, TOLD) for end in (about.first, about.last)):
            break
    else:
        return near  # the families part too slowly

    def sample(distance: float) -> Sample:
        other = about.sample(distance)
        return replace(other, distance=ahead(interval.curve, interval.first, other.solution))

    def value(distance: float) -> float:
        return measure(sample(distance))

    low, high = sample(0.0), sample(about.length)
    before, after = measure(low), measure(high)
    if not before * after < 0:
        return near
    vanishing = sample(zero(value, 0.0, about.length, LOCATION))
    straight = low.distance + (high.distance - low.distance) * before / (before - after)
    vanishes = abs(measure(vanishing)) < STRAIGHT * (abs(before) + abs(after))
    if not (vanishes and abs(vanishing.distance - straight) < STRAIGHT * about.length):
        return near  # between them orbits of the other family were met
    interval.seen[vanishing.distance] = vanishing
    return vanishing


@dataclass(frozen=True)
class Subinterval:
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

    def read(self, sample: Sample) -> np.ndarray:
        """The indices of an orbit there in the order of its ends."""
        share = (sample.distance - self.low) / (self.high - self.low)
        expected, indices = (1 - share) * self.before + share * self.after, sample.indices
        kind, seen = self.real, real_indices(sample)
        if kind.sum() != seen.sum():
            return np.asarray(indices[matching(expected, indices)])
        values = np.empty_like(indices)
        for these, other in ((kind, seen), (~kind, ~seen)):
            values[these] = indices[other][matching(expected[these], indices[other])]
        return values


def subintervals(interval: Interval, met: Sequence[Sample]) -> list[Subinterval]:
    """The interval cut at the collisions `met` and at every orbit that was looked at in between."""
    knots = {sample.distance: (sample.indices, sample.turns) for sample in interval.known()}
    knots |= {sample.distance: (joined(sample), np.zeros_like(sample.turns)) for sample in met}
    parts = []
    for (low, before), (high, after) in pairwise(sorted(knots.items())):
        parts.append(Subinterval(low, high, before[0], after[0][_continued(*before, *after)]))
    return parts


def _continued(before: np.ndarray, turns: np.ndarray, after: np.ndarray, later: np.ndarray) -> np.ndarray:
    """The order in which indices go on: as they stand, unless kinds differ or Krein signatures were exchanged."""
    first, last = (np.array([is_real(value) for value in values], bool) for values in (before, after))
    order = np.arange(before.size)
    if first.sum() == last.sum() and not np.array_equal(first, last):
        for these, other in ((first, last), (~first, ~last)):
            order[these] = np.flatnonzero(other)[matching(before[these], after[other])]
    for i, j in exchanged(before, turns, after[order], later[order]):
        order[[i, j]] = order[[j, i]]
    return order


def exchanged(before: np.ndarray, turns: np.ndarray, after: np.ndarray, later: np.ndarray) -> list[tuple[int, int]]:
    """Pairs on the unit circle whose opposite Krein signatures have changed places: they have passed each other.

    Nearer to +-2 than to each other, each has rather turned over by itself.
    """
    turned = np.flatnonzero((turns != 0) & (turns == -later))
    pairs = []
    for i in turned:
        for j in turned[(turned > i) & (turns[turned] == -turns[i])]:
            apart = max(abs(before[i] - before[j]), abs(after[i] - after[j]))
            if apart < min(2 - abs(values[k].real) for values in (before, after) for k in (i, j)):
                pairs.append((int(i), int(j)))
    return pairs


def joined(sample: Sample) -> np.ndarray:
    """The indices at a collision, where two are one: their mean in place of the two nearest ones."""
    values = sample.indices.copy()
    gaps = np.abs(values[:, None] - values[None, :]) + np.diag(np.full(values.size, np.inf))
    i, j = np.unravel_index(int(gaps.argmin()), gaps.shape)
    values[[i, j]] = 0.5 * (values[i] + values[j]).real
    return values


def passages(interval: Interval, most: int, met: Sequence[Sample] = ()) -> list[tuple[Sample, Test]]:
    """Every passage of an index through a level of resonances up to order `most`, with the orbit there.

    Raises `ConvergenceError` where two indices cannot be told apart within so long a step.
    """
    levels, parts = [*index_levels(interval.first.about.root, most)], subintervals(interval, met)
    return [
        (sample, Test(kind, detail, passage(level), order, multiplier))
        for part in parts for level, kind, detail, order, multiplier in levels
        for sample in _passed(interval, part, level)
    ]  # fmt: skip


def _passed(interval: Interval, part: Subinterval, level: float) -> list[Sample]:
    """The orbits of a subinterval at which an index passes a level."""
    real = part.real
    before, after = part.before[real].real, part.after[real].real
    rises = (after >= level).astype(int) - (before >= level)
    if not rises.any():
        return []
    if abs(int(rises.sum())) < int(np.abs(rises).sum()):  # some rise and some fall: only their own course tells
        return _each(interval, part, level, np.flatnonzero(real)[rises != 0])
    ranks = np.flatnonzero((np.sort(after) >= level) != (np.sort(before) >= level))

    def above(rank: int, sample: Sample) -> float:
        return float(np.sort(part.read(sample)[real].real)[rank] - level)

    return [located(interval, partial(above, rank), part.low, part.high) for rank in ranks.tolist()]


def _each(interval: Interval, part: Subinterval, level: float, positions: np.ndarray) -> list[Sample]:
    samples = []
    for j in positions:

        def course(sample: Sample, j: int = int(j)) -> float:
            return float(part.read(sample)[j].real - level)

        sample = located(interval, course, part.low, part.high)
        # an index located at a level is this near to it, unless two indices were taken for each other
        if abs(course(sample)) <= 1e-4:
            samples.append(sample)
        elif interval.length > UNTOLD:
            raise ConvergenceError(f"two stability indices near {level:.4g} cannot be told apart within one step")
    return samples


# Collisions: two stability indices meet and leave the real axis together, or come back to it.
# Both the place where this happens and pairs of such places within one step are looked for. On the unit
# circle only multipliers of opposite Krein signature do so; equal ones pass through each other.


Bracket = tuple[float, float]


def meeting(sample: Sample) -> float:
    """The least |kappa_i - kappa_j|^2 of indices that may collide, its sign changed by every complex pair."""
    values, turns = sample.indices, sample.turns
    unlike = (turns[:, None] == 0) | (turns[:, None] != turns[None, :])
    gaps = np.where(np.triu(unlike, 1), np.abs(values[:, None] - values[None, :]) ** 2, np.inf)
    return float((-1.0) ** complex_pairs(sample) * min(gaps.min(initial=np.inf), 1e300))


def complex_pairs(sample: Sample) -> int:
    """Pairs of indices off the real axis."""
    return int(np.sum(~real_indices(sample))) // 2


def look(interval: Interval) -> None:
    """Looks between the ends where indices may have met twice, so that an orbit between the two meetings is seen."""
    a, b = interval.first, interval.last
    if complex_pairs(a) != complex_pairs(b):
        return
    # of opposite signature on the unit circle they stand in another order
    first, last = ([int(t) for t in sample.turns[np.argsort(sample.indices.real)] if t] for sample in (a, b))
    exchanged = len(first) == len(last) and sum(first) == sum(last) and first != last
    # indices nearer than this at one end of a step may have met twice inside it
    if exchanged or min(abs(meeting(a)), abs(meeting(b))) < 0.3**2:
        twice(interval, meeting, exchanged)


def collisions(interval: Interval) -> list[Bracket]:
    """(low, high) of every collision between orbits that were seen. Raises `ConvergenceError` where two are in one."""
    brackets = []
    for before, after in pairwise(interval.known()):
        change = complex_pairs(after) - complex_pairs(before)
        if abs(change) > 1:
            raise ConvergenceError("two pairs of stability indices meet within one step")
        if change:
            brackets.append((before.distance, after.distance))
    return brackets


def twice(interval: Interval, measure: Measure, thorough: bool = False) -> float | None:
    """A distance between two zeros of a measure that has one sign at both ends; None where it keeps it.

    Looked for at the vertex of a parabola, or `thorough`ly by minimising.
    """
    sign = float(np.sign(measure(interval.first)))

    def height(distance: float) -> float:
        return sign * measure(interval.sample(distance))

    place = _lowest(height, interval.length) if thorough else _vertex(height, interval.length)
    return place if height(place) < 0 else None


def grazed(interval: Interval, measure: Measure, near: float) -> None:
    """Looks between the ends where a measure of one sign at both is `near` 0 at one."""
    ends = [measure(sample) for sample in (interval.first, interval.last)]
    if ends[0] * ends[1] > 0 and min(np.abs(ends)) < near:
        twice(interval, measure)


def _vertex(height: Callable[[float], float], length: float) -> float:
    """The middle, or where the parabola through the ends and the middle is lowest."""
    heights = [height(share * length) for share in (0.0, 0.5, 1.0)]
    share, parabola = _parabola((0.0, 0.5, 1.0), heights)
    low = heights[1] >= 0 and 0 < share < 1 and parabola(share) < 0.2 * min(heights[::2])
    return share * length if low else 0.5 * length


def _parabola(places: Sequence[float], heights: Sequence[float]) -> tuple[float, Callable[[float], float]]:
    """Where a parabola through three places is lowest, infinitely far out if it is not bent up, and the parabola."""
    (a, m, b), (low, middle, high) = places, heights
    left, right = (middle - low) / (m - a), (high - middle) / (b - m)
    bend = (right - left) / (b - a)
    lowest = 0.5 * (a + m - left / bend) if bend > 0 else np.inf
    return lowest, lambda place: low + (place - a) * (left + bend * (place - m))


def _lowest(height: Callable[[float], float], length: float) -> float:
    """Where it is lowest, by parabolas through the lowest looks, or where it is first seen below 0; no nearer than it
    takes to say that it stays above."""
    known = {share * length: height(share * length) for share in (0.0, 0.5, 1.0)}
    narrow, told = EXTREMUM * length, False
    for _ in range(MOST_LOOKS):
        places = sorted(known)
        best = min(places, key=lambda place: known[place])
        k = min(max(places.index(best), 1), len(places) - 2)
        a, m, b = places[k - 1 : k + 2]
        place, parabola = _parabola((a, m, b), [known[each] for each in (a, m, b)])
        inside, near = a + narrow < place < b - narrow, abs(place - best) < narrow
        if known[best] < 0 or b - a < 3 * narrow:
            break
        if near or (told and (not inside or parabola(place) > 0.5 * known[best])):
            break
        wider = 1.0 if best > m or (best == m and b - m > m - a) else -1.0
        if not inside:
            place = 0.5 * (m + (b if wider > 0 else a))
        known[place] = height(place)
        told = abs(known[place] - parabola(place)) < TOLD_LOW * abs(known[place])
    return min(known, key=lambda each: known[each])


# Multipliers that pass through +1 or -1 between two points: thin strips of instability, and avoided crossings.
# A pair of multipliers on the unit circle turns one way, which its Krein signature tells. Where the
# signature says that the pair has gone through +-1 although its stability index is inside (-2, 2) at both
# points, either the index was outside for a short stretch between two bifurcations, or the step went across
# an avoided crossing of two families (an internal resonance), which are different curves on the two sides.


NEAR = 0.5
"""How near to +-2 an index must be at one of the two points to have gone through it."""
GRAZED = 0.05
"""An index nearer than this to +-2 at one of the two points may have been beyond it and come back the same way."""


@dataclass(frozen=True)
class Flip:
    """An index (its position) whose multipliers went through the level/2 on the unit circle within a step."""

    position: int
    level: float


def flips(before: Sample, after: Sample) -> list[Flip]:
    """Every index that was turned over between two samples."""
    unlike = before.indices.shape != after.indices.shape or before.about.root != after.about.root
    if unlike or not before.indices.size:
        return []
    turned_over = []
    passed = {k for pair in exchanged(before.indices, before.turns, after.indices, after.turns) for k in pair}
    for j, (a, b) in enumerate(zip(before.indices, after.indices, strict=True)):
        inside = is_real(a) and is_real(b) and abs(a.real) < 2 and abs(b.real) < 2 and a.real * b.real > 0
        turned = before.turns[j] * after.turns[j] < 0 and j not in passed
        if inside and turned and max(abs(a.real), abs(b.real)) > 2 - NEAR:
            turned_over.append(Flip(j, 2.0 * float(np.sign(a.real))))
    return turned_over


def avoided(before: Sample, after: Sample) -> bool:
    """Whether the step may have gone across an avoided crossing: multipliers met at +1 of the formulation's map."""
    return any(flip.level > 0 for flip in flips(before, after))


def strips(interval: Interval) -> None:
    """Looks inside every strip, so that its two bifurcations lie between orbits that were seen."""
    turned = flips(interval.first, interval.last)
    for flip in turned:
        with suppress(ConvergenceError, IntegrationError):  # the families have turned away on both sides
            twice(interval, partial(_inside, flip), thorough=True)
    for level in {2.0, -2.0} - {flip.level for flip in turned}:
        grazed(interval, passage(level), GRAZED)


def _inside(flip: Flip, sample: Sample) -> float:
    return float(2.0 - np.sign(flip.level) * sample.indices[flip.position].real)


# Families that avoid each other (an internal resonance, a broken symmetry). Which one is followed beyond is decided by
# their gap, before it is reached, and not by where a step ends.


BESIDE, WIDE, MET, AIMED = 0.5, 0.5, 4.0, 0.2
"""A root multiplier nearer to +1 than this may be what another family comes near with, across a gap no wider than this;
it is crossed over to from so many gaps away, by a family that is off a straight way there by no more than this share"""


def crossing_ahead(curve: Curve, sample: Sample, length: float) -> AvoidedCrossing | None:
    """The crossing of two families that the next `length` from an orbit may come near to."""
    reach, kept = length + 2 * WIDE, sample.solution.kept
    if np.abs(sample.about.values - 1.0).min(initial=np.inf) > BESIDE:
        return None
    if kept.get("looked", 0.0) < reach:
        kept["looked"], kept["avoided"] = reach, None
        with suppress(IntegrationError, np.linalg.LinAlgError):
            kept["avoided"] = avoided_crossing(curve, sample.solution, reach)
    found: AvoidedCrossing | None = kept["avoided"]
    return found if found and found.gap < WIDE else None
