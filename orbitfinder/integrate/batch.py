"""Many segments marched at once with their derivatives, by any number of steps, out of one compiled step.

The step is the only large graph; numbers of steps and segments come in by folding and mapping it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.buffered import Buffered
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.rk8 import folded, step_of, variational_field
from orbitfinder.mechanics.model import Invariant, Model, vector_field

AGREEMENT = 1e-12
"""Two step sizes must agree to this; the finer result is then some 2^8 times better than that."""
MOST_DOUBLINGS = 7
QUANTUM = 4
"""Numbers of steps are rounded up to a multiple of this, so that few different foldings are made."""


@dataclass(frozen=True)
class March:
    """One system: `plain` and `variational` are single steps of (t, x) and (t, x, vec Y) with parameters (h, s),
    `field(t, x, s, free)` is dx/dt, `energy(x)` gives (E, dE/dx)."""

    size: int
    unfolded: int
    field: ca.Function
    energy: ca.Function
    plain: ca.Function
    variational: ca.Function


def build_march(model: Model, unfolded: tuple[Invariant, ...] = ()) -> March:
    """The steps of an autonomous Model with unfolding parameters s."""
    field = vector_field(model, (), unfolded)
    x = (ca.SX if field.is_a("SXFunction") else ca.MX).sym("x", field.size1_in(1))
    n, values = model.degrees_of_freedom, model.parameters()
    total = model.kinetic(x[:n], x[n:], values) + model.potential(x[:n], values)
    energy = ca.Function("energy", [x], [total, ca.gradient(total, x)])
    plain, variational = compiled(step_of(field)), compiled(step_of(variational_field(field)))
    return March(2 * n, len(unfolded), field, energy, plain, variational)


@lru_cache(maxsize=512)
def _folded(step: ca.Function, steps: int, segments: int) -> Buffered:
    return Buffered(folded(step, steps, segments))


@lru_cache(maxsize=128)
def _path(step: ca.Function, steps: int) -> Buffered:
    return Buffered(step.mapaccum(steps))


@lru_cache(maxsize=128)
def _rates(field: ca.Function, count: int) -> Buffered:
    return Buffered(field.map(count))


def rounded(steps: float) -> int:
    """A number of steps of at least this many, a multiple of `QUANTUM`."""
    return max(1, int(np.ceil(steps / QUANTUM))) * QUANTUM


def states_along(one: March, state: np.ndarray, duration: float, steps: int, s: np.ndarray) -> np.ndarray:
    """States (steps + 1 x 2n) at equal times from `state`. Raises `IntegrationError` if one is not finite."""
    start = np.concatenate([[0.0], state])
    found = _path(one.plain, steps)(start, np.concatenate([[duration / steps], s]))[0][:, 1:]
    return np.vstack([state, _finite(found, state)])


def ends(one: March, nodes: np.ndarray, duration: float, steps: int, s: np.ndarray) -> np.ndarray:
    """End states (N x 2n) of segments of equal duration from `nodes` (N x 2n)."""
    start = np.column_stack([np.zeros(len(nodes)), nodes])
    found = _folded(one.plain, steps, len(nodes))(start, np.concatenate([[duration / steps], s]))[0]
    return _finite(found[:, 1:], nodes[0])


def derivatives(
    one: March, nodes: np.ndarray, duration: float, steps: int, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """End states (N x 2n) and their derivatives [Phi | dx/ds] (N x 2n x (2n + k))."""
    count, columns = len(nodes), one.size + one.unfolded
    start = np.zeros((count, 1 + one.size * (1 + columns)))
    start[:, 1 : 1 + one.size] = nodes
    start[:, 1 + one.size :] = np.eye(one.size, columns).ravel("F")
    found = _folded(one.variational, steps, count)(start, np.concatenate([[duration / steps], s]))[0]
    found = _finite(found[:, 1:], nodes[0])
    slopes = found[:, one.size :].reshape(count, columns, one.size)
    return found[:, : one.size], slopes.transpose(0, 2, 1)


def rates(one: March, states: np.ndarray, s: np.ndarray) -> np.ndarray:
    """f(x, s) at states (N x 2n)."""
    return _rates(one.field, len(states))(0.0, states, s, 0.0)[0]


def refined_ends(one: March, nodes: np.ndarray, duration: float, least: int, s: np.ndarray) -> tuple[np.ndarray, int]:
    """End states (N x 2n) with 2 least, 4 least, ... steps, the first that half as many confirm; how many those are."""
    steps = least
    coarse = ends(one, nodes, duration, steps, s)
    for _ in range(MOST_DOUBLINGS):
        steps *= 2
        fine = ends(one, nodes, duration, steps, s)
        if np.abs(fine - coarse).max() <= AGREEMENT * max(1.0, float(np.abs(fine).max())):
            break
        coarse = fine
    return fine, steps


def _finite(found: np.ndarray, state: np.ndarray) -> np.ndarray:
    if not np.all(np.isfinite(found)):
        raise IntegrationError("the state is not finite", time=0.0, state=np.asarray(state))
    return np.asarray(found)
