"""The records of this room, for the registry of records."""

from dataclasses import replace
from typing import Any

from orbitfinder.errors import plural
from orbitfinder.families.diagram import load_diagram
from orbitfinder.families.equilibrium import EQUILIBRIA, Equilibria, load_equilibria
from orbitfinder.families.happening import facts
from orbitfinder.families.plane import load_map
from orbitfinder.records.registry import KINDS, Kind, answers

__all__ = ["EQUILIBRIA"]


def _each(equilibria: Equilibria) -> list[Equilibria]:
    return [replace(equilibria, name=f"{equilibria.name}-{k}", points=(point,), events=(), ends=())
            for k, point in enumerate(equilibria.points)]  # fmt: skip


def _facts(rest: Equilibria, shown: int = 2) -> Any:
    """What is shown of equilibria: of many only the outermost."""
    if not rest.ends:
        return rest.points[0]
    points, more = rest.points, len(rest.points) - 2 * shown
    sure = sum(point.certified for point in points)
    some = (*points[:shown], f"and {more} more", *points[-shown:]) if more > 1 else points
    return {
        "counts": f"{len(points)} equilibria, {sure} certified; {plural(len(rest.events), 'event')}",
        **facts(rest),
        "points": some,
    }


answers("family", facts=facts)
KINDS[EQUILIBRIA] = Kind(
    "equilibria", load_equilibria, _each, holds=EQUILIBRIA, verify="families.rest_curves:verified", facts=_facts,
)  # fmt: skip
KINDS["diagram"] = Kind(
    "a bifurcation diagram", load_diagram, verify="families.diagram:verified", facts="families.diagram:facts"
)
KINDS["map"] = Kind("a map of a parameter plane", load_map, verify="families.mapping:verified")
