"""Fixed-step eighth-order marches over all shooting segments in one call, of states or of states and derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.buffered import Buffered
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.cvodes import Flow
from orbitfinder.integrate.rk8 import block, variational_field
from orbitfinder.loops.condensed import Linearised
from orbitfinder.loops.newton import tail_of
from orbitfinder.loops.problem import Guess, Problem


@dataclass(frozen=True)
class Path:
    """Nodes (N x 2n) and tail (period, unfolding, freed parameters)."""

    nodes: np.ndarray
    tail: np.ndarray

    def moved(self, step: tuple[np.ndarray, np.ndarray], factor: float = 1.0) -> Path:
        """The path after a (shortened) step."""
        return Path(self.nodes + factor * step[0], self.tail + factor * step[1])


def segments_needed(problem: Problem, flow: Flow, steps: int, largest: float, most: int) -> int:
    """Segments that keep every state-transition matrix of the guess below `largest`; rates scaled by the period."""
    varied, known = variational_field(flow.field), tail_of(flow)
    period, state = problem.guess.period, np.asarray(problem.guess.state, float)
    size = state.size
    start = np.concatenate([[0.0], state, np.eye(size, size + known.size).ravel("F")])
    found = block(varied, steps, 1)(start, np.concatenate([[period * problem.boundary.fraction / steps], known]))
    matrix = found.full().ravel()[1 + size : 1 + size + size**2].reshape(size, size, order="F")
    if not np.all(np.isfinite(matrix)):
        return most
    clock = np.concatenate([np.ones(size // 2), np.full(size // 2, period / (2 * np.pi))])
    growth = max(float(np.linalg.norm(matrix * clock[:, None] / clock[None, :], 2)), 2.0)
    return min(int(np.ceil(np.log(growth) / np.log(largest))), most)


class Marches:
    """The marches of one Problem with N segments, `steps` steps in a block; compiled where possible."""

    def __init__(self, problem: Problem, flow: Flow, segments: int, steps: int) -> None:
        self.problem, self.flow, self.segments, self.steps = problem, flow, segments, steps
        self.states, self.derivatives, self.growth = 0, 0, 1.0
        self._known, self._share = tail_of(flow), problem.boundary.fraction / segments
        self._march = Buffered(compiled(block(flow.field, steps, segments)))
        self._vary = Buffered(compiled(block(variational_field(flow.field), steps, segments)))
        self._single = Buffered(block(flow.field, steps, 1))
        self._rates = Buffered(flow.field.map(segments))

    def start(self, guess: Guess) -> Path:
        """The path of a guess: sampled from its trajectory, else simulated from its state."""
        state, span = np.asarray(guess.state, float), guess.period * self._share
        tail = np.concatenate([[guess.period], self._known])
        if guess.times is not None and guess.states is not None:
            moments = span * np.arange(self.segments)
            return Path(np.stack([np.interp(moments, guess.times, row) for row in guess.states.T], axis=1), tail)
        p, nodes = np.concatenate([[span / self.steps], self._known]), [state]
        for k in range(1, self.segments):
            nodes.append(self._single(np.concatenate([[(k - 1) * span], nodes[-1]]), p)[0].ravel()[1:])
        return Path(np.asarray(nodes), tail)

    def ends(self, path: Path, blocks: int) -> np.ndarray:
        """End states (N x 2n) by so many blocks of steps. Raises `IntegrationError` where one is not finite."""
        z, p = np.column_stack([self._clock(path), path.nodes]), self._parameters(path, self.steps * blocks)
        self.states += 1
        for _ in range(blocks):
            (z,) = self._march(z, p)
        return _finite(z[:, 1:], path)

    def linearised(self, path: Path, blocks: int = 1) -> tuple[np.ndarray, Linearised]:
        """End states (N x 2n) and their derivatives by so many blocks; the closing rows are still missing."""
        count, size = path.nodes.shape
        extra, named = path.tail.size - 1, len(self.flow.unfolded)
        z = np.zeros((count, 1 + size * (1 + size + extra)))
        z[:, 0], z[:, 1 : 1 + size] = self._clock(path), path.nodes
        z[:, 1 + size :] = np.eye(size, size + extra).ravel("F")
        p = self._parameters(path, self.steps * blocks)
        for _ in range(blocks):
            (z,) = self._vary(z, p)
        found = _finite(z, path)
        self.derivatives += 1
        ends = found[:, 1 : 1 + size]
        matrices = found[:, 1 + size :].reshape(count, size + extra, size).transpose(0, 2, 1)
        s, free = path.tail[1 : 1 + named], path.tail[1 + named :]
        (late,) = self._rates(found[:, :1], ends, s, free)
        slopes = late * self._share  # by the period: the segment gets longer ...
        if self.problem.model.forced:  # ... and begins later
            (early,) = self._rates(self._clock(path)[:, None], path.nodes, s, free)
            delayed = late - np.einsum("kij,kj->ki", matrices[:, :, :size], early)
            slopes = slopes + delayed * (self._share * np.arange(count))[:, None]
        self.growth = max(1.0, float(np.abs(matrices[:, :, :size]).max()))
        columns = np.concatenate([slopes[:, :, None], matrices[:, :, size:]], axis=2)
        none = np.zeros((0, size))
        return ends, Linearised(matrices[:, :, :size], columns, none, none, none)

    def standstill(self, path: Path) -> float:
        """Largest component of T f at the nodes: 0 at an equilibrium."""
        tail, named = path.tail[1:], len(self.flow.unfolded)
        (rates,) = self._rates(self._clock(path)[:, None], path.nodes, tail[:named], tail[named:])
        return float(np.abs(rates).max() * path.tail[0])

    def _clock(self, path: Path) -> np.ndarray:
        return np.asarray(path.tail[0] * self._share * np.arange(self.segments))

    def _parameters(self, path: Path, steps: int) -> np.ndarray:
        """h, unfolding and freed parameters, the same for each segment."""
        return np.concatenate([[path.tail[0] * self._share / steps], path.tail[1:]])


def _finite(numbers: np.ndarray, path: Path) -> np.ndarray:
    if np.all(np.isfinite(numbers)):
        return numbers
    segment = int(np.argmin(np.all(np.isfinite(numbers), axis=1)))
    raise IntegrationError("the state is not finite", segment=segment, state=path.nodes[segment])
