"""The second integrator: SciPy's port of Hairer's DOP853, its samples between steps, its failures."""

import casadi as ca
import numpy as np
import pytest
from conftest import pendulum_period
from scipy.integrate import DOP853, solve_ivp

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.dop853 import SECOND, STEPS_PER_PERIOD, TIGHTEST, ReferenceSettings, _root, integrate
from orbitfinder.integrate.field import vector_field
from orbitfinder.mechanics.canonical import canonical
from orbitfinder.mechanisms.chain import chain


def pendulum(n: int = 1):
    return vector_field(canonical(chain(n)).field)


def clock():
    """y' = (cos t, -sin t): only time matters."""
    t, y = ca.SX.sym("t"), ca.SX.sym("y", 2)
    return vector_field(ca.Function("clock", [t, y], [ca.vertcat(ca.cos(t), -ca.sin(t))]))


def test_it_agrees_with_the_class_that_scipy_steps_in_python():
    """A double pendulum over 3 s, at the end and at 20 times between, to 1e-12."""
    field, start, times = pendulum(2), np.array([0.4, -0.3, 0.2, 0.1]), np.linspace(0.0, 3.0, 22)
    wanted = solve_ivp(field, (0, 3), start, DOP853, times, rtol=2.3e-14, atol=1e-15, max_step=0.01).y.T
    found = integrate(field, start, times, TIGHTEST, 0.01)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    np.testing.assert_array_equal(found[-1], integrate(field, start, times[[0, -1]], TIGHTEST, 0.01)[-1])


def test_states_between_long_steps_are_as_good_as_the_steps():
    """Twelve samples inside each of a few long steps at 1e-8 are no worse than the end state."""
    field, start = pendulum(2), np.array([0.4, -0.3, 0.2, 0.1])
    rough, times = ReferenceSettings(1e-8, 1e-8), np.linspace(0.0, 1.0, 200)
    exact, found = (integrate(field, start, times, settings) for settings in (TIGHTEST, rough))
    errors = np.abs(found - exact).max(axis=1)
    assert errors[-1] > 1e-12 and errors.max() < 5 * errors[-20:].max() < 1e-6


def test_time_between_the_steps_is_the_samples_own():
    """A field that depends on time alone, started at 0.5 s, is exact at every sample."""
    times = np.linspace(0.5, 6.0, 40)
    found = integrate(clock(), np.array([np.sin(0.5), np.cos(0.5)]), times, SECOND, 0.3)
    np.testing.assert_allclose(found, np.stack([np.sin(times), np.cos(times)], axis=1), atol=3e-14)


def test_any_callable_is_sampled_like_a_casadi_function():
    """A field without `many` is called sample by sample and gives the same states."""
    field, times = pendulum(), np.linspace(0.0, 2.0, 30)
    plain = integrate(lambda t, y: field(t, y), np.array([1.0, 0.0]), times)
    np.testing.assert_allclose(plain, integrate(field, np.array([1.0, 0.0]), times), rtol=0, atol=1e-15)


def test_rates_of_many_states_are_those_of_each():
    """`many` of a field with a structural zero agrees with single calls."""
    t, y = ca.SX.sym("t"), ca.SX.sym("y", 3)
    field = vector_field(ca.Function("f", [t, y], [ca.vertcat(y[1] + t, ca.SX(1, 1), ca.sin(y[0]))]))
    times, states = np.linspace(0, 1, 5), np.random.default_rng(0).normal(size=(5, 3))
    single = np.stack([field(t, y) for t, y in zip(times, states, strict=True)])
    np.testing.assert_array_equal(field.many(times, states), single)


def test_equal_steps_add_up_to_the_period():
    """The swing of 0.5 rad closes to 5e-15; steps of T/800 as they are would miss the end by 3e-14 s and more."""
    period = pendulum_period(0.5)
    ends = []
    for steps in range(STEPS_PER_PERIOD, STEPS_PER_PERIOD + 60, 7):
        path = integrate(pendulum(), np.array([0.5, 0.0]), np.array([0.0, period]), TIGHTEST, period / steps)
        ends.append(np.abs(path[-1] - path[0]).max())
    assert max(ends) < 5e-15


@pytest.mark.parametrize("error", [KeyError("planted"), KeyboardInterrupt(), IntegrationError("planted")])
@pytest.mark.parametrize("times", [(0.0, 2.0), (0.0, 1.0, 2.0)])
@pytest.mark.parametrize("calls", [2, 3, 40])
def test_what_the_field_raises_comes_out(error, times, calls):
    """An exception in a callback ends the integration at once and is raised as it is, once."""
    field, called = pendulum(), []

    def failing(t, y):
        called.append(t)
        if len(called) == calls:
            raise error
        return field(t, y)

    with pytest.raises(type(error)) as caught:
        integrate(failing, np.array([1.0, 0.0]), np.array(times))
    assert caught.value is error and len(called) == calls


def test_an_interrupt_that_c_code_wrapped_is_found():
    """SciPy's C code makes a SystemError of an exception raised between two callbacks, and a ValueError of that."""
    interrupt = KeyboardInterrupt()
    try:
        try:
            raise SystemError("returned a result with an exception set") from interrupt
        except SystemError as error:
            raise ValueError("Function to integrate must not return a tuple.") from error
    except ValueError as error:
        assert _root(error) is interrupt
    plain = ValueError("its own")
    assert _root(plain) is plain


def test_a_blow_up_is_named_with_its_time():
    """y' = y^2 from 1 at 0 is infinite at 1 s."""
    with pytest.raises(IntegrationError, match="step size becomes too small") as caught:
        integrate(lambda t, y: y * y, np.array([1.0]), np.array([0.0, 2.0]))
    assert caught.value.time == pytest.approx(1.0, abs=1e-6)


def test_too_many_evaluations_are_refused():
    """A limit of 1200 evaluations is 100 steps."""
    few = ReferenceSettings(max_evaluations=1200)
    with pytest.raises(IntegrationError, match="too many evaluations") as caught:
        integrate(pendulum(), np.array([1.0, 0.0]), np.array([0.0, 10.0]), few, 0.01)
    assert caught.value.time == pytest.approx(1.0, abs=0.05)


def test_stiff_equations_are_refused():
    """DOP853 notices that y' = -1e5 (y - cos t) keeps it at the edge of stability."""
    rough = ReferenceSettings(1e-5, 1e-5)
    with pytest.raises(IntegrationError, match="probably stiff"):
        integrate(lambda t, y: -1e5 * (y - np.cos(t)), np.array([1.0]), np.array([0.0, 10.0]), rough)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_rates_that_stop_being_numbers_are_an_error(bad):
    """Rates that are not finite from 0.5 s on stop the integration there."""
    with pytest.raises(IntegrationError) as caught:
        integrate(lambda t, y: -y if t < 0.5 else y * bad, np.array([1.0]), np.array([0.0, 2.0]))
    assert caught.value.time <= 0.5


def test_starts_without_meaning_are_refused():
    """A start or its rates that are not finite, named before integrating."""
    field = pendulum()
    with pytest.raises(IntegrationError, match="start is not finite"):
        integrate(field, np.array([np.nan, 0.0]), np.array([0.0, 1.0]))
    with pytest.raises(IntegrationError, match="overflow there"):
        integrate(field, np.array([1.0, 1e200]), np.array([0.0, 1.0]))
