"""What `show` says of events: what breaks, what is born, and the options of `continue FILE` that follow them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import FAILURES
from orbitfinder.families.branches import left_at, rest_leaving, unled
from orbitfinder.families.curves import curves_through
from orbitfinder.families.entries import kind_of
from orbitfinder.families.equilibrium import Equilibria, RestEvent
from orbitfinder.families.rest_curves import FORMS
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.kind import BUILT_IN, build_model
from orbitfinder.mechanics.scales import lasting
from orbitfinder.records.family import Event, Family

RESTING = {
    "fold": "an eigenvalue is 0 and the parameter turns back: two equilibria come together and vanish",
    "branch_point": "an eigenvalue is 0 and another curve of equilibria crosses",
    "hopf": "a pair of eigenvalues crosses the imaginary axis: cycles of the period are born",
    "neutral_saddle": "two real eigenvalues are opposite: nothing is born",
}
"""What happens at events of equilibria"""


@dataclass(frozen=True)
class Happening:
    """An event, what happens there, the options that follow it."""

    __repr__ = brief("event", "what", "follow")

    event: Event | RestEvent
    what: str
    follow: tuple[str, ...]


def facts(record: Family | Equilibria) -> dict[str, Any]:
    """What is shown of a record: its entries, of its events what happens."""
    events = range(len(record.events))
    told = [_of_orbits(record, k) if isinstance(record, Family) else _of_rest(record, k) for k in events]
    counts = {"counts": record.counts} if isinstance(record, Family) else {}
    return counts | {entry.name: getattr(record, entry.name) for entry in fields(record)} | {"events": told}


def sentence(family: Family, k: int) -> str:
    """What happens at an event of a family: what its multipliers do, stability on either side, what is born."""
    event, kind = family.events[k], kind_of(family.events[k].kind)
    sides, words = family.sides[k], kind.words.replace(" q times", f" {event.order} times")
    told = [words, f"{sides[0]} before it, {sides[1]} after it" if sides[0] != sides[1] and all(sides) else ""]
    if kind.branches:
        born = f"born are orbits of period {lasting(event.order * event.period, family.system, 9)}"
        breaks = f"what breaks is {event.symmetry.replace('+', ' or ')}, which these orbits have"
        told.append(born if event.order > 1 else breaks if event.symmetry != NONE.name else "")
    return "; ".join(filter(None, told))


def _of_orbits(family: Family, k: int) -> Happening:
    event, kind, told = family.events[k], kind_of(family.events[k].kind), [sentence(family, k)]
    ways, leads = [], "test" not in family.curve and (kind.branches or kind.followed)
    if leads and (why := unled(family)):
        told.append(f"what leads on from it is not known by {why}")
    elif leads and event.shooting_nodes.size:
        ways += [f"--switch {k}"] if k in left_at(family) else []
        ways += _curve(family, k) if k in curves_through(family) and not kind.crosses else []
    elif leads:
        told.append("family.npz is not beside it: continue the family again to follow it")
    return Happening(event, "; ".join(filter(None, told)), _trusted(family.system, ways))


def _of_rest(rest: Equilibria, k: int) -> Happening:
    event = rest.events[k]
    ways = [f"--switch {k}"] if k in rest_leaving(rest) and not rest.curve else []
    ways += _curve(rest, k) if event.kind in FORMS and not rest.curve else []
    return Happening(event, RESTING.get(event.kind, ""), _trusted(rest.system, ways))


def _curve(record: Family | Equilibria, k: int) -> list[str]:
    """The option that follows an event in two parameters, if the system has a second."""
    own, given = record.parameter, record.system.get("arguments", {})
    try:
        names = [*build_model(record.system).parameter_names, "energy", "period"]
    except FAILURES:
        names = [name for name, value in given.items() if isinstance(value, (int, float))]
    others = [name for name in names if name not in (*record.parameters, "energy", "period")]
    return [f"--curve {k} --parameters {own},{others[0]}"] if own in names and others else []


def _trusted(system: Mapping[str, Any], ways: list[str]) -> tuple[str, ...]:
    return tuple(way if system.get("module", BUILT_IN) == BUILT_IN else f"{way} --trust" for way in ways)
