"""Periods that elliptic integrals give exactly."""

from __future__ import annotations

import numpy as np

from benchmarks.validation.comparison import Comparison, Section, attempted, number
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses.modes import normal_modes
from orbitfinder.systems import double_well, duffing

EXACT = 1e-12
"""s, for periods of a few s: what double precision leaves of an elliptic integral and of an orbit"""
GRAVITY, LENGTH = 9.8, 1.0


def section() -> Section:
    """Single pendulum (swinging and turning), Duffing, double well, small oscillations of a double pendulum."""
    rows = [row for part in (swinging, turning, duffing_periods, well, small_oscillations) for row in part()]
    source = (
        "Complete elliptic integral K(m) by SciPy. Uniform rod: T = 4 K(sin^2(a/2)) / w, w^2 = 3 g / (2 l); turning, "
        "with e = E / (m g l / 2): T = 2 k K(k^2) / w, k^2 = 2 / (1 + e). Duffing x'' + a x + b x^3 = 0, amplitude A: "
        "T = 4 K(b A^2 / (2 (a + b A^2))) / sqrt(a + b A^2). Double pendulum of equal point masses: "
        "w^2 = (2 -+ sqrt 2) g / l (L. D. Landau, E. M. Lifshitz, Mechanics, section 23)."
    )
    return Section("Closed forms", source, tuple(rows))


def _period(quantity: str, exact: float, model: Model, guess: Guess, **pins: float) -> list[Comparison]:
    """One row: the period found from a guess against the exact one."""

    def rows() -> list[Comparison]:
        winding = (1,) if "energy" in pins and model.angles == (True,) else None
        orbit = find_orbit(Problem(model, guess, pin(**pins), winding=winding))
        return [number(quantity, repr(exact), orbit.period, EXACT * max(1.0, exact))]

    return attempted(quantity, repr(exact), rows)


def swinging() -> list[Comparison]:
    """The pendulum at four amplitudes, the last one near the upright."""
    from scipy.special import ellipk

    rate, rows = np.sqrt(1.5 * GRAVITY / LENGTH), []
    for amplitude in (0.1, 1.0, 2.0, 3.0):
        exact = float(4 * ellipk(np.sin(amplitude / 2) ** 2) / rate)
        guess = Guess([amplitude, 0.0], 1.01 * exact)
        rows += _period(f"pendulum at {amplitude:g} rad", exact, chain(1), guess, theta1=amplitude)
    return rows


def turning() -> list[Comparison]:
    """The pendulum going over the top at one and a half and at five times the separatrix energy."""
    from scipy.special import ellipk

    rate, scale, rows = np.sqrt(1.5 * GRAVITY / LENGTH), GRAVITY * LENGTH / 2, []
    for energy in (1.5, 5.0):
        modulus = 2 / (1 + energy)
        exact = float(2 * np.sqrt(modulus) * ellipk(modulus) / rate)
        start = np.sqrt(2 * scale * (energy + 1) * 3)  # E = v^2 / 6 - scale cos(theta), at theta = 0
        guess = Guess([0.0, start], 1.01 * exact)
        rows += _period(f"pendulum turning, e = {energy:g}", exact, chain(1), guess, energy=energy * scale)
    return rows


def duffing_periods() -> list[Comparison]:
    """The hardening oscillator at a small and a large amplitude."""
    from scipy.special import ellipk

    model, rows = duffing(), []
    a, b = (float(model.parameter_values[model.parameter_index(name)]) for name in ("stiffness", "cubic"))
    for amplitude in (0.5, 3.0):
        hard = a + b * amplitude**2
        exact = float(4 * ellipk(b * amplitude**2 / (2 * hard)) / np.sqrt(hard))
        guess = Guess([amplitude, 0.0], 1.01 * exact)
        rows += _period(f"Duffing, A = {amplitude:g}", exact, model, guess, x=amplitude)
    return rows


def well() -> list[Comparison]:
    """Across both wells of V = depth ((x / distance)^2 - 1)^2, by the Duffing formula with a < 0."""
    from scipy.special import ellipk

    model = double_well()
    depth, distance = (float(model.parameter_values[model.parameter_index(n)]) for n in ("depth", "distance"))
    mass = 2 * float(model.kinetic([0.0], [1.0], model.parameter_values))
    a, b = -4 * depth / distance**2 / mass, 4 * depth / distance**4 / mass
    amplitude = 2 * distance
    hard = a + b * amplitude**2
    exact = float(4 * ellipk(b * amplitude**2 / (2 * hard)) / np.sqrt(hard))
    return _period("double well, across", exact, model, Guess([amplitude, 0.0], 1.01 * exact), x=amplitude)


def small_oscillations() -> list[Comparison]:
    """Linear modes of two point masses on massless rods of 1 m."""
    model = chain(2, com=1.0, inertia=0.0)
    squared, _ = normal_modes(model)
    exact = [(2 + sign * np.sqrt(2)) * GRAVITY / LENGTH for sign in (-1, 1)]
    return [
        number(f"double pendulum, w^2 of mode {k + 1} (1/s^2)", repr(float(one)), float(found), 1e-12 * one)
        for k, (one, found) in enumerate(zip(exact, squared, strict=True))
    ]
