"""The straight-line orbit of Hénon-Heiles near its saddle: where it bifurcates, against Hill's equation alone.

The energies, in units of the saddle's 1/6, at which the straight-line orbit has a double multiplier 1 are those of
M. Brack, "Bifurcation cascades and self-similarity of periodic orbits with analytical scaling constants in
Hénon-Heiles type potentials", Foundations of Physics 31 (2001), nlin/0006034 (abstract seen; its table could not be
opened, the six digits 0.969309 and 0.986709 are as they were quoted to us).
"""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import orbitfinder as of
from orbitfinder.loops.ipopt import SolveSettings

QUOTED = (0.969309, 0.986709)
BRACKETS = ((0.9685, 0.9700), (0.9860, 0.9875))


def turning_points(scaled):
    """The two ends (y) of the motion along x = 0 at the energy `scaled` / 6."""
    roots = np.sort(np.roots([-1 / 3, 0.5, 0.0, -scaled / 6]).real)
    return roots[0], roots[1]


def half_swing(scaled):
    """Half the period and the state-transition matrix of x'' = -(1 + 2 y) x over it, by DOP853."""

    def rates(_, s):
        y, v = s[:2]
        return [v, y * y - y, s[3], -(1 + 2 * y) * s[2], s[5], -(1 + 2 * y) * s[4]]

    def at_rest(_, s):
        return s[1]

    at_rest.direction, at_rest.terminal = -1, True
    start = [turning_points(scaled)[0], 0.0, 1.0, 0.0, 0.0, 1.0]
    path = solve_ivp(rates, (0.0, 60.0), start, "DOP853", rtol=1e-13, atol=1e-14, events=at_rest)
    end = path.y_events[0][0]
    return path.t_events[0][0], np.array([[end[2], end[4]], [end[3], end[5]]])


def hill_index(scaled):
    """mu + 1/mu by Hill's equation: the second half of the swing is the first one run backwards."""
    half = half_swing(scaled)[1]
    back = np.diag([1.0, -1.0])
    return float(np.trace(back @ np.linalg.solve(half, back @ half)))


def orbit_at(scaled):
    model = of.systems.FUNCTIONS["henon_heiles"]()
    guess = of.Guess([0.0, turning_points(scaled)[0], 0.0, 0.0], 2 * half_swing(scaled)[0])
    problem = of.Problem(model, guess, pin=of.pin(energy=scaled / 6), symmetry="brake")
    return of.find_orbit(problem, SolveSettings(with_certificate=False))


def test_the_index_of_the_straight_orbit():
    """Multipliers of the found orbit against the scalar equation, between the two bifurcations."""
    for scaled in (0.9, 0.975):
        orbit = orbit_at(scaled)
        assert np.abs(orbit.samples[:, 0]).max() < 1e-9, "left the line"
        assert orbit.floquet_multipliers.sum().real == pytest.approx(hill_index(scaled), abs=1e-8)


@pytest.mark.parametrize("symmetry", ["none", "brake"])
@pytest.mark.parametrize(("bracket", "quoted"), list(zip(BRACKETS, QUOTED, strict=True)))
def test_bifurcation_energies(bracket, quoted, symmetry):
    """trace Phi(T) = 4 as an equation leads to the bifurcation itself: Hill's to 1e-10, all six digits quoted."""
    model = of.systems.FUNCTIONS["henon_heiles"]()
    guess = of.Guess([0.0, turning_points(bracket[0])[0], 0.0, 0.0], 2 * half_swing(bracket[0])[0])
    double = of.Constraint(lambda v: ca.trace(v.monodromy) - 4, name="double multiplier 1")
    orbit = of.find_orbit(of.Problem(model, guess, symmetry=symmetry, constraints=(double,)))
    assert orbit.certificate.passed and orbit.stability == "marginal"
    exact = brentq(lambda scaled: hill_index(scaled) - 2, *bracket, xtol=1e-13)
    assert 6 * orbit.energy == pytest.approx(exact, abs=1e-10)
    assert round(6 * orbit.energy, 6) == quoted


def test_the_cascade_has_its_scaling():
    """1 - e shrinks by exp(2 pi / sqrt(3)) from one bifurcation of a kind to the next.

    At the saddle the transverse frequency is sqrt(3) and the longitudinal rate 1: one turn more takes
    2 pi / sqrt(3) longer.
    """
    grid = 1 - np.geomspace(4e-2, 2e-5, 160)
    values = np.array([hill_index(scaled) - 2 for scaled in grid])
    places = np.flatnonzero(np.diff(np.sign(values)))
    energies = [brentq(lambda scaled: hill_index(scaled) - 2, grid[k], grid[k + 1], xtol=1e-14) for k in places]
    assert [round(one, 6) for one in energies[:2]] == list(QUOTED)
    ratios = (1 - np.array(energies[:-2])) / (1 - np.array(energies[2:]))
    assert ratios == pytest.approx(np.exp(2 * np.pi / np.sqrt(3)), rel=0.02)
