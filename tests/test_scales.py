"""A family is the same in any units, from any instant of its first orbit and from any of its orbits."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from conftest import inside

import orbitfinder as of
from orbitfinder.families.start import begin
from orbitfinder.loops.condensed import SMALL, Linearised, along_nodes, combined, eliminated, factorised
from orbitfinder.loops.scales import HARMONIC, Scales, sizes
from orbitfinder.mechanics.kind import with_parameters

SHIPPED = Path(__file__).parents[1] / "problems" / "gallery"


def rescaled(model, units, **given):
    """A first-order model with its components told in other units."""
    names, values = list(model.state_names), dict(zip(model.parameter_names, model.parameter_values, strict=True))
    scale = np.array(units, float)

    def field(t, x, p):
        parameters = ca.vertcat(*(p[k] for k in range(len(values))))
        rate = model.rate(t, ca.vertcat(*(x[k] * scale[k] for k in range(len(names)))), parameters)
        return [rate[k] / scale[k] for k in range(len(names))]

    return of.ode(field, names, values, **given)


def morris_lecar():
    def field(t, x, p):
        open_now = (1 + ca.tanh((x.V + 1.2) / 18)) / 2
        slow, pace = (1 + ca.tanh((x.V - 2) / 30)) / 2, ca.cosh((x.V - 2) / 60)
        current = p.current - 2 * (x.V + 60) - 4.4 * open_now * (x.V - 120) - 8 * x.n * (x.V + 84)
        return [current / 20, 0.04 * (slow - x.n) * pace]

    return of.ode(field, ["V", "n"], {"current": 100.0})


def self_excited(length=1.0):
    """x'' = -w^2 x + (mu - (x / L)^2) x' in SI, w = 100 1/s: amplitude about 2 L sqrt(mu), no fold anywhere."""
    x, v, mu = (ca.SX.sym(name) for name in ("x", "v", "mu"))
    symbols = of.Symbols(x, v, mu, ("mu",), (0.5,))
    return of.lagrange(v**2 / 2, 1e4 * x**2 / 2, symbols, forces=(mu - (x / length) ** 2) * v, names=["x"])


def seen(model, state, period, parameter, **given):
    """Kinds, values and periods of the events of a family, sorted; its kinds of ends."""
    family = of.follow_family(of.Problem(model, of.Guess(list(state), period)), parameter, **given)
    events = sorted((one.kind, one.parameter, one.period) for one in family.events if one.kind != "turn")
    return events, sorted(one.kind for one in family.ends)


def agree(first, second, digits=1e-8):
    """The same kinds, in order, and values to so many digits."""
    assert [one[0] for one in first[0]] == [one[0] for one in second[0]] and first[1] == second[1], (first, second)
    for one, other in zip(first[0], second[0], strict=True):
        assert np.allclose(one[1:], other[1:], rtol=digits, atol=0.0), (one, other)


@cache
def cycle():
    """Morris and Lecar's neuron at a current of 100 and its cycle, by simulation."""
    model = morris_lecar()
    settled = of.simulate(model, [-20.0, 0.1], 3000.0).states[-1]
    return model, "current", of.find_orbit(of.Problem(model, of.Guess(list(settled), 85.29)))


@cache
def branch():
    """Events and ends of the neuron's family as it is told in mV, from its own instant."""
    model, parameter, orbit = cycle()
    return seen(model, orbit.state, orbit.period, parameter, settings=PLAIN)


def at_phase(model, orbit, share):
    return of.simulate(model, orbit.state, orbit.period * share).states[-1] if share else orbit.state


PLAIN = of.FamilySettings(certify=False)
ML_FOLDS = (88.29325054, 216.89980139)


def test_a_neuron_has_its_two_folds_and_no_other():
    """0.2.0 met 212.28 and 92.85 in mV, where the cycle stops crossing a plane of constant V."""
    events, ends = branch()
    folds = [value for kind, value, _ in events if kind == "fold"]
    assert folds == pytest.approx(ML_FOLDS, rel=1e-9) and {kind for kind, *_ in events} == {"fold", "stability_change"}
    assert not any("underflow" in one for one in ends)


@pytest.mark.slow
@pytest.mark.parametrize("units", [(1e-6, 1.0), (1e6, 1.0), (1.0, 1e-6), (1.0, 1e6)])
def test_a_neuron_in_other_units(units):
    model, parameter, orbit = cycle()
    agree(branch(), seen(rescaled(model, units), orbit.state / units, orbit.period, parameter, settings=PLAIN))


@pytest.mark.slow
@pytest.mark.parametrize("eighth", [1, 2, 3, 4, 5, 6, 7])
def test_a_neuron_from_any_instant(eighth):
    model, parameter, orbit = cycle()
    agree(branch(), seen(model, at_phase(model, orbit, eighth / 8), orbit.period, parameter, settings=PLAIN))


@pytest.mark.slow
def test_a_neuron_from_another_orbit():
    model, parameter, orbit = cycle()
    near = of.follow_family(orbit, parameter, until=150.0, model=model, settings=PLAIN).points[-1]
    there = with_parameters(model, {"current": 150.0})
    agree(branch(), seen(there, near.state, near.period, parameter, settings=PLAIN))


HH_EVENTS = (  # of current, ../data/cycles.json
    ("fold", 6.2603212745), ("fold", 7.8423471202), ("fold", 7.9177854943),
    ("period_doubling", 7.8453373977), ("period_doubling", 7.9177776757),
)  # fmt: skip
HH_HOPF = (9.775437995393126, 154.522433665808)


@cache
def axon():
    """Hodgkin and Huxley's axon at a current of 10 and its cycle."""
    orbit = of.find_orbit(of.load_problem(SHIPPED / "hodgkin-huxley.toml"))
    return of.systems.hodgkin_huxley(), "current", orbit


def check_axon(model, state, period):
    family = of.follow_family(of.Problem(model, of.Guess(list(state), period)), "current")
    kinds = ("fold", "period_doubling")
    events = sorted((one for one in family.events if one.kind in kinds), key=lambda one: (one.kind, one.parameter))
    assert [one.kind for one in events] == [kind for kind, _ in HH_EVENTS]
    assert [inside(one, value, 5e-10) for one, (_, value) in zip(events, HH_EVENTS, strict=True)] == [True] * 5
    assert {one.kind for one in family.events} == {*kinds, "stability_change"}
    assert [one.kind for one in family.ends] == ["hopf", "hopf"]
    assert sorted(one.parameter for one in family.ends) == pytest.approx(HH_HOPF, rel=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("component", range(4))
@pytest.mark.parametrize("unit", [1e-6, 1e-3, 1e3, 1e6])
def test_an_axon_in_any_units(unit, component):
    """V in volts is one of them; 0.2.0 had two folds of one place, a false one and two step underflows."""
    model, _, orbit = axon()
    units = np.where(np.arange(4) == component, unit, 1.0)
    check_axon(rescaled(model, units), orbit.state / units, orbit.period)


@pytest.mark.slow
@pytest.mark.parametrize("eighth", range(8))
def test_an_axon_from_any_instant(eighth):
    model, _, orbit = axon()
    check_axon(model, at_phase(model, orbit, eighth / 8), orbit.period)


@cache
def butterfly():
    """Lorenz's attracting cycle at rho 240, before it doubles at 229.41."""
    model = of.systems.lorenz(rho=240.0)
    settled = of.simulate(model, [1.0, -40.0, 220.0], 60.0).states[-1]
    return model, of.find_orbit(of.Problem(model, of.Guess(list(settled), 0.467)))


@pytest.mark.slow
@pytest.mark.parametrize("units", [(1e-6, 1.0, 1.0), (1.0, 1e6, 1.0), (1.0, 1.0, 1e-6)])
def test_lorenz_in_any_units(units):
    model, orbit = butterfly()
    given = {"until": 200.0}
    plain = seen(model, orbit.state, orbit.period, "rho", **given)
    assert [one[1] for one in plain[0] if one[0] == "period_doubling"] == pytest.approx([229.4067085], rel=1e-9)
    agree(plain, seen(rescaled(model, units), orbit.state / units, orbit.period, "rho", **given))


@pytest.mark.slow
@pytest.mark.parametrize("eighth", [1, 3, 6])
def test_lorenz_from_any_instant(eighth):
    model, orbit = butterfly()
    given = {"until": 200.0}
    agree(seen(model, orbit.state, orbit.period, "rho", **given),
          seen(model, at_phase(model, orbit, eighth / 8), orbit.period, "rho", **given))  # fmt: skip


def masses(units=(1.0, 1.0, 1.0)):
    """Three masses on two hardening springs, free to drift: the place of the first and the two stretches."""
    q, v, hardening = ca.SX.sym("q", 3), ca.SX.sym("v", 3), ca.SX.sym("hardening")
    moved = [one * scale for one, scale in zip(ca.vertsplit(v), units, strict=True)]
    one, other = q[1] * units[1], q[2] * units[2]
    speeds = [moved[0], moved[0] + moved[1], moved[0] + moved[1] + moved[2]]
    kinetic = sum(mass * speed**2 for mass, speed in zip((1.0, 1.3, 0.8), speeds, strict=True)) / 2
    potential = one**2 / 2 + 0.7 * other**2 + hardening * (one**4 + other**4) / 4
    symbols = of.Symbols(q, v, hardening, ("hardening",), (0.3,))
    return of.lagrange(kinetic, potential, symbols, names=["base", "first", "second"])


@cache
def swinging(energy=0.05):
    """The slower mode of the masses at an energy."""
    model = masses()
    return of.find_orbit(of.Problem(model, of.guesses.normal_mode(model, 2, 0.3, np.zeros(3)), of.pin(energy=energy)))


RESONANCES = (1.151255059, 4.717562092)
"""Energies where the multipliers of the slower mode of the masses pass a root of unity"""


@cache
def resonant():
    events, ends = seen(masses(), swinging().state, swinging().period, "energy", until=6.0)
    assert [one[1] for one in events] == pytest.approx(RESONANCES, rel=1e-9) and ends == ["target"]
    return events, ends


@pytest.mark.slow
@pytest.mark.parametrize("units", [(1e-6, 1.0, 1.0), (1.0, 1e6, 1.0), (1.0, 1.0, 1e-6), (1e3, 1e-3, 1e6)])
def test_free_masses_in_any_units(units):
    state = swinging().state / np.tile(units, 2)
    agree(resonant(), seen(masses(units), state, swinging().period, "energy", until=6.0))


@pytest.mark.slow
@pytest.mark.parametrize("eighth", [1, 3, 6])
def test_free_masses_from_any_instant(eighth):
    model, orbit = masses(), swinging()
    agree(resonant(), seen(model, at_phase(model, orbit, eighth / 8), orbit.period, "energy", until=6.0))


@pytest.mark.slow
def test_free_masses_from_another_orbit():
    """From between the two resonances the one is met upwards, the other downwards."""
    far = of.follow_family(swinging(), "energy", until=3.0, model=masses()).points[-1]
    for until, which in ((6.0, 1), (0.05, 0)):
        events, ends = seen(masses(), far.state, far.period, "energy", until=until)
        agree((resonant()[0][which : which + 1], ["target"]), (events, ends))


@pytest.mark.parametrize("phase", [0.8, 2.0, 4.0])
@pytest.mark.parametrize("unit", [1e-2, 1.0, 1e2])
def test_the_normal_form_of_hopf_has_no_fold(unit, phase):
    """x' = mu x - y - x r^2, y' = x + mu y - y r^2: A = sqrt(mu), T = 2 pi; 0.2.0 met folds at 0.514 and 0.484."""

    def field(t, x, p):
        y = x.y * unit
        square = x.x**2 + y**2
        return [p.mu * x.x - y - x.x * square, (x.x + p.mu * y - y * square) / unit]

    model = of.ode(field, ["x", "y"], {"mu": 1.0})
    state = [np.cos(phase), np.sin(phase) / unit]
    family = of.follow_family(of.Problem(model, of.Guess(state, 2 * np.pi)), "mu", until=0.01)
    assert not family.events and family.ends[-1].kind == "target"
    amplitudes = [np.hypot(one.state[0], one.state[1] * unit) for one in family.points]
    assert amplitudes == pytest.approx([np.sqrt(one.value) for one in family.points], rel=1e-9)


@pytest.mark.parametrize("length", [1e-6, 1.0, 1e6])
def test_a_self_excited_machine_has_no_fold(length):
    """In SI, w = 100 1/s: rates are a hundred times the coordinates; 0.2.0 certified a fold at 0.256875."""
    model, size = self_excited(length), 2 * np.sqrt(0.5) * length
    guess = of.Guess([size * np.cos(0.8), -100.0 * size * np.sin(0.8)], 2 * np.pi / 100)
    family = of.follow_family(of.Problem(model, guess), "mu", until=0.01)
    assert not [one for one in family.events if one.kind != "turn"] and family.ends[-1].kind == "target"


def test_rows_over_all_nodes_condense_as_they_stand():
    """The condensed step of rows over every node is that of the whole matrix."""
    random = np.random.default_rng(28)
    count, size, extra, closing = 5, 3, 2, 5
    system = Linearised(
        random.normal(size=(count, size, size)), random.normal(size=(count, size, extra)),
        random.normal(size=(closing, count * size)), random.normal(size=(closing, size)),
        random.normal(size=(closing, extra)),
    )  # fmt: skip
    rows = random.normal(size=(count - 1) * size + closing)
    assert eliminated(system)(rows) == pytest.approx(-np.linalg.solve(system.matrix(), rows), rel=1e-9)


@pytest.mark.parametrize("growth", [1.0, 1e3])
def test_many_rows_are_factorised_along_the_nodes(growth):
    """Large nodes that follow from the first, unless segments grow too much for that, solve as they all do."""
    random = np.random.default_rng(33)
    count, size, extra = 5, 40, 2
    transitions = growth * random.normal(size=(count, size, size)) / np.sqrt(size)
    parts = (random.normal(size=shape) for shape in ((size + extra, count * size), (size + extra, size)))
    columns, tail = random.normal(size=(count, size, extra)), random.normal(size=(size + extra, extra))
    system = Linearised(transitions, columns, *parts, tail)
    matrix = system.matrix()
    right = random.normal(size=len(matrix))
    assert len(matrix) > SMALL and (along_nodes(system) is not None) is (growth == 1.0)
    known = pytest.approx(np.linalg.solve(matrix, right), rel=1e-7, abs=1e-9)
    assert factorised(matrix, (count, size))(right) == known
    assert factorised(system)(right) == known
    with pytest.raises(np.linalg.LinAlgError):
        factorised(system.bordered(right))


def test_jacobians_in_parts_combine_as_whole_ones():
    """Whatever nodes their closing rows are of; those of other segments do not."""
    random = np.random.default_rng(5)

    def made(count, nodes):
        sizes = (count, 3, 3), (count, 3, 2), (4, 3 * nodes), (4, 3), (4, 2)
        return Linearised(*(random.normal(size=size) for size in sizes))

    a, b = made(5, 5), made(5, 1)
    b = replace(b, last=a.last)  # the link that closes a loop does not change
    known = 1.5 * a.matrix() - 0.5 * b.matrix()
    np.testing.assert_allclose(combined(a, 1.5, b, -0.5).matrix(), known, atol=1e-13)
    np.testing.assert_allclose(combined(a.matrix(), 1.5, b.matrix(), -0.5), known, rtol=1e-14)
    assert combined(a, 1.5, made(4, 1), -0.5) is None and combined(a, 1.5, b.matrix(), -0.5) is None


def test_a_harmonic_motion_has_length_one_in_each_component():
    angle = np.linspace(0, 2 * np.pi, 401)
    states = np.column_stack([3.0 * np.cos(angle), 7e-6 * np.sin(angle) + 5.0])
    model = of.ode(lambda t, x, p: [-x.y, x.x], ["x", "y"])
    measured = sizes(model, np.ones(2), states, 1.0)
    assert measured == pytest.approx(np.array([6.0, 1.4e-5]) / HARMONIC, rel=1e-4)
    assert np.sqrt(np.mean(((states - states.mean(axis=0)) / measured) ** 2, axis=0)) == pytest.approx(1.0, rel=1e-2)


def test_no_size_falls_below_a_tenth_of_the_largest_that_a_family_has_had():
    start = begin(
        of.Problem(of.systems.brusselator(), of.Guess([0.5, 3.5], 7.157)), of.FamilySettings(parameter="rate")
    )
    place, scales = start.solution.place, start.curve.scales
    smaller = scales.renewed(1e-3 * scales.states, place)
    assert smaller.states == pytest.approx(0.1 * scales.states) and smaller.largest == pytest.approx(scales.states)
    assert isinstance(smaller, Scales) and smaller.free == pytest.approx([3.0])
