"""The vocabulary of every chain: its description, symbols, links, directions, positions and energies.

Angles theta_i are measured from the downward vertical, x points down, y to the right; link i has
e_i = (cos theta_i, sin theta_i) along it and n_i = (-sin theta_i, cos theta_i) across it. The planar cross
product r x f = r_x f_y - r_y f_x is positive from e to n.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.constrained import constrained_model
from orbitfinder.mechanics.controls import TORQUE, Limits, checked_limits, checked_motors
from orbitfinder.mechanics.factorise import LinearBalances, acceleration_function
from orbitfinder.mechanics.lagrange import Symbols, Terms, energy_invariant, mass_matrix_and_bias, mechanical_model
from orbitfinder.mechanics.model import Baumgarte, Invariant, Model, constraint_of, symbol_of
from orbitfinder.records.reading import Entries

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
class ChainSymbols(Symbols):
    """Angles and rates (the coordinates and velocities) and parameters of a chain, its links written in them."""

    links: tuple[Link, ...] = ()
    gravity: Any = 0.0
    torques: tuple[Any, ...] = ()
    """net torque of the motors on each link (N m), none without motors"""
    controls: tuple[str, ...] = ()
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def torque(self, link: int) -> Any:
        """Net torque of the motors on a link, in N m."""
        return self.torques[link] if self.torques else 0.0


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
    return [*map(float, numbers)]


def chain_system(
    links: int,
    length: Numbers = 1.0,
    mass: Numbers = 1.0,
    inertia: Numbers | None = None,
    com: Numbers = 0.5,
    *,
    gravity: float = 9.8,
    formulation: str = "recursive",
    motors: Sequence[int] = (),
    limits: Limits | None = None,
    joints: int | None = None,
) -> Entries:
    """The plain description (JSON) that a chain is built from, checked."""
    if isinstance(links, bool) or not isinstance(links, (int, np.integer)) or links < 1:
        raise InputError(f"links: must be a whole number of at least 1, got {links!r}; give the number of links")
    if not isinstance(gravity, (int, float, np.number)) or not np.isfinite(gravity):
        raise InputError(f"gravity: must be finite, got {gravity!r}; use 9.8 on Earth, 0 for none")
    count = int(links)
    system: Entries = {
        "kind": "chain",
        "links": count,
        "length": per_link("length", length, count, 0.0),
        "mass": per_link("mass", mass, count, 0.0),
        "com": per_link("com", com, count, -np.inf),
        "gravity": float(gravity),
        "formulation": formulation,
    }
    if numbers := checked_motors(motors, joints or count):
        system["motors"] = numbers
    if limits:
        known = [f"{TORQUE}{k}" for k in numbers]
        system["limits"] = {name: list(pair) for name, pair in checked_limits(limits, known).items()}
    if inertia is not None:
        system["inertia"] = per_link("inertia", inertia, count, 0.0, inclusive=True)
        lever = [m * (c * s) ** 2 for m, c, s in zip(system["mass"], system["com"], system["length"], strict=True)]
        if any(i == 0 and level == 0 for i, level in zip(system["inertia"], lever, strict=True)):
            raise InputError(
                "inertia: a link with inertia 0 and com 0 has no resistance to rotation; "
                "give it an inertia or move its centre of mass off the joint"
            )
    return system


def chain_symbols(system: Entries) -> ChainSymbols:
    """Symbols and link expressions for a chain; a default inertia follows mass and length."""
    count = system["links"]
    fields = [name for name in ("length", "mass", "inertia", "com") if name in system]
    controls = [f"{TORQUE}{k}" for k in system.get("motors", ())]
    names = [*(f"{name}{i + 1}" for name in fields for i in range(count)), *controls, "gravity"]
    values = [value for name in fields for value in system[name]] + [0.0] * len(controls) + [system["gravity"]]
    parameters = ca.SX.sym("p", len(names))
    columns = {name: parameters[k * count : (k + 1) * count] for k, name in enumerate(fields)}
    links = []
    for i in range(count):
        length, mass = columns["length"][i], columns["mass"][i]
        inertia = columns["inertia"][i] if "inertia" in columns else mass * length**2 / 12
        links.append(Link(length, mass, inertia, columns["com"][i] * length))
    moments = {joint: parameters[names.index(f"{TORQUE}{joint}")] for joint in system.get("motors", ())}
    # a motor at joint k turns link k against link k - 1 (joint 1: against the ground)
    turned = [moments.get(k, 0.0) - moments.get(k + 1, 0.0) for k in range(1, count + 1)]
    return ChainSymbols(
        ca.SX.sym("theta", count), ca.SX.sym("thetadot", count), parameters,
        tuple(names), tuple(values), links=tuple(links), gravity=parameters[-1],
        torques=tuple(turned) if moments else (), controls=tuple(controls),
        limits=checked_limits(system.get("limits", {}), controls),
    )  # fmt: skip


def directions(angle: Any) -> tuple[Any, Any]:
    """e (along the link) and n (across it) for an angle from the downward vertical."""
    cosine, sine = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(cosine, sine), ca.vertcat(-sine, cosine)


def cross(arm: Any, force: Any) -> Any:
    """Moment arm x force of two plane vectors (2 each), a scalar."""
    return arm[0] * force[1] - arm[1] * force[0]


def geometry(symbols: ChainSymbols) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Joints (2 x n+1, m, the first is the fixed one), centres of mass (2 x n, m) and their velocities (2 x n, m/s)."""
    joints, centres, velocities, joint_velocity = [ca.SX.zeros(2)], [], [], ca.SX.zeros(2)
    for i, link in enumerate(symbols.links):
        along, across = directions(symbols.coordinates[i])
        rate = symbols.velocities[i]
        centres.append(joints[-1] + link.offset * along)
        velocities.append(joint_velocity + link.offset * rate * across)
        joints.append(joints[-1] + link.length * along)
        joint_velocity = joint_velocity + link.length * rate * across
    return ca.horzcat(*joints), ca.horzcat(*centres), ca.horzcat(*velocities)


def chain_energies(symbols: ChainSymbols) -> tuple[ca.SX, ca.SX]:
    """Kinetic energy sum 1/2 m v_G.v_G + 1/2 I w^2 and potential energy -sum m g x_G, in J."""
    _, centres, velocities = geometry(symbols)
    kinetic, potential = ca.SX(0), ca.SX(0)
    for i, link in enumerate(symbols.links):
        kinetic += 0.5 * link.mass * ca.sumsqr(velocities[:, i]) + 0.5 * link.inertia * symbols.velocities[i] ** 2
        potential -= link.mass * symbols.gravity * centres[0, i]
    return kinetic, potential


def chain_model(symbols: ChainSymbols, system: Entries, acceleration: ca.Function) -> Model:
    """A chain's Model around accelerations a(t, q, v, p), whichever way they were derived."""
    q, v, p = symbols.coordinates, symbols.velocities, symbols.parameters
    kinetic, potential = chain_energies(symbols)
    joints, centres, _ = geometry(symbols)
    turn, invariants = ca.SX.ones(q.numel()), [energy_invariant(kinetic, potential, q, v, p)]
    if symbols.parameter_values[-1] == 0.0:  # without gravity sum_i dT/dthetadot_i too, about the fixed joint
        invariants.append(
            Invariant(
                "angular_momentum",
                ca.Function("angular_momentum", [q, v, p], [ca.sum1(ca.gradient(kinetic, v))]),
                ca.Function("angular_momentum_unfolding", [q, v, p], [turn]),
                ca.Function("rotation", [q, v, p], [ca.vertcat(turn, ca.SX.zeros(q.numel()))]),
            )
        )
    return mechanical_model(
        acceleration,
        Terms(kinetic, potential, actuation=ca.vertcat(*symbols.torques) if symbols.torques else None),
        symbols,
        [f"theta{i + 1}" for i in range(len(symbols.links))],
        invariants=invariants,
        system=system,
        angles=(True,) * len(symbols.links),
        points=ca.Function("points", [q, p], [joints]),
        centres=ca.Function("centres", [q, p], [centres]),
        controls=symbols.controls,
        limits=symbols.limits,
        apart=chain_apart(symbols),
    )


def chain_apart(symbols: ChainSymbols) -> ca.Function:
    """The accelerations as those by which torques at other angles, q0, move what balances others, a0 (see `Dynamics`).

    da = -M^-1 dr at r(q, v, a) = 0, M^-1 being that of the recursion: some 32 numbers a link stand for da/d(q, v).
    """
    held = [ca.SX.sym(name, len(symbols.links)) for name in ("q0", "v0", "a0")]
    torques = tuple(-torque for torque in unbalanced(symbols, held[2]))
    there = replace(symbols, coordinates=held[0], velocities=held[1], torques=torques)
    return ca.Function("apart", [*symbols.arguments, *held], [recursive_acceleration(there)[0]])


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
    motors: Sequence[int] = (),
    limits: Limits | None = None,
) -> Model:
    """The n-link pendulum as a native DAE: 6n states (q, v), q = (x_G, y_G, theta) of each link.

    The Lagrange multipliers are the forces (2 per joint, N) on each link at its upper joint.

    Args:
        links: number of links n.
        length: m, as for `of.chain`.
        mass: kg, as for `of.chain`.
        inertia: kg m^2 about the centre of mass, as for `of.chain`.
        com: fraction of the length, as for `of.chain`.
        gravity: m/s^2.
        baumgarte: (alpha, beta) in 1/s of the stabilisation; off unless given, as in the report (section 2.2).
        motors: joints with a torque that may vary, as for `of.chain`.
        limits: of these torques, as for `of.chain`.

    Returns:
        A Model with a constraint.

    Raises:
        InputError: for a number that no pendulum has.

    Examples:
        >>> dae = of.chain_dae(2, baumgarte=(5.0, 5.0))
        >>> len(dae.state_names), dae.constraint.force_names
        (12, ('R1x', 'R1y', 'R2x', 'R2y'))

    See Also:
        `of.chain`, whose minimal coordinates have the same motions.
    """
    stabilisation = baumgarte_of(baumgarte, Baumgarte())
    system = chain_system(
        links, length, mass, inertia, com, gravity=gravity, formulation="dae", motors=motors, limits=limits
    )
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
    symbol = symbol_of(constraint.algebraic)
    t, q, v, p = symbol("t"), symbol("q", count), symbol("v", count), symbol("p", model.parameter_values.size)
    state = constraint.lift(q, v, p)
    return ca.Function("acceleration", [t, q, v, p], [constraint.algebraic(t, state[:n], state[n:], p)[2:n:3]])


def maximal_chain(symbols: ChainSymbols, system: Entries, baumgarte: Baumgarte, ground: ca.SX | None = None) -> Model:
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
    drive = [ca.SX(3 * count, 1)] if symbols.torques else []
    for i, moment in enumerate(symbols.torques):
        drive[0][3 * i + 2] = moment
    return constrained_model(
        LinearBalances.of(balances, second, a, reactions),
        position,
        Terms(kinetic, potential, actuation=ca.densify(drive[0]) if drive else None),
        Symbols(q, v, p, symbols.parameter_names, symbols.parameter_values),
        baumgarte,
        [f"{name}{i + 1}" for i in range(count) for name in ("x", "y", "theta")],
        force_names=[f"R{i + 1}{axis}" for i in range(joints) for axis in "xy"],
        angles=(False, False, True) * count,
        points=ca.Function("points", [q, p], [points]),
        centres=ca.Function("centres", [q, p], [q_centres]),
        lift=ca.Function("lift", [angles, rates, p], [lifted]),
        system=system,
        controls=symbols.controls,
        limits=symbols.limits,
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
        rows.append(link.inertia * body.acceleration[2] - moment - symbols.torque(i))
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


def chain(
    links: int,
    length: Numbers = 1.0,
    mass: Numbers = 1.0,
    inertia: Numbers | None = None,
    com: Numbers = 0.5,
    *,
    gravity: float = 9.8,
    formulation: str = "recursive",
    motors: Sequence[int] = (),
    limits: Limits | None = None,
) -> Model:
    """The n-link pendulum that hangs from a fixed joint at the origin.

    The state is x = (theta_1..n, thetadot_1..n) in rad and rad/s, angles from the downward vertical. The potential is
    zero at the fixed joint: V = -sum m g x_G.

    Args:
        links: number of links, 1 to 2000 in files.
        length: length of the links in m, positive, one number or one per link.
        mass: mass of the links in kg, positive, one number or one per link.
        inertia: inertia of the links about their centres of mass in kg m^2, m l^2 / 12 when left out.
        com: centre of mass as a fraction of the length from the upper joint, one number or one per link.
        gravity: gravitational acceleration in m/s^2.
        formulation: how the equations are derived, the motion is the same: recursive (O(n) elimination of the joint
            forces), lagrange (dense mass matrix), newton-euler (balances about the joints) or dae (maximal
            coordinates, reduced to the angles).
        motors: joints with a motor, whose torque (torque1, ... in N m) may vary in time; joint 1 is at the ground,
            joint k turns link k against link k - 1.
        limits: how far controls may go: the greatest magnitude, or [lowest, highest], by name, such as
            { torque1 = 5.0 }.

    Returns:
        A Model with coordinates theta1, theta2, ... and parameters length1, mass1, ..., gravity.

    Raises:
        InputError: for a number that no pendulum has, naming it.

    Examples:
        >>> of.chain(3, length=[1.0, 0.5, 0.5]).state_names
        ('theta1', 'theta2', 'theta3', 'theta1dot', 'theta2dot', 'theta3dot')

    See Also:
        `of.chain_dae` keeps the joints as constraints, `of.linkage` closes the chain.
    """
    if not isinstance(formulation, str) or formulation not in FORMULATIONS:
        raise InputError(f"formulation: unknown {formulation!r}; use one of {', '.join(FORMULATIONS)}")
    system = chain_system(
        links, length, mass, inertia, com, gravity=gravity, formulation=formulation, motors=motors, limits=limits
    )
    symbols = chain_symbols(system)
    return chain_model(symbols, system, FORMULATIONS[formulation](symbols))


def lagrange_chain(symbols: ChainSymbols) -> ca.Function:
    """Accelerations by Lagrange's equations: dense M(q) from the energies."""
    drive = ca.vertcat(*symbols.torques) if symbols.torques else None
    matrix, bias = mass_matrix_and_bias(*chain_energies(symbols), symbols.coordinates, symbols.velocities, drive)
    return acceleration_function(matrix, bias, symbols.arguments)


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
        moment = moment + symbols.torques[i] if symbols.torques else moment
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
    moment, balances = ca.SX(0), list[ca.SX]()
    for own in reversed(unbalanced(symbols, alpha)):
        moment += own
        balances.insert(0, moment)
    return ca.vertcat(*balances)


def unbalanced(symbols: ChainSymbols, alpha: ca.SX) -> list[ca.SX]:
    """The moments (N m each) about its upper joint that a link's accelerations ask for beyond those that act on it,

    I_j alpha_j + r_{Gj/Oj} x m_j (a_Gj - g e_x) + r_{Oj+1/Oj} x the forces on what hangs below.
    """
    inertial = inertial_forces(symbols, alpha)
    force, moments = ca.SX.zeros(2), list[ca.SX]()
    for j in reversed(range(len(symbols.links))):
        link, (along, _) = symbols.links[j], directions(symbols.coordinates[j])
        own = link.inertia * alpha[j] + cross(link.offset * along, inertial[j]) - symbols.torque(j)
        moments.insert(0, own + cross(link.length * along, force))
        force = force + inertial[j]
    return moments


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
    "recursive": lambda symbols: ca.Function("acceleration", symbols.arguments, [recursive_acceleration(symbols)[0]]),
}
"""Every way of deriving a chain's accelerations a(t, q, v, p), by name"""
