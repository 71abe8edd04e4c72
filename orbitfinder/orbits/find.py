"""From a Problem to a certified Orbit: the method that suits it finds the orbit, an independent motion certifies it.

What looks like a slip without being one is said: hints go with a search, as warnings, and stop nothing.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from orbitfinder._runtime.limit import limited
from orbitfinder.errors import Hint
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.failure import degrees_taken_for_radians
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.method import solved
from orbitfinder.orbits.shoot import closer
from orbitfinder.records.orbit import Orbit

NEAR_ONE = 1e-3
"""A multiplier this near to +1 may be one of an invariant: a double one is known to the root of its matrix's error."""


@one_thread()
def find_orbit(problem: Problem, settings: SolveSettings | None = None, progress: Callback | None = None) -> Orbit:
    """The periodic orbit that a Problem singles out, with its certificate.

    Multiple shooting solved by IPOPT with an explicit Hessian (so that a square problem is solved by Newton's
    method), two or more Newton steps on the residual of a high-order integrator, the minimal period. Motions with close
    encounters or bursts, which equal steps lose, are searched by damped Newton steps on a mesh that fits them first, at
    the guess's energy unless something is pinned. Symmetric modes of chains of 11 links and more are found by harmonic
    balance and shooting over a quarter period. The result may
    still fail its certificate: look at `orbit.certificate.passed`.

    Args:
        problem: model, guess, pins.
        settings: how to solve; the defaults are right for most.
        progress: called with what is being done.

    Returns:
        An Orbit: state (2n), period (s), energy (J), multipliers, stability, certificate.

    Raises:
        CountError: before solving an over- or under-determined problem, with the count.
        ConvergenceError: with a sentence to act on.
        IntegrationError: when a segment cannot be integrated from the guess.
        LimitError: after `settings.limit` s.

    Examples:
        >>> found = of.find_orbit(problem)
        >>> round(found.period, 9), found.certificate.passed
        (1.119340898, True)

    See Also:
        `of.Refiner` for many orbits of one problem, `of.search` for all of them, `of.least_unstable` to choose.
    """
    settings = settings or SolveSettings()
    with limited(settings.limit):
        began = time.perf_counter()
        problem.check_count()
        hint(degrees_taken_for_radians(problem))
        elapsed = progress and (lambda event: progress(replace(event, elapsed=time.perf_counter() - began)))
        orbit, model = solved(problem, settings, elapsed, began)
        if settings.with_certificate:
            orbit = certified(orbit, model)
            if orbit.certificate and not orbit.certificate.passed:
                orbit = closer(problem, orbit, model)
            hint(unexplained_multipliers(problem, orbit))
            hint(passed_stops(problem.model, orbit))
        if progress:
            progress(Progress("certificate", 0, orbit.closure, orbit.period, time.perf_counter() - began))
        return orbit


def hint(text: str) -> None:
    """Give a hint as a warning of the caller's caller."""
    if text:
        warnings.warn(text, Hint, stacklevel=4)


def unexplained_multipliers(problem: Problem, orbit: Orbit) -> str:
    """A sentence where an orbit has multipliers at +1 that no invariant explains, and no bifurcation asked for."""
    if orbit.certificate is None or problem.constraints or problem.relative or not problem.model.conservative:
        return ""
    extra = int(np.sum(np.abs(orbit.floquet_multipliers - 1) < NEAR_ONE))
    if extra < 2:
        return ""
    known = ", ".join(one.name for one in problem.model.invariants)
    return (
        f"invariants: {extra} multipliers are at +1 beyond those of the declared ones ({known}); if the system has "
        "another (a rotation that no coordinate shows), give it as of.Invariant in lagrange(..., invariants=...), or "
        "use a coordinate that it turns"
    )


def passed_stops(model: Model, orbit: Orbit) -> str:
    """A sentence where an orbit leaves the range of a robot's joint, at whose ends nothing acts."""
    joints = model.system.get("joints")
    for name, table in joints.items() if isinstance(joints, Mapping) else ():
        low, high = table.get("range", (-np.inf, np.inf))
        if name in model.state_names:
            along = np.vstack([orbit.nodes, *([orbit.samples] if orbit.samples.size else [])])
            least, most = (f(along[:, model.state_names.index(name)]) for f in (np.min, np.max))
            if least < low or most > high:
                return (
                    f"joints.{name}.range: the orbit goes from {least:.4g} to {most:.4g}, beyond {low:.4g} to "
                    f"{high:.4g}, where no stop acts; ask for a smaller motion, or take the range out"
                )
    return ""
