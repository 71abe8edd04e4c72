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
from orbitfinder.families.events import Interval, Probe, Test, discriminant, is_real, level_tests, passage, probe_at

NEAR = 0.5
"""How near to +-2 an index must be at one of the two points to have gone through it."""
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
    for j, (a, b) in enumerate(zip(before.indices, after.indices, strict=True)):
        inside = is_real(a) and is_real(b) and abs(a.real) < 2 and abs(b.real) < 2 and a.real * b.real > 0
        if inside and before.turns[j] * after.turns[j] < 0 and max(abs(a.real), abs(b.real)) > 2 - NEAR:
            found.append(Flip(j, 2.0 * float(np.sign(a.real))))
    return found


def avoided(before: Probe, after: Probe) -> bool:
    """Whether the step may have gone across an avoided crossing: multipliers met at +1 of the formulation's map."""
    return any(flip.level > 0 for flip in flips(before, after))


def strip_tests(interval: Interval, resonances: int) -> list[tuple[Test, float, float]]:
    """(test, low, high) of the two bifurcations of every strip, or of the one place where multipliers touch."""
    found = [one for flip in flips(interval.first, interval.last) for one in _strip(interval, flip, resonances)]
    return found + [one for pair in crossings(interval.first, interval.last) for one in _bubble(interval, *pair)]


def crossings(before: Probe, after: Probe) -> list[tuple[int, int]]:
    """Pairs of indices on the circle, of opposite signature, that have passed each other between two probes."""
    if before.indices.shape != after.indices.shape or before.about.root != after.about.root:
        return []
    pairs = [(i, j) for i in range(before.indices.size) for j in range(i)]
    real = [is_real(a) and is_real(b) for a, b in zip(before.indices, after.indices, strict=True)]
    gaps = [[float((one.indices[i] - one.indices[j]).real) for one in (before, after)] for i, j in pairs]
    opposite = [before.turns[i] * before.turns[j] < 0 for i, j in pairs]
    chosen = zip(pairs, gaps, opposite, strict=True)
    return [(i, j) for (i, j), (a, b), unlike in chosen if real[i] and real[j] and unlike and a * b < 0]


def _bubble(interval: Interval, i: int, j: int) -> list[tuple[Test, float, float]]:
    """The two Krein collisions of a pair that was off the circle for less than a step."""
    test = Test("collision", "", discriminant(i, j))
    options = {"xatol": SEARCH * interval.length, "maxiter": 25}
    least = minimize_scalar(
        lambda distance: test.measure(probe_at(interval, distance)), bounds=(0.0, interval.length), method="bounded",
        options=options,
    )  # fmt: skip
    if least.fun >= 0:
        return []
    return [(test, 0.0, float(least.x)), (test, float(least.x), interval.length)]


def _strip(interval: Interval, flip: Flip, resonances: int) -> list[tuple[Test, float, float]]:
    sign, j = np.sign(flip.level), flip.position

    def below(distance: float) -> float:
        return float(2.0 - sign * probe_at(interval, distance).indices[j].real)

    options = {"xatol": SEARCH * interval.length, "maxiter": 25}
    try:
        best = minimize_scalar(below, bounds=(0.0, interval.length), method="bounded", options=options)
        place, least = float(best.x), float(best.fun)
    except (ConvergenceError, IntegrationError):  # the families have turned away on both sides
        ends = [float(2.0 - sign * probe.indices[j].real) for probe in (interval.first, interval.last)]
        place, least = (0.0, interval.length)[int(ends[1] < ends[0])], min(ends)
    if least < 0:
        (test,) = (one for one in level_tests(interval.first.about.root, resonances, j) if one[1] == flip.level)
        return [(test[0], 0.0, place), (test[0], place, interval.length)]
    what = f"at {flip.level / 2:+.0f}: an avoided crossing stepped over within an arclength of {interval.length:.1g}"
    return [(Test("collision", what, passage(j, flip.level), multiplier=complex(sign)), place, place)]
