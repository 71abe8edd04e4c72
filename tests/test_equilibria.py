"""Equilibria along a parameter: closed forms, the road's references, units, planted faults, messages, files."""

import json
import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import verified

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.rest_problem import Stacked, regular, singular
from orbitfinder.integrate.jets import at_rest
from orbitfinder.show.equilibria import stretched


def morris_lecar(current=50.0, units=(1.0, 1.0)):
    """The Hopf class (road.json)."""

    def field(t, x, p):
        v, w = x[0] / units[0], x[1] / units[1]
        opened, wanted = (1 + ca.tanh((v + 1.2) / 18)) / 2, (1 + ca.tanh((v - 2) / 30)) / 2
        rate = (p[0] - 2 * (v + 60) - 4.4 * opened * (v - 120) - 8 * w * (v + 84)) / 20
        return [units[0] * rate, units[1] * 0.04 * (wanted - w) * ca.cosh((v - 2) / 60)]

    return of.ode(field, ["V", "w"], parameters={"I": current})


def hodgkin_huxley(current=0.0):
    """The squid's axon (road.json)."""

    def r(u):
        return u / (1 - ca.exp(-u))

    def field(t, x, p):
        v, m, h, n = (x[k] for k in range(4))
        rates = ((r((v + 40) / 10), 4 * ca.exp(-(v + 65) / 18)),
                 (0.07 * ca.exp(-(v + 65) / 20), 1 / (1 + ca.exp(-(v + 35) / 10))),
                 (0.1 * r((v + 55) / 10), 0.125 * ca.exp(-(v + 65) / 80)))  # fmt: skip
        ions = 120 * m**3 * h * (v - 50) + 36 * n**4 * (v + 77) + 0.3 * (v + 54.387)
        gates = [a * (1 - x) - b * x for (a, b), x in zip(rates, (m, h, n), strict=True)]
        return [p[0] - ions, *gates]

    return of.ode(field, ["V", "m", "h", "n"], parameters={"I": current})


def wing(speed=8.0, units=(1.0, 1.0, 1.0, 1.0)):
    """A section that flutters (road.json)."""

    def field(t, x, p):
        h, a, hd, ad = (x[k] / units[k] for k in range(4))
        flow, mass, arm, inertia = p[0], 12.387, 0.0333, 0.065
        e = a + hd / flow + 1.1 * 0.135 * ad / flow
        lift = 1.225 * flow**2 * 0.135 * 6.28 * e
        first, second = -lift - 27.43 * hd - 2844.4 * h, -0.1 * 0.135 * lift - 0.18 * ad - 2.82 * a - 100 * a**3
        det = mass * inertia - (mass * arm) ** 2
        rates = [hd, ad, (inertia * first - mass * arm * second) / det, (mass * second - mass * arm * first) / det]
        return [unit * rate for unit, rate in zip(units, rates, strict=True)]

    return of.ode(field, ["h", "a", "hd", "ad"], parameters={"U": speed})


def lorenz(rho):
    """sigma 10, beta 8/3."""
    return of.ode(
        lambda t, x, p: [10 * (x[1] - x[0]), x[0] * (p[0] - x[2]) - x[1], x[0] * x[1] - 8 / 3 * x[2]],
        ["x", "y", "z"], parameters={"rho": rho},
    )  # fmt: skip


ROAD = [
    (of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", 2.4, [(2.0, 6.2831853071795864769, -0.5)]),
    (morris_lecar(), [-40.0, 0.05], "I", 250.0,
     [(93.857618373725453244, 78.756609546026914898, 0.0065431867216735509915),
      (212.01881610037436819, 42.281921426198822313, 0.0036682920464783092042)]),
    (of.ode(lambda t, x, p: [x[0] - x[0] ** 3 / 3 - x[1] + p[0], 0.08 * (x[0] + 0.7 - 0.8 * x[1])], ["v", "w"],
            parameters={"I": 0.0}), [-1.2, -0.6], "I", 2.0,
     [(0.33128133745474581444, 22.805916865386006743, 0.97197108198899900511),
      (1.4187186625452541886, 22.805916865386006743, 0.97197108198899900511)]),
    (hodgkin_huxley(), [-65.0, 0.05, 0.6, 0.32], "I", 180.0,
     [(9.7754379953931263325, 10.717882807935417309, 0.014793648131008077780),
      (154.52243366580800086, 5.9112394413376591390, -0.0047285026950739886382)]),
    (lorenz(20.0), [7.0, 7.0, 19.0], "rho", 28.0,
     [(24.736842105263157895, 0.65283034762050792172, 0.00026551897258367142884)]),
    (wing(), [0.0, 0.0, 0.0, 0.0], "U", 20.0, [(12.107499918147065304, 0.47495058539320813354, 0.062767355546514436)]),
]  # fmt: skip


@pytest.mark.parametrize("model, state, parameter, until, wanted", ROAD, ids="bmfhlw")
def test_the_hopf_points_of_the_road(model, state, parameter, until, wanted):
    """Parameter, period and first Lyapunov coefficient of 30 digits lie within error bars that are small."""
    found = of.follow_equilibria(model, state, parameter, until=until)
    assert found.ends[-1].kind == "target" and found.points[-1].value == until
    assert all(point.certified for point in found.points)
    assert [event.kind for event in found.events] == ["hopf"] * len(wanted)
    for event, (value, period, coefficient) in zip(found.events, wanted, strict=True):
        assert abs(event.parameter - value) <= event.error <= 1e-12 * max(1, abs(value)) * 2
        assert abs(event.period - period) <= event.period_error <= 1e-12 * period
        assert abs(event.lyapunov - coefficient) <= event.lyapunov_error <= 1e-9 * abs(coefficient)
        assert event.criticality == ("supercritical" if coefficient < 0 else "subcritical") and event.check.passed
    assert verified(found, model).passed


def test_units_change_nothing():
    """Each component in units of its own: the same points and events."""
    plain = of.follow_equilibria(morris_lecar(), [-40.0, 0.05], "I", until=250.0)
    for units in ((1e-6, 1e6), (1e6, 1e-6)):
        other = of.follow_equilibria(morris_lecar(50.0, units), np.array([-40.0, 0.05]) * units, "I", until=250.0)
        assert [event.kind for event in other.events] == ["hopf", "hopf"]
        assert np.allclose([e.parameter for e in other.events], [e.parameter for e in plain.events], rtol=1e-12)
        assert [e.criticality for e in other.events] == [e.criticality for e in plain.events]
        assert all(point.certified for point in other.points) and verified(other, morris_lecar(50.0, units)).passed
    still = of.follow_equilibria(wing(8.0, (1e-6, 1e3, 1e6, 1e-3)), np.zeros(4), "U", until=20.0)
    assert abs(still.events[0].parameter - 12.107499918147065304) < 1e-12


def test_folds_branch_points_and_neutral_saddles(tmp_path):
    """A cubic's folds at +-2 / (3 sqrt 3); the pitchfork of Lorenz at 1; a saddle whose eigenvalues are +-a."""
    cubic = of.ode(lambda t, x, p: [p[0] + x[0] - x[0] ** 3], ["x"], parameters={"r": -1.0})
    found = of.follow_equilibria(cubic, [-1.3], "r", until=1.0)
    assert [event.kind for event in found.events] == ["fold", "fold"]
    again = of.load_equilibria(of.save_equilibria(found, tmp_path / "equilibria.json"))  # all eigenvalues are real
    assert all(a.eigenvalues == b.eigenvalues for a, b in zip(again.points, found.points, strict=True))
    for event, sign in zip(found.events, (1, -1), strict=True):
        assert abs(event.parameter - sign * 2 / 27**0.5) <= event.error < 1e-14
        assert abs(event.state[0] + sign / 3**0.5) < 1e-14 and event.check.passed
    assert [point.stability for point in found.points].count("unstable") > 5 and found.points[-1].stability == "stable"
    origin = of.follow_equilibria(lorenz(0.2), [0.0, 0.0, 0.0], "rho", until=28.0)
    assert [event.kind for event in origin.events] == ["branch_point", "neutral_saddle"]
    assert abs(origin.events[0].parameter - 1.0) < 1e-13
    across = origin.events[0].direction
    assert abs(across[0] - across[1]) < 1e-12 * abs(across[0]) and abs(across[3]) < 1e-12 * abs(across[0])
    # the z eigenvalue -8/3 against the positive one of the block (-10, 10; rho, -1): 10 rho = (8/3 + 10) (8/3 + 1)
    assert abs(origin.events[1].parameter - (8 / 3 + 10) * (8 / 3 + 1) / 10) < 1e-12
    assert verified(origin, lorenz(0.2)).passed


def test_mechanics_rest_with_gravity_constraints_and_symmetries():
    """A bead on a hoop leaves the bottom at spin^2 = g / r; a DAE's eigenvalues are those of the chain."""
    hoop = of.systems.rotating_hoop(spin=2.0)
    found = of.follow_equilibria(hoop, [0.0, 0.0], "spin", until=5.0)
    assert [event.kind for event in found.events] == ["branch_point"]
    assert abs(found.events[0].parameter - 9.8**0.5) <= 1e-13 and found.points[0].stability == "neutral"
    chain, dae = of.chain(2), of.chain_dae(2)
    lifted = dae.constraint.lift([0.0, 0.0], [0.0, 0.0], dae.parameter_values).full().ravel()
    one = of.follow_equilibria(chain, np.zeros(4), "mass2", until=2.0)
    other = of.follow_equilibria(dae, lifted, "mass2", until=2.0)
    for a, b in ((one.points[0], other.points[0]), (one.points[-1], other.points[-1])):
        assert np.allclose(np.sort(a.eigenvalues.imag), np.sort(b.eigenvalues.imag), atol=1e-9)
    cart = of.systems.pendulum_on_cart()
    free = of.follow_equilibria(cart, np.zeros(4), cart.parameter_names[0], points=5)
    assert all(len(point.eigenvalues) == 2 for point in free.points)


def test_derivatives_are_those_of_differences():
    """Of the extended systems of all kinds."""
    model, state, value = morris_lecar(93.0), np.array([-25.3, 0.139]), np.array([93.0])
    problem = regular(at_rest(model, ("I",), state), state, value)
    for kind in ("fold", "hopf", "branch_point"):
        extended, guess = singular(problem, state + 0.5, value, kind)
        start = Stacked(guess.vector * (1 + 0.01 * np.random.default_rng(1).normal(size=guess.vector.size)))
        linear = extended.linearise(start)[1]
        for k, size in enumerate(extended.sizes):
            step = np.zeros(extended.sizes.size)
            step[k] = 1e-5 * size
            slope = (extended.rows(start.moved(step)) - extended.rows(start.moved(-step))) / 2e-5
            assert np.allclose(slope, linear.matrix[:, k], rtol=1e-6, atol=1e-6), (kind, k)


def test_a_simulation_leads_to_rest_and_a_cycle_does_not():
    """From far away; where nothing rests that a motion comes to, a sentence says so."""
    found = of.follow_equilibria(morris_lecar(50.0), [60.0, 0.9], "I", points=2)
    assert abs(found.points[0].state[0]) < 60 and found.points[0].certified
    nowhere = of.ode(lambda t, x, p: [1 + x[0] ** 2 + p[0] ** 2], ["x"], parameters={"r": 1.0})
    with pytest.raises(ConvergenceError, match="no equilibrium: Newton's method finds none near the state"):
        of.follow_equilibria(nowhere, [0.0], "r")


def test_planted_faults_are_seen():
    """A state that does not rest, an eigenvalue, a verdict, a Hopf point elsewhere."""
    model = of.systems.brusselator(rate=1.8)
    found = of.follow_equilibria(model, [1.0, 1.8], "rate", until=2.4)
    assert verified(found, model).passed
    first, event = found.points[0], found.events[0]
    wrong = {
        "rates": replace(first, state=first.state + 1e-9),
        "eigenvalues": replace(first, eigenvalues=first.eigenvalues * (1 + 1e-5)),
        "verdicts": replace(first, stability="unstable"),
    }
    for name, point in wrong.items():
        assert name in verified(replace(found, points=(point, *found.points[1:])), model).failures
    moved = replace(event, frequency=event.frequency * 1.001, critical=event.critical * 1.001)
    assert verified(replace(found, events=(moved,)), model).failures == ("critical eigenvalues",)
    for other in (replace(event, critical=event.critical * 1.001), replace(event, kind="fold")):
        assert "verdicts" in verified(replace(found, events=(other,)), model).failures


def test_both_ways_are_gone_and_a_journal_goes_on(tmp_path):
    """Without until; a run with more points begins where the shorter one ended, with the same numbers."""
    model = of.systems.brusselator(rate=1.8)
    both = of.follow_equilibria(model, [1.0, 1.8], "rate", points=8)
    values = [point.value for point in both.points]
    assert values == sorted(values) and len(values) == 15 and [end.kind for end in both.ends] == ["point limit"] * 2
    short = of.follow_equilibria(model, [1.0, 1.8], "rate", until=2.4, points=4, out=tmp_path)
    assert len(short.points) == 4
    longer = of.follow_equilibria(model, [1.0, 1.8], "rate", until=2.4, out=tmp_path)
    whole = of.follow_equilibria(model, [1.0, 1.8], "rate", until=2.4)
    assert [p.value for p in longer.points] == [p.value for p in whole.points]
    assert longer.events[0].parameter == pytest.approx(whole.events[0].parameter, abs=1e-14)
    file = of.save_equilibria(longer, tmp_path / "equilibria.json")
    again = of.load_equilibria(file)
    assert [p.value for p in again.points] == [p.value for p in longer.points]
    assert again.events[0].lyapunov == longer.events[0].lyapunov and verified(again, model).passed


def test_pictures_change_their_line_at_the_event():
    """Stretches of one stability meet where it changes."""
    cubic = of.ode(lambda t, x, p: [p[0] + x[0] - x[0] ** 3], ["x"], parameters={"r": -1.0})
    found = of.follow_equilibria(cubic, [-1.3], "r", until=1.0)
    places = sorted((*found.points, *found.events), key=lambda place: place.arclength)
    parts = stretched(places)
    assert [stable for _, stable in parts] == [True, False, True]
    meets = [places[part.stop - 1] for part, _ in parts[:-1]]
    assert meets == list(found.events) and [places[part.start] for part, _ in parts[1:]] == meets


@pytest.mark.parametrize("change, message", [
    ({"model": of.systems.forced_duffing()}, "model: depends on time, so that it has no equilibria"),
    ({"model": of.systems.rimless_wheel()}, "model: jumps, so that it has no equilibria"),
    ({"parameter": "rat"}, "parameter: unknown 'rat'.* did you mean 'rate'"),
    ({"until": float("nan")}, "until: must be a finite value of rate, got nan"),
    ({"until": 1.8}, "until: 1.8 is where rate begins"),
    ({"points": 0}, "points: must be at least 1, got 0"),
    ({"state": [1.0]}, "state: 1 numbers for 2 components"),
])  # fmt: skip
def test_messages(change, message):
    """Field, value, remedy."""
    given = {"model": of.systems.brusselator(rate=1.8), "state": [1.0, 1.8], "parameter": "rate"} | change
    with pytest.raises(InputError, match=message):
        of.follow_equilibria(**given)


def test_the_command(tmp_path):
    """It writes, is verified, shown and plotted; a file without a state is refused."""
    file = tmp_path / "own.toml"
    table = 'system = { kind = "python", function = "brusselator", arguments = { rate = 1.8 } }\n'
    file.write_text(table + "simulate = { state = [1.0, 1.8] }\n")
    words = ["equilibria", str(file), "--parameter", "rate", "--until", "2.4", "-o", str(tmp_path / "out"), "--json"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert document["events"][0]["kind"] == "hopf" and document["certified"] == document["points"]
    written = str(tmp_path / "out" / "own" / "equilibria.json")
    for command in (["verify", written], ["show", written], ["plot", written, "-o", str(tmp_path / "pictures")]):
        done = CliRunner().invoke(cli, command)
        assert done.exit_code == 0, command
        told = ("and ", " more", "error ", "lyapunov error ", " equilibria, ", " certified; 1 event")
        assert command[0] != "show" or all(part in done.output for part in told)
    assert list((tmp_path / "pictures").rglob("*.png"))
    file.write_text(table + "search = { period = [1.0, 9.0] }\n")
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 2 and "guess: missing; give the state near an equilibrium" in done.stderr


CYCLES = [
    ((of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", 2.4), 0, {2.5: 6.5772843419058333033}),
    ((morris_lecar(), [-40.0, 0.05], "I", 250.0), 1, {200.0: 65.619195980659958010, 150.0: 66.161752734528508188}),
    ((hodgkin_huxley(), [-65.0, 0.05, 0.6, 0.32], "I", 180.0), 1,
     {150.0: 5.9575738351538314841, 100.0: 6.7902707172699416723}),
    ((lorenz(20.0), [7.0, 7.0, 19.0], "rho", 28.0), 0, {}),
    ((wing(), [0.0, 0.0, 0.0, 0.0], "U", 20.0), 0, {}),
]  # fmt: skip


NAMED = [
    pytest.param(*case, id=name, marks=[pytest.mark.slow] if name in "mhwb" else [])
    for case, name in zip(CYCLES, "bmhlw", strict=True)
]


@pytest.mark.parametrize("rest, number, periods", NAMED)
def test_cycles_are_born_at_hopf_points(rest, number, periods):
    """On the side that the coefficient says, with the reference's periods; the way back ends at the same Hopf point."""
    found = of.follow_equilibria(*rest)
    branch, hopf = of.switch_branch(found, number, model=rest[0]), found.events[number]
    assert branch.name == f"equilibria-{number}" and branch.described()["kind_of_event"] == "hopf"
    settings = of.FamilySettings(directions="away", events=False)
    family = of.follow_family(branch, at=list(periods), points=150, settings=settings, model=rest[0])
    for value, period in periods.items():
        (point,) = [point for point in family.points if point.value == value]
        assert point.period == pytest.approx(period, rel=1e-12, abs=0)
    near = family.points[np.argmin([abs(point.period - hopf.period) for point in family.points])]
    assert abs(near.period - hopf.period) < 0.01 * hopf.period
    crossed = np.sign(near.value - hopf.parameter)
    rising = [found.points[hopf.index + k].stability == "unstable" for k in (0, 1)]
    born = 1 if rising[1] else -1  # the side on which the equilibrium is unstable
    assert crossed == (born if hopf.criticality == "supercritical" else -born)
    assert ("stable" in near.stability and "un" not in near.stability) == (hopf.criticality == "supercritical")
    back = replace(settings, directions="both")
    ends = of.follow_family(branch, points=40, settings=back, model=rest[0]).ends
    (end,) = [end for end in ends if end.kind == "hopf"]
    assert abs(end.parameter - hopf.parameter) <= 10 * (end.error + hopf.error)


def test_no_cycles_elsewhere(tmp_path, capfd):
    """At folds and other numbers a sentence says where cycles are born; the command follows them."""
    model = of.systems.brusselator(rate=1.8)
    found = of.follow_equilibria(model, [1.0, 1.8], "rate", until=2.4)
    with pytest.raises(InputError, match="event: nothing leaves these equilibria at event 3; choose one of 0"):
        of.switch_branch(found, 3)
    wave = of.ode(lambda t, x, p: [p[0] + x[0] - x[0] ** 3], ["x"], parameters={"r": -1.0})
    folds = of.follow_equilibria(wave, [-1.3], "r", until=1.0)
    with pytest.raises(InputError, match="nothing leaves these equilibria at event 0; there is none at which"):
        of.switch_branch(folds, 0, model=wave)
    file = str(of.save_equilibria(found, tmp_path / "equilibria.json"))
    words = ["continue", file, "--switch", "0", "--until", "2.5", "-o", str(tmp_path / "families"), "--no-figures"]
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 0 and re.search(r"points, rate .* s elapsed, \d+ s left", capfd.readouterr().err), (
        done.output
    )
    family = of.load_family(tmp_path / "families" / "equilibria-0" / "family.json")
    assert family.points[-1].value == 2.5 and family.source["kind_of_event"] == "hopf"
    done = CliRunner().invoke(cli, ["continue", file])
    assert done.exit_code == 2, done.output


def test_other_equilibria_leave_at_branch_points(tmp_path):
    """x = y = +-sqrt(8/3 (rho - 1)), z = rho - 1 of Lorenz, with both Hopf points; transcritical: x = r."""
    model = lorenz(0.2)
    origin = of.follow_equilibria(model, [0.0, 0.0, 0.0], "rho", until=28.0)
    branch = of.switch_branch(origin, 0, model=model)
    found = of.follow_equilibria(branch, until=28.0, out=tmp_path / "lorenz")
    for point in found.points:
        x, y, z = point.state
        assert abs(z - (point.value - 1)) < 1e-12 and abs(x - y) < 1e-12 and abs(x**2 - 8 / 3 * z) < 1e-11
    assert [event.kind for event in found.events] == ["hopf", "hopf"] and all(p.certified for p in found.points)
    assert found.points[0].state[0] * found.points[-1].state[0] < 0 and [e.kind for e in found.ends] == ["target"] * 2
    for event in found.events:
        assert abs(event.parameter - 24.736842105263157895) <= event.error
    hoop = of.follow_equilibria(of.systems.rotating_hoop(spin=2.0), [0.0, 0.0], "spin", until=5.0)
    file = str(of.save_equilibria(hoop, tmp_path / "equilibria.json"))
    done = CliRunner().invoke(cli, ["continue", file, "--switch", "0", "--until", "5", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    bent = of.load_equilibria(tmp_path / "equilibria-0" / "equilibria.json")
    assert max(abs(np.cos(point.state[0]) - 9.8 / point.value**2) for point in bent.points) < 1e-12
    crossing = of.ode(lambda t, x, p: [x[0] * (p[0] - x[0])], ["x"], parameters={"r": -1.0})
    first = of.follow_equilibria(crossing, [0.0], "r", until=1.0)
    other = of.follow_equilibria(of.switch_branch(first, 0, model=crossing), points=10)
    assert max(abs(point.state[0] - point.value) for point in other.points) < 1e-13
    assert not other.unknown and {point.stability for point in other.points} >= {"unstable"}
    assert len({point.stability for point in other.points}) > 1  # changes at the parent's event
    with pytest.raises(InputError, match="state: missing; give follow_equilibria"):
        of.follow_equilibria(crossing)


@pytest.mark.parametrize("fish", [0.2, 0.41])
def test_a_crossing_where_all_terms_are_zero_is_a_branch_point(fish):
    """q = 3 f (1 - f) / (1 - exp(-5 f)) meets f = 0 at q = 3 / 5, where every term of the rates vanishes."""
    q = 3 * fish * (1 - fish) / -np.expm1(-5 * fish)
    rates = {"f": "3*f*(1-f) - f*s - q*(1-exp(-5*f))", "s": "3*f*s - s"}
    found = of.follow_equilibria(of.equations(rates=rates, parameters={"q": q}), [fish, 0.0], "q", until=0.3)
    last = found.events[-1]
    assert last.kind == "branch_point" and abs(last.parameter - 0.6) < 1e-12
    assert "fold" not in [event.kind for event in found.events if abs(event.parameter - 0.6) < 0.1]
