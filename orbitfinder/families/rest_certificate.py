"""What an equilibrium is judged by: rates, eigenvalues from differences of them, critical ones by the flow.

Nothing here has been used to find it: no derivative of the rates, and of a mechanical system not even those, but
Hamilton's equations, which are derived from its energies.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

import numpy as np
from scipy.linalg.lapack import dgeev
from scipy.optimize import linear_sum_assignment

from orbitfinder.continuation.tests import Roots, decomposed, felt
from orbitfinder.families.equilibrium import UNDECIDED, Equilibria, Equilibrium, RestEvent
from orbitfinder.families.rest_problem import ROUND_OFF, AtRest, state_sizes
from orbitfinder.integrate.dop853 import SECOND, integrate_in
from orbitfinder.integrate.equations import hamilton
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.jets import canonical_rates
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.records.certificate import Certificate, at_most, equal

NOISE, DIFFERENCE, DIFFERED = 1e-14, 2e-3, 1e-9
"""Components so small are 0; half of the widest of the differences that check slopes, in the sizes of the state, and
what slopes by them are known to"""
RESIDUAL, SLOPES, CRITICAL = 1e-12, 1e-7, 1e-8
"""What may be left of the rates, of the eigenvalues by differences and of a critical one by the flow, in the pace of
the equilibrium and its sizes"""
STEPS, WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]) / 3.0, np.array([-1.0, 9.0, -45.0, 45.0, -9.0, 1.0]) / 20.0
"""Of the sixth order, in `DIFFERENCE`s"""


def stability(values: np.ndarray, errors: np.ndarray) -> str:
    """The verdict on eigenvalues with error bars: stable | unstable | neutral."""
    real = values.real
    return "unstable" if (real > errors).any() else "stable" if (real < -errors).all() else "neutral"


def _nearer(state: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Sizes of a state's differences where the equations may not be defined beyond 0."""
    return np.asarray(np.minimum(sizes, np.where(state == 0.0, np.inf, np.abs(state))))


@dataclass(frozen=True, eq=False)
class Judge:
    """Of equilibria of a model along a parameter, or two: Hamilton's equations in y = (q, momentum), or first-order
    rates; `value` is the parameter's, or both."""

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


def verified(equilibria: Equilibria, model: Model | None = None) -> Certificate:
    """Every equilibrium from its record alone: rates, eigenvalues from their differences, critical ones by the flow."""
    judge, worst, wrong = Judge(model or build_model(equilibria.system), (equilibria.parameter,)), np.zeros(3), 0
    sizes = state_sizes(judge.model, np.abs([point.state for point in equilibria.points]).max(axis=0))
    every: tuple[Equilibrium | RestEvent, ...] = (*equilibria.points, *equilibria.events)
    for point in every:
        pace, flow = float(np.abs(point.eigenvalues).max(initial=0.0)) or 1.0, 0.0
        if isinstance(point, Equilibrium):
            value, fault = point.value, not judge.follows(point, sizes, pace)
        else:
            value, fault = point.parameter, not point.consistent
            flow = judge.flow(point.state, value, sizes, pace, point.critical)
        left = judge.left(point.state, value, sizes, pace, point.eigenvalues)
        worst, wrong = np.maximum(worst, [*left, flow]), wrong + fault
    return Certificate((
        at_most("rates", worst[0], RESIDUAL, "largest rate, in the sizes and the pace of its equilibrium"),
        at_most("eigenvalues", worst[1], SLOPES, "from differences of the rates"),
        at_most("critical eigenvalues", worst[2], CRITICAL, "at the events, by the flow of the variations"),
        equal("verdicts", float(wrong), 0.0, "on stability and events, which eigenvalues do not bear out"),
    ))  # fmt: skip
