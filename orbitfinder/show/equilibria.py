"""Pictures along a parameter as the field draws them: equilibria and cycles, solid where stable, with what happens."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from orbitfinder.families.diagram import NORM, BifurcationDiagram, drawn
from orbitfinder.families.entries import KINDS
from orbitfinder.families.equilibrium import Equilibria, Equilibrium, RestEvent
from orbitfinder.families.members import extents, norms
from orbitfinder.families.registry import Look, kind_of
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import End, Family
from orbitfinder.show.diagram import Diagram, entitled
from orbitfinder.show.plot import two_parameters
from orbitfinder.show.rest import stretched
from orbitfinder.show.style import (
    STRETCHES,
    dress,
    legend,
    new_figure,
    place_labels,
    rounded,
    save_all,
    told_in,
    with_word,
)
from orbitfinder.show.svg import COLOURS, axis

RESTS, OTHER = {
    "hopf": Look(size=6.0), "neutral_saddle": Look("x", colour="#8C8C8C"),
    "fold": Look("d", colour="#4D4D4D", size=6.5),
}, Look("*", size=9.0)  # fmt: skip
"""How events of equilibria look that families have not or otherwise, and ends of cycles, such as a homoclinic orbit"""
ORDINARY, SILENT, ENDLESS = (
    ("target", "point limit", "hopf", "merged", "returned", "stopped", "equilibrium"),
    ("turn", "neutral_saddle"),
    ("homoclinic", "heteroclinic", "saddle-node"),
)
"""Ends that are not marked, as nothing happens there or it is marked anyway; events whose parameters are not told; ends
at an infinite period, whose parameter is that there"""
MOST, LABELLED, LONG, NAMES = 6, 14, 30.0, ("cycles", "cycles born on cycles")
"""Components that are drawn, the first; labels; ratio of periods drawn in logarithms; curves of cycles by birth"""
ROBUST, ROOM, MARGIN, CLOSE = (2.0, 98.0), 0.3, 0.05, 0.01
"""Percentiles of what is drawn, shares: of their distance, seen beyond them; left empty; of labels that are close"""


def far_apart(heights: np.ndarray) -> bool:
    """Whether positive numbers are to be drawn in logarithms."""
    return bool(heights.min() > 0 and heights.max() > LONG * heights.min())


class Panel:
    """Axes on which curves are drawn by one number of each point; `shown` is the legend of all panels."""

    def __init__(self, axes: Any, shown: dict[str, Any]) -> None:
        self.axes, self.shown = axes, shown
        self.labels, self.heights = list[tuple[str, float, float]](), list[np.ndarray]()

    def line(
        self, stretches: Sequence[tuple[bool | None, np.ndarray]], colour: str, name: str, plain: bool = True
    ) -> None:
        """A curve: places (k x 2) that are stable or not, or of which nothing decides."""
        self.heights += [path[:, 1] for _, path in stretches]
        for stable, path in rounded(stretches) if plain else stretches:
            word, line = STRETCHES[stable]
            style = {"linestyle": line, "linewidth": 1.8 if stable else 1.2}
            self.axes.plot(*path.T, color=colour, **style)
            self.shown.setdefault(word, Line2D([], [], color="0.3", **style))
        self.shown.setdefault(name, Line2D([], [], color=colour, linewidth=2.4))

    def mark(self, kind: str, place: Sequence[float], resting: bool = False) -> None:
        """Something that happens at a place, to equilibria or to cycles, with the parameter there."""
        look: Look = RESTS[kind] if resting and kind in RESTS else KINDS[kind].look if kind in KINDS else OTHER
        name = kind.replace("_", " ") + {"fold": (" of cycles", " of equilibria")}.get(kind, ("", ""))[resting]
        style = {"marker": look.marker, "markersize": look.size, "linestyle": "none", "color": look.colour, "zorder": 4}
        drawn = self.axes.plot(*place, markerfacecolor="white" if look.hollow else look.colour, **style)
        self.shown.setdefault(name.replace("hopf", "Hopf"), drawn[0])
        if kind not in SILENT:
            self.labels.append((f"{place[0]:.5g}", float(place[0]), float(place[1])))

    def written(self, span: float) -> list[tuple[str, float, float]]:
        """The labels, of those nearer to each other than a share of what is seen the first."""
        apart = {round(label[1] / (CLOSE * span)): label for label in reversed(self.labels)}
        return list(apart.values())[::-1][:LABELLED]

    def rest(self, rest: Equilibria, height: Callable[[np.ndarray], float]) -> None:
        """Equilibria by a number of their states."""
        both: tuple[Equilibrium | RestEvent, ...] = (*rest.points, *rest.events)
        places = sorted(both, key=lambda place: place.arclength)
        values = [place.value if isinstance(place, Equilibrium) else place.parameter for place in places]
        line = np.column_stack([values, [height(place.state) for place in places]])
        self.line([(stable, line[part]) for part, stable in stretched(places)], COLOURS[0], "equilibria")
        if len(places) == 1:
            self.axes.plot(*line.T, "o", color=COLOURS[0])
        for event in rest.events:
            self.mark(event.kind, (event.parameter, height(event.state)), True)

    def endless(self, end: End, place: np.ndarray) -> None:
        """The end of cycles at an infinite period: where the parameter goes, and that the period goes on."""
        style = {"color": OTHER.colour, "linestyle": ":", "linewidth": 1.0}
        self.shown.setdefault("infinite period", self.axes.axvline(end.parameter, **style))
        self.axes.annotate(
            "", (end.parameter, 1.0), (place[0], place[1]), ("data", "axes fraction"), "data",
            arrowprops={"arrowstyle": "->", "color": OTHER.colour, "shrinkA": 0.0, "shrinkB": 0.0},
        )  # fmt: skip

    def cycles(self, family: Family, heights: np.ndarray, name: str, periods: bool = False) -> None:
        """Cycles by a number of each point and then of each event, their periods maybe."""
        drawn = Diagram(family, (family.parameter, ""), np.column_stack([family.places[:, 0], heights]))
        self.line(drawn.stretches, COLOURS[NAMES.index(name) + 2], name, not (periods and far_apart(heights)))
        for event, place in zip(family.events, drawn.events, strict=True):
            if kind_of(event.kind).critical and event.kind not in SILENT:
                self.mark(event.kind, place)
        last = int(np.argmax([abs(point.arclength) for point in family.points]))
        for end, k in zip(family.ends, (last,) if len(family.ends) == 1 else (0, -1), strict=False):
            if periods and end.kind in ENDLESS and end.parameter is not None:
                self.endless(end, drawn.points[k])
            elif end.kind not in ORDINARY:
                self.mark(end.kind, drawn.points[k])

    def window(self) -> None:
        """What is seen: everything, unless little of it runs far off."""
        known = np.concatenate(self.heights)
        low, high = np.percentile(known, ROBUST)
        low, high = max(known.min(), low - ROOM * (high - low)), min(known.max(), high + ROOM * (high - low))
        margin = MARGIN * ((high - low) or abs(high) or 1.0)
        self.axes.set_ylim(low - margin, high + margin)


def save_diagram_figure(diagram: BifurcationDiagram, folder: str | Path, model: Model) -> list[Path]:
    """Write `diagram.png`: equilibria with the least and greatest values of cycles, and below their periods."""
    families = [curve for curve in diagram.curves if isinstance(curve.record, Family)]
    number = drawn(diagram.coordinate, model)
    norm = number == model.degrees_of_freedom
    counts = "\n".join(textwrap.wrap(diagram.counts, 80))
    figure = new_figure(8.0, 6.8 if families else 4.8, entitled(diagram), counts)
    axes = figure.subplots(
        2 if families else 1, 1, sharex=True, squeeze=False, height_ratios=(2.2, 1)[: 1 + bool(families)]
    )
    shown: dict[str, Any] = {}
    upper, *below = (Panel(each, shown) for each in axes.ravel())
    for curve in diagram.curves:
        if isinstance(curve.record, Equilibria):
            upper.rest(curve.record, lambda state: float(np.linalg.norm(state) if norm else state[number]))
            for event in (event for event in curve.record.events if below and np.isfinite(event.period)):
                below[0].mark(event.kind, (event.parameter, event.period), True)
    for curve in families:
        name = NAMES[curve.parent.endswith("family.json")]
        for sizes in [norms(curve.record, model)] if norm else extents(curve.record, model)[:, ::-1, number].T:
            upper.cycles(curve.record, sizes, name)
        below[0].cycles(curve.record, np.array([member.period for member in curve.record.members]), name, True)
    across = with_word(diagram.parameter, diagram.system)
    dress(upper.axes, "" if below else across, NORM if norm else axis(model, number))
    for panel in below:
        periods = np.concatenate(panel.heights)
        panel.axes.set_yscale("log" if far_apart(periods) else "linear")
        dress(panel.axes, across, "period (s)")
    upper.window()
    legend(figure, shown, "lower center", ncols=4)
    room = MARGIN / 2 * (diagram.between[1] - diagram.between[0])
    upper.axes.set_xlim(*sorted((diagram.between[0] - room, diagram.between[1] + room)))
    place_labels(figure, upper.axes, upper.written(abs(diagram.between[1] - diagram.between[0])), 8.0)
    return save_all({"diagram": told_in(figure, diagram.system)}, folder)


def save_equilibria_figure(equilibria: Equilibria, folder: str | Path, model: Model) -> list[Path]:
    """Write `equilibria.png`, a panel for each component, of a curve in two parameters `two_parameters.png`."""
    if equilibria.curve:
        return save_all({"two_parameters": two_parameters([equilibria])}, folder)
    size = equilibria.points[0].state.size
    count = min(size if model.rates is not None else model.degrees_of_freedom, MOST)
    columns = min(count, 3)
    rows = -(-count // columns)
    many = len(equilibria.points)
    words = f"{many} {'equilibrium' if many == 1 else 'equilibria'} along {equilibria.parameter}"
    figure, shown = new_figure(3.6 * columns + 1.0, 3.2 * rows + 1.0, entitled(equilibria), words), dict[str, Any]()
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for k, axes in enumerate(panels):
        if k >= count:
            axes.set_visible(False)
            continue
        Panel(axes, shown).rest(equilibria, lambda state, k=k: float(state[k]))  # type: ignore[misc]
        dress(axes, with_word(equilibria.parameter, equilibria.system), axis(model, k))
    legend(figure, shown, "lower center", ncols=4)
    return save_all({"equilibria": figure}, folder)
