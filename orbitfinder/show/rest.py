"""Equilibria as every picture draws them: in order with what happens on the way, in stretches of one stability."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import FAILURES, InputError
from orbitfinder.families.equilibrium import Equilibria, Equilibrium, RestEvent
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, counted
from orbitfinder.show.diagram import mark_of
from orbitfinder.show.svg import HEIGHT, WIDTH, Axes, drawn_curve, greek, ranged


def most_moved(equilibria: Equilibria) -> int:
    """The component that changes most, in its own size."""
    states = np.array([point.state for point in equilibria.points])
    return int((np.ptp(states, axis=0) / nonzero(np.abs(states).max(axis=0))).argmax())


def stretched(places: Sequence[Equilibrium | RestEvent]) -> list[tuple[slice, bool]]:
    """Equilibria and events in their order as stretches of one stability, with the places where they meet in both."""
    stretches: list[tuple[slice, bool]] = []
    for k, pair in enumerate(pairwise(places)):
        verdicts = [place.stability for place in pair if isinstance(place, Equilibrium)]
        stable = bool(verdicts) and verdicts[-1] != "unstable"
        start = stretches.pop()[0].start if stretches and stretches[-1][1] == stable else k
        stretches.append((slice(start, k + 2), stable))
    return stretches


def names_of(equilibria: Equilibria, model_of: Callable[[Mapping[str, Any]], Model] = build_model) -> Sequence[str]:
    """What the components of their states are called; numbered where no file describes the system."""
    try:
        model = model_of(equilibria.system)
    except FAILURES:
        return [f"x{k + 1}" for k in range(equilibria.points[0].state.size)]
    if (size := equilibria.points[0].state.size) != len(model.state_names):
        raise InputError(f"{equilibria.name}: state: {size} numbers for {counted(model)}; compute the equilibria again")
    return model.state_names


def rest_svg(equilibria: Equilibria, names: Sequence[str]) -> str:
    """The component that moves most along the parameter; `names` are those of all components."""
    both: tuple[Equilibrium | RestEvent, ...] = (*equilibria.points, *equilibria.events)
    every, component = sorted(both, key=lambda rest: rest.arclength), most_moved(equilibria)
    values = [rest.value if isinstance(rest, Equilibrium) else rest.parameter for rest in every]
    places = np.column_stack([values, [rest.state[component] for rest in every]])
    where = [np.array([event.parameter, event.state[component]]) for event in equilibria.events]
    marks = [(f"{event.words} at {event.parameter:.6g}", place, mark_of(event))
             for event, place in zip(equilibria.events, where, strict=True)]  # fmt: skip
    axes = Axes(*ranged(places), (equilibria.parameter, greek(names[component])), WIDTH, HEIGHT)
    stretches = [(stable, places[part]) for part, stable in stretched(every)]
    return drawn_curve(axes, stretches, marks, f"{axes.names[1]} of the equilibria against {equilibria.parameter}")
