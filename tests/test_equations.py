"""Equations as text, AUTO's solutions: the same numbers as from Python, and no harm from any text."""

import json
import math
import os
import random
import shutil
import subprocess
import time
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.expression import expression
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.problemfile.auto import branches
from orbitfinder.problemfile.read import load_problem_file

ROOT = Path(__file__).parents[1]
FILES, DATA = ROOT / "problems" / "equations", ROOT / "tests" / "data"
AUTO = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))
OSCILLATOR = {"x": "y", "y": "-x"}
ROAD = {entry["id"]: entry for entry in json.loads((DATA / "road.json").read_text())}
HOPF = {
    "morris-lecar": ("eq-ml-hopf-class", "I", 250), "fitzhugh-nagumo": ("eq-fhn", "I", 2),
    "hodgkin-huxley": ("eq-hh", "I", 180), "brusselator": ("eq-brusselator", "b", 2.5),
    "lorenz": ("eq-lorenz", "rho", 28), "wing-flutter": ("eq-aero", "U", 20),
}  # fmt: skip
"""What road.json calls the systems of the shipped files"""
OTHERS = {
    "oregonator": ("f", 3, 1.5267), "predator-prey": ("q", 0.9, 0.671594), "steinmetz-larter": ("k7", 1.0, 1.2675),
    "hindmarsh-rose": ("I", 1, 1.34107),
}  # fmt: skip


def command(*words):
    return CliRunner().invoke(cli, list(map(str, words)))


def followed(file, parameter, until, out):
    return command("equilibria", file, "--parameter", parameter, "--until", until, "-o", out, "--json")


def refused(**given):
    with pytest.raises(InputError) as error:
        of.equations(**given)
    return str(error.value)


def model_of(name):
    return load_problem_file(FILES / f"{name}.toml").model


# ----------------------------------------------------------------------------------------------- the same numbers


def u_ramp(u):
    return u / (1 - ca.exp(-u))


WRITTEN = {
    "morris-lecar": lambda x, p: [
        (p.I - 2 * (x.V + 60) - 4.4 * (1 + ca.tanh((x.V + 1.2) / 18)) / 2 * (x.V - 120) - 8 * x.w * (x.V + 84)) / 20,
        0.04 * ((1 + ca.tanh((x.V - 2) / 30)) / 2 - x.w) * ca.cosh((x.V - 2) / 60),
    ],
    "fitzhugh-nagumo": lambda x, p: [x.v - x.v**3 / 3 - x.w + p.I, 0.08 * (x.v + 0.7 - 0.8 * x.w)],
    "hodgkin-huxley": lambda x, p: [
        p.I - 120 * x.m**3 * x.h * (x.V - 50) - 36 * x.n**4 * (x.V + 77) - 0.3 * (x.V + 54.387),
        u_ramp((x.V + 40) / 10) * (1 - x.m) - 4 * ca.exp(-(x.V + 65) / 18) * x.m,
        0.07 * ca.exp(-(x.V + 65) / 20) * (1 - x.h) - x.h / (1 + ca.exp(-(x.V + 35) / 10)),
        0.1 * u_ramp((x.V + 55) / 10) * (1 - x.n) - 0.125 * ca.exp(-(x.V + 65) / 80) * x.n,
    ],
    "lorenz": lambda x, p: [10 * (x.y - x.x), x.x * (p.rho - x.z) - x.y, x.x * x.y - 2.6666666666666665 * x.z],
    "hindmarsh-rose": lambda x, p: [
        x.y - x.x**3 + 3 * x.x**2 - x.z + p.I, 1 - 5 * x.x**2 - x.y, 0.005 * (4 * (x.x + 1.6) - x.z)
    ],
    "predator-prey": lambda x, p: [
        3 * x.fish * (1 - x.fish) - x.fish * x.sharks - p.q * (1 - ca.exp(-5 * x.fish)),
        -x.sharks + 3 * x.fish * x.sharks,
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", WRITTEN)
def test_text_and_python_give_the_same_rates(name):
    """To the last bit or two, at random states and parameters."""
    text, changed = model_of(name), {"lorenz": "rho", "predator-prey": "q"}.get(name, "I")
    python = of.ode(lambda t, x, p: WRITTEN[name](x, p), text.state_names, {changed: 0.0})
    draws = np.random.default_rng(0)
    for _ in range(50):
        state, value = draws.normal(size=len(text.state_names)) * 3, float(draws.normal())
        mine = text.rates(0.0, state, with_parameters(text, {changed: value}).parameter_values).full().ravel()
        theirs = python.rates(0.0, state, [value]).full().ravel()
        assert np.abs(mine - theirs).max() <= 1e-15 * np.abs(theirs).max() * 4


def test_a_quotient_0_by_0_is_passed_by_its_series():
    """At V = -40 and -55 rates and slopes are those of the limit u/(1 - exp(-u)) = 1 + u/2 + ..."""
    model = model_of("hodgkin-huxley")
    x = ca.SX.sym("x", 4)
    slope = ca.Function("slope", [x], [ca.jacobian(model.rates(0, x, model.parameter_values), x)])
    gate = 4 * math.exp(-25 / 18)
    rate = model.rates(0, [-40.0, 0.1, 0.5, 0.3], model.parameter_values).full().ravel()[1]
    assert rate == pytest.approx(0.9 - gate * 0.1, rel=1e-15)
    at = slope([-40.0, 0.1, 0.5, 0.3]).full()
    assert at[1, 0] == pytest.approx(0.05 * 0.9 + gate * 0.1 / 18, rel=1e-14) and np.isfinite(at).all()
    near = [
        model.rates(0, [v, 0.1, 0.5, 0.3], model.parameter_values).full().ravel()[1] for v in (-39.0, -39.0 - 1e-13)
    ]
    assert near[0] == pytest.approx(near[1], rel=1e-13)  # both sides of |u| = 0.1


@pytest.mark.parametrize("name", HOPF)
def test_the_road_goes_through_text(name, tmp_path):
    """`equilibria` of the shipped files gives the 30 digits of road.json within its bars."""
    entry, parameter, until = HOPF[name]
    made = followed(FILES / f"{name}.toml", parameter, until, tmp_path)
    assert made.exit_code == 0, made.output
    events = json.loads(made.stdout)["events"]
    wanted = ROAD[entry]["values"]["hopf"]
    assert [event["kind"] for event in events] == ["hopf"] * len(wanted)
    for event, hopf in zip(events, wanted, strict=True):
        assert abs(event["parameter"] - float(hopf["parameter"])) <= event["error"] < 1e-11
        assert event["period"] == pytest.approx(float(hopf["period"]), rel=1e-12)
        assert event["lyapunov"] == pytest.approx(float(hopf["l1"]), rel=1e-8)
    assert command("verify", tmp_path / name / "equilibria.json").exit_code == 0


@pytest.mark.parametrize("name", OTHERS)
def test_the_other_files_have_the_hopf_point_that_they_name(name, tmp_path):
    parameter, until, value = OTHERS[name]
    made = followed(FILES / f"{name}.toml", parameter, until, tmp_path)
    assert made.exit_code == 0, made.output
    assert json.loads(made.stdout)["events"][0]["parameter"] == pytest.approx(value, rel=1e-4)


def test_every_shipped_file_is_tested():
    assert {path.stem for path in FILES.glob("*.toml")} == {*HOPF, *OTHERS, "van-der-pol"}


def test_an_orbit_of_text_comes_back_from_its_file(tmp_path):
    """`run` and `verify` need no --trust; the Model is rebuilt, in the order of states although keys were sorted."""
    assert command("run", FILES / "van-der-pol.toml", "-o", tmp_path, "--no-figures").exit_code == 0
    file = tmp_path / "van-der-pol" / "orbit.json"
    assert command("verify", file).exit_code == 0
    orbit = of.load_orbit(file)
    assert orbit.period == pytest.approx(6.6632868593231301896996820305, rel=1e-13) and orbit.certificate.passed
    assert orbit.system == model_of("van-der-pol").system
    assert build_model(json.loads(json.dumps(orbit.system, sort_keys=True))).state_names == ("x", "y")
    backwards = of.equations({"y": "-x", "x": "y"})
    shuffled = build_model(json.loads(json.dumps(backwards.system, sort_keys=True)))
    assert shuffled.state_names == ("y", "x") and of.equations(OSCILLATOR).state_names == ("x", "y")
    assert build_model({"kind": "equations", "rates": OSCILLATOR}).state_names == ("x", "y")
    assert build_model({"kind": "equations", "rates": {"y": "-x", "x": "y"}}).state_names == ("y", "x")
    moved = with_parameters(model_of("van-der-pol"), {"mu": 2.0})
    assert moved.system["parameters"] == {"mu": 2.0} and build_model(moved.system).parameter_values[0] == 2.0


def test_a_hamiltonian_in_text():
    """The same equations, energy and Hamiltonian structure as of.hamiltonian."""
    text = of.equations(
        hamiltonian="(px^2 + py^2 + x^2 + y^2)/2 + lambda*(x^2*y - y^3/3)", coordinates=["x", "y"],
        momenta=["px", "py"], parameters={"lambda": 1.0},
    )  # fmt: skip
    own = of.systems.henon_heiles()
    state = np.array([0.1, 0.2, 0.3, -0.1])
    assert text.hamiltonian and of.energy(text, state) == pytest.approx(of.energy(own, state), rel=1e-15)
    rates = text.rates(0, state, text.parameter_values).full().ravel()
    x, y, px, py = state
    assert rates == pytest.approx([px, py, -x - 2 * x * y, -y - x**2 + y**2], rel=1e-15)


def test_energies_and_forces_in_text():
    """A damped pendulum: accelerations of Lagrange's equations, by a table of forces and by a list."""
    given = {"kinetic": "m*l^2*thetadot^2/2", "potential": "-m*g*l*cos(theta)", "coordinates": ["theta"],
             "angles": ["theta"], "parameters": {"m": 2.0, "l": 0.5, "g": 9.8, "c": 0.1}}  # fmt: skip
    for forces in ({"theta": "-c*thetadot"}, ["-c*thetadot"]):
        model = of.equations(**given, forces=forces)
        found = float(model.acceleration(0, [0.7], [1.3], model.parameter_values))
        assert found == pytest.approx((-0.1 * 1.3 - 2 * 9.8 * 0.5 * math.sin(0.7)) / (2 * 0.25), rel=1e-15)
        assert model.angular.tolist() == [True] and build_model(model.system).state_names == ("theta", "thetadot")
    free = of.equations(**given)
    assert [one.name for one in free.invariants] == ["energy"]
    assert of.energy(free, [0.0, 1.0]) == pytest.approx(0.25 - 9.8, rel=1e-15)


@pytest.mark.parametrize("form", ["rates", "kinetic"])
def test_a_forced_system_says_its_period(form, tmp_path):
    """x'' + 0.2 x' + x = cos(w t): the amplitude that is known, from a file whose guess is a state alone."""
    w, (head, lines) = 2.0, {
        "rates": ("", '[system.rates]\nx = "v"\nv = "-0.2*v - x + cos(w*t)"\n'),
        "kinetic": ('coordinates = ["x"]\nkinetic = "xdot^2/2"\npotential = "x^2/2"\n',
                    '[system.forces]\nx = "-0.2*xdot + cos(w*t)"\n'),
    }[form]  # fmt: skip
    file = tmp_path / "driven.toml"
    file.write_text(f'[system]\nkind = "equations"\nperiod = "2*pi/w"\n{head}{lines}[system.parameters]\nw = {w}\n'
                    "[guess]\nstate = [0.0, 0.0]\n")  # fmt: skip
    orbit = of.find_orbit(of.load_problem(file))
    assert orbit.period == pytest.approx(math.pi, rel=1e-15) and orbit.certificate.passed
    size = 1 / math.hypot(1 - w**2, 0.2 * w)
    assert math.hypot(orbit.state[0], orbit.state[1] / w) == pytest.approx(size, rel=1e-10)


def test_definitions_in_any_order_functions_of_functions_and_pythons_words():
    model = of.equations(
        {"x": "f(x, lambda) + a", "is": "-is"}, {"lambda": 2.0},
        let={"a": "b + g(1)", "f(u, v)": "g(u)*v", "b": "3*x", "g(u)": "u^2 + b"},
    )  # fmt: skip
    rate = model.rates(0, [0.5, 2.0], [2.0]).full().ravel()
    assert rate.tolist() == [(0.25 + 1.5) * 2 + 1.5 + 1 + 1.5, -2.0]


@pytest.mark.parametrize(
    "text, value",
    [("if(x > 1 and not x >= 3, 5, -x)", 5.0), ("if(x < 1 or x == 2, x^2, 0)", 4.0), ("if(1 < x < 2, 1, 0)", 0.0),
     ("min(x, 3, 1) + max(x, 7)", 8.0), ("abs(-x) + 2^-1", 2.5), ("-x^2", -4.0), ("2**3**2", 512.0),
     ("sinh(x)/cosh(x) - tanh(x)", 0.0), ("asin(1) + acos(1) + atan(0)", math.pi / 2), ("if(2 > 1, x, 1/x)", 2.0),
     ("x\n + 1", 3.0), ("if(x != 2, 1, 0)", 0.0), ("exp(log(x)) + sqrt(4)*sin(0)*cos(pi)*tan(0)", 2.0),
     ("x" + " + x" * 400, 802.0)],
)  # fmt: skip
def test_what_texts_mean(text, value):
    x = ca.SX.sym("x")
    assert float(ca.Function("f", [x], [expression(text, {"x": x}, "w")])(2.0)) == pytest.approx(value, abs=1e-15)


# --------------------------------------------------------------------------------------------------- bad input

HOSTILE = [
    ("10**400", "no finite real number"), ("9**9**9**9", "no finite real number"), ("1e999*x", "no finite real number"),
    ("9" * 1999, "no finite real number"), ("(-8)**0.5", "no finite real number"), ("1/0", "no finite real number"),
    ("(" * 900 + "x" + ")" * 900, "no expression"), ("-" * 1900 + "x", "nested too deeply"),
    ("sin(" * 80 + "x" + ")" * 80, "nested too deeply"), ("foo(" + "-" * 1900 + "x)", "is not allowed"),
    ("x" * 20_001, "at most 20000 letters"), ("", "must be an expression"), (" \n ", "must be an expression"),
    ("x +", "no expression"), ("(x", "no expression"), ("x)", "no expression"), ("2x", "no expression"),
    ("x y", "no expression"), ("x # and", "without comments"), ("x; y", "no expression"), ("a := x", "no expression"),
    ("x.real", "'x.real' is not allowed"), ("x.__class__.__mro__", "is not allowed"), ("x[0]", "is not allowed"),
    ("__import__('os').system('true')", "is not allowed"), ("open('x')", "is not allowed"), ("'a'*9", "is not allowed"),
    ("(lambda: 1)()", "is not allowed"), ("[x for x in x]", "no expression"), ("{x}", "is not allowed"),
    ("f'{x}'", "is not allowed"), ("x if x else x", "no expression"), ("sinn(x)", "did you mean 'sin'?"),
    ("sin(x, x)", "is not allowed"), ("if(x, 1)", "is not allowed"), ("max(x)", "is not allowed"), ("sin", "unknown"),
    ("xx", "unknown name 'xx', did you mean 'x'?; known are t, x"), ("True", "is not"), ("1j", "is not allowed"),
    ("x // 2", "is not allowed"), ("x @ x", "is not"), ("sin(*x)", "is not allowed"), ("x, x", "is not allowed"),
    ("t", "depends on the time t; give the period of that"), ("\\d", "no expression"), ("x\0", "no expression"),
    ("0x1for x in x", "no expression"),
]  # fmt: skip


@pytest.mark.parametrize("text, why", HOSTILE, ids=range(len(HOSTILE)))
def test_a_bad_text_is_refused_at_once_by_name(text, why, tmp_path):
    """From Python by its argument, from a file by its field and exit code 2."""
    began = time.perf_counter()
    said = refused(rates={"x": text})
    assert said.startswith("rates.x: ") and why in said and len(said) < 500
    assert time.perf_counter() - began < 1
    file = tmp_path / "bad.toml"
    file.write_text(f'[system]\nkind = "equations"\n[system.rates]\nx = {json.dumps(text)}\n[guess]\nstate = [0.0]\n')
    made = command("equilibria", file, "--parameter", "a")
    assert made.exit_code == 2 and f"{file}: system.rates.x: " in made.stderr.replace("\n", ""), made.stderr


WRONG = [
    ({}, "rates: nothing given; give rates, or hamiltonian with coordinates"),
    ({"rates": OSCILLATOR, "kinetic": "1"}, "rates: rates and kinetic given"),
    ({"rates": OSCILLATOR, "momenta": ["p"]}, "momenta: has no meaning beside rates; leave it out"),
    ({"hamiltonian": "p^2"}, "coordinates: missing; name those that hamiltonian"),
    ({"hamiltonian": "p^2 + q^2", "coordinates": ["q"]}, "momenta: 0 names for 1 coordinates"),
    ({"rates": OSCILLATOR, "states": ["x"]}, "states: x, but rates of x, y; name each state once"),
    ({"rates": OSCILLATOR, "parameters": {"y": 1.0}}, "parameters.y: 'y' is in rates too"),
    ({"rates": OSCILLATOR, "let": {"x(u)": "u"}}, "let.x(u): 'x' is in rates too"),
    ({"rates": {"exp": "1"}}, "rates.exp: 'exp' is no name that is free"),
    ({"rates": {"x-y": "1"}}, "rates.x-y: 'x-y' is no name that is free; use letters, digits and _, such as xy_1"),
    ({"rates": {"\u00b5": "1"}}, "is no name that is free"),
    ({"rates": OSCILLATOR, "let": {"f()": "1"}}, "let.f(): '' is no name"),
    ({"rates": OSCILLATOR, "let": {"f(t)": "1"}}, "let.f(t): 't' is no name"),
    ({"rates": OSCILLATOR, "let": {"a": "b", "b": "a"}}, "is defined by itself (a -> b -> a); break the circle"),
    ({"rates": OSCILLATOR, "let": {"f(u)": "f(u)"}}, "let.f(u): is defined by itself (f(u) -> f(u))"),
    ({"rates": OSCILLATOR, "let": {"a": "cc + 1"}}, "let.a: unknown name 'cc'"),
    ({"rates": OSCILLATOR, "parameters": {"a": float("nan")}}, "parameters.a: must be a finite number, got nan"),
    ({"rates": OSCILLATOR, "parameters": {"energy": 1.0}}, "energy and period are taken"),
    ({"rates": OSCILLATOR, "period": 1.0}, "period: nothing depends on the time t; leave it out"),
    ({"rates": {"x": "cos(w*t)"}, "period": "2*pi/w"}, "rates.x: unknown name 'w'"),
    ({"rates": {"x": "cos(t)"}, "period": "2*pi/x"}, "period: unknown name 'x'"),
    ({"rates": {"x": 1.0}}, "rates: expected names with a text each"),
    ({"rates": OSCILLATOR, "angles": ["z"]}, "angles: 'z' is none; known are x, y"),
    ({"rates": OSCILLATOR, "invariants": {"e": "x^2 + z"}}, "invariants.e: unknown name 'z'"),
    ({"kinetic": "xdot^2", "coordinates": ["x"], "forces": {"y": "1"}}, "forces: 'y' is none"),
    ({"kinetic": "xdot^2", "coordinates": ["x"], "forces": ["1", "1"]}, "forces: 2 for 1 coordinates"),
    ({"kinetic": "xdot^2", "coordinates": ["x"], "parameters": {"xdot": 1.0}}, "parameters.xdot: 'xdot' is in coord"),
    ({"rates": {f"x{k}": "1" + "+1" * 900 for k in range(200)}}, "letters of text, at most 200000 are read"),
]  # fmt: skip


@pytest.mark.parametrize("given, why", WRONG, ids=range(len(WRONG)))
def test_what_does_not_fit_together_is_said(given, why):
    assert why in refused(**given)


def test_functions_that_grow_and_long_rows_of_definitions_do_not_hang():
    """Sixty functions that each call the one before twice are 2^60 operations; two thousand quantities are fine."""
    let = {"f0(u)": "sin(u)"} | {f"f{k}(u)": f"f{k - 1}(u)*f{k - 1}(u + 1)" for k in range(1, 60)}
    began = time.perf_counter()
    assert "more than 200000 operations where functions are written out" in refused(rates={"x": "f59(x)"}, let=let)
    row = {"a0": "x"} | {f"a{k}": f"a{k - 1}*a{k - 1} - x" for k in range(1, 2000)}
    assert of.equations({"x": "a1999"}, let=row).state_names == ("x",)
    assert time.perf_counter() - began < 10


def test_random_texts_do_no_harm():
    """Of 3,000 seeded texts of such letters, each is a value or an InputError that names the field."""
    draws = random.Random(0)
    pieces = ["x", "y", "(", ")", "+", "-", "*", "/", "^", "**", ",", "1", "0", "9e9", "if(", "sin(", "max(", "<", "==",
              " and ", " not ", ".", "[", "]", "{", "}", "'", '"', "\\", "lambda", ":", "=", "%", "@", "\n", "é",
              "1e400", "__class__", "f(", "_", "!", "&", "|", "~", "\u01c1", "\x00", "for", "import "]  # fmt: skip
    known, read = {"x": ca.SX.sym("x"), "y": 2.0}, 0
    began = time.perf_counter()
    for _ in range(3000):
        text = "".join(draws.choices(pieces, k=draws.randint(1, 12)))
        try:
            assert isinstance(expression(text, known, "field"), (ca.SX, float)), text
            read += 1
        except InputError as error:
            assert str(error).startswith("field: "), text
    assert read > 20 and time.perf_counter() - began < 10


def test_an_orbit_file_with_bad_text_is_refused(tmp_path):
    """Exit code 2 of `verify`, naming the field."""
    assert command("run", FILES / "van-der-pol.toml", "-o", tmp_path, "--no-figures").exit_code == 0
    file = tmp_path / "van-der-pol" / "orbit.json"
    document = json.loads(file.read_text())
    for text in ("x.__class__", "10**400", "(" * 100_000):
        document["system"]["rates"]["x"] = text
        file.write_text(json.dumps(document))
        made = command("verify", file)
        assert made.exit_code == 2 and "system.rates.x" in made.output, made.output


def test_a_state_alone_is_for_equilibria(tmp_path):
    """`run` asks for a period; a state of a wrong length is refused."""
    made = command("run", FILES / "morris-lecar.toml", "-o", tmp_path)
    assert made.exit_code == 2 and "guess: state goes with period; alone it is where `equilibria` starts" in made.output
    file = tmp_path / "short.toml"
    file.write_text((FILES / "morris-lecar.toml").read_text().replace("[-60.0, 0.01]", "[-60.0]"))
    made = command("equilibria", file, "--parameter", "I")
    assert made.exit_code == 2 and "guess.state: 1 number for 1 coordinate; give 2" in made.output


# ------------------------------------------------------------------------------------------------------ resets

NEURON = {"v": "0.04*v^2 + 5*v + 140 - u + I", "u": "a*(b*v - u)"}
VALUES = {"a": 0.02, "b": 0.2, "c": -65.0, "d": 8.0, "I": 10.0}
SPIKE = {"guard": "v - 30", "direction": 1, "reset": {"v": "c", "u": "u + d"}}


def test_a_text_with_events_is_the_hybrid_system_of_python(tmp_path):
    """Izhikevich's neuron in both ways, found again by its file, its cycle its own or said."""
    model = of.equations(NEURON, VALUES, events={"spike": SPIKE})
    flow = of.ode(
        lambda t, x, p: [0.04 * x.v**2 + 5 * x.v + 140 - x.u + p.I, p.a * (p.b * x.v - x.u)], ["v", "u"], VALUES
    )
    reset = of.Transition(
        "spike", "flow", "flow", lambda x, p: x.v - 30, lambda x, p: ca.vertcat(p.c, x.u + p.d), direction=1
    )
    other = of.hybrid({"flow": flow}, [reset], ["spike"])
    known = [of.find_orbit(of.Problem(each, of.Guess([-65.0, 0.0], period=40.0))) for each in (model, other)]
    assert all(each.certificate.passed for each in known)
    assert known[0].period == pytest.approx(known[1].period, rel=1e-10)
    of.save_orbit(known[0], tmp_path / "orbit.json")
    assert command("verify", tmp_path / "orbit.json").exit_code == 0
    numbers = SPIKE | {"reset": {"v": -65}}
    assert (
        of.equations(NEURON, VALUES, events={"spike": numbers}, cycle=["spike", "spike"]).hybrid.cycle == ("spike",) * 2
    )


@pytest.mark.parametrize(
    "events, why",
    [
        ({"spike": {"guard": "v", "when": 1}}, "events.spike: got"), ({"spike": {"guard": 3}}, "events.spike: got"),
        ({"spike": SPIKE | {"reset": {"w": "1"}}}, "events.spike.reset: 'w' is no state; states are v, u"),
        ({"spike": SPIKE | {"guard": "w"}}, "events.spike.guard: unknown name 'w'"),
        ({"spike": SPIKE | {"reset": {"v": "w"}}}, "events.spike.reset.v: unknown name 'w'"),
        ({"spike": SPIKE | {"direction": 0}}, "events.spike: got"), ({"spike": {"guard": "I"}}, "never crossed"),
        ({"spike": SPIKE | {"direction": "up"}}, "events.spike: got"),
        ({"spike": SPIKE | {"guard": "v - t"}}, "depends on the time t"),
    ],
)  # fmt: skip
def test_wrong_events_are_refused_by_name(events, why):
    assert why in refused(rates=NEURON, parameters=VALUES, events=events)
    with pytest.raises(InputError, match="cycle: has no meaning without events"):
        of.equations(NEURON, VALUES, cycle=["spike"])
    with pytest.raises(InputError, match="has no meaning beside kinetic"):
        of.equations(kinetic="vdot^2/2", coordinates=["v"], events=events)


# -------------------------------------------------------------------------------------------------------- AUTO


def test_a_solution_of_auto_is_a_start():
    """A file that AUTO-07p wrote: the last cycle at its parameter, by name from b.brusselator or by place."""
    guess = of.from_auto(DATA / "auto", parameters=["b"])
    assert guess.period == pytest.approx(6.4965804533, rel=1e-12) and guess.free == {"b": pytest.approx(2.4, rel=1e-8)}
    assert guess.times[0] == 0 and guess.times[-1] == guess.period and guess.states.shape == (33, 2)
    model = of.equations({"x": "a + x^2*y - (b + 1)*x", "y": "b*x - x^2*y"}, {"a": 1.0, "b": 1.8})
    orbit = of.find_orbit(of.Problem(model, guess, free=["b"], pin=of.pin(b=guess.free["b"])))
    assert orbit.certificate.passed and orbit.period == pytest.approx(guess.period, rel=5e-6)  # of 8 intervals
    assert orbit.system["parameters"]["b"] == guess.free["b"]
    other = of.from_auto(DATA / "auto" / "b.brusselator", label=5, parameters={"b": 2})
    assert other.free["b"] == pytest.approx(2.2153078395) and other.period == pytest.approx(6.3779585, rel=1e-7)


def test_what_the_exporter_writes_for_auto_comes_back(tmp_path):
    """NAME.dat of an orbit: its period and profile, from which it is found again."""
    orbit = of.find_orbit(of.load_problem(FILES / "van-der-pol.toml"))
    of.export_orbit(orbit, "auto", tmp_path)
    guess = of.from_auto(tmp_path)
    assert guess.period == pytest.approx(orbit.period, rel=1e-15)
    assert guess.state == pytest.approx(orbit.state, rel=1e-12) and len(guess.times) == 2001
    again = of.find_orbit(of.Problem(model_of("van-der-pol"), guess))
    assert again.period == pytest.approx(orbit.period, rel=1e-13)


@pytest.mark.skipif(not (AUTO / "cmds" / "@r").exists() or not shutil.which("gfortran"), reason="needs AUTO-07p")
def test_what_auto_makes_of_an_exported_orbit_comes_back(tmp_path):
    orbit = of.find_orbit(of.load_problem(FILES / "van-der-pol.toml"))
    of.export_orbit(orbit, "auto", tmp_path)
    environment = os.environ | {"AUTO_DIR": str(AUTO), "OMP_NUM_THREADS": "1"}
    name = next(tmp_path.glob("*.f90")).stem
    subprocess.run(["sh", AUTO / "cmds" / "@r", name], cwd=tmp_path, env=environment, check=True, capture_output=True)
    guess = of.from_auto(tmp_path / "fort.8", parameters=["mu"])
    again = of.find_orbit(of.Problem(model_of("van-der-pol"), guess, free=["mu"], pin=of.pin(mu=guess.free["mu"])))
    assert guess.free["mu"] != 1.0 and again.period == pytest.approx(guess.period, rel=1e-6)
    assert of.from_auto(tmp_path, parameters=["ICP"]).free == guess.free
    rows = branches(tmp_path / "fort.7", ("mu", "period", "max_x", "PT"))
    assert rows[-1, :2] == pytest.approx([guess.free["mu"], guess.period], rel=1e-9) and (rows[:, 3] < 0).all()
    assert rows[-1, 2] == pytest.approx(guess.states[:, 0].max(), rel=1e-9)


CONSTANTS = """# what is continued, in which 'ICP = [1]'
! parnames = {1: 'wrong'}
parnames = {1: 'a', 2: "b",
            11: T}, unames = {1: 'x', 2: 'y'}
NDIM = 2, IPS = 2   # ICP = ['a'] before
NTST = 8, NCOL = 4 DS = -0.02, ICP = [%s], UZR = {'b': [2.1, 2.4]}
"""


@pytest.mark.parametrize(
    "freed", ["'b', 11", '"b" "T"', "b T", "2, 11", "'T',\n  'b'", "2 'PERIOD'", "1, 'b', 11"]
)  # fmt: skip
def test_constants_of_auto_name_parameters(tmp_path, freed):
    """Without b.NAME: parnames of c.NAME in each quotation, and what ICP frees besides the period."""
    shutil.copy(DATA / "auto" / "s.brusselator", tmp_path)
    (tmp_path / "c.brusselator").write_text(CONSTANTS % freed)
    wanted = {"a": 1.0} if freed.startswith("1") else {}
    both = {"a": 1.0, "b": pytest.approx(2.4, rel=1e-8)}
    for path in (tmp_path, tmp_path / "c.brusselator", tmp_path / "s.brusselator", tmp_path / "b.brusselator"):
        assert of.from_auto(path, parameters=["b", "a"]).free == both
        assert of.from_auto(path, parameters=["ICP"]).free == wanted | {"b": both["b"]}
        assert of.from_auto(path, parameters=("ICP",)).free == wanted | {"b": both["b"]}
        assert of.from_auto(path).free == {}
    assert of.from_auto(tmp_path, parameters={"ICP": 1}).free == {"ICP": 1.0}


def test_constants_of_auto_come_before_its_branches(tmp_path):
    """What was active is b.NAME's word where c.NAME is absent; numbers in a fixed order say nothing."""
    for letter in "bs":
        shutil.copy(DATA / "auto" / f"{letter}.brusselator", tmp_path)
    assert list(of.from_auto(tmp_path, parameters=["ICP"]).free) == ["b"]
    (tmp_path / "c.brusselator").write_text(
        "ICP = [1, 11]\nparnames = {1: 'rate'}  # \N{LATIN SMALL LETTER E WITH ACUTE}"
    )
    assert of.from_auto(tmp_path, parameters=["ICP"]).free == {"rate": 1.0}
    assert list(of.from_auto(tmp_path, parameters=["rate", "b"]).free) == ["rate", "b"]
    (tmp_path / "c.brusselator").write_text("2 2 2 1   NDIM,IPS,IRS,ILP\n2 1 11   NICP,(ICP(I),I=1,NICP)\n")
    assert list(of.from_auto(tmp_path, parameters=["ICP"]).free) == ["b"]
    (tmp_path / "b.brusselator").unlink()
    with pytest.raises(
        InputError, match=r"parameters.ICP: no place .*of b.brusselator and c.brusselator name PERIOD; wri"
    ):
        of.from_auto(tmp_path, parameters=["ICP"])


@pytest.mark.parametrize(
    ("constants", "why"),
    [
        ("ICP = ['mu', 11]\nparnames = {1: 'nu'}", "parameters.mu: no place .*, did you mean 'nu'"),
        ("ICP = [4, 11]", r"parameters.4: no place in PAR\(1\) to PAR\(36\)"),
        ("ICP = [mu]\nparnames = {99: 'mu'}", "parameters.mu: no place"),
        ("ICP = [mu]\nparnames = {0: 'mu'}", "parameters.mu: no place"),
        ("ICP = [__import__('os').mkdir('here')]", r"parameters.__import__\(: no place"),
        ("parnames = {1: 'mu'", "parameters.ICP: no place"),
        ("ICP = [" + "9" * 5000 + "]", "parameters.9999"),
        (b"\xff\xfe", "c.brusselator: no file of AUTO's, which are plain text"),
    ],
)
def test_constants_that_name_nothing(tmp_path, monkeypatch, constants, why):
    monkeypatch.chdir(tmp_path)
    shutil.copy(DATA / "auto" / "s.brusselator", tmp_path)
    (tmp_path / "c.brusselator").write_bytes(constants if isinstance(constants, bytes) else constants.encode())
    with pytest.raises(InputError, match=why):
        of.from_auto(tmp_path, parameters=["ICP"])
    assert not (tmp_path / "here").exists()


def test_hostile_constants_are_read_in_a_time_that_grows_with_their_size(tmp_path):
    """Openings that never close, spaces and digits: a backtracking expression would need hours for these."""
    shutil.copy(DATA / "auto" / "s.brusselator", tmp_path)
    many = 200_000
    for text in (
        "parnames = {" * many, "ICP = [" * many, "parnames = {1:" + " " * many + "}", "#" * many, " #" * many,
        "parnames = {" + "1" * many + ":}", "parnames" + " " * many, "parnames = {" + "1: ' " * many + "}",
    ):  # fmt: skip
        (tmp_path / "c.brusselator").write_text(text)
        with pytest.raises(InputError, match="no place"):
            of.from_auto(tmp_path, parameters=["ICP"])


HEADER = "   0    PT  TY  LAB       b               L2-NORM             MAX x              MIN y                T\n"


def test_branches_of_auto(tmp_path):
    """Columns by our names, of the branches that have them; PT is negative where stable."""
    rows = branches(DATA / "auto" / "b.brusselator", ("b", "period", "max_y", "PT"))
    assert rows.shape == (29, 4) and rows[1].tolist() == [2.0002000129, 6.2832551748, 2.0232038872, -2.0]
    assert rows[-1, :2] == pytest.approx([2.4, 6.4965804533], rel=1e-8)
    text = "   0\n   0   parnames = {2: 'b', 11: 'T'}\n" + HEADER
    text += "   1     3   0    0  2.5E+000 1 4.0 0.1 7.0\n   0\n"
    text += "   0    PT  TY  LAB       b               y\n 1 1 0 0 9.0 8.0\n"
    (tmp_path / "b.x").write_text(
        text + HEADER + "   2    -1   9    1  2.0-100 1 4.5 0.2 7.5\n   2    -2   0    0  2.0\n"
    )
    assert branches(tmp_path / "b.x", ("b", "period", "PT", "min_y")).tolist() == [
        [2.5, 7, 3, 0.1],
        [2e-100, 7.5, -1, 0.2],
    ]
    assert branches(tmp_path / "b.x", ("y", "b")).tolist() == [[8.0, 9.0]]
    (tmp_path / "b.x").write_text(HEADER + " 1 1 0 0 1.7976+308 1 4 0.1 -1E99\n 1 2 0 0 inf 1 4 0.1 9.9E98\n")
    assert np.isnan(branches(tmp_path / "b.x", ("b", "max_x", "T"))).tolist() == [
        [True, False, True],
        [True, False, False],
    ]
    for name, content, why in (
        ("b.x", text, "no branch has b, frequency; the last has b, y; AUTO names"),
        ("b.none", "", "no branch has b, frequency; the last has none"),
        ("b.words", HEADER + "some words", "could not convert string to float: 'some'"),
    ):
        (tmp_path / name).write_text(content)
        with pytest.raises(InputError, match=why):
            branches(tmp_path / name, ("b", "frequency"))


def test_numbers_as_fortran_writes_them(tmp_path):
    """An exponent of three digits has no E."""
    text = (DATA / "auto" / "s.brusselator").read_text()
    (tmp_path / "s.small").write_text(
        text.replace("0.0000000000E+000  8.1218570515E-001", "0.0000D+000  8.1218570515-101")
    )
    assert of.from_auto(tmp_path, label=4).state[0] == 8.1218570515e-101


def test_files_that_are_none_of_autos(tmp_path):
    text = (DATA / "auto" / "s.brusselator").read_text()
    lines = text.splitlines()
    cases = {
        "words": ("some text\n", "line 1: 'some text' is no head of a solution"),
        "empty": ("", "is empty; give s.NAME"),
        "cut": ("\n".join(lines[:40]), "is cut off; copy the file again"),
        "letters": (text.replace("8.1218570515E-001", "8.12x"), "could not convert string to float"),
        "nan": (text.replace("8.1218570515E-001", "NaN"), "no rows t, U"),
        "rest": ("1 1 9 1 1 1 1 3 2 1 0 36 0 2 1 0\n0.0 1.0 1.8\n" + "0.0 " * 36,
                 r"label: 1 is an equilibrium; give follow_equilibria the state \[1, 1.8\]"),
        "aperiodic": (text.replace("6.4965804533E+000", "0.0000000000E+000"), r"or PAR\(11\) = 0 is no period"),
    }  # fmt: skip
    for name, (content, why) in cases.items():
        (tmp_path / f"s.{name}").write_text(content)
        label = 4 if name in ("letters", "nan") else None
        with pytest.raises(InputError, match=why):
            of.from_auto(tmp_path / f"s.{name}", label=label)
    (tmp_path / "s.binary").write_bytes(b"\xff\xfe")
    (tmp_path / "one.dat").write_text("0 1\n1 2 3\n")
    for call, why in (
        (lambda: of.from_auto(DATA / "auto", label=77), "label: 77 is not in .*it has 4, 5, 6"),
        (lambda: of.from_auto(DATA / "auto", parameters=["bb"]), "parameters.bb: no place in PAR.*, did you mean 'b'?"),
        (lambda: of.from_auto(DATA / "auto", parameters={"b": 99}), r"parameters.b: .*PAR\(36\).*PERIOD, a, b, T;"),
        (lambda: of.from_auto(tmp_path), "path: .* has s.aperiodic, .*give a single file"),
        (lambda: of.from_auto(tmp_path / "s.binary"), "no file of AUTO's, which are plain text"),
        (lambda: of.from_auto(tmp_path / "one.dat"), "no rows t, U"),
        (lambda: of.from_auto(tmp_path / "one.dat", label=1), "a .dat file has no labels and no parameters"),
        (lambda: of.from_auto(tmp_path / "s.none"), "no such file"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=why):
            call()
