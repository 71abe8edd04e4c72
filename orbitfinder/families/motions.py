"""Motions along a family for pictures: whole periods of a few of its orbits, integrated from their nodes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.families.point import Family, FamilyPoint, FamilySettings, unknowns_of
from orbitfinder.families.start import curve_of, full_samples
from orbitfinder.loops.continued import at_place
from orbitfinder.mechanics.model import Model, positions

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
        states = full_samples(curve, at_place(curve, unknowns_of(curve, points[k])), SAMPLES)[1]
        there = at_values(model, points[k].free)
        found.append(Motion(points[k], states, positions(there, states) if model.points is not None else None))
    return found
