"""Cycles that are born at a Hopf point: the first of their family, x0 + a Re(q e^(i omega t)) corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.equilibrium import Equilibria, RestEvent
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.start import FIRST_STEPS, Start, corrected, curve_at, unknown_parameters
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.continued import advanced, plane
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.symmetry import NONE, named
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import LEAST_SHARE
from orbitfinder.records.family import Event

AMPLITUDES = (0.02, 0.005, 0.001, 0.05)
"""Of the first cycle, in the sizes of the equilibrium; the first that succeeds is taken"""


def cycle_start(
    equilibria: Equilibria, number: int, settings: FamilySettings, model: Model | None
) -> tuple[Start, Event]:
    """The first cycle of the family that is born at a Hopf point of this number, and its birth.

    Raises `ConvergenceError` where none is found.
    """
    born, name = equilibria.events[number], equilibria.parameter
    model = with_parameters(model or build_model(equilibria.system), {name: born.parameter})
    unknown_parameters(model, replace(settings, parameter=name))
    start = _first(model, name, born, np.abs([point.state for point in equilibria.points]).max(axis=0))
    return start, Event(born.kind, number, born.arclength, born.parameter, born.state, born.period, float("nan"))


def _first(model: Model, name: str, born: RestEvent, largest: np.ndarray) -> Start:
    """The first cycle, directed away from its birth."""
    real, imaginary = np.split(born.direction, 2)
    q = real + 1j * imaginary
    q = q / np.abs(q / np.where(largest > 0, largest, LEAST_SHARE * largest.max() or 1.0)).max()
    equations, why = Equations(model, named(NONE.name, model), (name,), action=True), "none was tried"
    still = equations.unknowns(born.state[None], born.period, uniform(1.0, 1, FIRST_STEPS), np.array([born.parameter]))
    direction = np.concatenate([q.real, np.zeros(still.vector.size - q.size)])
    for amplitude in AMPLITUDES:
        guess = advanced(still, direction, amplitude)
        try:
            curve = curve_at(equations, guess)
            start = corrected(curve, guess, plane(curve, guess, direction), guess, reach=10.0)
        except (ConvergenceError, IntegrationError) as error:
            why = str(error)
            continue
        place, metric = start.solution.place, start.curve.scales.states**-2.0
        moved = metric * (place.nodes[0] - born.state)
        if moved @ q.real > 0:
            return start if start.direction[: q.size] @ moved >= 0 else replace(start, direction=-start.direction)
        why = "what is found there is the equilibrium"
    raise ConvergenceError(f"no cycle was found at the Hopf point at {name} = {born.parameter:.9g}: {why}")
