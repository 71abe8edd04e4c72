"""Native DAEs: their equations, their reduction, and their motion under IDAS."""

import json

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipk

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.integrate.idas import DaeSettings, algebraic, simulate_dae
from orbitfinder.mechanics.constrained import constrained, maximal_states, minimal_states
from orbitfinder.mechanics.factorise import solve_positive_definite
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.lagrange import Symbols
from orbitfinder.mechanics.model import Baumgarte
from orbitfinder.mechanisms.chain import chain, chain_dae

GRAVITY = 9.8
HORIZONTAL_REST = np.r_[np.full(3, np.pi / 2), np.zeros(3)]


def cartesian_pendulum(baumgarte=None):
    q, v, p = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("p", 2)
    return constrained(
        0.5 * ca.sumsqr(v), -p[1] * q[0], 0.5 * (ca.sumsqr(q) - p[0] ** 2),
        Symbols(q, v, p, ("length", "gravity"), (1.0, GRAVITY)), baumgarte=baumgarte, names=["x", "y"],
    )  # fmt: skip


@pytest.mark.parametrize("baumgarte", [Baumgarte(), Baumgarte(3.0, 5.0)])
@pytest.mark.parametrize("build", [lambda b: cartesian_pendulum(b), lambda b: chain_dae(3, [1, 2, 0.5], baumgarte=b)])
def test_elimination_solves_the_residual(build, baumgarte):
    """Also off the constraints, where the Baumgarte terms act."""
    model = build(baumgarte)
    x = np.random.default_rng(0).normal(size=len(model.state_names))
    z = algebraic(model, x)[0]
    assert np.abs(model.constraint.residual(0.0, x, z, model.parameter_values).full()).max() < 1e-11


def test_written_constraints_are_the_derivatives_of_phi():
    """The chain's acceleration rows by hand against J a + Jdot v by differentiation, and J^T in the balances."""
    model = chain_dae(4, [1, 2, 0.5, 1.5], com=[0.3, 0.5, 0.6, 0.2])
    q, v, a = (ca.SX.sym(name, 12) for name in "qva")
    p, lam = model.parameter_values, ca.SX.sym("lam", 8)
    phi = model.constraint.phi(q, p)
    second = ca.jtimes(ca.jtimes(phi, q, v), q, v) + ca.jacobian(phi, q) @ a
    difference = ca.Function("d", [q, v, a], [second - model.constraint.acceleration(q, v, a, p)])
    forces = -ca.jacobian(model.constraint.balances(0, q, v, a, lam, p), lam)
    transposed = ca.Function("t", [q, v, a], [ca.densify(forces - model.constraint.jacobian(q, p).T)])
    numbers = np.random.default_rng(1).normal(size=(3, 12))
    assert np.abs(difference(*numbers).full()).max() < 1e-12
    assert np.abs(transposed(*numbers).full()).max() < 1e-12


def test_massless_directions_are_left_to_the_numerical_solver():
    """Point masses at the ends of the rods: M is singular in maximal coordinates, the DAE is not."""
    model, reference = (chain(2, inertia=0.0, com=1.0, formulation=f) for f in ("dae", "recursive"))
    q, v, p = [1.0, 2.0], [3.0, -1.0], reference.parameter_values
    found, expected = model.acceleration(0, q, v, p).full(), reference.acceleration(0, q, v, p).full()
    assert np.abs(found - expected).max() < 1e-11


def test_banded_factors_solve():
    rng = np.random.default_rng(2)
    lower = np.tril(rng.normal(size=(7, 7))) * (np.subtract.outer(range(7), range(7)) <= 2) + 3 * np.eye(7)
    matrix, right = lower @ lower.T, rng.normal(size=(7, 2))
    solution = solve_positive_definite(ca.SX(ca.sparsify(ca.DM(matrix))), ca.SX(ca.DM(right)))
    assert np.abs(matrix @ ca.evalf(solution).full() - right).max() < 1e-12


def test_minimal_and_maximal_states_are_inverse():
    model = chain_dae(3, [1, 2, 0.5])
    states = np.random.default_rng(3).normal(size=(5, 6))
    assert np.array_equal(minimal_states(model, maximal_states(model, states)), states)
    assert maximal_states(model, states[0]).shape == (18,)


def test_cartesian_pendulum_has_the_elliptic_period():
    """T = 4 sqrt(l/g) K(sin^2(theta0/2)): after it the pendulum is back at rest."""
    model, amplitude = cartesian_pendulum(Baumgarte(5.0, 5.0)), 1.0
    period = 4 * np.sqrt(1 / GRAVITY) * ellipk(np.sin(amplitude / 2) ** 2)
    start = [np.cos(amplitude), np.sin(amplitude), 0.0, 0.0]
    result = simulate_dae(model, start, period, 11)
    assert np.abs(result.states[-1] - start).max() < 1e-10
    assert result.forces[0, 0] == pytest.approx(-GRAVITY * np.cos(amplitude))


def test_triple_pendulum_dae_without_baumgarte_conserves_energy():
    """As in the report: 10 s from horizontal rest within 1e-9 J, at IDAS's tightest default tolerance."""
    model = chain_dae(3)
    result = simulate_dae(model, maximal_states(model, HORIZONTAL_REST), 10.0)
    assert np.abs(result.energy - result.energy[0]).max() <= 1e-9


def test_triple_pendulum_dae_with_baumgarte_keeps_the_constraints():
    model = chain_dae(3, baumgarte=Baumgarte(20.0, 20.0))
    result = simulate_dae(model, maximal_states(model, HORIZONTAL_REST), 10.0)
    assert result.constraint_drift.max() <= 1e-11
    assert result.rate_drift.max() <= 1e-10
    assert np.abs(result.energy - result.energy[0]).max() <= 1e-9


def test_native_and_reduced_motion_agree():
    model = chain_dae(3, baumgarte=Baumgarte(20.0, 20.0))
    start = maximal_states(model, HORIZONTAL_REST)
    native = simulate_dae(model, start, 2.0, 21)
    explicit = sample(build_flow(model), start, 2.0, 21)
    angles = sample(build_flow(chain(3)), HORIZONTAL_REST, 2.0, 21)
    assert np.abs(native.states - explicit).max() < 1e-9
    assert np.abs(minimal_states(model, native.states) - angles).max() < 1e-9


def test_description_rebuilds_the_native_dae():
    model = chain_dae(2, [1.0, 2.0], baumgarte=Baumgarte(3.0, 4.0))
    rebuilt = build_model(json.loads(json.dumps(model.system)))
    assert rebuilt.state_names == model.state_names and rebuilt.constraint.baumgarte == Baumgarte(3.0, 4.0)
    assert np.array_equal(rebuilt.parameter_values, model.parameter_values)
    angles = build_model(chain(2, [1.0, 2.0], formulation="dae").system)
    assert angles.constraint is None and np.array_equal(angles.parameter_values, model.parameter_values)


def test_tolerance_below_round_off_says_so():
    model = chain_dae(3)
    start = maximal_states(model, HORIZONTAL_REST)
    with pytest.raises(IntegrationError, match="try 1e-12"):
        simulate_dae(model, start, 10.0, settings=DaeSettings(1e-16, 1e-16))


def test_bad_input_is_refused():
    model = cartesian_pendulum()
    with pytest.raises(InputError, match="off the constraints"):
        simulate_dae(model, [1.1, 0.0, 0.0, 0.0], 1.0)
    with pytest.raises(InputError, match="4 finite numbers"):
        simulate_dae(model, [1.0, 0.0, np.nan, 0.0], 1.0)
    with pytest.raises(InputError, match="duration"):
        simulate_dae(model, [1.0, 0.0, 0.0, 0.0], -1.0)
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    with pytest.raises(InputError, match="leave no motion"):
        constrained(0.5 * ca.sumsqr(v), ca.SX(0), q, Symbols(q, v))
    with pytest.raises(InputError, match="constraint: depends on t;"):
        constrained(0.5 * ca.sumsqr(v), ca.SX(0), q[0] - ca.SX.sym("t"), Symbols(q, v))
    with pytest.raises(InputError, match="not a quadratic form"):
        constrained(0.5 * ca.sumsqr(v) + v[0], ca.SX(0), q[0], Symbols(q, v))
    with pytest.raises(InputError, match="potential: expected 1 x 1"):
        constrained(0.5 * ca.sumsqr(v), q, q[0], Symbols(q, v))


def test_forces_may_depend_on_time():
    """A bead on the line y = 0 pushed by cos t from rest: x = 1 - cos t, and the line carries the rest."""
    q, v, t = ca.SX.sym("q", 2), ca.SX.sym("v", 2), ca.SX.sym("t")
    push = ca.vertcat(ca.cos(t), ca.sin(t))
    model = constrained(0.5 * ca.sumsqr(v), ca.SX(0), q[1], Symbols(q, v, time=t), forces=push)
    result = simulate_dae(model, np.zeros(4), 3.0, 31)
    assert result.states[:, 0] == pytest.approx(1 - np.cos(result.times), abs=1e-11)
    assert result.forces[:, 0] == pytest.approx(-np.sin(result.times), abs=1e-11)


def test_hundred_links_for_ten_seconds():
    """From horizontal rest by CVODES the energy stays within 1e-9 of m g l n^2 / 2."""
    from orbitfinder.integrate.cvodes import IntegratorSettings
    from orbitfinder.mechanics.model import energies

    model = chain(100)
    flow = build_flow(model, settings=IntegratorSettings(1e-10, 1e-10))
    states = sample(flow, np.r_[np.full(100, np.pi / 2), np.zeros(100)], 10.0, 251)
    total = np.sum(energies(model, states), axis=0)
    assert np.abs(total - total[0]).max() <= 1e-9 * GRAVITY * 100**2 / 2
