"""Many orbits in one process: what one of them needed is given back before the next."""

import _ctypes
import gc
import os
import shutil
import subprocess
import sys
import tempfile
import weakref
from pathlib import Path

import numpy as np
import pytest

from orbitfinder.integrate.dop853 import integrate
from orbitfinder.integrate.held import Shared

GROWTH = """
import ctypes, gc, sys
from dataclasses import replace
from pathlib import Path

import orbitfinder as of
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.problemfile.read import load_problem_file
from orbitfinder.systems import spring_pendulum

file, how, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
known = replace(load_problem_file(Path(file)).problem, expected={})
name = known.model.parameter_names[0]
value = known.model.parameter_values[0]


def model(k):
    changed = value * (1 + 1e-6 * k)
    if how == "same":
        return known.model
    return with_parameters(known.model, {name: changed}) if how == "values" else spring_pendulum(length=changed)


def resident():
    gc.collect()
    getattr(ctypes.CDLL(None), "malloc_trim", lambda _: 0)(0)  # or 5 MB of its reserve come or go within an orbit
    return int(next(line for line in open("/proc/self/status") if line.startswith("VmRSS")).split()[1]) / 1024


for k in range(count + 1):
    assert of.find_orbit(replace(known, model=model(k))).certificate.passed, k
    if k == count // 10:  # what is imported, reserved and kept once is there by then
        before = resident()
print(resident() - before)
"""
SPRING, TRIPLE = (
    Path(__file__).parents[1] / "problems" / "gallery" / f"{name}.toml"
    for name in ("spring-pendulum-swing", "triple-pendulum-middle-mode")
)
linux = pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads /proc")


def growth(file: Path, how: str, count: int) -> float:
    """MB by which a process grows from a tenth of 1 + `count` orbits that it finds and certifies to the last.

    Nobody else compiles into its cache: a library that appears there half-way is loaded, and counts.
    """
    with tempfile.TemporaryDirectory() as cache:
        done = subprocess.run(
            [sys.executable, "-c", GROWTH, str(file), how, str(count)], capture_output=True, text=True, check=True,
            env=os.environ | {"ORBITFINDER_CACHE": cache},
        )  # fmt: skip
    return float(done.stdout)


@pytest.mark.parametrize("samples", [2, 40], ids=["end", "samples"])
def test_an_integration_lets_go_of_its_field(samples):
    """SciPy 1.17 keeps a reference to every function that DOP853 has called, for ever."""

    class Field:
        def __call__(self, t: float, y: np.ndarray) -> np.ndarray:
            return np.array([y[1], -y[0]])

    field = Field()
    seen = weakref.ref(field)
    integrate(field, np.array([1.0, 0.0]), np.linspace(0.0, 1.0, samples))
    del field
    gc.collect()
    assert seen() is None


def test_an_integration_leaves_nothing_of_scipy_behind():
    """SciPy 1.17 keeps every callback that it was given: 39 integrators a sweep, which grew by that."""

    def kept():
        gc.collect()
        return sum("dop853" in type(one).__name__ or "_Steps" in type(one).__name__ for one in gc.get_objects())

    before = kept()
    for _ in range(5):
        integrate(lambda t, y: np.array([y[1], -y[0]]), np.array([1.0, 0.0]), np.linspace(0.0, 1.0, 3))
    assert kept() == before


@linux
def test_a_library_that_nothing_refers_to_is_closed(tmp_path):
    """ctypes keeps each for good: 40 kB with every other value of a parameter, 38 MB of a thousand orbits."""

    def mapped():
        return "closed.so" in Path("/proc/self/maps").read_text()

    shutil.copy(_ctypes.__file__, tmp_path / "closed.so")
    opened = Shared(tmp_path / "closed.so")
    function = opened["PyInit__ctypes"]
    del opened
    assert mapped()  # its function needs it
    del function
    assert not mapped()


@pytest.mark.slow
@linux
def test_forty_orbits_need_no_more_memory_than_one():
    """They leaked 11 MB, 0.27 each. What is left is 1 to 3 MB of allocator."""
    assert growth(SPRING, "same", 40) < 6.0


@linux
@pytest.mark.slow
@pytest.mark.parametrize(
    ("file", "how", "most"),
    [(SPRING, "same", 20.0), (SPRING, "values", 20.0), (SPRING, "builder", 20.0), (TRIPLE, "values", 30.0)],
)
def test_a_thousand_orbits_need_twenty_megabytes(file, how, most):
    """Of one problem, and of a thousand that differ, from the hundredth on: the caches are full after some seventy.

    Of triple pendulums 9 MB are in use, the same after 100 as after 800, and as much again is in holes of the heap.
    """
    assert growth(file, how, 1000) < most
