"""The answers of this room about orbits and equilibria, for the registry of records."""

from orbitfinder.families.records import EQUILIBRIA
from orbitfinder.records.registry import answers

answers("orbit", export="exports.write:export_orbit")
answers(EQUILIBRIA, export="exports.tables:export_equilibria")
