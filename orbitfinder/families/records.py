"""The records of this room, for the registry of records."""

from orbitfinder.families.diagram import load_diagram
from orbitfinder.families.equilibrium import EQUILIBRIA, load_equilibria
from orbitfinder.records.registry import KINDS, Kind

KINDS[EQUILIBRIA] = Kind("equilibria", load_equilibria, verify="families.rest_curves:verified")
KINDS["diagram"] = Kind("a bifurcation diagram", load_diagram, verify="families.diagram:verified")
