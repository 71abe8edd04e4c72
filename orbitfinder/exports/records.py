"""The answers of this room about orbits, for the registry of records."""

from orbitfinder.records.registry import answers

answers("orbit", export="exports.write:export_orbit")
