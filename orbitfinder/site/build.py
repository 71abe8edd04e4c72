"""The whole site in memory: pages, data and assets."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from typing import Any

import numpy as np

from orbitfinder._runtime import __version__
from orbitfinder._runtime.caches import Kept
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import plural
from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.families.plane import ParameterMap
from orbitfinder.mechanics.scales import units
from orbitfinder.records.family import Family
from orbitfinder.records.orbit import level
from orbitfinder.records.reading import Entries, Table
from orbitfinder.show.diagram import entitled
from orbitfinder.show.facts import number, with_unit
from orbitfinder.show.rest import rest_svg
from orbitfinder.show.scene import evenly
from orbitfinder.site.equilibria import cycles_data, equilibria_data
from orbitfinder.site.gather import AtlasFile, Gathered, Verdict, judged, recorded
from orbitfinder.site.landscape import landscape
from orbitfinder.site.maps import map_picture, map_values
from orbitfinder.site.motion import Simulator, framed, packed
from orbitfinder.site.pages import (
    SiteOrbit,
    atlas_data,
    atlas_values,
    choices,
    family_data,
    family_values,
    orbit_data,
    orbit_values,
    span,
)
from orbitfinder.site.section import section_data, section_values
from orbitfinder.site.text import (
    ASSETS,
    article,
    mechanism,
    plain_words,
    rendered,
    script_data,
    size,
    slug_maker,
)
from orbitfinder.site.writing import MARK, mark
from orbitfinder.structures.section import Section

WEIGHT, PASSES = "@@WEIGHT@@", " (the curve comes within 0.3 % of this orbit in energy, period and action)"
SCRIPTS = {
    "gallery": ("gallery.js",),
    **{kind: ("plotly-basic.min.js", "plots.js", f"{script}.js")
       for kind, script in (("orbit", "orbit"), ("family", "explorer"), ("atlas", "explorer"), ("section", "section"),
                                                               ("equilibria", "equilibria"))},
}  # fmt: skip
"""What each kind of page loads besides core.js and its data"""
Progress = Callable[[str], None]
Named = Sequence[tuple[Family | Equilibria, str]]


@dataclass(frozen=True)
class SiteSettings:
    """What a site is called, and how many orbits of each atlas get a card and a page of their own."""

    title: str = "Periodic orbits"
    atlas_pages: int = 60
    verify: bool = True
    """Recompute the certificate of every orbit that gets a page; what is not recomputed is not called certified"""


@dataclass(frozen=True)
class SiteSummary:
    """What was written."""

    orbits: int
    families: int
    atlases: int
    sections: int
    equilibria: int
    maps: int
    size: int


@dataclass(frozen=True)
class HtmlFile:
    """One HTML file: where it is and which other files it loads."""

    path: str
    html: str
    loads: tuple[str, ...]


@dataclass(frozen=True)
class Card:
    """A family or an atlas as the gallery shows it; `motion` is the key of the one that stands for it."""

    kind: str
    href: str
    title: str
    words: str
    note: str
    motion: str
    system: str = ""
    """what orbits of the same system have too, see `same`"""
    curve: tuple[tuple[str, float, float, float], ...] = ()
    """address, energy, period and action of the points that can be picked"""
    picture: str = ""
    """where nothing moves: an SVG"""

    @property
    def search(self) -> str:
        """All that a search looks at."""
        return plain_words(f"{self.kind} {self.title} {self.words}")


class Site:
    """The files of a site by their path, collected before anything is written."""

    def __init__(self, settings: SiteSettings, solids: Table) -> None:
        self.settings, self.solids = settings, solids
        self.files = {}
        self.pages: list[HtmlFile] = []
        for asset in sorted(files(__package__).joinpath(ASSETS).iterdir(), key=lambda path: path.name):
            if asset.is_file():
                self.files[f"assets/{asset.name}"] = asset.read_bytes()

    def add_still(self, kind: str, path: str, values: Table, picture: bytes, about: str) -> None:
        """One page by the template of a kind on which nothing moves, with its picture; `values` has the title."""
        still = re.sub(r"\.html$", ".png", path)
        self.files[still] = picture
        self._page(kind, path, {**values, "picture": still}, [], about, (still,))

    def add(self, kind: str, path: str, values: Table, data: tuple[str, Any], about: str) -> None:
        """One page by the template of a kind, with its data file; `values` has the title."""
        key, payload = data
        beside = re.sub(r"\.html$", ".js", path)
        data_file = f"data/{beside}"
        text = script_data(key, payload)
        text += "".join(script_data(name, solids) for name, solids in self.solids.items() if f'"{name}"' in text)
        self.files[data_file] = text.encode("ascii")
        scripts = [f"assets/{name}" for name in ("core.js", *SCRIPTS[kind])]
        self._page(kind, path, values, [scripts[0], data_file, *scripts[1:]], about)

    def _page(
        self, kind: str, path: str, values: Table, loads: Sequence[str], about: str,
        shown: Sequence[str] = (),
    ) -> None:  # fmt: skip
        whole = rendered(
            kind, **values, path=path, site=self.settings.title, about=about, root="../" * path.count("/"),
            loads=loads, version=__version__, weight=WEIGHT,
        )  # fmt: skip
        self.pages.append(HtmlFile(path, whole, ("assets/page.css", "assets/theme.js", *loads, *shown)))

    def finish(self) -> int:
        """Turn the pages into files, each with what it and the whole site weigh; returns the latter in bytes."""
        self.files[MARK] = mark([*self.files, *(page.path for page in self.pages)])
        fixed = sum(map(len, self.files.values())) + sum(
            len(page.html.encode("utf-8", "replace")) for page in self.pages
        )
        whole = size(fixed)
        for page in self.pages:
            own = len(page.html.encode("utf-8", "replace")) + sum(len(self.files[name]) for name in page.loads)
            text = f"This page loads {size(own)}; the whole site is {whole}."
            self.files[page.path] = page.html.replace(WEIGHT, text).encode("utf-8", "replace")
        return sum(map(len, self.files.values()))


def build_site(
    gathered: Gathered, settings: SiteSettings | None = None, say: Progress | None = None
) -> tuple[Site, SiteSummary]:
    """All pages of everything gathered, in memory."""
    settings, tell = settings or SiteSettings(), say or (lambda _: None)
    simulator, slug = Simulator(gathered.model), slug_maker()
    site = Site(settings, simulator.solids)
    entries = []
    for file in gathered.orbits:
        motion = simulator.orbit(file.document, file.dense)
        entries.append(SiteOrbit(file, motion, slug(file.document["name"])))
        tell(f"orbit {len(entries)} of {len(gathered.orbits)} drawn")
    links = []
    motions: Entries = {}
    families, curves, atlases = slug_maker(), slug_maker(), slug_maker()
    collected = [(atlas, atlases(atlas.name)) for atlas in gathered.atlases]
    named = [(family, families(family.name)) for family in gathered.families]
    resting = [(rest, curves(rest.name)) for rest in gathered.equilibria]
    links += [_add_equilibria(site, rest, own, simulator, (gathered, named)) for rest, own in resting]
    everything: Named = [*named, *((rest, f"../equilibria/{own}") for rest, own in resting)]
    for k, (family, own) in enumerate(named, 1):
        tell(f"family {k} of {len(named)}, {family.name}: {plural(len(family.points), 'point')}")
        links.append(_add_family(site, family, own, simulator, motions, (everything, entries, collected)))
    for k, (atlas, own) in enumerate(collected, 1):
        tell(f"atlas {k} of {len(gathered.atlases)}, {atlas.name}: {atlas.counted('orbit')}")
        link, shown = _add_atlas(site, atlas, simulator, (own, slug), motions, links)
        links.insert(k - 1, link)
        entries += shown
    sections = slug_maker()
    for k, section in enumerate(gathered.sections, 1):
        tell(f"section {k} of {len(gathered.sections)}, {section.name}")
        links.append(_add_section(site, section, sections(section.name), gathered, motions))
    judge = partial(judged, model_of=gathered.model)
    if not settings.verify:
        judge = partial(recorded, why="it was not asked for")
    planes = slug_maker()
    links += [_add_map(site, plane, planes(plane.name), gathered) for plane in gathered.maps]
    verdicts = Kept[Verdict](max(1, len(entries)))  # of equal records found once
    for k, entry in enumerate(entries, 1):
        verdict = verdicts(entry.file.text, partial(judge, entry.file.orbit))
        entries[k - 1] = replace(_complete(entry, simulator, links), verdict=verdict)
        tell(f"orbit {k} of {len(entries)} judged")
    for k, entry in enumerate(entries):
        around = {"previous": entries[k - 1] if k else None, "next": entries[k + 1] if k + 1 < len(entries) else None}
        period = with_unit(number(entry.document["period"], 10), entry.units["time"])
        about = f"A periodic orbit of {article(entry.mechanism)}: period {period}."
        values = orbit_values(entry) | around | {"title": entry.title}
        site.add("orbit", f"orbits/{entry.slug}.html", values, ("orbit", orbit_data(entry)), about)
    _add_gallery(site, entries, links, motions)
    counts = [len(records) for records in (gathered.families, gathered.atlases, gathered.sections, gathered.maps)]
    return site, SiteSummary(len(entries), counts[0], counts[1], counts[2], len(resting), counts[3], site.finish())


def same(system: Table) -> str:
    """Equal for equal systems."""
    return json.dumps(system, sort_keys=True, default=str)


def _passing(document: Table, links: Sequence[Card]) -> list[tuple[str, str]]:
    """Address and words of the families whose curves pass an orbit."""
    known, here = same(document["system"]), _here(document)
    passed = [(link, _closest(here, link.curve)) for link in links if link.system == known]
    return [(f"../{link.href}{point}", f"{link.kind} {link.title}{PASSES}") for link, point in passed if point]


def _complete(entry: SiteOrbit, simulator: Simulator, links: Sequence[Card]) -> SiteOrbit:
    """The entry with its energies, its neighbour, and the families and atlases that it belongs to."""
    document, motion, near = entry.document, entry.motion, list[tuple[str, str]]()
    near = _passing(document, links)
    own = {words.removesuffix(PASSES) for _, words in (*near, *entry.near)}
    near += [(f"../{link.href}", f"{link.kind} {link.title}") for link in links
             if link.system == same(document["system"]) and f"{link.kind} {link.title}" not in own]  # fmt: skip
    return replace(
        entry, near=tuple(dict.fromkeys((*near, *entry.near))),
        conserved=simulator.conserves(document["system"], document),
        energies=motion.energies if motion else None,
        neighbour=simulator.neighbour(document, motion) if motion else None,
        landscape=landscape(simulator.known(document["system"]), framed([{"motion": packed(motion)}]))
        if motion else None,
    )  # fmt: skip


def _here(document: Table) -> tuple[float, float, float]:
    """Energy, period and action of an orbit."""
    return level(document["energy"]), float(document["period"]), float(document["action"])


def _closest(here: tuple[float, float, float], points: Sequence[tuple[str, float, float, float]]) -> str:
    """The address of the point of a family whose curve passes an orbit, "" where it is 0.3 % away."""
    curve = np.array([point[1:] for point in points])
    if len(curve) < 2:
        return ""
    unit = nonzero(np.ptp(curve, axis=0))
    begin, steps, aim = curve[:-1] / unit, np.diff(curve, axis=0) / unit, np.array(here) / unit
    share = np.clip(((aim - begin) * steps).sum(axis=1) / nonzero((steps**2).sum(axis=1)), 0.0, 1.0)
    apart = np.abs(begin + share[:, None] * steps - aim).max(axis=1)
    k = int(apart.argmin())
    return f"#{points[k + int(share[k] > 0.5)][0]}" if apart[k] < 0.003 else ""


def _relatives(family: Family, named: Named) -> Entries:
    """What this family branched from, and the families that branched from it, with addresses and words."""
    source = family.source

    def words(event: Any) -> str:
        return f"{str(event.get('kind_of_event', 'event')).replace('_', ' ')} {event.get('event')}"

    kind, at = Equilibria if source.get("kind_of_event") == "hopf" else Family, source.get("event")
    parents = [(f"{page}.html#event={at}", f"{other.name}, {words(source)}") for other, page in named
               if other.name == source.get("family") and isinstance(other, kind)]  # fmt: skip
    children = [(f"{page}.html", f"{name}, from {words(other)}", other.get("event")) for name, other, page in
                [(other.name, other.source, page) for other, page in named if isinstance(other, Family)]
                if other.get("family") == family.name and other.get("kind_of_event") != "hopf"]  # fmt: skip
    origin = (
        f"Started from {source.get('kind', 'a problem')} {source.get('name') or source.get('family') or ''}".strip()
    )
    return {"parents": parents, "children": children, "origin": origin.strip()}


def _headed(what: str, record: Any) -> str:
    """What a page is headed by: the title of what its record was started from, and what it is."""
    named, title = f"{what} {record.name}", entitled(record)
    return f"{what.capitalize()} {record.name}" if title == record.name else f"{title}: {named}"


def _add_family(
    site: Site, family: Family, slug: str, simulator: Simulator, motions: Entries,
    known: tuple[Named, Sequence[SiteOrbit], Sequence[tuple[AtlasFile, str]]],
) -> Card:  # fmt: skip
    data, path, words = family_data(family, simulator), f"families/{slug}.html", mechanism(family.system)
    values = family_values(family, data["items"]) | {"title": _headed("family", family), "moved": data["moved"]}
    curve = tuple((item["key"], item["energy"], item["period"], item["action"]) for item in data["items"]
                  if item["action"] is not None)  # fmt: skip
    known_here = same(family.system)
    own = [entry for entry in known[1] if same(entry.document["system"]) == known_here]
    values["orbits"] = [
        (f"../orbits/{entry.slug}.html", entry.title) for entry in own if _closest(_here(entry.document), curve)
    ]
    values["atlases"] = [
        (atlas.name, [
            (f"../atlases/{page}.html#orbit={place}", place) for place, file in atlas.orbits
            if same(file.document["system"]) == known_here and _closest(_here(file.document), curve)
        ])
        for atlas, page in known[2] if same(atlas.orbits[0][1].document["system"]) == known_here
    ]  # fmt: skip
    values |= _relatives(family, known[0]) | {name: data[name] for name in ("conserved", "landscape", "frame")}
    site.add("family", path, values, ("explorer", data), f"A family of periodic orbits of {article(words)}.")
    useful = "value" if values["useful"][0] == "value" or data["moved"] else "energy"
    shown, unit = span(data["columns"][useful], 4), units(family.system)["energy"] if useful == "energy" else ""
    name = "" if useful == "energy" else f"{family.parameter} "
    note = f"{plural(len(family.points), 'orbit')}, {name}{with_unit(shown, unit)}"
    cover = _cover(f"family/{slug}", data, motions)
    return Card("Family", path, family.name, words, note, cover, known_here, curve)


def _add_equilibria(
    site: Site, rest: Equilibria, slug: str, simulator: Simulator, known: tuple[Gathered, Sequence[tuple[Family, str]]]
) -> Card:
    """The page of equilibria; returns its link."""
    data, path, words = equilibria_data(rest, known[0]), f"equilibria/{slug}.html", mechanism(rest.system)
    own = [(family, f"../families/{page}.html") for family, page in known[1]
           if (family.source.get("family"), family.source.get("kind_of_event")) == (rest.name, "hopf")]  # fmt: skip
    born = [(page, family.name, family.source.get("event")) for family, page in own]
    data["cycles"] = [cycles_data(family, page, simulator) for family, page in own]
    values = data | {"title": _headed("equilibria", rest), "rest": rest, "born": born, "words": words}
    values["unit"] = units(rest.system)["time"]
    site.add("equilibria", path, values, ("equilibria", data), f"Equilibria of {article(words)}.")
    note = ", ".join(event.words.replace("hopf", "Hopf") for event in rest.events) or plural(len(rest.points), "point")
    svg = rest_svg(rest, data["names"])
    return Card("Equilibria", path, rest.name, words, f"{rest.parameter}: {note}", "", picture=svg)


def _add_section(site: Site, section: Section, slug: str, gathered: Gathered, motions: Entries) -> Card:
    """The page of a Poincare section; returns its link."""
    data, path, words = section_data(section, gathered), f"sections/{slug}.html", mechanism(section.system)
    values = section_values(section, data) | {"title": _headed("section", section)}
    site.add("section", path, values, ("section", data), f"A Poincare section of the {words}: {section.plane}.")
    return Card("Section", path, section.name, words, section.plane, _cover(f"section/{slug}", data, motions))


def _add_map(site: Site, plane: ParameterMap, slug: str, gathered: Gathered) -> Card:
    """The page of a map; returns its link."""
    path, words = f"maps/{slug}.html", mechanism(plane.system)
    values = map_values(plane) | {"title": _headed("map", plane), "words": words}
    picture = map_picture(plane, gathered)
    site.add_still("map", path, values, picture, f"A map of a parameter plane of {article(words)}.")
    note = f"{plane.by} over {' and '.join(plane.parameters)}, {plural(plane.blank.size, 'pixel')}"
    return Card("Map", path, plane.name, words, note, "", same(plane.system),
                picture=f'<img src="maps/{slug}.png" alt="">')  # fmt: skip


def _cover(key: str, data: Table, motions: Entries) -> str:
    """The key under which the gallery finds the motion that stands for a family or an atlas."""
    moving = [item["motion"] for item in data["items"] if item["motion"]]
    if moving:
        motions[key] = moving[len(moving) * 2 // 3]
    return key


def _add_atlas(
    site: Site, atlas: AtlasFile, simulator: Simulator, slugs: tuple[str, Callable[[str], str]],
    motions: Entries, links: Sequence[Card],
) -> tuple[Card, list[SiteOrbit]]:  # fmt: skip
    """The page of an atlas; returns its link and the orbits that get a card and a page of their own. Its orbits lead to
    the families among the `links` that pass them."""
    entries = []
    path = f"atlases/{slugs[0]}.html"
    titles = [str(file.document.get("title") or "") for _, file in atlas.orbits]
    named = all(titles) and len(set(titles)) == len(titles)
    for place, file in atlas.orbits:
        label = "" if named else f"{atlas.name}, orbit {place}"
        slug = slugs[1](str(file.document["name"]) if named else f"{atlas.name}-{place}")
        command = f"orbitfinder verify {atlas.file}#{place}"
        if not atlas.file.endswith(".json"):
            command = f"orbitfinder atlas show {atlas.file} {place}"
        known = simulator.conserves(file.document["system"], file.document)
        motion = simulator.orbit(file.document)
        key = f"orbit={place}"
        own = ((f"../{path}#{key}", f"Atlas {atlas.name}"), *_passing(file.document, links))
        orbit = SiteOrbit(file, motion, slug, atlas.name, label, conserved=known, command=command, key=key, near=own)
        entries.append(orbit)
    shown = [entries[k] for k in evenly(len(entries), site.settings.atlas_pages)]
    systems = {same(entry.document["system"]) for entry in entries}
    model = simulator.known(entries[0].document["system"]) if len(systems) == 1 else None
    data = atlas_data(atlas.name, entries, {entry.slug for entry in shown}, model)
    about = f"An atlas of {atlas.counted('periodic orbit')}, energy against period."
    values = atlas_values(entries, atlas) | {"title": f"Atlas {atlas.name}"}
    values |= {name: data[name] for name in ("landscape", "frame")}
    site.add("atlas", path, values, ("explorer", data), about)
    words, note = ", ".join(sorted({entry.mechanism for entry in entries})), atlas.counted("distinct orbit")
    cover = _cover(f"atlas/{slugs[0]}", data, motions)
    return Card("Atlas", path, atlas.name, words, note, cover, systems.pop() if len(systems) == 1 else ""), shown


def _add_gallery(site: Site, entries: Sequence[SiteOrbit], links: Sequence[Card], motions: Entries) -> None:
    motions = motions | {entry.slug: packed(entry.motion) for entry in entries if entry.motion}
    verdicts = [entry.verdict.certified for entry in entries]
    named = {True: "certified when this page was made", False: "rejected", None: "not checked here"}
    counts = [f"{verdicts.count(verdict)} {words}" for verdict, words in named.items() if verdict in verdicts]
    summary = ", ".join([plural(len(entries), "orbit") if entries else "No single orbits", *counts]) + "."
    about = f"A gallery of {plural(len(entries), 'periodic orbit')} of mechanical systems, each moving in real time."
    values = {"title": site.settings.title, "summary": summary, "entries": entries, "links": links} | choices(entries)
    site.add("gallery", "index.html", values, ("gallery", motions), about)
