"""Pages on which one orbit after the other is picked from a plot: families and atlases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from orbitfinder.records.family import Event, Family, FamilyPoint
from orbitfinder.records.orbit import system_at
from orbitfinder.site.gather import evenly
from orbitfinder.site.motion import Films, packed
from orbitfinder.site.orbits import Entry
from orbitfinder.site.text import mechanism, number, plural, symmetry_words

MOST_POINTS = 60
"""Points of a family that can be seen moving; all points are on the plot."""
MOST_EVENTS = 60
UNITS = {"energy": "J", "period": "s"}


def family_items(family: Family, films: Films) -> list[dict[str, Any]]:
    """The points and events that can be picked, in order along the family."""
    found = [(family.points[k].arclength, _item(family.points[k], films)) for k in spread(family.points, MOST_POINTS)]
    rare = [event for event in family.events if event.kind != "resonance"]
    common = [event for event in family.events if event.kind == "resonance"]
    kept = [rare[k] for k in evenly(len(rare), MOST_EVENTS)]
    kept += [common[k] for k in evenly(len(common), max(0, MOST_EVENTS - len(kept)))]
    found += [(event.arclength, _event_item(family, event, films)) for event in kept]
    return [item for _, item in sorted(found, key=lambda pair: pair[0])]


def spread(points: Sequence[FamilyPoint], most: int) -> list[int]:
    """At most `most` points, equally far apart along the curve of energy, frequency and arclength, ends among them."""
    if len(points) <= most:
        return list(range(len(points)))
    table = np.array([[one.energy, 1.0 / one.period, one.arclength] for one in points])
    steps = np.linalg.norm(np.diff(table / np.maximum(np.ptp(table, axis=0), 1e-300), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, length[-1], most)
    return sorted({int(np.abs(length - one).argmin()) for one in wanted} | {0, len(points) - 1})


def event_words(event: Event) -> str:
    """An event in words: its kind and detail."""
    return f"{event.kind.replace('_', ' ')} {event.detail}".strip()


def _item(point: FamilyPoint, films: Films) -> dict[str, Any]:
    motion = films.member(point.system, point)
    return {
        "energy": point.energy,
        "period": point.period,
        "value": point.value,
        "action": point.action,
        "closure": point.closure,
        "stability": point.stability,
        "symmetry": symmetry_words(point.symmetry),
        "multipliers": [[mu.real, mu.imag] for mu in point.floquet_multipliers.tolist()],
        "event": "",
        "kind": "",
        "motion": packed(motion) if motion else None,
    }


def _event_item(family: Family, event: Event, films: Films) -> dict[str, Any]:
    """An event; what it does not carry itself is that of the point before it."""
    before = family.points[min(max(event.index, 0), len(family.points) - 1)]
    motion = films.member(system_at(family.system, event.free), event)
    return {
        "energy": event.energy,
        "period": event.period,
        "value": event.parameter,
        "action": None,
        "closure": None,
        "stability": before.stability,
        "symmetry": symmetry_words(event.symmetry),
        "multipliers": [[mu.real, mu.imag] for mu in before.floquet_multipliers.tolist()],
        "event": event_words(event),
        "kind": event.kind,
        "motion": packed(motion) if motion else None,
    }


def family_data(family: Family, films: Films) -> dict[str, Any]:
    """What the family page's script works with."""
    columns = {name: family.values(name).tolist() for name in ("energy", "period", "action", "closure", "value")}
    return {
        "page": "family",
        "name": family.name,
        "parameter": family.parameter,
        "unit": UNITS.get(family.parameter, ""),
        "columns": columns
        | {
            "stable": [point.stability != "unstable" for point in family.points],
            "largest": [max(map(abs, point.floquet_multipliers.tolist()), default=1.0) for point in family.points],
        },
        "items": family_items(family, films),
    }


def span(values: Sequence[float]) -> str:
    """The least and the largest of some numbers, or the one where they read alike."""
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low} to {high}"


def family_values(family: Family, items: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the template of a family page is filled with."""
    points, events = family.points, family.events
    energies, periods = family.values("energy").tolist(), family.values("period").tolist()
    unstable = sum(point.stability == "unstable" for point in points)
    listed = sum(bool(item["event"]) for item in items)
    left_out = f"{listed} of {len(events)} events are listed; resonances are left out first."
    summary = (
        f"{plural(len(points), 'orbit')} of the {mechanism(family.system)}, {unstable} of them unstable, "
        f"and {plural(len(events), 'event')}. Energy {span(energies)} J, period {span(periods)} s. "
        f"Parameter: {family.parameter}. All as orbitfinder continue recorded it; not checked here."
    )
    return {
        "family": family,
        "items": items,
        "columns": ["energy", "period"] if family.parameter in UNITS else ["value", "energy", "period"],
        "heads": {"value": family.parameter, "energy": "energy, J", "period": "period, s"},
        "listed": "" if listed == len(events) else left_out,
        "summary": summary,
    }


def atlas_data(name: str, entries: Sequence[Entry], linked: set[str]) -> dict[str, Any]:
    """What the atlas page's script works with; `linked` are the orbits that have a page of their own."""
    items = []
    for entry in entries:
        document = entry.document
        items.append({
            "title": entry.title,
            "mechanism": entry.mechanism,
            "energy": document["energy"],
            "period": document["period"],
            "action": document["action"],
            "closure": document["closure"],
            "stability": document["stability"],
            "symmetry": symmetry_words(document["symmetry"]),
            "multipliers": document["floquet_multipliers"],
            "largest": entry.largest,
            "motion": packed(entry.motion) if entry.motion else None,
            "page": f"../orbits/{entry.slug}.html" if entry.slug in linked else None,
        })  # fmt: skip
    return {"page": "atlas", "name": name, "items": items}


def atlas_values(entries: Sequence[Entry], total: int) -> dict[str, Any]:
    """What the template of an atlas page is filled with."""
    energies, periods = ([float(one.document[key]) for one in entries] for key in ("energy", "period"))
    kinds = sorted({one.mechanism for one in entries})
    unstable = sum(one.document["stability"] == "unstable" for one in entries)
    part = "" if total == len(entries) else f" Shown: {len(entries)}, evenly chosen in order of energy."
    summary = f"{plural(total, 'distinct orbit')} ({', '.join(kinds) or 'none yet'}).{part} {unstable} unstable."
    if entries:
        summary += f" Energy {span(energies)} J, period {span(periods)} s."
    summary += " All as the atlas records it; an orbit with a page of its own says there what was checked."
    return {"summary": summary} | choices(entries)


def choices(entries: Sequence[Entry]) -> dict[str, Any]:
    """The distinct values that a page's filters offer."""
    return {
        "mechanisms": sorted({one.mechanism for one in entries}),
        "stabilities": sorted({one.document["stability"] for one in entries}),
        "symmetries": sorted({one.document["symmetry"] for one in entries}),
    }
