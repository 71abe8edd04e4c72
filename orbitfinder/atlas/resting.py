"""Where a system rests: the equilibrium that a search begins about."""

from __future__ import annotations

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import Model

DESCENTS = 16
FLAT = 1e-4
"""Slope (J per rad or m) at which a descent has reached a minimum; only its energy is asked for."""


def resting_place(model: Model, energy: float) -> np.ndarray:
    """Coordinates (n) of an equilibrium below an energy (J): the one near q = 0, which may be a barrier, or a minimum.

    Raises `InputError` when there is none.
    """

    def potential(q: np.ndarray) -> float:
        return float(model.potential(q, model.parameter_values))

    place = equilibrium(model)
    if energy <= potential(place):
        place = min([place, *minima(model)], key=potential)
    lowest = potential(place)
    if energy <= lowest:
        shown = 0.0 if abs(lowest) < FLAT * abs(energy) else lowest
        raise InputError(f"energy: {energy:.9g} J is not above {shown:.9g} J, the system at rest; give a larger energy")
    return place


def minima(model: Model) -> list[np.ndarray]:
    """Coordinates (n each) of minima of the potential, met going down from places about q = 0."""
    from scipy.optimize import minimize

    reach, random = reach_of(model), np.random.default_rng(0)
    found = [
        minimize(lambda q: float(model.potential(q, model.parameter_values)), reach * random.uniform(-1, 1, reach.size))
        for _ in range(DESCENTS)
    ]
    # a potential without a floor leads away from every minimum
    return [one.x for one in found if np.all(np.abs(one.x) < 4 * reach) and np.abs(one.jac).max() < FLAT]


def reach_of(model: Model) -> np.ndarray:
    """How far (n) from an equilibrium positions are drawn: half a turn, or 2."""
    return np.where(np.asarray(model.angles or (False,) * model.degrees_of_freedom), np.pi, 2.0)


def equilibrium(model: Model) -> np.ndarray:
    """Coordinates (n) of the minimum of the potential nearest to q = 0."""
    from scipy.optimize import minimize, root

    n = model.degrees_of_freedom

    def potential(q: np.ndarray) -> float:
        return float(model.potential(q, model.parameter_values))

    zero = np.zeros(n)
    slopes = [potential(1e-6 * unit) - potential(-1e-6 * unit) for unit in np.eye(n)]
    if np.abs(slopes).max() < 1e-11 * max(1.0, abs(potential(zero))):
        return zero
    found = minimize(potential, zero, method="BFGS", options={"gtol": 1e-11}).x

    def force(q: np.ndarray) -> np.ndarray:
        return np.asarray(model.acceleration(0.0, q, zero, model.parameter_values).full().ravel())

    return np.asarray(root(force, found, tol=1e-15).x)
