"""The page of equilibria: their curve, what happens on it, the cycles that are born there."""

from __future__ import annotations

from typing import Any

from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.records.codec import entries_of
from orbitfinder.records.family import Family
from orbitfinder.show.rest import most_moved, names_of
from orbitfinder.show.scene import evenly
from orbitfinder.site.gather import Gathered
from orbitfinder.site.motion import Simulator
from orbitfinder.site.pages import spread
from orbitfinder.site.text import coordinate

MOST_POINTS, MOST_NUMBERS, MOST_CYCLES = 600, 40_000, 60
"""Points, numbers of points and cycles of a family that a page holds"""


def equilibria_data(equilibria: Equilibria, gathered: Gathered) -> dict[str, Any]:
    """What the script of the page works with: the numbers of points (chosen where there are many) and events."""
    points, names = equilibria.points, [*names_of(equilibria, gathered.model)]
    beside = {event.index + k for event in equilibria.events for k in (0, 1)}  # where the stability changes
    chosen = {*evenly(len(points), max(2, min(MOST_POINTS, MOST_NUMBERS // (3 * len(names))))), *beside}
    return {
        "name": equilibria.name, "parameter": equilibria.parameter, "names": names, "up": most_moved(equilibria),
        "labels": [coordinate(name) for name in names],
        "points": [entries_of(points[k]) | {"number": k} for k in sorted(chosen) if k < len(points)],
        "events": [entries_of(event) | {"words": event.words} for event in equilibria.events],
    }  # fmt: skip


def cycles_data(family: Family, page: str, simulator: Simulator) -> dict[str, Any]:
    """The least and the largest of every component of cycles along the family of a page; null of what is not drawn."""
    chosen = spread(family.points, MOST_CYCLES)
    motions = [simulator.member(family.system, family.points[k]) for k in chosen]
    low, high = (
        [motion and getattr(motion.states, side)(axis=0).tolist() for motion in motions] for side in ("min", "max")
    )
    places = [[family.points[k].value, f"{page}#point={k}", family.points[k].stability] for k in chosen]
    return {"name": family.name, "places": places, "low": low, "high": high}
