"""What rooms say of themselves: each may have a file named after a registry, which fills it when it is first asked.

So nothing below names what is above it: a registry in `mechanics` knows the kinds that `mechanisms/kinds.py` enters
there if that room is installed, and is complete without it.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from typing import Any

from orbitfinder.errors import InputError

PACKAGE = __name__.partition(".")[0]


@cache
def filled(registry: str) -> None:
    """Import orbitfinder/ROOM/`registry`.py of every room that has one: "kinds", "methods", "records", "verifiers"."""
    for room in pkgutil.iter_modules(import_module(PACKAGE).__path__):
        name = f"{PACKAGE}.{room.name}.{registry}"
        if room.ispkg and find_spec(name):
            import_module(name)


def loaded(named: str | Callable[..., Any]) -> Callable[..., Any]:
    """What is named as "room.file:function", its module imported; a function itself. Raises `InputError`."""
    if callable(named):
        return named
    module, _, name = named.partition(":")
    try:
        entry = getattr(import_module(f"{PACKAGE}.{module}"), name, None)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{PACKAGE}.{module}".startswith(error.name):
            raise
        entry = None
    if not callable(entry):
        raise InputError(f"Kind: there is no {named!r} in orbitfinder; name 'room.file:function' in the entry of KINDS")
    return entry  # type: ignore[no-any-return]
