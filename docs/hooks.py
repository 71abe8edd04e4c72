"""Pages that are made while the site is built, so that they cannot be out of date: commands, validation."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

ROOT = Path(__file__).parents[1]


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Replace a marker by what it stands for."""
    if "{{ commands }}" in markdown:
        from orbitfinder.cli import cli

        return markdown.replace("{{ commands }}", "\n".join(described(cli)))
    if "{{ validation }}" in markdown:
        text = (ROOT / "results" / "validation" / "README.md").read_text(encoding="utf-8")
        return markdown.replace("{{ validation }}", text.partition("\n")[2])
    return markdown


def described(group: click.Group, path: tuple[str, ...] = ("orbitfinder",)) -> Iterator[str]:
    """The help text of every command as a section."""
    for name in sorted(group.commands):
        command, full = group.commands[name], (*path, name)
        if isinstance(command, click.Group):
            yield from described(command, full)
            continue
        context = click.Context(command, info_name=" ".join(full), max_content_width=96, terminal_width=96)
        yield f"## `{' '.join(full)}`\n\n```text\n{command.get_help(context)}\n```\n"
