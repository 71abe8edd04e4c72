"""Pages on which one orbit after the other is picked from a plot: families and atlases."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from orbitfinder.site.gather import evenly
from orbitfinder.site.motion import Films, packed
from orbitfinder.site.orbits import Entry
from orbitfinder.site.text import EVENTS, mechanism, number, plural, symmetry_words

MOST_POINTS = 60
"""Points of a family that can be seen moving; all points are on the plot."""
MOST_EVENTS = 60
UNITS = {"energy": "J", "period": "s"}


def family_items(family: Mapping[str, Any], films: Films) -> list[dict[str, Any]]:
    """The points and events that can be picked, in order along the family."""
    points, events = family["points"], family["events"]
    found = [(_place(points[k], k), _item(family, points[k], films, "")) for k in spread(points, MOST_POINTS)]
    rare = [event for event in events if event.get("kind") != "resonance"]
    common = [event for event in events if event.get("kind") == "resonance"]
    kept = [rare[k] for k in evenly(len(rare), MOST_EVENTS)]
    kept += [common[k] for k in evenly(len(common), max(0, MOST_EVENTS - len(kept)))]
    for event in kept:
        about = _nearest(points, event) | dict(event)
        found.append(
            (_place(event, float(event.get("index", 0)) + 0.5), _item(family, about, films, event_words(event)))
        )
    return [item for _, item in sorted(found, key=lambda pair: pair[0])]


def spread(points: Sequence[Mapping[str, Any]], most: int) -> list[int]:
    """At most `most` points, equally far apart along the curve of energy, frequency and arclength, ends among them."""
    if len(points) <= most:
        return list(range(len(points)))
    table = np.array([[one["energy"], 1.0 / one["period"], _place(one, float(k))] for k, one in enumerate(points)])
    steps = np.linalg.norm(np.diff(table / np.maximum(np.ptp(table, axis=0), 1e-300), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, length[-1], most)
    return sorted({int(np.abs(length - one).argmin()) for one in wanted} | {0, len(points) - 1})


def _place(entry: Mapping[str, Any], default: float) -> float:
    return float(entry.get("arclength", default))


def _nearest(points: Sequence[Mapping[str, Any]], event: Mapping[str, Any]) -> dict[str, Any]:
    """What an event does not carry itself, from the point before it."""
    before = points[min(max(int(event.get("index", 0)), 0), len(points) - 1)]
    kept = {key: before[key] for key in ("energy", "stability", "floquet_multipliers") if key in before}
    return kept | {"value": event.get("parameter"), "action": None, "closure": None}


def event_words(event: Mapping[str, Any]) -> str:
    """An event in words: its kind and detail."""
    kind = str(event.get("kind", ""))
    return f"{EVENTS.get(kind, kind)} {event.get('detail', '')}".strip()


def _item(family: Mapping[str, Any], entry: Mapping[str, Any], films: Films, event: str) -> dict[str, Any]:
    motion = films.member(family["system"], entry)
    return {
        "energy": entry.get("energy"),
        "period": entry["period"],
        "value": entry.get("value"),
        "action": entry.get("action"),
        "closure": entry.get("closure"),
        "stability": entry.get("stability", ""),
        "symmetry": symmetry_words(str(entry.get("symmetry", "none"))),
        "multipliers": entry.get("floquet_multipliers"),
        "event": event,
        "kind": str(entry.get("kind", "")) if event else "",
        "motion": packed(motion) if motion else None,
    }


def family_data(family: Mapping[str, Any], films: Films) -> dict[str, Any]:
    """What the family page's script works with."""
    points = family["points"]
    columns = {name: [point[name] for point in points] for name in ("energy", "period", "action", "closure", "value")}
    return {
        "page": "family",
        "name": str(family["name"]),
        "parameter": str(family["parameter"]),
        "unit": UNITS.get(family["parameter"], ""),
        "columns": columns
        | {
            "stable": [point["stability"] != "unstable" for point in points],
            "largest": [_largest(point["floquet_multipliers"]) for point in points],
        },
        "items": family_items(family, films),
    }


def span(values: Sequence[float]) -> str:
    """The least and the largest of some numbers, or the one where they read alike."""
    low, high = number(min(values)), number(max(values))
    return low if low == high else f"{low} to {high}"


def _largest(pairs: Sequence[Sequence[float]]) -> float:
    return float(max((abs(complex(*pair)) for pair in pairs), default=1.0))


def family_values(family: Mapping[str, Any], items: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """What the template of a family page is filled with."""
    points, events = family["points"], family["events"]
    energies, periods = [p["energy"] for p in points], [p["period"] for p in points]
    unstable = sum(point["stability"] == "unstable" for point in points)
    listed = sum(bool(item["event"]) for item in items)
    left_out = f"{listed} of {len(events)} events are listed; resonances are left out first."
    summary = (
        f"{plural(len(points), 'orbit')} of the {mechanism(family['system'])}, {unstable} of them unstable, "
        f"and {plural(len(events), 'event')}. Energy {span(energies)} J, period {span(periods)} s. "
        f"Parameter: {family['parameter']}. All as orbitfinder continue recorded it; not checked here."
    )
    return {
        "family": family,
        "items": items,
        "columns": ["energy", "period"] if family["parameter"] in UNITS else ["value", "energy", "period"],
        "heads": {"value": str(family["parameter"]), "energy": "energy, J", "period": "period, s"},
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
