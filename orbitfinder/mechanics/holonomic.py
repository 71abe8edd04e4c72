"""Hamilton's equations of a constrained system in as few coordinates as it offers: the certificate's formulation.

The finder works on the balances of a Model under constraints, Baumgarte terms included; here everything is
derived from its energies and its constraints alone, without stabilisation:

    q' = M^-1 p,    p' = d(T - V)/dq + J^T lambda,    J q' = 0,

a chain or linkage in its link angles (an open chain has no constraint left, a linkage the two of its
last pivot), any other system in its own coordinates. Source: E. Hairer, C. Lubich, G. Wanner,
Geometric Numerical Integration, section VII.1.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from orbitfinder.mechanics.factorise import solve_positive_definite
from orbitfinder.mechanics.lagrange import mass_matrix_and_bias
from orbitfinder.mechanics.model import Model, constraint_of


@dataclass(frozen=True)
class Holonomic:
    """Energies and constraints in k coordinates q, the parameters' values put in.

    `kinetic(q, v)`, `potential(q)`, `constraint(q)` = phi (m); `lift(q, v)` is the state (2n) in the
    model's own coordinates and `chosen` (2k) picks (q, v) out of such a state.
    """

    kinetic: ca.Function
    potential: ca.Function
    constraint: ca.Function
    lift: ca.Function
    chosen: np.ndarray

    @property
    def size(self) -> int:
        """k, the number of coordinates."""
        return int(self.chosen.size // 2)


@dataclass(frozen=True)
class HolonomicEquations:
    """Constrained Hamilton's equations in y = (q, p), 2k numbers.

    `field(t, y)` is y'; `variational(t, z)` is z' for z = (y, vec Y, S), Y' = (dy'/dy) Y and
    S' = p.q'; `momentum(q, v)` = M v; `velocity(y)` = M^-1 p; `tangent(y)` is the matrix (2m x 2k) of
    (d phi, d(J q')), whose null space is tangent to the motions; `energy(y)` = T + V.
    """

    field: ca.Function
    variational: ca.Function
    momentum: ca.Function
    velocity: ca.Function
    tangent: ca.Function
    energy: ca.Function


def holonomic(model: Model) -> Holonomic:
    """A Model under constraints described in its link angles where it has them, else in its own coordinates."""
    n, values, constraint = model.degrees_of_freedom, ca.DM(model.parameter_values), constraint_of(model)
    angular = constraint.lift is not None
    size = n // 3 if angular else n
    q, v = ca.SX.sym("q", size), ca.SX.sym("v", size)
    state = ca.vertcat(q, v) if constraint.lift is None else constraint.lift(q, v, values)
    place, rate = state[:n], state[n:]
    # the joints of an open chain hold identically in the angles; only the rows after them are left
    rows = constraint.phi(place, values)[2 * size if angular else 0 :]
    kept = np.arange(2, n, 3) if angular else np.arange(n)
    return Holonomic(
        kinetic=ca.Function("kinetic", [q, v], [model.kinetic(place, rate, values)]),
        potential=ca.Function("potential", [q], [model.potential(place, values)]),
        constraint=ca.Function("constraint", [q], [rows]),
        lift=ca.Function("lift", [q, v], [state]),
        chosen=np.concatenate([kept, kept + n]),
    )


def holonomic_equations(system: Holonomic) -> HolonomicEquations:
    """Field, variations and tangent space of a Holonomic system, by automatic differentiation.

    With M a + h = J^T lambda and J a + Jdot v = 0: lambda = (J M^-1 J^T)^-1 (J M^-1 h - Jdot v).
    """
    k = system.size
    q, p, v = ca.SX.sym("q", k), ca.SX.sym("p", k), ca.SX.sym("v", k)
    kinetic, potential, phi = system.kinetic(q, v), system.potential(q), system.constraint(q)
    mass, bias = mass_matrix_and_bias(kinetic, potential, q, v)
    jacobian = ca.jacobian(phi, q)
    force = ca.gradient(kinetic - potential, q)
    if phi.numel():
        weighted, free = solve_positive_definite(mass, jacobian.T), solve_positive_definite(mass, bias)
        right = jacobian @ free - ca.jtimes(jacobian @ v, q, v)
        force += jacobian.T @ solve_positive_definite(jacobian @ weighted, right)
    inner = ca.Function("inner", [q, v], [force])
    velocity = solve_positive_definite(mass, p)
    y = ca.vertcat(q, p)
    rate = ca.vertcat(velocity, inner(q, velocity))
    columns, action = ca.SX.sym("Y", 2 * k, 2 * k), ca.SX.sym("S")
    slopes = ca.jacobian(rate, y) @ columns
    t = ca.SX.sym("t")
    extended = ca.vertcat(y, ca.vec(columns), action)
    level = ca.vertcat(phi, jacobian @ velocity)
    return HolonomicEquations(
        field=ca.Function("field", [t, y], [rate]),
        variational=ca.Function("variational", [t, extended], [ca.vertcat(rate, ca.vec(slopes), ca.dot(p, velocity))]),
        momentum=ca.Function("momentum", [q, v], [mass @ v]),
        velocity=ca.Function("velocity", [y], [velocity]),
        tangent=ca.Function("tangent", [y], [ca.densify(ca.jacobian(level, y))]),
        energy=ca.Function("energy", [y], [system.kinetic(q, velocity) + potential]),
    )
