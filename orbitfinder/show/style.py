"""How figures look: Agg, Okabe-Ito colours (safe for colour-blind readers), units on every axis."""

from __future__ import annotations

import io
import textwrap
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from matplotlib.style import context
from matplotlib.text import Text
from scipy.interpolate import CubicSpline

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError
from orbitfinder.mechanics.scales import given_units, worded
from orbitfinder.records.reading import Entries, Table, write_atomically
from orbitfinder.show.scene import BRUSHES, Scene, Strokes, extent, outlines, tip
from orbitfinder.show.svg import COLOURS

DASHES = ("-", "--", "-.", ":")
STRETCHES = {True: ("stable", "-"), False: ("unstable", "--"), None: ("undecided", ":")}
"""The names and lines of stretches of a curve that are stable or not, or of which nothing decides"""
LEAST_SIDE, SLIVER = 0.4, 0.08
"""The shorter side of a picture with ground (and of what is drawn wider than it is), and how narrow that is"""
APART = 4.0
"""Pixels between two names, which move a little when the figure is laid out around them"""


@contextmanager
def styled(sheet: str | None) -> Iterator[None]:
    """Figures with the fonts, sizes and whatever else they do not set themselves of a Matplotlib style sheet.

    Raises `InputError`.
    """
    if sheet is None:
        yield
        return
    try:
        chosen = context(sheet)
        chosen.__enter__()
    except (OSError, ValueError) as error:
        raise InputError(f"style: {sheet}: no style sheet of Matplotlib; give a file or one of its names") from error
    try:
        yield
    finally:
        chosen.__exit__(None, None, None)


def new_figure(width: float, height: float, title: str, what: str = "") -> Figure:
    """A Figure headed by a wrapped title and, when given, a line that says what it shows; nothing is clipped."""
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


def with_word(quantity: str, system: Table) -> str:
    """A parameter or state by name, with its unit where that is told."""
    unit = given_units(system).get(quantity, "")
    return f"{quantity}\N{NO-BREAK SPACE}({unit})" if unit else quantity  # no unit of SI to put another in place of


def told_in(figure: Figure, system: Table) -> Figure:
    """A figure in SI units with a system's words in their place."""
    for text in figure.findobj(Text):
        text.set_text(worded(text.get_text(), system))
    return figure


def legend(figure: Figure, shown: Any, where: str, **more: Any) -> None:
    """A legend outside a figure: of what is `shown`, by name, or of the axes given; none where nothing has a name."""
    if not isinstance(shown, Mapping):
        handles, labels = shown.get_legend_handles_labels()
        shown = dict(zip(labels, handles, strict=True))
    if shown:
        figure.legend(list(shown.values()), list(shown), loc=f"outside {where}", frameon=False, **more)


def place_labels(
    figure: Figure, axes: Any, labels: Sequence[tuple[str, float, float]], size: float = 9.0, **style: Any
) -> None:
    """Names beside their places, clear of curves, marks, names before them and the frame; call it last."""
    style = {"parse_math": False, "fontsize": size, "ha": "center", "va": "center"} | style
    figure.draw_without_rendering()
    lines = [axes.transData.transform(np.asarray(line.get_xydata(), float)) for line in axes.lines]
    taken = np.concatenate([_dense(line[np.isfinite(line).all(axis=1)]) for line in lines] or [np.zeros((0, 2))])
    frame, boxes = axes.get_window_extent(), [name.get_window_extent() for name in axes.texts if name.get_text()]
    for name, x, y in labels:
        text = axes.annotate(name, (x, y), textcoords="offset points", xytext=(0, 0), **style)
        box = text.get_window_extent()
        best = (np.inf, (0.0, 0.0))
        for far, turn in product((0.9, 1.4, 2.2, 3.4, 5.0), np.arange(16) * np.pi / 8):
            move = np.array([np.cos(turn) * (box.width / 2 + 9 * far), np.sin(turn) * (box.height / 2 + 9 * far)])
            there = box.translated(*move)
            inside = ((taken > there.min - APART) & (taken < there.max + APART)).all(axis=1).sum()
            out = not (frame.contains(*there.min) and frame.contains(*there.max))
            cost = 3.0 * inside + 200.0 * sum(there.overlaps(other) for other in boxes) + 100.0 * out + far
            best = min(best, (float(cost), (float(move[0]), float(move[1]))))
        move = np.array(best[1])
        text.set_position(tuple(move * 72.0 / figure.dpi))
        if np.hypot(*move) - box.width / 2 > 25.0:  # so far away a thin line leads to it
            thin = {"arrowstyle": "-", "color": "0.5", "linewidth": 0.6, "shrinkA": 4, "shrinkB": 4, "patchA": text}
            axes.annotate("", (x, y), tuple(move * 72.0 / figure.dpi), textcoords="offset points", arrowprops=thin)
        boxes.append(box.translated(*move).padded(APART))


def _dense(line: np.ndarray) -> np.ndarray:
    """A polyline (k x 2, pixels) with a point at least every few pixels."""
    if len(line) < 2:
        return line
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T)))
    every = np.linspace(0.0, length[-1], min(4000, int(length[-1] / 4) + 2))
    return np.column_stack([np.interp(every, length, column) for column in line.T])


Stretches = Sequence[tuple[bool | None, np.ndarray]]


def rounded(stretches: Stretches, finer: int = 8) -> Stretches:
    """Stretches (k x 2 each) of a curve, which meet, through the same points without corners.

    A cubic spline over the square roots of the chords in the curve's extents, which makes no loops: E. Lee, Choosing
    nodes in parametric curve interpolation, Computer-Aided Design 21 (1989) 363-370.
    """
    whole = np.vstack([stretches[0][1], *(path[1:] for _, path in stretches[1:])]) if stretches else np.zeros((0, 2))
    chords = np.linalg.norm(np.diff(whole, axis=0) / nonzero(np.ptp(whole, axis=0)), axis=1) if len(whole) else whole
    if len(whole) < 4 or not np.isfinite(whole).all() or not chords.all():
        return stretches
    run = np.concatenate([[0.0], np.cumsum(np.sqrt(chords))])
    fine = np.interp(np.arange(finer * (len(run) - 1) + 1) / finer, np.arange(len(run)), run)
    curve, drawn, begin = CubicSpline(run, whole)(fine), list[tuple[bool | None, np.ndarray]](), 0
    for stable, path in stretches:
        drawn.append((stable, curve[begin : begin + finer * (len(path) - 1) + 1]))
        begin += finer * (len(path) - 1)
    return drawn


def arrows(axes: Any, across: np.ndarray, up: np.ndarray, colour: str, count: int = 2) -> None:
    """Arrowheads along a curve that say which way time goes."""
    moves = np.hypot(np.diff(across) / (np.ptp(across) or 1.0), np.diff(up) / (np.ptp(up) or 1.0))
    moves[~np.isfinite(moves) | (moves > 0.2)] = 0.0  # not across a jump
    run = np.cumsum(moves)
    for share in (np.arange(count) + 0.3) / count:
        k = min(int(np.searchsorted(run, share * run[-1])), len(moves) - 1)
        if moves[k] > 0:
            style = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 13, "shrinkA": 0, "shrinkB": 0}
            axes.annotate("", (across[k + 1], up[k + 1]), (across[k], up[k]), arrowprops=style)


def sweep(
    axes: Any, joints: np.ndarray, faint: float = 0.10, more: float = 0.45, width: float = 1.0, strokes: Strokes = ()
) -> None:
    """Configurations of a mechanism (k x 2 x m; x down, y right), early ones faint; of one with strokes only rods."""
    rods = [(kind, chosen) for kind, chosen in strokes if BRUSHES[kind].pinned]
    for k, points in enumerate(joints):
        for _, (down, right) in outlines(points, rods, 1.0):
            axes.plot(right, -down, color=COLOURS[0], alpha=faint + more * k / len(joints), linewidth=width)


def configuration(axes: Any, scene: Scene, width: float, still: bool, named: bool) -> None:
    """The first configuration of a scene in black, springs thin, the ground filled; pivots that stand `still` as
    squares, and what each is in a legend where they are `named`."""
    down, right = scene.points[0]
    if not scene.strokes:
        marked = {"marker": "o" if named and right.size <= 12 else None, "markersize": 4.5}
        axes.plot(right, -down, color="black", linewidth=width, label="t = 0" if named else None, **marked)
        ends = [0, -1] if 0 <= tip(scene.points) < right.size - 1 else [0]  # of a linkage the last one is a pivot too
        style: Entries = {"color": "black", "markersize": 8 if named else 4, "linestyle": "none"}
        if still and (right.size > 1 or not named):  # a lone one is no pivot
            style["label"] = "fixed joint" if named else None
            axes.plot(right[ends], -down[ends], "s" if right.size > 1 else "o", **style)
        return
    label = "t = 0" if named else None
    for kind, (down, right) in outlines(scene.points[0], scene.strokes, extent(scene.points)):
        brush = BRUSHES[kind]
        draw, colour = axes.fill if brush.filled else axes.plot, "black" if brush.filled or brush.rigid else "0.4"
        draw(right, -down, color=colour, linewidth=brush.thick * width, label=label if brush.pinned else None)
        label = None if brush.pinned else label


def trail(axes: Any, path: np.ndarray, width: float, **more: Any) -> None:
    """The path (k x 2; x down, y right) of a mechanism's tip."""
    axes.plot(path[:, 1], -path[:, 0], color=COLOURS[1], linewidth=width, **more)


def landmark(axes: Any, name: str, across: float, up: float) -> None:
    """A libration point or another place of rest as a cross, a body as a disc, with its name beside it."""
    rests = name.startswith("L")
    axes.plot(across, up, "x" if rests else "o", color="0.35" if rests else "black", markersize=6, zorder=1.8)
    offset = {"xytext": (5, 6) if rests else (5, -13), "textcoords": "offset points"}
    clear = [withStroke(linewidth=2.5, foreground="white")]  # over curves
    axes.annotate(name, (across, up), fontsize=8, color="0.25", parse_math=False, path_effects=clear, **offset)


def plane(axes: Any) -> None:
    """Axes for what hangs: x down, y to the right, equal scales."""
    axes.set_aspect("equal", adjustable="datalim")
    dress(axes, "to the right (m)", "height (m)")


def widen(axes: Any, wide: float, tall: float) -> None:
    """What is so narrow (extents in m) that nothing would be seen of it drawn wider, which the axis says."""
    if 0 < wide < SLIVER * tall:
        axes.set_aspect(wide / tall / LEAST_SIDE, adjustable="datalim")
        axes.set_xlabel(f"to the right (m),\ndrawn {LEAST_SIDE * tall / wide:.3g} times as wide")


def line_style(index: int, count: int) -> Entries:
    """Colour and dashes of curve `index` of `count`: distinct up to 28, a sequential map beyond."""
    if count > len(COLOURS) * len(DASHES):
        return {"color": colormaps["cividis"](index / (count - 1)), "linewidth": 0.7}
    dash = DASHES[index // len(COLOURS)]
    return {"color": COLOURS[index % len(COLOURS)], "linestyle": dash, "linewidth": 1.4}


def save_all(figures: Mapping[str, Figure], folder: str | Path) -> list[Path]:
    """Write figures as PNG files of their names; returns their paths."""
    return [save_png(figure, Path(folder) / f"{name}.png") for name, figure in figures.items()]


def save_png(figure: Figure, path: Path) -> Path:
    """Write a figure whole or not at all."""
    return _saved(figure, path, format="png")


def save_both(figure: Any, stem: Path) -> list[Path]:
    """Write a figure as PNG and as SVG, without dates or random identifiers."""
    kinds = {"png": {"Software": None}, "svg": {"Date": None, "Creator": None}}
    with rc_context({"svg.hashsalt": stem.name, "svg.fonttype": "none"}):
        return [
            _saved(figure, stem.with_suffix(f".{kind}"), format=kind, metadata=told) for kind, told in kinds.items()
        ]


def _saved(figure: Any, path: Path, **more: Any) -> Path:
    buffer = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")  # which is drawn as a box
        figure.savefig(buffer, dpi=150, **more)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, buffer.getvalue())
    return path
