"""The pages of orbits, families and atlases: what their templates are filled with and their scripts work with."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import plural
from orbitfinder.families.branches import left_at
from orbitfinder.families.entries import kind_of
from orbitfinder.families.happening import sentence
from orbitfinder.families.members import response
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import SI, given_units, unit_along, units
from orbitfinder.problemfile.write import orbit_name, orbit_text
from orbitfinder.records.certificate import Check
from orbitfinder.records.family import BECOMES, Event, Family, FamilyPoint
from orbitfinder.records.orbit import level, recorded_proof
from orbitfinder.records.reading import Entries, Table
from orbitfinder.show.diagram import LOOKS, changes, mark_of, verdicts
from orbitfinder.show.facts import facts, largest, number, with_unit
from orbitfinder.show.scene import evenly
from orbitfinder.site.gather import AtlasFile, OrbitFile, Verdict
from orbitfinder.site.landscape import landscape
from orbitfinder.site.motion import Filmed, Simulator, base64_of, framed, histories, packed
from orbitfinder.site.text import (
    article,
    coordinate,
    mechanism,
    plain_words,
    symmetry_words,
)

UNJUDGED = Verdict((), "this orbit has no page of its own")
FACTS = 7
"""Facts of an orbit above its picture; the rest has places of its own on the page"""


@dataclass(frozen=True)
class SiteOrbit:
    """One orbit of the site: its file, its motion, the name of its page and how its parts are called."""

    file: OrbitFile
    motion: Filmed | None
    slug: str
    series: str = ""
    """name of the atlas it came from, empty for an orbit.json"""
    label: str = ""
    """what it is called where its document has no telling name of its own"""
    verdict: Verdict = UNJUDGED
    conserved: bool = True
    """whether its energy is the same all along"""
    near: tuple[tuple[str, str], ...] = ()
    """address and words of what belongs to it: families, atlases"""
    command: str = ""
    """what shows it on a terminal, of an atlas' orbit"""
    key: str = ""
    """its address on the page of its atlas"""
    energies: np.ndarray | None = None
    """kinetic and potential energy at equal times"""
    neighbour: Filmed | None = None
    landscape: Table | None = None
    """the potential that it moves in, of a point in a plane"""

    @property
    def units(self) -> Mapping[str, str]:
        """Of energy, time, action and length."""
        return units(self.document["system"])

    @property
    def words(self) -> str:
        """All that a search looks at."""
        told = (self.title, self.slug, self.series, self.mechanism, symmetry_words(self.document["symmetry"]),
                self.document["stability"], str(self.document.get("source") or ""),
                str(self.document["system"].get("kind", "")))  # fmt: skip
        return plain_words(" ".join(told))

    @property
    def document(self) -> Table:
        """The orbit document."""
        return self.file.document

    @property
    def title(self) -> str:
        """The title, or the name where there is none."""
        return self.label or str(self.document.get("title") or self.document["name"])

    @property
    def mechanism(self) -> str:
        """The kind of mechanism in words."""
        return mechanism(self.document["system"])

    @property
    def largest(self) -> float:
        """Largest modulus of the Floquet multipliers, 1 where there are none."""
        return largest(self.file.orbit)


def orbit_values(entry: SiteOrbit) -> Entries:
    """What the template of an orbit page is filled with."""
    document, motion, name = entry.document, entry.motion, orbit_name(entry.document)
    problem, orbit = orbit_text(document), entry.file.orbit
    told = facts(orbit, entry.conserved, motion.names if motion else ())  # the period with every digit
    told |= {"period": with_unit(repr(orbit.period), entry.units["time"])}
    pairs = sorted(document["floquet_multipliers"], key=lambda pair: (-abs(complex(*pair)), pair[1]))
    return {
        "entry": entry,
        "document": document,
        "verdict": entry.verdict,
        "motion": motion,
        "aspect": _aspect(motion),
        "shown": portraits(motion) if motion else [],
        "coordinates": len(motion.angles) - len(shown(motion)) + len(portraits(motion)) if motion else 0,
        "facts": [(name.capitalize(), text) for name, text in [*told.items()][:FACTS] if text],
        "multipliers": [
            (re, im, abs(complex(re, im)), float(np.degrees(np.angle(complex(re, im))))) for re, im in pairs
        ],
        "proof": None if entry.verdict.certified is False else recorded_proof(document),  # of a rejected orbit nothing
        "name": name,
        "problem": problem,
        "commands": (f"orbitfinder run {name}.toml\n" if problem else "")
        + f"orbitfinder verify {name}.json\n"
        + (f"orbitfinder continue {name}.json\n" if problem and entry.conserved else "")
        + (f"orbitfinder studio {name}.json\n" if problem else "")
        + (f"{entry.command}\n" if entry.command else ""),
        "checks": [_check(check) for check in entry.verdict.checks],
    }


def _aspect(motion: Filmed | None) -> float:
    """Width over height of the moving picture: that of the motion, within limits."""
    if motion is None:
        return 1.25
    if motion.points.shape[1] > 2 or "unlike" in motion.around:
        return 1.25
    spans = np.ptp(motion.points, axis=(0, 2))
    down, right = spans + 0.15 * max(float(spans.max()), 1e-12)
    return float(np.clip(right / down, 0.95, 2.4))


def shown(motion: Filmed) -> list[int]:
    """The coordinates that are plotted: of a linkage its angles; evenly chosen where there are many."""
    n = len(motion.angles)
    candidates = list(range(n))
    if n > 6 and any(motion.angles) and not all(motion.angles):
        candidates = [k for k in candidates if motion.angles[k]]
    return [candidates[k] for k in evenly(len(candidates), 6)]


def portraits(motion: Filmed) -> list[int]:
    """Those of them that have a portrait: of a coordinate and its momentum the first."""
    partners, n = motion.partners, len(motion.angles)
    return [k for k in shown(motion) if partners[k] > k or partners[partners[k] % n] != k]


def _check(check: Check) -> Entries:
    """A check for reading: its name, what was found and asked, whether it passed, and its note."""
    sense = check.sense
    return {
        "name": check.name.replace("_", " "),
        "found": number(check.value, 3) if sense else "yes" if check.passed else "no",
        "asked": f"{sense} {number(check.tolerance, 3)}" if sense else "yes",
        "passed": check.passed,
        "note": check.note.replace("Phi^T J Phi = J", "\u03a6\u1d40J\u03a6 = J"),
    }


def orbit_data(entry: SiteOrbit) -> Entries:
    """What the orbit page's script works with."""
    document, motion = entry.document, entry.motion
    data = {
        "name": orbit_name(document),
        "title": entry.title,
        "period": float(document["period"]),
        "multipliers": document["floquet_multipliers"],
        "json": entry.file.text,
        "units": entry.units,
        "motion": None,
    }
    if motion is not None:
        n, own = len(motion.angles), given_units(document["system"])
        length, named = entry.units["length"] * (n < len(motion.names)), zip(motion.names, motion.angles, strict=False)
        data |= {
            "motion": packed(motion),
            "neighbour": packed(entry.neighbour) if entry.neighbour else None,
            "landscape": entry.landscape,
            "energy": document["energy"],
            "energies": entry.energies
            if entry.energies is None
            else {
                "count": entry.energies.shape[1],
                "data": base64_of(entry.energies),  # rows of float32
            },
            "histories": histories(motion),
            "names": list(motion.names),
            "coordinates": n,
            "partners": motion.partners,
            "labels": [coordinate(name) for name in motion.names[:n]],
            "axes": [own.get(name, entry.units["angle"] if angle else length) for name, angle in named],
            "shown": shown(motion),
            "portraits": portraits(motion),
        }
    return data


# --------------------------------------------------------------------------------------------------
# Pages on which one orbit after the other is picked from a plot: families and atlases.


def pickable(family: Family) -> list[int]:
    """The members (points, then events) that can be picked, in order along the family."""
    members, first, most = family.members, len(family.points), 60  # points, and as many events
    common = [mark_of(event).many for event in family.events]
    kept: list[int] = []
    for wanted in (False, True):
        alike = [first + k for k, often in enumerate(common) if often is wanted]
        kept += [alike[k] for k in evenly(len(alike), max(0, most - len(kept)))]
    return sorted([*spread(family.points, most), *kept], key=lambda at: members[at].arclength)


def before(family: Family, event: Event) -> FamilyPoint:
    """The point before an event, which says what the event does not carry, with the verdict just before it."""
    point = family.points[min(max(event.index, 0), len(family.points) - 1)]
    return replace(point, stability=family.beside(event)[0] or point.stability)


def family_items(family: Family, simulator: Simulator, reach: Sequence[float]) -> list[Entries]:
    """What can be picked, in order along the family; `reach` are the amplitudes of its members, where known."""
    items, file, ways = [], f"families/{family.name}/family.json", left_at(family)
    for at in pickable(family):
        member, k = family.members[at], at - len(family.points)
        item = _item(member, family, simulator) | ({"amplitude": reach[at]} if reach else {})
        if isinstance(member, Event):
            command = f"orbitfinder continue {file} --switch {k}" if k in ways else ""
            items.append(item | {"key": f"event={k}", "number": k, "command": command})
        else:
            items.append(item | {"key": f"point={at}", "command": f"orbitfinder verify {file}#{at}"})
    return _said(family, items)


def _said(family: Family, items: list[Entries]) -> list[Entries]:
    """The items with what the picture `says` of each in a sentence: what happens at an event, of what stretch an orbit
    is and where its period tends."""
    time, unit = units(family.system)["time"], unit_along(family.parameter, family.system)

    def where(value: float) -> str:
        return f"{family.parameter} = {with_unit(number(value, 6), unit)}"

    listed = {item["number"] for item in items if item["event"]}
    cuts = [event for k, event in enumerate(family.events) if k in listed or event.detail in BECOMES]
    places, told = [event.arclength for event in cuts], list[Entries]()
    for item in items:
        if item["event"]:
            told.append(item | {"says": f"At {where(item['value'])}: {sentence(family, item['number'])}."})
            continue
        first = bisect_left(places, item["arclength"])
        ends = [cuts[first - 1] if first else family.points[0], *cuts[first : first + 1], family.points[-1]][:2]
        names = [f"the {end.words} at {where(end.parameter)}" if isinstance(end, Event) else where(end.value)
                 for end in ends]  # fmt: skip
        verdicts = {point.stability: 0 for point in family.points
                    if ends[0].arclength <= point.arclength <= ends[1].arclength}  # fmt: skip
        period = [with_unit(number(end.period, 5), time) for end in ends]
        way = "stays" if period[0] == period[1] else "grows" if ends[0].period < ends[1].period else "falls"
        how = f"{way} at {period[0]}" if way == "stays" else f"{way} from {period[0]} to {period[1]}"
        says = f"From {names[0]} to {names[1]}: orbits {' or '.join(verdicts)}, whose period {how}."
        told.append(item | {"says": says})
    return told


def spread(points: Sequence[FamilyPoint], most: int) -> list[int]:
    """At most `most` points, equally far apart along the curve of energy, frequency and arclength, ends among them."""
    if len(points) <= most:
        return list(range(len(points)))
    table = np.nan_to_num([[point.energy, 1.0 / point.period, point.arclength] for point in points])
    steps = np.linalg.norm(np.diff(table / nonzero(np.ptp(table, axis=0)), axis=0), axis=1)
    length = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, length[-1], most)
    return sorted({int(np.abs(length - place).argmin()) for place in wanted} | {0, len(points) - 1})


def _item(member: FamilyPoint | Event, family: Family, simulator: Simulator) -> Entries:
    """A point or an event; what an event does not carry is that of the point before it."""
    motion, event = simulator.member(family.system, member), member if isinstance(member, Event) else None
    at, point = (member, True) if isinstance(member, FamilyPoint) else (before(family, member), False)
    return {
        "energy": level(member.energy),
        "period": member.period,
        "value": at.value if event is None else event.parameter,
        "error": None if event is None else event.error,
        "arclength": member.arclength,
        "action": at.action if point and np.isfinite(member.energy) else None,
        "closure": at.closure if point else None,
        "defect": at.defect if point else None,
        "krein": list(at.krein),
        "stability": at.stability,
        "symmetry": symmetry_words(member.symmetry),
        "multipliers": [[float(f"{x:.8g}") for x in (mu.real, mu.imag)] for mu in at.floquet_multipliers.tolist()],
        "event": "" if event is None else event.words,
        "kind": "" if event is None else event.kind,
        "what": "" if event is None else kind_of(event.kind).words,
        "motion": packed(motion) if motion else None,
    }


def family_data(family: Family, simulator: Simulator) -> Entries:
    """What the family page's script works with."""
    names = ("energy", "period", "action", "closure", "value", "arclength")
    columns = {name: np.nan_to_num(family.values(name)).tolist() for name in names}
    moved, reach = "", list[float]()
    if len(family.parameters) > 1:
        moved, reach = family.parameters[1], family.places[:, 1].tolist()
    elif model := simulator.known(family.system):  # of one that dissipates, its amplitudes at points, then events
        moved, sizes = response(family, model)
        reach = sizes.tolist()
    items = family_items(family, simulator, reach)
    frame = framed(items)
    known = simulator.known(family.system) if family.unit else None  # others change the potential
    if moved:
        columns["amplitude"] = reach[: len(family.points)]
    return {
        "page": "family",
        "name": family.name,
        "parameter": family.parameter,
        "unit": family.unit,
        "moved": moved,
        "units": units(family.system),
        "conserved": simulator.conserves(family.system),
        "energetic": _energetic(family),
        "frame": frame,
        "landscape": landscape(known, frame, many=True),
        "curve": len(family.parameters) > 1,
        "columns": columns
        | {
            "stable": verdicts(family),
            "largest": [max(map(abs, point.floquet_multipliers.tolist()), default=1.0) for point in family.points],
        },
        "changes": [[k, None if at is None else _place(family, at, reach)] for k, at in changes(family)],
        "items": items,
        "looks": {
            kind: [look.symbol, look.series, look.pixels, look.line]
            for kind, look in {kind: LOOKS[kind] for kind in map(itemgetter("kind"), items) if kind}.items()
        },
    }  # fmt: skip


def _energetic(family: Family) -> bool:
    """Whether its orbits have an energy, and with it an action."""
    return bool(np.isfinite(family.values("energy")).any())


def _place(family: Family, number: int, reach: Sequence[float]) -> dict[str, float]:
    """Where an event lies on the axes that it is known on."""
    event = family.events[number]
    told = {"energy": level(event.energy), "period": event.period, "value": event.parameter}
    return told | {"arclength": event.arclength} | ({"amplitude": reach[len(family.points) + number]} if reach else {})


def span(values: Sequence[float], digits: int = 6) -> str:
    """The least and the largest of some numbers, or the one where they read alike."""
    low, high = number(min(values), digits), number(max(values), digits)
    return low if low == high else f"{low} to {high}"


def family_values(family: Family, items: Sequence[Table]) -> Entries:
    """What the template of a family page is filled with."""
    points, events, unit = family.points, family.events, units(family.system)
    periods, energetic = family.values("period").tolist(), _energetic(family)
    unstable = sum(point.stability == "unstable" for point in points)
    listed = sum(bool(item["event"]) for item in items)
    left_out = f"{listed} of {plural(len(events), 'event')} are listed; resonances are left out first."
    thinned = f"{len(items) - listed} of the orbits and {listed} of the events can be picked here. "
    other = "" if family.unit else f"{family.parameter} {span(family.values('value').tolist())}, "
    if energetic:
        other += f"energy {with_unit(span(family.values('energy').tolist()), unit['energy'])}, "
    summary = (
        f"{plural(len(points), 'orbit')} of {article(mechanism(family.system))}, {unstable} of them unstable, "
        f"and {plural(len(events), 'event')}: {other}"
        f"period {with_unit(span(periods), unit['time'])}. {thinned if len(items) < len(points) + len(events) else ''}"
        f"{'Parameters' if family.parameters[1:] else 'Parameter'}: {', '.join(family.parameters)}. "
        "All as orbitfinder continue recorded it; not checked here."
    )
    useful = ["value", "arclength"]  # what may be plotted across, the most telling first
    if energetic:
        order = ["value", "energy"] if not family.by_energy else ["energy", *([] if family.unit else ["value"])]
        useful = [*order, "below", "arclength", "action"]
    return {
        "family": family,
        "items": items,
        "columns": ["energy", "period"] if family.unit else ["value", *["energy"] * family.by_energy, "period"],
        "heads": {"value": family.parameter}
        | {
            name: f"{name}, {unit[kind]}" if unit[kind] else name
            for name, kind in (("energy", "energy"), ("period", "time"))
        },
        "useful": useful,
        "levels": [(name, name) for name in ("energy", "action") if energetic],
        "listed": "" if listed == len(events) else left_out,
        "summary": summary,
    }


def atlas_data(name: str, entries: Sequence[SiteOrbit], linked: set[str], model: Model | None) -> Entries:
    """What the atlas page's script works with; `linked` orbits have a page of their own, `model` is that of all."""
    items = []
    for entry in entries:
        document = entry.document
        items.append({
            "title": entry.title,
            "key": entry.key,
            "command": entry.command,
            "mechanism": entry.mechanism,
            "energy": level(document["energy"]),
            "period": document["period"],
            "action": document["action"],
            "closure": document["closure"],
            "stability": document["stability"],
            "symmetry": symmetry_words(document["symmetry"]),
            "code": document["symmetry"],
            "multipliers": document["floquet_multipliers"],
            "largest": entry.largest,
            "motion": packed(entry.motion) if entry.motion else None,
            "page": f"../orbits/{entry.slug}.html" if entry.slug in linked else None,
            "on": [[address, words.partition(" (")[0]] for address, words in entry.near[1:]],
        })  # fmt: skip
    alike = len({entry.mechanism for entry in entries}) == 1
    frame = framed(items) if alike else None
    return {
        "page": "atlas", "name": name, "items": items, "conserved": all(entry.conserved for entry in entries),
        "units": entries[0].units if alike else SI, "frame": frame,
        "landscape": landscape(model, frame, many=True),
    }  # fmt: skip


def atlas_values(entries: Sequence[SiteOrbit], atlas: AtlasFile) -> Entries:
    """What the template of an atlas page is filled with."""
    energies, periods = ([level(entry.document[key]) for entry in entries] for key in ("energy", "period"))
    kinds = sorted({entry.mechanism for entry in entries})
    unstable = sum(entry.document["stability"] == "unstable" for entry in entries)
    part = "" if atlas.total == len(entries) else f" Shown: {len(entries)} chosen in order of energy."
    summary = f"{atlas.counted('distinct orbit')} ({', '.join(kinds) or 'none yet'}).{part} {unstable} unstable."
    if entries:
        unit = entries[0].units if len(kinds) == 1 else SI
        told = f"Energy {with_unit(span(energies), unit['energy'])}, period"
        told = told if all(entry.conserved for entry in entries) else "Period"
        summary += f" {told} {with_unit(span(periods), unit['time'])}."
    summary += " All as the atlas records it; an orbit with a page of its own says there what was checked."
    return {"summary": summary} | choices(entries)


def choices(entries: Sequence[SiteOrbit]) -> Entries:
    """The distinct values that a page's filters offer."""
    return {
        "mechanisms": sorted({entry.mechanism for entry in entries}),
        "stabilities": sorted({entry.document["stability"] for entry in entries}),
        "symmetries": sorted({entry.document["symmetry"] for entry in entries}),
    }
