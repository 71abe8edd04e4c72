"""Files that others made, read within bounds: the way from a path to bytes, JSON, arrays and typed records;
and ours, written whole or not at all.

Whatever a file holds, what comes back is what was asked for, or an `InputError` of a sentence; nothing is
expanded, nested or counted beyond the bounds below, and only regular files are opened (no pipes, no devices).
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import math
import os
import stat
import sys
import tempfile
import time
import typing
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, BinaryIO

import numpy as np

from orbitfinder._runtime import interrupt
from orbitfinder.errors import InputError, LimitError, shortened

Table = Mapping[str, Any]
"""Entries by name, as in a JSON object, a TOML table, the description of a system"""
Entries = dict[str, Any]
"""The same where it is made"""
LARGEST_FILE = 100_000_000
"""Bytes; a larger file (of a journal: a larger line) is refused before it is read."""
MOST_VALUES = 10_000_000
"""Entries of a JSON document."""
DEEPEST = 64
"""Levels of lists and tables."""
LARGEST_INTEGER, LARGEST_NUMBER = 2**63 - 1, 1e150
"""the latter of dense arrays: its square is finite"""
BUSY = 2.0 if sys.platform == "win32" else 0.0
"""s to wait for others to close the file that is to be replaced"""


def _opened(path: Path, what: str) -> BinaryIO:
    """The open file at a path, if it is a regular file."""
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
        mode = os.fstat(handle).st_mode
        if stat.S_ISREG(mode):
            return os.fdopen(handle, "rb")
        os.close(handle)
    except FileNotFoundError as error:
        named = path.with_name(f"{path.name}.toml")
        meant = f"did you mean {named}?" if named.is_file() else "check the path"
        if what == "problem file" and not named.is_file():
            meant += "; `orbitfinder problems copy all` writes those that come with orbitfinder to problems/"
        raise InputError(f"{path}: no such file; {meant}") from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}); check the path and its permissions") from error
    kind = "a folder, not a file; name a" if stat.S_ISDIR(mode) else "not a regular file; give a"
    raise InputError(f"{path}: {kind} {what}{' in it' if stat.S_ISDIR(mode) else ''}")


def file_bytes(path: Path, what: str = "file", limit: int = LARGEST_FILE) -> bytes:
    """The content of a regular file of at most `limit` bytes, or `InputError`."""
    with _opened(path, what) as stream:
        size = os.fstat(stream.fileno()).st_size
        if size > limit:
            raise InputError(f"{path}: {size} bytes are too large for a {what}, the limit is {limit}")
        try:
            return stream.read(size)
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error}); check the disk") from error


def file_beside(folder: Path, name: str, where: str) -> Path:
    """Where a file lies that a problem file in `folder` names: there or below, or `InputError` of the field."""
    try:
        base = folder.resolve()
        source = (base / name).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a NUL in the name, links that go round in a circle
        raise InputError(f"{where}: {name!r} is no usable path ({error}); put the file beside") from error
    if not source.is_relative_to(base):
        raise InputError(f"{where}: {name!r} lies outside the problem file's folder; put the file beside it")
    return source


def parted(path: str | Path) -> tuple[Path, str]:
    """FILE and WORD of FILE#WORD; no word where there is none, or where a file has that very name."""
    name, mark, word = Path(path).name.rpartition("#")
    return (Path(path).with_name(name), word) if name and mark and not Path(path).exists() else (Path(path), "")


def file_head(path: Path, size: int) -> bytes:
    """The first bytes of a regular file, or `InputError`."""
    with _opened(path, "result file") as stream:
        return stream.read(size)


def file_lines(path: Path, what: str = "file") -> Iterator[bytes]:
    """The lines of a regular file with their ends; a line that is too long comes without its end."""
    with _opened(path, what) as stream:
        while line := stream.readline(LARGEST_FILE):
            yield line


def json_document(data: bytes, where: str, remedy: str) -> Any:
    """What JSON text stands for, within the bounds of `bounded`; NaN and infinity are refused."""
    try:
        if sum(map(data.count, (b",", b"[", b"{"))) > MOST_VALUES:
            raise ValueError(f"more than {MOST_VALUES} entries")
        document = json.loads(data.decode("utf-8"), parse_constant=_no_number)
    except UnicodeDecodeError as error:
        remedy = remedy if where.endswith(".json") else "give the .json file that orbitfinder wrote"
        raise InputError(f"{where}: cannot be read (no UTF-8 text at byte {error.start}); {remedy}") from error
    except RecursionError as error:
        raise InputError(f"{where}: nested too deeply; {remedy}") from error
    except ValueError as error:
        if where.endswith((".toml", ".py")):
            raise InputError(f"{where}: a problem file; run it, then give the orbit.json that was written") from error
        raise InputError(f"{where}: truncated or corrupt JSON ({shortened(error, 120)}); {remedy}") from error
    return bounded(document, where, remedy)


def _no_number(text: str) -> float:
    raise ValueError(f"{text} is not a number")


def json_file(path: Path, what: str, remedy: str) -> Any:
    """The JSON document at a path, or `InputError`."""
    return json_document(file_bytes(path, what), str(path), remedy)


def bounded(document: Any, where: str, remedy: str, finite: bool = True) -> Any:
    """The same document, if it is no deeper than `DEEPEST`, its text is Unicode and its numbers are numbers."""
    level = [("", document)]
    for _ in range(DEEPEST):
        if not level:
            return document
        try:
            level = [inner for name, part in level for inner in _inside(name, part, finite)]
        except ValueError as error:
            raise InputError(f"{where}: {error}; {remedy}") from error
    raise InputError(f"{where}: nested too deeply; {remedy}")


def _inside(name: str, part: Any, finite: bool) -> Iterator[tuple[str, Any]]:
    """The lists and tables in a list or table, named; `ValueError` about the first bad number or text in it."""
    entries = part.items() if isinstance(part, Mapping) else enumerate(part) if isinstance(part, list) else ()
    for key, value in entries:
        if isinstance(value, (Mapping, list)):
            yield _place(name, key), value
        elif fault := _fault(value, finite) or _fault(key, finite):
            raise ValueError(f"{_place(name, key)}: {fault}")


def _place(name: str, key: Any) -> str:
    text = f"[{key}]" if isinstance(key, int) else f".{ascii(key)[1:-1][:60]}"
    return f"{name}{text}".lstrip(".")


def _fault(value: Any, finite: bool) -> str:
    """What is wrong with a number or text, nothing when it is sound."""
    if isinstance(value, float):
        return f"malformed number, {value} is not finite" if finite and not math.isfinite(value) else ""
    if isinstance(value, int) and abs(value) > LARGEST_INTEGER:
        return f"malformed number, beyond {LARGEST_INTEGER} (about 1e{int(value.bit_length() * math.log10(2))})"
    if isinstance(value, str) and not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value):
        return "malformed text, not Unicode"
    return ""


def arrays(path: Path, names: Sequence[str], remedy: str, endless: Sequence[str] = ()) -> dict[str, np.ndarray]:
    """The numbers of an npz file by name, finite but for those of `endless`, which may be infinite.

    Their sizes are read before anything is expanded. `InputError`.
    """
    try:
        members = npz_members(file_bytes(path, "npz file"), names, 4 * LARGEST_FILE)
        for name, numbers in members.items():
            if np.isnan(numbers).any() or not (name in endless or (np.abs(numbers) < LARGEST_NUMBER).all()):
                raise ValueError(f"{name} holds a number that is not finite, or beyond {LARGEST_NUMBER:g}")
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: damaged ({shortened(error, 120)}); {remedy}") from error
    return members


def npz_members(data: bytes, names: Sequence[str], room: int, kinds: str = "fiu") -> dict[str, np.ndarray]:
    """The arrays of an npz file's bytes by name, all where no `names` are wanted, of NumPy's `kinds`, of no more than
    `room` bytes together, which is known before anything is expanded. Raises `ValueError`."""
    members = dict[str, np.ndarray]()
    try:
        if data.count(b"PK\x01\x02") > 100:
            raise ValueError("more than 100 arrays")
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            for name in names or [name.removesuffix(".npy") for name in archive.namelist()]:
                info = archive.getinfo(f"{name}.npy")
                left = room - sum(member.nbytes for member in members.values())
                if info.file_size > left or info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError(f"{name} would expand to {info.file_size} bytes")
                with archive.open(info) as stream:
                    form = np.lib.format
                    headers = {(1, 0): form.read_array_header_1_0, (2, 0): form.read_array_header_2_0}
                    shape, fortran, dtype = headers[form.read_magic(stream)](stream)
                    if dtype.kind not in kinds or math.prod(shape) * dtype.itemsize != info.file_size - stream.tell():
                        raise ValueError(f"{name} is not an array of numbers of its size")
                    array = np.frombuffer(stream.read(), dtype).reshape(shape, order="F" if fortran else "C")
                members[name] = array.astype({"f": float, "i": int, "u": int}.get(dtype.kind, dtype))
    except LimitError:
        raise
    except Exception as error:  # zipfile, zlib, struct, tokenize: what they raise has no common base
        raise ValueError(str(error)) from error
    return members


def inflated(data: bytes, where: str, remedy: str) -> bytes:
    """What zlib compressed, if it is no larger than a file may be. `InputError`."""
    try:
        packed = zlib.decompressobj()
        content = packed.decompress(data, LARGEST_FILE)
        if not packed.eof:
            raise ValueError("truncated" if len(content) < LARGEST_FILE else f"expands beyond {LARGEST_FILE} bytes")
    except (zlib.error, ValueError, TypeError) as error:
        raise InputError(f"{where}: damaged ({error}); {remedy}") from error
    return content


def content_digest(document: Any) -> str:
    """SHA-256 of a document's content, independent of its layout: 2 and 2.0 are one, keys have no order."""
    alike = walked(document, lambda value: repr(float(value)) if is_number(value) else value,
                   lambda row: [*map(repr, map(float, row))])  # fmt: skip
    text = json.dumps(alike, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def walked(value: Any, leaf: Callable[[Any], Any], row: Callable[[Sequence[float]], Any] | None = None) -> Any:
    """The same document with `leaf` of everything in it that is no table and no list, and the same for a `row` of plain
    numbers, of which a family's points have tens of thousands."""
    if isinstance(value, Mapping):
        return {str(key): walked(entry, leaf, row) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return row(value) if row and set(map(type, value)) <= {float, int} else [walked(v, leaf, row) for v in value]
    return leaf(value)


def plain_numbers(value: Any) -> Any:
    """JSON-ready: arrays as lists, complex numbers as [re, im], NumPy's numbers as Python's; all else as it is."""
    if isinstance(value, np.ndarray):
        return [[float(z.real), float(z.imag)] for z in value] if np.iscomplexobj(value) else value.tolist()
    if isinstance(value, complex):
        return [value.real, value.imag]
    return value.item() if isinstance(value, np.generic) else value


def is_number(value: Any) -> bool:
    """True for an int or a float that is no bool."""
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def typed(kind: Any, value: Any, where: str) -> Any:
    """A JSON value as the type that an annotation names, dataclasses included; `ValueError` names the entry.

    float: finite; complex: [re, im]; np.ndarray: numbers in at most two dimensions; entries that a dataclass
    does not know are left out, those with a default may be missing. `_check` of a dataclass, if it has any, raises
    `ValueError` about its field unless what was read belongs together.
    """
    try:
        reader, of = _reader(kind)
    except KeyError as error:
        raise TypeError(f"{where}: no record has a field of {error}; annotate it as str, float, np.ndarray, "
                        "tuple[X, ...], dict[str, X], X | None or a record X") from error  # fmt: skip
    return reader(of, value, where)


@lru_cache(1000)
def _reader(kind: Any) -> tuple[Callable[[Any, Any, str], Any], Any]:
    """What reads values of a kind, and what is given to it first: the kinds within, of a dataclass itself."""
    if dataclasses.is_dataclass(kind):
        return _record, kind
    if kind is tuple:
        raise KeyError(kind)
    return _READERS[typing.get_origin(kind) or kind], typing.get_args(kind)


def _record(kind: Any, value: Any, where: str) -> Any:
    entries, known, told = _table((str, Any), value, where), hints(kind), {}
    called = getattr(kind, "_called", {})
    for field in dataclasses.fields(kind):
        name = field.name if field.name in entries else called.get(field.name, field.name)
        place = f"{where}.{name}".lstrip(".")
        if name in entries:
            told[field.name] = typed(known[field.name], entries[name], place)
        elif field.default is field.default_factory is dataclasses.MISSING:
            raise ValueError(f"{place}: missing")
    made = kind(**told)
    if check := getattr(made, "_check", None):
        try:
            check()
        except ValueError as error:
            raise ValueError(f"{where}.{error}".lstrip(".")) from error
    return made


@lru_cache
def hints(kind: type) -> Entries:
    """The annotations of a class by name, what they are `Annotated` with included."""
    return typing.get_type_hints(kind, include_extras=True)


def _wrong(where: str, wanted: str, value: Any) -> ValueError:
    return ValueError(f"{where or 'document'}: expected {wanted}, got {shortened(repr(value))}")


def _plain(kinds: tuple[type, ...], wanted: str) -> Callable[[Any, Any, str], Any]:
    def read(_: Any, value: Any, where: str) -> Any:
        if isinstance(value, kinds) and (bool in kinds or not isinstance(value, bool)):
            return value
        raise _wrong(where, wanted, value)

    return read


def _number(_: Any, value: Any, where: str) -> float:
    if not is_number(value) or not math.isfinite(value):
        raise _wrong(where, "a finite number", value)
    return float(value)


def _numbers(_: Any, value: Any, where: str) -> np.ndarray:
    try:
        numbers = np.asarray(value)
    except ValueError as error:
        raise _wrong(where, "numbers in rows of one length", value) from error
    fits = 1 <= numbers.ndim <= 2 and not isinstance(value, str)
    if not fits or (numbers.size and (numbers.dtype.kind not in "fiu" or not np.abs(numbers).max() <= 1e300)):
        raise _wrong(where, "a list of numbers up to 1e+300", value)
    return numbers.astype(float)


def _complex(_: Any, value: Any, where: str) -> complex:
    if not isinstance(value, list) or len(value) != 2:
        raise _wrong(where, "[re, im]", value)
    return complex(*(_number((), part, where) for part in value))


def _table(of: tuple[Any, ...], value: Any, where: str) -> Entries:
    if not isinstance(value, Mapping):
        raise _wrong(where, "a table", value)
    if not of or of == (str, Any):
        return dict(value)
    return {of[0](key): typed(of[1], entry, f"{where}.{key}".lstrip(".")) for key, entry in value.items()}


def _row(of: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, (list, tuple)) or (of[-1] is not Ellipsis and len(value) != len(of)):
        raise _wrong(where, "a list" if of[-1] is Ellipsis else f"{len(of)} entries", value)
    kinds = of[:1] * len(value) if of[-1] is Ellipsis else of
    return tuple(typed(kind, entry, f"{where}[{k}]") for k, (kind, entry) in enumerate(zip(kinds, value, strict=True)))


def _either(of: tuple[Any, ...], value: Any, where: str) -> Any:
    if value is None and NoneType in of:
        return None
    return typed(next(kind for kind in of if kind is not NoneType), value, where)


_READERS: dict[Any, Callable[[Any, Any, str], Any]] = {
    Any: lambda _, value, __: value,
    float: _number, complex: _complex, np.ndarray: _numbers,
    int: _plain((int,), "a whole number"), str: _plain((str,), "text"), bool: _plain((bool,), "true or false"),
    bytes: _plain((bytes,), "bytes"),
    dict: _table, Mapping: _table, tuple: _row, UnionType: _either, typing.Union: _either,
    typing.Annotated: lambda of, value, where: of[1].read(value, where),
}  # fmt: skip
"""How each kind of annotation is read; X | None is X or null; `Annotated` reads by what it is annotated with."""


def read_as(kind: Any, value: Any, where: str, remedy: str) -> Any:
    """`typed`, its complaint as an `InputError` about the file `where`."""
    try:
        return typed(kind, value, "")
    except ValueError as error:
        raise InputError(f"{where}: {error}; {remedy}") from error


@contextlib.contextmanager
def named(path: Path) -> Iterator[None]:
    """What cannot be written in the block is said of this file: of a full disk the system names none."""
    try:
        yield
    except OSError as error:
        raise type(error)(error.errno, error.strerror or str(error), str(path)) from error


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file whole or not at all: a temporary file beside it, then a rename."""
    temporary = ""
    with interrupt.undisturbed(), named(path):
        try:
            handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            umask = os.umask(0)
            os.umask(umask)
            os.chmod(temporary, 0o666 & ~umask)
            _replace(temporary, path)
        except BaseException:
            with contextlib.suppress(OSError):
                os.unlink(temporary)
            raise


def _replace(temporary: str, path: Path) -> None:
    """A rename over what is there; who reads it keeps Windows from that for a moment."""
    until = time.monotonic() + BUSY
    while True:
        try:
            return os.replace(temporary, path)
        except PermissionError:
            if time.monotonic() >= until:
                raise
        time.sleep(0.02)


def json_bytes(document: Any, compact: bool = False) -> bytes:
    """A document as a line, or over as many lines as it has entries; floats round-trip exactly."""
    form = {"separators": (",", ":")} if compact else {"indent": 1}
    return (json.dumps(document, allow_nan=False, **form) + "\n").encode()


def write_json(path: Path, document: Any) -> Path:
    """Write a JSON document whole or not at all; returns its path."""
    write_atomically(path, json_bytes(document))
    return path


def write_npz(path: Path, members: Mapping[str, np.ndarray]) -> None:
    """Write named arrays whole or not at all."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **members)  # type: ignore[arg-type]
    write_atomically(path, buffer.getvalue())


def finite(value: Any) -> Any:
    """The same document with null for every NaN and infinity, which JSON does not have."""
    return walked(value, lambda leaf: None if isinstance(leaf, float) and not math.isfinite(leaf) else leaf)
