"""Every kind of end that a family or a curve may have: what its record says, and what is to be done there.

One that is not here is no end, unless it is a kind of event, in which families of hybrid orbits end: a grazing, say.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any

from orbitfinder._runtime.keeping import STOPPED
from orbitfinder._runtime.rooms import loaded
from orbitfinder.errors import closest


@dataclass(frozen=True)
class EndKind:
    """A kind of end: the pattern its sentence `begins` with, the fields that it `says` and those that it `may` say.

    `asked` for, so that it moves with what is asked; `lengthened` by more points; `closed`, so that there is no other
    direction; `outside`, where the last orbit that was met is none of the family's; or `stuck`, where another method
    may go on.
    """

    begins: str = ""
    says: str = ""
    may: str = ""
    asked: bool = False
    lengthened: bool = False
    closed: bool = False
    outside: bool = False
    stuck: bool = False


ENDS = {
    "target": EndKind("reached ", may="parameter", asked=True),
    "point limit": EndKind(r"\d+ points? w", lengthened=True),
    "returned": EndKind("a closed family", closed=True),
    "equilibrium": EndKind("the orbits shrink to the equilibrium", may="parameter period error", outside=True),
    "relative equilibrium": EndKind("the orbits shrink to a relative equilibrium", outside=True),
    "hopf": EndKind("the orbits shrink to the Hopf point", "parameter period error"),
    "homoclinic": EndKind("the period blows up", may="parameter period error saddles"),
    "heteroclinic": EndKind("the period blows up", "parameter period error saddles"),
    "saddle-node": EndKind("the period blows up", "parameter period error saddles"),
    "merged": EndKind("joins a family", may="parameter period error joined"),
    "canard": EndKind("a canard explosion", "parameter period error", stuck=True),
    "singularity": EndKind("the (motion comes near a singularity|branch leaves the domain of its)", stuck=True),
    "dead point": EndKind(),
    "step underflow": EndKind(stuck=True),
    STOPPED: EndKind(),
}
"""Every kind by its name"""


def end_kind(name: str) -> EndKind:
    """What is to be done at a kind of end."""
    return ENDS.get(name, EndKind())


def stuck(record: Any, fewest: int = 4) -> str:
    """Why a family or a branch of fewer points than that cannot go on; "" of others, which were followed."""
    reasons = [end.reason for end in record.ends if end_kind(end.kind).stuck]
    return reasons[0] if reasons and len(record.points) < fewest else ""


def unknown_end(kind: str, events: Iterable[str]) -> str:
    """What is wrong with a kind of end of a family with events of these kinds; "" where there is such."""
    known = kind in {*ENDS, *events} or loaded("families.entries:is_kind")(kind)
    return "" if known else f"kind: no family ends in {kind[:60]!a}{closest(kind, ENDS)}"


def end_fault(end: Any, events: Iterable[str]) -> str:
    """What contradicts itself in an `End`, of a family with events of these kinds; "" where nothing does."""
    if fault := unknown_end(end.kind, events):
        return fault
    kind, said = end_kind(end.kind), (each.name for each in fields(end) if each.name not in ("kind", "reason"))
    told = [name for name in said if getattr(end, name) is not None]
    if missing := [name for name in kind.says.split() if name not in told]:
        return f"{missing[0]}: missing, which is solved for at an end of kind {end.kind}"
    if more := [name for name in told if name not in f"{kind.says} {kind.may}".split()]:
        return f"{more[0]}: there is none at an end of kind {end.kind}"
    meant = [name for name, each in ENDS.items() if each.begins and re.match(each.begins, end.reason)]
    if meant and end.kind not in meant:
        return f"kind: {end.kind}, where its reason says {meant[0]}: {end.reason[:60]!a}"
    return ""
