"""Units are words: those that a file or a model says are in every text, table, picture and page, unconverted."""

from importlib.util import find_spec

import casadi as ca
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.scales import SI, units, worded
from orbitfinder.problemfile.write import orbit_text
from orbitfinder.records.orbit import orbit_to_document
from orbitfinder.show.diagram import entitled
from orbitfinder.show.facts import facts
from orbitfinder.show.plot import axis_name, time_histories
from orbitfinder.show.style import told_in
from orbitfinder.show.svg import axis
from orbitfinder.site.build import SiteSettings, build_site
from orbitfinder.site.gather import gather

NEURON = """
name = "clock"
title = "Van der Pol's clock"
[system]
kind = "equations"
rates = { V = "W", W = "mu*(1 - V^2)*W - V" }
parameters = { mu = 1.0 }
[units]
time = "ms"
V = "mV"
mu = "nS"
[guess]
state = [2.0, 0.0]
period = 6.7
"""


def run(*words, code=0):
    done = CliRunner().invoke(cli, [*map(str, words)])
    assert done.exit_code == code, done.output
    return done.output


@pytest.fixture(scope="module")
def spring():
    """A mass of 1 t on a spring in mm, t and s, so that forces are in N."""
    q, v = ca.SX.sym("x"), ca.SX.sym("v")
    words = {"length": "mm", "mass": "t", "time": "ms"}
    model = of.lagrange(v**2 / 2, q**2 / 2 + q**4 / 4, of.Symbols(q, v), names=["x"], units=words)
    return model, of.find_orbit(of.Problem(model, of.Guess([1.0, 0.0], 4.7), pin=of.pin(x=1.0), name="spring"))


def test_every_text_and_picture_has_the_words_of_a_model(spring):
    model, orbit = spring
    known = units(orbit.system)
    assert known["energy"] == "t mm^2/ms^2" and known["action"] == "t mm^2/ms^2 ms" and known["angle"] == "rad"
    told = facts(orbit)
    assert told["period"].endswith(" ms") and told["frequency"].endswith(" 1/ms")
    assert told["energy"].endswith(" t mm^2/ms^2")
    assert axis(model, 0) == "x (mm)" and axis(model, 1) == "rate of x (mm/ms)"
    figure = told_in(time_histories(orbit, model), orbit.system)
    labels = {axes.get_ylabel() for axes in figure.axes} | {axes.get_xlabel() for axes in figure.axes}
    assert labels == {"", "time (ms)", "coordinates (mm)", "velocities (mm/ms)"}
    assert " ms" in orbit._repr_html_() and not any(unit in orbit._repr_html_() for unit in (" J<", " s<", "(s)"))
    assert units(of.systems.duffing().system) == SI
    plain = of.lagrange(*duffing(), names=["x"])
    same = of.find_orbit(of.Problem(plain, of.Guess([1.0, 0.0], 4.7), pin=of.pin(x=1.0)))
    assert (same.period, same.energy) == (orbit.period, orbit.energy)  # nothing is converted


def duffing():
    q, v = ca.SX.sym("x"), ca.SX.sym("v")
    return v**2 / 2, q**2 / 2 + q**4 / 4, of.Symbols(q, v)


def test_texts_in_si_take_other_words_or_none():
    words = {"units": {"time": "ms", "length": "mm", "energy": "mJ"}}
    assert worded("T = 3.2 s, -4 J", words) == "T = 3.2 ms, -4 mJ"
    assert worded("velocities (rad/s or m/s)", words) == "velocities (rad/ms or mm/ms)"
    assert worded("frequency (1/s) of what (is no unit)", words) == "frequency (1/ms) of what (is no unit)"
    none = {"function": "lorenz"}
    assert worded("T = 3.2 s (1/s), 4 J, time (s), height (m)", none) == "T = 3.2, 4, time, height"
    hostile = {"units": {"time": "<b>", "energy": ["J"], "length": 3}}
    assert units(hostile) == SI and units({"units": "ms"}) == SI


def test_what_has_no_energy_says_nothing_of_it_and_has_no_unit_unless_told():
    cycle = of.ode(lambda _, x, p: [x.w, p.mu * (1 - x.v**2) * x.w - x.v], ["v", "w"], {"mu": 1.0})
    orbit = of.find_orbit(of.Problem(cycle, of.Guess([2.0, 0.0], 6.7)))
    told = facts(orbit)
    assert told["period"].startswith("6.663") and not told["period"].endswith(" s")
    assert not {"energy", "energy, not conserved", "action"} & told.keys()
    nerve = of.systems.hodgkin_huxley()
    assert units(nerve.system)["time"] == "ms" and axis(nerve, 0).endswith("(mV)")


@pytest.fixture(scope="module")
def clock(tmp_path_factory):
    """An orbit, a family, equilibria and a table of a problem file with [units], by commands."""
    folder = tmp_path_factory.mktemp("clock")
    (folder / "clock.toml").write_text(NEURON)
    said = run("run", folder / "clock.toml", "--out", folder, "--no-figures")
    options = ("--parameter", "mu", "--until", 1.05, "--points", 4, "--out", folder / "families", "--no-figures")
    return folder, said, run("continue", folder / "clock" / "orbit.json", *options)


def test_units_of_a_problem_file_are_in_records_commands_and_pages(clock):
    folder, found, followed = clock
    assert "certified, period 6.66328685932 ms, closure" in found
    assert "mu 1.05 nS" in run("continue", folder / "clock" / "orbit.json", "--parameter", "mu", "--at", 1.05,
                               "--points", 4, "--out", folder / "at", "--no-figures")  # fmt: skip
    orbit = of.load_orbit(folder / "clock" / "orbit.json")
    family = of.load_family(folder / "families" / "clock" / "family.json")
    for record in (orbit, family, family.points[-1]):
        assert record.system["units"] == {**dict.fromkeys(SI, ""), "angle": "rad", "time": "ms", "V": "mV", "mu": "nS"}
    assert "ms" in followed or "target" in followed
    model = build_model(orbit.system)
    assert axis(model, 0).replace("\N{NO-BREAK SPACE}", " ") == "V (mV)" and axis(model, 1) == "W"
    assert axis_name(family).replace("\N{NO-BREAK SPACE}", " ") == "mu (nS)"
    assert run("verify", folder / "clock" / "orbit.json") and run("show", folder / "clock" / "orbit.json")
    text = orbit_text(orbit_to_document(orbit))
    (folder / "again.toml").write_text(text.replace('name = "clock"', 'name = "again"'))
    assert of.load_problem(folder / "again.toml").model.system["units"]["V"] == "mV"
    files = build_site(gather([folder / "clock", folder / "families"]), SiteSettings(verify=False))[0].files
    pages = {name: content.decode() for name, content in files.items() if name.endswith((".html", ".js"))}
    page = next(text for name, text in pages.items() if name.startswith("orbits/"))
    assert "6.663286859317 ms" in page or " ms</" in page
    data = next(text for name, text in pages.items() if name.startswith("data/") and '"axes"' in text)
    assert '"axes":["mV",""]' in data


def test_guesses_sweeps_equilibria_and_chosen_axes_have_the_words(clock, monkeypatch, capfd):
    """And a table of another record of the same name is not written over."""
    folder = clock[0]
    assert "own        period 6.7 ms  misses" in run("guess", folder / "clock.toml")
    swept = ("sweep", folder / "clock.toml", "--parameter", "mu=1,1.05", "--no-orbits", "-o", folder / "sweeps")
    run(*swept)
    assert "mu = 1.05 nS, period 6.70061896 ms, asym" in capfd.readouterr().err
    rest = (folder / "clock.toml").read_text().replace("[2.0, 0.0]", "[0.0, 0.0]").replace("mu = 1.0", "mu = -1.0")
    (folder / "rest.toml").write_text(rest)
    told = run("equilibria", folder / "rest.toml", "--parameter", "mu", "--until", 1, "-o", folder)
    assert " nS +- " in told and ", period 6.28318530718 ms, l1" in told
    drawn = []
    monkeypatch.setattr("orbitfinder.show.plot.save_png", lambda figure, path: drawn.append(figure) or path)
    family = folder / "families" / "clock" / "family.json"
    run("plot", family, "--up", "amplitude_V", "-o", folder)
    (axes,) = drawn[0].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("mu\N{NO-BREAK SPACE}(nS)", "amplitude of V (mV)")
    assert drawn[0].get_suptitle() == "Van der Pol's clock: amplitude of V over mu"
    assert entitled(of.load_equilibria(next(folder.rglob("equilibria.json")))) == "Van der Pol's clock"
    assert 2.0 < axes.lines[0].get_ydata().min() < 2.02
    for _ in range(2):
        run("export", family, "--to", "csv", "-o", folder / "tables")
    orbit = ("export", folder / "clock" / "orbit.json", "--to", "csv", "-o", folder / "tables")
    assert "clock.csv is a table of other columns, of another record" in run(*orbit, code=2)


def test_wrong_words_are_refused(tmp_path):
    for line, message in (
        ('tmie = "ms"', "units: unknown 'tmie', did you mean 'time'"),
        ('time = "<script>"', "units.time: '<script>' is no unit; give a word such as 'ms'"),
        ("time = 3", "units.time: "),
    ):
        (tmp_path / "clock.toml").write_text(NEURON.replace('time = "ms"', line))
        with pytest.raises(InputError, match="units") as error:
            of.load_problem(tmp_path / "clock.toml")
        assert message in str(error.value)
    with pytest.raises(InputError, match="units: unknown 'speed'"):
        of.mechanism({"rod": {"mass": 1.0, "com": [0.5, 0.0], "inertia": 0.1}},
                     {"pin": {"kind": "revolute", "between": ["ground", "rod"]}}, units={"speed": "m/s"})  # fmt: skip


@pytest.mark.skipif(not find_spec("pyarrow"), reason="needs the extra parquet")
def test_columns_of_a_table_have_their_units(clock):
    from pyarrow import parquet

    folder, *_ = clock
    file = folder / "families" / "clock" / "family.json"
    run("export", file, "--to", "parquet", "-o", folder)
    schema = parquet.read_table(folder / "clock.parquet").schema
    told = {name: (schema.field(name).metadata or {}).get(b"unit", b"").decode() for name in schema.names}
    assert {name: unit for name, unit in told.items() if unit} == {
        "mu": "nS", "period": "ms", "amplitude_V": "mV", "min_V": "mV", "max_V": "mV",
    }  # fmt: skip
