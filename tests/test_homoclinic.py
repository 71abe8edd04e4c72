"""Families whose period grows without bound: homoclinic and heteroclinic ends, saddle-nodes on the cycle."""

import json
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

import orbitfinder as of
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.saddles import extrapolated, homoclinic_limit, passage_rates, saddle_node_limit, settling
from orbitfinder.families.verified import verified
from orbitfinder.records.family import save_family

CYCLES = json.loads((Path(__file__).parent / "data" / "cycles.json").read_text())["entries"]
QUIET = FamilySettings(certify=False, events=False)
EPSILON = np.finfo(float).eps


def near_rest(rates, state, p):
    """An equilibrium by Newton on differences, with eigenvectors: its fastest growing one and that of the transpose."""
    x = np.array(state, float)
    for _ in range(8):
        h = 1e-6 * np.maximum(1e-2, np.abs(x))
        slopes = np.array([(rates(x + h * e, p) - rates(x - h * e, p)) / (2 * h @ e) for e in np.eye(x.size)]).T
        x = x - np.linalg.solve(slopes, rates(x, p))
    (values, right), (others, left) = np.linalg.eig(slopes), np.linalg.eig(slopes.T)
    v, w = right[:, np.argmax(values.real)].real, left[:, np.argmax(others.real)].real
    return x, v / np.abs(v).max(), w / (w @ v)


def side(rates, p, start, out, sizes, goal=None, far=0.2):
    """On which side of a saddle's stable manifold the unstable one of another, or its own, passes it, by SciPy."""
    x, v, w = near_rest(rates, start, p)
    y, _, w = (x, v, w) if goal is None else near_rest(rates, goal, p)
    sizes = np.array(sizes)

    def leg(begin, about, direction):
        def reached(t, z):
            return np.linalg.norm((z - about) / sizes) - far

        reached.terminal, reached.direction = True, direction
        settings = {"method": "DOP853", "rtol": 100 * EPSILON, "atol": 1e-18, "events": reached}
        done = solve_ivp(lambda t, z: rates(z, p), (0, 1e4), begin, **settings)
        assert done.t_events[0].size
        return done.y[:, -1]

    away = leg(x + 1e-7 * np.sign(v @ np.array(out)) * v * sizes.max(), x, 1)
    return np.sign(w @ (leg(leg(away, y, -1), y, 1) - y))


def inside(end, rates, *given, least=0.0, **more):
    """The connection is within the error bar of an end, by the manifolds on both sides of it."""
    error = max(end.error, least)
    return side(rates, end.parameter - error, *given, **more) != side(rates, end.parameter + error, *given, **more)


def sandstede():
    """B. Sandstede's loop x^2 (1 - x) = y^2, which is homoclinic at a = 0 (Annals of Differential Equations, 1997)."""

    def field(_, x, p):
        return [-x.x + 2 * x.y + x.x**2, (2 - p.a) * x.x - x.y - 3 * x.x**2 + 1.5 * x.x * x.y]

    return of.ode(field, ["x", "y"], {"a": 0.2})


def morris_lecar(phi):
    """The nerve of C. Morris and H. Lecar, of the second set of J. Rinzel and B. Ermentrout."""

    def field(_, x, p):
        opening = (1 + ca.tanh((x.V + 1.2) / 18)) / 2
        rate = (p.I - 2 * (x.V + 60) - 4 * opening * (x.V - 120) - 8 * x.w * (x.V + 84)) / 20
        return [rate, p.phi * ((1 + ca.tanh((x.V - 12) / 17.4)) / 2 - x.w) * ca.cosh((x.V - 12) / 34.8)]

    return of.ode(field, ["V", "w"], {"I": 90.0, "phi": phi})


def from_hopf(model, state, name, most, settings=QUIET, **given):
    """The equilibria and the family born at their first Hopf point."""
    rest = of.follow_equilibria(model, state, name, until=most)
    k = next(k for k, event in enumerate(rest.events) if event.kind == "hopf")
    return of.follow_family(of.switch_branch(rest, k, model=model), settings=settings, **given)


def end_of(family, *kinds):
    """The end of a family whose period blows up, which its other end is none of."""
    (end,) = (end for end in family.ends if end.kind in kinds)
    assert end.period > 5 * family.values("period").min()
    assert sum(other.kind == "hopf" for other in family.ends) == len(family.ends) - 1
    return end


@pytest.fixture(scope="module")
def loop():
    """Sandstede's family."""
    return from_hopf(sandstede(), [0.9, 0.9], "a", 0.5)


def test_an_exact_homoclinic_orbit(loop, tmp_path):
    """At a = 0, of the saddle at 0 with eigenvalues 1 and -3; in the file, and verified from it."""
    end = end_of(loop, "homoclinic")
    assert abs(end.parameter) <= end.error < 1e-11
    (saddle,) = end.saddles
    assert saddle["state"] == [0.0, 0.0]
    assert np.array(saddle["eigenvalues"]) == pytest.approx(np.array([[-3.0, 0.0], [1.0, 0.0]]), abs=1e-9)
    assert "homoclinic orbit of the saddle q = [0. 0.] (eigenvalues -3, 1) at a " in end.reason
    assert "settling with exp(-1 T) where eigenvalues say 1" in end.reason
    known = of.load_family(save_family(replace(loop, name="loop"), tmp_path / "loop"))
    assert known.ends == loop.ends
    assert all(check.passed for _, check in verified(known, sandstede()))


@pytest.mark.parametrize("wrong", [
    {"parameter": 1e-9}, {"saddles": ({"state": [1e-3, 0.0], "eigenvalues": [[-3.0, 0.0], [1.0, 0.0]]},)},
    {"saddles": ({"state": [0.0, 0.0], "eigenvalues": [[-3.0, 0.0], [1.1, 0.0]]},)},
])  # fmt: skip
def test_a_wrong_homoclinic_end_is_rejected(loop, wrong):
    """Another parameter, another equilibrium, other eigenvalues."""
    planted = replace(loop, ends=tuple(replace(e, **wrong) if e.kind == "homoclinic" else e for e in loop.ends))
    checks = dict(verified(planted, sandstede()))
    assert sorted(check.passed for name, check in checks.items() if name.startswith("end")) == [False, True]


@pytest.mark.slow
def test_a_homoclinic_orbit_of_a_nerve():
    """phi = 0.23: against the manifolds of the saddle, by SciPy."""

    def rates(z, current):
        (v, w), opening = z, (1 + np.tanh((z[0] + 1.2) / 18)) / 2
        rate = (current - 2 * (v + 60) - 4 * opening * (v - 120) - 8 * w * (v + 84)) / 20
        return np.array([rate, 0.23 * ((1 + np.tanh((v - 12) / 17.4)) / 2 - w) * np.cosh((v - 12) / 34.8)])

    family = from_hopf(morris_lecar(0.23), [8.0, 0.4], "I", 30.0)
    end = end_of(family, "homoclinic")
    assert end.error < 1e-9 and inside(end, rates, [-22.3, 0.02], [1.0, 0.0], [50.0, 0.4])


def test_lorenz_homoclinic_explosion():
    """At rho = 13.926557407 (E. N. Lorenz' equations; C. Sparrow, 1982), and by the origin's manifold."""

    def rates(z, rho):
        return np.array([10 * (z[1] - z[0]), z[0] * (rho - z[2]) - z[1], z[0] * z[1] - 8 / 3 * z[2]])

    model = of.ode(lambda _, x, p: [10 * (x.y - x.x), x.x * (p.rho - x.z) - x.y, x.x * x.y - 8 / 3 * x.z],
                   ["x", "y", "z"], {"rho": 24.0})  # fmt: skip
    family = from_hopf(model, [7.9, 7.9, 23.0], "rho", 26.0)
    end = end_of(family, "homoclinic")
    assert end.parameter == pytest.approx(13.926557407, abs=1e-9) and end.error < 1e-9
    assert inside(end, rates, [0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [10.0, 10.0, 14.0], far=0.5)


def saddle_focus(z, b, a=0.4):
    """A. Arneodo, P. Coullet and C. Tresser's equations, whose origin is a saddle-focus."""
    return [z[1], z[2], -a * z[2] - z[1] + b * z[0] * (1 - z[0])]


@pytest.mark.slow
def test_shilnikov_orbit_behind_its_folds():
    """A family that goes to and fro towards the homoclinic orbit of a saddle-focus, through twelve folds."""
    model = of.ode(lambda _, x, p: saddle_focus([x.x, x.y, x.z], p.b), ["x", "y", "z"], {"b": 0.3})
    family = from_hopf(model, [1.0, 0.0, 0.0], "b", 0.7, replace(QUIET, points=400))
    end, folds = end_of(family, "homoclinic"), np.diff(np.sign(np.diff(family.values("value"))))
    assert np.count_nonzero(folds) >= 10 and "as its eigenvalues say" in end.reason
    rates = lambda z, b: np.array(saddle_focus(z, b))  # noqa: E731
    assert end.error < 1e-11 and inside(end, rates, [0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [1.0] * 3, least=1e-12)


@pytest.mark.slow
def test_a_saddle_node_on_the_cycle_of_a_nerve():
    """phi = 0.0667: where the current that holds the voltage is largest."""
    family = from_hopf(morris_lecar(0.0667), [-60.0, 0.0], "I", 150.0)
    end = end_of(family, "saddle-node")

    def held(v):
        opening = (1 + np.tanh((v + 1.2) / 18)) / 2
        return 2 * (v + 60) + 4 * opening * (v - 120) + 4 * (1 + np.tanh((v - 12) / 17.4)) * (v + 84)

    most = minimize_scalar(lambda v: -held(v), bracket=(-35.0, -29.0, -25.0), tol=1e-12)
    assert abs(end.parameter + most.fun) < 1e-12 * end.parameter and end.error < 1e-11
    assert end.saddles[0]["state"][0] == pytest.approx(most.x, abs=1e-5)
    assert min(np.abs(np.array(end.saddles[0]["eigenvalues"]) @ [1, 1j])) < 1e-9
    assert all(check.passed for name, check in verified(family, morris_lecar(0.0667)) if name.startswith("end"))


def test_fish_and_sharks_end_at_two_saddles():
    """AUTO's pp2: its cycles of period 12, 20 and 36, and the connection between two states without sharks."""
    wanted = {12 + 8 * k + 8 * (k == 2): one["q"] for k, one in enumerate(
        next(entry for entry in CYCLES if entry["id"] == "pp2")["points"])}  # fmt: skip

    def rates(z, q):
        return np.array([3 * z[0] * (1 - z[0]) - z[0] * z[1] - q * (1 - np.exp(-5 * z[0])), -z[1] + 3 * z[0] * z[1]])

    def field(_, x, p):
        return [3 * x.f * (1 - x.f) - x.f * x.s - p.q * (1 - ca.exp(-5 * x.f)), -x.s + 3 * x.f * x.s]

    model = of.ode(field, ["f", "s"], {"q": 0.6})
    family = from_hopf(model, [1 / 3, 0.4], "q", 0.75, at=list(wanted.values()), until=0.72)
    periods = {point.value: point.period for point in family.points if point.role == "at"}
    for period, q in wanted.items():  # ten digits of q, by the slope of T = -log(0.708073 - q) / 0.2211
        assert periods[q] == pytest.approx(period, abs=1e-10 / (0.2211 * (0.708073 - q)))
    for point in family.points:  # and q at the very period, by the family's own slope
        if point.role == "at":
            off = (round(point.period) - point.period) * point.tangent[-1] / point.tangent[-2]
            assert point.value + off == pytest.approx(wanted[round(point.period)], abs=1e-10)
    end = end_of(family, "heteroclinic")
    states = np.array(sorted(saddle["state"] for saddle in end.saddles))
    assert states == pytest.approx(np.array([[0.127625, 0.0], [0.651806, 0.0]]), abs=1e-6)
    assert (
        "heteroclinic cycle of the saddles" in end.reason
        and "exp(-0.2211 T) where eigenvalues say 0.2211" in end.reason
    )
    assert end.error < 1e-11 and inside(end, rates, [0.65, 0.0], [0.0, 1.0], [1.0, 1.0], goal=[0.1276, 0.0], far=0.1)


def test_a_heteroclinic_cycle_by_symmetry():
    """x'' = -x + x^3 + (p - x^2) x': from -1 to 1 and back, alike; a family between two ends."""

    def rates(z, p):
        return np.array([z[1], -z[0] + z[0] ** 3 + z[1] * (p - z[0] ** 2)])

    model = of.ode(lambda _, x, p: list(ca.vertsplit(ca.vertcat(x.v, -x.x + x.x**3 + x.v * (p.p - x.x**2)))),
                   ["x", "v"], {"p": 0.05})  # fmt: skip
    family = of.follow_family(of.Problem(model, of.Guess([0.42, 0.0], 6.7)), "p", settings=QUIET, model=model)
    end = end_of(family, "heteroclinic")
    assert sorted(round(saddle["state"][0], 9) for saddle in end.saddles) == [-1.0, 1.0]
    assert inside(end, rates, [-1.0, 0.0], [0.0, 1.0], [1.0, 1.0], goal=[1.0, 0.0], least=2e-13)


@pytest.mark.slow
def test_three_saddles():
    """J. Guckenheimer and P. Holmes' cycle, whose saddles a small push e keeps apart: it is there at e = 0."""

    def field(_, x, p):
        return [one * (1 - one**2 - 0.55 * two**2 - 1.5 * three**2) + p.e
                for one, two, three in ((x.x, x.y, x.z), (x.y, x.z, x.x), (x.z, x.x, x.y))]  # fmt: skip

    model = of.ode(field, ["x", "y", "z"], {"e": 1e-3})
    state = list(of.simulate(model, [0.9, 0.1, 0.01], 400.0).states[-1])
    settings = replace(QUIET, directions="backward", longest_period=4.0)
    family = of.follow_family(of.Problem(model, of.Guess(state, 29.855)), "e", settings=settings, model=model)
    end = next(end for end in family.ends if end.kind == "heteroclinic")
    assert len(end.saddles) == 3 and abs(end.parameter) <= end.error < 1e-12


def test_a_pendulum_ends_at_the_energy_of_its_saddle():
    """Upright: 4.9 J, eigenvalues of both signs; and nothing is extrapolated."""
    family = of.follow_family(
        of.Problem(of.chain(1), of.Guess([0.5, 0.0], 1.64)), settings=replace(QUIET, directions="forward")
    )
    end = next(end for end in family.ends if end.kind == "homoclinic")
    assert abs(end.parameter - 4.9) <= end.error < 1e-13 and "settling" not in end.reason
    assert end.saddles[0]["state"] == pytest.approx([np.pi, 0.0])
    assert all(check.passed for _, check in verified(family, of.chain(1)))


PERIODS = 3.0 * 1.05 ** np.arange(70)


@pytest.mark.parametrize("eigenvalues, value", [
    ([[-3.0, 1.0]], lambda t: np.exp(-t) - 0.7 * np.exp(-2 * t)),
    ([[-0.5, 1.2]], lambda t: 2 * np.exp(-0.5 * t) + 5 * np.exp(-1.2 * t)),
    ([[-0.6 - 1.3j, -0.6 + 1.3j, 0.8]], lambda t: np.exp(-0.6 * t) * np.cos(1.3 * t + 0.4) + 3 * np.exp(-0.8 * t)),
    ([[-2.0, 1.0], [-2.0, 1.0]], lambda t: np.exp(-t / 2) + np.exp(-t)),
    ([[-1.0, 0.5], [-2.0, 0.7]], lambda t: np.exp(-0.5 * t / (1 + 1 / 0.7))),
])  # fmt: skip
def test_limits_of_known_series(eigenvalues, value):
    """One saddle, its nearest eigenvalue of either sign or complex; two alike; a cycle of which a connection breaks."""
    known = [np.array(values, complex) for values in eigenvalues]
    for most in (40, 55, 70):
        limit, error, words = homoclinic_limit(PERIODS[:most], 0.3 + value(PERIODS[:most]), known, 1e-15)
        assert abs(limit - 0.3) <= error < 0.05, (most, limit, error)
        assert "settling with" in words
    assert error < 1e-9


def test_another_rate_than_the_eigenvalues():
    """The orbits' own rate is taken, and their distance from the limit is its error; the words give both."""
    values = 0.3 + np.exp(-0.2 * PERIODS)
    limit, error, words = homoclinic_limit(PERIODS, values, [np.array([-3.0, 1.0], complex)], 1e-15)
    assert abs(limit - 0.3) <= error and "exp(-0.2 T) where eigenvalues say 1" in words
    assert np.isnan(settling(PERIODS[:3], values[:3], 1e-15)[0])  # three orbits say nothing


def test_the_exponents_of_passages():
    """The nearest eigenvalue first, sums with it, complex ones once; of two saddles those of broken connections."""
    (alone,) = passage_rates([np.array([-0.6 - 1.3j, -0.6 + 1.3j, 0.8])])
    assert alone[:2] == pytest.approx(np.array([0.6 + 1.3j, 0.8]))
    alike, first, second = passage_rates([np.array([-1.0469, 0.9554]), np.array([-0.6171, 0.3639])])
    assert alike[0] == pytest.approx(0.18195) and first[0] == pytest.approx(0.9554 / (1 + 1.0469 / 0.3639))
    assert second[0] == pytest.approx(0.3639 / (1 + 0.6171 / 0.9554))


def test_the_limit_at_a_saddle_node():
    """T = pi / sqrt(p - 1) + 2: within its error, which orbits nearer make less."""
    errors = []
    for most in (30, 50, 70):
        periods = PERIODS[:most] + 2
        limit, error = saddle_node_limit(periods, 1 + (np.pi / PERIODS[:most]) ** 2, 1e-15)
        assert abs(limit - 1) <= error
        errors.append(error)
    assert errors[2] < 1e-3 * errors[0]


def test_too_few_orbits_say_nothing():
    """Of one or two orbits the last value is the limit, with no bound on its error."""
    assert extrapolated(PERIODS[:2], np.array([1.0, 0.9]), np.array([1.0]), 1e-15) == (0.9, np.inf)


@pytest.fixture(scope="module")
def scaled_loop():
    """Sandstede's loop with y stretched, b y / 2 in its place, which is homoclinic at a = 0 for every b."""

    def field(_, x, p):
        return [-x.x + p.b * x.y + x.x**2, (2 - p.a) * x.x - x.y - 3 * x.x**2 + 1.5 * x.x * x.y]

    model = of.ode(field, ["x", "y"], {"a": 0.2, "b": 2.0})
    return model, from_hopf(model, [0.9, 0.9], "a", 0.5)


def test_a_large_period_stands_for_a_curve_of_homoclinic_orbits(scaled_loop, tmp_path):
    """At a fixed period a stays within exp(-T) or so of 0 while b varies; its file loads and verifies."""
    model, family = scaled_loop
    point = min(family.points, key=lambda point: abs(point.period - 20))
    settings = replace(QUIET, beside="a")
    curve = of.follow_family(point, "b", points=6, settings=settings, model=model, out=tmp_path, name="large")
    assert np.ptp(curve.values("period")) == 0.0 and curve.points[0].period == pytest.approx(point.period, rel=1e-6)
    assert np.ptp(curve.values("value")) > 0.05
    assert all(0 < one.free["a"] < 1e-6 for one in curve.points)
    known = of.load_family(tmp_path / "large" / "family.json")
    assert all(check.passed for _, check in verified(known, model))
    again = of.follow_family(known.points[0], "a", settings=QUIET, model=model)
    end = next(end for end in again.ends if end.kind == "homoclinic")
    assert abs(end.parameter) <= end.error < 1e-10


def test_what_cannot_be_freed_beside(scaled_loop):
    """A name that is none, the same, an energy that is kept, and a forcing's period."""
    model, family = scaled_loop
    for beside in ("c", "b"):
        with pytest.raises(of.errors.InputError, match=f"beside: '{beside}': use one of a"):
            of.follow_family(family.points[0], "b", settings=replace(QUIET, beside=beside), model=model)
    swing = of.Problem(of.chain(1), of.Guess([0.5, 0.0], 1.64))
    with pytest.raises(of.errors.InputError, match="keeps its energy; use hold"):
        of.follow_family(swing, "gravity", settings=replace(QUIET, beside="l1"))
    driven = of.systems.forced_duffing(frequency=1.4)
    with pytest.raises(of.errors.InputError, match="its forcing has the period"):
        of.follow_family(of.Problem(driven, of.Guess([-0.4, 0.0], 4.48799)), "force",
                         settings=replace(QUIET, beside="damping"), model=driven)  # fmt: skip
