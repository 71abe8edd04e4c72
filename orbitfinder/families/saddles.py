"""Where the period of a family grows without bound: the equilibria that its orbits come near, and the parameter there.

With k passages alike of saddles whose nearest stable and unstable eigenvalues are -nu and mu, the parameter p goes to
its limit with powers of exp(-mu T / k) and exp(-nu T / k). In a heteroclinic cycle of which the parameter breaks the
connection to saddle 1 alone, with those of exp(-mu_1 T_1), T_(i+1) = (nu_i / mu_(i+1)) T_i, T the sum of all T_i.
Where a saddle-node is on the cycle, with powers of 1 / T from the second on. Sources: A. J. Homburg, B. Sandstede,
Handbook of Dynamical Systems III (2010) 379-524; Yu. A. Kuznetsov, Elements of Applied Bifurcation Theory (2004),
sections 6.2 and 7.1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter

import numpy as np

from orbitfinder.continuation.follow import zero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.motion import rates_along
from orbitfinder.families.point import extents, freed, parameter_value
from orbitfinder.families.rest import ROUND_OFF, can_rest
from orbitfinder.families.rest_problem import Stacked, error_bars, regular, singular, solve_square, spectrum
from orbitfinder.families.run import Run, Walked
from orbitfinder.integrate.jets import at_rest
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.loops.mesh import STEP_ERROR
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.newton import Settings, equilibrium
from orbitfinder.mechanics.scales import lasting, measured
from orbitfinder.records.family import End


@dataclass(frozen=True)
class Slow:
    """When a slow orbit counts as nearly homoclinic."""

    slow: float = 0.1
    """a motion slower than this share of its fastest is near an equilibrium"""
    share: float = 0.4
    """... and an orbit that spends this share of its period there is nearly homoclinic to it,"""
    near: float = 0.1
    """... if within this share of the motion's extents an equilibrium is"""
    passed: float = 0.01
    """... which is passed where the motion comes as near as this"""
    grown: float = 1.5
    grown_share: float = 0.25
    """a step underflow with the period this much above the shortest, and slow for this share, is read as homoclinic"""
    undecided: float = 1e11
    """beyond this multiplier the closure that double precision can hold says nothing about the orbit,"""
    settled: float = 1e-3
    """and a nearly homoclinic family ends once its energy changes by less than this share of what it has by then"""
    step: float = 1e-2
    """steps of a nearly homoclinic family are not made shorter than this"""
    alike: float = 0.1
    """the rate at which the parameter settles is the eigenvalues' to this share, and a saddle-node is where it goes"""


SLOW = Slow()
AT_REST = Settings(floor=1e-6, round_off=1e-6, converged=1e-6, most_evaluations=12, cutoff=1e-9)
"""How an equilibrium beside an orbit is looked for, in its extents"""
LATEST, TERMS, SEEN, CLEAR = 60, 3, 5, 1e4
"""Orbits of a family from whose last its limit is told, terms of its series at most, orbits that tell its
rate, which are so many times farther from the last than they are known"""
Limit = tuple[float, float]
Saddle = tuple[np.ndarray, np.ndarray]


def slowness(curve: Curve, solution: Solution) -> tuple[float, np.ndarray]:
    """Share of the period spent slower than `SLOW.slow` times the fastest rate, and the slowest state.

    Turning points are not slow in this sense: the speed includes the scaled acceleration.
    """
    states, weights = solution.march.states, np.diff(solution.place.mesh)
    speed = _speeds(curve, rates_along(curve, solution))
    slow = 0.5 * (speed[1:] + speed[:-1]) < SLOW.slow * speed.max()
    return float(weights[slow].sum() / weights.sum()), states[np.argmin(speed)]


def _speeds(curve: Curve, rates: np.ndarray) -> np.ndarray:
    return np.asarray(np.sqrt(rates**2 @ curve.weights[: curve.equations.size]))


def near_saddle(curve: Curve, solution: Solution) -> bool:
    """Whether an orbit is slowest near an equilibrium with a growing direction, relative to its extents; of what is
    driven none is.

    Without one, a slow and long orbit is no nearly homoclinic one.
    """
    if curve.equations.model.forced:
        return False
    return _grows(solution, rest_near(curve, solution, slowness(curve, solution)[1], SLOW.near)[1])


def held_up(curve: Curve, solution: Solution) -> bool:
    """Whether an orbit is slowest near a saddle and, where it can rest, passes one: it is not of a canard."""
    return near_saddle(curve, solution) and (not can_rest(curve) or any(passed(curve, solution)))


def _grows(solution: Solution, eigenvalues: np.ndarray) -> bool:
    return eigenvalues.size > 0 and bool(eigenvalues.real.max() * solution.place.period > 1.0)


def rest_near(curve: Curve, solution: Solution, state: np.ndarray, near: float) -> Saddle:
    """The equilibrium within a share of the motion's extents of a state, and its eigenvalues; none without one."""
    p, place = curve.equations, solution.place
    n, units = p.model.degrees_of_freedom, extents(curve, solution.march.states)
    still = np.zeros(p.size - n)

    def linearised(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x = np.append(q, still)
        if np.any(np.abs(x - state) > near * units):
            return np.full(n, np.nan), np.eye(n)
        # at rest the first rates, which are the velocities, are 0; a first-order system's are all to be solved for
        return p.march.rates(x[None], place.tail)[0][-n:], p.march.arcs[0].slopes(x, place.tail)[-n:, :n]

    rest = equilibrium(linearised, state[:n], units[:n], AT_REST)
    if not rest.converged:
        return state, np.zeros(0)
    x = np.append(np.where(np.abs(rest.w) > AT_REST.cutoff * units[:n], rest.w, 0.0), still)
    return x, np.linalg.eigvals(p.march.arcs[0].slopes(x, place.tail))


def passed(curve: Curve, solution: Solution) -> Iterator[Saddle]:
    """The saddles (state and eigenvalues) that an orbit comes near in a period, in this order, each as often."""
    mesh, states = curve.equations.symmetry.whole(solution.place.mesh, solution.march.states, curve.constant)
    mesh, states = mesh[:-1], states[:-1]
    place = solution.place
    speed = _speeds(curve, curve.equations.march.rates(states, place.tail, mesh * place.period))
    slow = speed < SLOW.slow * speed.max()
    begins = np.flatnonzero(slow & ~np.roll(slow, 1))
    for begin in begins:
        passage = np.roll(np.arange(mesh.size), -begin)
        passage = passage[: int(np.argmin(np.append(slow[passage], False)))]
        state, eigenvalues = rest_near(curve, solution, states[passage[np.argmin(speed[passage])]], SLOW.passed)
        if _grows(solution, eigenvalues):
            yield state, eigenvalues


def blown_up(run: Run, step: Walked, more: str = "") -> End | None:
    """The end of a family whose period has grown, at the saddles or the saddle-node that its orbits come near."""
    curve, solution, n = run.curve, step.solution, run.curve.equations.model.degrees_of_freedom
    state, resting = slowness(curve, solution)[1], can_rest(curve)
    system = curve.equations.model.system
    lasts = lasting(solution.place.period, system, 6)
    grown = f"the period blows up ({lasts}, {step.stretch:.3g} times the shortest)"
    known = list(passed(curve, solution)) if resting else []
    if not held_up(curve, solution):
        return _saddle_node(run, step, state, grown, more) if resting else None
    energy = parameter_value(curve, solution.place, "energy")
    grown += (
        f" at energy {measured(energy, 'energy', system)}"
        if np.isfinite(energy) and run.settings.parameter != "energy"
        else ""
    )
    if not known:
        where = np.array2string(state[:n], precision=4, suppress_small=True)
        return End("homoclinic", f"{grown}, slowest near q = {where}{more}")
    saddles = told_apart(curve, solution, known)
    value, error, settles = _limit(run, step, known)
    kind, what = (
        ("homoclinic", "orbit of the saddle") if len(saddles) == 1 else ("heteroclinic", "cycle of the saddles")
    )
    written = [", ".join(f"{v.real:.6g}{f' {v.imag:+.6g}i' if v.imag else ''}" for v in np.sort_complex(by))
               for _, by in saddles]  # fmt: skip
    named = " and ".join(f"q = {np.array2string(x[:n], precision=6)} (eigenvalues {values})"
                         for (x, _), values in zip(saddles, written, strict=True))  # fmt: skip
    reason = (
        f"{grown} towards a {kind} {what} {named} at {run.settings.parameter} {value:.12g} (+- {error:.1g}){settles}"
    )
    return _end(step, kind, reason + more, (value, error), known)


def _end(step: Walked, kind: str, reason: str, limit: Limit, saddles: Sequence[Saddle]) -> End:
    known = tuple({"state": x.tolist(), "eigenvalues": [[v.real, v.imag] for v in np.sort_complex(values).tolist()]}
                  for x, values in saddles)  # fmt: skip
    return End(kind, reason, limit[0], float(step.solution.place.period), limit[1], saddles=known)


def told_apart(curve: Curve, solution: Solution, known: Sequence[Saddle]) -> list[Saddle]:
    """Those of some saddles that are not the same, whole turns aside."""
    units, saddles = extents(curve, solution.march.states), list[Saddle]()
    angular = np.resize(curve.equations.model.angular, units.size)
    for x, by in known:
        gaps = [np.abs(np.where(angular, np.exp(1j * (x - y)) - 1, (x - y) / units)).max() for y, _ in saddles]
        saddles += [(x, by)] if all(gap > SLOW.passed for gap in gaps) else []
    return saddles


def _limit(run: Run, step: Walked, known: Sequence[Saddle]) -> tuple[float, float, str]:
    """The parameter at an infinite period and its error, with the rate at which it settles in words."""
    curve, place, name = run.curve, step.solution.place, run.settings.parameter
    if name not in curve.equations.physical:  # of an energy, or another integral, it is the saddle's own
        value = parameter_value(curve, replace(place, nodes=known[0][0][None]), name)
        return value, ROUND_OFF * max(abs(value), abs(parameter_value(curve, place, name))), ""
    periods, values = step.portraits[:, 0], step.portraits[:, 1 + curve.equations.physical.index(name)]
    return homoclinic_limit(periods, values, [each for _, each in known], noise_of(curve, step.solution, name))


def noise_of(curve: Curve, solution: Solution, name: str) -> float:
    """What errors of the integration in all pieces of an orbit make of its parameter, at a fixed period."""
    place, period = solution.place, np.zeros(solution.place.vector.size)
    period[place.nodes.size] = 1.0
    wanted = np.zeros(period.size)
    wanted[place.vector.size - place.free.size + curve.equations.physical.index(name)] = 1.0
    made = np.linalg.lstsq(np.vstack([solution.matrix, period]).T, wanted, rcond=None)[0][: place.nodes.size]
    return STEP_ERROR * float(np.abs(made) @ np.tile(extents(curve, solution.march.states), len(place.nodes)))


def passage_rates(eigenvalues: Sequence[np.ndarray]) -> list[np.ndarray]:
    """The exponents (1/s), least first, with which a parameter may settle as orbits pass saddles of these eigenvalues.

    First those of passages alike, of complex ones one of each pair; then those of cycles of which a connection breaks.
    """
    count = len(eigenvalues)
    own = np.concatenate([np.where(values.real > 0, values, -values) for values in eigenvalues]).astype(complex) / count
    own = own[(own.imag >= 0) & (own.real > 0)]
    rates, kept = np.concatenate([own, *(a + own for a in own)]), list[complex]()
    for rate in rates[np.argsort(rates.real, kind="stable")]:
        if all(abs(rate - other) > 0.5 * SLOW.alike * abs(other) for other in kept):
            kept.append(complex(rate))
    mu, nu = (np.array([float((sign * values.real)[sign * values.real > 0].min(initial=np.inf))
                        for values in eigenvalues]) for sign in (1, -1))  # fmt: skip
    ratios = np.array(
        [np.append(1.0, np.roll(nu, -k)[:-1] / np.roll(mu, -k)[1:]).cumprod().sum() for k in range(count)]
    )
    broken = mu / ratios if count > 1 and np.isfinite(nu).all() else np.zeros(0)
    return [np.array(kept), *(rate * np.arange(1.0, TERMS + 1) for rate in broken)]


def homoclinic_limit(
    periods: np.ndarray, values: np.ndarray, eigenvalues: Sequence[np.ndarray], noise: float
) -> tuple[float, float, str]:
    """The value at an infinite period, its error and how it settles, of orbits in order of the period past saddles.

    Values are known to `noise`. Where the rate is not the eigenvalues' the last orbits alone say it, and their distance
    from the limit is its error.
    """
    known = passage_rates(eigenvalues)
    rate, last = settling(periods, values, noise)
    if known[0][0].imag or not np.isfinite(rate):
        settles = f", settling with exp(-{known[0][0].real:.4g} T) as its eigenvalues say"
        return *extrapolated(periods, values, known[0][:TERMS], noise), settles
    rates = min(known, key=lambda rates: abs(rates[0].real - rate))[:TERMS]
    settles = f", settling with exp(-{rate:.4g} T) where eigenvalues say {rates[0].real:.4g}"
    if abs(rate / rates[0].real - 1.0) < SLOW.alike:
        return *extrapolated(periods, values, rates, noise), settles
    value, error = extrapolated(periods[: last + 1], values[: last + 1], np.array([rate]), noise)
    return value, abs(value - float(values[last])) + error, settles


def settling(periods: np.ndarray, values: np.ndarray, noise: float) -> tuple[float, int]:
    """The rate at which values go to a limit exponentially, nan where none is seen, and the last orbit that says it."""
    clear = np.flatnonzero(np.abs(values - values[-1]) > CLEAR * noise)
    if clear.size < SEEN:
        return np.nan, len(values) - 1
    a, b, c = chosen = clear[[-SEEN, -(SEEN + 1) // 2, -1]]

    def off(rate: float) -> float:
        e = np.exp(-rate * (periods[chosen] - periods[c]))
        return float((values[b] - values[a]) * (e[2] - e[1]) - (values[c] - values[b]) * (e[1] - e[0]))

    span = float(periods[c] - periods[a])
    ends = 1e-3 / span, 50.0 / span
    if not (span > 0 and off(ends[0]) * off(ends[1]) < 0):
        return np.nan, int(c)
    return zero(off, *ends, 1e-12 * ends[0]), int(c)


def saddle_node_limit(periods: np.ndarray, values: np.ndarray, noise: float) -> Limit:
    """The value at an infinite period and its error, of orbits that slow down at a saddle-node."""
    return extrapolated(np.log(periods), values, np.array([2.0, 3.0, 4.0]), noise)


def extrapolated(clock: np.ndarray, values: np.ndarray, rates: np.ndarray, noise: float) -> Limit:
    """The limit of a series in exp(-rate t) for large t, with its error, from values at a growing t.

    Exactly through as many values as there are terms, over which the first changes e times from each to the next; the
    error is what the last term changes, here and one value before, and what `noise` of the values makes.
    """
    best = float(values[-1]), np.inf
    for count in range(1, len(rates) + 1):
        before = np.inf
        for last in range(max(2, len(values) - LATEST), len(values)):
            pair = [_through(clock[: last + 1], values[: last + 1], rates[:k]) for k in (count, count - 1)]
            if None not in pair:
                (value, blown), (less, _) = pair  # type: ignore[misc]
                change = abs(value - less)
                best = min(best, (value, max(change, before) + noise * blown), key=itemgetter(1))
                before = change
    return best


def _through(clock: np.ndarray, values: np.ndarray, rates: np.ndarray) -> Limit | None:
    """The limit of a series through the last values, and what it makes of errors; None where there are too few."""
    chosen, wanted = [len(clock) - 1], 1 + len(rates) + int(np.count_nonzero(np.imag(rates)))
    while len(chosen) < wanted:
        earlier = np.flatnonzero(clock[: chosen[-1]] <= clock[chosen[-1]] - 1.0 / rates[0].real)
        if not earlier.size:
            return None
        chosen.append(int(earlier[-1]))
    powers = np.exp(-np.multiply.outer(clock[chosen] - clock[-1], rates))
    matrix = np.hstack([np.ones((wanted, 1)), powers.real, powers.imag[:, np.imag(rates) != 0]])
    weights = np.linalg.lstsq((matrix / np.abs(matrix).max(axis=0)).T, np.eye(wanted)[0], rcond=None)[0]
    return float(weights @ values[chosen]), float(np.abs(weights).sum())


def _saddle_node(run: Run, step: Walked, state: np.ndarray, grown: str, more: str) -> End | None:
    """The end at a saddle-node of equilibria to which the parameter goes with the period's inverse square."""
    curve, name = run.curve, run.settings.parameter
    if name not in curve.equations.physical:
        return None
    model = with_parameters(curve.equations.model, freed(curve, step.solution.place))
    periods, values = step.portraits[:, 0], step.portraits[:, 1 + curve.equations.physical.index(name)]
    rest = regular(at_rest(model, (name,), state), state, values[-1:])
    try:
        problem, guess = singular(rest, np.append(state, np.zeros(rest.jets.extra)), values[-1:], "fold")
        solved = solve_square(problem, guess)
        error = float(error_bars(problem, solved)[-1])
    except (ConvergenceError, IntegrationError, np.linalg.LinAlgError):
        return None
    z, p, _ = problem.parts(solved)
    x, value = z[: state.size], float(p[0])
    towards, bar = saddle_node_limit(periods, values, noise_of(curve, step.solution, name))
    near = np.all(np.abs(x - state) <= SLOW.near * extents(curve, step.solution.march.states))
    if not near or abs(towards - value) > SLOW.alike * abs(values[-1] - value) + bar:
        return None
    where = np.array2string(x[: curve.equations.model.degrees_of_freedom], precision=6)
    reason = (
        f"{grown} towards a saddle-node on the cycle, of equilibria at q = {where}, at {name} {value:.12g} "
        f"(+- {error:.1g}); by 1 / T^2 it is at {towards:.9g} (+- {bar:.1g}){more}"
    )
    return _end(step, "saddle-node", reason, (value, error), [(x, spectrum(rest, Stacked(np.append(z, p))).values)])
