"""Pictures of an atlas: energy against period with stability, how unstable, how many were found when."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from orbitfinder.atlas.report import discovery
from orbitfinder.atlas.store import Atlas, Filter, Row
from orbitfinder.errors import InputError
from orbitfinder.show.style import dress, new_figure, save_png
from orbitfinder.show.svg import COLOURS

KINDS = {"elliptic": (COLOURS[2], "o", "elliptic"), "marginal": (COLOURS[4], "s", "marginal"),
         "unstable": (COLOURS[1], "^", "unstable")}  # fmt: skip
"""Colour, marker and legend entry of each verdict."""
SPREAD = 0.32
"""Width of the cloud around an energy, as a share of the distance between energies."""


def save_atlas_figures(atlas: Atlas, folder: str | Path, chosen: Filter | None = None) -> list[Path]:
    """Write the three figures of an atlas as PNG files; returns their paths. `InputError` when it is empty."""
    rows = atlas.rows(chosen)
    if not rows:
        raise InputError(f"{atlas.path}: no orbit to draw; widen the filter, or search longer")
    figures = {
        "atlas_energy_period": energy_period(rows),
        "atlas_instability": instability(rows),
        "atlas_discovery": discovery_curves(atlas),
    }
    return [save_png(figure, Path(folder) / f"{name}.png") for name, figure in figures.items()]


def energy_period(rows: Sequence[Row]) -> Figure:
    """Energy against period, one mark an orbit, by stability.

    Searches fill single energies, so marks are spread about theirs by how unstable the orbit is.
    """
    figure = new_figure(8.0, 5.2, f"{len(rows)} periodic orbits: energy, period and stability")
    axes = figure.subplots()
    energies = np.array([row.energy for row in rows])
    shells = np.unique(np.round(energies, 9))
    height = SPREAD * (float(np.diff(shells).min()) if shells.size > 1 else 1.0)
    sizes = np.log10(np.array([row.instability for row in rows]))
    offsets = height * sizes / max(float(sizes.max()), 1e-9)
    for kind, (colour, marker, label) in KINDS.items():
        here = np.array([row.stability == kind for row in rows])
        if here.any():
            across = np.array([row.period for row in rows])[here]
            axes.plot(across, (energies + offsets)[here], marker, color=colour, markersize=4.5, alpha=0.75,
                      markeredgewidth=0, linestyle="none", label=f"{label} ({int(here.sum())})")  # fmt: skip
    for shell in shells if shells.size < 12 else []:
        axes.axhline(shell, color="0.75", linewidth=0.7, zorder=0)
    dress(axes, "period (s)", "energy (J), raised by log10 |largest multiplier|")
    if shells.size < 12:
        axes.set_yticks(shells)
    axes.legend(frameon=False, loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=3)
    return figure


def instability(rows: Sequence[Row]) -> Figure:
    """Histogram of ln |largest multiplier| / period, the mean rate (1/s) at which neighbours leave."""
    figure = new_figure(8.0, 4.6, f"{len(rows)} periodic orbits: how fast neighbours leave")
    axes = figure.subplots()
    rates = {kind: [np.log(row.instability) / row.period for row in rows if row.stability == kind] for kind in KINDS}
    top = max((max(values) for values in rates.values() if values), default=1.0)
    bins = np.linspace(0.0, max(top, 1e-3), 31)
    kinds = [kind for kind in KINDS if rates[kind]]
    axes.hist(
        [rates[kind] for kind in kinds], bins=list(bins), stacked=True, color=[KINDS[kind][0] for kind in kinds],
        label=[f"{kind} ({len(rates[kind])})" for kind in kinds],
    )  # fmt: skip
    dress(axes, "ln |largest multiplier| / period (1/s)", "orbits")
    axes.legend(frameon=False)
    return figure


def discovery_curves(atlas: Atlas) -> Figure:
    """Distinct orbits against processor time of every search, and Chao's estimate of how many there are."""
    figure = new_figure(8.0, 5.0, "Distinct orbits found, and how many such starts can find (Chao1)")
    axes = figure.subplots()
    searches = atlas.select([int, float, int], "SELECT id, energy, seed FROM searches ORDER BY id")
    for k, (search, energy, seed) in enumerate(searches):
        seconds, distinct, estimate = discovery(atlas, search)
        if not len(seconds):
            continue
        colour = COLOURS[k % len(COLOURS)]
        name = f"{energy:g} J, seed {seed}: {distinct[-1]} found, about {estimate[-1]:.0f} estimated"
        axes.plot(seconds, distinct, color=colour, label=name)
        settled = np.arange(len(seconds)) >= min(50, len(seconds) // 4)  # earlier it is mostly noise
        axes.plot(seconds[settled], estimate[settled], color=colour, linestyle=":", linewidth=1.2)
    dress(axes, "processor time (s)", "distinct orbits (dotted: estimate)")
    axes.set_ylim(bottom=0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    return figure
