"""Text that goes into pages: templates, what things are called, and data as JavaScript files.

Names and titles come from files that anyone may have written, so the templates escape every value.
"""

from __future__ import annotations

import json
import re
import unicodedata
from collections.abc import Callable
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from orbitfinder._runtime.inert import inert
from orbitfinder.mechanics.kind import NAMES, system_kind
from orbitfinder.records.reading import Table, finite
from orbitfinder.show.facts import number

ASSETS = "assets"


def rendered(template: str, /, **values: Any) -> str:
    """The page of a template of assets/templates."""
    return PAGES.get_template(f"{template}.html").render(values)


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
    taken = set()

    def make(name: str) -> str:
        base = re.sub(r"[^a-z0-9_-]+", "-", name.lower()).strip("-")[:60] or "unnamed"
        slug, count = base, 1
        while slug in taken:
            count += 1
            slug = f"{base}-{count}"
        taken.add(slug)
        return slug

    return make


def size(count: int) -> str:
    """Bytes as kB or MB (powers of 1000)."""
    return f"{count / 1e6:.2f} MB" if count >= 1_000_000 else f"{max(1, round(count / 1e3))} kB"


def mechanism(system: Table) -> str:
    """The kind of mechanism in two or three words, for captions and the filter."""
    return system_kind(system).words(system)


def plain_words(text: str) -> str:
    """A text for searching: lower case, without accents."""
    return "".join(
        letter for letter in unicodedata.normalize("NFKD", text.lower()) if not unicodedata.combining(letter)
    )


def article(words: str) -> str:
    """What a sentence calls a system: "the triple pendulum", and the system of somebody."""
    return f"the {words} system" if words in NAMES.values() else f"the {words}"


def coordinate(name: str) -> str:
    """A coordinate's name for an axis in Plotly's small HTML: theta3 with its subscript, others as they are."""
    angle = re.fullmatch(r"theta(\d*)", name)
    if angle:
        return f"θ<sub>{angle.group(1)}</sub>" if angle.group(1) else "θ"
    plain = re.fullmatch(r"([A-Za-z]+)(\d+)", name)
    text = f"{plain.group(1)}<sub>{plain.group(2)}</sub>" if plain else name
    return text if plain else inert(text)


def symmetry_words(name: str) -> str:
    """A symmetry for reading."""
    return "no symmetry" if name == "none" else name.replace("+", " and ")


PAGES = Environment(
    loader=PackageLoader(__package__, f"{ASSETS}/templates"), autoescape=True, undefined=StrictUndefined,
    trim_blocks=True, keep_trailing_newline=True,
)  # fmt: skip
PAGES.filters |= {"number": number, "symmetry": symmetry_words}
