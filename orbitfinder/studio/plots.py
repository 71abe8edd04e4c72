"""The plots of the studio, as Plotly takes them: close returns, families with their events, Poincare sections."""

from __future__ import annotations

import math
from collections.abc import Sequence
from textwrap import wrap
from typing import Any

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.scales import lasting, unit_along, units
from orbitfinder.orbits.guesses.returns import CloseReturn
from orbitfinder.records.family import Event, Family, FamilyPoint
from orbitfinder.records.reading import Entries, Table
from orbitfinder.show.diagram import mark_of
from orbitfinder.show.svg import ranged
from orbitfinder.site.text import coordinate
from orbitfinder.studio.tasks import Cut, Settled

Trace = Entries
STABLE, UNSTABLE, MARK, OTHER = "#0072b2", "#d55e00", "#008060", "#8a94a0"
MOTIONS = (STABLE, UNSTABLE, "#7a3e9d", "#8a6d00")
DARK = {STABLE: "#56b4e9", UNSTABLE: "#f0a35e", MARK: "#3fc79a", MOTIONS[2]: "#cc99e0", MOTIONS[3]: "#d8bf4a"}
LOOKS = {"stable": (STABLE, "circle"), "unstable": (UNSTABLE, "circle-open"), "undecided": (OTHER, "square-open")}
"""Colours and shapes of orbits by their stability"""
POINTS, EVENTS, HERE = 0, 1, 2
"""The traces of a plot of families: the first two can be clicked, the third is where one is"""


def _figure(
    data: list[Trace], across: str, up: str, dark: bool, log: bool = False, key: Table | None = None,
    nothing: str = "",
) -> Entries:  # fmt: skip
    """A plot, under a legend of a `key` (names: colour, symbol), or `nothing` in words where there is none yet."""
    for trace in data:
        trace["showlegend"] = False
    empty = bool(nothing) and not any(len(trace["x"]) for trace in data)
    data += [_dots([None], [None], marker={"size": 9, "color": look[0], "symbol": look[1]}, showlegend=True, name=name)
             for name, look in (key or {}).items()]  # fmt: skip
    ink, line = ("#c9d1d9", "#313a43") if dark else ("#444c55", "#e3e7eb")
    for trace in data:
        for part in ("marker", "line"):
            colour = trace.get(part, {}).get("color")
            if dark and colour is not None:
                swapped = [DARK.get(c, c) for c in colour] if isinstance(colour, list) else DARK.get(colour, colour)
                trace[part]["color"] = swapped
    axis = {"gridcolor": line, "zerolinecolor": line, "linecolor": line, "automargin": True}
    upward = {"type": "log", "exponentformat": "power", "nticks": 6} if log else {}
    layout: Entries = {
        "height": 274 if key else 250, "margin": {"l": 60, "r": 12, "t": 34 if key else 10, "b": 48},
        "showlegend": bool(key), "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom"}, "hovermode": "closest",
        "paper_bgcolor": "rgba(0,0,0,0)", "plot_bgcolor": "rgba(0,0,0,0)", "font": {"color": ink, "size": 13},
        "xaxis": axis | {"title": {"text": across, "standoff": 10}},
        "yaxis": axis | upward | {"title": {"text": up, "standoff": 12}}, "uirevision": up,
    }  # fmt: skip
    if key and max(map(len, key)) < 20:
        layout["legend"] |= {"entrywidth": 112, "font": {"size": 12}}
    if empty:
        words = {
            "text": "<br>".join(wrap(nothing, 36)),
            "x": 0.5,
            "y": 0.5,
            "xref": "paper",
            "yref": "paper",
            "showarrow": False,
        }
        layout |= {"xaxis": {"visible": False}, "yaxis": {"visible": False}, "annotations": [words], "height": 120}
    return {"data": data, "layout": layout, "config": {"displayModeBar": False, "responsive": True}}


def _axis(name: str, unit: str) -> str:
    return f"{name}, {unit}" if unit else name


def _dots(
    x: Sequence[float | None], y: Sequence[float | None], said: Any = None, mode: str = "markers", **more: Any
) -> Trace:
    """A trace of dots, or of what else `mode` says, with what is `said` where the pointer is."""
    told = {"hoverinfo": "skip"} if said is None else {"hovertext": said, "hoverinfo": "text"}
    return {"x": [*x], "y": [*y], "mode": mode} | told | more


def _rings(x: Sequence[float], y: Sequence[float], size: int) -> Trace:
    marker = {"size": size, "color": "rgba(0,0,0,0)", "line": {"color": MARK, "width": 3}}
    return _dots(x, y, marker=marker)


def returns_figure(returns: Sequence[CloseReturn], picked: int | None, system: Table, dark: bool) -> Entries:
    """Period against miss; the more promising, the larger the dot."""
    sizes = [22 if k == 0 else max(9, 18 - 2 * k) for k in range(len(returns))]
    colours = [MARK if k == picked else STABLE for k in range(len(returns))]
    hover = [
        f"return {k + 1}: T = {lasting(near.period, system, 4)}, miss {near.distance:.2g}"
        for k, near in enumerate(returns)
    ]
    marker = {"size": sizes, "color": colours, "opacity": 0.9}
    misses = [max(near.distance, 1e-12) for near in returns]
    data = [_dots([near.period for near in returns], misses, hover, marker=marker)]
    key = {"searched from": (MARK, "circle"), "close return, the larger the more promising": (STABLE, "circle")}
    key = key if picked is not None else dict([*key.items()][1:]) if returns else {}
    return _figure(data, _axis("period T", units(system)["time"]), "miss, of the extent", dark, True, key,
                   "Where the motion comes back close enough, dots appear here.")  # fmt: skip


def family_figure(
    points: Sequence[FamilyPoint], events: Sequence[Event], here: FamilyPoint | None, others: Sequence[Family],
    parameter: str, system: Table, dark: bool,
) -> Entries:  # fmt: skip
    """The chosen family by stability, its events by their kind, where it is, and the others in grey; a legend."""
    looks = [LOOKS.get(point.stability.replace("marginal", "undecided"), LOOKS["stable"]) for point in points]
    key = {name: look for name, look in LOOKS.items() if look in looks}
    marks = [mark_of(event).symbol for event in events]
    key |= {event.kind.replace("_", " "): (MARK, mark) for event, mark in zip(events, marks, strict=True)}
    told = [f"T = {lasting(point.period, system, 5)}, {point.stability}" for point in points]
    words = [f"{k}: {event.words}" for k, event in enumerate(events)]
    dashed = {"color": OTHER, "width": 1.5, "dash": "dot"}
    data = [
        _dots([point.value for point in points], [1 / point.period for point in points], told, "lines+markers",
              marker={"size": 8, "color": [look[0] for look in looks], "symbol": [look[1] for look in looks]},
              line={"color": OTHER, "width": 1}),
        _dots([event.parameter for event in events], [1 / event.period for event in events], words,
              marker={"size": 13, "color": MARK, "symbol": marks}),
        _rings([here.value] if here else [], [1 / here.period] if here else [], 18),
        *(_dots(other.values("value").tolist(), (1 / other.values("period")).tolist(), other.name, "lines", line=dashed)
          for other in others),
    ]  # fmt: skip
    unit = units(system)
    across = _axis(parameter, unit_along(parameter, system))
    up = _axis("frequency 1/T", unit["time"] and f"1/{unit['time']}")
    return _figure(data, across, up, dark, key=key, nothing="Follow an orbit, and its family appears here.")


def section_figure(cut: Cut | None, dark: bool) -> Entries:
    """A Poincare section: motions in colours, chaotic ones grey crosses, the orbit as rings."""
    if cut is None:
        return _figure([_dots([], [])], "", "", dark, nothing="The section appears here.")
    made, (across, up) = cut.section, map(coordinate, cut.section.axes)
    colours = [OTHER if said == "chaotic" else MOTIONS[k % len(MOTIONS)] for k, said in enumerate(made.kinds)]
    kinds = made.kinds.tolist() if made.told else ["regular"] * len(made.starts)
    shapes = {"regular": "circle", "chaotic": "x-thin-open", "undecided": "square-open"}
    key = {said: (OTHER if said == "chaotic" else STABLE, shapes[said]) for said in shapes if said in kinds * made.told}
    key |= {"the orbit": (MARK, "circle-open")} if cut.crossings.size else {}
    hover = [f"motion {k + 1}: start here" for k in made.seeds.tolist()]
    marker = {"size": [4 if kinds[k] == "regular" else 5 for k in made.seeds.tolist()],
              "color": [colours[k] for k in made.seeds.tolist()],
              "symbol": [shapes[kinds[k]] for k in made.seeds.tolist()]}  # fmt: skip
    (x, y), (across_ring, up_ring) = made.points.T.tolist(), cut.crossings.T.tolist()
    data = [_dots(x, y, hover, marker=marker), _rings(across_ring, up_ring, 15)]
    return _figure(data, across, up, dark, key=key)


def portrait_figure(
    settled: Settled | None, names: Sequence[str], plane: list[int], box: np.ndarray, dark: bool
) -> Entries:
    """What a motion has come to, and the equilibrium, full where stable, else open; `box`: what is seen (2 x 2)."""
    data, rest = [_dots([], [], mode="lines", line={"color": UNSTABLE, "width": 2.4}), _dots([], [])], None
    if settled is not None:
        (data[0]["x"], data[0]["y"]), rest = settled.path[:, plane].T.tolist(), settled.rest
    key = {"motion, once it has settled": (UNSTABLE, "line-ew-open")} if settled is not None else {}
    if rest is not None:
        key |= {f"equilibrium, {rest.stability}": (STABLE, f"circle{'-open' * (rest.stability == 'unstable')}")}
        look = {"size": 12, "color": STABLE, "symbol": f"circle{'-open' * (rest.stability == 'unstable')}"}
        x, y = rest.state[plane].tolist()
        data[1] = _dots([x], [y], [f"equilibrium, {rest.stability}"], marker=look)
    figure = _figure(data, coordinate(names[plane[0]]), coordinate(names[plane[1]]), dark, key=key)
    for axis, side in zip(("xaxis", "yaxis"), np.array(ranged(box)).T.tolist(), strict=True):
        figure["layout"][axis]["range"] = side
    return figure


def clicked(event: Table) -> tuple[int, int] | None:
    """The trace and the point that were clicked; None where a page sends something else."""
    try:
        point = event["points"][0]
        return int(point.get("curveNumber", 0)), int(point.get("pointIndex", point.get("pointNumber")))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError):
        return None


def finite(value: Any) -> float:
    """A number that a page sent. Raises `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise InputError(f"number: {str(value)[:40]!r} is not finite; give another one")
    return float(value)
