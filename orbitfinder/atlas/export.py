"""Orbits of an atlas as JSON, CSV or Parquet."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from typing import Any

from orbitfinder.atlas.signature import in_words
from orbitfinder.atlas.store import Atlas, AtlasRow, Filter, named_state, proved
from orbitfinder.errors import InputError
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.records.orbit import orbit_from_document

FIELDS = {
    "id": ("", "number of the orbit in the atlas, which it keeps"),
    "energy": ("J", "energy; of first-order systems their first invariant, empty where nothing is conserved"),
    "period": ("s", "minimal period"),
    "action": ("J s", "integral of momentum dq over a period; of first-order systems of |x'|^2"),
    "symmetry": ("", f"one of {', '.join(SYMMETRIES)}, or the system's own"),
    "stability": ("", "elliptic, unstable, marginal or asymptotically stable, by the Floquet multipliers"),
    "instability": ("1", "largest magnitude of a non-trivial Floquet multiplier"),
    "closure": ("1", "gap round the loop by the certifying integrator, largest component, in the state's units"),
    "pair_defect": ("1", "max |mu_i mu_j - 1| over reciprocal pairs of multipliers: their error bar"),
    "strategy": ("", "how the start that found it was made"),
    "seed": ("", "seed of its search"),
    "start": ("", "number of that start"),
    "signature": ("", "turning points of each coordinate in a period, whole turns after `turns`; events of a hybrid"),
    "floquet_multipliers": ("1", "the non-trivial ones, JSON list of [real, imaginary]"),
    "proof": ("", "stability proved with the orbit's existence in ball arithmetic; empty where not attempted"),
}
"""Columns of the table: unit and meaning. The state at t = 0 stands before `strategy`, a column a component."""
STATE = ("rad or m, and 1/s", "component of the state at t = 0: coordinates, then rates; the system's own units")


def exported(atlas: Atlas, kind: str, chosen: Filter | None = None) -> bytes:
    """The content of a file of that kind: json (orbit documents), csv or parquet (one row an orbit)."""
    return WRITERS[kind](atlas, chosen)


def _documents(atlas: Atlas, chosen: Filter | None) -> bytes:
    return (json.dumps(list(atlas.documents(chosen)), indent=1, allow_nan=False) + "\n").encode()


def _table(atlas: Atlas, chosen: Filter | None) -> tuple[list[str], list[dict[str, Any]]]:
    states = atlas.model.state_names
    return list(flat_names(states)), [flat(atlas, row, states) for row in atlas.rows(chosen)]


def flat_names(state_names: tuple[str, ...]) -> tuple[str, ...]:
    """Columns of the table."""
    names = list(FIELDS)
    place = names.index("strategy")
    return (*names[:place], *state_names, *names[place:])


def flat(atlas: Atlas, row: AtlasRow, state_names: tuple[str, ...]) -> dict[str, Any]:
    """One row: numbers in SI units and rad, the state at t = 0 and where the orbit came from."""
    document = atlas.document(row.id)
    origin = dict(document.get("provenance") or {})
    known = vars(row) | document | {"strategy": origin.get("strategy", ""), "proof": proved(document)}
    known |= {"seed": origin.get("seed"), "start": origin.get("index")}
    known["floquet_multipliers"] = json.dumps(document["floquet_multipliers"])
    known["signature"] = row.signature or in_words(orbit_from_document(document), atlas.signature(row.id))
    known |= named_state(document, state_names)
    return {name: known[name] for name in flat_names(state_names)}


def as_csv(names: list[str], rows: list[dict[str, Any]]) -> bytes:
    """A CSV file with a header line; numbers round-trip exactly."""
    text = io.StringIO()
    writer = csv.DictWriter(text, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue().encode()


def as_parquet(names: list[str], rows: list[dict[str, Any]], system: str) -> bytes:
    """A Parquet file that says the system (JSON), and the unit and meaning of each column, in its metadata.

    Raises `InputError` without the extra `parquet`.
    """
    try:
        import pyarrow  # noqa: PLC0415  an extra
        from pyarrow import parquet  # noqa: PLC0415  an extra
    except ImportError as error:
        raise InputError("kind: parquet needs pyarrow; pip install 'orbitfinder[parquet]', or use csv") from error
    table = pyarrow.table({name: [row[name] for row in rows] for name in names})
    told = {name: dict(zip(("unit", "meaning"), FIELDS.get(name, STATE), strict=True)) for name in names}
    fields = [table.schema.field(name).with_metadata(told[name]) for name in names]
    fields = [field.with_type(pyarrow.float64()) if pyarrow.types.is_null(field.type) else field for field in fields]
    sink = io.BytesIO()
    parquet.write_table(table.cast(pyarrow.schema(fields, {"system": system})), sink)
    return sink.getvalue()


WRITERS: dict[str, Callable[[Atlas, Filter | None], bytes]] = {
    "json": _documents,
    "csv": lambda atlas, chosen: as_csv(*_table(atlas, chosen)),
    "parquet": lambda atlas, chosen: as_parquet(*_table(atlas, chosen), json.dumps(atlas.system, sort_keys=True)),
}
