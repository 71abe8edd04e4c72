"""A quarter of a symmetric motion of a large system: states and variations on a fixed mesh.

The variational equations are integrated column block by column block, each column one directional
derivative of the O(n) accelerations, so that n columns cost O(n^2) operations a step and no graph
grows with more than n times the block. The march is the eighth-order one of `runge_kutta`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder.errors import IntegrationError
from orbitfinder.flow import vector_field
from orbitfinder.mechanics.model import Model
from orbitfinder.runge_kutta import refined_march

BLOCK = 20
"""Columns that share one evaluation of the state: 3.7 us a column at 20 links, 19 us at 100."""


@dataclass(frozen=True, eq=False)
class Quarter:
    """The autonomous equations of motion x' = f(x) of a Model, and their directional derivatives."""

    model: Model

    @property
    def links(self) -> int:
        """n, the number of coordinates."""
        return self.model.degrees_of_freedom

    @cached_property
    def field(self) -> ca.Function:
        """f(t, x, s, free), as everywhere, without unfolding or freed parameters."""
        return vector_field(self.model, (), ())

    @cached_property
    def slopes(self) -> ca.Function:
        """(x, Y) -> (f(x), df/dx Y) for BLOCK columns Y (2n x BLOCK)."""
        size = 2 * self.links
        x, columns = ca.SX.sym("x", size), ca.SX.sym("Y", size, BLOCK)
        rate = self.field(0.0, x, ca.SX(0, 1), ca.SX(0, 1))
        return ca.Function("slopes", [x, columns], [rate, ca.jtimes(rate, x, columns)])

    @cached_property
    def step(self) -> ca.Function:
        """(z, h) -> z after one Runge-Kutta step, z = (x, vec Y)."""
        size = 2 * self.links
        z, h = ca.MX.sym("z", size * (1 + BLOCK)), ca.MX.sym("h")
        stages: list[ca.MX] = []
        for row in DOP853.A:
            y = z + h * _combined(row, stages) if stages else z
            rate, slope = self.slopes(y[:size], ca.reshape(y[size:], size, BLOCK))
            stages.append(ca.vertcat(rate, ca.vec(slope)))
        return ca.Function("step", [z, h], [z + h * _combined(DOP853.B, stages)])

    def linearised(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Accelerations a(q, v) (n) and their slopes da/dq and da/dv (n x n each)."""
        n = self.links
        x, slopes, rate = np.concatenate([q, v]), np.zeros((2 * n, 2 * n)), None
        for part in _blocks(np.eye(2 * n)):
            rate, found = self.slopes(x, part[1])
            slopes[:, part[0]] = found.full()[:, : part[0].stop - part[0].start]
        assert rate is not None
        return rate.full().ravel()[n:], slopes[n:, :n], slopes[n:, n:]

    def path(self, q: np.ndarray, duration: float, least: int) -> np.ndarray:
        """States (k + 1 x 2n) at equal times from rest at q, at least 2 `least` steps, to round-off."""
        start = np.concatenate([q, np.zeros(q.size)])
        return refined_march(self.field, start, duration, least, np.zeros(0))

    def columns(self, q: np.ndarray, duration: float, steps: int, directions: np.ndarray) -> np.ndarray:
        """Phi(duration) times `directions` (2n x k) along the motion from rest at q, in `steps` steps.

        Raises `IntegrationError` when the result is not finite.
        """
        start, marched = np.concatenate([q, np.zeros(q.size)]), _fold(self.step, steps)
        found = np.zeros_like(directions, float)
        for place, part in _blocks(directions):
            z = marched(np.concatenate([start, part.ravel("F")]), duration / steps).full().ravel()
            found[:, place] = z[start.size :].reshape(part.shape, order="F")[:, : place.stop - place.start]
        if not np.all(np.isfinite(found)):
            raise IntegrationError("the variations are not finite", time=0.0, state=start)
        return found


@lru_cache(maxsize=8)
def _fold(step: ca.Function, steps: int) -> ca.Function:
    """The step taken `steps` times, keeping only the end."""
    return step.fold(steps)


def _combined(weights: np.ndarray, stages: list[ca.MX]) -> ca.MX:
    return sum(float(w) * k for w, k in zip(weights, stages, strict=False) if w != 0.0)


def _blocks(directions: np.ndarray) -> list[tuple[slice, np.ndarray]]:
    """(which columns, those columns filled up with zeros to BLOCK) of a matrix."""
    found = []
    for first in range(0, directions.shape[1], BLOCK):
        last = min(first + BLOCK, directions.shape[1])
        part = np.zeros((directions.shape[0], BLOCK))
        part[:, : last - first] = directions[:, first:last]
        found.append((slice(first, last), part))
    return found
