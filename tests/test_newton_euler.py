"""The four derivations of the chain agree, in accelerations and in joint forces."""

import casadi as ca
import numpy as np
import pytest

from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.mechanics.constrained import maximal_states
from orbitfinder.mechanics.model import energies
from orbitfinder.mechanisms.chain import (
    FORMULATIONS,
    chain,
    chain_dae,
    chain_symbols,
    chain_system,
    inertial_forces,
    outboard_balances,
    recursive_acceleration,
)

STATES = 200
METHODS = ("lagrange", "newton-euler", "dae", "recursive")


def unequal(links):
    rng = np.random.default_rng(links)
    return {
        "length": rng.uniform(0.5, 2.0, links),
        "mass": rng.uniform(0.5, 2.0, links),
        "inertia": rng.uniform(0.05, 0.5, links),
        "com": rng.uniform(0.2, 0.8, links),
    }


def random_states(links):
    rng = np.random.default_rng(100 + links)
    return rng.uniform(-np.pi, np.pi, (STATES, links)), rng.normal(0.0, 3.0, (STATES, links))


def relative(found, reference):
    return np.max(np.linalg.norm(found - reference, axis=0) / np.linalg.norm(reference, axis=0))


def at_states(function, angles, rates, parameters):
    count = len(angles)
    return function.map(count)(angles.T, rates.T, np.tile(parameters[:, None], (1, count))).full()


def test_all_formulations_are_registered():
    assert set(FORMULATIONS) == set(METHODS)


@pytest.mark.parametrize("links", range(1, 7))
def test_four_derivations_give_the_same_accelerations(links):
    angles, rates = random_states(links)
    found = {}
    for method in METHODS:
        model = chain(links, **unequal(links), formulation=method)
        assert model.system["formulation"] == method
        p = np.tile(model.parameter_values[:, None], (1, STATES))
        found[method] = model.acceleration.map(STATES)(0.0, angles.T, rates.T, p).full()
    for method in METHODS[1:]:
        assert relative(found[method], found["lagrange"]) < 1e-11


@pytest.mark.parametrize("links", range(1, 7))
def test_three_derivations_give_the_same_joint_forces(links):
    """Newton-Euler, the recursion and the DAE's algebraic variables."""
    angles, rates = random_states(links)
    symbols = chain_symbols(chain_system(links, **unequal(links)))
    alpha, recursive = recursive_acceleration(symbols)
    arguments = symbols.arguments[1:]
    outboard = ca.cumsum(ca.horzcat(*reversed(inertial_forces(symbols, alpha))), 1)  # R_j = sum_{i>=j} m_i (a_Gi - g)
    recovered = ca.horzcat(*reversed(ca.horzsplit(outboard)))
    both = ca.Function("forces", arguments, [ca.vertcat(ca.vec(recovered), ca.vec(recursive))])
    newton_euler, recursion = np.split(at_states(both, angles, rates, np.array(symbols.parameter_values)), 2)
    dae = chain_dae(links, **unequal(links))
    x = maximal_states(dae, np.hstack([angles, rates])).T
    n = dae.degrees_of_freedom
    p = np.tile(dae.parameter_values[:, None], (1, STATES))
    native = dae.constraint.algebraic.map(STATES)(0.0, x[:n], x[n:], p).full()[n:]
    assert relative(native, newton_euler) < 1e-10
    assert relative(recursion, newton_euler) < 1e-10


def test_balances_vanish_at_lagranges_accelerations():
    """The report's equations themselves, not their differences."""
    system = chain_system(4, **unequal(4))
    symbols = chain_symbols(system)
    alpha = ca.SX.sym("alpha", 4)
    function = ca.Function("b", [symbols.coordinates, symbols.velocities, alpha, symbols.parameters],
                           [outboard_balances(symbols, alpha)])  # fmt: skip
    angles, rates = random_states(4)
    model = chain(4, **unequal(4), formulation="lagrange")
    for q, v in zip(angles[:20], rates[:20], strict=True):
        a = model.acceleration(0, q, v, model.parameter_values)
        assert np.abs(function(q, v, a, np.array(symbols.parameter_values)).full()).max() < 1e-10


@pytest.mark.parametrize("method", METHODS)
def test_more_links_than_the_graph_factorises(method):
    links = 18
    angles, rates = random_states(links)
    model, reference = chain(links, formulation=method), chain(links, formulation="recursive")
    a = model.acceleration(0, angles[0], rates[0], model.parameter_values).full()
    b = reference.acceleration(0, angles[0], rates[0], reference.parameter_values).full()
    assert relative(a, b) < 1e-10


@pytest.mark.parametrize("method", METHODS)
def test_triple_pendulum_from_horizontal_rest_conserves_energy(method):
    """10 s at 1e-14: every method within 1e-9 J of the start."""
    from orbitfinder.integrate.cvodes import IntegratorSettings

    model = chain(3, formulation=method)
    flow = build_flow(model, settings=IntegratorSettings(1e-14, 1e-14))
    states = sample(flow, np.r_[np.full(3, np.pi / 2), np.zeros(3)], 10.0, 501)
    total = np.sum(energies(model, states), axis=0)
    assert np.abs(total - total[0]).max() <= 1e-9
