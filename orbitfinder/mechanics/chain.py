"""The n-link pendulum (open planar chain of rods) in absolute angles, derived in O(n) or by Lagrange.

Angles theta_i are measured from the downward vertical, x points down, y to the right; link i has
e_i = (cos theta_i, sin theta_i) along it and n_i = (-sin theta_i, cos theta_i) across it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.lagrange import Symbols, energy_invariant, lagrange
from orbitfinder.mechanics.model import Invariant, Model

Numbers = float | Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Link:
    """One link's quantities as expressions: length, mass, inertia about its centre, offset of it."""

    length: Any
    mass: Any
    inertia: Any
    offset: Any
    """distance of the centre of mass from the upper joint, in m"""


@dataclass(frozen=True)
class ChainSymbols:
    """Angles, rates and parameters of a chain, and its links written in those parameters."""

    angles: ca.SX
    rates: ca.SX
    parameters: ca.SX
    names: tuple[str, ...]
    values: np.ndarray
    links: tuple[Link, ...]
    gravity: Any


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
    derivers = formulations()
    if not isinstance(formulation, str) or formulation not in derivers:
        raise InputError(f"formulation: unknown {formulation!r}; use one of {', '.join(derivers)}")
    system = chain_system(links, length, mass, inertia, com, gravity=gravity, formulation=formulation)
    return derivers[formulation](chain_symbols(system), system)


def formulations() -> dict[str, Callable[[ChainSymbols, dict[str, Any]], Model]]:
    """Every way of deriving the chain's equations, by name (imported here: they build on this module)."""
    from orbitfinder.mechanics.maximal import dae_chain
    from orbitfinder.mechanics.newton_euler import newton_euler_chain

    return {
        "lagrange": lagrange_chain,
        "newton-euler": newton_euler_chain,
        "dae": dae_chain,
        "recursive": recursive_chain,
    }


def per_link(name: str, value: Numbers, links: int, lowest: float, inclusive: bool = False) -> list[float]:
    """A scalar or one number per link as a list; `InputError` names the field and the value."""
    try:
        numbers = np.asarray(value, float)
    except (TypeError, ValueError):
        raise InputError(f"{name}: must be numbers, got {value!r}; give one number or one per link") from None
    if numbers.ndim == 0:
        numbers = np.full(links, float(numbers))
    if numbers.shape != (links,):
        raise InputError(f"{name}: {numbers.size} numbers for {links} links; give one number or one per link")
    if not np.all(np.isfinite(numbers)):
        raise InputError(f"{name}: must be finite, got {value}; replace NaN and infinity by numbers")
    if np.any(numbers < lowest) or (not inclusive and np.any(numbers == lowest)):
        bound = f"at least {lowest:g}" if inclusive else f"greater than {lowest:g}"
        raise InputError(f"{name}: must be {bound}, got {value}; check the sign and the unit")
    return [float(number) for number in numbers]


def chain_system(
    links: int,
    length: Numbers = 1.0,
    mass: Numbers = 1.0,
    inertia: Numbers | None = None,
    com: Numbers = 0.5,
    *,
    gravity: float = 9.8,
    formulation: str = "recursive",
) -> dict[str, Any]:
    """The plain description (JSON) that a chain is built from, checked."""
    if isinstance(links, bool) or not isinstance(links, (int, np.integer)) or links < 1:
        raise InputError(f"links: must be a whole number of at least 1, got {links!r}; give the number of links")
    if not isinstance(gravity, (int, float, np.number)) or not np.isfinite(gravity):
        raise InputError(f"gravity: must be finite, got {gravity!r}; use 9.8 on Earth, 0 for none")
    count = int(links)
    system: dict[str, Any] = {
        "kind": "chain",
        "links": count,
        "length": per_link("length", length, count, 0.0),
        "mass": per_link("mass", mass, count, 0.0),
        "com": per_link("com", com, count, -np.inf),
        "gravity": float(gravity),
        "formulation": formulation,
    }
    if inertia is not None:
        system["inertia"] = per_link("inertia", inertia, count, 0.0, inclusive=True)
        lever = [m * (c * s) ** 2 for m, c, s in zip(system["mass"], system["com"], system["length"], strict=True)]
        if any(i == 0 and level == 0 for i, level in zip(system["inertia"], lever, strict=True)):
            raise InputError(
                "inertia: a link with inertia 0 and com 0 has no resistance to rotation; "
                "give it an inertia or move its centre of mass off the joint"
            )
    return system


def chain_symbols(system: dict[str, Any]) -> ChainSymbols:
    """Symbols and link expressions for a chain; a default inertia follows mass and length."""
    count = system["links"]
    fields = [name for name in ("length", "mass", "inertia", "com") if name in system]
    names = [f"{name}{i + 1}" for name in fields for i in range(count)] + ["gravity"]
    values = [value for name in fields for value in system[name]] + [system["gravity"]]
    parameters = ca.SX.sym("p", len(names))
    columns = {name: parameters[k * count : (k + 1) * count] for k, name in enumerate(fields)}
    links = []
    for i in range(count):
        length, mass = columns["length"][i], columns["mass"][i]
        inertia = columns["inertia"][i] if "inertia" in columns else mass * length**2 / 12
        links.append(Link(length, mass, inertia, columns["com"][i] * length))
    return ChainSymbols(
        ca.SX.sym("theta", count), ca.SX.sym("thetadot", count), parameters,
        tuple(names), np.asarray(values), tuple(links), parameters[-1],
    )  # fmt: skip


def directions(angle: Any) -> tuple[Any, Any]:
    """e (along the link) and n (across it) for an angle from the downward vertical."""
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(cosine, sine), ca.vertcat(-sine, cosine)


def geometry(symbols: ChainSymbols) -> tuple[ca.SX, ca.SX]:
    """Joint positions (2 x n+1, the first is the fixed joint) and centres of mass (2 x n), in m."""
    joints, centres = [ca.SX.zeros(2)], []
    for i, link in enumerate(symbols.links):
        along, _ = directions(symbols.angles[i])
        centres.append(joints[-1] + link.offset * along)
        joints.append(joints[-1] + link.length * along)
    return ca.horzcat(*joints), ca.horzcat(*centres)


def chain_energies(symbols: ChainSymbols) -> tuple[ca.SX, ca.SX]:
    """Kinetic energy sum 1/2 m v_G.v_G + 1/2 I w^2 and potential energy -sum m g x_G, in J."""
    kinetic, potential = ca.SX(0), ca.SX(0)
    joint, joint_velocity = ca.SX.zeros(2), ca.SX.zeros(2)
    for i, link in enumerate(symbols.links):
        along, across = directions(symbols.angles[i])
        rate = symbols.rates[i]
        velocity = joint_velocity + link.offset * rate * across
        kinetic += 0.5 * link.mass * ca.sumsqr(velocity) + 0.5 * link.inertia * rate**2
        potential -= link.mass * symbols.gravity * (joint[0] + link.offset * along[0])
        joint += link.length * along
        joint_velocity += link.length * rate * across
    return kinetic, potential


def chain_invariants(symbols: ChainSymbols, kinetic: ca.SX, potential: ca.SX) -> list[Invariant]:
    """Energy; without gravity also the angular momentum about the fixed joint, sum_i dT/dthetadot_i."""
    q, v, p = symbols.angles, symbols.rates, symbols.parameters
    found = [energy_invariant(kinetic, potential, q, v, p)]
    if symbols.values[-1] == 0.0:
        turn = ca.SX.ones(q.numel())
        found.append(
            Invariant(
                "angular_momentum",
                ca.Function("angular_momentum", [q, v, p], [ca.sum1(ca.gradient(kinetic, v))]),
                ca.Function("angular_momentum_unfolding", [q, v, p], [turn]),
                ca.Function("rotation", [q, v, p], [ca.vertcat(turn, ca.SX.zeros(q.numel()))]),
            )
        )
    return found


def lagrange_chain(symbols: ChainSymbols, system: dict[str, Any]) -> Model:
    """The chain by Lagrange's equations: dense M(q) from the energies."""
    kinetic, potential = chain_energies(symbols)
    joints, centres = geometry(symbols)
    return lagrange(
        kinetic,
        potential,
        Symbols(symbols.angles, symbols.rates, symbols.parameters, symbols.names, tuple(symbols.values)),
        names=[f"theta{i + 1}" for i in range(len(symbols.links))],
        angles=[True] * len(symbols.links),
        invariants=chain_invariants(symbols, kinetic, potential),
        points=joints,
        centres=centres,
        system=system,
    )


def recursive_chain(symbols: ChainSymbols, system: dict[str, Any]) -> Model:
    """The chain by elimination of the joint forces from tip to root, O(n) operations."""
    return model_from_acceleration(symbols, system, recursive_acceleration(symbols)[0])


def model_from_acceleration(symbols: ChainSymbols, system: dict[str, Any], acceleration: ca.SX | ca.Function) -> Model:
    """A chain Model around accelerations (n, or a Function of t, q, v, p) derived without the energies."""
    q, v, p = symbols.angles, symbols.rates, symbols.parameters
    count = len(symbols.links)
    kinetic, potential = chain_energies(symbols)
    joints, centres = geometry(symbols)
    labels = tuple(f"theta{i + 1}" for i in range(count))
    if not isinstance(acceleration, ca.Function):
        acceleration = ca.Function("acceleration", [ca.SX.sym("t"), q, v, p], [acceleration])
    return Model(
        system=system,
        state_names=labels + tuple(f"{label}dot" for label in labels),
        parameter_names=symbols.names,
        parameter_values=symbols.values,
        acceleration=acceleration,
        kinetic=ca.Function("kinetic", [q, v, p], [kinetic]),
        potential=ca.Function("potential", [q, p], [potential]),
        invariants=tuple(chain_invariants(symbols, kinetic, potential)),
        angles=(True,) * count,
        points=ca.Function("points", [q, p], [joints]),
        centres=ca.Function("centres", [q, p], [centres]),
    )


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
        link, rate_squared = symbols.links[i], symbols.rates[i] ** 2
        along, across = directions(symbols.angles[i])
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
        joint = joint + symbols.links[i].length * (alpha * across - symbols.rates[i] ** 2 * along)
    return ca.vertcat(*accelerations), ca.horzcat(*forces)
