"""The motion of an orbit for the eye: states at equal times over one period, and positions of its points.

Positions are quantised to 16 bits and interpolated by the page; their number follows from the error of
that interpolation (half a per cent of the picture, about one pixel of a gallery card).
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder.errors import IntegrationError, OrbitfinderError
from orbitfinder.integrate.rk8 import march
from orbitfinder.loops.symmetry import NONE, named, symmetries_of
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model, positions, vector_field
from orbitfinder.orbits.closure import alone, between
from orbitfinder.orbits.course import Course, course, sampled
from orbitfinder.records.family import Event, FamilyPoint

COUNTS = (24, 32, 40, 48, 60, 72, 84, 96, 120, 144, 180, 216, 264, 324, 400, 480)
"""Samples a period that are tried in turn."""
FIRST = 48
"""Samples from whose error the number needed is estimated."""
INTERPOLATION = 0.005
"""Largest error of the page's interpolation, relative to the extent of the picture."""
STEPS = (12, 24, 48, 96, 192, 384, 768, 1536, 3072)
ENDS = 1e-7
"""Agreement of two step sizes that is enough for a picture."""
GAP = 1e-2
"""Largest jump between pieces of a motion that is still shown, relative to its extent."""
JUMPING = 240
"""Samples of a hybrid period, between whose events the page interpolates."""
SMOOTH = 0.004
LEVELS = 32767


@dataclass(frozen=True)
class Motion:
    """One period: `states` (k+1 x d) at `times` (s), with the names and kinds of the n coordinates, n = d / 2 or d.

    `points` (m x 2 x j, x down and y right, m) are at m equal times, the end left out; `drawn` says
    what they are: "mechanism", or "plane" where the system declares no points.
    """

    period: float
    times: np.ndarray
    states: np.ndarray
    names: tuple[str, ...]
    angles: tuple[bool, ...]
    points: np.ndarray
    drawn: str
    course: Course | None = None
    """of a hybrid orbit, whose motion jumps"""
    strokes: tuple[tuple[str, tuple[int, ...]], ...] = ()
    """what is drawn through which points; () is one line through all"""

    @property
    def partners(self) -> list[int]:
        """The component that each coordinate is drawn against: its rate, in a first-order system the next one."""
        n, size = len(self.angles), len(self.names)
        return [(k + (n if n < size else 1)) % size for k in range(n)]

    def at(self, count: int, endpoint: bool = False) -> np.ndarray:
        """States at `count` equal times over the period."""
        if self.course is not None:
            states = self.course.states(np.linspace(0.0, self.period, count, endpoint=endpoint))
            if endpoint:
                states[-1] = self.course.pieces[-1].states[-1]  # before the event
            return states
        return resampled(self.times, self.states, self.period, count, len(self.angles), endpoint)


def resampled(
    times: np.ndarray, states: np.ndarray, period: float, count: int, n: int, endpoint: bool = False
) -> np.ndarray:
    """States at `count` equal times: the first n of their components are coordinates (see `between`)."""
    return between(times, states, n, np.linspace(0.0, period, count, endpoint=endpoint))


class Simulator:
    """Motions of orbits; models and their equations are built once per system and parameters."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[Model, Any] | None] = {}

    def model(self, system: Mapping[str, Any]) -> tuple[Model, Any] | None:
        """The Model of a description and its field f(t, x, s, p), or None where no file describes it."""
        key = repr(sorted(system.items()))
        if key not in self._known:
            try:
                built = build_model(system)
                self._known[key] = (built, vector_field(built, (), ()))
            except OrbitfinderError:
                self._known[key] = None
        return self._known[key]

    def orbit(self, document: Mapping[str, Any], dense: tuple[np.ndarray, np.ndarray] | None = None) -> Motion | None:
        """The motion of an orbit document from its nodes, or from dense samples where its system is unknown."""
        found, period = self.model(document["system"]), float(document["period"])
        if found is None:
            return None if dense is None else _without_model(document, *dense)
        model, field = found
        if model.hybrid is not None:
            return _jumping(model, np.asarray(document["state"], float), period, dense)
        nodes = np.asarray(document.get("nodes") or [document["state"]], float)
        if nodes.ndim != 2 or nodes.shape[1] != len(model.state_names):
            return None
        path = _pieces(field, nodes, np.linspace(0.0, period, len(nodes) + 1)) or dense
        if path is None or not _closes(path[1], model):
            return None
        return _motion(model, *path, period)

    def member(self, system: Mapping[str, Any], one: FamilyPoint | Event) -> Motion | None:
        """The motion of a point or event of a family from its nodes (or its state), completed by its symmetry."""
        found, period = self.model(system), one.period
        if found is None or len(one.state) != len(found[0].state_names):
            return None
        model, field = found
        if model.hybrid is not None:
            return _jumping(model, one.state, period, None)
        symmetry = symmetries_of(model).get(one.symmetry)
        if symmetry is None:
            return None
        nodes, edges = one.state[None], np.array([0.0, symmetry.fraction])
        if one.shooting_nodes.size:
            nodes, edges = one.shooting_nodes, one.mesh[:: (one.mesh.size - 1) // len(one.shooting_nodes)]
        path = _pieces(field, nodes, edges * period)
        angles = np.array(model.angles or (True,) * model.degrees_of_freedom)
        if path is None or not symmetry.closes(path[1], angles) <= GAP:
            return None
        return _motion(model, *symmetry.whole(*path), period)


def _path(field: Any, state: np.ndarray, duration: float, start: float = 0.0) -> np.ndarray | None:
    """States at equal times: steps are halved until the end moves by less than ENDS.

    Where it never does, because the motion amplifies round-off, those of the smallest steps; whether these are
    good enough shows where the pieces join. None when the motion cannot be integrated.
    """
    states = before = None
    for steps in STEPS:
        try:
            states = march(field, state, duration, steps, np.zeros(0), start)
        except IntegrationError:
            states = before = None
            continue
        if before is not None and np.abs(states[-1] - before).max() <= ENDS * max(1.0, np.abs(states[-1]).max()):
            return np.asarray(states)
        before = states[-1]
    return None if states is None else np.asarray(states)


def _pieces(field: Any, nodes: np.ndarray, edges: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Times and states from the first of the `edges` (N + 1 times, s) to the last.

    Each segment starts at its own node, so that instability does not show.
    """
    times, states = [edges[:1]], [nodes[:1]]
    for k, node in enumerate(nodes):
        path = _path(field, node, edges[k + 1] - edges[k], edges[k])
        if path is None:
            return None
        times.append(np.linspace(edges[k], edges[k + 1], len(path))[1:])
        states.append(path[1:])
        if k + 1 < len(nodes):
            states[-1][-1] = nodes[k + 1]
    return np.concatenate(times), np.vstack(states)


def _closes(states: np.ndarray, model: Model) -> bool:
    """True when the velocities return; the coordinates may have turned by whole turns."""
    n = model.degrees_of_freedom
    return named(NONE.name, model).closes(states, np.ones(n, bool) if model.rates is None else model.angular) <= GAP


def _jumping(
    model: Model, state: np.ndarray, period: float, dense: tuple[np.ndarray, np.ndarray] | None
) -> Motion | None:
    """The motion of a hybrid orbit from its samples or its state, by pieces; None where it goes another way."""
    try:
        times, states = dense or sampled(model, state, period)
        path = course(model, times, states)
    except OrbitfinderError:
        return None
    n, moments = model.degrees_of_freedom, np.arange(JUMPING) * period / JUMPING
    shown = path.positions(moments) if model.points is not None else _plane(path.states(moments), n)
    drawn = "mechanism" if model.points is not None else "plane"
    return Motion(
        period, times, states, model.state_names, model.angles or (True,) * n, shown, drawn, path, model.strokes
    )


def _motion(model: Model, times: np.ndarray, states: np.ndarray, period: float) -> Motion:
    n = model.degrees_of_freedom
    angles = model.angles or (True,) * n

    def seen(count: int) -> np.ndarray:
        chosen = resampled(times, states, period, count, n)
        return positions(model, chosen) if model.points is not None else _plane(chosen, n)

    drawn = "mechanism" if model.points is not None else "plane"
    return Motion(period, times, states, model.state_names, angles, _fewest(seen), drawn, strokes=model.strokes)


def _without_model(document: Mapping[str, Any], times: np.ndarray, states: np.ndarray) -> Motion:
    n = states.shape[1] // 2
    names = tuple(f"q{i + 1}" for i in range(n)) + tuple(f"q{i + 1}dot" for i in range(n))
    period = float(document["period"])
    points = _fewest(lambda count: _plane(resampled(times, states, period, count, n), n))
    return Motion(period, times, states, names, (False,) * n, points, "plane")


def _plane(states: np.ndarray, n: int) -> np.ndarray:
    """One point in a plane for systems without a picture: the first two coordinates, or one and its rate."""
    second = states[:, min(1, states.shape[1] - 1)] if n > 1 else states[:, n % states.shape[1]]
    return np.stack([-second, states[:, 0]], axis=1)[:, :, None]


def _fewest(seen: Any) -> np.ndarray:
    """Positions at the fewest equal times whose interpolation is good enough, at most the largest of COUNTS."""
    wanted = 0.9 * FIRST * (_between(seen(2 * FIRST))[1] / INTERPOLATION) ** 0.25  # the error is of fourth order
    for count in (*(one for one in COUNTS[:-1] if one >= wanted), COUNTS[-1]):
        coarse, error = _between(seen(2 * count))
        if error <= INTERPOLATION:
            break
    return coarse


def _between(fine: np.ndarray) -> tuple[np.ndarray, float]:
    """Every other of some positions, and how far interpolation between these misses the rest, over the extent."""
    coarse, between = fine[::2], fine[1::2]
    # Catmull-Rom half way between samples, as in assets/core.js
    guessed = (9 * (coarse + np.roll(coarse, -1, 0)) - np.roll(coarse, 1, 0) - np.roll(coarse, -2, 0)) / 16
    extent = max(float(np.ptp(coarse, axis=(0, 2)).max()), 1e-12)
    return np.asarray(coarse), float(np.abs(guessed - between).max()) / extent


def packed(motion: Motion) -> dict[str, Any]:
    """Positions for the page: int16 little-endian in base64, channel by channel; still channels as numbers.

    Channel c is x of point c for c < j, and y of point c - j after that; a value is centre + half * int / 32767.
    """
    count, _, many = motion.points.shape
    channels = motion.points.reshape(count, 2 * many).T
    low, high = motion.points.min(axis=(0, 2)), motion.points.max(axis=(0, 2))
    centre, half = (low + high) / 2, max(float((high - low).max()) / 2, 1e-12)
    moving = [c for c in range(2 * many) if np.ptp(channels[c]) > 1e-9 * half]
    middle = np.repeat(centre, many)
    numbers = np.rint((channels - middle[:, None]) / half * LEVELS)
    still = {str(c): float(round(channels[c, 0], 9)) for c in range(2 * many) if c not in moving}
    strokes = {"strokes": [[kind, list(chosen)] for kind, chosen in motion.strokes]} if motion.strokes else {}
    return (
        _landscape(motion)
        | strokes
        | {
            "count": count,
            "points": many,
            "period": motion.period,
            "centre": [float(x) for x in centre],
            "half": half,
            "moving": moving,
            "still": still,
            "data": base64.b64encode(numbers[moving].astype("<i2").tobytes()).decode(),
            "drawn": motion.drawn,
        }
    )


def _landscape(motion: Motion) -> dict[str, Any]:
    """Of a hybrid orbit: the samples after which the motion jumps, and the ground, one polyline or one a sample."""
    if motion.course is None:
        return {}
    count = len(motion.points)
    jumps, lines = _jumps(motion, count), motion.course.grounds(np.arange(count) * (motion.period / count))
    if lines is None:
        return {"jumps": jumps}
    if motion.course.walks or np.ptp(lines, axis=0).max() == 0:
        lines = lines[:1]
    return {"jumps": jumps, "ground": [[[float(f"{x:.6g}") for x in row] for row in line] for line in lines.tolist()]}


def _jumps(motion: Motion, count: int) -> list[int]:
    """The numbers of the samples, so many a period, after which the motion jumps."""
    events = () if motion.course is None else motion.course.events
    return sorted({min(int(np.ceil(at * count / motion.period - 1e-6)), count) - 1 for at, _ in events})


def histories(motion: Motion) -> dict[str, Any]:
    """States at equal times, end included, as little-endian float32 in base64, component by component.

    As many samples as the page's curves through them need to be good to SMOOTH of the extent, at most 960. Of a
    hybrid motion `jumps` are the samples after which it jumps; after the last, where nothing turns, to the first.
    """
    n, size = len(motion.angles), motion.states.shape[1]
    extent = np.ptp(motion.states, axis=0)
    # a component that stands still must not have its round-off sampled
    if n < size:
        among = np.repeat([extent[:n].max(), extent[n:].max()], n)
    else:
        among = alone(extent, np.asarray(motion.angles, bool))
    extent = np.maximum(extent, 1e-3 * among + 1e-12)
    for count in (240, 360, 480, 960) if motion.course is None else (960,):
        states = motion.at(2 * count + 1, endpoint=True)
        turned = states[-1] - states[0]  # whole turns of running orbits
        inner = np.vstack([states[-3] - turned, states[::2], states[2] + turned])
        curved = (9 * (inner[1:-2] + inner[2:-1]) - inner[:-3] - inner[3:]) / 16
        if np.all(np.abs(curved - states[1::2]).max(axis=0) <= SMOOTH * extent):
            break
    data = base64.b64encode(states[::2].T.astype("<f4").tobytes()).decode()
    if motion.course is None:
        return {"count": count + 1, "data": data}
    jumps = [*_jumps(motion, count)[:-1], *([] if motion.course.turned.any() else [count])]
    return {"count": count + 1, "data": data, "jumps": jumps}
