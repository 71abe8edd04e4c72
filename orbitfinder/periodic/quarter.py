"""A quarter of a symmetric motion of a large system: states and variations on a fixed mesh.

The variational equations are integrated column block by column block, each column one directional
derivative of the O(n) accelerations, so that n columns cost O(n^2) operations a step and no graph
grows with more than n times the block. The march is the eighth-order one of `runge_kutta`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder.compiled import compiled, interpreted_seconds
from orbitfinder.errors import IntegrationError
from orbitfinder.flow import vector_field
from orbitfinder.mechanics.model import Model
from orbitfinder.runge_kutta import AGREEMENT, MOST_DOUBLINGS

BLOCK = 4
"""Columns that share one evaluation of the state. At 100 links a column takes 19 us interpreted and 5 us compiled;
with 20 columns 17.5 and 7 us, and compiling takes seven times as long"""
CHUNK = 8
"""Steps in one call of a compiled-once function: few, so that its memory stays in the cache"""


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
        function = ca.Function("slopes", [x, columns], [rate, ca.jtimes(rate, x, columns)])
        # 2n columns, 12 stages a step, about 15 n steps in a quarter period: what the multipliers take interpreted
        calls = 2 * self.links / BLOCK * 12 * 15 * self.links
        return compiled(function, effort=interpreted_seconds(function, calls))

    @cached_property
    def march(self) -> ca.Function:
        """(x, h) -> x after CHUNK Runge-Kutta steps."""
        return _step(lambda x: self.field(0.0, x, ca.MX(0, 1), ca.MX(0, 1)), 2 * self.links).fold(CHUNK)

    @cached_property
    def variations(self) -> ca.Function:
        """(z, h) -> z = (x, vec Y) after CHUNK Runge-Kutta steps."""
        size = 2 * self.links

        def rate(z: ca.MX) -> ca.MX:
            slopes = self.slopes(z[:size], ca.reshape(z[size:], size, BLOCK))
            return ca.vertcat(slopes[0], ca.vec(slopes[1]))

        return _step(rate, size * (1 + BLOCK)).fold(CHUNK)

    def linearised(self, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Accelerations a(q, v) (n) and their slopes da/dq and da/dv (n x n each)."""
        n = self.links
        x, slopes, rate = np.concatenate([q, v]), np.zeros((2 * n, 2 * n)), None
        for part in _blocks(np.eye(2 * n)):
            rate, found = self.slopes(x, part[1])
            slopes[:, part[0]] = found.full()[:, : part[0].stop - part[0].start]
        assert rate is not None
        return rate.full().ravel()[n:], slopes[n:, :n], slopes[n:, n:]

    def path(self, state: np.ndarray, duration: float, count: int, inner: int = 1) -> np.ndarray:
        """States (count + 1 x 2n) at equal times from `state` (2n), CHUNK `inner` steps between two of them."""
        states, h = [np.asarray(state, float)], duration / (count * CHUNK * inner)
        for _ in range(count):
            x: object = states[-1]
            for _ in range(inner):
                x = self.march(x, h)
            states.append(x.full().ravel())  # type: ignore[attr-defined]
        found = np.asarray(states)
        if not np.all(np.isfinite(found)):
            raise IntegrationError("the state is not finite", time=0.0, state=found[0])
        return found

    def refined(self, state: np.ndarray, duration: float, count: int, inner: int = 1) -> np.ndarray:
        """`path` with steps halved until half the steps confirm the end, as in `refined_march`."""
        coarse = self.path(state, duration, count, inner)
        for _ in range(MOST_DOUBLINGS):
            inner *= 2
            fine = self.path(state, duration, count, inner)
            if np.abs(fine[-1] - coarse[-1]).max() <= AGREEMENT * max(1.0, float(np.abs(fine[-1]).max())):
                break
            coarse = fine
        return fine

    def columns(self, state: np.ndarray, duration: float, chunks: int, directions: np.ndarray) -> np.ndarray:
        """Phi(duration) times `directions` (2n x k) from `state` (2n), in CHUNK `chunks` steps.

        Raises `IntegrationError` when the result is not finite.
        """
        found, size = np.zeros_like(directions, float), state.size
        for place, part in _blocks(directions):
            z: object = np.concatenate([state, part.ravel("F")])
            for _ in range(chunks):
                z = self.variations(z, duration / (CHUNK * chunks))
            end = z.full().ravel()[size:].reshape(part.shape, order="F")  # type: ignore[attr-defined]
            found[:, place] = end[:, : place.stop - place.start]
        if not np.all(np.isfinite(found)):
            raise IntegrationError("the variations are not finite", time=0.0, state=np.asarray(state))
        return found


def _step(rate: Callable[[ca.MX], ca.MX], size: int) -> ca.Function:
    """(z, h) -> z after one Runge-Kutta step of z' = rate(z)."""
    z, h = ca.MX.sym("z", size), ca.MX.sym("h")
    stages: list[ca.MX] = []
    for row in DOP853.A:
        stages.append(rate(z + h * _combined(row, stages) if stages else z))
    return ca.Function("step", [z, h], [z + h * _combined(DOP853.B, stages)])


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
