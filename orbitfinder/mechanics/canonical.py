"""Hamilton's equations of a Model in as few coordinates as it offers: the certificate's formulation.

The finder works on accelerations, under constraints on balances with Baumgarte terms; here everything is derived from
the energies and the constraints alone, without stabilisation:

    q' = v with p = dL/dv(q, v),    p' = dL/dq(q, v) + Q + J^T lambda,    J q' = 0,

a chain or linkage under constraints in its link angles (an open chain has no constraint left, a linkage the two of its
last pivot), any other system in its own coordinates. A first-order system is taken as it stands. Sources: Goldstein,
Classical Mechanics, section 8.1; E. Hairer, C. Lubich, G. Wanner, Geometric Numerical Integration, section VII.1.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.mechanics.factorise import UNROLLED_FACTORISATION_LIMIT, solve_positive_definite
from orbitfinder.mechanics.lagrange import mass_matrix_and_bias
from orbitfinder.mechanics.model import Model


@dataclass(frozen=True)
class Coordinates:
    """Energies and constraints in k coordinates q, the parameters' values put in.

    `kinetic(q, v)`, `potential(q)`, `constraint(q)` = phi (m); `chosen` (2k) picks (q, v) out of a state (2n) of the
    model, to which `lift(q, v)` leads back where it is another. Where parameters were left free, each is a function of
    their values (one column) besides, the last of its arguments; so are those of `Canonical`.
    """

    kinetic: ca.Function
    potential: ca.Function
    constraint: ca.Function
    chosen: np.ndarray
    lift: ca.Function | None = None

    @property
    def size(self) -> int:
        """k, the number of coordinates."""
        return int(self.kinetic.numel_in(0))


@dataclass(frozen=True)
class Canonical:
    """Canonical equations in y = (q, momentum), 2k numbers; of a first-order system in y = q, its whole state.

    `field(t, y)` is y'; `variational(t, z)` is z' for z = (y, vec Y, S) with Y' = (dy'/dy) Y
    and S' = momentum.v the rate of the action; `momentum(q, v)` is dL/dv, `lift(q, v)` the Jacobian (2k x 2k)
    of y in (q, v); `tangent(y)` is the matrix (2m x 2k) of (d phi, d(J q')), 0 along motions.
    """

    coordinates: Coordinates
    field: ca.Function
    variational: ca.Function
    momentum: ca.Function
    lift: ca.Function
    tangent: ca.Function


def coordinates(model: Model, free: tuple[str, ...] = ()) -> Coordinates:
    """A Model described in its link angles where it has them under constraints, else in its own coordinates."""
    n, constraint = model.degrees_of_freedom, model.constraint
    lift = None if constraint is None else constraint.lift
    size = n if lift is None else n // 3
    symbol = _symbol(model, size)
    q, v, (values, given) = symbol("q", size), symbol("v", size), _parameters(model, free, symbol)
    state = ca.vertcat(q, v) if lift is None else lift(q, v, values)
    place, rate = state[:n], state[n:]
    # the joints of an open chain hold identically in the angles; only the rows after them are left
    rows = type(q)(0, 1) if constraint is None else constraint.phi(place, values)[0 if lift is None else 2 * size :]
    kept = np.arange(n) if lift is None else np.arange(2, n, 3)
    return Coordinates(
        kinetic=ca.Function("kinetic", [q, v, *given], [model.kinetic(place, rate, values)]),
        potential=ca.Function("potential", [q, *given], [model.potential(place, values)]),
        constraint=ca.Function("constraint", [q, *given], [rows]),
        chosen=np.concatenate([kept, kept + n]),
        lift=None if lift is None else ca.Function("lift", [q, v, *given], [state]),
    )


def _parameters(model: Model, free: tuple[str, ...], symbol: Any) -> tuple[Any, list[Any]]:
    """The parameters with some left free, and what functions of those are given besides: one column, or nothing."""
    chosen = symbol("free", len(free))
    return (model.parameters(free, chosen), [chosen]) if free else (model.parameters(), [])


def _symbol(model: Model, size: int) -> Any:
    """Scalars where the mass matrix is factorised in the graph."""
    scalar = model.constraint is not None or size <= UNROLLED_FACTORISATION_LIMIT
    return ca.SX.sym if scalar else ca.MX.sym


def canonical(model: Model, free: tuple[str, ...] = ()) -> Canonical:
    """Hamilton's equations from L = T + G - V (G linear in v) through the Legendre transform.

    v = M(q)^-1 (momentum - dT/dv at v = 0), dH/dp = v, -dH/dq = dL/dq(q, v) at that v.
    """
    if model.rates is not None:
        return _first_order(model, free)
    system = coordinates(model, free)
    k, symbol = system.size, _symbol(model, system.size)
    values, given = _parameters(model, free, symbol)
    t, q, v, y = symbol("t"), symbol("q", k), symbol("v", k), symbol("y", 2 * k)
    kinetic, potential, phi = system.kinetic(q, v, *given), system.potential(q, *given), system.constraint(q, *given)
    if model.gyroscopic is not None:
        kinetic += model.gyroscopic(q, v, values)
    momentum = ca.gradient(kinetic, v)
    legendre = ca.Function("legendre", [q, v, *given], [momentum, ca.jacobian(momentum, v)])
    offset, matrix = legendre(y[:k], type(y)(ca.DM.zeros(k)), *given)
    if symbol is ca.SX.sym:
        velocity = solve_positive_definite(matrix, y[k:] - offset)
    else:
        velocity = ca.solve(matrix, y[k:] - offset, "ldl")
    pushed = None if model.forces is None else model.forces(t, q, v, values)
    slope = ca.gradient(kinetic - potential, q) + _reaction(kinetic, potential, phi, q, v, pushed)
    whole = slope if pushed is None else slope + pushed
    force = ca.Function("slope", [t, q, v, *given], [whole])(t, y[:k], velocity, *given)
    rate = ca.vertcat(velocity, force)
    lower = ca.horzcat(ca.jacobian(momentum, q), ca.jacobian(momentum, v))
    upper = ca.horzcat(type(y).eye(k), type(y)(k, k))
    level = ca.Function("level", [q, v, *given], [ca.vertcat(phi, ca.jtimes(phi, q, v))])(y[:k], velocity, *given)
    return Canonical(
        coordinates=system,
        field=ca.Function("canonical_field", [t, y, *given], [rate]),
        variational=_variational(t, y, rate, ca.dot(y[k:], rate[:k]), given),
        momentum=ca.Function("momentum", [q, v, *given], [momentum]),
        lift=ca.Function("lift", [q, v, *given], [ca.densify(ca.vertcat(upper, lower))]),
        tangent=ca.Function("tangent", [y, *given], [ca.densify(ca.jacobian(level, y))]),
    )


def _reaction(kinetic: Any, potential: Any, phi: Any, q: Any, v: Any, forces: Any = None) -> Any:
    """J^T lambda: with M a + h = J^T lambda and J a + Jdot v = 0, lambda = (J M^-1 J^T)^-1 (J M^-1 h - Jdot v)."""
    if not phi.numel():
        return 0.0
    mass, bias = mass_matrix_and_bias(kinetic, potential, q, v, forces)
    jacobian = ca.jacobian(phi, q)
    weighted, free = solve_positive_definite(mass, jacobian.T), solve_positive_definite(mass, bias)
    right = jacobian @ free - ca.jtimes(jacobian @ v, q, v)
    return jacobian.T @ solve_positive_definite(jacobian @ weighted, right)


def _first_order(model: Model, free: tuple[str, ...]) -> Canonical:
    """The rates of a first-order Model and nothing else: its state is where it is."""
    n, symbol = model.degrees_of_freedom, model.symbol
    t, x, v, (values, given) = symbol("t"), symbol("x", n), symbol("v", 0), _parameters(model, free, symbol)
    rate, nothing = model.rates(t, x, values), type(x)(0, 1)  # type: ignore[misc]
    system = Coordinates(
        ca.Function("kinetic", [x, v, *given], [type(x)(0)]),
        ca.Function("potential", [x, *given], [model.potential(x, values)]),
        ca.Function("constraint", [x, *given], [nothing]), np.arange(n),
    )  # fmt: skip
    return Canonical(
        coordinates=system,
        field=ca.Function("rates", [t, x, *given], [rate]),
        variational=_variational(t, x, rate, model.action_rate(t, x, values), given),
        momentum=ca.Function("momentum", [x, v, *given], [nothing]),
        lift=ca.Function("lift", [x, v, *given], [ca.densify(type(x).eye(n))]),
        tangent=ca.Function("tangent", [x, *given], [type(x)(0, n)]),
    )


def _variational(t: Any, y: Any, rate: Any, action: Any, given: list[Any]) -> ca.Function:
    """z' for z = (y, vec Y, S) from y'(t, y) and S'(t, y)."""
    size, scalar = y.numel(), isinstance(y, ca.SX)
    if size > 2 * UNROLLED_FACTORISATION_LIMIT:
        return _directional(t, y, rate, action, given)
    columns = type(y).sym("Y", size, size)
    # in scalars the Jacobian times Y has two thirds of the operations of one directional derivative a column
    slopes = ca.jacobian(rate, y) @ columns if scalar else ca.jtimes(rate, y, columns)
    variation = ca.vertcat(rate, ca.vec(slopes), action)
    if scalar:
        inputs = ca.vertcat(y, ca.vec(columns), ca.SX.sym("S"))
    else:  # MX functions take pure symbols only
        inputs = ca.MX.sym("z", size + size**2 + 1)
        inner = ca.Function("inner", [t, y, columns, *given], [variation])
        variation = inner(t, inputs[:size], ca.reshape(inputs[size:-1], size, size), *given)
    return ca.Function("canonical_variational", [t, inputs, *given], [variation])


def _directional(t: Any, y: Any, rate: Any, action: Any, given: list[Any]) -> ca.Function:
    """The same by a directional derivative for each column."""
    size, parts = y.numel(), ca.Function("parts", [t, y, *given], [rate, action])
    clock, *numbers = (ca.MX.sym("p", part.numel()) for part in (t, *given))
    z = ca.MX.sym("z", size + size**2 + 1)
    inputs = [clock, z[:size], *numbers]
    now, added = parts(*inputs)
    seeds = [ca.MX(1, size), ca.reshape(z[size:-1], size, size), *(ca.MX(part.numel(), size) for part in numbers)]
    forward = ca.Function("rate", [t, y, *given], [rate]).forward(1).map(size)
    moving = forward(*(ca.repmat(part, 1, size) for part in (*inputs, now)), *seeds)
    return ca.Function("canonical_variational", [clock, z, *numbers], [ca.vertcat(now, ca.vec(moving), added)])
