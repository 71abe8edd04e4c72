"""The answers of this room about orbits, families, equilibria and maps, for the registry of records."""

from orbitfinder.families.records import EQUILIBRIA
from orbitfinder.records.registry import answers

answers("orbit", page="site.gather:add_orbit")
answers("family", page="families")
answers(EQUILIBRIA, page="equilibria")
answers("map", page="maps")
