"""The core stands alone: without the rooms above the border it is imported, finds, certifies and follows orbits."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from test_architecture import CORE, FLOORS, PACKAGE

ALONE = """
import pkgutil
from dataclasses import replace
from importlib import import_module

import pytest

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.families.folder import follow_family
from orbitfinder.records import registry


def test_every_module_is_imported():
    names = [module.name for module in pkgutil.walk_packages(of.__path__, "orbitfinder.")]
    assert len(names) > 80
    for name in names:
        import_module(name)


def test_orbits_of_every_sort(tmp_path):
    clock = of.ode(lambda t, x, p: [x.v, p.mu * (1 - x.u**2) * x.v - x.u], ["u", "v"], {"mu": 1.0})
    cycle = of.find_orbit(of.Problem(clock, of.Guess([2.0, 0.0], 6.7)))
    assert cycle.certificate.passed and abs(cycle.period - 6.663286859323131) < 1e-9
    assert not of.certify(replace(cycle, period=1.001 * cycle.period), clock).passed
    level = {"energy": lambda x, p: x.v**2 / 2 + 9.8 * x.y}
    fall = of.ode(lambda t, x, p: [x.v, -9.8], ["y", "v"], invariants=level)
    bounce = of.Transition("bounce", "air", "air", lambda x, p: x.y, lambda x, p: [x.y, -x.v])
    ball = of.hybrid({"air": fall}, [bounce], ["bounce"], conserved=["energy"])
    hop = of.find_orbit(of.Problem(ball, of.Guess([0.0, 4.9], 1.0), pin=of.pin(energy=12.005)))
    assert hop.certificate.passed and abs(hop.period - 1) < 1e-12
    path = of.save_orbit(hop, tmp_path / "orbit.json")
    assert set(registry.kinds()) == {"orbit", "family", "sweep", "equilibria", "diagram", "map"}
    assert registry.load(path).period == hop.period
    with pytest.raises(InputError, match="does not take"):
        registry.answer("plot", path)


def test_a_family_and_its_record(tmp_path):
    clock = of.ode(lambda t, x, p: [x.v, p.mu * (1 - x.u**2) * x.v - x.u], ["u", "v"], {"mu": 1.0})
    cycle = of.find_orbit(of.Problem(clock, of.Guess([2.0, 0.0], 6.7)))
    family = of.follow_family(cycle, parameter="mu", until=1.3, model=clock)
    assert abs(family.points[-1].value - 1.3) < 1e-9
"""
FILES = ("test_codec.py", "test_floquet.py", "test_offset.py", "test_caches.py")
"""Tests of the core that need nothing else"""


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The package without what is above the border."""
    folder = tmp_path_factory.mktemp("core")
    kept = {room for rooms in FLOORS[:CORE] for room in rooms}
    for path in sorted(PACKAGE.iterdir()):
        if path.is_dir() and path.name in kept:
            shutil.copytree(path, folder / "orbitfinder" / path.name)
        elif path.is_file() and path.stem in (*kept, "__init__", "py"):
            (folder / "orbitfinder").mkdir(exist_ok=True)
            shutil.copy(path, folder / "orbitfinder")
    (folder / "tests").mkdir()
    (folder / "tests" / "test_alone.py").write_text(ALONE)
    for name in FILES:
        shutil.copy(Path(__file__).with_name(name), folder / "tests")
    return folder


@pytest.mark.slow
def test_the_core_stands_alone(copy):
    assert not (copy / "orbitfinder" / "mechanisms").exists()
    told = subprocess.run(
        [sys.executable, "-P", "-m", "pytest", "-q", "-p", "no:cacheprovider", "-W", "error", "tests"],
        cwd=copy, env={**os.environ, "PYTHONPATH": str(copy)}, capture_output=True, text=True,
    )  # fmt: skip
    assert told.returncode == 0, told.stdout[-3000:] + told.stderr[-2000:]
