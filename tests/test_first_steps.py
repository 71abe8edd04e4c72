"""What a new user types first, and what is answered when it is not quite right."""

from pathlib import Path

import pytest
from click.testing import CliRunner

from orbitfinder.cli.group import cli

ROOT = Path(__file__).parents[1]
ORBIT = ROOT / "results" / "orbits" / "triple-1" / "orbit.json"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(cli, ["init", "mine"]).exit_code == 0
    (tmp_path / "orbit.json").write_bytes(ORBIT.read_bytes())
    return tmp_path


@pytest.mark.parametrize(("words", "answer"), [
    ("run mine", "mine: no such file; did you mean mine.toml?"),
    ("run none", "none: no such file; check the path; `orbitfinder problems copy all` writes those that come with"),
    ("mine.toml", "'mine.toml' is a file, not a command. Did you mean: orbitfinder run mine.toml"),
    ("orbit.json", "'orbit.json' is a file, not a command. Did you mean: orbitfinder verify orbit.json"),
    ("verify mine.toml", "mine.toml: a problem file; run it, then give the orbit.json that was written"),
    ("animate mine.toml", "mine.toml: a problem file; run it, then give the orbit.json that was written"),
    ("run orbit.json", "orbit.json: not a problem file; orbits and families go to verify"),
    ("rnu mine.toml", "No such command 'rnu'"),
    ("init mine", "mine.toml exists already and is left alone"),
])  # fmt: skip
def test_the_answer_names_what_was_meant(folder, words, answer):
    """Exit code 2 and one sentence that leads on."""
    result = CliRunner().invoke(cli, words.split())
    assert result.exit_code == 2 and answer in result.stderr


def test_the_template_runs_as_written(folder):
    """`init` then `run`: a certified orbit, with nothing edited."""
    result = CliRunner().invoke(cli, ["run", "mine.toml", "--no-figures"])
    assert result.exit_code == 0 and result.stdout.startswith("mine: certified, period 1.1785914628")
