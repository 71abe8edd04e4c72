"""Orbits of an atlas as JSON, CSV or Parquet."""

from __future__ import annotations

import json
from collections.abc import Callable

from orbitfinder.atlas.signature import in_words
from orbitfinder.atlas.store import Atlas, AtlasRow, Filter, named_state, proved
from orbitfinder.exports.tables import table_bytes
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.records.orbit import orbit_from_document
from orbitfinder.records.reading import Entries, json_bytes

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


def _table(atlas: Atlas, chosen: Filter | None, to: str) -> bytes:
    states = atlas.model.state_names
    lines = atlas.rows(chosen)
    rows, names = [flat(atlas, row, states) for row in lines], flat_names(states)
    told = {name: FIELDS.get(name, STATE) for name in names}
    further = {
        "parameters": ("", "of a grid, JSON; empty where they are the system's own"),
        "cost": ("", "of a controlled orbit, in units of its problem's cost; empty of others"),
    }
    for name, unit in further.items():
        if any(getattr(line, name) not in ("", None) for line in lines):
            rows = [row | {name: getattr(line, name)} for row, line in zip(rows, lines, strict=True)]
            names, told[name] = (*names, name), unit
    return table_bytes({name: [row[name] for row in rows] for name in names}, to, told, atlas.system)


def flat_names(state_names: tuple[str, ...]) -> tuple[str, ...]:
    """Columns of the table."""
    names = list(FIELDS)
    place = names.index("strategy")
    return (*names[:place], *state_names, *names[place:])


def flat(atlas: Atlas, row: AtlasRow, state_names: tuple[str, ...]) -> Entries:
    """One row: numbers in SI units and rad, the state at t = 0 and where the orbit came from."""
    document = atlas.document(row.id)
    origin = dict(document.get("provenance") or {})
    known = vars(row) | document | {"strategy": origin.get("strategy", ""), "proof": proved(document)}
    known |= {"seed": origin.get("seed"), "start": origin.get("index")}
    known["floquet_multipliers"] = json.dumps(document["floquet_multipliers"])
    known["signature"] = row.signature or in_words(orbit_from_document(document), atlas.signature(row.id))
    known |= named_state(document, state_names)
    return {name: known[name] for name in flat_names(state_names)}


WRITERS: dict[str, Callable[[Atlas, Filter | None], bytes]] = {
    "json": lambda atlas, chosen: json_bytes(list(atlas.documents(chosen))),
    "csv": lambda atlas, chosen: _table(atlas, chosen, "csv"),
    "parquet": lambda atlas, chosen: _table(atlas, chosen, "parquet"),
}
