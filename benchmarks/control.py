"""Controlled motions beside rockit: same field, intervals, tolerance and run; results/benchmarks/control.md.

`pip install rockit-meco`, then `python benchmarks/control.py`. rockit's Runge-Kutta steps of order 4 are as many as
bring its cost to 1e-8 of ours; it states and solves, here the solution is certified too. Seconds are those of the
processor, the best of two.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import machine
import numpy as np

import orbitfinder as of
from orbitfinder.mechanics.model import vector_field

ROOT, TURNS, AGREED = Path(__file__).parents[1], 2, 1e-8
PENDULUM = of.chain(1, motors=[1], limits={"torque1": 1.3})


def problems() -> dict[str, of.Problem]:
    """Periodic motions from a given state in a given time, controls held over 40 intervals."""
    held = of.Control("torque1**2", "zero-order", 40)
    double = replace(held, cost="torque2**2")
    cart = of.systems.driven_cart_pole()
    return {
        "pendulum, faster than it swings": of.Problem(
            of.chain(1, motors=[1]), of.Guess([1.0, 0.0], 1.5), of.pin(theta1=1.0, theta1dot=0.0, period=1.5),
            control=held),
        "the same, its motor at its limit": of.Problem(
            PENDULUM, of.Guess([1.0, 0.0], 1.5), of.pin(theta1=1.0, theta1dot=0.0, period=1.5), control=held),
        "double pendulum, swung at the elbow": of.Problem(
            of.chain(2, motors=[2]), of.Guess([0.6, 0.6, 0.0, 0.0], 2.0),
            of.pin(theta1=0.6, theta1dot=0.0, period=2.0), control=double),
        "cart and hanging load, passed at 1 m/s": of.Problem(
            cart, of.Guess([0.0, 0.1, 1.0, 0.0], 2.0), of.pin(y=0.0, ydot=1.0, theta=0.1, period=2.0),
            control=replace(held, cost="force**2")),
    }  # fmt: skip


def rockit_cost(problem: of.Problem, steps: int) -> float:
    """The same by rockit's multiple shooting."""
    import rockit

    model = problem.model
    size, count = len(model.state_names), len(model.controls)
    pins = {one.name: one.value for one in problem.pin}
    ocp = rockit.Ocp(T=pins["period"])
    x, u = ocp.state(size), ocp.control(count)
    ocp.set_der(x, vector_field(model, model.controls)(0.0, x, ca.DM(0, 1), u))
    ocp.add_objective(ocp.integral(ca.sumsqr(u)))
    ocp.subject_to(ocp.at_t0(x) == ocp.at_tf(x))
    for name, value in pins.items():
        if name in model.state_names:
            ocp.subject_to(ocp.at_t0(x[model.state_names.index(name)]) == value)
    for k, name in enumerate(model.controls):
        if name in model.limits:
            ocp.subject_to(model.limits[name][0] <= (u[k] <= model.limits[name][1]))
    ocp.set_initial(x, np.asarray(problem.guess.state))
    ocp.solver("ipopt", {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-10}})
    ocp.method(rockit.MultipleShooting(N=problem.control.intervals, M=steps, intg="rk"))  # type: ignore[union-attr]
    return float(ocp.solve().value(ocp.objective))


def timed(run: Callable[[], object]) -> tuple[float, object]:
    """Processor seconds, the best of some turns, and what was found."""
    best, found = np.inf, None
    for _ in range(TURNS):
        began = time.process_time()
        found = run()
        best = min(best, time.process_time() - began)
    return best, found


def main() -> None:
    """Measure and write the page."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    if find_spec("rockit") is None:
        raise SystemExit("rockit is not installed; pip install rockit-meco")
    rows = []
    for name, problem in problems().items():
        seconds, orbit = timed(lambda p=problem: of.find_orbit(p, of.SolveSettings(with_certificate=False)))
        whole, checked = timed(lambda p=problem: of.find_orbit(p))
        cost = float(orbit.control["cost"])  # type: ignore[attr-defined]
        steps = 1
        while abs(rockit_cost(problem, steps) - cost) > AGREED * cost and steps < 64:
            steps *= 2
        theirs, other = timed(lambda p=problem, m=steps: rockit_cost(p, m))
        verdict = "yes" if checked.certificate.passed else "NO"  # type: ignore[attr-defined]
        rows.append(f"| {name} | {cost:.10g} | {float(other):.10g} | {seconds:.2f} | {whole:.2f} | {theirs:.2f} "  # type: ignore[arg-type]
                    f"| {steps} | {verdict} |")  # fmt: skip
        print(rows[-1], flush=True)
    page = ROOT / "results" / "benchmarks" / "control.md"
    where = f"{machine.processor()}; {machine.versions('rockit-meco')}; {machine.load()}."
    head = "| problem | cost | rockit's cost | s | s, certified | rockit, s | its steps an interval | certified |"
    said = ["# Controlled motions beside rockit", "", where, "", (__doc__ or "").strip(), "", head, "|---" * 8 + "|"]
    text = "\n".join([*said, *rows, ""])
    page.write_text(text)


if __name__ == "__main__":
    main()
