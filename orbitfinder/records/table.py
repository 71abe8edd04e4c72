"""Records of many points as tables: columns of equal length by their names, a row a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from orbitfinder._runtime.notebook import Shown
from orbitfinder._runtime.rooms import loaded
from orbitfinder.errors import InputError
from orbitfinder.records.reading import Entries, Table

Tables = dict[str, Entries]
"""Columns by the table that they are of"""


class Tabled(Shown):
    """A record whose points, and whatever else comes in rows, are tables."""

    __slots__ = ()
    _tables: ClassVar[str] = ""
    """(record, model) -> its `Tables`, "module:function"; "" of what needs no model and has `own_tables`"""

    def tables(self, model: Any = None) -> Tables:
        """Every table as columns by name: `points`, and `events` and `ends` where there are such."""
        made: Tables = loaded(self._tables)(self, model) if self._tables else self.own_tables()
        return made

    def own_tables(self) -> Tables:
        """The same of what the record itself knows."""
        return {}

    def table(self, of: str = "points", model: Any = None) -> Any:
        """A table of it: a pandas.DataFrame where pandas is installed, else a NumPy record array.

        Args:
            of: points, or what else `tables` has: events, ends.
            model: needed only for systems that no file describes.

        Returns:
            A row a point; of orbits the parameters by their own names, period, energy and action where there is such,
            amplitude_C, min_C and max_C of every coordinate C, largest_multiplier, stability, certified, closure.

        Raises:
            InputError: for a table that it has not.
        """
        made = self.tables(model)
        if of not in made:
            raise InputError(f"of: unknown table {of!r}; it has {', '.join(made)}")
        return framed(made[of])


def framed(columns: Mapping[str, Sequence[Any]]) -> Any:
    """Columns as a pandas.DataFrame, without pandas as a NumPy record array."""
    words = ("kind", "detail", "criticality", "reason", "stability", "became", "curve")
    empty = dict.fromkeys(words, str) | {"certified": bool, "point": int, "order": int}
    arrays = {name: np.asarray(values, None if len(values) else empty.get(name)) for name, values in columns.items()}
    try:
        from pandas import DataFrame  # noqa: PLC0415  not ours to ask for
    except ImportError:
        return np.rec.fromarrays([*arrays.values()], dtype=[(name, each.dtype) for name, each in arrays.items()])
    return DataFrame(arrays)


def placed(parameters: Table, columns: Table) -> Entries:
    """A table's columns: the row's number, then parameters by their own names, which no other column takes."""
    count = len(next(iter({**parameters, **columns}.values())))
    return {"index": np.arange(count), **parameters, **columns, **parameters}


def known_levels(points: Sequence[Any]) -> dict[str, list[float]]:
    """The columns `period`, and `energy` and `action` of what has an energy."""
    levels = ("energy", "action") if any(np.isfinite(point.energy) for point in points) else ()
    names = [name for name in ("period", *levels) if all(hasattr(point, name) for point in points)]
    return {name: [getattr(point, name) for point in points] for name in names}


def extent_columns(names: Sequence[str], low: np.ndarray, high: np.ndarray) -> dict[str, np.ndarray]:
    """amplitude_C, min_C and max_C of coordinates (n) by their least and largest values (k x n) over a period."""
    return {
        f"{word}_{name}": column[:, k]
        for k, name in enumerate(names)
        for word, column in (("amplitude", (high - low) / 2), ("min", low), ("max", high))
    }


def verdict_columns(points: Sequence[Any], certified: Sequence[bool]) -> Entries:
    """largest_multiplier, stability, certified and closure of orbits."""
    return {
        "largest_multiplier": [max(map(abs, point.floquet_multipliers.tolist()), default=1.0) for point in points],
        "stability": [point.stability for point in points],
        "certified": list(certified),
        "closure": [point.closure for point in points],
    }


def stacked(parts: Mapping[str, Table]) -> Entries:
    """Tables below each other by the file that each is of, a column `curve`; nothing where a part has not a column."""
    columns = dict[str, list[Any]]({"curve": []})
    lengths = {file: len(next(iter(part.values()))) for file, part in parts.items()}
    for name in dict.fromkeys(name for part in parts.values() for name in part):
        told = [np.asarray(part[name]) for part in parts.values() if name in part]
        kind = next((each.dtype.kind for each in told if each.size), "f")
        nothing = {"U": "", "b": None}.get(kind, np.nan)
        columns[name] = [value for file, part in parts.items()
                         for value in (part[name] if name in part else [nothing] * lengths[file])]  # fmt: skip
    columns["curve"] = [file for file, length in lengths.items() for _ in range(length)]
    return columns


def entries(rows: Sequence[Any], *names: str) -> dict[str, list[Any]]:
    """Columns of attributes, nan where nothing is known."""
    told = {name: [getattr(row, name) for row in rows] for name in names}
    return {name: [np.nan if value is None else value for value in values] for name, values in told.items()}
