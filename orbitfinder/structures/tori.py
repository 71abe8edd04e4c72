"""Invariant tori: quasi-periodic motions around an elliptic orbit, or born where two multipliers leave the unit circle.

A torus is solved as a ring (see `families.ring`) and followed by pseudo-arclength: at fixed energy in its rotation
number, at fixed rotation number in the energy, or in a parameter. A family ends where its Fourier series no longer
converges: there the torus breaks down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime import locks
from orbitfinder._runtime.keeping import STOPPED, finished
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.follow import Direction, Goals, Pace, follow, towards
from orbitfinder.continuation.problem import Point, plane, solved
from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.integrate.dop853 import STEPS_PER_PERIOD, integrate_in
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.field import vector_field
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.mechanics.scales import extents_of, parameter_sizes
from orbitfinder.records.certificate import Certificate, at_least, at_most, equal
from orbitfinder.records.codec import entries_of
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import Entries, typed
from orbitfinder.structures.ring import (
    RESOLVED,
    Circle,
    Turned,
    at_angles,
    coefficients,
    harmonics,
    spectrum,
    unresolved,
)
from orbitfinder.structures.sections import Surface
from orbitfinder.structures.torus import Tori, Torus

FEWEST = 17
"""States of a curve at first"""
INVARIANT = 1e-9
"""What a return may miss the curve by between its states, in extents of the motion"""
RETURNS = 10
"""... and so many returns one after another, times their number squared"""
RESONANCE = 1e-9
"""A rotation number this near to p/q, q up to the states of the curve, is resonant"""


@dataclass(frozen=True)
class TorusSettings:
    """How tori are followed.

    Args:
        step: the first step, in what is followed.
        points: tori at most.
        most_states: of a curve (N); a torus that needs more ends the family.
        certify: whether each is certified.

    Raises:
        InputError: for numbers that cannot be.

    Examples:
        >>> of.TorusSettings(points=5).most_states
        151
    """

    step: float = 0.02
    points: int = 100
    most_states: int = 151
    certify: bool = True


def torus(
    orbit: Orbit,
    rotation: float,
    *,
    mode: int = 1,
    model: Model | None = None,
    settings: TorusSettings | None = None,
) -> Torus:
    """The torus around an elliptic orbit, at the orbit's energy, whose returns turn by a rotation number.

    phi_T(X(theta)) = X(theta + 2 pi rotation).

    Args:
        orbit: an elliptic one.
        rotation: turns in a return, 0 to 1, not resonant.
        mode: which pair of multipliers, the slowest first, from 1.
        model: needed only for systems that no file describes.
        settings: steps and sizes.

    Returns:
        A Torus, certified.

    Raises:
        InputError: for a resonant number and for an orbit that is not elliptic.
        ConvergenceError: where the family of tori ends before.

    Examples:
        >>> golden = of.torus(loop, rotation=(3 - 5**0.5) / 4)
        >>> [round(frequency, 9) for frequency in golden.frequencies], golden.certificate.passed
        ([1.020516687, 0.194901344], True)
    """
    chosen = settings or TorusSettings()
    family = follow_tori(orbit, until=rotation, mode=mode, model=model, settings=replace(chosen, certify=False))
    last = family.tori[-1]
    if abs(last.rotation - rotation) > RESONANCE:
        met = sorted(member.rotation for member in family.tori)
        met_range = f"those met are {met[0]:.9g} to {met[-1]:.9g}"
        raise ConvergenceError(f"no torus of rotation number {rotation:.9g} was reached, {met_range}: {family.end}")
    return certify_torus(last, _model(orbit, model)) if chosen.certify else last


@one_thread()
def follow_tori(
    origin: Orbit | Torus,
    *,
    until: float | None = None,
    at: tuple[float, ...] = (),
    hold: str | None = None,
    parameter: str | None = None,
    mode: int = 1,
    model: Model | None = None,
    settings: TorusSettings | None = None,
    progress: Callable[[Torus], None] | None = None,
    name: str = "",
    out: str | Path | None = None,
) -> Tori:
    """The family of tori from an elliptic orbit or from a Torus.

    Args:
        origin: an elliptic Orbit, of a dissipative system an orbit at a torus event, or a Torus (then with its
            `model`).
        until: value of what is followed to stop at.
        at: values at which tori are computed exactly.
        hold: of conservative systems "energy" (default; followed in the rotation number) or "rotation" (followed in
            the energy, from a Torus).
        parameter: of others, the physical parameter.
        mode: which pair of multipliers, the slowest first, from 1.
        model: for a Torus, and for systems that no file describes.
        settings: steps and sizes.
        progress: called with each torus.
        name: a word for files.
        out: a folder: OUT/<name>/tori.jsonl keeps every torus as it comes, and what was asked before goes on from
            there.

    Returns:
        Tori, and why they end.

    Raises:
        InputError: for an origin without tori.
        ConvergenceError: where the first is not found.

    Examples:
        >>> two = of.follow_tori(loop, settings=of.TorusSettings(points=2, certify=False))
        >>> len(two.tori), two.end
        (2, 'point limit of 2')
    """
    chosen = settings or TorusSettings()
    system = _model(origin, model)
    asked = _asked(system, origin, hold, parameter)
    goals = tuple(sorted({*at, *(() if until is None else (until,))}))
    for goal in goals if asked == "rotation" else ():
        _check_rotation(goal, chosen.most_states)
    label = name or (f"{origin.name}-tori" if isinstance(origin, Orbit) else "tori")
    free = isinstance(origin, Torus)  # the tangent of its family points anywhere
    if isinstance(origin, Torus):
        ring, guess, direction = _from_torus(origin, system, asked)
        begun = [origin.curve, origin.period, origin.rotation, dict(origin.free)]
    else:
        ring, guess, direction = _from_orbit(origin, system, asked, mode)
        begun = [origin.state, origin.period]
    ring = replace(ring, most=chosen.most_states)
    unit = 2 * np.pi if asked == "rotation" else 1.0  # rad a turn
    inner = Goals(asked, None if until is None else unit * until, tuple(unit * value for value in goals))
    path = None if out is None else Path(out) / label / "tori.jsonl"
    request = {"origin": begun, "asked": asked, "mode": mode, "states": chosen.most_states,
               "step": chosen.step, "certify": chosen.certify, "system": dict(system.system)}  # fmt: skip
    curve = _TorusDirection(inner, 1.0, request, ring, guess, direction, free, system, chosen.certify)
    pace = Pace(first=chosen.step, shortest=1e-3, longest=10.0, points=chosen.points, quick=6)
    held = {label: value / (2 * np.pi) if label == "rotation" else value for label, value in ring.held}

    def tori(end: str) -> Tori:
        return Tori(label, dict(system.system), asked, held, tuple(kept.record for kept in curve.points), end,
                    getattr(origin, "title", ""))  # fmt: skip

    with locks.alone_in(path and path.parent):
        for kept in follow(curve, pace, path):
            finished(lambda: tori(STOPPED))
            if progress:
                progress(kept.record)
    return tori(_ended(curve, asked, until, chosen.points))


def _model(origin: Orbit | Torus, model: Model | None) -> Model:
    """The Model of an origin; `InputError` for systems whose tori are not known."""
    if not isinstance(origin, (Orbit, Torus)):
        raise InputError(f"origin: {type(origin).__name__}; give an Orbit, or a Torus with its model")
    if model is None:
        if isinstance(origin, Torus):
            raise InputError("model: missing; a Torus does not say of which system it is (build_model(tori.system))")
        model = build_model(origin.system)
    if not model.smooth or model.constraint is not None:
        what = "hybrid systems" if not model.smooth else "native DAE models; give the minimal one"
        raise InputError(f"origin: tori are not found of {what}")
    if isinstance(origin, Orbit) and (any(origin.winding) or origin.shift):
        raise InputError("origin: turns or shifts in a period; tori are found around orbits that come back")
    return model


def _asked(model: Model, origin: Orbit | Torus, hold: str | None, parameter: str | None) -> str:
    """What the family is followed in; `InputError` for what does not go together."""
    if not model.conservative:
        if parameter is None or parameter not in model.parameter_names:
            known = ", ".join(model.parameter_names[:12]) or "none"
            raise InputError(
                f"parameter: {parameter!r}; tori of a system without energy are followed in one of {known}"
            )
        return parameter
    if parameter is not None:
        raise InputError(f"parameter: {parameter!r}; tori of a conservative system are followed by hold='energy' or "
                         "hold='rotation'")  # fmt: skip
    if hold not in (None, "energy", "rotation"):
        raise InputError(f"hold: {hold!r}{closest(str(hold), ('energy', 'rotation'))}; use 'energy' or 'rotation'")
    if hold == "rotation" and isinstance(origin, Orbit):
        raise InputError("hold: 'rotation' begins with a Torus of that rotation number; find one at fixed energy first")
    return "energy" if hold == "rotation" else "rotation"


def _check_rotation(rotation: float, most: int) -> None:
    """`InputError` for a rotation number that no torus has, or only one of periodic orbits."""
    if not (np.isfinite(rotation) and 0 < rotation < 1):
        raise InputError(f"rotation: {rotation}; give turns a return, between 0 and 1")
    if (near := resonance(rotation, most)) is not None:
        raise InputError(
            f"rotation: {rotation!r} is resonant, {near[0]}/{near[1]}: such a torus is a ring of periodic orbits of "
            f"{near[1]} returns; give an irrational number, or follow the family past it"
        )


def resonance(rotation: float, most: int) -> tuple[int, int] | None:
    """(p, q), q up to `most`, where a rotation number is p/q to within `RESONANCE` / q."""
    orders = np.arange(1, most + 1)
    nearest = np.round(rotation * orders)
    hit = np.flatnonzero(np.abs(rotation * orders - nearest) <= RESONANCE)
    return (int(nearest[hit[0]]), int(orders[hit[0]])) if hit.size else None


Guessed = tuple[Circle, Turned, np.ndarray]
"""A ring, a guess of its torus, and the direction (over w) in which that is one of a family"""


def _from_orbit(orbit: Orbit, model: Model, asked: str, mode: int) -> Guessed:
    """A small torus around an elliptic orbit: X = x + a Re(v e^(i theta)), v an eigenvector of the monodromy."""
    free = (asked,) if asked in model.parameter_names else ()
    equations = Equations(model, NONE, free)
    w = equations.unknowns(orbit.state[None], orbit.period, np.linspace(0.0, 1.0, STEPS_PER_PERIOD + 1))
    path = equations.varied(w, states=True)
    units = extents_of(model, path.states, orbit.period)
    # of the pairs on the unit circle, slowest first
    multipliers, vectors = np.linalg.eig(path.transitions[0])
    if np.abs(multipliers).max() > 1e6:  # arcs would have to be shorter than a return
        raise InputError(
            f"origin: a multiplier of {np.abs(multipliers).max():.2g}; tori are not found around such orbits"
        )
    # on the unit circle, and turning
    on = [k for k, mu in enumerate(multipliers) if abs(abs(mu) - 1) < 1e-3 and mu.imag > 1e-3]
    if not on:
        raise InputError("origin: no pair of multipliers turns on the unit circle; tori lie around elliptic orbits, "
                         "and begin at torus events")  # fmt: skip
    if not 1 <= mode <= len(on):
        raise InputError(f"mode: {mode}; {len(on)} pairs of multipliers turn on the unit circle, give 1 to {len(on)}")
    chosen = sorted(on, key=lambda k: float(np.angle(multipliers[k])))[mode - 1]
    angle, vector = float(np.angle(multipliers[chosen])), vectors[:, chosen]
    vector = vector / np.sqrt(np.mean(np.abs(vector / units) ** 2) * units.size / 2)
    around = (np.exp(2j * np.pi * np.arange(FEWEST) / FEWEST)[:, None] * vector).real
    held = (("energy", orbit.energy),) if model.conservative else ()
    sizes = parameter_sizes(model, free, w.free)
    direction = np.concatenate([around.ravel(), np.zeros(2 + w.free.size)])
    still = Turned(np.tile(orbit.state, (FEWEST, 1)), orbit.period, angle, w.free)
    guess = still.moved(0.01 * direction)
    return Circle(equations, units, orbit.period / (2 * np.pi), sizes, held).confirmed(guess), guess, direction


def _from_torus(torus: Torus, model: Model, asked: str) -> Guessed:
    """A known torus, in the ring that its family is followed in; its direction points anywhere."""
    free = (asked,) if asked in model.parameter_names else ()
    equations = Equations(with_parameters(model, torus.free), NONE, free)
    numbers = np.array([torus.free.get(name, value) for name, value in zip(free, equations.numbers, strict=True)])
    w = Turned(torus.curve, torus.period, 2 * np.pi * torus.rotation, numbers)
    held = (("rotation", w.angle),) if asked == "energy" else (("energy", torus.energy),) if model.conservative else ()
    units = extents_of(model, filled(torus, model, FEWEST).reshape(-1, w.curve.shape[1]), torus.period)
    ring = Circle(equations, units, w.period / (2 * np.pi), parameter_sizes(model, free, numbers), held).confirmed(w)
    direction = np.concatenate([(w.curve - w.curve.mean(axis=0)).ravel(), np.zeros(2 + w.free.size)])
    return ring, w, direction


def filled(torus: Torus, model: Model, lines: int) -> np.ndarray:
    """States (lines x k x d) all over a torus: one return from each of so many angles."""
    equations = Equations(with_parameters(model, torus.free), NONE)
    starts = at_angles(torus.curve, 2 * np.pi * np.arange(lines) / lines)
    tail = np.concatenate([[torus.period], np.zeros(equations.march.unfolding)])
    path = equations.march.states(starts, np.linspace(0.0, lines, 128 * lines + 1), tail)
    return np.concatenate([starts[:, None], path[1:].reshape(lines, 128, -1)], axis=1)


def crossed(torus: Torus, cut: Surface) -> np.ndarray:
    """Where a torus crosses a section: states (k x d), the crossings in one return of motions from all round its curve.

    Raises `InputError` where it does not.
    """
    starts = at_angles(torus.curve, 2 * np.pi * np.arange(480) / 480)
    passing = cut.motions.passing(cut.plane, starts, 8, longest=1.5 * torus.period)
    states = passing.states[passing.times <= torus.period * (1 + INVARIANT)]
    if not len(states):
        raise InputError(f"plane: the torus does not cross {cut.name}; choose another plane or direction")
    return states


def strip(curve: np.ndarray) -> float:
    """Half the width of the strip in which the series converges: the decay rate of its coefficients above round-off."""
    waves, sizes = harmonics(len(curve)), np.abs(coefficients(curve)).max(axis=1)
    largest = np.array([sizes[np.abs(waves) >= k].max() for k in range(1, waves.max() + 1)])
    clear = np.arange(max(3, np.flatnonzero(largest > 1e-12 * largest[0])[-1] + 1))  # the others are round-off
    return float(-np.polyfit(clear, np.log(nonzero(largest[clear])), 1)[0])


@dataclass(eq=False)
class _TorusDirection(Direction):
    """A direction along tori: the ring of the first, a guess of it and the way (over w) in which that is of a family,
    whether that way is `free` to be turned, the system, and whether each is certified."""

    ring: Circle
    guess: Turned
    way: np.ndarray
    free: bool
    model: Model
    certify: bool

    def begin(self) -> Point:
        """The first torus, its tangent this way, or the same torus gone round the other way."""
        guess, way, shape = self.guess, self.way, self.guess.curve.shape
        point = self._near(guess, way)
        if self.leads(point):
            return point
        if self.free:
            return replace(point, tangent=-point.tangent)

        def turned(curve: np.ndarray) -> np.ndarray:
            return np.roll(curve.reshape(shape)[::-1], 1, axis=0)

        curve, others = np.split(way, [guess.curve.size])
        guess = replace(guess, curve=turned(guess.curve), angle=2 * np.pi - guess.angle)
        return self._near(guess, np.concatenate([turned(curve).ravel(), others]))

    def _near(self, guess: Turned, way: np.ndarray) -> Point:
        """The torus in the plane through a guess across a direction."""
        point = solved(self.ring, guess, plane(self.ring, guess, way))
        ring, w, tangent = self.ring.at(point.w, point.tangent)
        return replace(point, problem=ring, w=w, tangent=tangent)

    def leads(self, first: Point) -> bool:
        """Whether its goal lies ahead of a first torus, and 1 - goal not nearer: theta -> -theta makes r of a torus
        1 - r."""
        name, until = self.goals.name, self.goals.until
        if self.free:
            return towards(first, name, until) > 0
        goal = until if until is not None else min(self.goals.at, default=None)
        if name != "rotation" or goal is None:
            return True
        ahead = [angle for angle in (goal, 2 * np.pi - goal) if towards(first, name, angle) > 0]
        return not ahead or min(ahead, key=lambda angle: abs(angle - first.w.angle)) == goal

    def record(self, point: Point) -> Torus:
        """The Torus. Raises `ConvergenceError` where its curve needs more states."""
        if unresolved(point.w.curve / self.ring.units) > RESOLVED:
            raise ConvergenceError(f"a torus needs more than {len(point.w.curve)} states")
        w, ring = point.w, point.problem
        p = ring.equations
        energy = ring.value(w, "energy") if p.model.conservative else np.nan
        measured = w.curve / ring.units
        free = {name: float(value) for name, value in zip(p.free, w.free, strict=True)}
        record = Torus(
            w.curve, w.period, float(w.angle / (2 * np.pi) % 1.0), energy, unresolved(measured), strip(measured), free
        )
        return certify_torus(record, self.model) if self.certify else record

    def write(self, point: Point, record: Torus) -> Entries:
        """Both in plain numbers."""
        return entries_of(record) | {
            "angle": point.w.angle, "numbers": point.w.free, "tangent": point.tangent, "steps": point.problem.steps,
            "arclength": point.arclength, "step": point.step,
        }  # fmt: skip

    def read(self, entry: Mapping[str, Any]) -> tuple[Point, Torus]:
        """Both from what was written."""
        record: Torus = typed(Torus, entry, "torus")
        w = Turned(record.curve, record.period, float(entry["angle"]), np.array(entry["numbers"], float))
        ring = replace(self.ring, steps=int(entry["steps"]))
        tangent = np.array(entry["tangent"], float)
        if tangent.shape != w.vector.shape:
            raise ValueError("a tangent of another size")
        return Point(ring, w, tangent, float(entry["arclength"]), float(entry["step"])), record


def _ended(curve: Direction, asked: str, until: float | None, most: int) -> str:
    """Why a family ends, in words."""
    assert curve.end is not None
    kinds = {"target": f"{asked} reached {until or 0.0:.12g}", "point limit": f"point limit of {most}"}
    return kinds.get(curve.end.kind) or _breaking([kept.record for kept in curve.points], asked, curve.end.reason)


def _breaking(tori: list[Torus], asked: str, why: str) -> str:
    """Why a family ends where it breaks down: the width of its strip, and where that goes to 0."""
    values = np.array([torus_value(member, asked) for member in tori])
    widths = np.array([member.strip for member in tori])
    told = f"break-down near {asked} {values[-1]:.9g}: {why}"
    if len(tori) > 2 and widths[-1] < widths[-3]:
        slope = (values[-1] - values[-3]) / (widths[-1] - widths[-3])
        zero = values[-1] - slope * widths[-1]
        told += f"; the strip of convergence is {widths[-1]:.3g} wide, and 0 near {zero:.6g}"
        low, high = sorted((values[-1], zero))
        between = [(p, q) for q in range(1, 13) for p in range(q + 1) if low <= p / q <= high]
        if asked == "rotation" and between:  # that of lowest order
            told += " (the resonance {}/{})".format(*between[0])
    return told


def torus_value(torus: Torus, name: str) -> float:
    """The rotation number, the energy or a freed parameter of a Torus."""
    return float(torus.free[name]) if name in torus.free else float(getattr(torus, name))


def certify_torus(torus: Torus, model: Model) -> Torus:
    """The Torus with its Certificate: DOP853 from angles between the states, nothing of the solver's taken on trust.

    invariance: max |phi_T(X(theta)) - X(theta + 2 pi rotation)| at random angles; returns: the same after many, on one
    motion; energy: its change over the curve; resonance, dimension (the sine between curve and flow), amplitude (of the
    curve), series (its highest harmonics), once (the curve is gone round once).
    """
    own = with_parameters(model, torus.free)
    angles = np.random.default_rng(20).uniform(0, 2 * np.pi, 12)
    field, turn = vector_field(accelerations(own)), 2 * np.pi * torus.rotation
    starts = at_angles(torus.curve, angles)
    times = np.linspace(0.0, torus.period, 33)
    longest = torus.period / STEPS_PER_PERIOD
    scale = nonzero(np.abs(starts).max(axis=0))
    units = np.where(scale > 1e-9 * scale.max(), scale, scale.max())
    paths = np.array([integrate_in(units, field, start, times, longest_step=longest) for start in starts])
    extents = extents_of(own, paths.reshape(-1, torus.curve.shape[1]), torus.period)
    missed = np.abs((paths[:, -1] - at_angles(torus.curve, angles + turn)) / extents).max()
    many = integrate_in(units, field, starts[0], torus.period * np.arange(RETURNS + 1), longest_step=longest)
    strayed = np.abs((many - at_angles(torus.curve, angles[0] + turn * np.arange(RETURNS + 1))) / extents).max()
    along = at_angles(torus.curve, angles, derivative=True) / extents
    flow = np.array([field(0.0, start) for start in starts]) / extents
    norms = np.linalg.norm(along, axis=1) * np.linalg.norm(flow, axis=1)
    across = np.sqrt(np.maximum(0.0, 1.0 - (np.sum(along * flow, axis=1) / nonzero(norms)) ** 2))
    size = float((np.ptp(torus.curve, axis=0) / extents).max())
    near = resonance(torus.rotation, len(torus.curve))
    # a curve is gone round as often as the greatest common divisor of the harmonics that are there
    curve = torus.curve / extents
    waves, sizes = spectrum(curve)
    there = waves[(waves > 0) & (sizes > 1e-6 * sizes[waves > 0].max())]
    checks = [
        at_most("invariance", missed, INVARIANT, "a return, between the curve's states, by another integrator"),
        at_most("returns", strayed, INVARIANT * RETURNS**2, f"{RETURNS} returns of one motion"),
        at_most("series", unresolved(curve), 10 * RESOLVED, "the highest harmonics"),
        at_least("dimension", float(across.min()), 1e-6, "sine between curve and flow"),
        at_least("amplitude", size, 1e-6, "the curve in extents of the motion"),
        equal("resonance", near is not None, 0.0, "{}/{}".format(*near) if near else "none up to the number of states"),
        at_most("once", float((gcd(*map(int, there)) if there.size else 0) - 1), 0.0, "the curve is gone round once"),
    ]  # fmt: skip
    if own.conservative:
        kinetic, potential = energies(own, starts)
        exchanged = np.abs(kinetic if own.rates is None else potential).max()
        drift = float(np.abs(kinetic + potential - torus.energy).max() / nonzero(exchanged))
        checks.append(at_most("energy", drift, INVARIANT, "over the curve, relative"))
    if own.forced:
        cycles = torus.period / own.driving_period
        checks.append(at_most("forcing", abs(cycles - round(cycles)), INVARIANT, "a return is whole periods of it"))
    return replace(torus, certificate=Certificate(tuple(checks)))
