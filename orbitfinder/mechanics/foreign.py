"""Systems made by Python functions: the built-in ones for everybody, others only where the user vouches for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from orbitfinder._runtime.suggest import closest
from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import Model

BUILT_IN = "orbitfinder.systems"


def python_model(system: Mapping[str, Any], trusted: Path | None = None) -> Model:
    """The Model of a `kind = "python"` description {module, function, arguments}.

    `orbitfinder.systems` is always allowed and only its registered functions are. With `trusted`
    (the folder of a file that the user vouches for) any other module is imported (see `module_file`).
    Raises `InputError`, also for whatever the function raises.
    """
    module, name = system.get("module", BUILT_IN), system.get("function")
    arguments = system.get("arguments", {})
    if not (isinstance(module, str) and isinstance(name, str) and isinstance(arguments, Mapping)):
        raise InputError("system: a python system needs module and function (text) and arguments (a table)")
    function = _built_in(name) if module == BUILT_IN else _foreign(module, name, trusted)
    try:
        model = function(**arguments)
    except InputError:
        raise
    except TypeError as error:
        raise InputError(f"system.arguments: {error}; compare with help({module}.{name})") from error
    except Exception as error:
        raise InputError(f"system.function: {module}.{name} failed with {type(error).__name__}: {error}") from error
    if not isinstance(model, Model):
        raise InputError(f"system.function: {module}.{name} returned {type(model).__name__}; return a Model")
    if module != BUILT_IN:
        described = {"kind": "python", "module": module, "function": name, "arguments": dict(arguments)}
        model = replace(model, system=described)
    return model


def module_file(module: str, folder: Path) -> Path | None:
    """Where a trusted module lies: beside the file that names it, else in the working folder; None: installed.

    The one answer for every command: an orbit.json is seldom in the folder of the problem that it came from.
    """
    places = (folder / f"{module}.py", Path.cwd() / f"{module}.py")
    return next((place for place in places if place.is_file()), None)


def _built_in(name: str) -> Callable[..., Any]:
    from orbitfinder.mechanics.library import FUNCTIONS

    if name not in FUNCTIONS:
        known = ", ".join(FUNCTIONS)
        raise InputError(f"system.function: {BUILT_IN} has no {name!r}{closest(name, FUNCTIONS)}; it has {known}")
    return FUNCTIONS[name]


def _foreign(module: str, name: str, trusted: Path | None) -> Callable[..., Any]:
    """A function of a module that is not ours, imported only for a trusted file."""
    import importlib
    import importlib.util

    if trusted is None:
        raise InputError(
            f"system.module: {module!r} is a program that is not part of orbitfinder, so it was not run; read it, "
            f"then add --trust, or use module = {BUILT_IN!r}"
        )
    if not all(part.isidentifier() for part in module.split(".")):
        raise InputError(f"system.module: {module!r} is no module name; give one such as 'my_system' (my_system.py)")
    try:
        if (place := module_file(module, trusted)) is not None:
            spec = importlib.util.spec_from_file_location(f"orbitfinder_trusted_{module}", place)
            assert spec is not None and spec.loader is not None
            found = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(found)
        else:
            found = importlib.import_module(module)
    except Exception as error:
        raise InputError(f"system.module: {module!r} cannot be imported ({type(error).__name__}: {error})") from error
    function = getattr(found, name, None)
    if not callable(function):
        raise InputError(f"system.function: {module} has no function {name!r}; define it there")
    return function  # type: ignore[no-any-return]
