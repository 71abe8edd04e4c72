"""The motion of an orbit for the eye: states at equal times over one period, and positions of its points.

What is rigid is handed over as angles, so that the page rebuilds it without stretching it; the rest as positions.
Both are quantised to 16 bits and interpolated by the page; their number follows from the error of that interpolation.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import size_of
from orbitfinder.errors import FAILURES, IntegrationError
from orbitfinder.integrate.rk8 import march
from orbitfinder.loops.symmetry import NONE, named, symmetries_of
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model, altered, energies, vector_field
from orbitfinder.mechanics.scales import shared
from orbitfinder.orbits.certify import shown
from orbitfinder.orbits.course import Course, course, sampled
from orbitfinder.records.family import Event, FamilyPoint
from orbitfinder.records.orbit import Orbit, orbit_from_document, orbit_to_document
from orbitfinder.records.reading import Entries, Table
from orbitfinder.show.scene import (
    BRUSHES,
    Scene,
    Strokes,
    box,
    cuts_of,
    equal_times,
    extent,
    filled,
    places,
    positions_at,
    rounds_of,
    scenery,
    solids_of,
)

COUNTS = (24, 32, 40, 48, 60, 72, 84, 96, 120, 144, 180, 216, 264, 324, 400, 480, 640, 960)
"""Samples a period that are tried in turn."""
FIRST = 48
"""Samples from whose error the number needed is estimated."""
ENDS = 1e-7
"""Agreement of two step sizes that is enough for a picture."""
GAP, NEAR = 1e-2, 0.6
"""In extents of a motion: the largest jump between its pieces that is shown; how near stands what is in its picture"""
OFF, TURNS, TINY = 0.03, 3, 1e-5
"""How far from an orbit its neighbour starts, how many periods it is followed, and what is small, all relative."""
MOST_ROUNDS, MOST_SAMPLES = 40, 4000
"""Periods and samples of what comes back turned"""
RIGID = 1e-6
"""Change of a distance, relative to the extent of the picture, of what is called rigid."""


@dataclass(frozen=True)
class Filmed(Scene):
    """One period of what a model does, by its `course`, with the names and kinds of its n coordinates, n = d / 2 or d.

    Of what comes back turned there are as many `rounds` as lead to where it was, what drifts is seen from beside it;
    what does not loop starts again.
    """

    model: Any
    """the Model, or the names and kinds alone of one that no file describes"""
    course: Course
    skeleton: Skeleton | None = None
    """what of the points turns rigidly; nothing where the motion jumps"""
    rounds: int = 1
    """periods that the frames last"""
    drift: np.ndarray | None = None
    """how far all that is drawn goes in a period (m): taken from the points, which the page gives back"""

    @property
    def states(self) -> np.ndarray:
        """Its samples (k x d), the end among them."""
        return np.vstack([piece.states for piece in self.course.pieces])

    @property
    def names(self) -> tuple[str, ...]:
        """What the components of its states are called."""
        return tuple(self.model.state_names)

    @property
    def angles(self) -> tuple[bool, ...]:
        """Which coordinates are angles."""
        return tuple(self.model.angles) or (True,) * self.model.degrees_of_freedom

    @property
    def partners(self) -> list[int]:
        """The component that each coordinate is drawn against: its rate or momentum, in other first-order systems the
        next one."""
        n, size = len(self.angles), len(self.names)
        half = n // 2 if getattr(self.model, "hamiltonian", False) else 1
        return [(k + (n if n < size else half)) % size for k in range(n)]

    def at(self, count: int, endpoint: bool = False) -> np.ndarray:
        """States at `count` equal times over the period."""
        states = self.course.states(np.linspace(0.0, self.period, count, endpoint=endpoint))
        if endpoint:
            states[-1] = self.course.pieces[-1].states[-1]  # before the event
        return states

    @property
    def energies(self) -> np.ndarray | None:
        """Kinetic and potential energy (2 x k) at equal times over a period, where a mechanical one is conserved."""
        if self.course.jumps or self.model.rates is not None or not self.model.conservative:
            return None
        return np.asarray(energies(self.model, self.at(121, endpoint=True)))


class Simulator:
    """Motions of orbits; models and their equations are built once per system and parameters."""

    def __init__(self, model_of: Callable[[Table], Model] = build_model) -> None:
        self._model_of = model_of
        self._known: dict[str, tuple[Model, Any] | None] = {}
        self.solids: dict[str, list[list[Any]]] = {}
        """shapes of bodies by their names in what is packed"""

    def model(self, system: Table, free: tuple[str, ...] = ()) -> tuple[Model, Any] | None:
        """The Model of a description and its field f(t, x, s, free), or None where no file describes it."""
        key = repr((sorted(system.items()), free))
        if key not in self._known:
            try:
                model = self._model_of(system)
                names = [name for name in free if name in model.parameter_names]
                self._known[key] = model, vector_field(model, names)
                self.solids |= solids_of(system)
            except FAILURES:
                self._known[key] = None
        return self._known[key]

    def known(self, system: Table) -> Model | None:
        """The Model of a description, None where no file describes it."""
        known = self.model(system)
        return known and known[0]

    def orbit(self, document: Table, dense: tuple[np.ndarray, np.ndarray] | None = None) -> Filmed | None:
        """The motion of an orbit document from its nodes, or from dense samples where its system is unknown."""
        known, period = self.model(document["system"]), float(document["period"])
        if known is None:
            return None if dense is None else _motion(_without_model(dense[1]), *dense, returns=True)
        model, field = known
        if document.get("control"):  # its Model alone moves otherwise
            dense = dense or shown(orbit_from_document(document), model)
        if not model.smooth:
            return _jumping(model, np.asarray(document["state"], float), period, dense)
        nodes = np.asarray(document.get("nodes") or [document["state"]], float)
        if nodes.ndim != 2 or nodes.shape[1] != len(model.state_names):
            return None
        path = None if document.get("control") else _pieces(field, nodes, np.linspace(0.0, period, len(nodes) + 1))
        path = path or dense
        if path is None or not _closes(path[1], model):
            return None
        return _motion(model, *path)

    def of(self, orbit: Orbit) -> Filmed | None:
        """The motion of an orbit in memory."""
        dense = (orbit.times, orbit.samples) if len(orbit.samples) > 1 else None
        return self.orbit(orbit_to_document(orbit), dense)

    def neighbour(self, document: Table, motion: Filmed) -> Filmed | None:
        """What starts OFF (of the extent of the motion) from an orbit and is left alone for TURNS periods.

        It starts where small differences grow most: a difference is sent round twice and made small again.
        """
        known, period = self.model(document["system"]), motion.period
        alone = known is not None and not (known[0].forced or document.get("control"))
        if known is None or not alone or motion.course.jumps or not motion.loops:
            return None
        model, field = known
        state, sizes = motion.states[0], np.ptp(motion.states, axis=0)
        scales = np.maximum(sizes, 1e-3 * sizes.max())
        away = scales * np.cos(1.0 + np.arange(state.size))
        for _ in range(2):
            away *= TINY / size_of(away / scales)
            path = _path(field, state + away, period)
            if path is None:
                return None
            away = path[-1] - path[0] + away
        path = _path(field, state + away * (OFF / size_of(away / scales)), TURNS * period)
        if path is None or np.abs(path[:, state.size // 2 :]).max() > 1e3 * np.abs(motion.states).max():
            return None
        return _motion(model, np.linspace(0.0, TURNS * period, len(path)), path, returns=False)

    def conserves(self, system: Table, orbit: Table | None = None) -> bool:
        """Whether an energy is conserved, by an `orbit` of it, True where nothing is known of the system."""
        known = self.model(system)
        return (known is None or known[0].conservative) and not (orbit or {}).get("control")

    def member(self, system: Table, member: FamilyPoint | Event) -> Filmed | None:
        """The motion of a point or event of a family from its nodes (or its state), completed by its symmetry.

        `system` is the family's: its equations are built once, with what varies along it as their argument.
        """
        known, period = self.model(system, tuple(member.free)), member.period
        if known is None or len(member.state) != len(known[0].state_names):
            return None
        model, field = known
        free = {name: float(value) for name, value in member.free.items() if name in model.parameter_names}
        if not model.smooth:
            return _jumping(with_parameters(model, free), member.state, period, None)
        symmetry = symmetries_of(model).get(member.symmetry)
        if symmetry is None:
            return None
        nodes, edges = member.state[None], np.array([0.0, symmetry.fraction])
        if member.shooting_nodes.size:
            nodes, edges = member.shooting_nodes, member.mesh[:: (member.mesh.size - 1) // len(member.shooting_nodes)]
        path = _pieces(field, nodes, edges * period, np.array([*free.values()]))
        angles = np.array(model.angles or (True,) * model.degrees_of_freedom)
        if path is None or not symmetry.closes(path[1], angles) <= GAP:
            return None
        numbers = [free.get(name, value) for name, value in model.named_parameters.items()]
        return _motion(altered(model, parameter_values=np.array(numbers)), *symmetry.whole(*path))


def _path(
    field: Any, state: np.ndarray, duration: float, start: float = 0.0, free: np.ndarray | None = None
) -> np.ndarray | None:
    """States at equal times, at the values of the field's free parameters: steps are halved until the
    end moves by less than ENDS.

    Where it never does, because the motion amplifies round-off, those of the smallest steps; whether these are
    good enough shows where the pieces join. None when the motion cannot be integrated.
    """
    states = before = None
    for steps in (12 * 2**k for k in range(9)):
        try:
            states = march(field, state, duration, steps, np.zeros(0) if free is None else free, start)
        except IntegrationError:
            states = before = None
            continue
        if before is not None and np.abs(states[-1] - before).max() <= ENDS * max(1.0, np.abs(states[-1]).max()):
            return np.asarray(states)
        before = states[-1]
    return None if states is None else np.asarray(states)


def _pieces(
    field: Any, nodes: np.ndarray, edges: np.ndarray, free: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray] | None:
    """Times and states from the first of the `edges` (N + 1 times, s) to the last.

    Each segment starts at its own node, so that instability does not show.
    """
    times, states = [edges[:1]], [nodes[:1]]
    for k, node in enumerate(nodes):
        path = _path(field, node, edges[k + 1] - edges[k], edges[k], free)
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
    if model.rates is None and np.abs(states[-1] - states[0])[n:].max() <= GAP * ENDS * np.abs(states[:, n:]).max():
        return True  # also of a motion at constant rates, which has no extent
    return named(NONE.name, model).closes(states, np.ones(n, bool) if model.rates is None else model.angular) <= GAP


def _jumping(
    model: Model, state: np.ndarray, period: float, dense: tuple[np.ndarray, np.ndarray] | None
) -> Filmed | None:
    """The motion of a hybrid orbit from its samples or its state, by pieces; None where it goes another way."""
    try:
        path = course(model, *(dense or sampled(model, state, period)))
    except FAILURES:
        return None
    moments = equal_times(path.period, 240)  # between the events among them the page interpolates
    return _filmed(model, path, positions_at(model, path, moments), ground=_standing(path, moments),
                   cuts=cuts_of(path, moments))  # fmt: skip


def _motion(model: Any, times: np.ndarray, states: np.ndarray, returns: bool | None = None) -> Filmed:
    """A smooth motion that `returns` or does not, or is asked whether it does, at as few times as a page needs."""
    path = course(model, times, states)

    def seen(count: int, rounds: int = 1) -> np.ndarray:
        return positions_at(model, path, equal_times(rounds * path.period, count))

    gap = places(model, states[-1:]) - places(model, states[:1])
    drifts = returns is False or bool(returns is None and np.abs(gap).max() > GAP * extent(seen(FIRST)))
    if not drifts or returns is False:
        points, bones = _fewest(seen, model.strokes, drifts)
        return _filmed(model, path, points, skeleton=bones, loops=not drifts)
    step, size = gap[0].mean(axis=1), extent(seen(FIRST))
    if np.abs(positions_at(model, path, path.period + equal_times(path.period, FIRST)) - seen(FIRST)
              - step[:, None]).max() < GAP * size:  # all of it goes along  # fmt: skip
        points, bones = _fewest(lambda count: seen(count) - step[:, None] * equal_times(1.0, count)[:, None, None],
                                model.strokes)  # fmt: skip
        return _filmed(model, path, points, skeleton=bones, drift=step)
    count = len(_fewest(seen, model.strokes, drifts)[0])
    rounds = rounds_of(model, path, min(MOST_ROUNDS, MOST_SAMPLES // count))
    points = seen(rounds * count, rounds)
    return _filmed(model, path, points, skeleton=skeleton(points, model.strokes), rounds=rounds)


def _filmed(model: Any, path: Course, points: np.ndarray, **more: Any) -> Filmed:
    drawn = "plane" if model.points is None else "mechanism"
    about = scenery(model) if isinstance(model, Model) else {}
    return Filmed(points, model, path, strokes=model.strokes, period=path.period, drawn=drawn, around=about, **more)


def _without_model(states: np.ndarray) -> Any:
    """The names and kinds of coordinates and rates (k x 2n) of a system that no file describes."""
    n = states.shape[1] // 2
    names = tuple(f"q{i + 1}{rate}" for rate in ("", "dot") for i in range(n))
    return SimpleNamespace(state_names=names, degrees_of_freedom=n, angles=(False,) * n, angular=np.ones(n, bool),
                           points=None, space=None, strokes=(), hybrid=None, smooth=True, cycle=(), arcs=(), rates=None,
                           conservative=False)  # fmt: skip


def recorded(model: Model, states: np.ndarray, duration: float) -> Scene:
    """What was simulated (k x d states at equal times over a duration, s), as it is: nothing returns."""
    drawn = "plane" if model.points is None else "mechanism"
    return Scene(places(model, states), strokes=model.strokes, period=max(duration, 1e-9), drawn=drawn,
                 loops=False, around=scenery(model))  # fmt: skip


def jumping(model: Model, path: Course, count: int) -> Scene:
    """What was simulated of a hybrid Model, arc by arc, at `count` times: nothing returns."""
    moments = equal_times(path.period, count)
    return replace(recorded(model, path.states(moments), path.period), points=positions_at(model, path, moments),
                   ground=_standing(path, moments), cuts=cuts_of(path, moments))  # fmt: skip


def _standing(path: Course, moments: np.ndarray) -> np.ndarray | None:
    """What a machine stands on at moments, once where it does not move."""
    ground = path.grounds(moments)
    return ground[:1] if ground is not None and (path.walks or np.ptp(ground, axis=0).max() == 0) else ground


@dataclass(frozen=True)
class Skeleton:
    """What of m points turns rigidly: `rods` are (point, parent, length in m), each parent before its point.

    Its channels are x of all points, then y (in space then z), then the angle of every point about its parent, those of
    rods alone instead of x and y. Angles run on over whole turns.
    """

    many: int
    rods: tuple[tuple[int, int, float], ...] = ()

    def channels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (k x 3 m) of all channels of positions (k x 2 x m) over a period, and what they grow by in one."""
        angles, turns = np.zeros((len(points), self.many)), np.zeros((points.shape[1] + 1) * self.many)
        for point, parent, length in self.rods:
            down, right = (points[:, :, point] - points[:, :, parent]).T
            turned = np.unwrap(np.arctan2(right, down)) if length else np.zeros(len(points))
            angles[:, point] = turned
            on = (turned[0] - turned[-1] + np.pi) % (2 * np.pi) - np.pi  # from the last on to the first, the short way
            turns[2 * self.many + point] = 2 * np.pi * np.rint((turned[-1] - turned[0] + on) / (2 * np.pi))
        return np.hstack([points.reshape(len(points), -1), angles]), turns

    def places(self, values: np.ndarray) -> np.ndarray:
        """Positions (k x 2 x m) of channels (k x 3 m)."""
        points = values[:, : -self.many].reshape(len(values), -1, self.many).copy()
        for point, parent, length in self.rods:
            angle = values[:, 2 * self.many + point]
            points[:, :, point] = points[:, :, parent] + length * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return points


def skeleton(points: np.ndarray, strokes: Strokes) -> Skeleton:
    """What is rigid among positions (k x 2 x m): a point and the one before it in a line, or one that it lies on."""
    many, size = points.shape[2], extent(points)
    if points.shape[1] > 2:
        return Skeleton(many)
    near: dict[int, list[int]] = {k: [k - 1] if k and not strokes else [] for k in range(many)}
    for kind, line in strokes:
        for first, second in pairwise(line if BRUSHES[kind].rigid else ()):
            near[max(first, second)].append(min(first, second))
    rods = []
    for k in range(1, many):
        if np.ptp(points[:, :, k], axis=0).max() <= RIGID * size:
            continue
        apart = np.linalg.norm(points[:, :, :k] - points[:, :, k : k + 1], axis=1)
        same = np.flatnonzero(apart.max(axis=0) <= RIGID * size).tolist()
        parents = [*same, *(j for j in near[k] if np.ptp(apart[:, j]) <= RIGID * size)]
        if parents:
            rods.append((k, int(parents[0]), 0.0 if same else float(apart[:, parents[0]].mean())))
    return Skeleton(many, tuple(rods))


def _fewest(seen: Any, strokes: Strokes = (), drifts: bool = False) -> tuple[np.ndarray, Skeleton]:
    """Positions at the fewest equal times whose interpolation is good enough, at most the largest of COUNTS.

    What drifts does not come back to where it was, so that nothing is interpolated from its end to its start.
    """
    first, allowed = seen(2 * FIRST), 0.003  # of the extent
    bones = skeleton(first, strokes)
    wanted = 0.9 * FIRST * (_between(first, bones, drifts)[1] / allowed) ** 0.25  # the error is of fourth order
    least = COUNTS[0] if not drifts else FIRST
    for count in (*(most for most in COUNTS[:-1] if most >= max(wanted, least)), COUNTS[-1]):
        coarse, error = _between(seen(2 * count), bones, drifts)
        if error <= allowed:
            break
    return coarse, bones


def _between(fine: np.ndarray, bones: Skeleton, drifts: bool) -> tuple[np.ndarray, float]:
    """Every other of some positions, and how far interpolation between these misses the rest, over the extent."""
    coarse, between = fine[::2], fine[1::2]
    values, turns = bones.channels(coarse)
    round_ = np.vstack([values[-1:] - turns, values, values[:2] + turns])
    guessed = bones.places(_half_way(round_))
    missed = np.abs(guessed - between)[1 if drifts else 0 : -2 if drifts else None]
    return np.asarray(coarse), float(missed.max()) / extent(coarse)


def _half_way(samples: np.ndarray) -> np.ndarray:
    """Catmull-Rom half way between samples (k), but for the first and the last, as in assets/core.js."""
    return np.asarray((9 * (samples[1:-2] + samples[2:-1]) - samples[:-3] - samples[3:]) / 16)


def _short(number: float) -> float:
    """A number as exact as the page's, which are of 32 bits."""
    return float(f"{number:.8g}")


def framed(items: Sequence[Table]) -> dict[str, list[float]] | None:
    """Centre and spans (down, right, m) of what the packed motions of several items cover together."""
    if not (shown := [item["motion"] for item in items if item["motion"]]):
        return None
    centres, spans = (np.array([motion[name] for motion in shown]) for name in ("centre", "spans"))
    low, high = (centres - spans / 2).min(axis=0), (centres + spans / 2).max(axis=0)
    return {"centre": ((low + high) / 2).tolist(), "spans": (high - low).tolist()}


def _window(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest x and y of what is drawn: points, discs about some of them, the boxes of solids."""
    seen = [filled(scene.points, scene.strokes)]
    for centre, rim, *_ in (line for kind, line in scene.strokes if BRUSHES[kind].centred):
        middle = scene.points[:, :, [centre]]
        radius = np.linalg.norm(scene.points[:, :, [rim]] - middle, axis=1, keepdims=True)
        seen += [middle - radius, middle + radius]
    low, high = box(np.concatenate(seen, axis=2))
    middle, reach = (low + high) / 2, (high - low) / 2 + NEAR * extent(scene.points)
    marks = [np.array(place) for _, place, _ in scene.around.get("marks", ())]
    near = [at for at in marks if np.all(np.abs(at - middle) < reach)]
    return np.min([low, *near], axis=0), np.max([high, *near], axis=0)


def base64_of(numbers: np.ndarray, kind: str = "<f4") -> str:
    """Numbers for the page: little-endian, 32 bits each unless another `kind` is asked for, in base64."""
    return base64.b64encode(numbers.astype(kind).tobytes()).decode()


def packed(scene: Scene) -> Entries:
    """Channels for the page: int16 little-endian in base64, channel by channel; still channels as numbers.

    Of m points channel c is x of point c for c < m, y of point c - m below 2 m, in space z below 3 m, and then the
    angle of each point about its parent; a position is centre + half * int / 32767, an angle middle + swing * int /
    32767.
    """
    dims, many = scene.points.shape[1:]
    first, film = dims * many, scene if isinstance(scene, Filmed) else None
    bones = (film.skeleton if film else None) or Skeleton(many)
    values, turns = bones.channels(scene.points)
    turns *= scene.loops
    low, high = _window(scene)
    centre, half = (low + high) / 2, max(float((high - low).max()) / 2, 1e-12)
    about = {point: (parent, length) for point, parent, length in bones.rods}
    placed = [c for c in range(first) if c % many not in about]
    turning = [first + point for point, (_, length) in about.items() if length]
    middles = (values.min(axis=0) + values.max(axis=0)) / 2
    middles[:first] = np.repeat(centre, many)
    swing = max(1e-12, *(float(np.ptp(values[:, c])) / 2 for c in turning)) if turning else 1.0
    moving = [c for c in placed if np.ptp(values[:, c]) > half / 32767] + turning
    sizes = np.where(np.arange(first + many) < first, half, swing)
    numbers = np.rint((values - middles) / sizes * 32767).T[moving]
    rods = [
        [point, parent, *(_short(x) for x in (length, middles[first + point], turns[first + point]))]
        for point, (parent, length) in about.items()
    ]
    more: Entries = {"jumps": _jumps(scene.cuts)} if scene.cuts else {}
    if not scene.loops:
        more = {"jumps": _jumps((*scene.cuts, len(scene.points)))}
    if scene.ground is not None:
        more["ground"] = [[[float(f"{x:.6g}") for x in row] for row in line] for line in scene.ground.tolist()]
    if film and film.rounds > 1:
        more["rounds"] = film.rounds
    if film and film.drift is not None:
        more["drift"] = [_short(x) for x in film.drift]
    if rods:
        more |= {"rods": rods, "swing": swing}
    if scene.strokes:
        more["strokes"] = [[kind, list(chosen)] for kind, chosen in scene.strokes]
    if scene.around:
        more["around"] = scene.around
    return more | {
        "dims": dims,
        "count": len(scene.points),
        "points": many,
        "period": scene.period,
        "centre": [_short(x) for x in centre],
        "half": half,
        "spans": [_short(x) for x in high - low],
        "moving": moving,
        "still": {str(c): float(round(values[0, c], 9)) for c in placed if c not in moving},
        "data": base64_of(numbers, "<i2"),
        "drawn": scene.drawn,
    }


def _jumps(cuts: Sequence[int]) -> list[int]:
    """The samples after which a motion jumps."""
    return sorted({cut - 1 for cut in cuts})


def histories(motion: Filmed) -> Entries:
    """States at equal times, end included, as little-endian float32 in base64, component by component.

    As many samples as the page's curves through them need to be good to 0.4 % of the extent, at most 960. Of a
    hybrid motion `jumps` are the samples after which it jumps; after the last, where nothing turns, to the first.
    """
    sizes = np.ptp(motion.states, axis=0)
    # a component that stands still must not have its round-off sampled
    sizes = np.maximum(sizes, 1e-3 * shared(sizes, np.asarray(motion.angles, bool)) + 1e-12)
    smooth = 0.004
    for count in (960,) if motion.course.jumps else (240, 360, 480, 960):
        states = motion.at(2 * count + 1, endpoint=True)
        turned = states[-1] - states[0]  # whole turns of running orbits
        inner = np.vstack([states[-3] - turned, states[::2], states[2] + turned])
        if np.all(np.abs(_half_way(inner) - states[1::2]).max(axis=0) <= smooth * sizes):
            break
    data = base64_of(states[::2].T)
    if not motion.course.jumps:
        return {"count": count + 1, "data": data}
    cuts = cuts_of(motion.course, equal_times(motion.period, count))
    jumps = [*_jumps(cuts)[:-1], *([] if motion.course.turned.any() else [count])]
    return {"count": count + 1, "data": data, "jumps": jumps}
