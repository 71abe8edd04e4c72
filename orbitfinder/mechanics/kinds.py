"""The kinds of [system] that the core knows beside `python`, for the registry of kinds."""

from orbitfinder.mechanics import equations  # noqa: F401
