"""Where a walk along a family stands: what is asked, the last point and what the next step is predicted from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder.families.events import Probe, make_probe, parameter_slopes
from orbitfinder.families.point import Check, FamilySettings, make_point, unknowns_of
from orbitfinder.families.scale import span
from orbitfinder.families.start import Start
from orbitfinder.loops.continued import Curve, Solution, at_place, bend, tangent
from orbitfinder.records.family import FamilyPoint


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
    """Where the walk stands: the last point, its integration, the tangent over w, the parabola, the trend.

    `probe` is what the tests read there, `heads` every step so far, and `drift` the change of the
    Jacobian with arclength, where two orbits in a row have one mesh.
    """

    point: FamilyPoint
    found: Solution
    whole: np.ndarray
    curvature: np.ndarray
    trend: np.ndarray
    shortest_period: float
    probe: Probe
    heads: tuple[np.ndarray, ...]
    drift: np.ndarray | None = None


def first_point(start: Start, settings: FamilySettings, check: Check | None) -> FamilyPoint:
    """The point that a family starts from, its tangent towards a larger value of the parameter."""
    head = start.direction
    if parameter_slopes(start.curve, start.found.place, head)[settings.parameter] < 0:
        head = -head
    unit = span(start.curve.equations.model.angles, start.curve.weights, start.found.march.states)
    where: dict[str, Any] = {"index": 0, "arclength": 0.0, "step": settings.first_step * unit}
    return make_point(start.curve, start.found, head, settings.parameter, check, **where)[0]


def stand_at(walk: Walk, points: Sequence[FamilyPoint]) -> Stand:
    """The state of the walk after its last point; everything follows from the points themselves."""
    last = points[-1]
    found = at_place(walk.curve, unknowns_of(walk.curve, last))
    sign = walk.direction if len(points) == 1 else 1
    whole = tangent(walk.curve, found, sign * last.tangent)
    curvature, trend = np.zeros_like(whole), np.zeros_like(last.indices)
    if len(points) > 1:
        before = points[-2]
        curvature = bend(walk.curve, found.place, whole, unknowns_of(walk.curve, before))
        trend = trend_of(before, last)
    shortest = min(point.period for point in points)
    probe = make_probe(walk.curve, 0.0, found, whole, last.indices)
    heads = tuple(unknowns_of(walk.curve, point).head for point in points)
    return Stand(last, found, whole, curvature, trend, shortest, probe, heads)


def trend_of(before: FamilyPoint, last: FamilyPoint) -> np.ndarray:
    """The last change of each index, 0 where it was a jump."""
    if before.indices.shape != last.indices.shape:
        return np.zeros_like(last.indices)
    change = last.indices - before.indices
    return np.asarray(np.where(np.abs(change) < 0.5, change, 0.0))
