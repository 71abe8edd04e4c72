"""Paths of what moves in a plane or in space, from every side, with the places that a system marks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from orbitfinder.families.members import MemberMotion
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import Family
from orbitfinder.records.orbit import Orbit
from orbitfinder.show.diagram import entitled
from orbitfinder.show.facts import sides
from orbitfinder.show.scene import landmarks
from orbitfinder.show.style import dress, landmark, legend, new_figure
from orbitfinder.show.svg import COLOURS


def path_views(orbit: Orbit, model: Model) -> Figure:
    """One orbit's path over a period from every side, its start, and the landmarks near it."""
    states = orbit.samples
    what = f"path, T = {orbit.period:.6g}"
    figure, views = _views([states], model, orbit.title or orbit.name, what)
    for axes, (i, j) in views:
        axes.plot(states[:, i], states[:, j], color=COLOURS[0], linewidth=1.3)
        axes.plot(states[0, i], states[0, j], "o", color=COLOURS[1], markersize=5, label="t = 0")
    legend(figure, views[0][0], "lower right")
    return figure


def family_paths(family: Family, shown: Sequence[MemberMotion], model: Model) -> Figure:
    """Orbits along a family from every side, coloured by the family's parameter, and the landmarks near them."""
    figure, views = _views([motion.states for motion in shown], model, f"{entitled(family)}: orbits along the family")
    values = [motion.point.value for motion in shown]
    scale = ScalarMappable(Normalize(min(values), max(values)), colormaps["viridis"])
    for axes, (i, j) in views:
        for motion in shown:
            colour = scale.to_rgba(motion.point.value)
            axes.plot(motion.states[:, i], motion.states[:, j], color=colour, linewidth=1.1)
    unit = "" if model.landmarks or not family.unit else f" ({family.unit})"
    figure.colorbar(scale, ax=[axes for axes, _ in views], label=f"{family.parameter}{unit}", shrink=0.85)
    legend(figure, views[0][0], "lower right")
    return figure


def _views(
    motions: Sequence[np.ndarray], model: Model, title: str, what: str = ""
) -> tuple[Figure, list[tuple[Any, tuple[int, int]]]]:
    """A figure with axes for each pair of coordinates that is worth one, labelled and with landmarks."""
    n = len(model.planes)
    low, high, pairs = sides(np.vstack([states[:, :n] for states in motions]))
    extent = float((high - low).max())
    figure = new_figure(4.2 * len(pairs) + 0.8, 4.9, title, what)
    views = list(zip(np.atleast_1d(figure.subplots(1, len(pairs))), pairs, strict=True))
    room = 0.35 * extent  # about the path, within which landmarks are shown
    for axes, (i, j) in views:
        seen: list[np.ndarray] = []
        for name, place, _ in landmarks(model):
            there = np.array([place[i], place[j]])
            inside = all(low[k] - room <= place[k] <= high[k] + room for k in range(n))
            if inside and all(np.abs(there - other).max() > 0.02 * extent for other in seen):
                landmark(axes, name, *there)
                seen.append(there)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.08)
        unit = "" if model.landmarks else " (m)"
        dress(axes, f"{model.state_names[i]}{unit}", f"{model.state_names[j]}{unit}")
    return figure, views
