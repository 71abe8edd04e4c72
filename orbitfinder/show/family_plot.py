"""Pictures of a family: frequency against energy, multipliers in the plane and against the parameter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orbitfinder.families.members import Motion, motions
from orbitfinder.records.family import Family, FamilyPoint
from orbitfinder.show.style import COLOURS, dress, new_figure, save_png

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from orbitfinder.mechanics.model import Model

MARKERS = {
    "fold": ("v", "fold"),
    "branch_point": ("o", "branch point"),
    "period_doubling": ("s", "period doubling"),
    "torus": ("P", "torus"),
    "resonance": (".", "resonance"),
    "collision": ("x", "collision"),
    "stability_change": ("D", "stability change"),
}
"""Marker and legend entry of each kind of event."""
UNITS = {"energy": "J", "period": "s"}


def save_family_figures(family: Family, folder: str | Path, model: Model | None = None) -> list[Path]:
    """Write the figures of a family as PNG files, with a gallery where its model is given; returns their paths."""
    figures = {"frequency_energy": frequency_energy([family])}
    if any(point.floquet_multipliers.size for point in family.points):
        figures |= {"multipliers_plane": multipliers_plane(family), "multipliers": multipliers_along(family)}
    if model is not None and len(family.points) > 1:
        figures["gallery"] = gallery(family, motions(family, model))
    return [save_png(figure, Path(folder) / f"{name}.png") for name, figure in figures.items()]


def gallery(family: Family, shown: Sequence[Motion]) -> Figure:
    """Orbits along the family, each over one period: swept links and the path of the tip, or the path in (q1, q2)."""
    columns = min(4, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(2.6 * columns, 2.9 * rows + 0.4, f"{family.name}: orbits along the family")
    grid = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, motion in zip(grid, shown, strict=False):
        _draw(axes, motion)
        one = motion.point
        where = f"{family.parameter} {one.value:.5g}" if family.parameter in one.free else f"{one.energy:.5g} J"
        axes.set_title(f"{where}, {one.period:.4g} s\n{one.stability}", fontsize=8)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.06)
        axes.tick_params(labelsize=7)
        dress(axes, "", "")
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    return figure


def _draw(axes: Any, motion: Motion) -> None:
    if motion.joints is None:
        axes.plot(motion.states[:, 0], motion.states[:, 1], color=COLOURS[1], linewidth=1.2)  # (q, v) for n = 1
        return
    joints = motion.joints[:: max(1, len(motion.joints) // 30)]
    for k, (down, right) in enumerate(joints):
        axes.plot(right, -down, color=COLOURS[0], alpha=0.10 + 0.45 * k / len(joints), linewidth=0.8)
    down, right = motion.joints[0]
    # the last joint of a linkage is a pivot on the ground
    fixed = motion.joints.shape[2] > 1 and np.ptp(motion.joints[:, :, -1], axis=0).max() < 1e-9
    tip = motion.joints[:, :, -2 if fixed else -1]
    axes.plot(tip[:, 1], -tip[:, 0], color=COLOURS[1], linewidth=1.1)
    axes.plot(right, -down, color="black", linewidth=1.6)
    axes.plot(right[0], -down[0], "s", color="black", markersize=4)


def frequency_energy(
    families: Sequence[Family], marks: dict[str, tuple[float, float]] | None = None, title: str = ""
) -> Figure:
    """Frequency against energy, one colour a family: solid where stable, dashed where unstable, events marked.

    Families in a physical parameter, along which the energy may not change, are drawn against that. `marks` are
    further orbits to show, name -> (energy, period).
    """
    from matplotlib.lines import Line2D

    names = ", ".join(family.name for family in families)
    freed = families[0].parameter if all(families[0].parameter in family.points[0].free for family in families) else ""
    figure = new_figure(8.0, 5.6, title or f"{names}: frequency and {freed or 'energy'}")
    axes = figure.subplots()
    shown: dict[str, Any] = {}
    for k, family in enumerate(families):
        colour = COLOURS[k % len(COLOURS)]
        for stable, run in runs(family.points):
            across = [point.value if freed else point.energy for point in run]
            up = [1.0 / point.period for point in run]
            style = {"linestyle": "-" if stable else "--", "linewidth": 1.8 if stable else 1.1}
            axes.plot(across, up, color=colour, **style)
        for event in family.events:
            marker, text = MARKERS[event.kind]
            face = colour if event.kind != "branch_point" else "white"
            size = 3.0 if event.kind == "resonance" else 5.5
            (line,) = axes.plot(event.parameter if freed else event.energy, 1.0 / event.period, marker, color=colour,
                                markerfacecolor=face, markersize=size, linestyle="none")  # fmt: skip
            shown.setdefault(text, line)
    if len(families) > 1:
        names_shown = [Line2D([], [], color=COLOURS[k % len(COLOURS)]) for k in range(len(families))]
        axes.legend(names_shown, [family.name for family in families], loc="upper right", frameon=False)
    for name, (energy, period) in (marks or {}).items():
        axes.plot(energy, 1.0 / period, "*", color="black", markersize=10)
        offset = {"xytext": (6, 8), "textcoords": "offset points"}
        axes.annotate(name, (energy, 1.0 / period), fontsize=9, parse_math=False, **offset)
    dress(axes, axis_name(families[0]) if freed else "energy (J)", "frequency (1/s)")
    if shown:
        figure.legend(list(shown.values()), list(shown), loc="outside lower center", ncols=3, frameon=False)
    return figure


def runs(points: Sequence[FamilyPoint]) -> list[tuple[bool, list[FamilyPoint]]]:
    """Maximal stretches of points with the same verdict (stable or not), each joined to the next."""
    found: list[tuple[bool, list[FamilyPoint]]] = []
    for point in points:
        stable = point.stability != "unstable"
        if not found or found[-1][0] != stable:
            joined = [found[-1][1][-1]] if found else []
            found.append((stable, joined))
        found[-1][1].append(point)
    return found


def multipliers_plane(family: Family) -> Figure:
    """Every point's multipliers in the complex plane, inside a square a little wider than the unit circle."""
    figure = new_figure(6.4, 6.4, f"{family.name}: Floquet multipliers")
    axes = figure.subplots()
    angle = np.linspace(0, 2 * np.pi, 361)
    axes.plot(np.cos(angle), np.sin(angle), color="0.6", linewidth=0.8)
    values = np.concatenate([point.floquet_multipliers for point in family.points])
    where = np.concatenate([np.full(point.floquet_multipliers.size, point.value) for point in family.points])
    near = np.abs(values) < 2.5
    dots = axes.scatter(values.real[near], values.imag[near], c=where[near], s=9, cmap="viridis")
    axes.set_aspect("equal")
    axes.set(xlim=(-2.6, 2.6), ylim=(-2.6, 2.6))
    dress(axes, "real part", "imaginary part")
    figure.colorbar(dots, ax=axes, label=axis_name(family), shrink=0.8)
    return figure


def multipliers_along(family: Family) -> Figure:
    """|mu| (logarithmic) and the stability indices along the family, each index as one curve."""
    figure = new_figure(8.0, 6.4, f"{family.name}: stability along the family")
    upper, lower = figure.subplots(2, 1, sharex=True)
    values = family.values("value")
    sizes = np.abs(np.stack([point.floquet_multipliers for point in family.points]))
    upper.semilogy(values, np.maximum(sizes, 1e-300), ".", color=COLOURS[0], markersize=3)
    indices = np.stack([point.indices for point in family.points])
    for k in range(indices.shape[1]):
        lower.plot(values, indices[:, k].real, ".-", color=COLOURS[k % len(COLOURS)], markersize=3, linewidth=1.0)
    for level in (-2.0, 2.0):
        lower.axhline(level, color="0.5", linewidth=0.7)
    for event in family.events:
        if event.kind in ("branch_point", "period_doubling", "collision"):
            lower.axvline(event.parameter, color="0.75", linewidth=0.6)
    lower.set_ylim(-4.0, 4.0)
    root = family.points[0].root
    dress(upper, "", "|multiplier|")
    dress(lower, axis_name(family), "stability index" + (" of the half period" if root == 2 else ""))
    return figure


def axis_name(family: Family) -> str:
    """The parameter with its unit, where that is known."""
    unit = UNITS.get(family.parameter)
    return f"{family.parameter} ({unit})" if unit else family.parameter
