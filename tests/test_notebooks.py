"""What notebooks show, and that the worked notebooks run."""

import importlib.util
import re
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import orbitfinder as of
from orbitfinder._runtime import notebook as display
from orbitfinder.atlas.store import Atlas
from orbitfinder.families.entries import KINDS, LOOKS
from orbitfinder.families.folder import follow_family
from orbitfinder.families.point import FamilySettings
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.show import svg
from orbitfinder.show.html import html, motions
from orbitfinder.show.scene import Scene

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
VOID = {"br"}


class Tags(HTMLParser):
    """Every element with its attributes and, in `text`, what a reader sees; unbalanced tags fail."""

    def __init__(self, text):
        super().__init__()
        self.open, self.found, self.text, self.source = [], [], "", text
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.found.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def triple():
    return of.load_orbit(ROOT / "results" / "orbits" / "triple-1" / "orbit.json")


@pytest.fixture(scope="module")
def family(tmp_path_factory):
    settings = FamilySettings(directions="forward", events=False)
    problem = mode_problem(of.chain(2), 1, 0.2)
    return follow_family(problem, points=4, out=tmp_path_factory.mktemp("family"), settings=settings)


def test_an_orbit_moves_and_says_its_numbers(triple):
    """Two pictures move in real time; period, stability and certificate are there; small and self-contained."""
    shown = triple._repr_html_()
    tags = Tags(shown)
    moving = [attributes for tag, attributes in tags.found if tag == "animate"]
    assert len(moving) == 5 and {one["dur"] for one in moving} == {f"{triple.period:.6g}s"}
    for words in ("Triple pendulum, periodic solution", "1.65533898831 s", "unstable", "passed, 16 checks"):
        assert words in tags.text
    assert len(shown) < 300_000
    assert not re.search(r"https?:|<script|<link|<img|url\(", shown)
    assert all(attributes.get("aria-label") for tag, attributes in tags.found if tag == "svg")


def test_the_motion_is_the_orbit(triple):
    """The animated polyline starts and ends at the drawn joints, to a tenth of a pixel, and scales are equal."""
    places = of.positions(of.chain(3), triple.samples)
    picture = svg.moving_mechanism(Scene(places, period=triple.period), "label")
    values = re.search(r'attributeName="points"[^>]*values="([^"]*)"', picture).group(1).split(";")
    frames = np.array([[pair.split(",") for pair in one.split()] for one in values], float)
    assert np.abs(frames[0] - frames[-1]).max() < 0.15
    lengths = np.linalg.norm(np.diff(frames, axis=1), axis=2)
    assert np.ptp(lengths) < 0.3 and lengths.min() > 20  # three links of one length, whatever their angle


def test_titles_are_escaped(triple):
    """A script tag in a title is text; so are check notes and names."""
    hostile = replace(triple, title="<script>alert(1)</script>", source='"><img src=x>')
    shown = hostile._repr_html_()
    assert "<script" not in shown and "<img" not in shown
    assert "<script>alert(1)</script>" in Tags(shown).text


def test_an_orbit_without_samples_is_sampled(triple):
    bare = replace(triple, times=np.zeros(0), samples=np.zeros((0, 6)), certificate=None)
    assert bare._repr_html_().count("<animate ") == 5 and "no certificate" in bare._repr_html_()


def test_an_orbit_of_a_system_that_no_file_describes_shows_its_numbers(triple):
    unknown = replace(triple, system={"kind": "custom"})
    assert "<animate " not in unknown._repr_html_() and "1.65533898831 s" in unknown._repr_html_()


def test_a_certificate_is_a_table(triple):
    """Every check with its number and verdict, failed ones in capitals."""
    certificate = triple.certificate
    tags = Tags(certificate._repr_html_())
    assert all(check.name in tags.text for check in certificate.checks) and "FAILED" not in tags.text
    first = replace(certificate.checks[0], passed=False)
    failing = replace(certificate, checks=(first, *certificate.checks[1:]))
    assert "Certificate: FAILED: closure" in Tags(failing._repr_html_()).text


def test_a_family_is_a_diagram_with_three_of_its_orbits(family, five_bar):
    """An event is a mark in the diagram, and its kind once more in the key below it."""
    shown = replace(family, events=five_bar.events)._repr_html_()
    tags = Tags(shown)
    assert sum(tag == "svg" for tag, _ in tags.found) == 5 and shown.count("E = ") == 3
    assert shown.count("<title>") == 2
    assert "frequency (1/s)" in tags.text and len(shown) < 300_000


def test_what_moves_in_space_is_seen_from_above_and_from_the_side():
    """In equal scales, with what is marked near it; in a plane its path is beside its phase portrait."""
    seen = [
        motions(of.load_orbit(ROOT / f"results/gallery/three-body-{name}/orbit.json")) for name in ("halo", "lyapunov")
    ]
    labels = [[Tags(picture).found[0][1]["aria-label"] for picture in pictures] for pictures in seen]
    assert labels == [["y against x", "z against x"], ["y against x", "py against y"]]
    assert all(">L1<" in picture for picture in seen[0]) and ">L1<" not in seen[1][1]


def test_kinds_of_events_have_shapes_of_their_own():
    """Every disc is of a kind that figures draw as a disc too."""
    shapes = [svg.glyph(LOOKS[kind], np.zeros(2), kind).split('"')[1] for kind in KINDS]
    discs = [kind for kind, shape in zip(KINDS, shapes, strict=True) if shape.startswith("M-4 0a4")]
    assert {"fold", "period_doubling", "stability_change"}.isdisjoint(discs) and "branch_point" in discs


def test_orbits_too_unstable_to_be_integrated_are_not_drawn(triple, family):
    """A picture that leaves its own loop would be a lie: only samples, or a multiplier below 1e6, are drawn."""
    wild = replace(triple, floquet_multipliers=np.array([1e9, 1e-9]))
    assert wild._repr_html_().count("<animate ") == 5  # it has samples
    bare = replace(wild, times=np.zeros(0), samples=np.zeros((0, 6)))
    assert "<animate " not in bare._repr_html_()
    points = (*family.points[:-1], replace(family.points[-1], scale=1e9))
    last = f"E = {family.points[-1].energy:.6g} J"
    assert last in family._repr_html_() and last not in replace(family, points=points)._repr_html_()


def test_an_atlas_is_a_table_with_moving_orbits(triple, pendulum_orbit, tmp_path):
    with Atlas(tmp_path / "one.sqlite", triple.system, write=True) as atlas:
        atlas.add(triple)
        tags = Tags(atlas._repr_html_())
    assert "Atlas one.sqlite: 1 orbit" in tags.text and "1.655338988" in tags.text
    assert sum(tag == "animate" for tag, _ in tags.found) == 5


def test_pictures_are_well_formed_xml(triple):
    circle = svg.unit_circle(np.array([0.5 + 0.5j, 100.0, -0.01]), "a & b")
    root = ElementTree.fromstring(circle)
    assert root.get("aria-label") == "a & b"
    assert [dot.get("fill") for dot in root.iter("circle")][1:] == ["#D55E00", "none", "#D55E00"]


def test_what_else_users_hold_says_what_it_is():
    """A table, and pictures of a guess and a run: of what one line names, balanced and escaped, without empty rows."""
    model = of.chain(2)
    problem = of.Problem(model, of.Guess([0.3, -0.2, 0, 0], 1.5), of.pin(energy=-15.0), name="<b>")
    run = of.simulate(model, [0.3, -0.2, 0, 0], 3.0)
    (close,) = of.guesses.close_returns(run.times, run.states, model.angles, 1)
    swept = of.sweep(of.Problem(of.chain(1), of.Guess([0.5, 0], 2.0), of.pin(theta1=0.5)), {"theta1": [0.5]})
    shown = [
        (model, "θ₁ (rad), θ₂ (rad)"), (problem, "<b>"), (problem.guess, "1.5"), (problem.count(), "node states"),
        (run, "time (s)"), (close, f"{close.distance:.9g}"), (of.Refiner(problem), "segments"), (swept, "elliptic"),
        (of.systems.simplest_walker(0.009), "strike"),
    ]  # fmt: skip
    for value, text in shown:
        tags = Tags(value._repr_html_())
        assert text in tags.text and len(repr(value)) < 600 and "\n" not in repr(value)
        assert not any(tag in ("script", "b>") for tag, _ in tags.found)
    assert problem._repr_html_().count("<svg") == 1 and run._repr_html_().count("<polyline") == 2


def test_other_things_and_failures_are_left_to_plain_text(triple, monkeypatch):
    """None tells a notebook to show the repr."""
    assert html(3) is None
    monkeypatch.setattr(display, "_drawing", [])
    assert triple._repr_html_() is None


def test_long_mechanisms_stay_small():
    """A hundred joints get fewer frames."""
    places = np.random.default_rng(0).normal(size=(401, 2, 101))
    assert len(svg.moving_mechanism(Scene(places), "many")) < 300_000


@pytest.fixture(scope="module")
def five_bar():
    """A linkage along the length of a link: five points and an event, in `results/families`."""
    whole = of.load_family(ROOT / "results" / "families" / "five-bar-length" / "family.json")
    return replace(whole, points=whole.points[:: -(-len(whole.points) // 5)], events=whole.events[3:4])


@pytest.mark.needs("notebook")
def test_a_family_on_a_stage(five_bar):
    """Every point and event with its motion at its own length, its numbers and its place on the curve; one scale."""
    stage = five_bar.widget()
    items = stage.shown["items"]
    assert len(items) == len(stage.members) == 6 and stage.picked is five_bar.points[0]
    for one, item in zip(stage.members, items, strict=True):
        rows = dict(item["rows"])
        length = one.value if one in five_bar.points else one.parameter
        assert item["period"] == one.period and float(rows["length3"]) == pytest.approx(length, rel=1e-11)
        assert min(abs(rod[2] - length) for rod in item["motion"]["rods"]) < 1e-7
        assert 0 <= item["place"][0] <= svg.WIDTH and 0 <= item["place"][1] <= svg.HEIGHT
        assert item["portrait"].count("<animate ") == 2 and "<svg" in item["circle"]
    assert {name for name in stage.keys if not name.startswith("_")} >= {"shown", "index", "playing", "speed"}
    spans = np.array(stage.shown["frame"]["spans"])
    assert all(np.all(spans >= 0.999 * np.array(item["motion"]["spans"])) for item in items)
    stage.index = 5
    assert stage.picked is five_bar.points[-1]
    for wrong in ({"index": 6}, {"index": -1}, {"speed": 0.0}, {"speed": float("nan")}):
        with pytest.raises(of.errors.InputError, match=next(iter(wrong))):
            stage.set_trait(*next(iter(wrong.items())))
    with pytest.raises(of.errors.InputError, match="no orbits"):
        replace(five_bar, points=()).widget()


@pytest.mark.needs("notebook")
def test_a_stage_shows_the_static_picture_where_no_widget_runs(triple):
    """GitHub reads text/html; a notebook that runs prefers the view. Nothing of either comes from a network."""
    stage = triple.widget()
    data, _ = stage._repr_mimebundle_()
    assert data["text/html"] == triple._repr_html_() and "application/vnd.jupyter.widget-view+json" in data
    assert (
        data["text/plain"].startswith("Stage(Orbit(")
        and dict(stage.shown["items"][0]["rows"])["stability"] == "unstable"
    )
    loaded = re.findall(r"https?:[^\"')]*|import[ (]|@import|url\(", stage._esm + stage._css)
    assert set(loaded) <= {"http://www.w3.org/2000/svg"}
    assert ":root" not in stage._css and "--link" in stage._css  # the host keeps its own


@pytest.mark.needs("notebook")
def test_an_orbit_that_no_file_describes_has_a_stage_with_its_numbers(triple):
    bare = replace(triple, system={"kind": "custom"}, times=np.zeros(0), samples=np.zeros((0, 6)))
    (item,) = bare.widget().shown["items"]
    assert item["motion"] is None and item["portrait"] == "" and item["period"] == triple.period


def test_without_anywidget_a_sentence_names_the_extra(triple, monkeypatch):
    monkeypatch.setitem(sys.modules, "anywidget", None)
    monkeypatch.delitem(sys.modules, "orbitfinder.studio.widget", raising=False)
    with pytest.raises(of.errors.InputError, match=r"pip install 'orbitfinder\[notebook\]'"):
        triple.widget()


def test_axes_have_round_numbers_inside_their_range():
    """At least two and at most so many, whatever the range; the portrait of a motion lies inside its axes."""
    for low, high in ((0.0, 1.0), (-44.1, 44.09), (0.863, 0.8630001), (-3e-7, 5e-7), (1e5, 3e7), (-8.3, 8.3)):
        found = svg.ticks(low, high, 5)
        assert 2 <= len(found) <= 5 and all(low - 1e-9 <= at <= high + 1e-9 for at, _ in found)
        assert np.ptp(np.diff([at for at, _ in found])) < 1e-6 * (high - low)
        assert len({text for _, text in found}) == len(found)
    places = np.column_stack([np.cos(np.arange(60) / 9.4), 5e3 * np.sin(np.arange(60) / 9.4)])
    tags = Tags(svg.moving_portrait(places, 2.0, ("x (m)", "rate of x (m/s)")))
    texts = [float(one) for one in re.findall(r">(-?[\d.]+)<", tags.source.replace("\N{MINUS SIGN}", "-"))]
    assert len(texts) >= 6 and max(texts) <= 5.5e3 and "rate of x (m/s)" in tags.text


@pytest.mark.needs("notebook")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_show_what_they_did_and_need_only_the_front_door(path):
    """Stored as `notebooks/run.py` leaves them: with displays, without widgets, paths and deep imports; below 1 MB."""
    import nbformat

    notebook = nbformat.read(path, 4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count == k + 1 for k, cell in enumerate(code))
    assert sum("<animate " in text for cell in code for text in _outputs(cell)) >= 2
    text = path.read_text(encoding="utf-8")
    assert len(text) < 1_000_000 and not re.search(r"widget-view|Traceback|/tmp|/home|/root|[A-Z]:\\\\", text)
    imports = re.findall(r"^(?:from|import) ([\w.]+)", "\n".join(cell.source for cell in code), re.M)
    assert "orbitfinder" in imports and not [name for name in imports if name.startswith("orbitfinder.")]


def _outputs(cell):
    """The texts of a cell's outputs."""
    return [one.get("text") or next(iter(one["data"].values())) for one in cell.outputs]


MEMBER = r"\w+ = [-\d.e]+(?: J)?, T = "
"""Before the numbers of an orbit in the display of a family. Which orbits these are is a matter of the steps
that a run took: notebooks print orbits at pinned values of the parameter instead"""


def _read(text):
    """What a reader reads of an output: the words, and the numbers above round-off."""
    seen = (Tags(text).text if text.lstrip().startswith("<") else text).replace("\N{MINUS SIGN}", "-")
    if (counted := re.sub(r"orbits\d+(?=parameter)", "orbits", seen)) != seen:  # a family, whatever its title
        seen = re.split(MEMBER, counted)[0]
    number = r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?"
    seen = re.sub(f"{number}(?= round-offs grown)", "some", seen)  # of a gap that is round-off, 0 to 30
    return re.sub(number, "#", seen), [float(one) for one in re.findall(number, seen) if abs(float(one)) > 1e-6]


def test_displays_of_families_are_compared_by_events_and_ends():
    """Not by the orbits that a run happened to take; of everything else every number counts."""
    rest = "<b>parameter</b>energyend 1target: energy = -36.0E = {} J, T = 1.8 sunstable</div>"
    shown = "<div>Family a{}<b>orbits</b>{}" + rest
    before = _read(shown.format("fold at -38.4897", 19, -38.3783))
    assert _read(shown.format("fold at -38.4897", 21, -38.3737)) == before and -38.4897 in before[1]
    assert _read(shown.format("fold at -38.4898", 19, -38.3783)) != before
    assert _read(shown.format("", 19, -38.3783))[0] != before[0]
    assert _read("E = -38.3783 J, T = 1.8 s") != _read("E = -38.3737 J, T = 1.8 s")
    gaps = [f"{gap} round-offs grown {grown} times" for gap, grown in ((0.56, 853), (0.74, 853), (0.56, 854))]
    assert _read(gaps[0]) == _read(gaps[1]) != _read(gaps[2])


@pytest.mark.slow
@pytest.mark.needs("notebook")
@pytest.mark.filterwarnings("ignore")  # of Jupyter's own
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run_and_show_what_they_hold(path):
    """Each cell runs and says what is stored: the same words, the same numbers."""
    spec = importlib.util.spec_from_file_location("run_notebooks", ROOT / "notebooks" / "run.py")
    run = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(run)
    stored, fresh = (
        [text for cell in one.cells if cell.cell_type == "code" for text in _outputs(cell)]
        for one in (run.nbformat.read(path, 4), run.executed(path))
    )
    assert len(stored) == len(fresh)
    for before, after in zip(map(_read, stored), map(_read, fresh), strict=True):
        assert before[0] == after[0] and after[1] == pytest.approx(before[1], rel=1e-6)
