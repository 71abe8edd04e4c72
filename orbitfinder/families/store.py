"""A family on disk: a journal that survives being killed, and family.json + family.npz made from it.

`family.jsonl` holds a header line and then one line per step with everything that the step added,
flushed to the disk before the next step begins. A line that was cut short by a kill is dropped, so a
step is there completely or not at all; the walk resumes from the last one.
"""

from __future__ import annotations

import dataclasses
import io
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.families.points import Batch, End, Event, Family, FamilyPoint
from orbitfinder.periodic.orbit import write_atomically

FORMAT, VERSION = "orbitfinder/family", 1
JOURNAL = "family.jsonl"
COMPLEX = ("floquet_multipliers", "indices")
ARRAYS = ("state", "unfolding", "nodes", "mesh", "tangent")
DENSE = ("nodes", "mesh", "tangent")
"""What goes into family.npz instead of family.json."""


@dataclass(frozen=True)
class Journal:
    """What a journal says: its header and the complete batches, in the order they were computed."""

    header: Mapping[str, Any]
    batches: tuple[Batch, ...]

    def steps(self, direction: int) -> list[FamilyPoint]:
        """The steps already taken in one direction."""
        points = [p for batch in self.batches if batch.direction == direction for p in batch.points]
        return [point for point in points if point.role == "step"]

    def end(self, direction: int) -> End | None:
        """The last reason for ending in one direction."""
        ends = [batch.end for batch in self.batches if batch.direction == direction and batch.end is not None]
        return ends[-1] if ends else None


def plain(value: Any) -> Any:
    """JSON-ready: arrays as lists, complex numbers as [re, im]."""
    if isinstance(value, np.ndarray):
        return [[float(z.real), float(z.imag)] for z in value] if np.iscomplexobj(value) else value.tolist()
    if isinstance(value, complex):
        return [value.real, value.imag]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {one.name: plain(getattr(value, one.name)) for one in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    return value.item() if isinstance(value, np.generic) else value


def restored(kind: type[FamilyPoint] | type[Event], document: Mapping[str, Any]) -> Any:
    """A FamilyPoint or an Event out of what `plain` made of it."""
    entries = dict(document)
    for name in ARRAYS:
        if name in entries:
            entries[name] = np.asarray(entries[name], float)
    for name in COMPLEX:
        if name in entries:
            entries[name] = np.asarray([complex(*pair) for pair in entries[name]], complex)
    if "multiplier" in entries:
        entries["multiplier"] = complex(*entries["multiplier"])
    if "krein" in entries:
        entries["krein"] = tuple(entries["krein"])
    return kind(**entries)


def _batch(document: Mapping[str, Any]) -> Batch:
    end = document.get("end")
    return Batch(
        direction=int(document["direction"]),
        points=tuple(restored(FamilyPoint, entry) for entry in document["points"]),
        events=tuple(restored(Event, entry) for entry in document["events"]),
        end=None if end is None else End(**end),
    )


def start_journal(folder: Path, header: Mapping[str, Any]) -> None:
    """A fresh journal with its header, replacing an older one."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / JOURNAL, _line(header))
    _sync_folder(folder)


def append(folder: Path, batch: Batch) -> None:
    """One batch as one line, on the disk when this returns."""
    with open(folder / JOURNAL, "ab") as stream:
        stream.write(_line(plain(batch)))
        stream.flush()
        os.fsync(stream.fileno())


def _line(document: Mapping[str, Any]) -> bytes:
    return (json.dumps(plain(document), separators=(",", ":")) + "\n").encode()


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_journal(folder: Path) -> Journal | None:
    """The journal of a folder, its torn last line cut off the file; None when there is none to read."""
    path = folder / JOURNAL
    if not path.is_file():
        return None
    data = path.read_bytes()
    documents, kept = [], 0
    for line in data.splitlines(keepends=True):
        try:
            document = json.loads(line) if line.endswith(b"\n") else None
        except ValueError:
            document = None
        if document is None:
            break
        documents.append(document)
        kept += len(line)
    if not documents or documents[0].get("format") != FORMAT:
        return None
    if kept < len(data):
        with open(path, "r+b") as stream:
            stream.truncate(kept)
            os.fsync(stream.fileno())
    try:
        return Journal(documents[0], tuple(_batch(one) for one in documents[1:]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: malformed journal ({error}); delete it to start again") from error


def assemble(journal: Journal) -> Family:
    """The family in order along the curve, points numbered from one end to the other."""
    origin: FamilyPoint = restored(FamilyPoint, journal.header["origin"])
    points = [origin, *(point for batch in journal.batches for point in batch.points)]
    points.sort(key=lambda point: point.arclength)
    numbered = tuple(replace(point, index=k) for k, point in enumerate(points))
    places = np.array([point.arclength for point in numbered])
    events = sorted((event for batch in journal.batches for event in batch.events), key=lambda one: one.arclength)
    indexed = tuple(replace(one, index=int(np.searchsorted(places, one.arclength)) - 1) for one in events)
    ends = tuple(end for end in (journal.end(-1), journal.end(1)) if end is not None)
    header = journal.header
    about = header["curve"], header.get("source", {})
    return Family(header["name"], header["system"], header["parameter"], numbered, indexed, ends, *about)


def family_to_document(family: Family) -> dict[str, Any]:
    """The contract of family.json; floats round-trip exactly."""
    points = []
    for point in family.points:
        entry = {key: value for key, value in plain(point).items() if key not in DENSE}
        points.append(entry | {family.parameter: point.value} | dict(point.free))
    events = [{k: v for k, v in plain(event).items() if k not in DENSE} for event in family.events]
    return {
        "format": FORMAT,
        "version": VERSION,
        "name": family.name,
        "system": dict(family.system),
        "parameter": family.parameter,
        "points": points,
        "events": events,
        "ends": [plain(end) for end in family.ends],
        "curve": plain(family.curve),
        "source": plain(family.source),
    }


def save_family(family: Family, folder: Path) -> Path:
    """Write family.json and family.npz whole or not at all; returns the JSON's path."""
    folder.mkdir(parents=True, exist_ok=True)
    arrays: dict[str, np.ndarray] = {}
    for kind, members in (("point", family.points), ("event", family.events)):
        for name in DENSE:
            pieces = [np.asarray(getattr(one, name), float).ravel() for one in members]  # type: ignore[attr-defined]
            arrays[f"{kind}_{name}"] = np.concatenate(pieces) if pieces else np.zeros(0)
            arrays[f"{kind}_{name}_sizes"] = np.array([piece.size for piece in pieces], int)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    write_atomically(folder / "family.npz", buffer.getvalue())
    text = json.dumps(family_to_document(family), indent=1, allow_nan=False)
    write_atomically(folder / "family.json", (text + "\n").encode())
    return folder / "family.json"


def load_family(path: str | Path) -> Family:
    """Read family.json (and family.npz beside it). Raises `InputError` on anything unreadable."""
    source = Path(path)
    try:
        document = json.loads(source.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{source}: cannot be read ({error}); give a family.json") from error
    if not isinstance(document, dict) or document.get("format") != FORMAT or document.get("version") != VERSION:
        raise InputError(f"{source}: format: expected {FORMAT!r} version {VERSION}; give a family.json")
    try:
        size = len(document["points"][0]["state"]) if document["points"] else 0
        points = _with_dense(source, "point", FamilyPoint, document["points"], size)
        events = _with_dense(source, "event", Event, document["events"], size)
        ends = tuple(End(**end) for end in document["ends"])
        about = document.get("curve", {}), document.get("source", {})
        return Family(document["name"], document["system"], document["parameter"], points, events, ends, *about)
    except (KeyError, TypeError, ValueError, OSError) as error:
        raise InputError(f"{source}: malformed entry ({error}); continue the family again") from error


def _with_dense(
    source: Path, kind: str, type_: Any, entries: Sequence[Mapping[str, Any]], size: int
) -> tuple[Any, ...]:
    """Points or events with the arrays of family.npz put back."""
    known = {one.name for one in dataclasses.fields(type_)}
    if not source.with_suffix(".npz").is_file():  # without it an orbit is its state and period
        empty = np.zeros(0)
        bare = {"nodes": np.zeros((0, size)), "mesh": empty, "tangent": empty}
        return tuple(restored(type_, {k: v for k, v in entry.items() if k in known} | bare) for entry in entries)
    with np.load(source.with_suffix(".npz"), allow_pickle=False) as data:
        dense = {name: np.split(data[f"{kind}_{name}"], np.cumsum(data[f"{kind}_{name}_sizes"])[:-1]) for name in DENSE}
    found = []
    for k, entry in enumerate(entries):
        numbers = {name: dense[name][k] for name in DENSE}
        numbers["nodes"] = numbers["nodes"].reshape(-1, size)
        found.append(restored(type_, {key: value for key, value in entry.items() if key in known} | numbers))
    return tuple(found)
