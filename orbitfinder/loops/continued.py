"""The corrector of a family: its loop with one aim more, Newton, tangent and predictor, in the family's `Scales`.

The aim is the last condition and picks one orbit of the family; without it the Jacobian has a one-dimensional
kernel, the tangent of the family (Muñoz-Almaraz et al., Physica D 181 (2003) 1-38).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any, Self

import numpy as np
from scipy.integrate import trapezoid
from scipy.linalg import eigh

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.integrate.march import Varied
from orbitfinder.loops.condensed import (
    SMALL,
    Broyden,
    Jacobian,
    Linearised,
    bordered,
    combined,
    dense,
    factorised,
    pivoted,
)
from orbitfinder.loops.conditions import hyperplane
from orbitfinder.loops.loop import Condition, Equations, Loop, Unknowns, beyond
from orbitfinder.loops.problem import clocked
from orbitfinder.loops.scales import Measures, Scales, sizes
from orbitfinder.loops.watch import Watch
from orbitfinder.mechanics.newton import Solver
from orbitfinder.mechanics.scales import parameter_sizes, snapped


@dataclass(frozen=True)
class CorrectorSettings:
    """When the corrector of a family is content, and how it differences a test."""

    newton_ready: float = 1e-11
    """Residual, in units of the metric, from which one more Newton step, not evaluated again, reaches round-off."""
    approached: float = 3e-7
    """Residual at which the approach with an old Jacobian hands over to Newton's method."""
    fitting: float = 1e-4
    """Residual below which an orbit is known well enough to fit a mesh to it."""
    fewest_steps: int = 32
    """Steps of a horizon from which on the approach takes only half of them."""
    newton_floor: float = 1e-9
    """... or below this, where round-off on an unstable orbit keeps the residual from shrinking further."""
    unmoved: float = 1e-13
    """A last step that is shorter than this leaves what was integrated along the motion as it is."""
    most_newton: int = 12
    slow: float = 0.1
    """A step that leaves more than this share of the residual asks for the differences of a test function anew."""
    across: float = 1e-3
    """A step of which less than this share, squared, leads off the surface of orbits tells how a test changes along
    it."""
    at_zero: float = 1e-6
    """A parameter that is below this share of its usual size (`mechanics.scales.parameter_sizes`) is at 0."""
    difference: float = 1e-4
    """Half of a central difference of a test function, in the metric: its error and round-off are both some 1e-8."""
    iterations: int = 3
    """Steps from a random vector to a kernel, whose error each of them squares, and vectors that ask for the rank."""
    dependent: float = 1e-7
    """A singular value below this, in the units of rows, asks for all of them."""


CORRECTOR = CorrectorSettings()


TESTED = 1e3
"""What a test function is measured in: it may be so much farther from 0 before the last step, whose row is exact."""
CRITICAL = 1e-3
"""A singular value below this, relative to the next larger ones, belongs to the kernel."""


@dataclass(frozen=True, eq=False)
class Curve(Loop):
    """One family's loop, and its metric.

    `scales` measure w at the orbit that the family has come to. `weights` are of a head (x(0), T, free) of its first
    orbit, in which its equations are integrated: coordinates by `mechanics.scales.lengths` (angles in rad), rates by
    the time scale, period and parameters relative to their values. A curve of bifurcations
    has a `test` too, a function of orbits that vanishes along it, and one parameter more is free; `degenerate` where
    the equations without it lose a rank there, as at a branch point, which a symmetry must keep.
    """

    weights: np.ndarray = field(kw_only=True)
    scales: Scales = field(kw_only=True)
    test: Callable[[Curve, Sequence[Solution]], np.ndarray] | None = field(default=None, kw_only=True)
    degenerate: bool = field(default=False, kw_only=True)
    watch: Mapping[str, Watch] = field(default_factory=dict, kw_only=True)
    """numbers of its orbits that a user watches"""

    @cached_property
    def shares(self) -> np.ndarray:
        """What coordinates (n) are measured in, in rad or relative to the first: 1 where all are measured alike."""
        return np.sqrt(self._unit / self.weights[: self.equations.model.degrees_of_freedom])

    @cached_property
    def units(self) -> np.ndarray:
        """The same of a state (2n) in powers of 256, so that a system of order one is computed with as it is."""
        return snapped(np.sqrt(self._unit / self.weights[: self.equations.size]))

    @property
    def kept(self) -> tuple[Condition, ...]:
        """What the family keeps, but for a forcing's period."""
        return tuple(condition for condition in self.conditions if not condition.cycles)

    def through(self, w: Unknowns) -> Self:
        """The same with its phases over all nodes fixed by w, with which they are kept."""
        units, (of, known, normals) = self.scales.states, w.__dict__.get("normals", (None, None, NO_ROWS))
        if of is not self.equations or known is not units:
            normals = self.equations.phases(w, units)
            w.__dict__["normals"] = self.equations, units, normals
        return replace(self, normals=normals, reference=w.nodes.ravel())

    def measured(self, solution: Solution) -> Self:
        """The same with its scales renewed at an orbit that was accepted."""
        return replace(self, scales=self.scales.renewed(self.sizes(solution), solution.place))

    def sizes(self, solution: Solution) -> np.ndarray:
        """The extents (d) of the whole motion."""
        p, place = self.equations, solution.place
        states = p.symmetry.whole(place.mesh, solution.march.states, self.constant)[1]
        return sizes(p.model, self.shares, states, place.period)

    @cached_property
    def centre(self) -> np.ndarray:
        """Where coordinates (n) must be centred, nan for those that may be anywhere."""
        return self.equations.symmetry.centre(self.constant)

    @cached_property
    def turns(self) -> tuple[int, ...]:
        """Whole turns of each coordinate in one period (n); zero for orbits that swing back."""
        return tuple(map(int, self.equations.symmetry.turns(self.constant)))

    @property
    def _unit(self) -> float:
        return 1.0 if self.equations.model.angular.any() else float(self.weights[0])


NO_ROWS = np.zeros((0, 0))


@dataclass(frozen=True)
class Solution:
    """A corrected orbit with the integration it came from and the Jacobian of all rows, a test's too, but the aim; of a
    collocated or a large one without a test as its parts.
    """

    place: Unknowns
    march: Varied
    jacobian: Jacobian
    residual: float
    stepped: float = 0.0
    """how far, in the family's metric, the place is from where `march` was made: Newton's last step"""
    marched: Unknowns | None = None
    """where `march` was made, if that is not the place"""
    kept: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)
    """what was read off it and takes long"""

    @property
    def matrix(self) -> np.ndarray:
        """The Jacobian, dense."""
        return dense(self.jacobian)


def make_curve(
    equations: Equations,
    constant: np.ndarray,
    w: Unknowns,
    conditions: tuple[Condition, ...],
    unit: np.ndarray,
    states: np.ndarray,
) -> Curve:
    """The curve through (or near) w, along whose first motion there are `states` (k x d).

    `unit` is what coordinates (n) are measured in (see `mechanics.scales.lengths`).
    """
    lengths = np.tile(unit, equations.size // unit.size)
    relative = parameter_sizes(equations.model, equations.free, w.free)
    with np.errstate(over="ignore"):  # what comes of a period that is too small is said where it is integrated
        pace = np.square(1.0 / w.period)
    weights = np.concatenate(
        [clocked(equations.model, w.period / (2 * np.pi)) ** 2 / lengths**2, [pace], 1.0 / relative**2]
    )
    curve = Curve(equations, constant, conditions, weights=weights, scales=Scales.head(weights, equations.size))
    return replace(curve, scales=Scales.of(sizes(equations.model, curve.shares, states, w.period), w, relative))


def begun(curve: Curve, solution: Solution, along: np.ndarray) -> tuple[Curve, np.ndarray]:
    """The curve in the scales of its first orbit, and its direction over w there along one over w or over the head."""
    w, size = solution.place, curve.equations.size
    usual = 1.0 / np.sqrt(curve.weights[size + 1 :])
    zero = np.abs(w.free) < CORRECTOR.at_zero * usual
    curve = replace(curve, scales=Scales.of(curve.sizes(solution), w, np.where(zero, usual, np.abs(w.free))))
    if zero.any():
        felt = np.linalg.norm(scaled(curve, solution)[0][:, -zero.size :], axis=0)
        curve = replace(curve, scales=curve.scales.begun(w, tangent(curve, solution, along), zero, felt))
    return curve, tangent(curve, solution, along)


def _measures(curve: Curve, w: Unknowns, slopes: np.ndarray | None = None) -> Measures:
    """What unknowns are measured in by the metric, and with that the rows, a test's and then an aim's last."""
    measures = Measures.of(curve, w, curve.scales.columns(w), slopes)
    if curve.test is None:
        return measures
    named, aims = np.split(measures.rows, [measures.rows.size - (slopes is not None)])
    return replace(measures, rows=np.concatenate([named, [TESTED], aims]))


def jacobian_of(curve: Curve, w: Unknowns, path: Varied) -> Jacobian:
    """The Jacobian of the rows without a test and an aim: of many segments or large nodes as its parts."""
    system, large = curve.linearised(w, path), curve.equations.march.wide and w.nodes.size > SMALL
    parts = (curve.equations.gridded or large) and curve.test is None and not curve.degenerate
    return system if parts else system.matrix()


def nearby(curve: Curve, a: Jacobian, share: float, b: Jacobian, other: float) -> Jacobian | None:
    """share a + other b of two orbits' Jacobians, None where `correct` does not begin with what is nearby."""
    return combined(a, share, b, other) if begins(curve, a) and begins(curve, b) else None


def begins(curve: Curve, jacobian: Jacobian) -> bool:
    """Whether `correct` begins with a Jacobian nearby: not with parts of many segments, factorised anew as quickly."""
    return not (isinstance(jacobian, Linearised) and curve.equations.gridded)


def _approached(
    curve: Curve, guess: Unknowns, aim: Condition, matrix: Jacobian, measures: tuple[np.ndarray, np.ndarray],
    fit: Callable[[Solution], np.ndarray] | None,
) -> Unknowns:  # fmt: skip
    """The guess improved by Broyden's method on marches of the state alone, in long steps, from a Jacobian of all rows.

    Stops where a step no longer helps. `measures` are what each row is measured in, and what it loses to round-off.
    Where variations are dear they are marched in long steps too when the Jacobian leads no further, and it goes on in
    the steps of the guess's mesh, or of that which `fit` makes of it, until Newton's method has to march them only once
    in short ones.
    """
    coarser = 2 if guess.steps % 2 == 0 and guess.mesh.size > CORRECTOR.fewest_steps else 1
    before_closing = (len(guess.nodes) - 1) * curve.equations.size
    rows, cut = (matrix.first, 0) if isinstance(matrix, Linearised) else (matrix, before_closing)
    cut += len(curve.equations.boundary[0])
    rows[cut : cut + len(curve.normals), : curve.normals.shape[1]] = curve.normals
    dear, best = curve.equations.march.wide, np.inf
    kept = guess.on(guess.mesh[::coarser])
    try:
        while True:
            method, before = Broyden(_factorised(curve, guess, matrix)), best
            kept, best = _stepped(curve, kept, aim, method, measures, CORRECTOR.approached)
            if not dear or best < CORRECTOR.approached or not best < CORRECTOR.slow * before:
                break
            matrix = bordered(jacobian_of(curve, kept, curve.equations.varied(kept)), curve.slopes(kept, (aim,))[0])
    except (np.linalg.LinAlgError, IntegrationError):
        return kept.on(guess.mesh)
    kept = kept.on(guess.mesh)
    if not (dear and best < CORRECTOR.approached):
        return kept
    try:
        if fit is not None:
            states = curve.equations.march.states(kept.nodes, kept.mesh, kept.tail)
            kept = kept.on(fit(Solution(kept, Varied(states[:0], NO_ROWS, NO_ROWS, states, 0.0), NO_ROWS, best)))
        return _stepped(curve, kept, aim, Broyden(method.solver), measures, CORRECTOR.newton_ready)[0]
    except IntegrationError:
        return kept


def _stepped(
    curve: Curve, w: Unknowns, aim: Condition, method: Broyden, measures: tuple[np.ndarray, np.ndarray], enough: float
) -> tuple[Unknowns, float]:
    """The best of Broyden's steps on one mesh and its residual, by rows of which `enough` is wanted."""
    kept, best, (units, lost) = w, np.inf, measures
    for _ in range(CORRECTOR.most_newton):
        try:
            rows = beyond(curve.rows(w, curve.equations.ends(w), aim), lost)
        except IntegrationError:
            break
        largest = float(np.abs(rows / units).max())
        if not largest < 0.5 * best:
            break
        kept, best = w, largest
        if largest < enough:
            break
        w = w.moved(method.step(rows))
    return kept, best


def correct(
    curve: Curve,
    guess: Unknowns,
    aim: Condition,
    reference: Unknowns | None = None,
    reach: float = 1.0,
    slope: Jacobian | None = None,
    fit: Callable[[Curve, Solution], np.ndarray] | None = None,
) -> Solution:
    """Newton from a guess onto the family where the aim is met.

    `reference` carries the phase condition; `reach` bounds how far (in the family's metric) the
    result may be from the guess; `slope` is the Jacobian of an orbit nearby over the same segments, with
    which most of the way is cheap; `fit` gives a better mesh over these segments once the orbit is nearly
    known. Raises `ConvergenceError` or `IntegrationError`.
    """
    steps, alone = _correcting(curve, guess, aim, reference, reach, slope, fit), curve.test is None
    try:
        w = next(steps)
        while True:
            w = steps.send(curve.equations.changed(w) if alone else curve.equations.varied(w, states=True))
    except StopIteration as done:
        return done.value  # type: ignore[no-any-return]


def correct_each(
    curves: Sequence[Curve], guesses: Sequence[Unknowns], aims: Sequence[Condition], reach: float
) -> list[Solution | ConvergenceError | IntegrationError]:
    """The same of guesses on a mesh, of curves of the same equations, marched beside each other; of what fails why."""
    results = {}
    each = zip(curves, guesses, aims, strict=True)
    steps = [_correcting(curve, guess, aim, reach=reach) for curve, guess, aim in each]
    places = {k: next(step) for k, step in enumerate(steps)}
    while places:
        paths = _marched(curves[0].equations, list(places.values()))
        for (k, _), path in zip(list(places.items()), paths, strict=True):
            try:
                if isinstance(path, IntegrationError):
                    raise path
                places[k] = steps[k].send(path)
            except StopIteration as done:
                results[k] = done.value
            except (ConvergenceError, IntegrationError) as error:
                results[k] = error
            if k in results:
                del places[k]
    return [results[k] for k in range(len(steps))]


def _marched(equations: Equations, places: list[Unknowns]) -> list[Varied | IntegrationError]:
    """Integrations beside each other; of those that cannot be, why."""
    try:
        return [*equations.varied_each(places, states=True)]
    except IntegrationError as error:
        if len(places) == 1:
            return [error]
        half = len(places) // 2
        return [*_marched(equations, places[:half]), *_marched(equations, places[half:])]


def _correcting(
    curve: Curve,
    guess: Unknowns,
    aim: Condition,
    reference: Unknowns | None = None,
    reach: float = 1.0,
    slope: Jacobian | None = None,
    fit: Callable[[Curve, Solution], np.ndarray] | None = None,
) -> Generator[Unknowns, Varied, Solution]:
    """The steps of `correct`: unknowns whose integration each of them asks for."""
    same = reference is not None and np.array_equal(reference.edges, guess.edges)
    family, curve = curve, curve.through(reference if same and reference is not None else guess)
    slopes = curve.slopes(guess, (*curve.conditions, aim))
    w, previous, units, lost = guess, np.inf, _measures(curve, guess, slopes).rows, curve.lost(guess, (aim,), slopes)
    border, patience = (None, 2) if curve.test is None else (Border(curve, slope), 5)
    if slope is not None and border is None and begins(curve, slope):
        better = None if fit is None else partial(fit, family)
        w = _approached(curve, guess, aim, bordered(slope, slopes[-1]), (units, lost), better)
    for iteration in range(CORRECTOR.most_newton):
        path = yield w
        rows, jacobian = beyond(curve.rows(w, path.ends, aim), lost), jacobian_of(curve, w, path)
        if border is not None:
            rows = np.concatenate([rows[:-1], [border.value(Solution(w, path, jacobian, 0.0))], rows[-1:]])
        largest = max(float(np.abs(rows / units).max()), path.change)
        stays = 0.1 if border is None else 0.7  # by less it shrinks where the border is not yet known
        ready = largest < CORRECTOR.newton_ready or (largest < CORRECTOR.newton_floor and largest > stays * previous)
        if not np.isfinite(largest) or (iteration > patience and largest > 0.5 * previous and not ready):
            raise ConvergenceError(f"the corrector stalled at a residual of {largest:.2g}; take a smaller step")
        if not (jacobian.finite() if isinstance(jacobian, Linearised) else np.isfinite(jacobian).all()):
            raise ConvergenceError("the variations of the corrector's orbit overflow; take a smaller step")
        if border is not None:
            slow = iteration > 0 and largest > CORRECTOR.slow * previous
            assert isinstance(jacobian, np.ndarray)
            jacobian = np.vstack([jacobian, border.row(w, jacobian, ready or slow)])
        solver = _solver(curve, w, jacobian, curve.slopes(w, (aim,))[0])
        step = -solver(rows)
        moved = w.moved(step)
        if ready:
            if border is not None:  # by so much off the bifurcation was the march
                return Solution(moved, curve.equations.varied(moved, states=True), jacobian, largest)
            solved = {"solver": (jacobian, solver)}
            return Solution(moved, path, jacobian, largest, distance(curve, moved, w), w, solved)
        if not distance(curve, moved, guess) < reach or not moved.period > 0:
            raise ConvergenceError("the corrector left the neighbourhood of its guess; take a smaller step")
        if fit is not None and largest < CORRECTOR.fitting:
            moved = moved.on(fit(family, Solution(w, path, jacobian, largest)))
            fit = None
        w, previous = moved, largest
    raise ConvergenceError(f"the corrector did not finish in {CORRECTOR.most_newton} steps; take a smaller step")


class Border:
    """The row of a curve's test over w.

    Its derivatives along what the other rows leave free, and in the direction across it in which an orbit was
    corrected, are differences; in between they follow from how the test changes (a secant update).
    """

    def __init__(self, curve: Curve, slope: Jacobian | None = None) -> None:
        assert curve.test is not None
        self.curve, self.test = curve, curve.test
        self._row = slope[-1] if isinstance(slope, np.ndarray) else np.zeros(0)
        self._last: tuple[np.ndarray, float] | None = None
        self._free, self._across = np.zeros((0, 0)), np.zeros((0, 0))
        self._value = np.inf

    def value(self, solution: Solution) -> float:
        """The test at an orbit."""
        self._value = float(self.test(self.curve, [solution])[0])
        return self._value

    def row(self, w: Unknowns, jacobian: np.ndarray, exact: bool = True) -> np.ndarray:
        """The row where `value` was asked for last; `jacobian` is that of the other rows."""
        columns, known = self.curve.scales.columns(w), self._row.size == w.vector.size
        before, self._last = self._last, (w.vector, self._value)
        if known and not exact and before is None:
            return self._row
        if exact or not known or not self._free.size:
            # orthonormal rows over w, in units of the metric: the kernel of all but the test and the aim
            if self.curve.degenerate:
                matrix = _measures(self.curve.through(w), w).matrix(jacobian)
                self._free = np.linalg.svd(matrix)[2][len(jacobian) - 1 :]
            else:  # what rows are measured in does not change their kernel
                self._free = np.linalg.qr((jacobian * columns).T, mode="complete")[0][:, len(jacobian) :].T
        moved = np.zeros(columns.size) if before is None else (w.vector - before[0]) / columns
        across = moved - (self._free @ moved) @ self._free
        length = float(np.linalg.norm(across))
        if not self._across.size and length > 0.0:
            self._across = across[None] / length
        if exact or not known:
            row = self._differenced(w, columns)
        else:
            row = self._row * columns
            told = across if length**2 > CORRECTOR.across * (moved @ moved) else moved
            change = self._value - (before[1] if before else self._value)
            row = row + (change - row @ moved) / nonzero(told @ told) * told
        self._row = np.asarray(row / columns)
        return self._row

    def _differenced(self, w: Unknowns, columns: np.ndarray) -> np.ndarray:
        """The row over unknowns in units of the metric, 0 along what nothing was moved in."""
        directions = np.concatenate([self._free, -self._free, self._across.reshape(-1, columns.size)])
        near = [w.moved(step) for step in CORRECTOR.difference * (columns * directions)]
        paths = self.curve.equations.varied_each(near, states=True)
        tests = self.test(self.curve, [Solution(*both, NO_ROWS, 0.0) for both in zip(near, paths, strict=True)])
        ahead, behind, over = np.split(tests, [len(self._free), 2 * len(self._free)])
        row = 0.5 * (ahead - behind) @ self._free
        for along, test in zip(self._across, over, strict=True):
            beside = along - (self._free @ along) @ self._free
            row = row + (test - self._value - CORRECTOR.difference * row @ along) * beside
        return np.asarray(row / CORRECTOR.difference)


def _solver(curve: Curve, w: Unknowns, jacobian: Jacobian, row: np.ndarray) -> Solver:
    """What multiplies by the inverse of all rows, one over w the last; where they are degenerate without the direction
    that they leave to a symmetry."""
    system, columns = bordered(jacobian, row), curve.scales.columns(w)
    gridded = isinstance(system, Linearised) and curve.equations.gridded
    if gridded or not curve.degenerate:
        try:
            return _factorised(curve, w, system)
        except np.linalg.LinAlgError:
            return lambda right: np.linalg.lstsq(dense(system), right, rcond=1e-12)[0]
    measured = dense(system) * columns
    rows = nonzero(np.linalg.norm(measured, axis=1))
    left, sizes, across = np.linalg.svd(measured / rows[:, None])
    return lambda right: columns * (across[:-1].T @ ((left.T @ (right / rows))[:-1] / sizes[:-1]))


def _factorised(curve: Curve, w: Unknowns, matrix: Jacobian) -> Solver:
    """What multiplies by the inverse of all rows, one over w the last; of large nodes each follows from the first."""
    if isinstance(matrix, Linearised) and curve.equations.gridded:
        step = pivoted(matrix, curve.scales.columns(w))
        return lambda right: -step(right)
    return factorised(matrix, w.nodes.shape if curve.equations.march.wide else (1, 0))


def plane(curve: Curve, w: Unknowns, along: np.ndarray, ahead: float = 0.0) -> Condition:
    """The aim in the hyperplane through w, or so far ahead of it, normal to a direction over w or over the head."""
    normal = curve.scales.metric(w) * w.over(along)
    return hyperplane(float(normal @ w.vector) + ahead, normal)


def scaled(curve: Curve, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """The Jacobian of all rows but the aim in units of the metric, and those of its columns."""
    measures = _measures(curve.through(solution.place), solution.place)
    return measures.matrix(solution.matrix), measures.columns


def distance(curve: Curve, w: Unknowns, other: Unknowns) -> float:
    """Distance of two orbits over one mesh in the family's metric."""
    return float(np.sqrt(curve.scales.metric(w) @ (other.vector - w.vector) ** 2))


def tangent(curve: Curve, solution: Solution, along: np.ndarray) -> np.ndarray:
    """The family's direction over w, of unit length, with <along, t> > 0; `along` is over w or over the head."""
    place, metric = solution.place, curve.scales.metric(solution.place)
    row = metric * place.over(along)
    right = np.zeros(place.vector.size)
    right[-1] = 1.0
    known, solver = solution.kept.get("solver", (None, None))
    if known is not solution.jacobian:  # else the kernel is known, whatever the row of the aim was
        solver = _solver(curve, place, solution.jacobian, row)
    whole = solver(right)
    return np.asarray(whole / np.copysign(np.sqrt(metric @ whole**2), row @ whole))


def kernel(curve: Curve, solution: Solution) -> np.ndarray:
    """The same without a direction to go by: the right singular vector of the smallest singular value."""
    if (whole := _iterated(curve, solution)) is not None:
        return whole
    matrix, units = scaled(curve, solution)
    last = np.linalg.svd(matrix)[2][-2:]
    if curve.degenerate:  # the direction in which a symmetry is lost is the kernel's too, and moves no parameter
        last = np.linalg.svd(last[:, -solution.place.free.size :])[0].T[:1] @ last
    whole = units * last[-1]
    return np.asarray(whole / np.sqrt(curve.scales.metric(solution.place) @ whole**2))


def _iterated(curve: Curve, solution: Solution) -> np.ndarray | None:
    """The same of large nodes by inverse iteration; None of others, and where the rows may be dependent.

    Bordered by their kernel rows have the inverse of their own least singular value, by which most vectors grow.
    """
    jacobian, w = solution.jacobian, solution.place
    if not isinstance(jacobian, Linearised) or curve.equations.gridded or curve.degenerate:
        return None
    measures, random = _measures(curve.through(w), w), np.random.default_rng(0)
    units, rows, unit = measures.columns, np.append(measures.rows, 1.0), np.zeros(w.vector.size)
    row, unit[-1] = random.normal(size=unit.size) / units, 1.0
    try:
        for _ in range(CORRECTOR.iterations):
            whole = _factorised(curve, w, jacobian.bordered(row))(unit) / units
            whole /= np.linalg.norm(whole)
            row = whole / units
        solver = _factorised(curve, w, jacobian.bordered(row))
    except np.linalg.LinAlgError:
        return None
    grown = [np.linalg.norm(solver(rows * random.normal(size=unit.size)) / units) for _ in range(CORRECTOR.iterations)]
    whole = units * whole
    known = CORRECTOR.dependent * max(grown) < 1.0  # not so of what is no number
    return whole / np.sqrt(curve.scales.metric(w) @ whole**2) if known else None


def crossed(curve: Curve, solution: Solution, share: float = CRITICAL) -> bool:
    """Whether another family crosses there: the rows without an aim have a kernel of two dimensions."""
    sizes = np.linalg.svd(scaled(curve, solution)[0], compute_uv=False)
    return bool(sizes[-1] < share * sizes[-2:][0])


@dataclass(frozen=True)
class AvoidedCrossing:
    """Where two families avoid each other (or cross, the `gap` being 0), in the plane of both through a `centre`.

    There they are the hyperbola z_0^2 - z_1^2 = 1, z = `rows` (2 over w) (w - centre), and centre +- `axes`[0] (2 over
    w) their orbits that are nearest to each other, by <., .> over the whole motion.
    """

    centre: Unknowns
    axes: np.ndarray
    rows: np.ndarray
    gap: float

    def place(self, w: Unknowns) -> np.ndarray:
        """z of an orbit over the same segments."""
        return np.asarray(self.rows @ (w.vector - self.centre.vector))


def avoided_crossing(curve: Curve, solution: Solution, reach: float) -> AvoidedCrossing | None:
    """The place within `reach` of an orbit at which two families of smooth motions, whose rows are in one matrix, avoid
    each other or cross, if there is one.

    The orbits of F(w) + b psi = 0, psi the left singular vector of the smallest singular value, are a surface on which
    b has a saddle there; b = 0 are the families. Newton's method for the saddle, in the plane of the last two right
    singular vectors. Source: W. J. F. Govaerts, Numerical Methods for Bifurcations of Dynamical Equilibria (2000).
    """
    if curve.test is not None or curve.equations.links or isinstance(solution.jacobian, Linearised):
        return None
    w, path, apart, free = solution.place, solution.march, CORRECTOR.difference, curve.equations.size + 1
    curve, units, cut = curve.through(w), 1.0 / np.sqrt(curve.weights[free:]), w.nodes.size
    for _ in range(CORRECTOR.most_newton):
        curve = replace(curve, scales=Scales.of(curve.sizes(Solution(w, path, NO_ROWS, 0.0)), w, units))
        measures = _measures(curve, w)
        matrix = measures.matrix(dense(jacobian_of(curve, w, path)))
        left, sizes, right = np.linalg.svd(matrix)
        plane, axes, residual = right[-2:], right[-2:] * measures.columns, curve.rows(w, path.ends) / measures.rows
        places = [w.moved(apart * axis) for axis in axes]
        paths = curve.equations.varied_each(places, states=True)
        rows = [
            left[:, -1] @ measures.matrix(dense(jacobian_of(curve, *each))) for each in zip(places, paths, strict=True)
        ]
        bent = (rows - left[:, -1] @ matrix) @ plane.T / apart
        across = right[:-2].T @ (left[:, :-1].T @ residual / sizes[:-1])
        step = -across - plane.T @ np.linalg.solve(bent, [sizes[-1], 0.0])
        moved = w.moved(measures.columns * step)
        if not distance(curve, moved, solution.place) < reach or not moved.period > 0.0:
            return None
        if np.abs(step).max() < CORRECTOR.newton_floor:
            break
        w, path = moved, curve.equations.varied(moved, states=True)
    else:
        return None
    states = np.array([each.states for each in (path, *paths)]) / curve.scales.states
    motions, times = (states[1:] - states[0]) / apart, w.mesh / w.mesh[-1]
    if len(curve.normals):  # what leads along the orbit is another time, and no other motion
        rates = np.gradient(states[0], times, axis=0)
        motions -= np.tensordot(np.sum(motions * rates, axis=(1, 2)), rates / np.sum(rates**2), axes=0)
    lengths = trapezoid(np.einsum("ikd,jkd->ijk", motions, motions), times)
    tails = axes[:, cut:] * np.sqrt(curve.scales.metric(w)[cut:])
    values, vectors = eigh(bent, lengths + tails @ tails.T)
    if not values[0] < 0.0 < values[1]:
        return None
    level = float(left[:, -1] @ residual)
    known, order = max(abs(level), CORRECTOR.newton_floor), np.argsort(values * level)
    vectors = vectors[:, order] * np.sqrt(2 * known / np.abs(values[order]))
    gap = 2 * float(np.sqrt(2 * known / abs(values[order[0]]))) if known == abs(level) else 0.0
    return AvoidedCrossing(w, vectors.T @ axes, np.linalg.solve(vectors, plane / measures.columns), gap)


def oriented(curve: Curve, solution: Solution, whole: np.ndarray) -> bool:
    """The sign of the determinant of the rows and a tangent: one along a family, another on that which it avoids."""
    matrix, units = scaled(curve, solution)
    return bool(np.linalg.slogdet(np.vstack([matrix, whole / units]))[0] > 0)


def advanced(w: Unknowns, whole: np.ndarray, length: float, curvature: np.ndarray | None = None) -> Unknowns:
    """The predictor: a step of this length along a tangent, with its curvature where that is known."""
    return w.moved(length * whole if curvature is None else length * whole + length**2 * curvature)


def at_place(curve: Curve, w: Unknowns) -> Solution:
    """A Solution out of unknowns that are already on the family (those read from a file)."""
    path = curve.equations.varied(w, states=True)
    solution = Solution(w, path, jacobian_of(curve.through(w), w, path), 0.0)
    if curve.test is None:
        return solution
    border, rows = Border(curve), solution.matrix
    border.value(solution)
    return replace(solution, jacobian=np.vstack([rows, border.row(w, rows)]))


def bend(curve: Curve, w: Unknowns, whole: np.ndarray, other: Unknowns) -> np.ndarray:
    """c of w(sigma) = w + sigma t + sigma^2 c through others; zero where the segments differ."""
    moved = w.displacement(other)
    if moved is None:
        return np.zeros_like(whole)
    along = float((curve.scales.metric(w) * whole) @ moved)
    return (moved - along * whole) / along**2 if abs(along) > 1e-9 else np.zeros_like(whole)
