"""The flow and its derivatives, against exact solutions, finite differences and DOP853."""

import casadi as ca
import numpy as np
import pytest
from conftest import dop853

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.cvodes import (
    IntegratorSettings,
    build_flow,
    end_state,
    integration_error,
    sample,
    transition,
    vector_field,
)
from orbitfinder.integrate.dop853 import integrate
from orbitfinder.integrate.field import vector_field as numeric_field
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.lagrange import Symbols, acceleration_function, lagrange, mass_matrix_and_bias
from orbitfinder.mechanics.model import altered
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.shoot import initial_nodes

OMEGA = 1.7


def oscillator():
    """x'' = -OMEGA^2 x through lagrange(), its stiffness a parameter."""
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("p")
    return lagrange(0.5 * v**2, 0.5 * p * q**2, Symbols(q, v, p, ("stiffness",), (OMEGA**2,)))


def exact_transition(t):
    """State-transition matrix of the oscillator."""
    c, s = np.cos(OMEGA * t), np.sin(OMEGA * t)
    return np.array([[c, s / OMEGA], [-OMEGA * s, c]])


def exploding():
    """V = -q^4: from q = 1, v = 0 the motion reaches infinity in finite time (about 0.93 s)."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    return lagrange(0.5 * v**2, -(q**4), Symbols(q, v))


def differences(function, x, h):
    """Jacobian by the four-point central rule, error of order h^4."""
    columns = []
    for step in h * np.eye(x.size):
        near, far = function(x + step) - function(x - step), function(x + 2 * step) - function(x - 2 * step)
        columns.append((8 * near - far) / (12 * h))
    return np.stack(columns, axis=1)


@pytest.mark.parametrize("duration", [0.3, 3.0, 20.0])
def test_the_harmonic_oscillator_is_exact(duration):
    """End state and state-transition matrix of the oscillator are the cosine and the sine."""
    flow, start = build_flow(oscillator()), np.array([0.4, -1.1])
    wanted = exact_transition(duration)
    end, matrix = transition(flow, start, duration)
    np.testing.assert_allclose(end, wanted @ start, atol=1e-10)
    np.testing.assert_allclose(matrix, wanted, atol=1e-10)
    np.testing.assert_allclose(end_state(flow, start, duration), wanted @ start, atol=1e-10)


def test_samples_are_the_exact_solution_at_equal_times():
    """sample() returns the start, the end and what lies between at equal times."""
    flow, start = build_flow(oscillator()), np.array([0.4, -1.1])
    states = sample(flow, start, 2.0, 9)
    wanted = np.stack([exact_transition(t) @ start for t in np.linspace(0, 2, 9)])
    np.testing.assert_allclose(states, wanted, atol=1e-10)


def test_the_state_transition_matrix_agrees_with_finite_differences_of_another_integrator():
    """dx(1.5 s)/dx(0) of an unequal triple pendulum agrees with differences of DOP853 to 1e-8."""
    model = chain(3, [1.0, 0.7, 1.2], [1.0, 2.0, 0.5])
    flow, start = build_flow(model), np.array([0.5, -0.3, 0.8, 0.2, 1.0, -0.7])
    end, matrix = transition(flow, start, 1.5)
    times = np.array([0.0, 1.5])
    np.testing.assert_allclose(end, dop853(flow, start, times)[-1], atol=1e-10)
    found = differences(lambda x: dop853(flow, x, times)[-1], start, 1e-3)
    np.testing.assert_allclose(matrix, found, atol=1e-8 * np.abs(matrix).max())


def test_the_state_transition_matrix_agrees_with_dop853_on_the_variational_equations():
    """CVODES and DOP853 on x' = f, Phi' = f_x Phi agree to 1e-9 of the largest entry."""
    model = chain(3)
    field = vector_field(model, (), ())
    t, z = ca.MX.sym("t"), ca.MX.sym("z", 6 + 36)
    x = ca.MX.sym("x", 6)
    rate = ca.Function("rate", [t, x], [(f := field(t, x, ca.DM(0, 1), ca.DM(0, 1))), ca.jacobian(f, x)])
    slope, matrix = rate(t, z[:6])
    whole = ca.Function("whole", [t, z], [ca.vertcat(slope, ca.vec(matrix @ ca.reshape(z[6:], 6, 6)))])
    start = np.array([0.2, 0.23, -1.45, -0.32, 0.15, 1.66])
    extended = np.concatenate([start, np.eye(6).ravel()])
    reached = integrate(numeric_field(whole), extended, np.array([0.0, 1.655]))[-1]
    wanted = reached[6:].reshape(6, 6, order="F")
    _, found = transition(build_flow(model), start, 1.655)
    np.testing.assert_allclose(found, wanted, atol=1e-9 * np.abs(wanted).max())


@pytest.mark.parametrize("gravity", [9.8, 0.0])
def test_columns_of_unfolding_and_freed_parameters_agree_with_finite_differences(gravity):
    """dx(end)/ds and dx(end)/dp are the differences of the perturbed flow, for every invariant."""
    model = chain(2, [1.0, 0.8], gravity=gravity)
    free = ("length2", "mass1", "gravity")
    flow = build_flow(model, free, model.invariants)
    start, duration, count = np.array([0.9, -0.4, 0.3, 1.2]), 1.1, len(model.invariants)
    values = np.array([0.8, 1.0, gravity])
    _, sensitivity = flow.derivatives(0.0, start, duration, np.zeros(count), values)

    def end(tail):
        return dop853(flow, start, [0.0, duration], tail[:count], tail[count:])[-1]

    found = differences(end, np.concatenate([np.zeros(count), values]), 1e-3)
    assert np.abs(found).max(axis=0).min() > 1e-3  # no column is zero by accident
    np.testing.assert_allclose(sensitivity.full()[:, 4:], found, atol=1e-8)


def test_the_custom_jacobian_of_the_end_state_is_right_in_every_argument():
    """CasADi's Jacobian of flow.end in state, duration, s and freed parameter equals differences."""
    model = chain(2)
    flow = build_flow(model, ("length2",), model.invariants)
    x = ca.MX.sym("x", 7)
    end = flow.end(0.0, x[:4], x[4], x[5], x[6])
    jacobian = ca.Function("jacobian", [x], [ca.jacobian(end, x)])
    point = np.array([0.9, -0.4, 0.3, 1.2, 1.3, 0.05, 1.0])

    def reached(y):
        return dop853(flow, y[:4], [0.0, y[4]], y[5:6], y[6:])[-1]

    np.testing.assert_allclose(jacobian(point).full(), differences(reached, point, 1e-3), atol=1e-8)


def test_the_start_time_of_a_driven_system_has_its_column():
    """d end / d t0 of a driven pendulum, zero for an autonomous one, equals differences of DOP853."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    symbols = Symbols(q, v, time=t, forcing_period=np.pi)
    driven = lagrange(0.5 * v**2, -ca.cos(q), symbols, forces=3 * ca.cos(2 * t) - 0.1 * v)
    start, t0, moment = np.array([0.3, 0.2]), 0.6, ca.MX.sym("t0")
    for model, free_of_time in ((driven, False), (chain(1), True)):
        flow = build_flow(model)
        end = flow.end(moment, start, 1.4, ca.DM(0, 1), ca.DM(0, 1))
        found = ca.Function("column", [moment], [ca.jacobian(end, moment)])(t0).full()
        wanted = differences(lambda x, flow=flow: dop853(flow, start, [x[0], x[0] + 1.4])[-1], np.array([t0]), 1e-3)
        np.testing.assert_allclose(found, wanted, atol=1e-8)
        assert (np.abs(wanted).max() < 1e-9) == free_of_time


def test_the_start_time_matters_to_a_driven_system():
    """x'' = cos(2 t) integrated from t0 gives the closed-form solution from t0."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    model = lagrange(0.5 * v**2, ca.SX(0), Symbols(q, v, time=t), forces=ca.cos(2 * t))
    flow, t0, t1 = build_flow(model), 0.6, 2.1
    speed = (np.sin(2 * t1) - np.sin(2 * t0)) / 2
    place = -(np.cos(2 * t1) - np.cos(2 * t0)) / 4 - np.sin(2 * t0) / 2 * (t1 - t0)
    np.testing.assert_allclose(end_state(flow, np.zeros(2), t1 - t0, t0), [place, speed], atol=1e-11)
    np.testing.assert_allclose(sample(flow, np.zeros(2), t1 - t0, 3, t0)[-1], [place, speed], atol=1e-11)


def test_the_error_follows_the_tolerance():
    """log error against log tolerance has a slope near 1, from 1e-4 to 1e-11."""
    start, duration = np.array([0.4, -1.1]), 10.0
    tolerances = 10.0 ** -np.arange(4, 12)
    wanted = exact_transition(duration) @ start
    errors = []
    for tolerance in tolerances:
        flow = build_flow(oscillator(), settings=IntegratorSettings(tolerance, tolerance))
        errors.append(np.abs(end_state(flow, start, duration) - wanted).max())
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.7 <= slope <= 1.3


def test_a_numerically_factorised_mass_matrix_differentiates_too():
    """With M factorised at run time, as for long chains, the state-transition matrix is the recursion's."""
    fast = chain(3)
    q, v, p = ca.SX.sym("q", 3), ca.SX.sym("v", 3), ca.SX.sym("p", fast.parameter_values.size)
    parts = mass_matrix_and_bias(fast.kinetic(q, v, p), fast.potential(q, p), q, v)
    dense = altered(fast, acceleration=acceleration_function(*parts, [ca.SX.sym("t"), q, v, p], limit=0))
    assert dense.acceleration.is_a("MXFunction")
    start = np.array([0.5, -0.3, 0.8, 0.2, 1.0, -0.7])
    (end, matrix), (wanted, wanted_matrix) = (transition(build_flow(model), start, 0.3) for model in (dense, fast))
    np.testing.assert_allclose(end, wanted, atol=1e-11)
    np.testing.assert_allclose(matrix, wanted_matrix, atol=1e-10)


def test_one_freed_parameter_of_a_model_with_one_parameter():
    """Flow, derivatives and samples work when the only physical parameter of a model is freed, or is not."""
    start = np.array([0.4, -1.1])
    wanted = exact_transition(2.0) @ start
    for free in ((), ("stiffness",)):
        flow = build_flow(oscillator(), free)
        np.testing.assert_allclose(end_state(flow, start, 2.0), wanted, atol=1e-10)
        np.testing.assert_allclose(transition(flow, start, 2.0)[0], wanted, atol=1e-10)
        np.testing.assert_allclose(sample(flow, start, 2.0, 3)[-1], wanted, atol=1e-10)


@pytest.mark.parametrize("ask", [end_state, transition, lambda flow, x, T: sample(flow, x, T, 20)])
def test_a_blow_up_is_one_typed_error_and_nothing_reaches_the_terminal(ask, capfd):
    """A motion that reaches infinity raises IntegrationError with time, state and reason, silently."""
    start = np.array([1.0, 0.0])
    with pytest.raises(IntegrationError) as caught:
        ask(build_flow(exploding(), settings=IntegratorSettings(max_steps=5000)), start, 5.0)
    assert capfd.readouterr() == ("", "")
    error = caught.value
    np.testing.assert_array_equal(error.state, start)
    assert error.segment is None and error.reason in str(error)
    assert len(str(error).splitlines()) == 1
    assert 0.8 < error.time < 1.0  # the exact instant is the integral of dq / sqrt(2 q^4 - 2), 0.927 s


def test_a_blow_up_in_a_search_names_its_segment(capfd):
    """find_orbit reports the shooting segment in which the guess cannot be integrated."""
    problem = Problem(exploding(), Guess([1.0, 0.0], 5.0), segments=4)
    with pytest.raises(IntegrationError, match="segment 0") as caught:
        find_orbit(problem)
    assert caught.value.segment == 0
    assert 0.8 < caught.value.time < 1.0
    assert capfd.readouterr() == ("", "")


def test_a_blow_up_in_a_later_segment_names_that_one():
    """With segments of 0.4 s the third one is where V = -q^4 explodes."""
    problem = Problem(exploding(), Guess([1.0, 0.0], 4.0), segments=10)
    with pytest.raises(IntegrationError) as caught:
        initial_nodes(problem, build_flow(problem.model), SolveSettings())
    assert caught.value.segment == 2
    assert 0.8 < caught.value.time < 1.0


def test_too_few_steps_are_reported_as_such():
    """max_steps turns a hopeless integration into an error that says so."""
    flow = build_flow(oscillator(), settings=IntegratorSettings(max_steps=10))
    with pytest.raises(IntegrationError, match="too many internal steps"):
        end_state(flow, np.array([1.0, 0.0]), 100.0)


def test_a_state_that_is_not_a_number_is_reported():
    """NaN in the state raises IntegrationError, not a CasADi error."""
    with pytest.raises(IntegrationError, match="not finite"):
        end_state(build_flow(oscillator()), np.array([np.nan, 0.0]), 1.0)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("At t = 0.25, mxstep steps taken before reaching tout", "too many internal steps"),
        ("At t = 0.25, mxstep steps taken before reaching tout", "in 2 s; that is too long for one segment"),
        ("NaN detected for output ode\nAt t = 0.25, mxstep steps taken", "not finite there (0 / 0"),
        ("CV_ERR_FAILURE", "singular"),
        ("CV_CONV_FAILURE", "corrector"),
        ("CV_TOO_MUCH_ACC", "round-off"),
        ("CV_TOO_CLOSE", "too short"),
        ('x.cpp:403: CVode returned "CV_FIRST_RHSFUNC_ERR". Consult', "not finite there (0 / 0"),
        ('x.cpp:403: CVode returned "CV_ILL_INPUT". Consult', "2 s cannot be told in steps"),
        ('x.cpp:403: CVode returned "CV_MEM_FAIL". Consult', "SUNDIALS gives up (CV_MEM_FAIL); start elsewhere"),
        ("something else\nunheard of", "unheard of"),
        ("", "no message"),
    ],
)
def test_every_cause_has_its_sentence(text, reason):
    """What SUNDIALS prints becomes a sentence; an unknown text is quoted by its last line."""
    error = integration_error(text, np.zeros(2), 1.0, 2.0, segment=3)
    assert reason in error.reason and "segment 3" in str(error)
    assert error.time == (1.5 if "0.25" in text else 1.0)


def test_the_second_integrator_reports_a_blow_up_too():
    """DOP853 raises the same typed error with the time it reached."""
    field = vector_field(exploding(), (), ())
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2)
    function = ca.Function("field", [t, x], [field(t, x, ca.DM(0, 1), ca.DM(0, 1))])
    with pytest.raises(IntegrationError) as caught:
        integrate(numeric_field(function), np.array([1.0, 0.0]), np.array([0.0, 5.0]))
    assert 0.8 < caught.value.time < 1.0


def test_the_second_integrator_is_exact_at_every_wanted_time():
    """DOP853 returns the oscillator at all asked times, the end without interpolation error."""
    times, start = np.linspace(0, 6, 25), np.array([0.4, -1.1])
    flow = build_flow(oscillator())
    states = dop853(flow, start, times)
    wanted = np.stack([exact_transition(t) @ start for t in times])
    np.testing.assert_allclose(states, wanted, atol=1e-12)
    np.testing.assert_allclose(states[-1], wanted[-1], atol=3e-14)
    np.testing.assert_array_equal(dop853(flow, start, np.zeros(2)), [start, start])
