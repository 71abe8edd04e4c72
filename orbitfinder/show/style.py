"""How figures look: Agg, Okabe-Ito colours (safe for colour-blind readers), units on every axis."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""M. Okabe, K. Ito, Color Universal Design (2008), without the yellow that vanishes on white."""
DASHES = ("-", "--", "-.", ":")
RESOLUTION = 150


def new_figure(width: float, height: float, title: str, what: str = "") -> Figure:
    """A Figure headed by a wrapped title and, when given, a line that says what it shows; nothing is clipped."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    lines = textwrap.wrap(title, width=int(width * 10), max_lines=3, placeholder=" ...")
    figure.suptitle("\n".join(filter(None, [*lines, what])), fontsize=11, parse_math=False)
    return figure


def dress(axes: Any, across: str, up: str) -> None:
    """Labels, a light grid and open frames on one set of axes."""
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    if axes.get_xscale() == axes.get_yscale() == "linear":
        axes.locator_params(nbins=6)
    axes.grid(True, color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def line_style(index: int, count: int) -> dict[str, Any]:
    """Colour and dashes of curve `index` of `count`: distinct up to 28, a sequential map beyond."""
    if count > len(COLOURS) * len(DASHES):
        from matplotlib import colormaps

        return {"color": colormaps["cividis"](index / (count - 1)), "linewidth": 0.7}
    dash = DASHES[index // len(COLOURS)]
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": dash, "linewidth": 1.4}


def save_png(figure: Figure, path: Path) -> Path:
    """Write a figure whole or not at all."""
    import io

    from orbitfinder.records.reading import write_atomically

    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=RESOLUTION)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, buffer.getvalue())
    return path
