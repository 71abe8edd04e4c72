"""Events of families checked by their definitions: planted moves and renames, false folds, what a point claims."""

import json
import logging
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import inside
from test_certificate_holes import flat

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError
from orbitfinder.families.entries import KINDS
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.registry import EventKind
from orbitfinder.families.registry import Test as Vanishing
from orbitfinder.families.start import curve_of
from orbitfinder.families.verified import reading
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.kind import build_model
from orbitfinder.records.family import Event, Reading, load_family, save_family

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results" / "families"
PLANTED = [
    ("triple-1", "fold"), ("triple-1", "turn"), ("triple-1", "branch_point"), ("triple-1", "stability_change"),
    ("henon-heiles-loop", "resonance"), ("henon-heiles-loop", "period_doubling"), ("quadruple-mode-3", "collision"),
    ("five-bar-length", "branch_point"), ("triple-mode-2", "period_doubling"),
]  # fmt: skip
FEW = FamilySettings(points=12)


def verdict(family, folder):
    """Exit code and output of `verify FAMILY.json`, the file written anew, so that its digest fits."""
    done = CliRunner().invoke(cli, ["verify", str(save_family(family, folder)), "--trust"])
    return done.exit_code, done.output


def only(family, event):
    """The orbits beside one event, with that and no end."""
    first = max(event.index - 3, 0)
    points = family.points[first : event.index + 5]
    return replace(family, points=points, events=(replace(event, index=event.index - first),), ends=())


def moved(family, event, share=1e-4):
    """The event that share of its step further on, with all that it says of itself."""
    a, b = family.points[event.index : event.index + 2]

    def on(value, first, last):
        return value + share * (last - first)

    return replace(
        event, state=on(event.state, a.state, b.state), period=on(event.period, a.period, b.period),
        energy=on(event.energy, a.energy, b.energy), parameter=on(event.parameter, a.value, b.value),
        arclength=on(event.arclength, a.arclength, b.arclength),
        free={name: on(value, a.free[name], b.free[name]) for name, value in event.free.items()},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "kind"), [PLANTED[0], *(pytest.param(*one, marks=pytest.mark.slow) for one in PLANTED[1:3])]
)
def test_an_event_moved_or_renamed_is_rejected(name, kind, tmp_path):
    """The kinds that are most easily taken for each other."""
    rejected(name, kind, ("branch_point", "period_doubling"), tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "kind"), PLANTED)
def test_every_kind_moved_or_renamed_is_rejected(name, kind, tmp_path):
    """As every other kind."""
    rejected(name, kind, [one for one in KINDS if one not in ("fold", "turn")], tmp_path)


def rejected(name, kind, renamed, tmp_path):
    """By 1e-4 of its step: the orbit, the parameter alone, the period alone; and as every other kind."""
    family = load_family(RESULTS / name / "family.json")
    event = next(one for one in family.events if one.kind == kind)
    assert verdict(only(family, event), tmp_path)[0] == 0
    planted = moved(family, event)
    wrong = [planted, replace(event, parameter=planted.parameter), replace(event, period=planted.period)]
    wrong += [replace(event, kind=other) for other in renamed if other != kind]
    wrong += [replace(event, kind="fold", detail="energy")] * (kind != "fold")
    wrong += [replace(event, kind="turn", detail="period")] * (kind != "turn")
    for one in wrong:
        code, said = verdict(only(family, one), tmp_path)
        assert code == 1 and "FAILED" in said, (one.kind, one.parameter, said)


def test_a_fold_is_known_where_orbits_of_one_parameter_are_far_apart():
    """(1 - mu) of the lower one is 4e-14, and its gap all but along that: 0.04 from an orbit of the same frequency."""
    orbit = of.find_orbit(of.load_problem(ROOT / "problems" / "gallery" / "forced-duffing-lower.toml"))
    family = follow_family(orbit, "frequency", until=1.0, points=40)
    folds = [one for one in family.events if one.kind == "fold"]
    assert [inside(*pair) for pair in zip(folds, [1.7317606717826788, 1.4529935043131847], strict=True)] == [True] * 2


@pytest.mark.parametrize("file", sorted(RESULTS.glob("*/family.json")), ids=lambda one: one.parent.name)
def test_a_verdict_changes_only_at_an_event_that_says_so(file):
    """Of every shipped family."""
    family = load_family(file)
    said = [one.arclength for one in family.events if one.kind == "stability_change"]
    for a, b in pairwise(one for one in family.points if one.stability != "marginal"):
        between = sum(a.arclength <= one <= b.arclength for one in said)
        assert between % 2 == ((a.stability == "unstable") != (b.stability == "unstable")), (a.value, b.value)


def test_a_recorded_reading_is_compared(tmp_path):
    family = load_family(RESULTS / "henon-heiles-loop" / "family.json")
    event = replace(family.events[0], check=Reading(1e-3, 1e-5, True))
    assert verdict(only(family, event), tmp_path)[0] == 1


def test_a_torus_moved_or_renamed_is_rejected(tmp_path):
    """A cycle z = b whose pair passes the unit circle at a = b^2, off no resonance."""

    def field(_, x, p):
        rate = x.z - 0.7
        return [rate * x.x - 3.5 * x.y, 3.5 * x.x + rate * x.y, 0.3 + p.a * x.z - x.z**3 / 3 - x.x**2 - x.y**2]

    model = of.ode(field, ("x", "y", "z"), {"a": 0.4})
    guess = Guess([np.sqrt(0.3 + 0.28 - 0.343 / 3), 0, 0.7], 2 * np.pi / 3.5)
    family = follow_family(Problem(model, guess, name="torus"), "a", until=0.6, model=model)
    assert [one.kind for one in family.events] == ["torus", "stability_change"]
    event = family.events[0]
    assert event.check.passed and abs(event.check.value) <= event.check.error < 1e-5
    assert inside(event, 0.49) and event.period_error < 1e-8
    curve, step = curve_of(family.curve, model, FamilySettings(parameter="a")), 0.1
    a, b = family.points[event.index : event.index + 2]
    along = np.array([*(b.state - a.state), b.period - a.period, b.value - a.value])
    bare = replace(event, shooting_nodes=np.zeros((0, 0)), mesh=np.zeros(0))
    assert reading(curve, bare, along, step).passed
    wrong = [replace(bare, kind=kind) for kind in ("fold", "branch_point", "period_doubling", "collision", "grazing")]
    for one in [*wrong, moved(family, bare)]:
        with pytest.raises(ConvergenceError):
            reading(curve, one, along, step)


def test_the_hopf_normal_form_has_no_fold(caplog):
    """In units of 0.01 and from phase 0.8 its family turned at mu = 0.514 once; no multiplier is +1 there."""
    unit, phase = 0.01, 0.8

    def field(_, x, p):
        u, v = x.x, x.y * unit
        square = u**2 + v**2
        return [p.mu * u - v - u * square, (u + p.mu * v - v * square) / unit]

    model = of.ode(field, ("x", "y"), {"mu": 1.0})
    guess = Guess([np.cos(phase), np.sin(phase) / unit], 2 * np.pi)
    family = follow_family(Problem(model, guess, name="hopf"), "mu", until=0.3, model=model)
    assert not [one for one in family.events if one.kind == "fold"]
    point = family.points[len(family.points) // 2]
    curve = curve_of(family.curve, model, FamilySettings(parameter="mu"))
    false = Event("fold", 0, 0.0, point.value, point.state, point.period, float("nan"), detail="mu", free=point.free)
    along = np.array([0.0, 0.0, 0.0, 1.0])
    found = reading(curve, false, along, 0.1)
    assert not found.passed and abs(found.value) > 0.1


def test_what_is_seen_and_is_none_is_said(caplog, monkeypatch):
    """An event whose check fails is in the log and not in the family."""
    family = load_family(RESULTS / "henon-heiles-loop" / "family.json")
    model, point = build_model(family.system), family.points[3]
    missed = replace(KINDS["resonance"], check=lambda sides, event: sides.zero(lambda look: 1.0))
    monkeypatch.setitem(KINDS, "resonance", missed)
    start = of.load_problem(Path(__file__).parents[1] / "problems" / "families" / "henon-heiles-loop.toml")
    with caplog.at_level(logging.WARNING):
        found = follow_family(start, until=0.08, model=model, settings=replace(FEW, directions="forward"))
    assert point and "resonance" not in {one.kind for one in found.events}
    assert any("a resonance was seen at" in one.message for one in caplog.records)


def test_a_kind_of_ones_own(monkeypatch):
    """An entry of the table is all that an event needs to be looked for, checked and recorded."""
    start = of.load_problem(Path(__file__).parents[1] / "problems" / "families" / "henon-heiles-loop.toml")
    settings = replace(FEW, directions="forward")
    plain = follow_family(start, until=0.08, settings=settings)
    middle = float(np.mean(plain.values("period")[[0, -1]]))
    passed = Vanishing("on_time", "", lambda sample: sample.solution.place.period - middle)
    own = EventKind(
        lambda sides, event: sides.zero(lambda look: look.value("period") - middle), test=lambda _: [passed]
    )
    monkeypatch.setitem(KINDS, "on_time", own)
    found = follow_family(start, until=0.08, settings=settings)
    (event,) = (one for one in found.events if one.kind == "on_time")
    assert event.check.passed and event.certified and event.period == pytest.approx(middle, abs=1e-9)
    assert [one.kind for one in found.events if one is not event] == [one.kind for one in plain.events]


@pytest.mark.parametrize(
    ("entry", "change"),
    [
        ("value", lambda point: replace(point, value=point.value + 1e-3)),
        ("indices", lambda point: replace(point, indices=np.array([9.0, *point.indices[1:]]))),
        ("krein", lambda point: replace(point, krein=tuple(-one for one in point.krein))),
        ("indices", lambda point: replace(point, indices=np.array([9.0, *point.indices[1:]]), scale=1e12)),
        ("krein", lambda point: replace(point, krein=tuple(-one for one in point.krein), scale=1e300)),
        ("root", lambda point: replace(point, root=3 - point.root)),
    ],
)
def test_what_a_point_claims_of_its_family_is_verified(entry, change, tmp_path):
    """A9(g): the file's digest fits. How much is known of a point is not what its record says."""
    family = load_family(RESULTS / "triple-mode-2" / "family.json")
    number = next(k for k, one in enumerate(family.points) if any(one.krein) and k > 3)
    points = [*family.points[:number], change(family.points[number]), *family.points[number + 1 :]]
    true, false = (
        save_family(one, tmp_path / f"{k}") for k, one in enumerate((family, replace(family, points=points)))
    )
    done = [CliRunner().invoke(cli, ["verify", f"{one}#{number}", "--json"]) for one in (true, false)]
    failed = [{c["name"] for c in json.loads(one.stdout)["results"][0]["checks"] if not c["passed"]} for one in done]
    assert entry not in failed[0] and entry in failed[1], failed


def test_points_of_which_nothing_is_known_are_not_counted():
    family = load_family(RESULTS / "henon-heiles-straight" / "family.json")
    unknown = sum(one.scale > 1e10 for one in family.points)
    assert unknown and family.counts.startswith(f"{len(family.points) - unknown} closed orbits (and {unknown} too")


def test_folds_of_older_files_that_are_turns_are_called_so():
    family = load_family(RESULTS / "triple-1" / "family.json")
    assert {(one.kind, one.detail) for one in family.events if one.kind in ("fold", "turn")} == {
        ("fold", "energy"), ("turn", "period"),
    }  # fmt: skip


def test_a_verdict_that_changes_at_a_fold_by_almost_nothing_is_kept():
    """Multipliers leave the circle by 3e-4 in a whole step there, by less than is asked for beside the fold."""
    family = load_family(RESULTS / "quadruple-mode-1" / "family.json")
    first = next(one for one in family.points[70:] if one.value < -77.44 and one.stability == "unstable")
    guess, pin = Guess(first.state, first.period), of.pin(energy=first.energy)
    start = Problem(build_model(family.system), guess, pin, symmetry=first.symmetry)
    settings = FamilySettings(directions="backward", points=8, certify=False)
    found = follow_family(start, "energy", settings=settings)
    changes = [(one.kind, one.detail) for one in found.events if one.kind != "turn"]
    assert changes == [("fold", "energy"), ("stability_change", "becomes unstable")]  # in the order of the points
    assert found.points[-1].stability == "unstable" != found.points[0].stability
    assert found.events[0].parameter == pytest.approx(-77.450824102262, abs=1e-9)
    assert all(one.check.passed for one in found.events)


def behind_a_gap(frequency):
    """Two masses, the first with a spring of 100 N/m behind a gap of 1 m, whose corner is round over 1 mm."""
    wall = {"kind": "stop", "at": "q1", "stiffness": 100.0, "gap": 1.0, "smoothing": 1e-3}
    damping, stiffness = np.array([[0.03, -0.03], [-0.03, 0.06]]), np.array([[1.0, -1.0], [-1.0, 2.0]])
    load = {"at": "q2", "amplitude": 0.1, "frequency": frequency}
    return of.structure(np.eye(2), damping, stiffness, {"wall": wall}, load)


@pytest.mark.parametrize("step", [0.05, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.03, 0.02, 0.01))])
def test_a_doubling_beside_a_sharp_corner_is_found(step):
    """A mesh that the corner has left located it elsewhere by 1e-6 to 1e-5, or not at all, and its check then failed.

    The reference is by SciPy's DOP853 at 1e-12, Newton's method and secants of the multiplier.
    """
    model = behind_a_gap(0.755611)
    state = [-0.627431123196162, -0.8138791574253464, 1.0442090865109155, 0.24558921613317733]
    settings = FamilySettings(parameter="frequency", first_step=step, certify=False)
    family = follow_family(flat(model, state, 2 * np.pi / 0.755611), until=0.75558, settings=settings)
    assert [one.kind for one in family.events] == ["period_doubling", "stability_change"] and not family.unknown
    for one in family.events:
        assert one.check.passed and inside(one, 0.7555876139127675) and one.error < 1e-11


@pytest.mark.slow
def test_every_event_beside_a_sharp_corner_is_found():
    """Up the resonance and down again: two folds and two doublings, every change of stability at one of them."""
    problem = Problem(behind_a_gap(0.8), of.guesses.linear_response(behind_a_gap(0.8)), name="gap")
    family = follow_family(problem, "frequency", until=0.5, points=260)
    found = {one.kind: [] for one in family.events}
    for one in family.events:
        found[one.kind].append(one)
    assert {kind: len(events) for kind, events in found.items()} == {
        "period_doubling": 2, "stability_change": 4, "fold": 2
    }  # fmt: skip
    assert not family.unknown
    for one, reference in zip(found["period_doubling"], [0.7388003205948521, 0.7555876139127675], strict=True):
        assert inside(one, reference)


@pytest.mark.slow
def test_doublings_of_one_mass_beside_a_sharper_corner():
    """40 N/m behind 0.5 m, round over 0.3 mm: the orbits of both were off by 5e-8 and 3e-9. References as above."""
    wall = {"kind": "stop", "at": "q1", "stiffness": 40.0, "gap": 0.5, "smoothing": 3e-4}
    load = {"at": "q1", "amplitude": 0.3, "frequency": 0.7}
    model = of.structure(np.eye(1), np.array([[0.05]]), np.eye(1), {"wall": wall}, load)
    problem = Problem(model, of.guesses.linear_response(model), name="one")
    family = follow_family(problem, "frequency", until=1.0)
    doublings = [one for one in family.events if one.kind == "period_doubling"]
    for one, reference in zip(doublings, [0.8016201287834238, 0.9226871651515308], strict=True):
        assert inside(one, reference)
    assert not family.unknown and [one.kind for one in family.events].count("stability_change") == 2
