"""Families of orbits and of equilibria, and diagrams of both, as tables: points, events, ends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from orbitfinder.families.diagram import BifurcationDiagram
from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.families.members import extents
from orbitfinder.mechanics.kind import build_model, restricted
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import End, Family
from orbitfinder.records.table import Tables, entries, extent_columns, known_levels, placed, stacked, verdict_columns


def family_tables(family: Family, model: Model | None = None) -> Tables:
    """The tables of a family. Raises `InputError` where its system cannot be built or its equations are not known."""
    model = model or build_model(family.system)
    seen, count, watched = extents(family, model), len(family.points), family.points[0].watch
    names = dict.fromkeys([*family.parameters, *family.points[0].free])
    called = model.coordinates

    def columns(members: Sequence[Any], rows: slice, more: dict[str, Any]) -> dict[str, Any]:
        parameters = {name: [family.value(member, name) for member in members] for name in names}
        moves = extent_columns(called, seen[rows, 0], seen[rows, 1])
        watch = {name: [member.watch.get(name, np.nan) for member in members] for name in watched}
        constant = {"jacobi": [-2 * member.energy for member in members]} if restricted(family.system) else {}
        return placed(parameters, {**known_levels(members), **constant, **moves, **more, **watch})

    points, events = family.points, family.events
    happened = entries(events, "kind", "detail", "criticality", "error", "period_error", "order", "certified")
    happened |= {"multiplier_re": [event.multiplier.real for event in events],
                 "multiplier_im": [event.multiplier.imag for event in events],
                 "point": [event.index for event in events]}  # fmt: skip
    return {
        "points": columns(points, slice(count), verdict_columns(points, [point.certified for point in points])),
        "events": columns(events, slice(count, None), happened),
        "ends": _ends(family.parameter, family.ends),
    }


def _ends(parameter: str, ends: Sequence[End]) -> dict[str, Any]:
    return placed(
        {parameter: entries(ends, "parameter")["parameter"]}, entries(ends, "kind", "period", "error", "reason")
    )


def equilibria_tables(rest: Equilibria, model: Model | None = None) -> Tables:
    """The tables of equilibria. Raises `InputError` where their system cannot be built."""
    model, points, events = model or build_model(rest.system), rest.points, rest.events

    def columns(members: Sequence[Any], own: str, more: dict[str, Any]) -> dict[str, Any]:
        places = [member.values if len(rest.parameters) > 1 else [getattr(member, own)] for member in members]
        values = np.reshape(places, (len(members), len(rest.parameters))).T
        states = np.reshape([member.state for member in members], (len(members), len(model.state_names))).T
        parameters = dict(zip(rest.parameters, values, strict=True))
        return placed(parameters, {**dict(zip(model.state_names, states, strict=True)), **more})

    spectra = np.array([point.eigenvalues for point in points]).T
    eigenvalues = {
        f"eigenvalue_{k}_{part}": getattr(value, word)
        for k, value in enumerate(spectra, 1)
        for part, word in (("re", "real"), ("im", "imag"))
    }
    happened = entries(
        events, "kind", "criticality", "error", "frequency", "period", "period_error", "lyapunov", "lyapunov_error"
    )
    return {
        "points": columns(points, "value", eigenvalues | entries(points, "stability", "residual", "certified")),
        "events": columns(events, "parameter", happened | {"point": [event.index for event in events]}),
        "ends": _ends(rest.parameter, rest.ends),
    }


def diagram_tables(diagram: BifurcationDiagram, model: Model | None = None) -> Tables:
    """The tables of a diagram, those of its curves below each other: equilibria have ranges, too, of no width, and
    events what `became` of them. Raises `InputError` where its system cannot be built."""
    model = model or build_model(diagram.system)
    became = {(fork.file, fork.event): fork.became for fork in diagram.branchings}
    made = {}
    for curve in diagram.curves:
        tables = made[curve.file] = curve.record.tables(model)
        if isinstance(curve.record, Equilibria):
            names = model.coordinates
            at = np.array([tables["points"][name] for name in names]).T
            tables["points"] |= extent_columns(names, at, at)
        events = range(len(curve.record.events))
        tables["events"]["became"] = [became.get((curve.file, k), "") for k in events]
    return {of: stacked({file: tables[of] for file, tables in made.items()}) for of in ("points", "events", "ends")}
