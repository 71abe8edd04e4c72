"""Collocation: order, derivatives, stiff cycles against the road's references, families, planted faults, messages."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicHermiteSpline

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families import birth
from orbitfinder.families.point import unknowns_of
from orbitfinder.families.stability import spectrum
from orbitfinder.families.verified import family_curve, verified
from orbitfinder.integrate.collocation import Collocation, tableau
from orbitfinder.integrate.compiled import compiling
from orbitfinder.integrate.march import uniform
from orbitfinder.loops import mesh
from orbitfinder.loops.condensed import Linearised, pivoted
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import correct
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.symmetry import NONE
from orbitfinder.orbits import collocate
from orbitfinder.orbits.closure import carried

ROAD = {entry["id"]: entry["values"] for entry in json.loads((Path(__file__).parent / "data/road.json").read_text())}
COLLOCATION = of.SolveSettings(method="collocation")
BARE = of.SolveSettings(method="collocation", with_certificate=False)


def van_der_pol(mu, units=(1.0, 1.0)):
    def field(t, x, p):
        x, v = x[0] / units[0], x[1] / units[1]
        return [units[0] * v, units[1] * (p[0] * (1 - x**2) * v - x)]

    return of.ode(field, ["x", "v"], {"mu": float(mu)})


def oregonator(f=1.0):
    def field(t, x, p):
        x, y, z = x[0], x[1], x[2]
        return [77.27 * (y - x * y + x - 8.375e-6 * x**2), (-y - x * y + p[0] * z) / 77.27, 0.161 * (x - z)]

    return of.ode(field, ["x", "y", "z"], {"f": f})


def steinmetz_larter(units=(1.0, 1.0, 1.0, 1.0)):
    def field(t, x, p):
        a, b, x, y = (x[k] / units[k] for k in range(4))
        chain, start = 0.1631021 * a * b * x, 0.046875 * a * b * y
        rates = [-chain - start + 1.5 - p[0] * a, -chain - start + 0.75,
                 chain - 2500 * x**2 + 2 * start - 20 * x + 0.001, -start + 2500 * x**2 - 1.104 * y]  # fmt: skip
        return [rate * unit for rate, unit in zip(rates, units, strict=True)]

    return of.ode(field, ["A", "B", "X", "Y"], {"km7": 0.1175})


def hindmarsh_rose():
    def field(t, x, p):
        return [x[1] - x[0] ** 3 + 3 * x[0] ** 2 - x[2] + p[0], 1 - 5 * x[0] ** 2 - x[1],
                0.005 * (4 * (x[0] + 1.6) - x[2])]  # fmt: skip

    return of.ode(field, ["x", "y", "z"], {"I": 2.0})


def brusselator(b=2.5):
    return of.ode(lambda t, x, p: [1 + x[0] ** 2 * x[1] - (p[0] + 1) * x[0], p[0] * x[0] - x[0] ** 2 * x[1]],
                  ["x", "y"], {"b": b})  # fmt: skip


def lorenz(rho):
    return of.ode(lambda t, x, p: [10 * (x[1] - x[0]), x[0] * (p[0] - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]],
                  ["x", "y", "z"], {"rho": rho})  # fmt: skip


def fitzhugh_nagumo():
    return of.ode(lambda t, x, p: [x[0] - x[0] ** 3 / 3 - x[1] + p[0], 0.08 * (x[0] + 0.7 - 0.8 * x[1])],
                  ["v", "w"], {"I": 0.5})  # fmt: skip


@cache
def found(name):
    """A stiff cycle from a start of two digits, as anybody finds it."""
    model, state, period = {
        "vdp-100": (van_der_pol(100), [2.0, 0.0], 160.0),
        "steinmetz-larter": (steinmetz_larter(), [2.5, 5.6, 0.024, 1.4], 16.0),
        "hindmarsh-rose": (hindmarsh_rose(), [-1.0, -4.0, 1.8], 160.0),
    }[name]
    method = None if name == "vdp-100" else "collocation"
    return of.find_orbit(of.Problem(model, of.Guess(state, period), name=name, method=method)), model


def inside(orbit, period, most):
    """The reference lies in the error bar, which is narrow."""
    bar = orbit.provenance["period_error"]
    return abs(orbit.period - float(period)) <= bar <= most * orbit.period


@pytest.mark.parametrize(("kind", "points", "order"), [("radau", 3, 5), ("radau", 5, 9), ("legendre", 4, 8)])
def test_steps_are_of_the_order_of_their_points(kind, points, order):
    usual = Equations(van_der_pol(1), NONE, ("mu",), action=True).march
    march = Collocation(usual.field, False, usual.integrand, False, points, kind)
    nodes, tail = np.array([[2.0, 0.1]]), np.array([2.0, 1.0])
    exact = usual.varied(nodes, uniform(1.0, 1, 400), tail)
    errors = []
    for steps in (4, 8, 16):
        path = march.varied(nodes, uniform(1.0, 1, steps), tail)
        errors.append(np.abs(path.ends - exact.ends).max())
        for name in ("transitions", "columns"):
            assert steps < 16 or np.allclose(getattr(path, name), getattr(exact, name), atol=1e-6), name
    slopes = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(slopes > order - 0.9), slopes
    rule = tableau(points, kind)
    assert abs(rule.weights @ rule.points ** (order - 1) - 1 / order) < 1e-14


def test_derivatives_are_those_of_differences():
    """Of a forced system too, whose moments move with the period."""
    model = of.ode(lambda t, x, p: [x[1], p[0] * np.cos(1.0) * t - x[0] ** 3 - 0.1 * x[1]], ["x", "v"], {"a": 0.3},
                   forcing_period=lambda p: 6.0)  # fmt: skip
    march = Equations(model, NONE, ("a",), action=True, by=Collocation).march
    random, mesh = np.random.default_rng(0), np.array([0.0, 0.2, 0.3, 0.6, 1.0])
    nodes, tail = random.normal(size=(4, 2)), np.array([3.0, 0.3])
    path, step = march.varied(nodes, mesh, tail), 1e-5
    with compiling("off"):
        slow = Collocation(march.field, True, march.integrand).varied(nodes, mesh, tail)
    for name in ("ends", "transitions", "columns", "integral"):
        assert np.allclose(getattr(path, name), getattr(slow, name), rtol=0, atol=1e-13), name
    for k in range(2):
        sides = [march.ends(nodes + s * np.eye(2)[k], mesh, tail) for s in (step, -step)]
        assert np.allclose((sides[0] - sides[1]) / (2 * step), path.transitions[:, :, k], atol=1e-8)
        sides = [march.ends(nodes, mesh, tail + s * np.eye(2)[k]) for s in (step, -step)]
        assert np.allclose((sides[0] - sides[1]) / (2 * step), path.columns[:, :, k], atol=1e-8)
    grown, none = (
        march.growths(nodes, tail, mesh[:-1] * 3.0, np.zeros(4)),
        march.growths(nodes, tail, mesh[:-1], np.full(4, 1e3)),
    )
    slopes = np.array([[[0.0, 1.0], [-3 * x**2, -0.1]] for x in nodes[:, 0]])
    assert np.allclose(grown, np.maximum(np.linalg.eigvals(slopes).real.max(axis=1), 0.0)) and not none.any()


def test_a_step_of_no_length_leaves_its_state_as_it_is():
    """It said "invalid value encountered in divide", with no place: warnings are errors here."""
    march = Equations(van_der_pol(1), NONE, ("mu",), by=Collocation).march
    nodes, mesh = np.random.default_rng(0).normal(size=(4, 2)), np.array([0.0, 0.2, 0.2, 0.6, 1.0])
    ends = march.ends(nodes, mesh, np.array([2.0, 1.0]))
    assert np.isfinite(ends).all() and np.array_equal(ends[1], nodes[1])


def test_a_driven_oscillator_is_collocated():
    """Nothing turns and no phase is free: the monodromy is not reduced. A quarter later is another t = 0."""
    for cosine, sine in ((1.0, 0.0), (0.0, 1.0)):
        model = of.ode(
            lambda t, x, p: [x[1], p[0] * ca.cos(t) + p[1] * ca.sin(t) - 0.2 * x[1] - x[0] - x[0] ** 3], ["x", "v"],
            {"a": cosine / 2, "b": sine / 2}, forcing_period=lambda p: 2 * np.pi,
        )  # fmt: skip
        orbit = of.find_orbit(of.Problem(model, of.Guess([0.4, 0.1], 2 * np.pi)), COLLOCATION)
        assert orbit.certificate.passed, orbit.certificate.failures
        assert np.prod(orbit.floquet_multipliers).real == pytest.approx(np.exp(-0.4 * np.pi), rel=1e-10)


@pytest.mark.parametrize("compiler", ["auto", "off"])
def test_the_whole_matrix_is_the_dense_one(compiler):
    random, (count, d, m) = np.random.default_rng(0), (7, 3, 2)
    sizes = (count, d, d), (count, d, m), (d + m, count * d), (d + m, d), (d + m, m)
    system = Linearised(*(random.normal(size=size) for size in sizes))
    rows = random.normal(size=count * d + m)
    assert np.abs(system.sparse().toarray() - system.matrix()).max() == 0.0
    with compiling(compiler):
        for columns in (None, 10.0 ** random.uniform(-3, 3, rows.size)):
            assert np.allclose(pivoted(system, columns)(rows), -np.linalg.solve(system.matrix(), rows), atol=1e-12)
        with pytest.raises(np.linalg.LinAlgError):
            pivoted(replace(system, first=system.first[:-1], last=system.last[:-1], tail=system.tail[:-1]))
        with pytest.raises(np.linalg.LinAlgError):
            pivoted(replace(system, first=0 * system.first, last=0 * system.last, tail=0 * system.tail))


def test_what_grows_and_decays_along_a_chain_is_solved_to_round_off():
    """Blocks of singular values from 1e-6 to 1e3 in directions that know nothing of each other, and rows over all."""
    random, (count, d, m) = np.random.default_rng(0), (130, 3, 2)
    turns = np.linalg.qr(random.normal(size=(2, count, d, d)))[0]
    blocks = turns[0] * 10.0 ** random.uniform(-6, 3, (count, 1, d)) @ turns[1]
    first = np.vstack([np.eye(d, count * d), random.normal(size=(m, count * d))])
    last = -np.eye(d + m, d)
    system = Linearised(blocks, random.normal(size=(count, d, m)), first, last, random.normal(size=(d + m, m)))
    rows, matrix = random.normal(size=count * d + m), system.matrix()
    step = pivoted(system)(rows)
    assert np.abs(matrix @ step + rows).max() < 1e-14 * (np.abs(matrix) @ np.abs(step)).max()


@pytest.mark.parametrize(
    ("name", "key"),
    [pytest.param("vdp-100", "period_quad", marks=pytest.mark.slow), ("steinmetz-larter", "period_quad")],
)
def test_stiff_cycles_of_the_road(name, key):
    orbit, _ = found(name)
    assert orbit.certificate.passed, orbit.certificate.failures
    assert inside(orbit, ROAD[name][key], 1e-12)
    assert orbit.provenance["method"] == "collocation"
    assert orbit.provenance.get("method_reason", "").startswith("stiff" if name == "vdp-100" else "")


@pytest.mark.slow
def test_what_shooting_does_not_find_is_collocated():
    """At 20, where it failed once, Newton's method on a mesh that fits the motion finds the cycle."""
    problem = of.Problem(van_der_pol(50), of.Guess([2.0, 0.0], 85.0))
    told = of.find_orbit(problem, of.SolveSettings(with_certificate=False)).provenance
    assert (told["method"], told["method_reason"].split(": ")[0]) == ("collocation", "shooting failed")


@pytest.mark.slow
def test_bursting_against_another_integrator():
    orbit, _ = found("hindmarsh-rose")
    assert orbit.certificate.passed, orbit.certificate.failures

    def rates(t, x):
        return [x[1] - x[0] ** 3 + 3 * x[0] ** 2 - x[2] + 2, 1 - 5 * x[0] ** 2 - x[1],
                0.005 * (4 * (x[0] + 1.6) - x[2])]  # fmt: skip

    normal = np.array(rates(0.0, orbit.state))

    def back(t, x):
        return (x - orbit.state) @ normal

    back.direction = 1.0
    path = solve_ivp(rates, (0.0, 1.01 * orbit.period), orbit.state, "Radau", events=back, rtol=1e-12, atol=1e-13)
    moments, states = path.t_events[0], path.y_events[0]
    near = moments[(np.abs(states - orbit.state).max(axis=1) < 1e-6) & (moments > 1.0)]
    assert abs(near[0] / orbit.period - 1) < 1e-10
    assert abs(orbit.period - 156.5755177223) < 1e-9


@pytest.mark.slow
def test_van_der_pol_at_10_and_1000():
    """Periods, amplitudes and error bars; the certificate at 1000 takes some seconds, and is among the slow tests."""
    for mu, period, amplitude in (
        (10, "period_quad", "amplitude_quad"),
        (1000, *("period_longdouble", "amplitude_longdouble")),
    ):
        orbit = of.find_orbit(of.Problem(van_der_pol(mu), of.Guess([2.0, 0.0], 1.6 * mu + 3)), BARE)
        assert inside(orbit, ROAD[f"vdp-{mu}"][period], 1e-12)
        x, v = orbit.samples.T
        k = int(np.flatnonzero((v[:-1] > 0) & (v[1:] <= 0))[0])
        peak = CubicHermiteSpline(orbit.times[k : k + 2], x[k : k + 2], v[k : k + 2])
        top = max(peak(peak.derivative().roots(extrapolate=False)))
        assert abs(top - float(ROAD[f"vdp-{mu}"][amplitude])) < 1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("model", "state", "period", "reference"), [
    (van_der_pol(1000), [2.0, 0.0], 1600.0, "1614.4011258083340251"),
    (oregonator(), [4.0, 1.1, 4.0], 300.0, "302.85804402758"),
])  # fmt: skip
def test_the_stiffest_are_certified(model, state, period, reference):
    orbit = of.find_orbit(of.Problem(model, of.Guess(state, period)))
    assert orbit.certificate.passed, orbit.certificate.failures
    assert inside(orbit, reference, 1e-12)


@pytest.mark.parametrize(("model", "state", "period"), [
    pytest.param(steinmetz_larter(), [2.5, 5.6, 0.024, 1.4], 16.0, marks=pytest.mark.slow),
    (brusselator(), [1.4, 3.0], 6.6), (van_der_pol(5), [2.0, 0.1], 11.6), (fitzhugh_nagumo(), [-0.3, -0.19], 39.5),
    pytest.param(lorenz(28.0), [-13.763610682134, -19.578751942451, 27.0], 1.5587, marks=pytest.mark.slow),
])  # fmt: skip
def test_shooting_and_collocation_agree(model, state, period):
    problem = of.Problem(model, of.Guess(state, period))
    shot, collocated = of.find_orbit(problem, of.SolveSettings(method="shooting")), of.find_orbit(problem, COLLOCATION)
    assert collocated.certificate.passed
    assert abs(collocated.period / shot.period - 1) < 1e-12
    assert np.allclose(shot.floquet_multipliers, collocated.floquet_multipliers, rtol=1e-8, atol=1e-9)


@pytest.mark.slow
def test_a_triple_pendulum_by_collocation():
    state = [0.207821287890159, 0.230046723844060, -1.448527525250897,
             -0.323636324707770, 0.146094757260416, 1.655339043727058]  # fmt: skip
    orbit = of.find_orbit(of.Problem(of.chain(3), of.Guess(state, 1.655), of.pin(energy=-38.351)), COLLOCATION)
    assert orbit.certificate.passed
    assert (
        abs(
            orbit.period - of.find_orbit(of.Problem(of.chain(3), of.Guess(state, 1.655), of.pin(energy=-38.351))).period
        )
        < 1e-12
    )


def test_multipliers_keep_their_size():
    """2.3e-17 beside nothing larger: a product of matrices has 1e-13 for it."""
    orbit = of.find_orbit(of.Problem(fitzhugh_nagumo(), of.Guess([-0.3, -0.19], 39.5)), BARE)
    told = float(next(one for one in ROAD["cyc-fhn"] if one["parameter"] == 0.5)["multipliers"][1])
    assert abs(orbit.floquet_multipliers[0].real / told - 1) < 1e-6


@pytest.mark.slow
def test_units_do_not_matter():
    plain = found("steinmetz-larter")[0]
    for units in ((1e-6, 1e3, 1.0, 1e6), (1e6, 1.0, 1e-6, 1e2)):
        state = np.array([2.5, 5.6, 0.024, 1.4]) * units
        orbit = of.find_orbit(of.Problem(steinmetz_larter(units), of.Guess(list(state), 16.0)), COLLOCATION)
        assert orbit.certificate.passed, orbit.certificate.failures
        assert abs(orbit.period / plain.period - 1) < 1e-12
        assert np.allclose(orbit.floquet_multipliers, plain.floquet_multipliers, rtol=1e-6, atol=1e-9)


def test_planted_faults_are_rejected():
    orbit, model = found("vdp-100")
    late = of.certify(replace(orbit, period=orbit.period * (1 + 1e-9)), model)
    assert "closure" in late.failures
    off = replace(orbit, samples=orbit.samples * [1.0, 1.001])
    assert "samples" in of.certify(off, model).failures


def test_a_mesh_that_is_too_coarse_is_refused(monkeypatch):
    monkeypatch.setattr(collocate, "FINEST", 100)
    with pytest.raises(ConvergenceError, match="on up to 100 intervals found no orbit"):
        of.find_orbit(of.Problem(van_der_pol(1000), of.Guess([2.0, 0.0], 1600.0)), COLLOCATION)


def test_what_is_said():
    problem = of.Problem(brusselator(), of.Guess([1.4, 3.0], 6.6))
    with pytest.raises(InputError, match="method: unknown 'colocation', did you mean 'collocation'"):
        of.find_orbit(replace(problem, method="colocation"))
    with pytest.raises(InputError, match="collocation is not for this problem, its pins leave 1 to choose"):
        of.find_orbit(of.Problem(of.chain(1), of.Guess([1.0, 0.0], 1.8)), COLLOCATION)
    with pytest.raises(InputError, match="impacts is not for this problem"):
        of.find_orbit(replace(problem, method="impacts"))
    with pytest.raises(ConvergenceError, match="the motion from guess.state comes to rest"):
        of.find_orbit(of.Problem(brusselator(1.5), of.Guess([1.4, 3.0], 6.6)), COLLOCATION)


@pytest.mark.slow
def test_a_family_grows_stiff_and_is_closed_by_the_second_integrator_on_the_way():
    """From mu = 1 to 1000, where at mu = 77 a closure takes more evaluations than a tame orbit's may."""
    problem = of.Problem(van_der_pol(1), of.Guess([2.0, 0.0], 6.7), method="collocation")
    family = of.follow_family(problem, "mu", until=1000.0, settings=of.FamilySettings(directions="forward"))
    assert family.ends[-1].kind == "target"
    assert abs(family.points[-1].period - float(ROAD["vdp-1000"]["period_longdouble"])) < 1e-10
    assert all(np.isfinite(point.closure) for point in family.points)


def test_a_family_is_followed_kept_and_verified(tmp_path):
    problem = of.Problem(van_der_pol(1), of.Guess([2.0, 0.0], 6.7), name="relaxation", method="collocation")
    settings = of.FamilySettings(directions="forward", longest_step=0.8)
    batches = []

    def stopped(batch):
        batches.append(batch)
        if len(batches) == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        of.follow_family(problem, "mu", until=10.0, at=[5.0], settings=settings, out=tmp_path, progress=stopped)
    family = of.follow_family(problem, "mu", until=10.0, at=[5.0], settings=settings, out=tmp_path)
    assert family.ends[-1].kind == "target"
    assert [point.value for point in family.points[1:5]] == [batch.points[-1].value for batch in batches[:4]]
    assert abs(family.points[-1].period - float(ROAD["vdp-10"]["period_quad"])) < 1e-11
    five = next(point for point in family.points if point.value == 5.0)
    assert abs(five.period - 11.612230667719588) < 1e-11
    assert all(point.closure < 1e-10 for point in family.points)
    loaded = of.load_family(tmp_path / "relaxation" / "family.json")
    assert loaded.curve["method"] == "collocation"
    again = of.follow_family(problem, "mu", until=10.0, at=[5.0], settings=settings, out=tmp_path)
    assert [point.period for point in again.points] == [point.period for point in family.points]


@pytest.mark.slow
def test_events_of_a_neuron_do_not_depend_on_units_and_phase():
    """Morris and Lecar's fold of cycles and its curve in two parameters, against shooting."""

    def neuron(units):
        def field(t, x, p):
            v, w = x[0] / units[0], x[1] / units[1]
            opened, wanted = (1 + ca.tanh((v + 1.2) / 18)) / 2, (1 + ca.tanh((v - 2) / 30)) / 2
            rate = (p[0] - 2 * (v + 60) - 4.4 * opened * (v - 120) - 8 * w * (v + 84)) / 20
            return [units[0] * rate, units[1] * p[1] * (wanted - w) * ca.cosh((v - 2) / 60)]

        return of.ode(field, ["V", "w"], {"I": 214.0, "phi": 0.04})

    base = of.find_orbit(of.Problem(neuron((1.0, 1.0)), of.Guess([0.0, 0.4], 74.0)))
    seen, curved = [], []
    for method, units, phase in (("shooting", (1.0, 1.0), 0.0), ("collocation", (1.0, 1.0), 0.0),
                                 ("collocation", (1e-3, 1e3), 0.37), ("collocation", (1e3, 1e-3), 0.7)):  # fmt: skip
        model, state = neuron(units), base.samples[int(phase * len(base.samples))] * units
        plain = units == (1.0, 1.0)
        settings = of.FamilySettings(method=method, directions="forward", first_step=0.1, points=16, certify=plain)
        family = of.follow_family(of.Problem(model, of.Guess(list(state), base.period)), "I", settings=settings)
        assert [event.kind for event in family.events] == ["fold", "stability_change"]
        seen.append([family.events[0].parameter, family.events[0].period])
        if not plain:
            continue
        assert all(event.certified for event in family.events)
        settings = of.FamilySettings(directions="forward", points=1, certify=False)
        curve = of.follow_curve(family, 0, ("phi", "I"), at=[0.0405], settings=settings, model=model)
        curved.append(next(point for point in curve.points if point.value == 0.0405).free["I"])
    assert np.allclose(seen, seen[0], rtol=2e-12, atol=0.0), seen
    assert abs(curved[0] / curved[1] - 1) < 2e-12


@pytest.mark.slow
def test_a_doubling_and_the_branch_there():
    model, state = lorenz(232.0), [2.32713547, -13.22001488, 191.94267052]
    settings = of.FamilySettings(directions="backward", method="collocation")
    family = of.follow_family(of.Problem(model, of.Guess(state, 0.478)), "rho", until=228.0, settings=settings)
    event = next(event for event in family.events if event.kind == "period_doubling")
    assert event.certified
    assert abs(event.parameter - 229.4067085) < 1e-7
    branch = of.follow_family(of.switch_branch(family, family.events.index(event), model=model), points=2, model=model)
    assert branch.curve["method"] == "collocation"
    assert all(abs(point.period / (2 * event.period) - 1) < 0.01 for point in branch.points)


def test_files_and_commands(tmp_path):
    (tmp_path / "p.py").write_text(
        "import orbitfinder as of\n"
        "def problem():\n"
        "    model = of.ode(lambda t, x, p: [x[1], p[0] * (1 - x[0]**2) * x[1] - x[0]], ['x', 'v'], {'mu': 3.0})\n"
        "    return of.Problem(model, of.Guess([2.0, 0.1], 8.9), name='p')\n"
    )
    run = CliRunner().invoke(
        cli, ["run", str(tmp_path / "p.py"), "--trust", "--method", "collocation", "--no-figures",
              "--out", str(tmp_path / "orbits")],
    )  # fmt: skip
    assert run.exit_code == 0, run.output
    orbit = of.load_orbit(tmp_path / "orbits" / "p" / "orbit.json")
    assert orbit.provenance["method"] == "collocation"
    assert orbit.provenance["method_reason"] == "asked for"
    (tmp_path / "q.toml").write_text(
        '[system]\nkind = "chain"\nlinks = 1\n[guess]\nstate = [1.0, 0.0]\nperiod = 1.8\n'
        '[find]\nmethod = "collocation"\npin = { energy = -1.0 }\n'
    )
    assert of.load_problem(tmp_path / "q.toml").method == "collocation"


def test_a_family_of_shooting_goes_on_by_collocation(tmp_path, monkeypatch):
    """Where shooting may take no more steps, here a few: what it followed is read by collocation and says why."""
    monkeypatch.setattr(mesh, "MESH", replace(mesh.MESH, most_steps=180))
    problem = of.Problem(brusselator(3.0), of.Guess([1.0, 2.0], 7.1), name="stiffer")
    settings = of.FamilySettings(directions="forward", longest_step=0.4, shortest_step=1e-3)
    alone = of.follow_family(problem, "b", until=5.0, settings=replace(settings, method="shooting"))
    assert alone.ends[-1].kind == "step underflow" and "method" not in alone.curve
    family = of.follow_family(problem, "b", until=5.0, at=[3.25], settings=settings, out=tmp_path)
    assert family.curve["method"] == "collocation" and family.ends[-1].reason == "reached b = 5.0"
    reason = family.curve["method_reason"]
    assert reason.startswith("shooting ended at b ") and "its mesh would become too fine" in reason
    assert np.all(np.diff(family.values("value")) > 0) and len(family.points) > len(alone.points)
    same = of.follow_family(replace(problem, method="collocation"), "b", until=5.0, at=[3.25], settings=settings)
    for value in (3.25, 5.0):
        periods = [next(p.period for p in each.points if p.value == value) for each in (family, same)]
        assert abs(periods[0] / periods[1] - 1) < 1e-12
    loaded = of.load_family(tmp_path / "stiffer" / "family.json")
    asked = next(point for point in loaded.points if point.value == 3.25)
    assert asked.certified and all(check.passed for _, check in verified(loaded, brusselator()))
    again = of.follow_family(problem, "b", until=5.0, at=[3.25], settings=settings, out=tmp_path)
    assert [point.period for point in again.points] == [point.period for point in family.points]


def test_cycles_are_born_by_collocation(monkeypatch):
    """Asked for, and where shooting finds none at the Hopf point."""
    model = brusselator(1.8)
    rest = of.follow_equilibria(model, [1.0, 1.8], "b", until=2.4)
    settings = of.FamilySettings(directions="away", method="collocation")
    asked = of.follow_family(of.switch_branch(rest, 0, settings=settings, model=model), "b", points=3, model=model)
    assert asked.curve["method"] == "collocation" and "method_reason" not in asked.curve
    cycle = birth._cycle

    def stiff(*given):
        if given[-1] is not Collocation:
            raise ConvergenceError("too stiff")
        return cycle(*given)

    monkeypatch.setattr(birth, "_cycle", stiff)
    other = of.follow_family(of.switch_branch(rest, 0, model=model), "b", points=3, model=model)
    assert other.curve["method_reason"] == "by shooting too stiff"
    assert [point.period for point in other.points] == [point.period for point in asked.points]
    with pytest.raises(ConvergenceError, match="too stiff"):
        of.switch_branch(rest, 0, settings=of.FamilySettings(method="shooting"), model=model)


def test_errors_do_not_outgrow_an_interval():
    """On the unit circle with w' = c w beside it, which grows exp(c h) times in a step: the rule has a pole at 6.29."""
    rule = tableau()
    sizes = np.array([1.0, np.log(30.0), 5.0, 7.0])
    assert np.abs(rule.amplified(sizes) * np.exp(-sizes) - 1) == pytest.approx([2.5e-9, 8.5e-4, 0.0688, 1.35], rel=0.02)
    assert rule.amplified(sizes)[3] < 0
    known, turn = 2 * np.pi, 2 * np.pi * np.arange(40) / 40
    nodes = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(40)])
    for size, fits in ((3.4, True), (5.0, False)):
        field = of.ode(lambda t, x, p: [-x[1], x[0], p[0] * x[2]], list("xyw"), {"c": size * 40 / known})
        march = Equations(field, NONE, (), by=Collocation).march
        place = nodes, uniform(1.0, 40, 1), np.array([known])
        assert march.fits(*place) is fits
        finer = march.regridded(*place)
        assert len(finer[0]) > 40 and march.fits(*finer, place[2])


def followed_from_a_hopf_point(side, until, points):
    """A family of the Oregonator from its right or left Hopf point."""
    model = oregonator(3.0)
    rest = of.follow_equilibria(model, [2.0, 2.0, 2.0], "f", until=0.3)
    settings = of.FamilySettings(
        directions="away", method="collocation", certify=False, longest_step=0.25, points=points
    )
    return of.follow_family(
        of.switch_branch(rest, side, settings=settings, model=model), until=until, settings=settings
    )


@pytest.mark.slow
def test_the_oregonator_passes_its_canard():
    """From the right Hopf point, where errors grow beyond 1e290, to the stable cycle of road.json at f = 1. Multipliers
    are known as well as they say: by those on meshes of twice as many intervals."""
    family = followed_from_a_hopf_point(0, 1.0, 600)
    assert [end.kind for end in family.ends] == ["target"] and not family.events
    last, scales = family.points[-1], [point.scale for point in family.points]
    assert last.value == 1.0 and abs(last.period - float(ROAD["oregonator"]["period_double"])) < 1e-6
    assert max(scales) == 1e290 and scales[0] < 1e3
    canard = [point.value for point in family.points if point.scale > 1e100]
    assert np.ptp(canard) < 1e-7 and abs(np.median(canard) - 1.5937725438) < 1e-9
    calm = [point.stability for point in family.points]
    turn = calm.index("asymptotically stable")
    assert {*calm[:turn]} <= {"unstable", "marginal"} and {*calm[turn:]} == {"asymptotically stable"}
    assert calm.count("marginal") <= 1 and calm[turn - 2] == "unstable"
    curve, told = family_curve(family, oregonator()), list[float]()
    for k in (turn - 4, turn, turn + 3, turn + 30):
        point, w = family.points[k], unknowns_of(curve, family.points[k])
        finer = mesh.regridded(curve.equations.gridded, w, 2 * len(w.nodes))
        other = correct(curve, finer, pinned(curve.equations, "period", point.period), finer, reach=10.0)
        apart = np.log(point.floquet_multipliers[0].real / spectrum(curve, other).floquet.multipliers[0].real)
        told.append(abs(apart) / point.multiplier_errors[0])
        assert point.multiplier_errors[1] == 1.0
    assert max(told) < 5.0


@pytest.mark.slow
def test_a_canard_is_no_homoclinic_orbit():
    """From the left Hopf point, past 20 times the shortest period, near no saddle: from 12 on slow orbits count as
    homoclinic. The normal form's small cycle takes some 30 points to the canard, at the longest step asked for, which
    is in sizes of the motion; along the canard `longest_stretch` lets the period grow 1.037 times per point."""
    family = followed_from_a_hopf_point(1, 0.6, 125)
    (end,) = family.ends
    assert end.kind == "point limit" and family.points[0].period > 20 * family.values("period").min()
    assert abs(family.points[0].value - 0.5005721483675) < 1e-11


def test_canards_leave_the_range_of_numbers():
    """Errors that grow beyond it do so infinitely, without a warning; others by the largest norm of what is left."""
    pieces, left, norms = np.random.default_rng(3).normal(size=(9, 3, 3)), np.eye(3), []
    for piece in pieces[::-1]:
        left = left @ piece
        norms.append(np.linalg.norm(left, 2))
    whole, grown = carried(list(pieces), np.ones(3))
    assert np.allclose(whole, left) and grown == pytest.approx(max(norms), rel=1e-13)
    last = np.diag([2.0, 0.1, 0.1])  # the whole, 1.5 I, is larger by Frobenius' norm alone
    assert carried([1.5 * np.linalg.inv(last), last], np.ones(3))[1] == pytest.approx(2.0, rel=1e-14)
    assert carried([np.diag([1e200, 1.0])] * 2, np.ones(2))[1] == np.inf


def test_another_orbit_may_have_had_the_mesh():
    """Stages that are carried on from far off lead nowhere; those from the nodes alone do."""
    equations = Equations(fitzhugh_nagumo(), NONE, (), action=True, by=Collocation)
    march, mesh_, tail = equations.march, uniform(1.0, 40, 1), np.array([39.0])
    angles = 2 * np.pi * mesh_[:-1, None]
    far, near = (size * np.hstack([np.cos(angles), np.sin(angles)]) for size in (40.0, 1.0))
    march.begin(near, 1e3 * np.ones((40, 5, 2)), mesh_, tail)
    assert np.isfinite(march.ends(near, mesh_, tail)).all() and far.size == near.size
