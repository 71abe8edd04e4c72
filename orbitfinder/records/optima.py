"""Families of optima as plain numbers, and their file (format "orbitfinder/optima")."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError, plural
from orbitfinder.records.orbit import Orbit, orbit_in, orbit_to_document
from orbitfinder.records.reading import json_bytes, json_file, write_atomically

FORMAT, VERSION = "orbitfinder/optima", 1
AGAIN = "follow the optima again"


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
class Optima(Shown):
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

    name: str
    parameter: str
    points: tuple[Orbit, ...]
    values: np.ndarray
    descents: tuple[int, ...]
    changes: tuple[Change, ...] = ()
    end: str = ""

    @property
    def costs(self) -> np.ndarray:
        """The cost of each point."""
        return np.array([float(one.control["cost"]) if one.control else np.nan for one in self.points])

    @property
    def counts(self) -> str:
        """How many points there are, certified, and what happens along them, in words."""
        sure = sum(one.certificate is not None and one.certificate.passed for one in self.points)
        lowest = sum(one == 0 for one in self.descents)
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
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    document = {
        "format": FORMAT, "version": VERSION, "name": found.name, "parameter": found.parameter, "end": found.end,
        "values": [float(one) for one in found.values], "descents": list(found.descents),
        "changes": [vars(one) for one in found.changes], "points": [orbit_to_document(one) for one in found.points],
    }  # fmt: skip
    write_atomically(target, json_bytes(document))
    return target


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
    document = json_file(Path(path), "optima.json", AGAIN)
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        raise InputError(f"{path}: format: expected {FORMAT!r} of version {VERSION}; give an optima.json")
    try:
        points = tuple(orbit_in(one, f"{path}#{k}") for k, one in enumerate(document["points"]))
        values, descents = np.array(document["values"], float), tuple(int(one) for one in document["descents"])
        changes = tuple(_change(one, len(points)) for one in document["changes"])
        if not points or values.shape != (len(points),) or len(descents) != len(points):
            raise ValueError("as many values and descents as points are needed, and one at least")
        if any(one.control is None for one in points):
            raise ValueError("a point without control")
        return Optima(str(document["name"]), str(document["parameter"]), points, values, descents, changes,
                      str(document["end"]))  # fmt: skip
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: malformed entry ({error}); {AGAIN}") from error


def _change(entry: Mapping[str, Any], count: int) -> Change:
    numbers = [float(entry[name]) for name in ("value", "cost", "period")]
    if not 0 <= int(entry["index"]) < count:
        raise ValueError(f"a change at point {entry['index']} of {count}")
    value, cost, period = numbers
    return Change(str(entry["kind"]), int(entry["index"]), value, cost, period, str(entry["detail"]))
