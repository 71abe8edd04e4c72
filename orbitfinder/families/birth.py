"""Cycles that leave an equilibrium: the first of their family, x0 + a Re(q e^(i omega t)) corrected.

They are born at a Hopf point, or are about one without damping the motions of each of its modes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.families.equilibrium import Equilibria, RestEvent
from orbitfinder.families.handover import rescued
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.rest_problem import oscillations, regular
from orbitfinder.families.start import FIRST_STEPS, Start, begin, corrected, curve_at, unknown_parameters
from orbitfinder.integrate.equations import hamilton
from orbitfinder.integrate.jets import at_rest
from orbitfinder.integrate.march import Gridded, March, uniform
from orbitfinder.loops.continued import advanced, plane
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import NONE, named
from orbitfinder.mechanics.kind import build_model, loops_of, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import energy as energy_of
from orbitfinder.mechanics.scales import LEAST_SHARE
from orbitfinder.orbits.method import begins
from orbitfinder.orbits.method import named as method_named
from orbitfinder.records.family import Event

AMPLITUDES, INTERVALS = (0.02, 0.005, 0.001, 0.05), 40
"""Of the first cycle, in the sizes of the equilibrium, the first that succeeds is taken; of its mesh of collocation"""


def cycle_start(
    equilibria: Equilibria, number: int, settings: FamilySettings, model: Model | None
) -> tuple[Start, Event]:
    """The first cycle of the family that is born at a Hopf point of this number, and its birth.

    Raises `ConvergenceError` where none is found.
    """
    born, name = equilibria.events[number], equilibria.parameter
    model = with_parameters(model or build_model(equilibria.system), {name: born.parameter})
    unknown_parameters(model, replace(settings, parameter=name))
    largest = np.abs([point.state for point in equilibria.points]).max(axis=0)
    start = _first(model, name, born, largest, settings.method)
    return start, Event(born.kind, number, born.arclength, born.parameter, born.state, born.period, float("nan"))


def mode_start(
    equilibria: Equilibria, which: str, mode: int, settings: FamilySettings, model: Model | None
) -> tuple[Start, Event]:
    """The first motion of a normal mode (from 1, slowest first) about the first or the last equilibrium, and its birth.

    Raises `InputError` where there is no such mode, `ConvergenceError` where no motion is found.
    """
    rest, name = equilibria.points[0 if which == "start" else -1], equilibria.parameter
    model, value = with_parameters(model or build_model(equilibria.system), {name: rest.value}), np.array([rest.value])
    if not model.conservative:
        raise InputError(f"event: no energy is kept, so that nothing leaves the equilibrium at the {which}; cycles "
                         "leave at Hopf points, by their numbers")  # fmt: skip
    problem = regular(at_rest(model, (name,), rest.state), rest.state, value)
    frequencies, shapes = oscillations(problem, np.pad(rest.state, (0, problem.jets.extra)), value)
    if not 1 <= mode <= frequencies.size:
        raise InputError(f"branch: {mode} asked for, {frequencies.size} modes oscillate at the {which}; the slowest "
                         "is 1")  # fmt: skip
    omega, q, n = float(frequencies[mode - 1]), shapes[:, mode - 1], model.degrees_of_freedom
    largest = (q / problem.z_sizes[: q.size])[:n]
    largest = largest[np.abs(largest).argmax()]  # at rest where it is largest
    state, period = rest.state + AMPLITUDES[0] * (q / largest).real, 2 * np.pi / omega
    if model.constraint is not None:
        own = hamilton(model).coordinates
        state = loops_of(model.system).state(model, near=state[own.chosen[: own.size]])
    start = begin(Problem(model, Guess(state, period)), settings)
    energy = float(energy_of(model, rest.state))
    return start, Event("mode", -1, rest.arclength, energy, rest.state, period, energy)


def _first(model: Model, name: str, born: RestEvent, largest: np.ndarray, method: str | None) -> Start:
    """The first cycle, away from its birth, by a method; None: by shooting, or what rescues where that fails."""
    if method and begins(method):
        return _cycle(model, name, born, largest, method_named(method).march)
    try:
        return _cycle(model, name, born, largest, March)
    except ConvergenceError as error:
        other = None if method else rescued(model, born.state, born.period)
        if other is None:
            raise
        return replace(_cycle(model, name, born, largest, other.march), why=f"by shooting {error}")


def _cycle(model: Model, name: str, born: RestEvent, largest: np.ndarray, by: type[March]) -> Start:
    """The same by one of them."""
    real, imaginary = np.split(born.direction, 2)
    gridded = issubclass(by, Gridded)
    q, count = real + 1j * imaginary, INTERVALS if gridded else 1
    q = q / np.abs(q / np.where(largest > 0, largest, LEAST_SHARE * largest.max() or 1.0)).max()
    equations, why = Equations.of(model, named(NONE.name, model), (name,), by), "none was tried"
    mesh = uniform(1.0, count, 1 if gridded else FIRST_STEPS)
    nodes, turning = np.repeat(born.state[None], count, axis=0), np.exp(2j * np.pi * np.arange(count)[:, None] / count)
    still = equations.unknowns(nodes, born.period, mesh, np.array([born.parameter]))
    direction = np.concatenate([(q * turning).real.ravel(), np.zeros(still.vector.size - still.nodes.size)])
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
