"""Many segments marched at once by a fixed-step eighth-order Runge-Kutta method, with their derivatives.

The state and its variational equations are one system,

    x' = f(x, s),    Y' = (df/dx) Y + [0 | df/ds],    Y(0) = [1 | 0],

stepped by the method of Dormand and Prince (Hairer, Norsett, Wanner, Solving Ordinary Differential
Equations I, section II.10; coefficients from SciPy's DOP853). One step is the only large graph; it
is what `compiled` turns into machine code, while numbers of steps and segments come in by folding
and mapping it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import DOP853

from orbitfinder.compiled import compiled
from orbitfinder.errors import IntegrationError
from orbitfinder.flow import vector_field
from orbitfinder.mechanics.model import Invariant, Model

AGREEMENT = 1e-12
"""Two step sizes must agree to this; the finer result is then some 2^8 times better than that."""
MOST_DOUBLINGS = 7
QUANTUM = 4
"""Numbers of steps are rounded up to a multiple of this, so that few different foldings are made."""


@dataclass(frozen=True)
class March:
    """One system: `plain(x, (h, s)) -> x`, `variational((x, vec Y), (h, s)) -> (x, vec Y)`, one step each;
    `rate(x, s) -> f`; `energy(x) -> (E, dE/dx)`."""

    size: int
    unfolded: int
    rate: ca.Function
    energy: ca.Function
    plain: ca.Function
    variational: ca.Function


def build_march(model: Model, unfolded: tuple[Invariant, ...] = ()) -> March:
    """The steps of an autonomous Model with unfolding parameters s."""
    field = vector_field(model, (), unfolded)
    symbol: Any = ca.SX.sym if field.is_a("SXFunction") else ca.MX.sym
    size, count = field.size1_in(1), len(unfolded)
    x, s = symbol("x", size), symbol("s", count)
    rate = field(0.0, x, s, symbol("free", 0))
    columns = symbol("Y", size, size + count)
    slopes = ca.jacobian(rate, x) @ columns + ca.horzcat(type(x)(size, size), ca.jacobian(rate, s))
    simple = ca.Function("rate", [x, s], [rate])
    paired = ca.Function("variational_rate", [x, columns, s], [rate, slopes])
    n, values = size // 2, model.parameters()
    total = model.kinetic(x[:n], x[n:], values) + model.potential(x[:n], values)
    energy = ca.Function("energy", [x], [total, ca.gradient(total, x)])
    return March(size, count, simple, energy, _plain_step(simple), _variational_step(paired))


def _plain_step(rate: ca.Function) -> ca.Function:
    z, p = ca.MX.sym("z", rate.size1_in(0)), ca.MX.sym("p", 1 + rate.size1_in(1))
    return compiled(ca.Function("step", [z, p], [_stepped(lambda y: rate(y, p[1:]), z, p[0])]))


def _variational_step(rate: ca.Function) -> ca.Function:
    size, width = rate.size1_in(0), rate.size2_in(1)
    z, p = ca.MX.sym("z", size * (1 + width)), ca.MX.sym("p", 1 + rate.size1_in(2))

    def whole(y: ca.MX) -> ca.MX:
        parts = rate(y[:size], ca.reshape(y[size:], size, width), p[1:])
        return ca.vertcat(parts[0], ca.vec(parts[1]))

    return compiled(ca.Function("variational_step", [z, p], [_stepped(whole, z, p[0])]))


def _stepped(rate: Any, z: ca.MX, h: ca.MX) -> ca.MX:
    stages: list[ca.MX] = []
    for row in DOP853.A:
        stages.append(rate(z + h * _combined(row, stages) if stages else z))
    return z + h * _combined(DOP853.B, stages)


def _combined(weights: np.ndarray, stages: list[ca.MX]) -> ca.MX:
    return sum((float(w) * k for w, k in zip(weights, stages, strict=False) if w != 0.0), ca.MX(0))


@lru_cache(maxsize=512)
def _folded(step: ca.Function, steps: int, segments: int, size: int) -> ca.Function:
    """Ends of `segments` columns after `steps` steps; the derivatives' initial values are put in here."""
    x, p = ca.MX.sym("x", size), ca.MX.sym("p", step.size1_in(1))
    width = step.size1_in(0) // size - 1
    z = ca.vertcat(x, ca.vec(ca.MX(ca.horzcat(ca.DM.eye(size), ca.DM.zeros(size, width - size))))) if width else x
    end = step.fold(steps)(z, ca.repmat(p, 1, steps)) if steps > 1 else step(z, p)
    one = ca.Function("segment", [x, p], [end])
    return one.map("segments", "serial", segments, [1], []) if segments > 1 else one


@lru_cache(maxsize=128)
def _path(step: ca.Function, steps: int) -> ca.Function:
    x, p = ca.MX.sym("x", step.size1_in(0)), ca.MX.sym("p", step.size1_in(1))
    return ca.Function("path", [x, p], [step.mapaccum(steps)(x, ca.repmat(p, 1, steps))])


def rounded(steps: float) -> int:
    """A number of steps of at least this many, a multiple of `QUANTUM`."""
    return max(1, int(np.ceil(steps / QUANTUM))) * QUANTUM


def states_along(one: March, state: np.ndarray, duration: float, steps: int, s: np.ndarray) -> np.ndarray:
    """States (steps + 1 x 2n) at equal times from `state`. Raises `IntegrationError` if one is not finite."""
    found = _path(one.plain, steps)(state, np.concatenate([[duration / steps], s])).full()
    return np.vstack([state, _finite(found.T, state)])


def ends(one: March, nodes: np.ndarray, duration: float, steps: int, s: np.ndarray) -> np.ndarray:
    """End states (N x 2n) of segments of equal duration from `nodes` (N x 2n)."""
    function = _folded(one.plain, steps, len(nodes), one.size)
    return _finite(function(nodes.T, np.concatenate([[duration / steps], s])).full().T, nodes[0])


def derivatives(
    one: March, nodes: np.ndarray, duration: float, steps: int, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """End states (N x 2n) and their derivatives [Phi | dx/ds] (N x 2n x (2n + k))."""
    function = _folded(one.variational, steps, len(nodes), one.size)
    found = _finite(function(nodes.T, np.concatenate([[duration / steps], s])).full().T, nodes[0])
    slopes = found[:, one.size :].reshape(len(nodes), one.size + one.unfolded, one.size)
    return found[:, : one.size], slopes.transpose(0, 2, 1)


def rates(one: March, states: np.ndarray, s: np.ndarray) -> np.ndarray:
    """f(x, s) at states (N x 2n)."""
    count = len(states)
    return np.asarray(one.rate.map(count)(states.T, np.tile(s[:, None], (1, count))).full().T)


def refined_ends(
    one: March, nodes: np.ndarray, duration: float, least: int, s: np.ndarray
) -> tuple[np.ndarray, int]:
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
