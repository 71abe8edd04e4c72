"""Pictures of maps: a parameter plane coloured by a number of its orbits, with the boundaries of stability."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from orbitfinder.families.plane import ParameterMap
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import given_units, units
from orbitfinder.records.family import UNITS
from orbitfinder.show.plot import forced_unit
from orbitfinder.show.style import legend, new_figure, save_all
from orbitfinder.show.svg import axis

REGIONS, NOTHING = {
    "stable": "#CCE5F2", "unstable, a multiplier above 1": "#E69F00", "unstable, a multiplier below \u22121": "#009E73",
    "unstable, a complex pair": "#CC79A7",
}, "0.75"  # fmt: skip
"""What is told apart by colour where stability is, by the largest multiplier; the colour of pixels without an orbit"""
REAL, LEAST = 1e-6, 1e-12
"""The argument of a multiplier, in rad, that counts as real, and the least modulus that is drawn"""


def save_map_figure(plane: ParameterMap, folder: str | Path, model: Model) -> list[Path]:
    """Write `map.png` (see `map_figure`); returns the path."""
    return save_all({"map": map_figure(plane, model)}, folder)


def map_figure(plane: ParameterMap, model: Model | None) -> Figure:
    """The plane with its colour bar or legend, and lines where stability changes; names are plain without a model."""
    counts = f"{plane.known.sum()} orbits of {plane.blank.size} pixels, "
    counts += f"{int(plane.sample[:, 2].sum())} of {len(plane.sample)} sampled certified"
    figure = new_figure(7.6, 6.0, plane.title or plane.name, counts)
    axes, shown = figure.subplots(), dict[str, Any]()
    edges = list[np.ndarray]()  # of pixels, half-way between their values
    for values in (plane.columns, plane.rows):
        middle = (values[1:] + values[:-1]) / 2
        edges.append(np.concatenate([[2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]]))
    axes.set_facecolor(NOTHING)
    style = {"rasterized": True, "linewidth": 0}
    if plane.by == "stability":
        numbers, names = regions(plane), list(REGIONS)
        axes.pcolormesh(*edges, numbers, cmap=ListedColormap(list(REGIONS.values())), vmin=-0.5, vmax=3.5, **style)
        shown |= {names[k]: Patch(color=REGIONS[names[k]]) for k in range(4) if (numbers == k).any()}
    else:
        values, time = plane.values(plane.by), units(plane.system)["time"]
        words = f"period ({time})" if time else "period"
        if plane.by == "amplitude":
            words = f"amplitude of {axis(model, plane.moving) if model else plane.coordinates[plane.moving]}"
        elif plane.by != "period":
            words = "$\\log_{10}$ of the largest multiplier's modulus"
            values = np.log10(np.maximum(values, LEAST))
        figure.colorbar(axes.pcolormesh(*edges, values, cmap="viridis", **style), ax=axes, label=words)
    if not plane.known.all():
        shown["no orbit"] = Patch(color=NOTHING)
    sizes, stable = plane.values("multiplier"), plane.values("stability")
    if 0 < np.nansum(stable) < plane.known.sum():  # of what dissipates stability changes where the largest is 1
        shrinks = np.nanmin(np.where(stable == 1, sizes, np.inf)) < 1.0 - REAL
        between = np.log(np.maximum(sizes, LEAST)) if shrinks else 0.5 - stable
        axes.contour(plane.columns, plane.rows, between, levels=[0.0], colors="black", linewidths=1.0)
        shown["stability changes"] = Line2D([], [], color="black", linewidth=1.0)
    axes.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]], xlabel=_named(plane, 0), ylabel=_named(plane, 1))
    axes.locator_params(nbins=6)
    legend(figure, shown, "lower center", ncols=2)
    return figure


def regions(plane: ParameterMap) -> np.ndarray:
    """Numbers of `REGIONS` (R x C), nan where there is no orbit."""
    real, imaginary = plane.multipliers.transpose(2, 0, 1)
    turned = np.abs(np.arctan2(imaginary, real))
    how = np.where(turned < REAL, 1.0, np.where(np.pi - turned < REAL, 2.0, 3.0))
    return np.where(plane.known, np.where(plane.stable, 0.0, how), np.nan)


def _named(plane: ParameterMap, k: int) -> str:
    """A parameter with its unit, where that is known."""
    name, values = plane.parameters[k], np.broadcast_to((plane.columns, plane.rows[:, None])[k], plane.periods.shape)
    cycles = plane.curve.get("cycles", np.inf)
    unit = (
        given_units(plane.system).get(name, "")
        or UNITS.get(name, "")
        or forced_unit(values[plane.known], plane.periods[plane.known], cycles)
    )
    return f"{name} ({unit})" if unit and units(plane.system)["time"] else name
