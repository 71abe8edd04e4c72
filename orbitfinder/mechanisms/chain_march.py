"""The motion of a long chain as a March: its states by the recursion, its variations in closed form.

The state is marched by CasADi on the O(n) accelerations of the Model. Variations march in the closed form's C, O(n) a
column; without a compiler they are a product of dense matrices at each stage, which costs a twelfth of what n
directional derivatives of the recursion cost interpreted. Both march with the eighth-order coefficients of `rk8`.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.march import March, Varied, divided
from orbitfinder.integrate.rk8 import AGREEMENT, one_step, refined
from orbitfinder.mechanics.model import Model, field_apart, vector_field
from orbitfinder.mechanisms.chain_lagrange import ChainLagrange, chain_lagrange

CHUNK = 8
"""Steps in one call, and numbers of steps are multiples of it: few, so that its memory stays in the cache"""
STALLED, ROUND_OFF = 4.0, 1e-10
"""Below ROUND_OFF halving the steps of an eighth-order march no longer helps where it gains less than STALLED"""


class ClosedChain(March):
    """The autonomous equations of motion x' = f(x) of a chain: of its Model, and their closed form.

    Nothing is differentiated by what is `held` (2n) at the start: those columns of transitions stay 0.
    """

    def __init__(self, model: Model, held: np.ndarray) -> None:
        super().__init__(vector_field(model), apart=field_apart(model))
        self.model, self.kept = model, np.flatnonzero(~held)

    @cached_property
    def closed(self) -> ChainLagrange:
        """The closed form, from the Model's energies."""
        return chain_lagrange(self.model)

    def _kernel(self, varied: bool, segments: int = 0) -> None:
        """None: states are marched in no time, variations by the closed form."""

    @cached_property
    def _chunk(self) -> ca.Function:
        """((t, x), CHUNK step lengths) -> (t, x) after each step."""
        return one_step(self.field, ca.MX.sym).mapaccum("chunk", CHUNK)

    def states(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (M + 1 x 2n) at the mesh."""
        each, steps = (mesh.size - 1) // len(nodes), tail[0] * np.diff(mesh)
        states = nodes[:1]
        for k, node in enumerate(nodes):
            states = np.vstack([states, self._path(node, steps[k * each : (k + 1) * each])])
        return states

    def ends(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (N x 2n) at the ends of the segments."""
        each = (mesh.size - 1) // len(nodes)
        return self.states(nodes, mesh, tail)[each::each]

    def varied(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, states: bool = False) -> Varied:
        """Ends and their derivatives; with `states` those at the mesh too. Raises `IntegrationError`."""
        (count, size), each = nodes.shape, (mesh.size - 1) // len(nodes)
        path, transitions = self.states(nodes, mesh, tail), np.zeros((count, size, size))
        for k, node in enumerate(nodes):
            steps = tail[0] * np.diff(mesh[k * each : (k + 1) * each + 1])
            transitions[k][:, self.kept] = self.variations(node, steps, np.eye(size)[:, self.kept])
        ends = path[each::each]
        by_period = self._by_period(nodes[None], ends[None], transitions[None], mesh[None, ::each], tail[None])[0]
        return Varied(ends, transitions, by_period[:, :, None], path if states else nodes, 0.0)

    def varied_each(self, nodes: np.ndarray, mesh: np.ndarray, tails: np.ndarray, states: bool = False) -> list[Varied]:
        """The same of several loops on one mesh, of nodes (B x N x 2n) and tails (B x 1), one after another."""
        return [self.varied(own, mesh, tail, states) for own, tail in zip(nodes, tails, strict=True)]

    def _path(self, state: np.ndarray, steps: np.ndarray) -> np.ndarray:
        """States (k x 2n) after each of k steps."""
        z, states = ca.DM(np.append(0.0, state)), []
        for lengths in steps.reshape(-1, CHUNK):
            limit.check()
            several = self._chunk(z, lengths[None])
            z = several[:, -1]
            states.append(several.full().T[:, 1:])
        path = np.vstack(states)
        if not np.all(np.isfinite(path)):
            raise IntegrationError("the state is not finite", time=0.0, state=np.asarray(state))
        return path

    def refined(self, state: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (M + 1 x 2n) at a mesh, its steps halved until half of them confirm the end.

        Or until halving no longer helps: at 100 links the rates' round-off is about `AGREEMENT` itself.
        """
        changes = [np.inf]

        def settled(coarse: np.ndarray, fine: np.ndarray) -> bool:
            scale = max(1.0, float(np.abs(fine[-1]).max()))
            changes.append(float(np.abs(fine[-1] - coarse[-1]).max()) / scale)
            return changes[-1] <= AGREEMENT or changes[-2] / STALLED < changes[-1] < ROUND_OFF

        def path(times: int) -> np.ndarray:
            return self.states(state[None], divided(mesh, times), tail)[::times]

        return refined(path, 1, settled)

    def variations(self, state: np.ndarray, steps: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """The state-transition matrix times `directions` (2n x k) from `state` (2n), over steps of these lengths (s).

        Raises `IntegrationError` when the result is not finite.
        """
        field, time = self.closed.varied_rates, np.zeros(1)

        def march(columns: np.ndarray) -> np.ndarray:
            z = np.concatenate([state, columns])
            with np.errstate(over="ignore", invalid="ignore"):
                for h in steps:
                    fast = field.stepped(time, z[None], np.array([h]))
                    z = self._step(z, h) if fast is None else fast[0]
            return z

        _, columns = self.closed.varied(directions, march)
        if not np.all(np.isfinite(columns)):
            raise IntegrationError("the variations are not finite", time=0.0, state=np.asarray(state))
        return columns

    def _step(self, z: np.ndarray, h: float) -> np.ndarray:
        """The state and its variations after a step, without a compiler."""
        slopes = np.empty((len(DOP853.A), z.size))
        for k, row in enumerate(DOP853.A):
            slopes[k] = self.closed.variational(0.0, z + h * (row[:k] @ slopes[:k]))
        return np.asarray(z + h * (DOP853.B @ slopes))

    def disagreement(self, states: np.ndarray) -> float:
        """Largest relative difference at states (k x 2n) between closed form and recursion, its derivative taken by AD.

        Compared are f(x) and df/dx y along one random direction y at each state.
        """
        x, y = ca.SX.sym("x", self.size), ca.SX.sym("y", self.size)
        rate = self.field(0.0, x, ca.SX(0, 1), ca.SX(0, 1))
        function = ca.Function("slope", [x, y], [ca.vertcat(rate, ca.jtimes(rate, x, y))])
        random, apart = np.random.default_rng(0), 0.0
        for state in states:
            direction = random.normal(0.0, 1.0, state.size)
            wanted = function(state, direction).full().reshape(2, -1)
            both = np.concatenate([state, np.tile(direction, self.closed.width)])
            rates = self.closed.varied_rates.many(np.zeros(1), both[None])[0, : 2 * state.size].reshape(2, -1)
            apart = max(apart, float((np.abs(rates - wanted).max(1) / np.abs(wanted).max(1)).max()))
        return apart
