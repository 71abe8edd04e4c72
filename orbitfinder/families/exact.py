"""The orbits of a step at which the family's parameter has exactly the values asked for."""

from __future__ import annotations

from typing import Any

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.events import Interval, make_probe
from orbitfinder.families.point import make_point, parameter_value
from orbitfinder.families.run import Stand, Walk
from orbitfinder.loops.continued import Solution, correct, distance, tangent
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.problem import pinned
from orbitfinder.records.family import FamilyPoint


def exact_points(
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
        whole = tangent(walk.curve, place, stand.found.place.head_of(stand.whole))
        normal = walk.curve.weights * stand.found.place.head_of(stand.whole)
        along = float(normal @ (place.place.head - stand.found.place.head))
        expected = interval.indices(along)
        where: dict[str, Any] = {
            "index": stand.point.index, "arclength": stand.point.arclength + walk.direction * along,
            "step": stand.point.step, "role": role,
            "indices": make_probe(walk.curve, along, place, whole, expected).indices,
        }  # fmt: skip
        head = place.place.head_of(whole)
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


def _solve_level(walk: Walk, stand: Stand, guess: Unknowns, value: float, reach: float) -> Solution:
    """The orbit at a given value of the parameter, on a mesh that satisfies it."""
    curve = walk.curve
    aim = pinned(curve.equations, walk.settings.parameter, value)
    found = correct(curve, guess, aim, stand.found.place, reach=reach, slope=stand.found.jacobian)
    if distance(curve, found.place.head, stand.found.place.head) > 2 * reach:
        raise ConvergenceError("the exact value was found on another part of the family")
    return found
