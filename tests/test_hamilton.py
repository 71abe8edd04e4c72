"""The certificate's equations are derived once a model, and compiled for those whose orbits are many."""

import casadi as ca
import numpy as np
import pytest

import orbitfinder as of
from orbitfinder.integrate import equations as module
from orbitfinder.integrate.compiled import available, compiling
from orbitfinder.integrate.equations import KEPT, accelerations, hamilton, prepare
from orbitfinder.integrate.field import vector_field
from orbitfinder.mechanics.canonical import canonical
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import altered
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.certify import certify


@pytest.fixture(autouse=True)
def forgetful():
    """Each test begins with nothing remembered."""
    module._derived.clear()


def test_equations_are_derived_once():
    """The same model gives the same functions; another value, force or model gives others."""
    model = chain(2)
    assert hamilton(model) is hamilton(altered(model, points=None))
    assert accelerations(model) is accelerations(model)
    longer = with_parameters(model, {model.parameter_names[0]: 1.5})
    n = model.degrees_of_freedom
    t, q, v, p = ca.SX.sym("t"), ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("p", model.parameter_values.size)
    damped = altered(model, forces=ca.Function("damping", [t, q, v, p], [-v]))
    others = [hamilton(one) for one in (model, longer, damped, chain(2))]
    assert len({id(one) for one in others}) == 4
    y = np.array([0.3, 0.1, 0.2, 0.5])
    rates = [one.field(0.0, y).full().ravel() for one in others]
    np.testing.assert_array_equal(rates[0], rates[3])
    assert np.abs(rates[1] - rates[0]).max() > 0.1 and np.abs(rates[2] - rates[0]).max() > 0.1


@pytest.mark.parametrize("build", [of.systems.forced_duffing, of.systems.henon_heiles, of.systems.lorenz])
def test_equations_are_derived_once_for_all_values_of_the_parameters(build):
    """Of what is not made anew at each value; they are those that are derived with the values in them."""
    model = build()
    name = model.parameter_names[0]
    other = with_parameters(model, {name: 1.1 * model.parameter_values[0] + 0.1})
    ours, theirs = hamilton(model), hamilton(other)
    assert ours is hamilton(model) and ours is not theirs
    assert ours.field.function is theirs.field.function and ours.variational.function is theirs.variational.function
    assert accelerations(model).function is accelerations(other).function
    random = np.random.default_rng(0)
    for one, known in ((hamilton(each), canonical(each)) for each in (model, other)):
        size = known.field.size1_in(1)
        assert one.coordinates.size == known.coordinates.size
        for function, fixed in ((one.field, known.field), (one.variational, known.variational)):
            for y in random.uniform(-1.0, 1.0, (5, fixed.size1_in(1))):
                t = float(random.uniform())
                np.testing.assert_allclose(function(t, y).full(), fixed(t, y).full(), rtol=1e-13, atol=1e-14)
        y = random.uniform(-1.0, 1.0, size)
        q, v = np.split(y[: 2 * known.coordinates.size], [known.coordinates.size])
        for name in ("momentum", "lift"):
            both = (getattr(equations, name)(q, v).full() for equations in (one, known))
            np.testing.assert_allclose(*both, rtol=1e-14, atol=1e-15)
        np.testing.assert_allclose(one.tangent(y).full(), known.tangent(y).full(), rtol=1e-14)


def test_only_so_many_are_remembered():
    """The oldest equations make room; they are derived again when asked for."""
    models = [chain(1, length=1.0 + k) for k in range(KEPT + 1)]
    first, *_ = [hamilton(one) for one in models]
    assert len(module._derived) == KEPT and hamilton(models[0]) is not first


def _fields(model):
    """The certificate's equations as fields: of the orbit, of its variations, of the second formulation."""
    return [vector_field(one) for one in (hamilton(model).field, hamilton(model).variational, accelerations(model))]


@pytest.mark.skipif(not available()[0], reason="no C compiler")
def test_prepared_equations_give_the_same_certificate(report_orbits):
    """Compiled: the value of every check is the interpreted one to the last bit."""
    orbit, model = report_orbits["triple-1"], chain(3)
    with compiling("off"):
        before = certify(orbit, model)
    with compiling("on"):
        prepare(model)
        after = certify(orbit, model)
        assert all(one.library() is not None for one in _fields(model))
    assert after.passed and [one.name for one in after.checks] == [one.name for one in before.checks]
    for one, two in zip(before.checks, after.checks, strict=True):
        np.testing.assert_array_equal(two.value, one.value, err_msg=one.name)


def test_nothing_is_compiled_where_that_is_off():
    """Prepared equations are interpreted, however much work is to come."""
    model = chain(2)
    with compiling("off"):
        prepare(model)
        assert all(one.library() is None for one in _fields(model))
