"""A wrong entry of a registry is one sentence, which names the entry, the field and what to do, as early as may be."""

import json
from dataclasses import make_dataclass, replace

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.exports.formats import FORMATS, Format
from orbitfinder.families import entries
from orbitfinder.families.registry import EventKind, Look
from orbitfinder.families.registry import Test as Vanishing
from orbitfinder.loops import conditions
from orbitfinder.loops.conditions import Quantity
from orbitfinder.loops.shooting import flow_of
from orbitfinder.mechanics import kind as systems
from orbitfinder.mechanics.controls import with_controls
from orbitfinder.mechanics.kind import SystemKind
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.orbits.measure import measure
from orbitfinder.orbits.method import METHODS, Method
from orbitfinder.records import registry
from orbitfinder.records.codec import Codec
from orbitfinder.records.registry import Kind

PENDULUM = of.chain(1)
SWING = of.Problem(PENDULUM, of.Guess([0.0, 3.0], 1.8), pin=of.pin(energy=-3.4), name="swing")


def zero(sides, event):
    return sides.zero(lambda probe: probe.value("period") - 1.72)


def vanishing(interval, kind="on_time"):
    return [Vanishing(kind, "", lambda sample: sample.solution.place.period - 1.72)]


GOOD = EventKind(zero, test=vanishing)


def run(*words, code=0):
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code == code, result.output
    return " ".join(result.output.split())


def swings(**more):
    settings = of.FamilySettings(directions="forward", first_step=0.2)
    return of.follow_family(mode_problem(PENDULUM, 1, 0.3), points=6, settings=settings, name="swings", **more)


@pytest.mark.parametrize(
    ("table", "entry", "said"),
    [
        (entries.KINDS, zero, "EventKind 'new': expected an EventKind, got function"),
        (entries.KINDS, EventKind(True), "EventKind 'new', check: expected a function, got True; see orbitfinder.fam"),
        (entries.KINDS, replace(GOOD, words=3), "EventKind 'new', words: expected a text, got 3"),
        (entries.KINDS, replace(GOOD, test=[]), r"EventKind 'new', test: expected a function, got \[\]"),
        (entries.KINDS, replace(GOOD, look="o"), r"EventKind 'new', look: expected a Look, got 'o'; Look\(marker"),
        (entries.KINDS, replace(GOOD, look=Look("star")), r"look.marker: expected 'o', .* got 'star'; see orbitf"),
        (entries.KINDS, replace(GOOD, look=Look(colour="gren")), "look.colour: expected a colour such as '#00AA88', "),
        (METHODS, lambda problem: None, "Method 'new': expected a Method, got function"),
        (METHODS, Method(True, zero), "Method 'new', suits: expected a function, got True"),
        (registry.KINDS, Kind("a toy", 3), "Kind 'new', read: expected a function, or its name 'module:function', got"),
        (systems.KINDS, SystemKind(zero, words="a spring"), "SystemKind 'new', words: expected a function, got 'a spr"),
        (conditions.QUANTITIES, Quantity(["x"], zero), r"Quantity 'new', names: expected a function, got \['x'\]"),
        (FORMATS, Format(None), "Format 'new', files: expected a function, or its name"),
    ],
)  # fmt: skip
def test_what_an_entry_is_not_is_refused_when_it_is_entered(table, entry, said):
    before = dict(table)
    for enter in (lambda: table.__setitem__("new", entry), lambda: table.update({"new": entry})):
        with pytest.raises(InputError, match=said):
            enter()
    assert dict(table) == before


def test_markers_are_those_of_matplotlib():
    matplotlib = pytest.importorskip("matplotlib.markers")
    fits = entries.KINDS.__class__(EventKind)
    for marker in matplotlib.MarkerStyle.filled_markers:
        fits["new"] = replace(GOOD, look=Look(marker))
    with pytest.raises(InputError, match="look.marker"):
        fits["new"] = replace(GOOD, look=Look("oo"))


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (EventKind(lambda sides, event: True, test=vanishing), "EventKind 'on_time', check: expected a Reading, got T"),
        (EventKind(lambda sides, event: sides.zero(lambda probe: None), test=vanishing),
         "Sides.zero, value of its measure: expected a number, got None"),
        (EventKind(zero, test=lambda interval: vanishing(interval)[0]), "EventKind 'on_time', test: expected a list"),
        (EventKind(zero, test=lambda interval: [1.0]), r"'on_time', test: expected a list, each a Test, got \[1.0\]"),
        (EventKind(zero, test=lambda interval: vanishing(interval, "ontime")),
         r"'on_time', test: a Test of 'ontime', which is no kind of event, did you mean 'on_time'\?; write Test\("),
        (EventKind(zero, test=lambda interval: [Vanishing("on_time", "", lambda sample: np.bool_(True))]),
         "EventKind 'on_time', measure of its Test: expected a number, got bool"),
    ],
)  # fmt: skip
def test_what_an_event_gives_is_refused_on_the_first_step(monkeypatch, kind, said):
    monkeypatch.setitem(entries.KINDS, "on_time", kind)
    with pytest.raises(InputError, match=said):
        swings()


def orbit_of(problem, settings, report, began, size=2):
    return measure(problem, flow_of(problem, settings.integrator), np.zeros((1, size)) + 0.5, 1.8, np.zeros(1))


@pytest.mark.parametrize(
    ("find", "said"),
    [
        (orbit_of, r"Method 'new', find: expected \(Orbit, Model\), got Orbit; return both"),
        (lambda *given: None, r"Method 'new', find: expected \(Orbit, Model\), got None"),
        (lambda *given: orbit_of(*given, size=3), r"measure: expected nodes \(N x 2\), .* got shapes \(1, 3\), \(\)"),
        (lambda problem, *rest: (replace(orbit_of(problem, *rest), state=np.zeros(3)), problem.model),
         r"Method 'new', find: expected a state \(2\) and nodes \(N x 2\), got shapes \(3,\) and \(1, 2\)"),
    ],
)  # fmt: skip
def test_what_a_method_gives_is_looked_at(monkeypatch, find, said):
    monkeypatch.setitem(METHODS, "new", Method(lambda problem: True, find))
    with pytest.raises(InputError, match=said):
        of.find_orbit(SWING)


@pytest.mark.parametrize(
    ("quantity", "error", "said"),
    [
        (Quantity(lambda model: None, zero), TypeError, "Quantity.names: returned None; return a list .* for 'new'"),
        (Quantity(lambda model: ["new"], lambda *given: None), InputError,
         "Quantity of 'new', value: expected a CasADi MX expression, got None; write it"),
        (Quantity(lambda model: ["new"], zero, refused=lambda *given: True), InputError,
         "Quantity of 'new', refused: expected a text, got True; return why"),
        (Quantity(lambda model: ["new"], zero, row=lambda *given: 1.0), InputError,
         "Quantity of 'new', row: expected a Condition, got 1.0; Condition"),
    ],
)  # fmt: skip
def test_what_a_quantity_gives_is_looked_at(monkeypatch, quantity, error, said):
    monkeypatch.setitem(conditions.QUANTITIES, "new", quantity)
    with pytest.raises(error, match=said):
        of.find_orbit(replace(SWING, pin=of.pin(new=1.0)))


def test_a_controlled_motion_has_no_pin_by_an_expression(monkeypatch):
    """Nor is it a traceback."""
    speed = Quantity(lambda model: ["speed"], lambda variables, _: variables.start[1] ** 2)
    monkeypatch.setitem(conditions.QUANTITIES, "the speed squared", speed)
    driven = with_controls(PENDULUM, ["gravity"])
    with pytest.raises(InputError, match="pin: speed is not of controlled motions, .*; ask for it in a task"):
        of.Problem(driven, of.Guess([0.0, 3.0], 1.8), pin=of.pin(speed=9.0), control=of.Control("gravity**2"))
    timed = of.Problem(driven, of.Guess([0.0, 3.0], 1.8), pin=of.pin(period=1.8), control=of.Control("gravity**2"))
    assert [pin.name for pin in timed.pin] == ["period"]


def test_what_a_system_a_format_and_a_record_give_is_looked_at(monkeypatch, tmp_path):
    monkeypatch.setitem(systems.KINDS, "none", SystemKind(lambda system, _: None))
    with pytest.raises(InputError, match="SystemKind 'none', build: expected a Model, got None"):
        systems.build_model({"kind": "none"})
    orbit = of.find_orbit(SWING)
    monkeypatch.setitem(FORMATS, "text", Format(lambda source: "a text"))
    with pytest.raises(InputError, match="Format 'text', files: expected names with a text each.*, got 'a text'; ret"):
        of.export_orbit(orbit, "text", tmp_path)
    file = of.save_orbit(orbit, tmp_path / "orbit.json")
    for verb, made, said in (
        ("verify", lambda *given: True, "Kind 'orbit', verify: expected a Certificate, got True; Certificate("),
        ("plot", lambda *given: None, "Kind 'orbit', plot: expected a list, each a path, got None; return the files"),
        ("plot", "show.nowhere:figures", "Kind: there is no 'show.nowhere:figures' in orbitfinder"),
        ("plot", "show.plot:nothing", "Kind: there is no 'show.plot:nothing' in orbitfinder"),
    ):
        with monkeypatch.context() as patch:
            patch.setitem(registry.KINDS, "orbit", replace(registry.kinds()["orbit"], **{verb: made}))
            assert said in run(verb, file, code=2)


@pytest.mark.parametrize("verb", ["show", "verify", "plot", "page"])
def test_a_record_that_nobody_has_entered_is_said_to_be_unknown(tmp_path, verb):
    (tmp_path / "heights.json").write_text(json.dumps({"format": "orbitfinder/heights", "version": 1}))
    said = run(verb, tmp_path / "heights.json", *(["-o", tmp_path / "site"] if verb == "page" else []), code=2)
    assert "format: 'orbitfinder/heights' is unknown to this installation, which knows orbit, family, " in said
    assert "import the module that enters it in KINDS" in said


@pytest.mark.parametrize("kind", [list, tuple, set[str]])
def test_a_record_has_no_field_that_cannot_be_read(tmp_path, kind):
    codec = Codec(make_dataclass("Rows", [("rows", kind)]), "rows", "`a test`", "again")
    (tmp_path / "rows.json").write_text(json.dumps({"format": "orbitfinder/rows", "version": 1, "rows": ["a"]}))
    with pytest.raises(TypeError, match=r"rows: no record has a field of .*; annotate it as .* tuple\[X, \.\.\.\]"):
        codec.load(tmp_path / "rows.json")


@pytest.mark.slow
def test_a_family_that_is_finished_is_said_to_be_read(tmp_path, capfd):
    file = of.save_orbit(of.find_orbit(SWING), tmp_path / "orbit.json")

    def said(points):
        run("continue", file, "--points", points, "--out", tmp_path)
        return capfd.readouterr().err

    read = "this family was finished there before, and is read, not followed"
    assert read not in said(3)
    assert read in (again := said(3)) and "another --out or delete the folder" in again
    assert read not in said(4)


def test_another_system_is_another_family(tmp_path):
    """Its guess, its pin and its name may be the same: it is neither read in the other's place nor written over it."""

    def periods(gravity):
        problem = replace(SWING, model=of.chain(1, gravity=gravity), pin=())
        return of.follow_family(problem, out=tmp_path, points=2).values("period")

    first = periods(9.8)
    with pytest.raises(InputError, match=r"family.jsonl: system.gravity: 9.8 there, 5.0 asked for"):
        periods(5.0)
    assert np.array_equal(periods(9.8), first)
