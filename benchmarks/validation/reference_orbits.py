"""The course report's orbits, and orbits computed independently of this project."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.validation.comparison import Comparison, Section, attempted, number
from orbitfinder.errors import InputError
from orbitfinder.integrate.cvodes import build_flow, end_state
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.model import energy
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.find import find_orbit
from orbitfinder.records.orbit import Orbit
from orbitfinder.reproduce.facts import ORBITS, PrintedOrbit

FILES = ("report_orbits.json", "normal_modes.json")
PERIOD = 1e-10
"""s; the reference files promise 1e-13, the rest is room for orbits with large multipliers"""
MULTIPLIER = 1e-7
MODERATE = 1e3
"""Largest multiplier of orbits whose multipliers are compared: beyond it neither side knows seven digits."""


def sections(data: Path) -> list[Section]:
    """The report's digits, the same orbits refined by others, and 28 normal modes."""
    for file in FILES:
        entries(data, file)  # before anything is computed
    return [report_digits(), refined(data), modes(data)]


@cache
def report_orbit(printed: PrintedOrbit) -> Orbit:
    """A report orbit found from its printed digits at the energy of the printed state."""
    model = chain(printed.links)
    guess = Guess(printed.state, printed.period_guess)
    pinned = pin(energy=energy(model, np.asarray(printed.state)))
    return find_orbit(Problem(model, guess, pinned, name=printed.name))


def report_digits() -> Section:
    """Each printed state against the orbit found at its energy, and the number that turns out to be the period."""
    rows: list[Comparison] = []
    for one in ORBITS:
        rows += attempted(one.name, "printed digits", partial(_printed, one))
    source = (
        "MAE 5730 final report, figures 11 to 13. The report prints states to 15 decimals and no periods; the last "
        "component of each turns out to be the period up to sign. Allowed: the gap by which the printed state itself "
        "fails to return after our period."
    )
    return Section("The course report's orbits", source, tuple(rows))


def _printed(one: PrintedOrbit) -> list[Comparison]:
    orbit, state = report_orbit(one), np.asarray(one.state)
    gap = float(np.linalg.norm(end_state(build_flow(chain(one.links)), state, orbit.period) - state))
    distance = float(np.abs(orbit.state - state).max())
    return [
        Comparison(f"{one.name}, state", "15 decimals", "refined", distance, gap, "largest component"),
        number(f"{one.name}, period", repr(one.period_guess), orbit.period, gap, "the last printed component"),
    ]


def read_json(path: Path) -> dict[str, Any]:
    """A reference file. Raises `InputError` when it is not there."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError) as error:
        raise InputError(f"--data: {path}: cannot be read ({error}); give the folder tests/data") from error


def entries(data: Path, file: str) -> list[dict[str, Any]]:
    """The orbits of a reference file. Raises `InputError`."""
    return list(read_json(data / file)["orbits"])


def refined(data: Path) -> Section:
    """The four report orbits as refined by Taylor integration at 1e-16."""
    rows: list[Comparison] = []
    known = {one.name: one for one in ORBITS}
    for entry in entries(data, FILES[0]):
        rows += attempted(entry["name"], repr(entry["period"]), partial(_refined, known[entry["name"]], entry))
    return Section("The same orbits refined independently", _source(), tuple(rows))


def _source() -> str:
    return (
        "Reference files in tests/data, computed outside this project by Taylor-series integration at 1e-16 with "
        "Newton shooting and cross-checked by DOP853. Allowed: 1e-10 s for periods; for Floquet multipliers a "
        f"relative distance of {MULTIPLIER:g} from the nearest of ours, compared where the largest is below "
        f"{MODERATE:g}."
    )


def modes(data: Path) -> Section:
    """Normal modes of the triple and quadruple pendulum at 0.1, 1, 6 and 20 J above hanging."""
    rows: list[Comparison] = []
    for entry in entries(data, FILES[1]):
        rows += attempted(entry["name"], repr(entry["period"]), partial(_mode, entry))
    return Section("Nonlinear normal modes", _source(), tuple(rows))


def _refined(printed: PrintedOrbit, entry: Mapping[str, Any]) -> list[Comparison]:
    return _compared(entry, report_orbit(printed))


def _mode(entry: Mapping[str, Any]) -> list[Comparison]:
    """Rows of the orbit found from the reference state off by 1e-4, relative, at the same energy."""
    state = np.asarray(entry["state"]) * (1 + 1e-4)
    guess = Guess(state, entry["period"] * (1 - 1e-4))
    pinned = pin(energy=entry["energy"])
    problem = Problem(chain(entry["links"]), guess, pinned, symmetry="brake+reflection", name=entry["name"])
    return _compared(entry, find_orbit(problem))


def _compared(entry: Mapping[str, Any], orbit: Orbit) -> list[Comparison]:
    rows = [number(f"{entry['name']}, period", repr(entry["period"]), orbit.period, PERIOD)]
    wanted = np.array([complex(*pair) for pair in entry["floquet_multipliers"]])
    if np.abs(wanted).max() >= MODERATE:
        return rows
    found = orbit.floquet_multipliers
    worst = max(float(np.abs(found - mu).min() / max(1.0, abs(mu))) for mu in wanted)
    largest = f"{np.abs(wanted).max():.10g}"
    ours = f"{np.abs(found).max():.10g}"
    return [*rows, Comparison(f"{entry['name']}, multipliers", largest, ours, worst, MULTIPLIER, "largest shown")]
