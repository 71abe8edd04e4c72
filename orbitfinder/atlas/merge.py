"""Several atlases of one system as one: what the searches in them would have made of one file.

The union is put in an order of its own, so that it does not matter which atlas comes first or how often: searches by
their request, orbits by the first start that found them. Of an orbit that several atlases hold the record of the lowest
start is kept, which is the one that a single search would have kept.
"""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from orbitfinder._runtime import limit
from orbitfinder._runtime.arguments import checked
from orbitfinder._runtime.notebook import brief
from orbitfinder.atlas.signature import same_orbit, signature_of
from orbitfinder.atlas.store import RESTORE, STORED, Atlas, named_values
from orbitfinder.atlas.tables import explained, transaction
from orbitfinder.errors import InputError, plural
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import orbit_from_document

Request = tuple[float, float, float, int, str]
"""A search: energy (J), shortest and longest period (s), seed, method."""
Birth = tuple[Request, int]
"""The search and number of a start."""


@dataclass(frozen=True)
class Joined:
    """One search of a merged atlas: how many starts were made, and how many between them were not (lost shards)."""

    energy: float
    periods: tuple[float, float]
    seed: int
    starts: int
    missing: int


@dataclass(frozen=True)
class Merged:
    """What `merge_atlases` made."""

    __repr__ = brief("atlas", "orbits", "starts")

    atlas: Path
    orbits: int
    starts: int
    searches: tuple[Joined, ...]

    def document(self) -> dict[str, Any]:
        """The same for `--json`."""
        return asdict(self) | {"atlas": str(self.atlas)}


@dataclass(frozen=True, order=True)
class _Birth:
    """An orbit of one of the atlases in the order of the union: by its birth, those without one after all others."""

    orphan: bool
    birth: Birth | tuple[()]
    numbers: tuple[float, float, float]
    unproved: bool
    digest: bytes
    book: int
    number: int
    bins: tuple[int, int]
    parameters: str


@checked
def merge_atlases(
    files: Sequence[str | Path], atlas: str | Path, *, union: bool = False, model: Model | None = None,
    trusted: Path | None = None,
) -> Merged:  # fmt: skip
    """Put the orbits, searches and starts of several atlases of one system into one, beside what that holds already.

    Merging is idempotent, commutative and associative. Each atlas is taken whole or not at all, and none where one is
    refused; of a merge that is stopped or killed those stay that are taken, and are not taken again.

    Args:
        files: the atlases.
        atlas: the file to write.
        union: whether atlases that share no search with another one are taken too.
        model: for systems that no file describes.
        trusted: folder of a module that makes the system.

    Returns:
        How many `orbits` and `starts` the atlas holds, and which `searches`.

    Raises:
        InputError: for atlases of other systems, and without `union` of other searches.

    Examples:
        >>> for shard in ("1/2", "2/2"):
        ...     _ = of.search(pendulum, -18.0, (0.9, 2.5), f"{shard[0]}.sqlite", starts=4, workers=0, shard=shard)
        >>> of.merge_atlases(["1.sqlite", "2.sqlite"], "both.sqlite").starts
        4
    """
    if not files:
        raise InputError("files: none given; name the atlases to merge")
    with contextlib.ExitStack() as stack:
        books = [
            stack.enter_context(Atlas(file, model=model, trusted=trusted))
            for file in {Path(file).resolve(): Path(file) for file in files}.values()
        ]
        for book in books[1:]:
            stack.enter_context(Atlas(book.path, books[0].system, model=model, trusted=trusted))  # or it is of another
        out = stack.enter_context(Atlas(atlas, books[0].system, write=True, model=model, trusted=trusted))
        held = stack.enter_context(Atlas(atlas, model=model, trusted=trusted))
        books = [book for book in books if book.path.resolve() != out.path.resolve()]
        with explained(out.path):
            _check_requests([*books, held], union)
            for k, book in enumerate([*books, held]):
                for entry in _entries(k, book):
                    book.document(entry.number)  # `InputError` where it is damaged, before anything is written
            taken = {key for (key,) in held.select([str], "SELECT key FROM about")}
            marks = [(mark, book) for book in books if (mark := _mark(book)) not in taken]
            for k, (mark, book) in enumerate(marks or [("", held)]):
                done = k + len(books) - len(marks)
                limit.note(f"{done} of {plural(len(books), 'atlas')} in {out.path}; the same command takes the others")
                limit.check()
                with transaction(out.connection):
                    _joined(out, [book, held] if mark else [held])
                    if mark:
                        out.connection.execute("INSERT OR IGNORE INTO about VALUES (?, ?)", [mark, book.path.name])
        rows = out.select(
            [float, float, float, int, int, int],
            "SELECT energy, shortest, longest, seed, count(number), coalesce(max(number) + 1 - count(number), 0) "
            "FROM searches LEFT JOIN starts ON starts.search = searches.id GROUP BY searches.id ORDER BY searches.id",
        )
        joined = tuple(
            Joined(energy, (low, high), seed, made, missing) for energy, low, high, seed, made, missing in rows
        )
        return Merged(out.path, len(out), sum(search.starts for search in joined), joined)


def _joined(out: Atlas, books: Sequence[Atlas]) -> None:
    """Make an atlas the union of several, the last of which reads what it holds; in a transaction."""
    entries = sorted(entry for k, book in enumerate(books) for entry in _entries(k, book))
    for table in ("starts", "orbits", "searches"):
        out.connection.execute(f"DELETE FROM {table}")
    out.forget()
    known = _orbits(out, books, entries)
    _starts(out, books, known, [entry for entry in entries if not entry.orphan])


def _mark(book: Atlas) -> str:
    """What an atlas that has taken all of another one says `about` it: the journal of a merge."""
    digest = hashlib.sha256()
    with explained(book.path):
        for table in ("searches", "starts", "orbits"):
            for row in book.connection.execute(f"SELECT * FROM {table} ORDER BY 1, 2"):
                digest.update(repr(row).encode())
    return f"merged {digest.hexdigest()}"


def _searches(book: Atlas) -> dict[int, Request]:
    """The searches of an atlas by their ids. `InputError` where a start belongs to none, or to no orbit."""
    lost = "search NOT IN (SELECT id FROM searches) OR orbit > 0 AND orbit NOT IN (SELECT id FROM orbits)"
    if book.select([int], f"SELECT search FROM starts WHERE {lost} LIMIT 1"):
        raise InputError(f"{book.path}: starts: of searches or orbits that are not there; {RESTORE}")
    rows = book.select([int, float, float, float, int, str], "SELECT id, energy, shortest, longest, seed, method FROM "
                       "searches ORDER BY energy, shortest, longest, seed, method")  # fmt: skip
    return {number: (energy, *rest) for number, energy, *rest in rows}  # type: ignore[misc]


def _check_requests(books: Sequence[Atlas], union: bool) -> None:
    """`InputError` for an atlas with searches none of which is in another one: hardly a shard of the same."""
    asked = [(book, set(_searches(book).values())) for book in books]
    asked = [(book, requests) for book, requests in asked if requests]
    for book, requests in asked:
        others = [known for other, known in asked if other is not book]
        if others and not union and not any(requests & known for known in others):
            energy, shortest, longest, seed, _ = min(requests)
            raise InputError(
                f"{book.path}: searches: at {energy:g} J, periods {shortest:g} to {longest:g} s, seed {seed}, and none "
                "of them is in another of these atlases, so it is no shard of the same search; leave it out, or give "
                "--union (union=True) to catalogue different searches together"
            )


def _entries(k: int, book: Atlas) -> Iterator[_Birth]:
    """The orbits of an atlas with the starts that found them."""
    requests, born = _searches(book), dict[int, Birth]()
    for orbit, search, number in book.select(
        [int, int, int], "SELECT orbit, search, number FROM starts WHERE outcome = 'new' AND orbit IS NOT NULL"
    ):
        born[orbit] = min(born.get(orbit, (requests[search], number)), (requests[search], number))
    kinds = [int, float, float, float, int, int, str, str, bytes]
    columns = "id, energy, period, action, period_bin, action_bin, proof, parameters, document"
    question = f"SELECT {columns} FROM orbits WHERE id = ?"
    for (number,) in book.select([int], "SELECT id FROM orbits"):
        ((_, *numbers, first, second, proof, parameters, document),) = book.select(kinds, question, [number])
        birth, digest = born.get(number, ()), hashlib.sha256(document).digest()
        where = k, number, (first, second), parameters
        yield _Birth(not birth, birth, tuple(numbers), not proof, digest, *where)  # type: ignore[arg-type]


def _orbits(out: Atlas, books: Sequence[Atlas], entries: Sequence[_Birth]) -> dict[tuple[int, int], int]:
    """Write each orbit once; the new id of every orbit by its atlas and id there."""
    known, seen = dict[tuple[int, int], int](), dict[bytes, int]()
    for entry in entries:
        number = seen.get(entry.digest)
        if number is None:
            book = books[entry.book]
            document, words = book.document(entry.number), entry.parameters  # `InputError` where it is damaged
            near = out.near(entry.bins, words)
            if near:
                there = with_parameters(out.model, named_values(words))
                signature = replace(signature_of(orbit_from_document(document), there), parameters=words)
                number = next((k for k in near if same_orbit(out.signature(k), signature)), None)
            if number is None:
                row = book.connection.execute(f"SELECT {STORED} FROM orbits WHERE id = ?", [entry.number]).fetchone()
                number = out.put(row)
            seen[entry.digest] = number
        known[entry.book, entry.number] = number
    return known


def _starts(out: Atlas, books: Sequence[Atlas], known: dict[tuple[int, int], int], births: Sequence[_Birth]) -> None:
    """Write every search and start once; of a start that two atlases hold the one that met an orbit."""
    execute, ids = out.connection.execute, dict[Request, int]()
    search = "INSERT INTO searches (energy, shortest, longest, seed, method, sources) VALUES (?, ?, ?, ?, ?, 0)"
    for request in sorted({wanted for book in books for wanted in _searches(book).values()}):
        row = execute(search, request)
        ids[request] = int(row.lastrowid or 0)
    for k, book in enumerate(books):
        requests = _searches(book)
        for (search,) in book.select([int], "SELECT DISTINCT search FROM starts"):
            kinds = [int, str, str, int | None, float]
            question = "SELECT number, strategy, reason, orbit, seconds FROM starts WHERE search = ?"
            for number, strategy, reason, orbit, seconds in book.select(kinds, question, [search]):
                met = None if orbit is None else known[k, orbit]
                outcome = "failed" if met is None else "duplicate"
                execute(PREFERRED, [ids[requests[search]], number, strategy, outcome, reason, met, seconds])
    first: dict[int, _Birth] = {}
    for entry in births:
        first.setdefault(known[entry.book, entry.number], entry)
    for number, entry in first.items():
        assert entry.birth
        place = [ids[entry.birth[0]], entry.birth[1], number]
        execute("UPDATE starts SET outcome = 'new' WHERE search = ? AND number = ? AND orbit = ?", place)


PREFERRED = """
INSERT INTO starts VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (search, number) DO UPDATE SET
    strategy = excluded.strategy, outcome = excluded.outcome, reason = excluded.reason, orbit = excluded.orbit,
    seconds = excluded.seconds
WHERE (excluded.outcome, excluded.strategy, excluded.reason, coalesce(excluded.orbit, 0), excluded.seconds)
    < (outcome, strategy, reason, coalesce(orbit, 0), seconds)
"""
"""The least of all records of a start, whichever comes first; `duplicate` is before `failed`."""
