"""The n-link pendulum by angular momentum balance of the outboard links about each joint.

Planar cross product r x f = r_x f_y - r_y f_x, positive from e (along a link) to n (across it).
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from orbitfinder.mechanics.chain import ChainSymbols, directions, model_from_acceleration
from orbitfinder.mechanics.lagrange import acceleration_function
from orbitfinder.mechanics.model import Model


def newton_euler_chain(symbols: ChainSymbols, system: dict[str, Any]) -> Model:
    """The chain by Newton-Euler: n angular momentum balances, linear in alpha, A alpha = b.

    A is the jacobian of the balances and b their negative at alpha = 0. The balance about O_j minus
    the one about O_j+1 has a symmetric positive definite matrix (it is row j of the mass matrix), so
    these differences are what is solved. Source: the report, section 2.1.
    """
    count = len(symbols.links)
    alpha = ca.SX.sym("alpha", count)
    balances = outboard_balances(symbols, alpha)
    differences = balances - ca.vertcat(balances[1:, 0], 0)
    matrix = ca.jacobian(differences, alpha)
    bias = ca.substitute(differences, alpha, ca.SX.zeros(count))
    arguments = [ca.SX.sym("t"), symbols.angles, symbols.rates, symbols.parameters]
    return model_from_acceleration(symbols, system, acceleration_function(matrix, bias, arguments))


def outboard_balances(symbols: ChainSymbols, alpha: ca.SX) -> ca.SX:
    """Residuals (n, N m) of the angular momentum balances about the joints O_1..O_n.

    sum_{i>=j} [ I_i alpha_i + r_{Gi/Oj} x m_i (a_Gi - g e_x) ] = 0, summed from the tip: what the
    links beyond O_j+1 contribute about O_j is their sum about O_j+1 plus r_{Oj+1/Oj} x their force.
    """
    inertial = inertial_forces(symbols, alpha)
    outboard_moment, outboard_force = ca.SX(0), ca.SX.zeros(2)
    balances: list[ca.SX] = []
    for j in reversed(range(len(symbols.links))):
        link = symbols.links[j]
        along, _ = directions(symbols.angles[j])
        own = link.inertia * alpha[j] + cross(link.offset * along, inertial[j])
        outboard_moment = outboard_moment + cross(link.length * along, outboard_force) + own
        outboard_force = outboard_force + inertial[j]
        balances.insert(0, outboard_moment)
    return ca.vertcat(*balances)


def joint_forces_newton_euler(symbols: ChainSymbols, alpha: ca.SX) -> ca.SX:
    """Force on each link at its upper joint (2 x n, N) from the accelerations alpha (n, rad/s^2).

    Linear momentum balance of the outboard links: R_j = sum_{i>=j} m_i (a_Gi - g e_x).
    """
    force, forces = ca.SX.zeros(2), []
    for inertial in reversed(inertial_forces(symbols, alpha)):
        force = force + inertial
        forces.append(force)
    return ca.horzcat(*reversed(forces))


def inertial_forces(symbols: ChainSymbols, alpha: ca.SX) -> list[ca.SX]:
    """m_i (a_Gi - g e_x) of every link (2 each, N), by the five-term acceleration formula.

    a_Gi = a_Oi + alpha k x r + omega k x (omega k x r), r = r_{Gi/Oi}; the two body-derivative
    terms and the Coriolis term of the formula vanish for a rigid link.
    """
    joint, forces = ca.SX.zeros(2), []
    weight = ca.vertcat(symbols.gravity, 0)
    for i, link in enumerate(symbols.links):
        along, across = directions(symbols.angles[i])
        turning = alpha[i] * across - symbols.rates[i] ** 2 * along
        forces.append(link.mass * (joint + link.offset * turning - weight))
        joint = joint + link.length * turning
    return forces


def cross(arm: Any, force: Any) -> Any:
    """Moment arm x force of two plane vectors (2 each), a scalar."""
    return arm[0] * force[1] - arm[1] * force[0]
