"""Families of optima as tables."""

from __future__ import annotations

import numpy as np

from orbitfinder.control.optimum import Optima
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import shown
from orbitfinder.records.certificate import certified
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.table import Tables, entries, extent_columns, known_levels, placed, verdict_columns


def optima_tables(optima: Optima, model: Model | None = None) -> Tables:
    """The tables of a family of optima: points, `events` (what changes along it), ends. Raises `InputError`."""
    model, points, changes = model or build_model(optima.system), optima.points, optima.changes
    n = model.degrees_of_freedom

    def states(point: Orbit, value: float) -> np.ndarray:
        values = {**point.provenance.get("free", {}), optima.parameter: float(value)}
        there = with_parameters(model, {name: x for name, x in values.items() if name in model.parameter_names})
        given = shown(point, there)
        assert given is not None
        return given[1][:, :n]

    moved = [states(*each) for each in zip(points, optima.values, strict=True)]
    low, high = (np.array([bound(rows, axis=0) for rows in moved]) for bound in (np.min, np.max))
    columns = {"cost": optima.costs, **known_levels(points), **extent_columns(model.state_names[:n], low, high)}
    columns |= {**verdict_columns(points, [*map(certified, points)]), "descents": list(optima.descents)}
    happened = entries(changes, "kind", "detail", "cost", "period") | {"point": [change.index for change in changes]}
    return {
        "points": placed({optima.parameter: optima.values}, columns),
        "events": placed({optima.parameter: [change.value for change in changes]}, happened),
        "ends": {"reason": [optima.end]},
    }
