"""Pictures of brute-force bifurcation diagrams: samples over a parameter, with families of orbits through them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import Family
from orbitfinder.show.diagram import entitled
from orbitfinder.show.equilibria import NAMES, Panel
from orbitfinder.show.style import dress, legend, new_figure, place_labels, save_png, with_word
from orbitfinder.show.svg import axis
from orbitfinder.structures.bifurcation import Bifurcation, family_samples

WAYS = {"none": ("0.25", "samples"), "up": ("0.25", "samples, upwards"), "down": ("#0072B2", "samples, downwards")}
"""How samples of each way of a sweep are drawn and called"""


def save_bifurcation_figure(made: Bifurcation, folder: str | Path, model: Model) -> list[Path]:
    """Write `bifurcation.png`; returns the path."""
    return [draw_bifurcation(made, Path(folder) / "bifurcation.png", model=model)]


def draw_bifurcation(
    made: Bifurcation, path: str | Path, *, families: Sequence[Family] = (), model: Model | None = None
) -> Path:
    """Draw samples over the parameter as PNG, and through them the orbits of families of the same system: solid where
    stable, dashed where not, with their events. Raises `InputError` for a family of something else."""
    model = model or build_model(made.system)
    figure = new_figure(8.4, 5.6, entitled(made), f"{made.plane}; {made.transient} returns dropped, {made.count} kept")
    panel = Panel(figure.subplots(), dict[str, Any]())
    axes, values, heights = panel.axes, made.values[made.owners[:, 0]], made.heights
    size = float(np.clip(40_000 / max(heights.size, 1), 0.25, 6.0))
    for way in ("up", "down") if made.sweep == "both" else (made.sweep,):
        colour, name = WAYS[way]
        mine = (made.owners[:, 1] >= len(made.starts)) == (way == "down") if made.sweep == "both" else slice(None)
        axes.scatter(values[mine], heights[mine], s=size, color=colour, linewidths=0, rasterized=True, zorder=3)
        panel.shown[name] = Line2D([], [], color=colour, marker="o", markersize=3, linestyle="none")
    for family in families:
        for column in family_samples(made, family, model).T:
            panel.cycles(family, column, NAMES[0])
    low, high = (float(end(heights)) for end in (np.min, np.max)) if heights.size else (0.0, 1.0)
    margin = 0.05 * ((high - low) or abs(high) or 1.0)
    first, last = made.values[[0, -1]]
    axes.set(xlim=(first, last) if last > first else None, ylim=(low - margin, high + margin))
    number = model.state_names.index(made.coordinate)
    dress(axes, with_word(made.parameter, made.system), axis(model, number))
    legend(figure, panel.shown, "lower center", ncols=4)
    labels = [label for label in panel.written(last - first or 1.0)
              if first <= label[1] <= last and low - margin <= label[2] <= high + margin]  # fmt: skip
    place_labels(figure, axes, labels)
    return save_png(figure, Path(path))
