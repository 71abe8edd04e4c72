"""Following anything, one step after another; and pseudo-arclength continuation of anything that is F(w) = 0.

`walked` is the driver of everything that is followed: it asks a `Walk` for steps, halves those that fail, and ends.
`follow` is the walk along a continuation problem: predict, correct, step on, locate what is asked. Source: H. B.
Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems, in Applications of Bifurcation Theory
(1977). `reached` is the walk straight to a value of natural parameters, of what goes round no folds. Nothing here knows
what is followed.

Every step of `follow` is a line of a journal, and the same request goes on where it stopped. What is asked for may
change: more points, a farther end, other values. What the journal has is read and not solved again; what is no longer
asked for stays there and is left out.
"""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from scipy.optimize import brentq

from orbitfinder._runtime import limit
from orbitfinder.continuation.problem import Point, plane, solved
from orbitfinder.continuation.tests import Crossing, Entries, Roots, crossings
from orbitfinder.errors import UNSOLVED, ConvergenceError, DomainError, plural
from orbitfinder.records.codec import plain
from orbitfinder.records.ends import end_kind
from orbitfinder.records.family import End
from orbitfinder.records.journal import append_line, known_lines, refuse_other
from orbitfinder.records.reading import Table, typed

LOCATED, LOOKS, MISSED = 1e-12, 60, 1e-9
"""An event is located to this share of a step, in so many looks at most; a sign is known to this of the other end"""
LEAST, SAME, BESIDE = 4, 1e-6, 0.05
"""A curve of at least so many points is closed where it is as near to its start as this share of a step.
A change of sign that looks within a step bound is on the curve so much farther, in what they bound, at most"""
CLOSER, NEARLY = 6, 0.5
"""So often a test is looked at within a step where a parabola through what is known turns below this share of that"""


class Block(Protocol):
    """What some steps add to what is followed."""

    @property
    def end(self) -> End | None:
        """Why there are no more."""


B = TypeVar("B", bound=Block, covariant=True)


class Walk(Protocol[B]):
    """How something is followed in one direction: it knows where it stands, at first after the steps known already."""

    def taken(self) -> int:
        """How many steps it has taken."""

    def approach(self) -> tuple[float, End | None]:
        """The length of the next step, and why there is none where it ends."""

    def advance(self, length: float) -> B:
        """On by a step of this length, and by more where they come together.

        Raises `ConvergenceError` or `IntegrationError` where it is too long, and stands where it stood.
        """

    def shortest(self) -> float:
        """Where a step fails that is shorter, none leads on."""

    def failed(self, reason: str) -> B:
        """What there is where no step leads on: an end, or somewhere else to go on from."""

    def ended(self, end: End) -> B:
        """A block of no step but the end."""


def walked(walk: Walk[B], most: int) -> Iterator[B]:
    """The blocks of a walk until it ends, at the latest after so many steps."""
    while True:
        limit.check()
        length, end = (0.0, point_limit(most)) if walk.taken() >= most else walk.approach()
        block = _advanced(walk, length) if end is None else walk.ended(end)
        yield block
        if block.end is not None:
            return


def _advanced(walk: Walk[B], length: float) -> B:
    """On by as short a step as it takes."""
    while True:
        try:
            return walk.advance(length)
        except UNSOLVED as error:
            length /= 2
            if length < walk.shortest() ** getattr(error, "digits", 1.0):
                return walk.failed(str(error))


def point_limit(most: int) -> End:
    """The end of what has as many points as were asked for."""
    return End("point limit", f"{plural(most, 'point')} {'was' if most == 1 else 'were'} asked for")


def zero(value: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Where a function that changes its sign between two lengths vanishes, by Brent's method.

    Round-off may keep the last bracket wider than asked for, and the sign the same at an end that is one.
    """
    value = cache(value)
    near, far = sorted((low, high), key=lambda end: abs(value(end)))
    if value(near) * value(far) > 0 and abs(value(near)) <= MISSED * abs(value(far)):
        return near
    return float(brentq(value, low, high, xtol=tolerance, rtol=1e-14, maxiter=LOOKS, disp=False))


Test = Callable[[Point], float]
"""What vanishes at an event, and changes its sign there"""
Tests = Mapping[str, Test | Entries]
"""By the name of the event: a function, or entries of the spectrum"""


@dataclass(frozen=True)
class Pace:
    """How long steps are, as arclength, and how many.

    Args:
        first: the first.
        shortest: a step that fails below it ends the curve.
        longest: the longest.
        points: corrected ones at most, the first among them, those at values that are asked for not.
        bend: the least cosine between the tangents of a step.
        quick: a step in at most so many iterations of the corrector is followed by one `growth` as long.
        slow: one in more by one `shrinkage` as long.
        located: events are, to this share of a step.
        closed: whether a curve that comes back to its start ends there.
    """

    first: float = 0.02
    shortest: float = 1e-3
    longest: float = 10.0
    points: int = 100
    bend: float = 0.5
    quick: int = 5
    slow: int = 9
    growth: float = 1.5
    shrinkage: float = 0.6
    located: float = LOCATED
    closed: bool = False

    def next(self, step: float, iterations: int) -> float:
        """The length after a step that took so many iterations."""
        easy = self.growth if iterations <= self.quick else self.shrinkage if iterations > self.slow else 1.0
        return min(self.longest, step * easy)


@dataclass(frozen=True)
class Goals:
    """The quantity that a curve is followed in, where it ends, and the values at which points are wanted."""

    name: str
    until: float | None = None
    at: tuple[float, ...] = ()

    def met(self, before: Point, after: Point) -> list[float]:
        """The values between two points, in the order in which they are met, none beyond the end."""
        a, b = before.value(self.name), after.value(self.name)
        wanted = self.at if self.until is None else (*self.at, self.until)
        within = sorted(
            {value for value in wanted if value != a and (value - a) * (value - b) <= 0},
            key=lambda value: abs(value - a),
        )
        return within[: within.index(self.until) + 1] if self.until in within else within


@dataclass(frozen=True, eq=False)
class KeptPoint:
    """A point with its role ("step", "at", "end") or its event's name, and its record."""

    role: str
    point: Point
    record: Any


AtValue = tuple[float, KeptPoint]
"""A point at a value of what is followed in"""


@dataclass(eq=False)
class Direction(ABC):
    """One direction along a curve of a continuation problem, in the order of its steps as far as it is followed.

    Args:
        goals: what it is followed in, where it ends, and the values at which points are wanted.
        sign: 1 or -1, of arclengths along the curve that way.
        request: what decides whether a journal is of it (plain numbers).
    """

    goals: Goals
    sign: float
    request: Mapping[str, Any]
    points: list[KeptPoint] = field(default_factory=list, init=False)
    events: list[KeptPoint] = field(default_factory=list, init=False)
    end: End | None = field(default=None, init=False)

    @abstractmethod
    def begin(self) -> Point:
        """The first point, its tangent this way."""

    def leads(self, first: Point) -> bool:  # noqa: ARG002 - for those that may not
        """Whether a journal's first point leads this way."""
        return True

    def tests(self) -> Tests:
        """The events that are asked for, by name."""
        return {}

    def spectrum(self, point: Point) -> Roots:
        """The roots of a point, of whose entries some tests are."""
        raise NotImplementedError

    @abstractmethod
    def record(self, point: Point) -> Any:
        """What is kept of a point, certified."""

    @abstractmethod
    def write(self, point: Point, record: Any) -> Table:
        """Both in plain numbers."""

    @abstractmethod
    def read(self, entry: Table) -> tuple[Point, Any]:
        """Both from what was written."""


D = TypeVar("D", bound=Direction)


def in_turn(directions: Iterable[D], path: Path | None) -> Iterator[tuple[D, Path | None]]:
    """One direction of a curve after another until it is closed, each with its journal, beside that of the first."""
    for k, direction in enumerate(directions):
        yield direction, path and path.with_stem(f"{path.stem}{k or ''}")
        if direction.end and end_kind(direction.end.kind).closed:
            return


def towards(point: Point, name: str, value: float | None) -> float:
    """1 or -1: the way along the tangent in which a quantity goes towards a value, up without one."""
    return 1.0 if rise(point, name) * (1.0 if value is None else value - point.value(name)) >= 0 else -1.0


def rise(point: Point, name: str) -> float:
    """What a quantity changes by along the curve, up to a positive factor: 0 where it turns."""
    return float(point.problem.aim(point.w, name, point.value(name))[1] @ point.tangent)


def advanced(point: Point, length: float, bend: float = 0.0) -> Point:
    """The point in the plane across the tangent at a length from one, its tangent going on.

    Raises `ConvergenceError` or `IntegrationError`, also where the tangents enclose more than a cosine of `bend`.
    """
    guess = point.w.moved(length * point.tangent)
    after = solved(point.problem, guess, plane(point.problem, guess, point.tangent))
    along = point.inner(after.tangent)
    if abs(along) < bend:
        raise ConvergenceError("the curve bends within a step")
    tangent = after.tangent if along >= 0 else -after.tangent
    return Point(after.problem, after.w, tangent, point.arclength + length, iterations=after.iterations)


def exactly(before: Point, after: Point, name: str, value: float) -> Point:
    """The point between two at which a quantity has a value. Raises `ConvergenceError` or `IntegrationError`."""
    a, b = before.value(name), after.value(name)
    length, share = after.arclength - before.arclength, (value - a) / (b - a)
    first = after.problem.carried(before.w, after.w)
    guess = first.moved(share * (after.w.vector - first.vector))
    there = solved(after.problem, guess, lambda w: after.problem.aim(w, name, value))
    tangent = there.tangent if after.inner(there.tangent) >= 0 else -there.tangent
    return replace(there, tangent=tangent, arclength=before.arclength + share * length)


def between(before: Point, after: Point, share: float) -> Point:
    """The point at a share of a step, as far along its first tangent, on the cubic along both; its own is sharp."""
    length, first, s = after.arclength - before.arclength, after.problem.carried(before.w, after.w), share
    chord, a, b, along = after.w.vector - first.vector, before.tangent, after.tangent, before.inner(after.tangent)
    early, late = length * s * (1 - s) ** 2, length * s**2 * (s - 1) / along
    moved = s**2 * (3 - 2 * s) * chord + early * a + late * b
    slope = 6 * s * (1 - s) / length * chord + (1 - s) * (1 - 3 * s) * a + s * (3 * s - 2) / along * b
    return Point(after.problem, first.moved(moved), slope, before.arclength + s * length).sharp


def located(before: Point, after: Point, test: Test, within: tuple[float, float], tolerance: float) -> Point | None:
    """Where a test vanishes between two shares of a step, or just beside; None where it does not on the curve itself.

    Raises `ConvergenceError` or `IntegrationError`.
    """
    (low, high), length = within, after.arclength - before.arclength
    ends, beside = {0.0: before.sharp, 1.0: after.sharp}, BESIDE * (high - low)

    def at(share: float) -> Point:
        return ends[share] if share in ends else advanced(before, share * length).sharp

    for a, b in ((low, high), (max(low - beside, 0.0), high), (low, min(high + beside, 1.0)), (0.0, 1.0)):
        if (test(at(a)) < 0) != (test(at(b)) < 0):
            return at(zero(lambda share: test(at(share)), a, b, tolerance))
    return None


def changes(look: Callable[[float], float], known: Mapping[float, float]) -> list[tuple[float, float]]:
    """Between which shares of a step a test changes its sign, of which three values are known.

    Where the parabola through them turns towards 0 it is looked at more closely: two events may lie within the step.
    """
    values = dict(known)
    for _ in range(CLOSER):
        shares = sorted(values)
        if crossed := [(a, b) for a, b in pairwise(shares) if (values[a] < 0) != (values[b] < 0)]:
            return crossed
        least = min(shares, key=lambda share: abs(values[share]))
        k = min(max(shares.index(least), 1), len(shares) - 2)
        turn, there = turning(*((share, values[share]) for share in shares[k - 1 : k + 2]))
        near = shares[k - 1] < turn < shares[k + 1] and min(abs(turn - s) for s in shares) > 1e-3
        if not near or there * np.sign(values[least]) > NEARLY * abs(values[least]):
            break
        values[turn] = look(turn)
    return []


def turning(first: tuple[float, float], second: tuple[float, float], third: tuple[float, float]) -> tuple[float, float]:
    """Where the parabola through three places and values turns, and its value there; nan where it does not."""
    (a, f), (b, g), (c, h) = first, second, third
    slope = (g - f) / (b - a)
    bend = ((h - g) / (c - b) - slope) / (c - a)
    turn = (a + b) / 2 - slope / (2 * bend) if bend else nan
    return turn, f + slope * (turn - a) + bend * (turn - a) * (turn - b)


@dataclass(frozen=True)
class _Line:
    """What a step adds: points at values of the quantity, events by name, the point that it ends in."""

    at: tuple[tuple[float, Table], ...] = ()
    events: tuple[tuple[str, Table], ...] = ()
    step: Table | None = None
    end: End | None = None


class CurveJournal:
    """A direction as far as it is known, by an earlier run and this one; with a path it is a journal there.

    Raises `InputError` for a journal that cannot be read, is of another curve, or whose first point leads elsewhere.
    """

    def __init__(self, direction: Direction, path: Path | None = None) -> None:
        self.direction, self.path = direction, path
        self.steps: list[KeptPoint] = []
        self.events: list[list[KeptPoint]] = []
        self.at: list[AtValue] = []
        self.end: End | None = None
        if path is None:
            return
        known_lines(path, plain(direction.request), self._read)
        if self.steps and not direction.leads(self.steps[0].point):
            refuse_other(path, {"until": "the other way"}, {"until": "this way"})

    def _read(self, entries: Table) -> None:
        line: _Line = typed(_Line, entries, "")
        self.at += [(value, KeptPoint("at", *self.direction.read(entry))) for value, entry in line.at]
        self.end = line.end
        if line.step is not None:
            self.events.append([KeptPoint(name, *self.direction.read(entry)) for name, entry in line.events])
            self.steps.append(KeptPoint("step", *self.direction.read(line.step)))

    def kept(self, role: str, point: Point) -> KeptPoint:
        """A point with its record."""
        return KeptPoint(role, point, self.direction.record(point))

    def add(
        self, step: KeptPoint | None = None, events: Sequence[KeptPoint] = (), at: Sequence[AtValue] = (),
        end: End | None = None,
    ) -> _Line:  # fmt: skip
        """What was found, as a line."""
        if step is not None:
            self.steps.append(step)
            self.events.append(list(events))
        self.at, self.end = [*self.at, *at], end
        if self.path is None:
            return _Line(end=end)
        line = _Line(
            tuple((value, self._entry(point)) for value, point in at),
            tuple((event.role, self._entry(event)) for event in events),
            None if step is None else self._entry(step), end,
        )  # fmt: skip
        append_line(self.path, plain(line))
        return line

    def _entry(self, point: KeptPoint) -> Table:
        return self.direction.write(point.point, point.record)

    def exactly(self, before: Point, after: Point, goals: Goals) -> tuple[list[KeptPoint], list[AtValue]]:
        """The points at values between two, and those among them that were not known before."""
        points, fresh = [], []
        for value in goals.met(before, after):
            kept = next((kept for known, kept in self.at if known == value
                        and before.arclength <= kept.point.arclength <= after.arclength), None)  # fmt: skip
            if kept is None:
                kept = self.kept("at", exactly(before, after, goals.name, value))
                fresh.append((value, kept))
            points.append(replace(kept, role="end" if value == goals.until else "at"))
        return points, fresh


def follow(curve: Direction, pace: Pace, path: Path | None = None) -> Iterator[KeptPoint]:
    """The points of a curve from where it begins until it ends, with a path kept in a journal there; the curve grows by
    a step before its points come. What its `begin` raises is raised."""
    goals, trace, tests = curve.goals, CurveJournal(curve, path), curve.tests()
    if not trace.steps:
        trace.add(trace.kept("step", curve.begin()))
    curve.points.append(trace.steps[0])
    yield trace.steps[0]
    ahead = walked(_Arclength(trace, goals, pace, tests, curve.spectrum), pace.points)
    for index in range(1, pace.points):
        if index == len(trace.steps) and trace.end is None:
            next(ahead)
        if index == len(trace.steps):
            curve.end = trace.end
            return
        try:
            before, after = (step.point for step in trace.steps[index - 1 : index + 1])
            points, fresh = trace.exactly(before, after, goals)
        except UNSOLVED as error:
            curve.end = End("step underflow", str(error))
            if trace.end is None:
                trace.add(end=curve.end)
            return
        if fresh:
            trace.add(at=fresh, end=trace.end)
        met = bool(points) and points[-1].role == "end"
        reach = points[-1].point.arclength if met else after.arclength
        points += [] if met else [trace.steps[index]]
        curve.points += points
        curve.events += [event for event in trace.events[index] if event.point.arclength <= reach]
        yield from points
        if met:
            curve.end = End("target", f"reached {goals.name} = {goals.until!r}")
            return
    curve.end = point_limit(pace.points)


@dataclass(frozen=True, eq=False)
class _Arclength:
    """The walk along the solutions of a continuation problem, of which a trace holds all."""

    trace: CurveJournal
    goals: Goals
    pace: Pace
    tests: Tests
    spectrum: Callable[[Point], Roots]
    last: dict[str, float] = field(default_factory=dict)
    """of each test, at the point where it stands"""

    @property
    def point(self) -> Point:
        return self.trace.steps[-1].point

    def taken(self) -> int:
        return len(self.trace.steps)

    def approach(self) -> tuple[float, End | None]:
        return self.point.step or self.pace.first, None

    def shortest(self) -> float:
        return self.pace.shortest

    def advance(self, length: float) -> _Line:
        """By one step, with what lies before its end."""
        point = self.point
        after = advanced(point, length, self.pace.bend)
        home = self._home(point, after)
        after = after if home is None else home
        problem, w, tangent = after.problem.at(after.w, after.tangent)
        step = self.pace.next(length, after.iterations)
        after = Point(problem, w, tangent, after.arclength, step, after.iterations)
        _, fresh = self.trace.exactly(point, after, self.goals)
        events, tested = self._events(point, after)
        self.last.update(tested)
        end = None if home is None else End("returned", "the curve is closed")
        return self.trace.add(self.trace.kept("step", after), events, fresh, end)

    def _home(self, before: Point, after: Point) -> Point | None:
        """The curve's first point, where a step comes to it again along it."""
        first = self.trace.steps[0].point
        if not self.pace.closed or len(self.trace.steps) < LEAST or first.w.vector.size != before.w.vector.size:
            return None
        away = first.w.vector - before.w.vector
        length = before.inner(away)
        if not 0 < length <= after.arclength - before.arclength or after.inner(first.tangent) <= 0:
            return None
        there = advanced(before, length)
        gap = there.w.vector - first.w.vector
        return there if before.problem.metric(there.w) @ gap**2 < (SAME * length) ** 2 else None

    def _events(self, before: Point, after: Point) -> tuple[list[KeptPoint], dict[str, float]]:
        """Where tests change their signs within a step, by both ends and the middle, and their values at its end."""
        events, tested = [], {}
        if self.tests and before.w.vector.size != after.w.vector.size:  # on the mesh of what comes after
            w, moved = (after.problem.carried(one, after.w) for one in (before.w, before.w.moved(before.tangent)))
            before = replace(before, problem=after.problem, w=w, tangent=moved.vector - w.vector)
        middle = between(before, after, 0.5) if self.tests else after
        same = self.last if after.problem is before.problem else {}  # in the same metric
        kinds = {}
        for name, test in self.tests.items():
            if not callable(test):
                kinds[test] = name
                continue
            tested[name] = test(after.sharp)

            def look(share: float, test: Test = test) -> float:
                return test(between(before, after, share))

            known = {0.0: same[name] if name in same else look(0.0), 0.5: test(middle), 1.0: tested[name]}
            for within in changes(look, known):
                event = located(before, after, test, within, self.pace.located)
                events += [] if event is None else [self.trace.kept(name, event)]
        events += self._crossed(before, after, kinds) if kinds else []
        return sorted(events, key=lambda event: event.point.arclength), tested

    def _crossed(self, before: Point, after: Point, kinds: Mapping[Entries, str]) -> list[KeptPoint]:
        """Where entries of the spectrum vanish within a step, by its length along its first tangent."""
        spectrum, start, length, events = self.spectrum, before.arclength, after.arclength - before.arclength, []

        def roots(point: Point) -> Roots:
            known = spectrum(point)
            return replace(known, slopes=known.slopes / before.inner(point.tangent))

        def value(crossing: Crossing, point: Point) -> tuple[float, complex]:
            return crossing.value(roots(point), (point.arclength - start) / length, length)

        ends = roots(before.sharp), roots(after.sharp)
        for crossing in crossings(lambda share: roots(advanced(before, share * length).sharp), ends, length, kinds):
            test = partial(value, crossing)
            event = located(before, after, lambda point: test(point)[0], crossing.within, self.pace.located)  # noqa: B023
            if event is not None:
                events.append(
                    self.trace.kept(
                        kinds[Entries(crossing.entry[0] != crossing.entry[1])], replace(event, critical=test(event)[1])
                    )
                )
        return events

    def failed(self, reason: str) -> _Line:
        point, name, kind = self.point, self.goals.name, "step underflow"
        with contextlib.suppress(*UNSOLVED):
            try:
                point.problem.rows(point.w.moved(self.pace.first * point.tangent))
            except DomainError as error:
                kind, where = "singularity", f"{name} = {point.value(name):.9g}"
                reason = f"the branch leaves the domain of its equations at {where}: {error}"
        return self.trace.add(end=End(kind, reason))

    def ended(self, end: End) -> _Line:
        return _Line(end=end)


DIRECT = Pace(first=1.0, shortest=2.0**-8, longest=1.0, growth=2.0)
"""At once; where that fails by halves of the way, and of those, and after each that leads on by one twice as long"""
S = TypeVar("S")
Known = list[tuple[Any, S]]
"""The last two solutions or fewer, each with the values of the natural parameters (a number, or an array) before it"""


def reached(known: Known[S], target: Any, corrected: Callable[[Any], tuple[S, int]], pace: Pace = DIRECT) -> S:
    """The solution at values of natural parameters, by steps along the line there from the last that is known.

    `corrected` is the solution at values, by what is known, and its iterations; `pace` is in shares of the way, and the
    shortest step ever shorter where less is left than the first. What is known grows. Raises `ConvergenceError` where
    no step leads on.
    """
    for _ in walked(_Straight(known, target, corrected, pace), 1):
        pass
    return known[-1][1]


class _Straight(Generic[S]):
    """The walk along a straight line of natural parameters."""

    def __init__(self, known: Known[S], target: Any, corrected: Callable[[Any], tuple[S, int]], pace: Pace) -> None:
        self.known, self.target, self.corrected, self.pace = known, target, corrected, pace
        self.start, self.share, self.step = known[-1][0], 0.0, pace.first

    def taken(self) -> int:
        return int(self.share)

    def approach(self) -> tuple[float, End | None]:
        left = 1.0 - self.share
        return self.step if self.step < 2 * left else left, None  # halves of a step are of a whole one, also the last

    def shortest(self) -> float:
        return self.pace.shortest * min(1.0, (1.0 - self.share) / self.pace.first)

    def advance(self, length: float) -> _Line:
        share = min(self.share + length, 1.0)
        place = self.target if share == 1.0 else self.start + share * (self.target - self.start)
        solution, iterations = self.corrected(place)
        self.known[:] = [*self.known[-1:], (place, solution)]
        self.share, self.step = share, self.pace.next(length, iterations)
        return _Line()

    def failed(self, reason: str) -> _Line:
        raise ConvergenceError(reason)

    def ended(self, end: End) -> _Line:
        return _Line(end=end)
