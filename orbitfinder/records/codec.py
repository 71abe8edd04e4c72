"""One codec for records: a dataclass, its JSON, and what is dense beside it in .npz.

A file says its format and version, then the fields in their order, or in that of `_entries` of the class: `...` stands
there for the fields that it does not name, and properties may be among them, which are written only. Those of `_sparse`
are left out where they are None or empty, `_called` says of a field what it is called there. The annotation of a field
says how it stands in a file: arrays as lists, records within records as tables, everything else as it is; what is
different is `Annotated` with a `Filed`. `_check` of the class says what of it belongs together (see `typed`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

import numpy as np

from orbitfinder._runtime.notebook import chosen
from orbitfinder.errors import InputError
from orbitfinder.records.reading import (
    Entries,
    arrays,
    bounded,
    content_digest,
    hints,
    json_bytes,
    json_file,
    plain_numbers,
    typed,
    write_atomically,
    write_npz,
)

Record = TypeVar("Record")


@dataclass(frozen=True)
class Filed:
    """How a field stands in a file: what is written of it, and what is made of an entry at a place (`ValueError`).

    `dense`: in the .npz, where numbers are finite or `endless`.
    """

    write: Callable[[Any], Any]
    read: Callable[[Any, str], Any]
    dense: bool = False
    endless: bool = False


def check_shapes(record: Any, **shapes: tuple[int, ...]) -> None:
    """`ValueError` for an array of a record that has another shape."""
    for name, shape in shapes.items():
        if (given := np.shape(getattr(record, name))) != shape:
            raise ValueError(f"{name}: shape {given} where {shape} belongs")


def check_axes(record: Any) -> None:
    """`ValueError` for a record whose axes are not among its `state_names`."""
    if not set(record.axes) <= set(record.state_names):
        raise ValueError(f"axes: expected two of the components, got {', '.join(record.axes)}")


def _null_for(unsaid: float) -> Filed:
    return Filed(
        lambda value: value if math.isfinite(value) else None,
        lambda entry, where: unsaid if entry is None else typed(float, entry, where),
    )


def _complexes(entry: Any, where: str) -> np.ndarray:
    pairs = typed(np.ndarray, entry, where)
    if pairs.shape != (0,) and pairs.shape[1:] != (2,):
        raise ValueError(f"{where}: expected a list of [re, im]")
    return np.asarray(pairs.reshape(-1, 2).view(complex)[:, 0])


Unknown = Annotated[float, _null_for(math.nan)]
"""A number that may be nan, which files say as null"""
Endless = Annotated[float, _null_for(math.inf)]
"""A number that may be infinite, which files say as null"""
Complexes = Annotated[np.ndarray, Filed(np.asarray, _complexes)]
"""Complex numbers, in files [re, im] each"""
Dense = Annotated[np.ndarray, Filed(np.asarray, lambda entry, where: entry, dense=True)]
"""Numbers in the .npz beside the file"""


class FileEntry(NamedTuple):
    """An entry of a record's file: the field or property that it is of, and what that is annotated with."""

    name: str
    field: str
    filed: Filed | None
    sparse: bool


@lru_cache
def layout(kind: Any) -> tuple[FileEntry, ...]:
    """The entries of a class of records in their order."""
    known, order, called = hints(kind), getattr(kind, "_entries", (...,)), getattr(kind, "_called", {})
    fields = {called.get(part.name, part.name): part.name for part in dataclasses.fields(kind)}
    rest = [name for name in fields if name not in order]
    entries = []
    for name in (name for part in order for name in (rest if part is ... else [part])):
        field = fields.get(name, name)
        filed = getattr(known.get(field), "__metadata__", (None,))[0]
        entries.append(FileEntry(name, field, filed, name in getattr(kind, "_sparse", ())))
    return tuple(entries)


def entries_of(record: Any, kind: Any = None) -> Entries:
    """A record in plain numbers, without what is dense; as of a `kind` that its own class derives from."""
    entries = {}
    for name, field, filed, sparse in layout(kind or record.__class__):
        value = getattr(record, field)
        left_out = sparse and (value is None or (hasattr(value, "__len__") and len(value) == 0))
        if not left_out and not (filed is not None and filed.dense):
            entries[name] = plain(value if filed is None else filed.write(value))
    return entries


def plain(value: Any) -> Any:
    """JSON-ready: records as their entries, arrays as lists, complex numbers as [re, im]."""
    if value.__class__ in (float, int, str, bool):
        return value
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return list(value) if set(map(type, value)) <= {float, int, str, bool} else [plain(entry) for entry in value]
    return entries_of(value) if dataclasses.is_dataclass(value) else plain_numbers(value)


def outline(value: Any, whole: bool = True, most: int = 24) -> Any:
    """What a record holds, in plain numbers: its entries, those of records within it that their one line names; of
    arrays, and of lists of numbers or of what can be certified, `most` entries and how many more; nothing empty."""
    if dataclasses.is_dataclass(value):
        names = chosen(value) if not whole and chosen(value) else [entry.field for entry in layout(value.__class__)]
        value = {name: getattr(value, name, None) for name in (["counts", *names, "proof"] if whole else names)}
    if isinstance(value, Mapping):
        table = {str(name): outline(entry, False) for name, entry in value.items()}
        return {name: entry for name, entry in table.items() if entry == entry and entry not in (None, "", [], {})}
    if isinstance(value, np.ndarray) and value.size > most:
        return " x ".join(map(str, value.shape))
    if isinstance(value, (list, tuple)):
        long = len(value) > most and (hasattr(value[0], "certificate") or not dataclasses.is_dataclass(value[0]))
        known = [outline(entry, False) for entry in value[: most if long else None]]
        return [*known, f"and {len(value) - most} more"] if long else known
    return plain(value)


def check_format(document: Any, wanted: str, version: int, where: str, give: str, again: str) -> Entries:
    """The same document, if it is of the format and version that are wanted, or `InputError`."""
    if not isinstance(document, dict):
        raise InputError(f"{where}: format: expected an object, got {type(document).__name__}; {give}")
    if document.get("format") != wanted:
        raise InputError(f"{where}: format: expected {wanted!r}, got {document.get('format')!r}; {give}")
    if document.get("version") != version:
        raise InputError(f"{where}: version: this orbitfinder reads {version}, got {document.get('version')!r}; "
                         f"use the orbitfinder that wrote it, or {again}")  # fmt: skip
    return document


def unsealed(document: Entries, where: str, again: str, required: bool = False) -> Entries:
    """The same document without its digest. Raises `InputError` where that is of another content, or missing."""
    record = document.pop("record", None)
    if (record is not None or required) and record != content_digest(document):
        raise InputError(f"{where}: record: its digest is another, so the file was edited or damaged; {again}")
    return document


@dataclass(frozen=True)
class Codec(Generic[Record]):
    """How records of a `kind` are written and read: `name` is that of the format, `maker` the command that writes
    them, `again` what to do about a damaged file; `alone`: it may be without its .npz; `sealed`: `record` is the digest
    of everything else, which older files are without."""

    kind: Callable[..., Record]
    name: str
    maker: str
    again: str
    alone: bool = False
    version: int = 1
    sealed: bool = False

    @property
    def format(self) -> str:
        """What a file says that it is."""
        return f"orbitfinder/{self.name}"

    def document(self, record: Record) -> Entries:
        """The JSON document of a record; floats round-trip exactly."""
        document = {"format": self.format, "version": self.version, **entries_of(record, self.kind)}
        return document | {"record": content_digest(document)} if self.sealed else document

    def save(self, record: Record, path: str | Path) -> Path:
        """Write a record and what is dense of it, each whole or not at all; returns the JSON's path.

        Raises `InputError`, before anything is written, for a number that no file can say.
        """
        target, document = Path(path), self.document(record)
        try:
            text = json_bytes(document)
        except ValueError:
            bounded(document, str(target), "nothing was written")
            raise
        target.parent.mkdir(parents=True, exist_ok=True)
        if dense := self._dense():
            members = {name: filed.write(getattr(record, name)) for name, filed in dense.items()}
            write_npz(target.with_suffix(".npz"), members)
        write_atomically(target, text)
        return target

    def load(self, path: str | Path) -> Record:
        """The record of a file. Raises `InputError`: for another format or version, and for anything damaged."""
        source = Path(path)
        give = f"give a {self.name}.json, which {self.maker} writes"
        content, beside = json_file(source, f"{self.name}.json", self.again), source.with_suffix(".npz")
        document = check_format(content, self.format, self.version, str(source), give, self.again)
        if self.sealed:
            unsealed(document, str(source), self.again)
        dense = self._dense()
        entries = {name: entry for name, entry in document.items() if name not in dense}
        if dense and (beside.exists() or not self.alone):
            endless = [name for name, filed in dense.items() if filed.endless]
            entries |= arrays(beside, list(dense), self.again, endless)
        try:
            record: Record = typed(self.kind, entries, "")
        except ValueError as error:
            raise InputError(f"{source}: malformed entry ({error}); {self.again}") from error
        return record

    def _dense(self) -> dict[str, Filed]:
        """What is in the .npz."""
        return {entry.name: entry.filed for entry in layout(self.kind) if entry.filed is not None and entry.filed.dense}
