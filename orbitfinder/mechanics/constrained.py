"""Mechanical systems in redundant coordinates with holonomic constraints, as index-1 DAEs.

    M(q) a + h(t, q, v) = J(q)^T lambda,      J a + Jdot v + 2 alpha J v + beta^2 phi = 0.

x = (q, v) are the differential states and z = (a, lambda) the algebraic ones. alpha = beta = 0
leaves the bare acceleration constraints, which drift; with both positive phi decays
(J. Baumgarte, "Stabilization of constraints and integrals of motion in dynamical systems",
Computer Methods in Applied Mechanics and Engineering 1 (1972) 1-16).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError
from orbitfinder.mechanics.factorise import LinearBalances, eliminated
from orbitfinder.mechanics.lagrange import (
    Symbols,
    coordinate_angles,
    coordinate_names,
    energy_invariant,
    mass_matrix_and_bias,
    polyline,
)
from orbitfinder.mechanics.model import Invariant, Model

RANK_TOLERANCE = 1e-8
"""smallest over largest singular value of J below which a configuration counts as singular"""
CONSISTENCY_TOLERANCE = 1e-6
"""largest |phi| and |J v| of a state that is accepted as lying on the constraints"""


@dataclass(frozen=True)
class Baumgarte:
    """Stabilisation phi'' + 2 alpha phi' + beta^2 phi = 0, both in 1/s; zero is off."""

    alpha: float = 0.0
    beta: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class ConstrainedModel:
    """Equations of a system of n redundant coordinates q under m constraints phi(q, p) = 0.

    `balances(t, q, v, a, lambda, p)` = M a + h - J^T lambda (n); `constraint(q, p)` = phi (m);
    `constraint_rate(q, v, p)` = J v; `constraint_acceleration(q, v, a, p)` = J a + Jdot v (m);
    `constraint_jacobian(q, p)` = J (m x n); `algebraic(t, q, v, p)` = (a, lambda) by elimination,
    Baumgarte terms included. Energies, `forces`, `points`, `centres`, names and the like are as in `Model`.
    `lift(angles, rates, p)` is the state (2n) of a chain or linkage from its link angles and rates.
    """

    __repr__ = brief("system", "constraints")

    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    force_names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    parameter_values: np.ndarray
    balances: ca.Function
    constraint: ca.Function
    constraint_rate: ca.Function
    constraint_acceleration: ca.Function
    constraint_jacobian: ca.Function
    algebraic: ca.Function
    kinetic: ca.Function
    potential: ca.Function
    baumgarte: Baumgarte
    forces: ca.Function | None = None
    invariants: tuple[Invariant, ...] = ()
    angles: tuple[bool, ...] = ()
    points: ca.Function | None = None
    centres: ca.Function | None = None
    lift: ca.Function | None = None
    forcing_period: ca.Function | None = None

    @property
    def coordinates(self) -> int:
        """n, the number of redundant coordinates."""
        return len(self.state_names) // 2

    @property
    def constraints(self) -> int:
        """m, the number of constraints and of constraint forces."""
        return len(self.force_names)

    def as_model(self) -> Model:
        """The same system as a Model; see `reduced`."""
        return reduced(self)

    def residual(self, t: Any, x: Any, z: Any, p: Any) -> Any:
        """The n + m algebraic equations of the DAE in z = (a, lambda), Baumgarte terms included."""
        n = self.coordinates
        q, v, a = x[:n], x[n:], z[:n]
        alpha, beta = self.baumgarte.alpha, self.baumgarte.beta
        rows = self.constraint_acceleration(q, v, a, p)
        rows += 2 * alpha * self.constraint_rate(q, v, p) + beta**2 * self.constraint(q, p)
        return ca.vertcat(self.balances(t, q, v, a, z[n:], p), rows)


@dataclass(frozen=True)
class ConstrainedEquations:
    """Expressions that a ConstrainedModel is built from, written in `symbols`, a and lambda.

    `balances` = M a + h - J^T lambda (n) and `constraint_acceleration` = J a + Jdot v (m).
    """

    symbols: Symbols
    acceleration: ca.SX
    multipliers: ca.SX
    balances: ca.SX
    constraint: ca.SX
    constraint_acceleration: ca.SX
    kinetic: ca.SX
    potential: ca.SX
    forces: ca.SX | None = None


def constrained(
    kinetic: ca.SX,
    potential: ca.SX,
    constraint: ca.SX,
    symbols: Symbols,
    *,
    forces: ca.SX | None = None,
    baumgarte: Baumgarte | None = None,
    names: Sequence[str] | None = None,
    angles: Sequence[bool] | None = None,
    invariants: Sequence[Invariant] | None = None,
    points: ca.SX | None = None,
    system: Mapping[str, Any] | None = None,
) -> ConstrainedModel:
    """Native DAE of a system given by energies and holonomic constraints phi(q, p) = 0 (SX, m).

    M a + h = J^T lambda with M = d2T/dv2, J = dphi/dq: Lagrange's equations of the first kind
    (Goldstein, Classical Mechanics, section 2.4). `forces` Q(t, q, v, p) (n) are added to the right.
    SI units. Raises `InputError` for expressions of a wrong shape or in foreign symbols, and when the
    constraints are none or as many as the coordinates. Only forces may depend on time.
    """
    q, v = symbols.coordinates, symbols.velocities
    count = ca.SX(constraint).numel()
    _check_expressions(kinetic, potential, constraint, forces, symbols)
    matrix, bias = mass_matrix_and_bias(kinetic, potential, q, v, forces)
    a, multipliers, jacobian = ca.SX.sym("a", q.numel()), ca.SX.sym("lambda", count), ca.jacobian(constraint, q)
    equations = ConstrainedEquations(
        symbols, a, multipliers, matrix @ a + bias - jacobian.T @ multipliers, ca.SX(constraint),
        jacobian @ a + ca.jtimes(jacobian @ v, q, v), kinetic, potential, forces,
    )  # fmt: skip
    p = _parameters(symbols)
    return constrained_model(
        equations,
        baumgarte or Baumgarte(),
        names=coordinate_names(names, q.numel()),
        angles=coordinate_angles(angles, q.numel()),
        invariants=invariants,
        points=polyline("points", points, [q, p]),
        system=dict(system or {"kind": "custom"}),
    )


def _check_expressions(
    kinetic: ca.SX, potential: ca.SX, constraint: ca.SX, forces: ca.SX | None, symbols: Symbols
) -> None:
    q, v, p = symbols.coordinates, symbols.velocities, _parameters(symbols)
    count, clock = ca.SX(constraint).numel(), [] if symbols.time is None else [symbols.time]
    if q.numel() != v.numel():
        raise InputError(f"velocities: {v.numel()} given for {q.numel()} coordinates; give one per coordinate")
    if not 0 < count < q.numel():
        raise InputError(
            f"constraint: {count} equations for {q.numel()} coordinates leave no motion to compute; "
            "give at least one and fewer than the coordinates (lagrange() is for none)"
        )
    for name, value, size, known in (
        ("kinetic", kinetic, 1, [q, v, p]),
        ("potential", potential, 1, [q, p]),
        ("constraint", constraint, count, [q, p]),
        ("forces", forces, q.numel(), [q, v, p, *clock]),
    ):
        expression = ca.SX(size, 1) if value is None else ca.SX(value)
        if expression.shape != (size, 1):
            raise InputError(f"{name}: expected {size} x 1 expressions, got shape {expression.shape}")
        stray = [str(one) for one in ca.symvar(expression) if not ca.depends_on(ca.vertcat(*known), one)]
        if stray:
            raise InputError(f"{name}: depends on {', '.join(stray)}; use only the symbols passed (time: forces only)")
    at_rest = ca.substitute(ca.vertcat(kinetic, ca.gradient(kinetic, v)), v, ca.SX.zeros(v.numel()))
    if ca.depends_on(ca.hessian(ca.SX(kinetic), v)[0], v) or not ca.simplify(at_rest).is_zero():
        raise InputError("kinetic: not a quadratic form in the velocities; write T = 1/2 v.M(q) v")


def _parameters(symbols: Symbols) -> ca.SX:
    return symbols.parameters if symbols.parameters is not None else ca.SX(0, 1)


def constrained_model(
    equations: ConstrainedEquations,
    baumgarte: Baumgarte,
    *,
    names: Sequence[str],
    force_names: Sequence[str] | None = None,
    invariants: Sequence[Invariant] | None = None,
    **fields: Any,
) -> ConstrainedModel:
    """A ConstrainedModel around expressions; `fields` are passed on to it as they are."""
    symbols, a, force = equations.symbols, equations.acceleration, equations.multipliers
    q, v, p = symbols.coordinates, symbols.velocities, _parameters(symbols)
    t = symbols.time if symbols.time is not None else ca.SX.sym("t")
    jacobian = ca.jacobian(equations.constraint, q)
    if invariants is None:
        conservative = equations.forces is None and symbols.time is None
        invariants = [energy_invariant(equations.kinetic, equations.potential, q, v, p)] if conservative else []
    values, clock = np.asarray(symbols.parameter_values, float), symbols.forcing_period
    return ConstrainedModel(
        state_names=(*names, *(f"{name}dot" for name in names)),
        force_names=tuple(force_names or (f"lambda{k + 1}" for k in range(force.numel()))),
        parameter_names=tuple(symbols.parameter_names),
        parameter_values=values,
        balances=ca.Function("balances", [t, q, v, a, force, p], [equations.balances]),
        constraint=ca.Function("constraint", [q, p], [equations.constraint]),
        constraint_rate=ca.Function("constraint_rate", [q, v, p], [jacobian @ v]),
        constraint_acceleration=ca.Function(
            "constraint_acceleration", [q, v, a, p], [equations.constraint_acceleration]
        ),
        constraint_jacobian=ca.Function("constraint_jacobian", [q, p], [jacobian]),
        algebraic=_eliminate(equations, baumgarte, [t, q, v, p], values),
        kinetic=ca.Function("kinetic", [q, v, p], [equations.kinetic]),
        potential=ca.Function("potential", [q, p], [equations.potential]),
        baumgarte=baumgarte,
        forces=None if equations.forces is None else ca.Function("forces", [t, q, v, p], [equations.forces]),
        invariants=tuple(invariants),
        forcing_period=None if clock is None else ca.Function("forcing_period", [p], [ca.SX(clock)]),
        **fields,
    )


def _eliminate(
    equations: ConstrainedEquations, baumgarte: Baumgarte, arguments: list[ca.SX], values: np.ndarray
) -> ca.Function:
    """(a, lambda) as a Function of (t, q, v, p), with M, h, J and the rest read off by jacobian."""
    a, force = equations.acceleration, equations.multipliers
    t, q, v, p = arguments
    unknowns = ca.vertcat(a, force)
    residual = ca.vertcat(equations.balances, equations.constraint_acceleration)
    rest = ca.substitute(residual, unknowns, ca.SX.zeros(unknowns.numel()))
    drift = 2 * baumgarte.alpha * ca.jtimes(equations.constraint, q, v) + baumgarte.beta**2 * equations.constraint
    mass = ca.jacobian(equations.balances, a)
    linear = LinearBalances(
        mass=mass,
        bias=rest[: a.numel()],
        force=-ca.jacobian(equations.balances, force),
        jacobian=ca.jacobian(equations.constraint_acceleration, a),
        right=-rest[a.numel() :] - drift,
    )
    generic = 0.1 + 0.01 * np.arange(q.numel())
    sample = ca.Function("mass", [t, q, p], [mass])(0, generic, values)
    invertible = q.numel() == ca.sprank(sample) and np.all(np.abs(_pivots(sample)) > 0)
    return eliminated(linear, arguments, bool(invertible))


def _pivots(matrix: ca.DM) -> np.ndarray:
    """Diagonal of a diagonal matrix, eigenvalues of any other symmetric one, small ones set to 0."""
    if matrix.nnz() == matrix.shape[0]:
        return np.asarray(ca.diag(matrix).full().ravel())
    values = np.linalg.eigvalsh(matrix.full())
    return np.where(np.abs(values) < 1e-12 * np.abs(values).max(), 0.0, values)


def reduced(model: ConstrainedModel) -> Model:
    """The same system as an explicit ODE in the same redundant coordinates: a(t, q, v, p) alone.

    The algebraic variables are eliminated, Baumgarte terms included, so the flow is that of the DAE.
    Its energies carry no constraint forces: do not form Hamilton's equations from them.
    """
    inputs = [model.algebraic.mx_in(k) for k in range(4)]
    if model.algebraic.is_a("SXFunction"):
        inputs = [model.algebraic.sx_in(k) for k in range(4)]
    acceleration = model.algebraic(*inputs)[: model.coordinates]
    return Model(
        system=model.system,
        state_names=model.state_names,
        parameter_names=model.parameter_names,
        parameter_values=model.parameter_values,
        acceleration=ca.Function("acceleration", inputs, [acceleration]),
        kinetic=model.kinetic,
        potential=model.potential,
        forces=model.forces,
        invariants=model.invariants,
        angles=model.angles,
        points=model.points,
        centres=model.centres,
        forcing_period=model.forcing_period,
        native=model,
    )
