"""The nonlinear program of a Shooting, solved by IPOPT."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.quiet import captured
from orbitfinder.integrate.cvodes import IntegratorSettings
from orbitfinder.loops.failure import explain, refuse_equilibrium
from orbitfinder.loops.shooting import Shooting
from orbitfinder.records.reading import Entries

STALLED = {
    "acceptable_tol": 1e-6, "acceptable_iter": 10, "acceptable_constr_viol_tol": 1e-9, "acceptable_compl_inf_tol": 1e-7,
}  # fmt: skip
"""An objective whose derivatives are right to 1e-10 cannot always be followed to 1e-9: ten steps in a row within these
are the end of it. The orbit itself is held to its own tolerance, and polished."""

PATIENCE, FALL = 20, 0.9
"""A search ends where so many iterations have not brought the largest defect below so much of what it was: of 60
certified problem files the slowest needs 13"""
UNSOLVED = 1e-3
"""The same, of the largest defect met, where an objective is followed"""


@dataclass(frozen=True)
class SolveSettings:
    """How `of.find_orbit` solves; the mathematics is in the Problem.

    Args:
        integrator: CVODES' tolerances.
        ipopt_tolerance: IPOPT's own; the digits beyond it come from the polish.
        max_iterations: of IPOPT.
        objective_iterations: the same in each box where an objective or inequalities are followed with an approximate
            Hessian.
        fewest_segments: per period, where the problem does not say; fewer make the basin of convergence smaller.
        growth_per_segment: segments are added until no state-transition matrix is larger than this.
        most_segments: at most so many.
        with_certificate: whether the orbit is certified.
        limit: s after which the search is given up with a `LimitError`; None for none.
        method: shooting | collocation | balance, or another of the table; None: the problem's, or the one that suits.

    Raises:
        InputError: for a number that is out of range.

    Examples:
        >>> quick = of.SolveSettings(with_certificate=False, limit=60.0)
        >>> of.find_orbit(problem, quick).certificate is None
        True
    """

    integrator: IntegratorSettings = field(default_factory=IntegratorSettings)
    ipopt_tolerance: float = 1e-9
    max_iterations: int = 100
    objective_iterations: int = 60
    fewest_segments: int = 8
    growth_per_segment: float = 20.0
    most_segments: int = 40
    with_certificate: bool = True
    limit: float | None = None
    method: str | None = None

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class Progress:
    """What a progress callback gets: the stage's name, iteration, largest defect, period, seconds so far."""

    stage: str
    iteration: int
    defect: float
    period: float
    elapsed: float


Callback = Callable[[Progress], None]


class _Iterations(ca.Callback):  # type: ignore[misc]
    """CasADi's iteration hook: it reports `Progress`, and ends a search that is late or gets nowhere.

    `stuck` then says since when, empty otherwise.
    """

    def __init__(self, shooting: Shooting, report: Callback | None) -> None:
        ca.Callback.__init__(self)
        self.shooting, self.report, self.defects, self.stuck = shooting, report, list[float](), ""
        self.construct("progress", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:  # noqa: ARG002  CasADi's signature
        return "stop"

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        sizes = {"x": self.shooting.start.size, "lam_x": self.shooting.start.size, "f": 1}
        count = self.shooting.constraints.numel() + self.shooting.inequalities.numel()
        rows = {"g": count, "lam_g": count}
        return ca.Sparsity.dense(sizes.get(ca.nlpsol_out(i), rows.get(ca.nlpsol_out(i), 0)), 1)

    def eval(self, arguments: Sequence[ca.DM]) -> list[int]:
        equations = self.shooting.constraints.numel()
        self.defects.append(float(ca.norm_inf(arguments[ca.nlpsol_out().index("g")][:equations])))
        if self.report:
            period = self.shooting.at(arguments[0].full().ravel()).period
            self.report(Progress("shooting", len(self.defects) - 1, self.defects[-1], period, 0.0))
        # hopeless when the best of the last iterations is hardly better than the best before them
        best = min(self.defects)
        limit.note(f"shooting, iteration {len(self.defects) - 1}, largest defect {best:.3g}")
        unsolved = self.shooting.square or best > UNSOLVED * max(self.defects)  # an objective moves along solutions
        if unsolved and len(self.defects) > PATIENCE and best > FALL * min(self.defects[:-PATIENCE]):
            self.stuck = f"the largest defect, {best:.3g} at best, did not fall in {PATIENCE} iterations"
        return [int(bool(self.stuck) or limit.left() < 0)]


def solve_nlp(
    shooting: Shooting, settings: SolveSettings, report: Callback | None = None, start: np.ndarray | None = None
) -> np.ndarray:
    """The decision vector w that IPOPT finds from `start`; `ConvergenceError` or `IntegrationError` otherwise."""
    watch = _Iterations(shooting, report)
    objective = ca.MX(0) if shooting.square else shooting.objective
    rows = ca.vertcat(shooting.constraints, shooting.inequalities)
    program = {"x": shooting.variables, "f": objective, "g": rows}
    zeros = np.zeros(shooting.constraints.numel())
    limits = {"lbg": np.concatenate([zeros, shooting.low]), "ubg": np.concatenate([zeros, shooting.high])}
    ipopt, options = _options(shooting, settings)
    w, stats, text = minimised(
        minimiser("shooting", program, ipopt, options | {"iteration_callback": watch}),
        x0=shooting.start if start is None else start, lbx=shooting.lower, ubx=shooting.upper, **limits,
    )  # fmt: skip
    if not stats["success"]:
        raise explain(shooting, w, watch.stuck or stats["return_status"], text)
    refuse_equilibrium(shooting, w)
    return w


def minimiser(name: str, program: dict[str, ca.MX], ipopt: Entries, options: Entries) -> ca.Function:
    """IPOPT with its options and CasADi's, for any numbers that the program is given."""
    own = {"print_level": 0, "sb": "yes", "acceptable_iter": 0, "bound_relax_factor": 0.0} | ipopt
    whole = {"print_time": False, "error_on_fail": False, "ipopt": own} | options
    with captured(), limit.alarm():
        return ca.nlpsol(name, "ipopt", program, whole)


def minimised(solver: ca.Function, **given: np.ndarray) -> tuple[np.ndarray, Entries, str]:
    """What IPOPT ends at, its statistics, and what it printed."""
    with captured() as output, limit.alarm():
        answer, stats = solver(**given), solver.stats()
    return answer["x"].full().ravel(), stats, output.text


def _options(shooting: Shooting, settings: SolveSettings) -> tuple[Entries, Entries]:
    """IPOPT's options; the Hessian is explicit where its structure is known and L-BFGS elsewhere, never exact."""
    ipopt = {"tol": settings.ipopt_tolerance, "mu_init": 1e-8, "max_iter": settings.max_iterations}
    if not shooting.square and (shooting.inequalities.numel() or shooting.problem.objective != "nearest"):
        ipopt |= {"mu_init": 1e-2, "max_iter": settings.objective_iterations, **STALLED}
    if shooting.square or shooting.problem.objective == "nearest" or shooting.residuals.numel():
        return ipopt, {"hess_lag": hessian(shooting)}
    return ipopt | {"hessian_approximation": "limited-memory", "limited_memory_max_history": 30}, {}


def hessian(shooting: Shooting) -> ca.Function:
    """Upper triangle of the Hessian handed to IPOPT: lam_f times that of the objective, constraints left out.

    Square problems have objective 0 and take a small multiple of the identity: the step is Newton's
    whatever it is. Least-squares objectives take their Gauss-Newton Hessian, diag(weights) for the
    distance to the guess and (dr/dw)^T dr/dw for residuals r.
    """
    w, parameters = shooting.variables, ca.MX.sym("p", 0)
    count = shooting.constraints.numel() + shooting.inequalities.numel()
    factor, rows = ca.MX.sym("lam_f"), ca.MX.sym("lam_g", count)
    size = shooting.start.size
    if shooting.square:
        matrix = ca.MX(ca.diag(ca.DM.ones(size) * 1e-8))
    elif shooting.residuals.numel():
        slope = ca.densify(ca.jacobian(shooting.residuals, w))
        matrix = factor * (slope.T @ slope + 1e-8 * ca.DM.eye(size))
    else:
        matrix = ca.diag(factor * ca.DM(shooting.weights + 1e-8))
    given = ca.MX.sym("w", size)
    inner = ca.Function("matrix", [w, factor], [matrix])
    return ca.Function("hess_lag", [given, parameters, factor, rows], [ca.triu(inner(given, factor))])
