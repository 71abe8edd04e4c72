"""The facts of an orbit as every display says them: names, numbers, units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np

from orbitfinder.atlas.store import Atlas
from orbitfinder.errors import FAILURES, plural
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import units
from orbitfinder.records.certificate import Certificate
from orbitfinder.records.orbit import Orbit


def has_path(model: Model) -> bool:
    """Whether the coordinates are those of one thing in a plane or in space: it marks places, or draws no links."""
    if model.rates is not None and not model.hamiltonian:
        return False
    places = not model.angular.any() and model.degrees_of_freedom in (2, 3)
    return bool(model.landmarks) or (places and model.points is None)


def sides(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[tuple[int, int]]]:
    """Lowest and highest of coordinates (k x n), and each pair of them that is worth a view."""
    low, high = places.min(axis=0), places.max(axis=0)
    moving = np.flatnonzero(high - low > 1e-6 * (high - low).max()).tolist()
    return low, high, list(combinations(moving, 2)) or [(0, 1)]


def number(value: Any, digits: int = 6) -> str:
    """A number for reading: plain where that is short, with a power of ten otherwise."""
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        return "not computed"
    return f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}")


def with_unit(text: str, unit: str) -> str:
    """A number with its unit, where it has one."""
    return f"{text} {unit}" if unit else text


def largest(orbit: Orbit) -> float:
    """Largest modulus of the Floquet multipliers, 1 where there are none."""
    return max(map(abs, orbit.floquet_multipliers.tolist()), default=1.0)


def conserves(atlas: Atlas) -> bool:
    """Whether an energy is conserved, True where nothing is known of the system."""
    try:
        return atlas.model.conservative and not atlas.controlled
    except FAILURES:
        return True


def verdict_of(certificate: Certificate) -> str:
    """passed, or the checks that failed."""
    count = len(certificate.checks)
    return f"passed, {plural(count, 'check')}" if certificate.passed else f"FAILED: {', '.join(certificate.failures)}"


def facts(orbit: Orbit, conserved: bool = True, names: Sequence[str] = ()) -> dict[str, str]:
    """What an orbit's numbers are called, and they, in its units; of what dissipates the energy at t = 0. `names` are
    those of its coordinates."""
    unit, certificate, level = units(orbit.system), orbit.certificate, math.isfinite(orbit.energy)
    energy = with_unit(number(orbit.energy, 12), unit["energy"]) + ("" if conserved else " at t = 0")
    verdict = "no certificate" if certificate is None else verdict_of(certificate)
    if certificate is not None and orbit.record is not None:
        verdict = f"as its file has it, not checked here: {verdict}"
    called = names or [f"q{k + 1}" for k in range(len(orbit.winding))]
    turns = [f"{name} {k}" for name, k in zip(called, orbit.winding, strict=False) if k]
    late = math.nan if certificate is None else certificate.period_error
    return {
        "period": with_unit(number(orbit.period, 12), unit["time"]),
        **({"period known to": with_unit(number(late, 1), unit["time"])} if late > 0 else {}),
        "frequency": with_unit(number(1.0 / orbit.period, 8), unit["time"] and f"1/{unit['time']}"),
        **({"energy" if conserved else "energy, not conserved": energy} if level else {}),
        **({"action": with_unit(number(orbit.action, 10), unit["action"])} if level else {}),
        "closure": number(orbit.closure, 2),
        "largest multiplier": number(largest(orbit)) if orbit.floquet_multipliers.size else "none but the trivial ones",
        "turns": ", ".join(turns).replace("theta", "\N{GREEK SMALL LETTER THETA}"),
        "stability": orbit.stability,
        "symmetry": orbit.symmetry,
        "certificate": verdict,
    }


def numbers(orbit: Orbit) -> list[tuple[str, str]]:
    """The facts that stand beside an orbit's pictures."""
    known = facts(orbit)
    beside = ("period", "energy", "closure", "stability", "symmetry", "largest multiplier", "certificate")
    return [(name, known[name]) for name in beside if name in known]


def told(orbit: Orbit, digits: int) -> str:
    """Period, energy where there is one, verdict and symmetry in one line."""
    unit = units(orbit.system)
    level = (
        f", E = {with_unit(f'{orbit.energy:.{digits - 2}g}', unit['energy'])}" if math.isfinite(orbit.energy) else ""
    )
    symmetry = "" if orbit.symmetry == "none" else f", {orbit.symmetry.replace('+', ' and ')}"
    return f"T = {with_unit(f'{orbit.period:.{digits}g}', unit['time'])}{level}, {orbit.stability}{symmetry}"
