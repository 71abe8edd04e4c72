"""Families of optima as plain numbers, and their file (format "orbitfinder/optima")."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import plural
from orbitfinder.records.certificate import certified
from orbitfinder.records.codec import Codec
from orbitfinder.records.orbit import Orbit, Orbits
from orbitfinder.records.table import Tabled


@dataclass(frozen=True)
class Change:
    """What happens along a family of optima at the point with number `index`, at a `value` of its parameter.

    `kind`: fold (the family turns back) | active | inactive (a constraint begins or ceases to be met just so) | least |
    largest (of the cost along it) | costless (no control is needed: the motion of the mechanism alone) | branch (other
    optima branch off between the point before and this one).
    """

    kind: str
    index: int
    value: float
    cost: float
    period: float
    detail: str = ""


@dataclass(frozen=True)
class Optima(Tabled):
    """Controlled orbits along a family of optima.

    Args:
        name: a word for files.
        parameter: what varies.
        points: the orbits.
        values: of the parameter.
        descents: how many directions lower the cost to second order: 0 of a local least, more beyond a turn.
        changes: turning points, changes of the active set, extremes of the cost.
        end: why it ends.

    Examples:
        >>> optima.descents
        (0, 0)
    """

    __repr__ = brief("name", "parameter", "points", "changes", "end")
    _tables = "control.table:optima_tables"
    _entries = (..., "end", "values", "descents", "changes", "points")

    name: str
    parameter: str
    points: Orbits
    values: np.ndarray
    descents: tuple[int, ...]
    changes: tuple[Change, ...] = ()
    end: str = ""

    @property
    def system(self) -> Mapping[str, Any]:
        """What rebuilds the model of the first point."""
        return self.points[0].system

    @property
    def costs(self) -> np.ndarray:
        """The cost of each point."""
        return np.array([float(point.control["cost"]) if point.control else np.nan for point in self.points])

    @property
    def counts(self) -> str:
        """How many points there are, certified, and what happens along them, in words."""
        sure = sum(map(certified, self.points))
        lowest = sum(count == 0 for count in self.descents)
        return (
            f"{plural(len(self.points), 'point')}, {sure} of them certified, {lowest} of them local least ones; "
            f"{plural(len(self.changes), 'change')}"
        )

    def __len__(self) -> int:
        return len(self.points)

    def __iter__(self) -> Iterator[Orbit]:
        return iter(self.points)

    def __getitem__(self, k: int) -> Orbit:
        return self.points[k]

    def _check(self) -> None:
        count = len(self.points)
        for name, numbers in (("values", self.values), ("descents", self.descents)):
            if not count or np.shape(numbers) != (count,):
                raise ValueError(f"{name}: expected one of each of {plural(count, 'point')}, and one at least")
        for k, change in enumerate(self.changes):
            if not 0 <= change.index < count:
                raise ValueError(f"changes[{k}].index: expected 0 to {count - 1}, got {change.index}")
        for k, point in enumerate(self.points):
            if point.control is None:
                raise ValueError(f"points[{k}].control: missing")


CODEC = Codec(Optima, "optima", "`orbitfinder continue`", "follow the optima again")


def save_optima(found: Optima, path: str | Path) -> Path:
    """Write an optima.json.

    Args:
        found: the optima.
        path: where.

    Returns:
        The path.

    Raises:
        InputError: where it cannot be written.

    Examples:
        >>> of.save_optima(optima, "optima.json").name
        'optima.json'
    """
    return CODEC.save(found, path)


def load_optima(path: str | Path) -> Optima:
    """Read an optima.json; its points come without samples.

    Args:
        path: of the file.

    Returns:
        Optima.

    Raises:
        InputError: on anything unreadable.

    Examples:
        >>> _ = of.save_optima(optima, "optima.json")
        >>> of.load_optima("optima.json").parameter
        'period'
    """
    return CODEC.load(path)
