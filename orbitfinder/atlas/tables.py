"""The atlas as an SQLite file: its tables, their versions, and what is said when it cannot be used.

A file knows its format by `PRAGMA application_id` and its version by `PRAGMA user_version`, the number
of `MIGRATIONS` it has been through. Write-ahead logging lets others read while a search writes.
Source: SQLite documentation, "Pragma statements", "Write-ahead logging", "Result and error codes".
"""

from __future__ import annotations

import contextlib
import re
import sqlite3
import stat
import time
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from orbitfinder.errors import InputError
from orbitfinder.records.reading import LARGEST_FILE

APPLICATION = 0x6F726266
"""The letters `orbf`."""
PATIENCE = 60.0
"""Seconds that a writer waits for another one's transaction."""
MIGRATIONS: tuple[str, ...] = (
    """
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE orbits (
    id INTEGER PRIMARY KEY,
    period_bin INTEGER NOT NULL, action_bin INTEGER NOT NULL,
    energy REAL NOT NULL, period REAL NOT NULL, action REAL NOT NULL,
    symmetry TEXT NOT NULL, stability TEXT NOT NULL,
    instability REAL NOT NULL,
    closure REAL NOT NULL,
    document BLOB NOT NULL
);
CREATE INDEX orbits_by_signature ON orbits (period_bin, action_bin);
CREATE TABLE searches (
    id INTEGER PRIMARY KEY,
    energy REAL NOT NULL, shortest REAL NOT NULL, longest REAL NOT NULL,
    seed INTEGER NOT NULL, method TEXT NOT NULL,
    sources INTEGER NOT NULL,
    UNIQUE (energy, shortest, longest, seed, method)
);
CREATE TABLE starts (
    search INTEGER NOT NULL REFERENCES searches (id),
    number INTEGER NOT NULL,
    strategy TEXT NOT NULL,
    outcome TEXT NOT NULL CHECK (outcome IN ('new', 'duplicate', 'failed')),
    reason TEXT NOT NULL,
    orbit INTEGER REFERENCES orbits (id),
    seconds REAL NOT NULL,
    PRIMARY KEY (search, number)
) WITHOUT ROWID;
""",
    """
CREATE INDEX orbits_by_energy ON orbits (energy, period);
CREATE INDEX starts_by_orbit ON starts (orbit);
""",
    """
ALTER TABLE orbits ADD COLUMN signature TEXT NOT NULL DEFAULT '';
ALTER TABLE orbits ADD COLUMN proof TEXT NOT NULL DEFAULT '';
""",
    """
ALTER TABLE orbits ADD COLUMN parameters TEXT NOT NULL DEFAULT '';
""",
    """
ALTER TABLE orbits ADD COLUMN cost REAL;
""",
)
"""Scripts that raise the version by one each; a published one is never edited, only followed by another."""
VERSION = len(MIGRATIONS)
OURS = ("about", "orbits", "searches", "starts", "orbits_by_signature", "orbits_by_energy", "starts_by_orbit")
"""Names of the tables and indices that the migrations make."""


def connect(path: Path, write: bool) -> sqlite3.Connection:
    """A connection to an atlas of this version; a new file is made, an older one migrated, only to write.

    An older one is read as a copy in memory that has been migrated.
    Raises `InputError` for files that are missing, not an atlas, newer than this program or unusable.
    """
    with explained(path):
        if not write:
            return _checked(path, _reading(path))
        if path.is_dir():
            raise InputError(f"{path}: a folder, not an atlas; name a file in it")
        if not path.parent.is_dir():
            raise InputError(f"{path}: the folder {str(path.parent)!r} does not exist; make it first")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: not a regular file; give an atlas")
        if path.exists() and not path.stat().st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH):
            raise InputError(f"{path}: read-only; make it writable, or work on a copy")
        connection = sqlite3.connect(path, timeout=PATIENCE, isolation_level=None)
        try:
            return _prepared(path, connection)
        except BaseException:
            connection.close()
            raise


def _reading(path: Path) -> sqlite3.Connection:
    """A connection that only asks; of a file in a folder that cannot be written as a file that nobody changes.

    It is not opened read-only: only who may write takes the files -wal and -shm away with the last connection.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such atlas; check the path, or make one with orbitfinder search")
    address = path.resolve().as_uri()
    connection = sqlite3.connect(f"{address}?mode=rw", timeout=PATIENCE, isolation_level=None, uri=True)
    try:
        connection.execute("PRAGMA query_only = ON")
        connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
        return connection
    except sqlite3.Error as error:
        connection.close()
        waiting = path.with_name(path.name + "-wal")
        if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_CANTOPEN or waiting.exists():
            raise
    return sqlite3.connect(f"{address}?mode=ro&immutable=1", isolation_level=None, uri=True)


def _checked(path: Path, connection: sqlite3.Connection) -> sqlite3.Connection:
    """The connection, or one to a migrated copy in memory, if its file is an atlas."""
    try:
        version = _version(path, connection)
        if version == 0:
            raise InputError(f"{path}: empty, not an atlas yet; make one with orbitfinder search")
        if version == VERSION:
            return connection
        with contextlib.closing(connection):
            copy = sqlite3.connect(":memory:", isolation_level=None)
            connection, left = copy, connection
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_FILE)
            left.backup(connection)
        _migrate(connection, version)
        return connection
    except BaseException:
        connection.close()
        raise


def _version(path: Path, connection: sqlite3.Connection) -> int:
    """The version of an atlas, 0 for an empty file. Raises `InputError` for everything else."""
    inside = connection.in_transaction
    if not inside:  # one look at the file, not three: another writer may be making its tables
        connection.execute("BEGIN")
    try:
        mark = connection.execute("PRAGMA application_id").fetchone()[0]
        tables = connection.execute("SELECT type, name, sql FROM sqlite_master").fetchall()
        version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    finally:
        if not inside and connection.in_transaction:
            connection.execute("ROLLBACK")
    if mark != APPLICATION:
        if tables or mark or version:
            raise InputError(f"{path}: a database of another program, not an atlas; give another file")
        return 0
    if version > VERSION:
        raise InputError(
            f"{path}: version: an atlas of version {version}, this orbitfinder knows up to {VERSION}; "
            "update orbitfinder, nothing was changed"
        )
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_FILE)
    wanted = set(_schema(version))  # that the migrations make: no view computes, no trigger acts
    for kind, name, text in tables:
        if _squeezed(text) in wanted:
            wanted.remove(_squeezed(text))
        elif kind not in ("table", "index") or str(name) in OURS:
            raise InputError(f"{path}: {kind} {str(name)[:60]!r} is not as orbitfinder makes it; restore a copy")
    if wanted:
        raise InputError(f"{path}: misses {min(wanted)[:60]!r}; restore a copy of the atlas")
    return version


def _squeezed(text: object) -> str:
    return re.sub(r"\s+", " ", str(text)).strip()


def _prepared(path: Path, connection: sqlite3.Connection) -> sqlite3.Connection:
    """The connection with the file brought to this version, one transaction a version."""
    _version(path, connection)
    until = time.monotonic() + PATIENCE
    while True:  # write-ahead logging; SQLite does not wait for others by itself when it switches to it
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            break
        except sqlite3.OperationalError as error:
            if error.sqlite_errorcode & 0xFF != sqlite3.SQLITE_BUSY or time.monotonic() > until:
                raise
            time.sleep(0.02)
    # a transaction survives the death of the process; after a power cut the last ones may be missing, none is
    # half there, and a resumed search computes the same again
    connection.execute("PRAGMA synchronous = NORMAL")
    connection.execute("PRAGMA foreign_keys = ON")
    while _version(path, connection) < VERSION:
        with transaction(connection):
            version = _version(path, connection)  # another writer may have been faster
            _migrate(connection, version, version + 1)
    return connection


def _migrate(connection: sqlite3.Connection, version: int, wanted: int = VERSION) -> None:
    """Raise the version of an atlas from the one found to the one wanted."""
    for script in MIGRATIONS[version:wanted]:
        for statement in script.split(";"):
            connection.execute(statement)
        version += 1
        connection.execute(f"PRAGMA application_id = {APPLICATION}")
        connection.execute(f"PRAGMA user_version = {version}")


@lru_cache
def _schema(version: int) -> frozenset[str]:
    """The statements of the tables and indices of an atlas of a version, as SQLite keeps them."""
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as connection:
        _migrate(connection, 0, version)
        question = "SELECT sql FROM sqlite_master WHERE sql IS NOT NULL"
        return frozenset(_squeezed(text) for (text,) in connection.execute(question))


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """All of the block or nothing, alone among the writers from the beginning."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # a full disk has rolled back already
            connection.execute("ROLLBACK")
        raise


REASONS = {
    sqlite3.SQLITE_FULL: "the disk is full; free some space and give the same command again, which goes on from here",
    sqlite3.SQLITE_READONLY: "read-only; make it writable, or work on a copy",
    sqlite3.SQLITE_PERM: "no permission; check who owns it",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened; check the path, the folder and their permissions",
    sqlite3.SQLITE_NOTADB: "not an SQLite file; give an atlas",
    sqlite3.SQLITE_CORRUPT: "damaged; restore a copy (sqlite3 FILE .recover saves what is left)",
    sqlite3.SQLITE_BUSY: f"another program kept it locked for {PATIENCE:g} s; try again when that has ended",
    sqlite3.SQLITE_IOERR: "the disk does not answer (input/output error); check its space and its health",
}
"""What SQLite's primary result codes mean for the owner of the file."""


@contextlib.contextmanager
def explained(path: Path) -> Iterator[None]:
    """SQLite's errors inside the block become an `InputError` that names the file and the remedy."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:  # the latter: SQLite quoting what is no text
        code = getattr(error, "sqlite_errorcode", 0) & 0xFF
        reason = REASONS.get(code, f"cannot be used ({error}); check that it is an atlas")
        raise InputError(f"{path}: {reason}") from error
