"""Text that goes into pages: escaping, templates, and data as JavaScript files.

Names and titles come from files that anyone may have written, so every value is escaped unless it is
`Html`, which only this package makes.
"""

from __future__ import annotations

import html
import json
import math
import re
from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from string import Template
from typing import Any

from orbitfinder.records.reading import finite

ASSETS = "assets"


class Html(str):
    """Text that is markup already and is not escaped again."""

    __slots__ = ()


def escaped(value: object) -> Html:
    """A value as text between tags or in a quoted attribute."""
    return value if isinstance(value, Html) else Html(html.escape(str(value), quote=True))


@lru_cache(maxsize=32)
def template(name: str) -> Template:
    """The template of a name in assets/templates."""
    return Template(files(__package__).joinpath(ASSETS, "templates", f"{name}.html").read_text(encoding="utf-8"))


def fill(name: str, /, **values: object) -> Html:
    """A template with its $names filled in, each value escaped unless it is `Html`."""
    return Html(template(name).substitute({key: escaped(value) for key, value in values.items()}))


def joined(parts: Any, separator: str = "\n") -> Html:
    """Pieces of markup (others escaped) one after the other."""
    return Html(separator.join(escaped(part) for part in parts))


def script_data(key: str, payload: Any) -> str:
    """A JavaScript file that registers `payload` under `key`.

    Data are scripts because a page opened from disk may not fetch files. `<`, `>`, `&` and the line
    separators U+2028 and U+2029 are written as escapes, so the text is inert wherever it is put.
    """
    text = json.dumps(finite(payload), separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    for letter in "<>&":
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return f"orbitfinder.put({json.dumps(key)},{text});\n"


def slug_maker() -> Callable[[str], str]:
    """A function that turns names into distinct file names of lower-case letters, digits, - and _."""
    taken: set[str] = set()

    def make(name: str) -> str:
        base = re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-")[:60] or "unnamed"
        found, count = base, 1
        while found in taken:
            count += 1
            found = f"{base}-{count}"
        taken.add(found)
        return found

    return make


def number(value: float | None, digits: int = 6) -> str:
    """A number for reading: plain where that is short, with a power of ten otherwise."""
    if value is None or not math.isfinite(value):
        return "not computed"
    return f"{value:.{digits}g}".replace("-", "\N{MINUS SIGN}")


def size(count: int) -> str:
    """Bytes as kB or MB (powers of 1000)."""
    return f"{count / 1e6:.2f} MB" if count >= 1_000_000 else f"{max(1, round(count / 1e3))} kB"
