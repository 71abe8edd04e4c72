"""`orbitfinder search` and `orbitfinder atlas`: what a person types and reads."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import database
from test_atlas_search import content

from orbitfinder.atlas.search import Limits, SearchStatistics
from orbitfinder.cli import atlas as cataloguing
from orbitfinder.cli import search as searching
from orbitfinder.cli.console import paced
from orbitfinder.cli.group import cli

ROOT = Path(__file__).parents[1]
TRIPLE = ROOT / "problems" / "search" / "triple.toml"


def run(*words, code=0):
    """Standard output and standard error of a command that ends with a code."""
    result = CliRunner().invoke(cli, [str(word) for word in words])
    assert result.exit_code == code, result.output + repr(result.exception)
    return result.stdout, result.stderr


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """An atlas filled by the command, and what it printed."""
    path = tmp_path_factory.mktemp("book") / "triple.sqlite"
    out, _ = run("search", TRIPLE, "--starts", 12, "--workers", 0, "--atlas", path, "--json")
    return path, json.loads(out)


def test_search_reports_in_json(book):
    path, document = book
    orbits, starts = content(path)
    assert document["format"] == "orbitfinder/search" and document["atlas"] == str(path)
    assert document["runs"][0]["energy"] == -30.0 and document["runs"][0]["starts"] == len(starts) == 12
    assert document["summary"]["orbits"] == document["runs"][0]["new"] == len(orbits) > 2
    assert document["summary"]["estimate"]["total"] >= len(orbits)
    assert sum(one["starts"] for one in document["summary"]["yields"]) == 12


def test_search_reports_in_words(book):
    """The same command again has nothing left to do, and says what is there."""
    path, document = book
    out, _ = run("search", TRIPLE, "--starts", 12, "--workers", 0, "--atlas", path)
    assert "-30 J: 0 starts" in out and f"{document['summary']['orbits']} distinct certified orbits" in out
    assert "strategy" in out and "recurrence" in out and "Chao1" in out
    assert "orbits without symmetry at -30 J were sought by" in out and "+- 0" not in out


def test_an_energy_that_a_point_of_the_grid_does_not_reach_leaves_the_others(tmp_path):
    """Three links hang at -4.5 g: with g = 5 at -22.5 J."""
    asked = ("search", TRIPLE, "--starts", 0, "--workers", 0, "--atlas", tmp_path / "a.sqlite", "--parameter")
    document = json.loads(run(*asked, "gravity=5,9.8", "--json", code=1)[0])
    (refused,) = document["refused"]
    assert refused["parameters"] == {"gravity": 5.0} and "-22.5" in refused["reason"]
    assert [one["parameters"] for one in document["runs"]] == [{"gravity": 9.8}]
    out, _ = run(*asked, "gravity=5,9.8", code=1)
    assert f"-30 J, gravity = 5: not searched: {refused['reason']}" in out and "-30 J, gravity = 9.8: 0 starts" in out
    assert "-22.5" in run(*asked, "gravity=5,4", code=2)[1]


def test_list_show_and_verify(book, tmp_path):
    path, document = book
    out, _ = run("atlas", "list", path)
    assert out.splitlines()[-1] == f"{document['summary']['orbits']} orbits" and "largest |mu|" in out
    listed = json.loads(run("atlas", "list", path, "--json", "--order", "period DESC")[0])["orbits"]
    periods = [row["period"] for row in listed]
    assert periods == sorted(periods, reverse=True)
    narrow = json.loads(run("atlas", "list", path, "--json", "--period", f"{periods[0] - 1e-6},")[0])["orbits"]
    assert [row["id"] for row in narrow] == [listed[0]["id"]]
    assert not json.loads(run("atlas", "list", path, "--json", "--energy", ",-31")[0])["orbits"]
    out, _ = run("atlas", "show", path, listed[0]["id"])
    assert "theta3dot" in out and "floquet multipliers" in out and "seed 0" in out
    (tmp_path / "orbit.json").write_text(run("atlas", "show", path, listed[0]["id"], "--json")[0])
    assert "certified" in run("verify", tmp_path / "orbit.json")[0]


def test_show_trusts_a_module_beside_the_atlas(book, tmp_path):
    """Names of the state come from the module, which is imported only with --trust; the document needs none."""
    module = "from orbitfinder.mechanisms.chain import chain\n\ndef made():\n    return chain(3)\n"
    (tmp_path / "homemade.py").write_text(module)
    path = tmp_path / "own.sqlite"
    path.write_bytes(book[0].read_bytes())
    system = {"kind": "python", "module": "homemade", "function": "made", "arguments": {}}
    with database(path) as connection:
        connection.execute("UPDATE about SET value = ? WHERE key = 'system'", [json.dumps(system)])
    connection.close()
    assert "theta3dot" in run("atlas", "show", path, 1, "--trust")[0]
    assert "theta3dot" in run("atlas", "export", path, "--to", "csv", "--trust")[0]
    assert "was not run; read it, then add --trust" in run("atlas", "show", path, 1, code=2)[1]
    assert json.loads(run("atlas", "show", path, 1, "--json")[0])["period"] > 0


def test_export_and_report(book, tmp_path):
    path, document = book
    count = document["summary"]["orbits"]
    assert len(json.loads(run("atlas", "export", path)[0])) == count
    assert len(run("atlas", "export", path, "--to", "csv")[0].splitlines()) == count + 1
    run("atlas", "export", path, "--to", "csv", "-o", tmp_path / "orbits.csv")
    assert len((tmp_path / "orbits.csv").read_text().splitlines()) == count + 1
    assert f"{count} distinct certified orbits of 12 starts" in run("atlas", "report", path)[0]
    assert json.loads(run("atlas", "report", path, "--json")[0])["orbits"] == count
    assert "--out: missing; a Parquet file" in run("atlas", "export", path, "--to", "parquet", code=2)[1]
    assert "cannot write" in run("atlas", "export", path, "-o", tmp_path / "no" / "x.json", code=2)[1]


def test_parquet_without_pyarrow(book, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    err = run("atlas", "export", book[0], "--to", "parquet", "-o", tmp_path / "a.parquet", code=2)[1]
    assert "pip install 'orbitfinder[parquet]', or use csv" in err


def test_plot(book, tmp_path):
    out, _ = run("atlas", "plot", book[0], "-o", tmp_path)
    names = ["atlas_energy_period.png", "atlas_instability.png", "atlas_discovery.png"]
    assert [Path(line).name for line in out.splitlines()] == names
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in names)
    assert "no orbit to draw" in run("atlas", "plot", book[0], "-o", tmp_path, "--period", "90,", code=2)[1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["search", "{triple}", "--atlas", "{tmp}/a.sqlite", "--budget", "soon"], "--budget: 'soon' is not a time"),
        (["search", "{triple}", "--atlas", "{tmp}/no/a.sqlite"], "does not exist; make it first"),
        (["search", "{tmp}/none.toml", "--atlas", "{tmp}/a.sqlite"], "no such file"),
        (["search", "{report}", "--atlas", "{tmp}/a.sqlite"], "search: missing; add a [search] table"),
        (["search", "{energyless}", "--atlas", "{tmp}/a.sqlite"], "search.energy: missing"),
        (["search", "{nonsense}", "--atlas", "{tmp}/a.sqlite"], "search.energy: must be a number or a list of numbers"),
        (["search", "{low}", "--atlas", "{tmp}/a.sqlite", "--workers", "0"], "energy: -90 J is not above -44.1 J"),
        (["atlas", "list", "{tmp}/none.sqlite"], "no such atlas"),
        (["atlas", "list", "{book}", "--period", "one,two"], "--period: 'one,two' is no range"),
        (["atlas", "list", "{book}", "--order", "colour"], "order: unknown 'colour'"),
        (["atlas", "show", "{book}", "999"], "id: no orbit 999"),
        (["search", "{double}", "--atlas", "{book}", "--starts", "0"], "system: holds orbits of chain (links = 3"),
    ],
)
def test_mistakes(book, tmp_path, words, message):
    system = '[system]\nkind = "chain"\nlinks = 3\n[search]\nperiod = [0.5, 6.0]\n'
    files = {
        "energyless": system, "nonsense": system + 'energy = "high"\n', "low": system + "energy = -90.0\n",
        "double": system.replace("3", "2") + "energy = -10\n",
    }  # fmt: skip
    for name, text in files.items():
        (tmp_path / f"{name}.toml").write_text(text)
    places = {name: tmp_path / f"{name}.toml" for name in files} | {
        "triple": TRIPLE, "tmp": tmp_path, "book": book[0], "report": ROOT / "problems" / "report" / "triple-1.toml"
    }  # fmt: skip
    _, err = run(*(word.format(**places) for word in words), code=2)
    assert message in err and "Traceback" not in err


def test_energies_of_a_problem_file(tmp_path):
    """A list, one number, or the pin."""
    from orbitfinder.problemfile.read import load_problem_file

    head = '[system]\nkind = "chain"\nlinks = 3\n[search]\nperiod = [0.5, 6.0]\n'
    for text, energies in (
        ("energy = [-40, -30.5]\n", [-40.0, -30.5]),
        ("energy = -30.0\n", [-30.0]),
        ("[find]\npin = { energy = -35.0 }\n", [-35.0]),
    ):
        (tmp_path / "a.toml").write_text(head + text)
        assert searching.wanted(load_problem_file(tmp_path / "a.toml")) == (energies, (0.5, 6.0))


@pytest.mark.parametrize("file", sorted((ROOT / "problems" / "search").glob("*.toml")), ids=lambda file: file.stem)
def test_problem_files(file):
    """Every problem file for searches asks for something that can be searched."""
    from orbitfinder.atlas.starts import Target, check
    from orbitfinder.problemfile.read import load_problem_file

    loaded = load_problem_file(file)
    energies, periods = searching.wanted(loaded)
    for energy in energies or [0.0]:
        check(loaded.model, Target(energy, periods))


@pytest.mark.parametrize(("text", "value"), [("60s", 60), ("1.5m", 90), ("2h", 7200), ("45", 45), ("3 min", 180)])
def test_durations(text, value):
    assert searching.seconds(text) == value


def test_progress_in_words():
    """A line and a table say starts, hits, new, known, failures, rate and time left."""
    tally = SearchStatistics(done=10, hits=6, new=4, duplicates=2, orbits=9, begun_at=5, before=5,
                       limits=Limits(starts=35, budget=60.0))  # fmt: skip
    tally.failures["iteration limit"] = 4
    tally.began = time.monotonic() - 2.0
    assert tally.left == pytest.approx(4.0, abs=0.2)
    told = searching.progress(-30.0, tally)
    assert told.line.startswith("-30 J: 15 starts, 6 hits, 4 new, 2 known, 4 failed, 9 orbits in the atlas, 5")
    assert told.line.endswith("s left")
    assert len(told.rows) == 9 and ("failed: iteration limit", "4") in told.rows
    shown = []
    call = paced(shown.append, 1000.0)
    call(told)
    call(told)
    assert shown == []
    paced(shown.append, 0.0)(told)
    assert shown == [told]


def test_ranges_may_be_open():
    read = cataloguing.interval
    assert read(None, None, "1,") == (1.0, float("inf")) and read(None, None, ",2") == (-float("inf"), 2.0)
    assert read(None, None, None) is None


@pytest.mark.slow
def test_interrupt(tmp_path):
    """Ctrl-C: exit code 130, no traceback, no process left, and the search goes on to the same end."""
    path, calm = tmp_path / "a.sqlite", tmp_path / "calm.sqlite"
    words = [sys.executable, "-m", "orbitfinder", "search", str(TRIPLE), "--starts", "60", "--workers", "2", "--atlas"]
    process = subprocess.Popen([*words, str(path)], stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    while not path.exists() or not content_or_nothing(path):
        time.sleep(0.1)
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130 and "Interrupted" in err and "Traceback" not in err
    assert 0 < len(content(path)[1]) < 60
    for place in (path, calm):
        subprocess.run([*words, str(place)], check=True, capture_output=True, timeout=300)
    assert content(path) == content(calm)


def content_or_nothing(path):

    try:
        return content(path)[1]
    except sqlite3.Error:
        return []
