"""Journals of what takes long: a header line and then a line a step, flushed to the disk before the next begins.

Every line is a JSON object that ends with a digest of itself. A last line that was cut short by a kill is dropped, so
that a step is there completely or not at all; any other line that is not what was written is an error.
"""

from __future__ import annotations

import base64
import contextlib
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NoReturn, TypeVar

import numpy as np

from orbitfinder._runtime import locks
from orbitfinder.errors import InputError, shortened
from orbitfinder.records.reading import (
    Entries,
    Table,
    content_digest,
    file_lines,
    json_bytes,
    json_document,
    named,
    typed,
    write_atomically,
)

FORMAT, VERSION = "orbitfinder/journal", 1
SEAL = "digest"
"""The key of a line's digest: the first digits of the SHA-256 of the rest of its content"""
AGAIN = "restore a copy, or delete the file to start again"
Line = TypeVar("Line")


@dataclass(frozen=True)
class Checkpoints(Generic[Line]):
    """What earlier runs of a request have left, line by line; with a path it is a journal there, which grows."""

    path: Path | None
    known: list[Line]

    def add(self, entries: Table) -> None:
        """One line more, on the disk when this returns."""
        if self.path is not None:
            append_line(self.path, entries)


@contextlib.contextmanager
def checkpoints(path: Path | None, request: Table, read: Callable[[Entries], Line]) -> Iterator[Checkpoints[Line]]:
    """Those of a request (plain numbers) at a path, whose folder nobody else has meanwhile; nothing without a path.

    Raises `InputError` where it cannot be read, and for what is kept there of another request.
    """
    if path is None:
        yield Checkpoints(None, [])
        return
    with locks.alone_in(path.parent):
        yield Checkpoints(path, known_lines(path, request, read))


def known_lines(path: Path, request: Table, read: Callable[[Entries], Line]) -> list[Line]:
    """The lines of the journal of a request, which is begun where there is none, or another without a line.

    Raises `InputError` where it cannot be read, and for the lines of another request, which nothing writes over.
    """
    lines, known = read_lines(path, path.name), list[Line]()
    if lines is None or lines[0][:1] != [header_of(request)]:
        if lines and lines[0][1:]:
            refuse_other(path, lines[0][0].get("request"), request)
        begin_journal(path, header_of(request))
        return known
    for number, entries in enumerate(lines[0][1:], start=2):
        try:
            known.append(read(entries))
        except (ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
            raise InputError(f"{path}: line {number}: {error}; {AGAIN}") from error
    return known


def header_of(request: Table) -> Entries:
    """The first line of the journal of a request."""
    return {"format": FORMAT, "version": VERSION, "request": request}


def refuse_other(path: Path, there: Any, asked: Any) -> NoReturn:
    """`InputError` of what a journal keeps of another request than is asked for: where they differ and what to do."""
    field, *values = next(_differences(there, asked, ""), ("version", "another", VERSION))
    known, wanted = map(_in_words, values)
    raise InputError(f"{path}: {field}: {known} there, {wanted} asked for; what is computed there is not written over: "
                     f"give another folder (--out), or delete {path.parent}")  # fmt: skip


def _differences(there: Any, asked: Any, name: str) -> Iterator[tuple[str, Any, Any]]:
    """Where two trees of plain numbers differ, by name, outermost first where their shapes do."""
    if isinstance(there, Mapping) and isinstance(asked, Mapping):
        pairs = {key: (there.get(key, "nothing"), asked.get(key, "nothing")) for key in (*asked, *there)}
    elif isinstance(there, list) and isinstance(asked, list) and len(there) == len(asked):
        pairs = dict(enumerate(zip(there, asked, strict=True)))
    else:
        if there != asked:
            yield name, there, asked
        return
    for key, (old, new) in pairs.items():
        yield from _differences(old, new, f"{name}.{key}".lstrip("."))


def _in_words(value: Any) -> str:
    """A value of a request, short."""
    if isinstance(value, list) and len(value) > 3:
        return f"{len(value)} values from {shortened(value[0], 20)} to {shortened(value[-1], 20)}"
    return shortened(value, 60)


def fill(arrays: Iterable[np.ndarray], matrix: np.ndarray) -> None:
    """Write the columns of a matrix back into the arrays that it was stacked from, in the rows that both have."""
    begin = 0
    for array in arrays:
        width = array[:1].size
        array[: len(matrix)] = matrix[: len(array), begin : begin + width].reshape(-1, *array.shape[1:])
        begin += width


def packed(matrix: np.ndarray) -> str:
    """A matrix of numbers as text, every bit of it, infinities and NaN too."""
    return f"{matrix.shape[1]}:" + base64.b64encode(np.ascontiguousarray(matrix, "<f8").tobytes()).decode()


def unpacked(text: str, columns: int | None) -> np.ndarray:
    """The matrix of so many columns, or as many as it says, that a text stands for. Raises `ValueError`."""
    width, _, data = typed(str, text, "numbers").partition(":")
    if not width.isdecimal() or (columns is not None and width != str(columns)):
        raise ValueError(f"expected numbers in {columns or 'so many'} columns, got {width[:9]!r}")
    return np.frombuffer(base64.b64decode(data, validate=True), "<f8").reshape(-1, int(width[:9])).astype(float)


def begin_journal(path: Path, header: Table, lines: Iterable[Table] = ()) -> None:
    """A journal of a header and of lines that are known, replacing an older journal whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, b"".join(map(sealed_line, (header, *lines))))
    handle = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def append_line(path: Path, entries: Table) -> None:
    """One line more, on the disk when this returns."""
    with named(path), open(path, "ab") as stream:
        stream.write(sealed_line(entries))
        stream.flush()
        os.fsync(stream.fileno())


def sealed_line(entries: Table) -> bytes:
    """A line with its digest."""
    return json_bytes({**entries, SEAL: seal(entries)}, compact=True)


def seal(entries: Table) -> str:
    """The digest of a line's entries."""
    return content_digest(entries)[:16]


def read_lines(path: Path, what: str) -> tuple[list[Entries], bool] | None:
    """The lines of a journal, header first, and whether all have digests; a damaged last line is cut off the file.

    None where there is no file. Raises `InputError` about any other line that is not as it was written.
    """
    if not path.exists():
        return None
    lines = list(_lines(path, what))
    if lines and isinstance(lines[-1], InputError):
        logging.getLogger(__name__).warning("%s: the last line was cut short and is computed again", lines.pop())
        kept = sum(len(line) for _, line in zip(lines, file_lines(path), strict=False))
        with open(path, "r+b") as stream:
            stream.truncate(kept)
            os.fsync(stream.fileno())
    entries = []
    for line in lines:
        if isinstance(line, InputError):
            raise line
        entries.append(line)
    sealed = all(SEAL in entry for entry in entries)
    return [{key: value for key, value in entry.items() if key != SEAL} for entry in entries], sealed


def _lines(path: Path, what: str) -> Iterator[Entries | InputError]:
    """What each line says, or what is wrong with it."""
    sealed = False
    for number, line in enumerate(file_lines(path, what), start=1):
        try:
            entries = json_document(line, f"{path}: line {number}", AGAIN)
            _check(entries, line, sealed)
            sealed = SEAL in entries
            yield entries
        except InputError as error:
            yield error
        except ValueError as error:
            yield InputError(f"{path}: line {number}: {error}; {AGAIN}")


def _check(entries: Any, line: bytes, sealed: bool) -> None:
    """`ValueError` unless a line is complete and has its digest; after no `sealed` line it may be without."""
    if not isinstance(entries, dict) or not line.endswith(b"\n"):
        raise ValueError("incomplete")
    if not sealed and SEAL not in entries:
        return
    if entries.get(SEAL) != seal({key: value for key, value in entries.items() if key != SEAL}):
        raise ValueError("not what was written, its digest is another (edited or damaged)")
