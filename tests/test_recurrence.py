"""Guesses that people have: close returns of a motion, sums of normal modes, and both in a problem file."""

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.guesses.modes import normal_modes
from orbitfinder.orbits.guesses.returns import close_returns, normal_mode_sum, recurrences
from orbitfinder.systems import FUNCTIONS

CHAOTIC = [0.0, -0.15, 0.4728636, 0.0]
"""A chaotic start of the Henon-Heiles system at E = 1/8."""


def test_a_periodic_signal_returns_after_its_period():
    """cos t, sin 2 t: the best return is 2 pi, to the sampling interval, at a distance near zero."""
    times = np.linspace(0, 40, 2001)
    states = np.column_stack([np.cos(times), np.sin(2 * times)])
    best = close_returns(times, states, count=3)[0]
    assert best.period == pytest.approx(2 * np.pi, abs=0.03) and best.distance < 0.03
    assert best.guess.states.shape[0] == best.guess.times.size


def test_angles_return_modulo_whole_turns():
    """A steadily turning angle returns after one turn only where it is known to be an angle."""
    times = np.linspace(0, 10, 1001)
    states = np.column_stack([2 * np.pi * times, np.full_like(times, 2 * np.pi) + 1e-3 * np.sin(2 * np.pi * times)])
    assert close_returns(times, states, [True], count=1)[0].period == pytest.approx(1.0, abs=0.02)


def test_resting_does_not_count_as_returning():
    """A motion that creeps without going away has no return."""
    times = np.linspace(0, 1, 500)
    assert close_returns(times, np.column_stack([times, np.ones_like(times)])) == []


def test_close_returns_of_a_chaotic_motion_lead_to_distinct_orbits():
    """At least three certified orbits of different periods, one unstable, from one 300 s simulation."""
    model = FUNCTIONS["henon_heiles"]()
    periods = set()
    unstable = 0
    for one in recurrences(model, CHAOTIC, 300.0, 5, longest=60.0):
        orbit = find_orbit(Problem(model, one.guess, pin=pin(energy=0.125)))
        assert orbit.certificate.passed
        periods.add(round(orbit.period, 6))
        unstable += orbit.stability == "unstable"
    assert len(periods) >= 3 and unstable >= 1


def test_a_forced_motion_returns_on_the_beat():
    """Periods of returns of a forced motion are multiples of the forcing's and start at its phase 0."""
    model = FUNCTIONS["forced_duffing"]()
    clock = 2 * np.pi / 1.2
    for one in recurrences(model, [0.3, 0.0], 100.0, 3):
        assert one.period / clock == pytest.approx(round(one.period / clock), abs=1e-12)
        assert one.time / clock == pytest.approx(round(one.time / clock), abs=1e-12)


def test_a_sum_of_modes_starts_where_the_modes_add_up():
    """State = a1 u1 + a2 u2 at rest; the period is a multiple of the first mode's that suits the second."""
    model = chain(2)
    squared, shapes = normal_modes(model)
    guess = normal_mode_sum(model, [1, 2], [0.2, -0.1])
    units = [shape / shape[np.abs(shape).argmax()] for shape in shapes.T]
    np.testing.assert_allclose(guess.state, [*(0.2 * units[0] - 0.1 * units[1]), 0, 0], atol=1e-14)
    ratio = guess.period * np.sqrt(squared[0]) / (2 * np.pi)
    assert ratio == pytest.approx(round(ratio), abs=1e-12)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: normal_mode_sum(chain(2), [1, 2], [0.1]), "guess.amplitude: 1 number for 2 modes"),
        (lambda: recurrences(chain(1), [0.1, 0.0], -1.0), "guess.duration: must be positive"),
        (lambda: recurrences(chain(1), [0.1], 1.0), "guess.state: 1 number; give 2"),
        (lambda: close_returns(np.arange(3.0), np.zeros((3, 2))), "trajectory: 3 times"),
    ],
)
def test_unusable_input_is_refused(call, message):
    """Each is an InputError that says what to give."""
    with pytest.raises(InputError, match=message):
        call()


def test_problem_files_know_both_forms(tmp_path):
    """`duration` beside `state`, and lists for `mode` and `amplitude`."""
    from orbitfinder.problemfile.read import load_problem

    head = '[system]\nkind = "chain"\nlinks = 2\n[guess]\n'
    file = tmp_path / "problem.toml"
    file.write_text(head + "mode = [1, 2]\namplitude = [0.2, -0.1]\n")
    assert load_problem(file).guess.state[0] != 0
    file.write_text(head + "state = [1.0, 0.5, 0.0, 0.0]\nduration = 30.0\n")
    assert load_problem(file).guess.states is not None
    file.write_text(head + "state = [1.0, 0.5, 0.0, 0.0]\nduration = 30.0\nperiod = 2.0\n")
    with pytest.raises(InputError, match="duration goes with state and takes the place of period"):
        load_problem(file)
