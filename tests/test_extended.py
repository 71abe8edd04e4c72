"""Integration in long double: what it is right to, and what it shows of an orbit and of a false one."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate import extended as extended_module
from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.extended import ROUND_OFF, Extended, extended
from orbitfinder.integrate.field import vector_field
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.symmetry import NONE, SYMMETRIES
from orbitfinder.loops.wide import wide
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.orbits import evidence
from orbitfinder.orbits.between import _retaken, overlooked
from orbitfinder.orbits.evidence import Evidence, gather
from orbitfinder.systems import three_bodies

t, y, free = ca.SX.sym("t"), ca.SX.sym("y", 4), ca.SX.sym("free")
KEPLER = ca.Function("kepler", [t, y, free], [ca.vertcat(y[2:], -free * y[:2] / ca.norm_2(y[:2]) ** 3)])
FORCED = ca.Function("forced", [t, y], [ca.vertcat(y[1], -y[0], ca.cos(t), 1 / (y[3] + 2))])
BUTTERFLY = np.array(
    [
        1.999998859153095,
        1.991614059734009e-07,
        1.2185304020252418e-30,
        -4.82364361247927e-31,
        0.0,
        0.0,
        -1.178866788171155,
        -0.2927371061538406,
    ]
)
PERIOD = 7.003703608035741
"""Butterfly II of Suvakov and Dmitrasinovic, as found here from its printed digits"""


@pytest.fixture
def deep():
    if extended(vector_field(FORCED)) is None:
        pytest.skip("no compiler, or no wider long double")


@pytest.mark.usefixtures("deep")
@pytest.mark.parametrize("quadruple", [False, True])
def test_exact_solutions(quadruple):
    """An oscillator, a quadrature of the time and y' = 1 / (y + 2) over a span that does not begin at 0."""
    begin, end = np.longdouble(0.25), np.longdouble(3.0)
    start = np.array([np.cos(begin), -np.sin(begin), np.sin(begin), 0.0])
    found = extended(vector_field(FORCED), quadruple).end(np.array([1.0, 1.0, 1e-3, 10.0]), start, (0.25, 3.0), None)
    exact = [np.cos(end), -np.sin(end), np.sin(end), np.sqrt(4 + 2 * (end - begin)) - 2]
    assert found.dtype == np.longdouble
    assert np.abs(found - exact).max() < (4 if quadruple else 200) * ROUND_OFF  # those of long double are as rough


@pytest.mark.usefixtures("deep")
@pytest.mark.parametrize("quadruple", [False, True])
@pytest.mark.parametrize("eccentricity", [0.0, 0.5, 0.99])
def test_a_motion_comes_back(eccentricity, quadruple):
    """Round a Kepler ellipse (a = 1, attraction 2) and back, past a centre at 1 - e: errors grow by 1 / (1 - e)^2."""
    start = np.array([1 + eccentricity, 0.0, 0.0, np.sqrt(2 * (1 - eccentricity) / (1 + eccentricity))])
    wide, back = extended(vector_field(KEPLER, np.array([2.0])), quadruple), np.array([1, 1, -1, -1])
    there = wide.end(np.ones(4), start, (0.0, 4.0), np.array([2.0]))
    again = back * wide.end(np.ones(4), back * there, (0.0, 4.0), np.array([2.0]))
    assert np.abs(there - start).max() > 0.1
    assert np.abs(again - start).max() < 1e3 * ROUND_OFF / (1 - eccentricity) ** 2


@pytest.mark.usefixtures("deep")
def test_many_states_on_the_way_cost_no_digits():
    """Round-off of long double at each would grow: past a centre at 0.01."""
    start, free = np.array([1.99, 0.0, 0.0, np.sqrt(0.02 / 1.99)]), np.array([2.0])
    wide = extended(vector_field(KEPLER, free), True)
    path = wide.along(np.ones(4), start, np.linspace(0.0, 18.0, 500), free)[:, 0]
    assert np.abs(path[-1] - wide.end(np.ones(4), start, (0.0, 18.0), free)).max() < 20 * ROUND_OFF
    plain = extended(vector_field(KEPLER, free)).along(np.ones(4), start, np.linspace(0.0, 18.0, 500), free)[:, 0]
    assert np.abs(path[-1] - plain[-1]).max() > 1e5 * ROUND_OFF


@pytest.mark.usefixtures("deep")
@pytest.mark.parametrize("quadruple", [False, True])
def test_derivatives_are_those_of_the_march(quadruple):
    """By the state, the period, the unfolding and a freed parameter, and the action."""
    equations = Equations(three_bodies(), SYMMETRIES["brake"], ("mass1",))
    w = equations.unknowns(np.array([[2.0, 0, 0.3, 1.5, 0, 0, 0, 0]]), 2.0, np.linspace(0.0, 0.5, 401), np.array([1.1]))
    units = np.array([2.0, 1.0, 1.0, 2.0, 0.5, 0.5, 1.0, 1.0])
    sharp, path = wide(equations, units, quadruple).varied(w), equations.varied(w)
    for name in ("ends", "transitions", "columns"):
        exact = getattr(path, name)
        assert exact.shape == getattr(sharp, name).shape
        assert np.abs(exact - getattr(sharp, name)).max() < 1e-11 * np.abs(exact).max(), name
    whole = Equations(three_bodies(), NONE, ("mass1",), action=True)
    w = replace(w, unfolding=np.zeros(whole.march.unfolding))
    alone = replace(w, unfolding=np.zeros(0))
    integral = wide(whole, units, quadruple, 1.0).varied(alone).integral
    assert integral == pytest.approx(whole.varied(w).integral, rel=1e-11)


@pytest.mark.usefixtures("deep")
def test_a_collision_is_refused():
    """Steps into the centre become too short."""
    with pytest.raises(IntegrationError, match="too small in long double"):
        extended(vector_field(KEPLER)).end(np.ones(4), np.array([1.0, 0, 0, 0]), (0.0, 2.0), np.array([2.0]))


def butterfly(off: float = 0.0) -> Evidence:
    """What is seen of it, its start moved by so much of its extents across the flow."""
    return gather(three_bodies(), BUTTERFLY + off * np.eye(8)[6], PERIOD, np.zeros(4))


@pytest.mark.slow
@pytest.mark.usefixtures("deep")
def test_round_off_past_encounters_hides_nothing():
    """In double precision the butterfly is known to 3e-9 only, for 1e-9, and its flow is kept to 4e-8."""
    with compiling("off"):
        double = butterfly()
    assert double.closes.distance > 1e-9 and double.motion.missed is None
    known = butterfly()
    assert known.closes.distance < 3e-10 and known.motion.missed is not None
    assert known.tour.trivial < 1e-2 * double.tour.trivial
    assert known.closes.gap < double.closes.gap or known.closes.gap < 1e-13


@pytest.mark.slow
@pytest.mark.usefixtures("deep")
def test_a_start_beside_the_orbit_is_as_far_as_it_is():
    """Orbits beside it are nearer by the share of the step that leads along their family; nothing false passes."""
    near, far = butterfly(-1e-7).closes.distance, butterfly(1e-6).closes.distance
    assert 1e-9 < near < 1e-7 and far == pytest.approx(10 * near, rel=0.1)


@pytest.mark.slow
@pytest.mark.usefixtures("deep")
def test_what_long_double_cannot_integrate_is_judged_in_double(monkeypatch):
    """As it was before there was any, and not refused for it."""
    known = butterfly()

    def refuse(*_):
        raise IntegrationError("no", time=0.0, state=BUTTERFLY)

    monkeypatch.setattr(Extended, "_end", refuse)
    double = butterfly()
    assert double.motion.missed is None and known.motion.missed is not None
    assert double.closes.distance > 1e-9 > known.closes.distance


@pytest.mark.usefixtures("deep")
def test_without_a_compiler_of_cpp_the_numbers_are_the_compilers_own(monkeypatch):
    """`_Float128` where sums of two doubles cannot be compiled, to the same digits."""
    start, free, code = np.array([1.5, 0.0, 0.0, np.sqrt(2 / 3)]), np.array([2.0]), extended_module._code
    sums = extended(vector_field(KEPLER, free), True).end(np.ones(4), start, (0.0, 4.0), free)
    types = []

    def refused(function, real, parts):
        types.append(real)
        return "#error no" if real == "Twofold" else code(function, real, parts)

    monkeypatch.setattr(extended_module, "_code", refused)
    own = extended(vector_field(KEPLER, free), True).end(np.ones(4), start, (0.0, 4.0), free)
    assert types == ["Twofold", "_Float128"]
    assert np.abs(sums - own).max() <= 4 * ROUND_OFF


@pytest.mark.usefixtures("deep")
def test_functions_of_two_doubles():
    """Quadratures of what CasADi writes, beside long double's; divisions by 0 and roots of less are no numbers."""
    time, state = ca.SX.sym("t"), ca.SX.sym("y", 6)
    x = 0.3 + 0.1 * time
    rates = ca.vertcat(
        ca.sin(x) * ca.exp(x) / ca.cos(x), ca.atan2(x, 1 + x) + ca.tanh(x) + ca.log(x), ca.fabs(-x) ** 2.5 + ca.sqrt(x),
        ca.if_else(x < 0.5, x, ca.fmax(x, 1.0)), ca.floor(x) - ca.sign(x) + ca.erf(x), -state[5] ** 3,
    )  # fmt: skip
    field = vector_field(ca.Function("functions", [time, state], [rates]))
    begin, span = np.array([0, 0, 0, 0, 0, 1.0]), (0.0, 0.9)
    ends = [extended(field, deep).end(np.ones(6), begin, span, None) for deep in (False, True)]
    assert np.abs(ends[0] - ends[1]).max() < 1e-15
    assert ends[1][5] == pytest.approx(float(1 / np.sqrt(np.longdouble(2.8))), rel=1e-15)
    broken = ca.Function("broken", [time, state], [ca.sqrt(state - 2) / (state - state)])
    with pytest.raises(IntegrationError):
        extended(vector_field(broken), True).end(np.ones(6), begin, span, None)


@pytest.mark.usefixtures("deep")
@pytest.mark.parametrize("kicked", [False, True])
def test_a_force_far_narrower_than_a_step_is_found(kicked):
    """2e-6 of the motion wide, where long double passes it by too; that takes its steps again by short ones."""
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    kick = kicked * 6.8e-3 / (5e-6 * np.sqrt(np.pi)) * ca.exp(-(((q - 0.77) / 5e-6) ** 2)) * v
    model, state, whole = lagrange(v**2 / 2, q**2 / 2, Symbols(q, v), forces=kick), np.array([1.0, 0.0]), 2 * np.pi
    motion = evidence.canonical_motion(model, state, whole, np.zeros(1), evidence.evenly(whole), evidence.TIGHTEST)
    sharp = evidence._sharpened(model, motion, np.ones(2), False)
    assert np.abs(sharp.trace.states[-1] - [np.cos(whole), -np.sin(whole)]).max() < 1e-18
    changed = overlooked([sharp.trace])[0]
    assert changed > 1e-3 if kicked else changed == 0.0


@pytest.mark.usefixtures("deep")
def test_a_motion_that_double_precision_does_not_go_through(monkeypatch):
    """The certificate begins in long double where DOP853 fails, and says the same of what it does not fail of."""
    given, own = (three_bodies(), BUTTERFLY, PERIOD, np.zeros(4)), evidence.canonical_motion
    exact = gather(*given, doubts=lambda _: True)

    def failing(*given, longer=False):
        if longer:
            return own(*given, longer=longer)
        raise IntegrationError("collided")

    monkeypatch.setattr(evidence, "canonical_motion", failing)
    again = gather(*given)
    assert np.abs(again.extents / exact.extents - 1).max() < 1e-6
    apart = np.abs(np.sort_complex(again.floquet.multipliers) - np.sort_complex(exact.floquet.multipliers))
    assert apart.max() < 1e-9
    monkeypatch.setattr(evidence, "extended", lambda *_: None)
    with pytest.raises(IntegrationError, match="collided"):
        gather(*given)


@pytest.mark.usefixtures("deep")
def test_past_a_centre_at_a_ten_thousandth():
    """A late clock, whose own round-off is 4e-9 s, costs no digits; steps taken again are in the motion's digits."""
    start, free, times = (
        np.array([1.9999, 0.0, 0.0, np.sqrt(2e-4 / 1.9999)]),
        np.array([2.0]),
        np.linspace(0.0, 3.0, 129),
    )
    field = vector_field(KEPLER, free)
    wide = extended(field)
    early, late = (wide.end(np.ones(4), start, (begin, begin + 3.0), free) for begin in (0.0, 2.0**36))
    assert np.abs(early - start).max() > 0.1 and np.abs(late - early).max() < 1e-12
    trace = evidence._traced(field, wide, np.ones(4), wide.along(np.ones(4), start, times, free), times)
    k = int(np.abs(trace.rates(trace.moments, trace.states)).max(axis=1).argmax()) - 1
    begin, end = trace.moments[k : k + 2]
    known, lost = (_retaken(each, k, begin, end, (end - begin) / 50) for each in (trace, replace(trace, retaken=None)))
    assert known < 1e-14 and lost > 1e-10


@pytest.mark.slow
@pytest.mark.usefixtures("deep")
def test_how_many_digits_are_asked_for(monkeypatch):
    """None more for a distance that long double confirms, nor for multipliers that are known; for others they are."""
    given, turns = (three_bodies(), BUTTERFLY), np.zeros(4)
    wrong = gather(*given, PERIOD * (1 + 1e-8), turns)
    assert wrong.motion.precise == ROUND_OFF and wrong.closes.distance > 1e-9
    assert gather(*given, PERIOD, turns, doubts=lambda _: True).motion.precise == ROUND_OFF
    own = evidence.analyse
    monkeypatch.setattr(evidence, "analyse", lambda *known, **more: replace(own(*known, **more), pair_defect=1e-7))
    assert gather(*given, PERIOD, turns, doubts=lambda _: True).motion.precise < ROUND_OFF
