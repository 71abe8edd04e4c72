"""Linear invariants of first-order systems: found in the equations, named, held by equilibria, cycles and families, and
recorded; and where a simulation comes to rest, wherever 0 lies."""

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import verified
from scipy.optimize import brentq

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError
from orbitfinder.families.verified import verified as verified_family
from orbitfinder.mechanics.kind import build_model

SIRS = {"S": "-beta*S*J + w*R", "J": "beta*S*J - g*J", "R": "g*J - w*R"}
RATES = {"beta": 2.0, "g": 1.0, "w": 0.2}
PLANKTON = {
    "N": "-V*N*P/(0.1 + N) + 0.1*P + 0.2*Z + 0.45*P*Z/(h + P)",
    "P": "V*N*P/(0.1 + N) - 0.1*P - 1.5*P*Z/(h + P)",
    "Z": "1.05*P*Z/(h + P) - 0.2*Z",
}
"""Nutrient, phytoplankton and zooplankton in a closed vessel; numbers of the text add up in decimals alone"""
CLOCK = {"x": "mu*(1 - y^2)*x - y", "y": "x", "z": "-mu*(1 - y^2)*x + y - x"}
"""Van der Pol's equations, and what takes up the rest of x + y"""
COLUMN = """
par p=-50
number gA=3.25, gB=22, a=100, b=50, C=135, e0=2.5, v0=6, r=0.56
init y0=0.1, y1=15, y2=10, z0=0, z1=0, z2=0
S(v)=2*e0/(1+exp(r*(v0-v)))
y0'=z0
y1'=z1
y2'=z2
z0'=gA*a*S(y1-y2)-2*a*z0-a^2*y0
z1'=gA*a*(p+0.8*C*S(C*y0))-2*a*z1-a^2*y1
z2'=gB*b*0.25*C*S(0.25*C*y0)-2*b*z2-b^2*y2
done
"""
"""A cortical column of B. Jansen and V. Rit, Biological Cybernetics 73 (1995) 357-366"""


def found(rates, **parts):
    """The invariants that the description of a system of text has."""
    names = ("beta", "g", "w", "k", "h", "V", "mu")
    return of.equations(rates, dict.fromkeys(names, 1.0), **parts).system.get("invariants", {})


@pytest.mark.parametrize(("rates", "texts"), [
    (SIRS, ["S + J + R"]),
    (PLANKTON, ["N + P + Z"]),
    (CLOCK, ["x + y + z"]),
    ({"S": "-k*S*E + g*C", "E": "-k*S*E + (g + h)*C", "C": "k*S*E - (g + h)*C", "P": "h*C"}, ["S + C + P", "E + C"]),
    ({"A": "-2*k*A^2 + 2*g*B", "B": "k*A^2 - g*B"}, ["A + 2*B"]),
    ({"A": "-A/3 - 0.3*A*B", "B": "0.1*A*B + A/3", "C": "0.2*A*B"}, ["A + B + C"]),
    ({"A": "-(A + B)^2", "B": "A^2 + 2*A*B + B^2"}, ["A + B"]),
    ({"A": "-A*I", "I": "0"}, ["I"]),
    ({"A": "k - exp(-A*B) - if(A > 1, B, 2)", "B": "exp(-A*B) + if(A > 1, B, 2) - k"}, ["A + B"]),
    ({"A": "-max(A, B)*tanh(k*A)", "B": "tanh(k*A)*max(A, B)"}, ["A + B"]),
    ({"A": "-k*A^h/(1 + A^h) + g*sqrt(B)", "B": "k*A^h/(1 + A^h) - g*B^0.5"}, ["A + B"]),
])  # fmt: skip
def test_totals_are_found(rates, texts):
    """Small whole numbers, of networks, dimers, decimals, thirds, products written out, functions; steady in time."""
    assert [*found(rates).values()] == texts
    model = of.equations(rates, dict.fromkeys(("beta", "g", "w", "k", "h", "V", "mu"), 0.7))
    states, values = np.random.default_rng(3).uniform(0.5, 2.0, (5, len(rates))), model.parameter_values
    for one in model.invariants:
        slopes = one.unfolding(0.0, [], values).full().ravel()
        rates_there = np.array([model.rates(0.0, x, values).full().ravel() for x in states])
        assert one.linear and np.abs(rates_there @ slopes).max() < 1e-14 * np.abs(rates_there).max()


@pytest.mark.parametrize("rates", [
    {"A": "-k*A + g*B", "B": "k*A - 1.0000001*g*B"}, {"A": "-k*A + g*B", "B": "k*A - g*B + 1e-12"},
    {"A": "-k*A + g*B", "B": "k*A - h*B"}, {"A": "-if(A, B, 0)", "B": "A*B"}, {"A": "-abs(A)", "B": "A"},
    {"A": "-A*B", "B": "A*B*(1 + 1e-9*A)"}, {"A": "-k*A", "B": "A"}, {"x": "y", "y": "-x"},
])  # fmt: skip
def test_no_total_is_invented(rates):
    """What holds at some parameters, on some states or to some digits only is not conserved."""
    assert not found(rates) and not of.equations(rates, dict.fromkeys(("k", "g", "h"), 1.0)).invariants


def test_a_total_is_counted_once():
    """Beside declared ones, of which it is a sum, a multiple or a function; under a name that is free."""
    network = {"A": "-A*B + C", "B": "-A*B + C", "C": "A*B - C"}
    assert found(network, invariants={"u": "A + C", "v": "A - B"}) == {"u": "A + C", "v": "A - B"}
    assert found(SIRS, invariants={"all": "(S + J + R)^2"}) == {"all": "(S + J + R)^2"}
    assert len(found(network, invariants={"u": "2*A + B + 3*C"})) == 2
    model = of.ode(lambda t, x, p: [-x[0] * p[0], x[0] * p[0]], ["total_1", "B"], {"k": 1.0})
    assert [one.name for one in model.invariants] == ["total_2"] and model.dissipative
    assert not of.ode(lambda t, x, p: [-x[0], x[0]], ["A", "B"], find_invariants=False).invariants
    pair = of.ode(lambda t, x, p: [x[1] * ca.exp(x[0]), -x[0] * ca.exp(x[0])], ["x", "y"],
                  invariants={"radius": lambda x, p: x[0] ** 2 + x[1] ** 2})  # fmt: skip
    assert [one.name for one in pair.invariants] == ["radius"] and not pair.dissipative


def test_a_record_has_its_totals():
    """A description has them, and rebuilds no others: what was written without keeps the meaning that it had."""
    model = of.equations(SIRS, RATES)
    assert model.system["invariants"] == {"total_1": "S + J + R"}
    rebuilt = build_model(json.loads(json.dumps(model.system)))
    assert [one.name for one in rebuilt.invariants] == ["total_1"] and rebuilt.system == model.system
    old = {key: value for key, value in model.system.items() if key != "invariants"}
    assert build_model(old).invariants == () and build_model(old).system == old


@pytest.mark.parametrize("exact", [False, True])
def test_equilibria_keep_the_total(exact):
    """That of the state they start from, which need not be at rest, and may be; by hand, S = g / beta and so on."""
    start = [0.5, 1 / 12, 5 / 12] if exact else [0.5, 0.1, 0.4]
    sirs = of.follow_equilibria(of.equations(SIRS, RATES), start, "beta", until=4.0)
    assert np.allclose(sirs.points[0].state, [0.5, 1 / 12, 5 / 12], atol=1e-13)
    assert np.allclose(sirs.points[-1].state, [0.25, 0.125, 0.625], atol=1e-13)
    assert all(point.stability == "stable" and point.certified for point in sirs.points) and verified(sirs).passed
    isomer = of.equations({"A": "-k1*A + k2*B", "B": "k1*A - k2*B"}, {"k1": 1.0, "k2": 3.0})
    found = of.follow_equilibria(isomer, [0.75, 0.25] if exact else [1.0, 0.0], "k1", until=4.0)
    assert np.allclose([point.state[0] for point in found.points], [3 / (3 + point.value) for point in found.points])
    assert found.points[-1].value == 4.0 and all(point.certified for point in found.points)


def test_an_enzyme_in_a_flow():
    """v - d S = k3 C and E + C = 1: the substrate is solved for by hand."""
    rates = {"S": "v - E*S + C - d*S", "E": "-E*S + 2*C", "C": "E*S - 2*C"}
    found = of.follow_equilibria(of.equations(rates, {"v": 1.0, "d": 0.1}), [1.0, 1.0, 0.0], "v", until=4.0)
    for point in (found.points[0], found.points[-1]):
        s = brentq(lambda s, v=point.value: v - 0.1 * s - s / (2 + s), 0.0, 100.0)
        assert np.allclose(point.state, [s, 2 / (2 + s), s / (2 + s)], rtol=1e-12) and point.stability == "stable"


def test_hopf_points_of_closed_systems():
    """On the level of the total the system is any other: trace 0 of its slopes, by own differences and bisection."""
    model = of.equations(PLANKTON, {"V": 2.0, "h": 0.9})

    def rest(h):
        p = 0.2 * h / (1.05 - 0.2)
        z = lambda n: (2 * n / (0.1 + n) - 0.1) * (h + p) / 1.5  # noqa: E731 - the formula
        n = brentq(lambda n: n + p + z(n) - 0.9, 1e-9, 0.9)
        return np.array([n, p, z(n)])

    def trace(h):
        steps = 1e-4 * np.eye(3)
        rates = lambda x: model.rates(0.0, x, [2.0, h]).full().ravel()  # noqa: E731 - the formula
        slopes = [(8 * (rates(x + e) - rates(x - e)) - (rates(x + 2 * e) - rates(x - 2 * e))) / 12e-4
                  for x in [rest(h)] for e in steps]  # fmt: skip
        return np.trace(slopes)

    found = of.follow_equilibria(model, [0.1, 0.2, 0.6], "h", until=0.3)
    (event,) = found.events
    assert (event.kind, event.criticality) == ("hopf", "supercritical")
    assert abs(event.parameter - brentq(trace, 0.4, 0.8, xtol=1e-12)) < 1e-7 and np.allclose(
        event.state, rest(event.parameter)
    )


@pytest.mark.slow  # an orbit and its certificate
def test_cycles_of_closed_systems():
    """Van der Pol's period, with what takes up the rest: the total is pinned where the guess has it."""
    clock = of.equations(CLOCK, {"mu": 1.0})
    orbit = of.find_orbit(of.Problem(clock, of.Guess([0.0, 2.0, 0.5], 6.6), of.pin(total_1=2.5)))
    assert orbit.certificate.passed and abs(orbit.period - 6.6632868593) < 1e-9
    assert abs(orbit.state.sum() - 2.5) < 1e-12 and orbit.stability == "asymptotically stable"
    assert orbit.provenance["invariants"] == ["total_1"] and orbit.floquet_multipliers.size == 1


def test_first_cycles_of_closed_systems():
    """At a Hopf point the cycles that leave it hold its total, and what is followed is their parameter."""
    model = of.equations(PLANKTON, {"V": 2.0, "h": 0.55})
    rest = of.follow_equilibria(model, [0.25, 0.13, 0.52], "h", until=0.5)
    branch = of.switch_branch(rest, 0)
    assert {row.name: round(row.value, 12) for row in branch.start.curve.kept} == {"energy": 0.9}
    assert branch.start.curve.equations.free == ("h",)


@pytest.mark.slow  # a family from a Hopf point, and one back to it
def test_families_of_closed_systems():
    """All at the total of the state that equilibria began at; what goes to the Hopf point ends there."""
    rest = of.follow_equilibria(of.equations(PLANKTON, {"V": 2.0, "h": 0.9}), [0.1, 0.2, 0.6], "h", until=0.3)
    family = of.follow_family(of.switch_branch(rest, 0), until=0.4)
    assert family.ends[-1].kind == "target" and len(family.points) > 5
    assert all(abs(point.state.sum() - 0.9) < 1e-12 for point in family.points)
    assert all(point.stability == "asymptotically stable" for point in family.points)
    model = of.equations(PLANKTON, {"V": 2.0, "h": 0.4})
    near = min(family.points, key=lambda point: abs(point.value - 0.4))
    orbit = of.find_orbit(of.Problem(model, of.Guess(near.state, near.period)))
    back = of.follow_family(orbit, until=0.8, settings=of.FamilySettings(parameter="h"))
    assert back.ends[-1].kind == "hopf" and abs(back.ends[-1].parameter - rest.events[0].parameter) < 1e-8


def test_cycles_are_counted():
    """Two equations that say the same, of closure, make room for one pin more."""
    guess = of.Guess([0.0, 2.0, 0.5], 6.6)
    counted = [
        of.Problem(of.equations(CLOCK, {"mu": 1.0}, find_invariants=find), guess).count() for find in (False, True)
    ]
    assert [each.freedom for each in counted] == [0, 1]


@pytest.mark.slow  # a command each
def test_commands_need_no_declaration(tmp_path, monkeypatch):
    """`equilibria`, `diagram` and `verify` of a problem file."""
    monkeypatch.chdir(tmp_path)
    lines = ["[system]", 'kind = "equations"', "[system.rates]", *(f'{k} = "{v}"' for k, v in SIRS.items()),
             "[system.parameters]", *(f"{k} = {v}" for k, v in RATES.items()), "[guess]",
             "state = [0.5, 0.1, 0.4]"]  # fmt: skip
    (tmp_path / "sirs.toml").write_text("\n".join(lines))
    for command in ("equilibria", "diagram"):
        run = CliRunner().invoke(cli, [command, "sirs.toml", "--parameter", "beta", "--until", "4", "--out", command])
        assert run.exit_code == 0
    for place in ("equilibria/sirs", "diagram/sirs/equilibria"):
        document = json.loads((tmp_path / place / "equilibria.json").read_text())
        assert document["system"]["invariants"] == {"total_1": "S + J + R"}
        assert np.allclose(document["points"][-1]["state"], [0.25, 0.125, 0.625])
    assert CliRunner().invoke(cli, ["verify", "equilibria/sirs/equilibria.json"]).exit_code == 0


def test_what_is_not_found_is_asked_for():
    """A total whose shares are parameters is not one for all of them: the message names the table to declare it in."""
    rates, values = {"A": "(B - A)/V", "B": "(A - B)/U"}, {"V": 2.0, "U": 3.0}
    with pytest.raises(ConvergenceError, match=r"singular.*\[system.invariants\]"):
        of.follow_equilibria(of.equations(rates, values), [1.0, 0.2], "V", until=4.0)
    model = of.equations(rates, values, invariants={"amount": "V*A + U*B"})
    found = of.follow_equilibria(model, [1.0, 0.2], "V", until=4.0)
    assert np.allclose(found.points[-1].state, 2.6 / 7)


def test_rest_wherever_zero_lies(tmp_path):
    """A cortical column rests within 5 s from a state with zeros; a motion's rest does not depend on the origin."""
    (tmp_path / "column.ode").write_text(COLUMN)
    column = of.from_xpp(tmp_path / "column.ode")
    found = of.follow_equilibria(column, column.landmarks["init"], "p", until=-45.0)
    rest = [7.78249534e-4, -1.00142626, 2.52819042, 0.0, 0.0, 0.0]
    assert np.allclose(found.points[0].state, rest, rtol=2e-9) and found.points[0].stability == "stable"
    assert found.points[-1].value == -45.0 and all(point.certified for point in found.points)
    rests = []
    for origin in (0.0, 1.0, 1000.0):
        x, y = f"(x - {origin})", f"(y - {origin})"
        model = of.equations({"x": f"20*tanh({y} - 3) - 100*{x}", "y": f"a*exp(-{x}^2) - 0.01*{y}"}, {"a": 0.02})
        found = of.follow_equilibria(model, [origin + 7.0, origin], "a", until=0.021)
        rests.append(found.points[0].state - origin)
    assert np.ptp(rests, axis=0).max() < 1e-9


def cascade(random=None):
    """Three cycles of a protein and its phosphorylated forms, each by the last of the cycle before."""
    factor = iter(np.ones(40) if random is None else np.exp(random.uniform(-1.0, 1.0, 40)))

    def step(v, k, substrate, enzyme="1"):
        return f"{v * next(factor)}*{enzyme}*{substrate}/({k * next(factor)} + {substrate})"

    up = [f"V*A/((1 + EPP/{9 * next(factor)})*({10 * next(factor)} + A))", step(0.025, 15, "B", "AP"),
          step(0.025, 15, "BP", "AP"), step(0.025, 15, "E", "BPP"), step(0.025, 15, "EP", "BPP")]  # fmt: skip
    down = [step(0.25, 8, "AP"), *(step(v, 15, x) for v, x in ((0.75, "BP"), (0.75, "BPP"), (0.5, "EP"), (0.5, "EPP")))]
    net = [f"({u} - {d})" for u, d in zip(up, down, strict=True)]
    rates = {"A": f"-{net[0]}", "AP": net[0], "B": f"-{net[1]}", "BP": f"{net[1]} - {net[2]}", "BPP": net[2],
             "E": f"-{net[3]}", "EP": f"{net[3]} - {net[4]}", "EPP": net[4]}  # fmt: skip
    return of.equations(rates, {"V": 0.1})


@pytest.mark.parametrize("seed", [None, 0, 1, 2])
def test_a_simulation_to_rest_keeps_the_totals(seed):
    """BDF's steps of 1e10 at rest made 2938 of a total of 300, of which the branch then was."""
    model = cascade(None if seed is None else np.random.default_rng(seed))
    rest = of.follow_equilibria(model, [90.0, 10.0, 280.0, 10.0, 10.0, 280.0, 10.0, 10.0], "V", until=0.2)
    for point in (rest.points[0], rest.points[-1]):
        x = point.state
        assert [x[:2].sum(), x[2:5].sum(), x[5:].sum()] == pytest.approx([100.0, 300.0, 300.0], rel=1e-12)
        assert point.certified and (x > 0).all()


@pytest.mark.slow  # a family between two Hopf points, and its verification
def test_a_family_of_a_closed_system_ends_at_its_hopf_point():
    """The linear oscillation has the totals of the orbits; with those of the middle of their extents its period is off
    by 4.5e-4."""
    rates = {"F": "v - F*T*(r + D^2)", "T": "D - F*T*(r + D^2)", "D": "F*T*(r + D^2) - D"}
    rest = of.follow_equilibria(of.equations(rates, {"v": 0.05, "r": 0.02}), [1.0, 1.6, 0.4], "v", until=1.0)
    family = of.follow_family(of.switch_branch(rest, 0))
    end = family.ends[-1]
    assert end.kind == "hopf" and end.parameter == pytest.approx(rest.events[1].parameter, rel=1e-9)
    model = build_model(family.system)
    assert all(check.passed for _, check in verified_family(family, model))
    wrong = replace(end, period=end.period * (1 + 1e-5))
    said = dict(verified_family(replace(family, ends=(*family.ends[:-1], wrong)), model))
    assert not said[f"end {len(family.ends) - 1}"].passed
