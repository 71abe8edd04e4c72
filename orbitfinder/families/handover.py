"""A family that shooting cannot carry on, read by collocation: its points so far on meshes of collocation, from the last
of which it goes on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from orbitfinder.families.members import batch_certified
from orbitfinder.families.point import FamilySettings, freed, make_point, parameter_value, unknowns_of
from orbitfinder.families.registry import end_kind
from orbitfinder.integrate.collocation import Collocation
from orbitfinder.loops.continued import Curve, Solution, correct, plane
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.mesh import intervals, regridded, worked
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.collocate import settles
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.method import COLLOCATION
from orbitfinder.records.codec import plain
from orbitfinder.records.family import Batch, End, Event, FamilyPoint, Journal


def rescued(model: Model, state: np.ndarray, period: float) -> bool:
    """Whether collocation is tried on the orbits of a system where shooting fails."""
    return settles(Problem(model, Guess(state, period)))


def given_up(curve: Curve, settings: FamilySettings, end: End | None, last: FamilyPoint) -> bool:
    """Whether an end is shooting's own, where collocation may go on."""
    p = curve.equations
    stuck = end is not None and end_kind(end.kind).stuck and not (settings.method or p.collocated or curve.test)
    whole = p.symmetry.name == NONE.name and not p.symmetry.relative
    return stuck and whole and rescued(p.model, last.state, last.period)


def collocated(curve: Curve) -> Curve:
    """The same curve, integrated by collocation."""
    p = curve.equations
    return replace(curve, equations=Equations(p.model, p.symmetry, p.free, action=True, collocated=True))


def handed_over(journal: Journal, old: Curve, check: ClosureCheck | None, certify: bool, why: str) -> Journal:
    """A journal of shooting as one of collocation that has its points and events, and says why.

    Raises `ConvergenceError` or `IntegrationError` where one of them is not found on a mesh of collocation.
    """
    new, name = collocated(old), str(journal.header["parameter"])

    def point(member: FamilyPoint) -> FamilyPoint:
        where = {entry: getattr(member, entry) for entry in ("index", "arclength", "step", "role", "indices", "wall_time")}
        return make_point(new, _read(old, new, member), member.tangent, name, check, **where)

    def event(member: Event) -> Event:
        w = _read(old, new, member).place
        return replace(
            member, parameter=parameter_value(new, w, name), state=w.nodes[0], period=w.period, free=freed(new, w),
            energy=parameter_value(new, w, "energy"), shooting_nodes=w.nodes, mesh=w.mesh, certified=False,
        )  # fmt: skip

    def read(batch: Batch) -> Batch:
        batch = replace(batch, points=tuple(map(point, batch.points)), events=tuple(map(event, batch.events)))
        return batch_certified(new, replace(batch, standing=None)) if certify else batch

    entry = {**journal.header["curve"], "method": COLLOCATION, "method_reason": why}
    header: Mapping[str, Any] = {**journal.header, "origin": plain(point(journal.origin)), "curve": entry}
    return Journal(header, tuple(map(read, journal.batches)))


def _read(old: Curve, new: Curve, member: FamilyPoint | Event) -> Solution:
    """The orbit of a point or event of shooting on a mesh of collocation that fits it."""
    march, place = new.equations.march, unknowns_of(old, member)
    assert isinstance(march, Collocation)
    states = old.equations.march.states(place.nodes, place.mesh, place.tail)
    place = replace(place, nodes=states[:-1])  # each step an interval
    place = regridded(march, place, intervals(worked(march, place)))
    return correct(new, place, plane(new, place, member.tangent), place)
