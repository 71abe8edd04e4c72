"""The last digits where equal steps cannot give them: motions with close approaches."""

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.cvodes import build_flow
from orbitfinder.integrate.dop853 import TIGHTEST, integrate
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.rk8 import MOST_DOUBLINGS, march, refined_march
from orbitfinder.loops import polish
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.polish import end_of, graded_end, segment, tail_of
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.measure import action, dense, loop_action
from orbitfinder.systems import FUNCTIONS

ARENSTORF = (("-2.00158510637908252240537862224", "17.0652165601579625588917206249"),
             ("-2.0317326295573368357302057924", "11.124340337266085134999734047"))  # fmt: skip
"""y'(0) and period; E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, section II.0"""


def moon():
    return FUNCTIONS["restricted_three_body"](0.012277471)


@pytest.mark.parametrize(("rate", "period"), ARENSTORF)
def test_an_orbit_past_the_moon_has_its_published_digits(rate, period):
    """With the segments chosen by default; equal steps gave the first period to 3e-11 only."""
    guess = Guess([0.994, 0.0, 0.0, float(rate)], float(period))
    orbit = find_orbit(Problem(moon(), guess, pin(x=0.994)))
    assert orbit.period == pytest.approx(float(period), abs=2e-13)
    assert orbit.state[3] == pytest.approx(float(rate), abs=1e-13)
    assert "action" not in orbit.certificate.failures


def test_graded_steps_follow_a_close_passage():
    """Four seconds from 0.006 beside the Moon: graded steps agree with DOP853 to 1e-9, 3200 equal ones do not."""
    flow = build_flow(moon())
    start, span = np.array([0.994, 0.0, 0.0, float(ARENSTORF[0][0])]), (0.0, 4.0)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", 4)
    field = vector_field(ca.Function("f", [t, x], [flow.field(t, x, [], [])]))
    wanted = integrate(field, start, np.array(span), TIGHTEST, 1e-3)[-1]
    equal = segment(flow, start, span, tail_of(flow), 25)
    assert len(equal) - 1 == 25 << MOST_DOUBLINGS and np.abs(equal[-1] - wanted).max() > 1e-8
    assert np.abs(graded_end(flow.field, start, span, tail_of(flow)) - wanted).max() < 1e-9
    np.testing.assert_array_equal(end_of(flow, start, span, tail_of(flow), 25),
                                  graded_end(flow.field, start, span, tail_of(flow)))  # fmt: skip


def test_a_tame_motion_keeps_its_equal_steps():
    """Where equal steps agree nothing else is tried, so results are what they were."""
    flow = build_flow(chain(2))
    start, span = np.array([0.3, -0.2, 0.1, 0.5]), (0.0, 1.0)
    found = end_of(flow, start, span, tail_of(flow), 25)
    np.testing.assert_array_equal(found, segment(flow, start, span, tail_of(flow), 25)[-1])


def test_equal_steps_stand_where_graded_ones_take_too_many(monkeypatch):
    """A march that needs more pieces than allowed is given up, and the end is that of equal steps."""
    monkeypatch.setattr(polish, "MOST_PIECES", 3)
    flow = build_flow(moon())
    start, span = np.array([0.994, 0.0, 0.0, float(ARENSTORF[0][0])]), (0.0, 4.0)
    assert graded_end(flow.field, start, span, tail_of(flow)) is None
    equal = segment(flow, start, span, tail_of(flow), 25)
    np.testing.assert_array_equal(end_of(flow, start, span, tail_of(flow), 25), equal[-1])


def test_graded_steps_that_leave_the_numbers_are_too_long():
    """y' = -50 y^3 from 10 explodes in steps of 1/8 s; graded ones end at 10 / sqrt(1 + 10^4 t)."""
    t, y, s, free = ca.SX.sym("t"), ca.SX.sym("y", 2), ca.SX.sym("s", 0), ca.SX.sym("free", 0)
    field = ca.Function("field", [t, y, s, free], [-50 * y**3])
    end = graded_end(field, np.array([10.0, 10.0]), (0.0, 1.0), np.zeros(0))
    np.testing.assert_allclose(end, 10 / np.sqrt(1 + 1e4), rtol=1e-12)


def test_the_action_is_taken_from_equal_times_where_they_tell_it(report_orbits):
    """The loop of triple 1: the trapezoidal sum itself; every fourth sample of it only would be integrated on."""
    orbit, model = report_orbits["triple-1"], chain(3)
    flow = build_flow(model)
    times, states = dense(flow, orbit.nodes, orbit.period)
    wanted = action(model, times, states)
    assert loop_action(model, flow, orbit.nodes, times, states) == wanted
    few = slice(None, None, (len(times) - 1) // 8)
    assert abs(action(model, times[few], states[few]) / wanted - 1) > 1e-6
    assert loop_action(model, flow, orbit.nodes, times[few], states[few]) == pytest.approx(wanted, rel=1e-13)


def test_equal_steps_that_leave_the_numbers_are_halved():
    """x' = -x^3 from 10: 8 steps a unit of time overflow, more do not; what is singular is still told."""
    x = ca.SX.sym("x")
    none = [ca.SX.sym(name, 0) for name in ("s", "free")]
    field = ca.Function("f", [t := ca.SX.sym("t"), x, *none], [-(x**3)])
    with pytest.raises(IntegrationError, match="not finite"):
        march(field, np.array([10.0]), 1.0, 8, np.zeros(0))
    assert refined_march(field, np.array([10.0]), 1.0, 8, np.zeros(0))[-1, 0] == pytest.approx(2.01**-0.5, rel=1e-12)
    with pytest.raises(IntegrationError, match="not finite"):
        refined_march(ca.Function("f", [t, x, *none], [x**3]), np.array([10.0]), 1.0, 8, np.zeros(0))
