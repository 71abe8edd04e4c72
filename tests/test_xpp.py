"""XPPAUT's files: a rule of its manual a test, rates worked out by hand, and what has no meaning refused with its line.

Rates of public files are compared with XPPAUT's own by benchmarks/xppaut_rates.py.
"""

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import Hint, InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.problemfile.read import load_problem_file

ROOT = Path(__file__).parents[1]
FILES, DATA = ROOT / "problems" / "equations", ROOT / "tests" / "data"
ROAD = {entry["id"]: entry for entry in json.loads((DATA / "road.json").read_text())}


def command(*words):
    return CliRunner().invoke(cli, list(map(str, words)))


def followed(file, parameter, until, out):
    return command("equilibria", file, "--parameter", parameter, "--until", until, "-o", out, "--json")


def model_of(name):
    return load_problem_file(FILES / f"{name}.toml").model


@pytest.fixture
def read(tmp_path):
    """(text, and what `of.from_xpp` takes) -> the Model of a file with that text."""

    def model(text, **given):
        (tmp_path / "a.ode").write_text(text)
        return of.from_xpp(tmp_path / "a.ode", **given)

    return model


def rates(model, state):
    return model.rates(0, state, model.parameter_values).full().ravel()


def test_an_xppaut_file_is_the_same_neuron(tmp_path):
    """Rates to the last bits, its initial state, and the Hopf points of road.json from the file by the command."""
    model, own = of.from_xpp(DATA / "morris-lecar.ode"), model_of("morris-lecar")
    assert model.state_names == ("V", "w") and model.landmarks["init"] == (-60.0, 0.01)
    assert model.parameter_names == ("I", "gca", "gk", "gl", "phi", "c")  # numbers are fixed, names as they are defined
    for state in np.random.default_rng(1).normal(size=(20, 2)) * [30, 1]:
        assert model.rates(0, state, model.parameter_values).full() == pytest.approx(
            own.rates(0, state, own.parameter_values).full(), rel=1e-14
        )
    made = followed(DATA / "morris-lecar.ode", "I", 250, tmp_path)
    assert made.exit_code == 0, made.output
    wanted = [float(hopf["parameter"]) for hopf in ROAD["eq-ml-hopf-class"]["values"]["hopf"]]
    assert [event["parameter"] for event in json.loads(made.stdout)["events"]] == pytest.approx(wanted, rel=1e-12)
    assert command("verify", tmp_path / "morris-lecar" / "equilibria.json").exit_code == 0
    assert load_problem_file(DATA / "morris-lecar.ode").duration == 150


def test_functions_conditions_and_abbreviations_of_xppaut():
    model = of.from_xpp(str(DATA / "spike-rate.ode"))
    assert model.state_names == ("u", "a") and model.parameter_names == ("b", "tau")
    assert model.landmarks["init"] == (0.25, 0.1)

    def exact(u, a, b=0.5, tau=2.0):
        x, gain = u - a, 1 if u >= 1 else max(u, -1)
        fired = x**2 / (1 + x**2) if x > 0 and a > -10 else 0
        return [-u + fired + (b if u >= 0 else 0) + math.log(2), (gain - a) / tau]

    for state in [(0.25, 0.1), (2.0, 0.5), (-3.0, 1.0), (0.0, -11.0)]:
        assert model.rates(0, state, model.parameter_values).full().ravel() == pytest.approx(exact(*state), rel=1e-15)
    assert build_model(model.system).system == model.system


def test_guess_writes_a_problem_file_of_an_xppaut_file(tmp_path):
    """Its closest return is found again as the cycle of road.json."""
    file, out = tmp_path / "spiking.ode", tmp_path / "spiking.toml"
    file.write_text((DATA / "morris-lecar.ode").read_text().replace("par I=0", "par I=150"))
    assert command("guess", file, "--out", out).exit_code == 0
    assert command("run", out, "-o", tmp_path, "--no-figures").exit_code == 0
    orbit = of.load_orbit(tmp_path / "spiking" / "orbit.json")
    (wanted,) = (float(one["period"]) for one in ROAD["cyc-ml"]["values"] if one["parameter"] == 150)
    assert orbit.period == pytest.approx(wanted, rel=1e-12)


def test_not_of_xppaut_is_a_function(tmp_path):
    """not(x>1)*3 is 3 times the opposite, not the opposite of a product."""
    (tmp_path / "not.ode").write_text("x'=not(x>1)*3-NOT(x<1|x>2)*LOG10(100)\n")
    model = of.from_xpp(tmp_path / "not.ode")
    assert [float(model.rates(0, [x], [])) for x in (0.5, 1.5, 3.0)] == pytest.approx([3.0, -2.0, 0.0])


def test_a_forced_xppaut_file_takes_its_period_from_the_call(tmp_path):
    file = tmp_path / "forced.ode"
    file.write_text("par w=2\nx'=-x+cos(w*t)\n")
    assert float(of.from_xpp(file, period="2*pi/w").forcing_period([2.0])) == pytest.approx(math.pi)
    with pytest.raises(InputError, match=r"line 2: .*depends on the time t; give the period of that.* time = 0"):
        of.from_xpp(file)
    assert float(of.from_xpp(file, time=math.pi / 2).rates(0, [2.0], [2.0])) == pytest.approx(-3.0)
    with pytest.raises(InputError, match="has no period; leave period out"):
        of.from_xpp(file, time=0.0, period=1.0)


def test_commands_take_a_time_or_a_period_after_the_name(tmp_path):
    """x' = a - x + cos t at t = 0 rests at a + 1."""
    (tmp_path / "a.ode").write_text("par a=1\nx'=a-x+cos(t)\ninit x=2\n")
    done = followed(f"{tmp_path}/a.ode#time=0", "a", 2, tmp_path / "out")
    assert done.exit_code == 0, done.output
    rest = of.load_equilibria(tmp_path / "out" / "a" / "equilibria.json")
    assert [point.state[0] for point in rest.points] == pytest.approx([point.value + 1 for point in rest.points])
    shown = command("show", f"{tmp_path}/a.ode#period=2*3.141592653589793")
    assert shown.exit_code == 0 and re.search(r"forced +True", shown.output)
    for words, why in (
        ("time=nan", "'time=nan' after the name; give #time=NUMBER"),
        ("tome=1", "'tome=1' after the name"),
        ("period=", "'period=' after the name"),
        ("period=exit()", "system.period: 'exit"),
    ):
        refused = command("show", f"{tmp_path}/a.ode#{words}")
        assert refused.exit_code == 2 and why in refused.output


READ = {
    "x'=-2*x": -2.0,
    "x'=[3]*x": 3.0,
    "dx/dt = a\npar a = 4 , b": 4.0,
    "% a comment\nx'=1": 1.0,
    "\"one more {a=1}\nx'=1": 1.0,
    "a=2\nx'=a\n! b = 3*a": 2.0,
    "x'=flr(2.7)+sign(-3)": 1.0,
    "x'=mod(-1, 3)+mod(7,2.5)": 4.0,
    "x'=erf(0)+erfc(0)": 1.0,
    "f(t)=t^2\nx'=f(3)": 9.0,
    "x'=sum(0,3)of(i'*x)": 6.0,
    "x'=sum(1,2)of(shift(a,i'))\npar a=1,b=2,c=3": 5.0,
    "x'=shift(x,mod(3,2))\ny'=0\ninit x=1,y=7": 7.0,
    "table f % 5 0 4 t^2\nx'=f(2.5)": 6.5,
    "x'=p\np=1\naux q=ran(1)": 1.0,
    "table f % 3 0 2 b*t\npar b=3\nx'=f(5)": 15.0,
    "x'=1\nz=delay(x,1)": 1.0,
    "x'=a\n!a=b*2\nnumber b=.5": 1.0,
    "x'=1\nb x-1\nbndry x'-2\nonly x\noptions o.opt\nset one {x=1}": 1.0,
    "x'=period\npar period=3": 3.0,
    "x'=heav(x-1)+heav(-x)": 1.0,
    "x'=1\nThese are words": 1.0,
    "x'=1\ndone\nnonsense (": 1.0,
    "x'=if(x>0)then(2)else(3)": 2.0,
    "x'=5HT-2b\n5HT=4*2B\npar 2b=3": 9.0,
    "x'=1+\\\\ \n2": 3.0,
    "x[1...2]'=1\ninit x1=1": 1.0,
}
"""At x = 1 (or its initial state) what each text gives as the first rate"""


@pytest.mark.parametrize("text", READ)
def test_each_rule_of_the_manual(text, read):
    model = read("init x=1\n" + text if "init" not in text else text)
    assert rates(model, model.landmarks["init"])[0] == pytest.approx(READ[text], rel=1e-14)
    assert build_model(model.system).system == model.system


def test_arrays_are_written_out(read):
    """A ring of twenty, its initial states by an array, and lines that are repeated with the first falling."""
    text = "par d=2\nx[1..20]'=d*(x[j-1]-2*x[j]+x[j+1])\nx0=x20\nx21=x1\nx[1..20](0)=.5\ninit x3=1\n"
    model = read(text)
    state = np.random.default_rng(0).normal(size=20)
    assert model.state_names == tuple(f"x{k}" for k in range(1, 21)) and model.landmarks["init"][2] == 1
    assert rates(model, state) == pytest.approx(2 * (np.roll(state, 1) - 2 * state + np.roll(state, -1)), rel=1e-13)
    other = read("%[3..1]\nu[j]'=[j*2]*v[j]\nv[j]'=-u[j]\n%\n")
    assert other.state_names == ("u3", "v3", "u2", "v2", "u1", "v1")
    assert rates(other, np.arange(1.0, 7.0)) == pytest.approx([12, -1, 16, -3, 12, -5])


def test_what_is_left_out_is_in_the_record_and_shown(read, tmp_path):
    model = read("par energy=1\nx'=energy-x\naux twice=2*x\ntmin=t/60\nbndry x-1\nlow glucose, r=0.04\nonly x\n")
    left = [
        "aux twice",
        "bndry x-1",
        "unknown low glucose, r=0.04",
        "only x",
        "tmin enters no rate",
        "energy is called energy_1",
    ]
    assert model.system["left_out"] == left and model.parameter_names == ("energy_1",) and not model.forced
    of.save_equilibria(of.follow_equilibria(model, [1.0], "energy_1", until=2.0), tmp_path / "equilibria.json")
    for file in ("equilibria.json", "a.ode"):
        made = command("show", tmp_path / file)
        assert made.exit_code == 0 and "low glucose, r=0.04" in made.output, made.output


def test_a_table_of_a_file_lies_beside_it(read, tmp_path):
    (tmp_path / "f.tab").write_text("3\n0\n2\n1\n3\n2\n")
    model = read("table f f.tab\nx'=f(x)\n")
    places = [-1.0, 0.0, 0.5, 1.0, 1.75, 4.0]
    assert [float(rates(model, [place])[0]) for place in places] == pytest.approx([-1, 1, 2, 3, 2.25, 0])
    for name, content, why in (
        ("../f.tab", "", "lies outside"),
        ("g.tab", None, "no such file"),
        ("h.tab", "3 0 2 1 2", "is no table"),
        ("i.tab", "2 0 1 nan 1", "is no table"),
        ("j.tab", "1e9 0 1 2", "is no table"),
        ("k.tab", "x", "is no table"),
    ):
        if content:
            (tmp_path / name).write_text(content)
        with pytest.raises(InputError, match=why):
            read(f"table f {name}\nx'=f(x)\n")


def test_global_makes_an_automaton(read):
    """Integrate and fire: x' = I - x from 0 to 1 in log(I / (I - 1)), certified."""
    model = read("par i=2\nx'=i-x\nglobal 1 {x-1} {x=0;out_put=1}\n")
    assert not model.smooth and model.system["events"] == {
        "event_1": {"guard": "x-1", "direction": 1, "reset": {"x": "0"}}
    }
    orbit = of.find_orbit(of.Problem(model, of.Guess([0.0], period=0.7)))
    assert orbit.certificate.passed and orbit.period == pytest.approx(math.log(2), rel=1e-10)
    two = read("par c=.5\nx'=-c\ny'=0*x\nglobal 0 x-y {x=x+1;y=y-1}\nglobal 1 x {arret=1}\n")
    assert {name: event["direction"] for name, event in two.system["events"].items()} == {"event_1": -1, "event_2": 1}
    assert build_model(two.system).system == two.system


def test_a_value_is_what_xppaut_reads_of_it(read):
    """A number is its beginning, as C's atof has it, and that is said."""
    with pytest.warns(Hint, match="line 2: 'par b=8/3': b=8/3 as 8: XPPAUT reads no more of it"):
        model = read("x'=b\npar b=8/3\n")
    assert model.parameter_values.tolist() == [8.0] and "read b=8/3 as 8" in model.system["left_out"]
    with pytest.warns(Hint, match="x=c as 0"):
        assert read("x'=1\ninit x=c\n").landmarks["init"] == (0.0,)


def test_a_start_may_be_a_formula(read):
    """Of parameters and functions; one that is drawn at random is 0 and said."""
    text = "par a=3\nf(u)=u^2\nx[1..2]'=x[j]\ny'=a\nz'=-z\ninit x1=2\nx2(0)=f(a)+x1\ny(0)=ran(1)\nz(0)=exp(t)\n"
    model = read(text)
    assert model.landmarks["init"] == (2.0, 11.0, 0.0, 1.0) and "start y(0)=ran(1)" in model.system["left_out"]
    assert read("par a=3\nx'=y\ny'=x\nx(0)=log(-a)\ny(0)=a\n").landmarks["init"] == (0.0, 3.0)
    assert read("par a=3\nx'=y\ny'=x\nx(0)=q\ny(0)=a\n").landmarks["init"] == (0.0, 3.0)  # q is nothing
    many = read("x[1..400]'=-x[j]\nx[1..400](0)=ran(1)\nx7(0)=2\n")  # takes no model for each
    assert set(many.landmarks["init"]) == {0.0, 2.0} and len(many.system["left_out"]) == 399


def test_parameters_at_a_time_are_those_that_events_have_left(tmp_path):
    """x' = a - x, where a doubles at 5, is 7 more from 20 minutes on, and does nothing at 400."""
    text = (
        "par a=1,k=2\nx'=a-x\nm=t/60\nglobal 1 {m-20} {a=a0+7;x=3}\nglobal 1 t-5 {a=2*k}\nglobal 1 400-t {a=9}\na0=k\n"
    )
    (tmp_path / "a.ode").write_text(text)
    for time, value in ((0.0, 1.0), (4.0, 1.0), (6.0, 4.0), (1199.0, 4.0), (1201.0, 9.0)):
        model = of.from_xpp(tmp_path / "a.ode", time=time)
        assert dict(zip(model.parameter_names, model.parameter_values, strict=True))["a"] == value and model.smooth
    assert "global 1 t-5 {a=2*k}" in model.system["left_out"]
    (tmp_path / "a.ode").write_text("par a=1\nx'=a-x\nglobal 1 t-3 {a=a*10}\nglobal 1 t-2 {a=a+1}\n")
    model = of.from_xpp(tmp_path / "a.ode", time=4.0)  # each takes what the events before it left
    assert model.parameter_values.tolist() == [20.0]
    for line, why in (
        ("global 1 {x+t-5} {a=2}", "no time at which it happens"),
        ("global 1 sin(t) {a=2}", "no time at which it happens"),
        ("global 1 t-a {a=3}", "no time at which it happens"),
        ("global 1 t-5 {a=2*x}", "gives a parameter a value of the state then"),
    ):
        (tmp_path / "a.ode").write_text(f"par a=1\nx'=a-x\n{line}\n")
        with pytest.raises(InputError, match=f"line 3: .*{why}"):
            of.from_xpp(tmp_path / "a.ode", time=6.0)


REFUSED = {
    "markov z 2": "jumps at random",
    "wiener w": "noise makes no",
    "y'=delay(x,3)": "a value of the past",
    "volt x": "an integral",
    "0=x-1": "equations 0=... are not read",
    "y(t)=int{x}": "an integral over",
    "x(t+1)=x": "makes a map",
    "y'=ran(1)": "at random",
    "y'=xx": "unknown name 'xx', did you mean 'x'?",
    "par 8=b": "'8=b' is no name=number",
    "5HT'=5HQ": "no expression",
    "x'=2*x": "x is defined in line 2 too",
    "par X=1": "X is defined in line 2 too",
    "init q=3": "the rate of q",
    "y'=x +": "no expression",
    "y'=x.real": "'.' is not expected",
    "y'=10^400": "no finite real number",
    "x==3": "is not understood",
    "y'=": "is not understood",
    "y'=foo(x)": "'foo(x)' is not allowed",
    "solv y=1": "equations 0=",
    "special k=conv(even,9,2,w,x)": "a whole network",
    "group g 2": "groups are not read",
    "x[j]'=1": "[j] belongs to a line with a range",
    "global 1 x-1 {a=2}": "a is a parameter that it changes",
    "global 1 t-1 {x=2}": "happens at a time",
    "global 1 t-1 {a=2}": "take the rates at a time",
    "global 1 x-1 {x=t}": "happens at a time",
    "global 1 x {q=2}": "resets no variable",
    "global x {x=2}": "is not understood; write global 1",
    "y'=sum(0,x)of(i')": "a sum is written",
    "y'=shift(x,90)": "is no variable",
    "y'=sum(0,999999)of(x)": "letters with its sums",
    "y'=sum(0,9999999999)of(x)": "a sum is written",
    "y'=shift(x," + "(" * 3000 + "1": "no expression",
    f"y[1..{'9' * 5000}]'=1": "is not understood",
    "y'=int{x}": "an integral int",
    "y[1..99999]'=1": "at most 5000 are read",
}


@pytest.mark.parametrize("line", REFUSED)
def test_what_is_not_understood_is_named_with_its_line(line, tmp_path):
    file = tmp_path / "bad.ode"
    file.write_text(f"par a=1\nx'=-a*x\n\n{line}\ndone\n")
    made = command("simulate", file)
    said = made.stderr.replace("\n", "")
    shown = repr(line) if len(line) < 50 else repr(line)[:50]
    assert made.exit_code == 2 and f"{file}: line 4: {shown}" in said and REFUSED[line] in said, made.stderr


def test_a_file_without_equations_or_that_is_no_text(tmp_path):
    for content, why in (
        (b"par a=1\n", "no equations x'=... or dx/dt=..."),
        (b"\xff\xfe\x00", "not text"),
        (b"2\nv x=1,y=2\n", "old form"),
        (b"%[1..3]\nx[j]'=1\n", "are not ended"),
        (b"x'=1\ny'=f(x)\nf(a)=f(a)", "is defined by itself"),
        (b"x[1..300]'=1\n%[1..4000]\na[j]=1\nb[j]=1\n%\n", "more than 5000 lines"),
    ):
        (tmp_path / "none.ode").write_bytes(content)
        with pytest.raises(InputError, match=why):
            of.from_xpp(tmp_path / "none.ode")
    (tmp_path / "none.ode").write_bytes("# caf\xe9 \xb5\nx'=-x\n".encode("latin-1"))
    assert of.from_xpp(tmp_path / "none.ode").state_names == ("x",)
    with pytest.raises(InputError, match="no such file"):
        of.from_xpp(tmp_path / "missing.ode")


def test_a_problem_file_may_name_an_xppaut_file(tmp_path):
    """With other values of its parameters, at a time or with a period; what is found has the equations in it."""
    spiral = "r=heav(t-t0)*(1-x^2-y^2)\nx'=r*x-a*y\ny'=r*y+a*x\n"  # to a circle: of a centre which orbit is luck
    (tmp_path / "a.ode").write_text("par a=-1, t0=5\n" + spiral)
    text = '[system]\nkind = "xpp"\nfile = "a.ode"\ntime = 6.0\nparameters = { a = -2.0 }\n'
    text += "[guess]\nstate = [1.25, 0]\nperiod = 3\n"
    (tmp_path / "b.toml").write_text(text)
    made = command("run", tmp_path / "b.toml", "-o", tmp_path, "--no-figures")
    assert made.exit_code == 0, made.output
    orbit = of.load_orbit(tmp_path / "b" / "orbit.json")
    assert orbit.period == pytest.approx(math.pi, rel=1e-12) and orbit.system["kind"] == "equations"
    assert command("show", tmp_path / "b.toml").exit_code == 0
    for wrong, why in (("a = -2.0", "b = 1.0"), ("a.ode", "../a.ode"), ('"a.ode"', '"c.ode"'), ("time = 6.0\n", "")):
        (tmp_path / "b.toml").write_text(text.replace(wrong, why))
        assert command("run", tmp_path / "b.toml", "-o", tmp_path).exit_code == 2


def test_large_arrays_and_endless_tables(tmp_path):
    """A thousand states of an array, and a table that reaches to infinity."""
    (tmp_path / "a.ode").write_text("x[1..1000]'=-x[j]\ntable f % 3 0 1e999 t\n")
    assert len(of.from_xpp(tmp_path / "a.ode").state_names) == 1000
    (tmp_path / "a.ode").write_text("x'=f(x)\ntable f % 3 0 1e999 t\n")
    with pytest.raises(InputError, match="rows from 0.0 to inf"):
        of.from_xpp(tmp_path / "a.ode")
