"""Bifurcations of families that conserve no energy: multipliers that pass through the unit circle.

Sorted by size, the moduli are continuous along the family, whatever meets what: each that passes 1 is an event, and the
multiplier that does so says which, +1 (fold or branch point), -1 (period doubling) or a complex pair (torus, the
Neimark-Sacker bifurcation). A neutral saddle, two real multipliers of product 1, passes nothing.
Source: Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004), sections 5.3 and 10.2.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.families.collisions import twice
from orbitfinder.families.passages import UNTOLD, Measure, Test, located
from orbitfinder.families.samples import Interval, Probe, is_real

GRAZED = 0.1
"""A modulus within this share of 1 at one of the two points may have passed it and come back."""
DEEPEST = 6
"""How often a part of a step is halved until the events in it account for what changes across it."""


def multipliers(probe: Probe) -> np.ndarray:
    """Multipliers of the root map, the largest modulus first."""
    values = np.linalg.eigvals(probe.about.reduced).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]


def modulus(rank: int) -> Measure:
    """The logarithm of the modulus of this rank."""
    return lambda probe: float(np.log(np.maximum(np.abs(multipliers(probe)[rank]), 1e-300)))


def crossings(interval: Interval) -> list[tuple[Probe, Test]]:
    """Every passage of a multiplier through the unit circle, with the orbit there.

    Raises `ConvergenceError` where they cannot be told apart within so long a step.
    """
    for rank in range(len(interval.first.about.reduced)):
        ends = [modulus(rank)(probe) for probe in (interval.first, interval.last)]
        if ends[0] * ends[1] > 0 and min(np.abs(ends)) < GRAZED:
            twice(interval, modulus(rank))
    parts = [(a.distance, b.distance) for a, b in pairwise(interval.known())]
    return [one for low, high in parts for one in _between(interval, low, high, DEEPEST)]


def _between(interval: Interval, low: float, high: float, depth: int) -> list[tuple[Probe, Test]]:
    """The passages of a part of an interval, halved until they explain what is beyond +1 and -1 at its ends."""
    a, b = interval.probe(low), interval.probe(high)
    found = _passed(interval, a, b)
    if all(_parity(found, sign) == (_beyond(a, sign) + _beyond(b, sign)) % 2 for sign in (1, -1)):
        return found
    if depth == 0:
        if interval.share > UNTOLD:
            raise ConvergenceError("multipliers on the unit circle cannot be told apart within one step")
        return found
    middle = 0.5 * (low + high)
    return _between(interval, low, middle, depth - 1) + _between(interval, middle, high, depth - 1)


def _passed(interval: Interval, a: Probe, b: Probe) -> list[tuple[Probe, Test]]:
    """One passage for each modulus that is on another side of 1; the two of a complex pair are one passage."""
    found: list[tuple[Probe, Test]] = []
    rank, count = 0, len(a.about.reduced)
    while rank < count:
        measure = modulus(rank)
        rank += 1
        if (measure(a) < 0) == (measure(b) < 0):
            continue
        probe = located(interval, measure, a.distance, b.distance)
        test = _named(probe, rank - 1)
        rank += test.kind == "torus"
        found.append((probe, test))
    return found


def _named(probe: Probe, rank: int) -> Test:
    """What the multiplier of this rank does on the unit circle."""
    mu = complex(multipliers(probe)[rank])
    if not is_real(mu):
        return Test("torus", "", modulus(rank), 0, complex(mu.real, abs(mu.imag)))
    if mu.real > 0:
        return Test("branch_point", "", modulus(rank))
    if probe.about.root == 2:
        return Test("branch_point", "", modulus(rank), 1, -1.0 + 0.0j)
    return Test("period_doubling", "", modulus(rank), 2, -1.0 + 0.0j)


def _beyond(probe: Probe, sign: int) -> int:
    """How many real multipliers are beyond +1 or -1."""
    values = multipliers(probe)
    return sum(is_real(mu) and sign * mu.real > 1 for mu in values)


def _parity(found: list[tuple[Probe, Test]], sign: int) -> int:
    """Whether an odd number of passages is through +1 or -1."""
    return sum(test.kind != "torus" and test.multiplier.real * sign > 0 for _, test in found) % 2
