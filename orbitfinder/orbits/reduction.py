"""What an orbit is relative in and what is held for it, and motions that only follow a symmetry: relative equilibria.

Source: J. E. Marsden, Lectures on Mechanics (1992), chapter 4.
"""

from __future__ import annotations

import numpy as np

from orbitfinder._runtime.sizes import size_of
from orbitfinder.integrate.equations import accelerations
from orbitfinder.loops.symmetry import shifts_of
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.floquet import generated
from orbitfinder.records.orbit import Orbit

STEADY = 1e-9
"""A rate this far off the symmetries' directions, relative, is along them."""


def steady(model: Model, state: np.ndarray, period: float) -> dict[str, float]:
    """c of x' = sum_k c_k g_k(x) at a state (2n), by the name of each symmetry; nothing where x' is no such sum.

    Rates are measured by the largest one, accelerations by what that changes in a `period` (s).
    The flow of a relative equilibrium is that of its symmetries: a conical pendulum turns steadily about its axis.
    """
    n, along = model.degrees_of_freedom, generated(model, state, commuting=False)
    if not len(along) or model.forced:
        return {}
    rate = accelerations(model)(0.0, state).full().ravel()
    found = np.linalg.lstsq(along.T, rate, rcond=None)[0]
    speed = size_of(rate[:n])
    missed = np.abs(rate - along.T @ found) / np.where(np.arange(state.size) < n, speed, 2 * np.pi * speed / period)
    if not missed.max() <= STEADY:
        return {}
    momenta = [one.name for one in model.invariants if one.generator is not None]
    called = {one.momentum: name for name, one in shifts_of(model).items()}
    return {called.get(name, name): float(c) for name, c in zip(momenta, found, strict=True)}


def held(model: Model, orbit: Orbit) -> dict[str, float]:
    """The momenta that are kept with what an orbit is relative in."""
    kept = {one.momentum for name, one in shifts_of(model).items() if name in orbit.shift}
    n = model.degrees_of_freedom
    q, v, p = orbit.state[:n], orbit.state[n:], model.parameter_values
    return {one.name: float(one.value(q, v, p)) for one in model.invariants if one.name in kept}


def reduction(model: Model, orbit: Orbit) -> str:
    """What an orbit shifts by and which momenta that holds, or how a relative equilibrium moves; else nothing."""
    if orbit.shift:
        moved = ", ".join(f"{name} by {by!r}" for name, by in orbit.shift.items())
        return f"relative: shifts {moved} in a period; held {_listed(held(model, orbit))}"
    found = {name: rate for name, rate in steady(model, orbit.state, orbit.period).items() if rate}
    return f"relative equilibrium: steady rates {_listed(found)} a second" if found else ""


def _listed(numbers: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.12g}" for name, value in numbers.items())
