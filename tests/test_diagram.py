"""Whole bifurcation diagrams: what the field knows of four systems, nothing twice, resumed, doctored, pictures."""

import contextlib
import importlib
import json
import pickle
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import inside
from matplotlib.figure import Figure
from test_equilibria import hodgkin_huxley, morris_lecar

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError, LimitError
from orbitfinder.families import folder as family_folder
from orbitfinder.families.checks import Probe, Sides
from orbitfinder.families.diagram import happened, load_diagram, verified, within
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.records.family import End
from orbitfinder.records.registry import load
from orbitfinder.show.equilibria import Panel, save_diagram_figure

family_diagram = importlib.import_module("orbitfinder.families.diagram")  # where the package has the function
LORENZ = Path(__file__).parents[1] / "problems" / "equations" / "lorenz.toml"
RESTS = "equilibria/equilibria.json"


def became(tree):
    return [(one.file, one.event, one.became, one.leads) for one in tree.branchings]


def record(tree, file):
    return next(curve.record for curve in tree.curves if curve.file == file)


@pytest.fixture(scope="module")
def nerve(tmp_path_factory):
    """Morris and Lecar's, in a folder."""
    out = tmp_path_factory.mktemp("nerve")
    return of.diagram(morris_lecar(), [-40.0, 0.05], "I", 250.0, name="nerve", out=out), out / "nerve"


def test_two_hopf_points_of_a_nerve_are_joined_by_one_family(nerve):
    """Followed from the first; folds of cycles as road.json and AUTO's; verified from the files, and the same there."""
    tree, folder = nerve
    cycles = "equilibria-0/family.json"
    assert became(tree) == [(RESTS, 0, "followed", (cycles,)), (RESTS, 1, "joined", (cycles,))]
    assert tree.undone == () and tree.between == (50.0, 250.0) and tree.coordinate == "V"
    counts = "1 curve of equilibria with 2 Hopf points, 1 of cycles with 2 folds; 1 followed, 1 joined"
    assert tree.counts == counts and tree.remarks == ()
    hopf, (first, *_, last) = list(happened(tree, tree.curves[0])), list(happened(tree, tree.curves[1]))
    assert hopf[0].startswith("event 0, subcritical hopf at I 93.8576184 (+- ") and ", l1 = 0.00" in hopf[0]
    assert hopf[0].endswith("; followed equilibria-0/family.json") and hopf[1].endswith("; joined " + cycles)
    assert first.startswith("event 0, subcritical fold of cycles at I 216.899801")
    assert last.startswith("ends: hopf at I 212.018816 (+- ")
    folds = [event for event in record(tree, cycles).events if event.kind == "fold"]
    assert inside(folds[0], 216.899801389411483947485) and len(folds) == 2
    assert abs(folds[0].period - 77.9290518026875238) <= folds[0].period_error < 1e-8
    again = load(folder / "diagram.json")
    assert became(again) == became(tree) and [curve.file for curve in again.curves] == [RESTS, cycles]
    assert [p.value for p in record(again, cycles).points] == [p.value for p in record(tree, cycles).points]
    assert verified(again, morris_lecar()).passed
    assert "2 curves" not in repr(tree) and "branchings" in repr(tree)


def test_its_tables_are_those_of_its_curves(nerve):
    """Below each other, rests with ranges of no width; events with what became of them."""
    tree, tables = nerve[0], nerve[0].tables(morris_lecar())
    cycles, rest = (record(tree, curve.file) for curve in reversed(tree.curves))
    points = tables["points"]
    assert points["curve"] == [RESTS] * len(rest.points) + ["equilibria-0/family.json"] * len(cycles)
    assert points["index"] == [*range(len(rest.points)), *range(len(cycles))]
    values = [point.value for point in (*rest.points, *cycles.points)]
    assert points["I"] == values and np.isnan(points["period"][0]) and points["period"][-1] == cycles.points[-1].period
    assert points["min_V"][0] == points["max_V"][0] == rest.points[0].state[0] and points["amplitude_V"][0] == 0
    assert points["amplitude_V"][-30] > 1 and np.isnan(points["V"][-30])
    assert tables["events"]["became"][:2] == ["followed", "joined"] and "hopf" in tables["ends"]["kind"]


def test_a_chemical_clock_ends_at_the_bound(tmp_path):
    """One Hopf point at 2, cycles to the bound exactly; in memory, then saved."""
    model = of.systems.brusselator(rate=1.8)
    tree = of.diagram(model, [1.0, 1.8], "rate", 2.5)
    (point,) = [p for p in record(tree, "equilibria-0/family.json").points if p.value == 2.5]
    assert point.period == pytest.approx(6.5772843419058333034, rel=1e-12, abs=0)
    file = of.save_diagram(tree, tmp_path / "own" / "diagram.json")
    assert became(of.load_diagram(file)) == became(tree) and verified(of.load_diagram(file), model).passed
    only = of.diagram(model, [1.0, 1.8], "rate", 2.5, depth=0, coordinate="norm")
    assert [one.became for one in only.branchings] == ["depth"] and len(only.curves) == 1
    assert only.undone == (f"{RESTS}, event 0, supercritical hopf at rate 2: deeper than 0",)


def rolls():
    return with_parameters(load_problem_file(LORENZ).model, {"rho": 0.2})


@pytest.fixture(scope="module")
def convection():
    return of.diagram(rolls(), [0.0, 0.0, 0.0], "rho", 28.0)


def test_what_is_followed_elsewhere_is_the_same(convection, tmp_path, monkeypatch):
    """In processes or on a cluster, whoever answers first: their journals are read, and nothing is followed again."""
    sent = []

    @contextlib.contextmanager
    def crew(work, workers, what, scheduler):
        def answers(requests):
            sent.extend(requests)
            made = [(k, work(*pickle.loads(pickle.dumps(one)))) for k, one in enumerate(requests)]
            monkeypatch.setattr(family_folder, "append", None)
            yield from reversed(made)

        yield answers

    monkeypatch.setattr(family_diagram.tasks, "crew", crew)
    tree = of.diagram(rolls(), [0.0, 0.0, 0.0], "rho", 28.0, workers=2, out=tmp_path)
    assert len(sent) == 2 and became(tree) == became(convection)
    for curve, other in zip(tree.curves, convection.curves, strict=True):
        both = [np.array([point.state for point in each.record.points]) for each in (curve, other)]
        assert curve.file == other.file and np.array_equal(*both)
    again = of.diagram(rolls(), [0.0, 0.0, 0.0], "rho", 28.0, workers=2, out=tmp_path)
    assert len(sent) == 2 and became(again) == became(tree)


def test_lorenz_from_the_pitchfork_to_the_homoclinic_orbits(convection):
    """Branch point at 1, the two others, their subcritical Hopf points at 470/19, cycles that end at the origin."""
    tree = convection
    origin, others = record(tree, RESTS), record(tree, "equilibria-0/equilibria.json")
    (pitchfork,) = [event for event in origin.events if event.kind == "branch_point"]
    assert abs(pitchfork.parameter - 1.0) < 1e-12
    assert [event.criticality for event in others.events] == ["subcritical"] * 2
    for event in others.events:
        assert abs(event.parameter - 470 / 19) <= event.error
    assert [len(curve.record.points) > 20 for curve in tree.curves[2:]] == [True, True]
    for curve in tree.curves[2:]:
        (end,) = curve.record.ends
        last = max(curve.record.points, key=lambda point: abs(point.arclength))
        assert end.kind == "homoclinic" and last.value == pytest.approx(13.9266, abs=1e-3)
        assert curve.record.points[0].state[0] * curve.record.points[-1].state[0] != 0
    signs = {np.sign(curve.record.points[-1].state[0]) for curve in tree.curves[2:]}
    assert signs == {-1.0, 1.0} and verified(tree, rolls()).passed  # each about its own equilibrium


def rossler(a=0.05):
    """b = 2, c = 4."""
    return of.ode(
        lambda t, x, p: [-x[1] - x[2], x[0] + p[0] * x[1], 2 + x[2] * (x[0] - 4)], ["x", "y", "z"],
        parameters={"a": a},
    )  # fmt: skip


def test_a_doubling_at_depth_two(tmp_path):
    """Of Roessler's cycles: of twice the period where it is born; what is deeper is said to be left."""
    tree = of.diagram(rossler(), [0.02, -0.5, 0.5], "a", 0.38, out=tmp_path)
    cycles, doubled = record(tree, "equilibria-0/family.json"), record(tree, "equilibria-0-0-1/family.json")
    (hopf,) = record(tree, RESTS).events
    (event,) = [event for event in cycles.events if event.kind == "period_doubling"]
    assert hopf.kind == "hopf" and abs(doubled.points[0].period / (2 * event.period) - 1) < 1e-2
    assert doubled.points[0].value == pytest.approx(event.parameter, abs=1e-3) and doubled.points[-1].value == 0.38
    assert [one.became for one in tree.branchings] == ["followed", "followed", "depth"]
    assert (
        len(tree.undone) == 1
        and "equilibria-0-0-1/family.json, event 0, supercritical period doubling" in tree.undone[0]
    )
    assert verified(load(tmp_path / "diagram" / "diagram.json"), rossler()).passed


def fish(q=0.1):
    """AUTO's predator and prey (cycles.json, pp2): 3 f (1 - f) - f s - q (1 - exp(-5 f)), -s + 3 f s."""
    return of.ode(
        lambda t, x, p: [3 * x[0] * (1 - x[0]) - x[0] * x[1] - p[0] * (1 - ca.exp(-5 * x[0])), 3 * x[0] * x[1] - x[1]],
        ["fish", "sharks"], parameters={"q": q},
    )  # fmt: skip


@pytest.mark.slow
def test_branches_cross_transcritically_and_are_not_taken_for_each_other():
    """Fish alone leave f = 1/3, s = 0 with q = 3 f (1 - f) / (1 - exp(-5 f)), turn, and meet nothing at q = 0.6."""
    tree = of.diagram(fish(), [0.3, 1.8], "q", 1.0, depth=2)
    alone, nothing = record(tree, "equilibria-1/equilibria.json"), record(tree, "equilibria-1-3/equilibria.json")
    for point in alone.points:
        f = point.state[0]
        assert abs(3 * f * (1 - f) + point.value * np.expm1(-5 * f)) < 1e-12 and abs(point.state[1]) < 1e-12
        assert 0.1 <= point.value <= 1.0
    (fold,) = [event for event in alone.events if event.kind == "fold"]
    f = fold.state[0]
    assert abs((1 - 2 * f) * -np.expm1(-5 * f) - 5 * f * (1 - f) * np.exp(-5 * f)) < 1e-12
    assert [end.reason for end in alone.ends] == ["reached q = 0.1"] * 2
    assert max(abs(point.state).max() for point in nothing.points) < 1e-12
    assert {nothing.points[0].value, nothing.points[-1].value} == {0.1, 1.0}
    assert verified(tree, fish()).passed


@pytest.mark.slow
def test_a_doubling_that_comes_back_to_its_parent():
    """Hodgkin and Huxley's: born at 7.917777676, joined at 7.845337398, followed from the first only."""
    tree = of.diagram(hodgkin_huxley(), [-65.0, 0.05, 0.6, 0.32], "I", 180.0)
    doubled = next(curve for curve in tree.curves if curve.depth == 2)
    assert doubled.record.ends[0].kind == "merged" and len(tree.curves) == 3
    ends = [(one.became, one.leads) for one in tree.branchings if one.file == "equilibria-0/family.json"]
    assert ends == [("followed", (doubled.file,)), ("joined", (doubled.file,))]
    folds = [(event.parameter, event.error) for event in doubled.record.events if event.kind == "fold"]
    known = (7.906804139188585, 7.855722807406184)  # by steps of a sixth of the length
    for (value, error), other in zip(folds, known, strict=True):
        assert abs(value - other) < error < 1e-10  # the second was said to be known to 4e-7
    doublings = {round(event.parameter, 8): event for event in doubled.record.events if event.kind == "period_doubling"}
    assert sorted(doublings) == [7.84648143, 7.85572281, 7.90680388, 7.91777365]
    # 1 + multiplier is 0 to its own error bar, of 7e-5 at the first (without AVX-512 it is 3e-6 there)
    assert all(abs(event.check.value) <= event.check.error < 0.01 for event in doublings.values())
    near = doublings[7.85572281]  # 6e-10 beside the second fold, was denied: "0.57 where 0.92 is known"
    assert abs(near.parameter - 7.8557228080) < 1e-10 > near.error and near.check.error < 0.01


@pytest.mark.slow
def test_a_run_that_is_killed_goes_on(nerve, tmp_path, monkeypatch):
    """Half way along the cycles: what is there is a diagram; the second run has all points, none of them twice."""
    append, count = family_folder.append, [0]

    def killed(folder, batch):
        count[0] += 1
        if count[0] == 50:
            raise KeyboardInterrupt
        append(folder, batch)

    def run():
        return of.diagram(morris_lecar(), [-40.0, 0.05], "I", 250.0, name="nerve", out=tmp_path)

    with monkeypatch.context() as patched:
        patched.setattr(family_folder, "append", killed)
        with pytest.raises(KeyboardInterrupt):
            run()
    part = load(tmp_path / "nerve" / "diagram.json")
    assert [one.became for one in part.branchings] == ["budget"] * 2 and len(part.curves) == 1
    assert part.undone[0].endswith("subcritical hopf at I 93.8576184: not reached yet")
    assert verified(part, morris_lecar()).passed
    journal = tmp_path / "nerve" / "equilibria-0" / "family.jsonl"
    before = journal.read_bytes()
    tree = run()
    assert before.count(b"\n") == 50 and journal.read_bytes().startswith(before) and became(tree) == became(nerve[0])
    both = [record(one, "equilibria-0/family.json") for one in (tree, nerve[0])]
    lengths = [point.arclength for point in both[0].points]
    assert len(set(lengths)) == len(lengths) and [end.kind for end in both[0].ends] == ["hopf"]
    for one, other in zip(both[0].events, both[1].events, strict=True):
        assert one.kind == other.kind and one.parameter == pytest.approx(other.parameter, abs=1e-8)
    before = journal.read_bytes()
    assert became(run()) == became(tree) and journal.read_bytes() == before


def test_less_of_a_diagram_leaves_what_is_there(nerve, tmp_path):
    """A nearer bound cut the curves of the larger diagram, and less depth left them out of its file."""
    home = tmp_path / "nerve"
    shutil.copytree(nerve[1], home)
    files = {file: file.read_bytes() for file in home.rglob("*") if file.is_file()}
    for until, depth, words in ((200.0, 2, "until: 250.0 there, 200.0"), (250.0, 0, "depth: 2 there, 0")):
        with pytest.raises(InputError, match=f"diagram.json: {words} asked for; .* delete "):
            of.diagram(morris_lecar(), [-40.0, 0.05], "I", until, depth=depth, name="nerve", out=tmp_path)
    with pytest.raises(InputError, match=r"equilibria.jsonl: state.0: -40.0 there, -41.0 asked for"):
        of.diagram(morris_lecar(), [-41.0, 0.05], "I", 250.0, name="nerve", out=tmp_path)
    assert files == {file: file.read_bytes() for file in home.rglob("*") if file.is_file()}


def test_a_budget_is_kept():
    """What was not come to is said; without anything there is nothing to return."""

    def late(curve):
        raise LimitError("stopped after 1 s (limit)")

    tree = of.diagram(morris_lecar(), [-40.0, 0.05], "I", 250.0, progress=late)
    assert [one.became for one in tree.branchings] == ["budget"] * 2 and "stopped after 1 s (limit)" in tree.undone[0]
    with pytest.raises(LimitError):
        of.diagram(morris_lecar(), [-40.0, 0.05], "I", 250.0, limit=1e-9)
    model = of.systems.brusselator(rate=1.8)
    born = of.diagram(model, [1.0, 1.8], "rate", 2.5, progress=lambda curve: late(curve) if curve.depth else None)
    assert became(born) == [(RESTS, 0, "budget", ("equilibria-0/family.json",))] and verified(born, model).passed
    few = of.diagram(of.systems.brusselator(rate=1.8), [1.0, 1.8], "rate", 2.5, points=15)
    assert [line for line in few.undone if "stops: 15 points were asked for" in line]


@pytest.mark.slow
def test_doctored_diagrams_are_rejected(nerve):
    """An event left out, a join that is none, a birth elsewhere, a depth that is not, a bound, a state."""
    tree, _ = nerve
    first, second = tree.branchings
    rest, cycles = tree.curves
    moved = replace(rest.record.points[3], state=rest.record.points[3].state * (1 + 1e-6))
    points = (*rest.record.points[:3], moved, *rest.record.points[4:])
    astray = replace(cycles, event=1)
    wrong = {
        "events": replace(tree, branchings=(first,)),
        "branchings": replace(tree, branchings=(first, replace(second, leads=(RESTS,)))),
        "range": replace(tree, between=(50.0, 210.0)),
        "rates": replace(tree, curves=(replace(rest, record=replace(rest.record, points=points)), cycles)),
    }
    others = [
        replace(tree, curves=(rest, astray)),
        replace(tree, branchings=(replace(first, became="depth"), second)),
        replace(tree, branchings=(replace(first, leads=()), second)),
        replace(tree, branchings=(replace(first, leads=("other/family.json",)), second)),
        replace(tree, curves=(rest, cycles, replace(cycles, file="twice/family.json"))),
        replace(tree, branchings=(first, replace(second, became="joined", event=7))),
    ]
    for name, doctored in [*wrong.items(), *(("branchings", each) for each in others)]:
        assert name in verified(doctored, morris_lecar()).failures, name
    last = cycles.record.ends[0]
    away = replace(cycles.record, ends=(replace(last, parameter=last.parameter + 1e-4),))
    assert "branchings" in verified(replace(tree, curves=(rest, replace(cycles, record=away))), morris_lecar()).failures


@pytest.mark.parametrize("change, message", [
    ({"coordinate": "W"}, "coordinate: unknown 'W'; this system has V, w, norm"),
    ({"depth": -1}, "depth: must be at least 0, got -1"),
    ({"points": 0}, "points: must be at least 1, got 0"),
    ({"until": 50.0}, "until: 50.0 is where I begins"),
    ({"until": float("inf")}, "until: must be a finite value of I, got inf"),
    ({"parameter": "J"}, "parameter: unknown 'J'"),
    ({"limit": -1.0}, "limit: must be a positive number of seconds"),
    ({"model": of.systems.rimless_wheel()}, "model: jumps, so that it has no equilibria"),
])  # fmt: skip
def test_messages(change, message):
    """Field, value, remedy."""
    given = {"model": morris_lecar(), "state": [-40.0, 0.05], "parameter": "I", "until": 250.0} | change
    with pytest.raises(InputError, match=message):
        of.diagram(**given)


def test_files_that_are_none(nerve, tmp_path):
    """A curve that is missing or elsewhere, no range, a word that is none."""
    document = json.loads((nerve[1] / "diagram.json").read_text())
    file = tmp_path / "diagram.json"
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"equilibria.json.*"):
        of.load_diagram(file)
    file.write_text(json.dumps(document | {"between": [50.0, 50.0]}))
    with pytest.raises(InputError, match="between: begins and ends at I 50; make the diagram again"):
        of.load_diagram(file)
    changes = [("curves", "file", "../equilibria/equilibria.json", "is not NAME/equilibria.json or NAME/family.json"),
               ("curves", "file", "equilibria/other.json", "is not NAME/equilibria.json or NAME/family.json"),
               ("branchings", "became", "lost", "'lost' is none of followed, joined, depth")]  # fmt: skip
    for part, field, value, message in changes:
        entries = [dict(entry) for entry in document[part]]
        entries[0][field] = value
        file.write_text(json.dumps(document | {part: entries}))
        with pytest.raises(InputError, match=message):
            of.load_diagram(file)


def test_equilibria_are_cut_at_the_bounds():
    """A curve that turns back and goes out where it came in ends there."""
    cubic = of.ode(lambda t, x, p: [p[0] - x[0] ** 2], ["x"], parameters={"r": 1.0})
    tree = of.diagram(cubic, [1.0], "r", -1.0)
    (curve,) = tree.curves
    assert [curve.record.points[k].value for k in (0, -1)] == [1.0, 1.0] and abs(
        curve.record.points[-1].state[0] + 1.0
    ) < 1e-12
    assert [event.kind for event in curve.record.events] == ["fold"] and curve.record.ends[
        -1
    ].reason == "reached r = 1.0"
    (remark,) = tree.remarks
    assert "left by r = 1, where it begins: r = -1 was not reached; look for other curves with --box" in remark
    assert remark.startswith("equilibria/equilibria.json turned back at r ")
    part = within(curve.record, (0.5, 1.0))
    assert len(part.points) < len(curve.record.points) and not part.events and min(p.value for p in part.points) >= 0.5


def test_other_curves_begin_in_a_box(tmp_path):
    """At both bounds, those that are on no curve yet; also without a state; a curve that is met twice is one."""
    lines = of.ode(lambda t, x, p: [(x[0] - 3) * (p[0] - x[0] ** 2) * (x[0] + 4 + p[0])], ["x"], parameters={"r": 1.0})
    for state in ([1.0], None):
        tree = of.diagram(lines, state, "r", -1.0, box={"x": (-6.0, 6.0)}, out=tmp_path, name=f"box-{state is None}")
        files = [curve.file for curve in tree.curves]
        assert files[0] == RESTS and files[1:] == ["box-2/equilibria.json", "box-3/equilibria.json"]
        states = sorted(round(float(point.state[0]), 9) for curve in tree.curves for point in curve.record.points
                        if point.value in (1.0, -1.0))  # fmt: skip
        assert states == [-5.0, -3.0, -1.0, 1.0, 3.0, 3.0] and tree.remarks == ()
        assert verified(load_diagram(tmp_path / tree.name / "diagram.json"), lines).passed
    with pytest.raises(ConvergenceError, match="no equilibrium was met in the box; give a larger one"):
        of.diagram(lines, None, "r", -1.0, box={"x": (10.0, 11.0)})


def test_an_infinite_period_is_an_arrow():
    """At the parameter that is told there, not where the last cycle is."""
    axes, shown = Figure().subplots(), {}
    Panel(axes, shown).endless(End("homoclinic", "", 1.0, 70.0, 1e-9), np.array([1.1, 70.0]))
    (arrow,) = axes.texts
    assert arrow.xy == (1.0, 1.0) and arrow.xyann == (1.1, 70.0) and "infinite period" in shown
    assert list(axes.lines[0].get_xdata()) == [1.0, 1.0]


@pytest.mark.parametrize("also", [(), pytest.param(("norm",), marks=pytest.mark.slow)])
def test_the_picture(nerve, tmp_path, monkeypatch, also):
    """Greatest and least values, solid where stable, a mark for each event, periods below; the window is robust."""
    drawn = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *a, **k: drawn.append(self))
    for chosen in ("V", *also):
        save_diagram_figure(replace(nerve[0], coordinate=chosen), tmp_path, morris_lecar())
    upper, below = drawn[0].axes
    values = record(nerve[0], "equilibria-0/family.json").points
    top = max(line.get_ydata().max() for line in upper.lines)
    assert 30 < top < 45 and below.get_ylabel().startswith("period") and upper.get_ylabel() == "V"
    solid = [line for line in upper.lines if line.get_linestyle() == "-" and len(line.get_xdata()) > 2]
    assert len(solid) == 4 and any(abs(line.get_xdata().max() - 216.8998) < 1e-3 for line in solid)
    names = [text.get_text() for text in drawn[0].legends[0].get_texts()]
    assert names == ["stable", "unstable", "equilibria", "Hopf", "cycles", "fold of cycles"] and len(values) > 100
    written = {text.get_text() for text in upper.texts if text.get_text()}
    assert written == {"93.858", "212.02", "216.9", "88.293"}
    for other in drawn[1:]:
        assert other.axes[0].get_ylabel() == "norm" and len(other.axes[0].lines) < len(upper.lines)
    panel = Panel(drawn[0].axes[0], {})
    panel.heights = [np.linspace(0, 1, 100), np.array([1e6])]
    panel.window()
    assert panel.axes.get_ylim()[1] < 2.0


def test_the_command(tmp_path):
    """It writes, draws, is verified and shown; the option is named in messages; a file without a state is refused."""
    file = tmp_path / "own.toml"
    table = 'system = { kind = "python", function = "brusselator", arguments = { rate = 1.8 } }\n'
    file.write_text(table + "simulate = { state = [1.0, 1.8] }\n")
    words = ["diagram", str(file), "--parameter", "rate", "--until", "2.4", "-o", str(tmp_path / "out")]
    done = CliRunner().invoke(cli, [*words, "--json", "--across", "v"])
    assert done.exit_code == 0, done.output
    document, home = json.loads(done.stdout), tmp_path / "out" / "own"
    assert document["undone"] == [] and document["written"] == [str(home / "diagram.json"), str(home / "diagram.png")]
    assert [curve["file"] for curve in document["curves"]] == [RESTS, "equilibria-0/family.json"]
    for command, more in (("verify", []), ("show", []), ("plot", []), ("export", ["--to", "csv"])):
        more += ["-o", str(tmp_path)] if command in ("plot", "export") else []
        done = CliRunner().invoke(cli, [command, str(home / "diagram.json"), *more])
        assert done.exit_code == 0, done.output
        assert command != "show" or ", what event 0, supercritical hopf at rate 2 (+- " in done.output
    assert (tmp_path / "own.csv").read_text().startswith("curve,index,rate,") and (tmp_path / "own-events.csv").exists()
    done = CliRunner().invoke(cli, [*words, "--box", "u=0:1", "--no-figures"])
    assert done.exit_code == 2 and "--box: v missing; say from where to where of each component" in done.stderr
    done = CliRunner().invoke(cli, [*words, "--points", "15", "--no-figures", "--name", "few"])
    assert done.exit_code == 1 and "followed equilibria-0/family.json" in done.stdout
    done = CliRunner().invoke(cli, [*words, "--across", "w"])
    assert done.exit_code == 2 and "--across: unknown 'w'" in done.stderr
    file.write_text(table + "search = { period = [1.0, 9.0] }\n")
    done = CliRunner().invoke(cli, words)
    assert done.exit_code == 2 and "guess: missing; give the state near an equilibrium" in done.stderr


def test_what_is_read_there_is_known_as_well_as_it_is_read_again():
    """Where the integration's own error is too coarse a bound: the farthest of five other readings, not one of them."""
    curve = SimpleNamespace(equations=SimpleNamespace(links=None))

    def probe(value, **known):
        made = Probe(curve, None)
        made.__dict__.update(about=value, **known)
        return made

    here = probe(0.02, tour=True, doubted=[0.021, 0.035, 0.012], coarser=0.0201)
    sides = Sides(probe(-1.0), here, probe(0.008), probe(1.0), apart=3e-4, step=1.0)
    sides.__dict__["across"] = np.zeros(0)  # no error bars
    read = sides.zero(lambda look: look.about, within=0.0)
    assert not read.passed and read.error == 0.02  # it is no farther: the sign changes between the two sides
    read = sides.zero(lambda look: look.about, within=4e-6)
    assert read.passed and read.error == pytest.approx(0.015 + 4e-6 / 3e-4)  # the coarser integration alone says 1e-4
