"""Pictures of equilibria: their components along the parameter, solid where stable, with what happens there."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from orbitfinder.families.equilibrium import Equilibria, Equilibrium, RestEvent
from orbitfinder.mechanics.model import Model
from orbitfinder.show.rest import stretched
from orbitfinder.show.style import dress, new_figure, save_all
from orbitfinder.show.svg import COLOURS, axis

MARKS = {"hopf": "o", "fold": "s", "branch_point": "D", "neutral_saddle": "x"}
"""Matplotlib's markers of events"""
MOST = 6
"""Components that are drawn, the first"""


def save_equilibria_figure(equilibria: Equilibria, folder: str | Path, model: Model) -> list[Path]:
    """Write `equilibria.png`; returns its path."""
    both: tuple[Equilibrium | RestEvent, ...] = (*equilibria.points, *equilibria.events)
    places = sorted(both, key=lambda place: place.arclength)
    values = np.array([place.value if isinstance(place, Equilibrium) else place.parameter for place in places])
    states, stretches = np.array([place.state for place in places]), stretched(places)
    count = min(states.shape[1] if model.rates is not None else model.degrees_of_freedom, MOST)
    columns = min(count, 3)
    rows = -(-count // columns)
    words = f"{len(equilibria.points)} equilibria along {equilibria.parameter}; solid: stable, dashed: unstable"
    figure = new_figure(3.6 * columns + 1.0, 3.2 * rows + 0.8, equilibria.name, words)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, panel in enumerate(panels):
        if k >= count:
            panel.set_visible(False)
            continue
        for part, stable in stretches:
            panel.plot(values[part], states[part, k], "-" if stable else "--", color=COLOURS[0], linewidth=1.6)
        marked = defaultdict[str, list[tuple[float, float]]](list)
        for event in equilibria.events:
            marked[event.kind].append((event.parameter, event.state[k]))
        for kind, marks in marked.items():
            panel.plot(*np.array(marks).T, MARKS.get(kind, "."), color=COLOURS[1], label=kind.replace("_", " "))
        dress(panel, equilibria.parameter, axis(model, k))
    if equilibria.events:
        panels[0].legend(loc="best", frameon=False, fontsize=8)
    return save_all({"equilibria": figure}, folder)
