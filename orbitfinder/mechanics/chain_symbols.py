"""The vocabulary of every chain: its description, symbols, links, directions, positions and energies.

Angles theta_i are measured from the downward vertical, x points down, y to the right; link i has
e_i = (cos theta_i, sin theta_i) along it and n_i = (-sin theta_i, cos theta_i) across it. The planar cross
product r x f = r_x f_y - r_y f_x is positive from e to n.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.lagrange import Symbols, Terms, energy_invariant, mechanical_model
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
class ChainSymbols(Symbols):
    """Angles and rates (the coordinates and velocities) and parameters of a chain, its links written in them."""

    links: tuple[Link, ...] = ()
    gravity: Any = 0.0


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
        tuple(names), tuple(values), links=tuple(links), gravity=parameters[-1],
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


def chain_invariants(symbols: ChainSymbols, kinetic: ca.SX, potential: ca.SX) -> list[Invariant]:
    """Energy; without gravity also the angular momentum about the fixed joint, sum_i dT/dthetadot_i."""
    q, v, p = symbols.coordinates, symbols.velocities, symbols.parameters
    found = [energy_invariant(kinetic, potential, q, v, p)]
    if symbols.parameter_values[-1] == 0.0:
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


def chain_model(symbols: ChainSymbols, system: dict[str, Any], acceleration: ca.Function) -> Model:
    """A chain's Model around accelerations a(t, q, v, p), whichever way they were derived."""
    q, p = symbols.coordinates, symbols.parameters
    kinetic, potential = chain_energies(symbols)
    joints, centres, _ = geometry(symbols)
    return mechanical_model(
        acceleration,
        Terms(kinetic, potential),
        symbols,
        [f"theta{i + 1}" for i in range(len(symbols.links))],
        invariants=chain_invariants(symbols, kinetic, potential),
        system=system,
        angles=(True,) * len(symbols.links),
        points=ca.Function("points", [q, p], [joints]),
        centres=ca.Function("centres", [q, p], [centres]),
    )
