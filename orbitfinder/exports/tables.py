"""Records as tables, a row a point: CSV, Parquet, and JSON as a list of rows by their columns."""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.exports.formats import TABLES
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import given_units, unit_names, units
from orbitfinder.records.reading import Table, finite, json_bytes, write_atomically
from orbitfinder.records.registry import kind_of
from orbitfinder.records.table import Tabled

Told = Mapping[str, tuple[str, str]]
"""The unit and the meaning of columns"""


def table_bytes(columns: Table, to: str, told: Told | None = None, system: Table | None = None) -> bytes:
    """Columns of equal length as one of `TABLES`; digits that round-trip, CSV has nothing and JSON null for what is no
    number. Parquet says the system (JSON) and what is `told` of columns in its metadata.

    Raises `InputError` for parquet without its extra.
    """
    if to == "parquet":
        try:
            import pyarrow  # noqa: PLC0415  an extra
            from pyarrow import parquet  # noqa: PLC0415  an extra
        except ImportError as error:
            raise InputError("kind: parquet needs pyarrow; pip install 'orbitfinder[parquet]', or use csv") from error
        table = pyarrow.table({name: np.asarray(values).tolist() for name, values in columns.items()})
        known = {name: dict(zip(("unit", "meaning"), words, strict=True)) for name, words in (told or {}).items()}
        fields = [table.schema.field(name).with_metadata(known.get(name)) for name in columns]
        fields = [each.with_type(pyarrow.float64()) if pyarrow.types.is_null(each.type) else each for each in fields]
        sink, about = io.BytesIO(), {"system": json.dumps(dict(system or {}), sort_keys=True)}
        parquet.write_table(table.cast(pyarrow.schema(fields, about)), sink)
        return sink.getvalue()
    rows = [*zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)]
    if to == "json":
        return json_bytes(finite([dict(zip(columns, row, strict=True)) for row in rows]))
    shown = [["" if value != value else value for value in row] for row in rows]
    csv.writer(text := io.StringIO(), lineterminator="\n").writerows([[*columns], *shown])
    return text.getvalue().encode()


def refuse_another(target: Path, content: bytes) -> None:
    """`InputError` where a CSV file would replace a table of other columns, which is another record's."""
    if target.suffix == ".csv" and target.is_file():
        with target.open("rb") as stream:
            if stream.readline().rstrip() != content.partition(b"\n")[0]:
                raise InputError(f"--out: {target} is a table of other columns, of another record of that name; "
                                 "give another folder, or delete it")  # fmt: skip


def export_table(record: Any, to: str, folder: Path, model: Model) -> list[Path]:
    """What `export --to` writes of a record of many points: NAME.csv (or parquet, json), its other tables that have
    rows NAME-events.csv, NAME-ends.csv; never over a record. Raises `InputError`."""
    tabled: Tabled = record
    if to not in TABLES:
        raise InputError(f"to: {to} files hold orbits, and {record.name} is a table; use one of {', '.join(TABLES)}")
    written = list[Path]()
    for of, columns in tabled.tables(model).items():
        target = folder / f"{record.name}{'' if of == 'points' else f'-{of}'}.{to}"
        if target.exists() and kind_of(target):
            raise InputError(f"--out: {target} is a record, which a table would replace; give another folder")
        if of == "points" or len(next(iter(columns.values()))):
            words, n = units(model.system), model.degrees_of_freedom
            own = {**dict(zip(model.state_names[:n], unit_names(model), strict=True)), **given_units(model.system)}
            own |= {"period": words["time"], "energy": words["energy"], "action": words["action"]}
            words = {name: own.get(re.sub("^(amplitude|min|max)_", "", name), "") for name in columns}
            told = {name: (unit, "") for name, unit in words.items() if unit}
            content = table_bytes(columns, to, told, record.system)
            refuse_another(target, content)
            write_atomically(target, content)
            written.append(target)
    return written
