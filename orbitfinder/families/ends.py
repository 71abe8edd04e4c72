"""Why a family ends: an equilibrium, a homoclinic orbit, its own start, or a step that cannot be taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.follow import zero
from orbitfinder.errors import UNSOLVED, ConvergenceError, IntegrationError, plural
from orbitfinder.families.joins import EVEN, Invariance, Join, about_mean, agrees, approaching, end_of, passed, solved
from orbitfinder.families.minimal import dead_point
from orbitfinder.families.motion import full_samples
from orbitfinder.families.passages import LOCATION
from orbitfinder.families.point import LEAST, extents, freed, parameter_value
from orbitfinder.families.rest import RestPoint, can_rest, rest_of, vanishing
from orbitfinder.families.rest_problem import ROUND_OFF, first_lyapunov, regular
from orbitfinder.families.run import Interval, Run, Walked, portrait
from orbitfinder.families.saddles import SLOW, blown_up, held_up, near_saddle, rest_near, slowness
from orbitfinder.families.start import return_gaps
from orbitfinder.integrate.jets import at_rest
from orbitfinder.loops.conditions import hyperplane
from orbitfinder.loops.continued import Curve, Solution, correct
from orbitfinder.loops.symmetry import NONE, beside, named, recognise
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.scales import lasting, measured
from orbitfinder.records.family import End


@dataclass(frozen=True)
class Shrinking:
    """When a family shrinks to a point, or is in a canard."""

    linear: float = 1e-7
    nearly: float = 1e-5
    steady: float = 1e-5
    """a small oscillation's period is the linear one's to this share: where a family shrinks, and where it fails; and
    how little the period changes in a step there"""
    smaller: float = 0.95
    """... and how much smaller the orbits become"""
    agreed: float = 0.2
    """a Hopf point is where orbits shrink to when parameter and period, followed along the tangent to amplitude 0, miss
    its own by less than this share of how far they are from it,"""
    close: float = 1e-3
    """or when they are this much nearer to it than the family's first orbit was,"""
    halted: float = 1e-5
    """... and nearer than this, where a step cannot be taken, whatever the tangent says"""
    ahead: float = 6.0
    """it is looked for when amplitude 0 is no more than so many steps away"""
    turned: float = -0.5
    """cosine between two orbits' deviations from their means below which the second one is half a period late"""
    exploded: float = 1e-5
    explosion: float = 0.02
    """a family is in a canard when within the first share of its way in the parameter it changes by the second one"""
    abrupt: float = 30.0
    wider: float = 1.01
    """a largest acceleration this many times the median one speaks of a singularity where a family cannot go on, and so
    does an orbit that, so much wider, leaves the domain of its equations"""


@dataclass(frozen=True)
class Meeting:
    """When a family joins another one, or itself."""

    apart: float = 1e-2
    """a family ends in another one from which its orbits are apart by no more than this share of their motion"""
    short: float = 0.7
    """steps to what is wanted before it, or to an end that is seen ahead, go so far of the way"""
    symmetric: float = 1e-3
    """how symmetric, relative to its extent, an orbit at a fold must be to belong to the family joined there"""
    edge: float = 1e-2
    """share of a step that a fold must be away from its ends to be looked at from both sides"""
    mirrored: float = 1e-4
    """periods on the two sides of a mirror differ by less than this share of how much they have changed"""
    there: float = 1e-3
    """a family turns at a join when their parameters differ by less than this share of its change in the step"""
    same: float = 1e-7
    alike: float = 1e-4
    """orbits whose periods, parameters and actions, and whose means and spreads, are as near as this, are one orbit"""
    fewest: int = 5
    """a closed family, and a canard, has at least so many steps"""


SHRINKING, MEETING = Shrinking(), Meeting()


def end_at(run: Run, before: Walked, after: Walked) -> End | None:
    """The reason to stop after a step, or None."""
    curve, solution = run.curve, after.solution
    if self_excited(curve):
        # one that is the one before half a period later is behind an equilibrium
        (first, here), (other, there) = (about_mean(curve, each) for each in (before.solution, solution))
        weights = curve.scales.states**-2.0  # in their extents what does not move is noise
        alike = np.einsum("kd,kd->d", first, other) @ weights
        if alike < SHRINKING.turned * np.sqrt((here @ weights) * (there @ weights)):
            raise ConvergenceError("the orbits pass amplitude 0 within one step")
    elif collapsed(curve, before.solution, solution):
        return _steady(curve, before) if curve.equations.symmetry.relative else _at_equilibrium(run, before.solution)
    else:  # smaller than the one before, hardly slower or faster, and small beside where it is
        (once, _), (size, far) = (_extent_and_place(curve, each) for each in (before.solution, solution))
        steady = abs(solution.place.period / before.solution.place.period - 1.0) < SHRINKING.steady
        shrunk = steady and size < min(SHRINKING.smaller * once, LEAST * far)
        if shrunk and linear(curve, solution, SHRINKING.linear):
            return _at_equilibrium(run, solution)
    if passed(curve, before.solution, solution):
        raise ConvergenceError("another family is joined within one step")
    if curve.equations.model.forced or slowness(curve, solution)[0] <= SLOW.share:
        return None
    if after.stretch > run.settings.longest_period:
        return blown_up(run, after)
    stretch = float(np.log(after.point.period / before.point.period))
    change = abs(after.point.energy - before.point.energy) / nonzero(stretch)
    settled = stretch > 0 and change < SLOW.settled * abs(after.point.energy - run.origin.energy)
    if not curve.equations.physical and after.point.scale > SLOW.undecided and settled:
        return blown_up(run, after, f", multiplier {after.point.scale:.2g}, while the energy stands still")
    return None


def approach(run: Run, before: Walked, length: float, seen: dict[Invariance, Join]) -> tuple[float, End | None]:
    """How long the next step may be, so as not to pass over the Hopf point or the family in which this one ends.

    Or that end, where it is near and nothing is wanted before it. `seen` are the joins that the run has ahead of it.
    """
    try:
        length, ended = _to_hopf(run, before, length) if self_excited(run.curve) else (length, None)
        return (length, ended) if ended else _to_join(run, before, length, seen)
    except IntegrationError:  # as far ahead as is looked
        return length, None


def _to_hopf(run: Run, before: Walked, length: float) -> tuple[float, End | None]:
    """The same towards a Hopf point, before which no multiplier may be left to pass the unit circle."""
    away = vanishing(run.curve, before.sample, length)
    rest, off = _shrinks_to(run, before, away) if away < SHRINKING.ahead * length else (None, np.inf)
    if rest is None or off > SHRINKING.agreed:
        return length, None
    near = away < length or abs(before.point.value - rest.value) < SHRINKING.close * abs(run.origin.value - rest.value)
    multipliers = before.sample.about.floquet.multipliers
    grown = np.abs(np.delete(multipliers, np.argmin(np.abs(multipliers - 1.0)))) > 1.0
    other = near and np.count_nonzero(grown) != np.count_nonzero(rest.others.real > 0)
    if other or _wanted(run, before, rest.value, rest.error):
        return min(length, MEETING.short * away), None
    return length, _hopf(run, rest) if near else None


def _to_join(run: Run, before: Walked, length: float, seen: dict[Invariance, Join]) -> tuple[float, End | None]:
    """The same towards a family that is joined: seen from a first guess, then from orbits a small share beside it."""
    name = run.settings.parameter
    for kept, away, apart in approaching(run.curve, before.sample, length):
        if MEETING.short * away > length:
            continue
        join, beside = seen.get(kept), apart > MEETING.apart
        if join is None or not beside or not agrees(join, before, away, name):  # the end is told from the nearest orbit
            join = solved(run.curve, before.solution, name, kept)
        if join is None or not agrees(join, before, away, name):
            continue
        seen[kept] = join
        if beside or _wanted(run, before, join.value, join.error):
            return min(length, MEETING.short * away), None
        return length, end_of(join)
    return length, None


def _wanted(run: Run, before: Walked, value: float, error: float) -> bool:
    """Whether something that is asked for lies before this value of the parameter."""
    now, far = before.point.value, 1e-9 * abs(run.origin.value - value) + error
    wanted = [*run.at, *([] if run.until is None else [run.until])]
    return any(min(now, value) < other < max(now, value) and abs(other - value) > far for other in wanted)


def self_excited(curve: Curve) -> bool:
    """Whether a family is one of a physical parameter and of equations that keep no energy."""
    return bool(curve.equations.physical) and curve.equations.model.dissipative and can_rest(curve)


def _shrinks_to(run: Run, step: Walked, away: float) -> tuple[RestPoint | None, float]:
    """The Hopf point near an orbit, and by how much of their way parameter and period miss it `away` along the tangent.

    Both are even in the amplitude, so that they change by half of what the tangent says.
    """
    solution, name = step.solution, run.settings.parameter
    rest = rest_of(run.curve, solution, name) if np.isfinite(away) else None
    if rest is None:
        return None, np.inf
    left = np.array([rest.value - step.point.value, rest.period - solution.place.period])
    slopes = np.array([step.sample.slopes[name], step.sample.slopes["period"]])
    least = np.array([rest.error, 1e-6 * rest.period])
    return rest, float(np.max(np.abs(left - 0.5 * away * slopes) / np.maximum(np.abs(left), least)))


def _hopf(run: Run, rest: RestPoint, more: str = "") -> End:
    name, where, values = run.settings.parameter, np.array2string(rest.state, precision=6), np.array([rest.value])
    model = with_parameters(run.curve.equations.model, {**run.origin.free, name: rest.value})
    problem = regular(at_rest(model, (name,), rest.state), rest.state, values)
    z = np.append(rest.state, np.zeros(problem.jets.extra))
    coefficient, _, side, _ = first_lyapunov(problem, z, values, 2 * np.pi / rest.period, ROUND_OFF * problem.z_sizes)
    grown = int(np.count_nonzero(rest.others.real > 0))
    beside = f" beside {plural(grown, 'eigenvalue')} that grow" if grown else ""
    lasts = lasting(rest.period, run.curve.equations.model.system)
    reason = (
        f"the orbits shrink to the Hopf point at {name} {rest.value:.12g} (+- {rest.error:.1g}), period {lasts}, of "
        f"the branch of equilibria through {where}, {side} (l1 = {coefficient:.6g}){beside}{more}"
    )
    return End("hopf", reason, rest.value, rest.period, rest.error)


def _extent_and_place(curve: Curve, solution: Solution) -> tuple[float, float]:
    """The largest extent of a coordinate, and how far from the origin the motion is."""
    q = solution.march.states[:, : curve.equations.model.degrees_of_freedom]
    return float(np.ptp(q, axis=0).max()), float(np.abs(q[0]).max())


def _at_equilibrium(run: Run, solution: Solution) -> End:
    where, period = np.array2string(centre(run.curve, solution), precision=6), solution.place.period
    system = run.curve.equations.model.system
    rest = rest_of(run.curve, solution, run.settings.parameter) if can_rest(run.curve) else None
    known = (rest.value, rest.period, rest.error) if rest else ()
    period = rest.period if rest else period
    return End(
        "equilibrium",
        f"the orbits shrink to the equilibrium at q = {where}, period {lasting(period, system, 9)}",
        *known,
    )


def end_of_failure(run: Run, step: Walked, failure: str) -> End:
    """The reason why no further step could be taken."""
    curve, solution = run.curve, step.solution
    try:
        if (met := _met(run, step, failure)) is not None:
            return met
    except IntegrationError:
        pass
    slow = step.stretch > SLOW.grown and slowness(curve, solution)[0] > SLOW.grown_share
    if slow and (end := blown_up(run, step, f"; then {failure}")) is not None:
        return end
    if slow and step.stretch > run.settings.longest_period:  # no canard
        return End("step underflow", f"the period is {step.stretch:.3g} times the shortest, no saddle near; {failure}")
    dead = dead_point(curve.equations.model, solution.march.states, freed(curve, solution.place))
    if dead:
        return End("dead point", f"{dead}, where the coordinates of this family end; {failure}")
    size, far = _extent_and_place(curve, solution)
    first, last = np.linalg.norm(step.portraits[[0, -1], -curve.equations.size :] / curve.scales.states, axis=1)
    shrunk = last < SHRINKING.smaller * first and size < 10 * LEAST * far
    if shrunk and linear(curve, solution, SHRINKING.nearly):
        return _at_equilibrium(run, solution)
    if (end := _canard(run, step, failure)) is not None:
        return end
    return singularity(curve, solution, failure) or End("step underflow", failure)


def _canard(run: Run, step: Walked, failure: str) -> End | None:
    """The end of a family of relaxation oscillations that changes beyond what its parameter's digits can tell."""
    if not self_excited(run.curve):
        return None
    p, name = run.curve.equations, run.settings.parameter
    k, method = p.physical.index(name), p.by.name
    values, periods = step.portraits[:, 1 + k], step.portraits[:, 0]
    first, width = explosion(values)
    period, size = (changing(rows) for rows in (periods[first:, None], step.portraits[first:, -p.size :]))
    if values.size - first < MEETING.fewest or max(period, size) < SHRINKING.explosion:
        return None
    reason = (
        f"a canard explosion: within {width:.1g} of {name} {values[-1]:.12g} the period changes from "
        f"{periods[first]:.6g} to {lasting(periods[-1], p.model.system, 6)} and the extents by {100 * size:.2g} %, "
        f"along orbits that follow a repelling slow motion for so long that {method} cannot hold them; {failure}"
    )
    return End("canard", reason, float(values[-1]), float(periods[-1]), width)


def explosion(values: np.ndarray) -> tuple[int, float]:
    """Since when a parameter hardly changes, of its values along a family, and by how much it does."""
    apart = np.abs(values - values[-1]) > SHRINKING.exploded * np.ptp(values)
    first = int(np.flatnonzero(apart)[-1]) + 1 if apart.any() else 0
    return first, float(np.ptp(values[first:]))


def changing(rows: np.ndarray) -> float:
    """The most that any size (k x m) changes along its column, relative to its largest."""
    sizes = nonzero(rows)
    return float(np.max(np.ptp(sizes, axis=0) / sizes.max(axis=0)))


def _met(run: Run, step: Walked, failure: str) -> End | None:
    """The join or the Hopf point that a family failed to reach."""
    curve, solution, name = run.curve, step.solution, run.settings.parameter
    for kept, away, _ in approaching(curve, step.sample, step.point.step):
        join = solved(curve, solution, name, kept)
        if join is not None and agrees(join, step, away, name):
            return end_of(join, f"; {failure}")
    if not self_excited(curve):
        return None
    rest, off = _shrinks_to(run, step, vanishing(curve, step.sample, step.point.step))
    if rest is None:
        return None
    halted = abs(step.point.value - rest.value) < SHRINKING.halted * abs(run.origin.value - rest.value)
    return _hopf(run, rest, f"; {failure}") if off < SHRINKING.agreed or halted else None


def shortest_step(run: Run, step: Walked) -> float:
    """How short a step may become: near a homoclinic orbit, which passes its saddle and round-off rules, not very."""
    curve, solution, usual = run.curve, step.solution, run.settings.shortest_step
    if not step.stretch > SLOW.grown:
        return usual
    return SLOW.step if slowness(curve, solution)[0] > SLOW.share and held_up(curve, solution) else usual


def linear(curve: Curve, solution: Solution, within: float) -> bool:
    """Whether an orbit is a linear oscillation about an equilibrium: its period is, to this share, that of a pair i w.

    It differs with the square of the amplitude.
    """
    p, n = curve.equations, curve.equations.model.degrees_of_freedom
    if not p.can_rest:
        return False
    middle = np.concatenate([centre(curve, solution), np.zeros(p.size - n)])
    turns = np.abs(rest_near(curve, solution, middle, 1.0)[1].imag) * solution.place.period / (2 * np.pi)
    return bool(np.any(np.abs(turns - 1.0) < within))


def singularity(curve: Curve, solution: Solution, failure: str) -> End | None:
    """The end of a family whose motion is somewhere so much faster than elsewhere that its equations are singular."""
    states, mesh, model = solution.march.states, solution.place.mesh, curve.equations.model
    rates, middle = curve.equations.march.rates, 0.5 * (states.max(axis=0) + states.min(axis=0))
    slopes, times = rates(states, solution.place.tail, mesh * solution.place.period), mesh * solution.place.period
    beyond = ~np.isfinite(rates(middle + SHRINKING.wider * (states - middle), solution.place.tail, times)).all(axis=1)
    if beyond.any():
        where = np.array2string(states[np.argmax(beyond)], precision=6)
        return End("singularity", f"the motion comes near a singularity: beyond {where} its equations are not defined; "
                   f"{failure}")  # fmt: skip
    # jumps of relaxation oscillations are no singularities, nor is a swing that is fast beside a rest at a saddle
    if self_excited(curve) or near_saddle(curve, solution):
        return None
    n, what = model.degrees_of_freedom, "acceleration" if model.rates is None else "rate"
    pushed = slopes[:, n:] / curve.shares if n < states.shape[1] else slopes / extents(curve, states)
    speed = np.linalg.norm(pushed, axis=1)
    # along the path and not in time, in which an orbit may be at rest
    path = np.append(0.0, np.cumsum(np.sqrt(np.diff(states[:, :n], axis=0) ** 2 @ curve.weights[:n])))
    usual = float(np.median(np.interp(np.linspace(0, path[-1], speed.size), path, speed)))
    if not speed.max() > SHRINKING.abrupt * usual:
        return None
    where = np.array2string(states[int(np.argmax(speed)), :n], precision=4, suppress_small=True)
    return End(
        "singularity",
        f"the motion comes near a singularity at q = {where} (a collision, say), where its {what} is "
        f"{speed.max() / usual:.3g} times the median; {failure}",
    )


def centre(curve: Curve, solution: Solution) -> np.ndarray:
    """The middle of an orbit's configurations (n): where a shrinking family is going."""
    n = curve.equations.model.degrees_of_freedom
    held, q = curve.centre, solution.march.states[:, :n]
    return np.where(np.isnan(held), 0.5 * (q.max(axis=0) + q.min(axis=0)), held)


def collapsed(curve: Curve, before: Solution, solution: Solution) -> bool:
    """Whether the last step went through an equilibrium: the orbit is now on the other side of its middle."""
    n, relative = curve.equations.model.degrees_of_freedom, curve.equations.symmetry.relative
    weights, still = curve.weights[: curve.equations.size], np.zeros(curve.equations.size - n)
    paths = [beside_shifts(s.march.states, relative) for s in (before, solution)]
    rates = [0.5 * (path[:, n:].max(axis=0) + path[:, n:].min(axis=0)) if relative else still for path in paths]
    middles = [centre(curve, s) for s in (before, solution)] if not relative else [
        0.5 * (path[:, :n].max(axis=0) + path[:, :n].min(axis=0)) for path in paths
    ]  # fmt: skip
    first, other = (path[0] - np.concatenate(parts) for path, *parts in zip(paths, middles, rates, strict=True))
    moved = float(np.sqrt(weights @ (other - first) ** 2))
    sizes = [np.ptp(path[:, :n], axis=0) * np.sqrt(weights[:n]) for path in paths]
    return bool(np.sum(weights * first * other) < 0 and np.max(sizes) < 3 * moved)


def beside_shifts(states: np.ndarray, relative: Sequence[Sequence[float]]) -> np.ndarray:
    """States (k x 2n) with the coordinates brought back along the directions that an orbit is relative in."""
    n = states.shape[1] // 2
    return np.array([[*beside(state[:n], relative), *state[n:]] for state in states]) if relative else states


def _steady(curve: Curve, before: Walked) -> End:
    """The end of a family that shrinks to a relative equilibrium, by its last orbit before it."""
    shift, period = before.point.shift, before.point.period
    rates = ", ".join(f"{name} by {by / period:.9g} a second" for name, by in shift.items())
    states = beside_shifts(before.solution.march.states, curve.equations.symmetry.relative)
    middle = 0.5 * (states.max(axis=0) + states.min(axis=0))[: states.shape[1] // 2]
    return End(
        "relative equilibrium",
        f"the orbits shrink to a relative equilibrium at q = {np.array2string(middle, precision=6)}, which moves "
        f"{rates}, period {lasting(period, curve.equations.model.system, 9)}",
    )


def returned(curve: Curve, before: Walked, after: Walked) -> End | None:
    """The end of a closed family: the last step passed an earlier one again, going the same way.

    What looks near, by numbers that do not depend on where t = 0 lies, is confirmed by an orbit of the family with the
    period and the parameters of the earlier one: it must be the same.
    """
    if len(before.portraits) <= MEETING.fewest:
        return None
    units = _units(curve, before.solution)
    known, reached = before.portraits / units, after.portraits[-1] / units
    past, here, step = known[: 1 - MEETING.fewest], known[-1], reached - known[-1]
    square, ahead = float(step @ step), np.diff(known[: 2 - MEETING.fewest], axis=0)
    if not square > 0.0:
        return None
    shares = (past - here) @ step / square
    aside = np.sqrt(np.maximum(((past - here) ** 2).sum(axis=1) - shares**2 * square, 0.0))
    near = (shares >= 0.0) & (shares <= 1.0) & (aside < 0.1 * np.sqrt(square)) & (ahead @ step > 0)
    for k in np.flatnonzero(near):
        if passed_again(curve, before.solution, after.solution, units * past[k]):
            where, length = "its start" if k == 0 else f"its step {k}", abs(after.point.arclength)
            return End("returned", f"a closed family: back at {where} after an arclength of {length:.6g}")
    return None


def passed_again(curve: Curve, before: Solution, after: Solution, past: np.ndarray) -> bool:
    """Whether the orbit between two of a step that has the period and the parameters of a past orbit's `portrait` is
    that past orbit."""
    place, count, units = before.place, 1 + before.place.free.size, _units(curve, before)
    here, there = (portrait(curve, solution) / units for solution in (before, after))
    step, off = there - here, past / units - here
    normal = np.concatenate([np.zeros(curve.equations.size), step[:count] / units[:count]])
    aim = hyperplane(float(step[:count] @ (past / units)[:count]), normal)
    try:
        again = correct(curve, place.blended(after.place, float(off @ step / (step @ step))), aim, place)
    except UNSOLVED:
        return False
    apart = np.abs((portrait(curve, again) - past) / units)
    return bool(apart[: count + 1].max() < MEETING.same and apart.max() < MEETING.alike)


def _units(curve: Curve, solution: Solution) -> np.ndarray:
    """What a portrait is measured in."""
    scales, action = curve.scales, abs(solution.march.integral) or 1.0
    return np.concatenate([[scales.period], scales.free, [action], scales.states, scales.states])


def mirrored(interval: Interval, at: float) -> bool:
    """Whether a hybrid family is its own mirror image about a fold in energy, or a parameter, `at` so far into a step.

    Then orbits of one energy on its two sides have one period, and of one parameter one action, which at a plain fold
    differ to first order. Raises `ConvergenceError` at the edge of the step.
    """
    name = interval.curve.equations.parameter

    def read(distance: float) -> np.ndarray:
        solution = interval.sample(distance).solution
        value = parameter_value(interval.curve, solution.place, name)
        return np.array([value, solution.place.period if name == "energy" else solution.march.integral])

    turn, ends = read(at), {distance: read(distance) for distance in (0.0, interval.length)}
    near, far = sorted(ends, key=lambda distance: abs(ends[distance][0] - turn[0]))
    if abs(near - at) < MEETING.edge * interval.length:
        raise ConvergenceError("the family turns at the edge of a step")
    level = ends[near]
    other = read(zero(lambda distance: float(read(distance)[0] - level[0]), at, far, LOCATION))
    return bool(abs(other[1] - level[1]) < MEETING.mirrored * abs(level[1] - turn[1]))


def merged(interval: Interval, at: float, name: str) -> End | None:
    """At a fold so far into a step: whether the family joins one of more symmetry or of a shorter period.

    A branch is its own mirror image about the orbit that it was born from, so that what it is followed in turns there.
    """
    curve, solution = interval.curve, interval.sample(at).solution
    model, (times, states) = curve.equations.model, full_samples(curve, solution)
    seen = recognise(times, states, model)
    gaps_of = {k: float((return_gaps(curve, states, k) / curve.units).max()) for k in EVEN}
    extent = float(np.ptp(states / curve.units, axis=0).max())
    covers = max((k for k in EVEN if gaps_of[k] < MEETING.symmetric * extent), default=1)
    if covers == 1 and seen in (NONE.name, curve.equations.symmetry.name):
        return None
    if not curve.equations.links:
        times, beside = full_samples(curve, interval.first.solution)
        if covers == 1:
            other, some = named(seen, model), beside[:: len(beside) // 3]
            held = all(other.held_by(model, state, curve.cycles) for state in some)
            if not held or recognise(times, beside, model) == seen:
                return None  # the motion has it and the equations have not, or the family has it itself
        join = solved(curve, solution, name, Invariance(covers), seen if covers == 1 else "")
        values = [parameter_value(curve, interval.sample(d).solution.place, name) for d in (0.0, at, interval.length)]
        there = join is not None and abs(join.value - values[1]) < MEETING.there * np.ptp(values)
        return end_of(join) if join is not None and there else None
    if not mirrored(interval, at):
        return None
    what = f"of period T/{covers}" if covers > 1 else f"of symmetry {seen}"
    place, names = solution.place, curve.equations.physical or ("energy",)
    where = ", ".join(f"{name} {measured(parameter_value(curve, place, name), name, model.system)}" for name in names)
    return End("merged", f"joins a family {what} at {where}, period {lasting(place.period, model.system, 9)}")
