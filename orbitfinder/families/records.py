"""The records of this room, for the registry of records."""

from orbitfinder.families.equilibrium import load_equilibria
from orbitfinder.records.registry import KINDS, Kind

KINDS["equilibria"] = Kind("equilibria", load_equilibria, verify="families.equilibria:verified")
