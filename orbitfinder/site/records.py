"""The answers of this room about orbits, families and equilibria, for the registry of records."""

from orbitfinder.families.records import EQUILIBRIA
from orbitfinder.records.registry import answers

answers("orbit", page="site.gather:add_orbit")
answers("family", page="families")
answers(EQUILIBRIA, page="equilibria")
