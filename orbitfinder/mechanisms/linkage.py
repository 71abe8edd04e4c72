"""Closed planar chains of bars (four-bar, five-bar, ...) as native DAEs, their assembly, and minimal coordinates.

A linkage of n bars is the chain of n links whose tip is pinned to the ground at (x, y), x down and
y right, by two more reaction forces and two more constraints. The first joint is at the origin, the
ground is not counted as a bar here: three links make a four-bar. It has n - 2 degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.constrained import RANK_TOLERANCE, Loops, by_place, maximal_states
from orbitfinder.mechanics.controls import Limits
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import Baumgarte, Model, check_state, constraint_of
from orbitfinder.mechanics.newton import Settings, closed
from orbitfinder.mechanisms.chain import Numbers, baumgarte_of, chain_symbols, chain_system, maximal_chain
from orbitfinder.records.reading import Table

CLOSING = Settings(floor=1e-13, round_off=1e-13, converged=1e-13, longest=0.5)
"""How an assembly is closed: gaps over the perimeter, steps in rad"""
REACH_TOLERANCE = 1e-12
"""relative excess over the reach that is taken for round-off"""


def linkage(
    length: Sequence[float] | np.ndarray,
    mass: Numbers = 1.0,
    ground: Sequence[float] = (0.0, 1.0),
    inertia: Numbers | None = None,
    com: Numbers = 0.5,
    *,
    gravity: float = 9.8,
    baumgarte: Baumgarte | Sequence[float] | None = None,
    motors: Sequence[int] = (),
    limits: Limits | None = None,
) -> Model:
    """A closed chain of n bars from the origin to a ground pivot, as a native DAE.

    q = (x_G, y_G, theta) of each bar; the Lagrange multipliers are the forces (2 per joint, N) on each bar at its
    upper joint, the last pair on the ground at its pivot. Source: the report, section 3.

    Args:
        length: length of the bars in m, positive, 2 to 40 of them in files; three and the ground are a four-bar.
        mass: mass of the bars in kg, positive, one number or one per bar.
        ground: position [x, y] in m of the pivot at the end of the last bar, x down, y right; the first is at 0.
        inertia: inertia of the bars about their centres of mass in kg m^2, m l^2 / 12 when left out.
        com: centre of mass as a fraction of the length from the upper joint, one number or one per bar.
        gravity: gravitational acceleration in m/s^2.
        baumgarte: stabilisation [alpha, beta] of the constraints in 1/s, both positive; 10 each when left out.
        motors: joints with a motor, whose torque (torque1, ... in N m) may vary in time; 1 is the first pivot, n + 1
            the last.
        limits: how far controls may go: the greatest magnitude, or [lowest, highest], by name, such as
            { torque1 = 5.0 }.

    Returns:
        A Model with a constraint.

    Raises:
        InputError: for a linkage that cannot be assembled.

    Examples:
        >>> four_bar = of.linkage([0.5, 1.2, 1.0], ground=(0.2, 1.0))
        >>> of.linkages.assemble(four_bar, {"theta1": 0.6}).round(4)
        array([ 0.6   ,  0.8786, -2.9339])

    See Also:
        `of.mechanism` for bodies and joints of every kind.
    """
    lengths = np.atleast_1d(np.asarray(length, float))
    if lengths.ndim != 1 or lengths.size < 2:
        raise InputError(f"length: a linkage has one number per bar and at least 2 bars, got {length!r}")
    pivot = np.asarray(ground, float)
    if pivot.shape != (2,) or not np.all(np.isfinite(pivot)):
        raise InputError(f"ground: need the two coordinates of the far pivot (x down, y right, m), got {ground!r}")
    system = chain_system(
        lengths.size,
        lengths,
        mass,
        inertia,
        com,
        gravity=gravity,
        motors=motors,
        limits=limits,
        joints=lengths.size + 1,
    )
    for absent in ("links", "formulation"):
        del system[absent]
    # phi decays within a few tenths of a second, much faster than a linkage of metres moves
    stabilisation = baumgarte_of(baumgarte, Baumgarte(10.0, 10.0))
    system |= {
        "kind": "linkage",
        "ground": pivot.tolist(),
        "baumgarte": [stabilisation.alpha, stabilisation.beta],
    }
    check_closable(lengths, pivot)
    symbols = chain_symbols({**system, "links": len(system["length"])})
    symbols = replace(  # with the ground pivot as two more parameters
        symbols, parameters=ca.vertcat(symbols.parameters, ca.SX.sym("ground", 2)),
        parameter_names=(*symbols.parameter_names, "ground1", "ground2"),
        parameter_values=(*symbols.parameter_values, *system["ground"]),
    )  # fmt: skip
    return maximal_chain(symbols, system, stabilisation, ground=symbols.arguments[-1][-2:])


def check_closable(lengths: np.ndarray, ground: np.ndarray) -> None:
    """`InputError` unless the polygon of bars and ground closes: no side longer than all others together."""
    sides = np.append(lengths, np.linalg.norm(ground))
    longest = int(np.argmax(sides))
    others = float(sides.sum() - sides[longest])
    if sides[longest] > others * (1 + REACH_TOLERANCE):
        name = f"length{longest + 1}" if longest < lengths.size else "the distance between the ground pivots"
        raise InputError(
            f"linkage: cannot be assembled, {name} = {sides[longest]:.6g} m exceeds the sum of all other sides, "
            f"{others:.6g} m (polygon inequality); shorten it by more than {sides[longest] - others:.6g} m "
            "or lengthen the others"
        )


def dimensions(model: Model, parameters: Any = None) -> tuple[Any, Any]:
    """Bar lengths (n) and ground pivot (2) of a linkage, in m, among its values or other `parameters` (symbols)."""
    if "ground" not in model.system:
        given = model.system.get("kind")
        raise InputError(f"model: expected a linkage, got kind {given!r}; build it with linkage(...)")
    lengths = [model.parameter_index(f"length{i + 1}") for i in range(len(model.system["length"]))]
    ground = [model.parameter_index(name) for name in ("ground1", "ground2")]
    p = model.parameter_values if parameters is None else parameters
    return p[lengths], p[ground]


def closure_jacobian(lengths: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Derivative (2 x n) of the tip's position sum l_i e_i with respect to the angles: columns l_i n_i."""
    return np.asarray(lengths * np.array([-np.sin(theta), np.cos(theta)]))


def check_regular(lengths: np.ndarray, theta: np.ndarray) -> None:
    """`InputError` at a change-point configuration: all bars on one line, the closure loses rank."""
    values = np.linalg.svd(closure_jacobian(lengths, theta), compute_uv=False)
    if values[-1] < RANK_TOLERANCE * values[0]:
        raise InputError(
            "linkage: change-point configuration, all bars lie on one line at theta = "
            f"{np.array2string(theta, precision=6)} (singular values of the closure {values[0]:.3g} "
            f"and {values[-1]:.3g}), so the motion is not determined; "
            "start from another configuration or change a length slightly"
        )


def joint_forces(model: Model, state: np.ndarray) -> np.ndarray:
    """Reaction forces (2 x joints, N) at one state (2n): on each link at its upper joint, x down, y right.

    For a linkage the last column is the force on the ground at its pivot.
    """
    x, n = check_state(model, state), model.degrees_of_freedom
    z = constraint_of(model).algebraic(0.0, x[:n], x[n:], model.parameter_values).full().ravel()
    return np.asarray(z[n:].reshape(-1, 2).T)


def linkage_state(model: Model, theta: np.ndarray, rates: np.ndarray | None = None) -> np.ndarray:
    """State (6n) of a linkage at angles (n, rad) and rates (n, rad/s; at rest without them)."""
    speeds = np.zeros(len(theta)) if rates is None else rates
    return maximal_states(model, np.concatenate([theta, speeds]))


def assemble(
    model: Model,
    known: Mapping[str, float],
    branch: int | None = None,
    guess: Sequence[float] | np.ndarray | None = None,
) -> np.ndarray:
    """All angles (n, rad) of a linkage from some, e.g. `assemble(fourbar, {"theta1": 0.3}, branch=+1)`.

    Closure: sum l_i (cos theta_i, sin theta_i) = ground. With n - 2 known angles the two others
    follow from the intersection of two circles, and `branch` is the sign of sin(theta_j - theta_i),
    i < j the unknown bars (default +1, or the one nearer to `guess`). With fewer, the nearest
    configuration to `guess` (n, rad) is found by Gauss-Newton. Raises `InputError` when the rest
    cannot reach, or at a change-point.
    """
    lengths, ground = dimensions(model)
    fixed = by_place(known, [f"theta{i + 1}" for i in range(lengths.size)], "angle", "linkage")
    if len(fixed) > lengths.size - 2:
        raise InputError(
            f"assemble: {len(fixed)} angles given, but {lengths.size} bars have {lengths.size - 2} degrees of freedom; "
            f"give at most {lengths.size - 2}"
        )
    start = None if guess is None else np.asarray(guess, float)
    if start is not None and (start.shape != (lengths.size,) or not np.all(np.isfinite(start))):
        raise InputError(f"guess: need {lengths.size} finite angles in rad, got {guess!r}")
    if branch is not None and branch not in (1, -1):
        raise InputError(f"branch: must be +1 or -1, the sign of sin(theta_j - theta_i), got {branch!r}")
    if len(fixed) == lengths.size - 2:
        theta = _dyad(model, fixed, branch, start)
    elif start is None:
        raise InputError(
            f"assemble: {len(fixed)} angles given for {lengths.size - 2} degrees of freedom; give more, or guess="
        )
    else:
        theta = _nearest(lengths, ground, fixed, start)
    check_regular(lengths, theta)
    return theta


def linkage_rates(model: Model, theta: np.ndarray, known: Mapping[str, float]) -> np.ndarray:
    """All rates (n, rad/s) from n - 2 of them, e.g. `{"theta1dot": 2.0}`; a four-bar needs one.

    sum l_i n_i thetadot_i = 0. Raises `InputError` at a change-point, or at a dead point of the
    given bars (the two others in line), where another bar's rate must be given.
    """
    lengths, _ = dimensions(model)
    angles = np.asarray(theta, float)
    given = by_place(known, [f"theta{i + 1}dot" for i in range(lengths.size)], "rate", "linkage")
    if len(given) != lengths.size - 2:
        raise InputError(
            f"linkage_rates: {len(given)} rates given for {lengths.size - 2} degrees of freedom; give exactly that many"
        )
    check_regular(lengths, angles)
    jacobian = closure_jacobian(lengths, angles)
    rest = [i for i in range(lengths.size) if i not in given]
    values = np.linalg.svd(jacobian[:, rest], compute_uv=False)
    if values[-1] < RANK_TOLERANCE * values[0]:
        raise InputError(
            f"linkage_rates: dead point, bars {rest[0] + 1} and {rest[1] + 1} are in line, so the rates of the others "
            f"do not determine theirs; give theta{rest[0] + 1}dot or theta{rest[1] + 1}dot instead"
        )
    rates = np.zeros(lengths.size)
    for i, rate in given.items():
        rates[i] = rate
    rates[rest] = np.linalg.solve(jacobian[:, rest], -jacobian @ rates)
    return rates


def _put_together(
    model: Model, known: Any = None, rates: Any = None, near: np.ndarray | None = None, branch: int | None = None
) -> np.ndarray:
    """The state (6n) at some angles (see `assemble`) and rates (see `linkage_rates`; at rest without)."""
    if known is None and near is None:
        near = np.linspace(1.0, -1.0, dimensions(model)[0].size)
    theta = assemble(model, known or {}, branch, near)
    return linkage_state(model, theta, linkage_rates(model, theta, rates) if rates else None)


def _assemblies(model: Model, near: Sequence[float] | None) -> list[np.ndarray]:
    """Angles (n each) as given, or of assemblies drawn with a fixed seed, the lowest equilibrium's neighbours."""
    if near is not None:
        return [np.asarray(near, float)]
    lengths, ground = dimensions(model)
    random, assembled = np.random.default_rng(0), []
    for _ in range(24):
        start = np.arctan2(ground[1], ground[0]) + random.uniform(-np.pi, np.pi, lengths.size)
        with suppress(InputError):
            assembled.append(assemble(model, {}, guess=start))
    return assembled


def _dyad(model: Model, fixed: Mapping[int, float], branch: int | None, guess: np.ndarray | None) -> np.ndarray:
    """The last two bars i < j as two sides of a triangle whose third side is the gap left by the others."""
    lengths, ground = dimensions(model)
    i, j = (k for k in range(lengths.size) if k not in fixed)
    gap = ground - sum(lengths[k] * np.array([np.cos(angle), np.sin(angle)]) for k, angle in fixed.items())
    distance, longest, shortest = float(np.hypot(*gap)), lengths[i] + lengths[j], abs(lengths[i] - lengths[j])
    margin = REACH_TOLERANCE * longest
    if not (shortest - margin <= distance <= longest + margin and distance > 0):
        given = ", ".join(f"theta{k + 1} = {angle:.6g}" for k, angle in fixed.items()) or "no angle given"
        rule = f"at least {shortest:.6g} m = |length{i + 1} - length{j + 1}|"
        if distance > longest:
            rule = f"at most {longest:.6g} m = length{i + 1} + length{j + 1}"
        raise InputError(
            f"linkage: cannot be assembled at {given}: bars {i + 1} and {j + 1} would have to span {distance:.6g} m, "
            f"but they span {rule} (triangle inequality); give other angles or other lengths"
        )
    known, bars, solutions = ca.SX(list(fixed.values())), [k + 1 for k in fixed], {}
    for sign in (1, -1):
        angles = _bar_angles(model, known, ca.SX(model.parameter_values), bars, sign)
        solution: np.ndarray = ca.evalf(angles).full().ravel()
        if guess is not None:  # to within pi of the guess
            solution[[i, j]] += 2 * np.pi * np.round((guess[[i, j]] - solution[[i, j]]) / (2 * np.pi))
        solutions[sign] = solution
    if branch is not None or guess is None:
        return solutions[branch or 1]
    return min(solutions.values(), key=lambda solution: float(np.linalg.norm(solution - guess)))


def _nearest(lengths: np.ndarray, ground: np.ndarray, fixed: Mapping[int, float], guess: np.ndarray) -> np.ndarray:
    """Closure by Gauss-Newton with least-norm steps in the angles that are not fixed."""
    theta, loose = guess.copy(), [k for k in range(lengths.size) if k not in fixed]
    for k, angle in fixed.items():
        theta[k] = angle

    def phi(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slopes = closure_jacobian(lengths, theta)  # each bar a quarter turn ahead
        return slopes[::-1].sum(axis=1) * (1.0, -1.0) - ground, slopes

    solution = closed(phi, theta, loose, size=float(lengths.sum()), settings=CLOSING)
    if solution.converged:
        return solution.w
    raise InputError(
        f"linkage: cannot be assembled near guess = {np.array2string(guess, precision=6)}: a gap of "
        f"{float(np.hypot(*phi(solution.w)[0])):.3g} m is left after {CLOSING.most_evaluations} Gauss-Newton steps; "
        "give another guess or fewer fixed angles"
    )


def minimal_linkage(model: Model, independent: Sequence[int], branch: int = 1) -> Model:
    """The Model of a linkage in the angles of its `independent` bars (n - 2 of 1..n), same energies and parameters.

    The two dependent bars i < j close a triangle over the gap that the others leave, so their angles are explicit
    functions of the independent ones u, and with theta = Theta(u) the energies T(Theta, dTheta/du u'), V(Theta)
    give Lagrange's equations. Source: R. A. Wehage, E. J. Haug, "Generalized coordinate partitioning for dimension
    reduction in analysis of constrained dynamic systems", Journal of Mechanical Design 104 (1982) 247-255. Valid
    while the dependent bars are not in line (a dead point). The physical parameters stay symbols, the closure of
    the loop included, so that any of them may be freed.
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
    drive = None
    if model.actuation is not None:  # virtual work: J^T Q of the bars' motion
        drive = ca.jtimes(state[:n], u, model.actuation(0.0, state[:n], state[n:], p), True)
    return lagrange(
        model.kinetic(state[:n], state[n:], p),
        model.potential(state[:n], p),
        Symbols(u, rates, p, model.parameter_names, tuple(map(float, model.parameter_values))),
        names=[f"theta{k + 1}" for k in chosen],
        angles=(True,) * len(chosen),
        points=None if model.points is None else model.points(state[:n], p),
        forces=drive,
        controls=model.controls,
        limits=model.limits,
        system={**model.system, "independent": [int(k) for k in independent], "branch": int(branch)},
    )


def _bar_angles(model: Model, u: ca.SX, p: ca.SX, independent: Sequence[int], branch: int) -> ca.SX:
    lengths, ground = dimensions(model, p)
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
    distance = ca.norm_2(gap)
    cosine = (distance**2 + lengths[i] ** 2 - lengths[j] ** 2) / (2 * distance * lengths[i])
    if cosine.is_constant():
        cosine = ca.fmax(ca.fmin(cosine, 1.0), -1.0)  # stretched out, but for round-off
    angles[i] = ca.atan2(gap[1], gap[0]) - branch * ca.acos(cosine)
    elbow = gap - lengths[i] * ca.vertcat(ca.cos(angles[i]), ca.sin(angles[i]))
    angles[j] = ca.atan2(elbow[1], elbow[0])
    return ca.vertcat(*angles)


def _in_all(model: Model, system: Table, u: ca.SX) -> ca.SX:
    """The native coordinates (3n) of the minimal form with this system."""
    p, lift = ca.SX(model.parameter_values), constraint_of(model).lift
    theta = _bar_angles(model, u, p, system["independent"], system["branch"])
    assert lift is not None
    return lift(theta, 0 * theta, p)[: model.degrees_of_freedom]


def _dependent(model: Model, chosen: Sequence[int]) -> tuple[int, int]:
    """The bars, from 0, that follow from the others."""
    i, j = (k // 3 for k in _angles(model) if k not in chosen)
    return i, j


def _angles(model: Model) -> range:
    return range(2, model.degrees_of_freedom, 3)


def _margins(model: Model, places: np.ndarray) -> Callable[[Sequence[int]], np.ndarray]:
    """How far two bars are from being in line, as which they count where |sin| of their angle is below 0.05."""

    def margins(chosen: Sequence[int]) -> np.ndarray:
        i, j = _dependent(model, chosen)
        sine = np.sin(places[:, 3 * j + 2] - places[:, 3 * i + 2])
        return np.asarray(sine * np.sign(sine[:1]) / 0.05)

    return margins


def _in_line(model: Model, _: np.ndarray, chosen: Sequence[int]) -> str:
    i, j = _dependent(model, chosen)
    return f"bars {i + 1} and {j + 1} come into line (a dead point)"


def _minimal(model: Model, chosen: Sequence[int], near: np.ndarray) -> Model:
    i, j = _dependent(model, chosen)
    branch = 1 if np.sin(near[3 * j + 2] - near[3 * i + 2]) > 0 else -1
    return minimal_linkage(model, [k // 3 + 1 for k in chosen], branch)


LOOPS = Loops(
    _put_together, _assemblies, _angles, _margins, _in_line, _in_all, _minimal,
    lambda model, theta: check_regular(dimensions(model)[0], theta),
)  # fmt: skip
