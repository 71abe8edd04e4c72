"""A family as every picture draws it: what its axes are, where points and events lie, how events look."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from orbitfinder.errors import FAILURES
from orbitfinder.families.entries import LOOKS, kind_of
from orbitfinder.families.equilibrium import RestEvent
from orbitfinder.families.members import response
from orbitfinder.families.registry import Look
from orbitfinder.mechanics.kind import build_model
from orbitfinder.records.family import Event, Family

__all__ = ["LOOKS", "Diagram", "diagram_of", "frequencies", "mark_of"]


CURVES_OF_RESTS = {"bogdanov_takens": Look("D"), "fold_hopf": Look("P"), "double_hopf": Look("s")}
"""Points on curves of equilibria in two parameters that families have not, beside discs, generalised Hopf points"""


def mark_of(event: Event | RestEvent) -> Look:
    """How an event is drawn; one of a kind that nobody knows as a star."""
    look: Look = CURVES_OF_RESTS.get(event.kind) or LOOKS.get(event.kind, Look("*", "star"))
    return look


@dataclass(frozen=True)
class Diagram:
    """A family as a curve: what its axes are called (across, up), and the `places` (k x 2) of its points and then of
    its events."""

    family: Family
    names: tuple[str, str]
    places: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """Where its points are."""
        return self.places[: len(self.family.points)]

    @property
    def events(self) -> np.ndarray:
        """Where its events are."""
        return self.places[len(self.family.points) :]

    @property
    def stretches(self) -> list[tuple[bool | None, np.ndarray]]:
        """Stretches (k x 2) that are stable or not, None of orbits of which nothing decides, which meet where that
        changes."""
        stable, cuts = verdicts(self.family), changes(self.family)
        ends = [0, *(k for k, _ in cuts), len(stable)]
        stretches = [(stable[k], self.points[max(k - 1, 0) : end]) for k, end in pairwise(ends)]
        for number, (k, at) in enumerate(cuts):
            if at is not None:
                place = self.events[at]
                stretches[number] = (stable[k - 1], np.vstack([stretches[number][1], place]))
                stretches[number + 1] = (stable[k], np.vstack([place, stretches[number + 1][1][1:]]))
        return stretches


def verdicts(family: Family) -> list[bool | None]:
    """Whether each point is stable, None where nothing decides."""
    said = {"unstable": False, "marginal": None}
    return [said.get(point.stability, True) for point in family.points]


def changes(family: Family) -> list[tuple[int, int | None]]:
    """The points that are not of the same stability as those before, and the number of the event between them that
    changes it, where that is known."""
    points, stable = family.points, verdicts(family)

    def between(k: int) -> list[int]:
        low, high = points[k - 1].arclength, points[k].arclength
        told = enumerate(family.events)
        return [n for n, event in told if low <= event.arclength <= high and kind_of(event.kind).verdict]

    return [(k, next(iter(between(k)[-1:]), None)) for k in range(1, len(points)) if stable[k] != stable[k - 1]]


def entitled(*records: Any) -> str:
    """What a picture of records is headed by: the title of what one was started from, else the names."""
    titles = [
        record.source.get("title") if isinstance(record, Family) else getattr(record, "title", "") for record in records
    ]
    return str(titles[0]) if titles[0] and len(records) == 1 else ", ".join(record.name for record in records)


def frequencies(family: Family) -> np.ndarray:
    """1 / period of its points and then of its events."""
    return np.array([1 / member.period for member in family.members])


def diagram_of(family: Family) -> Diagram:
    """Frequency against energy, or against the parameter where the energy hardly changes; of what dissipates the
    amplitude against the parameter; of a curve of bifurcations its second parameter against its first."""
    if len(family.parameters) > 1:
        return Diagram(family, family.parameters[:2], family.places)  # type: ignore[arg-type]
    try:
        moved, sizes = response(family, build_model(family.system))
    except FAILURES:
        moved, sizes = "", np.zeros(0)
    by_energy = family.by_energy and not moved
    levels = np.nan_to_num([member.energy for member in family.members])
    along, across = (levels, "energy (J)") if by_energy else (family.places[:, 0], family.parameter)
    up = (sizes, f"amplitude of {moved}") if moved else (frequencies(family), "frequency (1/s)")
    return Diagram(family, (across, up[1]), np.column_stack([along, up[0]]))
