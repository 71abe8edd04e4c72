"""Pseudo-arclength continuation: step along the tangent, correct, look at what lies between, repeat.

Source: H. B. Keller, Numerical solution of bifurcation and nonlinear eigenvalue problems, in
Applications of Bifurcation Theory (1977); the predictor is a parabola through the previous point.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.ends import end_after, energies_of, merged, returned, shortest_step
from orbitfinder.families.events import Interval, Probe, find_events, make_interval, make_probe
from orbitfinder.families.exact import exact_points
from orbitfinder.families.point import FamilySettings, make_point, unknowns_of
from orbitfinder.families.run import Stand, Walk, stand_at, trend_of
from orbitfinder.families.scale import span
from orbitfinder.families.stability import Spectrum
from orbitfinder.families.strips import avoided
from orbitfinder.loops.continued import Curve, Solution, advanced, bend, correct, distance, tangent
from orbitfinder.loops.loop import Condition
from orbitfinder.loops.mesh import refined, regraded, settled
from orbitfinder.records.family import Batch, End, Event, FamilyPoint

SHORTEST_SEARCH = 1e-3
"""Steps longer than this are repeated at half their length when an event in them cannot be located."""
PREDICTION = 3e-3
"""How far from the family, in its metric, the predicted orbit should be."""
REFINEMENTS = 2
"""How often the mesh of an orbit that does not close is made finer before its step is made shorter."""
ECHO = 1e-2
"""Arclength before a junction of two families within which nothing else is reported."""


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


LEAST_STRETCHED = 1e-4
"""A step as short as this may change the period by more than `longest_stretch`: the saddle is reached in the end."""


def stride(walk: Walk, stand: Stand) -> tuple[Stand, Batch]:
    """The next point, by as short a step as it takes. Raises the last error when the step underflows."""
    length = stand.point.step
    while True:
        try:
            return _attempt(walk, stand, length)
        except (ConvergenceError, IntegrationError) as error:
            length *= 0.5
            least = shortest_step(walk.curve, stand.found, walk.settings, stand.shortest_period)
            least *= _span(walk.curve, stand.found)
            if length < least:
                raise ConvergenceError(f"step below {least:g}: {error}") from error


def _attempt(walk: Walk, stand: Stand, length: float) -> tuple[Stand, Batch]:
    began = time.perf_counter()
    curve, place, unit = walk.curve, stand.found.place, _span(walk.curve, stand.found)
    head = place.head_of(stand.whole)
    guess = advanced(place, stand.whole, length, stand.curvature)
    normal = curve.weights * head
    aim = Condition(float(normal @ place.head) + length, normal)
    slope = stand.found.jacobian if stand.drift is None else stand.found.jacobian + length * stand.drift
    raw = correct(curve, guess, aim, place, reach=0.5 * length + 1e-9 * unit, slope=slope, fit=regraded)
    whole = tangent(curve, raw, head)
    turn = _angle(curve, head, raw.place.head_of(whole))
    if turn > walk.settings.sharpest_turn:
        raise ConvergenceError(f"the family turns by {turn:.2g} rad within one step")
    stretch = abs(raw.place.period / place.period - 1.0)
    if stretch > walk.settings.longest_stretch and length > LEAST_STRETCHED * unit:
        raise ConvergenceError(f"the period changes by {stretch:.2g} within one step")
    found = settled(curve, raw, curve.weights * raw.place.head_of(whole))
    if found is not raw:
        whole = tangent(curve, found, raw.place.head_of(whole))
    last = make_probe(curve, length, raw, tangent(curve, raw, head) if found is not raw else whole,
                      stand.point.indices + stand.trend)  # fmt: skip
    if length > walk.settings.narrowest * unit and avoided(stand.probe, last):
        raise ConvergenceError("two families may avoid each other within one step")
    missed = distance(curve, guess.head, raw.place.head)
    where: dict[str, Any] = {
        "index": stand.point.index + 1,
        "arclength": stand.point.arclength + walk.direction * length,
        "step": unit * _next_step(walk.settings, length / unit, missed / unit, (turn, stretch)),
        "indices": last.indices,
    }
    point, found = _checked_point(walk, found, whole, where, last.about if found is raw else None)
    point = replace(point, wall_time=time.perf_counter() - began)
    probe = replace(last, distance=0.0) if found is raw else make_probe(curve, 0.0, found, whole, last.indices)
    after = Stand(
        point, found, whole, bend(curve, found.place, whole, place), trend_of(stand.point, point),
        min(stand.shortest_period, point.period), probe, (*stand.heads, found.place.head),
        (raw.jacobian - stand.found.jacobian) / length if found is raw else None,
    )  # fmt: skip
    return after, _batch(walk, stand, after, last)


def _checked_point(
    walk: Walk, found: Solution, whole: np.ndarray, where: dict[str, Any], about: Spectrum | None
) -> tuple[FamilyPoint, Solution]:
    """The point of a corrected place, on a finer mesh where it does not close on this one."""
    head, name = found.place.head_of(whole), walk.settings.parameter
    for trial in range(REFINEMENTS + 1):
        try:
            return make_point(walk.curve, found, head, name, walk.check, about=about, **where)[0], found
        except ConvergenceError:
            if trial == REFINEMENTS:
                raise
            found, about = refined(walk.curve, found, walk.curve.weights * head), None
    raise AssertionError("unreachable")


def _span(curve: Curve, found: Solution) -> float:
    """What lengths along the family are relative to here."""
    return span(curve.equations.model.angles, curve.weights, found.march.states)


def _angle(curve: Curve, one: np.ndarray, other: np.ndarray) -> float:
    return float(np.arccos(np.clip(np.sum(curve.weights * one * other), -1.0, 1.0)))


def _next_step(settings: FamilySettings, length: float, missed: float, changes: tuple[float, float]) -> float:
    """Longer after a good prediction (its error goes with the third power), shorter after a bad one or large changes.

    `changes` are the turn (rad) and the relative change of the period; all lengths are relative to the motion.
    """
    ease = float(np.clip((PREDICTION / max(missed, 1e-12)) ** (1 / 3), 0.5, 1.5))
    limits = (0.4 * settings.sharpest_turn, 0.6 * settings.longest_stretch)
    bendable = min(limit / max(change, 1e-9) for limit, change in zip(limits, changes, strict=True))
    return float(min(settings.longest_step, length * min(ease, max(0.5, bendable))))


def _batch(walk: Walk, stand: Stand, after: Stand, last: Probe) -> Batch:
    """Everything between two points, in order: events, points asked for, and the end if there is one."""
    curve, settings = walk.curve, walk.settings
    interval = make_interval(curve, stand.probe, last)
    events = _events(interval, settings)
    where = stand.point.arclength
    named = tuple(_placed(event, at, walk, stand) for at, event in events)
    folds = [at for at, event in events if event.kind == "fold" and event.detail == settings.parameter]
    wanted = tuple(value for value in walk.at if value != walk.origin.value)
    extras = [exact_points(walk, stand, interval, value, folds, "at") for value in wanted]
    if walk.until is not None:
        final = exact_points(walk, stand, interval, walk.until, folds, "end")
        if final:
            end = End("target", f"reached {settings.parameter} = {walk.until!r}")
            reach = abs(final[0].arclength - where)
            kept = [point for group in extras for point in group if abs(point.arclength - where) <= reach]
            before = tuple(event for event in named if abs(event.arclength - where) <= reach)
            return Batch(walk.direction, _ordered([*kept, final[0]]), before, end)
    about = energies_of(walk.origin, stand.point, after.point)
    found = end_after(curve, after.found, settings, after.shortest_period, "", stand.found, about)
    if found is not None and found.kind == "equilibrium":
        return Batch(walk.direction, (), (), found)
    for event in named:
        turned = (event.kind, event.detail) == ("fold", "energy")
        at = abs(event.arclength - where)
        joined = merged(curve, unknowns_of(curve, event), interval, at) if turned else None
        if joined is not None:
            reach = abs(event.arclength - where)
            kept = [point for group in extras for point in group if abs(point.arclength - where) <= reach]
            # the tangent is ill-defined where two families cross: other folds seen beside this one are its echoes
            clear = [one for one in named if abs(one.arclength - where) < reach - ECHO * interval.unit]
            return Batch(walk.direction, _ordered(kept), (*clear, event), joined)
    found = found or returned(curve, stand.found, after.found, stand.heads, after.point.arclength)
    points = [point for group in extras for point in group]
    return Batch(walk.direction, (*_ordered(points), after.point), named, found)


def _events(interval: Interval, settings: FamilySettings) -> list[tuple[float, Event]]:
    """Located events; a step over one that cannot be located is repeated shorter, and at last taken without it."""
    if not settings.events:
        return []
    try:
        return find_events(interval, settings, 0.0)
    except (ConvergenceError, IntegrationError) as error:
        if interval.share > SHORTEST_SEARCH:
            raise
        logging.getLogger(__name__).warning("an event could not be located: %s", error)
        return []


def _ordered(points: list[FamilyPoint]) -> tuple[FamilyPoint, ...]:
    return tuple(sorted(points, key=lambda point: abs(point.arclength)))


def _placed(event: Event, at: float, walk: Walk, stand: Stand) -> Event:
    return replace(event, index=stand.point.index, arclength=stand.point.arclength + walk.direction * at)
