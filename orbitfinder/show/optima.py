"""Pictures of families of optima: what they cost along their parameter."""

from __future__ import annotations

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import numpy as np

from orbitfinder.control.optimum import Optima
from orbitfinder.show.diagram import entitled
from orbitfinder.show.style import dress, new_figure, rounded, save_png, with_word
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
    figure = new_figure(
        8.0, 5.2, entitled(*optima.points[:1]) or optima.name, f"least cost along {optima.parameter}; {optima.end}"
    )
    axes, values, costs = figure.subplots(), optima.values, optima.costs
    least = [first == 0 or second == 0 for first, second in pairwise(optima.descents)]  # a turning point ends both
    cuts = [0, *(k for k in range(1, len(least)) if least[k] != least[k - 1]), len(least)]
    line = np.column_stack([values, costs])
    for stable, path in rounded([(least[k], line[k : end + 1]) for k, end in pairwise(cuts) if least]):
        axes.plot(*path.T, "-" if stable else "--", color=COLOURS[0], linewidth=1.6)
    axes.plot(values, costs, ".", color=COLOURS[0], markersize=5)
    places = defaultdict[str, list[tuple[float, float]]](list)
    for change in optima.changes:
        places[change.kind].append((change.value, change.cost))
    for kind, (mark, words) in MARKS.items():
        if places[kind]:
            axes.plot(*zip(*places[kind], strict=True), mark, color=COLOURS[1], label=words, markersize=8)
    if optima.changes:
        axes.legend(loc="best", frameon=False, fontsize=9)
    dress(axes, with_word(optima.parameter, optima.points[0].system), "cost")
    return save_png(figure, Path(folder) / "optima.png")
