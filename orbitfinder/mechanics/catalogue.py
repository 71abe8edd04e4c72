"""From a plain description (the `system` entry of a file) back to a Model.

Systems made by Python functions are rebuilt too: the built-in ones for everybody, others only where the user vouches
for them.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.chain import chain, chain_dae
from orbitfinder.mechanics.controls import check_constant, with_controls
from orbitfinder.mechanics.driven import DRIVEN
from orbitfinder.mechanics.hybrid import at_numbers, with_cycle
from orbitfinder.mechanics.library import BUILT_IN, FUNCTIONS
from orbitfinder.mechanics.linkage import linkage, minimal_linkage
from orbitfinder.mechanics.machines import MACHINES
from orbitfinder.mechanics.mechanism import mechanism, minimal_mechanism
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import with_scales
from orbitfinder.records.orbit import system_at

REBUILDABLE = ("chain", "linkage", "mechanism")
"""Kinds that take their description as arguments; python systems are rebuilt by `python_model`."""
REMADE = ("chain", "linkage")
"""Those whose description is read again where a parameter changes"""
PROBLEM = "problem"
"""The function of a Python problem file, which returns a Problem and not a Model"""


def build_model(system: Mapping[str, Any], trusted: Path | None = None) -> Model:
    """The Model that a description stands for; of a linkage the one in maximal coordinates, or (with
    `independent` bars and `branch`) the minimal one; of a mechanism with loops the native DAE, or (with
    `independent` coordinates) the minimal one; of a chain with `baumgarte` terms the native DAE.

    `trusted` is the folder of a file whose Python functions may be imported (see `python_model`).
    Raises `InputError` for an unknown or wrong description.
    """
    try:
        return _model(system, trusted)
    except InputError:
        raise
    except (TypeError, ValueError, KeyError, IndexError, OverflowError, AttributeError) as error:
        raise InputError(f"system: {error}; compare with a freshly written orbit.json") from error


def _model(system: Mapping[str, Any], trusted: Path | None) -> Model:
    if system.get("kind") == "python":
        return python_model(system, trusted)
    if system.get("kind") == "linkage":
        plain = {key: value for key, value in system.items() if key not in ("independent", "branch")}
        model = _built(linkage, plain)
        return (
            minimal_linkage(model, system["independent"], system.get("branch", 1)) if "independent" in system else model
        )
    if system.get("kind") == "mechanism":
        found = _built(mechanism, {key: value for key, value in system.items() if key != "independent"})
        return minimal_mechanism(found, system["independent"]) if "independent" in system else found
    if system.get("kind") == "chain" and "baumgarte" in system:
        return _built(chain_dae, {key: value for key, value in system.items() if key != "formulation"})
    return _built(chain, system)


def _built(builder: Callable[..., Model], system: Mapping[str, Any]) -> Model:
    if (kind := system.get("kind")) not in REBUILDABLE:
        raise InputError(
            f"system.kind: cannot rebuild {kind!r} from a file; in Python give the Model itself (model=...), and for "
            "commands find the orbit by a program with problem() (run FILE.py --trust), or by a problem file "
            "of kind = " + " or ".join(repr(known) for known in ("python", *REBUILDABLE))
        )
    try:
        return builder(**{key: value for key, value in system.items() if key != "kind"})
    except TypeError as error:
        raise InputError(f"system: {error}; compare with a freshly written orbit.json") from error


def python_model(system: Mapping[str, Any], trusted: Path | None = None) -> Model:
    """The Model of a `kind = "python"` description {module, function, arguments}.

    `orbitfinder.systems` is always allowed and only its registered functions are. With `trusted`
    (the folder of a file that the user vouches for) any other module is imported (see `module_file`). The function
    `problem` is that of a Python problem file: its Problem's Model, arguments being physical parameters.
    Raises `InputError`, also for whatever the function raises.
    """
    module, name = system.get("module", BUILT_IN), system.get("function")
    arguments = system.get("arguments", {})
    if not (isinstance(module, str) and isinstance(name, str) and isinstance(arguments, Mapping)):
        raise InputError("system: a python system needs module and function (text) and arguments (a table)")
    function = _built_in(name) if module == BUILT_IN else _foreign(module, name, trusted)
    try:
        model = with_parameters(function().model, arguments) if name == PROBLEM else function(**arguments)
    except InputError:
        raise
    except TypeError as error:
        raise InputError(f"system.arguments: {error}; compare with help({module}.{name})") from error
    except Exception as error:
        raise InputError(f"system.function: {module}.{name} failed with {type(error).__name__}: {error}") from error
    if not isinstance(model, Model):
        raise InputError(f"system.function: {module}.{name} returned {type(model).__name__}; return a Model")
    scales = system.get("scales", model.scales)
    if module != BUILT_IN:
        model = replace(model, system=described({}, module, name, arguments))
    if not isinstance(scales, Mapping):
        raise InputError("system.scales: must be a table of names and sizes")
    model = with_scales(_controlled(model, system), scales)
    return with_cycle(model, system["cycle"]) if "cycle" in system else model


def described(
    system: Mapping[str, Any], module: str, function: str, arguments: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """The description of a system that a module's function makes, with what else (a cycle) was said of it."""
    made = {"kind": "python", "module": module, "function": function, "arguments": dict(arguments or {})}
    return {**system, **made}


def _controlled(model: Model, system: Mapping[str, Any]) -> Model:
    """The Model with the controls and limits that a description gives, its own without."""
    given = {name: system[name] for name in ("controls", "limits") if name in system}
    if not given:
        return model
    found = with_controls(model, given.get("controls", model.controls), {**model.limits, **given.get("limits", {})})
    return replace(found, system={**model.system, **given})


def module_file(module: str, folder: Path) -> Path | None:
    """Where a trusted module lies: beside the file that names it, else in the working folder; None: installed.

    The one answer for every command: an orbit.json is seldom in the folder of the problem that it came from.
    """
    places = (folder / f"{module}.py", Path.cwd() / f"{module}.py")
    return next((place for place in places if place.is_file()), None)


def _built_in(name: str) -> Callable[..., Any]:
    functions = FUNCTIONS | MACHINES | DRIVEN
    if name not in functions:
        known = ", ".join(functions)
        raise InputError(f"system.function: {BUILT_IN} has no {name!r}{closest(name, functions)}; it has {known}")
    return functions[name]


def _foreign(module: str, name: str, trusted: Path | None) -> Callable[..., Any]:
    """A function of a module that is not ours, imported only for a trusted file."""
    if trusted is None:
        raise InputError(
            f"system.module: {module!r} is a program that is not part of orbitfinder, so it was not run; read it, "
            f"then add --trust (in Python give the Model), or use module = {BUILT_IN!r}"
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
        raise InputError(
            f"system.module: {module!r} cannot be imported ({type(error).__name__}: {error}); "
            f"work in the folder of {module}.py, or put it beside the file"
        ) from error
    function = getattr(found, name, None)
    if not callable(function):
        raise InputError(f"system.function: {module} has no function {name!r}; define it there")
    return function  # type: ignore[no-any-return]


def with_parameters(model: Model, values: Mapping[str, float]) -> Model:
    """The same Model with some physical parameters changed, its description included; itself where none is."""
    if not values:
        return model
    check_constant(model, values)
    numbers = model.parameter_values.copy()
    for name, value in values.items():
        numbers[model.parameter_index(name)] = value
    system = system_at(model.system, values)
    if model.system.get("kind") in REMADE:
        return build_model(system)
    return replace(model, parameter_values=numbers, system=system, hybrid=at_numbers(model.hybrid, numbers))
