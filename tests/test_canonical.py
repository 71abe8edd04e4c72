"""Hamilton's equations against the accelerations, and their structure."""

import casadi as ca
import numpy as np
import pytest

from orbitfinder.integrate.dop853 import integrate
from orbitfinder.integrate.field import vector_field
from orbitfinder.mechanics.canonical import canonical
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanics.model import energies
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.evidence import ClosureCheck, Hamiltonian, gather
from orbitfinder.orbits.measure import frame
from orbitfinder.systems import henon_heiles, pendulum_on_cart


def unequal(links):
    """A chain with no two links alike."""
    random = np.random.default_rng(links)
    return chain(links, random.uniform(0.5, 1.5, links), random.uniform(0.5, 2, links))


@pytest.mark.parametrize("links", [1, 2, 3, 5, 17])
def test_hamiltons_equations_are_the_accelerations_in_other_coordinates(links):
    """dq/dt = v and d momentum/dt = (d momentum/dq) v + M a, at random states; 17 links take the numeric path."""
    model = unequal(links)
    equations = canonical(model)
    q, v = ca.MX.sym("q", links), ca.MX.sym("v", links)
    momentum = equations.momentum(q, v)
    acceleration = model.acceleration(0, q, v, ca.DM(model.parameter_values))
    rate = ca.jtimes(momentum, q, v) + ca.jtimes(momentum, v, acceleration)
    both = ca.Function("both", [q, v], [momentum, rate])
    random = np.random.default_rng(1)
    for _ in range(5):
        place, speed = random.normal(size=links), random.normal(size=links)
        start, wanted = both(place, speed)
        found = equations.field(0, ca.vertcat(place, start)).full().ravel()
        np.testing.assert_allclose(found[:links], speed, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(found[links:], wanted.full().ravel(), rtol=1e-10, atol=1e-9)


def test_forces_reach_the_momenta():
    """Damping and a linear term in v: v = (momentum - offset) / m and momentum' = -dV/dq + Q."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    model = lagrange(v**2 + 0.5 * v, q**2, Symbols(q, v), forces=-0.3 * v)
    found = canonical(model).field(0, [0.7, 1.5]).full().ravel()
    np.testing.assert_allclose(found, [0.5, -1.4 - 0.15], rtol=1e-14)


@pytest.mark.parametrize("links", [1, 2, 3, 4])
def test_the_monodromy_is_symplectic_and_the_action_is_the_integral_of_twice_the_kinetic_energy(links):
    """Phi^T J Phi = J along an open arc of 1.2 s, and S = int 2 T dt by Gauss quadrature of the same arc."""
    model = unequal(links)
    equations = canonical(model)
    random = np.random.default_rng(links)
    q, v = random.normal(0, 0.5, links), random.normal(size=links)
    start = np.concatenate([q, equations.momentum(q, v).full().ravel()])
    extended = np.concatenate([start, np.eye(2 * links).ravel(), [0.0]])
    path = integrate(vector_field(equations.variational), extended, np.array([0.0, 1.2]))
    phi = path[-1, 2 * links : -1].reshape(2 * links, 2 * links, order="F")
    unit = np.kron([[0, 1], [-1, 0]], np.eye(links))
    assert np.abs(phi.T @ unit @ phi - unit).max() <= 1e-10
    points, weights = np.polynomial.legendre.leggauss(200)
    field = vector_field(equations.field)
    times = np.concatenate([[0.0], 0.6 * (points + 1), [1.2]])
    momenta = integrate(field, start, times, longest_step=0.01)
    states = np.stack([np.concatenate([row[:links], field(0.0, row)[:links]]) for row in momenta[1:-1]])
    kinetic, _ = energies(model, states)
    assert path[-1, -1] == pytest.approx(0.6 * weights @ (2 * kinetic), rel=1e-9)


@pytest.mark.parametrize(
    "model",
    [chain(3), chain(2, gravity=0.0), pendulum_on_cart(), henon_heiles()],
    ids=["hanging", "free", "cart", "star"],
)
def test_gradients_and_directions_are_the_same_in_both_coordinates(model):
    """Canonical directions are those in (q, v) carried over, canonical gradients those that pull back to them."""
    x = np.random.default_rng(0).normal(size=len(model.state_names))
    equations = Hamiltonian(model)
    gradients, directions, held = equations.frame(x, equations.start(x))
    lift = equations.equations.lift(*np.split(x, 2)).full()
    wanted, moved = frame(model, x)
    np.testing.assert_allclose(gradients @ lift, wanted, atol=1e-12)
    np.testing.assert_allclose(directions, moved @ lift.T, atol=1e-12)
    assert not held.size and gradients.shape == directions.shape
    assert np.abs(directions @ gradients.T).max() < 1e-12  # every invariant is kept by every symmetry


def test_one_path_serves_the_closure_and_the_certificate():
    """What says that a point of a family closes is the motion that a certificate measures."""
    model, x = chain(2), np.array([0.4, -0.3, 0.2, 0.1])
    found = ClosureCheck(model).ends(x[None], np.array([0.7]))[0]
    np.testing.assert_allclose(found, gather(model, x, 0.7, np.zeros(2)).states[-1], atol=1e-12)


def test_directional_derivatives_are_all_slopes(monkeypatch):
    """Of large systems, whose slopes take long to derive."""
    model = chain(3)
    z = np.random.default_rng(1).normal(0.0, 0.5, 6 + 36 + 1)
    dense = canonical(model)
    monkeypatch.setattr("orbitfinder.mechanics.canonical.UNROLLED_FACTORISATION_LIMIT", 2)
    columns = canonical(model)
    assert columns.variational.is_a("MXFunction") and not dense.variational.is_a("MXFunction")
    found, known = (each.variational(0.3, z).full() for each in (columns, dense))
    np.testing.assert_allclose(found, known, rtol=1e-12, atol=1e-12 * np.abs(known).max())
