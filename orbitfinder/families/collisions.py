"""Collisions: two stability indices meet and leave the real axis together, or come back to it.

Both the place where this happens and pairs of such places within one step are looked for. On the unit
circle only multipliers of opposite Krein signature do so; equal ones pass through each other.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.passages import Measure
from orbitfinder.families.samples import Interval, Probe, real_indices

NEAR_MEETING = 0.3
"""Indices nearer than this at one end of a step may have met twice inside it."""
SEARCH = 1e-3
"""The extremum of a measure is located to this share of the step."""

Bracket = tuple[float, float]


def meeting(probe: Probe) -> float:
    """The least |kappa_i - kappa_j|^2 of indices that may collide, its sign changed by every complex pair."""
    values, turns = probe.indices, probe.turns
    unlike = (turns[:, None] == 0) | (turns[:, None] != turns[None, :])
    gaps = np.where(np.triu(unlike, 1), np.abs(values[:, None] - values[None, :]) ** 2, np.inf)
    return float((-1.0) ** complex_pairs(probe) * min(gaps.min(initial=np.inf), 1e300))


def complex_pairs(probe: Probe) -> int:
    """Pairs of indices off the real axis."""
    return int(np.sum(~real_indices(probe))) // 2


def look(interval: Interval) -> None:
    """Looks between the ends where indices may have met twice, so that an orbit between the two meetings is seen."""
    a, b = interval.first, interval.last
    if complex_pairs(a) != complex_pairs(b):
        return
    exchanged = _exchanged(a, b)
    if exchanged or min(abs(meeting(a)), abs(meeting(b))) < NEAR_MEETING**2:
        twice(interval, meeting, exchanged)


def collisions(interval: Interval) -> list[Bracket]:
    """(low, high) of every collision between orbits that were seen. Raises `ConvergenceError` where two are in one."""
    found = []
    for before, after in pairwise(interval.known()):
        change = complex_pairs(after) - complex_pairs(before)
        if abs(change) > 1:
            raise ConvergenceError("two pairs of stability indices meet within one step")
        if change:
            found.append((before.distance, after.distance))
    return found


def twice(interval: Interval, measure: Measure, thorough: bool = False) -> float | None:
    """A distance between two zeros of a measure that has one sign at both ends; None where it keeps it.

    Looked for at the vertex of a parabola, or `thorough`ly by minimising.
    """
    sign = float(np.sign(measure(interval.first)))

    def height(distance: float) -> float:
        return sign * measure(interval.probe(distance))

    place = (_lowest if thorough else _vertex)(height, interval.length)
    return place if height(place) < 0 else None


def _vertex(height: Callable[[float], float], length: float) -> float:
    """The middle, or where the parabola through the ends and the middle is lowest."""
    a, m, b = height(0.0), height(0.5 * length), height(length)
    bend, slope = 2 * (a - 2 * m + b), -3 * a + 4 * m - b
    share = -0.5 * slope / bend if bend > 0 else 0.5
    low = a + share * slope + share**2 * bend
    return share * length if m >= 0 and 0 < share < 1 and low < 0.2 * min(a, b) else 0.5 * length


def _lowest(height: Callable[[float], float], length: float) -> float:
    options = {"xatol": SEARCH * length, "maxiter": 25}
    return float(minimize_scalar(height, bounds=(0.0, length), method="bounded", options=options).x)


def _exchanged(a: Probe, b: Probe) -> bool:
    """Whether indices of opposite signature on the unit circle stand in another order."""
    first, last = ([int(t) for t in one.turns[np.argsort(one.indices.real)] if t] for one in (a, b))
    return len(first) == len(last) and sum(first) == sum(last) and first != last
