"""A start for symmetric modes of large amplitude whose linear mode is too far off: harmonic balance along the family.

What `long_chain` does for long chains, for any model at rest at q = 0: the family of the linear mode that the guess
resembles most is followed by `harmonic_balance` up to the pin. Multiple shooting then starts from there.
"""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.guesses.balance import FINE_TAIL, FIRST_STEP, Accelerations, PinRow, Series, follow, resolved
from orbitfinder.guesses.modes import normal_modes
from orbitfinder.integrate.buffered import Buffered
from orbitfinder.loops.conditions import Pin, pin_row
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import QUARTER
from orbitfinder.mechanics.model import Model, energy

GROWTHS = (1.7, 1.4, 1.2)
"""Growths of the steps along the family, tried in turn: a resonance that stops one is stepped over by another."""


def balanced_guess(problem: Problem) -> Guess | None:
    """Rest state and period near the orbit; None for a problem of another kind or a family that is lost on the way."""
    if not suits(problem):
        return None
    model, one = problem.model, problem.pin[0]
    n, start = model.degrees_of_freedom, np.asarray(problem.guess.state, float)
    try:
        squared, shapes = normal_modes(model)
    except InputError:  # q = 0 is no equilibrium
        return None
    shares = np.linalg.solve(shapes, start[:n])
    mode = int(np.abs(shares * np.abs(shapes).max(axis=0)).argmax())
    if not squared[mode] > 0:
        return None
    shape = shapes[:, mode] * shares[mode]
    index = model.state_index(one.name) if one.name in model.state_names else None
    factor = one.value / shape[index] if index is not None and shape[index] else 1.0
    linear = Series(FIRST_STEP * factor * shape[None, :], float(np.sqrt(squared[mode])))
    with np.errstate(over="ignore", invalid="ignore"):
        found = _followed(problem, linear)
    return None if found is None else Guess(np.concatenate([found.start, np.zeros(n)]), found.period)


def suits(problem: Problem) -> bool:
    """True for brake and reflection symmetric motions of a conservative model from a guess at rest, with one pin."""
    model, n = problem.model, problem.model.degrees_of_freedom
    plain = model.conservative and not model.forced and model.constraint is None and model.gyroscopic is None
    chosen = problem.free or problem.bounds or problem.constraints or problem.objective != "nearest"
    return (
        plain
        and model.forces is None
        and problem.boundary == QUARTER
        and not chosen
        and problem.phase_condition is None
        and problem.guess.states is None
        and len(problem.pin) == 1
        and problem.pin[0].name in ("energy", "period", *model.state_names[:n])
        and not np.any(np.asarray(problem.guess.state, float)[n:])
        and bool(np.any(np.asarray(problem.guess.state, float)[:n]))
    )


def _followed(problem: Problem, linear: Series) -> Series | None:
    model, one, n = problem.model, problem.pin[0], problem.model.degrees_of_freedom
    pins, accelerations = _Pins(model), _accelerations(model)
    walked, rest = one, 0.0
    if one.name == "period":  # which tells nothing near the linear mode
        largest = int(np.abs(problem.guess.state[:n]).argmax())
        walked = Pin(model.state_names[largest], float(problem.guess.state[largest]))
    power = 1
    if one.name == "energy":
        rest, power = energy(model, np.zeros(2 * n)), 2

    def along(fraction: float) -> PinRow:
        return pins(replace(walked, value=rest + fraction**power * (walked.value - rest)))

    for growth in GROWTHS:
        found = follow(linear, accelerations, along, lambda *_: None, growth)
        if found is not None and one.name == "period":
            again = resolved(found, accelerations, pins(one), FINE_TAIL)
            found = None if again is None else again[0]
        if found is not None:
            return found
    return None


def _accelerations(model: Model) -> Accelerations:
    """Accelerations and their slopes as `harmonic_balance` asks for them."""
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


class _Pins:
    """A pin's residual at rest and its derivatives in q(0) and T; `pins(one)` is the row of one pin."""

    def __init__(self, model: Model) -> None:
        self._model, self._known = model, dict[str, ca.Function]()

    def __call__(self, one: Pin) -> PinRow:
        if one.name not in self._known:
            n, values = self._model.degrees_of_freedom, ca.DM(self._model.parameter_values)
            q, period = ca.MX.sym("q", n), ca.MX.sym("T")
            row = pin_row(self._model, Pin(one.name, 0.0), ca.vertcat(q, ca.DM.zeros(n)), period, values)
            slopes = [ca.densify(ca.gradient(row, q)), ca.densify(ca.gradient(row, period))]
            self._known[one.name] = ca.Function("pin", [q, period], [row, *slopes])

        def rows(place: np.ndarray, duration: float) -> tuple[float, np.ndarray, float]:
            value, by_place, by_period = self._known[one.name](place, duration)
            return float(value) - one.value, by_place.full().ravel(), float(by_period)

        return rows
