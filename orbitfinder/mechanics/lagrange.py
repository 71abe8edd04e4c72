"""Lagrange's equations from expressions for the energies, by automatic differentiation."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, shortened
from orbitfinder.mechanics.conserved import MOST, discrepancy, linear_invariants
from orbitfinder.mechanics.controls import Limits, checked_controls, checked_limits, divided
from orbitfinder.mechanics.factorise import acceleration_function
from orbitfinder.mechanics.model import Drive, Dynamics, Invariant, Mechanics, Model, Structure, altered
from orbitfinder.mechanics.scales import with_scales, with_units
from orbitfinder.records.reading import Table


@dataclass(frozen=True)
class Symbols:
    """The CasADi SX symbols that the energies of `of.lagrange` and `of.constrained` are written in.

    Args:
        coordinates: q (n).
        velocities: v (n).
        parameters: physical parameters (k); None for none.
        parameter_names: their names (k).
        parameter_values: their values (k).
        time: t, of systems that depend on it explicitly.
        forcing_period: s, a number or an expression in the parameters: the period of that dependence.

    Raises:
        InputError: where sizes differ or a name comes twice.

    Examples:
        >>> import casadi as ca
        >>> q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
        >>> spring = of.Symbols(q, v, p, ("stiffness",), (30.0,))
        >>> of.lagrange(v**2 / 2, p * q**2 / 2, spring).parameter_names
        ('stiffness',)
    """

    __repr__ = brief("coordinates", "parameter_names")

    coordinates: ca.SX
    velocities: ca.SX
    parameters: ca.SX | None = None
    parameter_names: tuple[str, ...] = ()
    parameter_values: tuple[float, ...] = ()
    time: ca.SX | None = None
    forcing_period: ca.SX | float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("coordinates", "velocities", "parameters", "time"):
            symbols = getattr(self, name)
            if symbols is not None and not (isinstance(symbols, ca.SX) and symbols.is_valid_input()):
                raise InputError(f"{name}: {symbols} is no symbol of its own; make one by ca.SX.sym({name[0]!r}, n)")
        n, rates = self.coordinates.numel(), self.velocities.numel()
        if n != rates:
            raise InputError(f"velocities: {rates} given for {n} coordinates; give one per coordinate")
        count = 0 if self.parameters is None else self.parameters.numel()
        lengths = len(self.parameter_names), len(self.parameter_values)
        if lengths != (count, count):
            raise InputError(
                f"parameter_names, parameter_values: {lengths[0]} names and {lengths[1]} values for {count} "
                "parameters; give one each"
            )

    @property
    def arguments(self) -> list[ca.SX]:
        """t, q, v, p: what every function of a Model is written in, with stand-ins for what is not there."""
        t = ca.SX.sym("t") if self.time is None else self.time
        p = ca.SX(0, 1) if self.parameters is None else self.parameters
        return [t, self.coordinates, self.velocities, p]


@dataclass(frozen=True)
class Terms:
    """A Lagrangian taken apart: kinetic (quadratic in v) + gyroscopic (linear in v) - potential, and forces."""

    kinetic: ca.SX
    potential: ca.SX
    gyroscopic: ca.SX | None = None
    forces: ca.SX | None = None
    actuation: ca.SX | None = None
    """what controls add to the forces"""

    @property
    def all_forces(self) -> ca.SX | None:
        """The forces with what controls add."""
        given = [term for term in (self.forces, self.actuation) if term is not None]
        return sum(given[1:], given[0]) if given else None


def mass_matrix_and_bias(
    kinetic: ca.SX, potential: ca.SX, q: ca.SX, v: ca.SX, forces: ca.SX | None = None, t: ca.SX | None = None
) -> tuple[ca.SX, ca.SX]:
    """M (n x n) and h (n) with M a + h = 0, from L = T - V by the multivariable chain rule.

    d/dt dL/dv = d2L/dv dt + (d2L/dv dq) v + (d2L/dv2) a, hence M = d2L/dv2 and
    h = d2L/dv dt + (d2L/dv dq) v - dL/dq - Q. Source: Goldstein, Classical Mechanics, section 1.4.
    """
    lagrangian = kinetic - potential
    momentum = ca.gradient(lagrangian, v)
    mass_matrix = ca.jacobian(momentum, v)
    bias = ca.jtimes(momentum, q, v) - ca.gradient(lagrangian, q)
    if t is not None:
        bias += ca.jacobian(momentum, t)
    return mass_matrix, bias if forces is None else bias - forces


def take_apart(kinetic: ca.SX, potential: ca.SX, forces: ca.SX | None, arguments: Sequence[ca.SX]) -> Terms:
    """The terms of L = T - V in (t, q, v, p) that the rest of the library works with.

    T = T2 + T1 + T0 by powers of v. Autonomous: T2 stays, T1 is gyroscopic and V - T0 the potential,
    so that T2 + V - T0 is the Jacobi integral v.dL/dv - L (Goldstein, section 2.7). What depends on
    time becomes a force: with h the bias of all terms and h0 that of T2 and V at t = 0, Q = h0 - h.
    """
    t, q, v, _ = arguments
    nothing = ca.SX.zeros(v.numel())
    rest = ca.substitute(kinetic, v, nothing)
    slope = ca.substitute(ca.gradient(kinetic, v), v, nothing)
    if ca.depends_on(ca.vertcat(kinetic, potential), t):
        mass = ca.hessian(kinetic, v)[0]
        if ca.depends_on(mass, t):
            raise InputError("kinetic: its terms quadratic in v depend on time; only the linear and constant ones may")
        steady = Terms(0.5 * ca.dot(v, mass @ v), ca.substitute(potential, t, ca.SX(0)))
        moving = mass_matrix_and_bias(kinetic, potential, q, v, forces, t)[1]
        return Terms(steady.kinetic, steady.potential, None,
                     mass_matrix_and_bias(steady.kinetic, steady.potential, q, v)[1] - moving)  # fmt: skip
    if slope.is_zero() and rest.is_zero():
        return Terms(kinetic, potential, None, forces)
    gyroscopic = None if slope.is_zero() else ca.dot(slope, v)
    return Terms(0.5 * ca.dot(v, ca.hessian(kinetic, v)[0] @ v), potential - rest, gyroscopic, forces)


def energy_invariant(kinetic: ca.SX, potential: ca.SX, q: ca.SX, v: ca.SX, p: ca.SX) -> Invariant:
    """Energy as an invariant, unfolded by fictitious damping: a += s v, so dE/dt = s v.M v."""
    return Invariant(
        "energy",
        ca.Function("energy", [q, v, p], [kinetic + potential]),
        ca.Function("energy_unfolding", [q, v, p], [v]),
    )


MANY = 6
"""From so many further coordinates on the momentum of their common shift is named by the first and the last"""


def detected_invariants(
    terms: Terms, labels: Sequence[str], arguments: Sequence[ca.SX], cyclic: Sequence[bool] | None = None,
    angles: Sequence[bool] = (), declared: Mapping[str, ca.SX] | None = None, values: Sequence[float] = (),
) -> list[Invariant]:  # fmt: skip
    """Energy where no force acts, and the momentum dL/dv.g of each direction g(q) along which L stays what it is and no
    force acts: of each coordinate that L does not contain or, if that is given, is `cyclic`; else also of shifts of
    several coordinates and rotations of those that are no `angles`: dL/dq.g + dL/dv.(dg/dq v) = 0 for all (t, q, v, p).

    Directions that are `declared` are tried about `values` of the parameters and stand for those that say the same.
    Source: Goldstein, Classical Mechanics, sections 2.6 and 13.7. Raises `InputError`.
    """
    _, q, v, p = arguments
    lagrangian = terms.kinetic - terms.potential + (0 if terms.gyroscopic is None else terms.gyroscopic)
    invariants = [] if terms.forces is not None else [energy_invariant(terms.kinetic, terms.potential, q, v, p)]
    momentum, unit = ca.gradient(lagrangian, v), ca.SX(ca.DM.eye(len(labels)))
    force = ca.SX.zeros(len(labels)) if terms.forces is None else ca.SX(terms.forces)
    tried, directions = dict[str, ca.SX](), dict[str, ca.SX]()
    lengths = [i for i, angle in enumerate(angles) if not angle]
    few = len(lengths) * (len(lengths) - 1) // 2 + len(labels) <= MOST
    for i, j in combinations(lengths, 2) if few else ():
        tried[f"angular_momentum_{labels[i]}_{labels[j]}"] = unit[:, j] * q[i] - unit[:, i] * q[j]
    for i, label in enumerate(labels):
        if force[i].is_zero() and (cyclic[i] if cyclic is not None else not ca.depends_on(lagrangian, q[i])):
            directions[f"momentum_{label}"] = unit[:, i]
        elif cyclic is None and len(labels) <= MOST:
            tried[f"momentum_{label}"] = unit[:, i]
    share, slope = ca.SX.sym("share"), ca.gradient(lagrangian, q)
    changes = [ca.dot(slope + share * force, g) + ca.dot(momentum, ca.jtimes(g, q, v)) for g in tried.values()]
    known = linear_invariants([*arguments, share], ca.vertcat(*changes)) if tried else []
    named = [[name for name, part in zip(tried, parts, strict=True) if part] for parts in known]
    alone = sum(first.startswith("angular") for first, *_ in named) == 1
    for parts, (first, *others) in zip(known, named, strict=True):
        moved = [name.removeprefix("momentum_") for name in others]
        shift = "_".join([first, *(moved if len(moved) < MANY else ["to", moved[-1]])])
        turn = "angular_momentum" if alone else first
        directions[turn if first.startswith("angular") else shift] = ca.mtimes(
            ca.horzcat(*tried.values()), ca.DM(parts)
        )
    own, kept = {name: ca.SX(each) for name, each in (declared or {}).items()}, dict[str, ca.SX]()
    for name, along in own.items():
        if along.shape != q.shape or strangers(along, [q, p]):
            raise InputError(f"symmetries: {name!r} is {shortened(str(along))}; give {len(labels)} expressions of "
                             "coordinates and parameters")  # fmt: skip
        ways = ca.horzcat(((slope + share * force) * along).T, (momentum * ca.jtimes(along, q, v)).T)
        if off := discrepancy([*arguments[:3], share, p], ways, values):
            raise InputError(f"symmetries: along {name!r} the Lagrangian changes, or forces act, by {off}; correct its "
                             "generator, or leave it out")  # fmt: skip
    for name, along in (*own.items(), *directions.items()) if own else ():
        levels = [ca.dot(momentum, each) for each in (*kept.values(), along)]
        if not linear_invariants(arguments, ca.vertcat(*levels)):
            kept[name + "_2" * (name in kept)] = along
        elif along is own.get(name):
            raise InputError(f"symmetries: {name!r} moves nothing, or as others do; leave it out")
    for name, along in (kept or directions).items():
        along, fit = ca.densify(along), ca.Function.fix_name
        made = {"": ca.dot(momentum, along), "_unfolding": along, "_shift": ca.vertcat(along, ca.jtimes(along, q, v))}
        functions = (ca.Function(fit(f"{name}{word}"), [q, v, p], [value]) for word, value in made.items())
        invariants.append(Invariant(name, *functions))
    return invariants


def mirrors(
    symmetries: Mapping[str, tuple[int, Mapping[str, int]]], names: Sequence[str]
) -> tuple[tuple[str, int, tuple[int, ...]], ...]:
    """Declared symmetries {name: (sense of time, {component: sign})} as a Model keeps them. Raises `InputError`."""
    for name, (sense, moved) in symmetries.items():
        signs = [sense, *moved.values()]
        if -1 not in signs or any(sign not in (1, -1) for sign in signs) or moved.keys() - {*names}:
            raise InputError(f"symmetries: {name!r} has the sense of time {sense!r} and the signs {moved}; give 1 or "
                             f"-1 of components ({', '.join(names)}), not 1 throughout")  # fmt: skip
    return tuple((name, int(sense), tuple(int(moved.get(each, 1)) for each in names))
                 for name, (sense, moved) in symmetries.items())  # fmt: skip


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
    strokes: Sequence[tuple[str, tuple[int, ...]]] = (),
    system: Table | None = None,
    symmetries: Mapping[str, Sequence[int]] | None = None,
    generators: Mapping[str, ca.SX] | None = None,
    scales: Mapping[str, float] | None = None,
    controls: Sequence[str] = (),
    limits: Limits | None = None,
    units: Mapping[str, str] | None = None,
) -> Model:
    """The Model of a system given by its kinetic and its potential energy, CasADi SX expressions.

    Lagrange: d/dt dL/dv - dL/dq = Q with L = T(t, q, v, p) - V(t, q, p). T may have terms linear in v (moving pivots,
    rotating frames). First integrals are detected: the Jacobi integral ("energy") when Q and time are absent, and the
    momenta of shifts and rotations of coordinates that leave L as it is, whichever values the parameters have.

    Args:
        kinetic: T in J, quadratic in the velocities.
        potential: V in J.
        symbols: the coordinates, velocities, parameters and time that T and V are written in.
        forces: generalized forces Q(t, q, v, p) (n), in J per unit of each coordinate.
        names: of the coordinates (q1, q2, ...); their rates get a trailing "dot".
        angles: which coordinates (n) are angles, so that they may turn; none unless said.
        invariants: first integrals in place of the detected ones, `()` for none; `of.find_orbit` checks their drift.
        points: positions (2 x k, m; x down, y right) that pictures draw; in space 3 x k, z towards the eye.
        centres: centres of mass (2 x k, m).
        strokes: what is drawn through which of the points: rod, spring, ground, slider, disc.
        system: a description from which files rebuild the Model.
        symmetries: reversals (q_i, t) -> (s_i q_i, -t) by name, {"mirror": (1, -1)}: orbits that have one are
            labelled, found over half a period and searched for; the equations are tried when one is asked for.
        generators: directions g(q, p) (n) in which L stays as it is and no force acts, whose momenta dL/dv.g join those
            that are detected by these names.
        scales: sizes to measure in, of coordinates and parameters by name or "length" of all coordinates that are no
            angles, where no motion shows them yet (modes, searches).
        controls: parameters that may vary in time.
        limits: of the controls: greatest magnitude, or lowest and highest, by name.
        units: words for time, length, mass, angle, or a state or parameter by name ("ms", "mN"); nothing is converted.

    Returns:
        A Model.

    Raises:
        InputError: when an energy is no scalar, depends on a foreign symbol, or T is not quadratic in all velocities.

    Examples:
        >>> import casadi as ca
        >>> q, v = ca.SX.sym("q"), ca.SX.sym("v")
        >>> rod = of.lagrange(v**2 / 2, -9.8 * ca.cos(q), of.Symbols(q, v), names=["theta"], angles=[True])
        >>> of.energy(rod, [0.0, 1.0])
        -9.3...

    See Also:
        `of.constrained` with constraints, `of.hamiltonian` from H, `of.from_sympy` from SymPy's mechanics.
    """
    labels, turning = coordinate_names(names, symbols), coordinate_angles(angles, symbols)
    arguments = symbols.arguments
    _, q, v, p = arguments
    _check_energies(kinetic, potential, forces, arguments)
    passive, drive = divided(forces, p, controls, symbols.parameter_names, symbols.parameter_values)
    terms = replace(take_apart(ca.SX(kinetic), ca.SX(potential), passive, arguments), actuation=drive)
    lagrangian = terms.kinetic if terms.gyroscopic is None else terms.kinetic + terms.gyroscopic
    matrix, bias = mass_matrix_and_bias(lagrangian, terms.potential, q, v, terms.all_forces)
    model = mechanical_model(
        acceleration_function(matrix, bias, arguments),
        terms,
        symbols,
        labels,
        invariants=detected_invariants(terms, labels, arguments, None, turning, generators, symbols.parameter_values)
        if invariants is None
        else invariants,
        system=system,
        angles=turning,
        **pictured(points, [q, p]),
        centres=polyline("centres", centres, [q, p]),
        symmetries=_reversals(symmetries or {}, q.numel()),
        controls=controls,
        limits=limits,
    )
    return with_units(with_scales(altered(model, strokes=tuple(strokes)), scales), units)


def _reversals(symmetries: Mapping[str, Sequence[int]], count: int) -> tuple[tuple[str, int, tuple[int, ...]], ...]:
    """Declared reversals as a Model keeps them; `InputError` unless each has a sign for every coordinate."""
    for name, signs in symmetries.items():
        if len(signs) != count or not set(signs) <= {1, -1} or len(set(signs)) < min(count, 2):
            raise InputError(
                f"symmetries: {name!r} is {list(signs)}; give 1 or -1 for each of {count} coordinates, not all alike "
                "(those need no declaration)"
            )
        if not name.replace("-", "_").isidentifier():
            raise InputError(f"symmetries: {name!r} is no name; use letters, digits, - and _")
    return tuple((name, -1, tuple(map(int, signs))) for name, signs in symmetries.items())


def mechanical_model(
    acceleration: ca.Function,
    terms: Terms,
    symbols: Symbols,
    names: Sequence[str],
    *,
    invariants: Sequence[Invariant],
    system: Table | None = None,
    controls: Sequence[str] = (),
    limits: Limits | None = None,
    **parts: Any,
) -> Model:
    """The Model of accelerations a(t, q, v, p) and of the Lagrangian's terms; other `parts` go in as they are."""
    arguments, clock = symbols.arguments, symbols.forcing_period
    _, q, v, p = arguments
    model = Model(
        dict(system or {"kind": "custom"}),
        Dynamics(
            (*names, *(f"{name}dot" for name in names)), tuple(symbols.parameter_names),
            np.asarray(symbols.parameter_values, float), acceleration,
            forcing_period=None if clock is None else ca.Function("forcing_period", [p], [ca.SX(clock)]),
        ),
        Mechanics(
            ca.Function("kinetic", [q, v, p], [terms.kinetic]), ca.Function("potential", [q, p], [terms.potential]),
            None if terms.forces is None else ca.Function("forces", arguments, [terms.forces]),
            None if terms.gyroscopic is None else ca.Function("gyroscopic", [q, v, p], [terms.gyroscopic]),
        ),
        Structure(tuple(invariants)),
        drive=Drive(
            checked_controls(controls, symbols.parameter_names), checked_limits(limits or {}, controls),
            None if terms.actuation is None else ca.Function("actuation", arguments, [terms.actuation]),
        ),
    )  # fmt: skip
    return altered(model, **parts)


def coordinate_names(names: Sequence[str] | None, symbols: Symbols) -> tuple[str, ...]:
    """Names of the coordinates, q1, q2, ... without any; `InputError` unless one each, and none twice or taken."""
    count = symbols.coordinates.numel()
    names = [f"q{i + 1}" for i in range(count)] if names is None else names
    if len(names) != count:
        raise InputError(f"names: {len(names)} given for {count} coordinates, {list(names)}; give one per coordinate")
    everything = [*names, *(f"{name}dot" for name in names), *symbols.parameter_names, "energy", "period"]
    twice = sorted(name for name, count in Counter(everything).items() if count > 1)
    if twice:
        raise InputError(
            f"names: {', '.join(map(repr, twice))} would name two things (rates get a trailing 'dot', parameters have "
            f"names too, 'energy' and 'period' are taken), got {shortened(str(list(names)), 80)}; give different ones"
        )
    return tuple(names)


def coordinate_angles(angles: Sequence[bool] | None, symbols: Symbols) -> tuple[bool, ...]:
    """Which coordinates are angles, none without a word; `InputError` unless one answer each."""
    count = symbols.coordinates.numel()
    if angles is not None and len(angles) != count:
        raise InputError(f"angles: {len(angles)} given for {count} coordinates; give True or False for each")
    return (False,) * count if angles is None else tuple(bool(angle) for angle in angles)


def strangers(expression: ca.SX, known: Sequence[ca.SX]) -> list[str]:
    """Symbols of an expression that are not among the known ones."""
    return [str(symbol) for symbol in ca.symvar(expression) if not ca.depends_on(ca.vertcat(*known), symbol)]


def polyline(name: str, expression: ca.SX | None, arguments: Sequence[ca.SX]) -> ca.Function | None:
    """Positions (2 x k) as a Function of (q, p), or none. Raises `InputError`."""
    if expression is None:
        return None
    if ca.SX(expression).shape[0] != 2:
        raise InputError(
            f"{name}: shape {ca.SX(expression).shape}; give 2 x k, x down and y right in each column: ca.horzcat of "
            "ca.vertcat(x, y); of points in space 3 x k"
        )
    return ca.Function(name, list(arguments), [expression])


ISOMETRIC = np.array([[1.0, 0.5, 0.5], [0.0, np.sqrt(0.75), -np.sqrt(0.75)]])
"""(down, right) of (x, y, z) in the flat pictures of what moves in space"""


def pictured(points: ca.SX | None, arguments: Sequence[ca.SX]) -> dict[str, ca.Function | None]:
    """The parts of a Model that `points` in the plane (2 x k) or in space (3 x k) give. Raises `InputError`."""
    if points is None or ca.SX(points).shape[0] != 3:
        return {"points": polyline("points", points, arguments)}
    flat = ca.mtimes(ISOMETRIC, ca.densify(ca.SX(points)))
    return {"points": polyline("points", flat, arguments), "space": ca.Function("space", [*arguments], [points])}


def _check_energies(kinetic: ca.SX, potential: ca.SX, forces: ca.SX | None, arguments: Sequence[ca.SX]) -> None:
    t, q, v, p = arguments
    for name, value in (("kinetic", kinetic), ("potential", potential)):
        if ca.SX(value).numel() != 1:
            raise InputError(f"{name}: expected a scalar expression, got shape {ca.SX(value).shape}")
    if forces is not None and ca.SX(forces).shape != (q.numel(), 1):
        raise InputError(f"forces: shape {ca.SX(forces).shape} for {q.numel()} coordinates; give one per coordinate")
    allowed = {"kinetic": "t, q, v and p", "potential": "t, q and p", "forces": "t, q, v and p"}
    for name, value, known in (
        ("kinetic", kinetic, arguments), ("potential", potential, [t, q, p]), ("forces", forces, arguments)
    ):  # fmt: skip
        if value is not None and (stray := strangers(ca.SX(value), known)):
            raise InputError(f"{name}: depends on {', '.join(stray)}; it may depend on {allowed[name]} only")
    hessian = ca.hessian(ca.SX(kinetic), v)[0]
    if ca.depends_on(hessian, v):
        raise InputError("kinetic: not quadratic in the velocities; write T = 1/2 v.M(q) v + ...")
    if ca.sprank(hessian) < v.numel():
        idle = [str(v[i]) for i in range(v.numel()) if hessian[i, :].is_zero()]
        raise InputError(
            f"kinetic: no mass moves with {', '.join(idle) or 'some combination of velocities'}; every velocity needs "
            "its term in T = 1/2 v.M(q) v. A first-order system q' = f(q) has none: take T = v^2 / 2 and the forces "
            "(df/dq) v - k (v - f), k > 0, whose motions on v = f are its own"
        )
