"""The answers of this room about orbits and families, for the registry of records."""

from orbitfinder.records.registry import answers

answers("orbit", page="site.gather:add_orbit")
answers("family", page="families")
