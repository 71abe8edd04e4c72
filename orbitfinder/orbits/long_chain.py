"""Nonlinear normal modes of long chains: harmonic balance, then shooting over a quarter period.

A brake and reflection symmetric motion starts at rest at q0 and is at q = 0 a quarter period later, so
n + 1 unknowns (q0, T) and as many equations {q(T/4) = 0, one pin} are all there is; multiple shooting
with all states of all nodes would have 16 times as many at 8 segments. Harmonic balance follows the
family from the linear mode (see `harmonic_balance`), shooting takes its result to round-off, and the
multipliers of the whole period follow from one quarter by symmetry.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import lu_factor, lu_solve

from orbitfinder.errors import ConvergenceError, InputError, IntegrationError, OrbitfinderError
from orbitfinder.guesses import balance as harmonic_balance
from orbitfinder.guesses.balance import PinRow, Series
from orbitfinder.integrate.chain import CHUNK, Quarter
from orbitfinder.loops.conditions import Pin, pin_row
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.symmetry import QUARTER, recognise
from orbitfinder.mechanics.chain_lagrange import ChainLagrange
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import energy as total_energy
from orbitfinder.orbits.certify import certified
from orbitfinder.orbits.evidence import gap, is_long
from orbitfinder.orbits.find import provenance
from orbitfinder.orbits.floquet import Floquet, analyse, reduce_monodromy
from orbitfinder.orbits.measure import action
from orbitfinder.records.orbit import Orbit

SAMPLES = 512
"""Intervals of the dense samples over a period."""
NODES = 8
PATH_PHASE, NEWTON_PHASE, MULTIPLIER_PHASE = 0.5, 1.0, 0.3
"""Radians of the fastest linear mode in a step. Relative errors of the variations at 100 links: 2e-5 at 1
(enough for a Newton matrix), 2e-9 at 0.3."""
GROWTHS = (1.7, 1.4, 1.2)
"""Step growths with which the family is followed in turn: an internal resonance that stops one is stepped over by
another."""
DIRECT = 0.05
"""A guess that misses q = 0 by less than this, relative, after a quarter of its period is corrected directly."""
AGREEMENT = 1e-8
"""Closed form and recursion agree to this, relative: both lose cond(M) of the mass matrix, 5e4 at 100 links."""
UNUSED = ("relative_tolerance", "absolute_tolerance", "ipopt_tolerance")
"""Entries of the provenance about CVODES and IPOPT, neither of which is used here"""
MOST_STEPS, MOST_MATRICES, SHRINKING, WORST = 20, 4, 0.3, 1e-9


@dataclass(frozen=True, eq=False)
class Chain:
    """A long chain with what is derived from it once: its equations and its pin."""

    problem: Problem
    quarter: Quarter
    pin: Callable[[Pin], PinRow]

    @property
    def closed(self) -> ChainLagrange:
        """Its equations in closed form."""
        return self.quarter.closed

    @property
    def fastest(self) -> float:
        """The highest linear frequency in rad/s."""
        return float(np.sqrt(self.closed.squared[-1]))

    def chunks(self, period: float, phase: float, samples: int = 1) -> int:
        """Chunks of steps between `samples` equal times over a quarter period, the fastest mode turning by at most
        `phase` (rad) in a step."""
        return int(np.ceil(self.fastest * period / 4 / phase / (CHUNK * samples)))

    def end(self, start: np.ndarray, period: float) -> np.ndarray:
        """State (2n) a quarter of the period after rest at `start` (n), to round-off."""
        state = np.concatenate([start, np.zeros(start.size)])
        return np.asarray(self.quarter.refined(state, period / 4, 1, self.chunks(period, 2 * PATH_PHASE))[-1])


def suits(problem: Problem) -> bool:
    """True for a problem that this room solves: a symmetric mode of a long chain with one pin and nothing else."""
    model = problem.model
    return (
        is_long(model)
        and model.acceleration.is_a("SXFunction")
        and float(model.system["gravity"]) > 0
        and problem.boundary == QUARTER
        and len(problem.pin) == 1
        and not (problem.free or problem.bounds or problem.constraints or problem.objective != "nearest")
        and problem.phase_condition is None
        and problem.guess.states is None
        and float(np.abs(np.asarray(problem.guess.state)[: model.degrees_of_freedom]).max()) < np.pi
    )


def find_long_chain(problem: Problem, settings: SolveSettings, progress: Callback | None = None) -> Orbit:
    """The certified orbit of a problem that `suits`. Raises `ConvergenceError` and `InputError`."""
    began = time.perf_counter()
    chain = build_chain(problem)

    def report(stage: str, count: int, defect: float, period: float) -> None:
        if progress:
            progress(Progress(stage, count, defect, period, time.perf_counter() - began))

    series = balanced(chain, report)
    start, period = shot(chain, series.start, series.period, report)
    orbit = measured(chain, start, period)
    said = {key: value for key, value in provenance(problem, settings, began).items() if key not in UNUSED}
    method = {"method": "harmonic balance, quarter-period shooting", "harmonics": len(series.coefficients)}
    orbit = replace(orbit, provenance=said | method)
    if settings.with_certificate:
        orbit = certified(orbit, problem.model)
    report("certificate", 0, orbit.closure, orbit.period)
    return orbit


def build_chain(problem: Problem) -> Chain:
    """Everything that is derived once. `InputError` for a pin on a rate, which is 0 where the motion starts."""
    model, name = problem.model, problem.pin[0].name
    n = model.degrees_of_freedom
    if name in model.state_names[n:]:
        raise InputError(f"pin: {name} is 0 where a brake orbit starts; pin an angle, the energy or the period")
    return Chain(problem, Quarter(model), _pin_rows(model))


def _pin_rows(model: Model) -> Callable[[Pin], PinRow]:
    """A pin's residual and its derivatives in q(0), T at rest, as a NumPy function for each pin."""
    n, values = model.degrees_of_freedom, ca.DM(model.parameter_values)
    q, period = ca.MX.sym("q", n), ca.MX.sym("T")
    known: dict[str, ca.Function] = {}

    def made(one: Pin) -> PinRow:
        if one.name not in known:
            row = pin_row(model, Pin(one.name, 0.0), ca.vertcat(q, ca.DM.zeros(n)), period, values)
            slopes = [ca.densify(ca.gradient(row, q)), ca.densify(ca.gradient(row, period))]
            known[one.name] = ca.Function("pin", [q, period], [row, *slopes])

        def rows(place: np.ndarray, duration: float) -> tuple[float, np.ndarray, float]:
            value, by_place, by_period = known[one.name](place, duration)
            return float(value) - one.value, by_place.full().ravel(), float(by_period)

        return rows

    return made


def balanced(chain: Chain, report: Callable[[str, int, float, float], None]) -> Series:
    """The orbit to about 1e-6 by harmonic balance: from the guess where it nearly closes, else along the family."""
    pin = chain.problem.pin[0]
    direct = _from_guess(chain)
    if direct is not None:
        return direct
    start = _linear(chain)

    def told(fraction: float, found: Series) -> None:
        report(f"harmonic balance at {fraction:.3f} of the pin", len(found.coefficients), found.tail, found.period)

    for growth in GROWTHS:
        found = harmonic_balance.follow(start, chain.closed.linearised, _walk(chain), told, growth)
        if found is not None and pin.name == "period":
            again = harmonic_balance.resolved(
                found, chain.closed.linearised, chain.pin(pin), harmonic_balance.FINE_TAIL
            )
            found = None if again is None else again[0]
        if found is not None:
            return found
    raise ConvergenceError(
        f"no orbit found: the family of the guess's linear mode could not be followed to {pin.name} = {pin.value:g}; "
        "give a smaller value, or start from the state and period of an orbit nearer to it"
    )


def _from_guess(chain: Chain) -> Series | None:
    """The guess corrected, where its motion passes near q = 0 after a quarter of its period."""
    guess, n = chain.problem.guess, chain.quarter.links
    start = np.asarray(guess.state, float)[:n]
    state, count = np.concatenate([start, np.zeros(n)]), SAMPLES // 4
    try:
        states = chain.quarter.path(state, guess.period / 4, count, chain.chunks(guess.period, PATH_PHASE, count))
    except IntegrationError:
        return None
    if not np.abs(states[-1, :n]).max() < DIRECT * np.abs(start).max():
        return None
    spline = CubicHermiteSpline(np.linspace(0, np.pi / 2, len(states)), states[:, :n],
                                states[:, n:] * guess.period / (2 * np.pi))  # fmt: skip
    count = 2 * harmonic_balance.FEWEST
    orders = 2 * np.arange(count) + 1
    cosines = np.cos(np.outer(orders, orders) * np.pi / (4 * count))
    series = Series(2 / count * cosines.T @ spline(orders * np.pi / (4 * count)), 2 * np.pi / guess.period)
    found = harmonic_balance.resolved(
        series, chain.closed.linearised, chain.pin(chain.problem.pin[0]), harmonic_balance.FINE_TAIL
    )
    return found[0] if found is not None and harmonic_balance.near(series, found[0]) else None


def _linear(chain: Chain) -> Series:
    """The linear mode nearest to the guess, signed like it, as a series at the first step of the walk."""
    n, closed = chain.quarter.links, chain.closed
    start = np.asarray(chain.problem.guess.state, float)[:n]
    shares = closed.modes.T @ closed.coupling @ start
    mode = int(np.abs(shares).argmax())
    shape = closed.modes[:, mode] * np.sign(shares[mode])
    pin, size = chain.problem.pin[0], float(np.abs(start).max())
    if pin.name in chain.problem.model.state_names and shape[index := chain.problem.model.state_index(pin.name)]:
        factor = pin.value / shape[index]
    else:
        factor = size / float(np.abs(shape).max())
    first = harmonic_balance.FIRST_STEP
    return Series(first * factor * shape[None, :], float(np.sqrt(closed.squared[mode])))


def _walk(chain: Chain) -> Callable[[float], PinRow]:
    """The pin along the way: its value at rest plus the fraction (squared for the energy) of the rest of it.

    The period tells nothing near the linear mode, so the guess's largest angle takes its place.
    """
    problem, n = chain.problem, chain.quarter.links
    pin, start = problem.pin[0], np.asarray(problem.guess.state, float)[:n]
    if pin.name == "period":
        largest = int(np.abs(start).argmax())
        pin = Pin(problem.model.state_names[largest], float(start[largest]))
    angle = pin.name in problem.model.state_names
    rest = 0.0 if angle else total_energy(problem.model, np.zeros(2 * n))

    def at(fraction: float) -> PinRow:
        return chain.pin(Pin(pin.name, rest + (fraction if angle else fraction**2) * (pin.value - rest)))

    return at


def shot(
    chain: Chain, start: np.ndarray, period: float, report: Callable[[str, int, float, float], None]
) -> tuple[np.ndarray, float]:
    """(q0, T) with q(T/4) = 0 and the pin to round-off: Newton steps with a matrix kept while it serves.

    The residual is integrated to round-off; the matrix needs n columns of the variations over a
    quarter period at a few digits. Raises `ConvergenceError` when the residual does not shrink.
    """
    pin = chain.pin(chain.problem.pin[0])
    place, rows = (start, period), np.zeros(0)
    best, matrices, factors = np.inf, 0, None
    for count in range(MOST_STEPS):
        end = chain.end(*place)
        row, by_place, by_period = pin(*place)
        rows = np.append(end[: start.size], row)
        size = float(np.abs(rows).max())
        report("quarter-period shooting", count, size, place[1])
        if not size < best:
            break
        kept, slow, best = place, size > SHRINKING * best, size
        if factors is None or (slow and size > WORST and matrices < MOST_MATRICES):
            factors, matrices = lu_factor(_newton_matrix(chain, place, end, by_place, by_period)), matrices + 1
        step = lu_solve(factors, -rows)
        place = (place[0] + step[:-1], place[1] + float(step[-1]))
    if not best < WORST:
        raise ConvergenceError(
            f"no orbit found: shooting over a quarter period stalled with q(T/4) = {best:.3g}; the harmonic balance "
            "was not near an orbit, give a smaller pin or a guess nearer to an orbit"
        )
    return kept


def _newton_matrix(
    chain: Chain, place: tuple[np.ndarray, float], end: np.ndarray, by_place: np.ndarray, by_period: float
) -> np.ndarray:
    """d(q(T/4), pin)/d(q0, T), n + 1 square."""
    n = chain.quarter.links
    state = np.concatenate([place[0], np.zeros(n)])
    steps = CHUNK * chain.chunks(place[1], NEWTON_PHASE)
    columns = chain.quarter.columns(state, place[1] / 4, steps, np.eye(2 * n)[:, :n])
    return np.block([[columns[:n], end[n:, None] / 4], [by_place[None, :], np.array([[by_period]])]])


def multipliers(chain: Chain, start: np.ndarray, period: float) -> Floquet:
    """Reduced Floquet multipliers of the whole period from the variations of a quarter of it.

    In canonical coordinates let A be the matrix of the quarter and P = diag(-1, 1), which reverses
    time and the positions. The map x(0) -> -x(T/2) has W = -P A^-1 P A and W^2 is the monodromy;
    A^-1 = -J A^T J by symplecticity, so that the pair defect of W^2 is a true error bar.
    """
    n, closed = chain.quarter.links, chain.closed
    modes = np.kron(np.eye(2), closed.modes)
    first = np.concatenate([start, np.zeros(n)])
    columns = chain.quarter.columns(first, period / 4, CHUNK * chain.chunks(period, MULTIPLIER_PHASE), modes)
    before, after = closed.momentum_frame(first), closed.momentum_frame(chain.end(start, period))
    matrix = np.linalg.solve((before @ modes).T, (after @ columns).T).T
    unit = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])
    half, _ = chain.problem.boundary.root(matrix, lambda other: -unit @ matrix.T @ unit @ other, 2 * n)
    flow = before @ chain.quarter.field(0.0, first, [], []).full().ravel()
    gradient = np.concatenate([-flow[n:], flow[:n]])
    reduced = reduce_monodromy(half, gradient[None, :], flow[None, :])
    return analyse(reduced @ reduced)


def measured(chain: Chain, start: np.ndarray, period: float) -> Orbit:
    """The Orbit (without certificate) that starts at rest at `start` (n)."""
    problem, model = chain.problem, chain.problem.model
    state = np.concatenate([start, np.zeros(start.size)])
    states = chain.quarter.refined(state, period, SAMPLES, chain.chunks(4 * period, PATH_PHASE, SAMPLES))
    times = np.linspace(0.0, period, SAMPLES + 1)
    apart = chain.quarter.disagreement(states[: SAMPLES // 4 + 1 : SAMPLES // 16])
    if not apart < AGREEMENT:
        raise OrbitfinderError(
            f"multipliers: the closed form of this chain's equations and the derivatives of its accelerations differ "
            f"by {apart:.2g}, relative; please report this with the problem file"
        )
    floquet = multipliers(chain, start, period)
    turns = np.zeros(start.size, int)
    return Orbit(
        name=problem.name, title=problem.title, source=problem.source, system=model.system,
        state=state, period=period, energy=total_energy(model, state), action=action(model, times, states),
        closure=gap(state, states[-1], turns), symmetry=recognise(times, states, model),
        winding=tuple(int(k) for k in turns), floquet_multipliers=floquet.multipliers,
        pair_defect=floquet.pair_defect, stability=floquet.stability, unfolding=(),
        nodes=states[: -1 : SAMPLES // NODES], times=times, samples=states,
        tolerance=problem.tolerance, expected=problem.expected,
    )  # fmt: skip
