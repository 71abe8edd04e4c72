"""The `proof` entry of an orbit.json: what was proved and with which settings, and its replay."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import Model
from orbitfinder.periodic.orbit import Orbit, read_document, write_atomically
from orbitfinder.proof.balls import arb, flint, precision
from orbitfinder.proof.enclosure import Settings
from orbitfinder.proof.theorem import STATEMENT, Options, Progress, Proof, prove
from orbitfinder.version import __version__

DIGITS = 30
"""Decimal places of the centres of enclosures in a record"""


def enclosure(ball: Any, digits: int = DIGITS) -> dict[str, Any]:
    """A ball as {"value": decimal, "radius": float}: it lies within `radius` of the decimal as written."""
    text = ball.mid().str(digits, radius=False)
    apart = (ball - arb(text)).abs_upper()
    return {"value": text, "radius": math.nextafter(float(apart), math.inf)}


def entry(proof: Proof) -> dict[str, Any]:
    """The JSON form of a proof."""
    with precision(max(proof.settings.bits, 4 * DIGITS)):
        document: dict[str, Any] = {
            "theorem": STATEMENT,
            "proved": proof.proved,
            "reason": proof.reason,
            "symmetry": proof.symmetry,
            "order": proof.settings.order,
            "bits": proof.settings.bits,
            "tolerance": proof.settings.tolerance,
            "wall_time": round(proof.wall_time, 1),
            "versions": {"orbitfinder": __version__, "python-flint": flint.__version__},
        }
        return document | (_proved(proof) if proof.proved else {})


def _proved(proof: Proof) -> dict[str, Any]:
    assert proof.stability is not None
    return {
        "segments": proof.segments,
        "steps": proof.steps,
        "box_radius": proof.radius,
        "enclosure_radius": proof.tightness,
        "contraction": proof.contraction,
        "energy": enclosure(proof.energy),
        "period": enclosure(proof.period),
        "state": [enclosure(x) for x in proof.state],
        "phase": proof.phase,
        "nodes": [[enclosure(x) for x in node] for node in proof.nodes],
        "unfolding": None if proof.unfolding is None else enclosure(proof.unfolding),
        "distance": proof.distance,
        "period_distance": proof.period_distance,
        "minimal_period": {"proved": proof.minimal, "divisors_excluded_up_to": proof.divisors},
        "multipliers": [[enclosure(mu.real, 18), enclosure(mu.imag, 18)] for mu in proof.stability.multipliers],
        "stability": proof.stability.verdict,
        "stability_reason": proof.stability.reason,
    }


def write_entry(path: Path, proof: Proof) -> None:
    """Put the entry into an orbit.json; everything else in the file, its digest included, stays as it is."""
    document = read_document(path)
    document["proof"] = entry(proof)
    write_atomically(path, (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())


def read_entry(path: Path) -> dict[str, Any]:
    """The entry of an orbit.json. `InputError` when there is none, or it is of another theorem."""
    found = read_document(path).get("proof")
    if not isinstance(found, dict):
        raise InputError(f"{path}: proof: missing; prove the orbit first: orbitfinder prove {path}")
    if found.get("theorem") != STATEMENT:
        raise InputError(
            f"{path}: proof.theorem: version {found.get('theorem')!r}, this orbitfinder proves version {STATEMENT}; "
            f"prove it again: orbitfinder prove {path}"
        )
    return found


def options_of(found: Mapping[str, Any]) -> Options:
    """The options that a recorded proof was made with."""
    try:
        settings = Settings(order=int(found["order"]), bits=int(found["bits"]), tolerance=float(found["tolerance"]))
        options = Options(settings, str(found["symmetry"]), int(found["segments"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"proof: malformed entry ({error}); prove the orbit again") from error
    return checked(options)


def checked(options: Options) -> Options:
    """The same options, or `InputError` naming the one that is out of range."""
    settings = options.settings
    for name, value, low, high in (
        ("order", settings.order, 4, 400), ("bits", settings.bits, 64, 20000),
        ("segments", 1 if options.segments is None else options.segments, 1, 1000),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(f"{name}: must be from {low} to {high}, got {value}; the default is fine for most orbits")
    if not 0 < settings.tolerance < 1e-6:
        raise InputError(f"tolerance: must be between 0 and 1e-6, got {settings.tolerance}; the default is 1e-18")
    return options


def replay(
    orbit: Orbit, found: Mapping[str, Any], model: Model | None = None, progress: Progress | None = None
) -> tuple[Proof, list[str]]:
    """The proof done again with the recorded settings, and every recorded claim that it contradicts."""
    options = options_of(found)
    proof = prove(orbit, model, options, progress)
    if not proof.proved:
        return proof, [proof.reason]
    fresh = entry(proof)
    wrong = [f"{name}: recorded {found.get(name)!r}, found {fresh[name]!r}"
             for name in ("proved", "stability") if found.get(name) != fresh[name]]  # fmt: skip
    if not (isinstance(minimal := found.get("minimal_period"), dict) and minimal.get("proved") is True):
        wrong.append(f"minimal_period: recorded {minimal!r}, proved now")
    with precision(max(options.settings.bits, 4 * DIGITS)):
        wrong += [f"{name}: the recorded enclosure and the recomputed one do not meet"
                  for name in ("period", "energy", "state", "multipliers")
                  if not _meet(found.get(name), fresh[name])]  # fmt: skip
    if not _at_least(found.get("box_radius"), fresh["box_radius"]):
        wrong.append(f"box_radius: recorded {found.get('box_radius')!r}, found {fresh['box_radius']!r}")
    return proof, wrong


def _at_least(recorded: Any, fresh: float) -> bool:
    """True when a recorded radius claims no larger a box than the one proved again (to rounding)."""
    return isinstance(recorded, float) and 0 < recorded <= fresh * (1 + 1e-6)


def _meet(recorded: Any, fresh: Any) -> bool:
    """True when recorded enclosures overlap the recomputed ones, entry by entry."""
    if isinstance(fresh, list):
        same = isinstance(recorded, list) and len(recorded) == len(fresh)
        return same and all(_meet(a, b) for a, b in zip(recorded, fresh, strict=True))
    loosest = max(1e-3, 2 * fresh["radius"])
    try:
        return bool(_ball(recorded, loosest).overlaps(_ball(fresh, loosest)))
    except (KeyError, TypeError, ValueError):
        return False


def _ball(found: Mapping[str, Any], loosest: float) -> Any:
    """A recorded enclosure; `ValueError` when it is too loose to claim anything."""
    if not 0 <= float(found["radius"]) <= loosest:
        raise ValueError("not an enclosure")
    return arb(str(found["value"]), float(found["radius"]))
