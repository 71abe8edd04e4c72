"""Pages that are made while the site is built, so that they cannot be out of date: commands, validation."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

ROOT = Path(__file__).parents[1]


MARKER = re.compile(r"<!-- made: (\w+) ?(\S*) -->")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace a marker, `<!-- made: WHAT [FILE] -->`, by what it stands for."""
    return MARKER.sub(lambda found: MAKERS[found.group(1)](found.group(2)), markdown)


def commands(_: str) -> str:
    """The help text of every command."""
    from orbitfinder.cli.group import cli

    return "\n".join(described(cli))


def validation(_: str) -> str:
    """The validation page without its heading."""
    return (ROOT / "results" / "validation" / "README.md").read_text(encoding="utf-8").partition("\n")[2]


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


MAKERS = {"commands": commands, "validation": validation, "orbit": orbit, "family": family}


def described(group: click.Group, path: tuple[str, ...] = ("orbitfinder",)) -> Iterator[str]:
    """The help text of every command as a section."""
    for name in sorted(group.commands):
        command, full = group.commands[name], (*path, name)
        if isinstance(command, click.Group):
            yield from described(command, full)
            continue
        context = click.Context(command, info_name=" ".join(full), max_content_width=96, terminal_width=96)
        yield f"## `{' '.join(full)}`\n\n```text\n{command.get_help(context)}\n```\n"
