"""The full certificate of single orbits of a family: of those asked for, of its ends and of its events."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from orbitfinder.families.point import winding
from orbitfinder.families.stability import spectrum
from orbitfinder.families.start import SAMPLES, full_samples
from orbitfinder.loops.continued import Curve, Place, at_place
from orbitfinder.loops.symmetry import recognise
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.mechanics.model import energy
from orbitfinder.orbits.certify import certify
from orbitfinder.records.family import CLOSURE, Batch, Event, FamilyPoint
from orbitfinder.records.orbit import Orbit

Member = TypeVar("Member", FamilyPoint, Event)


def as_orbit(curve: Curve, member: FamilyPoint | Event, name: str = "point") -> tuple[Orbit, dict[str, float]]:
    """A point or an event of a family as an Orbit without certificate, and the freed parameters it has."""
    model, free = curve.propagator.model, dict(member.free)
    place = Place(member.shooting_nodes, member.period, np.zeros(curve.propagator.unfolding),
                  np.array(list(free.values())), member.mesh)  # fmt: skip
    place = replace(place, unfolding=np.array(member.unfolding)) if isinstance(member, FamilyPoint) else place
    found = at_place(curve, place)
    floquet = spectrum(curve, found).floquet
    times, states = full_samples(curve, found, 4 * SAMPLES)
    orbit = Orbit(
        name=name, system=model.system, state=member.state, period=member.period,
        energy=energy(with_parameters(model, free), member.state),
        action=found.march.action / curve.propagator.symmetry.fraction, closure=0.0,
        symmetry=recognise(times, states, np.asarray(model.angles)),
        winding=winding(curve), floquet_multipliers=floquet.multipliers,
        pair_defect=floquet.pair_defect, stability=floquet.stability,
        unfolding=tuple(float(s) for s in place.unfolding), nodes=member.state[None],
        times=np.zeros(0), samples=np.zeros((0, member.state.size)), tolerance=CLOSURE,
    )  # fmt: skip
    return orbit, free


def certified(curve: Curve, member: Member) -> Member:
    """The same, `certified` where its orbit passes every check."""
    orbit, free = as_orbit(curve, member)
    return replace(member, certified=certify(orbit, with_parameters(curve.propagator.model, free)).passed)


def batch_certified(curve: Curve, batch: Batch) -> Batch:
    """A step with its events and the points that were asked for certified."""
    points = tuple(certified(curve, one) if one.role != "step" else one for one in batch.points)
    return replace(batch, points=points, events=tuple(certified(curve, one) for one in batch.events))
