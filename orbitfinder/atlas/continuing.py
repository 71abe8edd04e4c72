"""The strategy that starts from a known orbit of another energy and follows its family to this one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from orbitfinder.atlas.attempt import Attempt, Numbers, finished, reasons
from orbitfinder.atlas.solver import QuickSettings
from orbitfinder.atlas.starts import Bench, Start
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.follow import follow
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Run, first_point
from orbitfinder.families.start import begin
from orbitfinder.records.family import FamilyPoint
from orbitfinder.records.orbit import Orbit, orbit_from_document

CONTINUATION = "continuation"
SETTINGS = FamilySettings(points=40, first_step=0.1, longest_step=0.6, events=False, certify=False, longest_period=4.0)
"""A family is left when it takes longer than this to reach the energy, or slows down too much."""


def continued(
    one: Bench, seed: int, index: int, source: Mapping[str, Any], known: Callable[[Numbers], bool] | None = None
) -> Attempt:
    """The attempt from the orbit of a document, followed to the energy of the bench."""
    with reasons(index, CONTINUATION) as ended:
        point = followed(one, orbit_from_document(source))
        start = Start(index, CONTINUATION, "none", point.state, point.period)
        ended.append(finished(one, seed, start, known, QuickSettings()))
    return ended[-1]


def followed(one: Bench, orbit: Orbit) -> FamilyPoint:
    """The first orbit of a family at the energy of the bench; `ConvergenceError` when it ends before."""
    try:
        start = begin(orbit, SETTINGS)
    except InputError as error:
        raise ConvergenceError("family cannot be followed") from error
    origin = first_point(start, SETTINGS, None)
    towards = 1 if one.target.energy > origin.value else -1
    for batch in follow(Run(start.curve, SETTINGS, towards, origin, until=one.target.energy)):
        for point in batch.points:
            if point.role == "end":
                return point
    raise ConvergenceError("family ends before the energy")
