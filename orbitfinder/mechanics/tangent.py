"""The tangent space of a constraint manifold, on which the multipliers of a constrained motion live.

Motions satisfy phi(q) = 0 and J v = 0, so neighbouring ones differ by w = (w_q, w_v) with

    J w_q = 0,    J w_v + (d(J v)/dq) w_q = 0.

The directions across it belong to the stabilisation (multipliers exp(-alpha T)) or, without it, to
no motion at all; they never enter an eigenvalue solver.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from orbitfinder.mechanics.constrained import ConstrainedModel


def tangent_basis(rows: np.ndarray) -> np.ndarray:
    """Orthonormal basis (columns) of the null space of `rows` (r x N), which must have full rank r."""
    if not rows.size:
        return np.eye(rows.shape[1])
    return np.asarray(np.linalg.svd(rows)[2][rows.shape[0] :].T)


def tangent_space(model: ConstrainedModel, state: np.ndarray) -> np.ndarray:
    """Orthonormal basis (2n x 2(n - m)) of the variations of a state (2n) that keep phi = 0 and J v = 0."""
    n, p = model.coordinates, ca.DM(model.parameter_values)
    x = ca.MX.sym("x", 2 * n)
    level = ca.vertcat(model.constraint(x[:n], p), model.constraint_rate(x[:n], x[n:], p))
    return tangent_basis(ca.Function("rows", [x], [ca.jacobian(level, x)])(state).full())


def allowed_velocities(model: ConstrainedModel, state: np.ndarray) -> np.ndarray:
    """Orthonormal basis (n x n - m) of the velocities with J v = 0 at a state (2n)."""
    return tangent_basis(model.constraint_jacobian(state[: model.coordinates], model.parameter_values).full())
