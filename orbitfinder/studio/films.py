"""What the stage of the studio shows: poses and motions as the players of pages take them."""

from __future__ import annotations

import numpy as np

from orbitfinder.mechanics.kind import system_kind
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.pose import movable
from orbitfinder.records.reading import Entries
from orbitfinder.show.scene import box, places
from orbitfinder.site.motion import packed, recorded

ROOM = 1.15
"""How much larger than what is in it the stage is"""


def film(model: Model, times: np.ndarray, states: np.ndarray) -> Entries:
    """A simulated motion (k times, k x d states) that begins anew at its end; 40 samples a second."""
    duration = float(times[-1] - times[0])
    count = int(np.clip(duration * 40, 2, min(2400, max(2, len(times) - 1))))
    chosen = states[np.linspace(0, len(times) - 1, count).round().astype(int)]
    return packed(recorded(model, chosen, duration))


def pose(model: Model, state: np.ndarray) -> Entries:
    """A motion that stands still at a state."""
    return film(model, np.array([0.0, 1.0]), np.array([state, state]))


def view(model: Model, states: np.ndarray) -> dict[str, list[float]]:
    """The part of the plane that the stage shows, down and right (m): `centre` and `spans`.

    Of a chain it is the circle that it reaches, so that dragging never leaves the stage.
    """
    if system_kind(model.system).pendulum:
        reach = 2.0 * float(np.sum(model.system["length"]))
        return {"centre": [0.0, 0.0], "spans": [ROOM * reach, ROOM * reach]}
    low, high = box(places(model, states))
    size = np.maximum(high - low, 0.3 * max(float((high - low).max()), 1e-9))
    return {"centre": ((low + high) / 2).tolist(), "spans": (ROOM * size).tolist()}


def around(shown: Entries) -> dict[str, list[float]]:
    """The part of the plane that a film fills."""
    size = np.maximum(shown["spans"], 0.3 * max(*shown["spans"], 1e-9))
    return {"centre": shown["centre"], "spans": (ROOM * size).tolist()}


def draggable(model: Model) -> list[float]:
    """The lengths (m) of the links of a chain whose joints can be dragged; [] of anything else."""
    plain = system_kind(model.system).pendulum and model.constraint is None and model.smooth
    return [*map(float, model.system["length"])] if plain else []


def pullable(model: Model, state: np.ndarray) -> list[int]:
    """The points of a mechanism with a picture that can be pulled, as far as its joints allow; [] of a chain."""
    return [] if draggable(model) or (model.smooth and model.rates is not None) else movable(model, state)
