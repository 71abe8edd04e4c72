"""Why a search ended without an orbit, as one sentence that a person can act on."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from orbitfinder._runtime.sizes import relative
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.cvodes import integration_error, sundials
from orbitfinder.loops.problem import Problem, clocked
from orbitfinder.loops.shooting import Shooting, spans
from orbitfinder.mechanics.model import Model, energy
from orbitfinder.mechanics.newton import descended


@dataclass(frozen=True)
class Signs:
    """What tells why a search failed."""

    settled: float = 1e-4
    """Slope of the potential, relative to its value, below which a way down has come to its end."""
    rest: float = 1e-6
    """Nodes whose rates and accelerations are all below this, relative to the guess's, are an equilibrium."""
    steady: float = 1e-6
    """Rates that are this much, relative, beside the directions of the symmetries count as along them."""
    no_unfolding: float = 1e-6
    """A fictitious damping (per period) above this says that the conserved quantities do not fit together."""


SIGNS = Signs()


def explain(shooting: Shooting, w: np.ndarray, status: str, text: str) -> Exception:
    """The error to raise for a decision vector at which IPOPT gave up with `status`, `text` its output."""
    problem, count = shooting.problem, len(shooting.guess.nodes)
    if not np.all(np.isfinite(w)):
        return integration_error(text, shooting.at(shooting.start).nodes[0], 0.0, problem.guess.period)
    try:
        defects = worst_defects(shooting, w)
    except IntegrationError as error:
        return error
    reached, worst = shooting.at(w), int(np.argmax(defects))
    segment = reached.period * problem.boundary.fraction / count
    place = f"of segment {worst} (t = {(worst + 1) * segment:.4g} s)"
    if worst == count - 1:
        place += ", where the loop should close"
    return ConvergenceError(
        f"no orbit found ({status}): largest defect {defects[worst]:.3g} at the end {place}, "
        f"period {reached.period:.6g} s (guess {problem.guess.period:.6g} s), "
        f"unfolding {np.max(np.abs(reached.unfolding), initial=0.0):.2g}; {advice(shooting, w, defects)}"
    )


def refuse_equilibrium(shooting: Shooting, w: np.ndarray) -> None:
    """`ConvergenceError` when what was found closes only because nothing moves."""
    if at_rest(shooting, w):
        state = np.array2string(shooting.at(w).nodes[0], precision=4, separator=", ")
        raise ConvergenceError(
            f"no orbit found: the search fell on an equilibrium, {state}; {_away_from_rest(shooting)}"
        )


def advice(shooting: Shooting, w: np.ndarray, defects: np.ndarray) -> str:
    """What happened and what to try, the most telling sign first."""
    problem, reached = shooting.problem, shooting.at(w)
    if slip := degrees_taken_for_radians(problem):
        return slip
    if at_rest(shooting, w):
        return f"the search fell on an equilibrium; {_away_from_rest(shooting)}"
    if turning := _turning(shooting, w):
        return (
            f"the motion only turns along the symmetry of {turning} (a relative equilibrium), where energy and "
            "momentum say the same and a pin is one condition too many; leave the pin out"
        )
    low, high = shooting.at(shooting.lower), shooting.at(shooting.upper)
    if reached.period < 1.05 * low.period:
        return "the period collapsed towards 0, where every state closes; raise guess.period or pin the period"
    if reached.period > 0.95 * high.period:
        return "the period ran away upwards, as near a separatrix; lower guess.period or pin another energy"
    bounds = zip(shooting.loop.equations.free, reached.free, low.free, high.free, strict=True)
    for name, value, lowest, highest in bounds:
        if min(value - lowest, highest - value) < 1e-3 * (highest - lowest):
            return f"{name} ran to the end of its range ({value:.4g}); give a guess nearer to an orbit or free another"
    if far := _energy_gap(shooting):
        return far
    if defects.max() < 1e-6 and reached.period * np.max(np.abs(reached.unfolding), initial=0.0) > SIGNS.no_unfolding:
        return (
            "it closes only with the fictitious damping of the unfolding, so no such orbit exists at this pin near "
            "the guess; pin another value"
        )
    if len(reached.nodes) == 1:
        return "one segment amplifies every error; use more segments, or a guess nearer to an orbit"
    return "try a guess nearer to an orbit, more segments, or another pin"


def degrees_taken_for_radians(problem: Problem) -> str:
    """A sentence where an angle of the guess is of several turns and winds nowhere, as 60 degrees taken for rad."""
    guess, model = problem.guess, problem.model
    if guess.states is not None:
        return ""
    angles = np.where(model.angular, guess.start[: model.degrees_of_freedom], 0.0)
    worst = int(np.abs(angles).argmax())
    if abs(angles[worst]) <= 2 * np.pi:
        return ""
    value = angles[worst]
    return (
        f"guess.state: {model.state_names[worst]} = {value:.6g} rad is {abs(value) / (2 * np.pi):.3g} turns; angles "
        f"are in rad, and {value:.6g} degrees are {np.radians(value):.6g} rad"
    )


def at_rest(shooting: Shooting, w: np.ndarray) -> bool:
    """True when no node moves, compared with the guess."""
    units = np.asarray(shooting.flow.units or 1.0)
    nodes, given = shooting.at(w).nodes / units, shooting.at(shooting.start).nodes / units
    if shooting.problem.model.forced:  # at rest although pushed: every node is the same
        return len(nodes) > 1 and bool(
            np.ptp(nodes, axis=0).max() < SIGNS.rest * max(np.ptp(given, axis=0).max(), SIGNS.rest)
        )
    return _speed(shooting, w) < SIGNS.rest * max(_speed(shooting, shooting.start), SIGNS.rest)


def _turning(shooting: Shooting, w: np.ndarray) -> str:
    """Invariants along whose symmetries all motion goes, x' = sum_k c_k generator_k(x) at every node, or nothing."""
    model, reached = shooting.problem.model, shooting.at(w)
    n = model.degrees_of_freedom
    turns = [invariant for invariant in model.invariants if invariant.generator is not None]
    if not turns:
        return ""
    p = model.parameter_values.copy()
    p[[model.parameter_index(name) for name in shooting.loop.equations.free]] = reached.free
    left = 0.0
    for node in reached.nodes:
        along = np.column_stack([turn.generator(node[:n], node[n:], p).full() for turn in turns])  # type: ignore[misc]
        rate = shooting.flow.field(0.0, node, 0 * reached.unfolding, reached.free).full().ravel()
        missed = rate - along @ np.linalg.lstsq(along, rate, rcond=None)[0]
        left = max(left, relative(missed, rate))
    return " and ".join(turn.name for turn in turns) if left < SIGNS.steady else ""


def _speed(shooting: Shooting, w: np.ndarray) -> float:
    """Largest rate or acceleration over the nodes, in units of the period."""
    reached = shooting.at(w)
    clock = shooting.problem.guess.period / (2 * np.pi)
    scale = clock * clocked(shooting.problem.model, clock)
    if shooting.flow.units:
        scale /= np.resize(shooting.flow.units[: shooting.problem.model.degrees_of_freedom], scale.size)
    rates = [
        shooting.flow.field(0.0, node, reached.unfolding, reached.free).full().ravel() * scale for node in reached.nodes
    ]
    return float(np.abs(rates).max())


def _away_from_rest(shooting: Shooting) -> str:
    if shooting.problem.model.conservative:
        return "pin a larger energy, or start further from rest"
    return "start further from rest, nearer to the cycle"


def _energy_gap(shooting: Shooting) -> str:
    """A remark when the pinned energy is far from the guess's own, else nothing."""
    problem = shooting.problem
    pinned = [pin.value for pin in problem.pin if pin.name == "energy"]
    if not pinned or problem.model.rates is not None:  # of rest, which the difference is measured by, nothing is known
        return ""
    own = energy(problem.model, problem.guess.state)
    n = problem.model.degrees_of_freedom
    state = problem.guess.start
    potential = [energy(problem.model, np.concatenate([q, np.zeros(n)])) for q in (state[:n], np.zeros(n))]
    size = max(abs(own - min(potential)), abs(pinned[0] - min(potential)))
    if abs(own - pinned[0]) < 0.3 * size:
        return ""
    lowest = _lowest(problem.model, state[:n]) if pinned[0] < own else -np.inf
    if pinned[0] <= lowest:
        return f"the pin asks for {pinned[0]:.6g} J and at rest the system has {lowest:.6g} J near the guess; pin more"
    return (
        f"the guess has energy {own:.6g} J and the pin asks for {pinned[0]:.6g} J; follow the family there in smaller "
        "steps, or scale the guess to that energy"
    )


def _lowest(model: Model, place: np.ndarray) -> float:
    """Least energy (J) of rest on the way down from a place (n), -inf where there is no floor or rods constrain it."""
    if model.constraint is not None:
        return -np.inf
    _, lowest, slope = descended(lambda q: energy(model, np.concatenate([q, np.zeros(q.size)])), place)
    return lowest if np.isfinite(lowest) and slope <= SIGNS.settled * abs(lowest) else -np.inf


def worst_defects(shooting: Shooting, w: np.ndarray) -> np.ndarray:
    """Largest gap at the end of each segment (N) of a decision vector, in the units of its states.

    `IntegrationError` names its segment.
    """
    where = shooting.at(w)
    (count, size), ends, equations = where.nodes.shape, [], shooting.loop.equations
    tail = where.period, where.unfolding, ca.DM(where.free)
    for k, (flow, given) in enumerate(spans(equations, shooting.flow, list(where.nodes), tail)):
        with sundials(given[1], float(given[0]), float(given[2]), k):
            ends.append(flow.end(*given).full().ravel())
    reached = np.asarray(ends)
    off = equations.links.passed(where, reached)[0][:-1] - where.nodes[1:]
    gaps = np.abs(off / np.asarray(shooting.flow.units or 1.0)).max(axis=1)
    rows = shooting.rows(w, reached.T).full().ravel()
    boundary = rows[size * (count - 1) : size * count]
    return np.append(gaps, float(np.abs(boundary).max()))
