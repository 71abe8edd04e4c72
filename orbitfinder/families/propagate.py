"""The flow along a family: eighth-order Runge-Kutta on a mesh that moves with the orbit.

This is the one room of `families` that knows CasADi. State, variations and action are one system,

    x' = T f(x, s, p),    Y' = T (df/dx Y + [0 | df/ds | df/dp]),    S' = 2 T kinetic,

in time measured in periods, marched with the coefficients of Hairer, Norsett and Wanner (Solving
Ordinary Differential Equations I, section II.10, as tabulated in SciPy's DOP853) on a fixed mesh, so
that neighbouring orbits are integrated alike and a whole segment is one call without Python.
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
from orbitfinder.mechanics.model import Model
from orbitfinder.periodic.conditions import SYMMETRIES, Symmetry, boundary_rows, unfolded_invariants

EFFORT = 3.0
"""Seconds of interpreted marching in a family of moderate length, for `compiled`."""
FORMULATIONS = {**SYMMETRIES, "reversal": Symmetry("reversal", 0.5, False, True, False, True)}
"""The symmetries of a Problem, and odd motions, q(-t) = -q(t): reversal combined with reflection."""


@dataclass(frozen=True, eq=False)
class Propagator:
    """The equations of one family: which model, which symmetry, which freed parameters.

    `rate(z, p)` is dz/dtau of z = (x, vec Y, S) with p = (T, s, free); `step(z, (h, p))` one
    Runge-Kutta step and `move(x, (h, p))` one of the state alone; `trial_all` and `trial` the error
    estimates of such steps. `quantities(x, free)` gives (invariants, d/dx, d/dfree), `momenta(x, free)`
    the Jacobian of (q, momentum) in (q, v).
    """

    model: Model
    symmetry: Symmetry
    free: tuple[str, ...]
    unfolding: int
    rate: ca.Function
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
    boundary = FORMULATIONS[symmetry]
    unfolded = unfolded_invariants(model, boundary)
    field = vector_field(model, free, unfolded)
    rate = _rate(model, field, free)
    plain = ca.Function("plain", [x := ca.MX.sym("x", field.size1_in(1)), p := ca.MX.sym("p", rate.size1_in(1))],
                        [p[0] * field(0.0, x, p[1 : 1 + len(unfolded)], p[1 + len(unfolded) :])])  # fmt: skip
    step, move = (
        compiled(_step(name, one, error=False), effort=EFFORT) for name, one in (("step", rate), ("move", plain))
    )
    trial, trial_all = (
        compiled(_step(name, one, error=True), effort=EFFORT) for name, one in (("trial", plain), ("trial_all", rate))
    )
    quantities, momenta = _quantities(model, free)
    generators = tuple(one.generator for one in model.invariants if one.generator is not None)
    return Propagator(
        model, boundary, tuple(free), len(unfolded), rate, field, step, move, trial, trial_all, quantities, momenta,
        generators,
    )  # fmt: skip


def _rate(model: Model, field: ca.Function, free: tuple[str, ...]) -> ca.Function:
    symbol: Any = ca.SX.sym if field.is_a("SXFunction") else ca.MX.sym
    size, extra = field.size1_in(1), field.size1_in(2) + field.size1_in(3)
    x, columns = symbol("x", size), symbol("Y", size, size + extra)
    period, s, chosen = symbol("T"), symbol("s", field.size1_in(2)), symbol("free", len(free))
    motion = period * field(0.0, x, s, chosen)
    slopes = ca.jtimes(motion, x, columns)
    if extra:
        slopes += ca.horzcat(type(x)(size, size), ca.jacobian(motion, s), ca.jacobian(motion, chosen))
    n = size // 2
    kinetic = model.kinetic(x[:n], x[n:], model.parameters(free, chosen))
    action = 2.0 * period * kinetic
    if model.gyroscopic is not None:
        action += period * model.gyroscopic(x[:n], x[n:], model.parameters(free, chosen))
    packed = ca.vertcat(period, s, chosen)
    inner = ca.Function("inner", [x, columns, packed], [ca.vertcat(motion, ca.vec(slopes), action)])
    z, p = ca.MX.sym("z", size * (1 + size + extra) + 1), ca.MX.sym("p", packed.numel())
    whole = inner(z[:size], ca.reshape(z[size:-1], size, size + extra), p)
    return ca.Function("rate", [z, p], [whole])


def _step(name: str, rate: ca.Function, error: bool) -> ca.Function:
    """One step of the eighth-order formula, or the estimate of its error (SciPy's norm, per component)."""
    z, p = ca.MX.sym("z", rate.size1_in(0)), ca.MX.sym("p", 1 + rate.size1_in(1))
    h, rest = p[0], p[1:]
    stages = [rate(z, rest)]
    for row in DOP853.A[1:]:
        stages.append(rate(z + h * _combined(row, stages), rest))
    after = z + h * _combined(DOP853.B, stages)
    if not error:
        return ca.Function(name, [z, p], [after])
    stages.append(rate(after, rest))
    fifth, third = h * _combined(DOP853.E5, stages), h * _combined(DOP853.E3, stages)
    return ca.Function(name, [z, p], [fifth**2 / ca.sqrt(fifth**2 + 0.01 * third**2 + 1e-300)])


def _combined(weights: np.ndarray, stages: list[Any]) -> Any:
    return sum(float(w) * k for w, k in zip(weights, stages, strict=False) if w != 0.0)


def _quantities(model: Model, free: tuple[str, ...]) -> tuple[ca.Function, ca.Function]:
    n = model.degrees_of_freedom
    q, v, chosen = ca.MX.sym("q", n), ca.MX.sym("v", n), ca.MX.sym("free", len(free))
    parameters = model.parameters(free, chosen)
    values = [one.value(q, v, parameters) for one in model.invariants]
    values = values or [model.kinetic(q, v, parameters) + model.potential(q, parameters)]
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


@lru_cache(maxsize=64)
def _march(propagator: Propagator, steps: int, segments: int) -> ca.Function:
    return propagator.step.mapaccum("march", steps).map(segments)


@lru_cache(maxsize=64)
def _glide(propagator: Propagator, steps: int, segments: int) -> ca.Function:
    return propagator.move.mapaccum("glide", steps).map(segments)


@lru_cache(maxsize=64)
def _trials(propagator: Propagator, count: int) -> ca.Function:
    return propagator.trial.map(count)


@lru_cache(maxsize=64)
def _trials_all(propagator: Propagator, count: int) -> ca.Function:
    return propagator.trial_all.map(count)


@lru_cache(maxsize=64)
def _fields(propagator: Propagator, count: int) -> ca.Function:
    return propagator.field.map(count)


def rates(propagator: Propagator, states: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """dx/dt (k x 2n) at states (k x 2n); `tail` is (T, s, free)."""
    s, free = np.split(tail[1:], [propagator.unfolding])
    return np.asarray(_fields(propagator, len(states))(0.0, states.T, s, free).full().T)


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


def march(propagator: Propagator, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> March:
    """Integrate N segments from their nodes (N x 2n) over a mesh of M = N m steps in units of the period.

    `tail` is (T, s, free). Raises `IntegrationError` when something is not finite.
    """
    count, size = nodes.shape
    steps = (mesh.size - 1) // count
    columns = propagator.columns
    start = np.zeros((size * (1 + columns) + 1, count))
    start[:size] = nodes.T
    start[size : size + size * columns] = np.eye(size, columns).ravel("F")[:, None]
    packed = np.vstack([np.diff(mesh), np.tile(tail[:, None], (1, steps * count))])
    path = _march(propagator, steps, count)(start, packed).full().T
    if not np.all(np.isfinite(path)):
        raise IntegrationError("the state is not finite", segment=0, state=nodes[0])
    last = path[steps - 1 :: steps]
    sensitivities = last[:, size:-1].reshape(count, columns, size).transpose(0, 2, 1)
    states = np.vstack([nodes[:1], path[:, :size]])
    return March(states, last[:, :size], sensitivities, float(last[:, -1].sum()))


def glide(propagator: Propagator, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """The ends (N x 2n) of `march` without anything else, at a tenth of its cost or less."""
    count = len(nodes)
    steps = (mesh.size - 1) // count
    packed = np.vstack([np.diff(mesh), np.tile(tail[:, None], (1, steps * count))])
    return np.asarray(_glide(propagator, steps, count)(nodes.T, packed).full().T[steps - 1 :: steps])


def step_errors(propagator: Propagator, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """Estimated error of every step (M), relative to the size of the motion."""
    packed = np.vstack([np.diff(mesh), np.tile(tail[:, None], (1, mesh.size - 1))])
    errors = np.abs(_trials(propagator, mesh.size - 1)(states[:-1].T, packed).full())
    scale = np.maximum(np.abs(states).max(axis=0), np.abs(states).max(axis=0).max() * 1e-2)[:, None]
    return np.asarray((errors / scale).max(axis=0))


def variation_errors(
    propagator: Propagator, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Estimated error of every step's own state-transition matrix (M), in the units of the family's metric.

    A slow motion may carry fast variations, which its own error says nothing of.
    """
    size, count = propagator.size, mesh.size - 1
    start = np.zeros((size * (1 + propagator.columns) + 1, count))
    start[:size] = states[:-1].T
    start[size : size + size * size] = np.eye(size).ravel()[:, None]
    packed = np.vstack([np.diff(mesh), np.tile(tail[:, None], (1, count))])
    errors = _trials_all(propagator, count)(start, packed).full()[size : size + size * size]
    clock = np.sqrt(weights[:size])
    scale = (clock[None, :] / clock[:, None]).ravel()  # columns first: entry (i, j) stands at j size + i
    return np.asarray((np.abs(errors) * scale[:, None]).max(axis=0))


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
