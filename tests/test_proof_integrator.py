"""The validated integrator: exact solutions, another integrator, containment, and enclosures broken on purpose."""

from dataclasses import replace
from itertools import product

import casadi as ca
import numpy as np
import pytest
from scipy.special import ellipj, ellipk

pytest.importorskip("flint")

import orbitfinder as of
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import TIGHTEST, integrate
from orbitfinder.integrate.field import vector_field
from orbitfinder.loops.symmetry import BRAKE, REFLECTION, REVERSAL, SYMMETRIES
from orbitfinder.mechanics.lagrange import Symbols, lagrange
from orbitfinder.mechanisms.chain import chain
from orbitfinder.proof import enclosure
from orbitfinder.proof.balls import arb, arb_poly, decimal, floats, precision, radii, radius
from orbitfinder.proof.enclosure import TaylorSettings, cloud
from orbitfinder.proof.field import make_field, programs
from orbitfinder.proof.invariance import has_symmetry, turns_leave
from orbitfinder.proof.program import Ring, program
from orbitfinder.proof.series import coefficients, listed, outputs, recurrence, whole_series
from orbitfinder.proof.taylormodel import Beyond

pytestmark = pytest.mark.needs("proof")
FAST = TaylorSettings(order=14, bits=96, tolerance=1e-14)
FLOATS = Ring(
    float,
    {
        "add": lambda a, b: a + b, "sub": lambda a, b: a - b, "mul": lambda a, b: a * b, "div": lambda a, b: a / b,
        "neg": lambda a: -a, "sq": lambda a: a * a, "sin": np.sin, "cos": np.cos, "sqrt": np.sqrt, "exp": np.exp,
        "log": np.log, "pow": lambda a, b: a**b,
    },
)  # fmt: skip


@pytest.fixture(autouse=True)
def bits():
    with precision(FAST.bits):
        yield


def oscillator(potential=lambda q: q**2 / 2):
    q, v = ca.SX.sym("q"), ca.SX.sym("v")
    return lagrange(v**2 / 2, potential(q), Symbols(q, v))


def extended(state, duration, spread=0.0):
    return [arb(float(x), spread) for x in state] + [arb(0), arb(duration)]


def plain(model):
    n = model.degrees_of_freedom
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2 * n)
    rate = ca.vertcat(x[n:], model.acceleration(t, x[:n], x[n:], ca.DM(model.parameter_values)))
    return vector_field(ca.Function("plain", [t, x], [rate]))


@pytest.mark.parametrize("links", [1, 2, 3])
@pytest.mark.parametrize("formulation", ["recursive", "lagrange"])
def test_program_agrees_with_casadi(links, formulation):
    """The straight-line program in floats is CasADi's own evaluation."""
    model = chain(links, formulation=formulation)
    code = program(model.acceleration)
    random = np.random.default_rng(links)
    q, v = random.normal(size=(2, links))
    found = code.run([[0.0], q, v, model.parameter_values], FLOATS)[0]
    expected = model.acceleration(0.0, q, v, model.parameter_values).full().ravel()
    assert np.allclose([found[i] for i in range(links)], expected, rtol=1e-13)


def elementary():
    """A function with every operation that proofs know."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    a, b = x[0], x[1]
    rows = [
        ca.tan(a) * ca.exp(b), ca.log(2 + a) / (3 - b), ca.sqrt(2 + a * b), (2 + a) ** 3, (2 + b) ** 1.5, 1 / (a + 2),
        p**a, ca.sin(a - b) - 2 * ca.cos(b) + 4, -a + p, 5 - a, (1 + a) ** -2, (2 + a) ** b,
    ]  # fmt: skip
    return ca.Function("elementary", [x, p], [ca.vertcat(*rows)])


def test_series_and_remainders_of_every_operation():
    """Taylor models of all operations contain the function along a path, at times over the step."""
    function, order, h = elementary(), 8, 0.25
    code = recurrence(program(function), {1: [decimal(0.7)]})
    path = [[arb(0.3), arb(0.5), arb(-0.2)], [arb(-0.4), arb(1), arb(0.1)]]
    span = arb(h / 2, h / 2)

    def variables(k, _):
        return [path[entry][k] if k < 3 else arb(0) for _, _, entry in code.variables]

    values = coefficients(code, order - 1, variables)
    flat = [arb_poly(each) for each in values]
    rest = Beyond(code, flat, order, span).remainders([arb(0)] * len(code.variables))
    series, balls = outputs(code, values)[0], outputs(code, rest)[0]
    for time in np.linspace(0, h, 11):
        x = [sum(float(c) * time**k for k, c in enumerate(one)) for one in path]
        expected = function(x, 0.7).full().ravel()
        for i, exact in enumerate(expected):
            ball = sum((c * arb(time) ** k for k, c in enumerate(series[i][:order])), balls[i] * arb(time) ** order)
            assert abs(float(ball.mid()) - exact) <= 1e-13 + float(ball.rad())
            assert ball.rad() < 1e-2


@pytest.mark.parametrize(
    ("made", "slope", "rest"),
    [(ca.exp, -1.0, -1.5), (ca.log, 1.0, 0.5), (ca.sin, 2.0, -1.0), (ca.sqrt, -0.25, -0.125),
     (lambda x: x**2 - 1 / x, 1.0, 0.5), (lambda x: x / (2 + x), -0.5, -0.25)],
)  # fmt: skip
def test_remainders_of_what_has_one(made, slope, rest):
    """Over a long step of a low order, f(1 + a t + r t^2) is in the model, where r and the tail nearly cancel too."""
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [made(x)])
    code = recurrence(program(function), {})
    values = whole_series(code, 1, [[arb(1), arb(slope)]])[0]
    (ball,) = outputs(code, Beyond(code, values, 2, arb(0.5, 0.5)).remainders([arb(rest)]))[0].values()
    (series,) = outputs(code, values)[0].values()
    for t in np.linspace(0.0, 1.0, 21)[1:]:
        off = ball * arb(t * t) + series(arb(t)) - float(function(1 + slope * t + rest * t * t))
        assert off.is_finite() and (off + arb(0, 1e-14)).contains(0)


def test_whole_series_are_those_found_term_by_term():
    """Arb's series arithmetic and our recurrences give the same coefficients of every operation."""
    code = recurrence(program(elementary()), {1: [decimal(0.7)]})
    path = [[arb(0.3), arb(0.5), arb(-0.2)] + [arb(0)] * 7, [arb(-0.4), arb(1), arb(0.1)] + [arb(0)] * 7]
    one = coefficients(code, 9, lambda k, _: [path[entry][k] for _, _, entry in code.variables])
    two = [listed(each, 9) for each in whole_series(code, 9, [path[entry] for _, _, entry in code.variables])[0]]
    for a, b in zip(outputs(code, one)[0].values(), outputs(code, two)[0].values(), strict=True):
        assert all(x.overlaps(y) and x.rad() < 1e-20 and y.rad() < 1e-20 for x, y in zip(a, b, strict=True))


def test_unknown_operation_is_named():
    """An operation without a power series is refused by name, and a graph of solvers as such."""
    x = ca.SX.sym("x")
    with pytest.raises(InputError, match=r"OP_FABS has no power series"):
        program(ca.Function("f", [x], [ca.fabs(x)]))
    y = ca.MX.sym("y")
    with pytest.raises(InputError, match="only scalar graphs"):
        program(ca.Function("g", [y], [y]))


def test_parameters_are_decimals():
    """9.8 means 49/5, and the ball of a float contains both readings' difference."""
    with precision(200):
        assert (decimal(9.8) * 5 - 49).contains(0)
        assert not (arb(9.8) * 5 - 49).contains(0)
        assert (decimal(1.25e-7) * 8 - decimal(1e-6)).contains(0)
        assert (decimal(-3.0) + 3).contains(0)
    with pytest.raises(InputError, match="finite"):
        decimal(float("nan"))


def test_harmonic_oscillator_over_a_hundred_periods():
    """The enclosure contains the truth after 100 periods, and has not grown."""
    field = make_field(oscillator())
    period = 2 * arb.pi()
    spread = 1e-6
    here = cloud([arb(1, spread), arb(0, spread), arb(0), period.mid()])
    for _ in range(100):
        here, _ = enclosure.integrate(field, here, FAST)
    late = 100 * (2 * arb.pi() - period.mid())
    for x, v in ((1.0, 0.0), (1.0 + spread, -spread), (1.0 - spread, spread)):
        truth = [x * late.cos() - v * late.sin(), x * late.sin() + v * late.cos()]
        assert all(ball.contains(exact) for ball, exact in zip(here.hull, truth, strict=False))
    assert radius(here.point[:2]) < 1e-11
    assert radius(here.hull[:2]) < 1.01 * spread * np.sqrt(2)


@pytest.mark.parametrize("settings", [TaylorSettings(tolerance=1e-6), TaylorSettings(order=4, tolerance=1e-4)])
@pytest.mark.parametrize("spread", [1e-12, 0.03])
def test_all_solutions_of_a_wide_box_and_their_derivatives(spread, settings):
    """x' = x^2, y' = x y over tau: states on the way and at the end, and their slopes, from a box's corners."""
    field = make_field(of.ode(lambda _, x, p: [x.x**2, x.x * x.y], ("x", "y")))
    centre = [arb(1), arb(-2), arb(0.25)]
    box = [*(x + arb(0, spread) for x in centre[:2]), arb(0), centre[2] + arb(0, spread)]
    here, steps = enclosure.integrate(field, cloud(box), settings)
    for signs in product((-1, 0, 1), repeat=3):
        x, y, tau = (a + sign * arb(spread) for a, sign in zip(centre, signs, strict=True))
        for step in steps:
            pace = 1 - x * tau * (arb(step.begin) + arb(step.h) / 2)
            ways = step.at(arb(step.h) / 2)
            assert all(ball.contains(exact.mid()) for ball, exact in zip(ways, (x / pace, y / pace), strict=True))
        pace = 1 - x * tau
        slopes = [1 / pace**2, 0, x**2 / pace**2, y * tau / pace**2, 1 / pace, x * y / pace**2]
        rows = [row[k] for row in here.derivatives.tolist() for k in (0, 1, 3)]
        for ball, exact in zip([*here.hull[:2], *rows], [x / pace, y / pace, *slopes], strict=True):
            assert ball.contains(arb(exact).mid())


def test_wrapping_is_what_frames_prevent(monkeypatch):
    """Without the turning frames the same integration blows up."""
    monkeypatch.setattr(enclosure, "orthogonal", lambda matrix, weights: enclosure.identity(matrix.nrows()))
    field = make_field(oscillator())
    here = cloud([arb(1), arb(0), arb(0), arb(6.25)])
    turned = []
    for _ in range(8):
        here, _ = enclosure.integrate(field, here, FAST)
        turned.append(radius(here.point[:2]))
    monkeypatch.undo()
    there = cloud([arb(1), arb(0), arb(0), arb(6.25)])
    for _ in range(8):
        there, _ = enclosure.integrate(field, there, FAST)
    assert turned[-1] > 100 * radius(there.point[:2])


def test_pendulum_against_elliptic_functions():
    """theta = 2 arcsin(k sn(K - w t)) from rest at 2 rad lies in the enclosure, T = 4 K / w closes it."""
    model = chain(1)
    frequency = np.sqrt(1.5 * 9.8)
    modulus = np.sin(1.0)
    quarter = ellipk(modulus**2) / frequency
    field = make_field(model)
    here, _ = enclosure.integrate(field, cloud(extended([2.0, 0.0], 0.7)), FAST)
    sn, cn, dn, _ = ellipj(frequency * (quarter - 0.7), modulus**2)
    angle = 2 * np.arcsin(modulus * sn)
    rate = -2 * modulus * frequency * cn * dn / np.sqrt(1 - (modulus * sn) ** 2)
    assert radius(here.point[:2]) < 1e-12
    assert abs(float(here.point[0].mid()) - angle) < 1e-12
    assert abs(float(here.point[1].mid()) - rate) < 1e-11
    with precision(150):  # K by the arithmetic-geometric mean, in balls
        exact = arb.pi() / 2 / arb(1).agm(arb(1).cos()) / (arb(3) / 2 * arb(49) / 5).sqrt()
    closing, _ = enclosure.integrate(make_field(model), cloud([arb(2), arb(0), arb(0), exact.mid()]), FAST)
    assert closing.point[0].contains(0)


def test_against_another_integrator():
    """Chain(2): the enclosures of state and derivatives contain what DOP853 says, to its own error."""
    model, state, duration = chain(2), np.array([0.4, -0.9, 1.1, 0.3]), 0.6
    whole = replace(FAST, share=1.0)
    here, steps = enclosure.integrate(make_field(model), cloud(extended(state, duration)), whole)
    field = plain(model)
    end = integrate(field, state, np.array([0.0, duration]), TIGHTEST)[-1]
    assert np.abs([float(x.mid()) for x in here.point[:4]] - end).max() < 1e-12
    assert radius(here.point[:4]) < 1e-12
    derivatives = floats(here.derivatives)
    assert radii(here.derivatives).max() < 1e-9
    for j in range(4):
        nudge = 1e-5 * np.eye(4)[j]
        ends = [integrate(field, state + sign * nudge, np.array([0.0, duration]), TIGHTEST)[-1] for sign in (1, -1)]
        assert np.abs((ends[0] - ends[1]) / 2e-5 - derivatives[:, j]).max() < 1e-7
    assert np.abs(derivatives[:, 5] - field(0.0, end)).max() < 1e-11
    middle = steps[1].at(arb(steps[1].h) / 2)
    time = duration * (steps[1].begin + steps[1].h / 2)
    inside = integrate(field, state, np.array([0.0, time]), TIGHTEST)[-1]
    assert all(abs(float(a.mid()) - b) < 1e-12 for a, b in zip(middle, inside, strict=True))


STATE, SPREAD, DURATION = np.array([0.5, -0.4, 0.8, 1.2]), 1e-3, 0.4


def escaped(samples, unfolding=0.0):
    """How many of the solutions from random points of a box leave its enclosure at the end."""
    model = chain(2)
    box = [*extended(STATE, DURATION, SPREAD)[:4], arb(0, unfolding) if unfolding else arb(0), arb(DURATION)]
    here, _ = enclosure.integrate(make_field(model), cloud(box), FAST)
    low, high = (np.array([float(getattr(x, side)()) for x in here.hull[:4]]) for side in ("lower", "upper"))
    random = np.random.default_rng(1)
    starts = STATE + SPREAD * random.choice([-1.0, 1.0, 2.0], size=(samples, 4), p=[0.4, 0.4, 0.2]) * (
        random.uniform(0, 1, size=(samples, 4)) ** 0.2
    ).clip(0, 1)
    starts = np.clip(starts, STATE - SPREAD, STATE + SPREAD)
    ends = many(model, starts)
    return int(np.sum(np.any((ends < low - 1e-12) | (ends > high + 1e-12), axis=1)))


def many(model, starts):
    """Ends of many solutions at once, by 200 steps of the classical method of fourth order."""
    n, count = model.degrees_of_freedom, len(starts)
    acceleration = model.acceleration.map(count)
    p = np.tile(model.parameter_values[:, None], (1, count))

    def field(x):
        return np.vstack([x[n:], acceleration(np.zeros((1, count)), x[:n], x[n:], p).full()])

    x, h = starts.T.copy(), DURATION / 200
    for _ in range(200):
        a = field(x)
        b = field(x + h / 2 * a)
        c = field(x + h / 2 * b)
        d = field(x + h * c)
        x = x + h / 6 * (a + 2 * b + 2 * c + d)
    return x.T


def test_containment():
    """1000 random points of a box, its corners among the likeliest: none of their solutions is outside."""
    assert escaped(1000) == 0


def test_derivatives_of_a_box_contain_those_of_its_points():
    """At random points, the derivatives integrated from the point alone lie inside the box's enclosure."""
    field, random = make_field(chain(2)), np.random.default_rng(2)
    box = extended(STATE, DURATION, 1e-4)
    whole, _ = enclosure.integrate(field, cloud(box), FAST)
    for _ in range(4):
        point = [x.mid() + arb(float(random.uniform(-1e-4, 1e-4))) for x in box[:4]] + box[4:]
        alone, _ = enclosure.integrate(field, cloud([x.mid() for x in point]), FAST)
        pairs = zip(whole.derivatives.entries(), alone.derivatives.entries(), strict=True)
        assert all(ball.contains(exact) for ball, exact in pairs)


def test_broken_enclosure_is_caught(monkeypatch):
    """Derivatives shrunk by a quarter let solutions escape, and the containment test sees it."""
    whole = enclosure.Cloud.flow
    monkeypatch.setattr(enclosure.Cloud, "flow", lambda *given: tuple(part * arb(0.75) for part in whole(*given)))
    assert escaped(1000) > 0


def test_dropped_remainder_is_caught(monkeypatch):
    """At a low order, an enclosure without its remainder misses the exact solution."""
    coarse = TaylorSettings(order=4, bits=96, tolerance=1e-7)

    def contains():
        here, _ = enclosure.integrate(make_field(oscillator()), cloud([arb(1), arb(0), arb(0), arb(1)]), coarse)
        return here.point[0].contains(arb(1).cos()) and here.point[1].contains(-arb(1).sin())

    assert contains()
    whole = enclosure.state_remainder
    monkeypatch.setattr(
        enclosure, "state_remainder", lambda *a: None if (r := whole(*a)) is None else [arb(0) for _ in r]
    )
    assert not contains()


def test_hopeless_step_is_reported():
    """A solution that leaves every bound ends in a message, not in an enclosure."""
    field = make_field(oscillator(lambda q: -(q**4)))
    with pytest.raises(IntegrationError, match="no validated step is short enough"):
        enclosure.integrate(field, cloud([arb(3), arb(30), arb(0), arb(5)]), TaylorSettings(10, 80, 1e-12, 1e-5))


def test_symmetries_are_read_off_the_graph():
    """A chain has all of them; a charge in a field from one side has none but reversal of time."""
    codes = programs(chain(2))
    for symmetry in SYMMETRIES.values():
        assert has_symmetry(codes.rates, codes.energy, symmetry, 2)
    assert turns_leave(codes.rates, (True, True)) and turns_leave(codes.energy, (True, True))
    lopsided = programs(oscillator(lambda q: q**2 + q**3))
    assert has_symmetry(lopsided.rates, lopsided.energy, BRAKE, 1)
    assert not has_symmetry(lopsided.rates, lopsided.energy, REFLECTION, 1)
    assert not has_symmetry(lopsided.rates, lopsided.energy, REVERSAL, 1)
    assert not turns_leave(lopsided.rates, (True,))
    steep = programs(oscillator(lambda q: (2 + q) ** -3))
    assert not has_symmetry(steep.rates, steep.energy, REFLECTION, 1)
    two, one = (programs(oscillator(lambda q, k=k: ca.cos(k * q))) for k in (2, 1))
    assert turns_leave(two.rates, (True,), [0]) and not turns_leave(one.rates, (True,), [0])


def test_what_cannot_be_proved_is_refused():
    """Two integrals, a force that grows with time: the message says why."""
    with pytest.raises(InputError, match="conserves energy, angular_momentum"):
        programs(chain(2, gravity=0.0))
    q, v, t = ca.SX.sym("q"), ca.SX.sym("v"), ca.SX.sym("t")
    driven = lagrange(v**2 / 2, q**2 / 2, Symbols(q, v, time=t, forcing_period=1.0), forces=ca.sin(t) + t)
    with pytest.raises(InputError, match="when its drive repeats cannot be read off"):
        programs(driven)
