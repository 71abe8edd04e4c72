"""What is derived from a Model once: Hamilton's equations, its accelerations, the gradients of its invariants.

All of it is remembered for the models seen last, and compiled for those of which many orbits are to be certified.
Equations of motion are derived for all values of the parameters, but of a model that is made anew at each (chains).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import wraps
from typing import Any, TypeVar

import casadi as ca
import numpy as np

from orbitfinder._runtime.caches import Kept, Same
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.field import Bound, expect
from orbitfinder.mechanics.canonical import Canonical, canonical, coordinates
from orbitfinder.mechanics.kind import system_kind
from orbitfinder.mechanics.model import Model, vector_field

KEPT = 16
"""Sets of equations that are remembered."""

_derived = Kept[Any](KEPT)
T = TypeVar("T")


def likeness(model: Model, free: tuple[str, ...] = ()) -> tuple[Any, ...]:
    """What a Model's equations follow from, but for the values of freed parameters, as a part of a key."""
    values = model.parameter_values.copy()
    values[[model.parameter_index(name) for name in free]] = np.nan  # given to the equations, which are those of all
    parts = (model.rates, model.acceleration, model.kinetic, model.potential, model.gyroscopic, model.forces,
             model.constraint, *(invariant.value for invariant in model.invariants))  # fmt: skip
    return (free, len(model.state_names), values.tobytes(), *map(Same, parts))


def _key(model: Model, derive: Callable[..., Any], free: tuple[str, ...] = ()) -> tuple[Any, ...]:
    return (derive, *likeness(model, free))


def _once(derive: Callable[[Model], T]) -> Callable[[Model], T]:
    """A function of a model that is remembered for those seen last."""

    @wraps(derive)
    def found(model: Model) -> T:
        return _derived(_key(model, found), lambda: derive(model))  # type: ignore[no-any-return]

    return found


def _parameters(model: Model) -> tuple[str, ...]:
    """The parameters whose values equations of motion are given and not derived with."""
    return () if system_kind(model.system).reread else tuple(model.parameter_names)


def _at_values(derive: Callable[[Model, tuple[str, ...]], ca.Function]) -> Callable[[Model], ca.Function | Bound]:
    """A function of a model, derived once for all values of its parameters, at those of the model."""

    @wraps(derive)
    def found(model: Model) -> ca.Function | Bound:
        names = _parameters(model)
        function = _derived(_key(model, found, names), lambda: derive(model, names))
        return Bound(function, model.parameter_values) if names else function

    return found


def hamilton(model: Model, free: tuple[str, ...] = ()) -> Canonical:
    """Hamilton's equations of a Model with its parameter values, some of them left free (see `Coordinates`)."""
    names = free or _parameters(model)
    derived: Canonical = _derived(_key(model, canonical, names), lambda: canonical(model, names))
    if free or not names:
        return derived
    return _derived(_key(model, _bound), lambda: _bound(derived, model.parameter_values))  # type: ignore[no-any-return]


def _bound(derived: Canonical, values: np.ndarray) -> Canonical:
    """Equations at these values of all parameters."""

    def bound(parts: Any) -> dict[str, Any]:
        known = {part.name: getattr(parts, part.name) for part in fields(parts)}
        return {name: Bound(one, values) for name, one in known.items() if isinstance(one, ca.Function)}

    return replace(derived, coordinates=replace(derived.coordinates, **bound(derived.coordinates)), **bound(derived))


def _plain(model: Model, free: tuple[str, ...]) -> tuple[list[ca.MX], ca.MX]:
    """t, x and the free parameters, where there are any, and f of them, nothing unfolded."""
    t, x, p = ca.MX.sym("t"), ca.MX.sym("x", len(model.state_names)), ca.MX.sym("p", len(free))
    return [t, x, *([p] if free else [])], vector_field(model, free, ())(t, x, ca.DM(0, 1), p)


@_at_values
def accelerations(model: Model, free: tuple[str, ...]) -> ca.Function:
    """The equations of motion x' = f(t, x) of a Model with its parameter values, nothing unfolded."""
    given, rate = _plain(model, free)
    return ca.Function("plain", given, [rate])


@_at_values
def acceleration_slopes(model: Model, free: tuple[str, ...]) -> ca.Function:
    """df/dx (d x d) of the equations of motion x' = f(t, x) of a Model with its parameter values."""
    given, rate = _plain(model, free)
    return ca.Function("slopes", given, [ca.densify(ca.jacobian(rate, given[1]))])


@_at_values
def with_variations(model: Model, free: tuple[str, ...]) -> ca.Function:
    """The field of (x, vec Y, S): the motion of a Model with its parameter values, its variations, its action."""
    flow, size = vector_field(model, free), len(model.state_names)
    t, y, p = ca.MX.sym("t"), ca.MX.sym("y", size * (1 + size) + 1), ca.MX.sym("p", len(free))
    x, matrix = y[:size], ca.reshape(y[size:-1], size, size)
    inputs = flow.mx_in()
    both = ca.Function("both", inputs, [flow(*inputs), ca.jacobian(flow(*inputs), inputs[1])])
    rate, slopes = both(t, x, [], p)
    action = model.action_rate(t, x, model.parameters(free, p))
    given = [t, y, *([p] if free else [])]
    return ca.Function("varied", given, [ca.vertcat(rate, ca.vec(slopes @ matrix), action)])


@_once
def invariant_gradients(model: Model) -> ca.Function:
    """The gradients (k x 2n) of a Model's invariants at a state x, with its parameter values."""
    n, p = model.degrees_of_freedom, ca.DM(model.parameter_values)
    x = ca.MX.sym("x", len(model.state_names))
    rows = [ca.gradient(invariant.value(x[:n], x[n:], p), x).T for invariant in model.invariants]
    return ca.Function("gradients", [x], [ca.densify(ca.vertcat(*rows)) if rows else ca.MX(0, x.numel())])


@_once
def conserved(model: Model) -> ca.Function:
    """x -> the values (k) of a Model's invariants and, one after another, their gradients, as one column (k + k d)."""
    n, p, gradients = model.degrees_of_freedom, ca.DM(model.parameter_values), invariant_gradients(model)
    x = ca.MX.sym("x", len(model.state_names))
    values = [invariant.value(x[:n], x[n:], p) for invariant in model.invariants]
    return ca.Function("conserved", [x], [ca.densify(ca.vertcat(*values, ca.vec(gradients(x).T)))])


@_once
def at_rest(model: Model) -> ca.Function:
    """(q, u) -> M u, K u and dV/dq of a Model at rest: column by column, Hessians of 2000 links take minutes."""
    n, values = model.degrees_of_freedom, ca.DM(model.parameter_values)
    q, v = ca.MX.sym("q", n), ca.MX.sym("v", n)
    slope = ca.gradient(model.potential(q, values), q)
    momentum = ca.gradient(model.kinetic(q, v, values), v)  # linear in the rates
    return ca.Function("at_rest", [q, v], [momentum, ca.jtimes(slope, q, v), slope])


def driven_rest(model: Model, times: np.ndarray) -> tuple[np.ndarray, Any]:
    """Of x' = f(t, x) with the Model's parameter values, f(t, 0) (s x d) at times (s), and df/dx(0, 0), sparse."""
    symbol, rest = model.symbol, np.zeros(len(model.state_names))
    t, x, field = symbol("t"), symbol("x", rest.size), vector_field(model)
    rate = field(t, x, [], [])
    slopes = ca.Function("slopes", [t, x], [ca.jacobian(rate, x)])(0.0, rest)
    return np.array([field(at, rest, [], []).full().ravel() for at in times]), slopes.sparse()


@_once
def under_constraints(model: Model) -> Rest:
    """What the equilibria and small motions of a Model under constraints are found from."""
    system = coordinates(model)
    q, v = ca.SX.sym("q", system.size), ca.SX.sym("v", system.size)
    potential, phi = system.potential(q), system.constraint(q)
    mu = ca.SX.sym("mu", phi.numel())
    first = ca.Function("first", [q], [ca.gradient(potential, q), ca.jacobian(phi, q), phi])
    second = ca.Function("second", [q, mu], [ca.hessian(potential + ca.dot(mu, phi), q)[0]])
    mass = ca.Function("mass", [q], [ca.hessian(system.kinetic(q, v), v)[0]])
    return Rest(system.size, first, second, mass, system.potential)


def linearised(model: Model) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(q, v) -> the accelerations (n) of an autonomous Model and their slopes in q and in v (n x n each)."""
    n = model.degrees_of_freedom
    symbol = model.symbol
    q, v = symbol("q", n), symbol("v", n)
    a = model.acceleration(0.0, q, v, ca.DM(model.parameter_values))
    slopes = [ca.densify(ca.jacobian(a, q)), ca.densify(ca.jacobian(a, v))]
    function = Buffered(ca.Function("accelerations", [q, v], [a, *slopes]))

    def call(place: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        value, by_place, by_rate = function(place[None], rate[None])
        return value[0], by_place.T, by_rate.T

    return call


def with_action(model: Model, field: ca.Function) -> ca.Function:
    """A field f(t, x, s, free) with the action as a last state: (x, S)' = (f, 2 T + G)."""
    p = ca.DM(model.parameter_values)
    t, z, s, free = inputs = [ca.MX.sym("y", field.size1_in(k) + int(k == 1)) for k in range(4)]
    rate = model.action_rate(t, z[:-1], p)
    return ca.Function("action_field", inputs, [ca.vertcat(field(t, z[:-1], s, free), rate)])


@_once
def action_rate(model: Model) -> ca.Function:
    """What the action is the integral of (see `Model.action_rate`), as a function of (t, x, p)."""
    symbol = model.symbol
    inputs = [symbol("t"), symbol("x", len(model.state_names)), symbol("p", len(model.parameter_names))]
    return ca.Function("action_rate", inputs, [model.action_rate(*inputs)])


def prepare(model: Model, effort: float | None = None, free: tuple[str, ...] = ()) -> None:
    """Have the equations of a Model compiled: many of its orbits are to be certified, in `effort` (s) or more."""
    if system_kind(model.system).motion(model):  # certified by equations of its own
        return expect(accelerations(model), effort).begin()
    equations = hamilton(model, free)
    expect(equations.field, effort)
    if not free:  # with parameters left free only closures are looked at
        expect(equations.variational, effort)
        expect(accelerations(model), effort)


@dataclass(frozen=True, eq=False)
class Rest:
    """`first(q)` = (dV/dq, J, phi), `second(q, mu)` = d2(V + mu.phi)/dq2, `mass(q)` and `potential(q)` in k angles."""

    size: int
    first: ca.Function
    second: ca.Function
    mass: ca.Function
    potential: ca.Function
