"""Pseudo-arclength continuation: step along the tangent, correct, look at what lies between, repeat.

Source: H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems, in
Applications of Bifurcation Theory (1977); the predictor is a parabola through the previous point.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.ends import end_after, merged, shortest_step
from orbitfinder.families.events import Interval, Probe, find_events, make_interval, make_probe, parameter_slopes
from orbitfinder.families.mesh import settled
from orbitfinder.families.points import (
    Batch,
    Check,
    End,
    Event,
    FamilyPoint,
    FamilySettings,
    make_point,
    parameter_value,
    place_of,
)
from orbitfinder.families.start import Start
from orbitfinder.families.system import (
    Aim,
    Curve,
    Place,
    Solution,
    advanced,
    at_place,
    bend,
    correct,
    distance,
    head_of,
    tangent,
)

SHORTEST_SEARCH = 1e-3
"""Steps longer than this are repeated at half their length when an event in them cannot be located."""
ECHO = 1e-2
"""Arclength before a junction of two families within which nothing else is reported."""


@dataclass(frozen=True)
class Walk:
    """One direction of a family: its curve, where it began and what is asked of it."""

    curve: Curve
    settings: FamilySettings
    direction: int
    origin: FamilyPoint
    check: Check | None = None
    until: float | None = None
    at: tuple[float, ...] = ()


@dataclass(frozen=True)
class Stand:
    """Where the walk stands: the last point, its integration, the tangent over w, the parabola, the trend."""

    point: FamilyPoint
    found: Solution
    whole: np.ndarray
    curvature: np.ndarray
    trend: np.ndarray
    shortest_period: float


def first_point(start: Start, settings: FamilySettings, check: Check | None) -> FamilyPoint:
    """The point that a family starts from, its tangent towards a larger value of the parameter."""
    head = start.direction
    if parameter_slopes(start.curve, start.found.place, head)[settings.parameter] < 0:
        head = -head
    where: dict[str, Any] = {"index": 0, "arclength": 0.0, "step": settings.first_step}
    return make_point(start.curve, start.found, head, settings.parameter, check, **where)[0]


def follow(walk: Walk, done: Sequence[FamilyPoint] = ()) -> Iterator[Batch]:
    """Batches of points and events in one direction until the family ends.

    `done` are the steps already taken in this direction (from a journal); the walk goes on after them.
    """
    stand = stand_at(walk, [walk.origin, *done])
    while True:
        if stand.point.index >= walk.settings.points:
            yield Batch(walk.direction, end=End("point limit", f"{walk.settings.points} points were asked for"))
            return
        try:
            stand, batch = stride(walk, stand)
        except (ConvergenceError, IntegrationError) as error:
            end = end_after(walk.curve, stand.found, walk.settings, stand.shortest_period, str(error))
            yield Batch(walk.direction, end=end)
            return
        yield batch
        if batch.end is not None:
            return


def stand_at(walk: Walk, points: Sequence[FamilyPoint]) -> Stand:
    """The state of the walk after its last point; everything follows from the points themselves."""
    last = points[-1]
    found = at_place(walk.curve, place_of(last))
    sign = walk.direction if len(points) == 1 else 1
    whole = tangent(walk.curve, found, sign * last.tangent)
    curvature, trend = np.zeros_like(whole), np.zeros_like(last.indices)
    if len(points) > 1:
        before = points[-2]
        curvature = bend(walk.curve, found.place, whole, place_of(before))
        trend = _trend(before, last)
    shortest = min(point.period for point in points)
    return Stand(last, found, whole, curvature, trend, shortest)


def _trend(before: FamilyPoint, last: FamilyPoint) -> np.ndarray:
    if before.indices.shape != last.indices.shape:
        return np.zeros_like(last.indices)
    change = last.indices - before.indices
    return np.asarray(np.where(np.abs(change) < 0.5, change, 0.0))


def stride(walk: Walk, stand: Stand) -> tuple[Stand, Batch]:
    """The next point, by as short a step as it takes. Raises the last error when the step underflows."""
    length = stand.point.step
    while True:
        try:
            return _attempt(walk, stand, length)
        except (ConvergenceError, IntegrationError) as error:
            length *= 0.5
            least = shortest_step(walk.curve, stand.found, walk.settings, stand.shortest_period)
            if length < least:
                raise ConvergenceError(f"step below {least:g}: {error}") from error


def _attempt(walk: Walk, stand: Stand, length: float) -> tuple[Stand, Batch]:
    began = time.perf_counter()
    curve, place = walk.curve, stand.found.place
    head = head_of(stand.whole, place)
    guess = advanced(place, stand.whole, length, stand.curvature)
    normal = curve.weights * head
    aim = Aim(float(normal @ place.head) + length, normal)
    raw = correct(curve, guess, aim, place, reach=0.5 * length + 1e-9)
    whole = tangent(curve, raw, head)
    turn = _angle(curve, head, head_of(whole, raw.place))
    if turn > walk.settings.sharpest_turn:
        raise ConvergenceError(f"the family turns by {turn:.2g} rad within one step")
    found = settled(curve, raw, curve.weights * head_of(whole, raw.place))
    if found is not raw:
        whole = tangent(curve, found, head_of(whole, raw.place))
    last = make_probe(curve, length, raw, tangent(curve, raw, head) if found is not raw else whole,
                      stand.point.indices + stand.trend)  # fmt: skip
    where: dict[str, Any] = {
        "index": stand.point.index + 1,
        "arclength": stand.point.arclength + walk.direction * length,
        "step": _next_step(walk.settings, length, raw.iterations, turn),
        "indices": last.indices,
    }
    where["about"] = last.about if found is raw else None
    point, _ = make_point(curve, found, head_of(whole, found.place), walk.settings.parameter, walk.check, **where)
    point = replace(point, wall_time=time.perf_counter() - began)
    after = Stand(
        point, found, whole, bend(curve, found.place, whole, place), _trend(stand.point, point),
        min(stand.shortest_period, point.period),
    )  # fmt: skip
    return after, _batch(walk, stand, after, last)


def _angle(curve: Curve, one: np.ndarray, other: np.ndarray) -> float:
    return float(np.arccos(np.clip(np.sum(curve.weights * one * other), -1.0, 1.0)))


def _next_step(settings: FamilySettings, length: float, iterations: int, turn: float) -> float:
    """Longer after an easy correction, shorter after a hard one or a sharp turn."""
    ease = 1.5 if iterations <= 2 else 1.2 if iterations == 3 else 1.0 if iterations == 4 else 0.6
    bendable = 0.4 * settings.sharpest_turn / max(turn, 1e-9)
    return float(min(settings.longest_step, length * min(ease, max(0.5, bendable))))


def _batch(walk: Walk, stand: Stand, after: Stand, last: Probe) -> Batch:
    """Everything between two points, in order: events, points asked for, and the end if there is one."""
    curve, settings = walk.curve, walk.settings
    about_first = make_probe(curve, 0.0, stand.found, stand.whole, stand.point.indices)
    interval = make_interval(curve, about_first, last)
    events = _events(interval, settings)
    where = stand.point.arclength
    named = tuple(_placed(event, at, walk, stand) for at, event in events)
    folds = [at for at, event in events if event.kind == "fold" and event.detail == settings.parameter]
    wanted = tuple(value for value in walk.at if value != walk.origin.value)
    extras = [_exact(walk, stand, interval, value, folds, "at") for value in wanted]
    if walk.until is not None:
        final = _exact(walk, stand, interval, walk.until, folds, "end")
        if final:
            end = End("target", f"reached {settings.parameter} = {walk.until!r}")
            reach = abs(final[0].arclength - where)
            kept = [point for group in extras for point in group if abs(point.arclength - where) <= reach]
            before = tuple(event for event in named if abs(event.arclength - where) <= reach)
            return Batch(walk.direction, _ordered([*kept, final[0]]), before, end)
    for event in named:
        joined = merged(curve, _place_of(curve, event)) if (event.kind, event.detail) == ("fold", "energy") else None
        if joined is not None:
            reach = abs(event.arclength - where)
            kept = [point for group in extras for point in group if abs(point.arclength - where) <= reach]
            # the tangent is ill-defined where two families cross: other folds seen beside this one are its echoes
            clear = [one for one in named if abs(one.arclength - where) < reach - ECHO]
            return Batch(walk.direction, _ordered(kept), (*clear, event), joined)
    found = end_after(curve, after.found, settings, after.shortest_period, "", stand.found, walk.origin, after.point)
    points = [point for group in extras for point in group]
    if found is not None and found.kind == "equilibrium":
        return Batch(walk.direction, (), (), found)
    return Batch(walk.direction, (*_ordered(points), after.point), named, found)


def _events(interval: Interval, settings: FamilySettings) -> list[tuple[float, Event]]:
    """Located events; a step over one that cannot be located is repeated shorter, and at last taken without it."""
    if not settings.events:
        return []
    try:
        return find_events(interval, settings, 0.0)
    except (ConvergenceError, IntegrationError) as error:
        if interval.length > SHORTEST_SEARCH:
            raise
        logging.getLogger(__name__).warning("an event could not be located: %s", error)
        return []


def _place_of(curve: Curve, event: Event) -> Place:
    free = np.array(list(event.free.values()))
    return Place(event.nodes, event.period, np.zeros(curve.propagator.unfolding), free, event.mesh)


def _ordered(points: list[FamilyPoint]) -> tuple[FamilyPoint, ...]:
    return tuple(sorted(points, key=lambda point: abs(point.arclength)))


def _placed(event: Event, at: float, walk: Walk, stand: Stand) -> Event:
    return replace(event, index=stand.point.index, arclength=stand.point.arclength + walk.direction * at)


def _exact(
    walk: Walk, stand: Stand, interval: Interval, value: float, folds: list[float], role: str
) -> list[FamilyPoint]:
    """The points of an interval at which the parameter has exactly this value."""
    edges = [0.0, *folds, interval.length]
    levels = [_level(walk, interval, edge) for edge in edges]
    found = []
    for a, b, low, high in zip(edges[:-1], edges[1:], levels[:-1], levels[1:], strict=True):
        if (low - value) * (high - value) > 0 or low in (value, high):
            continue
        guess = interval.guess(a + (b - a) * (value - low) / (high - low))
        place = _solve_level(walk, stand, guess, value, interval.length)
        whole = tangent(walk.curve, place, head_of(stand.whole, stand.found.place))
        normal = walk.curve.weights * head_of(stand.whole, stand.found.place)
        along = float(normal @ (place.place.head - stand.found.place.head))
        expected = interval.indices(along)
        where: dict[str, Any] = {
            "index": stand.point.index, "arclength": stand.point.arclength + walk.direction * along,
            "step": stand.point.step, "role": role,
            "indices": make_probe(walk.curve, along, place, whole, expected).indices,
        }  # fmt: skip
        head = head_of(whole, place.place)
        found.append(make_point(walk.curve, place, head, walk.settings.parameter, walk.check, **where)[0])
    return found


def _level(walk: Walk, interval: Interval, at: float) -> float:
    if at == 0.0:
        place = interval.first.found.place
    elif at == interval.length:
        place = interval.last.found.place
    else:
        place = interval.guess(at)
    return parameter_value(walk.curve, place, walk.settings.parameter)


def _solve_level(walk: Walk, stand: Stand, guess: Place, value: float, reach: float) -> Solution:
    """The orbit at a given value of the parameter, on a mesh that satisfies it."""
    curve, size = walk.curve, walk.curve.propagator.size
    name, model = walk.settings.parameter, walk.curve.propagator.model
    unit = np.eye(curve.weights.size)
    if name == "energy":
        aim = Aim(value, invariant=0)
    elif name == "period":
        aim = Aim(value, unit[size])
    elif name in curve.propagator.free:
        aim = Aim(value, unit[size + 1 + curve.propagator.free.index(name)])
    else:
        aim = Aim(value, unit[model.state_index(name)])
    found = correct(curve, guess, aim, stand.found.place, reach=reach)
    if distance(curve, found.place.head, stand.found.place.head) > 2 * reach:
        raise ConvergenceError("the exact value was found on another part of the family")
    return found
