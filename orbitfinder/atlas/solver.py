"""Cheap first: damped Newton on loosely integrated multiple shooting, judged by its own corrections.

The equations are built once and used for every start with other numbers; nothing is transcribed, so a hopeless start
costs a few integrations. At F(x) = 0 with Jacobian J the step is x + s dx, where dx is Newton's -J^-1 F(x), its part
along the singular vector of J's least singular value cut to the longest step: near folds and tori it is that part alone
that is far too long, and the others need not wait for it. A step is taken when |F| falls by a quarter at least of what
it would in a linear problem, or the natural level |J^-1 F| does, with the J of where the step began at both ends: that
sees how far an orbit is, where |F| has valleys that damped least squares creep along. How far the next step may go is
foretold by the simplified correction -J^-1 F(x + s dx); starts of which nothing but very short steps are left are given
up. Source: P. Deuflhard, Newton Methods for Nonlinear Problems, Springer 2004, chapter 3 (error-oriented descent,
NLEQ-ERR), which does not cut.

Beside a nearly degenerate orbit it is an equation in a single unknown, followed along the valley where the others hold.
There the Jacobian J has a singular value that is far smaller than the rest (a nearly resonant torus, a fold or
a pitchfork close by): the residual F is small along a curve, damped steps creep and chord steps do not contract.
With its singular vectors u, v the bordered equations

    F(x) = mu u,  v.(x - x0) = h

are regular; mu(h) is followed from h = 0 until its sign changes, and there its zero is an orbit. Source: reduction
of Lyapunov and Schmidt by bordered systems, W. Govaerts, Numerical Methods for Bifurcations of Dynamical
Equilibria, SIAM 2000, chapter 3.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple, cast

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.atlas.abreast import Ask, Course, Marched
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import Placed, Varied, divided, rounded, uniform
from orbitfinder.integrate.rk8 import agree, refining
from orbitfinder.loops.loop import Equations, Loop, Unknowns
from orbitfinder.loops.problem import Problem, loop_of
from orbitfinder.loops.scales import Measures
from orbitfinder.mechanics.newton import Settings, Solved, Solver, chording, largest, stepping

SMOOTHING, POLISH = (
    Settings(floor=1e-8, most_evaluations=3),
    Settings(floor=1e-13, round_off=1e-13, converged=1e-10, most_evaluations=8),
)
GAVE_UP = "iteration limit", "hopeless start"
LOST, NARROWEST, ISOLATED = "the state is not finite", 1e-13, 1e-11
"""What a Failure says; length along the valley between which a zero is known well enough; what w is known to"""
REGULAR = Settings(floor=0.0, converged=0.0, round_off=0.0, most_evaluations=6, patience=0, progress=1.0)


@dataclass(frozen=True)
class ClosingSettings:
    """How a start is brought to an orbit; residuals and steps are scaled."""

    finer: int = 3
    """the polish begins with steps shorter than the cheap stage's by this factor"""
    near: float = 1e-2
    """residual below which a path is near an orbit"""
    narrow: float = 3e-2
    """a Jacobian is nearly singular in one direction when its last singular value is this much below the one before"""
    converged: float = 1e-6
    """residual at which the polish takes over"""
    most_evaluations: int = 40
    hopeless: tuple[int, float] = (24, 1.0)
    """evaluations and residual: given up when it is still larger after so many"""
    largest_step: float = 0.5
    """in any component, and along the weakest direction; half a radian"""
    powers: int = 2
    """steps of the power method to the weakest direction: where it is far weaker than the others, that tells it"""
    descent: float = 0.25
    """share of what a linear problem promises, by which the level or the residual must fall"""
    shorter: float = 0.25
    """factor of a step that leads out of bounds or of the numbers"""
    shortest_share: float = 3e-2
    """of a step; a start that wants less is given up"""
    largest_rate: float = 100.0
    """bound on rates, in units of the guess's root mean square; a step beyond it is not taken"""
    largest_unfolding: float = 100.0
    """bound on |s| times the clock (s); values of 10 have been seen to come back, this has left the problem"""
    smoothing: Settings = SMOOTHING
    polish: Settings = POLISH
    longest: float = 0.3
    shortest: float = 1e-3
    """of the steps along the valley"""
    regular: Settings = REGULAR
    """how the regular equations are solved: given up where what is left of them grows"""
    most_trials: int = 60
    slack: float = 1e-3
    """the regular equations hold when they are smaller than |mu| by this"""
    round_off: float = 3e-13
    """residual that counts as none"""

    def singular(self, jacobian: np.ndarray) -> bool:
        """True when a Jacobian is nearly singular in one direction alone."""
        values = np.linalg.svd(jacobian, compute_uv=False)
        return bool(values[-1] < self.narrow * values[-2])


def _inverses(jacobians: np.ndarray) -> np.ndarray:
    """What takes residuals to corrections (B x K x R), of each of several Jacobians (B x R x K); nan if singular."""
    if jacobians.shape[1] != jacobians.shape[2]:
        return np.linalg.pinv(jacobians, rcond=1e-13)
    try:
        return np.linalg.inv(jacobians)
    except np.linalg.LinAlgError:
        if len(jacobians) == 1:
            return np.full(jacobians.shape, np.nan)
        return np.concatenate([_inverses(each[None]) for each in jacobians])


def _weakest(inverses: np.ndarray, rounds: int) -> np.ndarray:
    """Unit vectors (B x K) that matrices move least, by their inverses (B x K x R) and the power method."""
    vectors = np.ones((*inverses.shape[:2], 1))
    for _ in range(rounds):
        for turned in (inverses.swapaxes(1, 2), inverses):
            vectors = turned @ vectors
            vectors = vectors / nonzero(np.linalg.norm(vectors, axis=1, keepdims=True))
    return vectors[..., 0]


def _norms(rows: np.ndarray) -> np.ndarray:
    """Euclidean, of each by itself."""
    return np.asarray(np.linalg.norm(rows, axis=1))


class Stalled(ConvergenceError):
    """Newton's method came near an orbit that is nearly degenerate, and no nearer; `w` is where it ended."""

    def __init__(self, w: Unknowns) -> None:
        super().__init__("stalled near a degenerate orbit")
        self.w = w


@dataclass(frozen=True)
class ScaledLoop:
    """The loop of a start, the longest step of its marches (s), what all is measured in."""

    loop: Loop
    step: float
    measures: Measures
    periods: tuple[float, float]
    units: tuple[float, ...] = ()
    settings: ClosingSettings = ClosingSettings()
    rough: float = 0.0
    """the longest step (s) of marches of variations in the valley"""

    def at(self, w: Unknowns) -> Unknowns:
        """w on the mesh that the step asks for."""
        count, fraction = len(w.nodes), self.loop.equations.symmetry.fraction
        steps = rounded(w.period * fraction / count / self.step)
        return w if w.mesh.size == steps * count + 1 else replace(w, mesh=uniform(fraction, count, steps))


def scaled_loop(
    problem: Problem,
    equations: Equations,
    step: float,
    w: Unknowns,
    periods: tuple[float, float],
    units: np.ndarray,
    clock: float,
) -> ScaledLoop:
    """The loop of a start, scales and references from its guess, from the `units` of states (2n) and a `clock` (s).

    States (d) without an energy that says how fast they are, are scaled by their units alone.
    """
    n, loop = problem.model.degrees_of_freedom, loop_of(problem, equations, w, None, problem.pin)
    if problem.model.rates is not None or not problem.pin:
        measures = Measures.of(loop, w, w.joined(units, problem.guess.period, 1.0 / clock, np.zeros(0)))
        return ScaledLoop(loop, step, measures, periods, tuple(units))
    rate = max(float(np.sqrt(np.mean((w.nodes[:, n:] / units[:n]) ** 2))), 2 * np.pi / problem.guess.period)
    node = np.concatenate([units[:n], rate * units[:n]])
    measures = Measures.of(loop, w, w.joined(node, problem.guess.period, 1.0 / clock, np.zeros(0)))
    first, phases, _ = np.split(measures.rows, [measures.rows.size - len(loop.normals) - 1, measures.rows.size - 1])
    phases = np.full(phases.size, rate) if np.all(units == 1.0) else phases
    # energies by how far they are above the potential there, which may be hardly at all
    level, at, p = problem.pin[0].value, equations.march.arcs[0].at, problem.model.parameter_values
    lowest = float(at(problem.model.potential, w.nodes[0, :n], p)[0][0, 0])
    moving = 2.0 * float(at(problem.model.kinetic, w.nodes[0, :n], node[n:], p)[0][0, 0])
    span = max(abs(level - lowest), 0.1 * abs(level), 1e-3 * min(1.0, moving))
    rows = np.concatenate([first, phases, [span]])
    return ScaledLoop(loop, step, replace(measures, rows=rows), periods, tuple(units))


@dataclass(frozen=True)
class Differentiated(Ask):
    """The scaled residual and its Jacobian at w, by the variational equations. `IntegrationError` where these leave
    the numbers."""

    scaled: ScaledLoop
    w: Unknowns

    @classmethod
    def answered(cls, asks: Sequence[Differentiated]) -> Sequence[Any]:
        """All of a march together."""
        answers: dict[int, Any] = {}
        groups = defaultdict[int, list[int]](list)
        for k, ask in enumerate(asks):
            groups[id(ask.scaled.loop.equations.march)].append(k)
        for numbers in groups.values():
            march, places = asks[numbers[0]].scaled.loop.equations.march.arcs[0], [asks[k].w for k in numbers]
            last, _ = march.beside(True, [(w.nodes, w.mesh, w.tail) for w in places])
            each = np.split(last, np.cumsum([len(w.nodes) for w in places])[:-1])
            for k, w, own in zip(numbers, places, each, strict=True):
                derived = march.derivatives(w.nodes[None], own, w.mesh[None, :: w.steps], w.tail[None])
                ends, transitions, columns = (rows[0] for rows in derived)
                path = Varied(ends, transitions, columns, w.nodes, 0.0)
                loop, measures = asks[k].scaled.loop, asks[k].scaled.measures
                answers[k] = (
                    (loop.rows(w, path.ends) / measures.rows, measures.matrix(loop.linearised(w, path).matrix()))
                    if np.isfinite(own).all() else IntegrationError(LOST, state=w.nodes[0])
                )  # fmt: skip
        return [answers[k] for k in range(len(asks))]


def moved(scaled: ScaledLoop, w: Unknowns, step: np.ndarray) -> Unknowns:
    """The unknowns after a scaled step, the period kept in range."""
    after = w.moved(step * scaled.measures.columns)
    return replace(after, period=float(np.clip(after.period, *scaled.periods)))


def bounded(scaled: ScaledLoop, w: Unknowns) -> Unknowns:
    """The unknowns, if rates and unfolding are within bounds; `IntegrationError` otherwise."""
    n = 0 if scaled.loop.equations.model.rates is not None else w.nodes.shape[1] // 2
    sizes = w.at(scaled.measures.columns)
    fast = float(np.abs(w.nodes[:, n:] / sizes.nodes[:, n:]).max()) > scaled.settings.largest_rate
    if fast or float(np.abs(w.unfolding / sizes.unfolding).max(initial=0.0)) > scaled.settings.largest_unfolding:
        raise IntegrationError("out of bounds", time=0.0, state=w.nodes[0])
    return w


@dataclass(frozen=True)
class Closing(Ask):
    """Unknowns with a small scaled residual and the Jacobian there; `ConvergenceError` says why there are none."""

    scaled: ScaledLoop
    w: Unknowns

    @property
    def shape(self) -> tuple[int, ...]:
        """What those have in common that stand in rows of the same arrays."""
        loop = self.scaled.loop
        rows = len(loop.normals), len(loop.conditions), len(loop.equations.boundary[0])
        return id(loop.equations.march), len(self.w.nodes), *rows, loop.cycles

    @classmethod
    def answered(cls, asks: Sequence[Closing]) -> Sequence[Any]:
        """All side by side: every evaluation is a march of all that are still on their way."""
        groups = defaultdict[tuple[int, ...], list[int]](list)
        for k, ask in enumerate(asks):
            groups[ask.shape].append(k)
        ranks = [Rank([asks[k] for k in numbers]) for numbers in groups.values()]
        _evaluated([(rank, rank.left, rank.w) for rank in ranks])
        for evaluation in range(1, asks[0].scaled.settings.most_evaluations + 1):
            for rank in ranks:
                rank.judge(evaluation)
            _evaluated([(rank, *rank.trials()) for rank in ranks if rank.left.size])
        answers: dict[int, Any] = {}
        for numbers, rank in zip(groups.values(), ranks, strict=True):
            rank.end(rank.left, ConvergenceError(GAVE_UP[0]))
            answers |= zip(numbers, rank.answers, strict=True)
        return [answers[k] for k in range(len(asks))]


class Rank:
    """Loops of the same shape in rows: unknowns (B x K), scaled residuals, Jacobians and Newton's step of each.

    What becomes of a row depends on that row alone: matrices are multiplied and solved each by itself.
    """

    def __init__(self, asks: Sequence[Closing]) -> None:
        scaled = [ask.scaled for ask in asks]
        self.asks, self.how, self.equations = asks, scaled[0].settings, scaled[0].loop.equations
        self.fractions = np.array([each.loop.equations.symmetry.fraction for each in scaled])
        known = {id(each.loop.equations): each.loop.equations.boundary for each in scaled}
        self.first, self.last = (np.array([known[id(each.loop.equations)][k] for each in scaled]) for k in (0, 1))
        self.count, self.size = asks[0].w.nodes.shape
        self.cut = self.count * self.size
        self.w = np.array([ask.w.vector for ask in asks])
        self.columns = np.array([each.measures.columns for each in scaled])
        self.rows = np.array([each.measures.rows for each in scaled])
        self.periods = np.array([each.periods for each in scaled])
        self.normals = np.array([each.loop.normals for each in scaled]).reshape(len(asks), -1, self.size)
        self.away = np.array([each.loop.reference for each in scaled])
        self.constants = np.array([each.loop.equations.aimed(each.loop.constant) for each in scaled])
        self.conditions = scaled[0].loop.conditions
        self.values = np.array([[condition.value for condition in each.loop.conditions] for each in scaled])
        self.left, self.answers = np.arange(len(asks)), list[Any]([None]) * len(asks)
        self.residual, self.jacobian = np.zeros(self.rows.shape), np.zeros((*self.rows.shape, self.w.shape[1]))
        self.inverse = np.full(self.jacobian.swapaxes(1, 2).shape, np.nan)  # of nothing: it foretells nothing
        self.share, self.renewed = np.ones(len(asks)), np.ones(len(asks), bool)
        self.newton, self.step, self.simplified = (np.zeros(self.w.shape) for _ in range(3))

    def end(self, numbers: np.ndarray, why: Exception) -> None:
        """Rows that lead nowhere."""
        for k in numbers:
            self.answers[k] = why
        if len(numbers):
            self.left = self.left[np.isin(self.left, numbers, invert=True)]

    def _at(self, k: int) -> Unknowns:
        return self.asks[k].scaled.at(self.asks[k].w.at(self.w[k]))

    def judge(self, evaluation: int) -> None:
        """Who has arrived, is hopeless or has stalled."""
        how, norm = self.how, np.abs(self.residual).max(axis=1)
        arrived = norm[self.left] < how.converged
        for k in self.left[arrived]:
            self.answers[k] = self._at(k), self.jacobian[k]
        self.left = self.left[~arrived]
        if evaluation > how.hopeless[0]:
            self.end(self.left[norm[self.left] > how.hopeless[1]], ConvergenceError(GAVE_UP[1]))
        renewed = self.left[self.renewed[self.left]]
        if renewed.size:
            self._correct(renewed)
        for k in self.left[self.share[self.left] < how.shortest_share]:
            near = norm[k] < how.near and how.singular(self.jacobian[k])
            self.end(np.array([k]), Stalled(self._at(k)) if near else ConvergenceError(GAVE_UP[1]))

    def _correct(self, numbers: np.ndarray) -> None:
        """Newton's steps from where rows are, cut, and what share of them the step before foretells."""
        inverse, before, simplified = _inverses(self.jacobian[numbers]), self.step[numbers], self.simplified[numbers]
        newton, weakest = -(inverse @ self.residual[numbers, :, None])[..., 0], _weakest(inverse, self.how.powers)
        along, most = (weakest * newton).sum(axis=1, keepdims=True), self.how.largest_step
        step = newton - (along - np.clip(along, -most, most)) * weakest
        self.inverse[numbers], self.newton[numbers], self.step[numbers] = inverse, newton, step
        self.renewed[numbers] = False
        unlike = nonzero(_norms(simplified - step) * _norms(step))
        foretold = self.share[numbers] * _norms(before) * _norms(simplified) / unlike
        share = np.minimum(np.where(np.isnan(foretold), self.share[numbers], foretold), 1.0)
        self.share[numbers] = np.minimum(share, most / nonzero(np.abs(step).max(axis=1)))
        self.end(numbers[~np.isfinite(step).all(axis=1)], ConvergenceError("singular equations"))

    def trials(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows (b) and where a step leads from them (b x K), the period kept in range; not those beyond bounds."""
        left, how = self.left, self.how
        w = self.w[left] + self.share[left, None] * self.step[left] * self.columns[left]
        w[:, self.cut] = np.clip(w[:, self.cut], *self.periods[left].T)
        sizes, n = np.abs(w / self.columns[left]), 0 if self.equations.model.rates is not None else self.size // 2
        rates = sizes[:, : self.cut].reshape(len(left), self.count, self.size)[:, :, n:]
        out = np.any(rates > how.largest_rate, axis=(1, 2))
        out |= np.any(sizes[:, self.cut + 1 :] > how.largest_unfolding, axis=1)
        self.share[left[out]] *= how.shorter
        return left[~out], w[~out]

    def placed(self, numbers: np.ndarray, w: np.ndarray) -> list[Placed]:
        """Nodes, meshes and tails of rows at w (b x K)."""
        step, count, shares = self.asks[0].scaled.step, self.count, self.fractions[numbers].tolist()
        meshes = [
            _mesh(fraction, count, rounded(period * fraction / count / step))
            for fraction, period in zip(shares, w[:, self.cut].tolist(), strict=True)
        ]
        return list(zip(w[:, : self.cut].reshape(-1, count, self.size), meshes, w[:, self.cut :], strict=True))

    def edges(self, numbers: np.ndarray) -> np.ndarray:
        """Where the segments of rows begin and end (bN x 2), in periods."""
        begins = np.arange(self.count)
        shares = self.fractions[numbers, None, None] / self.count
        return np.asarray(shares * np.stack([begins, begins + 1], axis=1)).reshape(-1, 2)

    def take(self, numbers: np.ndarray, w: np.ndarray, path: Derived) -> None:
        """What trials have come to: taken where the natural level or the residual falls, a shorter step where not."""
        finite, first = path.finite, np.isnan(self.inverse[numbers, 0, 0])
        if not finite.all():
            self.end(numbers[~finite & first], IntegrationError(LOST))
            self.share[numbers[~finite & ~first]] *= self.how.shorter
            numbers, w, first, path = numbers[finite], w[finite], first[finite], path.of(finite)
            if not numbers.size:
                return
        residual, jacobian = self._linearised(numbers, w, path)
        share, step, newton = self.share[numbers], self.step[numbers], self.newton[numbers]
        simplified = -(self.inverse[numbers] @ residual[..., None])[..., 0]
        linear = newton - share[:, None] * step  # what that would be in a linear problem, and the residual
        left = self.residual[numbers] + share[:, None] * (self.jacobian[numbers] @ step[..., None])[..., 0]
        better = self._falls(simplified, newton, linear) | self._falls(residual, self.residual[numbers], left) | first
        taken, refused = numbers[better], numbers[~better]
        self.w[taken], self.residual[taken], self.jacobian[taken] = w[better], residual[better], jacobian[better]
        self.simplified[taken], self.renewed[taken] = (simplified - (newton - step))[better], True
        bent = nonzero(_norms(simplified - linear))
        self.share[refused] = np.minimum(_norms(step) * share**2 / (2 * bent), share / 2)[~better]

    def _falls(self, now: np.ndarray, before: np.ndarray, linear: np.ndarray) -> np.ndarray:
        """Whether rows fall by enough of what they would in a linear problem."""
        size = _norms(before)
        return np.asarray(_norms(now) < size - self.how.descent * (size - _norms(linear)))

    def _linearised(self, numbers: np.ndarray, w: np.ndarray, path: Derived) -> tuple[np.ndarray, np.ndarray]:
        """Scaled residuals and Jacobians of rows at w (b x K), from the ends of their segments with derivatives."""
        count, size, cut, many = self.count, self.size, self.cut, len(w)
        nodes, first, end = w[:, :cut].reshape(many, count, size), self.first[numbers], self.last[numbers]
        ends, phi, columns, values, slopes = path
        links, closing, normals = cut - size, cut - size + first.shape[1], self.normals[numbers]
        phases = closing + normals.shape[1]
        residual, jacobian = np.empty((many, self.rows.shape[1])), np.zeros((many, *self.jacobian.shape[1:]))
        residual[:, :links] = (ends[:, :-1] - nodes[:, 1:]).reshape(many, -1)
        around = first @ nodes[:, 0, :, None] + end @ ends[:, -1, :, None]
        residual[:, links:closing] = around[..., 0] - self.constants[numbers]
        residual[:, closing:phases] = (normals @ (nodes[:, 0] - self.away[numbers])[..., None])[..., 0]
        residual[:, phases:] = values - self.values[numbers]
        inner, each = np.zeros((many, count - 1, size, count, size)), np.arange(count - 1)
        inner[:, each, :, each] = phi[:, :-1].swapaxes(0, 1)
        inner[:, each, :, each + 1] = -np.eye(size)
        jacobian[:, :links, :cut] = inner.reshape(many, links, cut)
        jacobian[:, :links, cut:] = columns[:, :-1].reshape(many, links, -1)
        jacobian[:, links:closing, cut - size : cut] = end @ phi[:, -1]
        jacobian[:, links:closing, :size] += first
        jacobian[:, links:closing, cut:] = end @ columns[:, -1]
        jacobian[:, closing:phases, :size] = normals
        jacobian[:, phases:, :size], jacobian[:, phases:, cut] = slopes[:, :, :size], slopes[:, :, size]
        rows = self.rows[numbers]
        return residual / rows, jacobian * self.columns[numbers, None] / rows[:, :, None]


class Derived(NamedTuple):
    """Of loops of N segments: ends (B x N x d), transitions, columns; conditions (B x c) and slopes."""

    ends: np.ndarray
    transitions: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    slopes: np.ndarray

    def of(self, rows: np.ndarray) -> Derived:
        """Some of the loops."""
        return Derived(*(part[rows] for part in self))

    @property
    def finite(self) -> np.ndarray:
        """Whether loops have led to numbers (B)."""
        ends = np.isfinite(self.ends).all(axis=(1, 2)) & np.isfinite(self.columns).all(axis=(1, 2, 3))
        return np.asarray(ends & np.isfinite(self.transitions).all(axis=(1, 2, 3)))


_mesh = lru_cache(maxsize=256)(uniform)


def _evaluated(trials: Sequence[tuple[Rank, np.ndarray, np.ndarray]]) -> None:
    """Trials of all ranks marched side by side, and taken or not."""
    marches = defaultdict[int, list[tuple[Rank, np.ndarray, np.ndarray]]](list)
    for rank, numbers, w in trials:
        if numbers.size:
            marches[id(rank.equations.march)].append((rank, numbers, w))
    for each in marches.values():
        equations, conditions = each[0][0].equations, each[0][0].conditions
        loops = [loop for rank, numbers, w in each for loop in rank.placed(numbers, w)]
        march, counts = equations.march.arcs[0], [len(nodes) for nodes, _, _ in loops]
        last, _ = march.beside(True, loops)
        nodes, tails = np.concatenate([nodes for nodes, _, _ in loops]), np.array([tail for _, _, tail in loops])
        edges = np.concatenate([rank.edges(numbers) for rank, numbers, _ in each])
        tails = np.repeat(tails, counts, axis=0)
        segments = [part[:, 0] for part in march.derivatives(nodes[:, None], last, edges, tails)]
        begins = np.cumsum([0, *counts])[:-1]
        whole = equations.named(conditions, nodes[begins], tails[begins, :1])
        loop, begin = 0, 0
        for rank, numbers, w in each:
            upto, end = loop + len(numbers), begin + len(numbers) * rank.count
            own = (part[begin:end].reshape(len(numbers), rank.count, *part.shape[1:]) for part in segments)
            rank.take(numbers, w, Derived(*own, *(part[loop:upto] for part in whole)))
            loop, begin = upto, end


def polished(scaled: ScaledLoop, w: Unknowns, jacobian: np.ndarray) -> Course[Unknowns]:
    """w to round-off, by chord steps with an accurate residual, on the mesh that it needs; `Stalled` above 1e-10.

    What the mesh of the cheap stage is wrong by is gone with first steps on a mesh that is not so dear.
    """
    equations, measures = scaled.loop.equations, scaled.measures

    def solver(jacobian: np.ndarray) -> Solver:
        inverse = np.linalg.pinv(jacobian, rcond=1e-13)
        return lambda rows: -(inverse @ rows) * measures.columns

    def rows(w: Unknowns, ends: np.ndarray) -> np.ndarray:
        return np.asarray(scaled.loop.rows(w, ends) / measures.rows)

    def chords(w: Unknowns, first: np.ndarray, by: Solver, settings: Settings) -> Course[Solved[Unknowns]]:
        course, answer = chording(w, first, by, settings, Unknowns.moved), cast(Any, None)
        while True:
            try:
                renewed, at = course.send(answer)
            except StopIteration as end:
                return cast(Solved[Unknowns], end.value)
            if renewed:
                answer = solver((yield Differentiated(scaled, at))[1])
            else:
                answer = rows(at, (yield Marched(equations, at)))

    how, w = scaled.settings, replace(scaled, step=scaled.step / scaled.settings.finer).at(w)
    near = yield from chords(w, rows(w, (yield Marched(equations, w))), solver(jacobian), how.smoothing)
    ends, mesh = yield from confirmed(scaled, near.w)
    w = replace(near.w, mesh=mesh)
    least = float(np.linalg.svd(jacobian, compute_uv=False)[-1])  # near a bifurcation a residual says less of w
    polish = replace(how.polish, floor=min(how.polish.floor, ISOLATED * least))
    solved = yield from chords(w, rows(w, ends), near.solver, polish)
    if not solved.converged:
        raise Stalled(solved.w)
    return solved.w


def confirmed(scaled: ScaledLoop, w: Unknowns) -> Course[tuple[np.ndarray, np.ndarray]]:
    """The ends of w by twice, four times, ... the steps of its mesh, the first that half as many confirm; that mesh."""

    def agreed(coarse: tuple[np.ndarray, np.ndarray], fine: tuple[np.ndarray, np.ndarray]) -> bool:
        return agree(coarse[0], fine[0], scaled.units)

    course, answer = refining(1, agreed), cast(Any, None)
    while True:
        try:
            mesh = divided(w.mesh, course.send(answer))
        except StopIteration as end:
            return cast(tuple[np.ndarray, np.ndarray], end.value)
        try:
            answer = (yield Marched(scaled.loop.equations, w.on(mesh))), mesh
        except IntegrationError as error:
            answer = error


@dataclass(frozen=True)
class ValleyPoint:
    """A point of the valley: w, scaled residual F and Jacobian there, u and v, and mu = u.F."""

    w: Unknowns
    residual: np.ndarray
    jacobian: np.ndarray
    left: np.ndarray
    right: np.ndarray

    @property
    def mu(self) -> float:
        """What is left of the residual in the equation that is not regular."""
        return float(self.left @ self.residual)


def orbit_in_valley(scaled: ScaledLoop, w: Unknowns) -> Course[tuple[Unknowns, np.ndarray]]:
    """The unknowns of an orbit in the valley that w lies in, and the Jacobian there; `Stalled` when there is none."""
    try:
        fine = replace(scaled, step=(yield from fine_step(scaled, w)), rough=scaled.step / scaled.settings.finer)
        residual, jacobian = yield from linearised(fine, w)
        at = turned(ValleyPoint(w, residual, jacobian, np.zeros(0), np.zeros(0)))
        here = yield from corrected(fine, at, 0.0)
        if abs(here.mu) > scaled.settings.round_off:
            here = yield from crossed(fine, *(yield from bracket(fine, turned(here))))
        _, jacobian = yield Differentiated(fine, fine.at(here.w))
    except (IntegrationError, np.linalg.LinAlgError) as error:
        raise Stalled(w) from error
    return here.w, jacobian


def linearised(scaled: ScaledLoop, w: Unknowns) -> Course[tuple[np.ndarray, np.ndarray]]:
    """The scaled residual at w, and its Jacobian by rough steps: bordered, it is regular, and Newton's steps end where
    the residual does."""
    w = scaled.at(w)
    rows = scaled.loop.rows(w, (yield Marched(scaled.loop.equations, w))) / scaled.measures.rows
    roughly = replace(scaled, step=max(scaled.step, scaled.rough))
    _, jacobian = yield Differentiated(roughly, roughly.at(w))
    return rows, jacobian


def fine_step(scaled: ScaledLoop, w: Unknowns) -> Course[float]:
    """The longest step (s) with which half of it agrees; the polish that follows needs no better Jacobian."""
    w = scaled.at(w)
    _, mesh = yield from confirmed(scaled, w)
    return 2 * w.period * float(mesh[-1]) / (mesh.size - 1)


def turned(at: ValleyPoint) -> ValleyPoint:
    """The point with the singular vectors of its own Jacobian, in the senses of those that it came with."""
    left, _, right = np.linalg.svd(at.jacobian)
    u, v = left[:, -1], right[-1]
    if at.left.size:
        u, v = u * (np.sign(u @ at.left) or 1.0), v * (np.sign(v @ at.right) or 1.0)
    return replace(at, left=u, right=v)


def corrected(scaled: ScaledLoop, at: ValleyPoint, length: float) -> Course[ValleyPoint]:
    """Where the regular equations hold at h = `length` from a point, by Newton's method; `Stalled` if nowhere."""
    how, points = scaled.settings, dict[int, ValleyPoint]()

    def onward(w: Unknowns, step: np.ndarray) -> Unknowns:
        return bounded(scaled, moved(scaled, w, step))

    def regular(point: ValleyPoint) -> tuple[np.ndarray, Solver]:
        rest = point.residual - point.mu * at.left

        def step(_: np.ndarray) -> np.ndarray:
            bordered = np.block([[point.jacobian, -at.left[:, None]], [at.right[None], np.zeros((1, 1))]])
            return np.linalg.solve(bordered, np.append(-rest, 0.0))[:-1]

        hold = largest(rest) < max(how.slack * abs(point.mu), how.round_off)
        return np.zeros(0) if hold else rest, step

    course = stepping(onward(at.w, length * at.right), how.regular, onward)
    w = next(course)
    while True:
        residual, jacobian = yield from linearised(scaled, w)
        points[id(w)] = ValleyPoint(w, residual, jacobian, at.left, at.right)
        try:
            w = course.send(regular(points[id(w)]))
        except StopIteration as end:
            solved: Solved[Unknowns] = end.value
            break
    if not solved.converged:
        raise Stalled(at.w)
    return points[id(solved.w)]


def bracket(scaled: ScaledLoop, at: ValleyPoint) -> Course[tuple[ValleyPoint, ValleyPoint, float]]:
    """Two successive points between which mu changes its sign, and h from the first to the second."""
    how = scaled.settings
    length = -how.longest * (np.sign(at.mu * (at.left @ at.jacobian @ at.right)) or 1.0)  # the way on which |mu| falls
    for _ in range(how.most_trials):
        try:
            there = yield from corrected(scaled, at, length)
        except (Stalled, IntegrationError):
            length /= 2
            if abs(length) < how.shortest:
                break
            continue
        if there.mu * at.mu <= 0:
            return at, there, length
        at, length = turned(there), float(np.clip(1.5 * length, -how.longest, how.longest))
    raise Stalled(at.w)


def crossed(scaled: ScaledLoop, first: ValleyPoint, second: ValleyPoint, length: float) -> Course[ValleyPoint]:
    """The zero of mu between two points, `length` apart: by false positions, an end that stays weighing ever less.

    Source: N. Anderson, A. Bjorck, BIT 13 (1973) 253-264.
    """
    (low, below), (high, above), there = (0.0, first.mu), (length, second.mu), second
    for _ in range(scaled.settings.most_trials):
        if abs(there.mu) < scaled.settings.round_off or abs(high - low) < NARROWEST:
            break
        share = high - above * (high - low) / (above - below)
        try:
            there = yield from corrected(scaled, first, share)
        except Stalled:  # by round-off of the regular equations: so near, the polish knows what is left
            if abs(there.mu) > scaled.settings.converged:
                raise
            break
        if there.mu * above < 0:
            low, below = high, above
        else:
            left = 1.0 - there.mu / above
            below *= left if left > 0 else 0.5
        high, above = share, there.mu
    return there
