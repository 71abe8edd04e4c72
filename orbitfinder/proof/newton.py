"""Newton on the theorem's equations without error bounds: where the box goes, and refined digits.

The same power series as in the proof, centres of balls only, at any precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from orbitfinder.errors import ConvergenceError
from orbitfinder.proof.balls import Vector, arb, arb_mat, block, exact, floats, magnitude, midpoints
from orbitfinder.proof.enclosure import Settings, horner
from orbitfinder.proof.krawczyk import Equations, approximate_inverse, jacobian, residual

MOST_ITERATIONS = 30
ROUGH = 1e-5
"""Corrections above this make a new Jacobian worth while"""


def step_length(series: list[Vector], left: float, settings: Settings) -> float:
    """A step whose last term is below the tolerance."""
    order = len(series[0]) - 1
    last, before = (magnitude([one[k] for one in series]) for k in (-1, -2))
    largest = max(last, before ** (order / (order - 1)))
    h = 0.9 * (settings.tolerance / max(largest, 1e-300)) ** (1.0 / order)
    return min(left, float(int(min(h, 1.0) * 2.0**40) * 2.0**-40))


def flow(equations: Equations, node: Vector, settings: Settings, vary: bool) -> tuple[Vector, Any]:
    """End (2n) of a segment and, when asked for, the derivatives (2n x 2n+2), as centres of balls."""
    field, size = equations.field, 2 * equations.field.size
    here, begin = midpoints(node), 0.0
    total = exact(np.eye(size + 2))
    while begin < 1.0:
        found = field.solution(here, settings.order, vary)
        h = step_length(found.states, 1.0 - begin, settings)
        if not 0 < h <= 1:
            raise ConvergenceError("no orbit near: the solution leaves every bound on the way")
        here = midpoints([horner(one, arb(h)) for one in found.states]) + here[size:]
        if vary:
            total = (horner(found.transitions(), arb(h)) * total).mid()
        begin += h
    return here[:size], block(total, size, 0, size + 2)


def linearised(equations: Equations, unknowns: Vector, settings: Settings) -> tuple[Vector, np.ndarray]:
    """F and an approximate inverse of DF at a point."""
    found = [flow(equations, node, settings, vary=True) for node in equations.formulation.nodes(unknowns)]
    values = residual(equations, unknowns, [end for end, _ in found])
    slopes = floats(jacobian(equations, unknowns, [matrix for _, matrix in found]))
    return midpoints(values), approximate_inverse(slopes)


def evaluated(equations: Equations, unknowns: Vector, settings: Settings) -> Vector:
    """F at a point."""
    ends = [flow(equations, node, settings, vary=False)[0] for node in equations.formulation.nodes(unknowns)]
    return midpoints(residual(equations, unknowns, ends))


def solve(
    equations: Equations, start: Vector, settings: Settings, target: float, farthest: float = 1e-2
) -> tuple[Vector, int]:
    """Unknowns whose last correction is below `target`, and the number of iterations.

    Newton's steps until they are small; then the last inverse is used again (each step gains the digits
    that it is right to). Raises `ConvergenceError` when they do not shrink or leave the start.
    """
    here, last = midpoints(start), float("inf")
    inverse = np.zeros((0, 0))
    for k in range(MOST_ITERATIONS):
        if k == 0 or last > ROUGH:
            values, inverse = linearised(equations, here, settings)
        else:
            values = evaluated(equations, here, settings)
        correction = (exact(inverse) * arb_mat(len(values), 1, values)).entries()
        size = magnitude(midpoints(correction))
        here = midpoints([x - c for x, c in zip(here, correction, strict=True)])
        moved = magnitude([x - y for x, y in zip(here, start, strict=True)])
        if not moved <= farthest or (k > 2 and size > 0.5 * last):
            raise ConvergenceError(f"no orbit near: Newton moved the nodes by {moved:.2g}, last by {size:.2g}")
        if size <= target or (size == 0.0):
            return here, k + 1
        last = size
    raise ConvergenceError(f"Newton did not settle in {MOST_ITERATIONS} iterations; the last correction was {last:.2g}")
