"""The full certificate of single orbits of a family: of those asked for, of its ends and of its events."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

import numpy as np

from orbitfinder.families.point import Batch, Event, FamilyPoint, unknowns_of, winding
from orbitfinder.families.stability import spectrum
from orbitfinder.families.start import SAMPLES, full_samples
from orbitfinder.loops.continued import Curve, at_place
from orbitfinder.loops.symmetry import recognise
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.mechanics.model import energy
from orbitfinder.orbits.certify import certify
from orbitfinder.records.orbit import Orbit

TOLERANCE = 1e-11
Member = TypeVar("Member", FamilyPoint, Event)


def as_orbit(curve: Curve, member: FamilyPoint | Event, name: str = "point") -> tuple[Orbit, dict[str, float]]:
    """A point or an event of a family as an Orbit without certificate, and the freed parameters it has."""
    model, free = curve.equations.model, dict(member.free)
    found = at_place(curve, unknowns_of(curve, member))
    floquet = spectrum(curve, found).floquet
    times, states = full_samples(curve, found, 4 * SAMPLES)
    orbit = Orbit(
        name=name, system=model.system, state=member.state, period=member.period,
        energy=energy(with_parameters(model, free), member.state),
        action=found.march.integral / curve.equations.symmetry.fraction, closure=0.0,
        symmetry=recognise(times, states, model),
        winding=tuple(int(k) for k in winding(curve)), floquet_multipliers=floquet.multipliers,
        pair_defect=floquet.pair_defect, stability=floquet.stability,
        unfolding=tuple(float(s) for s in found.place.unfolding), nodes=member.state[None],
        times=np.zeros(0), samples=np.zeros((0, member.state.size)), tolerance=TOLERANCE,
    )  # fmt: skip
    return orbit, free


def certified(curve: Curve, member: Member) -> Member:
    """The same, `certified` where its orbit passes every check."""
    orbit, free = as_orbit(curve, member)
    return replace(member, certified=certify(orbit, with_parameters(curve.equations.model, free)).passed)


def batch_certified(curve: Curve, batch: Batch) -> Batch:
    """A step with its events and the points that were asked for certified."""
    points = tuple(certified(curve, one) if one.role != "step" else one for one in batch.points)
    return replace(batch, points=points, events=tuple(certified(curve, one) for one in batch.events))
