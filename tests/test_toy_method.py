"""A toy method, known to this file alone, finds orbits by every way in; the certificate judges what it finds."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import orbitfinder as of
from orbitfinder.cli.group import cli
from orbitfinder.errors import ConvergenceError
from orbitfinder.loops.ipopt import Progress
from orbitfinder.loops.shooting import flow_of
from orbitfinder.orbits.measure import measure, provenance
from orbitfinder.orbits.method import METHODS, Method, method_of

FILE = """
name = "toy"
[system]
kind = "python"
function = "duffing"
arguments = { cubic = 0.0 }
[guess]
state = [0.4, 0.0]
period = 6.0
[find]
pin = { energy = 0.08 }
"""


def suits(problem):
    """Oscillators without a cubic term, at an energy."""
    linear = problem.model.system.get("arguments", {}).get("cubic") == 0.0
    return linear and [pin.name for pin in problem.pin] == ["energy"]


def exact(problem, settings, report, began, period=2 * np.pi):
    """x = a cos t."""
    if report:
        report(Progress("closed form", 0, 0.0, period, 0.0))
    state = np.array([[np.sqrt(2 * problem.pin[0].value), 0.0]])
    orbit = measure(problem, flow_of(problem, settings.integrator), state, period, np.zeros(1))
    said = provenance(problem, settings, began) | {"method": "closed form"}
    return replace(orbit, provenance=said), problem.model


@pytest.fixture
def known(monkeypatch):
    monkeypatch.setitem(METHODS, "closed form", Method(suits, exact))


def run(*words):
    result = CliRunner().invoke(cli, [str(word) for word in words])
    return result.exit_code, result.stdout + result.stderr


def test_it_finds_what_suits_it_and_nothing_else(known, tmp_path):
    (tmp_path / "toy.toml").write_text(FILE)
    problem = of.load_problem(tmp_path / "toy.toml")
    told = []
    orbit = of.find_orbit(problem, progress=told.append)
    assert orbit.provenance["method"] == "closed form" and orbit.certificate.passed
    assert abs(orbit.period - 2 * np.pi) < 1e-12 and [event.stage for event in told] == ["closed form", "certificate"]
    (tmp_path / "other.toml").write_text(FILE.replace("cubic = 0.0", "cubic = 1.0").replace("0.08", "0.0864"))
    other = of.load_problem(tmp_path / "other.toml")
    assert method_of(other)[1] is METHODS["shooting"] and "method" not in of.find_orbit(other).provenance


def test_its_orbits_go_everywhere(known, tmp_path):
    """Run, verified, shown, drawn, exported, on a page, swept, followed."""
    (tmp_path / "toy.toml").write_text(FILE)
    assert run("run", tmp_path / "toy.toml", "--no-figures", "--out", tmp_path)[0] == 0
    (file,) = tmp_path.rglob("orbit.json")
    assert json.loads(file.read_text())["provenance"]["method"] == "closed form"
    for words in (
        ("verify", file), ("show", file), ("plot", file, "-o", tmp_path / "figures"),
        ("export", file, "--to", "csv", "-o", tmp_path / "export"), ("page", file, "-o", tmp_path / "site"),
    ):  # fmt: skip
        code, text = run(*words)
        assert code == 0, text
    assert "closed form" in run("show", file)[1]
    family = of.follow_family(of.load_orbit(file), points=3)
    assert np.allclose([point.period for point in family.points], 2 * np.pi, rtol=1e-11)


def test_it_may_be_wrong_without_an_orbit_being_so(monkeypatch, tmp_path):
    """What it finds is certified like what any other finds; what it raises is told."""
    (tmp_path / "toy.toml").write_text(FILE)
    off = Method(suits, lambda *given: exact(*given, period=2 * np.pi * 1.001))
    monkeypatch.setitem(METHODS, "closed form", off)
    assert "closure" in of.find_orbit(of.load_problem(tmp_path / "toy.toml")).certificate.failures
    assert run("run", tmp_path / "toy.toml", "--no-figures", "--out", tmp_path)[0] == 1

    def failing(*given):
        raise ConvergenceError("no orbit found: not today; try tomorrow")

    monkeypatch.setitem(METHODS, "closed form", Method(suits, failing))
    code, text = run("run", tmp_path / "toy.toml", "--no-figures", "--out", tmp_path)
    assert code == 1 and "not today; try tomorrow" in text
