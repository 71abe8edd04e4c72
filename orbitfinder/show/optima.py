"""Pictures of families of optima: what they cost along their parameter."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

from orbitfinder.control.optimum import Optima
from orbitfinder.show.style import dress, new_figure, save_png
from orbitfinder.show.svg import COLOURS

MARKS = {"fold": ("D", "turning point"), "active": ("^", "constraint becomes active"),
         "inactive": ("v", "constraint is let go"), "least": ("o", "least cost"), "largest": ("s", "largest cost"),
         "costless": ("*", "no control needed"), "branch": ("x", "other optima branch off")}  # fmt: skip


def save_optima_figure(optima: Optima, folder: str | Path) -> Path:
    """Draw what optima cost along their parameter: solid where it is a local least, dashed where some direction lowers
    it; turning points, changes of the active constraints and extremes marked.

    Args:
        optima: at least one point.
        folder: where `optima.png` is written.

    Returns:
        The path of the picture.

    Examples:
        >>> of.save_optima_figure(optima, ".").name
        'optima.png'
    """
    figure = new_figure(8.0, 5.2, optima.name, f"least cost along {optima.parameter}; {optima.end}")
    axes, values, costs = figure.subplots(), optima.values, optima.costs
    for (k, first), (m, second) in pairwise(enumerate(optima.descents)):
        least = first == 0 or second == 0  # a turning point itself is the end of both
        axes.plot(values[[k, m]], costs[[k, m]], "-" if least else "--", color=COLOURS[0], linewidth=1.4)
    axes.plot(values, costs, ".", color=COLOURS[0], markersize=4)
    places = defaultdict[str, list[tuple[float, float]]](list)
    for change in optima.changes:
        places[change.kind].append((change.value, change.cost))
    for kind, (mark, words) in MARKS.items():
        if places[kind]:
            axes.plot(*zip(*places[kind], strict=True), mark, color=COLOURS[1], label=words, markersize=8)
    if optima.changes:
        axes.legend(loc="best", frameon=False, fontsize=9)
    dress(axes, optima.parameter, "cost")
    return save_png(figure, Path(folder) / "optima.png")
