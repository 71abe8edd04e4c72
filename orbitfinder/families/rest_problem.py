"""Rest as a continuation problem: equilibria, and what is singular among them, in one parameter or two.

With G(z, p) = 0 the equations of rest and E their mass matrix (`integrate.jets`), what is followed is

    regular         G = 0
    fold            G = 0,  G_z a = 0,  c.a = 1
    hopf            G = 0,  G_z a = -kappa E b,  G_z b = E a,  c.a = 1,  c.b = 0      eigenvalues^2 = -kappa
    branch_point    G = -mu psi0,  G_z^T psi = 0,  G_p.psi = 0,  psi0.psi = 1

the last three with one parameter solved for, or along a curve in two. A Hopf point's q = a + i omega b; where kappa
goes through 0 the curve goes on, as one of neutral saddles. A `Judge` judges what is solved by other means. Sources:
A. Griewank, G. Reddien, IMA J. Numer. Anal. 3 (1983) 295-303; Yu. Kuznetsov, Elements of Applied Bifurcation Theory
(2004), chapter 10.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite, sqrt
from typing import Any, Self

import numpy as np
from scipy.linalg.lapack import dgeev, dgetrf, dgetrs
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.continuation.tests import Roots, decomposed, felt
from orbitfinder.errors import ConvergenceError, DomainError
from orbitfinder.families.equilibrium import UNDECIDED, Equilibrium, stability
from orbitfinder.integrate.dop853 import SECOND, integrate_in
from orbitfinder.integrate.equations import hamilton
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.jets import Jets, canonical_rates
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Settings, Solver, largest, stepped
from orbitfinder.mechanics.scales import LEAST_SHARE, parameter_sizes

SETTINGS, SQUARE = (
    Settings(floor=1e-15, round_off=1e-13, converged=1e-12, most_evaluations=12, contraction=0.05),
    Settings(floor=0.0, most_evaluations=30, contraction=0.3, farthest=1e3),
)
"""Rows are relative to the sizes and the pace of the equilibrium; steps to what is singular, to all sizes"""
AHEAD, UNDAMPED = 1.25, 1e-7
"""Sizes that are outgrown become so much larger than what outgrew them. Real parts below this
share of the largest eigenvalue are none, imaginary ones the round-off of a double 0"""
ROUND_OFF = 4 * EPSILON
"""What each row is known to, relative to the sizes of its terms"""
SIMPLE, DISTURBED, BESIDE, CORRECTED = 1e-9, 1e-8, 1e-5, 10.0
"""y x of a simple eigenvalue is larger; how far apart places are, in sizes, that say what slopes change by within error
bars; half of a central difference of slopes along a curve; a solution is known to so many of its next corrections"""
NOISE, DIFFERENCE, DIFFERED = 1e-14, 2e-3, 1e-9
"""Components so small are 0; half of the widest of the differences that check slopes, in the sizes of the state, and
what slopes by them are known to"""
RESIDUAL, SLOPES, CRITICAL = 1e-12, 1e-7, 1e-8
"""What may be left of the rates, of the eigenvalues by differences and of a critical one by the flow, in the pace of
the equilibrium and its sizes"""
STEPS, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]) / 3.0, np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 20.0
"""Of the sixth order, in `DIFFERENCE`s"""


class Stacked:
    """Unknowns that are numbers only, with what is known of them once it was asked for."""

    __slots__ = ("known", "vector")

    def __init__(self, vector: np.ndarray) -> None:
        self.vector, self.known = vector, dict[str, Any]()

    def moved(self, step: np.ndarray) -> Stacked:
        """So much farther."""
        return Stacked(self.vector + step)


class Dense:
    """Derivatives as a matrix whose columns and rows are scaled."""

    def __init__(self, matrix: np.ndarray, sizes: np.ndarray) -> None:
        self.matrix, self.sizes = matrix, sizes

    def closed(self, rows: np.ndarray) -> Solver:
        """See `continuation.problem.Linear`."""
        own = (rows * self.sizes).reshape(-1, self.sizes.size)
        factors, pivots, fault = dgetrf(np.concatenate([self.matrix, own]))
        if fault:
            raise ConvergenceError(
                "the equations of rest are singular: no equilibrium stands alone there; declare what motions conserve "
                "in [system.invariants] (invariants= in Python), or give another state"
            )
        return lambda right: np.asarray(-dgetrs(factors, pivots, right)[0] * self.sizes)


@dataclass(frozen=True, eq=False)
class AtRest:
    """The problem: `form` as above, sizes of z (d + extra), of the parameters and of the rates, references.

    `phase` (k x d) are the generators of symmetries that nothing fixes, `c` and `kept` the numbers above.
    """

    jets: Jets
    form: str
    z_sizes: np.ndarray
    p_sizes: np.ndarray
    pace: float
    kept: np.ndarray
    phase: np.ndarray
    origin: np.ndarray
    c: np.ndarray
    settings: Settings = SETTINGS

    @cached_property
    def count(self) -> int:
        """Components of z."""
        return self.jets.size + self.jets.extra

    @cached_property
    def sizes(self) -> np.ndarray:
        """Sizes of all unknowns: z, what is singular in units of z, the parameters last."""
        more = {"regular": 0, "fold": self.count, "hopf": 2 * self.count + 1, "branch_point": self.count + 1}
        return np.concatenate([self.z_sizes, np.ones(more[self.form]), self.p_sizes])

    def parts(self, w: Stacked) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """z, p and what is between them."""
        vector, count = w.vector, len(self.p_sizes)
        return vector[: self.count], vector[vector.size - count :], vector[self.count : vector.size - count]

    def scaled(self, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """G with its phases, its slopes in z (square) and in p, all in units."""
        whole, below = self._evaluated(z, p), 1 + self.count
        return whole[0], whole[1:below].T, whole[below:].T

    def _evaluated(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """The same below each other, slopes transposed."""
        whole: np.ndarray = self.jets.first(z, p, self.kept) * self._units
        if not len(self.phase):
            return whole
        d, fixed = self.jets.size, np.zeros((len(whole), len(self.phase)))
        fixed[0], fixed[1 : 1 + d] = self.phase @ ((z[:d] - self.origin) / self.z_sizes[:d]), self.phase.T
        return np.hstack([whole, fixed])

    @cached_property
    def _units(self) -> np.ndarray:
        """1 and the units of z and of p, in those of each row."""
        return np.asarray(np.concatenate([[1.0], self.z_sizes, self.p_sizes])[:, None] / self.row_sizes)

    @cached_property
    def row_sizes(self) -> np.ndarray:
        """What G is measured in: sizes of the state a unit of time, and what the rest changes by at unit steps."""
        jets, d, rates = self.jets, self.jets.size, self.z_sizes[: self.jets.size] * self.pace
        if not jets.extra:
            return rates
        z = np.concatenate([self.origin, np.zeros(jets.extra)])
        by_z = jets.first(z, jets.model.values_of(jets.free), self.kept)[1 : 1 + z.size].T[d:]
        return np.concatenate([rates, nonzero(np.abs(by_z * self.z_sizes).max(axis=1, initial=0.0))])

    def moving(self, z: np.ndarray, p: np.ndarray) -> np.ndarray:
        """What each parameter changes by where the state moves by its sizes."""
        _, gz, gp = self.scaled(z, p)
        return np.asarray(self.p_sizes / nonzero(np.abs(np.linalg.lstsq(gz, gp)[0]).max(axis=0)))

    def second(self, z: np.ndarray, p: np.ndarray, v: np.ndarray) -> np.ndarray:
        """The slopes in (z, p) of G_z v, in units, with rows of 0 for the phases."""
        units = np.concatenate([self.z_sizes, self.p_sizes])
        found = self.jets.second(z, p, v * self.z_sizes) * units / self.row_sizes[:, None]
        return np.vstack([found, np.zeros((len(self.phase), units.size))])

    def rows(self, w: Stacked) -> np.ndarray:
        """F(w)."""
        return self.linearise(w)[0] if self.form == "regular" else self._assembled(w, False)[0]

    def linearise(self, w: Stacked) -> tuple[np.ndarray, Dense]:
        """F(w) and its derivatives, remembered with w."""
        problem, *found = w.known.get("linear", (None,))
        if problem is not self:
            rows, matrix = self._assembled(w, True)
            found = [rows, Dense(matrix, self.sizes)]
            w.known["linear"] = (self, *found)
        return found[0], found[1]

    def _assembled(self, w: Stacked, slopes: bool) -> tuple[np.ndarray, np.ndarray]:
        z, p, more = self.parts(w)
        whole, below = self._evaluated(z, p), 1 + self.count
        defined(self.jets, whole[:below])
        if self.form == "regular":
            return whole[0], whole[1:].T
        given = whole[0], whole[1:below].T, whole[below:].T
        return getattr(self, f"_{self.form}")(z, p, more, given, slopes)  # type: ignore[no-any-return]

    def _fold(
        self, z: np.ndarray, p: np.ndarray, a: np.ndarray, given: Any, slopes: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        g, gz, gp = given
        rows = np.concatenate([g, gz @ a, [self.c @ a - 1.0]])
        if not slopes:
            return rows, rows
        count, turned, zeros = self.count, self.second(z, p, a), np.zeros((self.count, self.count))
        return rows, np.vstack([
            np.hstack([gz, zeros, gp]), np.hstack([turned[:, :count], gz, turned[:, count:]]),
            np.concatenate([np.zeros(count), self.c, np.zeros(p.size)]),
        ])  # fmt: skip

    def _hopf(
        self, z: np.ndarray, p: np.ndarray, more: np.ndarray, given: Any, slopes: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        (g, gz, gp), count = given, self.count
        a, b, kappa = more[:count], more[count:-1], more[-1]
        mass = self.mass
        rows = np.concatenate([g, gz @ a + kappa * mass * b, gz @ b - mass * a, [self.c @ a - 1.0, self.c @ b]])
        if not slopes:
            return rows, rows
        first, second, zeros = self.second(z, p, a), self.second(z, p, b), np.zeros((count, count))
        column, none = (mass * b)[:, None], np.zeros((count, 1))
        ends = np.zeros((2, self.sizes.size))
        ends[0, count : 2 * count] = ends[1, 2 * count : 3 * count] = self.c
        return rows, np.vstack([
            np.hstack([gz, zeros, zeros, none, gp]),
            np.hstack([first[:, :count], gz, kappa * np.diag(mass), column, first[:, count:]]),
            np.hstack([second[:, :count], -np.diag(mass), gz, none, second[:, count:]]), ends,
        ])  # fmt: skip

    def _branch_point(
        self, z: np.ndarray, p: np.ndarray, more: np.ndarray, given: Any, slopes: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        (g, gz, gp), count = given, self.count
        mu, psi = more[0], more[1:]
        rows = np.concatenate([g + mu * self.c, gz.T @ psi, gp.T @ psi, [self.c @ psi - 1.0]])
        if not slopes:
            return rows, rows
        units, known = np.concatenate([self.z_sizes, self.p_sizes]), count - len(self.phase)
        hessian = self.jets.weighted(z, p, psi[:known] / self.row_sizes) * units * units[:, None]
        both = np.hstack([gz, gp]).T
        return rows, np.vstack([
            np.hstack([gz, self.c[:, None], np.zeros((count, count)), gp]),
            np.hstack([hessian[:, :count], np.zeros((count + p.size, 1)), both, hessian[:, count:]]),
            np.concatenate([np.zeros(count + 1), self.c, np.zeros(p.size)]),
        ])  # fmt: skip

    @cached_property
    def mass(self) -> np.ndarray:
        """The diagonal of E (with the phases' zeros)."""
        return np.concatenate([np.ones(self.jets.size), np.zeros(self.jets.extra)])

    def phases(self, w: Stacked) -> np.ndarray:
        """None: they are rows."""
        return np.zeros((0, w.vector.size))

    def metric(self, w: Stacked) -> np.ndarray:  # noqa: ARG002 - of the protocol
        """The mean square of the state's components, and of each parameter."""
        return self._metric

    @cached_property
    def _metric(self) -> np.ndarray:
        d, metric = self.jets.size, np.zeros(self.sizes.size)
        metric[:d] = 1.0 / (d * self.z_sizes[:d] ** 2)
        metric[metric.size - self.p_sizes.size :] = self.p_sizes**-2.0
        return metric

    def value(self, w: Stacked, name: str) -> float:
        """Of a parameter."""
        return float(w.vector[self.jets.free.index(name) - self.p_sizes.size])

    def aim(self, w: Stacked, name: str, value: float) -> tuple[float, np.ndarray]:
        """A parameter at a value, in its units."""
        index = self.jets.free.index(name) - self.p_sizes.size
        row = self._aims[index]
        return (float(w.vector[index]) - value) * float(row[index]), row

    @cached_property
    def _aims(self) -> np.ndarray:
        """What each parameter's aim changes by over w."""
        return np.asarray(np.eye(self.sizes.size)[-self.p_sizes.size :] / self.sizes)

    def at(self, w: Stacked, tangent: np.ndarray) -> tuple[Self, Stacked, np.ndarray]:
        """With references and sizes of an accepted w."""
        z, p, more = self.parts(w)
        renewed = self.seen(z, p)
        if self.form == "regular":
            noise = (np.abs(z) <= ROUND_OFF * renewed.z_sizes) & (z != 0.0)
            w = Stacked(np.concatenate([np.where(noise, 0.0, z), p])) if noise.any() else w
            if len(self.phase):
                z = w.vector[: self.count]
                renewed = replace(renewed, origin=z[: self.jets.size], phase=_phase(self.jets, z, p, renewed.z_sizes))
        elif self.form in ("fold", "hopf"):  # a reference that stays along the vector
            a, count = more[: self.count], self.count
            c = a / (a @ a)
            renewed, vector = replace(renewed, c=c), w.vector.copy()
            if self.form == "hopf" and more[-1] > 0:  # turned so that a is the longest, which goes on where kappa is 0
                a, b = _longest(a + 1j * np.sqrt(more[-1]) * more[count:-1], float(more[-1]))
                vector[count : 2 * count], vector[2 * count : 3 * count] = a, b
                renewed, w = replace(renewed, c=a / (a @ a)), Stacked(vector)
            elif self.form == "hopf":  # turned so that c.b = 0
                b, kappa = more[count : 2 * count], more[-1]
                share = float(c @ b)
                turned, other = a + kappa * share * b, b - share * a
                scale = float(c @ turned)
                vector[count : 2 * count] = turned / scale
                vector[2 * count : 3 * count] = (other - (c @ other) / scale * turned) / scale
                w = Stacked(vector)
        metric = renewed.metric(w)
        return renewed, w, tangent / sqrt(float(tangent @ (metric * tangent)))

    def seen(self, z: np.ndarray, p: np.ndarray, most: np.ndarray | None = None) -> Self:
        """With sizes no smaller than those of another equilibrium, or than a state's `most` (d), and somewhat larger
        where those are."""
        d, old = self.jets.size, self.sizes
        if self.form != "regular":
            return self
        largest = np.abs(np.concatenate([z[:d] if most is None else most, np.zeros(self.jets.extra), p]))
        if not (grown := largest > old).any():
            return self
        sizes = np.where(grown, AHEAD * largest, old)
        grown_up = replace(self, z_sizes=sizes[: z.size], p_sizes=sizes[z.size :])
        faster = AHEAD * float(np.abs(np.linalg.eigvals(grown_up.scaled(z, p)[1][:d, :d])).max(initial=0.0))
        return grown_up if faster <= AHEAD else grown_up.paced(faster * self.pace)

    def paced(self, pace: float) -> Self:
        """The same in another unit of time: of mechanics velocities too."""
        model, z_sizes = self.jets.model, self.z_sizes.copy()
        if model.rates is None:
            n = model.degrees_of_freedom
            z_sizes[n : 2 * n] = z_sizes[:n] * pace
        return replace(self, z_sizes=z_sizes, pace=pace)

    def carried(self, w: Stacked, onto: Stacked) -> Stacked:  # noqa: ARG002 - of the protocol
        """Itself: there is no mesh."""
        return w


def defined(jets: Jets, whole: np.ndarray) -> None:
    """`DomainError` where the equations of rest or their slopes (below each other) are not finite."""
    if not isfinite(float(np.vdot(whole, whole))):
        lost = np.array(jets.model.state_names)[~np.isfinite(whole[:, : jets.size]).all(axis=0)]
        rates = f"the rate of {', '.join(lost[:5])}, or a slope of it," if lost.size else "an equation of rest"
        raise DomainError(f"{rates} is not a finite number there")


def _phase(jets: Jets, z: np.ndarray, p: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """The directions (k x d) of symmetries at a state, in units, each of length 1."""
    rows = jets.generators(z[: jets.size], p)[0] / sizes[: jets.size]
    return np.asarray(rows / nonzero(np.linalg.norm(rows, axis=1, keepdims=True)))


def regular(
    jets: Jets, state: np.ndarray, values: np.ndarray, span: np.ndarray | None = None, leaf: np.ndarray | None = None
) -> AtRest:
    """The problem of equilibria about a state; `span` (of the parameters) are ways that are to be gone, and the first
    integrals keep the values that they have at `leaf` (d), the state itself when left out."""
    model, d = jets.model, jets.size
    z = np.concatenate([state, np.zeros(jets.extra)])
    kept = jets.kept_at(state if leaf is None else leaf)
    p_sizes = parameter_sizes(model, jets.free, values)
    p_sizes = np.maximum(p_sizes, 0.0 if span is None else np.abs(span))
    whole = jets.first(z, values, kept)[: 1 + z.size]
    defined(jets, whole)
    by_z = whole[1:].T
    sizes = state_sizes(model, np.abs(state))
    pace = float(np.abs(np.linalg.eigvals(by_z[:d, :d] * sizes / sizes[:, None])).max(initial=0.0)) or 1.0
    if model.rates is None:
        n = model.degrees_of_freedom
        sizes[n:] = sizes[:n] * pace
    pushes = np.abs(by_z[:d, d:] / sizes[:, None]).max(axis=0, initial=0.0) / pace
    z_sizes = np.concatenate([sizes, 1.0 / nonzero(pushes)])
    problem = AtRest(
        jets, "regular", z_sizes, p_sizes, pace, kept, _phase(jets, z, values, z_sizes), state, np.zeros(0)
    )  # fmt: skip
    unknown = (values == 0.0) & [span is None and name not in model.scales for name in jets.free]
    return replace(problem, p_sizes=np.where(unknown, problem.moving(z, values), p_sizes)) if any(unknown) else problem


def state_sizes(model: Model, largest: np.ndarray) -> np.ndarray:
    """What states (d) are measured in whose components are at most so large: angles in rad, the others in themselves,
    in a tenth of the largest where they are 0."""
    angular = np.resize(model.angular, largest.size)
    share = LEAST_SHARE * float(largest[~angular].max(initial=0.0)) or 1.0
    return np.where(angular, np.maximum(1.0, largest), np.where(largest > 0.0, largest, share))


def without_noise(problem: AtRest, z: np.ndarray, p: np.ndarray) -> np.ndarray:
    """z with 0 for what is 0 to the error bars of a regular equilibrium."""
    w = Stacked(np.append(z, p))
    try:
        bars = error_bars(problem, w, np.eye(w.vector.size)[-1])[: z.size]
    except np.linalg.LinAlgError:
        return z
    return np.where(np.abs(z) <= np.maximum(bars, ROUND_OFF * problem.z_sizes), 0.0, z)


def spectrum(problem: AtRest, w: Stacked, tangent: np.ndarray | None = None) -> Roots:
    """The eigenvalues of the linearised flow (1/s) at a solution, those that integrals, constraints and symmetries make
    0 left out; without a tangent (over w) they have no slopes, and the solution's error bars are at its parameters.

    Error bars are those of round-off in A, of the eigenvalue's own computation, and of the solution. Raises
    `ConvergenceError`.
    """
    d, jets, (z, p, _) = problem.jets.size, problem.jets, problem.parts(w)
    basis = np.eye(d)
    if problem.count > d:
        rows = np.vstack([problem.scaled(z, p)[1][d:, :d], jets.generators(z[:d], p)[1] * problem.z_sizes[:d]])
        _, values, right = np.linalg.svd(rows)
        basis = right[np.count_nonzero(values > 1e-9 * values.max(initial=0.0)) :]

    def slopes(w: Stacked) -> np.ndarray:
        with np.errstate(invalid="ignore"):  # beside the edge of where the equations are defined
            return np.asarray(basis @ problem.scaled(*problem.parts(w)[:2])[1][:d, :d] @ basis.T)

    a, change = slopes(w), np.zeros(len(basis))
    values, left, right = decomposed(a)
    step = ROUND_OFF * np.abs(w.vector) * np.resize([1.0, -1.0], w.vector.size)
    with contextlib.suppress(ConvergenceError):
        if problem.form == "regular":  # a correction more, by what is left of the rows
            across = np.eye(w.vector.size)[-1] if tangent is None else problem.metric(w) * tangent
            rows, linear = problem.linearise(w)
            step += CORRECTED * linear.closed(across[None])(np.append(rows, 0.0))
    more = DISTURBED / nonzero(float(np.abs(step / problem.sizes).max()))
    unsure = 4 * ROUND_OFF * np.abs(a) + np.abs(slopes(w.moved(more * step)) - a) / more
    missed = np.abs(felt(left, a, right) - values)
    errors = felt(abs(left), unsure, abs(right)) + np.where(np.abs(left).max(axis=1) < 1 / SIMPLE, missed, 0.0)
    if tangent is not None:
        sides = [(length, slopes(w.moved(length * tangent))) for length in (-BESIDE, BESIDE)]
        (low, before), (high, after) = (side if np.isfinite(side[1]).all() else (0.0, a) for side in sides)
        change = felt(left, (after - before) / nonzero(high - low), right)
    return Roots(values * problem.pace, change * problem.pace, basis.T @ right, errors * problem.pace)


def paired(problem: AtRest, w: Stacked) -> bool:
    """Whether eigenvalues come in pairs +-lambda: those of a conservative system where its energy is level do."""
    model = problem.jets.model
    if model.rates is None or not model.conservative:
        return model.conservative
    roots = spectrum(problem, w)
    sums = np.abs(roots.values[:, None] + roots.values).min(axis=1, initial=np.inf)
    return bool(sums.max(initial=0.0) <= 2 * roots.errors.max(initial=0.0))


def squared(roots: Roots) -> Roots:
    """The squares of eigenvalues that come in pairs +-lambda, half of them."""
    order = np.lexsort((roots.values.real, roots.values.imag))[roots.values.size // 2 :]
    half = roots.chosen(order)
    values, errors = half.values**2, (2 * np.abs(half.values) + half.errors) * half.errors
    values = np.where(np.abs(values.imag) <= errors, values.real, values)
    return replace(half, values=values, slopes=2 * half.values * half.slopes, errors=errors)


def singular(
    problem: AtRest, z: np.ndarray, p: np.ndarray, form: str, critical: complex | None = None
) -> tuple[AtRest, Stacked]:
    """The problem of what is singular near an equilibrium, and a guess of it, by the critical eigenvalue (1/s) if there
    is any."""
    problem = problem.paced(abs(critical)) if form == "hopf" and critical else problem
    gz = problem.scaled(z, p)[1]
    left, _, right = np.linalg.svd(gz)
    if form == "fold":
        a = right[-1]
        return replace(problem, form=form, c=a), Stacked(np.concatenate([z, a, p]))
    if form == "branch_point":
        psi = left[:, -1]
        return replace(problem, form=form, c=psi), Stacked(np.concatenate([z, [0.0], psi, p]))
    values, vectors = _pencil(gz, problem.mass)
    if critical is None:
        i, j = critical_pair(values)
    else:  # the conjugate, or the opposite if it is real
        i = int(np.argmin(np.abs(values - critical / problem.pace)))
        away = np.abs(values - (values[i].conj() if values[i].imag else -values[i]))
        away[i] = np.inf
        j = int(np.argmin(away))
    turning = abs(values[i].imag) >= abs(values[i].real)
    kappa = float(abs(values[i] * values[j])) * (1.0 if turning else -1.0)
    if kappa > 0:  # q = a + i omega b
        q = vectors[:, i] if values[i].imag > 0 else vectors[:, i].conj()
        a, b = _longest(q, kappa)
    else:
        u, v = vectors[:, i].real, vectors[:, j].real
        v = v if u @ v >= 0 else -v
        first, second = values[i].real, values[j].real
        a, b = u + v, u / first + v / second
    c = a / (a @ a)
    b = b - (c @ b) * a if kappa <= 0 else b
    return replace(problem, form=form, c=c), Stacked(np.concatenate([z, a, b, [kappa], p]))


def _longest(q: np.ndarray, kappa: float) -> tuple[np.ndarray, np.ndarray]:
    """a and b of q turned so that Re q and Im q are across each other, the first the longer."""
    q = q * np.exp(-0.5j * np.angle(np.sum(q**2)))
    return q.real, q.imag / np.sqrt(kappa)


def _pencil(gz: np.ndarray, mass: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues and vectors of G_z v = lambda E v, the infinite ones left out."""
    if mass.all():
        values, vectors = np.linalg.eig(gz)
        return values, vectors
    shift = 0.7364  # none of them, in units of the pace
    inverse, right = np.linalg.eig(np.linalg.solve(gz - shift * np.diag(mass), np.diag(mass)))
    finite = np.abs(inverse) > 1e-9
    return shift + 1.0 / inverse[finite], right[:, finite]


def nearest(gz: np.ndarray, mass: np.ndarray, value: complex) -> np.ndarray:
    """The vector of the eigenvalue that is nearest to a value."""
    values, vectors = _pencil(gz, mass)
    return vectors[:, np.argmin(np.abs(values - value))]


def oscillations(problem: AtRest, z: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The frequencies (k, rad/s, slowest first) of what turns about an equilibrium for ever, and q (d x k) of each."""
    values, vectors = _pencil(problem.scaled(z, p)[1], problem.mass)
    least = UNDAMPED * float(np.abs(values).max(initial=0.0))
    kept = np.flatnonzero((np.abs(values.real) <= least) & (values.imag > least))
    kept = kept[np.argsort(values.imag[kept])]
    shapes = problem.z_sizes[:, None] * vectors[:, kept]
    return values.imag[kept] * problem.pace, shapes[: problem.jets.size]


def critical_pair(values: np.ndarray) -> tuple[int, int]:
    """The two eigenvalues whose sum is the least, of those that are not both 0."""
    sums = np.abs(values[:, None] + values[None, :])
    sums[np.diag_indices(values.size)] = np.inf
    i, j = np.unravel_index(int(np.argmin(sums)), sums.shape)
    return int(i), int(j)


def error_bars(problem: AtRest, w: Stacked, across: np.ndarray | None = None) -> np.ndarray:
    """Of all unknowns of a square problem, or of a curve's in the plane `across`: what round-off of its terms, and what
    is left of its rows, moves them by."""
    rows, linear = problem.linearise(w)
    matrix = linear.matrix if across is None else np.vstack([linear.matrix, across * problem.sizes])
    inverse = np.abs(np.linalg.inv(matrix))[:, : rows.size]
    terms = np.abs(linear.matrix) @ np.abs(w.vector / problem.sizes)
    return np.asarray(inverse @ (np.abs(rows) + ROUND_OFF * terms) * problem.sizes)


def solve_square(problem: AtRest, guess: Stacked) -> Stacked:
    """A solution of a problem with as many rows as unknowns: whole Newton steps until they no longer shrink.

    Raises `ConvergenceError`.
    """

    def step(w: Stacked) -> np.ndarray:
        rows, linear = problem.linearise(w)
        return linear.closed(np.zeros((0, w.vector.size)))(rows)

    solved = stepped(guess, step, SQUARE, Stacked.moved, lambda step: largest(step / problem.sizes))
    if not solved.converged:
        raise ConvergenceError("the equations of a singular equilibrium were not solved")
    return solved.w


def lyapunov(
    problem: AtRest, z: np.ndarray, p: np.ndarray, omega: float
) -> tuple[float, float, np.ndarray, np.ndarray, np.ndarray]:
    """The first Lyapunov coefficient of a Hopf point of frequency omega (rad/s), the size of its terms, and q, h11,
    h20 (d) of its motions x + 2 Re(w q) + h11 |w|^2 + Re(h20 w^2); nan and zeros at a resonance.

    l1 = Re [<p, C(q, q, q*)> - 2 <p, B(q, A^-1 B(q, q*))> + <p, B(q*, (2 i omega - A)^-1 B(q, q))>] / 2 omega.
    """
    d, gz, mass = problem.jets.size, problem.scaled(z, p)[1], np.diag(problem.mass)
    units, turn = problem.z_sizes, 1j * omega / problem.pace
    rows = np.append(problem.row_sizes, np.ones(len(problem.phase)))
    q, weight = units * nearest(gz, problem.mass, turn), nearest(gz.T, problem.mass, turn).conj() / rows
    q = q / np.linalg.norm(q[:d])
    weight = weight / np.conj(weight.conj() @ (mass @ q))
    jets, a, b = problem.jets, q.real, q.imag
    second = (jets.second(z, p, a) + 1j * jets.second(z, p, b))[:, : z.size]  # B(q, .)
    third = jets.third(z, p, a, a) - jets.third(z, p, b, b) + 2j * jets.third(z, p, a, b)  # C(q, q, .)

    def solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
        return units * np.linalg.solve(matrix, np.append(right, np.zeros(len(problem.phase))) / rows)

    try:
        mean, double = solved(gz, second @ q.conj()), solved(2 * turn * mass - gz, second @ q)
    except np.linalg.LinAlgError:  # another pair at twice the frequency: a resonance
        return np.nan, np.nan, q[:d], np.zeros(d), np.zeros(d)
    terms = np.array([third @ q.conj(), -2 * second @ mean, second.conj() @ double])
    parts = (weight.conj()[: terms.shape[1]] * terms) / (2 * omega)
    return float(parts.sum().real), float(np.abs(parts).sum()), q[:d], -mean[:d].real, double[:d]


def first_lyapunov(
    problem: AtRest, z: np.ndarray, p: np.ndarray, omega: float, bars: np.ndarray
) -> tuple[float, float, str, np.ndarray]:
    """The first Lyapunov coefficient at an equilibrium with these error bars, its own error bar, supercritical |
    subcritical | degenerate, and q; nan at a resonance."""
    coefficient, terms, q, *_ = lyapunov(problem, z, p, omega)
    if np.isnan(coefficient):
        return coefficient, np.nan, "degenerate", q
    bars, random = np.maximum(bars, ROUND_OFF * problem.z_sizes), np.random.default_rng(0)
    more = DISTURBED / float(np.abs(bars / problem.z_sizes).max())
    moved = [lyapunov(problem, z + more * bars * random.uniform(-1, 1, z.size), p, omega)[0] for _ in range(4)]
    error = 10 * float(np.abs(np.array(moved) - coefficient).max()) / more + 1e-12 * terms
    side = "supercritical" if coefficient < -error else "subcritical" if coefficient > error else "degenerate"
    return coefficient, error, side, q


def _nearer(state: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Sizes of a state's differences where the equations may not be defined beyond 0."""
    return np.asarray(np.minimum(sizes, np.where(state == 0.0, np.inf, np.abs(state))))


@dataclass(frozen=True, eq=False)
class Judge:
    """The witness of equilibria of a model along a parameter, or two (`value` is the parameter's, or both): Hamilton's
    equations in y = (q, momentum), or first-order rates, eigenvalues from differences of those, critical ones by the
    flow. Nothing of it has been used to find them: no derivative of the rates, and of mechanics not even those.
    """

    model: Model
    parameters: tuple[str, ...]

    @cached_property
    def _equations(self) -> tuple[Buffered, Buffered, np.ndarray, np.ndarray]:
        """Those of `canonical_rates`, and where the states beside one are, in sizes."""
        there, rates, chosen = canonical_rates(self.model, self.parameters, STEPS.size)
        beside = DIFFERENCE * np.vstack([np.zeros((1, chosen.size)), np.kron(STEPS[:, None], np.eye(chosen.size))])
        return there, rates, chosen, beside

    def _canonical(
        self, state: np.ndarray, value: float | np.ndarray, sizes: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """y, and what it is measured in."""
        if self.model.rates is not None:
            return state, sizes
        there, _, chosen, _ = self._equations
        (y,), slopes = there(state[chosen], value)
        return y, sizes[chosen] @ np.abs(slopes)

    def record(self, problem: AtRest, z: np.ndarray, p: np.ndarray, arclength: float, roots: Roots) -> Equilibrium:
        """An equilibrium with these eigenvalues, certified."""
        d, value = problem.jets.size, float(p[0])
        z = np.where(np.abs(z) <= NOISE * problem.z_sizes, 0.0, z)
        values = roots.values[np.lexsort((-roots.values.imag, -roots.values.real))]
        residual, slopes = self.left(z[:d], value, problem.z_sizes[:d], problem.pace, values)
        sure = bool(residual <= RESIDUAL and slopes <= SLOPES)
        return Equilibrium(z[:d], value, values, stability(roots.values, roots.errors), arclength, residual, sure)

    def left(
        self, state: np.ndarray, value: float | np.ndarray, sizes: np.ndarray, pace: float, claimed: np.ndarray
    ) -> tuple[float, float]:
        """The largest rate in sizes and pace, and how far the claimed eigenvalues are from those of differences of the
        sixth order, relative to the pace: the least singular value of A - lambda, or the distance, which is larger."""
        rates, slopes = self._differences(state, value, sizes, pace)
        upper, largest = claimed[claimed.imag >= 0] / pace, float(np.abs(rates).max())  # of a pair either will do
        bound = np.inf
        if isfinite(float(slopes.sum())):
            real, imaginary, *_ = dgeev(slopes, compute_vl=False, compute_vr=False)
            bound = float(np.abs(upper[:, None] - (real + 1j * imaginary)).min(axis=1).max(initial=0.0))
            if bound > SLOPES:
                shifted = slopes - upper[:, None, None] * np.eye(len(slopes))
                bound = float(np.linalg.svd(shifted, compute_uv=False)[:, -1].max())
        nearer = _nearer(state, sizes)
        if bound > SLOPES and (nearer < sizes).any():
            bound = self.left(state, value, nearer, pace, claimed)[1]
        return largest, bound

    def _differences(
        self, state: np.ndarray, value: float | np.ndarray, sizes: np.ndarray, pace: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """The rates in sizes and pace, and their slopes by differences of the sixth order."""
        y, units = self._canonical(state, value, sizes)
        _, rates_of, _, beside = self._equations
        rates, d = rates_of(y + units * beside, value)[0] / (units * pace), y.size
        return rates[0], (WEIGHTS @ rates[1:].reshape(6, d * d)).reshape(d, d).T / DIFFERENCE

    def follows(self, point: Equilibrium, sizes: np.ndarray, pace: float) -> bool:
        """Whether the verdict on stability does, from the eigenvalues of differences of the rates; where these leave it
        open, from the recorded ones with error bars by the conditions of those."""
        slopes, nearer = self._differences(point.state, point.value, sizes, pace)[1], _nearer(point.state, sizes)
        if not np.isfinite(slopes).all() and (nearer < sizes).any():
            return self.follows(point, nearer, pace)
        claimed, size = point.eigenvalues / pace, np.abs(slopes)
        if not (np.isfinite(slopes).all() and np.isfinite(claimed).all() and claimed.size <= len(slopes)):
            return False
        values, left, right = decomposed(slopes)
        chosen = linear_sum_assignment(np.abs(claimed[:, None] - values))[1]
        left, right = left[chosen], right[:, chosen]
        bars = DIFFERED * felt(abs(left), size + 1e-3 * size.max(axis=1, keepdims=True), abs(right))
        verdict = stability(values[chosen], bars)
        if verdict == "neutral":
            return point.stability in (verdict, stability(claimed, ROUND_OFF * felt(abs(left), size, abs(right))))
        earlier = point.stability == "neutral" and claimed.real.max() <= UNDECIDED
        return earlier or point.stability == verdict

    def flow(
        self, state: np.ndarray, value: float | np.ndarray, sizes: np.ndarray, pace: float, claimed: complex
    ) -> float:
        """How far an eigenvalue is from that of the flow, DOP853's of the variations over 1 / pace: the least singular
        value of Phi - exp(lambda t)."""
        y, sizes = self._canonical(state, value, sizes)
        known = dict(zip(self.parameters, np.ravel(value).tolist(), strict=True))
        d, field = y.size, hamilton(with_parameters(self.model, known)).variational
        start, units = np.concatenate([y, np.eye(d).ravel(), [0.0]]), np.outer(sizes, 1.0 / sizes).T.ravel()
        units = np.concatenate([sizes, units, [1.0]])
        end = integrate_in(units, vector_field(field), start, np.array([0.0, 1.0 / pace]), SECOND)[-1]
        phi = end[d:-1].reshape(d, d).T * sizes / sizes[:, None]
        return float(np.linalg.svd(phi - np.exp(claimed / pace) * np.eye(d), compute_uv=False)[-1])
