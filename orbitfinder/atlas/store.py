"""An Atlas: a durable catalogue of distinct certified orbits of one system, and the record of its searches."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder import display
from orbitfinder.atlas.signature import Signature, neighbours, same_orbit, signature_of
from orbitfinder.atlas.tables import connect, explained, transaction
from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import Model
from orbitfinder.periodic.orbit import Orbit, check_document, orbit_from_document, orbit_to_document

LOOPS_KEPT = 4096
"""Loops of known orbits held in memory; others are integrated again when a look-up needs them."""


@dataclass(frozen=True)
class Row:
    """One line of an atlas: an orbit in a few numbers (SI units), `instability` its largest |multiplier|."""

    id: int
    energy: float
    period: float
    action: float
    symmetry: str
    stability: str
    instability: float
    closure: float


COLUMNS = tuple(Row.__dataclass_fields__)


@dataclass(frozen=True)
class Filter:
    """Which orbits: closed ranges of period (s) and energy (J), kinds of stability and symmetry; None is all."""

    period: tuple[float, float] | None = None
    energy: tuple[float, float] | None = None
    stability: tuple[str, ...] = ()
    symmetry: tuple[str, ...] = ()

    def condition(self) -> tuple[str, list[Any]]:
        """The same as an SQL condition with its values."""
        parts, values = ["1"], []
        for name in ("period", "energy"):
            if (limits := getattr(self, name)) is not None:
                parts.append(f"{name} BETWEEN ? AND ?")
                values += [float(limits[0]), float(limits[1])]
        for name in ("stability", "symmetry"):
            if chosen := getattr(self, name):
                parts.append(f"{name} IN ({', '.join('?' * len(chosen))})")
                values += list(chosen)
        return " AND ".join(parts), values


class Atlas:
    """Orbits in an SQLite file, at `path`. Open to read by default; a context manager.

    `system` (the description in `Model.system`) must be given to write, and must be that of the
    orbits already there. `model` is needed for systems that no file describes.
    """

    def __init__(
        self, path: str | Path, system: Mapping[str, Any] | None = None, write: bool = False, model: Model | None = None
    ) -> None:
        self.path, self._model = Path(path), model
        self._loops: dict[int, Signature] = {}
        self.connection = connect(self.path, write)
        try:
            with explained(self.path):
                asked = system if model is None else model.system
                self.system = self._recorded() if asked is None else self._claim(dict(asked), write)
        except BaseException:
            self.connection.close()
            raise

    def __enter__(self) -> Atlas:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; a last connection also folds the write-ahead log into it."""
        self.connection.close()

    def _recorded(self) -> dict[str, Any]:
        row = self.connection.execute("SELECT value FROM about WHERE key = 'system'").fetchone()
        if row is None:
            raise InputError(f"{self.path}: system: missing; the atlas has not been searched into yet")
        return dict(json.loads(row[0]))

    def _claim(self, system: dict[str, Any], write: bool) -> dict[str, Any]:
        """The system of this atlas: recorded if none is, and refused if it is another."""
        text = json.dumps(system, sort_keys=True)
        if write:
            with transaction(self.connection):
                self.connection.execute("INSERT OR IGNORE INTO about VALUES ('system', ?)", [text])
        found = self._recorded()
        if canonical(found) != canonical(system):
            raise InputError(
                f"{self.path}: system: holds orbits of {described(found, system)}, not of {described(system, found)}; "
                "give another atlas file"
            )
        return found

    @property
    def model(self) -> Model:
        """The Model of the atlas's system."""
        if self._model is None:
            from orbitfinder.mechanics.catalogue import build_model

            self._model = build_model(self.system)
        return self._model

    def _repr_html_(self) -> str | None:
        """How a notebook shows it."""
        return display.html(self)

    def __len__(self) -> int:
        return int(self.connection.execute("SELECT count(*) FROM orbits").fetchone()[0])

    def rows(self, chosen: Filter | None = None, order: str = "energy, period") -> list[Row]:
        """The orbits that pass a filter, by energy and period (or by `order`, columns of `Row`)."""
        words = order.replace(",", " ").split()
        if not set(words) <= {*COLUMNS, "DESC"}:
            raise InputError(f"order: unknown {order!r}; use columns among {', '.join(COLUMNS)}")
        condition, values = (chosen or Filter()).condition()
        with explained(self.path):
            found = self.connection.execute(
                f"SELECT {', '.join(COLUMNS)} FROM orbits WHERE {condition} ORDER BY {order}, id", values
            ).fetchall()
        return [Row(*entry) for entry in found]

    def document(self, number: int) -> dict[str, Any]:
        """The orbit.json document of an orbit by its id."""
        with explained(self.path):
            row = self.connection.execute("SELECT document FROM orbits WHERE id = ?", [int(number)]).fetchone()
        if row is None:
            raise InputError(f"{self.path}: id: no orbit {number}; list them with orbitfinder atlas list")
        return unpacked(row[0], f"{self.path}: orbit {number}")

    def orbit(self, number: int) -> Orbit:
        """An orbit by its id, certificate included; its dense samples are left out (see `with_samples`)."""
        document = self.document(number)
        return orbit_from_document(document, np.zeros(0), np.zeros((0, len(document["state"]))))

    def documents(self, chosen: Filter | None = None) -> Iterator[dict[str, Any]]:
        """The orbit.json documents that pass a filter, by energy and period."""
        for row in self.rows(chosen):
            yield self.document(row.id)

    def look_up(self, signature: Signature) -> int | None:
        """The id of the orbit that a signature belongs to, None when it is new."""
        periods, actions = neighbours(signature)
        found = self.connection.execute(
            "SELECT id FROM orbits WHERE period_bin IN (?, ?, ?) AND action_bin IN (?, ?, ?) ORDER BY id",
            [*periods, *actions],
        ).fetchall()
        return next((one for (one,) in found if same_orbit(self.signature(one), signature)), None)

    def signature(self, number: int) -> Signature:
        """The signature of a stored orbit, its loop integrated again unless it is still in memory."""
        if number not in self._loops:
            self.remember(number, signature_of(self.orbit(number), self.model))
        return self._loops[number]

    def remember(self, number: int, signature: Signature) -> None:
        """Keep the loop of an orbit for later look-ups."""
        if len(self._loops) >= LOOPS_KEPT:
            self._loops.pop(next(iter(self._loops)))
        self._loops[number] = signature

    def insert(self, orbit: Orbit, signature: Signature) -> int:
        """Store an orbit without further questions; the id. To be called inside a transaction."""
        if orbit.certificate is None or not orbit.certificate.passed:
            raise InputError("orbit: not certified; an atlas holds certified orbits only, certify it first")
        periods, actions = signature.bins
        numbers = [
            periods, actions, orbit.energy, orbit.period, orbit.action, orbit.symmetry, orbit.stability,
            float(np.abs(orbit.floquet_multipliers).max(initial=1.0)), orbit.closure, packed(orbit),
        ]  # fmt: skip
        cursor = self.connection.execute(
            "INSERT INTO orbits (period_bin, action_bin, energy, period, action, symmetry, stability, instability, "
            "closure, document) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            numbers,
        )
        assert cursor.lastrowid is not None
        return cursor.lastrowid

    def add(self, orbit: Orbit) -> tuple[int, bool]:
        """The id of an orbit, and True when it was new to this atlas."""
        signature = signature_of(orbit, self.model)
        with explained(self.path), transaction(self.connection):
            known = self.look_up(signature)
            number = self.insert(orbit, signature) if known is None else known
        self.remember(number, signature)
        return number, known is None


def packed(orbit: Orbit) -> bytes:
    """The orbit.json document of an orbit, compressed."""
    text = json.dumps(orbit_to_document(orbit), separators=(",", ":"), allow_nan=False)
    return zlib.compress(text.encode(), 9)


def unpacked(data: bytes, where: str) -> dict[str, Any]:
    """The document that `packed` made; `InputError` when it is damaged."""
    try:
        document = json.loads(zlib.decompress(data))
    except (zlib.error, ValueError, TypeError) as error:
        raise InputError(f"{where}: damaged ({error}); restore a copy of the atlas") from error
    return check_document(document, where)


def canonical(system: Mapping[str, Any]) -> str:
    """A description of a system in which 2 and 2.0 are one, keys sorted."""

    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {str(key): plain(entry) for key, entry in value.items()}
        if isinstance(value, Sequence) and not isinstance(value, str):
            return [plain(entry) for entry in value]
        return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else value

    # all formulations of a chain are the same motion
    return json.dumps(plain({key: value for key, value in system.items() if key != "formulation"}), sort_keys=True)


def described(system: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    """A system in a few words: its kind, and what differs from another."""
    words = [f"{key} = {value}" for key, value in system.items() if key != "formulation" and other.get(key) != value]
    return f"{system.get('kind', 'unknown')} ({', '.join(sorted(words, key=len))})"[:200]
