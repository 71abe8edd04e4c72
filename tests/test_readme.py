"""The README's code runs, its numbers are those measured, and what it points at exists."""

import re
import shlex
import subprocess
import tomllib
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import EXTRAS

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("code", blocks("python"))
def test_python_example_runs_and_certifies(code, capsys):
    """The example finds the orbit near the report's first, and its own assertion holds."""
    names = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["orbit"].period == pytest.approx(1.6554, abs=1e-3)
    assert "closure" in capsys.readouterr().out


def test_continuous_integration_runs_the_two_lines_as_they_stand_here():
    """`.ci/run` takes them from this file and has no environment and no test command of its own."""
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (block,) = (one for one in blocks("sh") if "-m venv" in one)
    first, second = block.splitlines()
    reader = re.search(r"mapfile -t lines < <\((.*)\)$", script, re.MULTILINE)[1]
    taken = subprocess.run(["bash", "-c", reader], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    assert taken.splitlines() == [first, second]
    assert first.endswith("orbitfinder run problems/report/triple-1.toml") and second.endswith("python -m pytest")
    commands = "".join(line for line in script.splitlines(keepends=True) if not line.startswith("#"))
    own = commands.replace(reader, "")
    assert not [word for word in ("-m venv", "[test", "-m pytest") if word in own]
    wanted = [
        '"${lines[0]}"',
        '"${lines[1]% && *}"',
        '"${lines[1]##* && } --times $scratch/times.json"',
        r""""$(.venv/bin/python - <<'END'""",
        "\"${lines[1]##* && } -m 'needs and not slow' $(grep -l mark.needs tests/test_*.py | xargs)\"",
    ]
    assert re.findall(r"^eval (.*)$", commands, re.MULTILINE) == wanted
    assert sorted(re.search(r"pip install -q -e '\.\[(.*)\]'", commands)[1].split(",")) == sorted(EXTRAS)


def test_python_example_is_short():
    assert all(code.count("\n") <= 20 for code in blocks("python"))


def test_links_lead_somewhere():
    """Every relative link and picture is a file of the repository; it is a landing page of less than 120 lines."""
    missing = [target for target in re.findall(r"\]\(([^)#:]+)\)", README) if not (ROOT / target).exists()]
    assert not missing and README.count("\n") < 120


def test_badges_are_true():
    """What the badges say is what the package declares."""
    with (ROOT / "pyproject.toml").open("rb") as stream:
        project = tomllib.load(stream)["project"]
    shown = {name: (ROOT / "docs" / "badges" / f"{name}.svg").read_text() for name in ("license", "python")}
    versions = sorted(re.findall(r"Python :: (3\.\d+)", str(project["classifiers"])), key=lambda one: int(one[2:]))
    assert f"license: {project['license']}<" in shown["license"]
    assert f"python: {versions[0]} to {versions[-1]}<" in shown["python"]
    assert project["requires-python"] == f">={versions[0]}"


def test_benchmark_rows_are_the_measured_ones():
    """The comparison is quoted from the benchmark's own page, verdict included."""
    quoted = README.split("tests/test_readme.py -->\n")[1].split("<!-- end -->")[0].strip()
    page = (ROOT / "results" / "benchmarks" / "refine.md").read_text(encoding="utf-8")
    assert quoted == page[page.index("| orbit |") :].strip()


def test_quoted_commands_exist():
    """Each `orbitfinder COMMAND` in a shell block has a help page."""
    from orbitfinder.cli.group import cli

    lines = [line for block in blocks("sh") for line in block.splitlines()]
    words = [shlex.split(line, comments=True) for line in lines if line.startswith("orbitfinder ")]
    assert words
    for _, command, *_ in words:
        assert CliRunner().invoke(cli, [command, "--help"]).exit_code == 0
