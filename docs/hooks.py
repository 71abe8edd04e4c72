"""What is made while the site is built, so that it cannot be out of date: commands, validation, changes, moving orbits.

Links that lead out of docs/ into the repository, `[x](../problems/x.toml)` or `![x](../results/x.png)`, work on a page
that nobody built; on the site their files are copied below `repository/`, where Markdown becomes pages too.
"""

from __future__ import annotations

import cmath
import inspect
import logging
import math
import posixpath
import re
from collections.abc import Iterator
from html import escape
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
    from orbitfinder.records.registry import load_orbit
    from orbitfinder.show.html import orbit_html

    shown = orbit_html(load_orbit(ROOT / file))
    seen = "; ".join(re.findall(r'aria-label="([^"]*)"', shown))
    return f"{shown}<p><small>From the left: {seen}.</small></p>"


def family(file: str) -> str:
    """A family of the repository as notebooks show it."""
    from orbitfinder.records.family import load_family
    from orbitfinder.show.html import family_html

    return family_html(load_family(ROOT / file))


CROSSINGS = {
    "fold": ((53, 0, 1.75), (-53, 0, 0.5)),
    "branch_point": ((53, 0, 1.75), (-53, 0, 0.5)),
    "period_doubling": ((127, 180, 1.75), (-127, -180, 0.5)),
    "resonance": ((74, 146, 1), (-74, -146, 1)),
    "collision": ((41, 70, 1.5), (100, 70, 0.6), (-41, -70, 1.5), (-100, -70, 0.6)),
    "torus": ((60, 60, 1.5), (-60, -60, 1.5)),
}
"""Of each multiplier at an event: the angles on the unit circle from which and to which it comes, its size after."""
ARROW = (
    '<marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="11" markerHeight="11" orient="auto" \
markerUnits="userSpaceOnUse"><path d="M0 0L8 4L0 8z"/></marker>'
)


def crossing(kind: str) -> str:
    """A sketch of the multipliers at an event: the unit circle, where they come from and where they go."""
    ways = []
    for start, end, size in CROSSINGS[kind]:
        begin = cmath.rect(60 if start != end else 33, -math.radians(start))
        there = cmath.rect(60, -math.radians(end))
        after = there * size
        path = f"M{begin.real:.1f} {begin.imag:.1f}A60 60 0 0 {int(end < start)} {there.real:.1f} {there.imag:.1f}"
        if start == end:
            path = f"M{begin.real:.1f} {begin.imag:.1f}"
        line = f"L{after.real:.1f} {after.imag:.1f}" if size != 1 else ""
        ways.append(f'<path class="way" d="{path}{line}" marker-end="url(#tip)"/>')
        ways.append(f'<circle cx="{begin.real:.1f}" cy="{begin.imag:.1f}" r="4"/>')
    return (
        f'<svg class="crossing" viewBox="-115 -90 230 180" role="img" aria-label="multipliers at a {kind}">'
        f'<defs>{ARROW}</defs><path class="axes" d="M-110 0H110M0 -85V85"/>'
        f'<circle class="unit" r="60"/>{"".join(ways)}</svg>'
    )


def events(_: str) -> str:
    """Every kind of event that families know, with what leads on from it, as a table."""
    from orbitfinder.families.entries import KINDS

    lines = ["| event | what happens | leads on |", "|---|---|---|"]
    for name, kind in KINDS.items():
        ways = ["`--switch`"] * kind.branches + ["`--curve`"] * bool(kind.followed)
        place = " (on curves in two parameters)" if kind.second else ""
        lines.append(f"| `{name}` | {kind.words}{place} | {', '.join(ways)} |")
    return "\n".join(lines)


MAKERS = {
    "crossing": crossing,
    "events": events,
    "commands": commands,
    "validation": validation,
    "changelog": changelog,
    "orbit": orbit,
    "family": family,
}


def described(group: click.Group) -> Iterator[str]:
    """Every command by what it is for: how it is called, what it does, examples, a table of its options."""
    from orbitfinder.cli.group import PURPOSES

    for heading, names in PURPOSES.items():
        yield f"## {heading}\n"
        for name in names:
            command = group.commands[name]
            many = command.commands if isinstance(command, click.Group) else {"": command}
            for own, each in many.items():
                yield from told(each, " ".join(filter(None, ("orbitfinder", name, own))))


def told(command: click.Command, name: str) -> Iterator[str]:
    """One command."""
    context = click.Context(command, info_name=name)
    said, _, examples = inspect.cleandoc(command.help or "").partition("\b\nExamples:\n")
    yield f"### `{name}`\n\n```text\n{name} {' '.join(command.collect_usage_pieces(context))}\n```\n"
    yield "".join(f"<p>{escape(part)}</p>" for part in said.strip().split("\n\n")) + "\n"
    if examples:
        yield f"```sh\n{inspect.cleandoc(examples)}\n```\n"
    rows = filter(None, (option.get_help_record(context) for option in command.get_params(context)))
    cells = (
        f"<tr><td><code>{escape(option)}</code></td><td>{escape(does)}</td></tr>"
        for option, does in rows
        if does
    )
    head = "<thead><tr><th>option</th><th>what it does</th></tr></thead>"
    yield f"<table>{head}<tbody>{''.join(cells)}</tbody></table>\n"
