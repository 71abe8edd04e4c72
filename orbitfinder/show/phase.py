"""Pictures of phases: phase responses, and the phase plane of two states with nullclines and equilibria."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from orbitfinder.continuation.tests import decomposed, felt
from orbitfinder.errors import InputError
from orbitfinder.families.equilibrium import stability
from orbitfinder.integrate.jets import Jets
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import equilibrium
from orbitfinder.mechanics.scales import lasting
from orbitfinder.orbits.closure import shift
from orbitfinder.records.orbit import Orbit
from orbitfinder.show.diagram import entitled
from orbitfinder.show.style import arrows, dress, legend, line_style, new_figure, save_all
from orbitfinder.show.svg import COLOURS, axis
from orbitfinder.structures.phase_response import PhaseResponse

MOST, ARROWS, CELLS, FINE, KNOWN, RESTS = 4, 20, 60, 300, 1e-9, {
    "stable": ("o", "black"), "unstable": ("o", "white"), "saddle": ("D", "white"), "neutral": ("s", "0.6"),
}  # fmt: skip
"""Components drawn; on an axis: arrows, points between which equilibria are looked for, and those of nullclines; what
slopes are known to, relative to them; marker and filling of equilibria"""


def save_phase_figure(curve: PhaseResponse, folder: str | Path, model: Model) -> list[Path]:
    """Write `phase.png`: components of the cycle and below each what a kick in it does; returns its path."""
    count, phases = min(curve.states.shape[1], MOST), np.append(curve.times / curve.period, 1.0)
    states = np.vstack([curve.states, curve.states[:1] + shift(curve.winding, curve.states.shape[1])])
    figure = new_figure(
        3.4 * count + 1.0, 5.6, entitled(curve), f"phase response, T = {lasting(curve.period, curve.system, 6)}"
    )
    for k, (above, below) in enumerate(figure.subplots(2, count, sharex=True, squeeze=False).T):
        above.plot(phases, states[:, k], color="0.3", linewidth=1.6)
        below.plot(phases, np.append(curve.response[:, k], curve.response[0, k]), color=COLOURS[0], linewidth=1.6)
        below.axhline(0.0, color="0.6", linewidth=0.8)
        dress(above, "", axis(model, k))
        dress(below, "phase (periods)", f"advance per unit of {model.state_names[k]}")
    return save_all({"phase": figure}, folder)


def phase_plane(
    model: Model, ranges: Mapping[str, tuple[float, float]] | None = None, *, orbits: Sequence[Orbit] = (),
    title: str = "phase plane",
) -> Figure:  # fmt: skip
    """The phase plane of an autonomous system of two states: nullclines, directions, equilibria, orbits.

    Args:
        model: the system.
        ranges: least and largest value of each state, by name; around the orbits without it.
        orbits: drawn over it, dashed where unstable.
        title: a heading.

    Returns:
        A figure of Matplotlib.

    Raises:
        InputError: for other systems, and ranges that are none.

    Examples:
        >>> of.phase_plane(clock, {"u": (0.0, 4.0), "v": (0.0, 5.0)}, orbits=[cycle]).axes[0].get_xlabel()
        'u'
    """
    low, high = _view(model, ranges or {}, orbits)
    figure, room = new_figure(7.4, 6.2, title), (high - low) / (2 * ARROWS)
    axes, shown = figure.subplots(), dict[str, Any]()
    for k, (places, rates) in enumerate([_rates(model, low, high, FINE)] * 2):
        axes.contour(*places, rates[k], levels=[0.0], colors=COLOURS[k + 1], linewidths=1.5)
        shown[f"{model.state_names[k]}' = 0"] = Line2D([], [], color=COLOURS[k + 1], linewidth=1.5)
    places, rates = _rates(model, low + room, high - room, ARROWS)
    with np.errstate(all="ignore"):
        rates /= np.hypot(*(rates / room[:, None, None] / 1.3))
    axes.quiver(*places, *rates, angles="xy", scale_units="xy", scale=1, pivot="mid", color="0.75", width=0.0022)
    for k, orbit in enumerate(orbits):
        style = line_style(k, len(orbits)) | {"linestyle": "--" if orbit.stability == "unstable" else "-"}
        shown[orbit.name] = axes.plot(*orbit.samples.T, **style)[0]
        arrows(axes, orbit.samples[:, 0], orbit.samples[:, 1], style["color"])
    for place, word in _rests(model, low, high):
        style = dict(zip(("marker", "markerfacecolor"), RESTS[word], strict=True), color="black", linestyle="none")
        shown[f"equilibrium, {word}"] = axes.plot(*place, **style, markersize=7, zorder=4)[0]
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    dress(axes, axis(model, 0), axis(model, 1))
    legend(figure, shown, "lower center", ncols=4)
    return figure


def _view(model: Model, ranges: Mapping[str, Any], orbits: Sequence[Orbit]) -> np.ndarray:
    """The lower and the upper corner (2 x 2). Raises `InputError`."""
    names = model.state_names
    if len(names) != 2 or model.forced or not model.smooth:
        what = "depends on time" if model.forced else "jumps" if not model.smooth else f"has {len(names)} states"
        raise InputError(f"model: {what}; phase planes are of autonomous systems of two states, draw a section of this")
    corners = []
    for k, name in enumerate(names):
        moved = [orbit.samples[:, k] for orbit in orbits if name not in ranges]
        least, most = (np.min(moved), np.max(moved)) if moved else ranges.get(name, (np.nan, np.nan))
        if not -np.inf < least < most < np.inf or set(ranges) - set(names):
            raise InputError(f"ranges: expected the least and the largest value of {' and '.join(names)}, got {ranges}")
        corners.append(np.array([least, most]) + 0.2 * (most - least) * bool(moved) * np.array([-1.0, 1.0]))
    return np.array(corners).T


def _rates(model: Model, low: np.ndarray, high: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Places and rates (2 x count x count each) on a grid that fills a view."""
    places = np.array(np.meshgrid(*np.linspace(low, high, count).T))
    rates = model.rate(0.0, places.reshape(2, -1), model.parameter_values).full()
    return places, np.where(np.isfinite(rates), rates, np.nan).reshape(places.shape)


def _rests(model: Model, low: np.ndarray, high: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """The equilibria in view, each with a word of `RESTS`, by Newton's method from where both rates change sign."""
    places, rates = _rates(model, low, high, CELLS)
    corners = np.array([rates[:, i : CELLS - 1 + i, j : CELLS - 1 + j] for i in (0, 1) for j in (0, 1)])
    both = ((corners.min(axis=0) <= 0) & (corners.max(axis=0) >= 0)).all(axis=0)
    jets, rests, none = Jets(model, ()), list[tuple[np.ndarray, str]](), np.zeros(0)

    def linearised(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows, *slopes = jets.first(x, none, none)
        return rows, np.transpose(slopes)

    for start in places[:, :-1, :-1][:, both].T:
        rest = equilibrium(linearised, start, high - low)
        again = any(np.abs((rest.w - other) / (high - low)).max() < 1e-6 for other, _ in rests)
        if rest.converged and not again and np.all((rest.w >= low) & (rest.w <= high)):
            slopes = linearised(rest.w)[1]
            values, left, right = decomposed(slopes)
            word = stability(values, KNOWN * felt(abs(left), abs(slopes), abs(right)))
            rests.append((rest.w, "saddle" if np.prod(values).real < 0 else word))
    return rests
