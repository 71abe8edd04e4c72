"""From a Problem to a certified Orbit: shoot with IPOPT, polish, reduce the period, measure, certify."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np
from scipy.interpolate import CubicHermiteSpline

from orbitfinder.errors import IntegrationError
from orbitfinder.flow import Flow, IntegratorSettings, build_flow, end_state, transition
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.periodic.certify import certify, gap
from orbitfinder.periodic.conditions import Pin, unfolded_invariants
from orbitfinder.periodic.dae_segments import build_dae_flow
from orbitfinder.periodic.failure import explain, refuse_equilibrium
from orbitfinder.periodic.measure import dense, measure
from orbitfinder.periodic.orbit import Orbit
from orbitfinder.periodic.polish import polish
from orbitfinder.periodic.preparation import at_forcing_period, check_invariants, winding_of
from orbitfinder.periodic.problem import Guess, Problem
from orbitfinder.periodic.shooting import Shooting, transcribe
from orbitfinder.quiet import captured


@dataclass(frozen=True)
class SolveSettings:
    """How to solve; the mathematics is in the Problem."""

    integrator: IntegratorSettings = field(default_factory=IntegratorSettings)
    ipopt_tolerance: float = 1e-9
    """IPOPT's own tolerance; the digits beyond it come from the polish"""
    max_iterations: int = 100
    fewest_segments: int = 8
    """per period, where the problem does not say: fewer make the basin of convergence smaller"""
    growth_per_segment: float = 20.0
    """segments are added until no state-transition matrix is larger than this"""
    most_segments: int = 40
    with_certificate: bool = True


@dataclass(frozen=True)
class Progress:
    """What a progress callback gets: the stage's name, iteration, largest defect, period, seconds so far."""

    stage: str
    iteration: int
    defect: float
    period: float
    elapsed: float


Callback = Callable[[Progress], None]


def find_orbit(problem: Problem, settings: SolveSettings | None = None, progress: Callback | None = None) -> Orbit:
    """The periodic orbit that a Problem singles out, with its certificate.

    Multiple shooting solved by IPOPT with an explicit Hessian (so that a square problem is solved
    by Newton's method), two or more Newton steps on the residual of a high-order integrator, the
    minimal period. Raises `CountError` before solving an over- or under-determined problem,
    `ConvergenceError` with a sentence to act on, `IntegrationError` when a segment cannot be
    integrated from the guess. The result may still fail its certificate: look at
    `orbit.certificate.passed`.
    """
    settings = settings or SolveSettings()
    began = time.perf_counter()
    problem.check_count()
    check_invariants(problem)
    problem = at_forcing_period(problem)
    unfolded = unfolded_invariants(problem.model, problem.boundary)
    build = build_flow if problem.model.native is None else build_dae_flow
    flow = build(problem.model, problem.free, unfolded, settings.integrator)
    nodes = initial_nodes(problem, flow, settings)
    if problem.winding is None:
        problem = replace(problem, winding=winding_of(problem, flow, nodes))
    shooting = transcribe(problem, nodes, flow)
    w = solve_nlp(shooting, settings, _reporter(progress, began))
    refined, w = _minimal(*_polished(shooting, w), settings)
    orbit = measure(refined.problem, refined.flow, refined.layout.nodes(w), *refined.layout.tail(w)[:2])
    orbit = replace(orbit, provenance=provenance(problem, settings, began))
    if settings.with_certificate:
        certificate = certify(orbit, refined.problem.model)
        independent = [check.value for check in certificate.checks if check.name == "closure"]
        orbit = replace(orbit, certificate=certificate, closure=(independent or [orbit.closure])[0])
    if progress:
        progress(Progress("certificate", 0, orbit.closure, orbit.period, time.perf_counter() - began))
    return orbit


def initial_nodes(problem: Problem, flow: Flow, settings: SolveSettings) -> np.ndarray:
    """Node states (N x 2n) of the guess: sampled from its trajectory, else simulated from its state."""
    guess, horizon = problem.guess, problem.boundary.fraction * problem.guess.period
    count = problem.segments or _segments_needed(problem, flow, horizon, settings)
    moments = np.arange(count) * horizon / count
    if guess.times is not None and guess.states is not None:
        return np.stack([np.interp(moments, guess.times, column) for column in guess.states.T], axis=1)
    nodes = [np.asarray(guess.state, float)]
    for k in range(1, count):
        try:
            nodes.append(end_state(flow, nodes[-1], horizon / count, moments[k - 1]))
        except IntegrationError as error:
            raise IntegrationError(error.reason, segment=k - 1, time=error.time, state=nodes[-1]) from None
    return np.asarray(nodes)


def _segments_needed(problem: Problem, flow: Flow, horizon: float, settings: SolveSettings) -> int:
    """As many segments as keep each state-transition matrix below `growth_per_segment`."""
    state = np.asarray(problem.guess.state, float)
    clock = np.concatenate([np.ones(state.size // 2), np.full(state.size // 2, problem.guess.period / (2 * np.pi))])
    matrix = transition(flow, state, horizon)[1]
    growth = float(np.linalg.norm(matrix * clock[:, None] / clock[None, :], 2))
    needed = int(np.ceil(np.log(max(growth, 2.0)) / np.log(settings.growth_per_segment)))
    fewest = int(np.ceil(settings.fewest_segments * problem.boundary.fraction))
    return min(max(needed, fewest), settings.most_segments)


def _reporter(progress: Callback | None, began: float) -> Callback | None:
    if progress is None:
        return None
    return lambda event: progress(replace(event, elapsed=time.perf_counter() - began))


class _IterationCallback(ca.Callback):  # type: ignore[misc]
    """CasADi's iteration hook turned into `Progress` events."""

    def __init__(self, shooting: Shooting, report: Callback) -> None:
        ca.Callback.__init__(self)
        self.shooting, self.report, self.iteration = shooting, report, 0
        self.construct("progress", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:
        return "stop"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        sizes = {"x": self.shooting.layout.total, "lam_x": self.shooting.layout.total, "f": 1}
        rows = {"g": self.shooting.constraints.numel(), "lam_g": self.shooting.constraints.numel()}
        return ca.Sparsity.dense(sizes.get(ca.nlpsol_out(i), rows.get(ca.nlpsol_out(i), 0)), 1)

    def eval(self, arguments: Sequence[ca.DM]) -> list[int]:
        period = self.shooting.layout.tail(arguments[0].full().ravel())[0]
        defect = float(ca.norm_inf(arguments[ca.nlpsol_out().index("g")]))
        self.report(Progress("shooting", self.iteration, defect, period, 0.0))
        self.iteration += 1
        return [0]


def solve_nlp(shooting: Shooting, settings: SolveSettings, report: Callback | None = None) -> np.ndarray:
    """The decision vector w that IPOPT finds; `ConvergenceError` or `IntegrationError` otherwise."""
    options: dict[str, Any] = {
        "hess_lag": hessian(shooting),
        "print_time": False,
        "error_on_fail": False,
        "ipopt": {
            "print_level": 0, "sb": "yes", "tol": settings.ipopt_tolerance, "mu_init": 1e-8,
            "max_iter": settings.max_iterations, "acceptable_iter": 0, "bound_relax_factor": 0.0,
        },
    }  # fmt: skip
    if report is not None:
        callback = _IterationCallback(shooting, report)
        options["iteration_callback"] = callback
    square = shooting.problem.count(shooting.layout.segments).freedom == 0
    objective = ca.MX(0) if square else shooting.objective
    program = {"x": shooting.variables, "f": objective, "g": shooting.constraints}
    with captured() as output:
        solver = ca.nlpsol("shooting", "ipopt", program, options)
        result = solver(x0=shooting.start, lbx=shooting.lower, ubx=shooting.upper, lbg=0, ubg=0)
        stats = solver.stats()
    w = result["x"].full().ravel()
    if not stats["success"]:
        raise explain(shooting, w, stats["return_status"], output.text)
    refuse_equilibrium(shooting, w)
    return np.asarray(w)


def hessian(shooting: Shooting) -> ca.Function:
    """Upper triangle of the Hessian handed to IPOPT: lam_f times that of the objective, constraints left out.

    Square problems have objective 0 and take a small multiple of the identity: the step is Newton's
    whatever it is. Least-squares objectives take their Gauss-Newton Hessian, diag(weights).
    """
    w, parameters = ca.MX.sym("w", shooting.layout.total), ca.MX.sym("p", 0)
    factor, rows = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", shooting.constraints.numel())
    square = shooting.problem.count(shooting.layout.segments).freedom == 0
    diagonal = ca.DM.ones(w.numel()) * 1e-8 if square else factor * ca.DM(shooting.weights + 1e-8)
    return ca.Function("hess_lag", [w, parameters, factor, rows], [ca.triu(ca.diag(ca.MX(diagonal)))])


def _polished(shooting: Shooting, w: np.ndarray) -> tuple[Shooting, np.ndarray]:
    """Newton on the high-order residual; freed parameters are then written into the model.

    A problem with an objective is first made square by holding its place in the family.
    """
    problem, layout = shooting.problem, shooting.layout
    square = problem.count(layout.segments).freedom == 0
    if square:
        w = polish(shooting, w)
    if square and not problem.free:
        return shooting, w
    period, unfolding, free = layout.tail(w)
    nodes = layout.nodes(w)
    model = with_parameters(problem.model, dict(zip(problem.free, free, strict=True)))
    settled = replace(problem, model=model, free=(), guess=Guess(nodes[0], period), segments=len(nodes), pin=())
    if model.invariants:
        settled = replace(settled, pin=problem.pin[:1] or natural_pin(settled, nodes[0]))
    held = transcribe(settled, nodes, None if problem.free else shooting.flow)
    return held, polish(held, held.layout.join(nodes, period, np.zeros(0), unfolding))


def natural_pin(problem: Problem, state: np.ndarray) -> tuple[Pin, ...]:
    """The pin that holds an orbit where it is in its family: its energy; nothing where none is conserved."""
    n = problem.model.degrees_of_freedom
    values = problem.model.parameter_values
    first = problem.model.invariants[:1]
    return tuple(Pin(one.name, float(one.value(state[:n], state[n:], values))) for one in first)


def _minimal(shooting: Shooting, w: np.ndarray, settings: SolveSettings) -> tuple[Shooting, np.ndarray]:
    """The same orbit over its minimal period, when the solver went round it several times."""
    problem, layout = shooting.problem, shooting.layout
    if problem.symmetry != "none":
        return shooting, w
    cover = cover_of(shooting, w)
    if cover == 1:
        return shooting, w
    period = layout.tail(w)[0] / cover
    count = max(1, layout.segments // cover)
    state = layout.nodes(w)[0]
    turns = tuple(int(k) for k in problem.turns // cover)
    pins = natural_pin(problem, state)
    shorter = replace(problem, guess=Guess(state, period), pin=pins, segments=count, winding=turns)
    shot = transcribe(shorter, initial_nodes(shorter, shooting.flow, settings), shooting.flow)
    return shot, polish(shot, shot.start)


def cover_of(shooting: Shooting, w: np.ndarray, most: int = 30, tolerance: float = 1e-5) -> int:
    """The largest k <= `most` for which x(T/k) = x(0), the winding divided by k."""
    layout, problem = shooting.layout, shooting.problem
    period, nodes = layout.tail(w)[0], layout.nodes(w)
    times, states = dense(shooting.flow, nodes, period)
    n = problem.model.degrees_of_freedom
    spline = CubicHermiteSpline(times, states[:, :n], states[:, n:])
    extent = float(np.ptp(states, axis=0).max())
    for cover in range(most, 1, -1):
        if np.any(problem.turns % cover) or problem.forcing_cycles % cover:
            continue
        reached = np.concatenate([spline(period / cover), spline(period / cover, 1)])
        if gap(states[0], reached, problem.turns // cover) < tolerance * max(extent, float(np.abs(nodes).max())):
            return cover
    return 1


def provenance(problem: Problem, settings: SolveSettings, began: float) -> dict[str, Any]:
    """Versions, tolerances, wall time and guess: enough to repeat the search."""
    import platform

    import scipy

    from orbitfinder.version import __version__

    return {
        "orbitfinder": __version__,
        "casadi": ca.__version__,
        "numpy": np.__version__,
        "scipy": scipy.__version__,
        "python": platform.python_version(),
        "relative_tolerance": settings.integrator.relative_tolerance,
        "absolute_tolerance": settings.integrator.absolute_tolerance,
        "ipopt_tolerance": settings.ipopt_tolerance,
        "guess": {"state": [float(x) for x in problem.guess.state], "period": float(problem.guess.period)},
        "pin": {one.name: one.value for one in problem.pin},
        "invariants": [one.name for one in problem.model.invariants],
        "wall_time": round(time.perf_counter() - began, 3),
    }
