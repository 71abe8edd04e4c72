"""A quarter of a symmetric motion of a long chain: its states by the recursion, its variations in closed form.

The state is marched by CasADi on the O(n) accelerations of the Model. The variations of all columns are a
product of dense matrices at each stage, which in the closed form costs a third of what n directional
derivatives of the recursion cost when compiled, and a twelfth of what they cost interpreted (100 links: 0.3,
1.0 and 3.8 ms). Both march with the eighth-order coefficients of `rk8`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.rk8 import AGREEMENT, folded, one_step, refined
from orbitfinder.mechanics.chain_lagrange import ChainLagrange, chain_lagrange
from orbitfinder.mechanics.model import Model, vector_field

CHUNK = 8
"""Steps in one call of the march: few, so that its memory stays in the cache"""
STALLED, ROUND_OFF = 4.0, 1e-10
"""Below ROUND_OFF halving the steps of an eighth-order march no longer helps where it gains less than STALLED"""


@dataclass(frozen=True, eq=False)
class Quarter:
    """The autonomous equations of motion x' = f(x) of a chain: of its Model, and their closed form."""

    model: Model

    @cached_property
    def closed(self) -> ChainLagrange:
        """The closed form, from the Model's energies."""
        return chain_lagrange(self.model)

    @property
    def links(self) -> int:
        """n, the number of coordinates."""
        return self.model.degrees_of_freedom

    @cached_property
    def field(self) -> ca.Function:
        """f(t, x, s, free), as everywhere, without unfolding or freed parameters."""
        return vector_field(self.model, (), ())

    @cached_property
    def march(self) -> ca.Function:
        """((t, x), h) -> (t, x) after CHUNK Runge-Kutta steps."""
        return folded(one_step(self.field, ca.MX.sym), CHUNK, 1)

    def path(self, state: np.ndarray, duration: float, count: int, inner: int = 1) -> np.ndarray:
        """States (count + 1 x 2n) at equal times from `state` (2n), CHUNK `inner` steps between two of them."""
        states, h = [np.asarray(state, float)], duration / (count * CHUNK * inner)
        for _ in range(count):
            z = ca.DM(np.append(0.0, states[-1]))
            for _ in range(inner):
                limit.check()
                z = self.march(z, h)
            states.append(z.full().ravel()[1:])
        found = np.asarray(states)
        if not np.all(np.isfinite(found)):
            raise IntegrationError("the state is not finite", time=0.0, state=found[0])
        return found

    def refined(self, state: np.ndarray, duration: float, count: int, inner: int = 1) -> np.ndarray:
        """`path` with steps halved until half the steps confirm the end, as in `refined_march`.

        Or until halving no longer helps: at 100 links the rates' round-off is about `AGREEMENT` itself.
        """
        changes = [np.inf]

        def settled(coarse: np.ndarray, fine: np.ndarray) -> bool:
            scale = max(1.0, float(np.abs(fine[-1]).max()))
            changes.append(float(np.abs(fine[-1] - coarse[-1]).max()) / scale)
            return changes[-1] <= AGREEMENT or changes[-2] / STALLED < changes[-1] < ROUND_OFF

        return refined(lambda steps: self.path(state, duration, count, steps), inner, settled)

    def columns(self, state: np.ndarray, duration: float, steps: int, directions: np.ndarray) -> np.ndarray:
        """Phi(duration) times `directions` (2n x k) from `state` (2n), in so many steps.

        Raises `IntegrationError` when the result is not finite.
        """
        z, h = np.concatenate([state, np.ravel(directions, "F")]), duration / steps
        slopes = np.empty((len(DOP853.A), z.size))
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(steps):
                slopes[0] = self.closed.variational(0.0, z)
                for k, row in enumerate(DOP853.A[1:], start=1):
                    slopes[k] = self.closed.variational(0.0, z + h * (row[:k] @ slopes[:k]))
                z = z + h * (DOP853.B @ slopes)
        if not np.all(np.isfinite(z)):
            raise IntegrationError("the variations are not finite", time=0.0, state=np.asarray(state))
        return z[state.size :].reshape(directions.shape, order="F")

    def disagreement(self, states: np.ndarray) -> float:
        """Largest relative difference at states (k x 2n) between closed form and recursion, its derivative taken by AD.

        Compared are f(x) and df/dx y along one random direction y at each state.
        """
        x, y = ca.SX.sym("x", 2 * self.links), ca.SX.sym("y", 2 * self.links)
        rate = self.field(0.0, x, ca.SX(0, 1), ca.SX(0, 1))
        function = ca.Function("slope", [x, y], [ca.vertcat(rate, ca.jtimes(rate, x, y))])
        random, apart = np.random.default_rng(0), 0.0
        for state in states:
            direction = random.normal(0.0, 1.0, state.size)
            wanted = function(state, direction).full().reshape(2, -1)
            found = self.closed.variational(0.0, np.concatenate([state, direction])).reshape(2, -1)
            apart = max(apart, float((np.abs(found - wanted).max(1) / np.abs(wanted).max(1)).max()))
        return apart
