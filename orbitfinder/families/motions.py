"""Motions along a family for pictures: whole periods of a few of its orbits, integrated from their nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.families.point import FamilySettings, place_of
from orbitfinder.families.start import curve_of, full_samples
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.loops.continued import at_place
from orbitfinder.loops.symmetry import recognise
from orbitfinder.mechanics.model import Model, positions
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.measure import dense
from orbitfinder.records.family import Family, FamilyPoint
from orbitfinder.records.orbit import Orbit

SAMPLES = 240


@dataclass(frozen=True)
class Motion:
    """One orbit of a family: its point, states (k x 2n) at equal times over a period, joints (k x 2 x m) or None."""

    point: FamilyPoint
    states: np.ndarray
    joints: np.ndarray | None


def at_values(model: Model, free: Mapping[str, float]) -> Model:
    """The same equations at other values of some parameters."""
    numbers = model.parameter_values.copy()
    for name, value in free.items():
        numbers[model.parameter_index(name)] = value
    return replace(model, parameter_values=numbers)


def whole(orbit: Orbit, model: Model) -> Orbit:
    """The orbit with samples over its period; a point of a family as an Orbit of its own, certified, with the symmetry
    that it has and not only its formulation's.
    """
    if not isinstance(orbit, FamilyPoint) or not (orbit.curve and orbit.mesh.size):
        times, samples = dense(build_flow(model, (), model.invariants), orbit.nodes, orbit.period)
    else:
        curve = curve_of(orbit.curve, model, FamilySettings(parameter=next(iter(orbit.free), "energy")))
        times, samples = full_samples(curve, at_place(curve, place_of(orbit)), 4 * SAMPLES)
    kept = {one.name: getattr(orbit, one.name) for one in fields(Orbit)} | {"times": times, "samples": samples}
    if not isinstance(orbit, FamilyPoint):
        return Orbit(**kept)
    symmetry = recognise(times, samples, np.asarray(model.angles))
    return certified(Orbit(**kept | {"symmetry": symmetry, "closure": 0.0}), model)


def motions(family: Family, model: Model, count: int = 8) -> list[Motion]:
    """`count` orbits at equal arclengths from one end of a family to the other. Raises `InputError`."""
    points = [point for point in family.points if point.mesh.size]
    if not family.curve or not points:
        raise InputError(f"{family.name}: no nodes beside the family; continue it again")
    curve = curve_of(family.curve, model, FamilySettings(parameter=family.parameter))
    places = np.array([point.arclength for point in points])
    wanted = np.linspace(places[0], places[-1], count)
    chosen = sorted({int(np.argmin(np.abs(places - place))) for place in wanted})
    found = []
    for k in chosen:
        states = full_samples(curve, at_place(curve, place_of(points[k])), SAMPLES)[1]
        there = at_values(model, points[k].free)
        found.append(Motion(points[k], states, positions(there, states) if model.points is not None else None))
    return found
