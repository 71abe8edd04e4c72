"""The page of a Poincare section: its points, what else lies in it, and the motions that a click shows."""

from __future__ import annotations

from collections import Counter, defaultdict
from itertools import chain
from operator import itemgetter
from typing import Any

import numpy as np

from orbitfinder.errors import FAILURES, InputError, plural
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import lasting, units
from orbitfinder.records.reading import Entries
from orbitfinder.show.facts import number
from orbitfinder.show.scene import evenly
from orbitfinder.show.svg import axis
from orbitfinder.site.gather import Gathered
from orbitfinder.site.landscape import landscape
from orbitfinder.site.motion import framed, packed, recorded
from orbitfinder.site.text import coordinate, mechanism
from orbitfinder.structures.manifold import Connection, Manifold
from orbitfinder.structures.section import Section
from orbitfinder.structures.sections import Surface, check_plane, crossings, named_surface
from orbitfinder.structures.tori import crossed

MOST_MOTIONS, MOST_POINTS = 150, 6000
"""Motions that can be picked, and points that are drawn of all of them"""
RETURNS, SAMPLES = 6, 480
"""Returns of a motion that are shown, and samples of them"""
LEVEL = 1e-9
"""Energies nearer than this, relative, are one"""


def section_values(section: Section, data: Entries) -> Entries:
    """What the template of a section page is filled with."""
    drawn = sum(len(item["x"]) for item in data["items"])
    level = f", energy {number(section.energy, 10)}" if np.isfinite(section.energy) else ""
    counts = Counter(map(itemgetter("kind"), data["items"]))
    told = plural(counts.total() - counts["orbit"], "motion")
    if section.told:
        told += f", {counts['regular']} of them regular, {counts['undecided']} undecided"
    more = "" if drawn >= section.returns else f" The plot shows {drawn} of {section.returns} returns."
    laid = defaultdict[str, list[str]](list)
    for kind, name in map(itemgetter("kind", "name"), data["curves"]):
        laid[kind].append(name)
    tori = len(laid.pop("torus", ()))
    words = [f"{tori} invariant tori" if tori > 1 else "an invariant torus"] if tori else []
    return {"summary": f"{mechanism(section.system)}: {section.plane}{level}", "told": f"{told}.{more}",
            "laid": [*chain.from_iterable(laid.values()), *words]}  # fmt: skip


def section_data(section: Section, gathered: Gathered) -> Entries:
    """What the script of a section page works with: `items` to pick (motions and orbits), `curves` beside them."""
    try:
        model: Model | None = gathered.model(section.system)
    except FAILURES:
        model = None
    items, curves = _motions(section, model), list[Entries]()
    if model is not None:
        surface = named_surface(model, section.plane, section.axes)
        items += _orbits(section, model, gathered)
        curves = [curve for laid in gathered.laid for curve in _laid(laid, section, surface) if _belongs(laid, section)]
    frame = framed(items)
    axes = [coordinate(name) if model is None else axis(model, model.state_names.index(name), coordinate)
            for name in section.axes]  # fmt: skip
    return {"name": section.name, "axes": axes, "items": items, "curves": curves,
            "told": section.told, "time": units(section.system)["time"], "landscape": landscape(model, frame),
            "energy": section.energy if np.isfinite(section.energy) else None}  # fmt: skip


def _belongs(record: Any, section: Section) -> bool:
    """Whether a record is of a section's system, and of its energy where it has one itself."""
    energy = getattr(record, "energy", np.nan)
    level = energy == energy and section.energy == section.energy
    near = not level or abs(energy - section.energy) <= LEVEL * abs(energy)
    return dict(record.system) == dict(section.system) and near


def _motions(section: Section, model: Model | None) -> list[Entries]:
    """The motions of a section with their points (the first of each) chosen where there are many."""
    chosen = evenly(len(section.starts), MOST_MOTIONS)
    most = max(1, MOST_POINTS // len(chosen))
    ends = [section.times[section.seeds == k][:RETURNS] for k in chosen]
    span = float(np.median([times[-1] for times in ends if len(times)]))
    moving = _paths(section, model, section.starts[list(chosen)], span)
    items = []
    for k, motion in zip(chosen, moving, strict=True):
        points = section.points[section.seeds == k]
        kind = str(section.kinds[k]) if section.told else "motion"
        facts = [["Motion", f"{k + 1} of {len(section.starts)}"], ["Kind", kind], ["Returns", str(len(points))],
                 ["MEGNO", number(float(section.megno(k)[-1]), 3) if section.told and len(points) else ""]]  # fmt: skip
        items.append(_item(kind, f"motion={k + 1}", f"motion {k + 1}", points[:most], motion, facts))
    return items


def _item(kind: str, key: str, name: str, points: np.ndarray, motion: Any, facts: list[list[str]]) -> Entries:
    """What can be picked: its points in the section, its motion, and the address `key` under which it is found."""
    across, up = _short(points[:, 0]), _short(points[:, 1])
    return {"kind": kind, "key": key, "name": name, "x": across, "y": up, "motion": motion, "facts": facts}


def _paths(
    section: Section, model: Model | None, starts: np.ndarray, span: float
) -> list[Entries | None]:  # fmt: skip
    """Motions from states (k x d) over a time (s) for the page, None of what cannot be integrated."""
    if model is None or not model.smooth:
        return [None] * len(starts)
    motions = named_surface(model, section.plane, section.axes).motions
    return [packed(recorded(model, path[:-1], span)) if np.isfinite(path).all() else None
            for path in motions.sampled(starts, span / SAMPLES, SAMPLES)]  # fmt: skip  # what jumps back at its end


def _orbits(section: Section, model: Model, gathered: Gathered) -> list[Entries]:
    """The orbits of the section's system and energy, as items: their crossings and their motion."""
    items = []
    for orbit in (file.orbit for file in gathered.orbits):
        if not _belongs(orbit, section):
            continue
        try:
            points = crossings(model, section, orbit)
        except InputError:
            continue
        facts = [
            ["Orbit", orbit.name],
            ["Stability", orbit.stability],
            ["Period", lasting(orbit.period, orbit.system, 10)],
        ]
        (motion,) = _paths(section, model, orbit.state[None], orbit.period)
        items.append(_item("orbit", f"orbit={orbit.name}", orbit.name, points, motion, facts))
    return items


def _laid(record: Manifold | Connection | Any, section: Section, surface: Surface) -> list[Entries]:
    """Manifolds, connections and tori as curves and points; `InputError` for those of another plane."""
    if hasattr(record, "tori"):
        level = [torus for torus in record.tori if not np.isfinite([torus.energy, section.energy]).all()
                 or abs(torus.energy - section.energy) <= LEVEL * abs(section.energy)]  # fmt: skip
        return [_curve("torus", f"torus {number(torus.rotation, 6)}", surface.chart(crossed(torus, surface)))
                for torus in level]  # fmt: skip
    check_plane(record, section)
    if isinstance(record, Connection):
        return [_curve("connection", f"{record.kind} {record.name}", surface.chart(record.states))]
    gap = np.full((1, 2), np.nan)
    pieces = np.vstack([np.vstack([surface.chart(curve), gap]) for curve in record.curves])
    return [_curve(record.which, f"{record.name}, {record.which} manifold", pieces)]


def _curve(kind: str, name: str, points: np.ndarray) -> Entries:
    return {"kind": kind, "name": name, "x": _short(points[:, 0]), "y": _short(points[:, 1])}


def _short(values: np.ndarray) -> list[float | None]:
    """Numbers for a plot, None for nan."""
    return [float(f"{value:.6g}") if np.isfinite(value) else None for value in values.tolist()]
