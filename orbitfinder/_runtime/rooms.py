"""What rooms say of themselves: each may have a file named after a registry, which fills it when it is first asked.

So nothing below names what is above it: a registry in `mechanics` knows the kinds that `mechanisms/kinds.py` enters
there if that room is installed, and is complete without it.
"""

from __future__ import annotations

import pkgutil
from functools import cache
from importlib import import_module
from importlib.util import find_spec

PACKAGE = __name__.partition(".")[0]


@cache
def filled(registry: str) -> None:
    """Import orbitfinder/ROOM/`registry`.py of every room that has one: "kinds", "methods", "records", "verifiers"."""
    for room in pkgutil.iter_modules(import_module(PACKAGE).__path__):
        name = f"{PACKAGE}.{room.name}.{registry}"
        if room.ispkg and find_spec(name):
            import_module(name)
