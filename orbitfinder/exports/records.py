"""The answers of this room about orbits and tables, for the registry of records."""

from orbitfinder.families.records import EQUILIBRIA
from orbitfinder.records.registry import answers

answers("orbit", export="exports.write:export_orbit")
for kind in ("family", EQUILIBRIA, "diagram", "map", "sweep"):
    answers(kind, export="exports.tables:export_table")
