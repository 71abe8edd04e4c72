"""A linkage in minimal coordinates by coordinate partitioning: n - 2 independent angles and no constraint left.

The two dependent bars i < j close a triangle over the gap that the others leave (as in `linkage.assemble`), so
their angles are explicit functions of the independent ones u, and with theta = Theta(u) the energies
T(Theta, dTheta/du u'), V(Theta) give Lagrange's equations. Source: R. A. Wehage, E. J. Haug, "Generalized
coordinate partitioning for dimension reduction in analysis of constrained dynamic systems", Journal of
Mechanical Design 104 (1982) 247-255. Valid while the dependent bars are not in line (a dead point).
The physical parameters stay symbols, the closure of the loop included, so that any of them may be freed.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from orbitfinder.errors import InputError
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.linkage import dimensions
from orbitfinder.mechanics.model import Model, constraint_of


def minimal_linkage(model: Model, independent: Sequence[int], branch: int = 1) -> Model:
    """The Model of a linkage in the angles of its `independent` bars (n - 2 of 1..n), same energies and parameters.

    `branch` is the sign of sin(theta_j - theta_i) of the dependent bars i < j, constant along the motion.
    Raises `InputError`.
    """
    chosen = [int(k) - 1 for k in independent]
    u, rates = ca.SX.sym("u", len(chosen)), ca.SX.sym("udot", len(chosen))
    p, n = ca.SX.sym("p", model.parameter_values.size), model.degrees_of_freedom
    theta = _bar_angles(model, u, p, independent, branch)
    lift = constraint_of(model).lift
    assert lift is not None
    state = lift(theta, ca.jtimes(theta, u, rates), p)
    return lagrange(
        model.kinetic(state[:n], state[n:], p),
        model.potential(state[:n], p),
        Symbols(u, rates, p, model.parameter_names, tuple(map(float, model.parameter_values))),
        names=[f"theta{k + 1}" for k in chosen],
        angles=(True,) * len(chosen),
        points=_joints(_sides(model, p)[0], theta),
        system={**model.system, "independent": [int(k) for k in independent], "branch": int(branch)},
    )


def bar_angles(model: Model, independent: Sequence[int], branch: int = 1) -> ca.Function:
    """theta(u): the angles of all bars from those of the independent ones; see `minimal_linkage`."""
    u = ca.SX.sym("u", len(independent))
    return ca.Function("bar_angles", [u], [_bar_angles(model, u, ca.SX(model.parameter_values), independent, branch)])


def _sides(model: Model, p: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Bar lengths (n) and ground pivot (2) among the parameters of a linkage."""
    bars = dimensions(model)[0].size
    named = {name: p[k] for k, name in enumerate(model.parameter_names)}
    lengths = ca.vertcat(*[named[f"length{k + 1}"] for k in range(bars)])
    return lengths, ca.vertcat(named["ground1"], named["ground2"])


def _bar_angles(model: Model, u: ca.SX, p: ca.SX, independent: Sequence[int], branch: int) -> ca.SX:
    lengths, ground = _sides(model, p)
    bars = lengths.numel()
    chosen = [int(k) - 1 for k in independent]
    rest = [k for k in range(bars) if k not in chosen]
    if len(rest) != 2 or len(set(chosen)) != bars - 2 or branch not in (1, -1):
        raise InputError(
            f"independent: need {bars - 2} different bars of 1 to {bars} and branch +1 or -1, "
            f"got {list(independent)!r} and {branch!r}"
        )
    angles = [ca.SX(0)] * bars
    gap = ground
    for position, k in enumerate(chosen):
        angles[k] = u[position]
        gap = gap - lengths[k] * ca.vertcat(ca.cos(u[position]), ca.sin(u[position]))
    i, j = rest
    angles[i], angles[j] = _dyad(gap, lengths[i], lengths[j], branch)
    return ca.vertcat(*angles)


def _joints(lengths: ca.SX, theta: ca.SX) -> ca.SX:
    """Positions (2 x n + 1) of the joints, from the first pivot to the last; x down, y right."""
    bars = [lengths[k] * ca.vertcat(ca.cos(theta[k]), ca.sin(theta[k])) for k in range(lengths.numel())]
    return ca.cumsum(ca.horzcat(ca.SX(2, 1), *bars), 1)


def _dyad(gap: ca.SX, first: ca.SX, second: ca.SX, branch: int) -> tuple[ca.SX, ca.SX]:
    """Angles of two bars that span a gap (2): heading -+ arccos of the cosine rule, and what is left."""
    distance = ca.norm_2(gap)
    opening = ca.acos((distance**2 + first**2 - second**2) / (2 * distance * first))
    angle = ca.atan2(gap[1], gap[0]) - branch * opening
    elbow = gap - first * ca.vertcat(ca.cos(angle), ca.sin(angle))
    return angle, ca.atan2(elbow[1], elbow[0])
