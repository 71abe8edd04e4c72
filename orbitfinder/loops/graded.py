"""The flow along a family: eighth-order Runge-Kutta on a mesh that moves with the orbit.

This is the one room of `families` that knows CasADi. State, variations and action are one system,

    x' = f(x, s, p),    Y' = df/dx Y + [0 | df/ds | df/dp],    S' = 2 kinetic,

marched by `runge_kutta.step_of` on a mesh given in periods, so that neighbouring orbits are
integrated alike and a whole segment is one call without Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.lanes import STAGES, called, evaluated, marched
from orbitfinder.integrate.rk8 import step_of, variational_field
from orbitfinder.loops.conditions import SYMMETRIES, Symmetry, boundary_rows, unfolded_invariants
from orbitfinder.mechanics.model import Model, vector_field

EFFORT = 3.0
"""Seconds of interpreted marching in a family of moderate length, for `compiled`."""


@dataclass(frozen=True, eq=False)
class Propagator:
    """The equations of one family: which model, which symmetry, which freed parameters.

    `field(t, x, s, free)` is dx/dt; `step(z, p)` one Runge-Kutta step of z = (t, x, vec Y, S) with
    p = (h, s, free) and `move` one of (t, x) alone; `trial_all` and `trial` the error estimates of
    such steps. `quantities(x, free)` gives (invariants and energy, d/dx, d/dfree), `momenta(x, free)` the
    Jacobian of (q, momentum) in (q, v).
    """

    model: Model
    symmetry: Symmetry
    free: tuple[str, ...]
    unfolding: int
    field: ca.Function
    step: ca.Function
    move: ca.Function
    trial: ca.Function
    trial_all: ca.Function
    quantities: ca.Function
    momenta: ca.Function
    generators: tuple[ca.Function, ...]

    @property
    def size(self) -> int:
        """2n, the length of a state."""
        return len(self.model.state_names)

    @property
    def columns(self) -> int:
        """Columns of Y: the state's, the unfolding's, the freed parameters'."""
        return self.size + self.unfolding + len(self.free)


def build_propagator(model: Model, symmetry: str = "none", free: tuple[str, ...] = ()) -> Propagator:
    """Everything that depends on the equations alone; built once per family."""
    boundary = SYMMETRIES[symmetry]
    unfolded = unfolded_invariants(model, boundary)
    field = vector_field(model, free, unfolded)
    action = _action_rate(model, field, free)
    whole = variational_field(field, action)
    if not compiled(step_of(whole), effort=EFFORT).is_a("External"):
        whole = variational_field(field, action, products=True)
    step, move, trial_all, trial = (
        compiled(step_of(one, error), effort=EFFORT) for error in (False, True) for one in (whole, field)
    )
    quantities, momenta = _quantities(model, free)
    generators = tuple(one.generator for one in model.invariants if one.generator is not None)
    return Propagator(
        model, boundary, tuple(free), len(unfolded), field, step, move, trial, trial_all, quantities, momenta,
        generators,
    )  # fmt: skip


def _action_rate(model: Model, field: ca.Function, free: tuple[str, ...]) -> ca.Function:
    """dS/dt = 2 kinetic + gyroscopic as a function of (t, x, s, free)."""
    inputs = field.sx_in() if field.is_a("SXFunction") else field.mx_in()
    n, x, parameters = model.degrees_of_freedom, inputs[1], model.parameters(free, inputs[3])
    action = 2.0 * model.kinetic(x[:n], x[n:], parameters)
    if model.gyroscopic is not None:
        action += model.gyroscopic(x[:n], x[n:], parameters)
    return ca.Function("action_rate", inputs, [action])


def _quantities(model: Model, free: tuple[str, ...]) -> tuple[ca.Function, ca.Function]:
    n = model.degrees_of_freedom
    q, v, chosen = ca.MX.sym("q", n), ca.MX.sym("v", n), ca.MX.sym("free", len(free))
    parameters = model.parameters(free, chosen)
    values = [one.value(q, v, parameters) for one in model.invariants]
    values.append(model.kinetic(q, v, parameters) + model.potential(q, parameters))
    stacked, parts = ca.vertcat(*values), [q, v, chosen]
    slopes = ca.Function("slopes", parts, [stacked, ca.horzcat(ca.jacobian(stacked, q), ca.jacobian(stacked, v)),
                                           ca.jacobian(stacked, chosen)])  # fmt: skip
    momentum = ca.gradient(model.kinetic(q, v, parameters), v)
    if model.gyroscopic is not None:
        momentum += ca.gradient(model.gyroscopic(q, v, parameters), v)
    lower = ca.horzcat(ca.jacobian(momentum, q), ca.jacobian(momentum, v))
    upper = ca.horzcat(ca.MX.eye(n), ca.MX(n, n))
    momenta = ca.Function("momenta_parts", parts, [ca.densify(ca.vertcat(upper, lower))])
    x = ca.MX.sym("x", 2 * n)
    whole = [x[:n], x[n:], chosen]
    quantities = ca.Function("quantities", [x, chosen], slopes.call(whole))
    return quantities, ca.Function("momenta", [x, chosen], momenta.call(whole))


def rates(propagator: Propagator, states: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """dx/dt (k x 2n) at states (k x 2n); `tail` is (T, s, free)."""
    rest = np.tile(tail[1:], (len(states), 1))
    s, free = np.split(rest, [propagator.unfolding], axis=1)
    return evaluated(propagator.field, 1, np.zeros((len(states), 1)), states, s, free)


def rate_at(propagator: Propagator, x: np.ndarray, unfolding: np.ndarray, free: np.ndarray) -> np.ndarray:
    """dx/dt (2n) at one state."""
    return called(propagator.field, 0.0, x, unfolding, free)[0].ravel()


def invariants_at(propagator: Propagator, x: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Invariants, last the energy (k + 1), at one state, their derivatives by the state and by freed parameters."""
    values, slopes, by_free = called(propagator.quantities, x, free)
    return values.ravel(), slopes, by_free


def momentum_slopes(propagator: Propagator, x: np.ndarray, free: np.ndarray) -> np.ndarray:
    """The Jacobian (2n x 2n) of (q, momentum) in (q, v) at one state."""
    return called(propagator.momenta, x, free)[0]


@dataclass(frozen=True)
class March:
    """What one integration of all segments gives.

    `states` (M + 1 x 2n) at the mesh, `ends` (N x 2n), `sensitivities` (N x 2n x columns) and the
    action over the horizon.
    """

    states: np.ndarray
    ends: np.ndarray
    sensitivities: np.ndarray
    action: float


def _parameters(mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """(h, s, free) of every step (M x 1 + ...), h in seconds."""
    packed = np.tile(tail, (mesh.size - 1, 1))
    packed[:, 0] *= np.diff(mesh)
    return packed


def march(propagator: Propagator, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> March:
    """Integrate N segments from their nodes (N x 2n) over a mesh of M = N m steps in units of the period.

    `tail` is (T, s, free). Raises `IntegrationError` when something is not finite.
    """
    count, size = nodes.shape
    steps = (mesh.size - 1) // count
    columns = propagator.columns
    start = np.zeros((count, propagator.step.size1_in(0)))
    start[:, 1 : 1 + size] = nodes
    start[:, 1 + size : -1] = np.eye(size, columns).ravel("F")
    path = marched(propagator.step, start, _parameters(mesh, tail))
    if not np.all(np.isfinite(path)):
        raise IntegrationError("the state is not finite", segment=0, state=nodes[0])
    last = path[steps - 1 :: steps]
    sensitivities = last[:, 1 + size : -1].reshape(count, columns, size).transpose(0, 2, 1)
    states = np.vstack([nodes[:1], path[:, 1 : 1 + size]])
    return March(states, last[:, 1 : 1 + size], sensitivities, float(last[:, -1].sum()))


def glide(propagator: Propagator, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """The ends (N x 2n) of `march` without anything else, at a fifth of its cost or less."""
    count = len(nodes)
    steps = (mesh.size - 1) // count
    start = np.column_stack([np.zeros(count), nodes])
    return marched(propagator.move, start, _parameters(mesh, tail))[steps - 1 :: steps, 1:]


def step_errors(
    propagator: Propagator, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray, asked: np.ndarray
) -> np.ndarray:
    """Estimated error of each step `asked` for, relative to the size of the motion."""
    start = np.column_stack([np.zeros(len(asked)), states[asked]])
    errors = np.abs(evaluated(propagator.trial, STAGES, start, _parameters(mesh, tail)[asked]))
    extent = np.abs(states).max(axis=0)
    return np.asarray((errors / np.maximum(extent, extent.max() * 1e-2)).max(axis=1))


def variation_errors(
    propagator: Propagator,
    states: np.ndarray,
    mesh: np.ndarray,
    tail: np.ndarray,
    weights: np.ndarray,
    asked: np.ndarray,
) -> np.ndarray:
    """Estimated error of the state-transition matrix of each step `asked` for, in the units of the family's metric.

    A slow motion may carry fast variations, which its own error says nothing of.
    """
    size = propagator.size
    start = np.zeros((len(asked), propagator.step.size1_in(0)))
    start[:, 1 : 1 + size] = states[asked]
    start[:, 1 + size : 1 + size + size * size] = np.eye(size).ravel()
    errors = evaluated(propagator.trial_all, STAGES, start, _parameters(mesh, tail)[asked])
    clock = np.sqrt(weights[:size])
    scale = (clock[None, :] / clock[:, None]).ravel()  # columns first: entry (i, j) stands at j size + i
    return np.asarray((np.abs(errors[:, size : size + size * size]) * scale).max(axis=1))


def boundary_matrices(propagator: Propagator) -> tuple[np.ndarray, np.ndarray]:
    """B0 and B1 (2n x 2n) of the boundary rows B0 x(0) + B1 x(end) - constant."""
    size = propagator.size
    if propagator.symmetry.name == "reversal":
        place = np.diag(np.repeat([1.0, 0.0], size // 2))
        return place, np.roll(place, size // 2, axis=0)
    zero, none = ca.DM.zeros(size), np.zeros(size // 2)

    def rows(start: Any, end: Any) -> np.ndarray:
        return np.asarray(ca.DM(boundary_rows(propagator.symmetry, start, end, none)).full().ravel())

    unit = [ca.DM(column) for column in np.eye(size)]
    first = np.stack([rows(one, zero) for one in unit], axis=1)
    return first, np.stack([rows(zero, one) for one in unit], axis=1)
