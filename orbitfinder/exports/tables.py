"""Records as tables, a row a point: CSV, and JSON as a list of rows by their columns."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.exports.formats import TABLES
from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.mechanics.model import Model
from orbitfinder.records.reading import finite, json_bytes, write_atomically
from orbitfinder.records.registry import kind_of, loaded

Columns = Mapping[str, Sequence[Any]]


def rest_columns(equilibria: Equilibria, names: Sequence[str]) -> Columns:
    """Every equilibrium of a curve: the parameter, the state by the `names` of its components, eigenvalues, verdicts."""
    points = equilibria.points
    eigenvalues = np.array([point.eigenvalues for point in points])
    pairs = [(f"eigenvalue_{k + 1}_re", values.real) if not part else (f"eigenvalue_{k + 1}_im", values.imag)
             for k, values in enumerate(eigenvalues.T) for part in (0, 1)]  # fmt: skip
    columns = [("index", range(len(points))), (equilibria.parameter, [point.value for point in points]),
               *zip(names, np.array([point.state for point in points]).T, strict=True), *pairs,
               *((name, [getattr(point, name) for point in points]) for name in ("stability", "residual", "certified"))]
    return {name: np.asarray(values).tolist() for name, values in columns}


def csv_table(columns: Columns) -> str:
    """A header line, then the rows; digits that round-trip."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(chain([columns], zip(*columns.values(), strict=True)))
    return text.getvalue()


def json_table(columns: Columns) -> str:
    """A list of rows, each by its columns; what is not finite as null."""
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return json_bytes(finite(rows)).decode()


def export_equilibria(equilibria: Equilibria, to: str, folder: Path, model: Model) -> list[Path]:
    """What `export --to` writes of equilibria: NAME.csv or NAME.json, never over a record. Raises `InputError`."""
    if to not in TABLES:
        raise InputError(f"to: {to} files hold orbits, and these are equilibria; use one of {', '.join(TABLES)}")
    target = folder / f"{equilibria.name}.{to}"
    if target.exists() and kind_of(target):
        raise InputError(f"--out: {target} is a record, which a table would replace; give another folder")
    write_atomically(target, loaded(TABLES[to])(rest_columns(equilibria, model.state_names)).encode())
    return [target]
