"""The whole site in memory: pages, data and assets."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.resources import files
from typing import Any

from orbitfinder._runtime import __version__
from orbitfinder._runtime.caches import Kept
from orbitfinder.errors import plural
from orbitfinder.records.family import Family
from orbitfinder.records.section import Section
from orbitfinder.site.gather import AtlasFile, Gathered, Verdict, evenly, judged, recorded
from orbitfinder.site.motion import Simulator, packed
from orbitfinder.site.pages import (
    Entry,
    atlas_data,
    atlas_values,
    choices,
    family_data,
    family_values,
    orbit_data,
    orbit_values,
)
from orbitfinder.site.section import section_data, section_values
from orbitfinder.site.text import ASSETS, mechanism, number, rendered, script_data, size, slug_maker
from orbitfinder.site.writing import MARK, mark

WEIGHT = "@@WEIGHT@@"
SPEAK_EVERY = 10
NOT_ASKED = "it was not asked for"
PLOTS = ("plotly-basic.min.js", "plots.js")
SCRIPTS = {
    "gallery": ("gallery.js",),
    "orbit": (*PLOTS, "orbit.js"),
    "family": (*PLOTS, "explorer.js"),
    "atlas": (*PLOTS, "explorer.js"),
    "section": (*PLOTS, "section.js"),
}
"""What each kind of page loads besides core.js and its data"""
Progress = Callable[[str], None]


@dataclass(frozen=True)
class Settings:
    """What a site is called, and how many orbits of each atlas get a card and a page of their own."""

    title: str = "Periodic orbits"
    atlas_pages: int = 60
    verify: bool = True
    """Recompute the certificate of every orbit that gets a page; what is not recomputed is not called certified"""


@dataclass(frozen=True)
class Summary:
    """What was written."""

    orbits: int
    families: int
    atlases: int
    size: int


@dataclass(frozen=True)
class Page:
    """One HTML file: where it is and which other files it loads."""

    path: str
    html: str
    loads: tuple[str, ...]


@dataclass(frozen=True)
class Link:
    """A family or an atlas as the gallery shows it; `motion` is the key of the one that stands for it."""

    kind: str
    href: str
    title: str
    words: str
    note: str
    motion: str


class Site:
    """The files of a site by their path, collected before anything is written."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.files: dict[str, bytes] = {}
        self.pages: list[Page] = []
        for asset in sorted(files(__package__).joinpath(ASSETS).iterdir(), key=lambda one: one.name):
            if asset.is_file():
                self.files[f"assets/{asset.name}"] = asset.read_bytes()

    def add(self, kind: str, path: str, values: Mapping[str, Any], data: tuple[str, Any], about: str) -> None:
        """One page by the template of a kind, with its data file; `values` has the title."""
        key, payload = data
        beside = re.sub(r"\.html$", ".js", path)
        data_file = f"data/{beside}"
        self.files[data_file] = script_data(key, payload).encode("ascii")
        loads = ["assets/core.js", data_file, *(f"assets/{name}" for name in SCRIPTS[kind])]
        whole = rendered(
            kind, **values, path=path, site=self.settings.title, about=about, root="../" * path.count("/"),
            loads=loads, version=__version__, weight=WEIGHT,
        )  # fmt: skip
        self.pages.append(Page(path, whole, ("assets/page.css", "assets/theme.js", *loads)))

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


def build_site(found: Gathered, settings: Settings | None = None, say: Progress | None = None) -> tuple[Site, Summary]:
    """All pages of everything gathered, in memory."""
    settings, tell = settings or Settings(), say or (lambda _: None)
    site, simulator, slug = Site(settings), Simulator(), slug_maker()
    entries = []
    for file in found.orbits:
        entries.append(Entry(file, simulator.orbit(file.document, file.dense), slug(file.document["name"])))
    tell(f"{plural(len(entries), 'orbit')} drawn")
    links: list[Link] = []
    motions: dict[str, Any] = {}
    families = slug_maker()
    for family in found.families:
        links.append(_add_family(site, family, families(family.name), simulator, motions))
        tell(f"family {family.name}: {plural(len(family.points), 'point')}")
    atlases = slug_maker()
    for atlas in found.atlases:
        link, shown = _add_atlas(site, atlas, simulator, (atlases(atlas.name), slug), motions)
        links.insert(found.atlases.index(atlas), link)
        entries += shown
        tell(f"atlas {atlas.name}: {plural(atlas.total, 'orbit')}")
    sections = slug_maker()
    links += [_add_section(site, one, sections(one.name), found, motions) for one in found.sections]
    entries = _judged(entries, settings.verify, tell)
    for entry in entries:
        _add_orbit(site, entry)
    _add_gallery(site, entries, links, motions)
    return site, Summary(len(entries), len(found.families), len(found.atlases), site.finish())


def _judged(entries: Sequence[Entry], verify: bool, tell: Progress) -> list[Entry]:
    """The entries with their verdicts, those of equal records found once."""
    found, known = list[Entry](), Kept[Verdict](max(1, len(entries)))
    for entry in entries:
        document = entry.document
        verdict = known(entry.file.text, partial(judged, document)) if verify else recorded(document, NOT_ASKED)
        found.append(replace(entry, verdict=verdict))
        if len(found) % SPEAK_EVERY == 0 or len(found) == len(entries):
            tell(f"{len(found)} of {plural(len(entries), 'orbit')} judged")
    return found


def _add_orbit(site: Site, entry: Entry) -> None:
    about = f"A periodic orbit of the {entry.mechanism}: period {number(entry.document['period'], 10)} s."
    values = orbit_values(entry) | {"title": entry.title}
    site.add("orbit", f"orbits/{entry.slug}.html", values, ("orbit", orbit_data(entry)), about)


def _add_family(site: Site, family: Family, slug: str, simulator: Simulator, motions: dict[str, Any]) -> Link:
    data, path, words = family_data(family, simulator), f"families/{slug}.html", mechanism(family.system)
    values = family_values(family, data["items"]) | {"title": f"Family {family.name}", "moved": data["moved"]}
    site.add("family", path, values, ("explorer", data), f"A family of periodic orbits of the {words}.")
    energies = data["columns"]["energy"]
    note = f"{plural(len(energies), 'orbit')}, {number(min(energies), 4)} to {number(max(energies), 4)} J"
    return Link("Family", path, family.name, words, note, _cover(f"family/{slug}", data, motions))


def _add_section(site: Site, section: Section, slug: str, found: Gathered, motions: dict[str, Any]) -> Link:
    """The page of a Poincare section; returns its link."""
    data, path, words = section_data(section, found), f"sections/{slug}.html", mechanism(section.system)
    values = section_values(section, data) | {"title": f"Section {section.name}"}
    site.add("section", path, values, ("section", data), f"A Poincare section of the {words}: {section.plane}.")
    return Link("Section", path, section.name, words, section.plane, _cover(f"section/{slug}", data, motions))


def _cover(key: str, data: Mapping[str, Any], motions: dict[str, Any]) -> str:
    """The key under which the gallery finds the motion that stands for a family or an atlas."""
    moving = [item["motion"] for item in data["items"] if item["motion"]]
    if moving:
        motions[key] = moving[len(moving) * 2 // 3]
    return key


def _add_atlas(
    site: Site, atlas: AtlasFile, simulator: Simulator, slugs: tuple[str, Callable[[str], str]], motions: dict[str, Any]
) -> tuple[Link, list[Entry]]:
    """The page of an atlas; returns its link and the orbits that get a card and a page of their own."""
    entries: list[Entry] = []
    titles = [str(one.document.get("title") or "") for _, one in atlas.orbits]
    named = all(titles) and len(set(titles)) == len(titles)
    for place, one in atlas.orbits:
        label = "" if named else f"{atlas.name}, orbit {place}"
        slug = slugs[1](str(one.document["name"]) if named else f"{atlas.name}-{place}")
        entries.append(Entry(one, simulator.orbit(one.document), slug, atlas.name, label))
    own = [entries[k] for k in evenly(len(entries), site.settings.atlas_pages)]
    data, path = atlas_data(atlas.name, entries, {one.slug for one in own}), f"atlases/{slugs[0]}.html"
    about = f"An atlas of {plural(atlas.total, 'periodic orbit')}, energy against period."
    values = atlas_values(entries, atlas.total) | {"title": f"Atlas {atlas.name}"}
    site.add("atlas", path, values, ("explorer", data), about)
    words, note = ", ".join(sorted({one.mechanism for one in entries})), plural(atlas.total, "distinct orbit")
    return Link("Atlas", path, atlas.name, words, note, _cover(f"atlas/{slugs[0]}", data, motions)), own


def _add_gallery(site: Site, entries: Sequence[Entry], links: Sequence[Link], motions: dict[str, Any]) -> None:
    motions = motions | {entry.slug: packed(entry.motion) for entry in entries if entry.motion}
    counts = plural(len(entries), "orbit") if entries else "No single orbits"
    summary = counts + (f", {_counted(entries)}." if entries else ".")
    about = f"A gallery of {plural(len(entries), 'periodic orbit')} of mechanical systems, each moving in real time."
    values = {"title": site.settings.title, "summary": summary, "entries": entries, "links": links} | choices(entries)
    site.add("gallery", "index.html", values, ("gallery", motions), about)


def _counted(entries: Sequence[Entry]) -> str:
    """How many were certified, rejected and not checked when the page was made."""
    verdicts = [entry.verdict.certified for entry in entries]
    named = {True: "certified when this page was made", False: "rejected", None: "not checked here"}
    counts = [(verdicts.count(one), words) for one, words in named.items()]
    return ", ".join(f"{count} {words}" for count, words in counts if count)
