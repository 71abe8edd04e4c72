"""Hamilton's equations of a Model, derived from its energies alone: the certificate's formulation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca

from orbitfinder.mechanics.factorise import UNROLLED_FACTORISATION_LIMIT, solve_positive_definite
from orbitfinder.mechanics.model import Model


@dataclass(frozen=True)
class Canonical:
    """Canonical equations y' = (dH/dp, -dH/dq + Q) in y = (q, momentum), 2n numbers.

    `field(t, y)` is y'; `variational(t, z)` is z' for z = (y, vec Y, S) with Y' = (dy'/dy) Y
    and S' = momentum.v the rate of the action; `momentum(q, v)` is dL/dv.
    """

    field: ca.Function
    variational: ca.Function
    momentum: ca.Function


def canonical(model: Model) -> Canonical:
    """Hamilton's equations from L = T + G - V (G linear in v) through the Legendre transform.

    v = M(q)^-1 (momentum - dT/dv at v = 0), dH/dp = v, -dH/dq = dL/dq(q, v) at that v.
    Source: Goldstein, Classical Mechanics, section 8.1.
    """
    n = model.degrees_of_freedom
    symbol: Any = ca.SX.sym if n <= UNROLLED_FACTORISATION_LIMIT else ca.MX.sym
    t, q, v, y = symbol("t"), symbol("q", n), symbol("v", n), symbol("y", 2 * n)
    values = model.parameters()
    kinetic, potential = model.kinetic(q, v, values), model.potential(q, values)
    if model.gyroscopic is not None:
        kinetic += model.gyroscopic(q, v, values)
    momentum = ca.gradient(kinetic, v)
    legendre = ca.Function("legendre", [q, v], [momentum, ca.jacobian(momentum, v)])
    offset, matrix = legendre(y[:n], type(y)(ca.DM.zeros(n)))
    if n <= UNROLLED_FACTORISATION_LIMIT:
        velocity = solve_positive_definite(matrix, y[n:] - offset)
    else:
        velocity = ca.solve(matrix, y[n:] - offset, "ldl")
    slope = ca.Function("slope", [q, v], [ca.gradient(kinetic - potential, q)])
    force = slope(y[:n], velocity)
    if model.forces is not None:
        force += model.forces(t, y[:n], velocity, values)
    rate = ca.vertcat(velocity, force)
    columns = symbol("Y", 2 * n, 2 * n)
    extended = ca.vertcat(y, ca.vec(columns), symbol("S"))
    # in scalars the Jacobian times Y has two thirds of the operations of one directional derivative a column
    slopes = ca.jacobian(rate, y) @ columns if symbol is ca.SX.sym else ca.jtimes(rate, y, columns)
    variation = ca.vertcat(rate, ca.vec(slopes), ca.dot(y[n:], velocity))
    inputs = extended if symbol is ca.SX.sym else None
    if inputs is None:  # MX functions take pure symbols only
        whole = ca.MX.sym("z", 2 * n + 4 * n * n + 1)
        inner = ca.Function("inner", [t, y, columns], [variation])
        variation = inner(t, whole[: 2 * n], ca.reshape(whole[2 * n : -1], 2 * n, 2 * n))
        inputs = whole
    return Canonical(
        field=ca.Function("canonical_field", [t, y], [rate]),
        variational=ca.Function("canonical_variational", [t, inputs], [variation]),
        momentum=ca.Function("momentum", [q, v], [momentum]),
    )
