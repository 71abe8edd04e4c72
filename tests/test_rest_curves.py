"""Folds and Hopf points of equilibria in two parameters: closed forms, other programs, units, faults, files."""

import json
from dataclasses import replace
from itertools import combinations

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import root

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.rest_curves import verified
from orbitfinder.show.plot import two_parameters


def curve_of(field, states, start, values, along, to, parameters, kind, points=40, **more):
    """A model, its equilibria along a parameter, and the curve through an event of a kind."""
    model = of.ode(field, states, parameters=values)
    found = of.follow_equilibria(model, start, along, until=to, points=150)
    number = next(k for k, event in enumerate(found.events) if event.kind == kind)
    return model, found, of.follow_curve(found, number, parameters, points=points, model=model, **more)


def inside(event, *wanted, most=1e-10):
    """Both values lie inside error bars that are small."""
    assert (np.abs(event.values - wanted) <= event.errors + 1e-15).all(), (event.values - wanted, event.errors)
    assert (event.errors <= most * np.maximum(1.0, np.abs(wanted))).all() and event.check.passed


def cubic(t, x, p):
    return [p[0] + p[1] * x[0] - x[0] ** 3]


def nerve(units=(1.0, 1.0, 1.0, 1.0)):
    """FitzHugh and Nagumo's with a = 0.7, rate 0.08: of v, w, current and b the units."""

    def field(t, x, p):
        v, w, current, b = x[0] / units[0], x[1] / units[1], p[0] / units[2], p[1] / units[3]
        return [units[0] * (v - v**3 / 3 - w + current), units[1] * 0.08 * (v + 0.7 - b * w)]

    return field


def of_nerve(v, b):
    """The current at which v rests."""
    return v**3 / 3 - v + (v + 0.7) / b


TAKENS, BAUTIN = 0.08**-0.5, (1 - 0.92**0.5) / 0.08
"""b of its Bogdanov-Takens points (b^2 rate = 1), and of generalised Hopf points (1 - 2 b + b^2 rate = 0)"""


def test_the_cusp():
    """x' = p + q x - x^3: folds at 4 q^3 = 27 p^2, q = 3 x^2, <p, B(q, q)> / 2 = -3 x; the cusp at 0 with c = -1."""
    model, _, curve = curve_of(cubic, ["x"], [-1.3], {"p": -1.0, "q": 1.0}, "p", 1.0, ("p", "q"), "fold", 60)
    assert curve.parameters == ("p", "q") and len(curve.points) == 119 and all(p.certified for p in curve.points)
    for point in curve.points:
        (x,), (p, q) = point.state, point.values
        assert abs(4 * q**3 - 27 * p**2) <= 1e-13 * max(1.0, 27 * p**2) and abs(q - 3 * x**2) < 1e-13 * max(1.0, q)
        assert abs(point.normal_form["a"]) == pytest.approx(3 * abs(x), rel=1e-12)
    (cusp,) = curve.events
    assert cusp.kind == cusp.words == "cusp" and cusp.normal_form["c"] == pytest.approx(-1.0, rel=1e-12)
    inside(cusp, 0.0, 0.0)
    assert curve.points[cusp.index].values[0] * curve.points[cusp.index + 1].values[0] < 0
    assert verified(curve, model).passed


@pytest.mark.parametrize("s", [1.0, -1.0])
def test_bogdanov_takens(s):
    """x' = y, y' = b1 + b2 x + x^2 + s x y, moved to (0.3, -0.2): Hopf points b1 = 0, b2 < 0, folds 4 b1 = b2^2."""

    def field(t, x, p):
        return [x[1], p[0] - 0.3 + (p[1] + 0.2) * x[0] + x[0] ** 2 + s * x[0] * x[1]]

    given = (field, ["x", "y"], [-0.6, 0.0], {"b1": -0.2, "b2": -0.5}, "b1", 0.6, ("b1", "b2"))
    for kind in ("hopf", "fold"):
        model, _, curve = curve_of(*given, kind)
        for point in curve.points:
            b1, b2 = point.values - (0.3, -0.2)
            assert abs(b1 - (0.0 if kind == "hopf" else b2**2 / 4)) < 1e-13 * max(1.0, b2**2)
            assert point.kind == ("fold" if kind == "fold" else "hopf" if b2 < 0 else "neutral_saddle")
        (event,) = curve.events
        inside(event, 0.3, -0.2)
        assert event.words == "Bogdanov-Takens" and event.normal_form["a"] ** 2 == pytest.approx(1.0, rel=1e-9)
        assert event.normal_form["a"] * event.normal_form["b"] == pytest.approx(s, rel=1e-9)
        assert verified(curve, model).passed


def test_bautin():
    """z' = (b1 + 2 i) z + (b2 - 0.3) z |z|^2 - z |z|^4: l1 = 2 (b2 - 0.3) / 2 along b1 = 0."""

    def field(t, x, p):
        r = x[0] ** 2 + x[1] ** 2
        g = p[0] + (p[1] - 0.3) * r - r**2
        return [g * x[0] - 2 * x[1], g * x[1] + 2 * x[0]]

    given = (field, ["x", "y"], [0.0, 0.0], {"b1": -0.5, "b2": -0.4}, "b1", 0.5, ("b2", "b1"), "hopf")
    model, _, curve = curve_of(*given, 60, until=0.9, at=[0.25])
    assert curve.ends[-1].kind == "target" and curve.points[-1].values[0] == 0.9
    assert [point.values[1] for point in curve.points if point.values[0] == 0.25] == [0.0]
    assert all(abs(p.normal_form["l1"] - (p.values[0] - 0.3)) < 1e-13 and p.values[1] == 0.0 for p in curve.points)
    (event,) = curve.events
    inside(event, 0.3, 0.0)
    assert event.kind == "generalised_hopf" and event.frequency == pytest.approx(2.0, rel=1e-14)
    assert verified(curve, model).passed


def zero_hopf(t, x, p):
    r = x[1] ** 2 + x[2] ** 2
    g, w = p[1] - 0.5 * x[0] + x[0] ** 2, 1.3 + x[0]
    return [p[0] + x[0] ** 2 - r, g * x[1] - w * x[2], g * x[2] + w * x[1]]


@pytest.mark.parametrize("kind, along, until", [("fold", "b1", 0.5), ("hopf", "b2", 0.5)])
def test_fold_hopf(kind, along, until):
    """x' = b1 + x^2 - r^2, r' = r (b2 - x / 2 + x^2), angle 1.3 + x: folds b1 = 0, Hopf points b2 = x / 2 - x^2."""
    start = ([-0.6, 0.0, 0.0], {"b1": -0.4, "b2": -1.2})
    model, _, curve = curve_of(zero_hopf, list("xyz"), *start, along, until, ("b1", "b2"), kind, 60)
    for point in curve.points:
        x, (b1, b2) = point.state[0], point.values
        assert abs(b1 + x**2) < 1e-13 and abs(b1 if kind == "fold" else b2 - x / 2 + x**2) < 1e-13
    event, *more = curve.events
    inside(event, 0.0, 0.0)
    assert [other.kind for other in more] == ["generalised_hopf"] * (kind == "hopf")
    for other in more:  # x moves by r^2 / 2 x, and r' by (2 x - 1 / 2) of that: 0 at x = 1 / 4
        inside(other, -1 / 16, 1 / 16)
    assert event.kind == "fold_hopf" and event.frequency == pytest.approx(1.3, rel=1e-12)
    assert verified(curve, model).passed


def test_double_hopf_and_what_is_none():
    """Two oscillators: a = 0 meets b = 0; two neutral saddles beside a Hopf curve are no event."""

    def field(t, x, p):
        r, s = x[0] ** 2 + x[1] ** 2, x[2] ** 2 + x[3] ** 2
        g, h = p[0] - r - s, p[1] - 2 * r - s
        return [g * x[0] - x[1], g * x[1] + x[0], h * x[2] - 1.7 * x[3], h * x[3] + 1.7 * x[2]]

    given = ([0.0] * 4, {"a": -0.5, "b": -0.3}, "a", 0.5, ("a", "b"), "hopf")
    model, _, curve = curve_of(field, list("xyzu"), *given)
    (event,) = curve.events
    inside(event, 0.0, 0.0)
    assert event.kind == "double_hopf" and verified(curve, model).passed

    def real(t, x, p):
        return [p[0] * x[0] - x[1], p[0] * x[1] + x[0], x[2], (p[1] - 1) * x[3]]

    _, _, curve = curve_of(real, list("xyzu"), *given[:1], {"a": -0.5, "b": -0.3}, *given[2:])
    assert min(p.values[1] for p in curve.points) < 0.0 < max(p.values[1] for p in curve.points)
    assert not curve.events


@pytest.fixture(scope="module")
def known():
    """Both curves of the nerve."""
    given = (nerve(), ["v", "w"], [-1.8, -0.4])
    fold = curve_of(*given, {"current": -0.5, "b": 3.0}, "current", 2.5, ("current", "b"), "fold", 150)
    hopf = curve_of(*given, {"current": -0.5, "b": 2.0}, "current", 2.5, ("current", "b"), "hopf", 120)
    return fold[0], fold[2], hopf[2]


def test_the_nerve_of_fitzhugh_and_nagumo(known):
    """Cusp (0.7, 1); Bogdanov-Takens and generalised Hopf points in closed form, on both curves, in error bars."""
    model, fold, hopf = known
    for curve in (fold, hopf):
        both = sorted((event for event in curve.events if event.kind == "bogdanov_takens"), key=lambda e: e.values[0])
        for event, v in zip(both, (1.0, -1.0), strict=True):
            inside(event, of_nerve(v * (1 - 0.08**0.5) ** 0.5, TAKENS), TAKENS)
        assert verified(curve, model).passed
    (cusp,) = [event for event in fold.events if event.kind == "cusp"]
    inside(cusp, 0.7, 1.0)
    (bent,) = [event for event in hopf.events if event.kind == "generalised_hopf"]
    inside(bent, of_nerve(-((1 - 0.08 * BAUTIN) ** 0.5), BAUTIN), BAUTIN)
    for point in hopf.points:
        (v, _), (current, b) = point.state, point.values
        assert abs(v**2 - 1 + 0.08 * b) < 1e-12 * max(1, v**2) and (b < TAKENS) == (point.kind == "hopf")
        assert abs(current - of_nerve(v, b)) < 1e-12 * max(1, abs(v) ** 3)
        if point.kind == "hopf":
            assert (point.normal_form["l1"] > 0) == (b > BAUTIN)


@pytest.mark.slow
@pytest.mark.parametrize("units", [(1e-6, 1e6, 1e6, 1e-6), (1e6, 1e-3, 1e-6, 1e6)])
def test_units_change_nothing(known, units):
    """Components and parameters in other units: the same special points."""
    _, fold, hopf = known
    for b, kind, plain, points in ((3.0, "fold", fold, 100), (2.0, "hopf", hopf, 60)):
        start, values = np.array([-1.8, -0.4]) * units[:2], {"current": -0.5 * units[2], "b": b * units[3]}
        model, _, other = curve_of(nerve(units), ["v", "w"], start, values, "current", 2.5 * units[2],
                                   ("current", "b"), kind, points)  # fmt: skip
        mine = sorted((event.kind, *(event.values / units[2:])) for event in other.events)
        theirs = {event.kind: event.values for event in plain.events if event.values[0] > 0}
        assert sorted(theirs) == [event[0] for event in mine]
        assert all(np.allclose(values, theirs[kind], rtol=1e-10, atol=0) for kind, *values in mine)
        assert all(point.certified for point in other.points) and verified(other, model).passed


@pytest.mark.slow
def test_morris_lecar_in_current_and_half_activation():
    """Its Hopf curve: the trace is 0 by slopes written by hand; Bogdanov-Takens points by another program."""

    def parts(x, shift, tanh=np.tanh, cosh=np.cosh):
        v, w = x[0], x[1]
        opened, wanted = (1 + tanh((v + 1.2) / 18)) / 2, (1 + tanh((v - shift) / 30)) / 2
        still = -2 * (v + 60) - 4.4 * opened * (v - 120) - 8 * w * (v + 84)
        return still / 20, 0.04 * (wanted - w) * cosh((v - shift) / 60)

    def field(t, x, p):
        first, second = parts((x[0], x[1]), p[1], ca.tanh, ca.cosh)
        return [first + p[0] / 20, second]

    def slopes(v, w, shift):  # at rest, where wanted = w
        opened, steep = (1 + np.tanh((v + 1.2) / 18)) / 2, 1 / np.cosh((v + 1.2) / 18) ** 2 / 36
        pace = 0.04 * np.cosh((v - shift) / 60)
        return np.array([[(-2 - 4.4 * (steep * (v - 120) + opened) - 8 * w) / 20, -8 * (v + 84) / 20],
                         [pace / np.cosh((v - shift) / 30) ** 2 / 60, -pace]])  # fmt: skip

    given = ([-40.0, 0.05], {"I": 50.0, "V3": 2.0}, "I", 110.0, ("I", "V3"), "hopf")
    model, _, curve = curve_of(field, ["V", "w"], *given, points=400)
    assert curve.ends[-1].kind == "returned" and {p.kind for p in curve.points} == {"hopf", "neutral_saddle"}
    for point in curve.points[::10]:
        a = slopes(*point.state, point.values[1])
        assert abs(np.trace(a)) < 1e-13 and (np.linalg.det(a) > 0) == (point.kind == "hopf")

    def rows(y):
        v, w, current, shift = y
        a = slopes(v, w, shift)
        return [parts((v, w), shift)[0] + current / 20, parts((v, w), shift)[1], np.trace(a), np.linalg.det(a)]

    assert [event.kind for event in curve.events].count("bogdanov_takens") == 4
    for event in curve.events:
        if event.kind == "bogdanov_takens":
            again = root(rows, [*event.state, *event.values] * (1 + 1e-5 * np.array([1, -1, 1, -1])), tol=1e-14).x
            assert np.allclose(again[2:], event.values, rtol=1e-9) and np.allclose(again[:2], event.state, rtol=1e-9)
    assert verified(curve, model).passed


def test_a_wing_flutters_in_speed_and_damping():
    """Four states: all points have a pair on the axis by the characteristic polynomial of slopes by hand."""

    def matrix(flow, damping):
        mass, arm, inertia = 12.387, 0.0333, 0.065
        lift = 1.225 * flow**2 * 0.135 * 6.28 * np.array([0, 1, 1 / flow, 1.1 * 0.135 / flow])
        first = -lift - np.array([2844.4, 0, damping, 0])
        second = -0.1 * 0.135 * lift - np.array([0, 2.82, 0, 0.18])
        forces = np.linalg.solve([[mass, mass * arm], [mass * arm, inertia]], [first, second])
        return np.vstack([[0, 0, 1, 0], [0, 0, 0, 1], forces])

    def field(t, x, p):
        h, a, hd, ad = (x[k] for k in range(4))
        mass, arm, inertia = 12.387, 0.0333, 0.065
        lift = 1.225 * p[0] ** 2 * 0.135 * 6.28 * (a + hd / p[0] + 1.1 * 0.135 * ad / p[0])
        first, second = -lift - p[1] * hd - 2844.4 * h, -0.1 * 0.135 * lift - 0.18 * ad - 2.82 * a - 100 * a**3
        det = mass * inertia - (mass * arm) ** 2
        return [hd, ad, (inertia * first - mass * arm * second) / det, (mass * second - mass * arm * first) / det]

    given = ([0.0] * 4, {"U": 8.0, "c": 27.43}, "U", 20.0, ("U", "c"), "hopf")
    model, _, curve = curve_of(field, ["h", "a", "hd", "ad"], *given, points=30)
    for point in curve.points:
        roots = np.roots(np.poly(matrix(*point.values)))
        pair = roots[np.argsort(np.abs(roots.real))[:2]]
        assert np.abs(pair.real).max() < 1e-9 * np.abs(roots).max() and abs(pair[0].imag) > 1 and point.kind == "hopf"
    assert np.ptp([p.values[1] for p in curve.points]) > 10 and verified(curve, model).passed


def test_a_pendulum_under_torque_and_one_on_a_rod():
    """torque = g sin(theta) folds at torque = g, whose eigenvalue 0 is double: no Bogdanov-Takens point is claimed."""
    q, v, torque, g = (ca.SX.sym(name) for name in ("q", "v", "torque", "g"))
    symbols = of.Symbols(q, v, ca.vertcat(torque, g), ("torque", "g"), (8.0, 9.8))
    model = of.lagrange(v**2 / 2, -g * ca.cos(q) - torque * q, symbols, names=["theta"])
    found = of.follow_equilibria(model, [1.0, 0.0], "torque", points=40)
    number = [event.kind for event in found.events].index("fold")
    curve = of.follow_curve(found, number, ("g", "torque"), until=12.0, model=model)
    assert all(abs(p.values[0] - p.values[1]) < 1e-12 and abs(p.state[0] - np.pi / 2) < 1e-7 for p in curve.points)
    assert not curve.events and curve.points[-1].values[0] == 12.0 and all(p.certified for p in curve.points)
    assert verified(curve, model).passed


def test_planted_faults_are_seen(known):
    """A state that does not rest, a point or an event elsewhere on its curve, another kind, another coefficient."""
    model, _, hopf = known
    far = {event.kind: replace(event, index=event.index // 5) for event in hopf.events}
    hopf = replace(hopf, points=hopf.points[::5], events=tuple(far.values()))
    takens, bent, first, other = far["bogdanov_takens"], far["generalised_hopf"], hopf.points[0], hopf.points[1]

    def failures(**changes):
        return set(verified(replace(hopf, **changes), model).failures)

    def with_first(**changes):
        return failures(points=(replace(first, **changes), *hopf.points[1:]))

    assert not failures() and not failures(points=hopf.points[:3], events=())
    assert "rates" in with_first(state=first.state * (1 + 1e-9)) and "rates" in with_first(values=other.values)
    assert "eigenvalues" in with_first(eigenvalues=other.eigenvalues)
    assert with_first(kind="neutral_saddle") == {"verdicts"} and "critical eigenvalues" in with_first(kind="fold")
    assert with_first(normal_form={"l1": first.normal_form["l1"] * (1 + 1e-4)}) == {"coefficients"}
    there = {name: getattr(other, name) for name in ("state", "values", "eigenvalues")}
    moved = {name: getattr(hopf.points[bent.index], name) for name in there}
    for event, change in ((takens, there), (bent, moved), (bent, {"kind": "fold_hopf"}), (bent, {"kind": "cusp"})):
        assert failures(events=(replace(event, **change),)), (event.kind, change)
    assert failures(events=(replace(bent, **moved),)) == {"special points"}
    assert failures(events=(replace(takens, normal_form={"a": 1.0}),)) == {"coefficients"}


def test_a_journal_goes_on_and_files_hold_all(tmp_path):
    """A run with more points begins where the shorter one ended, with the same numbers; saved and loaded."""
    model = of.systems.brusselator(rate=1.8)
    found = of.follow_equilibria(model, [1.0, 1.8], "rate", until=2.4)
    short = of.follow_curve(found, found.events[0], ("feed", "rate"), points=4, out=tmp_path)
    assert short.name == "equilibria-0-feed-rate" and len(short.points) == 7
    longer, whole = (of.follow_curve(found, 0, ("feed", "rate"), points=9, out=out) for out in (tmp_path, None))
    assert np.array_equal(longer.places, whole.places) and [end.kind for end in longer.ends] == ["point limit"] * 2
    again = of.load_equilibria(of.save_equilibria(longer, tmp_path / "equilibria.json"))
    assert np.array_equal(again.places, whole.places) and again.parameters == ("feed", "rate")
    assert verified(again).passed and [p.normal_form for p in again.points] == [p.normal_form for p in whole.points]
    backwards = of.follow_curve(found, 0, ("rate", "feed"), until=1.5)
    assert backwards.points[-1].values[0] == 1.5 and backwards.points[-1].values[1] == pytest.approx(0.5**0.5)


def test_labels_do_not_overlap(known):
    """Of both curves in one picture."""
    figure = two_parameters([known[2], known[1]])
    figure.draw_without_rendering()
    names = [text for text in figure.axes[0].texts if text.get_text()]
    assert sorted(name.get_text() for name in names) == ["Bogdanov-Takens"] * 2 + ["cusp", "generalised Hopf"]
    boxes = [name.get_window_extent() for name in names]
    assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    words = {text.get_text() for text in figure.legends[0].get_texts()}
    assert words == {"fold", "Hopf", "neutral saddle", "Bogdanov-Takens", "cusp", "generalised Hopf"}


@pytest.mark.parametrize("change, message", [
    ({"event": 3}, "event: no curve leads through event 3 of equilibria; choose one of 0: supercritical hopf at ra"),
    ({"parameters": ("feed",)}, r"parameters: two names are needed, got 1 \(feed\); give a,b"),
    ({"parameters": ("feed", "rat")}, "parameters: unknown 'rat'.* did you mean 'rate'"),
    ({"parameters": ("rate", "rate")}, "parameters: 'rate' twice"),
    ({"until": 1.0}, "until: 1.0 is where feed begins"),
    ({"until": float("nan")}, "until: must be a finite value of feed, got nan"),
    ({"points": 0}, "points: must be at least 1, got 0"),
])  # fmt: skip
def test_messages(change, message):
    """Field, value, remedy."""
    found = of.follow_equilibria(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", until=2.4)
    given = {"family": found, "event": 0, "parameters": ("feed", "rate")} | change
    with pytest.raises(InputError, match=message):
        of.follow_curve(**given)


def test_what_no_curve_belongs_to(known):
    """Branch points, curves themselves, an event of equilibria beside a family, parameters that do not matter."""
    model, _, hopf = known
    with pytest.raises(InputError, match="is a curve in two parameters itself; give the equilibria that it was"):
        of.follow_curve(hopf, 0, ("current", "b"), model=model)
    with pytest.raises(InputError, match="event: nothing leaves these equilibria at event 0"):
        of.switch_branch(hopf, 0, model=model)
    crossing = of.ode(lambda t, x, p: [x[0] * (p[0] - x[0])], ["x"], parameters={"r": -1.0, "s": 1.0})
    found = of.follow_equilibria(crossing, [0.0], "r", until=1.0)
    with pytest.raises(InputError, match="through event branch_point of equilibria; it has no fold or Hopf point"):
        of.follow_curve(found, found.events[0], ("r", "s"), model=crossing)
    fixed = of.ode(lambda t, x, p: [p[0] - x[0] ** 2], ["x"], parameters={"r": 1.0, "s": 1.0, "u": 2.0})
    folds = of.follow_equilibria(fixed, [1.0], "r", until=-1.0, points=60)
    with pytest.raises(ConvergenceError, match="the fold at r = 0 does not move with s and u"):
        of.follow_curve(folds, 0, ("s", "u"), model=fixed)


def test_the_command(tmp_path):
    """It writes record and picture, which are verified, shown and plotted; b = 1 + a^2 on the way; missing options."""
    file = tmp_path / "own.toml"
    table = 'system = { kind = "python", function = "brusselator", arguments = { rate = 1.8 } }\n'
    file.write_text(table + "simulate = { state = [1.0, 1.8] }\n")

    def run(*words):
        done = CliRunner().invoke(cli, [*map(str, words), *(["-o", str(tmp_path)] if words[0] != "verify" else [])])
        return done

    assert run("equilibria", file, "--parameter", "rate", "--until", "2.4").exit_code == 0
    rest = tmp_path / "own" / "equilibria.json"
    done = run("continue", rest, "--curve", "0", "--parameters", "feed,rate", "--until", "2", "--at", "1.5", "--json")
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["certified"] == document["points"] and document["name"] == "own-0-feed-rate"
    written = tmp_path / "own-0-feed-rate" / "equilibria.json"
    assert (written.parent / "two_parameters.png").exists()
    places = of.load_equilibria(written).places
    assert np.abs(places[:, 1] - 1 - places[:, 0] ** 2).max() < 1e-13 and {1.0, 1.5, 2.0} <= {*places[:, 0]}
    assert run("verify", written).exit_code == 0 and run("plot", written).exit_code == 0
    assert "feed, rate" in CliRunner().invoke(cli, ["show", str(written)]).output
    document = json.loads(written.read_text())
    document["points"][0]["values"][1] *= 1 + 1e-9
    written.write_text(json.dumps(document))
    assert run("verify", written).exit_code == 1
    for words, message in (
        (("--curve", "0"), "--parameters: missing beside --curve"), (("--parameters", "feed,rate"), "--curve: missing"),
        (("--curve", "4", "--parameters", "feed,rate"), "event: no curve leads through event 4"),
    ):  # fmt: skip
        done = run("continue", rest, *words)
        assert done.exit_code == 2 and message in done.stderr, done.output


def test_folds_on_a_leaf_of_an_integral():
    """x' = y (k + x^2) - c x = -y', x + y = 3: the cusp is at k = 1 / 3, c = 8 / 3, x = 1."""

    def field(t, x, p):
        rate = x[1] * (p[0] + x[0] ** 2) - p[1] * x[0]
        return [rate, -rate]

    model = of.ode(field, ["x", "y"], parameters={"k": 0.25, "c": 2.0}, invariants={"total": lambda x, p: x[0] + x[1]})
    found = of.follow_equilibria(model, [2.6, 0.4], "c", until=3.0, points=200)
    curve = of.follow_curve(found, 0, ("k", "c"), points=40, model=model)
    assert all(abs(point.state.sum() - 3) < 1e-14 and point.certified for point in curve.points)
    (cusp,) = curve.events
    inside(cusp, 1 / 3, 8 / 3)
    assert cusp.kind == "cusp" and np.allclose(cusp.state, [1.0, 2.0], rtol=1e-12)
    # along (1, -1) / sqrt 2 the rate is -w^3 / 2 beside the cusp, w in units of length 1
    assert cusp.normal_form["c"] == pytest.approx(-0.5, rel=1e-10)
    assert verified(curve, model).passed


def test_a_curve_of_neutral_saddles():
    """The origin of Lorenz has -+beta among its eigenvalues at sigma rho = (beta + sigma) (beta + 1)."""
    model = of.systems.lorenz(rho=0.2)
    found = of.follow_equilibria(model, [0.0, 0.0, 0.0], "rho", until=28.0)
    (saddle,) = [event for event in found.events if event.kind == "neutral_saddle"]
    curve = of.follow_curve(found, saddle, ("sigma", "rho"), points=15)
    assert {point.kind for point in curve.points} == {"neutral_saddle"} and not curve.events
    for sigma, rho in curve.places:
        assert sigma * rho == pytest.approx((8 / 3 + sigma) * (8 / 3 + 1), rel=1e-13)
    assert all(point.certified for point in curve.points) and verified(curve).passed
