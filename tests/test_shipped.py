"""The problem files that come with orbitfinder: listed, shown and copied from a wheel as from a clone."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.problemfile import shipped

ROOT = Path(__file__).parents[1]
PROBLEMS = ROOT / "problems"


def invoke(*words):
    return CliRunner().invoke(cli, ["problems", *map(str, words)])


def test_every_file_and_folder_is_there_with_its_title():
    """What is listed is what lies in problems/: a new folder wants a line in KINDS, a new file a title."""
    found = {Path(one.kind, one.path.name) for one in shipped.shipped()}
    assert found == {path.relative_to(PROBLEMS) for path in PROBLEMS.glob("*/*.*") if path.suffix in (".toml", ".py")}
    assert {path.name for path in PROBLEMS.iterdir() if path.is_dir()} == set(shipped.KINDS)
    assert all(len(one.title) >= 8 for one in shipped.shipped())


def test_a_list_has_a_line_for_each():
    document = json.loads(invoke("list", "--json").stdout)
    assert document["format"] == "orbitfinder/problems"
    (lorenz,) = (one for one in document["problems"] if (one["kind"], one["name"]) == ("search", "lorenz"))
    assert lorenz["title"] == "Lorenz attractor" and lorenz["command"] == "search"
    lines = invoke("list", "report").stdout.splitlines()
    assert [line.split()[0] for line in lines[1:5]] == ["quadruple-1", "quadruple-2", "triple-1", "triple-2"]
    assert lines[0].startswith("report: ") and lines[-1].startswith("4 problem files; ")


def test_a_file_is_shown_as_it_is():
    content = (PROBLEMS / "report" / "triple-1.toml").read_text()
    assert invoke("show", "triple-1").stdout == content
    assert json.loads(invoke("show", "report/triple-1", "--json").stdout)["text"] == content


def test_a_problem_file_in_python_is_listed_by_its_docstring():
    (one,) = shipped.chosen(["freire"])
    assert one.path.name == "freire.py" and one.title.startswith("An electronic oscillator")


def test_copies_are_equal_and_bring_what_they_name(tmp_path):
    """Where `problems/...` of the documentation is, with the description of a robot beside its file."""
    result = invoke("copy", "a1-leg", "report", "-o", tmp_path)
    found = {path.relative_to(tmp_path) for path in tmp_path.rglob("*.*")}
    assert found == {Path("robots/a1-leg.toml"), Path("robots/a1-leg.urdf")} | {
        path.relative_to(PROBLEMS) for path in (PROBLEMS / "report").iterdir()
    }
    assert all((tmp_path / one).read_bytes() == (PROBLEMS / one).read_bytes() for one in found)
    assert result.exit_code == 0 and f"{tmp_path / 'robots' / 'a1-leg.toml'}: written" in result.stdout


def test_all_are_copied(tmp_path):
    assert f"{len(shipped.shipped())} problem files written" in invoke("copy", "all", "-o", tmp_path).stdout
    copied = {path.relative_to(tmp_path) for path in tmp_path.rglob("*.*")}
    assert copied == {path.relative_to(PROBLEMS) for path in PROBLEMS.glob("*/*.*")}


def test_an_interrupted_copy_leaves_no_half_file(tmp_path, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("os.replace", stopped)
    with pytest.raises(KeyboardInterrupt):
        shipped.copy(shipped.chosen(["triple-1"]), tmp_path)
    assert [one for one in tmp_path.rglob("*") if one.is_file()] == []


def test_nothing_is_overwritten_unless_told(tmp_path):
    """A changed file stays, and nothing else is written with it; an equal one is no hindrance."""
    mine = tmp_path / "report" / "triple-1.toml"
    mine.parent.mkdir()
    mine.write_text("mine")
    refused = invoke("copy", "report", "-o", tmp_path)
    assert refused.exit_code == 2 and mine.read_text() == "mine" and len(list(tmp_path.rglob("*.toml"))) == 1
    assert "triple-1.toml exists already and differs; choose another folder, or --force" in refused.stderr
    assert invoke("copy", "report", "-o", tmp_path, "--force").exit_code == 0 and mine.read_text() != "mine"
    assert invoke("copy", "report", "-o", tmp_path).exit_code == 0


@pytest.mark.parametrize(("words", "said"), [
    (("copy", "tripel-1"), "NAME: no problem file 'tripel-1' is shipped, did you mean 'triple-1'?"),
    (("copy", "xyzzy"), "NAME: no problem file 'xyzzy' is shipped; see `orbitfinder problems list`"),
    (("copy", "spherical-pendulum"), "means gallery/spherical-pendulum and mechanisms/spherical-pendulum; say which"),
    (("show", "report"), "NAME: 'report' is more than one file; see `orbitfinder problems list`"),
    (("list", "hybird"), "KIND: 'hybird' is unknown, did you mean 'hybrid'?"),
    (("list", "xyzzy"), "KIND: 'xyzzy' is unknown; there are report, examples, "),
])  # fmt: skip
def test_wrong_words_are_answered(words, said, tmp_path):
    out = ("-o", tmp_path) if words[0] == "copy" else ()
    result = invoke(*words, *out)
    assert result.exit_code == 2 and said in result.stderr and not list(tmp_path.iterdir())


def test_where_they_lie(monkeypatch, tmp_path):
    """In the package (a wheel), else beside it (a clone), else a sentence."""
    package = tmp_path / "orbitfinder"
    package.mkdir()
    monkeypatch.setattr(shipped.resources, "files", lambda _: package)
    with pytest.raises(InputError, match="the problem files are missing from this installation"):
        shipped.folder()
    (tmp_path / "problems" / "report").mkdir(parents=True)
    assert shipped.folder() == tmp_path / "problems"
    (package / "problems" / "report").mkdir(parents=True)
    assert shipped.folder() == package / "problems"
