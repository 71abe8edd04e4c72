"""What the certificates of 0.2.0 passed, or refused, wrongly: each by the shortest system that shows it."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import ellipkm1
from test_false_orbits import forced, record, times_round

import orbitfinder as of
from orbitfinder.loops.symmetry import symplectic
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.orbits.between import primes
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.evidence import gather

ROOT = Path(__file__).parents[1]
Q, V = ca.SX.sym("q"), ca.SX.sym("v")
STEADY = 1 / (1 + 0.2j)
"""x'' + 0.2 x' + 2 x = cos t is solved by Re(STEADY exp(i t))"""


def flat(model, state, period, **changes):
    """A record of a first-order system."""
    return record(model, state, period, samples=np.zeros((0, len(state))), **changes)


def check(certificate, name):
    return next(one for one in certificate.checks if one.name == name)


@pytest.mark.parametrize("k", [1, 2, 3, 7, 103])
def test_a_forcing_declared_as_many_of_its_periods_is_no_period(k):
    model = forced(ca.cos, 2 * np.pi * k)
    certificate = certify(record(model, [STEADY.real, -STEADY.imag], 2 * np.pi * k), model)
    assert certificate.failures == (() if k == 1 else ("minimal_period",))
    assert k == 1 or f"of motion and forcing after T/{k}" in check(certificate, "minimal_period").note


@pytest.mark.parametrize("name", ["duffing", "van-der-pol", "double-pendulum-running"])
@pytest.mark.parametrize("k", [103, pytest.param(109, marks=pytest.mark.slow)])
def test_multiples_beyond_a_hundred_are_rejected_by_name(name, k):
    orbit = of.load_orbit(ROOT / "results" / "gallery" / name / "orbit.json")
    certificate = certify(times_round(orbit, k))
    assert "minimal_period" in certificate.failures
    assert f"T/{k}" in check(certificate, "minimal_period").note


@pytest.mark.parametrize("name", ["double-pendulum-fast-mode", "figure-eight-reduced", "duffing"])
@pytest.mark.parametrize("k", [2, 3, 13])
def test_a_return_is_seen_before_and_after_where_the_motion_is_fastest(name, k):
    orbit = of.load_orbit(ROOT / "results" / "gallery" / name / "orbit.json")
    assert "minimal_period" in certify(times_round(orbit, k)).failures


def test_prime_factors():
    assert [primes(n) for n in (1, 2, 12, 97 * 103, 2**10)] == [[], [2], [2, 3], [97, 103], [2]]


@pytest.mark.parametrize("period", [1, 2, 8, 20])
def test_a_pulse_in_a_later_period_of_the_forcing_is_seen(period):
    def pulsed(t):
        return ca.cos(t) + 0.5 * ca.exp(-(((t - 2.0 - 2 * np.pi * period) / 0.05) ** 2))

    model = forced(pulsed, 2 * np.pi)
    assert "time_dependence" in certify(record(model, [STEADY.real, -STEADY.imag], 2 * np.pi), model).failures


@pytest.mark.parametrize("place", [0.3, 0.77, -0.123456])
def test_a_force_far_narrower_than_a_step_is_found(place):
    """1e-5 of the motion wide, and what it does: 7e-3 of the motion."""
    wide = 2e-5
    kick = 6.8e-3 / (wide * np.sqrt(np.pi)) * ca.exp(-(((Q - place) / wide) ** 2)) * V
    model = lagrange(V**2 / 2, Q**2 / 2, Symbols(Q, V), forces=kick)
    certificate = certify(record(model, [1.0, 0.0], 2 * np.pi), model)
    assert certificate.failures == ("resolution",)
    assert check(certificate, "resolution").value > 1e-3
    assert "looks, each 1" in check(certificate, "resolution").note


@pytest.mark.parametrize("place", [0.3, -0.7123])
def test_a_rectangular_force_of_a_ten_thousandth_is_found(place):
    model = of.ode(lambda t, x, p: [x.v, -x.x + ca.if_else(ca.fabs(x.x - place) < 1e-4, 20.0 * x.v, 0)], ("x", "v"))
    assert certify(flat(model, [1.0, 0.0], 2 * np.pi), model).failures == ("resolution",)


def test_a_pulse_of_the_forcing_far_narrower_than_a_step_is_found():
    def pulsed(t):
        phase = t - 2 * np.pi * ca.floor(t / (2 * np.pi))
        return ca.cos(t) + 200.0 * ca.exp(-(((phase - 2.0) / 3e-4) ** 2))

    model = forced(pulsed, 2 * np.pi)
    found = certify(record(model, [STEADY.real, -STEADY.imag], 2 * np.pi), model).failures
    assert set(found) & {"resolution", "closure"}


@pytest.mark.parametrize("place", [0.21, -0.31])
def test_a_guard_crossed_and_recrossed_between_two_looks_is_found(place):
    """An oscillator against a wall at 0.5, with a needle of 1e-4 standing out of the wall where it flies."""
    bob = lagrange(V**2 / 2, Q**2 / 2, Symbols(Q, V))

    def against(needle):
        wall = of.impact(bob, lambda x, p: 0.5 - x.q1 - needle * ca.exp(-(((x.q1 - place) / 1e-4) ** 2)), 1.0)
        hit = of.Transition("hit", "fly", "fly", wall.gap, wall.after, impulse=wall.impulse)
        return of.hybrid({"fly": bob}, [hit], ["hit"], conserved=["energy"])

    orbit = of.find_orbit(of.Problem(against(0.0), guess=of.Guess([0.5, -1.0], 4.2), pin=of.pin(energy=0.625)))
    assert orbit.certificate.passed
    certificate = certify(orbit, against(2.0))
    assert "resolution" in certificate.failures
    assert "guard of hit is crossed" in check(certificate, "resolution").note


@pytest.mark.parametrize("turn", [0, 1, 2, 5])
def test_a_potential_that_differs_in_a_later_turn_is_seen(turn):
    bump = 0.3 * ca.exp(-(((Q - 2.0 - 2 * np.pi * turn) / 0.1) ** 2)) if turn else 0.0
    model = lagrange(V**2 / 2, -ca.cos(Q) + bump, Symbols(Q, V), angles=[True])
    period = 2 * quad(lambda angle: 1 / np.sqrt(2 * (1.5 + np.cos(angle))), 0, np.pi)[0]
    certificate = certify(record(model, [0.0, np.sqrt(5.0)], period, [1]), model)
    assert certificate.failures == (("winding",) if turn else ())


def test_angles_that_turn_together_are_asked_together():
    """Two pendula joined by gamma (b - a), both driven round: each turned alone would feel the other's pull."""

    def rates(t, x, p):
        pull = 0.2 * (x.b - x.a)
        return [x.p, x.q, 1.5 - 0.1 * x.p - ca.sin(x.a) + pull, 1.5 - 0.1 * x.q - ca.sin(x.b) - pull]

    model = of.ode(rates, ("a", "b", "p", "q"), angles=("a", "b"))
    guess = of.Guess([0.0, 0.0, 15.0, 15.0], 2 * np.pi / 15)
    orbit = of.find_orbit(of.Problem(model, guess=guess, winding=(1, 1, 0, 0)))
    assert orbit.certificate.passed
    assert "a, b" in check(orbit.certificate, "winding").note


@pytest.mark.parametrize("driven", [False, True])
def test_a_part_closes_to_what_grows_in_it(driven):
    """A free oscillator that loses 4e-8 in a period, beside and driving what errors grow 9e5 times in."""
    steep = np.log(9e5) / (2 * np.pi)

    def make(damping):
        return of.ode(
            lambda t, x, p: [x.v, -x.x - 2 * damping * x.v, x.d, steep**2 * x.c + driven * x.x], ("x", "v", "c", "d")
        )

    state = [1.0, 0.0, -driven / (1 + steep**2), 0.0]
    assert certify(flat(make(0.0), state, 2 * np.pi), make(0.0)).passed
    certificate = certify(flat(make(6e-9), state, 2 * np.pi), make(6e-9))
    assert {"closure", "distance"} <= set(certificate.failures)
    assert check(certificate, "closure").tolerance < 1e-10 and certificate.scale > 1e5


def test_multipliers_are_recorded_where_they_are_better_known():
    """Sharp's orbit 5 of the restricted problem: CVODES' multiplier is off by 7e-7."""
    model = of.systems.restricted_three_body(0.012277471)
    guess = of.Guess([0.879962, 0.0, 0.0, -0.66647], 6.3)
    orbit = of.find_orbit(of.Problem(model, guess=guess, pin=of.pin(x=0.879962), symmetry="mirror"))
    assert orbit.certificate.passed and orbit.pair_defect < 1e-8
    assert orbit.floquet_multipliers[0].real == pytest.approx(14.557497482, abs=2e-8)


@pytest.mark.parametrize("size", [1.0, 1e-6, 1e-12])
def test_a_damped_oscillator_is_damped_in_any_unit(size):
    t = ca.SX.sym("t")
    model = lagrange(
        V**2 / 2, Q**2 / 2 + Q**4 / 4 / size**2, Symbols(Q, V, time=t, forcing_period=2 * np.pi),
        forces=0.3 * size * ca.cos(t) - 0.083 * V,
    )  # fmt: skip
    assert not symplectic(model)
    orbit = of.find_orbit(of.Problem(model, guess=of.Guess([0.5 * size, 0.3 * size], 2 * np.pi)))
    assert orbit.certificate.passed and orbit.stability == "asymptotically stable"


@pytest.mark.parametrize("name", ["cart-pole-cycle", "compass-level", "parametric-swing", "pick-and-place"])
def test_shipped_controls_pass_their_own_certificate(name):
    """Their samples are thinned, the last one with them."""
    orbit = of.load_orbit(ROOT / "docs" / "gallery" / "orbits" / f"control-{name}.json")
    assert orbit.samples.size and certify(orbit).passed
    moved = orbit.samples.copy()
    moved[len(moved) // 2] += 1e-3
    object.__setattr__(orbit, "samples", moved)
    assert "samples" in certify(orbit).failures


@pytest.mark.slow
def test_points_of_a_family_have_the_action_of_their_own_place():
    """Newton's last step changes the energy by dE, and the action by T dE: it was left out, 1.6e-10 here."""
    orbit = of.load_orbit(ROOT / "results" / "gallery" / "henon-heiles-straight" / "orbit.json")
    bare = of.FamilySettings(events=False, certify=False)
    family = of.follow_family(orbit, parameter="energy", points=24, settings=bare)
    assert len(family.points) > 10
    assert not [k for k, point in enumerate(family.points) if "action" in certify(point).failures]


def test_a_swing_nearly_to_the_top_keeps_its_energy_as_well_as_it_closes():
    """From the bottom, 1e-3 rad below upright: a gap of 2e-9, left by growing errors, turns the energy's slope, and
    the one where the motion ends is compared."""
    below, squared = 1e-3, 1.5 * 9.8
    period = 4 * float(ellipkm1(np.sin(below / 2) ** 2)) / np.sqrt(squared)
    state = np.array([0.0, 2 * np.sqrt(squared) * np.cos(below / 2)])
    certificate = certify(record(of.chain(1), state, period), of.chain(1))
    kept = check(certificate, "trivial_multipliers")
    assert kept.value < 1e-12 and certificate.passed


@pytest.mark.parametrize("off", [1e-8, -1e-8])
def test_beside_a_saddle_another_period_is_another_orbits(off):
    """A state 1e-14 away has the period that is 1e-8 off; the one at this energy has not."""
    for below in (1e-1, 1e-2, 1e-3):
        squared = 1.5 * 9.8
        period = 4 * float(ellipkm1(np.sin(below / 2) ** 2)) / np.sqrt(squared)
        for state in ([0.0, 2 * np.sqrt(squared) * np.cos(below / 2)], [np.pi - below, 0.0]):
            true, wrong = (record(of.chain(1), np.array(state), period * factor) for factor in (1.0, 1 + off))
            kept = certify(true, of.chain(1))
            assert kept.passed and kept.period_error < 1e-8 * period, (below, kept.failures)
            assert "distance" in certify(wrong, of.chain(1)).failures


def test_past_a_primary_the_gradients_are_those_where_the_motion_ends():
    """A gap of 1e-8 in extents that grows 2e5 times: their difference from those at the start was 2.5e-8 of the map."""
    known = json.loads((ROOT / "tests" / "data" / "restricted_orbits.json").read_text())["orbits"]
    ratio, x0, speed, period = next(
        [float(one[key]) for key in ("ratio", "x0", "ydot0", "period")] for one in known if one["ydot0"][:6] == "-1.566"
    )
    model, state = of.systems.restricted_three_body(ratio), np.array([x0, 0.0, 0.0, speed + 1e-12])
    certificate = certify(record(model, state, period), model)
    assert check(certificate, "trivial_multipliers").value < 1e-9 and certificate.passed
    seen = gather(model, state, period, np.zeros(2, int))
    assert seen.tour.trivial < 1e-9 and replace(seen.tour, ended=None).trivial > 1e-8
