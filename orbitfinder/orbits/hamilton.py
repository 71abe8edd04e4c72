"""The certificate's equations of a Model, derived once for the models seen last and compiled for a search."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca

from orbitfinder.integrate.compiled import compiled
from orbitfinder.mechanics.hamilton import Canonical, canonical
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import vector_field as equations_of_motion

KEPT = 8
"""Sets of equations that are remembered."""

_known: dict[tuple[Any, ...], tuple[Model, Any]] = {}


def hamilton(model: Model) -> Canonical:
    """Hamilton's equations of a Model with its parameter values."""
    found: Canonical = _remembered(model, canonical)
    return found


def accelerations(model: Model) -> ca.Function:
    """The equations of motion x' = f(t, x) of a Model with its parameter values, nothing unfolded."""
    found: ca.Function = _remembered(model, _plain)
    return found


def prepare(model: Model) -> None:
    """Have the equations of a Model compiled: many of its orbits are to be certified."""
    slow = hamilton(model)
    fast = replace(slow, field=compiled(slow.field), variational=compiled(slow.variational))
    plain = compiled(accelerations(model))
    _known[_key(model, canonical)] = (model, fast)
    _known[_key(model, _plain)] = (model, plain)


def _plain(model: Model) -> ca.Function:
    field = equations_of_motion(model, (), ())
    t, x = ca.MX.sym("t"), ca.MX.sym("x", 2 * model.degrees_of_freedom)
    return ca.Function("plain", [t, x], [field(t, x, ca.DM(0, 1), ca.DM(0, 1))])


def _key(model: Model, derive: Callable[[Model], Any]) -> tuple[Any, ...]:
    functions = (model.acceleration, model.kinetic, model.potential, model.gyroscopic, model.forces)
    hashes = (None if one is None else one.__hash__() for one in functions)
    return (derive.__name__, model.degrees_of_freedom, model.parameter_values.tobytes(), *hashes)


def _remembered(model: Model, derive: Callable[[Model], Any]) -> Any:
    key = _key(model, derive)
    if key not in _known:
        found = derive(model)
        if len(_known) >= KEPT:
            _known.pop(next(iter(_known)))
        _known[key] = (model, found)  # holding the model keeps the hashes of its functions from being reused
    return _known[key][1]
