"""Periodic orbits of systems under constraints, found on the native DAE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.mechanics.constrained import ConstrainedModel, reduced
from orbitfinder.mechanics.maximal import maximal_states
from orbitfinder.orbits.certify import Tolerances, certify
from orbitfinder.orbits.find import Callback, SolveSettings, find_orbit
from orbitfinder.records.orbit import Certificate, Orbit


def dae_problem(
    model: ConstrainedModel,
    state: Sequence[float] | np.ndarray,
    period: float,
    pin: tuple[Pin, ...] = (),
    winding: Sequence[int] | None = None,
    name: str = "orbit",
) -> Problem:
    """The Problem of an orbit of a ConstrainedModel near `state` and `period` (s).

    `state` is a state of the model (2n) or, of a chain or linkage, its link angles and rates. `winding`
    counts the whole turns of each coordinate, or of each link, in one period. Further settings by
    `dataclasses.replace`. Raises `InputError`.
    """
    start = np.asarray(state, float)
    turns = None if winding is None else [int(k) for k in winding]
    links = model.coordinates // 3
    if model.lift is not None and start.size == 2 * links:
        start = maximal_states(model, start)
    if model.lift is not None and turns is not None and len(turns) == links:
        turns = [k for turn in turns for k in (0, 0, turn)]
    guess = Guess(start, float(period))
    return Problem(reduced(model), guess, pin, winding=None if turns is None else tuple(turns), name=name)


def find_dae_orbit(
    model: ConstrainedModel,
    state: Sequence[float] | np.ndarray,
    period: float,
    *,
    pin: tuple[Pin, ...] = (),
    winding: Sequence[int] | None = None,
    segments: int | None = None,
    settings: SolveSettings | None = None,
    progress: Callback | None = None,
) -> Orbit:
    """The periodic orbit of a ConstrainedModel near a guess (see `dae_problem`), with its certificate.

    Multiple shooting over IDAS on the native DAE with Baumgarte terms, derivatives by the variational
    equations of its reduced form, 2n N + 2 equations {closure, phase, pin} in {N nodes, T, s}; otherwise as
    `find_orbit`. Without a pin the orbit nearest to the guess. Multipliers are those on the tangent space of
    the constraints. Raises `InputError`, `ConvergenceError`, `IntegrationError`.
    """
    problem = replace(dae_problem(model, state, period, pin, winding), segments=segments)
    return find_orbit(problem, settings, progress)


def certify_dae(
    orbit: Orbit, model: ConstrainedModel | None = None, tolerances: Tolerances | None = None
) -> Certificate:
    """The certificate of an orbit under constraints; `model` is needed where no file describes the system.

    DOP853 on constrained Hamilton's equations without stabilisation, a linkage in its link angles; see `certify`.
    """
    if model is None and orbit.system.get("kind") != "linkage":
        raise InputError(f"model: cannot rebuild {orbit.system.get('kind')!r} with its constraints; give the model")
    return certify(orbit, None if model is None else reduced(model), tolerances)
