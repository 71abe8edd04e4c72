"""One orbit of a family or of an atlas by FILE#K, and a family's point as the Orbit that it is."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.atlas.store import Atlas
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.members import whole
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import energy
from orbitfinder.orbits.certify import certify
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.records.family import FamilyPoint, load_family, save_family, situated
from orbitfinder.records.orbit import Orbit, save_orbit, system_at
from orbitfinder.records.registry import kind_of, load_orbit, member

RESULTS = Path(__file__).parents[1] / "results"
FAMILIES = sorted(RESULTS.glob("families/*/family.json"))
QUICK = [RESULTS / "families" / name / "family.json" for name in ("henon-heiles-straight", "triple-mode-1")]
LENGTHS = RESULTS / "families" / "five-bar-length" / "family.json"
MANY = len(load_family(LENGTHS).points)
ATLAS = RESULTS / "atlas" / "triple.sqlite"
ORBIT = RESULTS / "orbits" / "triple-1" / "orbit.json"


def run(*words: object, code: int = 0) -> str:
    """What a command prints; it must end with this code."""
    done = CliRunner().invoke(cli, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == code, done.output
    return done.output


@pytest.mark.parametrize("path", FAMILIES, ids=lambda path: path.parent.name)
def test_every_point_is_an_orbit(path):
    """FILE#K is the K-th point, with the name, system and sizes of an orbit; the family's file stays as it is."""
    family = load_family(path)
    for k, point in enumerate(family.points):
        assert isinstance(point, Orbit) and (point.index, point.name) == (k, f"{family.name}-{k}")
        assert len(point.winding) == point.state.size // 2 and np.array_equal(point.nodes, point.state[None])
        assert point.system == system_at(family.system, point.free)
    k = len(family.points) // 2
    one = of.load_orbit(f"{path}#{k}")
    assert isinstance(one, FamilyPoint) and one.period == family.points[k].period
    assert np.array_equal(one.shooting_nodes, family.points[k].shooting_nodes)


def test_an_orbit_without_samples_is_drawn(tmp_path):
    """A family's point and an atlas's orbit have none; save_figures and orbit_clip asked for an orbit.npz."""
    with Atlas(ATLAS) as atlas:
        stored = atlas.orbit(1)
    for one in (of.load_orbit(f"{QUICK[1]}#3"), stored):
        assert len(one.samples) == 0
        assert len(of.save_figures(one, tmp_path / one.name)) == 4
        assert len(of.orbit_clip(one).points) > 10


def test_an_atlas_is_asked_for_one_of_its_orbits():
    assert f"one orbit of the file: {ATLAS}#1" in run("verify", ATLAS, code=2)
    with pytest.raises(InputError, match=r"triple\.sqlite#1"):
        of.load_orbit(ATLAS)


def test_a_family_is_followed_from_one_of_its_points():
    with pytest.raises(InputError, match=r"origin: a Family; give one of its points, or a branch"):
        of.follow_family(load_family(QUICK[0]))


@pytest.mark.slow
def test_a_family_is_drawn_as_continue_draws_it(tmp_path):
    """The same figures, by the command and in Python; other verbs say that they want one orbit."""
    of.follow_family(mode_problem(of.chain(2), 2), points=3, out=tmp_path / "families")
    file = tmp_path / "families" / "mode-2" / "family.json"
    said = run("plot", file, ORBIT, "-o", tmp_path).split()
    drawn = {Path(one).name for one in said if Path(one).parent.name == "mode-2"}
    assert drawn == {"frequency_energy.png", "multipliers_plane.png", "multipliers.png", "gallery.png"}
    assert {path.name for path in of.save_figures(load_family(file), tmp_path)} == drawn
    assert (tmp_path / "gallery.png").read_bytes() == (tmp_path / "mode-2" / "gallery.png").read_bytes()
    assert f"one orbit of the file: {QUICK[1]}#0" in run("animate", QUICK[1], code=2)


def test_a_problem_file_is_no_origin():
    with pytest.raises(InputError, match=r"origin: a.toml is a problem file; .* load_problem\('a.toml'\)"):
        of.follow_family("a.toml")


@pytest.fixture(scope="module")
def grown(tmp_path_factory) -> Path:
    """A family.json with its family.npz, in the formulation of half a period, begun at a point of another family."""
    folder = tmp_path_factory.mktemp("grown")
    run("continue", f"{QUICK[0]}#40", "--points", 2, "--out", folder, "--no-figures")
    return folder / "henon-heiles-straight-40" / "family.json"


@pytest.mark.parametrize("path", FAMILIES, ids=lambda path: path.parent.name)
def test_a_family_is_written_as_it_was_read(path, tmp_path):
    """What a point has as an Orbit is not written again: the same numbers come out (without family.npz beside it)."""
    again, first = (json.loads(one.read_text()) for one in (save_family(load_family(path), tmp_path), path))
    for event in first["events"]:  # what 0.2.0 called the fold of a period is a turn
        if event["kind"] == "fold" and event["detail"] not in ("energy", *event["free"]):
            event["kind"] = "turn"
    assert {key: again[key] for key in again if key not in ("dense", "record")} == {
        key: first[key] for key in first if key not in ("dense", "record")
    }


def test_a_grown_family_is_written_as_it_was_read(grown, tmp_path):
    """The same file to the byte, digests of the dense arrays included."""
    assert save_family(load_family(grown), tmp_path).read_bytes() == grown.read_bytes()


@pytest.mark.parametrize("path", [*QUICK, LENGTHS], ids=lambda path: path.parent.name)
def test_certified_points_certify_from_the_file_alone(path):
    """Of the points that a family calls certified every check passes again, by the numbers of the file."""
    sure = [point for point in load_family(path).points if point.certified]
    assert sure
    for point in sure[:: max(1, len(sure) // 3)]:
        found = certify(point)
        assert found.passed and len(found.checks) >= 15, found.failures


def test_a_point_that_was_edited_is_rejected():
    """A recorded number that is not the orbit's is found, the symmetry of the formulation included."""
    point = load_family(QUICK[1]).points[20]
    model = build_model(point.system)
    assert certify(point, model).passed
    for name, value in (
        ("action", 1.001 * point.action), ("stability", "marginal" if point.stability != "marginal" else "unstable"),
        ("symmetry", "reversal2"), ("closure", 1e-3),
    ):  # fmt: skip
        assert not certify(replace(point, **{name: value}), model).passed, name
    for fewer in ("none", "brake", "reflection", "reversal"):  # it is symmetric in every way
        assert certify(replace(point, symmetry=fewer), model).passed
    bent = load_family(QUICK[0]).points[30]
    assert bent.symmetry == "brake" and not certify(replace(bent, symmetry="reversal")).passed


def test_a_freed_parameter_is_in_the_points_system():
    """The point's own system has the value that the point was found at, and its energy follows from it."""
    for point in load_family(LENGTHS).points[::9]:
        model = build_model(point.system)
        assert model.parameter_values[model.parameter_index("length3")] == point.free["length3"]
        assert energy(model, point.state) == pytest.approx(point.energy, rel=1e-12)


@pytest.mark.parametrize(
    ("model", "values"),
    [
        (of.chain(3), {"length2": 0.7, "mass3": 2.0, "gravity": 1.6}),
        (of.systems.duffing(), {"cubic": 0.3}),
        (of.chain(2), {}),
    ],
)
def test_a_changed_description_is_that_of_the_changed_model(model, values):
    described = system_at(model.system, values)
    assert described == with_parameters(model, values).system
    assert np.array_equal(build_model(described).parameter_values, with_parameters(model, values).parameter_values)


@pytest.mark.parametrize(
    ("symmetry", "constant", "turns"),
    [
        ("none", [2 * np.pi, -4 * np.pi, 0.0, 0.0], (1, -2)),
        ("reversal", [0.0, np.pi, 3 * np.pi, np.pi], (3, 0)),
        ("brake+reflection", [0.0, 0.0, np.pi, 0.0], (0, 0)),
        ("none", [], (0, 0)),
    ],
)
def test_turns_of_older_files_follow_from_the_boundary(symmetry, constant, turns):
    """As the symmetry has them; files of today say the turns."""
    point = load_family(QUICK[0]).points[0]
    about = 7, "some", point.system
    curve = {"symmetry": symmetry, "constant": constant}
    assert situated(point, *about, curve).winding == turns
    if constant:
        assert tuple(SYMMETRIES[symmetry].turns(np.array(constant))) == turns
    assert situated(point, *about, curve | {"winding": [4, 5]}).winding == (4, 5)
    for wrong in ([4], ["a", 5], 3, [1.5, 2]):
        with pytest.raises(ValueError, match="curve.winding"):
            situated(point, *about, curve | {"winding": wrong})


@pytest.mark.parametrize("dense", [True, False])
def test_an_orbit_of_its_own_can_be_saved(grown, dense, tmp_path):
    """`whole` makes of a point an orbit.json like any other: samples, the symmetry that it has, a certificate."""
    point = load_orbit(f"{grown}#3" if dense else f"{QUICK[0]}#40")
    assert isinstance(point, FamilyPoint) and bool(point.shooting_nodes.size) == dense
    one = whole(point, build_model(point.system))
    assert type(one) is Orbit and one.certificate.passed and one.times[-1] == point.period
    again = load_orbit(save_orbit(one, tmp_path / "orbit.json"))
    assert certify(again).passed and np.array_equal(again.samples, one.samples)


def test_a_proof_survives_reading_and_writing(tmp_path):
    """The `proof` entry is part of an Orbit."""
    document = json.loads(ORBIT.read_text()) | {"proof": {"theorem": 2, "proved": True, "period": "1.65"}}
    (tmp_path / "orbit.json").write_text(json.dumps(document))
    shutil.copy(ORBIT.with_suffix(".npz"), tmp_path / "orbit.npz")
    orbit = load_orbit(tmp_path / "orbit.json")
    written = json.loads(save_orbit(orbit, tmp_path / "again.json").read_text())
    assert orbit.proof == written["proof"] == document["proof"] and written["record"] == document["record"]


def test_files_say_what_they_hold(tmp_path):
    for path, kind in ((ORBIT, "orbit"), (LENGTHS, "family"), (ATLAS, "atlas")):
        assert kind_of(path) == kind
    for text, kind in (
        ('[{"format": "orbitfinder/orbit"}]', "export"), ('{"name": "x", "format": "orbitfinder/family"}', "family"),
        ('{"a": {"format": "orbitfinder/orbit"}}', ""), ("name = 3", ""),
    ):  # fmt: skip
        (tmp_path / "some.json").write_text(text)
        assert kind_of(tmp_path / "some.json") == kind
    assert member("a/b.json#7") == (Path("a/b.json"), 7) and member("a/b.json") == (Path("a/b.json"), None)
    shutil.copy(ORBIT, tmp_path / "mine#2")
    assert member(tmp_path / "mine#2") == (tmp_path / "mine#2", None)
    assert load_orbit(tmp_path / "mine#2").name == "triple-1"


def test_orbits_of_an_atlas_have_numbers(tmp_path):
    """By the id in the database, and by the place in the list of its JSON export."""
    with Atlas(ATLAS) as atlas:
        wanted, documents = atlas.orbit(5), [atlas.document(5), atlas.document(3)]
    assert load_orbit(f"{ATLAS}#5").record == wanted.record
    (tmp_path / "atlas.json").write_text(json.dumps(documents))
    assert load_orbit(tmp_path / "atlas.json#0").record == wanted.record
    assert of.load_orbit(f"{ATLAS}#5").record == wanted.record
    assert load_orbit(Path(f"{ATLAS}#5")).record == wanted.record


@pytest.mark.parametrize(
    ("path", "said"),
    [
        (f"{LENGTHS}#{MANY}", f"#{MANY}: no such orbit in the file; give a number from 0 to {MANY - 1}"),
        (f"{LENGTHS}#-1", "#-1: not a whole number from 0; give FILE#K, such as family.json#0"),
        (f"{LENGTHS}#", "#: not a whole number from 0; give FILE#K, such as family.json#0"),
        (f"{LENGTHS}#3.0", "#3.0: not a whole number from 0"),
        (f"{ATLAS}#451", "id: no orbit 451, ids are from 1 to 450; list them with orbitfinder atlas list"),
        (f"{ATLAS}#99999999999999999999", "id: no orbit 99999999999999999999, ids are from 1 to 450"),
        (f"{ORBIT}#0", "#0: not a family or an atlas, of which orbits have numbers; leave #0 out"),
        ("missing/family.json#3", "missing/family.json: no such file; check the path"),
    ],
)
@pytest.mark.parametrize("verb", ["verify", "export --to csv"])
def test_a_number_that_is_none_is_refused(verb, path, said):
    assert said in run(*verb.split(), path, code=2)


def test_one_orbit_of_a_family_is_exported_by_its_number():
    assert "--to: c files hold orbits, and five-bar-length is a table" in run("export", "--to", "c", LENGTHS, code=2)


@pytest.mark.parametrize("path", [f"{QUICK[0]}#40", f"{ATLAS}#5"], ids=["family", "atlas"])
def test_every_verb_takes_one_orbit_of_a_file(path, tmp_path):
    assert "certified" in run("verify", path)
    assert json.loads(run("verify", path, "--json"))["results"][0]["file"] == path
    (table,) = run("export", path, "--to", "csv", "-o", tmp_path).split()
    rows = np.loadtxt(table, delimiter=",", skiprows=1)
    assert rows[-1, 0] == pytest.approx(load_orbit(path).period) and np.abs(rows[0, 1:] - rows[-1, 1:]).max() < 1e-6
    assert "time_histories.png" in run("plot", path, "-o", tmp_path / "figures")
    assert "index.html: 1 orbit, " in run("page", path, "-o", tmp_path / "site")
    assert "refined" not in run("verify", path, "--proof", code=2) and not list(Path(path).parent.glob("*#*"))


def test_a_point_moves(tmp_path):
    assert (tmp_path / "point.gif").name in run(
        "animate", f"{QUICK[0]}#40", "-o", tmp_path / "point.gif", "--size", 160, "--fps", 10
    )


@pytest.mark.needs("proof")
def test_a_point_is_proved_and_not_recorded():
    before = QUICK[0].read_bytes()
    said = run("prove", f"{QUICK[0]}#40")
    assert "proved in" in said and "the proof is not recorded" in said and QUICK[0].read_bytes() == before


def test_a_family_goes_on_from_a_point(grown):
    family, point = load_family(grown), load_family(QUICK[0]).points[40]
    assert family.source == {"kind": "orbit", "name": point.name} and len(family.points) == 5
    assert min(abs(one.energy - point.energy) for one in family.points) < 1e-12
