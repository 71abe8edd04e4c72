"""The records of this room, for the registry of records."""

from dataclasses import replace

from orbitfinder.families.diagram import load_diagram
from orbitfinder.families.equilibrium import EQUILIBRIA, Equilibria, load_equilibria
from orbitfinder.records.registry import KINDS, Kind

__all__ = ["EQUILIBRIA"]


def _each(equilibria: Equilibria) -> list[Equilibria]:
    return [replace(equilibria, name=f"{equilibria.name}-{k}", points=(point,), events=(), ends=())
            for k, point in enumerate(equilibria.points)]  # fmt: skip


KINDS[EQUILIBRIA] = Kind(
    "equilibria", load_equilibria, _each, holds=EQUILIBRIA, verify="families.rest_curves:verified",
    facts=lambda rest: rest if rest.ends else rest.points[0],
)  # fmt: skip
KINDS["diagram"] = Kind("a bifurcation diagram", load_diagram, verify="families.diagram:verified")
