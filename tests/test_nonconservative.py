"""Systems that conserve nothing, or less than one thinks: counts, periods, multipliers and refusals."""

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from orbitfinder.errors import CountError, InputError
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.canonical import canonical
from orbitfinder.mechanics.lagrange import Symbols, energy_invariant, lagrange
from orbitfinder.mechanics.model import energy
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.find import find_orbit
from orbitfinder.systems import FUNCTIONS

VAN_DER_POL = 6.6632868593231301896996820305
"""Period at mu = 1, and amplitude: Hairer and Wanner, Solving Ordinary Differential Equations II, the
stationary test problem (as quoted in the source of the russell library)."""
AMPLITUDE = 2.00861986087484313650940188


def names(orbit):
    return {check.name for check in orbit.certificate.checks}


@pytest.fixture(scope="module")
def cycle():
    return find_orbit(Problem(FUNCTIONS["van_der_pol"](), Guess([2.0, 0.0], 6.5)))


def test_van_der_pol_has_its_published_period_and_amplitude(cycle):
    """T to 1e-11 relative and the largest x to the digits of the samples."""
    assert cycle.certificate.passed
    assert cycle.period == pytest.approx(VAN_DER_POL, rel=1e-11)
    assert np.abs(cycle.samples[:, 0]).max() == pytest.approx(AMPLITUDE, rel=1e-4)
    field = solve_ivp(lambda t, x: [x[1], (1 - x[0] ** 2) * x[1] - x[0]], (0, VAN_DER_POL), [AMPLITUDE, 0.0],
                      method="DOP853", rtol=2.3e-14, atol=1e-15)  # fmt: skip
    assert np.abs(field.y[:, -1] - [AMPLITUDE, 0.0]).max() <= 1e-12


def test_van_der_pol_multiplier_is_the_exponential_of_the_divergence(cycle):
    """mu = exp(integral of 1 - x^2 over the cycle) (Liouville), integrated as a third equation: 1e-8 relative."""

    def field(t, x):
        return [x[1], (1 - x[0] ** 2) * x[1] - x[0], 1 - x[0] ** 2]

    end = solve_ivp(field, (0, VAN_DER_POL), [AMPLITUDE, 0.0, 0.0], method="DOP853", rtol=2.3e-14, atol=1e-15)
    assert cycle.floquet_multipliers.size == 1
    assert cycle.floquet_multipliers[0].real == pytest.approx(np.exp(end.y[2, -1]), rel=1e-8)
    assert cycle.stability == "asymptotically stable" and cycle.symmetry == "reflection"


def test_a_limit_cycle_needs_no_pin_and_takes_none():
    """Closure and phase in {nodes, T} are square without a pin; a pin is refused with the reason."""
    model, guess = FUNCTIONS["van_der_pol"](), Guess([2.0, 0.0], 6.5)
    count = Problem(model, guess).count(4)
    assert count.freedom == 0 and count.unknowns["unfolding"] == 0 and count.equations["phase conditions"] == 1
    with pytest.raises(CountError, match=r"over-determined.*room for 0 \(nothing is conserved"):
        find_orbit(Problem(model, guess, pin=pin(period=6.6)))


def test_a_freed_parameter_gives_the_cycle_a_prescribed_period():
    """With the damping free, the cycle of period 7 s is found, and its damping written into the system."""
    model = FUNCTIONS["van_der_pol"]()
    orbit = find_orbit(Problem(model, Guess([2.0, 0.0], 6.7), pin=pin(period=7.0), free=("damping",)))
    assert orbit.certificate.passed and orbit.period == pytest.approx(7.0, rel=1e-12)
    assert 1.0 < orbit.system["arguments"]["damping"] < 1.5
    assert certify(orbit).passed  # rebuilt from the description alone


def test_half_a_period_finds_the_same_cycle(cycle):
    """x(T/2) = -x(0) holds for the van der Pol cycle and may be imposed; brake may not."""
    model = FUNCTIONS["van_der_pol"]()
    orbit = find_orbit(Problem(model, Guess([2.0, 0.0], 6.5), symmetry="reflection"))
    assert orbit.period == pytest.approx(cycle.period, rel=1e-13)
    with pytest.raises(InputError, match="symmetry: .* change under running the film backwards"):
        Problem(model, Guess([2.0, 0.0], 6.5), symmetry="brake")


def test_a_forced_linear_oscillator_is_its_closed_form():
    """x'' + c x' + x = F cos(w t): amplitude F / sqrt((1 - w^2)^2 + c^2 w^2), multipliers of exp(A T)."""
    c, force, w = 0.1, 0.3, 1.2
    model = FUNCTIONS["forced_duffing"](1.0, 0.0, c, force, w)
    orbit = find_orbit(Problem(model, Guess([0.1, 0.0], 5.0)))
    gain = force / (1 - w**2 + 1j * c * w)
    np.testing.assert_allclose(orbit.state, [gain.real, -w * gain.imag], rtol=0, atol=1e-12)
    assert orbit.period == 2 * np.pi / w and orbit.certificate.passed
    exact = np.exp(np.roots([1, c, 1]) * orbit.period)
    np.testing.assert_allclose(np.sort_complex(orbit.floquet_multipliers), np.sort_complex(exact), atol=1e-10)


def test_a_forced_motion_has_no_phase_and_the_period_of_its_forcing():
    """No phase condition, one row for the period; the checks are the forced ones."""
    problem = Problem(FUNCTIONS["forced_duffing"](), Guess([0.9, 0.5], 5.0))
    count = problem.count(3)
    assert count.freedom == 0 and count.equations["phase conditions"] == 0 and count.equations["forcing period"] == 1
    orbit = find_orbit(problem)
    assert orbit.certificate.passed and orbit.floquet_multipliers.size == 2
    assert np.prod(orbit.floquet_multipliers).real == pytest.approx(np.exp(-0.1 * orbit.period), rel=1e-10)
    assert "forcing_period" in names(orbit)
    assert not {"symplectic", "pair_defect", "energy_drift", "unfolding", "trivial_multipliers"} & names(orbit)


def test_the_period_of_a_forced_motion_cannot_be_pinned():
    """The forcing prescribes it; the message says which multiple is meant."""
    with pytest.raises(InputError, match="the forcing prescribes the period, a multiple of 5.23598776 s"):
        Problem(FUNCTIONS["forced_duffing"](), Guess([0.9, 0.5], 10.0), pin=pin(period=10.0))


def test_one_excitation_three_responses():
    """Upper, lower and unstable middle branch of the same forced oscillator; the middle has one |mu| > 1."""
    model = FUNCTIONS["forced_duffing"](1.0, 0.05, 0.2, 2.5, 1.6)
    found = [find_orbit(Problem(model, Guess([x, 0.0], 3.93))) for x in (6.0, -5.5, -1.5)]
    assert [orbit.stability for orbit in found] == ["asymptotically stable", "unstable", "asymptotically stable"]
    assert all(orbit.certificate.passed for orbit in found)
    assert np.sum(np.abs(found[1].floquet_multipliers) > 1) == 1


def test_a_subharmonic_guess_comes_back_with_the_minimal_period():
    """Guessed over three periods of the forcing, the motion is recorded over one."""
    orbit = find_orbit(Problem(FUNCTIONS["forced_duffing"](), Guess([0.9, 0.5], 15.7)))
    assert orbit.period == pytest.approx(2 * np.pi / 1.2, rel=1e-14) and orbit.certificate.passed


def test_the_shaken_pendulum_swings_at_half_the_shaking_frequency():
    """Parametric resonance: the orbit takes two periods of the forcing and no fewer."""
    model = FUNCTIONS["vibrated_pendulum"](amplitude=0.1, frequency=5.9057, damping=0.1)
    orbit = find_orbit(Problem(model, Guess([1.0, 0.0], 2.1279)))
    assert orbit.certificate.passed and orbit.period == pytest.approx(4 * np.pi / 5.9057, rel=1e-14)
    minimal = next(check for check in orbit.certificate.checks if check.name == "minimal_period")
    assert minimal.passed and minimal.value > 0.1


def test_a_freed_forcing_frequency_moves_the_period_with_it():
    """With the frequency free and the start pinned, period x frequency stays 2 pi."""
    model = FUNCTIONS["forced_duffing"]()
    start = find_orbit(Problem(model, Guess([0.9, 0.5], 5.2)))
    orbit = find_orbit(Problem(model, Guess(start.state, 5.236), pin=pin(x=0.95), free=("frequency",)))
    assert orbit.certificate.passed and orbit.state[0] == pytest.approx(0.95, abs=1e-10)
    assert orbit.period * orbit.system["arguments"]["frequency"] == pytest.approx(2 * np.pi, rel=1e-13)


def test_time_without_a_declared_period_is_refused():
    """Equations that depend on time must say with which period."""
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    model = lagrange(v**2 / 2, q**2 / 2, Symbols(q, v, time=t), forces=ca.cos(2 * t) - v)
    with pytest.raises(InputError, match="equations depend on time; declare the period"):
        Problem(model, Guess([0.1, 0.0], 3.0))


def test_a_wrongly_declared_invariant_is_named_with_its_drift():
    """A damped oscillator whose energy is declared conserved is refused before anything is solved."""
    q, v, p = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX(0, 1)
    wrong = [energy_invariant(v**2 / 2, q**2 / 2, q, v, p)]
    model = lagrange(v**2 / 2, q**2 / 2, Symbols(q, v), forces=-0.01 * v, invariants=wrong)
    with pytest.raises(InputError, match=r"invariants: 'energy' is not conserved, it drifts by \d"):
        find_orbit(Problem(model, Guess([1.0, 0.0], 6.3), pin=pin(energy=0.5)))


def test_momenta_of_absent_coordinates_are_detected():
    """A free cart conserves its horizontal momentum; a tied one, or a pushed one, does not."""
    made = FUNCTIONS["pendulum_on_cart"]
    assert [one.name for one in made().invariants] == ["energy", "momentum_y"]
    assert [one.name for one in made(stiffness=2.0).invariants] == ["energy"]
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)
    dragged = lagrange(ca.sumsqr(v) / 2, q[1] ** 2 / 2, Symbols(q, v), forces=ca.vertcat(0, -v[1]))
    assert [one.name for one in dragged.invariants] == ["momentum_q1"] and not dragged.conservative


def test_the_jacobi_integral_is_conserved_where_the_kinetic_energy_has_linear_terms():
    """Restricted three bodies: 'energy' is v.dL/dv - L, does not drift, and Hamilton's equations agree."""
    model = FUNCTIONS["restricted_three_body"](0.1)
    state = np.array([0.4, 0.2, 0.3, -0.5])
    x, y, u, w = state
    r1, r2 = np.hypot(x + 0.1, y), np.hypot(x - 0.9, y)
    assert energy(model, state) == pytest.approx((u * u + w * w - x * x - y * y) / 2 - 0.9 / r1 - 0.1 / r2, rel=1e-14)
    equations = canonical(model)
    momenta = equations.momentum([x, y], [u, w]).full().ravel()
    np.testing.assert_allclose(momenta, [u - y, w + x], rtol=1e-14)
    rate = equations.field(0, [x, y, *momenta]).full().ravel()
    accelerated = model.acceleration(0, [x, y], [u, w], model.parameter_values).full().ravel()
    np.testing.assert_allclose(rate[2:], accelerated + np.array([-w, u]), rtol=1e-12)


def test_the_arenstorf_orbit_closes_in_the_rotating_frame():
    """E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, section II.0: it returns."""
    from orbitfinder.integrate.dop853 import integrate
    from orbitfinder.integrate.field import vector_field

    flow = build_flow(FUNCTIONS["restricted_three_body"](0.012277471))
    t, x = ca.MX.sym("t"), ca.MX.sym("x", 4)
    field = vector_field(ca.Function("f", [t, x], [flow.field(t, x, [], [])]))
    start = np.array([0.994, 0.0, 0.0, -2.00158510637908252240537862224])
    end = integrate(field, start, np.array([0.0, 17.0652165601579625588917206249]))[-1]
    assert np.abs(end - start).max() <= 1e-6


def test_a_pivot_that_moves_as_told_is_the_same_as_changing_gravity():
    """Shaking the pivot by A cos(w t) is gravity g - A w^2 cos(w t) downwards (x down): same accelerations."""
    model = FUNCTIONS["vibrated_pendulum"](1.0, 9.8, 0.0, 0.2, 7.0)
    for t, theta, rate in ((0.0, 0.3, 0.1), (0.4, -1.2, 2.0), (1.7, 2.5, -3.0)):
        found = float(model.acceleration(t, theta, rate, model.parameter_values))
        assert found == pytest.approx(-(9.8 + 0.2 * 49.0 * np.cos(7.0 * t)) * np.sin(theta), rel=1e-12)


def test_a_start_time_matters_to_the_derivative_of_a_forced_segment():
    """d end / d t0 of the flow agrees with central differences."""
    flow = build_flow(FUNCTIONS["forced_duffing"]())
    t0 = ca.MX.sym("t0")
    end = flow.end(t0, [0.4, -0.3], 1.3, [], [])
    slope = ca.Function("slope", [t0], [ca.jacobian(end, t0)])(0.7).full().ravel()
    ends = [flow.end(0.7 + h, [0.4, -0.3], 1.3, [], []).full().ravel() for h in (1e-3, -1e-3)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-3, atol=1e-7)
