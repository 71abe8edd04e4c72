"""From an event of a family on disk to the families that leave there."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.families.branches import SWITCHABLE, switch
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.start import Start, curve_of
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import Event, Family, load_family


@dataclass(frozen=True)
class Branch:
    """The start of a family that leaves another one: which family, which of its events, which of the branches there."""

    __repr__ = brief("name", "event")

    start: Start
    family: str
    event: Event
    number: int
    branch: int
    name: str

    def described(self) -> dict[str, Any]:
        """The same in plain numbers."""
        return {
            "family": self.family, "event": self.number, "branch": self.branch, "kind_of_event": self.event.kind,
            "order": self.event.order, "energy": self.event.energy, "period": self.event.period,
        }  # fmt: skip


def switch_branch(
    family: Family | str | Path,
    event: int,
    branch: int = 1,
    *,
    settings: FamilySettings | None = None,
    model: Model | None = None,
) -> Branch:
    """The `branch`-th of the branches that leave a family (or its family.json) at the event with this index.

    `follow_family` follows it. Raises what `branches` raises, and `InputError` where there are fewer branches.
    """
    found = branches(family, event, settings, model)
    if not 1 <= branch <= len(found):
        raise InputError(f"--branch: {branch} asked for, {len(found)} found at event {event}; give 1 to {len(found)}")
    return found[branch - 1]


def branches(
    family: Family | str | Path, event: int, settings: FamilySettings | None = None, model: Model | None = None
) -> list[Branch]:
    """Every branch that leaves a family at its event with this index, named <family>-<event>-<branch>.

    `model` is the family's where no file describes it. Raises `InputError` (also for events that nothing
    leaves from, with a list of those that something does) and `ConvergenceError` when no branch was found.
    """
    where = family.name if isinstance(family, Family) else str(family)
    family = family if isinstance(family, Family) else load_family(family)
    chosen = _event(family, event, where)
    if not chosen.shooting_nodes.size:
        raise InputError(f"{where}: family.npz is not beside it; continue the family again to switch from it")
    settings = replace(settings or FamilySettings(), parameter=family.parameter)
    curve = curve_of(family.curve, model or build_model(family.system), settings)
    starts = switch(curve, chosen, settings)
    if not starts:
        raise ConvergenceError(f"{family.name}: no branch was found at event {event} ({described(family, event)})")
    return [
        Branch(start, family.name, chosen, event, k, f"{family.name}-{event}-{k}") for k, start in enumerate(starts, 1)
    ]


def _event(family: Family, number: int, where: str) -> Event:
    if not family.curve:
        raise InputError(f"{where}: curve: missing, an older orbitfinder wrote this file; continue the family again")
    known = [k for k, one in enumerate(family.events) if one.kind in SWITCHABLE]
    if number in known:
        return family.events[number]
    listed = "; ".join(described(family, k) for k in known) or "this family has none"
    raise InputError(f"--switch: no branch leaves at event {number}; choose one of {listed}")


def described(family: Family, number: int) -> str:
    """An event in a few words."""
    one = family.events[number]
    detail = f" {one.detail}" if one.detail else ""
    return f"{number}: {one.kind}{detail} at {family.parameter} {one.parameter:.6g}"
