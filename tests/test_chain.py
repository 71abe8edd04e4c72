"""The n-link chain: two derivations, an independent dense one, energy, geometry, bad input."""

from functools import cache

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import build_flow, end_state
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import energy, positions
from orbitfinder.mechanisms.chain import chain


@cache
def long_chain(links: int):
    """A uniform chain by the recursion, derived once for all tests."""
    return chain(links)


def unequal(links: int, seed: int) -> dict:
    """Random physical parameters, no two links alike."""
    random = np.random.default_rng(seed)
    return {
        "length": random.uniform(0.4, 1.6, links),
        "mass": random.uniform(0.3, 3.0, links),
        "inertia": random.uniform(0.01, 0.5, links),
        "com": random.uniform(0.1, 0.9, links),
    }


def dense_acceleration(q, v, length, mass, inertia, com, gravity=9.8):
    """M(q)^-1 of the right-hand side written in NumPy from the textbook's cosines, no CasADi.

    M_ij = c_ij cos(q_i - q_j), c_ij = l_i (m_j d_j + l_j sum_{k>j} m_k) for i < j,
    c_ii = I_i + m_i d_i^2 + l_i^2 sum_{k>i} m_k; the gravity moment of link i is
    -(m_i d_i + l_i sum_{k>i} m_k) g sin q_i.
    """
    offset = com * length
    below = np.append(np.cumsum(mass[::-1])[::-1][1:], 0.0)
    moment = mass * offset + length * below
    constants = np.triu(np.outer(length, moment), 1)
    constants = constants + constants.T + np.diag(inertia + mass * offset**2 + length**2 * below)
    difference = q[:, None] - q[None, :]
    right = -(constants * np.sin(difference)) @ v**2 - gravity * moment * np.sin(q)
    return np.linalg.solve(constants * np.cos(difference), right)


@pytest.mark.parametrize("links", range(1, 7))
def test_recursive_and_lagrange_agree(links):
    """Two derivations give the same acceleration at 200 random states of unequal links, to 1e-11 relative."""
    system = unequal(links, links)
    models = [chain(links, **system, formulation=name) for name in ("recursive", "lagrange")]
    random = np.random.default_rng(links)
    q, v = random.uniform(-np.pi, np.pi, (links, 200)), random.uniform(-5, 5, (links, 200))
    values = np.tile(models[0].parameter_values[:, None], (1, 200))
    fast, dense = (model.acceleration.map(200)(0, q, v, values).full() for model in models)
    error = np.abs(fast - dense).max(axis=0) / np.abs(dense).max(axis=0)
    assert error.max() <= 1e-11


@pytest.mark.parametrize("links", [1, 2, 5, 100, pytest.param(1000, marks=pytest.mark.slow)])
def test_the_recursion_agrees_with_an_independent_dense_mass_matrix(links):
    """Up to 1000 links the recursion agrees with a NumPy solve of the full mass matrix to 1e-10."""
    model = long_chain(links)
    random = np.random.default_rng(links)
    ones = np.ones(links)
    for _ in range(3):
        q, v = random.uniform(-np.pi, np.pi, links), random.uniform(-2, 2, links)
        found = model.acceleration(0, q, v, model.parameter_values).full().ravel()
        wanted = dense_acceleration(q, v, ones, ones, ones / 12, 0.5 * ones)
        assert np.abs(found - wanted).max() <= 1e-10 * np.abs(wanted).max()


def test_the_dense_formula_agrees_for_unequal_links():
    """Inertia, mass, length and centre of mass of each link enter where mechanics puts them."""
    system = unequal(6, 9)
    model = chain(6, **system)
    random = np.random.default_rng(5)
    q, v = random.normal(size=6), random.normal(size=6)
    found = model.acceleration(0, q, v, model.parameter_values).full().ravel()
    np.testing.assert_allclose(found, dense_acceleration(q, v, **system), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize("most", [30, pytest.param(100, marks=pytest.mark.slow)])
def test_the_number_of_operations_grows_linearly(most):
    """Every further link costs the same number of them, to the last one."""
    links = np.array([3, 5, 10, most])
    operations = [long_chain(int(n)).acceleration.n_instructions() for n in links]
    each = np.diff(operations) / np.diff(links)
    assert np.all(each == each[0])


@pytest.mark.parametrize("formulation", ["recursive", "lagrange"])
@pytest.mark.parametrize("gravity", [9.8, 0.0])
def test_every_invariant_is_kept_by_the_acceleration(formulation, gravity):
    """dI/dt = I_q v + I_v a vanishes at random states for energy and, without gravity, angular momentum."""
    model = chain(4, **unequal(4, 4), gravity=gravity, formulation=formulation)
    names = [one.name for one in model.invariants]
    assert names == (["energy"] if gravity else ["energy", "angular_momentum"])
    q, v, p = ca.MX.sym("q", 4), ca.MX.sym("v", 4), ca.DM(model.parameter_values)
    acceleration = model.acceleration(0, q, v, p)
    random = np.random.default_rng(6)
    for one in model.invariants:
        value = one.value(q, v, p)
        parts = [ca.dot(ca.gradient(value, q), v), ca.dot(ca.gradient(value, v), acceleration)]
        terms = ca.Function("terms", [q, v], parts)
        for _ in range(20):
            drift, drive = map(float, terms(random.normal(size=4), random.normal(size=4)))
            assert abs(drift + drive) <= 1e-11 * max(abs(drift), abs(drive), 1.0)


def test_the_unfolding_changes_its_invariant_in_one_direction():
    """Along u the energy changes at v.M v > 0, and the angular momentum is turned by its generator."""
    model = chain(3, gravity=0.0)
    energy_one, spin = model.invariants
    q, v, p = ca.MX.sym("q", 3), ca.MX.sym("v", 3), ca.DM(model.parameter_values)
    rate = ca.dot(ca.gradient(energy_one.value(q, v, p), v), energy_one.unfolding(q, v, p))
    turning = ca.dot(ca.gradient(spin.value(q, v, p), v), spin.unfolding(q, v, p))
    check = ca.Function("check", [q, v], [rate, turning, model.kinetic(q, v, p)])
    random = np.random.default_rng(7)
    for _ in range(10):
        found, turned, kinetic = map(float, check(random.normal(size=3), random.normal(size=3)))
        assert found == pytest.approx(2 * kinetic, rel=1e-12)
        assert turned > 0
    np.testing.assert_array_equal(spin.generator([0, 0, 0], [0, 0, 0], p).full().ravel(), [1, 1, 1, 0, 0, 0])


def test_angular_momentum_is_kept_over_a_simulation_without_gravity():
    """Ten seconds of free rotation keep energy and angular momentum about the joint to 1e-9."""
    model = chain(3, gravity=0.0)
    start = np.array([0.3, -1.0, 2.0, 1.0, -2.0, 0.5])
    end = end_state(build_flow(model), start, 10.0)
    for one in model.invariants:
        before, after = (float(one.value(x[:3], x[3:], model.parameter_values)) for x in (start, end))
        assert abs(after - before) <= 1e-9 * max(1.0, abs(before))


def test_the_kinetic_energy_is_that_of_the_moving_centres():
    """T = sum 1/2 m |d centre/dt|^2 + 1/2 I w^2, the velocities by finite differences of the centres."""
    system = unequal(3, 3)
    model = chain(3, **system)
    random = np.random.default_rng(8)
    q, v, h = random.normal(size=3), random.normal(size=3), 1e-5
    states = np.stack([np.concatenate([q + k * h * v, v]) for k in (-1, 1)])
    before, after = positions(model, states, "centres")
    speed = ((after - before) / (2 * h)).T
    wanted = 0.5 * system["mass"] @ np.sum(speed**2, axis=1) + 0.5 * system["inertia"] @ v**2
    assert float(model.kinetic(q, v, model.parameter_values)) == pytest.approx(wanted, rel=1e-8)


def test_joints_and_centres_stand_where_the_angles_put_them():
    """x points down and y to the right: a horizontal link reaches to y = l, a hanging one to x = l."""
    model = chain(2, [2.0, 1.0], com=[0.25, 0.5])
    state = [np.pi / 2, 0.0, 0.0, 0.0]
    np.testing.assert_allclose(positions(model, [state])[0], [[0, 0, 1], [0, 2, 2]], atol=1e-15)
    np.testing.assert_allclose(positions(model, [state], "centres")[0], [[0, 0.5], [0.5, 2]], atol=1e-15)


def test_the_potential_energy_is_zero_at_the_joint_and_minus_g_n_squared_over_two_hanging():
    """V = -sum m g x_G: the hanging uniform chain has -g n^2 / 2, the horizontal one 0."""
    model = chain(3)
    assert energy(model, np.zeros(6)) == pytest.approx(-9.8 * 9 / 2, rel=1e-15)
    assert energy(model, [np.pi / 2] * 3 + [0.0] * 3) == pytest.approx(0.0, abs=1e-13)


def test_a_model_is_rebuilt_from_its_description():
    """build_model(model.system) gives the same parameters and accelerations."""
    model = chain(3, **unequal(3, 2), gravity=3.7, formulation="lagrange")
    again = build_model(model.system)
    assert again.system == model.system and again.parameter_names == model.parameter_names
    np.testing.assert_array_equal(again.parameter_values, model.parameter_values)
    q, v = np.ones(3), np.ones(3)
    a, b = (m.acceleration(0, q, v, m.parameter_values).full() for m in (model, again))
    np.testing.assert_array_equal(a, b)


def test_changed_parameters_reach_the_description():
    """with_parameters changes numbers, description and a default inertia together."""
    model = with_parameters(chain(2), {"length2": 0.5, "gravity": 1.6})
    assert model.system["length"] == [1.0, 0.5] and model.system["gravity"] == 1.6
    fresh = chain(2, [1.0, 0.5], gravity=1.6)
    np.testing.assert_array_equal(model.parameter_values, fresh.parameter_values)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(links=0), "links: must be a whole number of at least 1, got 0"),
        (dict(links=-2), "links: must be .*got -2"),
        (dict(links=2.0), "links: must be a whole number .*got 2.0"),
        (dict(links=True), "links: must be .*got True"),
        (dict(links="3"), "links: must be .*got '3'"),
        (dict(length=0.0), "length: must be greater than 0, got 0.0"),
        (dict(length=[1, -1, 1]), "length: must be greater than 0"),
        (dict(mass=-1.0), "mass: must be greater than 0, got -1.0"),
        (dict(mass=[1, 2]), "mass: 2 numbers for 3 links"),
        (dict(mass=float("nan")), "mass: must be finite, got nan"),
        (dict(com=float("inf")), "com: must be finite, got inf"),
        (dict(inertia=-0.1), "inertia: must be at least 0, got -0.1"),
        (dict(inertia=0.0, com=0.0), "inertia: a link with inertia 0 and com 0"),
        (dict(gravity=float("nan")), "gravity: must be finite, got nan"),
        (dict(formulation="newton"), "formulation: unknown 'newton'; use one of .*recursive"),
    ],
)
def test_bad_input_is_refused_with_field_and_value(arguments, message):
    """Each unusable number of a chain is an InputError that names the field, the value and a remedy."""
    with pytest.raises(InputError, match=message):
        chain(**{"links": 3, **arguments})


@pytest.mark.parametrize(
    ("system", "message"),
    [
        ({"kind": "spring"}, "system.kind: cannot rebuild 'spring'"),
        ({}, "system.kind: cannot rebuild None"),
        ({"kind": "chain"}, "system: .*links"),
        ({"kind": "chain", "links": 2, "colour": "red"}, "system: .*colour"),
        ({"kind": "chain", "links": 2, "length": "long"}, "length: .*long"),
        ({"kind": "chain", "links": 2, "length": [[1, 2]]}, "length: "),
        ({"kind": "chain", "links": 2, "gravity": "strong"}, "gravity: .*strong"),
        ({"kind": "chain", "links": 2, "formulation": ["lagrange"]}, "formulation: "),
    ],
)
def test_an_unusable_description_is_refused(system, message):
    """A description from a damaged file is an InputError, never another exception."""
    with pytest.raises(InputError, match=message):
        build_model(system)
