"""Beside a nearly degenerate orbit: one equation in one unknown, followed along the valley where the others hold.

There the Jacobian J has one singular value that is far smaller than the rest (a nearly resonant torus, a fold or
a pitchfork close by): the residual F is small along a curve, damped steps creep and chord steps do not contract.
With its singular vectors u, v the bordered equations

    F(x) = mu u,  v.(x - x0) = h

are regular; mu(h) is followed from h = 0 until its sign changes, and there its zero is an orbit. Source: reduction
of Lyapunov and Schmidt by bordered systems, W. Govaerts, Numerical Methods for Bifurcations of Dynamical
Equilibria, SIAM 2000, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from orbitfinder.atlas.solver import QuickSettings, Scaled, Stalled, bounded, linearised, moved
from orbitfinder.errors import IntegrationError
from orbitfinder.loops.loop import Unknowns

LONGEST, SHORTEST = 0.3, 1e-3
"""Scaled steps along the valley."""
MOST_CORRECTIONS = 6
MOST_TRIALS = 60
MOST_ROOT_STEPS = 20
SLACK = 1e-3
"""The regular equations hold when they are smaller than |mu| by this."""
ROUND_OFF = 3e-13
"""Scaled residual that counts as none."""


@dataclass(frozen=True)
class Point:
    """A point of the valley: w, scaled residual F and Jacobian there, u and v, and mu = u.F."""

    w: Unknowns
    residual: np.ndarray
    jacobian: np.ndarray
    left: np.ndarray
    right: np.ndarray

    @property
    def mu(self) -> float:
        """What is left of the residual in the one equation that is not regular."""
        return float(self.left @ self.residual)

    @property
    def rest(self) -> float:
        """The largest residual of the others."""
        return float(np.abs(self.residual - self.mu * self.left).max())


def orbit_in_valley(one: Scaled, w: Unknowns, settings: QuickSettings) -> tuple[Unknowns, np.ndarray]:
    """The unknowns of an orbit in the valley that w lies in, and the Jacobian there; `Stalled` when there is none."""
    fine = replace(one, step=fine_step(one, w))
    try:
        here = corrected(fine, settings, turned(Point(w, *linearised(fine, w), *NOWHERE)), 0.0)
        if abs(here.mu) > ROUND_OFF:
            here = crossed(fine, settings, *bracket(fine, settings, turned(here)))
    except (IntegrationError, np.linalg.LinAlgError) as error:
        raise Stalled(w) from error
    return here.w, here.jacobian


def fine_step(one: Scaled, w: Unknowns) -> float:
    """The longest step (s) with which half of it agrees; the polish that follows needs no better Jacobian."""
    w = one.at(w)
    mesh = one.loop.equations.march.refined_ends(w.nodes, w.mesh, w.tail)[1]
    return 2 * w.period * float(mesh[-1]) / (mesh.size - 1)


NOWHERE = np.zeros(0), np.zeros(0)


def turned(at: Point) -> Point:
    """The point with the singular vectors of its own Jacobian, in the senses of those that it came with."""
    left, _, right = np.linalg.svd(at.jacobian)
    u, v = left[:, -1], right[-1]
    if at.left.size:
        u, v = u * (np.sign(u @ at.left) or 1.0), v * (np.sign(v @ at.right) or 1.0)
    return replace(at, left=u, right=v)


def corrected(one: Scaled, settings: QuickSettings, at: Point, length: float) -> Point:
    """Where the regular equations hold at h = `length` from a point, by Newton's method; `Stalled` if nowhere."""
    w, smallest = moved(one, at.w, length * at.right), np.inf
    for _ in range(MOST_CORRECTIONS):
        found = Point(w, *linearised(one, bounded(one, w, settings)), at.left, at.right)
        if found.rest < max(SLACK * abs(found.mu), ROUND_OFF):
            return found
        if found.rest > smallest:
            break
        smallest = found.rest
        bordered = np.block([[found.jacobian, -at.left[:, None]], [at.right[None], np.zeros((1, 1))]])
        wanted = np.append(found.mu * at.left - found.residual, 0.0)
        w = moved(one, w, np.linalg.solve(bordered, wanted)[:-1])
    raise Stalled(at.w)


def bracket(one: Scaled, settings: QuickSettings, at: Point) -> tuple[Point, Point, float]:
    """Two successive points between which mu changes its sign, and h from the first to the second."""
    length = -LONGEST * (np.sign(at.mu * (at.left @ at.jacobian @ at.right)) or 1.0)  # the way on which |mu| falls
    for _ in range(MOST_TRIALS):
        try:
            there = corrected(one, settings, at, length)
        except (Stalled, IntegrationError):
            length /= 2
            if abs(length) < SHORTEST:
                break
            continue
        if there.mu * at.mu <= 0:
            return at, there, length
        at, length = turned(there), float(np.clip(1.5 * length, -LONGEST, LONGEST))
    raise Stalled(at.w)


def crossed(one: Scaled, settings: QuickSettings, first: Point, second: Point, length: float) -> Point:
    """The zero of mu between two points, by the Illinois method (M. Dowell, P. Jarratt, BIT 11 (1971) 168-174)."""
    (low, below), (high, above) = (0.0, first.mu), (length, second.mu)
    found = second
    for _ in range(MOST_ROOT_STEPS):
        if abs(found.mu) < ROUND_OFF or abs(high - low) < 1e-13:
            break
        middle = (low * above - high * below) / (above - below)
        found = corrected(one, settings, first, middle)
        if found.mu * above < 0:
            low, below = high, above
        else:
            below /= 2
        high, above = middle, found.mu
    return found
