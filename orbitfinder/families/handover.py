"""A family that shooting cannot carry on, read by another method: its points so far on meshes of that, from the last
of which it goes on."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.errors import UNSOLVED
from orbitfinder.families.members import batch_certified
from orbitfinder.families.point import freed, make_point, parameter_value, unknowns_of
from orbitfinder.families.run import Run, in_scales
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import Curve, Solution, correct, plane
from orbitfinder.loops.loop import Condition, Equations
from orbitfinder.loops.mesh import regridded
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.method import Method, begins, named, rescuer
from orbitfinder.records.codec import plain
from orbitfinder.records.family import JOURNAL, Batch, End, Event, FamilyPoint, Journal
from orbitfinder.records.journal import begin_journal


def rescued(model: Model, state: np.ndarray, period: float) -> Method | None:
    """The method that is tried on the orbits of a system where shooting fails, if any is."""
    name = rescuer(Problem(model, Guess(state, period)))
    return named(name) if name and begins(name) else None


def handed_over(
    folder: Path | None, journal: Journal, run: Run, end: End | None, last: FamilyPoint
) -> tuple[Journal, Curve] | None:
    """The journal of a family as one of another method, which says why, and its curve, where a run of shooting ended as
    it could not go on; None where it need not be. It is written where there is a folder."""
    p, settings, log = run.curve.equations, run.settings, logging.getLogger(__name__)
    stuck = end is not None and end.facts.stuck and not (settings.method or p.gridded or run.curve.test)
    whole = p.symmetry.name == NONE.name and not p.symmetry.relative
    if end is None or not (stuck and whole and (method := rescued(p.model, last.state, last.period))):
        return None
    why = f"shooting ended at {settings.parameter} {last.value:.9g} ({end.kind}: {end.reason})"
    curve = replace(run.curve, equations=Equations.of(p.model, p.symmetry, p.free, method.march))
    check = ClosureCheck(p.model, stiff=method.march.stiff) if settings.certify else None
    try:
        journal = _read(journal, run.curve, curve, check, why)
    except UNSOLVED as error:
        log.warning("%s; %s does not have its points: %s", why, method.march.name, error)
        return None
    log.warning("%s; it goes on by %s", why, method.march.name)
    if folder is not None:
        begin_journal(folder / JOURNAL, plain(journal.header), map(plain, journal.batches))
    return journal, in_scales(curve, journal.origin)


def _read(journal: Journal, old: Curve, new: Curve, check: ClosureCheck | None, why: str) -> Journal:
    """A journal of shooting as one of another method that has its points and events."""
    name = str(journal.header["parameter"])

    def point(member: FamilyPoint) -> FamilyPoint:
        kept = ("index", "arclength", "step", "role", "indices", "wall_time")
        where = {entry: getattr(member, entry) for entry in kept}
        exact = pinned(new.equations, name, member.value) if member.role != "step" else None
        return make_point(new, _on_mesh(old, new, member, exact), member.tangent, name, check, **where)

    def event(member: Event) -> Event:
        w = _on_mesh(old, new, member).place
        return replace(
            member, parameter=parameter_value(new, w, name), state=w.nodes[0], period=w.period, free=freed(new, w),
            energy=parameter_value(new, w, "energy"), shooting_nodes=w.nodes, mesh=w.mesh, certified=False,
        )  # fmt: skip

    def batch(known: Batch) -> Batch:
        points, events = tuple(map(point, known.points)), tuple(map(event, known.events))
        made = replace(known, points=points, events=events, standing=None)
        return batch_certified(new, made) if check else made

    entry = {**journal.header["curve"], "method": new.equations.by.name, "method_reason": why}
    header: Mapping[str, Any] = {**journal.header, "origin": plain(point(journal.origin)), "curve": entry}
    return Journal(header, tuple(map(batch, journal.batches)))


def _on_mesh(old: Curve, new: Curve, member: FamilyPoint | Event, aim: Condition | None = None) -> Solution:
    """The orbit of a point or event of shooting on a mesh of another method that fits it, where an aim is met."""
    march, place = new.equations.gridded, unknowns_of(old, member)
    assert march is not None
    states = old.equations.march.states(place.nodes, place.mesh, place.tail)
    place = replace(place, nodes=states[:-1])  # each step an interval
    place = regridded(march, place)
    return correct(new, place, aim or plane(new, place, member.tangent), place)
