"""Lagrange's equations from energies, against hand derivation, finite differences and NumPy."""

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.mechanics.factorise import acceleration_function, solve_positive_definite
from orbitfinder.mechanics.lagrange import (
    Symbols,
    lagrange,
    mass_matrix_and_bias,
)
from orbitfinder.mechanics.model import energies, energy, positions
from orbitfinder.mechanisms.chain import chain


def double_pendulum():
    """Point masses 1 and 2 kg on rods of 1 and 0.7 m, g = 9.8: symbols, T, V."""
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    m1, m2, l1, l2, g = 1.0, 2.0, 1.0, 0.7, 9.8
    kinetic = (
        0.5 * (m1 + m2) * l1**2 * v[0] ** 2
        + 0.5 * m2 * l2**2 * v[1] ** 2
        + m2 * l1 * l2 * v[0] * v[1] * ca.cos(q[0] - q[1])
    )
    potential = -(m1 + m2) * g * l1 * ca.cos(q[0]) - m2 * g * l2 * ca.cos(q[1])
    return q, v, kinetic, potential


def test_mass_matrix_and_bias_of_the_double_pendulum_by_hand():
    """M and h of the double pendulum with point masses are the textbook's (Goldstein, chapter 1)."""
    q, v, kinetic, potential = double_pendulum()
    derived = ca.Function("derived", [q, v], list(mass_matrix_and_bias(kinetic, potential, q, v)))
    random = np.random.default_rng(0)
    for _ in range(20):
        a, b, va, vb = random.normal(0, 2, 4)
        mass, bias = (part.full() for part in derived([a, b], [va, vb]))
        c = 2.0 * 0.7 * np.cos(a - b)
        s = 2.0 * 0.7 * np.sin(a - b)
        by_hand = [3 * 9.8 * np.sin(a) + s * vb**2, 2 * 0.7 * 9.8 * np.sin(b) - s * va**2]
        np.testing.assert_allclose(mass, [[3.0, c], [c, 2 * 0.49]], rtol=1e-13, atol=1e-13)
        np.testing.assert_allclose(bias.ravel(), by_hand, rtol=1e-12, atol=1e-12)


def test_the_acceleration_makes_the_euler_lagrange_expression_vanish():
    """d/dt dL/dv - dL/dq along q + v t + a t^2 / 2 vanishes, both derivatives by finite differences."""
    model = chain(3, [1.0, 0.6, 1.3], [1.0, 2.0, 0.4], formulation="lagrange")
    p, n, h = model.parameter_values, 3, 1e-4

    def lagrangian(q, v):
        return float(model.kinetic(q, v, p)) - float(model.potential(q, p))

    def slope(function, x):
        steps = h * np.eye(n)
        return np.array([
            (8 * (function(x + d) - function(x - d)) - function(x + 2 * d) + function(x - 2 * d)) / (12 * h)
            for d in steps
        ])  # fmt: skip

    random = np.random.default_rng(1)
    for _ in range(5):
        q, v = random.normal(size=n), random.normal(size=n)
        a = model.acceleration(0, q, v, p).full().ravel()

        def momentum(t, q=q, v=v, a=a):
            place = q + v * t + a * t * t / 2
            return slope(lambda u: lagrangian(place, u), v + a * t)

        rate = (8 * (momentum(h) - momentum(-h)) - momentum(2 * h) + momentum(-2 * h)) / (12 * h)
        np.testing.assert_allclose(rate, slope(lambda u, v=v: lagrangian(u, v), q), atol=1e-6)


@pytest.mark.parametrize("size", [1, 2, 3, 7, 16])
def test_the_unrolled_factorisation_solves_like_numpy(size):
    """The L D L^T written out in the graph agrees with numpy.linalg.solve on random positive matrices."""
    matrix, right = ca.SX.sym("A", size, size), ca.SX.sym("b", size)
    solve = ca.Function("solve", [matrix, right], [solve_positive_definite(matrix, right)])
    random = np.random.default_rng(size)
    for _ in range(10):
        root = random.normal(size=(size, size))
        a, b = root @ root.T + 0.1 * np.eye(size), random.normal(size=size)
        np.testing.assert_allclose(solve(a, b).full().ravel(), np.linalg.solve(a, b), rtol=1e-10, atol=1e-10)


def test_the_numeric_factorisation_agrees_with_the_unrolled_one():
    """Both ways of solving for the acceleration give the same numbers and the same derivative."""
    q, v, kinetic, potential = double_pendulum()
    arguments = [ca.SX.sym("t"), q, v, ca.SX(0, 1)]
    parts = mass_matrix_and_bias(kinetic, potential, q, v)
    arguments[3] = ca.SX.sym("p", 0)
    unrolled = acceleration_function(*parts, arguments)
    numeric = acceleration_function(*parts, arguments, limit=1)
    assert unrolled.is_a("SXFunction") and numeric.is_a("MXFunction")
    x = ca.MX.sym("x", 4)
    random = np.random.default_rng(2)
    state = random.normal(size=4)
    found = []
    for function in (unrolled, numeric):
        rate = function(0, x[:2], x[2:], ca.DM(0, 1))
        both = ca.Function("both", [x], [rate, ca.jacobian(rate, x)])
        found.append([part.full() for part in both(state)])
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-12)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-11, atol=1e-11)


def test_a_large_system_takes_the_numeric_path_and_agrees_with_the_recursion():
    """Beyond 16 coordinates M is factorised at run time; 18 links agree with the O(n) recursion."""
    random = np.random.default_rng(3)
    length, mass = random.uniform(0.5, 1.5, 18), random.uniform(0.5, 2, 18)
    dense = chain(18, length, mass, formulation="lagrange")
    fast = chain(18, length, mass)
    assert dense.acceleration.is_a("MXFunction")
    q, v = random.normal(size=18), random.normal(size=18)
    a = dense.acceleration(0, q, v, dense.parameter_values).full()
    b = fast.acceleration(0, q, v, fast.parameter_values).full()
    np.testing.assert_allclose(a, b, rtol=1e-10, atol=1e-10 * np.abs(b).max())


def test_generalized_forces_enter_the_acceleration_and_end_the_conservation_of_energy():
    """A damped, driven oscillator has a = (Q - k q) / m, carries its forces and has no invariant."""
    q, v, t, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t"), ca.SX.sym("p", 2)
    symbols = Symbols(q, v, p, ("stiffness", "damping"), (3.0, 0.2), t)
    model = lagrange(v**2, 0.5 * p[0] * q**2, symbols, forces=ca.cos(2 * t) - p[1] * v)
    assert model.invariants == ()
    found = float(model.acceleration(0.7, 0.3, 0.4, model.parameter_values))
    assert found == pytest.approx((np.cos(1.4) - 0.2 * 0.4 - 3.0 * 0.3) / 2, rel=1e-14)
    assert float(model.forces(0.7, 0.3, 0.4, model.parameter_values)) == pytest.approx(np.cos(1.4) - 0.08)


def test_a_custom_model_carries_names_energies_and_positions():
    """Names, energies along states and drawn points come out of lagrange() as they went in."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(
        0.5 * v**2, 2 * q**2, Symbols(q, v), names=["slide"], points=ca.vertcat(0, q), centres=ca.vertcat(q, 0)
    )
    assert model.state_names == ("slide", "slidedot") and model.angles == (False,)
    assert energy(model, [3.0, 2.0]) == 20.0
    kinetic, potential = energies(model, [[3.0, 2.0], [0.0, 4.0]])
    assert kinetic.tolist() == [2.0, 8.0] and potential.tolist() == [18.0, 0.0]
    assert positions(model, [[3.0, 2.0]]).tolist() == [[[0.0], [3.0]]]
    assert positions(model, [[3.0, 2.0]], "centres").tolist() == [[[3.0], [0.0]]]
    assert [one.name for one in model.invariants] == ["energy"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (dict(kinetic=lambda q, v: ca.vertcat(v, v)), r"kinetic: expected a scalar .*\(4, 1\)"),
        (dict(potential=lambda q, v: q), r"potential: expected a scalar .*\(2, 1\)"),
        (dict(velocities=3), "velocities: 3 given for 2 coordinates"),
        (dict(kinetic=lambda q, v: ca.sumsqr(v) * v[0]), "kinetic: not quadratic in the velocities"),
        (dict(kinetic=lambda q, v: ca.sumsqr(q)), r"kinetic: no mass moves with v_0, v_1; .* q' = f\(q\)"),
        (dict(kinetic=lambda q, v: v[0] ** 2), "kinetic: no mass moves with v_1; every velocity needs its term"),
    ],
)
def test_unusable_energies_are_refused_with_the_expression_named(change, message):
    """A vector, a missing velocity, a cubic or singular kinetic energy: InputError naming the expression."""
    q = ca.SX.sym("q", 2)
    v = ca.SX.sym("v", change.get("velocities", 2))
    kinetic = change.get("kinetic", lambda q, v: ca.sumsqr(v))(q, v)
    potential = change.get("potential", lambda q, v: ca.sumsqr(q))(q, v)
    with pytest.raises(InputError, match=message):
        lagrange(kinetic, potential, Symbols(q, v))


def test_an_energy_with_a_foreign_symbol_is_refused():
    """A symbol that is no coordinate, velocity or parameter is named in an InputError."""
    q, v, stray = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("stiffness")
    with pytest.raises(InputError, match="potential: .*stiffness"):
        lagrange(v**2, stray * q**2, Symbols(q, v))


def test_unknown_names_and_undeclared_points_are_refused():
    """Asking for an unknown parameter, state component or undeclared points says what there is."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2, q**2, Symbols(q, v))
    with pytest.raises(InputError, match="free: unknown physical parameter 'mass'"):
        model.parameter_index("mass")
    with pytest.raises(InputError, match="unknown state component 'x'; this system has q1, q1dot"):
        model.state_index("x")
    with pytest.raises(InputError, match="declares no points"):
        positions(model, [[0.0, 0.0]])


@pytest.mark.parametrize(
    ("symmetries", "message"),
    [
        ({"mirror": (1,)}, r"symmetries: 'mirror' is \[1\]; give 1 or -1 for each of 2 coordinates"),
        ({"mirror": (1, 0)}, r"give 1 or -1 for each of 2"),
        ({"mirror": (-1, -1)}, r"not all alike"),
        ({"a b": (1, -1)}, r"'a b' is no name"),
    ],
)
def test_symmetries_that_cannot_be_meant(symmetries, message):
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    with pytest.raises(InputError, match=message):
        lagrange(ca.sumsqr(v) / 2, ca.sumsqr(q) / 2, Symbols(q, v), symmetries=symmetries)
