"""Pseudo-arclength continuation: step along the tangent, correct, look at what lies between, repeat.

Source: H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems, in
Applications of Bifurcation Theory (1977); the predictor is a parabola through the previous point.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import numpy as np

from orbitfinder.continuation.follow import walked, zero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.changes import first_lost
from orbitfinder.families.codimension_two import find_special, left_circle
from orbitfinder.families.ends import approach, end_at, end_of_failure, merged, returned, shortest_step
from orbitfinder.families.entries import KINDS
from orbitfinder.families.events import avoiding, event_at, find_events
from orbitfinder.families.joins import Invariance, Join
from orbitfinder.families.motion import watched
from orbitfinder.families.passages import AIMED, MET, Test, avoided, crossing_ahead, zeros
from orbitfinder.families.point import FamilySettings, make_point, parameter_value
from orbitfinder.families.registry import tests_of
from orbitfinder.families.run import (
    Interval,
    Run,
    Sample,
    Walked,
    ahead,
    checked_point,
    make_interval,
    make_sample,
    standing_of,
    step_at,
    step_from,
)
from orbitfinder.loops.block import Ahead, Blocks, Pacing
from orbitfinder.loops.condensed import combined
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import Curve, Solution, advanced, correct, distance, oriented, plane, tangent
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.mesh import MESH, carried, regraded, settled, variation_errors
from orbitfinder.records.ends import end_kind
from orbitfinder.records.family import UNKNOWN, Batch, End, Event, FamilyPoint, Standing, reached

SHORTEST_SEARCH = 1e-3
"""Steps longer than this are repeated at half their length when an event in them cannot be located."""
PREDICTION = 3e-3
"""How far from the family, in its metric, the predicted orbit should be."""
ECHO = 1e-2
"""Arclength before a junction of two families within which nothing else is reported."""
ROUND_OFF = 1e-15
"""Arclength within which a watched number is met"""
Member = TypeVar("Member", FamilyPoint, Event)


def follow(run: Run, done: Sequence[tuple[FamilyPoint, Standing | None]] = ()) -> Iterator[Batch]:
    """Batches of points and events in one direction until the family ends.

    `done` are the steps already taken in this direction (from a journal); the run goes on after them.
    """
    return walked(_Walk(run, done), run.settings.points)


class _Walk:
    """The walk along a family: the run, in the scales that hold where it stands, and its last step."""

    def __init__(self, run: Run, done: Sequence[tuple[FamilyPoint, Standing | None]]) -> None:
        self.blocks = Blocks.of(run.curve, pacing(run))
        self.run, self.last = step_at(run, done, self.blocks)
        self.joins = dict[Invariance, Join]()

    def taken(self) -> int:
        return self.last.point.index

    def approach(self) -> tuple[float, End | None]:
        return approach(self.run, self.last, self.last.point.step, self.joins)

    def shortest(self) -> float:
        return shortest_step(self.run, self.last)

    def advance(self, length: float) -> Batch:
        self.last, batch = _attempt(self.run, self.last, length, self.blocks)
        self.run = replace(self.run, curve=self.last.curve)
        return batch

    def failed(self, reason: str) -> Batch:
        return self.ended(end_of_failure(self.run, self.last, f"step below {self.shortest():g}: {reason}"))

    def ended(self, end: End) -> Batch:
        return Batch(self.run.direction, end=end)


def pacing(run: Run) -> Pacing:
    """How long the steps of a run may be."""
    # steps along a curve of bifurcations may be so many times longer: only its points of codimension two lie between
    settings, along = run.settings, 1.0 if run.curve.test is None else 3.0
    return Pacing(along * settings.longest_step, settings.sharpest_turn, settings.longest_stretch, PREDICTION)


def _attempt(run: Run, before: Walked, length: float, blocks: Blocks | None) -> tuple[Walked, Batch]:
    began = time.perf_counter()
    curve, settings, sample, place = run.curve, run.settings, before.sample, before.solution.place
    near = crossing_ahead(curve, sample, length)
    ahead, nearly, over = None, None, False
    if near is not None and 0.0 < near.gap < settings.narrowest:
        along, z, close = near.rows @ sample.whole, near.place(place), MET * near.gap
        left, curved = float(-z @ along / (along @ along)), float(z[0] ** 2 - z[1] ** 2)
        if left > close and left - length < 0.5 * close and abs(curved) < AIMED * (z @ z):
            return _attempt(run, before, left - 0.75 * close, blocks)
        # nearer it has been decided, unless the family begins there; elsewhere the families are no hyperbola yet
        over = (0.5 * near.gap if before.point is run.origin else 0.5 * close) < left <= close and 0 < curved < 2
        if over:
            length, nearly = 2 * left, near.centre.moved(near.centre.vector - place.vector)
    if blocks is not None and not over:
        ahead = blocks.next(curve, (place, sample.whole, before.curvature), length)
    fits = ahead is not None and ahead.fits and variation_errors(curve, ahead.solution).max() < MESH.stale
    if ahead is not None and not fits:
        nearly = ahead.solution.place.on(regraded(curve, ahead.solution))
        ahead = ahead if nearly.mesh is ahead.solution.place.mesh else None
    step = _corrected(run, before, length, nearly) if ahead is None else ahead
    raw, whole = step.solution, step.whole
    solution = raw if ahead is not None and fits else settled(curve, raw, whole)
    _check_symmetric(curve, solution)
    last = make_sample(curve, length, raw, whole, before.point.indices + before.trend)
    if curve.equations.links and (cut := _cut(run, before, last)) is not None:
        return before, cut
    met, gone = list[Event](), near is not None and near.place(place)[1] * near.place(raw.place)[1] < 0.0
    if near is not None and near.gap and gone:
        if (oriented(curve, sample.solution, sample.whole) != oriented(curve, raw, whole)) != over:
            raise ConvergenceError("two families avoid each other within one step")
        met = [avoiding(curve, near, sample, over, settings.parameter)] if settings.events else met
    elif not gone and avoided(sample, last):
        if length > settings.narrowest:
            raise ConvergenceError("two families may avoid each other within one step")
        what = "from %s = %.12g on this may be another family: multipliers met at +1, and none was found to come near"
        logging.getLogger(__name__).warning(what, settings.parameter, before.point.value)
    where: dict[str, Any] = {
        "index": before.point.index + 1,
        "arclength": before.point.arclength + run.direction * length,
        "step": step.next,
        "indices": last.indices,
    }
    if solution is not raw:
        whole = tangent(curve, solution, carried(curve, raw.place, whole, solution.place))
    about = last.about if solution is raw else None
    point, kept, whole = checked_point(curve, solution, whole, settings.parameter, run.check, about, **where)
    point = replace(point, wall_time=time.perf_counter() - began)
    known = ahead.accepted if ahead is not None and kept is raw else None
    if known is None and blocks is not None:
        known = blocks.accepted(curve, place, kept, whole)
    after = step_from(run, before, point, kept, whole, last if kept is raw else None, known)
    if kept is not raw:  # beside a sharp corner what is read on a mesh that it has left is off by whole events
        last = replace(after.sample, distance=length, solution=raw, whole=last.whole)
    batch = _batch(run, before, after, last, met)
    stands = bool(batch.points) and batch.points[-1] is after.point
    return after, replace(batch, standing=standing_of(curve, kept, whole)) if stands else batch


def _check_symmetric(curve: Curve, solution: Solution) -> None:
    """`ConvergenceError` where the equations beside an orbit lack a symmetry by which a part of it stands for all."""
    p, w, states = curve.equations, solution.place, solution.march.states
    rates, some = partial(p.march.rates, tail=w.tail), states[:: max(1, len(states) // 24)]
    if lost := p.symmetry.lost_beside(rates, some, curve.scales.states, w.period / 2):
        change = lost.in_words(p.model.coordinates)
        raise ConvergenceError(
            f"the equations lose the symmetry of the family's orbits there: they change under {change}; start from an "
            "orbit beyond, whose family is followed without it"
        )


def _corrected(run: Run, before: Walked, length: float, nearly: Unknowns | None = None) -> Ahead:
    """The point a length on, corrected: from where it nearly is, on a mesh that fits it, where that is known to be on
    the family or on one crossed over to."""
    curve, settings, sample, place = run.curve, run.settings, before.sample, before.solution.place
    guess = advanced(place, sample.whole, length, before.curvature)
    jacobian, drift = before.solution.jacobian, before.drift
    slope = jacobian if drift is None else combined(jacobian, 1.0, drift, length)
    aim, reach = plane(curve, place, sample.whole, length), 0.5 * length + 1e-9
    fit = regraded if nearly is None else None
    raw = correct(curve, nearly or guess, aim, place, reach=reach, slope=slope, fit=fit)
    whole = tangent(curve, raw, sample.whole)
    turn = float(np.arccos(np.clip(np.sum(curve.scales.metric(place) * sample.whole * whole), -1.0, 1.0)))
    if turn > settings.sharpest_turn and nearly is None:
        raise ConvergenceError(f"the family turns by {turn:.2g} rad within one step")
    stretch = abs(raw.place.period / place.period - 1.0)
    # a step as short as this may change the period by more than `longest_stretch`: the saddle is reached in the end
    if stretch > settings.longest_stretch and length > 1e-4 and nearly is None:
        raise ConvergenceError(f"the period changes by {stretch:.2g} within one step")
    missed = distance(curve, guess, raw.place)
    return Ahead(place, length, raw, whole, turn, stretch, missed, pacing(run).next(length, turn, stretch, missed))


def _batch(run: Run, before: Walked, after: Walked, last: Sample, met: list[Event]) -> Batch:
    """Everything between two points, in order: events, those `met` already too, points asked for, and an end."""
    settings, origin = run.settings, before.point
    interval, ended = make_interval(run.curve, before.sample, last), end_at(run, before, after)
    lost = run.curve.equations.gridded and min(origin.scale, after.point.scale) > UNKNOWN
    inside = [] if lost else _events(interval, settings, met)  # of a canard nothing could be certified
    events = [_placed(event, run, origin) for event in inside]
    points, final = _exactly(run, before, interval, inside)
    if final:
        goal, there = min(final, key=lambda pair: abs(pair[1].arclength))
        end = End("target", reached(*goal))
        reach = abs(there.arclength - origin.arclength)
        kept = [*_within(points, origin, reach), there]
        return Batch(run.direction, _ordered(kept), tuple(_within(events, origin, reach)), end)
    if ended is not None and end_kind(ended.kind).outside:
        return Batch(run.direction, (), (), ended)
    for event, near in zip(events, inside, strict=True):
        turned = KINDS[near.kind].extremal and near.detail not in ("period", *run.curve.watch)
        joined = merged(interval, near.arclength, settings.parameter) if turned else left_circle(run.curve, near)
        if joined is not None:
            reach = abs(event.arclength - origin.arclength)
            # the tangent is ill-defined where two families cross: other folds seen beside this one are its echoes
            clear = _within([each for each in events if each is not event], origin, reach - turned * ECHO)
            located = clear if turned else [*clear, event]  # a join is an end and no fold
            return Batch(run.direction, _ordered(_within(points, origin, reach)), tuple(located), joined)
    ended = ended or returned(run.curve, before, after)
    return Batch(run.direction, (*_ordered(points), after.point), tuple(events), ended)


def _cut(run: Run, before: Walked, last: Sample) -> Batch | None:
    """The end of a family of hybrid orbits within a step, where the motion no longer goes through its cycle."""
    interval, name, origin = make_interval(run.curve, before.sample, last), run.settings.parameter, before.point
    lost = first_lost(interval)
    if lost is None:
        return None
    sample, margin = lost
    event = _placed(event_at(run.curve, sample, Test(margin.kind, margin.name, lambda sample: 0.0), name), run, origin)
    reach = sample.distance
    points, final = _exactly(run, before, interval, [])
    if _within([point for _, point in final], origin, reach):
        return None
    events: list[Event] = []
    if reach > 0:
        until = make_interval(run.curve, before.sample, interval.sample((1 - ECHO) * reach))
        events = [_placed(each, run, origin) for each in _events(until, run.settings, [])]
    end = End(margin.kind, f"{margin.what} beyond {name} = {event.parameter:.12g}")
    return Batch(run.direction, _ordered(_within(points, origin, reach)), (*events, event), end)


def _exactly(
    run: Run, before: Walked, interval: Interval, events: Sequence[Event]
) -> tuple[list[FamilyPoint], list[tuple[tuple[str, float], FamilyPoint]]]:
    """The points of an interval that are asked for, and those at which the run ends, with what is reached there."""
    name = run.settings.parameter
    wanted = (value for value in run.at if value != run.origin.value)
    points = [point for value in wanted for point in exact_points(run, before, interval, (name, value), events, "at")]
    return points, [(goal, each) for goal in run.goals
                    for each in exact_points(run, before, interval, goal, events, "end")[:1]]  # fmt: skip


def _events(interval: Interval, settings: FamilySettings, met: list[Event]) -> list[Event]:
    """Located events; a step over one that cannot be located is repeated shorter, and at last taken without it."""
    if not settings.events:
        return []
    try:
        alone = interval.curve.test is None
        located = find_events(interval, settings) if alone else find_special(interval)
        located += zeros(interval, tests_of(interval, not alone))
        events = [event_at(interval.curve, sample, test, settings.parameter) for sample, test in located]
        return sorted(events + met, key=lambda event: event.arclength)
    except (ConvergenceError, IntegrationError) as error:
        if interval.length > SHORTEST_SEARCH and not met:
            raise
        logging.getLogger(__name__).warning("an event could not be located: %s", error)
        return met


def _placed(event: Event, run: Run, origin: FamilyPoint) -> Event:
    """An event of the interval after a point, where it is on the family."""
    return replace(event, index=origin.index, arclength=origin.arclength + run.direction * event.arclength)


def _within(members: Iterable[Member], origin: FamilyPoint, reach: float) -> list[Member]:
    """The points or events no further than `reach` along the family from a point."""
    return [member for member in members if abs(member.arclength - origin.arclength) <= reach]


def _ordered(points: list[FamilyPoint]) -> tuple[FamilyPoint, ...]:
    return tuple(sorted(points, key=lambda point: abs(point.arclength)))


def exact_points(
    run: Run, before: Walked, interval: Interval, goal: tuple[str, float], events: Sequence[Event], role: str
) -> list[FamilyPoint]:
    """The points of an interval at which the parameter, or a watched number, has exactly this value."""
    curve, (name, value), first = run.curve, goal, interval.first
    turns = [event.arclength for event in events if KINDS[event.kind].extremal and event.detail == name]
    edges, points = [0.0, *turns, interval.length], []
    level = partial(_level, interval, name)
    levels = [level(edge) for edge in edges]
    for a, b, low, high in zip(edges[:-1], edges[1:], levels[:-1], levels[1:], strict=True):
        if (low - value) * (high - value) > 0 or low in (value, high):
            continue
        if name in curve.watch:
            sample = interval.sample(zero(lambda d: level(d) - value, a, b, ROUND_OFF))
        else:
            solution = _solve_level(run, interval, a + (b - a) * (value - low) / (high - low), value)
            whole, along = tangent(curve, solution, first.whole), ahead(curve, first, solution)
            sample = make_sample(curve, along, solution, whole, interval.indices(along))
        if not curve.equations.gridded and variation_errors(curve, sample.solution).max() > MESH.coarse:
            fit = settled(curve, sample.solution, sample.whole)
            if name not in curve.watch:
                fit = correct(curve, fit.place, pinned(curve.equations, name, value), fit.place, interval.length)
            sample = make_sample(curve, sample.distance, fit, tangent(curve, fit, sample.head), sample.indices)
        where: dict[str, Any] = {
            "index": before.point.index, "arclength": before.point.arclength + run.direction * sample.distance,
            "step": before.point.step, "role": role, "indices": sample.indices,
        }  # fmt: skip
        parameter = run.settings.parameter
        solution, about = sample.solution, sample.about
        points.append(make_point(curve, solution, sample.head, parameter, run.check, about=about, **where))
    return points


def _level(interval: Interval, name: str, distance: float) -> float:
    """A watched number at a distance into an interval, or about what the parameter is there."""
    if name in interval.curve.watch:
        return watched(interval.curve, interval.sample(distance).solution)[name]
    return parameter_value(interval.curve, interval.guess(distance), name)


def _solve_level(run: Run, interval: Interval, near: float, value: float) -> Solution:
    """The orbit at a given value of the parameter near a distance into an interval, on a mesh that satisfies it."""
    curve, first, reach = run.curve, interval.first.solution, interval.length
    aim = pinned(curve.equations, run.settings.parameter, value)
    slope = first.jacobian if curve.test is None else interval.slope(near)
    solution = correct(curve, interval.guess(near), aim, first.place, reach=reach, slope=slope)
    if distance(curve, solution.place, first.place) > 2 * reach:
        raise ConvergenceError("the exact value was found on another part of the family")
    return solution
