"""The n-link pendulum (open planar chain of rods) in absolute angles, derived in four ways that agree."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from orbitfinder.errors import InputError
from orbitfinder.mechanics.chain_symbols import (
    ChainSymbols,
    Numbers,
    chain_energies,
    chain_model,
    chain_symbols,
    chain_system,
    cross,
    directions,
)
from orbitfinder.mechanics.factorise import acceleration_function
from orbitfinder.mechanics.lagrange import mass_matrix_and_bias
from orbitfinder.mechanics.maximal import dae_chain
from orbitfinder.mechanics.model import Model


def chain(
    links: int,
    length: Numbers = 1.0,
    mass: Numbers = 1.0,
    inertia: Numbers | None = None,
    com: Numbers = 0.5,
    *,
    gravity: float = 9.8,
    formulation: str = "recursive",
) -> Model:
    """Model of the n-link pendulum hanging from a fixed joint at the origin.

    State x = (theta_1..n, thetadot_1..n) in rad and rad/s. `length` (m), `mass` (kg), `inertia`
    (kg m^2, about the centre of mass; default m l^2 / 12) and `com` (centre of mass as a fraction
    of the length, from the upper joint) are scalars or one number per link; `gravity` in m/s^2.
    The potential is zero at the fixed joint: V = -sum m g x_G. `formulation` is "recursive" (O(n)
    elimination of the joint forces), "lagrange" (dense mass matrix), "newton-euler" (balances about
    the joints) or "dae" (maximal coordinates, reduced to the angles). Raises `InputError`.
    """
    if not isinstance(formulation, str) or formulation not in FORMULATIONS:
        raise InputError(f"formulation: unknown {formulation!r}; use one of {', '.join(FORMULATIONS)}")
    system = chain_system(links, length, mass, inertia, com, gravity=gravity, formulation=formulation)
    symbols = chain_symbols(system)
    return chain_model(symbols, system, FORMULATIONS[formulation](symbols))


def lagrange_chain(symbols: ChainSymbols) -> ca.Function:
    """Accelerations by Lagrange's equations: dense M(q) from the energies."""
    matrix, bias = mass_matrix_and_bias(*chain_energies(symbols), symbols.coordinates, symbols.velocities)
    return acceleration_function(matrix, bias, symbols.arguments)


def recursive_chain(symbols: ChainSymbols) -> ca.Function:
    """Accelerations by elimination of the joint forces from tip to root, O(n) operations."""
    return ca.Function("acceleration", symbols.arguments, [recursive_acceleration(symbols)[0]])


def recursive_acceleration(symbols: ChainSymbols) -> tuple[ca.SX, ca.SX]:
    """Angular accelerations (n) and joint forces on each link at its upper joint (2 x n), in O(n).

    With a the acceleration of a link's upper joint, the force there is affine, R = P a + b.
    Substituting R' = P' a' + b' of the next link into the balances of this one,

        m a_G = R - R' + m g e_x,    I alpha = (balance of moments about the upper joint),
        a_G = a + d (alpha n - w^2 e),    a' = a + l (alpha n - w^2 e),

    gives alpha = (tau - k.a) / D with k = m d n + l P' n, D = I + m d^2 + l^2 n.P'n,
    tau = m g d n_x + l^2 w^2 n.P'e - l n.b', and the recursion
    P = m 1 + P' - k k^T / D,  b = b' - m g e_x - w^2 (m d e + l P' e) + k tau / D.
    This is the block-tridiagonal elimination of the reaction forces of the maximal-coordinate
    equations; compare R. Featherstone, Rigid Body Dynamics Algorithms (2008), chapter 7
    (articulated-body inertia).
    """
    inertia_matrix, bias = ca.SX(2, 2), ca.SX.zeros(2)
    sweep = []
    for i in reversed(range(len(symbols.links))):
        link, rate_squared = symbols.links[i], symbols.velocities[i] ** 2
        along, across = directions(symbols.coordinates[i])
        length, lever = link.length, link.mass * link.offset
        lag, drag = length * (inertia_matrix @ across), length * (inertia_matrix @ along)
        gain = lever * across + lag
        pivot = link.inertia + lever * link.offset + length * ca.dot(across, lag)
        moment = lever * symbols.gravity * across[0] + length * (
            rate_squared * ca.dot(across, drag) - ca.dot(across, bias)
        )
        inertia_matrix = link.mass * ca.SX.eye(2) + inertia_matrix - gain @ gain.T / pivot
        weight = ca.vertcat(link.mass * symbols.gravity, 0)
        bias = bias - weight - rate_squared * (lever * along + drag) + gain * (moment / pivot)
        sweep.append((along, across, gain, pivot, moment, inertia_matrix, bias))
    joint = ca.SX.zeros(2)
    accelerations, forces = [], []
    for i, (along, across, gain, pivot, moment, inertia_matrix, bias) in enumerate(reversed(sweep)):
        alpha = (moment - ca.dot(gain, joint)) / pivot
        accelerations.append(alpha)
        forces.append(inertia_matrix @ joint + bias)
        joint = joint + symbols.links[i].length * (alpha * across - symbols.velocities[i] ** 2 * along)
    return ca.vertcat(*accelerations), ca.horzcat(*forces)


def newton_euler_chain(symbols: ChainSymbols) -> ca.Function:
    """Accelerations by Newton-Euler: n angular momentum balances, linear in alpha, A alpha = b.

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
    return acceleration_function(matrix, bias, symbols.arguments)


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
        along, _ = directions(symbols.coordinates[j])
        own = link.inertia * alpha[j] + cross(link.offset * along, inertial[j])
        outboard_moment = outboard_moment + cross(link.length * along, outboard_force) + own
        outboard_force = outboard_force + inertial[j]
        balances.insert(0, outboard_moment)
    return ca.vertcat(*balances)


def inertial_forces(symbols: ChainSymbols, alpha: ca.SX) -> list[ca.SX]:
    """m_i (a_Gi - g e_x) of every link (2 each, N), by the five-term acceleration formula.

    a_Gi = a_Oi + alpha k x r + omega k x (omega k x r), r = r_{Gi/Oi}; the two body-derivative
    terms and the Coriolis term of the formula vanish for a rigid link.
    """
    joint, forces = ca.SX.zeros(2), []
    weight = ca.vertcat(symbols.gravity, 0)
    for i, link in enumerate(symbols.links):
        along, across = directions(symbols.coordinates[i])
        turning = alpha[i] * across - symbols.velocities[i] ** 2 * along
        forces.append(link.mass * (joint + link.offset * turning - weight))
        joint = joint + link.length * turning
    return forces


FORMULATIONS: dict[str, Callable[[ChainSymbols], ca.Function]] = {
    "lagrange": lagrange_chain,
    "newton-euler": newton_euler_chain,
    "dae": dae_chain,
    "recursive": recursive_chain,
}
"""Every way of deriving a chain's accelerations a(t, q, v, p), by name"""
