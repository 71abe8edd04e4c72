"""The least unstable of the orbits at one energy: a choice among many searches.

At a fixed energy the orbits of a conservative system without freed parameters stand alone, so no
gradient leads from one to the next. They are looked for from many starts (those of the atlas), and
the one with the smallest spectral radius is taken.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

from orbitfinder.atlas.attempt import Job, attempts
from orbitfinder.atlas.search import FIRST
from orbitfinder.atlas.signature import Signature, same_orbit, signature_of
from orbitfinder.atlas.starts import Target, context_of
from orbitfinder.errors import FAILURES, ConvergenceError, InputError
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.problem import Guess, Problem, without_choice
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.objectives import rank
from orbitfinder.records.orbit import Orbit

STARTS = 200
"""Starts where the file does not say how many."""
NEAR = 1e-6
"""A period that changes by more than this, relative, is another orbit's."""


@dataclass(frozen=True)
class Candidate:
    """A distinct orbit, how often it was found, and what it is ordered by: spectral radius, largest |mu + 1/mu|."""

    orbit: Orbit
    signature: Signature
    found: int
    rank: tuple[float, float]


def solve(
    problem: Problem, starts: int | None = None, seed: int = 0, progress: Callback | None = None,
    settings: SolveSettings | None = None,
) -> Orbit:  # fmt: skip
    """The orbit that a Problem asks for, by `find_orbit` or, where it is a choice, by `least_unstable`."""
    if problem.choice:
        return least_unstable(problem, STARTS if starts is None else starts, seed, progress, settings)
    return find_orbit(problem, settings, progress)


def least_unstable(
    problem: Problem, starts: int = STARTS, seed: int = 0, progress: Callback | None = None,
    settings: SolveSettings | None = None,
) -> Orbit:  # fmt: skip
    """The least unstable orbit at the pinned energy with a minimal period in `bounds["period"]`, certified.

    Among orbits on whose multipliers nothing is outside the unit circle the one with the smallest |mu + 1/mu| is
    taken. `provenance["choice"]` says how many orbits were found and how unstable the runner-up is. More starts find
    more orbits: the answer is the best of those found.

    Args:
        problem: with an energy pin and a range of the period in its bounds.
        starts: of the atlas's strategies, tried beside the guess.
        seed: the same gives the same answer.
        progress: called with what is being done.
        settings: how each is solved.

    Returns:
        An Orbit.

    Raises:
        InputError: for a problem without energy or range.
        ConvergenceError: where none was found.

    Examples:
        >>> wanted = of.Problem(pendulum, guess, pin=of.pin(energy=-18.0), bounds={"period": (0.9, 2.0)},
        ...                     objective="min_instability")
        >>> chosen = of.least_unstable(wanted, starts=4)
        >>> chosen.stability
        'elliptic'

    See Also:
        `of.search` keeps all that are found.
    """
    check(problem)
    known = candidates(problem, starts, seed, progress)
    low, high = problem.bounds["period"]
    if not known:
        raise ConvergenceError(
            f"no orbit found: none of {starts} starts led to one with a period from {low:g} to {high:g} s at this "
            "energy; widen bounds.period, or try more starts"
        )
    best = known[0].orbit
    plain = without_choice(replace(problem, symmetry="none"))
    dense = (best.times, best.samples) if len(best.samples) > 1 else ()
    guess = Guess(best.samples[0] if dense else best.state, best.period, *dense)
    wanted = replace(plain, pin=problem.pin, guess=guess, winding=best.winding)
    orbit = find_orbit(wanted, settings, progress)
    if abs(orbit.period / best.period - 1) > NEAR:
        raise ConvergenceError(
            f"the chosen orbit (period {best.period:.9g} s) was left for another ({orbit.period:.9g} s) when it was "
            "refined; use another seed"
        )
    radii = [candidate.rank[0] for candidate in known]
    choice = {
        "starts": starts, "seed": seed, "orbits": len(known), "spectral_radius": radii[0],
        "runner_up": radii[1] if len(radii) > 1 else None, "times_found": known[0].found,
    }  # fmt: skip
    return replace(orbit, provenance={**orbit.provenance, "choice": choice})


def check(problem: Problem) -> None:
    """`InputError` when a Problem is not a choice of this kind."""
    if not problem.choice:
        raise InputError(
            "objective: a choice among separate orbits needs objective min_instability, a pinned energy and a range of "
            "periods in bounds, and nothing free; use find_orbit otherwise"
        )
    extra = [name for name in problem.bounds if name != "period"]
    if extra or problem.constraints or problem.boundary.maps or [pin.name for pin in problem.pin] != ["energy"]:
        raise InputError(
            "objective: a choice among separate orbits goes by energy (pin) and period (bounds) only; leave out other "
            "bounds, constraints, pins and the symmetry"
        )


def candidates(problem: Problem, starts: int, seed: int, progress: Callback | None = None) -> list[Candidate]:
    """The distinct orbits found, least unstable first."""
    began = time.perf_counter()
    shared = context_of(problem.model, Target(problem.pin[0].value, problem.bounds["period"]))
    known: list[Candidate] = []
    try:  # what the guess itself leads to, when that is an orbit and its period fits
        own = find_orbit(replace(without_choice(problem), pin=problem.pin))
    except FAILURES:
        pass
    else:
        low, high = problem.bounds["period"]
        if low <= own.period <= high and own.certificate is not None and own.certificate.passed:
            _add(known, signature_of(own, problem.model), own)
    for first in range(0, starts, FIRST):
        jobs = [Job(index) for index in range(first, min(first + FIRST, starts))]
        for trial in attempts(shared, seed, jobs, [each.signature.numbers for each in known]):
            if trial.signature is not None:
                _add(known, trial.signature, trial.orbit)
        if progress and known:
            best = min(known, key=lambda each: each.rank).orbit
            progress(Progress("choosing", jobs[-1].number + 1, best.closure, best.period, time.perf_counter() - began))
    return sorted(known, key=lambda each: each.rank)


def _add(known: list[Candidate], signature: Signature, orbit: Orbit | None) -> None:
    for k, each in enumerate(known):
        if same_orbit(each.signature, signature):
            known[k] = replace(each, found=each.found + 1)
            return
    if orbit is not None:
        known.append(Candidate(orbit, signature, 1, rank(orbit)))
