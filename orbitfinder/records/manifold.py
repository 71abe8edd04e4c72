"""Invariant manifolds and connections of orbits as plain numbers, and their files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError
from orbitfinder.records.orbit import Certificate, Check, certificate_to_document, energy_of
from orbitfinder.records.reading import (
    arrays,
    finite,
    json_file,
    plain_numbers,
    read_as,
    typed,
    walked,
    write_atomically,
    write_json,
    write_npz,
)

FORMAT, CONNECTION, VERSION = "orbitfinder/manifold", "orbitfinder/connection", 1
AGAIN = "make it again"


def reach(points: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest values (m each) of points (k x m) that have weights (k), but for what is far out.

    Three times the range of the middle four fifths, no more than all: a manifold that comes by a collision has few
    points there by its own measure, and they are anywhere.
    """
    low, high = (np.empty(points.shape[1]) for _ in range(2))
    weights = weights if weights.sum() > 0 else np.ones(len(points))
    for k, column in enumerate(points.T):
        known = np.isfinite(column)
        order = np.argsort(column[known])
        values, share = column[known][order], np.cumsum(weights[known][order])
        a, b = np.interp(np.array([0.1, 0.9]) * share[-1], share, values)
        low[k], high[k] = max(values[0], a - (b - a)), min(values[-1], b + (b - a))
    return low, high


@dataclass(frozen=True)
class Manifold(Shown):
    """A stable or unstable manifold of an orbit: curves on a section, or motions along it (a tube).

    `states` (k x d) are the points of all curves one after another; `pieces` (k) numbers the curves, which are broken
    where that changes; `places` (k) are where each began: its displacement along the eigendirection, in extents of
    the orbit; `images` (k) how many returns it took, `times` (k, s) how long. `point` (d) is the orbit's own on the
    section, `direction` (d) the eigendirection there, `displacement` the largest of the places and `error` how far
    off the manifold that was measured to be, in extents of the orbit, at it and at half of it (which shows its
    order).
    """

    __repr__ = brief("name", "which", "kind", "multiplier", "displacement", "error")

    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    which: str
    kind: str
    plane: str
    axes: tuple[str, str]
    energy: float
    multiplier: float
    displacement: float
    error: float
    error_at_half: float
    point: np.ndarray
    direction: np.ndarray
    states: np.ndarray
    pieces: np.ndarray
    places: np.ndarray
    images: np.ndarray
    times: np.ndarray

    @property
    def curves(self) -> tuple[np.ndarray, ...]:
        """The states of each curve (k x d)."""
        return tuple(np.split(self.states, np.flatnonzero(np.diff(self.pieces)) + 1))

    def reach(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest values of components, but for what is far out, as beside collisions: see `reach`."""
        logs = np.log(np.maximum(np.abs(self.places), 1e-300))
        steps = np.abs(np.diff(logs, append=logs[-1:])) * (np.diff(self.pieces, append=-1) == 0)
        return reach(self.states[:, [self.state_names.index(name) for name in names]], steps)

    @property
    def order(self) -> float:
        """Order of the displacement's error as measured; 2 where the manifold is curved."""
        return float(np.log2(max(self.error, 1e-300) / max(self.error_at_half, 1e-300)))


PLAIN = (
    "name", "system", "state_names", "which", "kind", "plane", "axes", "energy", "multiplier", "displacement", "error",
    "error_at_half",
)  # fmt: skip
MOTION = ("times", "samples")
"""The arrays of a connection"""
ARRAYS = ("point", "direction", "states", "pieces", "places", "images", "times")


@dataclass(frozen=True)
class _Plain:
    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    which: str
    kind: str
    plane: str
    axes: tuple[str, str]
    energy: float | None
    multiplier: float
    displacement: float
    error: float
    error_at_half: float


def save_manifold(manifold: Manifold, path: str | Path) -> Path:
    """Write a manifold as JSON with its numbers beside it, .npz and .csv; returns the JSON's path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_npz(target.with_suffix(".npz"), {name: getattr(manifold, name) for name in ARRAYS})
    write_atomically(target.with_suffix(".csv"), _csv(manifold).encode())
    document = {"format": FORMAT, "version": VERSION, **{name: getattr(manifold, name) for name in PLAIN}}
    return write_json(target, finite(document))


def _csv(manifold: Manifold) -> str:
    """One row a point: curve, return, time, displacement, state."""
    head = ",".join(["curve", "return", "time", "displacement", *manifold.state_names])
    columns = zip(manifold.pieces, manifold.images, manifold.times, manifold.places, manifold.states, strict=True)
    rows = (
        ",".join([str(int(piece)), str(int(image)), *(repr(float(x)) for x in (time, place, *state))])
        for piece, image, time, place, state in columns
    )
    return "\n".join([head, *rows]) + "\n"


def load_manifold(path: str | Path) -> Manifold:
    """The Manifold of a JSON file and the .npz beside it. Raises `InputError`."""
    source = Path(path)
    document = _document(source, FORMAT, "a manifold", "`orbitfinder manifold`")
    plain = read_as(_Plain, document, str(source), AGAIN)
    numbers: dict[str, Any] = {**vars(plain), **arrays(source.with_suffix(".npz"), ARRAYS, AGAIN)}
    return Manifold(**numbers | {"energy": energy_of(plain.energy)})


def _document(source: Path, wanted: str, what: str, maker: str) -> Mapping[str, Any]:
    document = json_file(source, what.partition(" ")[2], AGAIN)
    if not isinstance(document, Mapping) or document.get("format") != wanted:
        raise InputError(f"{source}: not {what}; give a file that {maker} wrote")
    return document


@dataclass(frozen=True)
class End:
    """One end of a connection: an orbit and where on its local manifold the motion begins or ends.

    `orbit` is its name, `state` (d) and `period` the orbit itself, `point` (d) its crossing of the section,
    `multiplier` and `direction` (d) those of the manifold there, `place` the displacement along it, `extents` (d)
    what that is in.
    """

    __repr__ = brief("orbit", "multiplier", "place")

    orbit: str
    state: np.ndarray
    period: float
    multiplier: float
    point: np.ndarray
    direction: np.ndarray
    place: float
    extents: np.ndarray


@dataclass(frozen=True)
class Connection(Shown):
    """A motion from one orbit to another (heteroclinic) or back to the same (homoclinic).

    `states` (m + 1 x d) are its crossings of the section, the first on the unstable manifold of `origin`, the last on
    the stable one of `goal`, `durations` (m, s) the times between; it is looked at at crossing number `chosen`:
    `angle` (rad) between the manifolds there and `error` of that point, in the state's own units. `component` is that
    of the plane.
    """

    __repr__ = brief("name", "kind", "state", "angle", "error", "certificate")

    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    plane: str
    component: int
    axes: tuple[str, str]
    energy: float
    states: np.ndarray
    durations: np.ndarray
    chosen: int
    angle: float
    error: float
    origin: End
    goal: End
    certificate: Certificate | None = None
    times: np.ndarray = field(default_factory=lambda: np.zeros(0))
    samples: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def state(self) -> np.ndarray:
        """The point (d) where it is looked at."""
        return np.asarray(self.states[self.chosen])

    @property
    def kind(self) -> str:
        """homoclinic or heteroclinic."""
        same = self.origin.state.shape == self.goal.state.shape and np.array_equal(self.origin.state, self.goal.state)
        return "homoclinic" if same else "heteroclinic"


@dataclass(frozen=True)
class _Plain2:
    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    plane: str
    component: int
    axes: tuple[str, str]
    energy: float | None
    states: np.ndarray
    durations: np.ndarray
    chosen: int
    angle: float
    error: float | None
    origin: End
    goal: End


@dataclass(frozen=True)
class _Check:
    name: str
    value: float | None
    tolerance: float
    passed: bool
    note: str = ""


@dataclass(frozen=True)
class _Checks:
    checks: tuple[_Check, ...] = ()


def save_connection(connection: Connection, path: str | Path) -> Path:
    """Write a connection as JSON and its motion beside it in .npz; returns the JSON's path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_npz(target.with_suffix(".npz"), {name: getattr(connection, name) for name in MOTION})
    document = {"format": CONNECTION, "version": VERSION, "kind": connection.kind, **connection_entry(connection)}
    return write_json(target, document)


def connection_entry(connection: Connection) -> dict[str, Any]:
    """A Connection in plain numbers, but for its motion."""
    plain = {name: getattr(connection, name) for name in _Plain2.__dataclass_fields__}
    ends = {name: vars(plain[name]) for name in ("origin", "goal")}
    certificate = certificate_to_document(connection.certificate)
    return dict(finite(walked({**plain, **ends, "certificate": certificate}, plain_numbers)))


def load_connection(path: str | Path) -> Connection:
    """The Connection of a JSON file; its certificate as recorded. Raises `InputError`."""
    source = Path(path)
    document = _document(source, CONNECTION, "a connection", "`orbitfinder connect`")
    beside = source.with_suffix(".npz")
    motion = arrays(beside, MOTION, AGAIN) if beside.exists() else {}
    try:
        return connection_of(document, motion)
    except ValueError as error:
        raise InputError(f"{source}: {error}; {AGAIN}") from error


def connection_of(entry: Mapping[str, Any], motion: Mapping[str, np.ndarray]) -> Connection:
    """The Connection of its entry and its motion (`times`, `samples`). Raises `ValueError` for a damaged one."""
    plain = typed(_Plain2, entry, "")
    if plain.states.ndim != 2 or not 0 <= plain.chosen < len(plain.states):
        raise ValueError("states: expected rows, the chosen one among them")
    entries = typed(_Checks, entry.get("certificate", {}), "").checks
    checks = tuple(Check(**vars(one) | {"value": _number(one.value)}) for one in entries)
    known = {"energy": energy_of(plain.energy), "error": _number(plain.error), "certificate": Certificate(checks)}
    return Connection(**{**vars(plain), **motion, **known})


def _number(value: float | None) -> float:
    """Infinity where JSON has no such number."""
    return float("inf") if value is None else value
