"""Orbits of an atlas as JSON, CSV or Parquet."""

from __future__ import annotations

import csv
import io
import json
from typing import Any

from orbitfinder.atlas.store import Atlas, Filter, named_state
from orbitfinder.errors import InputError


def exported(atlas: Atlas, kind: str, chosen: Filter | None = None) -> bytes:
    """The content of a file of that kind: json (orbit documents), csv or parquet (one row an orbit)."""
    if kind == "json":
        return (json.dumps(list(atlas.documents(chosen)), indent=1, allow_nan=False) + "\n").encode()
    states = atlas.model.state_names
    rows = [flat(row.id, row.instability, atlas.document(row.id), states) for row in atlas.rows(chosen)]
    names = list(flat_names(states))
    return as_csv(names, rows) if kind == "csv" else as_parquet(names, rows)


def flat_names(state_names: tuple[str, ...]) -> tuple[str, ...]:
    """Columns of the table."""
    return (
        "id", "energy", "period", "action", "symmetry", "stability", "instability", "closure", "pair_defect",
        *state_names, "strategy", "seed", "start",
    )  # fmt: skip


def flat(number: int, instability: float, document: dict[str, Any], state_names: tuple[str, ...]) -> dict[str, Any]:
    """One row: numbers in SI units and rad, the state at t = 0 and where the orbit came from."""
    origin = dict(document.get("provenance") or {})
    known = document | {"id": number, "instability": instability, "strategy": origin.get("strategy", "")}
    known |= {"seed": origin.get("seed"), "start": origin.get("index")}
    known |= named_state(document, state_names)
    return {name: known[name] for name in flat_names(state_names)}


def as_csv(names: list[str], rows: list[dict[str, Any]]) -> bytes:
    """A CSV file with a header line; numbers round-trip exactly."""
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def as_parquet(names: list[str], rows: list[dict[str, Any]]) -> bytes:
    """A Parquet file. Raises `InputError` without the extra `parquet`."""
    try:
        import pyarrow  # noqa: PLC0415  an extra
        from pyarrow import parquet  # noqa: PLC0415  an extra
    except ImportError as error:
        raise InputError("kind: parquet needs pyarrow; pip install 'orbitfinder[parquet]', or use csv") from error
    columns = {name: [row[name] for row in rows] for name in names}
    sink = io.BytesIO()
    parquet.write_table(pyarrow.table(columns), sink)
    return sink.getvalue()
