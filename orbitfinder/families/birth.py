"""Cycles that leave an equilibrium: the first of their family, x0 + a Re(q e^(i omega t)) corrected.

They are born at a Hopf point, or are about one without damping the motions of each of its modes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError
from orbitfinder.families.equilibrium import Equilibria, RestEvent
from orbitfinder.families.handover import rescued
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.rest_problem import ROUND_OFF, AtRest, Stacked, lyapunov, oscillations, regular, spectrum
from orbitfinder.families.start import Start, begin, corrected, curve_at, unknown_parameters
from orbitfinder.integrate.equations import hamilton
from orbitfinder.integrate.jets import at_rest
from orbitfinder.integrate.march import March, uniform
from orbitfinder.loops.continued import plane
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import NONE, named
from orbitfinder.mechanics.kind import build_model, loops_of, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import energy as energy_of
from orbitfinder.orbits.method import begins
from orbitfinder.orbits.method import named as method_named
from orbitfinder.records.family import Event

GROWTH, SHARE, HALVINGS = 1e-3, 0.02, 12
"""Of the first cycle x + 2 Re(w q) + ...: what motions grow by in a radian, |l1| |w|^2, in sizes of the equilibrium its
amplitude where no normal form tells it; how often it is halved"""
LEAST, MOST, NEAR = 1e-6, 0.05, 0.1
"""What is not linear of the rates along a first cycle, relative to what is, without a normal form at least and always
at most; a cycle that is found belongs to a Hopf point where the critical eigenvalue has changed by less than this"""


def cycle_start(
    equilibria: Equilibria, number: int, settings: FamilySettings, model: Model | None
) -> tuple[Start, Event]:
    """The first cycle of the family that is born at a Hopf point of this number, and its birth.

    Raises `ConvergenceError` where none is found.
    """
    born, name = equilibria.events[number], equilibria.parameter
    if abs(born.parameter) < ROUND_OFF * max(abs(point.value) for point in equilibria.points):
        born = replace(born, parameter=0.0)
    model = with_parameters(model or build_model(equilibria.system), {name: born.parameter})
    unknown_parameters(model, replace(settings, parameter=name))
    if settings.method and begins(settings.method):
        start = _cycle(model, name, born, method_named(settings.method).march)
    else:  # by shooting, or what rescues where that fails
        try:
            start = _cycle(model, name, born, March)
        except ConvergenceError as error:
            other = None if settings.method else rescued(model, born.state, born.period)
            if other is None:
                raise
            start = replace(_cycle(model, name, born, other.march), why=f"by shooting {error}")
    return start, Event(born.kind, number, born.arclength, born.parameter, born.state, born.period, np.nan)


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
    z = np.pad(rest.state, (0, problem.jets.extra))
    frequencies, shapes = oscillations(problem, z, value)
    if not 1 <= mode <= frequencies.size:
        raise InputError(f"branch: {mode} asked for, {frequencies.size} modes oscillate at the {which}; the slowest "
                         "is 1")  # fmt: skip
    omega, q, n = float(frequencies[mode - 1]), shapes[:, mode - 1], model.degrees_of_freedom
    largest = (q / problem.z_sizes[: q.size])[:n]
    q = q / largest[np.abs(largest).argmax()]  # at rest where it is largest
    size = _fitting(problem, z, value, q, omega, SHARE, LEAST)
    state, period = rest.state + size * q.real, 2 * np.pi / omega
    if model.constraint is not None:
        own = hamilton(model).coordinates
        state = loops_of(model.system).state(model, near=state[own.chosen[: own.size]])
    start = begin(Problem(model, Guess(state, period)), settings)
    energy = float(energy_of(model, rest.state))
    return start, Event("mode", -1, rest.arclength, energy, rest.state, period, energy)


def _fitting(
    problem: AtRest, z: np.ndarray, values: np.ndarray, q: np.ndarray, omega: float, size: float, least: float
) -> float:
    """The amplitude a, by halving and doubling a `size`, at which the rates along x + a Re(q e^(i theta)) are linear
    but for a share of `least` to `MOST` of their part in q; the size itself where no doubling comes to `least`."""
    turn, gz = omega / problem.pace, problem.scaled(z, values)[1]
    u = np.pad(q, (0, z.size - q.size)) / problem.z_sizes
    shifted = gz - (1 + 1e-7) * 1j * turn * np.diag(problem.mass)
    weight = np.linalg.solve(shifted.conj().T, u).conj()  # q's part among equal eigenvalues too
    weight = 2 / (turn * (weight @ (problem.mass * u))) * weight

    def bent(size: float) -> float:
        steps = (size * (u * turned).real for turned in np.exp(0.25j * np.pi * np.arange(8)))
        rows = [problem.scaled(z + step * problem.z_sizes, values)[0] - gz @ step for step in steps]
        return float(np.abs(rows @ weight).max()) / size

    with np.errstate(all="ignore"):
        size = next((size * 2.0**k for k in range(64) if not bent(size * 2.0**k) < least), size)
        return next((size / 2.0**k for k in range(64) if bent(size / 2.0**k) <= MOST), size)


def _cycle(model: Model, name: str, born: RestEvent, by: type[March]) -> Start:
    """The first cycle, away from its birth, by a march."""
    value, count = np.array([born.parameter]), by.first_segments
    problem = regular(at_rest(model, (name,), born.state), born.state, value)
    z = np.pad(born.state, (0, problem.jets.extra))
    _, _, q, mean, double = lyapunov(problem, z, value, born.frequency)
    size, least = SHARE / float(np.abs(q / problem.z_sizes[: q.size]).max()), LEAST
    if born.criticality in ("supercritical", "subcritical"):
        size, least = 2 * float(np.sqrt(GROWTH / abs(born.lyapunov))), 0.0
    size = _fitting(problem, z, value, q, born.frequency, size, least)
    equations, why = Equations.of(model, named(NONE.name, model), (name,), by), "none was tried"
    mesh, held = uniform(1.0, count, by.first_steps), ("energy",) * model.conservative
    turning = np.exp(2j * np.pi * np.arange(count)[:, None] / count)
    for amplitude in size / 2.0 ** np.arange(HALVINGS):
        bent = (amplitude / 2) ** 2 * (mean + (double * turning**2).real)
        nodes = born.state + amplitude * (q * turning).real + bent
        guess = equations.unknowns(nodes, born.period, mesh, value)
        direction = np.pad((q * turning).real.ravel(), (0, guess.vector.size - nodes.size))
        try:
            curve = curve_at(equations, guess, held)
            start = corrected(curve, guess, plane(curve, guess, direction), guess, reach=10.0)
        except UNSOLVED as error:
            why = str(error)
            continue
        place = start.solution.place
        critical = spectrum(problem, Stacked(np.append(z, place.free))).values / born.frequency
        if np.abs(critical - 1j).min() < NEAR:
            away = start.direction[: q.size] @ (q.real * start.curve.scales.states**-2.0)
            return replace(start, direction=np.copysign(1.0, away) * start.direction)
        why = f"the cycle that is found there is at {name} = {place.free[0]:.9g}, which is not near"
    raise ConvergenceError(f"no cycle was found at the Hopf point at {name} = {born.parameter:.9g}: {why}")
