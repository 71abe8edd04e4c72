"""Invariant manifolds and connections of orbits as plain numbers, and their files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.records.certificate import Certified
from orbitfinder.records.codec import Codec, Dense, Endless, Unknown, check_axes, check_shapes, plain
from orbitfinder.records.reading import write_atomically


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


WHICH = {"unstable": 1, "stable": -1}
"""Manifolds, and the way of time in which motions on them leave"""


@dataclass(frozen=True)
class Manifold(Shown):
    """A stable or unstable manifold of an orbit: curves on a section, or motions along it (a tube).

    `states` (k x d) are the points of all curves in turn; `pieces` (k) numbers the curves, which are broken
    where that changes; `places` (k) are where each began: its displacement along the eigendirection, in extents of
    the orbit; `images` (k) how many returns it took, `times` (k, s) how long. `point` (d) is the orbit's own on the
    section, `direction` (d) the eigendirection there, `displacement` the largest of the places and `error` how far
    off the manifold that was measured to be, in extents of the orbit, at it and at half of it (which shows its
    order). `title` is the orbit's.
    """

    __repr__ = brief("name", "which", "kind", "multiplier", "displacement", "error")
    _sparse = ("title",)

    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    which: str
    kind: str
    plane: str
    axes: tuple[str, str]
    energy: Unknown
    multiplier: float
    displacement: float
    error: Unknown
    error_at_half: Unknown
    point: Dense
    direction: Dense
    states: Dense
    pieces: Dense
    places: Dense
    images: Dense
    times: Dense
    title: str = ""

    @property
    def curves(self) -> tuple[np.ndarray, ...]:
        """The states of each curve (k x d)."""
        return tuple(np.split(self.states, np.flatnonzero(np.diff(self.pieces)) + 1))

    def reach(self, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest values of components, but for what is far out, as beside collisions: see `reach`."""
        logs = np.log(nonzero(np.abs(self.places)))
        steps = np.abs(np.diff(logs, append=logs[-1:])) * (np.diff(self.pieces, append=-1) == 0)
        return reach(self.states[:, [self.state_names.index(name) for name in names]], steps)

    @property
    def order(self) -> float:
        """Order of the displacement's error as measured; 2 where the manifold is curved."""
        return float(np.log2(nonzero(self.error) / nonzero(self.error_at_half)))

    def _check(self) -> None:
        check_axes(self)
        if self.which not in WHICH:
            raise ValueError(f"which: must be unstable or stable, got {self.which!r}")
        count, d = self.pieces.size, len(self.state_names)
        check_shapes(self, states=(count, d), point=(d,), direction=(d,),
                     **dict.fromkeys(("pieces", "places", "images", "times"), (max(count, 1),)))  # fmt: skip


MANIFOLD = Codec(Manifold, "manifold", "`orbitfinder manifold`", "make it again")


def save_manifold(manifold: Manifold, path: str | Path) -> Path:
    """Write a manifold as JSON with its numbers beside it, .npz and .csv; returns the JSON's path."""
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    head = ",".join(["curve", "return", "time", "displacement", *manifold.state_names])
    columns = zip(manifold.pieces, manifold.images, manifold.times, manifold.places, manifold.states, strict=True)
    rows = (
        ",".join([str(int(piece)), str(int(image)), *(repr(float(x)) for x in (time, place, *state))])
        for piece, image, time, place, state in columns
    )
    write_atomically(target.with_suffix(".csv"), ("\n".join([head, *rows]) + "\n").encode())
    return MANIFOLD.save(manifold, target)


def load_manifold(path: str | Path) -> Manifold:
    """The Manifold of a JSON file and the .npz beside it. Raises `InputError`."""
    return MANIFOLD.load(path)


@dataclass(frozen=True)
class ConnectionEnd:
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
    """A motion from an orbit to another (heteroclinic) or back to the same (homoclinic).

    `states` (m + 1 x d) are its crossings of the section, the first on the unstable manifold of `origin`, the last on
    the stable one of `goal`, `durations` (m, s) the times between; it is looked at at crossing number `chosen`:
    `angle` (rad) between the manifolds there and `error` of that point, in the state's own units. `component` is that
    of the plane.
    """

    __repr__ = brief("name", "kind", "state", "angle", "error", "certificate")
    _entries = ("kind", ...)

    name: str
    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    plane: str
    component: int
    axes: tuple[str, str]
    energy: Unknown
    states: np.ndarray
    durations: np.ndarray
    chosen: int
    angle: float
    error: Endless
    origin: ConnectionEnd
    goal: ConnectionEnd
    certificate: Certified = None
    times: Dense = field(default_factory=lambda: np.zeros(0))
    samples: Dense = field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def state(self) -> np.ndarray:
        """The point (d) where it is looked at."""
        return np.asarray(self.states[self.chosen])

    @property
    def kind(self) -> str:
        """homoclinic or heteroclinic."""
        same = self.origin.state.shape == self.goal.state.shape and np.array_equal(self.origin.state, self.goal.state)
        return "homoclinic" if same else "heteroclinic"

    def _check(self) -> None:
        check_axes(self)
        if self.states.ndim != 2 or not 0 <= self.chosen < len(self.states):
            raise ValueError(f"states: expected rows, number {self.chosen} among them, got shape {self.states.shape}")


CONNECTION = Codec(Connection, "connection", "`orbitfinder connect`", "make it again", alone=True)


def save_connection(connection: Connection, path: str | Path) -> Path:
    """Write a connection as JSON and its motion beside it in .npz; returns the JSON's path."""
    return CONNECTION.save(connection, path)


def free_file(folder: Path, connection: Connection) -> Path:
    """The connection-K.json of a folder that holds this connection, else the first K that is free.

    Raises `InputError` for a file that cannot be read.
    """
    files = (folder / f"connection-{k}.json" for k in count(1))
    return next(file for file in files if not file.exists() or _same(load_connection(file), connection))


def _same(first: Connection, second: Connection) -> bool:
    """Whether both are a single motion, looked at in the same way."""
    looked = [(plain(each.system), each.plane, each.axes) for each in (first, second)]
    near = 1e-9 * first.origin.extents  # however it was computed
    return looked[0] == looked[1] and bool((np.abs(first.state - second.state) <= near).all())


def load_connection(path: str | Path) -> Connection:
    """The Connection of a JSON file; its certificate as recorded. Raises `InputError`."""
    return CONNECTION.load(path)
