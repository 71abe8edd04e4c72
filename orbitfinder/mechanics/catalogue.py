"""From a plain description (the `system` entry of a file) back to a Model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.mechanics.chain import chain
from orbitfinder.mechanics.foreign import python_model
from orbitfinder.mechanics.linkage import linkage
from orbitfinder.mechanics.linkage_minimal import minimal_linkage
from orbitfinder.mechanics.maximal import chain_dae
from orbitfinder.mechanics.model import Model

REBUILDABLE = ("chain", "linkage")
"""Kinds that take their description as arguments; python systems are rebuilt by `python_model`."""


def build_model(system: Mapping[str, Any], trusted: Path | None = None) -> Model:
    """The Model that a description stands for; of a linkage the one in maximal coordinates, or (with
    `independent` bars and `branch`) the minimal one; of a chain with `baumgarte` terms the native DAE.

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
    if system.get("kind") == "chain" and "baumgarte" in system:
        return _built(chain_dae, {key: value for key, value in system.items() if key != "formulation"})
    return _built(chain, system)


def _built(builder: Callable[..., Model], system: Mapping[str, Any]) -> Model:
    if (kind := system.get("kind")) not in REBUILDABLE:
        raise InputError(
            f"system.kind: cannot rebuild {kind!r} from a file; in Python give the Model itself (model=...), and for "
            "commands find the orbit by a problem file of kind = 'python' (module, function), rebuilt with --trust, or "
            "of kind = " + " or ".join(repr(known) for known in REBUILDABLE)
        )
    try:
        return builder(**{key: value for key, value in system.items() if key != "kind"})
    except TypeError as error:
        raise InputError(f"system: {error}; compare with a freshly written orbit.json") from error


def with_parameters(model: Model, values: Mapping[str, float]) -> Model:
    """The same Model with some physical parameters changed, its description included."""
    from dataclasses import replace

    numbers = model.parameter_values.copy()
    for name, value in values.items():
        numbers[model.parameter_index(name)] = value
    if model.system.get("kind") == "python":
        arguments = {**model.system.get("arguments", {}), **{name: float(value) for name, value in values.items()}}
        return replace(model, parameter_values=numbers, system={**model.system, "arguments": arguments})
    if model.system.get("kind") not in REBUILDABLE:
        return replace(model, parameter_values=numbers)
    system = dict(model.system)
    for name, value in values.items():
        field = name.rstrip("0123456789")
        if field == name:
            system[name] = float(value)
        else:
            position = int(name[len(field) :]) - 1
            column = list(system[field])
            column[position] = float(value)
            system[field] = column
    return build_model(system)
