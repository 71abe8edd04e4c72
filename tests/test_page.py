"""The static site: what it is made from, what it says, and that nothing in a file can do harm."""

import base64
import json
import re
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from conftest import pendulum_period
from jinja2 import UndefinedError

from orbitfinder import systems
from orbitfinder._runtime import locks
from orbitfinder.atlas.store import Atlas, Filter
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError, plural
from orbitfinder.families.entries import kind_of
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.integrate.rk8 import march
from orbitfinder.loops.symmetry import REVERSAL, SYMMETRIES
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import positions, vector_field
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.course import course
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.problemfile.read import load_problem
from orbitfinder.problemfile.write import orbit_name, orbit_text, toml
from orbitfinder.records.certificate import (
    Certificate,
    at_least,
    at_most,
    certificate_of,
    certificate_to_document,
)
from orbitfinder.records.family import Event, load_family
from orbitfinder.records.orbit import orbit_to_document
from orbitfinder.records.registry import load_orbit
from orbitfinder.show.facts import number
from orbitfinder.show.scene import evenly
from orbitfinder.site import writing
from orbitfinder.site.build import SiteSettings, build_site
from orbitfinder.site.gather import gather
from orbitfinder.site.landscape import landscape
from orbitfinder.site.motion import Simulator, histories, packed, skeleton
from orbitfinder.site.pages import portraits, span, spread
from orbitfinder.site.text import PAGES, coordinate, mechanism, script_data, size, slug_maker
from orbitfinder.site.writing import MARK, check_target, mark, write_site

ROOT = Path(__file__).parents[1]
SHIPPED = ROOT / "results" / "orbits"
NASTY = '</script><script>window.stolen = 1</script>\u2028 & "quoted" <b>'
SLOW_TO_START = ("four-bar-rotating",)
"""Its guess is the first return of a long simulation."""
PROBLEMS = [
    path
    for folder in ("gallery", "linkages")
    for path in sorted((ROOT / "problems" / folder).glob("*.toml"))
    if path.stem not in SLOW_TO_START
]


def document(name: str = "triple-1") -> dict:
    return json.loads((SHIPPED / name / "orbit.json").read_text())


@pytest.fixture(scope="session")
def material(tmp_path_factory) -> Path:
    """The shipped orbits, one with a title that is a program, a small family, and an atlas in both forms."""
    folder = tmp_path_factory.mktemp("material")
    shutil.copytree(SHIPPED, folder / "orbits", ignore=shutil.ignore_patterns("*.png"))
    (folder / "orbits" / "nasty").mkdir()
    (folder / "orbits" / "nasty" / "orbit.json").write_text(
        json.dumps(document() | {"name": "../" + NASTY, "title": NASTY, "source": NASTY})
    )
    settings = FamilySettings(first_step=0.1, longest_step=0.3)
    follow_family(mode_problem(chain(2), 1, 0.3), points=12, out=folder / "families", settings=settings)
    orbits = [load_orbit(path) for path in sorted(SHIPPED.glob("triple-*/orbit.json"))]
    with Atlas(folder / "triples.sqlite", write=True, model=chain(3)) as atlas:
        for orbit in orbits:
            atlas.add(orbit)
    (folder / "quadruples.json").write_text(json.dumps([document("quadruple-1"), document("quadruple-2")]))
    return folder


@pytest.fixture(scope="session")
def site(material, tmp_path_factory) -> Path:
    """A site of all of it, written by the command."""
    out = tmp_path_factory.mktemp("site") / "site"
    paths = [material / "orbits", material / "families", material / "triples.sqlite", material / "quadruples.json"]
    result = CliRunner().invoke(cli, ["page", *map(str, paths), "-o", str(out), "--title", "A & B"])
    assert result.exit_code == 0, result.output
    assert "9 orbits, 1 family, 2 atlases" in result.output
    return out


def embedded(path: Path) -> tuple[str, dict]:
    """Key and payload of a data file."""
    found = re.fullmatch(r'orbitfinder\.put\("([^"]+)",(.*)\);\n', path.read_text(encoding="ascii"))
    assert found
    return found.group(1), json.loads(found.group(2))


def decoded(motion: dict) -> np.ndarray:
    """Positions (m x 2 x j) out of what `packed` made."""
    many, values = motion["points"], np.frombuffer(base64.b64decode(motion["data"]), "<i2").astype(float)
    channels = np.zeros((3 * many, motion["count"]))
    for row, channel in enumerate(motion["moving"]):
        part = values[row * motion["count"] : (row + 1) * motion["count"]]
        channels[channel] = part / 32767
        if channel < 2 * many:
            channels[channel] = motion["centre"][channel >= many] + motion["half"] * part / 32767
    for channel, value in motion["still"].items():
        channels[int(channel)] = value
    points = channels[: 2 * many].reshape(2, many, -1)
    for point, parent, length, middle, _ in motion.get("rods", []):
        angle = channels[2 * many + point] * motion["swing"] + middle * (length > 0)
        points[:, point] = points[:, parent] + length * np.array([np.cos(angle), np.sin(angle)])
    return points.transpose(2, 0, 1)


def test_every_page_is_whole(site):
    pages = sorted(path.relative_to(site).as_posix() for path in site.rglob("*.html"))
    assert len([page for page in pages if page.startswith("orbits/")]) == 9
    assert "index.html" in pages and "atlases/triples.html" in pages and "atlases/quadruples.html" in pages
    assert any(page.startswith("families/") for page in pages)
    for page in pages:
        text = (site / page).read_text(encoding="utf-8")
        assert not re.search(r"[$@]{2}|\$[a-z]", text), page
        for target in re.findall(r'(?:src|href)="([^"#]+)"', text):
            assert "://" not in target and (site / page).parent.joinpath(target).resolve().is_file(), (page, target)
        assert text.startswith("<!doctype html>") and 'lang="en"' in text and "<title>" in text


def test_page_weight_is_stated_and_true(site):
    stated = re.search(r"This page loads ([\d.]+) MB; the whole site is ([\d.]+) MB", (site / "index.html").read_text())
    assert stated is None  # the gallery itself loads no plotting library
    stated = re.search(
        r"This page loads ([\d.]+) MB; the whole site is ([\d.]+) MB", (site / "orbits/triple-1.html").read_text()
    )
    whole = sum(path.stat().st_size for path in site.rglob("*") if path.is_file())
    assert stated and float(stated.group(2)) == pytest.approx(whole / 1e6, abs=0.02)
    own = ["orbits/triple-1.html", "data/orbits/triple-1.js"]
    own += [
        f"assets/{name}" for name in ("page.css", "theme.js", "core.js", "plotly-basic.min.js", "plots.js", "orbit.js")
    ]
    assert float(stated.group(1)) == pytest.approx(sum((site / name).stat().st_size for name in own) / 1e6, abs=0.02)


@pytest.mark.slow
def test_a_hundred_orbits_stay_below_six_megabytes(material):
    found = gather([material / "orbits"])
    made, summary = build_site(replace(found, orbits=found.orbits * 20))
    assert summary.orbits == 100 and summary.size < 6e6
    assert summary.size == sum(map(len, made.files.values()))


def test_nothing_in_a_file_becomes_markup(site):
    pages = list(site.rglob("*.html"))
    assert sum("window.stolen" in page.read_text(encoding="utf-8") for page in pages) >= 2
    for page in pages:
        text = page.read_text(encoding="utf-8")
        assert "<script>window" not in text and "<b>" not in text and not re.search(r"<script(?! (defer )?src=)", text)
    for data in (site / "data").rglob("*.js"):
        assert "<" not in data.read_text(encoding="ascii")
    names = {path.name for path in site.rglob("*")}
    assert not any(".." in name or "<" in name for name in names)


def test_data_survive_their_escapes():
    text = script_data("key", {"title": NASTY, "number": float("nan"), "list": [1.5, float("inf")]})
    assert "<" not in text and "&" not in text and "\u2028" not in text
    payload = json.loads(text[len('orbitfinder.put("key",') : -len(");\n")])
    assert payload == {"title": NASTY, "number": None, "list": [1.5, None]}


def test_templates_escape_what_is_not_markup():
    parts = PAGES.get_template("parts.html").module
    made = parts.player(NASTY) + parts.options([NASTY]) + parts.stability_badge("<i>")
    assert "&lt;i&gt;" in made and "<script>" not in made and "<i>" not in made and 'id="stage"' in made


def test_a_template_says_what_it_misses():
    with pytest.raises(UndefinedError, match="'about' is undefined"):
        PAGES.get_template("atlas.html").render()


def test_same_input_same_bytes(material):
    first, _ = build_site(gather([material]))
    second, _ = build_site(gather([material]))
    assert first.files == second.files


def test_former_page_is_replaced_and_nothing_else(site, tmp_path):
    made, _ = build_site(gather([SHIPPED / "triple-1"]), SiteSettings("first"))
    out = tmp_path / "site"
    write_site(made.files, out)
    more = made.files | {"orbits/old.html": b"", "more/old.html": b""}
    write_site(more | {MARK: mark(more)}, out)
    write_site(made.files, out)
    assert sorted(path.relative_to(out).as_posix() for path in out.rglob("*") if path.is_file()) == sorted(made.files)
    assert not (out / "more").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["site"]
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "thesis.txt").write_text("all of it")
    with pytest.raises(InputError, match="not empty and holds no former page"):
        write_site(made.files, foreign)
    assert (foreign / "thesis.txt").read_text() == "all of it"
    with pytest.raises(InputError, match="exists and is not a folder"):
        check_target(foreign / "thesis.txt")
    with pytest.raises(InputError, match="cannot write beside"):
        write_site(made.files, foreign / "thesis.txt" / "site")


@pytest.mark.parametrize("edition", [1, 2])
def test_what_others_keep_in_the_folder_stays(tmp_path, edition):
    """A repository, a CNAME, links and empty folders outlive the former page, whichever edition wrote that."""
    made, _ = build_site(gather([SHIPPED / "triple-1"]))
    out = tmp_path / "site"
    write_site(made.files | {"orbits/old.html": b"", MARK: mark(["orbits/old.html", *made.files])}, out)
    if edition == 1:
        (out / MARK).write_text('{"format": "orbitfinder/page", "version": 1}')
    (out / ".git" / "refs").mkdir(parents=True)
    (out / ".git" / "HEAD").write_text("ref: refs/heads/main")
    (out / "CNAME").write_text("orbits.example")
    (out / "orbits" / "notes.md").write_text("mine")
    (out / "link").symlink_to("CNAME")
    write_site(made.files, out)
    assert (out / ".git" / "HEAD").read_text() == "ref: refs/heads/main" and (out / ".git" / "refs").is_dir()
    assert (out / "link").is_symlink() and (out / "link").read_text() == "orbits.example"
    assert (out / "orbits" / "notes.md").read_text() == "mine" and not (out / "orbits" / "old.html").exists()
    assert (out / "index.html").read_bytes() == made.files["index.html"]
    (out / "orbits" / "double.html").write_text("mine")
    with pytest.raises(InputError, match="double.html is in the way"):
        write_site(made.files | {"orbits/double.html": b""}, out)
    assert (out / "orbits" / "double.html").read_text() == "mine"


def test_what_a_killed_page_left_is_removed_or_put_back(tmp_path):
    """Its temporary folder goes at the next run; of others' folders with like names nothing does."""
    made, _ = build_site(gather([SHIPPED / "triple-1"]))
    out = tmp_path / "site"
    write_site(made.files, out)
    (out / "CNAME").write_text("orbits.example")
    for name, inner in ((".site.abcdefgh", "new"), (".site.12345678", "thesis"), (".site.longer-name", "new")):
        (tmp_path / name / inner).mkdir(parents=True)
    (tmp_path / ".site.killed_1").mkdir()
    out.rename(tmp_path / ".site.killed_1" / "old")  # killed between the two renames
    write_site(made.files, out)
    assert {path.name for path in tmp_path.iterdir()} == {"site", ".site.12345678", ".site.longer-name"}
    assert (out / "CNAME").read_text() == "orbits.example"


def test_one_process_writes_a_site_at_a_time(tmp_path, monkeypatch):
    made, _ = build_site(gather([SHIPPED / "triple-1"]))
    monkeypatch.setattr(writing, "PATIENCE", 0.1)
    with locks.held(tmp_path / ".site.lock"), pytest.raises(InputError, match="another process is writing"):
        write_site(made.files, tmp_path / "site")
    assert not (tmp_path / "site").exists()


@pytest.mark.parametrize("failure", [OSError("disk full"), KeyboardInterrupt()])
def test_a_failed_write_leaves_the_former_page(failure, tmp_path, monkeypatch):
    made, _ = build_site(gather([SHIPPED / "triple-1"]))
    out, rename = tmp_path / "site", Path.rename
    write_site(made.files, out)
    before = (out / "index.html").read_bytes()

    def failing(self, target):
        if self.name == "new":
            raise failure
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises((InputError, KeyboardInterrupt)):
        write_site(made.files, out)
    assert (out / "index.html").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["site"]


def test_part_of_an_atlas_keeps_its_numbers(material, tmp_path):
    """The filters of `atlas list` choose what a page shows; exports were chosen from already."""
    with Atlas(material / "triples.sqlite") as atlas:
        (row,) = atlas.rows(Filter(symmetry="brake"))
        assert len(atlas) == 2
    asked = ["page", str(material / "triples.sqlite"), "-o", str(tmp_path / "site"), "--no-verify"]
    result = CliRunner().invoke(cli, [*asked, "--symmetry", "brake"])
    assert result.exit_code == 0 and "1 orbit, 1 atlas" in result.output
    _, told = embedded(tmp_path / "site" / "data" / "atlases" / "triples.js")
    assert [one["command"] for one in told["items"]] == [f"orbitfinder atlas show triples.sqlite {row.id}"]
    assert "1 of 2 distinct orbits" in (tmp_path / "site" / "atlases" / "triples.html").read_text(encoding="utf-8")
    for more, says in (
        (["--energy", "900,901"], "triples.sqlite: none of its 2 orbits is chosen"),
        (["--stability", "stable"], "unknown 'stable', stable orbits are elliptic"),
        ([str(material / "quadruples.json"), "--symmetry", "brake"], "an export, of which nothing is chosen again"),
    ):  # fmt: skip
        wrong = CliRunner().invoke(cli, [*asked, *more])
        assert wrong.exit_code == 2 and says in wrong.output


def test_every_point_of_a_family_says_how_a_command_takes_it(site, material, monkeypatch):
    (name,) = (path.name for path in (material / "families").iterdir())
    _, told = embedded(site / "data" / "families" / f"{name}.js")
    points = [one for one in told["items"] if one["key"].startswith("point=")]
    monkeypatch.chdir(material)
    assert points and all(one["command"].startswith("orbitfinder verify families/") for one in points)
    taken = [load_orbit(Path(one["command"].split()[-1])) for one in (points[0], points[-1])]
    assert [one.period for one in taken] == [points[0]["period"], points[-1]["period"]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "truncated or corrupt JSON"),
        ("7", "expected an object, got int; give an orbit.json"),
        ('{"format": "something"}', "got 'something'; give an orbit.json"),
        ('[{"format": "orbitfinder/orbit"}]', r"file.json\[0\]: version: this orbitfinder reads 1"),
        (json.dumps(document() | {"period": -1.0}), "not finite or not positive"),
        (json.dumps(document() | {"state": [1, 2, 3, 4, 5]}), "5 numbers; coordinates and then as many velocities"),
        (json.dumps(document() | {"state": ["x"]}), "malformed entry"),
        ('{"format": "orbitfinder/family", "version": 1}', "name: missing"),
        (json.dumps({"format": "orbitfinder/family", "version": 1, "name": "f", "system": {}, "parameter": "energy",
                     "points": [], "events": [], "ends": []}), "points: none"),
        (json.dumps({"format": "orbitfinder/family", "version": 1, "name": "f", "system": {}, "parameter": "energy",
                     "points": [{"period": 1.0}], "events": [], "ends": []}), r"points\[0\].state: missing"),
        (json.dumps(document()).replace(repr(document()["state"][0]), "1e999"), "not finite"),
        ("[" * 100_000, "nested too deeply|corrupt JSON"),
    ],
)  # fmt: skip
def test_bad_files_are_named(content, message, tmp_path):
    file = tmp_path / "file.json"
    file.write_text(content)
    with pytest.raises(InputError, match=message):
        gather([file])
    result = CliRunner().invoke(cli, ["page", str(file), "-o", str(tmp_path / "out")])
    assert result.exit_code == 2 and result.output.startswith("Error: ") and not (tmp_path / "out").exists()


def test_bad_numbers_of_a_family_are_named(material, tmp_path):
    family = json.loads(next(material.glob("families/*/family.json")).read_text())
    family["points"][3]["energy"] = float("nan")
    (tmp_path / "family.json").write_text(json.dumps(family))
    with pytest.raises(InputError, match="NaN is not a number"):
        gather([tmp_path])


def test_bad_paths_are_named(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        gather([tmp_path / "absent.json"])
    with pytest.raises(InputError, match=r"no such file|check the path"):
        gather([tmp_path / "absent.sqlite"])
    with pytest.raises(InputError, match="no orbit.json, family.json or atlas"):
        gather([tmp_path])
    (tmp_path / "text.sqlite").write_text("not a database")
    with pytest.raises(InputError, match="text.sqlite"):
        gather([tmp_path / "text.sqlite"])
    (tmp_path / "latin.json").write_bytes(b'{"name": "\xe9"}')
    with pytest.raises(InputError, match="cannot be read"):
        gather([tmp_path / "latin.json"])
    shutil.copy(SHIPPED / "triple-1" / "orbit.json", tmp_path / "orbit.json")
    (tmp_path / "orbit.npz").write_bytes(b"no zip")
    with pytest.raises(InputError, match="damaged"):
        gather([tmp_path / "orbit.json"])


def test_folders_are_searched_for_results(tmp_path):
    for name in ("below/orbit.json", "proved.json", "rejected.json"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(json.dumps(document() | {"name": name}))
    (tmp_path / "numbers.json").write_text('{"format": "something else"}')
    (tmp_path / "list.json").write_text(json.dumps([document()]))
    found = gather([tmp_path])
    assert [one.document["name"] for one in found.orbits] == ["below/orbit.json", "proved.json"]
    assert not found.atlases and not found.families


def test_a_proved_copy_takes_the_place_of_the_orbit(tmp_path):
    (tmp_path / "orbit.json").write_text(json.dumps(document()))
    (tmp_path / "proved.json").write_text(json.dumps(document() | {"proof": {"proved": True}}))
    (tmp_path / "other.json").write_text(json.dumps(document() | {"name": "other"}))
    found = gather([tmp_path])
    assert sorted(one.document["name"] for one in found.orbits) == ["other", "triple-1"]
    assert next(one for one in found.orbits if one.document["name"] == "triple-1").document["proof"]["proved"]


def test_a_path_given_twice_counts_once(material):
    found = gather([material / "orbits", material / "orbits" / "triple-1" / "orbit.json"])
    assert len(found.orbits) == 5


@pytest.mark.parametrize("name", ["triple-1", "quadruple-2"])
def test_positions_are_those_of_the_orbit(name):
    about = document(name)
    motion = Simulator().orbit(about)
    seen, model = decoded(packed(motion)), build_model(about["system"])
    exact = positions(model, motion.at(len(seen)))
    extent = np.ptp(exact, axis=(0, 2)).max()
    assert np.abs(seen - exact).max() < 1e-4 * extent
    lengths = np.linalg.norm(np.diff(seen, axis=2), axis=1)
    assert np.abs(lengths - 1.0).max() < 1e-8  # rebuilt from angles
    nodes = np.asarray(about["nodes"])
    assert np.abs(motion.at(len(nodes)) - nodes).max() < 1e-5


@pytest.mark.parametrize("name", ["triple-1", "triple-2"])
def test_interpolation_of_the_page_is_good_to_a_pixel(name):
    motion = Simulator().orbit(document(name))
    coarse, fine = motion.points, positions(build_model(document(name)["system"]), motion.at(2 * len(motion.points)))
    u, around = 0.5, [np.roll(coarse, shift, axis=0) for shift in (1, 0, -1, -2)]
    weights = [-u + 2 * u**2 - u**3, 2 - 5 * u**2 + 3 * u**3, u + 4 * u**2 - 3 * u**3, u**3 - u**2]  # as core.js
    between = sum(w / 2 * part for w, part in zip(weights, around, strict=True))
    assert np.abs(between - fine[1::2]).max() < 0.006 * np.ptp(fine, axis=(0, 2)).max()


def test_histories_hold_the_states():
    motion = Simulator().orbit(document())
    made = histories(motion)
    states = np.frombuffer(base64.b64decode(made["data"]), "<f4").reshape(6, made["count"])
    assert np.abs(states[:, 0] - document()["state"]).max() < 1e-6
    assert np.abs(states[:, -1] - states[:, 0]).max() < 1e-5


@pytest.mark.parametrize(
    ("symmetry", "start", "share"),
    [
        ("brake+reflection", [1.2, 0.0], 0.25),
        ("brake", [1.2, 0.0], 0.5),
        ("reflection", [1.2, 0.0], 0.5),
        ("reversal", [0.0, None], 0.5),
        ("none", [1.2, 0.0], 1.0),
    ],
)
def test_symmetries_complete_an_orbit(symmetry, start, share):
    """The part that a symmetry leaves free, completed, is the whole orbit by integration."""
    model, period = chain(1), pendulum_period(1.2)
    if start[1] is None:
        start = [0.0, np.sqrt(2 * 9.8 * 0.5 * (1 - np.cos(1.2)) / (1 / 3))]
    field = vector_field(model, (), ())
    steps = 200
    whole = march(field, np.array(start), period, steps, np.zeros(0))
    part = march(field, np.array(start), share * period, int(steps * share), np.zeros(0))
    made = SYMMETRIES[symmetry].whole(np.linspace(0, share * period, len(part)), part)[1]
    assert np.abs(made - whole).max() < 1e-8


def test_symmetry_of_a_running_orbit_keeps_its_turns():
    model, speed = chain(1), 12.0
    field = vector_field(model, (), ())
    times = np.linspace(0, 1, 401)
    path = march(field, np.array([0.0, speed]), 1.0, 400, np.zeros(0))
    period = float(np.interp(2 * np.pi, path[:, 0], times))
    part = march(field, np.array([0.0, speed]), period / 2, 100, np.zeros(0))
    made = REVERSAL.whole(np.linspace(0, period / 2, 101), part)[1]
    assert made[-1, 0] == pytest.approx(2 * np.pi, abs=1e-3) and made[-1, 1] == pytest.approx(speed, abs=1e-3)


def test_family_members_move(material):
    family = load_family(next(material.glob("families/*/family.json")))
    motion = Simulator().member(family.system, family.points[-1])
    assert motion is not None
    assert np.abs(motion.states[0] - motion.states[-1]).max() < 1e-6
    energies = [point.energy for point in family.points]
    _, payload = embedded_site(material)
    assert payload["columns"]["energy"] == energies
    assert sum(not item["event"] for item in payload["items"]) == len(energies)
    assert all(item["motion"] for item in payload["items"])


def test_family_motions_start_from_the_nodes(material, tmp_path):
    """With family.npz each segment starts from its own node; and the motion is the same."""
    source = next(material.glob("families/*/family.json"))
    shutil.copy(source, tmp_path / "family.json")
    bare, full = (gather([path]).families[0] for path in (tmp_path / "family.json", source))
    assert not bare.points[0].shooting_nodes.size and full.points[0].shooting_nodes.size
    first, second = (Simulator().member(one.system, one.points[0]) for one in (bare, full))
    assert np.abs(first.at(60) - second.at(60)).max() < 1e-5
    middle = len(first.states) // 8  # cut the quarter that is free into two segments
    edges = np.array([0.0, first.course.times[middle] / first.period, 0.25])
    many = replace(full.points[0], shooting_nodes=first.states[[0, middle]], mesh=edges)
    assert many.symmetry == "brake+reflection"
    assert np.abs(Simulator().member(full.system, many).at(60) - first.at(60)).max() < 1e-5
    (tmp_path / "family.npz").write_bytes(b"no zip")
    with pytest.raises(InputError, match="family.npz: damaged"):
        gather([tmp_path / "family.json"])


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_a_member_that_does_not_join_is_not_drawn(symmetry):
    """From the state of another instant the part that a symmetry leaves free does not meet what follows."""
    system, period = chain(1).system, pendulum_period(1.2)
    speed = np.sqrt(2 * 9.8 * 0.5 * (1 - np.cos(1.2)) / (1 / 3))
    good = [0.0, speed] if symmetry == "reversal" else [1.2, 0.0]
    one = Event("fold", 0, 0.0, 0.0, np.array(good), period, 0.0, symmetry=symmetry)
    assert Simulator().member(system, one) is not None
    assert Simulator().member(system, replace(one, period=0.9 * period)) is None
    assert Simulator().member(system, replace(one, symmetry="unheard of")) is None
    assert Simulator().member(system, replace(one, state=np.array([1.0]))) is None


@pytest.mark.parametrize("symmetry", SYMMETRIES)
def test_completed_times_reach_the_period(symmetry):
    times = SYMMETRIES[symmetry].fraction * np.array([0.0, 0.1, 0.5, 1.0]) * 3.0
    made, states = SYMMETRIES[symmetry].whole(times, np.zeros((4, 2)))
    assert made[0] == 0.0 and made[-1] == pytest.approx(3.0) and np.all(np.diff(made) > 0) and len(states) == len(made)


def embedded_site(material: Path) -> tuple[str, dict]:
    made, _ = build_site(gather([material / "families"]))
    text = next(data for path, data in made.files.items() if path.startswith("data/families/")).decode()
    found = re.fullmatch(r'orbitfinder\.put\("([^"]+)",(.*)\);\n', text)
    return found.group(1), json.loads(found.group(2))


def test_a_motion_that_does_not_join_is_not_drawn():
    broken = document() | {"nodes": None, "state": [2.0, -1.0, 0.5, 3.0, 1.0, -2.0]}
    assert Simulator().orbit(broken) is None
    unknown = document() | {"system": {"kind": "custom"}}
    assert Simulator().orbit(unknown) is None
    dense = load_orbit(SHIPPED / "triple-1" / "orbit.json")
    motion = Simulator().orbit(unknown, (dense.times, dense.samples))
    assert motion.drawn == "plane" and motion.names[0] == "q1"


def test_an_orbit_that_cannot_be_drawn_still_has_a_page(tmp_path):
    (tmp_path / "orbit.json").write_text(json.dumps(document() | {"system": {"kind": "custom"}}))
    made, _ = build_site(gather([tmp_path]))
    text = made.files["orbits/triple-1.html"].decode()
    assert "cannot be drawn" in text and "no problem file describes it" in text and "1.655338988314641 s" in text


def test_a_proof_is_shown(tmp_path):
    """Where it is of this orbit: of another period it is none."""
    energy, stability = {"value": repr(document()["energy"])}, {"stability": "unstable", "period_distance": 1e-9}
    proof = {"proved": True, "theorem": "<1>", "energy": energy} | stability
    proof |= {"period": {"value": "1.6553389883", "radius": 2e-30}}
    (tmp_path / "orbit.json").write_text(json.dumps(document() | {"proof": proof}))
    text = build_site(gather([tmp_path]))[0].files["orbits/triple-1.html"].decode()
    assert ">proof recorded</span>" in text and "not replayed here" in text
    assert "theorem &lt;1&gt; of" in text and "1.6553389883 s within 2e" in text
    for wrong in ({"proved": False}, {"period": {"value": "1.6553", "radius": 2e-30}}):
        (tmp_path / "orbit.json").write_text(json.dumps(document() | {"proof": proof | wrong}))
        assert "proof recorded" not in build_site(gather([tmp_path]))[0].files["orbits/triple-1.html"].decode()


FORGED = {"proof": {"proved": True, "theorem": "1"}}


def forged() -> dict:
    """A file that says of a false orbit that it is certified and proved."""
    right = document()
    return right | {"state": [x + 0.3 for x in right["state"]], "period": 1.1 * right["period"]} | FORGED


def test_the_page_of_a_false_orbit_says_what_verify_says(tmp_path):
    """Neither the recorded checks nor the recorded proof are repeated; the failing checks are named."""
    (tmp_path / "orbit.json").write_text(json.dumps(forged()))
    made, _ = build_site(gather([tmp_path]))
    page, index = (made.files[name].decode() for name in ("orbits/triple-1.html", "index.html"))
    told = json.loads(CliRunner().invoke(cli, ["verify", str(tmp_path / "orbit.json"), "--json"]).stdout)
    failing = [one["name"].replace("_", " ") for one in told["results"][0]["checks"] if not one["passed"]]
    assert len(failing) >= 8 and f"Not an orbit, by these checks: {', '.join(failing)}." in page
    assert page.count(">FAILED<") == len(failing) and ">rejected</span>" in page
    assert ">certified<" not in page and "proof" not in page.lower().replace("orbitfinder verify --proof", "")
    assert "1 rejected" in index and "certified" not in index and ">rejected</span>" in index


def test_a_true_orbit_is_certified_by_what_the_page_recomputed(tmp_path):
    """A file that says nothing, or says failed, of a true orbit changes nothing."""
    for name, extra in (("a", {"certificate": None}), ("b", {"certificate": {"passed": False, "checks": []}})):
        (tmp_path / f"{name}.json").write_text(json.dumps(document() | extra | {"name": name}))
    made, _ = build_site(gather([tmp_path]))
    assert "2 certified when this page was made" in made.files["index.html"].decode()
    assert "Recomputed from the numbers of the file" in made.files["orbits/a.html"].decode()


@pytest.mark.parametrize("why", ["not asked", "foreign"])
def test_what_was_not_recomputed_is_the_files_word(tmp_path, why):
    """`--no-verify`, or a system that only a program makes, which a page never runs."""
    system = {"kind": "python", "module": "mine", "function": "make", "arguments": {}}
    given = forged() | ({"system": system} if why == "foreign" else {})
    (tmp_path / "orbit.json").write_text(json.dumps(given))
    made, _ = build_site(gather([tmp_path]), SiteSettings(verify=why == "foreign"))
    page, index = (made.files[name].decode() for name in ("orbits/triple-1.html", "index.html"))
    assert "As the file has it; not checked here: " in page and ">not checked here</span>" in page
    assert ">certified<" not in page and "1 not checked here" in index and "certified" not in index
    assert 'badge good">passed' not in page


def test_a_state_of_another_system_is_rejected(tmp_path):
    """Numbers that do not belong together are no orbit, and no traceback."""
    (tmp_path / "orbit.json").write_text(json.dumps(document() | {"state": [0.1, 0.2]}))
    page = build_site(gather([tmp_path]))[0].files["orbits/triple-1.html"].decode()
    assert ">rejected</span>" in page and "does not belong to the system" in page


@pytest.mark.parametrize("file", PROBLEMS, ids=lambda path: path.stem)
def test_problem_text_loads_as_the_same_problem(file, tmp_path):
    """The problem file on an orbit page is one that `run` takes, of the same system, at the same state."""
    problem = load_problem(file)
    about = {
        "name": problem.name,
        "title": problem.title,
        "source": problem.source,
        "tolerance": problem.tolerance,
        "system": dict(problem.model.system),
        "state": problem.guess.state.tolist(),
        "period": problem.guess.period,
        "energy": 1.0,
        "winding": list(problem.turns),
        "shift": dict.fromkeys(problem.relative, 0.0),
        "provenance": {"pin": {one.name: one.value for one in problem.pin}},
    }
    (tmp_path / "again.toml").write_text(orbit_text(about), encoding="utf-8")
    again = load_problem(tmp_path / "again.toml")
    assert dict(again.model.system) == dict(problem.model.system)
    assert np.array_equal(again.guess.state, problem.guess.state) and again.guess.period == problem.guess.period
    assert again.pin == problem.pin and again.title == problem.title and tuple(again.turns) == tuple(problem.turns)
    assert again.relative == problem.relative


def test_problem_text_finds_the_orbit_again(tmp_path):
    """The command on the page, with the file on the page, ends at the orbit on the page."""
    (tmp_path / "triple-1.toml").write_text(orbit_text(document()))
    runner = CliRunner()
    result = runner.invoke(cli, ["run", str(tmp_path / "triple-1.toml"), "--out", str(tmp_path), "--no-figures"])
    assert result.exit_code == 0, result.output
    assert load_orbit(tmp_path / "triple-1" / "orbit.json").period == pytest.approx(document()["period"], abs=1e-12)


def test_downloaded_orbit_is_the_file(site):
    _, payload = embedded(site / "data" / "orbits" / "triple-1.js")
    assert json.loads(payload["json"]) == document()


def test_pins_of_a_orbit_text():
    bare = {key: value for key, value in document().items() if key != "provenance"}
    assert tomllib.loads(orbit_text(bare))["find"]["pin"] == {"energy": bare["energy"]}
    isolated = bare | {"provenance": {"invariants": []}}
    assert "pin" not in tomllib.loads(orbit_text(isolated))["find"]
    assert orbit_text(bare | {"system": {"kind": "custom"}}) is None
    assert orbit_text(bare | {"system": {"kind": "chain", "length": [None]}}) is None
    nasty = tomllib.loads(orbit_text(bare | {"name": NASTY, "title": NASTY}))
    assert nasty["title"] == NASTY.replace("\u2028", " ")


def test_toml_values():
    made = {"a": True, "b": [1, 2.5], "c": {"x y": 'q"\\\x7f'}, "d": {}}
    assert tomllib.loads(f"v = {toml(made)}")["v"] == made
    assert orbit_name({"name": "../..//a b"}) == "a-b" and orbit_name({"name": "%%%"}) == "orbit"


def test_words_and_numbers():
    assert mechanism({"kind": "chain", "links": 3}) == "triple pendulum"
    assert mechanism({"kind": "chain", "links": 100}) == "100-link pendulum"
    assert mechanism({"kind": "linkage", "length": [1, 1, 1]}) == "four-bar linkage"
    assert mechanism({"kind": "python", "function": "rotating_hoop"}) == "rotating hoop"
    assert mechanism({"kind": "custom"}) == "custom"
    assert mechanism({"kind": "python", "module": "my_leg", "function": "problem"}) == "my leg"
    assert [plural(1, "orbit"), plural(2, "family"), plural(2, "atlas")] == ["1 orbit", "2 families", "2 atlases"]
    assert [coordinate("theta3"), coordinate("y1"), coordinate("<x>")] == [
        "θ<sub>3</sub>",
        "y<sub>1</sub>",
        "&lt;x&gt;",
    ]
    assert number(-0.5) == "\N{MINUS SIGN}0.5" and number(None) == number(float("inf")) == "not computed"
    assert [size(1), size(54_321), size(1_234_567)] == ["1 kB", "54 kB", "1.23 MB"]
    make = slug_maker()
    assert [make("A b/c"), make("a-b-c"), make("../.."), make("é")] == ["a-b-c", "a-b-c-2", "unnamed", "unnamed-2"]
    assert evenly(5, 3) == [0, 2, 4] and evenly(2, 9) == [0, 1] and evenly(0, 3) == []


def test_atlas_database_and_export_agree(material, tmp_path):
    with Atlas(material / "triples.sqlite") as atlas:
        (tmp_path / "triples.json").write_text(json.dumps(list(atlas.documents())))
    base, export = (gather([path]).atlases[0] for path in (material / "triples.sqlite", tmp_path / "triples.json"))
    assert base.total == export.total == 2
    assert [one.document for _, one in base.orbits] == [one.document for _, one in export.orbits]
    assert [k for k, _ in base.orbits] == [1, 2] and [k for k, _ in export.orbits] == [0, 1]  # as FILE#K has them
    assert (base.file, export.file) == ("triples.sqlite", "triples.json")


def test_few_atlas_orbits_get_pages(tmp_path):
    orbit = orbit_to_document(load_orbit(SHIPPED / "triple-1" / "orbit.json"))
    many = [orbit | {"energy": orbit["energy"] + k} for k in range(12)]
    (tmp_path / "big.json").write_text(json.dumps(many))
    made, summary = build_site(gather([tmp_path / "big.json"]), SiteSettings(atlas_pages=4))
    assert summary.orbits == 4 and sum(path.startswith("orbits/") for path in made.files) == 4
    text = made.files["data/atlases/big.js"].decode()
    assert text.count('"page":"../orbits/') == 4 and text.count('"energy":-') == 12
    assert "orbitfinder verify big.json#11" in text and "big, orbit 11" in made.files["index.html"].decode()


def test_an_atlas_at_one_energy_is_in_order_of_period(tmp_path):
    """Round-off in the energies of a search at one energy must not decide the order, nor show as a range."""
    orbit = document()
    many = [orbit | {"energy": -30.0 + 1e-14 * (k % 3), "period": 5.0 - k} for k in range(4)]
    (tmp_path / "one.json").write_text(json.dumps(many))
    periods = [one.document["period"] for _, one in gather([tmp_path / "one.json"]).atlases[0].orbits]
    assert periods == [2.0, 3.0, 4.0, 5.0]
    assert span([-30.0, -30.0 + 1e-13]) == number(-30.0) and span([1.0, 2.5]) == "1 to 2.5"


def test_points_are_picked_evenly_along_the_curve():
    """Where the steps of a family are small, fewer of its points are picked."""
    energies = np.concatenate([np.linspace(0, 1, 11), 1 + np.linspace(0, 1e-3, 200)[1:]])
    points = [SimpleNamespace(energy=e, period=1 / (2 - e), arclength=e) for e in energies]
    picked = spread(points, 20)
    assert picked[0] == 0 and picked[-1] == 209
    assert set(range(10)) <= set(picked) and len(picked) <= 14
    assert spread(points[:5], 20) == [0, 1, 2, 3, 4]


def test_resampling_follows_the_rates():
    times = np.linspace(0, 2 * np.pi, 9)
    states = np.column_stack([np.sin(times), np.cos(times)])
    moments = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    seen = course(chain(1), times, states).states(moments)
    assert np.abs(seen[:, 0] - np.sin(moments)).max() < 2e-3


def test_vendored_library_carries_its_licence():
    assets = ROOT / "orbitfinder" / "site" / "assets"
    assert "MIT" in (assets / "plotly-LICENSE.txt").read_text()
    assert (
        (assets / "plotly-basic.min.js").read_text(encoding="utf-8").startswith("/**\n* plotly.js (basic - minified)")
    )
    assert "@font-face" not in (assets / "page.css").read_text()


@pytest.mark.parametrize(
    ("name", "rods", "still"), [("four-bar-rotating", 2, 4), ("fermi-pasta-ulam", 0, 14), ("rotating-hoop", 1, 2)]
)
def test_what_is_rigid_is_packed_as_angles(name, rods, still):
    """Of a closed linkage all but the last link, which the page does not stretch by more than its interpolation."""
    motion = Simulator().orbit(json.loads((ROOT / "results" / "gallery" / name / "orbit.json").read_text()))
    made = packed(motion)
    assert len(made.get("rods", [])) == rods and len(made["still"]) == still
    lengths = np.linalg.norm(np.diff(decoded(made), axis=2), axis=1)
    changes = np.ptp(lengths, axis=0) / max(made["spans"])
    if name != "fermi-pasta-ulam":  # springs there
        assert changes.max() < 2e-3 and np.sort(changes)[:rods].max() < 1e-8


def test_a_turning_angle_goes_on_over_the_end_of_the_period():
    """The crank turns once: its channel grows by a whole turn, and half way between last and first it is in between."""
    times = np.linspace(0, 2 * np.pi, 48, endpoint=False)
    points = np.zeros((48, 2, 2))
    points[:, 0, 1], points[:, 1, 1] = 2 * np.cos(times), 2 * np.sin(times)
    bones = skeleton(points, ())
    values, turns = bones.channels(points)
    assert bones.rods == ((1, 0, 2.0),) and turns[5] == pytest.approx(2 * np.pi)
    assert np.abs(bones.places(values) - points).max() < 1e-12
    assert not skeleton(points * (1 + 0.01 * np.cos(times))[:, None, None], ()).rods  # one that breathes
    assert not skeleton(points, (("spring", (0, 1)),)).rods


def shipped(name):
    return Simulator().orbit(json.loads((ROOT / "results" / "gallery" / name / "orbit.json").read_text()))


def test_a_motion_that_drifts_is_seen_from_beside_it():
    found = shipped("pendulum-on-moving-cart")
    made, cart = packed(found), positions(found.model, found.states)[:, 1, 0]
    assert "jumps" not in made and made["drift"] == pytest.approx([0.0, np.ptp(cart[[0, -1]])], abs=1e-8)
    assert made["count"] < 200 and np.ptp(found.points[:, 1, 0]) < 0.7 * made["drift"][1]


@pytest.mark.parametrize(
    ("name", "coordinate", "rounds"),
    [("spherical-pendulum", 1, 20), ("figure-eight-turning", 1, 17), ("free-double-pendulum", 0, 23)],
)
def test_a_motion_that_comes_back_turned_goes_on_turning(name, coordinate, rounds):
    """Until so many turns are nearly whole: nothing jumps, and every period is the first one turned."""
    found = shipped(name)
    turn = float(np.ptp(found.states[[0, -1], coordinate])) * rounds / (2 * np.pi)
    assert found.rounds == packed(found)["rounds"] == rounds and abs(turn - round(turn)) < 0.02
    one = found.points.reshape(rounds, -1, *found.points.shape[1:])
    sizes = np.linalg.norm(one - one[..., :1], axis=2)  # distances between points stay
    assert np.abs(sizes - sizes[0]).max() < 1e-6
    steps = np.linalg.norm(np.diff(found.points, axis=0, append=found.points[:1]), axis=1)
    assert steps[-1].max() < 2 * steps[:-1].max() and "jumps" not in packed(found)


def test_what_moves_in_space_is_drawn_there():
    """The bob keeps its distance in all three dimensions; the halo has its bodies about it, z upwards."""
    bob = shipped("conical-pendulum").points
    assert bob.shape[1:] == (3, 2) and np.abs(np.linalg.norm(bob[:, :, 1], axis=1) - 1.0).max() < 1e-12
    halo = shipped("three-body-halo")
    about, states = packed(halo)["around"], halo.at(len(halo.points))
    assert np.abs(halo.points[:, :, 0] - states[:, [2, 0, 1]] * [-1, 1, -1]).max() < 1e-12
    assert about["axes"] == [["x", [0.0, 1.0, 0.0]], ["y", [0.0, 0.0, -1.0]], ["z", [-1.0, 0.0, 0.0]]]
    assert [name for name, _, _ in about["marks"]][:3] == ["primary", "secondary", "L1"]
    assert halo.partners[:3] == [3, 4, 5] and portraits(halo) == [0, 1, 2]
    moon = {name: place for name, place, _ in packed(shipped("three-body-lyapunov"))["around"]["marks"]}
    assert set(moon) >= {"Earth", "Moon", "L1"} and moon["Moon"] == pytest.approx([0.0, 0.98784941, 0.0], abs=1e-6)


def test_a_rod_that_is_held_at_one_end_is_drawn_to_the_other():
    """As far as a uniform rod of its mass and moment of inertia goes; a point mass is its end."""
    model = load_problem(ROOT / "problems" / "mechanisms" / "furuta.toml").model
    ends = positions(model, np.zeros((1, 4)), "space")[0].T
    assert np.abs(ends - [0.129, 0.085, 0.0]).max(axis=1).min() < 1e-4  # hangs from the arm's end, 129 mm long


def test_a_disc_in_space_turns_about_its_axle():
    top = load_problem(ROOT / "problems" / "mechanisms" / "gyroscope.toml").model
    states = np.array([[0.3, 1.9, spin, 0.0, 0.0, 0.0] for spin in np.linspace(0, 6, 7)])
    _, (centre, *rim) = next(stroke for stroke in top.strokes if stroke[0] == "disc")
    seen = positions(top, states, "space")
    spokes = seen[:, :, rim] - seen[:, :, [centre]]
    axle = seen[:, :, centre] / np.linalg.norm(seen[:, :, centre], axis=1, keepdims=True)
    assert np.abs(np.einsum("kdm,kd->km", spokes, axle)).max() < 1e-12 and np.ptp(axle, axis=0).max() < 1e-12
    assert np.linalg.norm(spokes, axis=1) == pytest.approx(0.06) and np.ptp(spokes[:, :, 0], axis=0).max() > 0.05


def test_a_motion_at_constant_rates_is_drawn():
    about = json.loads((ROOT / "results/gallery/conical-pendulum/orbit.json").read_text())
    assert Simulator().orbit(about) is not None


def test_mixed_angles_and_lengths_have_histories():
    about = json.loads((ROOT / "results/gallery/pendulum-on-cart/orbit.json").read_text())
    assert histories(Simulator().orbit(about))["count"] > 200


@pytest.mark.parametrize(("name", "grows"), [("triple-1", 1.2415), ("quadruple-1", 1.0)])
def test_the_neighbour_leaves_an_unstable_orbit_as_its_multiplier_says(name, grows):
    simulator, about = Simulator(), document(name)
    motion = simulator.orbit(about)
    near = simulator.neighbour(about, motion)
    assert near.period == pytest.approx(3 * motion.period) and not near.loops
    extent = np.ptp(motion.states, axis=0)
    away = [np.abs((near.at(4, endpoint=True)[k] - motion.states[0]) / extent).max() for k in range(4)]
    assert away[0] == pytest.approx(0.03, rel=1e-6)
    if grows > 1.1:
        assert away[3] > 1.5 * away[0]
    else:
        assert max(away) < 0.4


def test_energies_sum_to_the_recorded_one():
    simulator, about = Simulator(), document()
    split = simulator.orbit(about).energies
    assert split.shape == (2, 121) and np.abs(split.sum(axis=0) - about["energy"]).max() < 1e-3
    forced = json.loads((ROOT / "results/gallery/forced-duffing-upper/orbit.json").read_text())
    assert simulator.orbit(forced).energies is None and not simulator.conserves(forced["system"])


def test_energies_are_called_kept_only_where_they_are(tmp_path):
    """Neither a forced oscillator's energy nor the reciprocal pairs that it has not are given as facts."""
    for name in ("forced-duffing-upper", "henon-heiles-loop"):
        shutil.copytree(ROOT / "results" / "gallery" / name, tmp_path / name)
    made, _ = build_site(gather([tmp_path]), SiteSettings(verify=False))
    forced, free = (
        made.files[f"orbits/{name}.html"].decode() for name in ("forced-duffing-upper", "henon-heiles-loop")
    )
    assert "<dt>Energy, not conserved</dt>" in forced and "reciprocal pairs" not in forced and "at t = 0" in forced
    assert "<dt>Energy</dt><dd>0.125</dd>" in free and " J</dd>" not in free and "reciprocal pairs" in free
    assert made.files["index.html"].decode().count("<dt>Energy</dt>") == 1


def test_a_certificate_says_which_way_its_numbers_must_be():
    """At most or at least, held against how the checks were judged; yes and no where only that was asked."""
    for path in [*SHIPPED.glob("*/orbit.json"), ROOT / "results/gallery/four-bar-rocking/orbit.json"]:
        for check in load_orbit(path).certificate.checks:
            sense = check.sense
            holds = {"\u2265": check.value >= check.tolerance, "\u2264": check.value <= check.tolerance, "": True}
            assert holds[sense] and (sense or check.tolerance == 0.0)
            assert (sense == "\u2265") == (check.name in ("not_equilibrium", "minimal_period"))
    for value in (1e-7, 1e-5):  # whether it passes or not
        assert at_least("minimal_period", value, 1e-6).sense == "\u2265"
        assert at_most("closure", value, 1e-6).sense == "\u2264"
    assert at_least("holds: above", 0.0, -1e-9).sense == "\u2265" and at_most("record", 1.0, 0.0).sense == ""
    for value in (float("nan"), float("-inf")):  # a file says null for both, and says beside it what was asked
        apart = Certificate((at_least("apart", value, 1e-6), at_most("closure", value, 1e-6)))
        again = certificate_of(json.loads(json.dumps(certificate_to_document(apart))), "")
        for made in (apart, again):
            assert [check.sense for check in made.checks] == ["\u2265", "\u2264"]


def test_the_page_says_at_least_and_at_most(site):
    text = (site / "orbits" / "triple-1.html").read_text(encoding="utf-8")
    rows = dict(
        re.findall(r'<th scope="row">([^<]+)</th><td><span[^>]*>passed</span></td><td>[^<]*</td><td>([^<]*)<', text)
    )
    assert rows["minimal period"].startswith("\u2265 ") and rows["closure"].startswith("\u2264 ")
    assert rows["stability"] == "yes"


def test_families_and_orbits_are_joined(tmp_path):
    """A branch, the family that it left, and the orbit that lies on both have links to each other."""
    for name in ("triple-1", "triple-mode-2"):
        shutil.copytree(ROOT / "results" / "families" / name, tmp_path / "families" / name)
    shutil.copytree(SHIPPED / "triple-1", tmp_path / "orbits" / "triple-1")
    made, _ = build_site(gather([tmp_path]), SiteSettings(verify=False))
    branch, parent, orbit = (
        made.files[f"{place}.html"].decode()
        for place in ("families/triple-1", "families/triple-mode-2", "orbits/triple-1")
    )
    assert 'href="triple-mode-2.html#event=2">triple-mode-2, branch point 2</a>' in branch
    assert 'href="triple-1.html">triple-1, from branch point 2</a>' in parent
    assert re.search(r'href="../families/triple-1.html#point=\d+">Family triple-1 \(the curve comes within', orbit)
    title = re.search("<h1>(.*?)</h1>", orbit)[1]
    assert f'<a href="../orbits/triple-1.html">{title}</a>' in branch
    text = made.files["data/families/triple-mode-2.js"].decode()
    assert kind_of("branch_point").words in text
    assert "orbitfinder continue families/triple-mode-2/family.json --switch 2" in text


def test_a_family_at_one_energy_opens_on_its_parameter(tmp_path):
    shutil.copytree(ROOT / "results" / "families" / "five-bar-length", tmp_path / "five-bar-length")
    made, _ = build_site(gather([tmp_path]))
    page = made.files["families/five-bar-length.html"].decode()
    assert page.index('value="value">length3') < page.index('value="energy">energy')
    assert "length3 0.8 to 2.2" in made.files["index.html"].decode()


def test_landscapes_are_the_potential_where_it_is_drawn():
    """Values on the grid are those of the formula at the places drawn; what is no point in a potential has none."""
    frame = {"centre": [0.1, -0.2], "spans": [0.6, 0.4]}
    made = landscape(systems.henon_heiles(), frame)
    assert made is not None
    values, down, right = (
        np.frombuffer(base64.b64decode(made["data"]), "<f4"),
        *map(np.array, (made["down"], made["right"])),
    )
    assert down[0] == pytest.approx(0.1 - 0.9) and right[-1] == pytest.approx(-0.2 + 0.9)
    x, y = right[None, :], -down[:, None]
    wanted = (x**2 + y**2) / 2 + x**2 * y - y**3 / 3
    np.testing.assert_allclose(values.reshape(len(down), len(right)), wanted, rtol=1e-5, atol=1e-6)
    assert made["levels"] == sorted(made["levels"])
    fine = np.diff(landscape(systems.henon_heiles(), frame, many=True)["down"])
    assert fine.min() < 0.4 * np.diff(down).min() and fine.argmin() in (len(fine) // 2 - 1, len(fine) // 2)
    assert landscape(chain(2), frame) is None and landscape(None, frame) is None
