"""Pictures of Poincare sections with orbits and manifolds in them, and of manifolds in the plane or in space."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection

from orbitfinder.errors import InputError
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, wrapped
from orbitfinder.records.orbit import Orbit
from orbitfinder.show.diagram import entitled
from orbitfinder.show.style import dress, landmark, legend, new_figure, save_png
from orbitfinder.show.svg import COLOURS, axis, greek
from orbitfinder.structures.manifold import Connection, Manifold, reach
from orbitfinder.structures.section import Section
from orbitfinder.structures.sections import check_plane, crossings, named_surface
from orbitfinder.structures.tori import crossed
from orbitfinder.structures.torus import Torus

GREYS = {"chaotic": "0.62", "undecided": "0.1"}
"""Colours of returns that belong to no regular motion"""
MOTIONS = COLOURS[2:6]
"""Those of regular motions, none of them a manifold's"""
REFUSED, PLANE = {"tube": "is a tube, not curves on a section; grow it without tube"}, re.compile(r"^\w+")
"""Kinds of manifolds that are not drawn there, and why; the component of a plane in words"""
SIDES = {"unstable": "#D55E00", "stable": "#0072B2"}
"""Colours of manifolds"""


def draw_section(
    section: Section | None,
    path: str | Path,
    *,
    orbits: Sequence[Orbit] = (),
    manifolds: Sequence[Manifold] = (),
    connections: Sequence[Connection] = (),
    tori: Sequence[Torus] = (),
    model: Model | None = None,
) -> Path:
    """Draw a section as PNG, with the crossings of orbits and tori, the curves of manifolds, the points of connections.

    Regular motions have four colours in turn, chaotic ones are grey, undecided ones black. Without a
    section the plane is that of the first manifold or connection. Raises `InputError` where they lie on different
    planes.
    """
    given = [record for record in (section, *manifolds, *connections) if record is not None]
    if not given:
        raise InputError("section: nothing to draw; give a section, a manifold or a connection")
    first = given[0]
    for record in given[1:]:
        check_plane(record, first)
    model = model or build_model(first.system)
    level = f", energy {first.energy:.8g}" if np.isfinite(first.energy) else ""
    plane, told = first.plane, re.fullmatch(r"(\w+ = )([-+.\de]+)(, .*)", first.plane)
    sizes = np.abs(first.states[np.isfinite(first.states)])
    if told is not None and abs(float(told[2])) <= 1e-14 * sizes.max(initial=0.0):  # the round-off of the states
        plane = f"{told[1]}0{told[3]}"
    plane = PLANE.sub(lambda name: greek(name[0]), plane)
    figure = new_figure(7.2, 6.2, entitled(first), f"section {plane}{level}")
    axes = figure.subplots()
    across, up = (model.state_names.index(name) for name in first.axes)
    if section is not None:
        _returns(axes, section)
    for manifold in manifolds:
        _curves(axes, manifold, model, (across, up))
    for way in connections:
        axes.plot(*way.states[:, [across, up]].T, "x", color="black", markersize=4, markeredgewidth=0.8,
                  label="its other crossings")  # fmt: skip
        axes.plot(way.state[across], way.state[up], "D", color="black", markersize=5, label=f"{way.kind} point")
    for k, torus in enumerate(tori):
        surface = named_surface(model, first.plane, first.axes)
        points = surface.chart(crossed(torus, surface))
        axes.plot(*points.T, ".", color="black", markersize=1.4, label="" if k else "torus")
    for orbit in orbits:
        axes.plot(*crossings(model, first, orbit).T, "o", color="white", markeredgecolor="black", markersize=6.5,
                  label=f"{orbit.name}: {orbit.stability}", zorder=5)  # fmt: skip
    _limits(axes, model, first.axes, section, manifolds, connections)
    dress(axes, axis(model, across), axis(model, up))
    legend(figure, axes, "lower center", ncols=3)
    return save_png(figure, Path(path))


def _returns(axes: Any, section: Section) -> None:
    """The returns, chaotic ones below; regular motions in colours that neighbours do not share."""
    points, kinds = section.points, section.kinds[section.seeds]
    size = float(np.clip(20_000 / max(section.returns, 1), 0.4, 6.0))
    if not section.told:
        axes.scatter(points[:, 0], points[:, 1], s=size, c=section.seeds, cmap="viridis", linewidths=0)
        return
    regular = kinds == "regular"
    for kind, colour in GREYS.items():
        axes.scatter(*points[kinds == kind].T, s=size, color=colour, linewidths=0, rasterized=True)
        if (kinds == kind).any():
            axes.plot([], [], "o", color=colour, markersize=3, label=kind)
    seeds = np.unique(section.seeds[regular])
    order = {int(seed): MOTIONS[k % len(MOTIONS)] for k, seed in enumerate(seeds)}
    colours = [order[int(seed)] for seed in section.seeds[regular]]
    axes.scatter(*points[regular].T, s=size, c=colours, linewidths=0, rasterized=True)
    axes.plot([], [], "o", color=MOTIONS[0], markersize=3, label="regular (colours: motions)")


def _curves(axes: Any, manifold: Manifold, model: Model, pair: tuple[int, int]) -> None:
    """The curves of a manifold on the section."""
    colour = SIDES[manifold.which]
    if why := REFUSED.get(manifold.kind):
        raise InputError(f"manifolds: {manifold.name} {why}")
    axes.plot(*manifold.point[list(pair)], "o", color="white", markeredgecolor="black", markersize=6.5, zorder=4.9)
    for k, curve in enumerate(manifold.curves):
        points = wrapped(curve, model.angular)[:, list(pair)]
        jumps = np.abs(np.diff(points, axis=0)).max(axis=1) > np.pi
        points = np.insert(points, np.flatnonzero(jumps & model.angular.any()) + 1, np.nan, axis=0)
        axes.plot(*points.T, color=colour, linewidth=0.9, label="" if k else f"{manifold.which} manifold")


def _limits(
    axes: Any, model: Model, names: Sequence[str], section: Section | None, manifolds: Sequence[Manifold],
    connections: Sequence[Connection],
) -> None:  # fmt: skip
    """What is drawn, but for what is far out."""
    ends = [manifold.reach(names) for manifold in manifolds]
    points = [way.states[:, [way.state_names.index(name) for name in names]] for way in connections]
    if section is not None:
        ends.append(reach(section.points, np.ones(section.returns)))
    ends += [(place.min(axis=0), place.max(axis=0)) for place in points]
    low, high = np.min([end[0] for end in ends], axis=0), np.max([end[1] for end in ends], axis=0)
    turns = [name in model.coordinates and model.angular[model.state_names.index(name)]
             for name in names]  # fmt: skip
    low, high = np.where(turns, np.maximum(low, -np.pi), low), np.where(turns, np.minimum(high, np.pi), high)
    room = np.where(high > low, 0.06 * (high - low), 1.0) + 1e-12 * np.abs(high)
    axes.set_xlim(low[0] - room[0], high[0] + room[0])
    axes.set_ylim(low[1] - room[1], high[1] + room[1])


def draw_manifolds(
    manifolds: Sequence[Manifold],
    path: str | Path,
    *,
    axes: Sequence[str] | None = None,
    orbits: Sequence[Orbit] = (),
    connections: Sequence[Connection] = (),
    model: Model | None = None,
) -> Path:
    """Draw tubes as PNG in two or three components (`axes`), with orbits and connections; by default those of
    what marks places in a plane, else the first three.

    Raises `InputError`.
    """
    if not manifolds:
        raise InputError("manifolds: none given; grow one with tube=")
    model = model or build_model(manifolds[0].system)
    flat = bool(model.landmarks) and model.degrees_of_freedom == 2
    names = tuple(axes) if axes is not None else model.state_names[: 2 if flat else 3]
    if len(names) not in (2, 3) or not set(names) <= set(model.state_names):
        known = ", ".join(model.state_names)
        raise InputError(f"axes: need two or three components, got {', '.join(names)}; this system has {known}")
    chosen = [model.state_names.index(name) for name in names]
    first, solid = manifolds[0], len(chosen) == 3
    multiplier = f"multiplier {first.multiplier:.6g}, displaced by {first.displacement:.2g}"
    figure = new_figure(7.6, 6.6, f"{entitled(first)}: manifolds", multiplier)
    panel: Any = figure.add_subplot(projection="3d") if solid else figure.subplots()
    for manifold in manifolds:
        lines = [wrapped(curve, model.angular)[:, chosen] for curve in manifold.curves if len(curve) > 1]
        which, colour = manifold.which, SIDES[manifold.which]
        if solid:
            for k, line in enumerate(lines):
                panel.plot(*line.T, color=colour, linewidth=0.45, alpha=0.6, label="" if k else which)
        else:
            panel.add_collection(LineCollection(lines, colors=colour, linewidths=0.45, alpha=0.6))
            panel.plot([], [], color=colour, label=which)
            panel.autoscale_view()
    for way in connections:
        panel.plot(*way.samples[:, chosen].T, color="black", linewidth=1.4, label=way.kind)
    for orbit in orbits:
        panel.plot(*orbit.samples[:, chosen].T, color="black", linewidth=1.8, linestyle="--", label=orbit.name)
    if len(chosen) == 2 and max(chosen) < model.degrees_of_freedom:  # bodies and places of rest
        low, high = panel.get_xlim()
        for name, place in model.landmarks.items():
            if low <= place[chosen[0]] <= high:
                landmark(panel, name, place[chosen[0]], place[chosen[1]])
    labels = [axis(model, i) for i in chosen]
    if solid:
        panel.set(xlabel=labels[0], ylabel=labels[1], zlabel=labels[2])
    else:
        dress(panel, *labels)
        if max(chosen) < model.degrees_of_freedom and not model.angular.any():
            panel.set_aspect("equal", adjustable="datalim")
    legend(figure, panel, "lower center", ncols=3)
    return save_png(figure, Path(path))
