"""The named objectives: what they minimise, and where along the orbit t = 0 has to be for that.

The largest value along an orbit is not a smooth function of its nodes. With t = 0 at a peak of the
coordinate (or of its rate) it is: the phase condition becomes v_i(0) = 0 (or a_i(0) = 0), and the
peak is x_i(0). Which of several peaks is the largest is looked up afterwards, and the search goes on
from there when it was another.

How unstable an orbit is, as a number that can be minimised: for a conservative system the largest stability index
|mu + 1/mu|, 2 and below while every multiplier is on the unit circle and growing with the spectral radius beyond;
for others the spectral radius itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
from scipy.linalg import eig

from orbitfinder.errors import ConvergenceError, CountError, InputError
from orbitfinder.integrate.cvodes import Flow, build_flow
from orbitfinder.loops.conditions import Constraint, Variables
from orbitfinder.loops.ipopt import Callback, SolveSettings, solve_nlp
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.problem import PEAKS, Guess, Problem, guessed_nodes
from orbitfinder.loops.shooting import Shooting, transcribe
from orbitfinder.loops.symmetry import symplectic
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import shared
from orbitfinder.orbits.measure import dense, full_period
from orbitfinder.records.orbit import Orbit

ROUNDS = 6
"""Peaks that are tried before two of them are said to compete."""
LARGEST_BOX, SMALLEST_BOX, MOST_BOXES = 0.3, 0.004, 60
"""Steps along the family, relative to the motion's extent, and how many of them."""
COARSE_BOX = 0.05
"""The smallest step where a kink is the usual reason for failing: it is looked for next."""
PEAK_TOLERANCE = 1e-6
"""A peak is another's equal when it is higher by less than this, relative."""
REAL = 1e-7
"""A stability index with a smaller imaginary part, relative, is taken for real."""
TIE = 1e-6
"""Spectral radii that differ by less, relative, are equal; all elliptic orbits have 1."""


class StalledError(ConvergenceError):
    """The objective cannot be followed further than `w`, the decision vector of an orbit."""

    def __init__(self, message: str, w: np.ndarray) -> None:
        super().__init__(message)
        self.w = w


def chosen(
    problem: Problem, nodes: np.ndarray | Unknowns, flow: Flow, settings: SolveSettings, report: Callback | None = None
) -> tuple[Shooting, np.ndarray]:
    """The solved nonlinear program of a Problem; its objective, where it has a name, made explicit first.

    Any objective but the distance is followed from the nearest orbit within the bounds, because an
    approximate Hessian far from all orbits leads astray.
    """
    if problem.choice:
        raise CountError(
            "objective: with nothing free the orbits stand alone, and the least unstable of them is a choice among "
            "many searches; use orbitfinder.least_unstable(problem) or a problem file"
        )
    stability = problem.objective == "min_instability"
    if stability:
        if problem.model.constraint is not None:
            raise InputError("objective: min_instability needs minimal coordinates; see minimal_linkage")
        problem = replace(problem, objective=instability(problem.model))
    first = transcribe(replace(problem, objective="nearest", coordinate=None), nodes, flow)
    w = solve_nlp(first, settings, report)
    if problem.objective == "nearest":
        return first, w
    if problem.objective in PEAKS:
        return _peak(problem, (first, w), settings, report)
    shooting = transcribe(problem, nodes, flow)
    try:
        return shooting, followed(shooting, settings, report, w, COARSE_BOX if stability else SMALLEST_BOX)
    except StalledError as stalled:
        if not stability or not problem.model.smooth:
            raise
        return _crossing(shooting, stalled, settings, report)


def _crossing(
    shooting: Shooting, stalled: StalledError, settings: SolveSettings, report: Callback | None
) -> tuple[Shooting, np.ndarray]:
    """Where the larger of two stability indices is smallest because there they are opposite, k1 = -k2.

    That is the usual optimum with two pairs of multipliers, and a kink: found as an equation, k1 + k2 =
    trace Phi(T) less the trivial ones = 0. Raises the error of the search that stalled where it is none.
    """
    problem, flow = shooting.problem, shooting.flow
    trivial = trivial_count(problem.model)
    if not symplectic(problem.model) or len(problem.model.state_names) - trivial != 4:
        raise stalled
    opposite = Constraint(lambda known: ca.trace(known.monodromy) - trivial, name="opposite indices")
    single = problem.count().freedom == 1
    wanted = replace(
        problem, constraints=(*problem.constraints, opposite), objective="nearest" if single else problem.objective
    )
    crossed = transcribe(wanted, shooting.guess.nodes, flow)
    solved = solve_nlp if single else followed
    try:
        w = solved(crossed, settings, report, stalled.w)
    except ConvergenceError as error:
        raise stalled from error
    if not _least(shooting, stalled.w, w):
        raise stalled
    return crossed, w


def _least(shooting: Shooting, before: np.ndarray, w: np.ndarray) -> bool:
    """True when the objective at w is below that of another orbit, and grows to both sides along the orbits."""
    value = ca.Function("value", [shooting.variables], [shooting.objective])
    _, singular, rows = np.linalg.svd(shooting.jacobian(w).full())
    if w.size - int(np.sum(singular > 1e-9 * singular[0])) != 1:
        return float(value(w)) <= float(value(before)) + 1e-9
    step = 1e-4 * rows[-1]
    here = float(value(w))
    return here <= float(value(before)) + 1e-9 and min(float(value(w + step)), float(value(w - step))) > here


def followed(
    shooting: Shooting, settings: SolveSettings, report: Callback | None, start: np.ndarray,
    smallest: float = SMALLEST_BOX,
) -> np.ndarray:  # fmt: skip
    """The optimum reached from an orbit through boxes of a fraction of its extent, each solved by IPOPT.

    A quasi-Newton step can be of any length, and the orbit's equations have many solutions: the boxes keep the
    search on the family that it started on. A box that fails is made smaller.
    """
    w, size = start, LARGEST_BOX
    for _ in range(MOST_BOXES):
        # how far each unknown may sensibly move: the motion's extents, the period, the parameters' own sizes
        here, angular = shooting.at(w), shooting.problem.model.angular
        node = shared(np.maximum(np.ptp(here.nodes, axis=0), np.abs(here.nodes).max(axis=0) / 2), angular)
        node[angular.size :] = np.maximum(node[angular.size :], node[: node.size - angular.size] / here.period)
        free = np.maximum(np.abs(here.free), 1e-3)
        reach = size * (here.joined(node, here.period, np.inf, free) / shooting.units)
        lower, upper = np.maximum(shooting.lower, w - reach), np.minimum(shooting.upper, w + reach)
        try:
            found = solve_nlp(replace(shooting, lower=lower, upper=upper), settings, report, w)
        except ConvergenceError as error:
            size /= 4
            if size < smallest:
                raise StalledError(_stopped(shooting, w), w) from error
            continue
        w, edge = found, 1e-4 * reach
        inside = ((w > lower + edge) | (lower == shooting.lower)) & ((w < upper - edge) | (upper == shooting.upper))
        if np.all(inside):
            return w
        size = min(LARGEST_BOX, 2 * size)
    raise ConvergenceError(
        f"no orbit found: the objective still improves after {MOST_BOXES} steps along the family; give bounds, or a "
        "guess nearer to the optimum"
    )


def _stopped(shooting: Shooting, w: np.ndarray) -> str:
    """Where the search along the family came to a halt, and what that may mean."""
    found = shooting.at(w)
    place = "".join(f", {name} {value:.6g}" for name, value in zip(shooting.problem.free, found.free, strict=True))
    return (
        f"no orbit found: the objective cannot be followed beyond the orbit of period {found.period:.6g} s{place}; "
        "it has a kink there, or the family ends or branches; give bounds that keep away from it, or start on its "
        "other side"
    )


def _peak(
    problem: Problem, near: tuple[Shooting, np.ndarray], settings: SolveSettings, report: Callback | None
) -> tuple[Shooting, np.ndarray]:
    """max_amplitude or min_peak_rate, solved again from the true peak until it is at t = 0."""
    flow, found = near[0].flow, near[0].at(near[1])
    times, states = _orbit(*near)
    n = problem.model.degrees_of_freedom
    place = n * (problem.objective == "min_peak_rate")  # in the state: of the coordinate that is asked, or its rate
    if problem.coordinate is not None:
        place += problem.model.state_index(problem.coordinate)
    else:
        place += int(np.abs(states[:, place : place + n]).max(axis=0).argmax())
    if problem.objective == "max_amplitude" and problem.turns[place]:
        raise InputError(
            f"coordinate: {problem.model.state_names[place]} turns over and over and has no amplitude; choose another"
        )
    heights = []
    for _ in range(ROUNDS):
        # with t = 0 of the guess at the peak of the component, and the objective about that
        top = int(np.abs(states[:-1, place]).argmax())
        resting = problem.boundary.reverses
        if resting:  # t = 0 stays at rest, at the end of the swing where the coordinate is larger
            top = 0 if abs(states[0, place]) >= abs(states[len(states) // 2, place]) else len(states) // 2
        moved = np.vstack([states[top:], states[1 : top + 1] + states[-1] - states[0]])
        # minus the size of a coordinate at t = 0, or the size of a rate
        sign = float(np.sign(moved[0, place])) * (-1 if place < n else 1)
        clock = np.concatenate([times[top:] - times[top], times[1 : top + 1] + times[-1] - times[top]])
        ready = replace(
            problem,
            guess=Guess(moved[0], float(times[-1]), clock, moved),
            coordinate=None,
            objective=partial(lambda sign, variables: sign * variables.start[place], sign),
            phase_condition=None if resting else lambda variables: variables.rate[place],
        )
        nodes = guessed_nodes(ready.guess, found.edges[:-1])
        shooting = transcribe(ready, nodes, flow)
        start = shooting.vector(replace(shooting.guess, free=found.free))
        w = followed(shooting, settings, report, start)
        found = shooting.at(w)
        times, states = _orbit(shooting, w)
        heights.append(float(np.abs(states[:, place]).max()))
        if heights[-1] <= (1 + PEAK_TOLERANCE) * abs(states[0, place]):
            return shooting, w
    name = problem.model.state_names[place]
    if problem.boundary.reverses:
        raise ConvergenceError(
            f"no orbit found: {name} is largest away from rest ({heights[-1]:.6g} against {abs(states[0, place]):.6g} "
            "there), and t = 0 of a brake orbit is at rest; use symmetry none"
        )
    raise ConvergenceError(
        f"no orbit found: several peaks of {name} compete ({heights[-2]:.6g} and {heights[-1]:.6g} in turn), so its "
        "largest value has no smooth optimum here; choose another coordinate"
    )


def _orbit(shooting: Shooting, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times and states over the whole period of a solved program."""
    problem, found = shooting.problem, shooting.at(w)
    model = with_parameters(problem.model, dict(zip(problem.free, found.free, strict=True)))
    flow = build_flow(model, (), shooting.flow.unfolded)
    whole = full_period(replace(problem, model=model), flow, found.nodes, found.period)
    return dense(flow, whole, found.period)


def instability(model: Model) -> Callable[[Variables], ca.MX]:
    """The objective: a quarter of the largest squared stability index, or the squared spectral radius.

    With a single pair of non-trivial multipliers the index is the trace of Phi(T) minus the trivial
    ones; with more it comes from the eigenvalues, whose derivative is y^H dPhi x / y^H x for left and right
    eigenvectors y and x (Golub, Van Loan, Matrix Computations, section 7.2.2). Raises `InputError` when
    there are no non-trivial multipliers.
    """
    trivial = trivial_count(model)
    others = len(model.state_names) - trivial
    if others < 1:
        raise InputError("objective: this system has no non-trivial Floquet multipliers; min_instability has no sense")
    if symplectic(model) and others == 2 and model.smooth:  # resets need not keep areas
        return lambda variables: (0.5 * (ca.trace(variables.monodromy) - trivial)) ** 2
    largest = _Largest(len(model.state_names), trivial, symplectic(model) and model.smooth)
    return lambda variables: largest(variables.monodromy)


def trivial_count(model: Model) -> int:
    """How many multipliers are 1 on every orbit: two for each invariant, or one for the flow."""
    if model.rates is not None and not model.hamiltonian:  # an invariant's multiplier has no partner
        return len(model.invariants) + int(not model.forced)
    return 2 * len(model.invariants) if model.invariants else int(not model.forced)


def rank(orbit: Orbit) -> tuple[float, float]:
    """What orbits are ordered by: the spectral radius in steps of 1e-6, then the largest |mu + 1/mu|."""
    multipliers = np.asarray(orbit.floquet_multipliers, complex)
    if not multipliers.size:
        return 1.0, 0.0
    radius = float(np.abs(multipliers).max())
    return float(np.round(radius / TIE) * TIE), float(np.abs(multipliers + 1 / multipliers).max())


def instability_of(monodromy: np.ndarray, trivial: int, conservative: bool) -> tuple[float, np.ndarray]:
    """The measure of a monodromy (m x m) and its derivative in each entry (m x m)."""
    values, left, right = eig(monodromy, left=True, right=True)
    kept = np.argsort(-np.abs(values - 1.0))[: values.size - trivial]
    sizes = [_size(complex(values[k]), conservative) for k in kept]
    k = int(kept[int(np.argmax(sizes))])
    mu = complex(values[k])
    slope = np.outer(left[:, k].conj(), right[:, k]) / (left[:, k].conj() @ right[:, k])
    radius = abs(mu)
    growth = (mu.conjugate() * slope).real / radius
    if not conservative:
        return radius**2, 2 * radius * growth
    index = mu + 1 / mu
    if _real(index):
        return 0.25 * index.real**2, 0.5 * index.real * ((1 - 1 / mu**2) * slope).real
    return max(sizes), 0.5 * (radius + 1 / radius) * (1 - 1 / radius**2) * growth


def _real(index: complex) -> bool:
    return abs(index.imag) <= REAL * max(1.0, abs(index))


def _size(mu: complex, conservative: bool) -> float:
    """The measure of one multiplier: a quarter of (mu + 1/mu)^2 where that is real, of (r + 1/r)^2 elsewhere."""
    radius = abs(mu)
    if not conservative:
        return radius**2
    index = mu + 1 / mu
    return float(0.25 * index.real**2 if _real(index) else 0.25 * (radius + 1 / radius) ** 2)


class _Largest(ca.Callback):  # type: ignore[misc]
    """`instability_of` as a CasADi function that brings its Jacobian."""

    def __init__(self, size: int, trivial: int, conservative: bool) -> None:
        ca.Callback.__init__(self)
        self.size, self.trivial, self.kept = size, trivial, conservative
        self.slope: ca.Callback | None = None
        self.construct("largest", {"enable_fd": False})

    def get_sparsity_in(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.size, self.size)

    def eval(self, arguments: Sequence[ca.DM]) -> list[float]:
        return [instability_of(arguments[0].full(), self.trivial, self.kept)[0]]

    def has_jacobian(self) -> bool:
        return True

    def get_jacobian(self, name: str, inputs: list[str], outputs: list[str], options: dict[str, object]) -> ca.Function:
        self.slope = _Slope(name, self, inputs, outputs, options)
        return self.slope


class _Slope(ca.Callback):  # type: ignore[misc]
    """The Jacobian of `_Largest`, a row of m^2."""

    def __init__(
        self, name: str, of: _Largest, inputs: list[str], outputs: list[str], options: dict[str, object]
    ) -> None:
        ca.Callback.__init__(self)
        self.of, self.names = of, (inputs, outputs)
        self.construct(name, options)

    def get_n_in(self) -> int:
        return 2

    def get_name_in(self, i: int) -> str:
        return self.names[0][i]

    def get_name_out(self, i: int) -> str:
        return self.names[1][i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self.of.size, self.of.size) if i == 0 else ca.Sparsity.dense(1, 1)

    def get_sparsity_out(self, _: int) -> ca.Sparsity:
        return ca.Sparsity.dense(1, self.of.size**2)

    def eval(self, arguments: Sequence[ca.DM]) -> list[ca.DM]:
        slope = instability_of(arguments[0].full(), self.of.trivial, self.of.kept)[1]
        return [ca.DM(slope.ravel("F")).T]
