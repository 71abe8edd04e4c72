"""The records of this room, for the registry of records."""

from dataclasses import replace

from orbitfinder.families.equilibrium import EQUILIBRIA, Equilibria, Equilibrium, load_equilibria
from orbitfinder.records.registry import KINDS, Kind


def _each(equilibria: Equilibria) -> list[Equilibria]:
    return [replace(equilibria, name=f"{equilibria.name}-{k}", points=(point,), events=(), ends=())
            for k, point in enumerate(equilibria.points)]  # fmt: skip


def _facts(equilibria: Equilibria) -> Equilibria | Equilibrium:
    return equilibria if equilibria.ends or len(equilibria.points) > 1 else equilibria.points[0]


KINDS[EQUILIBRIA] = Kind(
    "equilibria", load_equilibria, _each, holds=EQUILIBRIA, facts=_facts, verify="families.equilibria:verified",
)  # fmt: skip
