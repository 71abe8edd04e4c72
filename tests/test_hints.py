"""Hints, and what is said of motions that are special: relative equilibria, rotations that no coordinate shows."""

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.errors import ConvergenceError, Hint


def spherical_pendulum():
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    kinetic = (v[0] ** 2 + ca.sin(q[0]) ** 2 * v[1] ** 2) / 2
    return of.lagrange(kinetic, -9.81 * ca.cos(q[0]), of.Symbols(q, v), names=["theta", "phi"], angles=[True, True])


def conical(angle=0.6):
    rate = np.sqrt(9.81 / np.cos(angle))
    return [angle, 0.0, 0.0, rate], 2 * np.pi / rate


def test_a_conical_pendulum_is_certified():
    """Energy and momentum unfold it the same way; one against the other they are no force, and count as none."""
    state, period = conical()
    orbit = of.find_orbit(of.Problem(spherical_pendulum(), of.Guess(state, period), winding=(0, 1)))
    assert orbit.certificate.passed and max(map(abs, orbit.unfolding)) < 1e-12
    assert orbit.period == pytest.approx(2 * np.pi * np.sqrt(np.cos(orbit.state[0]) / 9.81), rel=1e-12)


def test_a_pin_too_many_on_a_relative_equilibrium_is_named():
    state, period = conical()
    model = spherical_pendulum()
    problem = of.Problem(model, of.Guess(state, period), of.pin(energy=of.energy(model, state)), winding=(0, 1))
    with pytest.raises(ConvergenceError, match="turns along the symmetry of momentum_phi .*pin out"):
        of.find_orbit(problem)


def spring_in_space(**options):
    """y is measured in halves of the others, so that no turning of coordinates is the rotation about the vertical."""
    q, v = ca.SX.sym("q", 3), ca.SX.sym("v", 3)
    place, rate = (ca.vertcat(x[0], x[1] / 2, x[2]) for x in (q, v))
    energy = 20 * (ca.norm_2(place) - 1) ** 2 - 9.81 * q[2]
    return of.lagrange(ca.sumsqr(rate) / 2, energy, of.Symbols(q, v), names=["x", "y", "z"], **options)


def about_the_vertical():
    """x ydot - y xdot in halves, of the rotation that no coordinate shows."""
    q, v, p = ca.SX.sym("q", 3), ca.SX.sym("v", 3), ca.SX.sym("p", 0)
    turned, turning = (ca.vertcat(-x[1] / 2, 2 * x[0], 0) for x in (q, v))
    return of.Invariant(
        "spin",
        ca.Function("spin", [q, v, p], [(q[0] * v[1] - q[1] * v[0]) / 2]),
        ca.Function("spin_unfolding", [q, v, p], [turned]),
        ca.Function("rotation", [q, v, p], [ca.vertcat(turned, turning)]),
    )


def test_a_rotation_that_no_coordinate_shows_is_hinted_at_and_can_be_declared():
    guess = of.Guess([0.5, 0.0, 1.2, 0.0, 0.0, 0.0], 2.2)
    plain = spring_in_space()
    with pytest.warns(Hint, match=r"2 multipliers are at \+1 beyond .*\(energy\).* of\.Invariant"):
        undeclared = of.find_orbit(of.Problem(plain, guess))
    assert undeclared.stability == "marginal"
    declared = spring_in_space(invariants=(*plain.invariants, about_the_vertical()))
    orbit = of.find_orbit(of.Problem(declared, guess))
    assert orbit.certificate.passed and orbit.stability == "elliptic" and orbit.floquet_multipliers.size == 2


def test_degrees_in_the_place_of_radians_are_hinted_at():
    """An angle of several turns is solved as it stands, with a hint."""
    with pytest.warns(Hint, match="theta1 = 63 rad is 10 turns; .* 63 degrees are 1.09956 rad"):
        orbit = of.find_orbit(of.Problem(of.chain(1), of.Guess([63.0, 0.0], 1.64), of.pin(theta1=63.0)))
    assert orbit.certificate.passed


def test_a_failure_says_that_angles_are_in_rad():
    problem = of.Problem(of.chain(1), of.Guess([60.0, 0.0], 2.0), of.pin(energy=-2.0))
    with (
        pytest.warns(Hint),
        pytest.raises(ConvergenceError, match="no orbit found .*; angles are in rad, and 60 degrees are 1.0472 rad"),
    ):
        of.find_orbit(problem, of.SolveSettings(max_iterations=2))
