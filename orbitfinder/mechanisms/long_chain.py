"""Nonlinear normal modes of long chains: harmonic balance, then shooting over a quarter period.

A brake and reflection symmetric motion starts at rest at q0 and is at q = 0 a quarter period later, so
n + 1 unknowns (q0, T) and as many equations {q(T/4) = 0, one pin} are all there is; multiple shooting
with all states of all nodes would have 16 times as many at 8 segments. Harmonic balance follows the
family from the linear mode (see `guesses.balance`), shooting takes its result to round-off, and the
multipliers of the whole period follow from one quarter by symmetry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from orbitfinder.errors import ConvergenceError, InputError, IntegrationError, OrbitfinderError
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.conditions import Pin
from orbitfinder.loops.ipopt import Callback, Progress, SolveSettings
from orbitfinder.loops.loop import Equations
from orbitfinder.loops.newton import Newton, NewtonSettings
from orbitfinder.loops.problem import Problem, loop_of
from orbitfinder.loops.scales import Measures
from orbitfinder.loops.symmetry import QUARTER
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.chain_lagrange import ChainLagrange, is_long
from orbitfinder.mechanisms.chain_march import CHUNK, ClosedChain
from orbitfinder.mechanisms.chain_rows import balancing
from orbitfinder.orbits.floquet import Floquet, analyse, reduce_monodromy, symplectic_unit
from orbitfinder.orbits.guesses.balance import (
    FEWEST,
    FINE_TAIL,
    PinRow,
    Series,
    along_family,
    near,
    only_pinned,
    pins,
    resolved,
)
from orbitfinder.orbits.measure import action, provenance, recorded
from orbitfinder.records.orbit import Orbit

SAMPLES = 512
"""Intervals of the dense samples over a period."""
NODES = 8
PATH_PHASE, NEWTON_PHASE = 0.5, 1.0
"""Radians of the fastest linear mode in a step"""
DIRECT = 0.05
"""A guess that misses q = 0 by less than this, relative, after a quarter of its period is corrected directly."""
AGREEMENT = 1e-8
"""Closed form and recursion agree to this, relative: both lose cond(M) of the mass matrix, 5e4 at 100 links."""
UNUSED = ("relative_tolerance", "absolute_tolerance", "ipopt_tolerance")
"""Entries of the provenance about CVODES and IPOPT, neither of which is used here"""
FRACTION, WORST = QUARTER.fraction, 1e-9
SHOOTING = NewtonSettings(handover=1e-2, most_evaluations=12)
"""A matrix costs as much as dozens of marches, so that it is kept from early on"""


@dataclass(frozen=True, eq=False)
class Chain:
    """A long chain with what is derived from it once: its equations and its pin."""

    problem: Problem
    march: ClosedChain
    equations: Equations
    pin: Callable[[Pin], PinRow]

    @property
    def closed(self) -> ChainLagrange:
        """Its equations in closed form."""
        return self.march.closed

    def mesh(self, fraction: float, period: float, phase: float, samples: int = 1) -> np.ndarray:
        """As many equal steps between `samples` times over a fraction of the period as turn the fastest linear mode by
        at most `phase` (rad) each."""
        turned = float(np.sqrt(self.closed.squared[-1])) * period * fraction
        return uniform(fraction, samples, CHUNK * int(np.ceil(turned / phase / (CHUNK * samples))))


def suits(problem: Problem) -> bool:
    """True for a problem that this room solves: a symmetric mode of a long chain with one pin and nothing else."""
    model = problem.model
    return (
        problem.control is None
        and model.smooth
        and is_long(model)
        and model.acceleration.is_a("SXFunction")
        and float(model.system["gravity"]) > 0
        and only_pinned(problem)
        and float(np.abs(np.asarray(problem.guess.state)[: model.degrees_of_freedom]).max()) < np.pi
    )


def find_long_chain(
    problem: Problem, settings: SolveSettings, report: Callback | None, began: float
) -> tuple[Orbit, Model]:
    """The orbit of a problem that `suits`, without certificate. Raises `ConvergenceError` and `InputError`."""
    chain = build_chain(problem)

    def told(stage: str, count: int, defect: float, period: float) -> None:
        if report:
            report(Progress(stage, count, defect, period, 0.0))

    series = balanced(chain, told)
    start, period = shot(chain, series.start, series.period, told)
    said = {key: value for key, value in provenance(problem, settings, began).items() if key not in UNUSED}
    method = {"method": "harmonic balance, quarter-period shooting", "harmonics": len(series.coefficients)}
    return replace(measured(chain, start, period), provenance=said | method), problem.model


def build_chain(problem: Problem) -> Chain:
    """Everything that is derived once. `InputError` for a pin on a rate, which is 0 where the motion starts."""
    model, name = problem.model, problem.pin[0].name
    n = model.degrees_of_freedom
    if name in model.state_names[n:]:
        raise InputError(f"pin: {name} is 0 where a brake orbit starts; pin an angle, the energy or the period")
    march = ClosedChain(model, problem.boundary.held(n))
    equations = Equations(model, problem.boundary, given=march)
    return Chain(problem, march, equations, pins(equations))


def balanced(chain: Chain, report: Callable[[str, int, float, float], None]) -> Series:
    """The orbit to about 1e-6 by harmonic balance: from the guess where it nearly closes, else along the family."""
    pin = chain.problem.pin[0]
    direct = _from_guess(chain)
    if direct is not None:
        return direct

    def told(fraction: float, found: Series) -> None:
        report(f"harmonic balance at {fraction:.3f} of the pin", len(found.coefficients), found.tail, found.period)

    closed = chain.closed
    found = along_family(chain.problem, closed.squared, closed.modes, balancing(closed), chain.pin, told)
    if found is not None:
        return found
    raise ConvergenceError(
        f"no orbit found: the family of the guess's linear mode could not be followed to {pin.name} = {pin.value:g}; "
        "give a smaller value, or start from the state and period of an orbit nearer to it"
    )


def _from_guess(chain: Chain) -> Series | None:
    """The guess corrected, where its motion passes near q = 0 after a quarter of its period."""
    guess, n = chain.problem.guess, chain.march.size // 2
    start = guess.start[:n]
    mesh = chain.mesh(FRACTION, guess.period, PATH_PHASE, SAMPLES // 4)
    try:
        states = chain.march.states(_at_rest(start), mesh, np.array([guess.period]))[:: mesh.size // (SAMPLES // 4)]
    except IntegrationError:
        return None
    if not np.abs(states[-1, :n]).max() < DIRECT * np.abs(start).max():
        return None
    spline = CubicHermiteSpline(np.linspace(0, np.pi / 2, len(states)), states[:, :n],
                                states[:, n:] * guess.period / (2 * np.pi))  # fmt: skip
    count = 2 * FEWEST
    orders = 2 * np.arange(count) + 1
    cosines = np.cos(np.outer(orders, orders) * np.pi / (4 * count))
    series = Series(2 / count * cosines.T @ spline(orders * np.pi / (4 * count)), 2 * np.pi / guess.period)
    found = resolved(series, balancing(chain.closed), chain.pin(chain.problem.pin[0]), FINE_TAIL)
    return found[0] if found is not None and near(series, found[0]) else None


def shot(
    chain: Chain, start: np.ndarray, period: float, report: Callable[[str, int, float, float], None]
) -> tuple[np.ndarray, float]:
    """(q0, T) with q(T/4) = 0 and the pin to round-off, by the Newton of all loops on this one's march.

    The matrix, kept while it serves, is of a few digits. Raises `ConvergenceError` when the residual does not shrink.
    """
    problem, equations = chain.problem, chain.equations
    w = equations.unknowns(_at_rest(start), period, chain.mesh(FRACTION, period, NEWTON_PHASE))
    loop = loop_of(problem, equations, w, None, problem.pin)
    newton = Newton(loop, SHOOTING, Measures.plain(loop, w))
    try:
        w, residual = newton.solve(w, equations.varied(w))
    except ConvergenceError:
        residual = newton.best
    report("quarter-period shooting", newton.marches, residual, w.period)
    if not residual < WORST:
        raise ConvergenceError(
            f"no orbit found: shooting over a quarter period stalled with q(T/4) = {residual:.3g}; the harmonic "
            "balance was not near an orbit, give a smaller pin or a guess nearer to an orbit"
        )
    return w.nodes[0, : start.size], w.period


def _at_rest(start: np.ndarray) -> np.ndarray:
    """The node (1 x 2n) at rest at `start` (n)."""
    return np.concatenate([start, np.zeros(start.size)])[None]


def multipliers(chain: Chain, first: np.ndarray, last: np.ndarray, period: float) -> Floquet:
    """Reduced Floquet multipliers of the whole period from the variations of a quarter of it, `first` to `last` (2n).

    In canonical coordinates let A be the matrix of the quarter and P = diag(-1, 1), which reverses
    time and the positions. The map x(0) -> -x(T/2) has W = -P A^-1 P A and W^2 is the monodromy;
    A^-1 = -J A^T J by symplecticity, so that the pair defect of W^2 is a true error bar.
    """
    n, closed = first.size // 2, chain.closed
    columns = chain.march.variations(first, FRACTION * period, np.kron(np.eye(2), closed.modes))
    matrix = closed.carried(first, last, columns)
    unit = symplectic_unit(n)
    half, _ = chain.problem.boundary.root(matrix, lambda other: -unit @ matrix.T @ unit @ other, 2 * n)
    flow = closed.momentum_frame(first) @ chain.march.field(0.0, first, [], []).full().ravel()
    gradient = np.concatenate([-flow[n:], flow[:n]])
    reduced = reduce_monodromy(half, gradient[None, :], flow[None, :])
    return analyse(reduced @ reduced)


def measured(chain: Chain, start: np.ndarray, period: float) -> Orbit:
    """The Orbit (without certificate) that starts at rest at `start` (n): a quarter of its period, the same backwards
    and reflected, and both of these reflected, which join up to twice q(T/4)."""
    problem = chain.problem
    mesh = chain.mesh(FRACTION, period, PATH_PHASE, SAMPLES // 4)
    quarter = chain.march.refined(_at_rest(start)[0], mesh, np.array([period]))[:: 4 * mesh.size // SAMPLES]
    half = np.vstack([quarter, quarter[-2::-1] * np.repeat([-1.0, 1.0], start.size)])
    states = np.vstack([half[:-1], -half])
    end = states[-1] + 2 * quarter[-1] * np.repeat([1.0, 0.0], start.size)
    times = np.linspace(0.0, period, SAMPLES + 1)
    apart = chain.march.disagreement(states[: SAMPLES // 4 + 1 : SAMPLES // 16])
    if not apart < AGREEMENT:
        raise OrbitfinderError(
            f"multipliers: the closed form of this chain's equations and the derivatives of its accelerations differ "
            f"by {apart:.2g}, relative; please report this with the problem file"
        )
    return recorded(
        problem, period, end, states[: -1 : SAMPLES // NODES], times, states, np.zeros(0),
        action(problem.model, times, states), multipliers(chain, states[0], states[SAMPLES // 4], period),
    )  # fmt: skip
