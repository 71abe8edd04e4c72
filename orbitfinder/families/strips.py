"""Multipliers that pass through +1 or -1 between two points: thin strips of instability, and avoided crossings.

A pair of multipliers on the unit circle turns one way, which its Krein signature tells. Where the
signature says that the pair has gone through +-1 although its stability index is inside (-2, 2) at both
points, either the index was outside for a short stretch between two bifurcations, or the step went across
an avoided crossing of two families (an internal resonance), which are different curves on the two sides.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.collisions import twice
from orbitfinder.families.passages import Test, exchanged, passage
from orbitfinder.families.samples import Interval, Probe, is_real

NEAR = 0.5
"""How near to +-2 an index must be at one of the two points to have gone through it."""
GRAZED = 0.05
"""An index nearer than this to +-2 at one of the two points may have been beyond it and come back the same way."""
SEARCH = 1e-3
"""The extremum of an index is located to this share of the step."""


@dataclass(frozen=True)
class Flip:
    """An index (its position) whose multipliers went through the level/2 on the unit circle within a step."""

    position: int
    level: float


def flips(before: Probe, after: Probe) -> list[Flip]:
    """Every index that was turned over between two probes."""
    if before.indices.shape != after.indices.shape or before.about.root != after.about.root:
        return []
    found = []
    passed = {k for pair in exchanged(before.indices, before.turns, after.indices, after.turns) for k in pair}
    for j, (a, b) in enumerate(zip(before.indices, after.indices, strict=True)):
        inside = is_real(a) and is_real(b) and abs(a.real) < 2 and abs(b.real) < 2 and a.real * b.real > 0
        turned = before.turns[j] * after.turns[j] < 0 and j not in passed
        if inside and turned and max(abs(a.real), abs(b.real)) > 2 - NEAR:
            found.append(Flip(j, 2.0 * float(np.sign(a.real))))
    return found


def avoided(before: Probe, after: Probe) -> bool:
    """Whether the step may have gone across an avoided crossing: multipliers met at +1 of the formulation's map."""
    return any(flip.level > 0 for flip in flips(before, after))


def strips(interval: Interval) -> list[tuple[Test, float]]:
    """Looks inside every strip, so that its two bifurcations lie between orbits that were seen.

    What is returned are the places at which multipliers touch without a strip: avoided crossings.
    """
    turned = flips(interval.first, interval.last)
    found = [one for flip in turned for one in _strip(interval, flip)]
    for level in {2.0, -2.0} - {flip.level for flip in turned}:
        ends = [passage(level)(probe) for probe in (interval.first, interval.last)]
        if ends[0] * ends[1] > 0 and min(np.abs(ends)) < GRAZED:
            twice(interval, passage(level))
    return found


def _strip(interval: Interval, flip: Flip) -> list[tuple[Test, float]]:
    sign, j = np.sign(flip.level), flip.position

    def below(distance: float) -> float:
        return float(2.0 - sign * interval.probe(distance).indices[j].real)

    options = {"xatol": SEARCH * interval.length, "maxiter": 25}
    try:
        best = minimize_scalar(below, bounds=(0.0, interval.length), method="bounded", options=options)
        place, least = float(best.x), float(best.fun)
    except (ConvergenceError, IntegrationError):  # the families have turned away on both sides
        ends = [float(2.0 - sign * probe.indices[j].real) for probe in (interval.first, interval.last)]
        place, least = (0.0, interval.length)[int(ends[1] < ends[0])], min(ends)
    if least < 0:
        return []
    what = f"at {flip.level / 2:+.0f}: an avoided crossing stepped over within an arclength of {interval.length:.1g}"
    return [(Test("collision", what, passage(flip.level), multiplier=complex(sign)), place)]
