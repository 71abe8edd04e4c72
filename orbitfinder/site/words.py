"""What things are called on the pages."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

COUNTS = ("", "single", "double", "triple", "quadruple", "quintuple", "sextuple")
BARS = {3: "three-bar", 4: "four-bar", 5: "five-bar", 6: "six-bar", 7: "seven-bar", 8: "eight-bar"}
NAMES = {"henon_heiles": "Hénon-Heiles", "van_der_pol": "Van der Pol", "duffing": "Duffing",
         "forced_duffing": "forced Duffing", "restricted_three_body": "restricted three-body"}  # fmt: skip
EVENTS = {
    "fold": "fold",
    "branch_point": "branch point",
    "period_doubling": "period doubling",
    "torus": "torus",
    "resonance": "resonance",
    "collision": "collision",
    "stability_change": "stability change",
}


def mechanism(system: Mapping[str, Any]) -> str:
    """The kind of mechanism in two or three words, for captions and the filter."""
    kind = system.get("kind")
    if kind == "chain":
        links = system.get("links")
        known = isinstance(links, int) and 1 <= links < len(COUNTS)
        return f"{COUNTS[links] if known else f'{links}-link'} pendulum"  # type: ignore[index]
    if kind == "linkage":
        lengths = system.get("length")
        bars = len(lengths) + 1 if isinstance(lengths, list) else 0
        return f"{BARS.get(bars, f'{bars}-bar')} linkage"
    if kind == "python":
        name = str(system.get("function", "python"))
        return NAMES.get(name, name.replace("_", " "))
    return str(kind)


def coordinate(name: str) -> str:
    """A coordinate's name for an axis in Plotly's small HTML: theta3 with its subscript, others as they are."""
    found = re.fullmatch(r"theta(\d*)", name)
    if found:
        return f"θ<sub>{found.group(1)}</sub>" if found.group(1) else "θ"
    plain = re.fullmatch(r"([A-Za-z]+)(\d+)", name)
    text = f"{plain.group(1)}<sub>{plain.group(2)}</sub>" if plain else name
    return text if plain else re.sub(r"[<>&]", "", text)


def plural(count: int, noun: str) -> str:
    """`1 orbit`, `2 orbits`, `3 families`."""
    many = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}es" if noun.endswith("s") else f"{noun}s"
    return f"{count} {noun if count == 1 else many}"
