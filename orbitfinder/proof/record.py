"""The `proof` entry of an orbit.json: what was proved and with which settings, and its replay."""

from __future__ import annotations

import math
import operator
import re
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from decimal import Context, Decimal, Inexact, InvalidOperation, localcontext
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime.cluster import home
from orbitfinder.errors import InputError, IntegrationError, shortened
from orbitfinder.mechanics.model import Model
from orbitfinder.proof import theorem
from orbitfinder.proof.balls import arb, precision, why_not
from orbitfinder.proof.theorem import (
    STATEMENT,
    NotProved,
    Options,
    Progress,
    Proof,
    Proving,
    checked,
    chosen_options,
    provable_model,
    proved_until,
)
from orbitfinder.records.orbit import Orbit, read_document, recorded_proof
from orbitfinder.records.reading import Entries, Table, read_as, write_json
from orbitfinder.records.registry import load_orbit

Record = TypeVar("Record")
Same = Callable[[Any, Any], bool]
DIGITS = 30
"""Decimal places of the centres of enclosures in a record"""
MARGIN = 2.0
"""Radii are recorded wider than they are found by this factor: a replay elsewhere has other round-off"""
EARLIER = 0.3
"""Share by which the contraction found may exceed the one in a record of another version: other series and steps make
it up to 1.27 times as large (measured on the orbits of Lorenz and of pendulums that 0.1 had proved)"""
LOOSEST = 0.1
"""Radius beyond which a recorded ball claims next to nothing, unless no smaller one is found; relative above 1"""


def enclosure(ball: Any, digits: int = DIGITS, margin: float = 1.0) -> Entries:
    """A ball as {"value": decimal, "radius": float}: it lies within `radius` / margin of the decimal as written."""
    text = ball.mid().str(digits, radius=False)
    apart = (ball - arb(text)).abs_upper()
    return {"value": text, "radius": margin * math.nextafter(float(apart), math.inf)}


def in_digits(ball: Table) -> str:
    """A recorded ball with the digits that it is good for."""
    places = min(max(0, 1 - math.floor(math.log10(ball["radius"]))), DIGITS)
    return f"{Decimal(ball['value']):.{places}f} +/- {ball['radius']:.1g}"


def entry(proof: Proof, margin: float = MARGIN, digits: int = DIGITS) -> Entries:
    """The JSON form of a proof."""
    with precision(max(proof.settings.bits, 4 * digits)):
        document = {
            "theorem": STATEMENT,
            "proved": proof.proved,
            "reason": proof.reason,
            "symmetry": proof.symmetry,
            "order": proof.settings.order,
            "bits": proof.settings.bits,
            "tolerance": proof.settings.tolerance,
            "wall_time": round(proof.wall_time, 1),
            "versions": proof.versions,
        }
        return document | (_proved(proof, margin, digits) if proof.proved else {})


def _proved(proof: Proof, margin: float, digits: int) -> Entries:
    assert proof.stability is not None
    wide = partial(enclosure, digits=digits, margin=margin)
    return {
        "segments": proof.segments,
        "steps": proof.steps,
        "box_radius": proof.radius,
        "enclosure_radius": margin * proof.tightness,
        "contraction": proof.contraction,
        "energy": None if proof.energy is None else wide(proof.energy),
        "period": wide(proof.period),
        "state": [wide(x) for x in proof.state],
        "phase": proof.phase,
        "nodes": [[wide(x) for x in node] for node in proof.nodes],
        "unfolding": None if proof.unfolding is None else wide(proof.unfolding),
        "distance": margin * proof.distance,
        "period_distance": margin * proof.period_distance,
        "minimal_period": {"proved": proof.minimal, "divisors_excluded_up_to": proof.divisors},
        "multipliers": [[wide(mu.real), wide(mu.imag)] for mu in proof.stability.multipliers],
        "stability": proof.stability.verdict,
        "stability_reason": proof.stability.reason,
    }


def proving(asked: Table) -> Proving:
    """How orbits are proved as is asked. Raises `InputError`."""
    options = chosen_options(asked)
    return Proving(lambda orbit, model, say: theorem.prove(orbit, model, options, say), entry, read=load_orbit)


def proved_entry(orbit: Orbit, folder: str | None, options: Options) -> tuple[Entries, list[str]]:
    """The entry of the proof of an orbit, whose system a module of a trusted folder may make, and whether it is proved
    in a line: a task that travels."""
    proof = proved_until(lambda proof: True, orbit, provable_model(orbit, home(folder)), options, None)
    return entry(proof), proof.lines[:1]


def write_entry(path: Path, proof: Table) -> None:
    """Put the entry into an orbit.json; everything else in the file, its digest included, stays as it is.

    Raises `InputError` where the file holds another orbit by now.
    """
    document = read_document(path) | {"proof": proof}
    if proof["proved"] and recorded_proof(document) is None:
        raise InputError(f"{path}: changed while it was proved, the proof is not recorded; prove it again")
    write_json(path, document)


def read_entry(orbit: Orbit, path: Path) -> Table:
    """The entry of an orbit, read from a path. `InputError` when there is none, or it is of another theorem."""
    recorded = orbit.proof
    if recorded is None:
        raise InputError(f"{path}: proof: missing; prove the orbit first: orbitfinder prove {path}")
    if recorded.get("theorem") != STATEMENT:
        raise InputError(
            f"{path}: proof.theorem: version {recorded.get('theorem')!r}, this orbitfinder proves version {STATEMENT}; "
            f"prove it again: orbitfinder prove {path}"
        )
    return recorded


@dataclass(frozen=True)
class Recorded:
    """What a `proof` entry must hold to be replayed; the enclosures are compared by `holds`."""

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
    minimal_period: Table
    stability: str
    stability_reason: str


def options_of(recorded: Table) -> Options:
    """The options that a recorded proof was made with. Raises `InputError`."""
    known = read_as(Recorded, recorded, "proof: malformed entry", "prove the orbit again")
    if known.proved and not known.enclosure_radius <= known.box_radius:
        raise InputError(
            f"proof.box_radius: {known.box_radius:g} is less than proof.enclosure_radius {known.enclosure_radius:g}, "
            "so that the box need not hold the orbit; prove the orbit again"
        )
    chosen = {"symmetry": known.symmetry, "segments": known.segments, "phase": known.phase % 1.0}
    with suppress(KeyError, TypeError, ValueError):
        nodes = np.array([[float(ball["value"]) for ball in node] for node in recorded["nodes"]])
        if nodes.ndim == 2 and len(nodes) == known.segments and np.all(np.isfinite(nodes)):
            chosen["begun"] = nodes, float(recorded["period"]["value"])
    return checked(Options(known.order, known.bits, known.tolerance, **chosen))


def replay(orbit: Orbit, recorded: Table, model: Model | None = None) -> tuple[Proof, list[str]]:
    """The proof done again with the recorded settings, and every recorded claim that it does not prove.

    A ball that is not inside the recorded one, as where that was written without a margin, is made smaller: it then is,
    or the recorded one is false or more than can be proved.
    """
    wrong: dict[str, str] | None = None

    def borne(proof: Proof) -> bool:
        nonlocal wrong
        fresh = entry(proof, 1.0, 2 * DIGITS)
        elsewhere = (
            {"contraction": partial(bounding, share=EARLIER)} if recorded.get("versions") != fresh["versions"] else {}
        )
        now = contradictions(recorded, fresh, COMPARED | elsewhere)
        wrong = now if wrong is None else {name: said for name, said in now.items() if name in wrong}
        return not wrong or not wrong.keys() <= ENCLOSED

    proof = proved_until(borne, orbit, model, options_of(recorded), None)
    return proof, list((wrong or {}).values()) if proof.proved else [proof.reason]


def replayed(path: Path, trusted: Path | None, _: Progress) -> tuple[Proof, list[str], str]:
    """The proof in the file of an orbit, or FILE#K, done again (see `Kind.replay`)."""
    orbit = load_orbit(path)
    proof, wrong = replay(orbit, read_entry(orbit, path), provable_model(orbit, trusted))
    return proof, wrong, proof.stability.verdict if proof.stability else ""


def contradictions(recorded: Table, fresh: Table, compared: Mapping[str, Same] | None = None) -> dict[str, str]:
    """What is wrong with each claim of a recorded entry that the proof done again, written as found, does not prove;
    `compared` says which claims there are and how they are told, `COMPARED` if absent."""
    return {
        name: f"{name}: recorded {shortened(repr(recorded.get(name)), 80)}, found {shortened(repr(fresh[name]), 80)}"
        for name, same in (compared or COMPARED).items() if not same(recorded.get(name), fresh[name])
    }  # fmt: skip


def done_again(record: Record, concluded: Callable[[], Record]) -> Record:
    """What a record of its own file says when it is proved again, or why it cannot be, and how long that took."""
    began = time.perf_counter()
    try:
        fresh = concluded()
    except (NotProved, IntegrationError, ZeroDivisionError) as error:
        fresh = replace(record, proved=False, reason=why_not(error))  # type: ignore[type-var]
    return timed(fresh, began)


def timed(record: Record, began: float) -> Record:
    """The record with how long it took since then (s)."""
    return replace(record, wall_time=round(time.perf_counter() - began, 1))  # type: ignore[type-var]


def close(recorded: Any, fresh: float, factor: float = 2.0) -> bool:
    """True for a number that another machine's round-off, or integrator, could have made of it: within a factor."""
    return isinstance(recorded, (int, float)) and fresh / factor <= recorded <= factor * fresh


def bounding(recorded: Any, fresh: float, share: float = 0.05, rounded: float = 1e-12) -> bool:
    """True for a contraction below 1 and not below what is found; a wider bound is true as well.

    By other series and steps it is another bound of the same norm, so that a `share` is allowed. On another processor
    C, a float inverse, is another, which changes it by 2e-8, or wholly where derivatives hardly change over the box and
    it is `rounded` off from 1 - 1.
    """
    return isinstance(recorded, (int, float)) and fresh <= (1 + share) * recorded + rounded and recorded < 1


def _wider(recorded: Any, fresh: float) -> bool:
    """True for a bound of distances that was not exceeded, and is not far above what the theorem asks."""
    return isinstance(recorded, (int, float)) and fresh <= recorded <= MARGIN * Options.nearness


def at_least(recorded: Any, fresh: float) -> bool:
    """True when a recorded radius claims no larger a box than the one proved again (to rounding)."""
    return isinstance(recorded, float) and 0 < recorded <= fresh * (1 + 1e-6)


def _minimal(recorded: Any, fresh: Table) -> bool:
    """True when the period was recorded as minimal, proved against no more divisors than now, but for round-off: those
    up to fewer are excluded as well. Longer steps leave more of them to be looked at."""
    divisors = recorded.get("divisors_excluded_up_to")
    most = 4 * fresh["divisors_excluded_up_to"]
    return recorded.get("proved") is True and isinstance(divisors, int) and 0 < divisors <= most


def _same_words(recorded: Any, fresh: str) -> bool:
    """True for the same sentence, whose numbers, balls such as [1.25 +/- 3e-10] too, could be the same."""
    number = r"\[?[-+]?\d[-+\d.e/ ]*\]?"
    if not (isinstance(recorded, str) and re.sub(number, "#", recorded) == re.sub(number, "#", fresh)):
        return False
    old, new = (re.findall(number, text) for text in (recorded, fresh))
    with suppress(ValueError):
        return all(arb(a.strip()).overlaps(arb(b.strip())) for a, b in zip(old, new, strict=True))
    return False


def holds(recorded: Any, fresh: Any) -> bool:
    """True when the recomputed enclosures lie inside the recorded ones, entry by entry, in exact arithmetic."""
    if fresh is None:
        return recorded is None
    if isinstance(fresh, list):
        same = isinstance(recorded, list) and len(recorded) == len(fresh)
        return same and all(holds(a, b) for a, b in zip(recorded, fresh, strict=True))
    try:
        (value, radius), (centre, within) = (
            (Decimal(str(ball["value"])), Decimal(float(ball["radius"]))) for ball in (recorded, fresh)
        )
        with localcontext(Context(3000, traps=[Inexact, InvalidOperation])):  # digits that hold the sum of two floats
            loosest = max(Decimal(LOOSEST) * max(Decimal(1), abs(centre)), 4 * within)
            return abs(value - centre) + within <= radius <= loosest
    except (KeyError, TypeError, ValueError, ArithmeticError):
        return False


def holds_each(recorded: Any, fresh: list[Any]) -> bool:
    """The same of multipliers in some order: theirs is that of blurred absolute values."""
    if not isinstance(recorded, list) or len(recorded) != len(fresh):
        return False
    apart = np.array([[not holds(a, b) for b in fresh] for a in recorded]).reshape(len(fresh), len(fresh))
    return not apart[linear_sum_assignment(apart)].any()


COMPARED: dict[str, Same] = {
    **dict.fromkeys(("proved", "reason", "symmetry", "segments", "stability"), operator.eq),
    **dict.fromkeys(("period", "energy", "state", "nodes", "unfolding"), holds),
    "multipliers": holds_each,
    "contraction": bounding,
    "steps": partial(close, factor=2.5),
    **dict.fromkeys(("distance", "period_distance", "enclosure_radius"), _wider),
    "box_radius": at_least,
    "phase": lambda recorded, fresh: (
        abs((recorded - fresh + 0.5) % 1.0 - 0.5) < 1e-6
    ),  # periods: a minimum, known to 1e-9
    "minimal_period": _minimal,
    "stability_reason": _same_words,
}
"""What a replay compares, which is all that a record claims, and how; the rest says how it was made and when."""
ENCLOSED = {name for name, same in COMPARED.items() if same in (holds, holds_each, _wider, bounding)}
"""What a further round of the proof, in smaller balls and with longer series, may still bear out"""
