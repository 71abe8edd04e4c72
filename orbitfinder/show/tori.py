"""Pictures of invariant tori: their curves and surfaces, and what changes along a family."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from orbitfinder.mechanics.model import Model
from orbitfinder.show.diagram import entitled
from orbitfinder.show.style import dress, legend, new_figure, save_all, told_in
from orbitfinder.show.svg import COLOURS, axis
from orbitfinder.structures.ring import at_angles, coefficients, harmonics
from orbitfinder.structures.tori import filled, torus_value
from orbitfinder.structures.torus import Tori, Torus

ANGLES = np.linspace(0.0, 2 * np.pi, 400)


def save_torus_figures(tori: Tori, folder: str | Path, model: Model) -> list[Path]:
    """Write `torus.png` of the last torus and, of several, `tori.png`; returns their paths."""
    figures = {"torus": torus_figure(tori.tori[-1], model, entitled(tori))}
    if len(tori.tori) > 1:
        figures["tori"] = family_figure(tori, model)
    return save_all({name: told_in(figure, tori.system) for name, figure in figures.items()}, folder)


def torus_figure(torus: Torus, model: Model, name: str) -> Figure:
    """A torus over two coordinates as arcs of one return, the curve that each begins and ends on, and its harmonics."""
    words = f"torus, T = {torus.period:.6g} s, {torus.rotation:.6g} turns a return"
    figure = new_figure(11.0, 4.5, name, words)
    places, portrait, series = figure.subplots(1, 3)
    paths = filled(torus, model, 48)
    ring = at_angles(torus.curve, ANGLES)
    half = torus.curve.shape[1] // 2
    planes = [(0, min(1, half - 1) if half > 1 else half), model.planes[0]]
    for axes, (across, up) in zip((places, portrait), planes, strict=True):
        for path in paths:
            axes.plot(path[:, across], path[:, up], color=COLOURS[0], linewidth=0.4, alpha=0.5)
        axes.plot(ring[:, across], ring[:, up], color=COLOURS[1], linewidth=1.6, label="invariant curve")
        dress(axes, axis(model, across), axis(model, up))
    legend(figure, places, "lower center")
    waves, sizes = harmonics(len(torus.curve)), np.abs(coefficients(torus.curve)).max(axis=1)
    series.semilogy(waves[waves > 0], sizes[waves > 0], ".", color=COLOURS[0])
    dress(series, "harmonic", "largest coefficient")
    return figure


def family_figure(tori: Tori, model: Model) -> Figure:
    """The invariant curves of a family, early ones faint, and the width of the strip along it."""
    figure = new_figure(8.0, 4.2, entitled(tori), f"{len(tori.tori)} tori; {tori.end.split(':')[0]}")
    curves, widths = figure.subplots(1, 2)
    across, up = model.planes[0]
    for k, torus in enumerate(tori.tori):
        ring = at_angles(torus.curve, ANGLES)
        shade = 1.0 - 0.8 * (len(tori.tori) - 1 - k) / len(tori.tori)
        curves.plot(ring[:, across], ring[:, up], color=COLOURS[0], linewidth=0.8, alpha=shade)
    dress(curves, axis(model, across), axis(model, up))
    widths.plot([torus_value(torus, tori.parameter) for torus in tori.tori], [torus.strip for torus in tori.tori], ".-",
                color=COLOURS[0])  # fmt: skip
    widths.set_ylim(bottom=0.0)
    words = {"rotation": "rotation number (turns a return)", "energy": "energy (J)"}
    dress(widths, words.get(tori.parameter, tori.parameter), "half-width of the strip of convergence")
    return figure
