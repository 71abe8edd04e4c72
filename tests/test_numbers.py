"""Numbers that a person reads off a family: extents of the motion itself, by closed forms and by other integrators."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import orbitfinder as of
from orbitfinder.families.entries import KINDS
from orbitfinder.families.members import extents, norms
from orbitfinder.families.registry import EventKind, Look
from orbitfinder.families.registry import Test as Vanishing
from orbitfinder.integrate.extent import extent
from orbitfinder.loops.watch import mean, range_of


def spike(t):
    """A peak of 50 some hundredth of the period wide, and its rate."""
    return 1 / (1.02 + np.cos(t - 0.711)), np.sin(t - 0.711) / (1.02 + np.cos(t - 0.711)) ** 2


@pytest.mark.parametrize("rated", [True, False])
def test_extrema_lie_between_samples(rated):
    """Of a stack of motions at unequal steps at once, of order h^8, or of each by its values alone, of order h^7; a
    constant stays itself."""
    worst = []
    for count in (240, 480):
        shares = np.linspace(0.0, 1.0, count + 1)
        t = 2 * np.pi * np.stack([shares + 0.03 * np.sin(2 * np.pi * k * shares) / k for k in (1, 2)])
        x, rates = (np.stack([*both], axis=-1) for both in ((spike(t)[0], 0 * t + 5.0), (spike(t)[1], 0 * t)))
        found = extent(t, x, rates) if rated else np.array([range_of(*each) for each in zip(t, x, strict=True)])
        assert found.shape == (2, 2, 2) and found[..., 1] == pytest.approx(5.0, rel=1e-14)
        worst.append(np.abs(found[..., 0] / [1 / 2.02, 50.0] - 1).max())
    assert worst[0] < (1e-7 if rated else 1e-5) and worst[1] < worst[0] / 60


def test_means_of_graded_motions():
    """The mean of exp(3 sin t) is I_0(3), of unequal steps too."""
    shares = np.linspace(0.0, 1.0, 241)
    for t in (2 * np.pi * shares, 2 * np.pi * (shares + 0.1 * np.sin(2 * np.pi * shares))):
        assert mean(t, np.exp(3 * np.sin(t))) == pytest.approx(4.880792585865024, rel=1e-10)


def relaxing(watch=None, points=1):
    """Van der Pol's oscillator at mu = 7, whose rate has spikes."""
    model = of.equations(rates={"x": "y", "y": "mu*(1-x^2)*y-x"}, parameters={"mu": 7.0})
    orbit = of.find_orbit(of.Problem(model, of.Guess([2.0, 0.0], 14.5)))
    return of.follow_family(orbit, "mu", points=points, watch=watch), model


@pytest.mark.slow
def test_columns_of_spikes_are_those_of_a_watch_and_of_dop853():
    """-0.16 % at mu = 7 by 960 samples: max_y is 10.243821."""
    family, model = relaxing({"peak": "max(y)", "low": "min(y)", "size": "sqrt(mean(x^2 + y^2))"})
    table = family.table()
    assert np.allclose(table["max_y"], table["peak"], rtol=1e-12, atol=0)
    assert np.allclose(table["min_y"], table["low"], rtol=1e-12, atol=0)
    assert np.allclose(table["amplitude_y"], (table["peak"] - table["low"]) / 2, rtol=1e-12, atol=0)
    assert np.allclose(norms(family, model)[: len(table["mu"])], table["size"], rtol=1e-12, atol=0)
    k = int(np.abs(np.asarray(table["mu"]) - 7.0).argmin())
    point, mu = family.points[k], float(table["mu"][k])

    def rates(t, x):
        return [x[1], mu * (1 - x[0] ** 2) * x[1] - x[0]]

    known = solve_ivp(rates, (0, point.period), point.state, "DOP853", rtol=1e-12, atol=1e-12,
                      events=lambda t, x: rates(t, x)[1])  # fmt: skip
    assert table["max_y"][k] == pytest.approx(known.y_events[0][:, 1].max(), rel=1e-10)
    assert table["max_y"][k] == pytest.approx(10.243821, rel=1e-5) and mu == 7.0


@pytest.mark.slow
def test_a_family_without_nodes_has_the_same_extents():
    """Its states alone are integrated where family.npz is missing."""
    family, model = relaxing()
    bare = replace(family, points=tuple(replace(p, mesh=np.zeros(0), shooting_nodes=p.shooting_nodes[:0])
                                        for p in family.points))  # fmt: skip
    assert np.allclose(extents(bare, model), extents(family, model), rtol=1e-8, atol=0)


@pytest.mark.slow
def test_stiff_spikes_are_radaus():
    """Collocated: 117845.778401 and 31263.844028 by SciPy's Radau at 1e-12; 960 samples were 0.4 and 0.9 % below."""
    rates = {"x": "s*(y-x*y+x-q*x^2)", "y": "(-y-x*y+z)/s", "z": "w*(x-z)"}
    model = of.equations(rates=rates, parameters={"s": 77.27, "q": 8.375e-6, "w": 0.161})
    orbit = of.find_orbit(of.Problem(model, of.Guess([490.0, 1.0, 490.0], 300.0)))
    family = of.follow_family(orbit, "s", points=1, watch={"top": "max(x)", "late": "max(z)"})
    table = family.table()
    k = int(np.abs(np.asarray(table["s"]) - 77.27).argmin())
    assert table["max_x"][k] == pytest.approx(117845.77840135, rel=1e-9)
    assert table["max_z"][k] == pytest.approx(31263.84402830, rel=1e-9)
    for column, number in (("max_x", "top"), ("max_z", "late")):
        assert np.allclose(table[column], table[number], rtol=1e-12, atol=0)


@pytest.mark.slow
def test_bursts_are_dop853s():
    """Hindmarsh and Rose's: the greatest of many spikes, which 960 samples miss by 0.7 %."""
    constants = {"I": 2.004469}
    model = of.equations(
        rates={"x": "y-x^3+3*x^2-z+I", "y": "1-5*x^2-y", "z": "0.01*(4*(x+1.6)-z)"}, parameters=constants
    )

    def field(t, u):
        x, y, z = u
        return [y - x**3 + 3 * x**2 - z + constants["I"], 1 - 5 * x**2 - y, 0.01 * (4 * (x + 1.6) - z)]

    turning = [lambda t, u: field(t, u)[0], lambda t, u: field(t, u)[2]]
    settled = solve_ivp(field, (0, 4000), [-1.3, -8.0, 1.0], "LSODA", rtol=1e-10, atol=1e-10).y[:, -1]
    known = solve_ivp(field, (0, 900), settled, "DOP853", rtol=1e-11, atol=1e-11, events=turning)
    first, (_, *laps) = known.y_events[1][0], zip(known.t_events[1], known.y_events[1], strict=True)
    period = min(t for t, u in laps if np.abs(u - first).max() < 1e-5) - known.t_events[1][0]
    problem = of.Problem(model, of.Guess(first, period), method="collocation")
    family = of.follow_family(problem, "I", points=1, watch={"top": "max(x)"})
    table = family.table()
    k = int(np.abs(np.asarray(table["I"]) - 2.004469).argmin())
    assert table["max_x"][k] == pytest.approx(known.y_events[0][:, 0].max(), rel=1e-8)
    assert table["max_x"][k] == pytest.approx(1.751669, abs=1e-5)
    assert np.allclose(table["max_x"], table["top"], rtol=1e-12, atol=0)


def test_the_table_has_the_amplitude_of_a_closed_form():
    """x'' + c x' + x = F cos w t: A = F / sqrt((1 - w^2)^2 + (c w)^2); by 960 samples it was off by some 1e-6."""
    model, (c, force, w) = of.systems.forced_duffing(1.0, 0.0, 0.2, 0.1, 0.9), (0.2, 0.1, 0.9)
    family = of.follow_family(of.Problem(model, of.Guess([0.3, 0.1], 2 * np.pi / w)), "frequency", points=1)
    w = family.values("frequency")
    known = force / np.sqrt((1 - w**2) ** 2 + (c * w) ** 2)
    for column in ("amplitude_x", "max_x"):
        assert np.allclose(family.table()[column], known, rtol=1e-10, atol=0)


def test_multipliers_of_samples_and_probes_are_those_of_the_period(monkeypatch):
    """Of what an event may read: the root map of x'' + c x' + x = F cos w t is half a period's."""
    seen = {"sample": [], "probe": []}

    def test(interval):
        seen["sample"].append((interval.first.solution.place.period, interval.first.multipliers, interval.first.about))
        return [Vanishing("on_time", "", lambda sample: sample.solution.place.period - 6.985)]

    def checked(sides, event):
        seen["probe"].append((sides.here.solution.place.period, sides.here.multipliers, sides.here.about))
        return sides.zero(lambda probe: probe.value("period") - 6.985)

    monkeypatch.setitem(KINDS, "on_time", EventKind(checked, "the period is 6.985 s", Look("$T$"), test=test))
    model = of.systems.forced_duffing(1.0, 0.0, 0.2, 0.1, 0.9)
    problem = of.Problem(model, of.Guess([0.3, 0.1], 2 * np.pi / 0.9))
    family = of.follow_family(problem, "frequency", points=1)
    assert [event.kind for event in family.events] == ["on_time"]
    for who in ("sample", "probe"):
        for period, multipliers, about in seen[who]:
            assert about.root == 2 and np.abs(multipliers) == pytest.approx(2 * [np.exp(-0.1 * period)], rel=1e-7)
            known = np.sort_complex(about.root_multipliers**2)
            assert np.sort_complex(multipliers) == pytest.approx(known, rel=1e-9)
