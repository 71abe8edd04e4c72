"""The reference of Python: which names are on which page, and links to them from `of.name` on every page."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path
from posixpath import dirname, relpath
from typing import Any

ROOT = Path(__file__).parents[1]
PAGES = ROOT / "docs" / "reference" / "python"
ENTRY = re.compile(r"^::: orbitfinder\.([\w.]+)", re.MULTILINE)
CODE = re.compile(r"(?<!<pre>)<code>(of\.[\w.]+)(\([^<]*\))?</code>(?!</a>)")


@cache
def places() -> dict[str, str]:
    """Where each public name, `of.name`, is described: page and anchor below docs/."""
    found = {}
    for page in sorted(PAGES.glob("*.md")):
        for home in ENTRY.findall(page.read_text(encoding="utf-8")):
            found[home] = f"reference/python/{page.stem}.html#orbitfinder.{home}"
    return {f"of.{name}": found[home] for name, home in homes().items() if home in found}


@cache
def homes() -> dict[str, str]:
    """The module and name behind each public name."""
    found = {}
    doors = (
        ("__init__.pyi", "", ""),
        ("orbits/guesses/__init__.pyi", "guesses.", "orbits.guesses."),
    )
    for stub, door, room in doors:
        text = (ROOT / "orbitfinder" / stub).read_text(encoding="utf-8")
        for home, name in re.findall(r"^from \.(\S+) import (\w+)", text, re.MULTILINE):
            found[door + name] = f"{room}{home}.{name}"
    for door in ("linkages", "flows", "sections"):
        text = (ROOT / "orbitfinder" / f"{door}.py").read_text(encoding="utf-8")
        for home, names in re.findall(
            r"^from orbitfinder\.(\S+) import ([\w, ]+)$", text, re.MULTILINE
        ):
            found |= {f"{door}.{name}": f"{home}.{name}" for name in names.split(", ")}
    return found


def on_page_content(html: str, page: Any, **_: Any) -> str:
    """The hook of mkdocs: `of.name` becomes a link to its description."""
    here = page.file.url

    def linked(found: re.Match[str]) -> str:
        name, call = found.group(1), found.group(2) or ""
        if name not in places():
            return found.group(0)
        return f'<a href="{relpath(places()[name], dirname(here) or ".")}"><code>{name}{call}</code></a>'

    return CODE.sub(linked, html)
