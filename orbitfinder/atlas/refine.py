"""From a start to an Orbit or to the reason why not: cheap solve, polish, minimal period, measure."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbitfinder.atlas.quick import Path, QuickSettings, polished, segments_needed, shot, solve, system
from orbitfinder.atlas.starts import Bench, Start, make_start
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.flow import Flow
from orbitfinder.periodic.certify import closest_return
from orbitfinder.periodic.conditions import pin
from orbitfinder.periodic.measure import measure
from orbitfinder.periodic.orbit import Orbit
from orbitfinder.periodic.problem import Guess, Problem

COVER = 1e-5
"""A return at T/k nearer than this, relative to the motion's extent, means that the loop was run k times."""
PERIOD_MARGIN = 1.15
"""The cheap stage lets the period leave the range by this factor before it holds it."""
SMALLEST = 1e-3
"""Motions of less than this extent (rad or m) are equilibria."""


@dataclass(frozen=True)
class Attempt:
    """How one start ended: an orbit (without certificate), or the reason for none."""

    index: int
    strategy: str
    orbit: Orbit | None = None
    reason: str = ""


def attempt(one: Bench, seed: int, index: int, strategy: str, settings: QuickSettings | None = None) -> Attempt:
    """One start from its number to its orbit."""
    settings = settings or QuickSettings()
    try:
        start = make_start(one, seed, index)
        orbit = minimal(one, converged(one, start, settings), settings)
        return Attempt(index, strategy, replace(orbit, provenance=origin(seed, start)))
    except ConvergenceError as error:
        return Attempt(index, strategy, reason=str(error))
    except IntegrationError as error:
        return Attempt(index, strategy, reason=f"integration: {error.reason}"[:60])


def converged(one: Bench, start: Start, settings: QuickSettings) -> Orbit:
    """The orbit that a start leads to, over the period found."""
    guess = Guess(start.state, start.period)
    problem = Problem(one.model, guess, pin=pin(energy=one.target.energy), symmetry=start.symmetry)
    flow = one.loose[start.symmetry]
    horizon = problem.boundary.fraction * start.period
    count = segments_needed(flow, start.state, horizon, settings)
    nodes = shot(flow, start.state, horizon, count)
    if start.symmetry == "none":
        problem = replace(problem, winding=turns(one, nodes, shot(flow, nodes[-1], 2 * horizon / count, 2)[1]))
    return solved(one, problem, Path(nodes, start.period, np.zeros(len(flow.unfolded))), settings)


def turns(one: Bench, nodes: np.ndarray, end: np.ndarray) -> tuple[int, ...]:
    """Whole turns of each coordinate over the guess, to the nearest."""
    n = one.model.degrees_of_freedom
    whole = np.round((end - nodes[0])[:n] / (2 * np.pi))
    return tuple(int(k) for k in np.where(np.asarray(one.model.angles or (False,) * n), whole, 0))


def solved(one: Bench, problem: Problem, path: Path, settings: QuickSettings) -> Orbit:
    """The polished and measured orbit of a path that is near one."""
    loose, tight = one.loose[problem.symmetry], one.tight[problem.symmetry]
    low, high = one.target.periods
    equations = system(problem, loose, path.nodes, (low / PERIOD_MARGIN, high * PERIOD_MARGIN))
    found, jacobian = solve(equations, path, settings)
    if np.abs(found.unfolding).max(initial=0.0) > 1e-4:
        raise ConvergenceError("unfolding does not vanish")
    found = polished(equations, found, jacobian, settings)
    orbit = measure(problem, tight, centred(one, problem, found.nodes), found.period, found.unfolding)
    if np.ptp(orbit.samples, axis=0).max() < SMALLEST:
        raise ConvergenceError("equilibrium")
    return orbit


def centred(one: Bench, problem: Problem, nodes: np.ndarray) -> np.ndarray:
    """Nodes with the first one's angles in (-pi, pi], where whole turns may be taken off."""
    n = one.model.degrees_of_freedom
    if problem.symmetry in ("reflection", "brake+reflection"):
        return nodes
    whole = np.ceil((nodes[0, :n] - np.pi) / (2 * np.pi)) * np.asarray(one.model.angles or (False,) * n)
    return nodes - 2 * np.pi * np.concatenate([whole, np.zeros(n)])


def minimal(one: Bench, orbit: Orbit, settings: QuickSettings) -> Orbit:
    """The same orbit over its minimal period; `ConvergenceError` when that is not in the range wanted."""
    angles = np.asarray(one.model.angles or (False,) * one.model.degrees_of_freedom)
    covers = [k for k in range(2, 31) if not np.any(np.asarray(orbit.winding) % k)]
    covers = [k for k in covers if closest_return(orbit.times, orbit.samples, angles, [k])[0] < COVER]
    if covers:
        orbit = uncovered(one, orbit, max(covers), settings)
    low, high = one.target.periods
    if not low <= orbit.period <= high:
        raise ConvergenceError("period outside the range")
    return orbit


def uncovered(one: Bench, orbit: Orbit, cover: int, settings: QuickSettings) -> Orbit:
    """The orbit solved again over a `cover`-th of its period."""
    period = orbit.period / cover
    if period < one.target.periods[0]:
        raise ConvergenceError("period outside the range")
    winding = tuple(k // cover for k in orbit.winding)
    guess = Guess(orbit.state, period)
    problem = Problem(one.model, guess, pin=pin(energy=one.target.energy), winding=winding)
    flow: Flow = one.loose["none"]
    nodes = shot(flow, orbit.state, period, segments_needed(flow, orbit.state, period, settings))
    return solved(one, problem, Path(nodes, period, np.zeros(len(flow.unfolded))), settings)


def origin(seed: int, start: Start) -> dict[str, Any]:
    """Provenance of an orbit found from a start: enough to find it again."""
    from orbitfinder.periodic.orbit import VERSION
    from orbitfinder.version import __version__

    return {
        "orbitfinder": __version__,
        "orbit_format": VERSION,
        "numpy": np.__version__,
        "seed": seed,
        "index": start.index,
        "strategy": start.strategy,
        "symmetry_imposed": start.symmetry,
        "start": {"state": [float(x) for x in start.state], "period": start.period},
    }
