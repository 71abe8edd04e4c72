"""`orbitfinder guess`: what it shows is what the system does, and what it writes runs."""

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import InputError
from orbitfinder.problemfile.proposals import propose
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.problemfile.write import toml

PROBLEMS = Path(__file__).parents[1] / "problems"
DOUBLE = PROBLEMS / "examples" / "double-mode-2.toml"
RECURRENCE = PROBLEMS / "gallery" / "henon-heiles-recurrence.toml"


def invoke(*words):
    return CliRunner().invoke(cli, ["guess", *map(str, words)])


@pytest.fixture(scope="module")
def shown():
    outcome = invoke(DOUBLE, "--json")
    assert outcome.exit_code == 0, outcome.output
    return json.loads(outcome.stdout)


def test_modes_are_those_of_the_equilibrium(shown):
    """Frequencies solve det(K - w^2 M) = 0 of two uniform rods, by hand."""
    modes = [one for one in shown["guesses"] if one["name"].startswith("mode")]
    mass = np.array([[1 / 3 + 1, 0.5], [0.5, 1 / 3]])
    stiffness = 9.8 * np.diag([1.5, 0.5])
    squared = np.sort(np.linalg.eigvals(np.linalg.solve(mass, stiffness)).real)
    assert [one["frequency"] for one in modes] == pytest.approx(np.sqrt(squared) / (2 * np.pi), rel=1e-9)
    assert [one["period"] for one in modes] == pytest.approx(2 * np.pi / np.sqrt(squared), rel=1e-9)
    assert all(max(map(abs, one["shape"])) == pytest.approx(1.0) for one in modes)


def test_own_guess_and_its_miss(shown):
    """The miss is the gap after the guessed period relative to the extent of the motion, simulated here again."""
    (own,) = [one for one in shown["guesses"] if one["name"] == "own"]
    model = of.chain(2)
    states = of.flows.sample(of.flows.build_flow(model), np.array(own["state"]), own["period"], 400)
    gaps = np.abs(states[-1] - states[0]) / np.ptp(states, axis=0)
    assert own["miss"] == pytest.approx(gaps.max(), rel=1e-3)
    assert own["energy"] == pytest.approx(of.energy(model, np.array(own["state"])))


def test_returns_come_back(shown):
    """Each state comes back to within its miss after its period; best first."""
    returns = [one for one in shown["guesses"] if one["name"].startswith("return")]
    assert len(returns) >= 3
    assert [one["miss"] for one in returns] == sorted(one["miss"] for one in returns)
    model = of.chain(2)
    for one in returns[:3]:
        states = of.flows.sample(of.flows.build_flow(model), np.array(one["state"]), one["period"], 400)
        gaps = np.abs(states[-1] - states[0]) / np.ptp(states, axis=0)
        assert gaps.max() < 5 * one["miss"] + 1e-3


@pytest.mark.parametrize("pick", [None, "mode-1", "own"])
def test_what_is_written_runs(pick, tmp_path):
    """The file is a problem file with one [guess] and certifies; the others are comments in it."""
    out = tmp_path / "candidate.toml"
    outcome = invoke(DOUBLE, "--out", out, *(() if pick is None else ("--pick", pick)))
    assert outcome.exit_code == 0 and "next: orbitfinder run" in outcome.stdout
    document = tomllib.loads(out.read_text(encoding="utf-8"))
    assert document["name"] == "candidate" and document["system"] == {"kind": "chain", "links": 2}
    assert document["source"] == f"orbitfinder guess, {pick or 'return-1'}"
    assert "# [guess]  # mode-2" in out.read_text(encoding="utf-8")
    ran = CliRunner().invoke(cli, ["run", str(out), "--out", str(tmp_path), "--no-figures"])
    assert ran.exit_code == 0, ran.output


def test_recorded_trajectories(tmp_path):
    """A CSV over many periods is searched for close returns, unless a simulation is asked for."""
    model = of.chain(1)
    states = of.flows.sample(of.flows.build_flow(model), np.array([1.0, 0.0]), 12.0, 1201)
    table = np.column_stack([np.linspace(0.0, 12.0, 1201), states])
    np.savetxt(tmp_path / "long.csv", table, delimiter=",")
    file = tmp_path / "long.toml"
    file.write_text('[system]\nkind = "chain"\nlinks = 1\n[guess]\ncsv = "long.csv"\n', encoding="utf-8")
    outcome = invoke(file, "--json")
    guesses = {one["name"]: one for one in json.loads(outcome.stdout)["guesses"]}
    exact = of.find_orbit(of.Problem(model, of.guesses.normal_mode(model, 1, 1.0), pin=of.pin(theta1=1.0))).period
    best = guesses["return-1"]
    assert best["source"] == "trajectory" and guesses["own"]["samples"] == 1201
    assert best["period"] / exact == pytest.approx(round(best["period"] / exact), abs=0.02)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    outcome = invoke(file, "--out", elsewhere / "new.toml", "--pick", "own")
    assert outcome.exit_code == 2 and "own reads 'long.csv' beside" in outcome.stderr
    short = invoke(file, "--duration", "1.5")
    assert "close returns: the motion never came back near itself in 1.5 s" in short.stdout
    assert "samples" not in invoke(RECURRENCE).stdout


@pytest.mark.parametrize("file", ["gallery/van-der-pol", "gallery/forced-duffing-upper", "linkages/five-bar-slow-mode"])
def test_every_kind_of_system(file):
    """Dissipative, forced and constrained systems have proposals too; energies only where one is conserved."""
    loaded = load_problem_file(PROBLEMS / f"{file}.toml")
    found = propose(loaded, count=2)
    assert {one.name.split("-")[0] for one in found.guesses} == {"own", "mode", "return"}
    assert all((one.energy is not None) == loaded.model.conservative for one in found.guesses)


def test_reasons_for_nothing(tmp_path):
    """An equilibrium that is unstable, a search without guess: said, not hidden."""
    file = tmp_path / "search.toml"
    text = '[system]\nkind = "python"\nfunction = "double_well"\n[search]\nperiod = [1.0, 5.0]\n'
    file.write_text(text, encoding="utf-8")
    outcome = invoke(file)
    assert outcome.exit_code == 0
    for reason in ("own guess: the file has none", "normal modes: ", "close returns: nothing to simulate from"):
        assert f"none: {reason}" in outcome.stdout
    outcome = invoke(file, "--out", tmp_path / "new.toml")
    assert outcome.exit_code == 2 and "nothing to propose" in outcome.stderr


def test_messages(tmp_path):
    """Wrong options end with a sentence and write nothing."""
    out = tmp_path / "new.toml"
    cases = [
        ((DOUBLE, "--pick", "mode-1"), "--pick: 'mode-1' is for --out"),
        ((DOUBLE, "--out", out, "--pick", "mode-9"), "there is no 'mode-9'; use one of own, mode-1"),
        ((DOUBLE, "--amplitude", "-1"), "--amplitude: must be positive"),
        ((DOUBLE, "--out", tmp_path / "a b.toml"), "--out: must consist of letters"),
        ((DOUBLE, "--out", tmp_path / "no" / "new.toml"), "--out: cannot write"),
        ((tmp_path / "missing.toml",), "no such file"),
    ]
    for words, message in cases:
        outcome = invoke(*words)
        assert outcome.exit_code == 2 and message in outcome.stderr, outcome.output
    assert not out.exists()
    shutil.copy(DOUBLE, out)
    outcome = invoke(DOUBLE, "--out", out)
    assert outcome.exit_code == 2 and "exists already" in outcome.stderr
    assert "--json" in invoke("--help").stdout


def test_python_files_have_no_system_to_copy(tmp_path):
    """They are shown with --trust, and cannot be rewritten as TOML."""
    file = tmp_path / "made.py"
    file.write_text(
        "import orbitfinder as of\n\n\ndef problem():\n    model = of.chain(2)\n"
        "    return of.Problem(model, of.guesses.normal_mode(model, 1, 0.2))\n",
        encoding="utf-8",
    )
    assert invoke(file).exit_code == 2
    assert invoke(file, "--trust").exit_code == 0
    outcome = invoke(file, "--trust", "--out", tmp_path / "made.toml")
    assert outcome.exit_code == 2 and "no [system] table" in outcome.stderr


def test_values_survive_toml():
    value = {"a": [1.5, 2], "b": True, "c": 'quote " and \\', "d": 1e-300}
    assert tomllib.loads(f"x = {toml(value)}")["x"] == value


def test_returns_need_a_duration():
    with pytest.raises(InputError, match="guess.duration"):
        of.guesses.recurrences(of.chain(2), [0.1, 0.2, 0.0, 0.0], -1.0)


def test_a_system_without_derivatives_at_zero_says_so():
    """The swinging spring's energy has a kink at q = 0: no modes there, close returns all the same."""
    outcome = invoke(PROBLEMS / "gallery" / "spring-pendulum-bounce.toml", "--duration", "12")
    assert outcome.exit_code == 0, outcome.output
    assert "return-1" in outcome.output and "normal modes: guess.mode: the energies have no second" in outcome.output
