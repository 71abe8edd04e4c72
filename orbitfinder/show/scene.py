"""What moves, for everything that draws it: positions frame by frame, what is drawn through them, the ground, jumps.

Mechanisms are drawn with rods, springs, sliders, discs and the ground, as lines through their points.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as entry
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.mechanics.model import Model, positions
from orbitfinder.mechanics.scales import given_units, units
from orbitfinder.orbits.course import Course
from orbitfinder.records.reading import Entries, Table

Strokes = Sequence[tuple[str, tuple[int, ...]]]
Outline = Callable[[np.ndarray, float], np.ndarray]
COILS, WIDTH = 8, 0.018
"""Coils of a spring; half the width of springs, sliders and pivots over the extent of the picture"""
CIRCLE = np.array([function(np.linspace(0.0, 2 * np.pi, 40)) for function in (np.cos, np.sin)])


def _line(at: np.ndarray, half: float) -> np.ndarray:
    """A line through points (2 x k); a mass in one point as a circle."""
    return at if at.shape[1] > 1 else at + half * CIRCLE


def _disc(at: np.ndarray, _: float) -> np.ndarray:
    """A circle; with a second point of the rim, a quarter on, as it is seen in space."""
    centre, rim = at[:, :1], at[:, 1:] - at[:, :1]
    return np.asarray(centre + (rim @ CIRCLE if rim.shape[1] > 1 else np.linalg.norm(rim) * CIRCLE))


def _spring(at: np.ndarray, half: float) -> np.ndarray:
    """A zigzag between two points with a straight piece at either end."""
    begin, along = at[:, 0], at[:, 1] - at[:, 0]
    length = nonzero(float(np.linalg.norm(along)))
    across = np.array([-along[1], along[0]]) * (half / length)
    places = np.concatenate([[0.0], np.linspace(0.15, 0.85, 2 * COILS + 1), [1.0]])
    sides = np.concatenate([[0.0, 0.0], np.resize([1.0, -1.0], 2 * COILS - 1), [0.0, 0.0]])
    return np.asarray(begin[:, None] + along[:, None] * places + across[:, None] * sides)


@dataclass(frozen=True)
class Brush:
    """How a kind of stroke is drawn: its line through points (2 x k) by half the width of what is wide (m).

    `thick` in widths of a rod; `filled` or a line; `rigid` where its points keep their distances, `centred` where the
    first is the centre and the second on the rim, `boxed` where they are a box's centre and three sides; `pinned` where
    pins mark its points, `covered` where solids are drawn instead.
    """

    outline: Outline
    thick: float = 0.5
    filled: bool = False
    rigid: bool = False
    centred: bool = False
    boxed: bool = False
    pinned: bool = False
    covered: bool = False


BRUSHES = {
    "rod": Brush(_line, 1.0, rigid=True, pinned=True),
    "bone": Brush(_line, 1.0, rigid=True, pinned=True, covered=True),
    "solid": Brush(lambda at, _: at[:, :0], boxed=True),
    "spring": Brush(_spring),
    "disc": Brush(_disc, rigid=True, centred=True),
    "slider": Brush(
        lambda at, half: at + half * np.array([[-1, -1, 1, 1, -1], [-1.6, 1.6, 1.6, -1.6, -1.6]]),
        filled=True,
        covered=True,
    ),
    "ground": Brush(
        lambda at, half: at + half * np.array([[0, 1.5, 1.5, 0], [0, -1, 1, 0]]), filled=True, covered=True
    ),
}
"""Of every kind of stroke; a bone is the rod of what has a solid, which lines do not show"""


def outlines(points: np.ndarray, strokes: Strokes, size: float) -> list[tuple[str, np.ndarray]]:
    """The lines (2 x k each, with their kinds) of one configuration (2 x m); without strokes one line through all.

    `size` is the extent of the picture (m).
    """
    if not strokes:
        return [("rod", points)]
    lines = ((kind, BRUSHES[kind].outline(points[:, list(chosen)], WIDTH * size)) for kind, chosen in strokes)
    return [(kind, line) for kind, line in lines if line.size]


def tip(points: np.ndarray) -> int:
    """Which point of positions (k x 2 x m, nan between arcs) is the tip, whose path is drawn: the last that moves."""
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    seen = (high.max(axis=1) - low.min(axis=1)).max()
    moving = np.flatnonzero((high - low).max(axis=0) > 1e-9 * seen)  # the rest stands still
    return int(moving[-1]) if moving.size else -1


def evenly(count: int, most: int) -> list[int]:
    """At most `most` of the indices below `count`, both ends among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int)).tolist() if count else []


def equal_times(period: float, count: int) -> np.ndarray:
    """Times (s) over a period, the end left out."""
    return np.linspace(0.0, period, count, endpoint=False)


def box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (down, right) of positions (k x 2 x m)."""
    return points.min(axis=(0, 2)), points.max(axis=(0, 2))


def filled(points: np.ndarray, strokes: Strokes) -> np.ndarray:
    """Positions (k x 2 or 3 x m) and the corners of the boxes about solids."""
    signs, seen = np.stack(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, 8), [points]
    for first, *sides in (chosen for kind, chosen in strokes if BRUSHES[kind].boxed):
        seen.append(points[:, :, [first]] + (points[:, :, sides] - points[:, :, [first]]) @ signs)
    return np.concatenate(seen, axis=2)


def extent(points: np.ndarray) -> float:
    """The larger side of a box about positions (k x 2 x m)."""
    low, high = box(points)
    return max(float((high - low).max()), 1e-9)


@dataclass(frozen=True)
class Scene:
    """What moves: `points` (frames x 2 x m; x down and y right, m; in space x 3 x m, z to the eye) at equal times.

    Args:
        points: positions, the end of the period left out.
        strokes: what is drawn through which points; () is one line through all.
        ground: (frames x 2 x g, or one frame for all) what the machine stands on or hits.
        cuts: frames right after a jump, before which paths are broken.
        period: s that all frames last.
        loops: whether the first frame follows the last.
        drawn: what the points are, "mechanism", or "plane" where the system declares none.
        around: what else stands there, see `scenery`.
    """

    points: np.ndarray
    strokes: Strokes = entry(default=(), kw_only=True)
    ground: np.ndarray | None = entry(default=None, kw_only=True)
    cuts: tuple[int, ...] = entry(default=(), kw_only=True)
    period: float = entry(default=1.0, kw_only=True)
    loops: bool = entry(default=True, kw_only=True)
    drawn: str = entry(default="mechanism", kw_only=True)
    around: Table = entry(default_factory=dict, kw_only=True)


def cuts_of(course: Course, moments: np.ndarray) -> tuple[int, ...]:
    """The frames at moments (s, ascending) right after the events of a course, in every period that they are in."""
    rounds = range(int(np.floor(moments[-1] / course.period)) + 1)
    ends = [moment + (k - 1e-9) * course.period for k in rounds for moment, _ in course.events]  # less round-off
    return tuple(np.searchsorted(moments, ends).tolist())


def spatial(model: Model) -> bool:
    """Whether a system is drawn in space: it says where its points are there, or its state is a point there."""
    n = model.degrees_of_freedom
    count = n // 2 if model.rates is not None and model.hamiltonian else n
    return model.space is not None or (model.points is None and count == 3 and not model.angular.any())


def places(model: Model, states: np.ndarray) -> np.ndarray:
    """What of states (k x d) is drawn (k x 2 x j, down and right; in space k x 3 x j, with what is towards the eye):
    the points of a mechanism, or one in the plane or the space of the first coordinates, or of one and its rate."""
    if model.points is not None:
        return positions(model, states, "points" if model.space is None else "space")
    if spatial(model):
        return np.stack([-states[:, 2], states[:, 0], -states[:, 1]], axis=1)[:, :, None]
    return np.stack([-states[:, 1 % states.shape[1]], states[:, 0]], axis=1)[:, :, None]


def positions_at(model: Model, course: Course, moments: np.ndarray) -> np.ndarray:
    """The same at moments of a course, where its pieces have led."""
    flat = model.points is not None and model.space is None
    return course.positions(moments) if flat else places(model, course.states(moments))


def rounds_of(model: Model, course: Course, most: int) -> int:
    """After how many periods what is drawn is where it was to a hundredth of what it fills by then; of `most` that
    which comes nearest, where none does."""
    instants = equal_times(1.0, 12)
    seen = positions_at(model, course, course.period * (np.arange(most + 1)[:, None] + instants).ravel())
    rounds = seen.reshape(most + 1, -1)
    away = np.abs(rounds[1:] - rounds[0]).max(axis=1) / extent(seen)
    return int(np.argmax(away < 0.01) if (away < 0.01).any() else away.argmin()) + 1


def unlike(model: Model) -> bool:
    """Whether a plane has a quantity across and another up, each on its own scale: a coordinate and its rate, or
    states of a first-order system that are no places."""
    n = model.degrees_of_freedom
    places = n if model.rates is None else n // 2 if model.hamiltonian or model.landmarks else 0
    return model.points is None and not spatial(model) and places < 2 <= len(model.state_names)


def axis_words(name: str, system: Table) -> str:
    """A state's name with its unit where that is told."""
    unit = given_units(system).get(name, "")
    return f"{name}, {unit}" if unit else name


BODIES = {0.01215: (("Earth", 0.0166), ("Moon", 0.0045)), 9.537e-4: (("Sun", 0.0009), ("Jupiter", 0.0001))}
"""By the lighter body's share of the mass of two: what they are called, and their radii over their distance"""


def landmarks(model: Model) -> list[tuple[str, tuple[float, ...], float]]:
    """What a system marks: names as the sky has them where they are known, coordinates (n), radii (0 of no body)."""
    lighter = model.named_parameters.get("ratio", 0.0)
    known = next((called for share, called in BODIES.items() if abs(lighter - share) < 0.02 * share), ())
    called = dict(zip(("primary", "secondary"), known, strict=False))
    told = ((called.get(name, (name, 0.0)), place) for name, place in model.landmarks.items())
    return [(name, place, radius) for (name, radius), place in told]


def scenery(model: Model) -> Entries:
    """What stands about a motion: `marks` (name, place, radius of a body or 0), in space also its `axes` by name
    (directions, 3) and the `unit` of lengths."""
    n = len(model.state_names)

    def at(coordinates: Sequence[float] | np.ndarray) -> np.ndarray:
        return places(model, np.resize([*coordinates, *np.zeros(n)], (1, n)))[0, :, 0]

    own: Entries = {"marks": [[name, at(place).tolist(), radius] for name, place, radius in landmarks(model)]}
    if unlike(model):
        own["unlike"] = [axis_words(name, model.system) for name in model.state_names[:2]]
    if not spatial(model):
        return own if own["marks"] or "unlike" in own else {}
    single = model.points is None or (model.degrees_of_freedom == 3 and not model.angular.any() and not model.strokes)
    axes = [(name, at(step) - at(np.zeros(3))) for name, step in zip(model.state_names, np.eye(3), strict=False)]
    named = axes if single else zip("xyz", np.eye(3), strict=True)
    seen = dict(zip(["solids"], solids_of(model.system), strict=False))
    return own | {"axes": [[name, way.tolist()] for name, way in named], "unit": units(model.system)["length"]} | seen


def solids_of(system: Table) -> dict[str, list[list[Any]]]:
    """The shapes of a robot's bodies in the order of their strokes, see `shapes.described`, by a name of all that pages
    keep them by; {} where nothing is known of them."""
    drawn = system.get("drawn")
    table = drawn.get("solids") if isinstance(drawn, Mapping) else None
    solids = [*table.values()] if isinstance(table, Mapping) else []
    return {f"solids-{hashlib.sha256(repr(solids).encode()).hexdigest()[:16]}": solids} if solids else {}
