"""Other programs on the same orbits: heyoka with its own derivation, AUTO-07p on our exported files."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from functools import partial
from importlib import import_module, metadata
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.validation.comparison import Comparison, Section, attempted, number
from benchmarks.validation.reference_orbits import report_orbit
from orbitfinder.errors import OrbitfinderError
from orbitfinder.exports.write import export_orbit
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.reproduce.facts import ORBITS, PrintedOrbit

CLOSURE = 1e-12
"""rad or rad/s, times max(1, largest multiplier)"""
AUTO_PERIOD = 1e-6
"""s: collocation with 50 intervals of 4 points and a residual of 1e-9"""


def sections() -> list[Section]:
    """heyoka and AUTO, each where it is installed."""
    return [heyoka(), auto()]


def heyoka() -> Section:
    """Each report orbit integrated by heyoka over our period: the gap round the loop."""
    source = (
        "heyoka.py: Lagrange's equations by heyoka's own `lagrangian` from the energies of uniform rods, Taylor "
        "integration at machine precision. Nothing of ours is used but the state and the period; a gap of 0 is "
        "what an orbit promises. Allowed: 1e-12 times the largest Floquet multiplier."
    )
    try:
        library = import_module("heyoka")
    except ImportError:
        return Section("heyoka", source, (), "heyoka is not installed (pip install heyoka)")
    rows: list[Comparison] = []
    for one in ORBITS:
        rows += attempted(one.name, "0", partial(_gap, library, one))
    return Section(f"heyoka {metadata.version('heyoka')}", source, tuple(rows))


def _gap(hy: Any, one: PrintedOrbit) -> list[Comparison]:
    orbit = report_orbit(one)
    n = orbit.state.size // 2
    q, v = hy.make_vars(*(f"q{i}" for i in range(n))), hy.make_vars(*(f"v{i}" for i in range(n)))
    system = hy.lagrangian(_lagrangian(hy, q, v), list(q), list(v))
    integrator = hy.taylor_adaptive(system, list(map(float, orbit.state)), tol=1e-17)
    integrator.propagate_until(orbit.period)
    gap = float(np.abs(np.asarray(integrator.state) - orbit.state).max())
    scale = max(1.0, float(np.abs(orbit.floquet_multipliers).max(initial=1.0)))
    return [Comparison(f"{orbit.name}, gap after one period", "0", f"{gap:.3e}", gap, CLOSURE * scale)]


def _lagrangian(hy: Any, q: Any, v: Any) -> Any:
    """L = T - V of uniform rods of 1 m and 1 kg, absolute angles from the downward vertical, g = 9.8 m/s^2."""
    total, x, y, along, across = 0.0, 0.0, 0.0, 0.0, 0.0
    for angle, rate in zip(q, v, strict=True):
        down, right = hy.cos(angle), hy.sin(angle)
        centre = (along - rate * right / 2, across + rate * down / 2)
        total = total + (centre[0] * centre[0] + centre[1] * centre[1]) / 2 + rate * rate / 24 + 9.8 * (x + down / 2)
        x, y, along, across = x + down, y + right, along - rate * right, across + rate * down
    return total


def auto() -> Section:
    """AUTO-07p on the files of `export --to auto`: its first point, and an orbit where its continuation ended."""
    folder = Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p"))
    source = (
        "AUTO-07p (orthogonal collocation, 50 intervals of 4 points) on the files that `orbitfinder export --to auto` "
        "writes: its first corrected orbit, and the period at the energy where 20 continuation steps ended, found "
        "again by us at that energy. Allowed: 1e-6 s."
    )
    if not (folder / "cmds" / "@r").is_file() or shutil.which("gfortran") is None:
        return Section("AUTO-07p", source, (), "AUTO-07p with gfortran is not installed (Debian package auto-07p)")
    rows: list[Comparison] = []
    for one in ORBITS:
        rows += attempted(one.name, "", partial(_continued, folder, one))
    return Section("AUTO-07p", source, tuple(rows))


def _continued(folder: Path, one: PrintedOrbit) -> list[Comparison]:
    orbit = report_orbit(one)
    with tempfile.TemporaryDirectory() as scratch:
        files = export_orbit(orbit, "auto", scratch)
        word = files[0].stem
        command = ["sh", str(folder / "cmds" / "@r"), word]
        environment = os.environ | {"AUTO_DIR": str(folder), "OMP_NUM_THREADS": "1"}
        try:
            subprocess.run(command, cwd=scratch, env=environment, check=True, capture_output=True, timeout=120)
            branch = read_branch(Path(scratch) / "fort.7")
            state = read_state(Path(scratch) / "fort.8", orbit.state.size)
        except (OSError, subprocess.SubprocessError, ValueError, IndexError) as error:
            raise OrbitfinderError(f"AUTO did not run: {error}") from error
    (first, _), (period, energy) = branch[0], branch[-1]
    again = find_orbit(Problem(chain(orbit.state.size // 2), Guess(state, period), pin(energy=energy)))
    return [
        number(f"{orbit.name}, period of AUTO's first point", f"{first:.11g}", orbit.period, AUTO_PERIOD),
        number(f"{orbit.name}, period at E = {energy:.8g} J", f"{period:.11g}", again.period, AUTO_PERIOD),
    ]


def read_branch(path: Path) -> list[tuple[float, float]]:
    """(period, energy) of every point of a fort.7 whose last columns they are."""
    rows = [line.split() for line in path.read_text().splitlines()]
    return [(float(row[-2]), float(row[-1])) for row in rows if row and row[0] != "0"]


def read_state(path: Path, size: int) -> np.ndarray:
    """The state at t = 0 of the last solution in a fort.8; its first line says how many lines the solution has."""
    lines, place, start = path.read_text().splitlines(), 0, 0
    while place < len(lines):
        start, place = place, place + int(lines[place].split()[8]) + 1
    numbers = " ".join(lines[start + 1 : start + 2 + size // 7 + 1]).split()
    return np.asarray(numbers[1 : size + 1], float)
