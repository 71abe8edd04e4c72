"""One published number beside ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfinder.errors import OrbitfinderError


@dataclass(frozen=True)
class Comparison:
    """A quantity as published and as computed here; `difference` and `allowed` are in its unit.

    `published` keeps the digits of the source. `note` says what the allowance stands for, or what failed.
    """

    quantity: str
    published: str
    ours: str
    difference: float
    allowed: float
    note: str = ""

    @property
    def passed(self) -> bool:
        """True when the difference is a number within the allowance."""
        return bool(np.isfinite(self.difference) and abs(self.difference) <= self.allowed)


@dataclass(frozen=True)
class Section:
    """Comparisons with one source; `missing` says why there are none."""

    title: str
    source: str
    rows: tuple[Comparison, ...]
    missing: str = ""


def number(quantity: str, published: str, ours: float, allowed: float, note: str = "") -> Comparison:
    """A Comparison of two numbers, the published one as text."""
    return Comparison(quantity, published, repr(float(ours)), float(ours) - float(published), allowed, note)


def failed(quantity: str, published: str, error: OrbitfinderError) -> Comparison:
    """The row of something that could not be computed."""
    return Comparison(quantity, published, "none", float("nan"), 0.0, " ".join(str(error).split()))


def attempted(quantity: str, published: str, rows: Callable[[], Sequence[Comparison]]) -> list[Comparison]:
    """The rows, or one failed row when computing them raised one of our errors."""
    try:
        return list(rows())
    except OrbitfinderError as error:
        return [failed(quantity, published, error)]
