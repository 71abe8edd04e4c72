"""From a plain description (the `system` entry of a file) back to a Model."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.mechanics.chain import chain
from orbitfinder.mechanics.constrained import ConstrainedModel, reduced
from orbitfinder.mechanics.foreign import python_model
from orbitfinder.mechanics.linkage import linkage
from orbitfinder.mechanics.maximal import chain_dae
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.partition import minimal_linkage
from orbitfinder.records.orbit import system_at

REBUILDABLE = ("chain", "linkage")
"""Kinds that take their description as arguments; python systems are rebuilt by `python_model`."""


def build_model(system: Mapping[str, Any], trusted: Path | None = None) -> Model:
    """The Model that a description stands for; of a linkage its reduced form in maximal coordinates, or
    (with `independent` bars and `branch`) its minimal one.

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
    if system.get("kind") == "linkage" and "independent" in system:
        plain = {key: value for key, value in system.items() if key not in ("independent", "branch")}
        return minimal_linkage(build_constrained(plain), system["independent"], system.get("branch", 1))
    if system.get("kind") == "linkage":
        return reduced(build_constrained(system))
    return _built(chain, system)  # type: ignore[no-any-return]


def build_constrained(system: Mapping[str, Any]) -> ConstrainedModel:
    """The native DAE that a description of a linkage, or of a chain, stands for. Raises `InputError`."""
    if system.get("kind") == "linkage":
        return _built(linkage, system)  # type: ignore[no-any-return]
    return _built(chain_dae, {key: value for key, value in system.items() if key != "formulation"})  # type: ignore[no-any-return]


def _built(builder: Callable[..., Any], system: Mapping[str, Any]) -> Any:
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
    numbers = model.parameter_values.copy()
    for name, value in values.items():
        numbers[model.parameter_index(name)] = value
    system = system_at(model.system, values)
    if model.system.get("kind") in REBUILDABLE:
        return build_model(system)
    return replace(model, parameter_values=numbers, system=system)
