"""Records as tables, a row a point: CSV, and JSON as a list of rows by their columns."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.exports.formats import TABLES
from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.mechanics.model import Model
from orbitfinder.records.reading import finite, json_bytes, write_atomically
from orbitfinder.records.registry import kind_of


def table_bytes(columns: dict[str, Any], to: str) -> bytes:
    """Columns of one length as one of `TABLES`; digits that round-trip, in JSON null for what is not finite."""
    rows = [*zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)]
    if to == "json":
        return json_bytes(finite([dict(zip(columns, row, strict=True)) for row in rows]))
    csv.writer(text := io.StringIO(), lineterminator="\n").writerows([columns, *rows])
    return text.getvalue().encode()


def export_equilibria(equilibria: Equilibria, to: str, folder: Path, model: Model) -> list[Path]:
    """What `export --to` writes of equilibria: NAME.csv or NAME.json, never over a record. Raises `InputError`."""
    target, points = folder / f"{equilibria.name}.{to}", equilibria.points
    if to not in TABLES:
        raise InputError(f"to: {to} files hold orbits, and these are equilibria; use one of {', '.join(TABLES)}")
    if target.exists() and kind_of(target):
        raise InputError(f"--out: {target} is a record, which a table would replace; give another folder")
    states, values = (np.array([getattr(point, name) for point in points]).T for name in ("state", "eigenvalues"))
    columns = {"index": range(len(points)), equilibria.parameter: [point.value for point in points]}
    columns |= dict(zip(model.state_names, states, strict=True))
    for k, eigenvalue in enumerate(values, 1):
        columns |= {f"eigenvalue_{k}_re": eigenvalue.real, f"eigenvalue_{k}_im": eigenvalue.imag}
    columns |= {name: [getattr(point, name) for point in points] for name in ("stability", "residual", "certified")}
    write_atomically(target, table_bytes(columns, to))
    return [target]
