"""One codec for records: a dataclass, its JSON, and what is dense beside it in .npz.

A file says its format and version, then the fields in their order, or in that of `_entries` of the class: `...` stands
there for the fields that it does not name, and properties may be among them, which are written only. The annotation of
a field says how it stands in a file: arrays as lists, records within records as tables, everything else as it is; what
is different is `Annotated` with a `Filed`. `_check` of the class says what of it belongs together (see `typed`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.records.reading import (
    arrays,
    bounded,
    hints,
    json_bytes,
    json_file,
    plain_numbers,
    typed,
    walked,
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


def _null_for(unsaid: float) -> Filed:
    return Filed(
        lambda value: plain_numbers(value) if math.isfinite(value) else None,
        lambda entry, where: unsaid if entry is None else typed(float, entry, where),
    )


def _complexes(entry: Any, where: str) -> np.ndarray:
    pairs = typed(np.ndarray, entry, where)
    if pairs.size and pairs.shape[1:] != (2,):
        raise ValueError(f"{where}: expected a list of [re, im]")
    return np.asarray(pairs.reshape(-1, 2).view(complex)[:, 0])


Unknown = Annotated[float, _null_for(math.nan)]
"""A number that may be nan, which files say as null"""
Endless = Annotated[float, _null_for(math.inf)]
"""A number that may be infinite, which files say as null"""
Complexes = Annotated[np.ndarray, Filed(plain_numbers, _complexes)]
"""Complex numbers, in files [re, im] each"""
Dense = Annotated[np.ndarray, Filed(np.asarray, lambda entry, where: entry, dense=True)]
"""Numbers in the .npz beside the file"""


@lru_cache
def _layout(kind: Any) -> dict[str, Filed | None]:
    """The entries of a record in their order, each with what its annotation says."""
    known, order = hints(kind), getattr(kind, "_entries", (...,))
    rest = [one.name for one in dataclasses.fields(kind) if one.name not in order]
    names = [name for part in order for name in (rest if part is ... else [part])]
    return {name: next(iter(getattr(known.get(name), "__metadata__", ())), None) for name in names}


def entry_of(record: Any) -> dict[str, Any]:
    """A record in plain numbers, without what is dense."""
    return {
        name: plain(getattr(record, name) if filed is None else filed.write(getattr(record, name)))
        for name, filed in _layout(type(record)).items()
        if filed is None or not filed.dense
    }


def plain(value: Any) -> Any:
    """JSON-ready: records as their entries, arrays as lists, complex numbers as [re, im]."""
    if dataclasses.is_dataclass(value):
        return entry_of(value)
    return walked(value, plain) if isinstance(value, (Mapping, list, tuple)) else plain_numbers(value)


@dataclass(frozen=True)
class Codec(Generic[Record]):
    """How records of a `kind` are written and read: `name` is that of the format, `maker` the command that writes
    them, `again` what to do about a damaged file; `alone`: it may be without its .npz.
    """

    kind: type[Record]
    name: str
    maker: str
    again: str
    alone: bool = False
    version: int = 1

    @property
    def format(self) -> str:
        """What a file says that it is."""
        return f"orbitfinder/{self.name}"

    def document(self, record: Record) -> dict[str, Any]:
        """The JSON document of a record; floats round-trip exactly."""
        return {"format": self.format, "version": self.version, **entry_of(record)}

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
        if dense := dict(self._dense()):
            members = {name: filed.write(getattr(record, name)) for name, filed in dense.items()}
            write_npz(target.with_suffix(".npz"), members)
        write_atomically(target, text)
        return target

    def load(self, path: str | Path) -> Record:
        """The record of a file. Raises `InputError`: for another format or version, and for anything damaged."""
        source = Path(path)
        document, beside = json_file(source, f"{self.name}.json", self.again), source.with_suffix(".npz")
        self._check_format(document, source)
        dense = dict(self._dense())
        entries = {name: entry for name, entry in document.items() if name not in dense}
        if dense and (beside.exists() or not self.alone):
            endless = [name for name, filed in dense.items() if filed.endless]
            entries |= arrays(beside, list(dense), self.again, endless)
        try:
            record: Record = typed(self.kind, entries, "")
        except ValueError as error:
            raise InputError(f"{source}: malformed entry ({error}); {self.again}") from error
        return record

    def _dense(self) -> Iterator[tuple[str, Filed]]:
        """What is in the .npz."""
        return ((name, filed) for name, filed in _layout(self.kind).items() if filed is not None and filed.dense)

    def _check_format(self, document: Any, source: Path) -> None:
        found = document if isinstance(document, Mapping) else {}
        if found.get("format") != self.format:
            raise InputError(
                f"{source}: format: expected {self.format!r} of version {self.version}, got {found.get('format')!r}; "
                f"give a {self.name}.json, which {self.maker} writes"
            )
        if found.get("version") != self.version:
            raise InputError(
                f"{source}: version: this orbitfinder reads {self.version}, got {found.get('version')!r}; "
                f"use the orbitfinder that wrote it, or {self.again}"
            )
