"""Single members of a family as orbits of their own: with samples, with a certificate, as motions for pictures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.families.motion import full_samples, graded
from orbitfinder.families.point import FamilySettings, make_point, unknowns_of
from orbitfinder.families.start import by_series, curve_in, curve_of
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.continued import Curve, at_place
from orbitfinder.loops.symmetry import recognise
from orbitfinder.loops.watch import mean, range_of
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import certified as with_certificate
from orbitfinder.orbits.certify import certify, shown
from orbitfinder.orbits.course import course, sampled
from orbitfinder.orbits.measure import dense
from orbitfinder.records.family import Batch, Event, Family, FamilyPoint
from orbitfinder.records.orbit import Orbit

SAMPLES = 960
"""Intervals of a period by which an orbit is known, and that a picture shows"""
STEADY = 1e6
"""What errors grow by on an orbit that is drawn from its state alone; beyond, it would be seen to leave itself."""
Member = TypeVar("Member", FamilyPoint, Event)


@dataclass(frozen=True)
class MemberMotion:
    """One orbit of a family: its point, states (k x 2n) over a period, broken by nan where it jumps, and joints
    (k x 2 x m) at equal times or None."""

    point: FamilyPoint
    states: np.ndarray
    joints: np.ndarray | None
    strokes: tuple[tuple[str, tuple[int, ...]], ...] = ()


def whole(orbit: Orbit, model: Model) -> Orbit:
    """The orbit with samples over its period, integrated where it has none; a point of a family as an Orbit of its own,
    certified, with the symmetry that it has and not only its formulation's.
    """
    if len(orbit.samples) > 1:
        return orbit
    times, samples = _period(orbit, model)
    if not isinstance(orbit, FamilyPoint):
        return replace(orbit, times=times, samples=samples)
    symmetry = recognise(times, samples, model)
    return with_certificate(_alone(orbit, times=times, samples=samples, symmetry=symmetry, closure=0.0), model)


def sampled_point(point: FamilyPoint) -> FamilyPoint:
    """A point with times and samples over its period. Raises `InputError` where no file describes its system."""
    try:
        model = build_model(point.system)
    except InputError as error:
        raise InputError(f"{error}; or of.simulate(model, point.state, point.period, parameters=point.free)") from error
    times, samples = _period(point, model)
    return replace(point, times=times, samples=samples)


def _alone(point: FamilyPoint, **changed: Any) -> Orbit:
    """A point as an Orbit of its own."""
    return Orbit(**{entry.name: getattr(point, entry.name) for entry in fields(Orbit)} | changed)


def _period(orbit: Orbit, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Times and states over one period: of a point of a family by its shooting nodes; of a hybrid orbit those of its
    simulation."""
    if not isinstance(orbit, FamilyPoint) and (given := shown(orbit, model)) is not None:
        return given
    if not model.smooth:
        return sampled(model, orbit.state, orbit.period)
    if not isinstance(orbit, FamilyPoint) or not (orbit.curve and orbit.mesh.size):
        return dense(build_flow(model, (), model.invariants), orbit.nodes, orbit.period)
    if by_series(orbit.curve):
        return np.linspace(0.0, orbit.period, SAMPLES + 1), series(orbit.shooting_nodes, SAMPLES)
    curve = curve_of(orbit.curve, model, FamilySettings(parameter=next(iter(orbit.free), "energy")))
    return full_samples(curve, at_place(curve, unknowns_of(curve, orbit)), SAMPLES)


def series(nodes: np.ndarray, count: int) -> np.ndarray:
    """States (count + 1 x d) at equal times over a period, of the trigonometric series through some (N x d)."""
    found = np.fft.irfft(np.fft.rfft(nodes, axis=0), count, axis=0) * (count / len(nodes))
    return np.vstack([found, found[:1]])


def response(family: Family, model: Model) -> tuple[str, np.ndarray]:
    """Of a family that dissipates: the coordinate that moves most, and its amplitude at every point and then event.

    Nothing, "" and no numbers, of one that is told apart by its energy.
    """
    if not (model.dissipative and family.curve):
        return "", np.zeros(0)
    sizes = amplitudes(family, model)
    most = int(sizes.max(axis=0).argmax())
    return model.state_names[most], sizes[:, most]


def orbit_at(curve: Curve, event: Event, model: Model) -> Orbit:
    """The orbit of an event, without certificate; the model has its freed parameters."""
    solution = at_place(curve, unknowns_of(curve, event))
    times, states = full_samples(curve, solution, SAMPLES)
    index, arclength = event.index, event.arclength
    point = make_point(curve, solution, event.tangent, "energy", None, index=index, arclength=arclength, step=0.0)
    return _alone(point, name="event", symmetry=recognise(times, states, model))


def certified(curve: Curve, member: Member) -> Member:
    """The same, `certified` where its orbit passes every check.

    That of an event or on a curve of them need not be isolated at its parameters, as it is not at a fold: its own
    check says how far it may be off.
    """
    model = with_parameters(curve.equations.model, member.free)
    orbit = member if isinstance(member, FamilyPoint) else orbit_at(curve, member, model)
    failed = set(certify(orbit, model).failures)
    special = isinstance(member, Event) or curve.test is not None
    return replace(member, certified=failed <= ({"distance"} if special else set()))


def batch_certified(curve: Curve, batch: Batch) -> Batch:
    """A step with its events and the points that were asked for certified."""
    points = tuple(certified(curve, point) if point.role != "step" else point for point in batch.points)
    return replace(batch, points=points, events=tuple(certified(curve, event) for event in batch.events))


def motions(family: Family, model: Model, count: int = 8) -> list[MemberMotion]:
    """`count` orbits along a family, spread by frequency, without family.npz of its less unstable orbits."""
    points = [point for point in family.points if point.mesh.size or point.scale < STEADY]
    if not points:
        raise InputError(f"{family.name}: no nodes beside the family, and no orbit steady without; continue it again")
    places = _spread([1.0 / point.period for point in points]) + 0.2 * _spread([point.arclength for point in points])
    wanted = np.linspace(places[0], places[-1], count)
    chosen = sorted({int(np.argmin(np.abs(places - place))) for place in wanted})
    shown = []
    for k in chosen:
        there = with_parameters(model, points[k].free)
        path = course(there, *_period(points[k], there))
        moments = np.linspace(0.0, path.period, SAMPLES + 1)[: -1 if path.jumps else None]
        joints = None if model.points is None else path.positions(moments)
        shown.append(MemberMotion(points[k], path.samples, joints, model.strokes))
    return shown


def _spread(values: Sequence[float]) -> np.ndarray:
    """How much of the way that a number goes along a family is behind each point, 0 to 1."""
    way = np.append(0.0, np.cumsum(np.abs(np.diff(values))))
    return way / (way[-1] or 1.0)


def amplitudes(family: Family, model: Model) -> np.ndarray:
    """Half the range (k x n) of every coordinate over a period, of each point and then of each event.

    Without family.npz their states alone are integrated. Raises `InputError`.
    """
    return np.diff(extents(family, model), axis=1)[:, 0] / 2


def extents(family: Family, model: Model) -> np.ndarray:
    """The least and the greatest value (k x 2 x n) over a period of every coordinate, of each point and then of each
    event, between its samples too."""
    n = model.degrees_of_freedom
    return np.array([range_of(times, states[:, :n]) for times, states in _motions(family, model)])


def norms(family: Family, model: Model) -> np.ndarray:
    """The root mean square over a period of the length of the state (k), of each point and then of each event."""
    return np.sqrt([mean(times, (states**2).sum(axis=1)) for times, states in _motions(family, model)])


def _motions(family: Family, model: Model) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Times and states over a period of each point and then of each event, as dense as their meshes."""
    if by_series(family.curve):
        for member in family.members:
            states = series(member.shooting_nodes, max(SAMPLES, 8 * len(member.shooting_nodes)))
            yield np.linspace(0.0, member.period, len(states)), states
        return
    curve = curve_in(family, model)
    mesh = uniform(curve.equations.symmetry.fraction, 1, SAMPLES // 4)
    for member in family.members:
        known = member if member.mesh.size else replace(member, shooting_nodes=member.state[None], mesh=mesh)
        yield graded(curve, at_place(curve, unknowns_of(curve, known)))
