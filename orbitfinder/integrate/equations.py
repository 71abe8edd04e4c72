"""What is derived from a Model once: Hamilton's equations, its accelerations, the gradients of its invariants.

All of it is remembered for the models seen last, and compiled for those of which many orbits are to be certified.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.caches import Kept, Same
from orbitfinder.integrate.buffered import Buffered
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.cvodes import vector_field
from orbitfinder.mechanics.constrained import ConstrainedModel
from orbitfinder.mechanics.hamilton import Canonical, canonical
from orbitfinder.mechanics.holonomic import Holonomic, HolonomicEquations, holonomic, holonomic_equations
from orbitfinder.mechanics.model import Model

KEPT = 16
"""Sets of equations that are remembered."""

_derived = Kept[Any](KEPT)


def hamilton(model: Model) -> Canonical:
    """Hamilton's equations of a Model with its parameter values."""
    return _remembered(model, canonical)


def constrained_hamilton(model: ConstrainedModel) -> tuple[Holonomic, HolonomicEquations]:
    """The coordinates of a ConstrainedModel's own, with its parameter values, and Hamilton's equations in them."""
    return _remembered(model, _constrained)


def accelerations(model: Model) -> ca.Function:
    """The equations of motion x' = f(t, x) of a Model with its parameter values, nothing unfolded."""
    return _remembered(model, _plain)


def invariant_gradients(model: Model) -> ca.Function:
    """The gradients (k x 2n) of a Model's invariants at a state x, with its parameter values."""
    return _remembered(model, _gradients)


def linearised(model: Model) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(q, v) -> the accelerations (n) of an autonomous Model and their slopes in q and in v (n x n each)."""
    n = model.degrees_of_freedom
    symbol = ca.SX.sym if model.acceleration.is_a("SXFunction") else ca.MX.sym
    q, v = symbol("q", n), symbol("v", n)
    a = model.acceleration(0.0, q, v, ca.DM(model.parameter_values))
    slopes = [ca.densify(ca.jacobian(a, q)), ca.densify(ca.jacobian(a, v))]
    function = Buffered(ca.Function("accelerations", [q, v], [a, *slopes]))

    def call(place: np.ndarray, rate: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        found, by_place, by_rate = function(place[None], rate[None])
        return found[0], by_place.T, by_rate.T

    return call


def prepare(model: Model) -> None:
    """Have the equations of a Model compiled: many of its orbits are to be certified."""
    slow = hamilton(model)
    fast = replace(slow, field=compiled(slow.field), variational=compiled(slow.variational))
    _derived[_key(model, canonical)] = fast
    _derived[_key(model, _plain)] = compiled(accelerations(model))


def _constrained(model: ConstrainedModel) -> tuple[Holonomic, HolonomicEquations]:
    system = holonomic(model)
    return system, holonomic_equations(system)


def _plain(model: Model) -> ca.Function:
    field = vector_field(model, (), ())
    t, x = ca.MX.sym("t"), ca.MX.sym("x", 2 * model.degrees_of_freedom)
    return ca.Function("plain", [t, x], [field(t, x, ca.DM(0, 1), ca.DM(0, 1))])


def _gradients(model: Model) -> ca.Function:
    n, p = model.degrees_of_freedom, ca.DM(model.parameter_values)
    x = ca.MX.sym("x", 2 * n)
    rows = [ca.gradient(one.value(x[:n], x[n:], p), x).T for one in model.invariants]
    return ca.Function("gradients", [x], [ca.densify(ca.vertcat(*rows)) if rows else ca.MX(0, 2 * n)])


def _key(model: Any, derive: Callable[..., Any]) -> tuple[Any, ...]:
    parts = (model.kinetic, model.potential, model.forces, getattr(model, "acceleration", None),
             getattr(model, "gyroscopic", None), getattr(model, "constraint", None),
             *(one.value for one in getattr(model, "invariants", ())))  # fmt: skip
    return (derive, len(model.state_names), model.parameter_values.tobytes(), *map(Same, parts))


def _remembered(model: Any, derive: Callable[..., Any]) -> Any:
    return _derived(_key(model, derive), lambda: derive(model))
