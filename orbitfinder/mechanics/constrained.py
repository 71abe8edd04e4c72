"""Models in redundant coordinates with holonomic constraints: index-1 DAEs, their elimination, their tangent space.

    M(q) a + h(t, q, v) = J(q)^T lambda,      J a + Jdot v + 2 alpha J v + beta^2 phi = 0.

x = (q, v) are the differential states and z = (a, lambda) the algebraic ones. alpha = beta = 0
leaves the bare acceleration constraints, which drift; with both positive phi decays
(J. Baumgarte, "Stabilization of constraints and integrals of motion in dynamical systems",
Computer Methods in Applied Mechanics and Engineering 1 (1972) 1-16).

Motions satisfy phi(q) = 0 and J v = 0, so neighbouring ones differ by w = (w_q, w_v) with

    J w_q = 0,    J w_v + (d(J v)/dq) w_q = 0.

The directions across this tangent space belong to the stabilisation (multipliers exp(-alpha T)) or, without it,
to no motion at all; they never enter an eigenvalue solver.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.controls import Limits, divided
from orbitfinder.mechanics.factorise import LinearBalances, eliminated
from orbitfinder.mechanics.lagrange import (
    Symbols,
    Terms,
    coordinate_angles,
    coordinate_names,
    energy_invariant,
    mass_matrix_and_bias,
    mechanical_model,
    pictured,
    strangers,
)
from orbitfinder.mechanics.model import Baumgarte, HolonomicConstraint, Invariant, Model, constraint_of, inputs_of
from orbitfinder.records.reading import Table

RANK_TOLERANCE = 1e-8
"""smallest over largest singular value of J below which a configuration counts as singular"""


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
    system: Table | None = None,
    controls: Sequence[str] = (),
    limits: Limits | None = None,
) -> Model:
    """The Model of a system given by energies and holonomic constraints phi(q, p) = 0, with its native DAE.

    M a + h = J^T lambda with M = d2T/dv2, J = dphi/dq: Lagrange's equations of the first kind (Goldstein, Classical
    Mechanics, section 2.4).

    Args:
        kinetic: T in J.
        potential: V in J.
        constraint: phi (m), zero on every configuration.
        symbols: what these are written in.
        forces: generalized forces Q(t, q, v, p) (n); only they may depend on time.
        baumgarte: the stabilisation of phi; chosen unless given.
        names: of the coordinates.
        angles: which coordinates (n) are angles.
        invariants: first integrals in place of the detected ones.
        points: positions (2 x k, m; x down, y right) that pictures draw.
        system: a description from which files rebuild the Model.
        controls: parameters that may vary in time.
        limits: of the controls, as for `of.lagrange`.

    Returns:
        A Model with a constraint.

    Raises:
        InputError: for expressions of a wrong shape or in foreign symbols, and when the constraints are none or as
            many as the coordinates.

    Examples:
        >>> import casadi as ca
        >>> q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
        >>> rod = of.constrained(ca.sumsqr(v) / 2, -9.8 * q[0], ca.sumsqr(q) - 1, of.Symbols(q, v), names=["x", "y"])
        >>> rod.constraint.force_names
        ('lambda1',)

    See Also:
        `of.linkage`, `of.mechanism`.
    """
    _, q, v, p = symbols.arguments
    _check_expressions(kinetic, potential, constraint, forces, symbols)
    matrix, bias = mass_matrix_and_bias(kinetic, potential, q, v, forces)
    passive, drive = divided(forces, p, controls, symbols.parameter_names, symbols.parameter_values)
    return constrained_model(
        LinearBalances.held(matrix, bias, constraint, q, v),
        ca.SX(constraint),
        Terms(kinetic, potential, forces=passive, actuation=drive),
        symbols,
        baumgarte or Baumgarte(),
        coordinate_names(names, symbols),
        angles=coordinate_angles(angles, symbols),
        invariants=invariants,
        **pictured(points, [q, p]),
        system=system,
        controls=controls,
        limits=limits,
    )


def _check_expressions(
    kinetic: ca.SX, potential: ca.SX, constraint: ca.SX, forces: ca.SX | None, symbols: Symbols
) -> None:
    _, q, v, p = symbols.arguments
    count, clock = ca.SX(constraint).numel(), [] if symbols.time is None else [symbols.time]
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
        if stray := strangers(expression, known):
            raise InputError(f"{name}: depends on {', '.join(stray)}; use only the symbols passed (time: forces only)")
    at_rest = ca.substitute(ca.vertcat(kinetic, ca.gradient(kinetic, v)), v, ca.SX.zeros(v.numel()))
    if ca.depends_on(ca.hessian(ca.SX(kinetic), v)[0], v) or not ca.simplify(at_rest).is_zero():
        raise InputError("kinetic: not a quadratic form in the velocities; write T = 1/2 v.M(q) v")


def constrained_model(
    balances: LinearBalances,
    phi: ca.SX,
    terms: Terms,
    symbols: Symbols,
    baumgarte: Baumgarte,
    names: Sequence[str],
    *,
    force_names: Sequence[str] | None = None,
    invariants: Sequence[Invariant] | None = None,
    lift: ca.Function | None = None,
    **parts: Any,
) -> Model:
    """A Model around M a + h = F lambda, J a = r: its accelerations are those of the DAE, Baumgarte terms included."""
    arguments = symbols.arguments
    t, q, v, p = arguments
    a, force, jacobian = ca.SX.sym("a", q.numel()), ca.SX.sym("lambda", phi.numel()), ca.jacobian(phi, q)
    if invariants is None:
        conservative = terms.forces is None and symbols.time is None
        invariants = [energy_invariant(terms.kinetic, terms.potential, q, v, p)] if conservative else []
    drift = 2 * baumgarte.alpha * ca.jtimes(phi, q, v) + baumgarte.beta**2 * phi
    algebraic = eliminated(replace(balances, right=balances.right - drift), arguments, _invertible(balances, symbols))
    inputs = inputs_of(algebraic)
    equations = balances.mass @ a + balances.bias - balances.force @ force
    constraint = HolonomicConstraint(
        phi=ca.Function("constraint", [q, p], [phi]),
        rate=ca.Function("constraint_rate", [q, v, p], [jacobian @ v]),
        acceleration=ca.Function("constraint_acceleration", [q, v, a, p], [balances.jacobian @ a - balances.right]),
        jacobian=ca.Function("constraint_jacobian", [q, p], [jacobian]),
        balances=ca.Function("balances", [t, q, v, a, force, p], [equations]),
        algebraic=algebraic,
        force_names=tuple(force_names or (f"lambda{k + 1}" for k in range(force.numel()))),
        baumgarte=baumgarte,
        lift=lift,
    )
    acceleration = ca.Function("acceleration", inputs, [algebraic(*inputs)[: a.numel()]])
    return mechanical_model(acceleration, terms, symbols, names, invariants=invariants, constraint=constraint, **parts)


def _invertible(balances: LinearBalances, symbols: Symbols) -> bool:
    """True when M has no massless directions; tiny eigenvalues count as 0."""
    t, q, _, p = symbols.arguments
    generic, values = 0.1 + 0.01 * np.arange(q.numel()), np.asarray(symbols.parameter_values, float)
    sample = ca.Function("mass", [t, q, p], [balances.mass])(0, generic, values)
    if sample.nnz() == q.numel():
        return bool(q.numel() == ca.sprank(sample) and np.all(ca.diag(sample).full() != 0))
    pivots = np.linalg.eigvalsh(sample.full())
    return bool(q.numel() == ca.sprank(sample) and np.all(np.abs(pivots) >= 1e-12 * np.abs(pivots).max()))


def tangent_basis(rows: np.ndarray) -> np.ndarray:
    """Orthonormal basis (columns) of the null space of `rows` (r x N), which must have full rank r."""
    if not rows.size:
        return np.eye(rows.shape[1])
    return np.asarray(np.linalg.svd(rows)[2][rows.shape[0] :].T)


def constraint_rows(model: Model) -> ca.Function:
    """The gradients (2m x 2n) of phi and J v at a state x, which `tangent_basis` is orthogonal to."""
    n, p, constraint = model.degrees_of_freedom, ca.DM(model.parameter_values), constraint_of(model)
    x = ca.MX.sym("x", 2 * n)
    level = ca.vertcat(constraint.phi(x[:n], p), constraint.rate(x[:n], x[n:], p))
    return ca.Function("rows", [x], [ca.jacobian(level, x)])


def allowed_velocities(model: Model, state: np.ndarray) -> np.ndarray:
    """Orthonormal basis (n x n - m) of the velocities with J v = 0 at a state (2n)."""
    q = state[: model.degrees_of_freedom]
    return tangent_basis(constraint_of(model).jacobian(q, model.parameter_values).full())


@dataclass(frozen=True)
class Loops:
    """What a kind of system says of its closed loops; `chosen` are places of a minimal form's coordinates among n."""

    state: Callable[..., np.ndarray]
    """(model, known, rates, near, branch) -> the state (2n) put together there, or somewhere"""
    starts: Callable[[Model, Any], list[np.ndarray]]
    """(model, near or None) -> where an equilibrium is looked for"""
    choice: Callable[[Model], Sequence[int]]
    """the coordinates that a minimal form may have"""
    margins: Callable[[Model, np.ndarray], Callable[[Sequence[int]], np.ndarray]]
    """(model, places (k x n)) -> chosen -> how well (k) the others follow from them, below 1 at a dead point"""
    dead: Callable[[Model, np.ndarray, Sequence[int]], str]
    """(model, place (n), chosen) -> what does not say there how the others follow, in words"""
    whole: Callable[[Model, Table, ca.SX], ca.SX]
    """(model, a minimal form's system, its coordinates u) -> all coordinates (n)"""
    minimal: Callable[[Model, Sequence[int], np.ndarray], Model] | None = None
    """(model, chosen, near) -> the minimal form, put together as near a place (n)"""
    check: Callable[[Model, np.ndarray], None] = lambda model, place: None
    """`InputError` where the motion from an equilibrium is not determined"""

    def everywhere(self, model: Model, system: Table) -> ca.Function:
        """(u, udot) -> all coordinates (n) and their rates, of the minimal form with this system."""
        u, rate = (ca.SX.sym(name, len(system["independent"])) for name in ("u", "udot"))
        q = self.whole(model, system, u)
        return ca.Function("everywhere", [u, rate], [q, ca.jtimes(q, u, rate)])


def by_place(known: Mapping[str, float], names: Sequence[str], what: str, where: str) -> dict[int, float]:
    """Numbers by name as numbers by place among all names; `InputError` for an unknown name or what is no number."""
    for name, value in known.items():
        if name not in names:
            raise InputError(f"{name}: unknown {what}{closest(name, names)}; this {where} has {', '.join(names)}")
        if isinstance(value, bool | str) or not np.isfinite(value):
            raise InputError(f"{name}: must be finite, got {value!r}; give a number")
    return {list(names).index(name): float(value) for name, value in known.items()}


def maximal_states(model: Model, states: np.ndarray) -> np.ndarray:
    """Maximal states (6n, or k x 6n) from states in the angles and rates (2n, or k x 2n)."""
    lift = constraint_of(model).lift
    if lift is None:
        raise InputError("this system has no link angles to start from; give its state in its own coordinates")
    rows = np.atleast_2d(np.asarray(states, float))
    count = model.degrees_of_freedom // 3
    if rows.shape[1] != 2 * count:
        raise InputError(f"state: {rows.shape[1]} numbers for {count} links; give {count} angles, then {count} rates")
    lifted = model.along(lift, rows.T[:count], rows.T[count:]).T
    return np.asarray(lifted[0] if np.ndim(states) == 1 else lifted)


def minimal_states(model: Model, states: np.ndarray) -> np.ndarray:
    """Angles and rates (2n, or k x 2n) of maximal states (6n, or k x 6n): theta and thetadot picked out."""
    if constraint_of(model).lift is None:
        raise InputError("this system has no link angles to go to; use its own coordinates")
    rows, size = np.asarray(states, float), len(model.state_names)
    if rows.ndim == 0 or rows.shape[-1] != size:
        raise InputError(f"states: shape {rows.shape}; give {size} numbers, or rows of that many")
    return rows[..., 2::3]
