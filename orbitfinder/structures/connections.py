"""Connections of orbits: motions on the unstable manifold of one and on the stable manifold of another, or of the
same.

The curves that both manifolds draw on a section of two dimensions are intersected. Each intersection is a problem of
two points, solved by Newton's method with the derivatives of the flow: with P the return to the section,

    P(x_u(a)) = y_1,   P(y_i) = y_i+1,   P(y_m-1) = x_s(b)

in the places a, b on both local manifolds and the crossings y_i between (two numbers each), so that round-off grows
over one return only. The tangents of both manifolds, carried to a crossing, give the angle at which they meet: where
it is 0 they only touch, and nothing is claimed.

The certificate takes another integrator on another formulation (DOP853 on Hamilton's equations) from each recorded
crossing to the next, and once round each orbit from nearer to it than the motion begins and ends, which shows how far
off the local manifolds are. The error of a point is what the linearised problem makes of all that.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.follow import Known, reached
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.dop853 import integrate_in
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.scales import floored
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, energy, vector_field, wrapped
from orbitfinder.mechanics.newton import Settings, Solver, full
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.evidence import Hamiltonian
from orbitfinder.orbits.refine import Refiner
from orbitfinder.records.certificate import Certificate, at_least, at_most, refused
from orbitfinder.records.codec import entries_of, plain
from orbitfinder.records.journal import checkpoints
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import Entries, Table, typed
from orbitfinder.structures.crossings import FINE
from orbitfinder.structures.manifold import Connection, ConnectionEnd
from orbitfinder.structures.manifolds import Local, ManifoldSettings, Part, grown, local_manifold, surface_of
from orbitfinder.structures.sections import Surface, levels_at, solved_component, surface

NEWTON = Settings(floor=1e-13, round_off=1e-10, converged=1e-10, contraction=0.5, most_evaluations=25, patience=4)
"""How a connection is solved: gaps in extents of the orbits"""
TRIED = 96
"""Crossings of curves that are tried in vain before no more are: manifolds that coincide cross in their round-off"""
COARSE = ManifoldSettings(spacing=0.03, turning=0.5, halvings=6)
"""How finely curves are grown that are only to be intersected"""


@dataclass(frozen=True)
class Allowed:
    """What the certificate of a connection allows, in extents unless said."""

    gap: float = 1e-9
    """of both orbits after a period, between crossings, and of these off the plane"""
    point: float = 1e-8
    """error of the point"""
    angle: float = 1e-4
    """least between the manifolds (rad)"""
    level: float = 1e-11
    """difference of the energies of all crossings, relative"""
    local: float = 1e-6
    """of a start off its manifold"""
    curved: float = 0.01
    """of a start from its place, along its manifold, relative to that"""
    apart: float = 1e-3
    """of the point from its orbits at least: else it is the orbit itself"""


ALLOWED = Allowed()


@dataclass(frozen=True)
class ReturnChain:
    """A connection's unknowns: crossings (m + 1 x d) from one local manifold to the other, their places there, and
    which crossing it is looked at."""

    origin: Local
    goal: Local
    states: np.ndarray
    places: tuple[float, float]
    chosen: int


@dataclass(frozen=True)
class Linearisation:
    """A chain's gaps (m x 2), the derivative of each return (m x 2 x 2), durations (m, s), the matrix of the
    problem."""

    gaps: np.ndarray
    slopes: np.ndarray
    durations: np.ndarray
    matrix: np.ndarray


def connect(
    orbit: Orbit,
    other: Orbit | None = None,
    *,
    plane: str | None = None,
    axes: Sequence[str] | None = None,
    direction: int = 1,
    returns: int = 1,
    most: int = 8,
    near: Sequence[float] | None = None,
    settings: ManifoldSettings | None = None,
    model: Model | None = None,
) -> tuple[Connection, ...]:
    """Connections from an orbit to another, or back to itself, certified.

    Args:
        orbit: whose unstable manifold is followed.
        other: whose stable manifold is met, of the same energy; the orbit itself if None.
        plane: which both cross, as in `of.section`.
        axes: the two components that are drawn.
        direction: how the plane is crossed.
        returns: fundamental domains of each manifold that are grown beyond the orbit's own size.
        most: how many are found at most, those of few returns first.
        near: a point of the axes near which they are looked for.
        settings: how finely manifolds are grown.
        model: needed only for systems that no file describes.

    Returns:
        Connections; none where the curves do not cross.

    Raises:
        InputError: for orbits of different energies and a plane that they do not cross.

    Examples:
        >>> homoclinic = of.connect(saddle, plane="theta1=0", returns=2, most=1)
        >>> [connection.certificate.passed for connection in homoclinic]
        [True]

    See Also:
        `of.sections.follow_connection` follows one in the energy.
    """
    goal, chosen = other or orbit, settings or COARSE
    cut = surface_of(orbit, model, plane, axes, direction)
    _check_section(cut, orbit, goal)
    for end in (orbit, goal) if other else (orbit,):
        if not certify(end, cut.model).passed:
            raise InputError(f"orbit: {end.name} does not pass its certificate; connections join orbits")
    ends = local_manifold(orbit, cut, "unstable"), local_manifold(goal, cut, "stable")
    if near is not None and (len(near) != 2 or not np.all(np.isfinite(near))):
        raise InputError(f"near: need two numbers, one for each axis, got {', '.join(map(str, near))}")
    here, there = (
        [part for way in (1, -1) for part in grown(end, way * end.displacement(chosen.accuracy)[0], returns, chosen)]
        for end in ends
    )
    point = None if near is None else np.asarray(near, float)
    called = orbit.name if other is None else f"{orbit.name}-{goal.name}"
    connections, tried = list[Connection](), 0
    for guess in _crossings(*ends, here, there, point):
        if tried >= TRIED or len(connections) >= most:
            break
        if any(_met(cut, guess.states[guess.chosen], other) for other in connections):
            continue
        tried += 1
        try:
            made = solved(guess)
        except UNSOLVED:
            continue
        state = made.states[made.chosen]
        own = min(np.linalg.norm((state - end.point) / end.extents) for end in (made.origin, made.goal))
        if own < ALLOWED.apart or any(_met(cut, state, other) for other in connections):
            continue
        known = certified_connection(described(made, f"{called}-{len(connections) + 1}"), cut.model)
        if known.certificate is None or not known.certificate.passed:
            continue
        connections.append(known)
        tried = 0
    return tuple(connections)


def _check_section(cut: Surface, orbit: Orbit, goal: Orbit) -> None:
    """`InputError` where the manifolds of both orbits are no curves in one plane."""
    model, held = cut.model, len(cut.levels)
    size = len(model.state_names) - held - (cut.plane.component >= 0)
    if size != 2:
        raise InputError(
            f"orbit: its section has {size} dimensions, in which curves do not meet; connections are found in 2, as of "
            "two degrees of freedom at one energy"
        )
    if goal.system != orbit.system:
        raise InputError("other: an orbit of another system; connections join orbits of one")
    here, there = energy(model, orbit.state), energy(model, goal.state)
    if held and abs(here - there) > 1e-9 * max(abs(here), abs(there)):
        raise InputError(
            f"other: its energy is {there!r}, that of the first {here!r}; motions keep theirs, find both at one energy"
        )


def _crossings(
    origin: Local, goal: Local, here: Sequence[Part], there: Sequence[Part], near: np.ndarray | None
) -> Iterator[ReturnChain]:
    """Where polylines cross, those of few returns first, or those nearest to a point (2) of the axes: guesses of
    chains."""
    guesses = []
    for (states, places, count, _), (others, marks, number, _) in product(here, there):
        if count + number < 2:
            continue
        p, q = origin.surface.chart(states), origin.surface.chart(others)
        for i, j, s, t in _intersections(p, q):
            away = count + number if near is None else float(np.linalg.norm(p[i] + s * (p[i + 1] - p[i]) - near))
            guesses.append((away, _between(places, i, s), count, _between(marks, j, t), number))
    for _, a, count, b, number in sorted(guesses):
        forth, back = _returned(origin, a, count), _returned(goal, b, number)
        if np.isfinite(forth).all() and np.isfinite(back).all():
            yield ReturnChain(origin, goal, np.vstack([forth, back[-2::-1]]), (a, b), count)


def _between(places: np.ndarray, k: int, share: float) -> float:
    """The displacement part of the way from the k-th to the next."""
    return float(places[k] * (places[k + 1] / places[k]) ** share)


def _returned(base: Local, place: float, count: int) -> np.ndarray:
    """A start on a local manifold and its returns (count + 1 x d)."""
    start = base.states(np.array([place]))
    return np.vstack([start, base.returned(start, count).states[0]]) if count else start


def _intersections(p: np.ndarray, q: np.ndarray) -> Iterator[tuple[int, int, float, float]]:
    """Numbers of the chords of two polylines (k x 2) that cross, and where along them."""
    if (p.min(axis=0) > q.max(axis=0)).any() or (q.min(axis=0) > p.max(axis=0)).any():
        return
    da, b, db = np.diff(p, axis=0), q[:-1], np.diff(q, axis=0)
    with np.errstate(all="ignore"):
        for i in range(len(da)):
            turn, off = da[i, 0] * db[:, 1] - da[i, 1] * db[:, 0], b - p[i]
            s = (off[:, 0] * db[:, 1] - off[:, 1] * db[:, 0]) / turn
            t = (off[:, 0] * da[i, 1] - off[:, 1] * da[i, 0]) / turn
            for j in np.flatnonzero((s >= 0) & (s < 1) & (t >= 0) & (t < 1)):
                yield i, int(j), float(s[j]), float(t[j])


def _linear(chain: ReturnChain) -> Linearisation:
    """The gaps of a chain and their derivatives. Raises `IntegrationError` where a crossing has no return."""
    base, cut, starts = chain.origin, chain.origin.surface, chain.states[:-1]
    size, axes, plane = starts.shape[1], list(cut.axes), cut.plane
    begins = np.hstack([starts, np.tile(np.eye(size).ravel(), (len(starts), 1))])
    passing = base.varied.passing(plane, begins, 1, longest=20 * base.orbit.period, tolerance=FINE)
    if not passing.complete.all():
        raise IntegrationError("the motion does not come back to the section")
    ends = passing.states[:, 0, :size]
    # d state / d axes (k x d x 2) on the section at the held energy
    frames = np.zeros((*starts.shape, 2))
    frames[:, list(cut.axes), [0, 1]] = 1.0
    if cut.levels:
        i, slopes = solved_component(cut), cut.invariants(starts)[1][:, 0]
        frames[:, i] = -slopes[:, list(cut.axes)] / slopes[:, i, None]
    moved = passing.states[:, 0, size:].reshape(-1, size, size).transpose(0, 2, 1) @ frames
    if plane.component >= 0:
        rates = cut.motions.rates(passing.times[:, 0], ends)
        moved = moved - rates[:, :, None] * (moved[:, None, plane.component] / rates[:, plane.component, None, None])
    gaps = wrapped(ends - chain.states[1:], cut.model.angular)
    return Linearisation(gaps[:, axes], moved[:, axes], passing.times[:, 0], _matrix(chain, moved[:, axes]))


def _matrix(chain: ReturnChain, slopes: np.ndarray) -> np.ndarray:
    """d gaps / d (log a, y_1, ..., y_m-1, log b) (2 m x 2 m)."""
    count, axes = len(slopes), list(chain.origin.surface.axes)
    matrix = np.zeros((2 * count, 2 * count))
    ends = [end.direction[axes] * place for end, place in zip((chain.origin, chain.goal), chain.places, strict=True)]
    matrix[:2, 0] = slopes[0] @ ends[0]
    matrix[-2:, -1] = -ends[1]
    for k in range(1, count):
        matrix[2 * k : 2 * k + 2, 2 * k - 1 : 2 * k + 1] = slopes[k]
        matrix[2 * k - 2 : 2 * k, 2 * k - 1 : 2 * k + 1] = -np.eye(2)
    return matrix


def solved(chain: ReturnChain, settings: Settings = NEWTON) -> ReturnChain:
    """The connection near a guess, by Newton's method. Raises `ConvergenceError` where the manifolds do not meet
    there."""
    axes = list(chain.origin.surface.axes)

    def linearised(chain: ReturnChain) -> tuple[np.ndarray, Solver]:
        linear = _linear(chain)

        def solver(_: np.ndarray) -> np.ndarray:
            try:
                step = np.linalg.solve(linear.matrix, -linear.gaps.ravel())
            except np.linalg.LinAlgError as error:
                raise ConvergenceError("connection: the manifolds touch and do not cross there") from error
            return step / max(1.0, float(np.abs(step[[0, -1]]).max()) / 0.3)  # of logarithms

        return linear.gaps / np.maximum(chain.origin.extents[axes], np.abs(chain.states[1:, axes])), solver

    solution = full(chain, linearised, settings, _moved)
    if not solution.converged:
        raise ConvergenceError(
            f"connection: the manifolds come within {solution.size:.2g} of each other there and do not meet"
        )
    return solution.w


def _moved(chain: ReturnChain, step: np.ndarray) -> ReturnChain:
    """The chain after a step of its unknowns, its crossings held at their energy."""
    cut = chain.origin.surface
    places = chain.places[0] * float(np.exp(step[0])), chain.places[1] * float(np.exp(step[-1]))
    inner = chain.states[1:-1].copy()
    inner[:, list(cut.axes)] += step[1:-1].reshape(-1, 2)
    if len(inner) and cut.levels:
        inner = cut.held(inner, along=[solved_component(cut)])
    first, last = (end.states(np.array([at])) for end, at in zip((chain.origin, chain.goal), places, strict=True))
    states = np.vstack([first, inner, last])
    if not np.isfinite(states).all():
        raise ConvergenceError("connection: Newton's method leaves the energy's states; start nearer to a crossing")
    return replace(chain, states=states, places=places)


def tangents(chain: ReturnChain, linear: Linearisation) -> np.ndarray:
    """The tangents (2 x 2) of the unstable and of the stable manifold at the chosen crossing, on the axes."""
    axes = list(chain.origin.surface.axes)
    forth, back = chain.origin.direction[axes], chain.goal.direction[axes]
    for slope in linear.slopes[: chain.chosen]:
        forth = slope @ forth
        forth = forth / np.linalg.norm(forth)
    for slope in linear.slopes[chain.chosen :][::-1]:
        back = np.linalg.solve(slope, back)
        back = back / np.linalg.norm(back)
    return np.array([forth, back])


def _angle(chain: ReturnChain, linear: Linearisation, units: np.ndarray) -> float:
    """Between the manifolds at the chosen crossing (rad, 0 to pi / 2), the axes being measured in extents."""
    a, b = (
        tangent / np.linalg.norm(tangent)
        for tangent in tangents(chain, linear) / units[list(chain.origin.surface.axes)]
    )
    return float(np.arcsin(min(1.0, abs(a[0] * b[1] - a[1] * b[0]))))


def _met(cut: Surface, state: np.ndarray, other: Connection) -> bool:
    """Whether a crossing is one of a connection that is known, to a share of its extents."""
    units = nonzero(np.ptp(other.states, axis=0))
    return bool(np.abs(wrapped(other.states - state, cut.model.angular) / units).max(axis=1).min() <= 1e-5)


def described(chain: ReturnChain, name: str) -> Connection:
    """The Connection (without certificate) of a chain."""
    cut, linear = chain.origin.surface, _linear(chain)
    names = cut.model.state_names
    ends = [
        ConnectionEnd(end.orbit.name, end.orbit.state, end.orbit.period, end.multiplier, end.point, end.direction,
                      place, end.extents)
        for end, place in zip((chain.origin, chain.goal), chain.places, strict=True)
    ]  # fmt: skip
    units = extents_of(cut.model, chain.states, chain.origin.orbit.period)
    parts, since = [], 0.0
    times = np.linspace(0.0, 1.0, 41)  # states between two crossings
    for state, duration in zip(chain.states, linear.durations, strict=False):
        rows = cut.motions.along(state[None], times * duration, tolerance=FINE)[0, :-1]
        parts.append(np.column_stack([since + times[:-1] * duration, rows]))
        since += duration
    whole = np.vstack([*parts, np.append(since, chain.states[-1])])
    return Connection(
        name, dict(cut.model.system), names, cut.name, cut.plane.component,
        cut.axis_names, chain.origin.orbit.energy, chain.states, linear.durations,
        chain.chosen, _angle(chain, linear, units), np.inf, ends[0], ends[1], None, whole[:, 0], whole[:, 1:],
    )  # fmt: skip


def certified_connection(connection: Connection, model: Model) -> Connection:
    """The connection with its certificate, and the error found there."""
    certificate, error = _certificate(connection, model)
    return replace(connection, certificate=certificate, error=error)


def certify_connection(connection: Connection, model: Model | None = None) -> Certificate:
    """The certificate of a connection, from its record alone, by DOP853 on Hamilton's equations."""
    return _certificate(connection, model or build_model(connection.system))[0]


def _end(equations: Hamiltonian, state: np.ndarray, duration: float) -> np.ndarray:
    """The state after a time, which may be negative, by DOP853 on the certificate's formulation."""
    sense, start, moments = float(np.sign(duration)), equations.start(state), np.array([0.0, abs(duration)])
    path = integrate_in(floored(np.abs(start)), lambda t, y: sense * equations.field(sense * t, y), start, moments)
    return np.asarray(equations.states(path)[-1])


def _certificate(connection: Connection, model: Model) -> tuple[Certificate, float]:
    """The certificate of a record, by where DOP853 comes from its crossings, how far both orbits are from closing and
    both ends off the local manifolds; and the error of its point in the state's units."""
    states, durations, ends = connection.states, connection.durations, (connection.origin, connection.goal)
    if not (np.isfinite(states).all() and np.isfinite(durations).all() and (durations > 0).all()):
        return Certificate((refused("finite", "a crossing or a duration is not a number"),)), np.inf
    motion = Hamiltonian(model)
    try:
        came = np.array([_end(motion, x, t) for x, t in zip(states, durations, strict=False)])
        closed = [wrapped(_end(motion, end.point, end.period) - end.point, model.angular) for end in ends]
        local = [_off(motion, end, x, sense) for end, x, sense in zip(ends, states[[0, -1]], (1, -1), strict=True)]
        chain = _chain(connection, model)
        linear = _linear(chain)
    except (IntegrationError, ConvergenceError, InputError) as failure:
        return Certificate((refused("integration", failure),)), np.inf
    units, growth = extents_of(model, states, connection.origin.period), [_growth(end) for end in ends]
    axes, gaps = list(chain.origin.surface.axes), wrapped(came - states[1:], model.angular)
    errors = np.abs(gaps[:, axes])
    errors[0] += np.abs(linear.slopes[0] @ local[0][axes])
    errors[-1] += np.abs(local[1][axes])
    place = 2 * chain.chosen - 1
    error = float(np.linalg.norm((np.abs(_inverse(linear.matrix)) @ errors.ravel())[place : place + 2]))
    away = [np.linalg.norm(wrapped(states[chain.chosen] - end.point, model.angular) / end.extents) for end in ends]
    gap = max(np.abs(gap / end.extents).max() / g for gap, end, g in zip(closed, ends, growth, strict=True))
    off = max(np.linalg.norm(gap / end.extents) for gap, end in zip(local, ends, strict=True))
    level = [energy(model, x) for x in (*states, *(end.state for end in ends))]
    plane = max(float(np.abs(_off_plane(chain, x)).max()) for x in (states, came))
    checks = [
        at_most("orbits", gap, ALLOWED.gap, "gap of both orbits after a period, over their multipliers"),
        at_most("local", off, ALLOWED.local, "of the first and the last crossing off the local manifolds, in extents"),
        *([at_most("energy", float(np.ptp(level)) / nonzero(abs(level[0])), ALLOWED.level,
                   "of all crossings and both orbits, relative")] if model.conservative else []),
        at_most("gap", float(np.abs(gaps / units).max()), ALLOWED.gap,
                "from each crossing to the next, by DOP853, in extents"),
        at_most("section", plane, ALLOWED.gap, "crossings off the plane, in extents"),
        at_least("angle", _angle(chain, linear, units), ALLOWED.angle,
                 "between the manifolds (rad); 0 where they only touch"),
        at_most("error", error / float(units[axes].max()), ALLOWED.point,
                "of the point, in extents: all that, carried"),
        at_least("apart", float(min(away)), ALLOWED.apart, "the point is not the orbit's own"),
    ]  # fmt: skip
    return Certificate(tuple(checks)), error


def _growth(end: ConnectionEnd) -> float:
    """How many times errors grow in a period of an orbit."""
    return max(abs(end.multiplier), 1 / abs(end.multiplier))


def _inverse(matrix: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.inf)


def _off_plane(chain: ReturnChain, states: np.ndarray) -> np.ndarray:
    """How far states (k x d) are off the section, in extents."""
    plane, units = chain.origin.surface.plane, chain.origin.extents
    if plane.component < 0:
        return np.zeros(1)
    own = states[:, plane.component]
    return np.asarray(plane.off(own, plane.nearest(own)) / units[plane.component])


def _chain(connection: Connection, model: Model) -> ReturnChain:
    """The chain of a record."""
    plane = None
    if connection.component >= 0:
        level = float(connection.states[connection.chosen][connection.component])
        plane = f"{model.state_names[connection.component]}={level!r}"
    rate = vector_field(model)(0.0, connection.states[connection.chosen], [], []).full().ravel()
    direction = 1 if connection.component < 0 else int(np.sign(rate[connection.component])) or 1
    cut = surface(model, plane, connection.axes, direction, levels=levels_at(model, connection.origin.state))
    ends = [
        Local(_no_orbit(end), cut, sense, end.point, end.direction, end.multiplier, 1, end.extents)
        for end, sense in ((connection.origin, 1), (connection.goal, -1))
    ]
    places = connection.origin.place, connection.goal.place
    return ReturnChain(ends[0], ends[1], connection.states, places, connection.chosen)


def _no_orbit(end: ConnectionEnd) -> Orbit:
    """What a local manifold asks of its orbit."""
    nothing = np.zeros(0)
    return Orbit(
        end.orbit, {}, end.state, end.period, np.nan, 0.0, 0.0, "", (), nothing, 0.0, "", (), end.state[None],
        nothing, nothing, 0.0,
    )  # fmt: skip


def _off(equations: Hamiltonian, end: ConnectionEnd, state: np.ndarray, sense: int) -> np.ndarray:
    """How far (d) a start is off the local manifold, but for the flow: by a motion of a period from nearer by."""
    model, turns = equations.model, 1 if end.multiplier > 0 else 2
    growth = _growth(end) ** turns
    later = _end(equations, end.point + end.place / growth * end.direction, sense * turns * end.period)
    gap = wrapped(later - state, model.angular) / end.extents
    rate = vector_field(model)(0.0, state, [], []).full().ravel() / end.extents
    spanned = [end.direction / end.extents, *([] if model.forced else [rate])]
    along = np.linalg.qr(np.column_stack(spanned))[0]
    own = float(gap @ spanned[0])  # along the manifold only as far as its curvature goes
    beyond = np.sign(own) * max(abs(own) - ALLOWED.curved * abs(end.place), 0.0)
    return np.asarray((gap - along @ (along.T @ gap) + beyond * spanned[0]) * end.extents)


def follow_connection(
    connection: Connection,
    orbit: Orbit,
    energies: Sequence[float],
    other: Orbit | None = None,
    *,
    model: Model | None = None,
    progress: Callable[[Connection], None] | None = None,
    name: str = "",
    out: str | Path | None = None,
) -> tuple[Connection, ...]:
    """A connection at other energies, one after another; it ends before the list does where the manifolds part.

    `orbit` and `other` are its orbits, which are refined at each energy; `progress` is called with each connection.
    OUT/<name>/connection.jsonl keeps them as they come, and what was asked before goes on from there, also to more
    energies. Raises `InputError`.
    """
    model, levels, label = model or build_model(orbit.system), tuple(map(float, energies)), name or connection.name
    if not model.conservative:
        raise InputError("energies: this system conserves none; connections are followed in energy")
    if not np.isfinite(levels).all():
        raise InputError(f"energies: must be finite, got {', '.join(map(str, levels))}")
    if any(plain(end.system) != plain(connection.system) for end in (orbit, other) if end):
        raise InputError("orbit: of another system than the connection; give the orbits that it joins")
    orbits, members = (orbit,) if other is None else (orbit, other), [connection]
    joined = [(end.state, end.period, end.symmetry) for end in orbits]
    request = plain({"name": label, "connection": entries_of(connection), "orbits": joined})
    path, refiners = None if out is None else Path(out) / label / "connection.jsonl", list[Refiner]()
    with checkpoints(path, request, _read) as journal:
        known = dict(journal.known)
        for k, level in enumerate(levels, 1):
            if levels[:k] not in known:
                refiners = refiners or [_refiner(end, model) for end in orbits]
                known[levels[:k]] = _next(members[-2:], refiners, level, f"{label}-{k}")
                journal.add(_entry(levels[:k], known[levels[:k]]))
            member = known[levels[:k]]
            if isinstance(member, str):
                logging.getLogger(__name__).warning("energies: %r: %s; give some nearer ones before it", level, member)
                break
            members.append(member)
            if progress:
                progress(member)
    return tuple(members[1:])


def _entry(levels: tuple[float, ...], member: Connection | str) -> Entries:
    """The line of a journal: energies up to one, and the connection there or why there is none."""
    if isinstance(member, str):
        return {"energies": levels, "end": member}
    motion = {"times": member.times, "samples": member.samples}
    return dict(plain({"energies": levels, "connection": entries_of(member), **motion}))


def _read(line: Table) -> tuple[tuple[float, ...], Connection | str]:
    """Both from what was written. Raises `ValueError`."""
    levels = tuple(map(float, line["energies"]))
    if "end" in line:
        return levels, str(line["end"])
    motion = {name: np.array(line[name], float) for name in ("times", "samples")}
    return levels, typed(Connection, {**line["connection"], **motion}, "")


def _next(known: Sequence[Connection], refiners: Sequence[Refiner], level: float, name: str) -> Connection | str:
    """The connection at another energy, from one or two that are known; or why there is none."""
    model = refiners[0].problem.model
    chains = [(member.energy, _chain(member, model)) for member in known]
    try:
        chain = reached(chains, level, partial(_at_level, chains, refiners))
    except UNSOLVED as error:
        return str(error)
    return certified_connection(described(chain, name), model)


def _refiner(orbit: Orbit, model: Model) -> Refiner:
    """What refines an orbit at other energies, in its symmetry where the equations have it."""
    problem = Problem(model, Guess(orbit.state, orbit.period), pin=(Pin("energy", orbit.energy),))
    try:
        return Refiner(replace(problem, symmetry=orbit.symmetry))
    except InputError:
        return Refiner(problem)


def _at_level(known: Known[ReturnChain], refiners: Sequence[Refiner], level: float) -> tuple[ReturnChain, int]:
    """The chain at another energy: its orbits there, motions from places on the secant through the last two, Newton."""
    (before, past), (here, chain) = known[0], known[-1]
    cut = chain.origin.surface
    orbits = [refiner.orbit(refiner.refine(None, (Pin("energy", level),)), False) for refiner in refiners]
    surfaces = [replace(cut, levels=levels_at(cut.model, orbit.state)) for orbit in orbits]
    origin, goal = (
        local_manifold(orbits[k], surfaces[k], which, point=end.point)
        for k, which, end in ((0, "unstable", chain.origin), (-1, "stable", chain.goal))
    )
    goal = replace(goal, surface=surfaces[0])
    share = np.clip((level - here) / (here - before), -2.0, 2.0) if here != before else 0.0
    a, b = (refiner * abs(refiner / other) ** share for refiner, other in zip(chain.places, past.places, strict=True))
    forth, back = _returned(origin, a, chain.chosen), _returned(goal, b, len(chain.states) - 1 - chain.chosen)
    if not (np.isfinite(forth).all() and np.isfinite(back).all()):
        raise ConvergenceError("connection: its motion does not come back to the section at this energy")
    states = np.vstack([forth, back[-2::-1]])
    return solved(replace(chain, origin=origin, goal=goal, states=states, places=(a, b))), 0
