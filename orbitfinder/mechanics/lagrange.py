"""Lagrange's equations from expressions for the energies, by automatic differentiation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import Invariant, Model

UNROLLED_FACTORISATION_LIMIT = 16
"""Up to this many coordinates M is factorised inside the graph; beyond, numerically at run time."""


@dataclass(frozen=True)
class Symbols:
    """The CasADi SX symbols that the energies are written in.

    `coordinates` q (n), `velocities` v (n), `parameters` (k) with names and default values,
    and `time` for systems that are forced explicitly.
    """

    coordinates: ca.SX
    velocities: ca.SX
    parameters: ca.SX | None = None
    parameter_names: tuple[str, ...] = ()
    parameter_values: tuple[float, ...] = ()
    time: ca.SX | None = None


def mass_matrix_and_bias(
    kinetic: ca.SX, potential: ca.SX, q: ca.SX, v: ca.SX, forces: ca.SX | None = None
) -> tuple[ca.SX, ca.SX]:
    """M (n x n) and h (n) with M a + h = 0, from L = T - V by the multivariable chain rule.

    d/dt dL/dv = (d2L/dv dq) v + (d2L/dv2) a, hence M = d2L/dv2 and
    h = (d2L/dv dq) v - dL/dq - Q. Source: Goldstein, Classical Mechanics, section 1.4.
    """
    lagrangian = kinetic - potential
    momentum = ca.gradient(lagrangian, v)
    mass_matrix = ca.jacobian(momentum, v)
    bias = ca.jtimes(momentum, q, v) - ca.gradient(lagrangian, q)
    return mass_matrix, bias if forces is None else bias - forces


def solve_positive_definite(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solve A y = b (A symmetric positive definite, n x n) by an L D L^T written out in the graph."""
    size = matrix.shape[0]
    lower, diagonal = ca.SX.eye(size), [ca.SX(0)] * size
    for j in range(size):
        scaled = [lower[j, k] * diagonal[k] for k in range(j)]
        diagonal[j] = matrix[j, j] - sum(lower[j, k] * scaled[k] for k in range(j))
        for i in range(j + 1, size):
            correction = sum(lower[i, k] * scaled[k] for k in range(j))
            lower[i, j] = (matrix[i, j] - correction) / diagonal[j]
    y: list[ca.SX] = []
    for i in range(size):
        y.append(right[i] - sum(lower[i, k] * y[k] for k in range(i)))
    y = [value / diagonal[i] for i, value in enumerate(y)]
    for i in reversed(range(size)):
        y[i] = y[i] - sum(lower[k, i] * y[k] for k in range(i + 1, size))
    return ca.vertcat(*y)


def energy_invariant(kinetic: ca.SX, potential: ca.SX, q: ca.SX, v: ca.SX, p: ca.SX) -> Invariant:
    """Energy as an invariant, unfolded by fictitious damping: a += s v, so dE/dt = s v.M v."""
    return Invariant(
        "energy",
        ca.Function("energy", [q, v, p], [kinetic + potential]),
        ca.Function("energy_unfolding", [q, v, p], [v]),
    )


def acceleration_function(
    matrix: ca.SX, bias: ca.SX, arguments: Sequence[ca.SX], limit: int = UNROLLED_FACTORISATION_LIMIT
) -> ca.Function:
    """a(t, q, v, p) = -M^-1 h; M is never inverted, and factorised numerically for large n."""
    size = matrix.shape[0]
    if size <= limit:
        return ca.Function("acceleration", list(arguments), [solve_positive_definite(matrix, -bias)])
    parts = ca.Function("mass_and_bias", list(arguments), [matrix, bias])
    inputs = [ca.MX.sym(f"i{k}", *a.shape) for k, a in enumerate(arguments)]
    mass, rest = parts(*inputs)
    return ca.Function("acceleration", inputs, [ca.solve(mass, -rest, "ldl")])


def lagrange(
    kinetic: ca.SX,
    potential: ca.SX,
    symbols: Symbols,
    *,
    forces: ca.SX | None = None,
    names: Sequence[str] | None = None,
    angles: Sequence[bool] | None = None,
    invariants: Sequence[Invariant] | None = None,
    points: ca.SX | None = None,
    centres: ca.SX | None = None,
    system: Mapping[str, Any] | None = None,
) -> Model:
    """Model of a system given by its kinetic and potential energy (CasADi SX expressions).

    Lagrange: d/dt dL/dv - dL/dq = Q with L = T(q, v, p) - V(q, p) and generalized forces
    Q(t, q, v, p). Energy is taken as a first integral when Q is absent; pass `invariants=()` or
    your own to override. `names` are the coordinates' names (rates get a trailing "dot").
    Raises `InputError` when an expression is not a scalar or the kinetic energy is not
    quadratic and positive in v at the origin.
    """
    q, v = symbols.coordinates, symbols.velocities
    _check_shapes(kinetic, potential, q, v)
    p = symbols.parameters if symbols.parameters is not None else ca.SX(0, 1)
    t = symbols.time if symbols.time is not None else ca.SX.sym("t")
    arguments = [t, q, v, p]
    matrix, bias = mass_matrix_and_bias(kinetic, potential, q, v, forces)
    size = q.numel()
    labels = tuple(names) if names is not None else tuple(f"q{i + 1}" for i in range(size))
    if invariants is None:
        conservative = forces is None and symbols.time is None
        invariants = [energy_invariant(kinetic, potential, q, v, p)] if conservative else []
    return Model(
        system=dict(system or {"kind": "custom"}),
        state_names=labels + tuple(f"{label}dot" for label in labels),
        parameter_names=tuple(symbols.parameter_names),
        parameter_values=np.asarray(symbols.parameter_values, float),
        acceleration=acceleration_function(matrix, bias, arguments),
        kinetic=ca.Function("kinetic", [q, v, p], [kinetic]),
        potential=ca.Function("potential", [q, p], [potential]),
        forces=None if forces is None else ca.Function("forces", arguments, [forces]),
        invariants=tuple(invariants),
        angles=tuple(angles) if angles is not None else (False,) * size,
        points=None if points is None else ca.Function("points", [q, p], [points]),
        centres=None if centres is None else ca.Function("centres", [q, p], [centres]),
    )


def _check_shapes(kinetic: ca.SX, potential: ca.SX, q: ca.SX, v: ca.SX) -> None:
    for name, value in (("kinetic", kinetic), ("potential", potential)):
        if ca.SX(value).numel() != 1:
            raise InputError(f"{name}: expected a scalar expression, got shape {ca.SX(value).shape}")
    if q.numel() != v.numel():
        raise InputError(f"velocities: {v.numel()} given for {q.numel()} coordinates; give one per coordinate")
    hessian = ca.hessian(ca.SX(kinetic), v)[0]
    if ca.depends_on(hessian, v) or hessian.nnz() == 0:
        raise InputError("kinetic: not quadratic in the velocities; write T = 1/2 v.M(q) v + ...")
