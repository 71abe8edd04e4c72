"""Pictures of orbits, of families and of atlases."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import LogLocator, MaxNLocator, StrMethodFormatter

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.atlas.report import discovery
from orbitfinder.atlas.store import Atlas, AtlasRow, Filter
from orbitfinder.errors import InputError, plural
from orbitfinder.families.equilibrium import Equilibria, RestEvent
from orbitfinder.families.members import MemberMotion, amplitudes, motions, whole
from orbitfinder.loops.control import history
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, positions
from orbitfinder.mechanics.scales import given_units, unit_names, units
from orbitfinder.orbits.course import Course, course_of
from orbitfinder.problemfile.auto import branches
from orbitfinder.records.family import UNITS, Event, Family, number_of, value_of
from orbitfinder.records.orbit import Orbit
from orbitfinder.show.diagram import Diagram, entitled, frequencies, mark_of
from orbitfinder.show.facts import conserves, has_path, number
from orbitfinder.show.paths import family_paths, path_views
from orbitfinder.show.scene import Scene, evenly, tip
from orbitfinder.show.style import (
    LEAST_SIDE,
    STRETCHES,
    arrows,
    configuration,
    dress,
    legend,
    line_style,
    new_figure,
    place_labels,
    plane,
    rounded,
    save_all,
    save_png,
    sweep,
    told_in,
    trail,
    widen,
    with_word,
)
from orbitfinder.show.svg import COLOURS, axis, label

MOST_PORTRAITS = 12
MOST_IN_LEGEND, MOST_BELOW, DECADES, RANGES = 12, 4, 1e3, "^(amplitude|min|max)_"


def save_figures(orbit: Orbit | Family, folder: str | Path, model: Model | None = None) -> list[Path]:
    """Write the four figures of an orbit, or those of a family, as PNG files.

    Without energy or links there are fewer; what moves in a plane or in space has its path from every side in place
    of links. An orbit without samples is integrated again.

    Args:
        orbit: an Orbit or a Family.
        folder: where.
        model: needed only for systems that no file describes.

    Returns:
        The paths.

    Raises:
        InputError: where they cannot be written.

    Examples:
        >>> [path.name for path in of.save_figures(orbit, ".")]
        ['time_histories.png', 'phase_portraits.png', 'energy_error.png', 'swept_configuration.png']
    """
    model = model or build_model(orbit.system)
    if isinstance(orbit, Family):
        return save_family_figures(orbit, folder, model)
    orbit = whole(orbit, model)
    figures = {
        "time_histories": time_histories(orbit, model),
        "phase_portraits": phase_portraits(orbit, model),
    }
    if orbit.control is not None:
        figures["controls"] = controls(orbit)
    elif np.isfinite(orbit.energy) and (model.smooth or model.conservative):
        figures["energy_error"] = energy_error(orbit, model)
    if has_path(model):
        figures["path"] = path_views(orbit, model)
    elif model.points is not None:
        figures["swept_configuration"] = swept_configuration(orbit, model)
    return _saved(figures, folder, orbit.system)


def _saved(figures: Mapping[str, Figure], folder: str | Path, system: Mapping[str, Any]) -> list[Path]:
    """Figures as PNG files, in the system's units."""
    return save_all({name: told_in(figure, system) for name, figure in figures.items()}, folder)


def heading(orbit: Orbit, what: str) -> tuple[str, str]:
    """The two lines above a figure: the orbit's title, and what is shown of it."""
    return orbit.title or orbit.name, f"{what}, T = {orbit.period:.6g} s"


def _unit(model: Model, suffix: str = "") -> str:
    known = " or ".join(f"{unit}{suffix}" for unit in dict.fromkeys(unit_names(model)) if unit)
    return f" ({known})" if known else ""


def time_histories(orbit: Orbit, model: Model) -> Figure:
    """Coordinates and velocities over one period; of a first-order system each component on its own scale.

    Events of a hybrid orbit are marked and named.
    """
    course = course_of(orbit, model)
    times, states = course.times, course.samples
    n = model.degrees_of_freedom
    figure = new_figure(8.0, 6.0, *heading(orbit, "time histories"))
    if model.rates is not None:
        chosen = evenly(n, MOST_PORTRAITS)  # components below each other
        columns = states[:, chosen].T
        panels = _below(figure, times, columns, [axis(model, k) for k in chosen], course.period)
        for axes, column in zip(panels, columns, strict=True):
            middle, spread = np.nanmean(column), np.nanmax(np.abs(column - column[0]))
            if 0 < spread < 1e-9 * abs(middle):  # what stands still must not have its round-off magnified
                axes.set_ylim(*(middle + np.array([-0.5, 0.5]) * abs(middle)))
            elif 0 < DECADES * np.nanmin(column) < np.nanmax(column):
                axes.set_yscale("log")
        mark_events(panels, course)
        return figure
    upper, lower = figure.subplots(2, 1, sharex=True)
    per = f"/{units(model.system)['time']}"
    for i in range(n):
        style = line_style(i, n)
        upper.plot(times, states[:, i], label=label(model.state_names[i]), **style)
        lower.plot(times, states[:, n + i], **style)
    dress(upper, "", f"coordinates{_unit(model)}")
    dress(lower, "time (s)", f"velocities{_unit(model, per)}")
    lower.set_xlim(0.0, orbit.period)
    mark_events([upper, lower], course)
    if "linestyle" in line_style(0, n):
        legend(figure, upper, "right center", ncols=1 if n <= MOST_IN_LEGEND else 2)
    else:
        scale = ScalarMappable(Normalize(1, n), "cividis")
        figure.colorbar(scale, ax=[upper, lower], label="coordinate number", aspect=40)
    return figure


def mark_events(panels: Sequence[Any], course: Course) -> None:
    """A line at every event of a hybrid orbit, and its name above the first panel unless there are many."""
    for moment, name in course.events:
        for axes in panels:
            axes.axvline(moment, color="0.45", linestyle=":", linewidth=0.9)
        if len(course.events) <= MOST_IN_LEGEND:
            panels[0].annotate(
                name, (moment, 1.0), (0, 2), xycoords=("data", "axes fraction"), textcoords="offset points",
                ha="right" if moment == course.period else "center", fontsize=8, color="0.3",
            )  # fmt: skip


def controls(orbit: Orbit) -> Figure:
    """The controls of a motion over its period, below each other, with their limits dashed."""
    assert orbit.control is not None
    times, values = history(orbit.control, orbit.period)
    names, limits = orbit.control["names"], orbit.control["limits"]
    figure = new_figure(8.0, 1.6 + 2.0 * len(names), *heading(orbit, "controls"))
    called = [with_word(name, orbit.system) for name in names]
    for axes, name, column in zip(_below(figure, times, values.T, called, orbit.period), names, values.T, strict=True):
        for bound in limits.get(name, ()):
            if np.isfinite(bound) and abs(bound) <= 3 * np.abs(column).max():
                axes.axhline(bound, color="0.5", linewidth=0.7, linestyle="--")
    return figure


def _below(
    figure: Figure, times: np.ndarray, columns: np.ndarray, names: Sequence[str], period: float
) -> list[Any]:  # fmt: skip
    """Panels below each other, a curve (k) over the times (k) of a period in each."""
    panels = list(np.atleast_1d(figure.subplots(len(names), 1, sharex=True)))
    for axes, column, name in zip(panels, columns, names, strict=True):
        axes.plot(times, column, color=COLOURS[0], linewidth=1.3)
        dress(axes, "time (s)" if axes is panels[-1] else "", name)
    panels[-1].set_xlim(0.0, period)
    return panels


def phase_portraits(orbit: Orbit, model: Model) -> Figure:
    """Velocity against coordinate, one panel each (at most 12, evenly chosen); see `Model.planes`.

    Jumps of a hybrid orbit are dashed.
    """
    course = course_of(orbit, model)
    states = course.samples
    chosen = [model.planes[k] for k in evenly(len(model.planes), MOST_PORTRAITS)]
    columns = min(len(chosen), 3 if len(chosen) != 4 else 2)
    rows = -(-len(chosen) // columns)
    figure = new_figure(max(3.2 * columns, 5.0), max(2.9 * rows, 3.6) + 0.5, *heading(orbit, "phase portraits"))
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    dashed = {"linestyle": "--", "color": COLOURS[0], "linewidth": 0.8, "alpha": 0.7}
    for axes, (i, j) in zip(grid, chosen, strict=False):
        axes.plot(states[:, i], states[:, j], color=COLOURS[0], linewidth=1.3)
        for k, (before, after) in enumerate(course.resets):
            axes.plot([before[i], after[i]], [before[j], after[j]], label="" if k else "reset", **dashed)
        axes.plot(states[0, i], states[0, j], "o", color=COLOURS[1], markersize=5, label="t = 0")
        arrows(axes, states[:, i], states[:, j], COLOURS[0])
        dress(axes, axis(model, i), axis(model, j))
        axes.locator_params(axis="x", nbins=4)
        axes.margins(0.08)
    for axes in grid[len(chosen) :]:
        axes.set_visible(False)
    legend(figure, grid[0], "lower right")
    return figure


def swept_configuration(orbit: Orbit, model: Model) -> Figure:
    """The links over one period, early ones faint, and the path of the tip; gravity points down the page.

    What walks is shown for three periods, on its ground.
    """
    course, snapshots = course_of(orbit, model), 48
    rounds = 3 if course.walks else 1
    if course.jumps:
        moments = np.linspace(0.0, rounds * course.period, rounds * snapshots // (2 if course.walks else 1) + 1)[:-1]
        rows = []  # broken by nan at events
        for k in range(rounds):
            for piece in course.pieces:
                rows.append(positions(piece.model, piece.states) + (piece.origin + k * course.stride)[:, None])
                rows.append(np.full((1, *rows[-1].shape[1:]), np.nan))
        joints, paths = course.positions(moments), np.concatenate(rows)
    else:
        paths = positions(model, orbit.samples)
        joints = paths[:: max(1, (len(paths) - 1) // snapshots)]
    tall, wide = np.ptp(joints, axis=(0, 2))
    high = float(np.clip(1.7 + 8.0 * tall / wide, 3.6, 6.4)) if course.walks else 6.4
    shape = (float(np.clip(1.2 + (high - 1.7) * wide / tall, 6.4, 9.0)) if course.walks else 6.4, high)
    figure, end = new_figure(*shape, *heading(orbit, "swept configuration")), tip(paths)
    axes = figure.subplots()
    sweep(axes, joints, strokes=model.strokes)
    trail(axes, paths[:, :, end], 1.4, label="path of the tip")
    still = not course.jumps or np.ptp(joints[:, :, 0], axis=0).max() == 0
    configuration(axes, Scene(joints, strokes=model.strokes), 2.0, still, named=True)
    plane(axes)
    axes.margins(0.06)
    seen = np.concatenate([joints[:, 1].ravel(), paths[:, 1, end]])
    if course.grounds(np.zeros(1)) is None:
        widen(axes, np.nanmax(seen) - np.nanmin(seen), float(np.ptp(joints[:, 0])))
    draw_ground(axes, course)
    legend(figure, axes, "lower center", ncols=4)
    return figure


def draw_ground(axes: Any, course: Course) -> None:
    """What the machine stands on or hits, without changing what is seen; where it moves, its places at equal times."""
    moments = np.linspace(0.0, course.period, 8, endpoint=False)
    if (lines := course.grounds(moments)) is None:
        return
    moving = not course.walks and np.ptp(lines, axis=0).max() > 0
    low, high = (np.array(limits) for limits in (axes.get_xlim(), axes.get_ylim()))
    wide, tall = np.ptp(low), np.ptp(high)
    low, high = (each + np.array([-1, 1]) * max(0.0, LEAST_SIDE * side - own) / 2
                 for each, side, own in ((low, tall, wide), (high, wide, tall)))  # fmt: skip
    axes.set_aspect("equal", adjustable="box")
    for k, (down, right) in enumerate(lines if moving else lines[:1]):
        shade = {"alpha": 0.35} if moving else {}
        axes.plot(right, -down, color="0.35", linewidth=1.6, zorder=1, label="" if k else "ground", **shade)
    axes.set(xlim=low, ylim=high)


def energy_error(orbit: Orbit, model: Model) -> Figure:
    """Energy of the samples minus that of the first, with the energies exchanged for scale."""
    course = course_of(orbit, model)
    times, (kinetic, potential) = course.times, course.energies
    total = kinetic + potential
    figure = new_figure(8.0, 5.6, *heading(orbit, "energy"))
    upper, lower = (None, figure.subplots()) if model.rates is not None else figure.subplots(2, 1, sharex=True)
    if upper is not None:  # a first-order system's energy is one expression
        upper.plot(times, kinetic, label="kinetic", **line_style(0, 3))
        upper.plot(times, potential - np.nanmin(potential), label="potential above its least", **line_style(1, 3))
        dress(upper, "", "energy (J)")
        upper.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False, borderaxespad=0.2)
    lower.plot(times, total - total[0], color=COLOURS[2], linewidth=1.1)
    lower.axhline(0.0, color="0.5", linewidth=0.7)
    dress(lower, "time (s)", "E(t) \N{MINUS SIGN} E(0) (J)")
    lower.set_xlim(0.0, orbit.period)
    mark_events([lower], course)
    return figure


STABLE, UNSTABLE, UNDECIDED = COLOURS[0], COLOURS[1], COLOURS[4]
"""Colours of the stretches of one family"""


def save_family_figures(family: Family, folder: str | Path, model: Model) -> list[Path]:
    """Write the figures of a family as PNG files; returns their paths.

    A forced family has its response in place of frequency and energy, another that dissipates both.
    """
    figures = {} if model.forced else {"frequency_energy": frequency_energy([family])}
    if len(family.parameters) > 1:
        figures = {"two_parameters": two_parameters([family])}
    elif not model.conservative:
        figures["response"] = response([family], model)
    if any(point.floquet_multipliers.size for point in family.points):
        figures |= {"multipliers_plane": multipliers_plane(family), "multipliers": multipliers_along(family)}
    if len(family.points) > 1:
        shown = motions(family, model)
        figures["gallery"] = gallery(family, shown)
        if has_path(model):
            figures["paths"] = family_paths(family, shown, model)
    return _saved(figures, folder, family.system)


def save_frequency_energy(families: Sequence[Family | Orbit], path: Path, level: float | None = None) -> Path:
    """Write one picture of families (see `frequency_energy`). Raises `InputError` for what is no family."""
    drawn = list[Family]()
    for family in families:
        if isinstance(family, Family) and len(family.parameters) < 2 and np.isfinite(family.values("energy")).all():
            drawn.append(family)
            continue
        raise InputError(f"{family.name}: --together and --level take families of orbits with an energy; leave it out")
    return save_png(frequency_energy(drawn, level=level), path)


def save_chosen(
    families: Sequence[Family], path: Path, across: str | None = None, up: str | None = None,
    xlim: Sequence[float] | None = None, beside: Path | None = None, model: Model | None = None,
) -> Path:  # fmt: skip
    """Write families in other coordinates: energy, period, frequency, arclength, a parameter, a watched number,
    amplitude_C, min_C or max_C of a coordinate C.

    `across` is by default the parameter, `up` the frequency, `xlim` the window; `model` is of what no file describes.
    Points of the b.NAME `beside` of AUTO-07p are drawn under them, then `up` is by default the period. Raises
    `InputError`.
    """
    if xlim is not None and (len(xlim) != 2 or not xlim[0] < xlim[1]):
        raise InputError(f"xlim: {list(xlim)}; give LOW,HIGH, the lower first")
    if other := next((record for record in families if not isinstance(record, Family)), None):
        raise InputError(f"{other.name}: --across, --up, --xlim and --beside take families; leave them out")
    names = across or families[0].parameter, up or ("period" if beside else "frequency")
    model, words = model or build_model(families[0].system), [_called(name) for name in names]
    figure = new_figure(8.0, 5.6, f"{entitled(*families)}: {words[1]} over {words[0]}")
    own = dict(zip(model.state_names, unit_names(model), strict=False))
    known = {"energy": "J", "period": "s", **own, **given_units(model.system)}
    known |= {} if "frequency" in families[0].parameters else {"frequency": "1/s"}
    told = [known.get(re.sub(RANGES, "", name)) for name in names]
    called = [f"{word} ({unit})" if unit else word for word, unit in zip(words, told, strict=True)]
    own_axes = {name: axis_name(families[0], k) for k, name in enumerate(families[0].parameters)}
    called = [own_axes.get(name, word) for name, word in zip(names, called, strict=True)]
    axes = figure.subplots()
    places = [np.column_stack([_quantity(family, name, model) for name in names]) for family in families]
    _curves(
        figure, axes, [Diagram(family, (called[0], called[1]), at) for family, at in zip(families, places, strict=True)]
    )
    dress(axes, *called)
    if beside is not None:
        *place, number = branches(beside, (*names, "PT")).T
        axes.scatter(
            *place, 20, np.where(number < 0, "0.5", "none"), edgecolors="0.5", zorder=1,
            label=f"{beside.name}: AUTO, filled where stable",
        )  # fmt: skip
        axes.legend(frameon=False)
    if xlim is not None:
        axes.set_xlim(*xlim)
        seen = np.vstack(places)
        inside = seen[(seen[:, 0] >= xlim[0]) & (seen[:, 0] <= xlim[1]), 1]
        if inside.size:
            room = 0.05 * float(np.ptp(inside)) or 0.05 * abs(float(inside[0])) or 1.0
            axes.set_ylim(inside.min() - room, inside.max() + room)
    return save_png(told_in(figure, families[0].system), path)


def _called(name: str) -> str:
    """A column of a family in words."""
    words = {"amplitude": "amplitude of", "min": "least", "max": "greatest"}
    return re.sub(RANGES, lambda kind: f"{words[kind[1]]} ", name)


def _quantity(family: Family, name: str, model: Model) -> np.ndarray:
    """A number of every point and then of every event; a parameter's own name comes first. Raises `InputError`."""
    own = (*family.parameters, *family.points[0].free, *family.points[0].watch)
    if name == "frequency" and name not in own:
        return frequencies(family)
    ranges = [f"{word}_{each}" for each in model.coordinates
              for word in ("amplitude", "min", "max")]  # fmt: skip
    if name in ranges and name not in own:
        tables = family.tables(model)
        return np.concatenate([tables[of][name] for of in ("points", "events")])
    known = dict.fromkeys(["energy", "period", "frequency", "arclength", *own, *ranges])
    if name not in known:
        raise InputError(f"{name}: not known along {family.name}; it has {', '.join(known)}")
    read = value_of if name == "arclength" else number_of
    return np.array([float(read(member, name)) for member in family.members])


def gallery(family: Family, shown: Sequence[MemberMotion]) -> Figure:
    """Orbits along the family, each over one period: swept links and the path of the tip, or the path in (q1, q2)."""
    columns = min(4, len(shown))
    rows = -(-len(shown) // columns)
    figure = new_figure(2.6 * columns, 2.9 * rows + 0.4, f"{entitled(family)}: orbits along the family")
    grid = np.atleast_1d(figure.subplots(rows, columns)).ravel()
    for axes, motion in zip(grid, shown, strict=False):
        if motion.joints is None:
            axes.plot(motion.states[:, 0], motion.states[:, 1], color=COLOURS[1], linewidth=1.2)  # (q, v) for n = 1
        else:
            sweep(axes, motion.joints[:: max(1, len(motion.joints) // 30)], width=0.8, strokes=motion.strokes)
            trail(axes, motion.joints[:, :, tip(motion.joints)], 1.1)
            configuration(axes, Scene(motion.joints, strokes=motion.strokes), 1.6, still=True, named=False)
        point = motion.point
        where = f"{family.parameter} {point.value:.5g}" if family.parameter in point.free else f"{point.energy:.5g} J"
        where = where.replace("-", "\N{MINUS SIGN}")
        axes.set_title(f"{where}, {point.period:.4g} s\n{point.stability}", fontsize=8)
        axes.set_aspect("equal", adjustable="datalim")
        axes.margins(0.06)
        axes.tick_params(labelsize=7)
        dress(axes, "", "")
    for axes in grid[len(shown) :]:
        axes.set_visible(False)
    if shown[0].joints is not None:
        figure.supxlabel("to the right (m)", fontsize=8)
        figure.supylabel("height (m)", fontsize=8)
    return figure


def frequency_energy(
    families: Sequence[Family],
    marks: dict[str, tuple[float, float]] | None = None,
    title: str = "",
    level: float | None = None,
) -> Figure:
    """Frequency against energy: one family by stability, several by a colour each, events marked.

    Families in a physical parameter, along which the energy may not change, are drawn against that. `marks` are
    further orbits to show, name -> (energy, period). With a `level` (J) the axis is the logarithm of the distance
    from it, which opens what gathers at a saddle or at rest. The numbers of one family are those of `--switch`.
    """
    freed = families[0].parameter if all(families[0].parameter in family.points[0].free for family in families) else ""
    figure = new_figure(8.0, 5.6, title or f"{entitled(*families)}: frequency and {freed or 'energy'}")
    axes = figure.subplots()

    def away(energy: float) -> float:
        return energy if level is None else abs(energy - level) or np.nan

    distance = "energy (J)" if level is None else f"distance of the energy from {level:g} J (J)"
    called = axis_name(families[0]) if freed else distance, "frequency (1/s)"
    drawn = []
    for each in families:
        levels = [away(member.energy) for member in each.members]
        drawn.append(
            Diagram(each, called, np.column_stack([each.places[:, 0] if freed else levels, frequencies(each)]))
        )
    _curves(figure, axes, drawn, plain=level is None)
    labels = [(name, away(energy), 1.0 / period) for name, (energy, period) in (marks or {}).items()]
    for _, energy, frequency in labels:
        axes.plot(energy, frequency, "*", color="black", markersize=10, zorder=5)
    if level is not None and not freed:
        axes.set_xscale("log")
    dress(axes, *called)
    if len(families) == 1:
        numbered = [k for k, event in enumerate(families[0].events) if mark_of(event).numbered]
        labels += [(str(k), *drawn[0].events[k]) for k in (numbered if len(numbered) <= 24 else [])]
    place_labels(figure, axes, labels)
    return figure


FAR = 4.0
"""Curves this many times as wide as their special points lie apart are drawn about those only"""


def two_parameters(families: Sequence[Family | Equilibria]) -> Figure:
    """Curves of bifurcations in the plane of their two parameters, with a mark at each point of codimension two.

    Curves of the same two parameters are drawn together, neutral saddles dotted; of those that go far off what is about
    their special points. Raises `InputError` for families in one parameter.
    """
    names = families[0].parameters
    for family in families:
        if len(family.parameters) < 2 or set(family.parameters) != set(names):
            raise InputError(
                f"{family.name}: varies {', '.join(family.parameters)}; give curves in {' and '.join(names)} alone"
            )
    figure = new_figure(8.0, 5.6, f"{entitled(*families)}: bifurcations in two parameters")
    axes, shown, labels = figure.subplots(), dict[str, Any](), list[tuple[str, float, float]]()
    for k, curve in enumerate(families):
        places, count = curve.places if curve.parameters == names else curve.places[:, ::-1], len(curve.points)
        events, test = places[count:], curve.curve["test"]
        order = np.argsort([each.arclength for each in (*curve.points, *curve.events)], kind="stable")
        known = [getattr(curve.points[j], "kind", "") if j < count else None for j in order]
        kinds = [str(known[max(j - 1, 0)] or "") if kind is None else kind for j, kind in enumerate(known)]
        line = places[order]
        ways = np.diff(line, axis=0) / nonzero(np.ptp(line, axis=0))
        back = {k + 2 for k in np.flatnonzero((ways[1:] * ways[:-1]).sum(axis=1) < 0) if order[k + 1] >= count}  # cusps
        cuts = {j for j in range(1, len(kinds)) if kinds[j] != kinds[j - 1]} | back
        for start, stop in pairwise(sorted({0, len(kinds)} | cuts)):
            ((_, path),) = rounded([(True, line[max(start - 1, 0) : stop])])
            beyond = kinds[start] == "neutral_saddle"
            style = {"linestyle": ":" if beyond else "-", "color": COLOURS[k % len(COLOURS)], "linewidth": 1.8}
            told = f"in {test['detail']}" if test["detail"] in names else test["detail"]
            called = kinds[start] if beyond else f"{test['kind']} {told}"
            called = called.replace("_", " ").replace("hopf", "Hopf").strip()
            shown.setdefault(called, axes.plot(*path.T, **style)[0])
        special: Sequence[Event | RestEvent] = curve.events
        for event, place in zip(special, events, strict=True):
            style = {"marker": mark_of(event).marker, "markersize": 7.0, "linestyle": "none", "color": "black"}
            said = event.words.replace("hopf", "Hopf")
            shown.setdefault(said, axes.plot(*place, **style)[0])
            if not any(words == said and np.allclose(place, at, rtol=1e-6) for words, *at in labels):
                labels.append((said, *place))
    dress(axes, *(axis_name(families[0], k) for k in (0, 1)))
    axes.margins(0.08)
    for k, frame in enumerate((axes.set_xlim, axes.set_ylim) if labels else ()):
        ends = [name[1:][k] for name in labels]
        low, high = min(ends), max(ends)
        drawn = np.ptp([end for line in axes.lines for end in line.get_xydata()[:, k]])
        if drawn > FAR * (high - low) > 0:
            frame(low - 0.5 * (high - low), high + 0.5 * (high - low))
    legend(figure, shown, "lower center", ncols=3)
    place_labels(figure, axes, labels)
    return figure


def response(families: Sequence[Family], model: Model, coordinate: str | None = None) -> Figure:
    """Amplitude against the parameter, as a resonance curve is drawn: solid where stable, dashed where not.

    The amplitude is half the range of a `coordinate` over a period, by default of the one that moves most. Families of
    one `model` and one parameter are drawn together. Raises `InputError`.
    """
    sizes = [amplitudes(family, model) for family in families]
    names = model.coordinates
    if coordinate is not None and coordinate not in names:
        raise InputError(f"coordinate: unknown {coordinate!r}; this system has {', '.join(names)}")
    most = int(np.max([size.max(axis=0) for size in sizes], axis=0).argmax())
    which = most if coordinate is None else names.index(coordinate)
    first = families[0]
    figure = new_figure(8.0, 5.6, f"{entitled(*families)}: response to {first.parameter}")
    axes, called = figure.subplots(), (axis_name(first), f"amplitude of {axis(model, which)}")
    paired = zip(families, sizes, strict=True)
    drawn = [Diagram(family, called, np.column_stack([family.places, size[:, which]])) for family, size in paired]
    _curves(figure, axes, drawn)
    dress(axes, *called)
    return figure


def _curves(figure: Figure, axes: Any, diagrams: Sequence[Diagram], plain: bool = True) -> None:
    """Each family as a curve through the places of its points, dashed where unstable, and its events marked.

    One family is coloured by stability; of several the later lie on wider ones. On `plain` axes without corners.
    """
    shown, many, calm = dict[str, Any](), len(diagrams) > 1, {True: STABLE, False: UNSTABLE, None: UNDECIDED}
    for k, drawn in enumerate(diagrams):
        wider = min(3.6, 0.9 * (len(diagrams) - 1 - k))
        for stable, path in rounded(drawn.stretches) if plain else drawn.stretches:
            colour, (word, line) = COLOURS[k % len(COLOURS)] if many else calm[stable], STRETCHES[stable]
            style = {"linestyle": line, "linewidth": (1.8 if stable else 1.2) + wider}
            axes.plot(*path.T, color=colour, zorder=2 + 0.01 * k, **style)
            key = {"color": "0.3" if many else colour, "linestyle": style["linestyle"]}
            shown.setdefault(word, Line2D([], [], **key))
        for event, place in zip(drawn.family.events, drawn.events, strict=True):
            look = mark_of(event)
            style = {"marker": look.marker, "markersize": look.size, "linestyle": "none", "color": look.colour}
            style["markerfacecolor"] = "white" if look.hollow else look.colour
            style["zorder"] = 4.0 - look.size / 10  # what has the same place as another event stays in sight
            shown.setdefault(event.kind.replace("_", " "), axes.plot(*place, **style)[0])
    if many:
        lines = [Line2D([], [], color=COLOURS[k % len(COLOURS)], linewidth=2.4) for k in range(len(diagrams))]
        names = dict(zip((each.family.name for each in diagrams), lines, strict=True))
        if beside := len(names) > MOST_BELOW:
            legend(figure, names, "right upper")
        shown = shown if beside else names | shown
    legend(figure, shown, "lower center", ncols=4)


def multipliers_plane(family: Family) -> Figure:
    """Every point's multipliers in the complex plane, inside a square a little wider than the unit circle."""
    figure = new_figure(6.8, 5.8, f"{entitled(family)}: Floquet multipliers")
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
    if away := int((~near).sum()):
        note = f"{away} of {values.size} are farther out, up to {np.abs(values).max():.3g}"
        axes.set_title(note, fontsize=8.5, color="0.3")
    figure.colorbar(dots, ax=axes, label=axis_name(family), ticks=MaxNLocator(6))
    return figure


def multipliers_along(family: Family) -> Figure:
    """|mu| (logarithmic) and the stability indices along the family, each index as one curve."""
    indices = np.stack([point.indices for point in family.points])
    paired = indices.shape[1] > 0
    figure = new_figure(8.0, 6.4 if paired else 4.4, f"{entitled(family)}: stability along the family")
    upper, lower = figure.subplots(2, 1, sharex=True) if paired else (figure.subplots(), None)
    values = family.values("value")
    sizes = np.abs(np.concatenate([point.floquet_multipliers for point in family.points]))
    where = np.repeat(values, [point.floquet_multipliers.size for point in family.points])
    upper.semilogy(where, nonzero(sizes), ".", color=COLOURS[0], markersize=3)
    if np.ptp(np.log10(nonzero(sizes))) < 2:
        upper.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
        upper.yaxis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        upper.yaxis.set_minor_formatter(StrMethodFormatter("{x:g}"))
    if lower is None:
        upper.axhline(1.0, color="0.5", linewidth=0.7)
        dress(upper, axis_name(family), "|multiplier|")
        return figure
    for k in range(indices.shape[1]):
        line = unpoled(values, indices[:, k].real)
        lower.plot(*line, ".-", color=COLOURS[k % len(COLOURS)], markersize=3, linewidth=1.0)
    for level in (-2.0, 2.0):
        lower.axhline(level, color="0.5", linewidth=0.7)
    drawn = {}
    for event, look in ((event, mark_of(event)) for event in family.events):
        if look.across:
            drawn[event.kind.replace("_", " ")] = lower.axvline(event.parameter, color=look.colour, linewidth=0.8)
    if drawn:
        lower.legend(list(drawn.values()), list(drawn), loc="lower left", fontsize=8)
    lower.set_yscale("asinh", linear_width=2.0)
    top = min(max(4.0, 1.2 * float(np.abs(indices).max())), 2000.0)  # beyond it the multipliers above tell more
    lower.set_yticks([sign * size for size in (2.0, 10.0, 100.0, 1000.0) if size <= top for sign in (-1, 1)] + [0.0])
    lower.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    lower.set_ylim(-top, top)
    root = family.points[0].root
    dress(upper, "", "|multiplier|")
    dress(lower, axis_name(family), "stability index" + (" of the half period" if root == 2 else ""))
    return figure


def unpoled(values: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A curve (values, line) broken by nan where it passes a pole: it is large on both sides of a change of sign."""
    jumps = (np.sign(line[1:]) != np.sign(line[:-1])) & (np.minimum(np.abs(line[1:]), np.abs(line[:-1])) > 4.0)
    at = np.flatnonzero(jumps) + 1
    return np.insert(values, at, np.nan), np.insert(line, at, np.nan)


def axis_name(family: Family | Equilibria, k: int = 0) -> str:
    """Parameter k with its unit, where that is known: of a forcing's frequency it follows from the period."""
    name, count = family.parameters[k], len(family.points)
    if isinstance(family, Equilibria) or name in given_units(family.system):
        return with_word(name, family.system)
    unit = UNITS.get(name, "") or forced_unit(
        family.places[:count, k], family.values("period"), family.curve.get("cycles", np.inf)
    )
    return f"{name} ({unit})" if unit else name


def forced_unit(values: np.ndarray, periods: np.ndarray, cycles: float) -> str:
    """The unit of a parameter that is the frequency of a forcing, by the orbits' periods, each of so many cycles."""
    frequencies = ((2 * np.pi, "rad/s"), (1.0, "1/s"))
    turns = values * periods / cycles
    return next((unit for turn, unit in frequencies if np.allclose(turns, turn, rtol=1e-9, atol=0.0)), "")


KINDS = {"elliptic": (COLOURS[2], "o"), "marginal": (COLOURS[4], "s"), "unstable": (COLOURS[1], "^")}
"""Colour and marker of each verdict."""


def save_atlas_figures(atlas: Atlas, folder: str | Path, chosen: Filter | None = None) -> list[Path]:
    """Write the three figures of an atlas as PNG files; returns their paths. `InputError` when it is empty."""
    rows = atlas.rows(chosen)
    if not rows:
        raise InputError(f"{atlas.path}: no orbit to draw; widen the filter, or search longer")
    figures = {
        "atlas_energy_period": energy_period(rows, conserves(atlas)),
        "atlas_instability": instability(rows),
        "atlas_discovery": discovery_curves(atlas),
    }
    return _saved(figures, folder, atlas.system)


def energy_period(rows: Sequence[AtlasRow], conserved: bool = True) -> Figure:
    """Largest multiplier against period, one panel an energy where one is conserved; of many energies (more than six),
    energy against period.

    One mark an orbit, by stability.
    """
    energies = np.array([row.energy for row in rows])
    shells = np.unique(np.round(energies, 9)) if conserved else energies[:1]
    apart = shells.size > 6
    panels = shells[:1] if apart else shells
    title = f"{plural(len(rows), 'periodic orbit')}: {'energy, period' if apart else 'period'}"
    figure = new_figure(8.0, 2.2 + 2.6 * panels.size, f"{title} and stability")
    axes = np.atleast_1d(figure.subplots(panels.size, 1, sharex=True))
    places = np.zeros(len(rows), int) if apart else np.abs(energies[:, None] - panels).argmin(axis=1)
    heights = energies if apart else np.array([row.instability for row in rows])
    periods, shown = np.array([row.period for row in rows]), dict[str, Any]()
    for kind, (colour, marker) in KINDS.items():
        verdict = np.array([row.stability == kind for row in rows])
        style = {"color": colour, "markersize": 4.5, "alpha": 0.75, "markeredgewidth": 0, "linestyle": "none"}
        for k, panel in enumerate(axes):
            here = verdict & (places == k)
            if here.any():
                shown[f"{kind} ({int(verdict.sum())})"] = panel.plot(periods[here], heights[here], marker, **style)[0]
    for panel, shell in zip(axes, panels, strict=True):
        if not apart:
            panel.set_yscale("log")
        if conserved and not apart:
            panel.set_title(f"{number(float(shell))} J", loc="left", fontsize=10)
        dress(panel, "period (s)" if panel is axes[-1] else "", "energy (J)" if apart else "largest |multiplier|")
    legend(figure, shown, "lower center", ncols=4)
    return figure


def instability(rows: Sequence[AtlasRow]) -> Figure:
    """Histogram of ln |largest multiplier| / period, the mean rate (1/s) at which neighbours leave."""
    figure = new_figure(8.0, 4.6, f"{plural(len(rows), 'periodic orbit')}: how fast neighbours leave")
    axes = figure.subplots()
    rates = {kind: [np.log(row.instability) / row.period for row in rows if row.stability == kind] for kind in KINDS}
    top = max((max(values) for values in rates.values() if values), default=1.0)
    bins = np.linspace(0.0, max(top, 1e-3), 31)
    kinds = [kind for kind in KINDS if rates[kind]]
    axes.hist(
        [rates[kind] for kind in kinds], bins=list(bins), stacked=True, color=[KINDS[kind][0] for kind in kinds],
        label=[f"{kind} ({len(rates[kind])})" for kind in kinds],
    )  # fmt: skip
    dress(axes, "ln |largest multiplier| / period (1/s)", "orbits")
    axes.legend(frameon=False)
    return figure


def discovery_curves(atlas: Atlas) -> Figure:
    """Distinct orbits against processor time of every search, and Chao's estimate of how many there are."""
    figure = new_figure(8.0, 5.0, "Distinct orbits found, and how many such starts can find (Chao1)")
    axes = figure.subplots()
    searches = atlas.select([int, float, int], "SELECT id, energy, seed FROM searches ORDER BY id")
    for k, (search, energy, seed) in enumerate(searches):
        seconds, distinct, estimate = discovery(atlas, search)
        if not len(seconds):
            continue
        colour = COLOURS[k % len(COLOURS)]
        level = f"{number(energy)} J, " if conserves(atlas) else ""
        name = f"{level}seed {seed}: {distinct[-1]} found, about {estimate[-1]:.0f} estimated"
        axes.plot(seconds, distinct, color=colour, label=name)
        settled = np.arange(len(seconds)) >= min(50, len(seconds) // 4)  # earlier it is mostly noise
        axes.plot(seconds[settled], estimate[settled], color=colour, linestyle=":", linewidth=1.2)
    dress(axes, "processor time (s)", "distinct orbits (dotted: estimate)")
    axes.set_ylim(bottom=0)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, fontsize=9, loc="upper center", bbox_to_anchor=(0.5, -0.12))
    return figure
