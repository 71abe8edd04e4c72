"""The n-link pendulum in maximal coordinates (x_G, y_G, theta per link), joint forces as unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.chain_symbols import (
    ChainSymbols,
    Numbers,
    chain_symbols,
    chain_system,
    cross,
    directions,
    geometry,
)
from orbitfinder.mechanics.constrained import constrained_model
from orbitfinder.mechanics.factorise import LinearBalances
from orbitfinder.mechanics.lagrange import Symbols, Terms
from orbitfinder.mechanics.model import Baumgarte, Model, constraint_of


@dataclass(frozen=True)
class Body:
    """One link's motion in maximal coordinates: (x_G, y_G, theta) and its two derivatives (3 each)."""

    place: ca.SX
    rate: ca.SX
    acceleration: ca.SX

    def end(self, arm: Any) -> tuple[ca.SX, ca.SX]:
        """Position and acceleration (2 each) of the point at `arm` (m) along the link from its centre.

        r = r_G + s e,  r'' = a_G + s (alpha n - omega^2 e).
        """
        along, across = directions(self.place[2])
        turning = self.acceleration[2] * across - self.rate[2] ** 2 * along
        return self.place[:2] + arm * along, self.acceleration[:2] + arm * turning


def chain_dae(
    links: int,
    length: Numbers = 1.0,
    mass: Numbers = 1.0,
    inertia: Numbers | None = None,
    com: Numbers = 0.5,
    *,
    gravity: float = 9.8,
    baumgarte: Baumgarte | Sequence[float] | None = None,
) -> Model:
    """The n-link pendulum as a native DAE: 6n states (q, v), q = (x_G, y_G, theta) per link.

    Arguments as for `chain`; lambda are the forces (2 per joint, N) on each link at its upper joint.
    Baumgarte terms are off unless given, as in the report (section 2.2). Raises `InputError`.
    """
    stabilisation = baumgarte_of(baumgarte, Baumgarte())
    system = chain_system(links, length, mass, inertia, com, gravity=gravity, formulation="dae")
    system["baumgarte"] = [stabilisation.alpha, stabilisation.beta]
    return maximal_chain(chain_symbols(system), system, stabilisation)


def baumgarte_of(given: Baumgarte | Sequence[float] | None, default: Baumgarte) -> Baumgarte:
    """Stabilisation as given: an object, the two numbers of a description, or none for the default."""
    if given is None or isinstance(given, Baumgarte):
        return given or default
    numbers = np.asarray(given, float)
    if numbers.shape != (2,) or not np.all(np.isfinite(numbers)) or np.any(numbers < 0):
        raise InputError(f"baumgarte: need [alpha, beta], both at least 0 in 1/s, got {given!r}")
    return Baumgarte(float(numbers[0]), float(numbers[1]))


def dae_chain(symbols: ChainSymbols) -> ca.Function:
    """The chain's angular accelerations a(t, q, v, p), got from the maximal-coordinate equations.

    The linear system for (a, lambda) is solved at the maximal state that the angles and rates imply,
    where phi and phidot vanish, and the angular accelerations are picked out of a.
    """
    model, count = maximal_chain(symbols, {}, Baumgarte()), len(symbols.links)
    constraint, n = constraint_of(model), model.degrees_of_freedom
    assert constraint.lift is not None
    symbol: Any = ca.SX.sym if constraint.algebraic.is_a("SXFunction") else ca.MX.sym
    t, q, v, p = symbol("t"), symbol("q", count), symbol("v", count), symbol("p", model.parameter_values.size)
    state = constraint.lift(q, v, p)
    return ca.Function("acceleration", [t, q, v, p], [constraint.algebraic(t, state[:n], state[n:], p)[2:n:3]])


def maximal_chain(
    symbols: ChainSymbols, system: dict[str, Any], baumgarte: Baumgarte, ground: ca.SX | None = None
) -> Model:
    """The chain, or with `ground` (2, m) the closed chain whose tip is pinned there, as a native DAE."""
    count = len(symbols.links)
    joints = count + (ground is not None)
    q, v, a = (ca.SX.sym(name, 3 * count) for name in ("q", "v", "a"))
    reactions = ca.SX.sym("R", 2 * joints)
    bodies = [Body(q[at], v[at], a[at]) for at in (slice(3 * i, 3 * i + 3) for i in range(count))]
    kinetic, potential = ca.SX(0), ca.SX(0)
    for link, body in zip(symbols.links, bodies, strict=True):
        kinetic += 0.5 * link.mass * ca.sumsqr(body.rate[:2]) + 0.5 * link.inertia * body.rate[2] ** 2
        potential -= link.mass * symbols.gravity * body.place[0]
    position, second = joint_constraints(symbols, bodies, ground)
    balances = link_balances(symbols, bodies, ca.reshape(reactions, 2, joints))
    points, centres, velocities = geometry(symbols)
    angles, rates, p = symbols.coordinates, symbols.velocities, symbols.parameters
    at_angles = ca.Function("geometry", [angles, p], [points, centres])
    points, q_centres = at_angles(q[2::3], p)
    lifted = ca.vertcat(ca.vec(ca.vertcat(centres, angles.T)), ca.vec(ca.vertcat(velocities, rates.T)))
    return constrained_model(
        LinearBalances.of(balances, second, a, reactions),
        position,
        Terms(kinetic, potential),
        Symbols(q, v, p, symbols.parameter_names, symbols.parameter_values),
        baumgarte,
        [f"{name}{i + 1}" for i in range(count) for name in ("x", "y", "theta")],
        force_names=[f"R{i + 1}{axis}" for i in range(joints) for axis in "xy"],
        angles=(False, False, True) * count,
        points=ca.Function("points", [q, p], [points]),
        centres=ca.Function("centres", [q, p], [q_centres]),
        lift=ca.Function("lift", [angles, rates, p], [lifted]),
        system=system,
    )


def link_balances(symbols: ChainSymbols, bodies: list[Body], reactions: ca.SX) -> ca.SX:
    """Residuals (3n) of two linear and one angular momentum balance per link (N, N, N m).

    With R_i on link i at its upper joint, -R_i+1 at its lower joint, G_i its centre of mass:
    m a_G = R_i - R_i+1 + m g e_x,   I alpha = r_{upper/G} x R_i - r_{lower/G} x R_i+1.
    Source: the report, section 2.2; angular momentum is taken about G.
    """
    rows: list[ca.SX] = []
    for i, (link, body) in enumerate(zip(symbols.links, bodies, strict=True)):
        along, _ = directions(body.place[2])
        upper = reactions[:, i]
        lower = reactions[:, i + 1] if i + 1 < reactions.shape[1] else ca.SX(2, 1)
        weight = ca.vertcat(link.mass * symbols.gravity, 0)
        rows.append(link.mass * body.acceleration[:2] - (upper - lower + weight))
        moment = cross(-link.offset * along, upper) - cross((link.length - link.offset) * along, lower)
        rows.append(link.inertia * body.acceleration[2] - moment)
    return ca.vertcat(*rows)


def joint_constraints(symbols: ChainSymbols, bodies: list[Body], ground: ca.SX | None) -> tuple[ca.SX, ca.SX]:
    """phi and its second derivative, two rows per joint: upper end of a link minus lower end of the last.

    The first joint is at the origin; with `ground` a last one holds ground minus the tip.
    """
    last_position, last_acceleration = ca.SX.zeros(2), ca.SX.zeros(2)
    positions, accelerations = [], []
    for link, body in zip(symbols.links, bodies, strict=True):
        upper_position, upper_acceleration = body.end(-link.offset)
        positions.append(upper_position - last_position)
        accelerations.append(upper_acceleration - last_acceleration)
        last_position, last_acceleration = body.end(link.length - link.offset)
    if ground is not None:
        positions.append(ground - last_position)
        accelerations.append(-last_acceleration)
    return ca.vertcat(*positions), ca.vertcat(*accelerations)


def maximal_states(model: Model, states: np.ndarray) -> np.ndarray:
    """Maximal states (6n, or k x 6n) from states in the angles and rates (2n, or k x 2n)."""
    lift = constraint_of(model).lift
    if lift is None:
        raise InputError("this system has no link angles to start from; give its state in its own coordinates")
    rows = np.atleast_2d(np.asarray(states, float))
    count = model.degrees_of_freedom // 3
    if rows.shape[1] != 2 * count:
        raise InputError(f"state: {rows.shape[1]} numbers for {count} links; give {count} angles, then {count} rates")
    p = np.tile(model.parameter_values[:, None], (1, len(rows)))
    lifted = lift.map(len(rows))(rows.T[:count], rows.T[count:], p).full().T
    return np.asarray(lifted[0] if np.ndim(states) == 1 else lifted)


def minimal_states(model: Model, states: np.ndarray) -> np.ndarray:
    """Angles and rates (2n, or k x 2n) of maximal states (6n, or k x 6n): theta and thetadot picked out."""
    if constraint_of(model).lift is None:
        raise InputError("this system has no link angles to go to; use its own coordinates")
    rows, size = np.asarray(states, float), len(model.state_names)
    if rows.ndim == 0 or rows.shape[-1] != size:
        raise InputError(f"states: shape {rows.shape}; give {size} numbers, or rows of that many")
    return np.asarray(rows[..., 2::3])
