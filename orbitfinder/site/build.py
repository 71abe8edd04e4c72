"""The whole site in memory: pages, data and assets."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from typing import Any

from orbitfinder._runtime.version import __version__
from orbitfinder.records.family import Family
from orbitfinder.site.explorers import atlas_data, atlas_main, family_data, family_main, options
from orbitfinder.site.gather import AtlasFile, Gathered, evenly
from orbitfinder.site.motion import Films, packed
from orbitfinder.site.orbits import Entry, card, orbit_data, orbit_main
from orbitfinder.site.text import ASSETS, Html, fill, joined, number, script_data, size, slug_maker
from orbitfinder.site.verdicts import Judge
from orbitfinder.site.words import mechanism, plural
from orbitfinder.site.writing import MARK, mark

WEIGHT = "@@WEIGHT@@"
SPEAK_EVERY = 10
PLOTTING = "plotly-basic.min.js"
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


class Site:
    """The files of a site by their path, collected before anything is written."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.files: dict[str, bytes] = {}
        self.pages: list[Page] = []
        for asset in sorted(files(__package__).joinpath(ASSETS).iterdir(), key=lambda one: one.name):
            if asset.is_file():
                self.files[f"assets/{asset.name}"] = asset.read_bytes()

    def add(self, path: str, title: str, main: Html, data: tuple[str, Any], scripts: Sequence[str], about: str) -> None:
        """One page with its data file."""
        key, payload = data
        beside = re.sub(r"\.html$", ".js", path)
        data_file = f"data/{beside}"
        self.files[data_file] = script_data(key, payload).encode("ascii")
        root = "../" * path.count("/")
        sources = [f"assets/{name}" for name in ("core.js", *scripts)]
        loads = [*sources[:1], data_file, *sources[1:]]
        tags = joined(Html(f'<script defer src="{root}{source}"></script>') for source in loads)
        here = Html(' aria-current="page"') if path == "index.html" else Html("")
        whole = fill(
            "base", title=title, site=self.settings.title, about=about, root=root, scripts=tags, main=main,
            version=__version__, weight=Html(WEIGHT), here=here,
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
    site, films, slug = Site(settings), Films(), slug_maker()
    entries = []
    for file in found.orbits:
        entries.append(Entry(file, films.orbit(file.document, file.dense), slug(file.document["name"])))
    tell(f"{plural(len(entries), 'orbit')} drawn")
    links: list[Html] = []
    motions: dict[str, Any] = {}
    families = slug_maker()
    for family in found.families:
        links.append(_add_family(site, family, families(family.name), films, motions))
        tell(f"family {family.name}: {plural(len(family.points), 'point')}")
    atlases = slug_maker()
    for atlas in found.atlases:
        link, shown = _add_atlas(site, atlas, films, (atlases(atlas.name), slug), motions)
        links.insert(found.atlases.index(atlas), link)
        entries += shown
        tell(f"atlas {atlas.name}: {plural(atlas.total, 'orbit')}")
    entries = _judged(entries, Judge(settings.verify), tell)
    for entry in entries:
        _add_orbit(site, entry)
    _add_gallery(site, entries, links, motions)
    return site, Summary(len(entries), len(found.families), len(found.atlases), site.finish())


def _judged(entries: Sequence[Entry], judge: Judge, tell: Progress) -> list[Entry]:
    """The entries with their verdicts."""
    found: list[Entry] = []
    for entry in entries:
        found.append(replace(entry, verdict=judge.verdict(entry.file)))
        if len(found) % SPEAK_EVERY == 0 or len(found) == len(entries):
            tell(f"{len(found)} of {plural(len(entries), 'orbit')} judged")
    return found


def _add_orbit(site: Site, entry: Entry) -> None:
    about = f"A periodic orbit of the {entry.mechanism}: period {number(entry.document['period'], 10)} s."
    scripts = (PLOTTING, "plots.js", "orbit.js")
    site.add(f"orbits/{entry.slug}.html", entry.title, orbit_main(entry), ("orbit", orbit_data(entry)), scripts, about)


def _add_family(site: Site, family: Family, slug: str, films: Films, motions: dict[str, Any]) -> Html:
    data = family_data(family, films)
    back = f"orbitfinder continue FILE --parameter {family.parameter}"
    main = family_main(family, data["items"], back)
    about = f"A family of periodic orbits of the {mechanism(family.system)}."
    scripts = (PLOTTING, "plots.js", "explorer.js")
    site.add(f"families/{slug}.html", f"Family {family.name}", main, ("explorer", data), scripts, about)
    moving = [item["motion"] for item in data["items"] if item["motion"]]
    key = f"family/{slug}"
    if moving:
        motions[key] = moving[len(moving) * 2 // 3]
    energies = data["columns"]["energy"]
    note = f"{plural(len(energies), 'orbit')}, {number(min(energies), 4)} to {number(max(energies), 4)} J"
    words = mechanism(family.system)
    return fill(
        "link", kind="Family", href=f"families/{slug}.html", title=family.name, note=note, motion=key, words=words
    )


def _add_atlas(
    site: Site, atlas: AtlasFile, films: Films, slugs: tuple[str, Callable[[str], str]], motions: dict[str, Any]
) -> tuple[Html, list[Entry]]:
    """The page of an atlas; returns its link and the orbits that get a card and a page of their own."""
    entries: list[Entry] = []
    titles = [str(one.document.get("title") or "") for _, one in atlas.orbits]
    named = all(titles) and len(set(titles)) == len(titles)
    for place, one in atlas.orbits:
        label = "" if named else f"{atlas.name}, orbit {place}"
        slug = slugs[1](str(one.document["name"]) if named else f"{atlas.name}-{place}")
        entries.append(Entry(one, films.orbit(one.document), slug, atlas.name, label))
    own = [entries[k] for k in evenly(len(entries), site.settings.atlas_pages)]
    data, path = atlas_data(atlas.name, entries, {one.slug for one in own}), f"atlases/{slugs[0]}.html"
    about = f"An atlas of {plural(atlas.total, 'periodic orbit')}, energy against period."
    main = atlas_main(atlas.name, entries, atlas.total)
    site.add(path, f"Atlas {atlas.name}", main, ("explorer", data), (PLOTTING, "plots.js", "explorer.js"), about)
    key, moving = f"atlas/{slugs[0]}", [item["motion"] for item in data["items"] if item["motion"]]
    if moving:
        motions[key] = moving[len(moving) * 2 // 3]
    words, note = ", ".join(sorted({one.mechanism for one in entries})), plural(atlas.total, "distinct orbit")
    return fill("link", kind="Atlas", href=path, title=atlas.name, note=note, motion=key, words=words), own


def _add_gallery(site: Site, entries: Sequence[Entry], links: Sequence[Html], motions: dict[str, Any]) -> None:
    motions = motions | {entry.slug: packed(entry.motion) for entry in entries if entry.motion}
    counts = [plural(len(entries), "orbit")] if entries else []
    more, jump = Html(""), Html("")
    if links:
        more = fill("links", links=joined(links))
        jump = fill("jump", sets=f"Families and atlases ({len(links)})", orbits=f"Orbits ({len(entries)})")
    main = fill(
        "gallery",
        title=site.settings.title,
        summary=f"{', '.join(counts) or 'No single orbits'}" + (f", {_tally(entries)}." if entries else "."),
        links=more,
        jump=jump,
        count=str(len(entries)),
        cards=joined(card(entry) for entry in entries),
        mechanisms=options(entry.mechanism for entry in entries),
        stabilities=options(entry.document["stability"] for entry in entries),
        symmetries=options(entry.document["symmetry"] for entry in entries),
    )
    about = f"A gallery of {plural(len(entries), 'periodic orbit')} of mechanical systems, each moving in real time."
    site.add("index.html", site.settings.title, main, ("gallery", motions), ("gallery.js",), about)


def _tally(entries: Sequence[Entry]) -> str:
    """How many were certified, rejected and not checked when the page was made."""
    verdicts = [entry.verdict.certified for entry in entries]
    named = {True: "certified when this page was made", False: "rejected", None: "not checked here"}
    counts = [(verdicts.count(one), words) for one, words in named.items()]
    return ", ".join(f"{count} {words}" for count, words in counts if count)
