"""What is made while the site is built, so that it cannot be out of date: commands, validation, changes, moving orbits.

Links that lead out of docs/ into the repository, `[x](../problems/x.toml)` or `![x](../results/x.png)`, work on a page
that nobody built; on the site their files are copied below `repository/`, where Markdown becomes pages too.
"""

from __future__ import annotations

import logging
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
CARRIED = "repository/"
PICTURES = {".png", ".gif", ".svg"}
LARGEST = 1_000_000
"""Bytes of a file that the site carries; larger ones are named without a link."""
MARKER = re.compile(r"<!-- made: (\w+) ?(\S*) -->")
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s#]+)(#[^)\s]*)?\)")
log = logging.getLogger("mkdocs.hooks.orbitfinder")


def on_files(files: Any, config: Any) -> Any:
    """Carry along what pages link to outside docs/: first their files, then the pictures of carried pages."""
    wanted = {place for page in DOCS.rglob("*.md") for place in outside(page)}
    wanted |= {
        one
        for place in wanted
        if place.endswith(".md")
        for one in outside(ROOT / place)
        if is_picture(one)
    }
    for place in sorted(wanted):
        if (ROOT / place).stat().st_size <= LARGEST:
            files.append(File.generated(config, CARRIED + place, abs_src_path=str(ROOT / place)))
    icon = "orbitfinder/site/assets/icon.svg"
    files.append(File.generated(config, "assets/icon.svg", abs_src_path=str(ROOT / icon)))
    return files


def outside(page: Path) -> Iterator[str]:
    """The files of the repository outside docs/ that a page links to, as paths from its root."""
    for found in LINK.finditer(page.read_text(encoding="utf-8")):
        place = resolved(page.relative_to(ROOT).as_posix(), found.group(3))
        if not place.startswith("docs/") and (ROOT / place).is_file():
            yield place


def resolved(page: str, target: str) -> str:
    """Where a link of a page leads, as a path from the root of the repository."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), target))


def is_picture(place: str) -> bool:
    """Whether a file is a picture."""
    return posixpath.splitext(place)[1] in PICTURES


def on_page_markdown(markdown: str, page: Any, files: Any, **_: Any) -> str:
    """Replace a marker, `<!-- made: WHAT [FILE] -->`, by what it stands for, and mend links into the repository."""
    source = page.file.src_uri
    carried = source.startswith(CARRIED)
    place = source.removeprefix(CARRIED) if carried else f"docs/{source}"

    def mended(found: re.Match[str]) -> str:
        picture, text, target, anchor = found.groups()
        aim = resolved(place, target)
        if ":" in target or (aim.startswith("docs/") and not carried):
            return found.group(0)
        known = aim.removeprefix("docs/") if aim.startswith("docs/") else CARRIED + aim
        if files.get_file_from_path(known) is None:
            if not carried and not (ROOT / aim).exists():
                log.warning("%s: no file %s", source, aim)
            return text
        way = posixpath.relpath(known, posixpath.dirname(source))
        return f"{picture}[{text}]({way}{anchor or ''})"

    return MARKER.sub(
        lambda found: MAKERS[found.group(1)](found.group(2)), LINK.sub(mended, markdown)
    )


def commands(_: str) -> str:
    """The help text of every command."""
    from orbitfinder.cli.group import cli

    return "\n".join(described(cli))


def validation(_: str) -> str:
    """The validation page without its heading."""
    return (
        (ROOT / "results" / "validation" / "README.md")
        .read_text(encoding="utf-8")
        .partition("\n")[2]
    )


def changelog(_: str) -> str:
    """The changes without their heading."""
    return (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").partition("\n")[2]


def orbit(file: str) -> str:
    """An orbit of the repository as notebooks show it, moving."""
    from orbitfinder.records.store import load_orbit
    from orbitfinder.show.html import orbit_html

    return orbit_html(load_orbit(ROOT / file))


def family(file: str) -> str:
    """A family of the repository as notebooks show it."""
    from orbitfinder.records.family import load_family
    from orbitfinder.show.html import family_html

    return family_html(load_family(ROOT / file))


CROSSINGS = {
    "fold": (("0.6+0.8j", "1", "1.7"), ("0.6-0.8j", "1", "0.59")),
    "branch_point": (("0.6+0.8j", "1", "1.7"), ("0.6-0.8j", "1", "0.59")),
    "period_doubling": (("-0.6+0.8j", "-1", "-1.7"), ("-0.6-0.8j", "-1", "-0.59")),
    "resonance": (
        ("0.28+0.96j", "-0.5+0.866j", "-0.8+0.6j"),
        ("0.28-0.96j", "-0.5-0.866j", "-0.8-0.6j"),
    ),
    "collision": (
        ("0.75+0.66j", "0.35+0.94j", "0.48+1.28j"),
        ("-0.1+0.995j", "0.35+0.94j", "0.26+0.69j"),
        ("0.75-0.66j", "0.35-0.94j", "0.48-1.28j"),
        ("-0.1-0.995j", "0.35-0.94j", "0.26-0.69j"),
    ),
    "torus": (("0.3+0.5j", "0.5+0.866j", "0.65+1.2j"), ("0.3-0.5j", "0.5-0.866j", "0.65-1.2j")),
}
"""The way of each multiplier in the complex plane: before an event, at it, after it."""


def crossing(kind: str) -> str:
    """A sketch of the multipliers at an event: the unit circle, where they come from and where they go."""
    ways = []
    for way in CROSSINGS[kind]:
        points = [f"{60 * one.real:.1f},{-60 * one.imag:.1f}" for one in map(complex, way)]
        x, y = points[0].split(",")
        ways.append(
            f'<polyline points="{" ".join(points)}" marker-end="url(#tip)"/><circle cx="{x}" cy="{y}" r="4"/>'
        )
    return (
        f'<svg class="crossing" viewBox="-115 -90 230 180" role="img" aria-label="multipliers at a {kind}">'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="6" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0L8 4L0 8z"/></marker></defs><path class="axes" d="M-110 0H110M0 -85V85"/>'
        f'<circle class="unit" r="60"/>{"".join(ways)}</svg>'
    )


MAKERS = {
    "crossing": crossing,
    "commands": commands,
    "validation": validation,
    "changelog": changelog,
    "orbit": orbit,
    "family": family,
}


def described(group: click.Group, path: tuple[str, ...] = ("orbitfinder",)) -> Iterator[str]:
    """The help text of every command as a section."""
    for name in sorted(group.commands):
        command, full = group.commands[name], (*path, name)
        if isinstance(command, click.Group):
            yield from described(command, full)
            continue
        context = click.Context(
            command, info_name=" ".join(full), max_content_width=96, terminal_width=96
        )
        yield f"## `{' '.join(full)}`\n\n```text\n{command.get_help(context)}\n```\n"
