"""Pictures of an orbit: time histories, phase portraits, the swept configuration, the energy error."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from orbitfinder.errors import InputError
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model, energies, positions
from orbitfinder.records.orbit import Orbit
from orbitfinder.show.style import dress, line_style, new_figure, plane, save_png, sweep, trail
from orbitfinder.show.svg import COLOURS

SNAPSHOTS = 48
"""Configurations drawn over one period."""
MOST_PORTRAITS = 12
MOST_IN_LEGEND = 12


def save_figures(orbit: Orbit, folder: str | Path, model: Model | None = None) -> list[Path]:
    """Write the four figures of an orbit as PNG files; returns their paths.

    `model` is needed only for systems that no file describes. Raises `InputError` when the orbit
    carries no samples.
    """
    model = model or build_model(orbit.system)
    figures = {
        "time_histories": time_histories(orbit, model),
        "phase_portraits": phase_portraits(orbit, model),
        "energy_error": energy_error(orbit, model),
    }
    if model.points is not None:
        figures["swept_configuration"] = swept_configuration(orbit, model)
    return [save_png(figure, Path(folder) / f"{name}.png") for name, figure in figures.items()]


def heading(orbit: Orbit, what: str) -> tuple[str, str]:
    """The two lines above a figure: the orbit's title, and what is shown of it."""
    return orbit.title or orbit.name, f"{what}, T = {orbit.period:.6g} s"


def label(name: str) -> str:
    """A coordinate's name for an axis: theta3 with its subscript, others as they are."""
    found = re.fullmatch(r"theta(\d+)", name)
    return rf"$\theta_{{{found.group(1)}}}$" if found else name


def units(model: Model) -> list[str]:
    """Unit of each coordinate: rad for angles, m otherwise."""
    n = model.degrees_of_freedom
    angles = model.angles or (True,) * n
    return ["rad" if angle else "m" for angle in angles]


def _samples(orbit: Orbit) -> tuple[np.ndarray, np.ndarray]:
    if len(orbit.samples) < 2:
        raise InputError(f"{orbit.name}: no samples to draw; keep orbit.npz beside orbit.json, or run it again")
    return orbit.times, orbit.samples


def _unit(model: Model, suffix: str = "") -> str:
    return " or ".join(f"{unit}{suffix}" for unit in dict.fromkeys(units(model)))


def time_histories(orbit: Orbit, model: Model) -> Figure:
    """Coordinates and velocities over one period."""
    times, states = _samples(orbit)
    n = model.degrees_of_freedom
    figure = new_figure(8.0, 6.0, *heading(orbit, "time histories"))
    upper, lower = figure.subplots(2, 1, sharex=True)
    for i in range(n):
        style = line_style(i, n)
        upper.plot(times, states[:, i], label=label(model.state_names[i]), **style)
        lower.plot(times, states[:, n + i], **style)
    dress(upper, "", f"coordinates ({_unit(model)})")
    dress(lower, "time (s)", f"velocities ({_unit(model, '/s')})")
    lower.set_xlim(0.0, orbit.period)
    if n <= MOST_IN_LEGEND:
        figure.legend(*upper.get_legend_handles_labels(), loc="outside right center", frameon=False)
    else:
        _colour_bar(figure, [upper, lower], n)
    return figure


def _colour_bar(figure: Figure, axes: Any, count: int) -> None:
    """For many curves: which coordinate is which, by a colour scale where the curves have one."""
    if line_style(0, count).get("linestyle") is None:
        scale = ScalarMappable(Normalize(1, count), "cividis")
        figure.colorbar(scale, ax=axes, label="coordinate number", aspect=40)
    else:
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False, ncols=2)


def phase_portraits(orbit: Orbit, model: Model) -> Figure:
    """Velocity against coordinate, one panel each (at most 12, evenly chosen)."""
    _, states = _samples(orbit)
    n = model.degrees_of_freedom
    chosen = np.unique(np.linspace(0, n - 1, min(n, MOST_PORTRAITS)).round().astype(int))
    columns = min(chosen.size, 3 if chosen.size != 4 else 2)
    rows = -(-chosen.size // columns)
    figure = new_figure(max(3.2 * columns, 5.0), max(2.9 * rows, 3.6) + 0.5, *heading(orbit, "phase portraits"))
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, i in zip(grid, chosen, strict=False):
        axes.plot(states[:, i], states[:, n + i], color=COLOURS[0], linewidth=1.3)
        axes.plot(states[0, i], states[0, n + i], "o", color=COLOURS[1], markersize=5, label="t = 0")
        name, unit = label(model.state_names[i]), units(model)[i]
        dress(axes, f"{name} ({unit})", f"rate of {name} ({unit}/s)")
        axes.locator_params(axis="x", nbins=4)
        axes.margins(0.08)
    for axes in grid[chosen.size :]:
        axes.set_visible(False)
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower right", frameon=False)
    return figure


def swept_configuration(orbit: Orbit, model: Model) -> Figure:
    """The links over one period, early ones faint, and the path of the tip; gravity points down the page."""
    _, states = _samples(orbit)
    figure = new_figure(6.4, 6.4, *heading(orbit, "swept configuration"))
    axes = figure.subplots()
    joints = positions(model, states[:: max(1, (len(states) - 1) // SNAPSHOTS)])
    sweep(axes, joints)
    trail(axes, positions(model, states)[:, :, -1], 1.4, label="path of the tip")
    down, right = joints[0]
    marks = "o" if right.size <= 12 else None
    axes.plot(right, -down, color="black", marker=marks, linewidth=2.0, markersize=4.5, label="t = 0")
    axes.plot(right[0], -down[0], "s", color="black", markersize=8, label="fixed joint")
    plane(axes)
    axes.margins(0.06)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return figure


def energy_error(orbit: Orbit, model: Model) -> Figure:
    """Energy of the samples minus that of the first, with the energies exchanged for scale."""
    times, states = _samples(orbit)
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    figure = new_figure(8.0, 5.6, *heading(orbit, "energy"))
    upper, lower = figure.subplots(2, 1, sharex=True)
    upper.plot(times, kinetic, label="kinetic", **line_style(0, 3))
    upper.plot(times, potential - potential.min(), label="potential above its least", **line_style(1, 3))
    dress(upper, "", "energy (J)")
    lower.plot(times, total - total[0], color=COLOURS[2], linewidth=1.1)
    lower.axhline(0.0, color="0.5", linewidth=0.7)
    dress(lower, "time (s)", "E(t) \N{MINUS SIGN} E(0) (J)")
    lower.set_xlim(0.0, orbit.period)
    upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, borderaxespad=0.2)
    return figure
