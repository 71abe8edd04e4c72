"""Maps of a parameter plane against monodromies that another program integrates, and curves of bifurcations."""

import html
import json
import re
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.mapping import verified
from orbitfinder.families.plane import BLANK, DIVERGED, RESTING, STOPPED
from orbitfinder.orbits.floquet import STABILITIES
from orbitfinder.records.journal import begin_journal, unpacked
from orbitfinder.records.registry import load
from orbitfinder.show.maps import regions, save_map_figure
from orbitfinder.site.build import build_site
from orbitfinder.site.gather import gather
from orbitfinder.site.maps import map_values

ROOT = Path(__file__).parents[1]
PLANE = {"a": np.linspace(0.1, 0.45, 15), "b": np.linspace(0.0, 0.35, 20)}
FORM = "[system]\nkind = 'python'\nfunction = 'forced_pendulum'\n[guess]\nstate = [0.1, 0.0]\nperiod = 3.14159\n"


def mathieu():
    """x'' + c x' + (a + b cos t) x = f: the response to a constant push is stable where Mathieu's equation is."""

    def field(t, x, p):
        return [x.v, p.push - p.c * x.v - (p.a + p.b * ca.cos(t)) * x.x]

    values = {"a": 0.2, "b": 0.1, "c": 0.05, "push": 1.0}
    return of.ode(field, ["x", "v"], values, forcing_period=2 * np.pi)


def problem(model=None):
    return of.Problem(model or mathieu(), of.Guess([5.0, 0.0], 2 * np.pi), name="mathieu")


@pytest.fixture(scope="module")
def plane():
    return of.map_plane(problem(), PLANE, sample=4)


def largest(a, b, c=0.05, steps=400):
    """The multiplier of largest modulus (R x C) of x'' + c x' + (a + b cos t) x, by RK4 in NumPy."""
    h, y = 2 * np.pi / steps, np.broadcast_to(np.eye(2), (*a.shape, 2, 2))

    def rate(t, y):
        return np.stack([y[..., 1, :], -c * y[..., 1, :] - (a + b * np.cos(t))[..., None] * y[..., 0, :]], axis=-2)

    for k in range(steps):
        one = rate(k * h, y)
        two = rate((k + 0.5) * h, y + h / 2 * one)
        three = rate((k + 0.5) * h, y + h / 2 * two)
        y = y + h / 6 * (one + 2 * two + 2 * three + rate((k + 1) * h, y + h * three))
    values = np.linalg.eigvals(y)
    return np.take_along_axis(values, np.abs(values).argmax(axis=2)[..., None], axis=2)[..., 0]


def test_a_map_is_that_of_mathieus_equation(plane):
    """Every pixel's multiplier; both sides of the first tongue, where it is below -1. Where b is 0 nothing moves."""
    assert np.all(plane.blank[0] == RESTING) and plane.known[1:].all() and BLANK[RESTING] in plane.counts
    theirs, stable = largest(*np.meshgrid(plane.columns, plane.rows[1:])), plane.stable[1:]
    assert np.abs(plane.values("multiplier")[1:] - np.abs(theirs)).max() < 1e-8
    assert np.array_equal(stable, np.abs(theirs) < 1.0) and 20 < stable.sum() < stable.size - 20
    assert np.array_equal(regions(plane)[1:], np.where(stable, 0.0, 2.0)) and np.all(theirs[~stable].real < -1.0)
    assert plane.sample.shape == (4, 3) and plane.sample[:, 2].all() and not plane.failures
    assert np.allclose(plane.periods[1:], 2 * np.pi, rtol=1e-14)


def test_the_boundary_is_the_curve_of_doublings(plane):
    """`follow_curve`'s points lie between pixels of different stability, or beside them: within a pixel."""
    family = of.follow_family(problem(), "a", until=0.3, settings=of.FamilySettings(directions="forward"))
    event = next(k for k, one in enumerate(family.events) if one.kind == "period_doubling")
    curve = of.follow_curve(family, event, ("a", "b"), points=25, model=mathieu())
    spans = [np.diff(axis)[0] for axis in (plane.columns, plane.rows)]
    low, high = ([axis[k] for axis in (plane.columns, plane.rows)] for k in (0, -1))
    inside = curve.places[np.all((curve.places >= low) & (curve.places <= high), axis=1)]
    assert len(inside) > 10
    for a, b in inside:
        near = (np.abs(plane.columns - a) <= spans[0]) & (np.abs(plane.rows - b) <= spans[1])[:, None] & plane.known
        assert 0 < plane.stable[near].sum() < near.sum()


def test_workers_and_a_resumed_run_give_the_same_bits(plane, tmp_path):
    """Whoever does the rows, however often it is stopped: the same record; what is done is not done again."""
    done = []

    class Stop(Exception):
        pass

    def stop(count, pixels):
        done.append(count)
        if count > pixels // 3:
            raise Stop

    with pytest.raises(Stop):
        of.map_plane(problem(), PLANE, sample=4, out=tmp_path, progress=stop)
    lines = (tmp_path / "mathieu" / "map.jsonl").read_text().splitlines()
    assert len(lines) == 5  # what is asked, the first orbit, the first pixel, the column, a strip
    again = of.map_plane(problem(), PLANE, sample=4, out=tmp_path)
    assert (tmp_path / "mathieu" / "map.jsonl").read_text().splitlines()[: len(lines)] == lines
    for name in ("nodes", "multipliers", "amplitudes", "verdicts", "sample"):
        assert np.array_equal(getattr(again, name), getattr(plane, name))


def test_a_smaller_map_leaves_a_larger_one(tmp_path):
    """It began its journal anew and wrote over all of the pixels."""
    small = {name: values[:3] for name, values in PLANE.items()}
    of.map_plane(problem(), small, sample=0, out=tmp_path)
    file = tmp_path / "mathieu" / "map.jsonl"
    whole = file.read_bytes()
    with pytest.raises(InputError, match=r"map.jsonl: map\.a: \[0.1, .* there, \[0.1, .*give another folder \(--out\)"):
        of.map_plane(problem(), small | {"a": PLANE["a"][:2]}, sample=0, out=tmp_path)
    with pytest.raises(InputError, match=r"map\.b\.1: 0.01\d* there, 0.02 asked for"):
        of.map_plane(problem(), small | {"b": [0.0, 0.02, small["b"][2]]}, sample=0, out=tmp_path)
    assert file.read_bytes() == whole


def test_processes_give_the_same_bits():
    model = of.systems.forced_pendulum(torque=0.9, damping=0.5)
    driven = of.Problem(model, of.Guess([0.1, 0.0], 3.14159), name="swing")
    given = {"damping": [0.4, 0.5], "torque": np.linspace(0.7, 1.0, 17)}
    one, two = (of.map_plane(driven, given, sample=0, workers=workers) for workers in (1, 2))
    assert np.array_equal(one.nodes, two.nodes) and np.array_equal(one.multipliers, two.multipliers) and one.known.all()


def test_beyond_a_fold_is_blank_with_its_reason():
    """Along the lower branch of a softening spring the orbit ends at a fold; amplitudes grow towards it."""
    model = of.systems.forced_duffing(stiffness=1.0, cubic=1.0, damping=0.1, force=0.3, frequency=1.5)
    low = of.Problem(model, of.Guess([-0.4, 0.0], 2 * np.pi / 1.5), name="low")
    made = of.map_plane(low, {"frequency": np.linspace(1.2, 1.5, 16), "force": np.linspace(0.28, 0.3, 3)}, sample=3,
                        by="amplitude")  # fmt: skip
    fold = 1.3242362007706  # at force 0.3, by 140 bits (problems/families/duffing-resonance.toml)
    assert np.array_equal(made.known[-1], made.columns > fold) and made.counts.count(BLANK[DIVERGED]) == 1
    assert made.sample[:, 2].all() and np.all(np.diff(made.values("amplitude")[-1][made.known[-1]]) < 0)


def test_steps_between_distant_pixels_are_as_short_as_they_must_be():
    """Three pixels along a resonance are orbits of seventeen; a clock that stands still is a sentence."""
    model = of.systems.forced_duffing(stiffness=1.0, cubic=1.0, damping=0.1, force=0.3, frequency=0.6)
    low = of.Problem(model, of.guesses.linear_response(model), name="low")
    force = [0.25, 0.3]
    coarse, fine = (of.map_plane(low, frequency=np.linspace(0.6, 1.6, k), force=force, sample=0) for k in (3, 17))
    assert np.allclose(coarse.nodes[:, :, 0], fine.nodes[:, ::8, 0], atol=1e-9) and coarse.known.all()
    with pytest.raises(InputError, match="frequency: at -0.5 the period of the forcing is -12.5664 s; give values"):
        of.map_plane(low, frequency=[-0.5, 0.5], force=force)
    with pytest.raises(InputError, match="frequency: at 0 the period of the forcing is inf s; give values"):
        of.bifurcation(low, frequency=[0.0, 0.5])
    with pytest.raises(InputError, match="frequency: at -0.5 the period"):
        of.sweep(low, frequency=[-0.5, 0.5])


def test_what_is_stopped_is_blank():
    made = of.map_plane(problem(), PLANE, sample=1, limit=1e-3)
    assert (made.blank == STOPPED).sum() > 50 and BLANK[STOPPED] in made.counts


def test_an_orbit_whose_matrices_are_singular_is_not_certified(plane, monkeypatch):
    def singular(*_, **__):
        raise np.linalg.LinAlgError("singular matrix")

    monkeypatch.setattr("orbitfinder.families.mapping.make_point", singular)
    assert {"sample", "certified"} <= set(verified(plane, mathieu()).failures)


def test_records_are_read_and_doctored_ones_refused(plane, tmp_path):
    file = of.save_map(plane, tmp_path / "map.json")
    model, again = mathieu(), load(file)
    assert again.counts == plane.counts and np.array_equal(again.nodes, plane.nodes)
    table, first = again.tables()["points"], np.argmax(plane.known)
    assert list(table)[:3] == ["index", *plane.parameters] and len(table["index"]) == plane.blank.size
    assert table["largest_multiplier"][first] == plane.values("multiplier").ravel()[first]
    assert (table["certified"] == "True").sum() == len(plane.sample)
    assert verified(again, model).passed
    nodes, wrong = plane.nodes.copy(), plane.verdicts.copy()
    nodes[3, 4] *= 1.0 + 1e-6
    wrong[2, 2] = 1 - wrong[2, 2] if wrong[2, 2] < 2 else 1
    assert "closure" in verified(replace(plane, nodes=nodes), model).failures
    assert verified(replace(plane, verdicts=wrong), model).failures == ("verdicts",)
    sample = plane.sample.copy()
    sample[0, 2] = 0
    assert verified(replace(plane, sample=sample), model).failures == ("sample",)
    document = json.loads(file.read_text())
    with pytest.raises(ValueError, match="periods: expected positive numbers where there are orbits"):
        replace(plane, periods=-plane.periods)._check()
    for entry, value in (("by", "colour"), ("curve", {}), ("parameters", ["a"])):
        file.write_text(json.dumps(document | {entry: value}))
        with pytest.raises(InputError):
            verified(of.load_map(file), model)


@pytest.mark.parametrize("by", ["stability", "multiplier", "amplitude", "period"])
def test_pictures_name_their_axes_and_colours(plane, tmp_path, by, monkeypatch):
    kept = {}
    monkeypatch.setattr("orbitfinder.show.maps.save_all", lambda figures, folder: kept.update(figures))
    blank = plane.blank.copy()
    blank[0, 0] = DIVERGED
    save_map_figure(replace(plane, by=by, blank=blank), tmp_path, mathieu())
    axes, *bars = kept["map"].axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("a", "b") and len(bars) == (by != "stability")
    words = {text.get_text() for text in kept["map"].legends[0].get_texts()}
    assert {"no orbit", "stability changes"} <= words and ("stable" in words) == (by == "stability")


@pytest.mark.parametrize("by", ["stability", "amplitude"])
def test_a_site_shows_a_map(plane, tmp_path, by):
    """Its picture and every pixel's verdict, in the same bytes each time; a page was refused."""
    named = replace(plane, name="plane <b>", by=by, title="Mathieu & friends")
    of.save_map(named, tmp_path / "map.json")
    site, summary = build_site(gather([tmp_path]))
    assert (summary.maps, summary.orbits) == (1, 0) and site.files == build_site(gather([tmp_path]))[0].files
    page, index = (site.files[path].decode() for path in ("maps/plane-b.html", "index.html"))
    assert site.files["maps/plane-b.png"].startswith(b"\x89PNG") and 'src="../maps/plane-b.png"' in page
    assert "Mathieu &amp; friends: map plane &lt;b&gt;" in page and "<b>" not in page
    assert 'href="maps/plane-b.html"' in index and "Maps, families and atlases" in index
    assert "Each moves in real time" not in index  # nothing does
    verdicts = dict(re.findall(r'<tr><th scope="row">([^<]+)</th><td>(\d+)</td>', page))
    words = np.where(plane.known, np.array(STABILITIES)[plane.verdicts], np.array(BLANK)[plane.blank])
    assert verdicts == {html.escape(word): str((words == word).sum()) for word in np.unique(words)}
    rows = re.findall(r"<tr><td>([^<]+)</td><td>([^<]+)</td><td>([^<]+)</td>", page)
    assert len(rows) == 300 and "300 pixels</summary>" in page
    for across, up, word in rows[::7]:
        row, column = np.abs(plane.rows - float(up)).argmin(), np.abs(plane.columns - float(across)).argmin()
        assert word == html.escape(words[row, column])


def test_of_many_pixels_a_page_has_some_and_counts_all(plane):
    values = map_values(plane, most=50)
    assert len(values["pixels"]) == 50 and not values["all_pixels"]
    assert sum(count for _, count, _, _ in values["verdicts"]) == 300
    assert [sum(numbers) for numbers in list(zip(*values["verdicts"], strict=True))[2:]] == [4, 4]


def test_the_command(tmp_path):
    file = tmp_path / "swing.toml"
    file.write_text(FORM)
    words = ["map", str(file), "--parameter", "torque=0.4:0.6:3", "--parameter", "damping=0.4,0.5", "-o", str(tmp_path)]
    run = CliRunner().invoke(cli, [*words, "--sample", "1", "--workers", "1", "--json"])
    assert run.exit_code == 0, run.output
    document = json.loads(run.stdout)
    assert document["parameters"] == ["torque", "damping"] and len(document["written"]) == 2
    shown = CliRunner().invoke(cli, ["show", document["written"][0]])
    assert "6 of 6 pixels have an orbit" in shown.stdout and shown.exit_code == 0
    assert CliRunner().invoke(cli, ["verify", document["written"][0]]).exit_code == 0


def test_shards_are_joined(tmp_path):
    """The same orbits; what they have is not computed again, what they have not is; others are refused by name."""
    file, name, done = tmp_path / "swing.toml", "swing", []
    file.write_text(FORM)
    words = ["map", str(file), "--parameter", "torque=0.4:0.6:3", "-o", str(tmp_path / "out"), "--sample", "1",
             "--workers", "1", "--no-figures", "--json", "--parameter"]  # fmt: skip
    for k in (3, 1):
        run = CliRunner().invoke(cli, [*words, "damping=0.4:0.5:7", "--shard", f"{k}/3"])
        assert run.exit_code == 0 and f"{k}-of-3" in run.stdout, run.output
    assert "pairs of values" in CliRunner().invoke(cli, [*words, "damping=0.4:0.5:7", "--shard", "1/4"]).output
    assert CliRunner().invoke(cli, [*words, "damping=0.4:0.5:7"]).exit_code == 0
    made = of.load_map(tmp_path / "out" / name / "map.json")
    own = [json.loads(line) for line in (tmp_path / "out" / name / "map.jsonl").read_text().splitlines()[1:]]
    filled = [unpacked(line["pixels"], int(line["pixels"].partition(":")[0]))[:, 0] for line in own]
    assert sorted(np.concatenate(filled)) == [3.0] * 3 + [4.0] * 3  # the second shard's rows and no others
    journals = sorted((tmp_path / "out").glob("*-of-3/*/map.jsonl"))
    fresh = of.map_plane(of.load_problem(file), {"torque": made.columns, "damping": made.rows}, sample=0)
    assert made.known.all() and made.sample[:, 2].all() and np.abs(made.nodes / fresh.nodes - 1).max() < 1e-9
    assert np.array_equal(made.nodes[:3], of.load_map(journals[0].with_suffix(".json")).nodes)
    of.map_plane(of.load_problem(file), {"torque": made.columns, "damping": made.rows[:3]}, sample=0,
                 shards=journals[:1], progress=lambda *each: done.append(each))  # fmt: skip
    assert done == [(9, 9)] * len(done)
    for given in ({"torque": [0.4, 0.5], "damping": made.rows}, {"torque": made.columns, "damping": made.rows[1:]}):
        with pytest.raises(InputError, match="1-of-3.*map.jsonl: map: of another map than this"):
            of.map_plane(of.load_problem(file), given, shards=journals)
    header, first, *_ = map(json.loads, journals[0].read_text().splitlines())
    for key, value, told in (
        ("versions", first["versions"] | {"casadi": "3.7.0"}, "versions: made with casadi 3.7.0, here"),
        ("segments", 7, "curve: made of another orbit than"),
    ):
        begin_journal(journals[0], {k: v for k, v in header.items() if k != "digest"},
                      [{k: v for k, v in first.items() if k != "digest"} | {key: value}])  # fmt: skip
        with pytest.raises(InputError, match=told):
            of.map_plane(of.load_problem(file), {"torque": made.columns, "damping": made.rows}, shards=journals[::-1])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"a": [0.1, 0.2]}, "two names"),
        ({"a": [0.1, 0.2], "d": [1.0, 2.0]}, "unknown 'd'"),
        ({"a": [0.1, 0.1], "b": [0.1, 0.2]}, "a: must be two different"),
        ({"a": ["x", "y"], "b": [0.1, 0.2]}, "list of numbers"),
    ],
)
def test_what_makes_no_plane_is_refused(given, words):
    with pytest.raises(InputError, match=words):
        of.map_plane(problem(), given)
    with pytest.raises(InputError, match="by: 'colour' is none of"):
        of.map_plane(problem(), PLANE, by="colour")


def test_a_plane_that_no_orbit_leads_to():
    model = of.systems.forced_duffing(stiffness=1.0, cubic=1.0, damping=0.1, force=0.3, frequency=1.5)
    low = of.Problem(model, of.Guess([-0.4, 0.0], 2 * np.pi / 1.5), name="low")
    with pytest.raises(ConvergenceError, match="none leads to frequency = 0.9"):
        of.map_plane(low, {"frequency": [0.8, 0.9], "force": [0.29, 0.31]})


@pytest.mark.parametrize(
    ("file", "given"),
    [
        ("gallery/brusselator", {"feed": [0.98, 1.0, 1.02], "rate": [2.9, 3.0, 3.1]}),
        ("examples/double-mode-2", {"energy": [-18.7, -18.6, -18.5], "gravity": [9.75, 9.8]}),
        ("hybrid/bouncing-ball", {"amplitude": [0.0119, 0.012], "restitution": [0.79, 0.8]}),
    ],
)
def test_cycles_energies_and_machines_that_bounce(file, given):
    """Orbits with a period of their own, of a level of energy, with events: each certified."""
    problem = of.load_problem(ROOT / "problems" / f"{file}.toml")
    made = of.map_plane(problem, given, sample=2)
    assert made.known.all() and made.sample[:, 2].all() and verified(made, problem.model).passed
