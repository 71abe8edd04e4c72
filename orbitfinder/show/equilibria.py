"""Pictures of equilibria: their components along the parameter, solid where stable, with what happens there."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.mechanics.model import Model
from orbitfinder.show.style import dress, new_figure, save_all
from orbitfinder.show.svg import COLOURS, axis

MARKS = {"hopf": "o", "fold": "s", "branch_point": "D", "neutral_saddle": "x"}
"""Matplotlib's markers of events"""
MOST = 6
"""Components that are drawn, the first"""


def save_equilibria_figure(equilibria: Equilibria, folder: str | Path, model: Model) -> list[Path]:
    """Write `equilibria.png`; returns its path."""
    states = np.array([point.state for point in equilibria.points])
    values = np.array([point.value for point in equilibria.points])
    stable = np.array([point.stability != "unstable" for point in equilibria.points])
    count = min(states.shape[1] if model.rates is not None else model.degrees_of_freedom, MOST)
    columns = min(count, 3)
    rows = -(-count // columns)
    words = f"{len(values)} equilibria along {equilibria.parameter}; solid: stable, dashed: unstable"
    figure = new_figure(3.6 * columns + 1.0, 3.2 * rows + 0.8, equilibria.name, words)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    edges = [0, *(np.flatnonzero(np.diff(stable)) + 1), len(values)]
    for k, panel in enumerate(panels):
        if k >= count:
            panel.set_visible(False)
            continue
        for low, high in pairwise(edges):
            part = slice(max(low - 1, 0), high)
            panel.plot(values[part], states[part, k], "-" if stable[low] else "--", color=COLOURS[0], linewidth=1.6)
        for kind in dict.fromkeys(event.kind for event in equilibria.events):
            places = [(event.parameter, event.state[k]) for event in equilibria.events if event.kind == kind]
            panel.plot(*np.array(places).T, MARKS.get(kind, "."), color=COLOURS[1], label=kind.replace("_", " "))
        dress(panel, equilibria.parameter, axis(model, k))
    if equilibria.events:
        panels[0].legend(loc="best", frameon=False, fontsize=8)
    return save_all({"equilibria": figure}, folder)
