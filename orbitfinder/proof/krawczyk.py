"""The interval Newton theorem of Krawczyk on the multiple-shooting equations.

K(X) = m - C F(m) + (1 - C DF(X)) (X - m). If K(X) lies in the interior of X, F has exactly one
zero in X, and it lies in K(X). Source: R. Krawczyk, Computing 4 (1969) 187-201; A. Neumaier,
Interval Methods for Systems of TheoremEquations (1990), section 5.1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError
from orbitfinder.proof.balls import Vector, arb, arb_mat, block, column, exact, floats, inside, magnitude, midpoints
from orbitfinder.proof.enclosure import TaylorSettings, Tube, cloud, horner, integrate
from orbitfinder.proof.field import Field
from orbitfinder.proof.formulation import Formulation

Arc = tuple[Vector, Any, Vector, list[Tube]]
"""a segment: its end from the box's centre, derivatives over the box (d x d+2), its end from the box, steps"""


@dataclass(frozen=True)
class TheoremEquations:
    """F(u) = 0 with everything it needs besides the unknowns.

    `sections` are (anchor (d), normal (d)) of hyperplanes, of an orbit that which fixes the phase; `energy` (J) a ball,
    None where nothing is conserved.
    """

    field: Field
    formulation: Formulation
    energy: Any
    sections: Sequence[tuple[Sequence[float], Sequence[float]]] = ()


@dataclass(frozen=True)
class Krawczyk:
    """The operator on one box: K(X), X itself, a bound of the norm of 1 - C DF(X), and whether K(X) is inside X.

    `arcs` are the segments over X.
    """

    image: Vector
    box: Vector
    contraction: float
    proved: bool
    arcs: list[Arc]


def arcs_over(equations: TheoremEquations, box: Vector, centre: Vector, settings: TaylorSettings) -> list[Arc]:
    """Every segment integrated from the nodes of a box of unknowns, about its centre."""
    arcs = []
    for node, point in zip(equations.formulation.nodes(box), equations.formulation.nodes(centre), strict=True):
        end, steps = integrate(equations.field, cloud(node, point), settings)
        arcs.append((end.point[: equations.field.dimension], end.derivatives, end.hull, steps))
    return arcs


def residual(equations: TheoremEquations, unknowns: Vector, ends: Sequence[Vector]) -> Vector:
    """F at a point (or over a box, without its correlations) from the segments' ends (d each)."""
    form = equations.formulation
    nodes = form.nodes(unknowns)
    rows = []
    for end, following in zip(ends[:-1], nodes[1:], strict=True):
        rows += [a - b for a, b in zip(end, following, strict=False)]
    mirror = form.mirror
    rows += [ends[-1][i] + mirror[i] * nodes[0][i] - aim for i, aim in zip(form.ends, form.targets, strict=True)]
    if form.closures:
        rows += equations.field.closure(nodes[0])[0][: form.closures]
    for anchor, normal in equations.sections:
        rows.append(sum((w * (x - a) for w, x, a in zip(normal, nodes[0], anchor, strict=False)), arb(0)))
    return rows if equations.energy is None else [*rows, equations.field.energy(nodes[0])[0] - equations.energy]


def jacobian(equations: TheoremEquations, box: Vector, derivatives: Sequence[Any]) -> Any:
    """DF over a box of unknowns from the segments' derivatives (d x d+2 each)."""
    return arb_mat(jacobian_rows(equations, box, [matrix.entries() for matrix in derivatives]))


def jacobian_rows(equations: TheoremEquations, box: Vector, derivatives: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """The rows of DF from the entries of the segments' derivatives, row after row."""
    form = equations.formulation
    d, total, mirror = form.dimension, form.unknowns, form.mirror
    free = {component: k for k, component in enumerate(form.free)}
    rows = [[arb(0)] * total for _ in range(total)]

    def place(k: int, component: int) -> int | None:
        if k:
            return len(free) + d * (k - 1) + component
        return free.get(component)

    def put(row: int, k: int, component: int, value: Any) -> None:
        where = place(k, component)
        if where is not None:
            rows[row][where] += value

    for k, values in enumerate(derivatives):
        last = k == len(derivatives) - 1
        for row, i in enumerate(form.ends if last else range(d), start=d * k):
            line = values[i * (d + 2) : (i + 1) * (d + 2)]
            for j in range(d):
                put(row, k, j, line[j])
            rows[row][-1] += line[-1]
            if form.unfolded:
                rows[row][-2] += line[-2]
            if last:
                put(row, 0, i, arb(mirror[i]))
            else:
                put(row, k + 1, i, arb(-1))
    if form.closures:
        slopes = equations.field.closure(form.nodes(box)[0])[1].tolist()[: form.closures]
        for row, line in enumerate(slopes, d * (form.segments - 1) + len(form.ends)):
            for j in range(d):
                put(row, 0, j, line[j])
    for row, (_, normal) in enumerate(equations.sections, total - len(equations.sections) - int(form.conserved)):
        for i, weight in enumerate(normal):
            put(row, 0, i, arb(weight))
    if form.conserved:
        for i, slope in enumerate(equations.field.energy(form.nodes(box)[0])[1]):
            put(total - 1, 0, i, slope)
    return rows


def krawczyk(equations: TheoremEquations, box: Vector, settings: TaylorSettings) -> Krawczyk:
    """K on a box of unknowns about its centre."""
    centre = midpoints(box)
    arcs = arcs_over(equations, box, centre, settings)
    values = residual(equations, centre, [arc[0] for arc in arcs])
    slopes = jacobian(equations, box, [arc[1] for arc in arcs])
    image, contraction = contracted(values, slopes, box)
    return Krawczyk(image, box, contraction, inside(box, image), arcs)


def contracted(values: Sequence[Any], slopes: Any, box: Vector) -> tuple[Vector, float]:
    """K(X) and the norm of 1 - C DF(X), from F at the centre and DF over the box.

    Where K(X) lies inside X, so does its image by the same C and DF(X), which holds the zero too: that is returned.
    """
    centre = midpoints(box)
    inverse = exact(approximate_inverse(floats(slopes)))
    defect = exact(np.eye(len(centre))) - inverse * slopes
    fixed = column(centre) - inverse * column(values)

    def image(of: Vector) -> Vector:
        return list((fixed + defect * (column(of) - column(centre))).entries())

    first = image(box)
    return image(image(first)) if inside(box, first) else first, norm(defect)


def approximate_inverse(matrix: np.ndarray) -> np.ndarray:
    """A float inverse; of a singular matrix zeros, which prove nothing."""
    try:
        inverse = np.linalg.inv(matrix)
    except np.linalg.LinAlgError:
        return np.zeros_like(matrix)
    return inverse if np.all(np.isfinite(inverse)) else np.zeros_like(matrix)


def norm(matrix: Any) -> float:
    """An upper bound of the largest row sum of |entries|."""
    size, values = matrix.ncols(), [abs(x).upper() for x in matrix.entries()]
    sums = [sum(values[i : i + size], arb(0)).upper() for i in range(0, len(values), size)]
    if not all(x.is_finite() for x in sums):
        return np.inf
    return float(np.nextafter(max(float(x) for x in sums), np.inf))


# --------------------------------------------------------------------------------------------------
# Newton on the theorem's equations without error bounds: where the box goes, and refined digits.
# The same power series as in the proof, centres of balls only, at any precision.


MOST_ITERATIONS = 30
ROUGH = 1e-5
"""Corrections above this make a new Jacobian worth while"""
SLOPES = TaylorSettings(order=10, tolerance=1e-6)
"""Of the Jacobian, on which it depends how many digits an iteration gains"""


def flow(equations: TheoremEquations, node: Vector, settings: TaylorSettings, vary: bool) -> tuple[Vector, Any]:
    """End (d) of a segment and, when asked for, the derivatives (d x d+2), as centres of balls."""
    field, size = equations.field, equations.field.dimension
    here, begin = midpoints(node), 0.0
    total = exact(np.eye(size + 2))
    while begin < 1.0:
        solution = field.solution(here, settings.order)
        last, before = (magnitude([component[k] for component in solution.states]) for k in (-1, -2))
        largest = max(last, before ** (settings.order / (settings.order - 1)))
        h = 0.9 * (settings.tolerance / nonzero(largest)) ** (1.0 / settings.order)  # its last term is below that
        h = min(1.0 - begin, float(int(min(h, 1.0) * 2.0**40) * 2.0**-40))
        if not 0 < h <= 1:
            raise ConvergenceError("no orbit near: the solution leaves every bound on the way")
        here = midpoints([horner(component, arb(h)) for component in solution.states]) + here[size:]
        if vary:
            total = (horner(solution.transitions(field.varied), arb(h)) * total).mid()
        begin += h
    return here[:size], block(total, size, 0, size + 2)


def linearised(equations: TheoremEquations, unknowns: Vector, settings: TaylorSettings) -> np.ndarray:
    """An approximate inverse of DF at a point."""
    flows = [flow(equations, node, settings, vary=True)[1] for node in equations.formulation.nodes(unknowns)]
    return approximate_inverse(floats(jacobian(equations, unknowns, flows)))


def evaluated(equations: TheoremEquations, unknowns: Vector, settings: TaylorSettings) -> Vector:
    """F at a point."""
    ends = [flow(equations, node, settings, vary=False)[0] for node in equations.formulation.nodes(unknowns)]
    return midpoints(residual(equations, unknowns, ends))


def corrected(step: Callable[[Vector], Any], start: Vector, target: float, what: str) -> Vector:
    """Unknowns whose last correction (a column, of `step`) is below a target. Raises `ConvergenceError`."""
    here, moved = midpoints(start), np.inf
    for _ in range(MOST_ITERATIONS):
        change = step(here).entries()
        here, before, moved = midpoints([x - dx for x, dx in zip(here, change, strict=True)]), moved, magnitude(change)
        if moved <= target:
            return here
        if not moved < 0.5 * before:
            break
    raise ConvergenceError(f"no {what} near: Newton's last step was {moved:.2g}")


def solve(
    equations: TheoremEquations, start: Vector, settings: TaylorSettings, target: float, farthest: float = 1e-2,
    known: np.ndarray | None = None,
) -> tuple[Vector, int]:  # fmt: skip
    """Unknowns whose last correction is below `target`, and the number of iterations.

    Newton's steps until they are small; then the last inverse is used again (each step gains the digits
    that it is right to), from the beginning where a neighbour's is `known`. Raises `ConvergenceError` when they do not
    shrink or leave the start.
    """
    here, last = midpoints(start), np.inf
    inverse = np.zeros((0, 0)) if known is None else known
    for k in range(MOST_ITERATIONS):
        if not inverse.size or (k and last > ROUGH):
            inverse = linearised(equations, here, SLOPES)
        values = evaluated(equations, here, settings)
        correction = (exact(inverse) * arb_mat(len(values), 1, values)).entries()
        size = magnitude(midpoints(correction))
        here = midpoints([x - c for x, c in zip(here, correction, strict=True)])
        moved = magnitude([x - y for x, y in zip(here, start, strict=True)])
        if not moved <= farthest or (k > 2 and size > 0.5 * last):
            raise ConvergenceError(f"no orbit near: Newton moved the nodes by {moved:.2g}, last by {size:.2g}")
        if size <= target or (size == 0.0):
            return here, k + 1
        last = size
    raise ConvergenceError(f"Newton did not settle in {MOST_ITERATIONS} iterations; the last correction was {last:.2g}")
