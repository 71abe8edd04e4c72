"""Along the proved orbit once more, in its tiny box: states at any time, minimal period, positivity, stability."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from orbitfinder.proof.balls import Vector, arb, arb_mat, between, block, eigenvalues, exact, fmpq, identity
from orbitfinder.proof.enclosure import TaylorSettings, Tube
from orbitfinder.proof.field import Field
from orbitfinder.proof.formulation import Formulation, image
from orbitfinder.proof.krawczyk import Arc, TheoremEquations, krawczyk

PIECES = 8
"""Parts of a step over which the field's sign is looked at"""


@dataclass(frozen=True)
class Trajectory:
    """The orbit's horizon enclosed: `steps` of every segment, derivatives (d square) over the horizon.

    `box` (unknowns) holds every zero; all other boxes follow from it.
    """

    field: Field
    formulation: Formulation
    box: Vector
    steps: list[list[Tube]]
    horizon_matrix: Any

    @property
    def first(self) -> Vector:
        """The extended first node (d + 2)."""
        return self.formulation.nodes(self.box)[0]

    @property
    def period(self) -> Any:
        """The period (s)."""
        return self.box[-1] * self.formulation.segments * self.formulation.parts

    def state(self, fraction: Fraction) -> Vector:
        """Enclosure of the state (d) at a fraction (0..1, exact) of the period."""
        time, transform = image(self.formulation, fraction)
        time = Fraction(time) * self.formulation.segments
        k = min(int(time), self.formulation.segments - 1)
        local = time - k
        step = next(passed for passed in reversed(self.steps[k]) if Fraction(passed.begin) <= local)
        after = local - Fraction(step.begin)
        return list(transform(step.at(arb(fmpq(after.numerator, after.denominator)))))


def trajectory(equations: TheoremEquations, box: Vector, settings: TaylorSettings) -> Trajectory:
    """The trajectories from a box of unknowns that holds every zero, itself made smaller by the operator once more."""
    again = krawczyk(equations, box, settings)
    return horizon(equations, [x.intersection(y) for x, y in zip(box, again.image, strict=True)], again.arcs)


def horizon(equations: TheoremEquations, box: Vector, arcs: Sequence[Arc]) -> Trajectory:
    """The trajectories from a box of unknowns by the arcs from a box that holds it."""
    size = equations.field.dimension
    total = identity(size)
    for arc in arcs:
        total = block(arc[1], size, 0, size) * total
    return Trajectory(equations.field, equations.formulation, box, [arc[3] for arc in arcs], total)


def monodromy(path: Trajectory) -> Any:
    """dx(T)/dx(0) (d square) from the horizon's, by the symmetry."""
    size = path.formulation.components
    phi = block(path.horizon_matrix, size, 0, size)
    root, power = path.formulation.symmetry.root(
        phi,
        lambda other: phi.solve(other, algorithm="precond"),
        size,
        made=lambda matrix: arb_mat(size, size, [arb(float(entry)) for entry in matrix.ravel()]),
        times=operator.mul,
    )
    return root * root if power == 2 else root


def positive_mass(path: Trajectory) -> bool:
    """True when the mass matrix is positive definite at every state on the way (L D L^T of its enclosures)."""

    def positive(step: Tube, pieces: int) -> bool:
        parts = (step.at(between(*(arb(step.h) * j / pieces for j in (k, k + 1)))) for k in range(pieces))
        return all(positive_definite(path.field.mass(part + step.constants)) for part in parts)

    return all(positive(step, 1) or positive(step, PIECES) for steps in path.steps for step in steps)


def positive_definite(matrix: Any) -> bool:
    """True when every symmetric matrix in the enclosure is positive definite: all pivots are positive."""
    n, rows = matrix.nrows(), matrix.tolist()
    for j in range(n):
        if not rows[j][j] > 0:
            return False
        for i in range(j + 1, n):
            factor = rows[i][j] / rows[j][j]
            for k in range(j + 1, n):
                rows[i][k] = rows[i][k] - factor * rows[j][k]
    return True


def moves(path: Trajectory) -> bool:
    """True when some component of the field is provably not zero at the first node."""
    return any(not x.contains(0) for x in path.field.rates(path.first)[: path.formulation.components])


def escape(path: Trajectory, angles: Sequence[bool]) -> tuple[Fraction, int] | None:
    """A fraction of the period within which one component, which is also returned, moves one way only.

    Until then the orbit has not been back at its first state.
    """
    rates = path.field.rates(path.first)[: path.formulation.components]
    quickest = sorted(range(len(rates)), key=lambda i: -float(abs(rates[i]).lower().mid()))
    return next(filter(None, (_moving(path, angles, component) for component in quickest)), None)


def _moving(path: Trajectory, angles: Sequence[bool], component: int) -> tuple[Fraction, int] | None:
    """See `escape`, of a component."""
    form, turning, reached = path.formulation, dict(enumerate(angles)), Fraction(0)
    for k, steps in enumerate(path.steps):
        for step in steps:
            for piece in range(PIECES):
                low, high = (Fraction(step.h) * Fraction(j, PIECES) for j in (piece, piece + 1))
                here = step.at(between(_ball(low), _ball(high))) + path.first[-2:]
                turned = path.field.rates(here)[component].contains(0)
                whole = abs(here[component] - path.first[component]) < 2 * arb.pi()
                far = turning.get(component, False) and not whole
                if turned or far:
                    return (reached, component) if reached else None
                reached = (k + Fraction(step.begin) + high) / (form.segments * form.parts)
    return reached, component


def _ball(number: Fraction) -> Any:
    return arb(fmpq(number.numerator, number.denominator))


def minimal_period(path: Trajectory, angles: Sequence[bool]) -> tuple[bool, int, str]:
    """Whether T is proved minimal, the largest k for which T/k was looked at, and what stood in the way.

    A period T/k below the escape time is impossible; for the other k, x(T/k) must differ from x(0) in
    some component (angles modulo whole turns) but a drive's time, whose true period may be shorter than the graph says.
    """
    left = escape(path, angles)
    if left is None:
        return False, 0, "no component of the state is monotone at first"
    most = int(1 / left[0])
    start = path.state(Fraction(0))[: path.formulation.components]
    for k in range(2, most + 1):
        apart = [a - b for a, b in zip(path.state(Fraction(1, k)), start, strict=path.formulation.drive is None)]
        if not any(differs(x, i < len(angles) and angles[i]) for i, x in enumerate(apart)):
            return False, k, f"the state at T/{k} could not be told from the first"
    return True, most, ""


def differs(difference: Any, angle: bool) -> bool:
    """True when a difference is not zero (nor a whole turn)."""
    if not difference.is_finite():
        return False
    return not (difference / (2 * arb.pi())).contains_integer() if angle else not difference.contains(0)


def reduced(path: Trajectory, matrix: Any) -> Any:
    """The monodromy on the energy surface modulo the flow (2n - 2 square; modulo the flow alone without an energy).

    With f the field, Phi f = f; and where g v = 0, of the gradients g of the energy and of what constraints hold,
    g Phi v = 0. In a basis (f, W, U) with g W = 0 the matrix is block triangular and its middle block is what is asked
    for (2(n - m) - 2 square under m constraints).
    """
    size = path.formulation.dimension
    flow = path.field.rates(path.first)[:size]
    f, columns = np.array([float(x.mid()) for x in flow]), [flow]
    # the gradients (d) of what the motion keeps, at the first node: of phi and J v, of the energy
    held = path.field.closure(path.first)[1].tolist() if path.formulation.dependent else []
    held += [path.field.energy(path.first)[1]] if path.formulation.conserved else []
    g = np.array([[float(x.mid()) for x in slope] for slope in held]).reshape(-1, size)
    u = np.linalg.svd(g, full_matrices=False)[2]
    tangent = f - u.T @ (u @ f)
    span = np.linalg.svd(np.vstack([u, tangent / np.linalg.norm(tangent)]))[2][len(u) + 1 :]
    if held:
        slopes, across = arb_mat(held), exact(u.T)
        parts = across * (slopes * across).solve(slopes * exact(span.T), algorithm="precond")
        span = (exact(span.T) - parts).transpose().tolist()
    columns += [*([arb(x) for x in w] for w in (*span, *u))]
    basis = arb_mat(size, size, [columns[j][i] for i in range(size) for j in range(size)])
    whole, last = basis.solve(matrix * basis, algorithm="precond").tolist(), size - len(held)
    return arb_mat([row[1:last] for row in whole[1:last]])


@dataclass(frozen=True)
class Stability:
    """Enclosed reduced multipliers (balls of complex numbers) and the verdict with its reason.

    `verdict` is "linearly stable" (every multiplier simple and on the unit circle), "asymptotically stable" (every one
    inside it, where nothing is conserved), "unstable" (one is off it; outside it) or "open".
    """

    verdict: str
    reason: str
    multipliers: list[Any]


def stability(reduced: Any, conserved: bool = True) -> Stability:
    """The verdict on a reduced monodromy (2n - 2 square, d - 1 where nothing is conserved, d of a driven system, which
    is `conserved` where it is symplectic).

    The reduced matrix is real and preserves a symplectic form, so with mu also conj(mu), 1/mu and
    1/conj(mu) are multipliers. An enclosure that holds one multiplier and meets the mirror images
    1/conj(.) of no enclosure but its own therefore has it on the unit circle. Source: V. I. Arnold,
    Mathematical Methods of Classical Mechanics, section 42.
    """
    if reduced.nrows() == 0:
        others = "one degree of freedom: no multiplier besides the two at 1"
        return Stability("linearly stable", others if conserved else "no multiplier besides the flow's", [])
    try:
        multipliers, apart = eigenvalues(reduced)
    except (ValueError, ZeroDivisionError):
        multipliers, apart = [], False
    if not multipliers or (conserved and not apart):
        return Stability("open", "two multipliers could not be separated", [])
    multipliers.sort(key=lambda mu: (-round(float(abs(mu).mid()), 6), float(mu.imag.mid())))
    largest = abs(multipliers[0])
    if not conserved and max(abs(mu).upper() for mu in multipliers) < 1:
        return Stability("asymptotically stable", "every multiplier is inside the unit circle", multipliers)
    if largest > 1:
        return Stability(
            "unstable", f"a multiplier of absolute value {arb(largest).str(12)} is off the unit circle", multipliers
        )
    if not conserved:
        return Stability("open", "a multiplier could be on the unit circle or off it", multipliers)
    for k, mu in enumerate(multipliers):
        mirrored = 1 / mu.conjugate()
        for j, other in enumerate(multipliers):
            if j != k and mirrored.overlaps(other):
                return Stability("open", "a multiplier could be one of a pair just off the unit circle", multipliers)
    return Stability("linearly stable", "every multiplier is simple and on the unit circle", multipliers)
