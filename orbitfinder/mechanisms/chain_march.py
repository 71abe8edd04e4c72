"""The motion of a long chain as a March: its states by the recursion, its variations in closed form.

The state is marched by CasADi on the O(n) accelerations of the Model, with the eighth-order coefficients of `rk8`.
Variations go by a few long steps of Gauss' method of high order, whose linear equations are solved in O(n) a column.
"""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.collocation import gauss
from orbitfinder.integrate.march import March, Varied, divided
from orbitfinder.integrate.rk8 import AGREEMENT, one_step, refined
from orbitfinder.mechanics.model import Model, field_apart, vector_field
from orbitfinder.mechanisms.chain_lagrange import ChainLagrange, chain_lagrange
from orbitfinder.mechanisms.chain_rows import gauss_step

CHUNK = 8
"""Steps in one call, and numbers of steps are multiples of it: few, so that its memory stays in the cache"""
STAGES, VARIED_PHASE, LAST = 3 * CHUNK - 1, 16.0, 1e-5
"""Of a step of variations: stages, radians that the fastest linear mode turns in it at most, and what share of
accelerations its last polynomial may be: its end is known to the square of that"""
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
            duration = tail[0] * (mesh[(k + 1) * each] - mesh[k * each])
            transitions[k][:, self.kept] = self.variations(node, duration, np.eye(size)[:, self.kept])
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

        return refined(lambda times: self.states(state[None], divided(mesh, times), tail)[::times], 1, settled)

    def variations(self, state: np.ndarray, duration: float, directions: np.ndarray) -> np.ndarray:
        """The state-transition matrix times `directions` (2n x k) from `state` (2n), over a duration (s).

        Raises `IntegrationError` when the result is not finite.
        """
        turned = float(np.sqrt(np.abs(self.closed.squared).max())) * abs(duration)
        lengths = np.diff(np.concatenate([[0.0], gauss(STAGES)[0], [1.0]]))
        columns, left = directions, max(1, int(np.ceil(turned / VARIED_PHASE)))
        h = duration / left
        while left:
            path = self._path(state, h * lengths)
            with np.errstate(over="ignore", invalid="ignore"):
                carried, share = gauss_step(self.closed, path[:-1], h, columns)
            if not np.all(np.isfinite(carried)):
                raise IntegrationError("the variations are not finite", time=0.0, state=np.asarray(state))
            if share > LAST:
                h, left = h / 2, 2 * left
            else:
                state, columns, left = path[-1], carried, left - 1
        return columns

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
            columns = np.tile(direction[:, None], self.closed.width)
            both = np.concatenate([state, columns.ravel()])
            rate, *varied = np.split(self.closed.varied_rates.many(np.zeros(1), both[None])[0], [state.size])
            rates = np.array([rate, varied[0].reshape(columns.shape)[:, 0]])
            apart = max(apart, float((np.abs(rates - wanted).max(1) / np.abs(wanted).max(1)).max()))
        return apart
