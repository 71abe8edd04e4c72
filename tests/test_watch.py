"""What a user watches of an orbit: a column, a stop and an event, by closed forms; in files, after a kill, verified."""

import json
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner

from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.branches import branches
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.verified import verified
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.watch import watches
from orbitfinder.mechanisms.library import forced_duffing
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.family import load_family
from orbitfinder.records.reading import content_digest

PROBLEMS = Path(__file__).parents[1] / "problems"
FORWARD = FamilySettings(directions="forward")
FORCE, DAMPING = 0.7, 0.2
PEAK = np.sqrt(1 - DAMPING**2 / 2)
LINE = """
[system]
kind = "python"
function = "forced_duffing"
arguments = { stiffness = 1.0, cubic = 0.0, damping = 0.2, force = 0.7, frequency = 0.5 }
[guess]
state = [0.9, 0.1]
period = 12.5
[watch]
peak = "max(x)"
"""


def line(frequency=0.5, **more):
    """x'' + c x' + x = F cos w t."""
    model = forced_duffing(1.0, 0.0, DAMPING, FORCE, frequency)
    return Problem(model, Guess([0.9, 0.1], 2 * np.pi / frequency), name="line", **more)


def amplitude(w):
    """That of its motion."""
    return FORCE / np.sqrt((1 - w**2) ** 2 + (DAMPING * w) ** 2)


def largest(times, states, parameters):
    """The same number by a function: at equal times, so that a parabola through three tells its maximum."""
    x, k = states[:, 0], int(np.argmax(states[1:-1, 0])) + 1
    a, b, c = x[k - 1 : k + 2]
    return b + (a - c) ** 2 / (8 * (2 * b - a - c)) + 0.0 * parameters["force"]


@pytest.fixture(scope="module")
def resonance(tmp_path_factory):
    """The linear resonance curve with its amplitude, its range and the mean of its squared velocity."""
    folder = tmp_path_factory.mktemp("watch")
    watch = {"peak": "max(x)", "spread": "max(x) - min(x)", "power": "damping * mean((xdot - mean(xdot))^2)"}
    return follow_family(line(), "frequency", until=2.0, watch=watch, out=folder, settings=FORWARD), folder / "line"


@pytest.fixture(scope="module")
def crest(lend):
    """The folder of a few orbits about the largest amplitude."""

    def make(folder):
        follow_family(line(0.97, watch={"peak": "max(x)"}), "frequency", until=1.0, out=folder, settings=FORWARD)

    folder = lend("crest", make, __file__)
    done = CliRunner().invoke(cli, ["verify", str(folder / "line" / "family.json")])
    assert done.exit_code == 0 and "watch.peak of" in done.output, done.output
    return folder / "line"


def test_columns_are_the_closed_forms(resonance):
    family, folder = resonance
    w = family.values("value")
    assert np.allclose(family.values("peak"), amplitude(w), rtol=2e-12, atol=0)
    assert np.allclose(family.values("spread"), 2 * amplitude(w), rtol=2e-12, atol=0)
    assert np.allclose(family.values("power"), DAMPING * (w * amplitude(w)) ** 2 / 2, rtol=2e-12, atol=0)
    again = load_family(folder / "family.json")
    assert [one.watch for one in (*again.points, *again.events)] == [
        one.watch for one in (*family.points, *family.events)
    ]


def test_the_table_has_the_closed_forms_and_goes_to_files(resonance, tmp_path, monkeypatch):
    """A row a point by the parameter's own name, the amplitude of the coordinate, events and ends; in three formats,
    and as a data frame where there is pandas."""
    family, folder = resonance
    monkeypatch.setitem(sys.modules, "pandas", None)
    table, events, ends = family.table(), family.table("events"), family.table("ends")
    assert table.dtype.names == (
        "index", "frequency", "period", "energy", "action", "amplitude_x", "min_x", "max_x",
        "largest_multiplier", "stability", "certified", "closure", "peak", "spread", "power",
    )  # fmt: skip
    assert all(np.array_equal(table[name], family.values(name)) for name in ("frequency", "peak", "closure"))
    assert np.allclose(table.amplitude_x, amplitude(table.frequency), rtol=2e-5, atol=0)
    assert np.allclose(table.largest_multiplier, np.exp(-DAMPING * table.period / 2), rtol=1e-9)
    assert [*events.detail] == [one.detail for one in family.events]
    assert events.amplitude_x[0] == pytest.approx(amplitude(events.frequency[0]), rel=2e-5)
    assert [*ends.kind] == [one.kind for one in family.ends] and ends.reason[-1] == "reached frequency = 2.0"
    with pytest.raises(InputError, match="of: unknown table 'orbits'; it has points, events, ends"):
        family.table("orbits")
    with pytest.raises(InputError, match="name: unknown 'frequncy', did you mean 'frequency'"):
        family.values("frequncy")
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    assert type(family.table()) is dict and np.array_equal(family.table()["frequency"], table.frequency)
    monkeypatch.delitem(sys.modules, "pandas")
    formats = ("csv", "json", "parquet") if find_spec("pyarrow") else ("csv", "json")
    for to in formats:
        done = CliRunner().invoke(cli, ["export", str(folder / "family.json"), "--to", to, "-o", str(tmp_path)])
        assert done.exit_code == 0, done.output
        names = [f"line{part}.{to}" for part in ("", "-events", "-ends")]
        assert done.output.split() == [str(tmp_path / name) for name in names]
    read = np.genfromtxt(tmp_path / "line.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    rows = json.loads((tmp_path / "line.json").read_text())
    assert read.dtype.names == table.dtype.names == tuple(rows[0])
    assert np.array_equal(read["amplitude_x"], table.amplitude_x) and rows[-1]["amplitude_x"] == table.amplitude_x[-1]
    if len(formats) > 2:
        from pyarrow import parquet

        assert parquet.read_table(tmp_path / "line.parquet").to_pylist() == rows
    refused = CliRunner().invoke(cli, ["export", str(folder / "family.json"), "--to", "c", "-o", str(tmp_path)])
    assert refused.exit_code == 2 and "c files hold orbits, and line is a table; use one of csv" in refused.stderr


def test_a_point_of_a_family_has_samples_where_it_is_asked_for(resonance):
    family, _ = resonance
    assert family.points[3].samples.size == 0 and len(family) == len(family.points) == len([*family])
    point = family[3]
    assert point.samples.shape == (point.times.size, 2) and np.array_equal(point.samples[0], family.points[3].state)
    assert np.abs(point.samples[:, 0]).max() == pytest.approx(amplitude(point.value), rel=2e-5)
    assert np.array_equal(family[-1].state, family.points[-1].state)
    nowhere = replace(family, points=(replace(family.points[0], system={"kind": "mine"}),))
    with pytest.raises(InputError, match=r"cannot rebuild 'mine'.*or of.simulate\(model, point.state, point.period"):
        nowhere[0]


def test_events_are_where_the_numbers_are_extremal(resonance):
    """The amplitude is largest at sqrt(1 - c^2 / 2), the velocity at 1; and nothing else happens."""
    family, _ = resonance
    found = {event.detail: event for event in family.events}
    assert [event.kind for event in family.events] == ["extremum"] * 3 and found.keys() == set(family.points[0].watch)
    for name, place in {"peak": PEAK, "spread": PEAK, "power": 1.0}.items():
        assert found[name].parameter == pytest.approx(place, abs=1e-9) and found[name].check.passed
        assert found[name].certified
    assert found["peak"].watch["peak"] == pytest.approx(amplitude(PEAK), rel=1e-11)


def test_a_stop_is_an_end(tmp_path):
    """Where the amplitude is 2, to round-off, and after it 3, going on; a stop beyond the largest is never met."""
    for wanted in (2.0, 3.0):
        family = follow_family(
            line(watch={"peak": "max(x)"}), "frequency", stop={"peak": wanted}, out=tmp_path, settings=FORWARD
        )
        last = family.points[-1]
        assert [end.kind for end in family.ends] == ["target"] and last.role == "end" and last.certified
        assert abs(last.watch["peak"] - wanted) < 1e-14 and abs(amplitude(last.value) - wanted) < 1e-11
        assert not family.events and all(check.passed for _, check in verified(family, line().model))
    begun = line(watch={"peak": "max(x)"})
    assert follow_family(begun, "frequency", until=1.2, stop={"peak": 4.0}).points[-1].value == 1.2
    settings = FamilySettings(directions="forward", longest_step=3.0, sharpest_turn=1.5, longest_stretch=1.0)
    over = follow_family(begun, "frequency", until=1.2, stop={"peak": 3.51763}, settings=settings)
    assert over.points[-1].watch["peak"] == pytest.approx(3.51763, abs=1e-14) and over.points[-1].value < PEAK


def test_a_function_is_as_good_as_text():
    """But it goes into no file, so that nobody can verify what it says."""
    family = follow_family(line(), "frequency", until=1.1, watch={"peak": largest}, settings=FORWARD)
    assert np.allclose(family.values("peak"), amplitude(family.values("value")), rtol=1e-9)
    (event,) = family.events
    assert event.parameter == pytest.approx(PEAK, abs=1e-4)
    assert family.curve["watch"] == {"peak": {"function": "test_watch.largest"}}
    wrong = [check for _, check in verified(family, line().model) if not check.passed]
    assert len(wrong) == 2 and all("state it as text" in check.note for check in wrong)


@pytest.mark.parametrize("entry", ["points", "events", "ends"])
def test_a_planted_number_is_rejected(crest, tmp_path, entry):
    """In a point, at an event, and what the family is said to have reached."""
    document = json.loads((crest / "family.json").read_text())
    if entry == "ends":
        document["ends"][0]["reason"] = "reached peak = 0.3"
    else:
        document[entry][0]["watch"]["peak"] *= 1 + 1e-8
    document["record"] = content_digest({name: one for name, one in document.items() if name != "record"})
    for name in ("family.json", "family.npz"):
        (tmp_path / name).write_bytes((crest / name).read_bytes())
    (tmp_path / "family.json").write_text(json.dumps(document))
    done = CliRunner().invoke(cli, ["verify", str(tmp_path / "family.json")])
    assert done.exit_code == 1 and "watch.peak is" in done.output
    one = CliRunner().invoke(cli, ["verify", f"{tmp_path / 'family.json'}#0"])
    assert one.exit_code == (entry == "points") and "watch.peak" in one.output


@pytest.mark.slow
def test_it_is_kept_over_a_kill(tmp_path):
    """The same to the last bit; and nothing is written over it where something else is watched."""
    problem = line(watch={"peak": "max(x)"})

    def stopped(batch, left=[18]):  # noqa: B006
        left[0] -= 1
        if not left[0]:
            raise KeyboardInterrupt

    given = {"until": 1.1, "settings": FORWARD}
    with pytest.raises(KeyboardInterrupt):
        follow_family(problem, "frequency", out=tmp_path / "killed", progress=stopped, **given)
    for name in ("killed", "whole"):
        follow_family(problem, "frequency", out=tmp_path / name, **given)
    killed, whole = (load_family(tmp_path / name / "line" / "family.json") for name in ("killed", "whole"))
    assert [one.watch for one in killed.points] == [one.watch for one in whole.points]
    assert [one.parameter for one in killed.events] == [one.parameter for one in whole.events] != []
    with pytest.raises(InputError, match=r"watch\.low: nothing there, min\(x\) asked for; .*not written over"):
        follow_family(problem, "frequency", out=tmp_path / "whole", watch={"low": "min(x)"}, **given)


def test_symmetric_and_hybrid_motions():
    """A quarter of a period stands for the whole: the pendulum's amplitude and its largest rate; arcs between jumps."""
    swing = load_problem(PROBLEMS / "examples" / "pendulum-2rad.toml")
    watch = {"top": "max(theta1)", "rate": "max(theta1dot)", "middle": "mean(theta1)"}
    family = follow_family(swing, "energy", until=4.0, watch=watch, settings=FamilySettings(points=12))
    energies = family.values("energy")
    assert family.curve["symmetry"] == "brake+reflection" and not family.events
    assert np.allclose(family.values("top"), np.arccos(-energies / 4.9), rtol=1e-12)
    assert np.allclose(family.values("rate"), np.sqrt(6 * (energies + 4.9)), rtol=1e-12)
    assert np.abs(family.values("middle")).max() < 1e-14
    ball = load_problem(PROBLEMS / "hybrid" / "bouncing-ball.toml")
    settings = FamilySettings(directions="forward", points=3)
    family = follow_family(ball, "frequency", watch={"top": "max(y)", "fall": "min(v)"}, settings=settings)
    for one in family.points:  # a parabola between two impacts, of a motion whose state is right after the first
        assert one.watch["top"] == pytest.approx(one.state[0] + one.state[1] ** 2 / 2, rel=1e-12)
    assert all(check.passed for _, check in verified(family, ball.model))


def test_a_branch_watches_what_its_family_does():
    lorenz = load_problem(PROBLEMS / "families" / "lorenz-doubling.toml")
    family = follow_family(lorenz, "rho", until=225.0, watch={"top": "max(z)"})
    place = next(k for k, one in enumerate(family.events) if one.kind == "period_doubling")
    (branch, *_) = branches(family, place)
    found = follow_family(branch, points=2)
    assert found.points[0].watch["top"] == pytest.approx(family.events[place].watch["top"], rel=1e-2)


def test_from_a_problem_file(tmp_path):
    path = tmp_path / "line.toml"
    path.write_text(LINE)
    command = ["continue", str(path), "--parameter", "frequency", "--direction", "forward", "--no-figures"]
    done = CliRunner().invoke(cli, [*command, "--stop", "peak=2.0", "--out", str(tmp_path)])
    assert done.exit_code == 0 and "ended: target (reached peak = 2.0)" in done.output
    assert load_family(tmp_path / "line" / "family.json").points[-1].watch["peak"] == pytest.approx(2.0, abs=1e-14)
    for wrong, said in (("peek=2", "did you mean 'peak'"), ("peak", "is not NAME=VALUE"), ("peak=x", "not a number")):
        done = CliRunner().invoke(cli, [*command, "--stop", wrong])
        assert done.exit_code == 2 and "stop" in done.output and said in done.output


@pytest.mark.parametrize(
    "name, text, said",
    [
        ("peak", "max(y)", "watch.peak: unknown name 'y'; known are"),
        (
            "peak",
            "x",
            "watch.peak: 'x' varies along an orbit; put what does into max(), min(), mean(), amplitude() or phase()",
        ),
        ("peak", "amplitude(x, 0)", "watch.peak: 'amplitude(x, 0)': harmonics are 1, 2, ...; give that number last"),
        ("peak", "__import__('os')", "watch.peak: \"__import__('os')\" is not allowed"),
        ("peak", "max(x, 1)", "watch.peak: 'max(x, 1)' is not allowed"),
        ("peak", "", "watch.peak: must be an expression"),
        ("period", "max(x)", "watch.period: no name for a number"),
        ("a b", "max(x)", "watch.a b: no name for a number"),
    ],
)
def test_mistakes_are_named(name, text, said):
    with pytest.raises(InputError) as raised:
        line(watch={name: text})
    assert str(raised.value).startswith(said)


def test_harmonics_are_exact():
    """Amplitude and phase of 1.5 cos(w t + 0.4) - 0.2 sin(3 w t) and its rate, at 64 equal times of some period."""
    texts = {"a": "amplitude(x, 1)", "b": "phase(x, 1)", "c": "amplitude(x, 3) + amplitude(x, 2)", "d": "phase(x, 3)",
             "e": "phase(xdot, 1) - phase(x, 1)"}  # fmt: skip
    times, model = 3.0 + np.linspace(0.0, 2.5, 65), line().model
    turn = 2 * np.pi * (times - 3.0) / 2.5
    x, rate = 1.5 * np.cos(turn + 0.4) - 0.2 * np.sin(3 * turn), -1.5 * np.sin(turn + 0.4) - 0.6 * np.cos(3 * turn)
    parameters = dict(zip(model.parameter_names, model.parameter_values, strict=True))
    known = [watches(texts, model)[name].of(times, np.column_stack([x, rate]), parameters) for name in texts]
    assert known == pytest.approx([1.5, 0.4, 0.2, np.pi / 2, np.pi / 2], abs=1e-14)


def test_maxima_lie_between_samples():
    """Of a motion at 61 times a period to nine digits, wherever it begins, and of each arc."""
    model = line().model
    top = watches({"top": "max(x)", "low": "min(x)", "one": "2^2"}, model)
    parameters = dict(zip(model.parameter_names, model.parameter_values, strict=True))
    times = np.linspace(0.0, 2 * np.pi, 61)
    for phase in np.linspace(0.0, 1.0, 12):
        states = np.column_stack([np.cos(times + phase), -np.sin(times + phase)])
        assert top["top"].of(times, states, parameters) == pytest.approx(1.0, abs=1e-9)
        assert top["low"].of(times, states, parameters) == pytest.approx(-1.0, abs=1e-9)
    halves, jumped = np.append(times, times + times[-1]), np.vstack([states, states + 5.0])
    assert top["top"].of(halves, jumped, parameters) == pytest.approx(6.0, abs=1e-9)
    assert top["one"].of(times, states, parameters) == 4.0
