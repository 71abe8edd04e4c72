"""Known defects of CasADi, each tried on the installed version by a few lines.

They do not make orbitfinder wrong: each entry says what it does instead. They matter to anyone who
builds on the same CasADi.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np

TIGHT = {"abstol": 1e-12, "reltol": 1e-12}


def parameter_jacobian() -> tuple[bool, str]:
    """d x(1)/dp of x' = p1 (1 - t) + p2 t + p3 t is (1/2, 1/2, 1/2), here through CasADi's own derivative."""
    t, x, p = ca.SX.sym("t"), ca.SX.sym("x"), ca.SX.sym("p", 3)
    rate = p[0] * (1 - t) + p[1] * t + p[2] * t
    flow = ca.integrator("flow", "cvodes", {"t": t, "x": x, "p": p, "ode": rate}, 0, 1, TIGHT)
    chosen = ca.MX.sym("p", 3)
    slope = ca.Function("slope", [chosen], [ca.jacobian(flow(x0=0, p=chosen)["xf"], chosen)])
    slopes = slope([1, 2, 3]).full().ravel()
    worst = float(slopes[np.argmax(np.abs(slopes - 0.5))])
    return abs(worst - 0.5) > 1e-6, f"0.5 expected, {worst:.6g} found"


def algebraic_adjoint() -> tuple[bool, str]:
    """d z(1)/dp for x' = -z, z = p1 x + p2 + p3 + p4: reverse mode against central differences of the same IDAS."""
    x, z, p = ca.SX.sym("x"), ca.SX.sym("z"), ca.SX.sym("p", 4)
    dae = {"x": x, "z": z, "p": p, "ode": -z, "alg": z - p[0] * x - p[1] - p[2] - p[3]}
    flow = ca.integrator("flow", "idas", dae, 0, 1, TIGHT)
    chosen = ca.MX.sym("p", 4)
    end = flow(x0=1, z0=1, p=chosen)["zf"]
    at, step = np.array([1.0, 0.1, 0.2, 0.3]), 1e-4
    value = ca.Function("value", [chosen], [end])
    slope = ca.Function("slope", [chosen], [ca.jacobian(end, chosen)])(at).full().ravel()
    shifts = step * np.eye(4)
    differences = np.array([float(value(at + shift) - value(at - shift)) / (2 * step) for shift in shifts])
    gap = np.abs(slope - differences)
    wanted, seen = differences[gap.argmax()], slope[gap.argmax()]
    return bool(gap.max() > 1e-5), f"{wanted:.6g} expected, {seen:.6g} found"


def overdetermined_problem() -> tuple[bool, str]:
    """IPOPT on x = 1 and x^2 = 4 from x = 7: no solution exists, so constraints reported as 0 are not evaluated."""
    x = ca.MX.sym("x")
    nlp = {"x": x, "f": 0, "g": ca.vertcat(x - 1, x**2 - 4)}
    solver = ca.nlpsol("solver", "ipopt", nlp, {"ipopt.print_level": 0, "print_time": False})
    answer = solver(x0=7, lbg=0, ubg=0)
    rest = float(np.abs(answer["g"].full()).max())
    return rest < 1e-8, f"x = {float(answer['x']):.6g} returned with residual {rest:.2g}, true residual 45"


TRIALS: tuple[tuple[str, str, Callable[[], tuple[bool, str]], str], ...] = (
    (
        "integrator Jacobian", "casadi issue 4383", parameter_jacobian,
        "the variational equations are integrated with the state",
    ),
    (
        "algebraic derivative", "design notes; 3.6.7 loses the seed, 3.8.2 the digits", algebraic_adjoint,
        "algebraic variables are eliminated before differentiating",
    ),
    (
        "over-determined NLP", "seen with 3.6.7 and 3.8.2", overdetermined_problem,
        "equations are counted before IPOPT is called",
    ),
)  # fmt: skip
"""(name, reference, trial: whether it is there and what was seen, what orbitfinder does instead)"""
