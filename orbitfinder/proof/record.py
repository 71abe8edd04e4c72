"""The `proof` entry of an orbit.json: what was proved and with which settings, and its replay."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orbitfinder._runtime import __version__
from orbitfinder.errors import InputError, shortened
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import FLINT, arb, precision
from orbitfinder.proof.theorem import STATEMENT, Options, Progress, Proof, prove
from orbitfinder.records.orbit import Orbit, read_document, recorded_proof
from orbitfinder.records.reading import read_as, write_json

DIGITS = 30
"""Decimal places of the centres of enclosures in a record"""
PHASE = 1e-6
"""Largest difference, in periods, between a recorded phase and the recomputed one (a minimum found to 1e-9)"""
NUMBER = r"\[?[-+]?\d[-+\d.e/ ]*\]?"
"""A decimal, or a ball such as [1.25 +/- 3e-10]"""


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
            "versions": {"orbitfinder": __version__, "python-flint": FLINT},
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
        "energy": None if proof.energy is None else enclosure(proof.energy),
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
    """Put the entry into an orbit.json; everything else in the file, its digest included, stays as it is.

    Raises `InputError` where the file holds another orbit by now.
    """
    document = read_document(path) | {"proof": entry(proof)}
    if proof.proved and recorded_proof(document) is None:
        raise InputError(f"{path}: changed while it was proved, the proof is not recorded; prove it again")
    write_json(path, document)


def read_entry(orbit: Orbit, path: Path) -> Mapping[str, Any]:
    """The entry of an orbit, read from a path. `InputError` when there is none, or it is of another theorem."""
    found = orbit.proof
    if found is None:
        raise InputError(f"{path}: proof: missing; prove the orbit first: orbitfinder prove {path}")
    if found.get("theorem") != STATEMENT:
        raise InputError(
            f"{path}: proof.theorem: version {found.get('theorem')!r}, this orbitfinder proves version {STATEMENT}; "
            f"prove it again: orbitfinder prove {path}"
        )
    return found


@dataclass(frozen=True)
class Recorded:
    """What a `proof` entry must hold to be replayed; the enclosures are compared by `_meet`."""

    order: int
    bits: int
    tolerance: float
    symmetry: str
    segments: int
    proved: bool
    steps: int
    box_radius: float
    enclosure_radius: float
    contraction: float
    phase: float
    distance: float
    period_distance: float
    minimal_period: Mapping[str, Any]
    stability: str
    stability_reason: str


def options_of(found: Mapping[str, Any]) -> Options:
    """The options that a recorded proof was made with. Raises `InputError`."""
    known = read_as(Recorded, found, "proof: malformed entry", "prove the orbit again")
    return checked(Options(known.order, known.bits, known.tolerance, symmetry=known.symmetry, segments=known.segments))


def checked(options: Options) -> Options:
    """The same options, or `InputError` naming the one that is out of range."""
    for name, value, low, high in (
        ("order", options.order, 10, 120), ("bits", options.bits, 64, 2000),
        ("segments", 1 if options.segments is None else options.segments, 1, 100),
    ):  # fmt: skip
        if not low <= value <= high:
            raise InputError(f"{name}: must be from {low} to {high}, got {value}; the default is fine for most orbits")
    if not 1e-40 <= options.tolerance < 1e-6:
        raise InputError(f"tolerance: must be from 1e-40 to 1e-6, got {options.tolerance}; the default is 1e-18")
    return options


def replay(
    orbit: Orbit, found: Mapping[str, Any], model: Model | None = None, progress: Progress | None = None
) -> tuple[Proof, list[str]]:
    """The proof done again with the recorded settings, and every recorded claim that it contradicts."""
    options = options_of(found)
    proof = prove(orbit, model, options, progress)
    if not proof.proved:
        return proof, [proof.reason]
    return proof, contradictions(found, entry(proof))


def contradictions(found: Mapping[str, Any], fresh: Mapping[str, Any]) -> list[str]:
    """Every claim of a recorded entry that the entry of the proof done again does not bear out."""
    with precision(max(fresh["bits"], 4 * DIGITS)):
        return [f"{name}: recorded {shortened(repr(found.get(name)), 80)}, found {shortened(repr(fresh[name]), 80)}"
                for name, same in COMPARED.items() if not same(found.get(name), fresh[name])]  # fmt: skip


def _close(recorded: Any, fresh: float) -> bool:
    """True for a number that another machine's round-off could have made of it: within a factor of 2."""
    return isinstance(recorded, (int, float)) and 0.5 * fresh <= recorded <= 2 * fresh


def _wider(recorded: Any, fresh: float) -> bool:
    """True for a distance that claims no more than the theorem asks and not much less than was found.

    It is made of round-off: from machine to machine it differs by factors of ten.
    """
    return isinstance(recorded, (int, float)) and fresh / 100 <= recorded <= Options.nearness


def _at_least(recorded: Any, fresh: float) -> bool:
    """True when a recorded radius claims no larger a box than the one proved again (to rounding)."""
    return isinstance(recorded, float) and 0 < recorded <= fresh * (1 + 1e-6)


def _minimal(recorded: Any, fresh: Mapping[str, Any]) -> bool:
    """True when the period was recorded as minimal, proved against about as many divisors."""
    name = "divisors_excluded_up_to"
    return recorded.get("proved") is True and _close(recorded.get(name), fresh[name])


def _same_words(recorded: Any, fresh: str) -> bool:
    """True for the same sentence, whatever the last digits of the numbers in it."""
    return isinstance(recorded, str) and re.sub(NUMBER, "#", recorded) == re.sub(NUMBER, "#", fresh)


def _meet(recorded: Any, fresh: Any) -> bool:
    """True when recorded enclosures overlap the recomputed ones, entry by entry."""
    if fresh is None:
        return recorded is None
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


COMPARED: dict[str, Callable[[Any, Any], bool]] = {
    **dict.fromkeys(("proved", "reason", "symmetry", "segments", "stability"), operator.eq),
    **dict.fromkeys(("period", "energy", "state", "nodes", "unfolding", "multipliers"), _meet),
    **dict.fromkeys(("contraction", "enclosure_radius", "steps"), _close),
    **dict.fromkeys(("distance", "period_distance"), _wider),
    "box_radius": _at_least,
    "phase": lambda recorded, fresh: abs((recorded - fresh + 0.5) % 1.0 - 0.5) < PHASE,
    "minimal_period": _minimal,
    "stability_reason": _same_words,
}
"""What a replay compares, which is all that a record claims, and how; the rest says how it was made and when."""
