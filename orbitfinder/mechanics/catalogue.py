"""From a plain description (the `system` entry of a file) back to a Model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.mechanics.chain import chain
from orbitfinder.mechanics.model import Model


def build_model(system: Mapping[str, Any]) -> Model:
    """The Model that a description stands for. Raises `InputError` for an unknown or wrong one."""
    kind = system.get("kind")
    if kind != "chain":
        raise InputError(
            f"system.kind: cannot rebuild {kind!r} from a file; give the Model itself (model=...) or use kind = 'chain'"
        )
    arguments = {key: value for key, value in system.items() if key != "kind"}
    try:
        return chain(**arguments)
    except TypeError as error:
        raise InputError(f"system: {error}; compare with a freshly written orbit.json") from error


def with_parameters(model: Model, values: Mapping[str, float]) -> Model:
    """The same Model with some physical parameters changed, its description included."""
    from dataclasses import replace

    numbers = model.parameter_values.copy()
    for name, value in values.items():
        numbers[model.parameter_index(name)] = value
    if model.system.get("kind") != "chain":
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
