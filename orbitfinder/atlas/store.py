"""An Atlas: a durable catalogue of distinct certified orbits of one system, and the record of its searches."""

from __future__ import annotations

import contextlib
import json
import re
import sqlite3
import weakref
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import GenericAlias
from typing import Any, get_type_hints

import numpy as np

from orbitfinder._runtime.arguments import checked
from orbitfinder._runtime.notebook import Shown, brief, html
from orbitfinder.atlas.signature import Signature, in_words, neighbours, same_orbit, signature_of
from orbitfinder.atlas.tables import connect, explained, transaction
from orbitfinder.errors import InputError, closest
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.kind import OTHER, build_model, system_kind, with_parameters
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.orbits.floquet import STABILITIES
from orbitfinder.records.orbit import (
    Orbit,
    orbit_from_document,
    orbit_to_document,
    recorded_proof,
)
from orbitfinder.records.reading import (
    LARGEST_INTEGER,
    Entries,
    Table,
    inflated,
    is_number,
    json_document,
    read_as,
    walked,
)

RESTORE = "restore a copy of the atlas"
LOOPS_KEPT = 32_000_000
"""Bytes of loops of known orbits, the latest used, in memory; others are integrated again where they are needed."""

ALIKE = ("formulation", "cycle")
"""What may differ in the description of one system: all formulations are one motion, all cycles one machine's."""
UNDESCRIBED = (
    " (a Model built in Python has no description: it may read the orbits whose energies it has; to write, "
    "search the problem file that they came from, with --trust)"
)
SAME_ENERGY = 1e-9
"""A Model's energy along a recorded orbit may differ by this from the recorded one, relative."""


@dataclass(frozen=True)
class AtlasRow:
    """One line of an atlas: an orbit in a few numbers (SI units), `instability` its largest |multiplier|.

    `signature` says how often each coordinate turns back in a period (see `signature.in_words`), `proof` the stability
    that is proved of it; "" where that was not asked; `parameters` are those that are not the system's own, in JSON;
    `cost` is that of a controlled orbit.
    """

    id: int
    energy: float
    period: float
    action: float
    symmetry: str
    stability: str
    instability: float
    closure: float
    signature: str
    proof: str
    parameters: str
    cost: float | None = None


COLUMNS = tuple(AtlasRow.__dataclass_fields__)
STORED = f"period_bin, action_bin, {', '.join(COLUMNS[1:])}, document"
"""What the line of an orbit holds besides its id, in the order in which it is written"""
LINES = f"SELECT {', '.join(COLUMNS)} FROM orbits"


@dataclass(frozen=True)
class Filter:
    """Which orbits of an atlas.

    Args:
        period: closed range in s; None for all.
        energy: closed range in J; None for all.
        stability: one kind or several; () for all.
        symmetry: one kind or several; () for all.

    Raises:
        InputError: for a range or a kind that no orbit can have.

    Examples:
        >>> with of.Atlas("mine.sqlite", pendulum.system, write=True) as atlas:
        ...     _ = atlas.add(orbit)
        ...     len(atlas.rows(of.Filter(period=(1.0, 1.2), stability="elliptic")))
        1
    """

    period: tuple[float, float] | None = None
    energy: tuple[float, float] | None = None
    stability: str | tuple[str, ...] = ()
    symmetry: str | tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("period", "energy"):
            if (limits := getattr(self, name)) is not None:
                check_range(name, limits)
        for name, known in KINDS.items():
            for word in named(getattr(self, name)):
                if word not in known:
                    stable = ", stable orbits are elliptic where an energy is kept and asymptotically stable elsewhere"
                    meant = stable if word == "stable" else closest(word, known)
                    raise InputError(f"{name}: unknown {word!r}{meant}; use {', '.join(known)}")

    def condition(self) -> tuple[str, list[Any]]:
        """The same as an SQL condition with its values."""
        parts, values = ["1"], list[Any]()
        for name in ("period", "energy"):
            if (limits := getattr(self, name)) is not None:
                parts.append(f"{name} BETWEEN ? AND ?")
                values += [float(limits[0]), float(limits[1])]
        for name in KINDS:
            if chosen := named(getattr(self, name)):
                parts.append(f"{name} IN ({', '.join('?' * len(chosen))})")
                values += list(chosen)
        return " AND ".join(parts), values


KINDS = {"stability": STABILITIES, "symmetry": tuple(SYMMETRIES)}
"""What a filter chooses by name."""


def named(kinds: str | Sequence[str]) -> tuple[str, ...]:
    """One name or several, as several."""
    return (kinds,) if isinstance(kinds, str) else tuple(kinds)


def check_range(name: str, limits: Sequence[float]) -> None:
    """`InputError` when two limits are no closed range."""
    try:
        low, high = (float(limit) for limit in limits)
    except (TypeError, ValueError):
        low, high = np.nan, np.nan
    if not low <= high:
        raise InputError(f"{name}: must be two increasing numbers, got {limits!r}; give (low, high)")


def _closed(connection: sqlite3.Connection) -> None:
    """Close what nobody closed, of which Python warns since 3.13; only in the thread where it was opened can it be."""
    with contextlib.suppress(sqlite3.ProgrammingError):
        connection.close()


class Atlas(Shown):
    """Orbits in an SQLite file. Open to read by default; a context manager.

    `rows(filter)` are those that pass a Filter, by energy and period; `orbit(id)` is one of them, certificate
    included; `add(orbit)` gives its id, and True when it was new.

    Args:
        path: of the file.
        system: the description in `Model.system`, to write; it must be that of the orbits already there.
        write: whether orbits may be added.
        model: for systems that no file describes.
        trusted: folder of a Python module that makes the system, which the caller vouches for.

    Raises:
        InputError: for a file that is none, and another system.

    Examples:
        >>> with of.Atlas("mine.sqlite", pendulum.system, write=True) as atlas:
        ...     atlas.add(orbit)
        (1, True)
        >>> of.Atlas("mine.sqlite").orbit(1).certificate.passed
        True

    See Also:
        `of.search` fills one; `of.load_orbit("FILE.sqlite#3")`.
    """

    __repr__ = brief("path", "system")

    @checked
    def __init__(
        self, path: str | Path, system: Mapping[str, Any] | None = None, write: bool = False,
        model: Model | None = None, trusted: Path | None = None,
    ) -> None:  # fmt: skip
        self.path, self._model, self._trusted = Path(path), model, trusted
        self._loops: dict[int, Signature] = {}
        self.connection = connect(self.path, write)
        self._forgotten = weakref.finalize(self, _closed, self.connection)
        try:
            with explained(self.path):
                asked = system if model is None else model.system
                self.system = self._recorded() if asked is None else self._claim(dict(asked), write)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Atlas:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; a last connection also folds the write-ahead log into it."""
        self._forgotten.detach()  # whichever thread collects a closed one
        self.connection.close()

    def _recorded(self) -> Entries:
        rows = self.select([str], "SELECT value FROM about WHERE key = 'system'")
        if not rows:
            raise InputError(f"{self.path}: system: missing; the atlas has not been searched into yet")
        document = json_document(rows[0][0].encode(), f"{self.path}: system", RESTORE)
        return read_as(Entries, document, f"{self.path}: system", RESTORE)  # type: ignore[no-any-return]

    def select(self, kinds: Sequence[Any], question: str, values: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """The rows that answer a SELECT, every column of its kind (see `reading.read_as`). Raises `InputError`."""
        if any(isinstance(value, int) and abs(value) > LARGEST_INTEGER for value in values):
            return []  # no row has such an id
        with explained(self.path):
            rows = self.connection.execute(question, list(values)).fetchall()
        return [read_as(GenericAlias(tuple, tuple(kinds)), row, str(self.path), RESTORE) for row in rows]

    def _claim(self, system: Entries, write: bool) -> Entries:
        """The system of this atlas: recorded if none is, and refused if it is another."""
        text = json.dumps(system, sort_keys=True)
        if write:
            with transaction(self.connection):
                self.connection.execute("INSERT OR IGNORE INTO about VALUES ('system', ?)", [text])
        recorded = self._recorded()
        if canonical(recorded) != canonical(system) and not self._moves_alike(system, write):
            raise InputError(
                f"{self.path}: system: holds orbits of {described(recorded, system)}, not of "
                f"{described(system, recorded)}; give another atlas file"
                + (UNDESCRIBED if system_kind(system) is OTHER else "")
            )
        return recorded

    def _moves_alike(self, system: Table, write: bool) -> bool:
        """True when a Model without a description, given to read, has the recorded energy all along every orbit."""
        if write or self._model is None or system_kind(system) is not OTHER:
            return False
        for document in self.documents():
            nodes = np.atleast_2d(np.asarray(document["nodes"], float))
            if nodes.shape[1] != len(self._model.state_names):
                return False
            kinetic, potential = energies(self._model, nodes)
            scale = np.abs(kinetic).max() + np.abs(potential).max()
            if not np.all(np.abs(kinetic + potential - document["energy"]) <= SAME_ENERGY * scale):
                return False
        return True

    @property
    def name(self) -> str:
        """That of its file."""
        return self.path.stem

    @property
    def model(self) -> Model:
        """The Model of the atlas's system."""
        if self._model is None:
            self._model = build_model(self.system, self._trusted)
        return self._model

    @property
    def controlled(self) -> bool:
        """Whether it is of controlled motions."""
        return bool(self.select([int], "SELECT 1 FROM orbits WHERE cost IS NOT NULL UNION SELECT 1 FROM searches WHERE "
                                       "json_extract(method, '$.control') IS NOT NULL"))  # fmt: skip

    @property
    def conserved(self) -> bool:
        """Whether its searches are at energies; True where nothing is known of the system."""
        try:
            return bool(self.model.invariants) and not self.controlled
        except InputError:
            return True

    def _repr_html_(self) -> str | None:
        """How a notebook shows it."""
        return html(self)

    def __len__(self) -> int:
        return int(self.select([int], "SELECT count(*) FROM orbits")[0][0])

    def rows(self, chosen: Filter | None = None, order: str = "energy, period") -> list[AtlasRow]:
        """The orbits that pass a filter, by energy and period (or by `order`, columns of `AtlasRow`)."""
        words = order.replace(",", " ").split()
        if not set(words) <= {*COLUMNS, "DESC"}:
            raise InputError(f"order: unknown {order!r}; use columns among {', '.join(COLUMNS)}")
        condition, values = (chosen or Filter()).condition()
        alike = "CAST(printf('%.9g', energy) AS REAL)"  # energies that differ by round-off are one
        told = re.sub(r"\benergy\b", alike, order)
        question = f"{LINES} WHERE {condition} ORDER BY {told}, id"
        return [AtlasRow(*entry) for entry in self.select(list(get_type_hints(AtlasRow).values()), question, values)]

    def row(self, number: int) -> AtlasRow:
        """The line of one orbit, by its id."""
        rows = self.select(list(get_type_hints(AtlasRow).values()), f"{LINES} WHERE id = ?", [int(number)])
        if not rows:
            raise self._missing(number)
        return AtlasRow(*rows[0])

    def document(self, number: int) -> Entries:
        """The orbit.json document of an orbit by its id."""
        rows = self.select([bytes], "SELECT document FROM orbits WHERE id = ?", [int(number)])
        if not rows:
            raise self._missing(number)
        return unpacked(rows[0][0], f"{self.path}: orbit {number}")

    def _missing(self, number: int) -> InputError:
        last = self.select([int], "SELECT coalesce(max(id), 0) FROM orbits")[0][0]
        known = f"ids are from 1 to {last}" if last else "the atlas is empty"
        return InputError(f"{self.path}: id: no orbit {number}, {known}; list them with orbitfinder atlas list")

    def orbit(self, number: int) -> Orbit:
        """An orbit by its id, certificate included; its dense samples are left out."""
        return orbit_from_document(self.document(number))

    def documents(self, chosen: Filter | None = None) -> Iterator[Entries]:
        """The orbit.json documents that pass a filter, by energy and period."""
        for row in self.rows(chosen):
            yield self.document(row.id)

    def look_up(self, signature: Signature) -> int | None:
        """The id of the orbit that a signature belongs to, None when it is new."""
        near = self.near(signature.bins, signature.parameters)
        return next((k for k in near if same_orbit(self.signature(k), signature)), None)

    def near(self, bins: tuple[int, int], parameters: str = "") -> list[int]:
        """The ids of the orbits in and next to bins of period and action, at these parameters."""
        periods, actions = neighbours(bins)
        rows = self.select(
            [int], "SELECT id FROM orbits WHERE period_bin IN (?, ?, ?) AND action_bin IN (?, ?, ?) "
            "AND parameters = ? ORDER BY id", [*periods, *actions, parameters],
        )  # fmt: skip
        return [number for (number,) in rows]

    def signature(self, number: int) -> Signature:
        """The signature of a stored orbit, its loop integrated again unless it is still in memory."""
        if number in self._loops:
            self._loops[number] = self._loops.pop(number)  # the latest used is the last to go
        else:
            parameters = self.row(number).parameters
            there = with_parameters(self.model, named_values(parameters))
            self.remember(number, replace(signature_of(self.orbit(number), there), parameters=parameters))
        return self._loops[number]

    def remember(self, number: int, signature: Signature) -> None:
        """Keep the loop of an orbit for later look-ups."""
        while self._loops and (1 + len(self._loops)) * signature.loop.nbytes > LOOPS_KEPT:
            self._loops.pop(next(iter(self._loops)))
        self._loops[number] = signature

    def forget(self) -> None:
        """Let go of all loops, where ids are to become those of other orbits."""
        self._loops.clear()

    def insert(self, orbit: Orbit, signature: Signature) -> int:
        """Store an orbit without further questions; the id. To be called inside a transaction."""
        if orbit.certificate is None or not orbit.certificate.passed:
            raise InputError("orbit: not certified; an atlas holds certified orbits only, certify it first")
        (periods, actions), document = signature.bins, orbit_to_document(orbit)
        numbers = [
            periods, actions, signature.energy, orbit.period, orbit.action, orbit.symmetry, orbit.stability,
            float(np.abs(orbit.floquet_multipliers).max(initial=1.0)), orbit.closure, in_words(orbit, signature),
            proved(document), signature.parameters, (orbit.control or {}).get("cost"), compressed(document),
        ]  # fmt: skip
        return self.put(numbers)

    def put(self, numbers: Sequence[Any]) -> int:
        """Write the line of an orbit (see `STORED`); its id. To be called inside a transaction."""
        places = ", ".join("?" * len(numbers))
        cursor = self.connection.execute(f"INSERT INTO orbits ({STORED}) VALUES ({places})", numbers)
        assert cursor.lastrowid is not None
        return cursor.lastrowid

    def describe(self, number: int, proof: Table | None = None) -> None:
        """Write the signature of a stored orbit again, which atlases made before 0.2 lack, and a proof of it.

        Raises `InputError` for a proof of another orbit, as where a merge has numbered them anew meanwhile.
        """
        told = in_words(self.orbit(number), self.signature(number))
        with explained(self.path), transaction(self.connection):
            document = self.document(number) | ({} if proof is None else {"proof": dict(proof)})
            if proof is not None and proof.get("proved") is True and not proved(document):
                raise InputError(f"{self.path}: orbit {number}: proof: it is of another orbit; prove this one again")
            values = [told, proved(document), compressed(document), number]
            self.connection.execute("UPDATE orbits SET signature = ?, proof = ?, document = ? WHERE id = ?", values)

    def add(self, orbit: Orbit) -> tuple[int, bool]:
        """The id of an orbit, and True when it was new to this atlas."""
        signature = signature_of(orbit, self.model)
        with explained(self.path), transaction(self.connection):
            known = self.look_up(signature)
            number = self.insert(orbit, signature) if known is None else known
        self.remember(number, signature)
        return number, known is None


def stored(path: Path, number: int) -> Orbit:
    """An orbit of an atlas by its id. Raises `InputError`."""
    with Atlas(path) as atlas:
        return atlas.orbit(number)


def compressed(document: Table) -> bytes:
    """A document as an atlas keeps it."""
    return zlib.compress(json.dumps(document, separators=(",", ":"), allow_nan=False).encode(), 9)


def named_values(parameters: str) -> dict[str, float]:
    """Parameters by name, as an atlas keeps them; none of ""."""
    return json.loads(parameters) if parameters else {}


def as_words(values: Mapping[str, float]) -> str:
    """The text of which those are the `named_values`."""
    return json.dumps(dict(values), sort_keys=True, separators=(",", ":")) if values else ""


def parameters_in_words(parameters: str, before: str = "") -> str:
    """Parameters for a reader, such as `mass = 2`, with something before where there are any."""
    return before * bool(parameters) + ", ".join(f"{k} = {value:.9g}" for k, value in named_values(parameters).items())


def proved(document: Table) -> str:
    """The stability that the recorded proof of an orbit decides ("linearly stable", ..., "open"), "" without one."""
    return str((recorded_proof(document) or {}).get("stability", ""))


def unpacked(data: bytes, where: str) -> Entries:
    """The document that `compressed` packed; `InputError` when it is damaged."""
    document: Entries = json_document(inflated(data, where, RESTORE), where, RESTORE)
    orbit_from_document(document, where)
    return document


def named_state(document: Table, names: Sequence[str]) -> dict[str, float]:
    """The state of an orbit document by its components' names. `InputError` when it is of another system."""
    state = document["state"]
    if len(state) != len(names):
        raise InputError(f"orbit: {len(state)} numbers in state for {', '.join(names)}; {RESTORE}")
    return dict(zip(names, state, strict=True))


def canonical(system: Table) -> str:
    """A description of a system in which 2 and 2.0 are one, keys sorted."""
    told = {key: value for key, value in system.items() if key not in ALIKE}
    return json.dumps(walked(told, lambda entry: float(entry) if is_number(entry) else entry), sort_keys=True)


def described(system: Table, other: Table) -> str:
    """A system in a few words: its kind, and what differs from another."""
    words = [f"{key} = {value}" for key, value in system.items() if key not in ALIKE and other.get(key) != value]
    return f"{system.get('kind', 'unknown')} ({', '.join(sorted(words, key=len))})"[:200]
