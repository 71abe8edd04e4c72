"""The closing rows of a square Problem, for any guess: boundary, phase, forcing, pins, with their derivatives."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from orbitfinder.errors import CountError, InputError
from orbitfinder.loops.conditions import Pin, boundary_rows, quantity
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.shooting import phase_directions


def closing(problem: Problem) -> tuple[ca.Function, ca.Function]:
    """Boundary, phase, forcing and pin rows as a function of (first, last, (T, free), shift, directions, reference,
    pins), and their derivatives by the first three."""
    model, n = problem.model, problem.model.degrees_of_freedom
    first, last = ca.MX.sym("first", 2 * n), ca.MX.sym("last", 2 * n)
    tail = ca.MX.sym("tail", 1 + len(problem.free))
    shift = ca.MX.sym("shift", 2 * n if problem.symmetry == "reversal" else n)
    count = len(phase_directions(problem, np.asarray(problem.guess.state, float)))
    directions, reference = ca.MX.sym("directions", 2 * n, count), ca.MX.sym("reference", 2 * n)
    pins, parameters = ca.MX.sym("pins", len(problem.pin)), model.parameters(problem.free, tail[1:])
    rows = [boundary_rows(problem.boundary, first, last, shift), directions.T @ (first - reference)]  # type: ignore[arg-type]
    if model.forcing_period is not None:
        rows.append(tail[0] - problem.forcing_cycles * model.forcing_period(parameters))
    rows += [quantity(model, one.name, first, tail[0], parameters) - pins[k] for k, one in enumerate(problem.pin)]
    whole = ca.vertcat(*rows)
    inputs = [first, last, tail, shift, directions, reference, pins]
    slopes = [ca.densify(ca.jacobian(whole, one)) for one in (first, last, tail)]
    both = ca.Function("closing", inputs, [whole]), ca.Function("slopes", inputs, slopes)
    try:
        return both[0].expand(), both[1].expand()
    except RuntimeError:  # a model of matrix expressions
        return both


def pin_values(problem: Problem, pin: Sequence[Pin] | None) -> np.ndarray:
    """Values of the pins in the problem's order."""
    known = {one.name: one.value for one in problem.pin}
    given = {one.name: one.value for one in (problem.pin if pin is None else pin)}
    if known.keys() != given.keys():
        raise InputError(
            f"pin: this refiner was built for pins of {', '.join(known) or 'nothing'}, got "
            f"{', '.join(given) or 'nothing'}; build another one"
        )
    return np.array([given[name] for name in known], float)


def check_square(problem: Problem) -> None:
    """Only square systems of pins can be refined by Newton's method alone."""
    problem.check_count()
    others = {"constraints": problem.constraints, "phase_condition": problem.phase_condition, "bounds": problem.bounds}
    for name, value in others.items():
        if value:
            raise InputError(f"{name}: warm refinement knows pins only; use find_orbit")
    if problem.model.constraint is not None and problem.symmetry != "none":
        raise InputError("symmetry: brake orbits under constraints are not refined warm; use find_orbit")
    count = problem.count()
    if count.freedom:
        raise CountError(f"pin: {count} leave {count.freedom} to choose; warm refinement needs as many pins")
