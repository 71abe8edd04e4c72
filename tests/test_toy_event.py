"""A kind of event that is known in this file only, by one entry, goes through everything that knows events."""

import importlib.util
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.families.entries import KINDS
from orbitfinder.families.registry import EventKind, Followed, Look
from orbitfinder.families.registry import Test as Vanishing
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.records.family import load_family, save_family
from orbitfinder.show.plot import frequency_energy, two_parameters

ROOT = Path(__file__).parents[1]
PERIOD = 1.72
TOY = EventKind(
    check=lambda sides, event: sides.zero(lambda probe: probe.value("period") - PERIOD),
    words="the period is 1.72 s",
    look=Look("$T$", "star-square", "#00AA88", series=2, pixels=13),
    test=lambda interval: [Vanishing("on_time", "", lambda sample: sample.solution.place.period - PERIOD)],
    followed=Followed(lambda test, curve, orbits: np.array([orbit.place.period - PERIOD for orbit in orbits])),
)


@pytest.fixture
def known(monkeypatch):
    """The toy is known."""
    monkeypatch.setitem(KINDS, "on_time", TOY)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The swings of a pendulum, on which the toy happens once."""
    out = tmp_path_factory.mktemp("toy")
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(KINDS, "on_time", TOY)
        settings = of.FamilySettings(directions="forward", first_step=0.2)
        of.follow_family(mode_problem(chain(1), 1, 0.3), points=6, settings=settings, out=out, name="swings")
    return out / "swings"


def run(*arguments):
    done = CliRunner().invoke(cli, [*map(str, arguments)])
    return done.exit_code, done.output


def test_it_is_found_checked_and_certified(folder):
    (event,) = load_family(folder / "family.json").events
    assert event.kind == "on_time" and event.check.passed and event.certified
    assert event.period == pytest.approx(PERIOD, abs=1e-10)


def test_it_is_verified_from_the_file(folder, known, tmp_path):
    """And rejected where it is not."""
    assert run("verify", folder / "family.json")[0] == 0
    family = load_family(folder / "family.json")
    (event,) = family.events
    moved = replace(event, state=event.state * 1.0001)
    code, said = run("verify", save_family(replace(family, events=(moved,)), tmp_path))
    assert code == 1 and "on_time" in said


def test_without_its_entry_it_is_drawn_and_not_believed(folder, tmp_path):
    code, said = run("verify", folder / "family.json")
    assert code == 1 and "a on_time has no check" in said
    assert run("show", folder / "family.json")[0] == 0
    assert run("plot", folder / "family.json", "-o", tmp_path / "figures")[0] == 0
    assert run("page", folder / "family.json", "-o", tmp_path / "site", "--no-verify")[0] == 0


def test_it_is_shown_with_what_leads_on(folder, known):
    code, said = run("show", folder / "family.json", "--json")
    (event,) = json.loads(said)["results"][0]["events"]
    way = f"orbitfinder continue {folder / 'family.json'} --curve 0 --parameters energy,length1"
    assert (
        code == 0
        and event["kind"] == "on_time"
        and event["follow"] == [way]
        and event["what"] == "the period is 1.72 s"
    )


def test_no_branch_leaves_there(folder, known, tmp_path):
    code, said = run("continue", folder / "family.json", "--switch", 0, "--out", tmp_path)
    assert code != 0 and "no branch leaves at event 0; this family has none from which one does" in said
    with pytest.raises(InputError, match="no branch leaves at event 0"):
        of.switch_branch(folder / "family.json", 0)


def test_it_is_drawn(folder, known, tmp_path):
    """With its marker in its colour, and in the legend."""
    figure = frequency_energy([load_family(folder / "family.json")])
    (mark,) = (line for line in figure.axes[0].lines if line.get_marker() == "$T$")
    assert mark.get_color() == "#00AA88"
    assert "on time" in {text.get_text() for legend in figure.legends for text in legend.get_texts()}
    assert run("plot", folder / "family.json", "-o", tmp_path)[0] == 0 and list(tmp_path.rglob("*.png"))


def test_it_is_on_the_page(folder, known, tmp_path):
    """As data: its name, its look."""
    code, said = run("page", folder / "family.json", "-o", tmp_path, "--no-verify")
    assert code == 0, said
    page = "".join(file.read_text() for file in tmp_path.rglob("*swings*") if file.is_file())
    assert '"looks":{"on_time":["star-square",2,13,1.5]}' in page.replace(
        " ", ""
    ) and '"kind":"on_time"' in page.replace(" ", "")


def test_it_is_followed_in_two_parameters(folder, known):
    """Along the curve the period stays, and the figure has its name."""
    curve = of.follow_curve(folder / "family.json", 0, ("gravity", "energy"), points=2)
    assert len(curve.points) > 3 and np.ptp([point.free["gravity"] for point in curve.points]) > 0
    assert np.allclose(curve.values("period"), PERIOD, rtol=1e-10)
    (legend,) = two_parameters([curve]).legends
    assert {text.get_text() for text in legend.get_texts()} == {"on time"}


@pytest.mark.needs("docs")
def test_the_docs_tell_of_it(known):
    spec = importlib.util.spec_from_file_location("hooks", ROOT / "docs" / "hooks.py")
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    assert "| `on_time` | the period is 1.72 s | `--curve` |" in hooks.MAKERS["events"]("")
