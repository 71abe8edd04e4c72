"""Points of a family as arrays: what the compiled `advance` is told of a curve, and what it makes of it.

Of loops of one smooth arc without a bifurcation's test, whose conditions are functions of the head (x(0), T, free).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder.integrate.lanes.advance import Advance, Frame, advance_of
from orbitfinder.integrate.march import EFFORT, March, Varied
from orbitfinder.loops.condensed import SMALL
from orbitfinder.loops.continued import CORRECTOR, Curve, Solution
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.mesh import MESH, STEP_ERROR
from orbitfinder.loops.scales import UNFELT, Scales
from orbitfinder.mechanics.scales import LEAST_SHARE, STILL

FEWEST, MOST = 4, 32
"""Points of a block, the first time and at most"""


@dataclass(frozen=True)
class Pacing:
    """How long steps may be (see `families.point.FamilySettings`)."""

    longest: float
    sharpest: float
    stretch: float
    prediction: float

    def next(self, length: float, turn: float, stretch: float, missed: float) -> float:
        """The length after a step that turned by so much (rad), stretched the period, was predicted so far off.

        Longer after a good prediction (its error goes with the third power), shorter after a bad one, and so that what
        is allowed is not changed in the next. The same stands in `advance.c`.
        """
        ease = float(np.clip((self.prediction / max(missed, 1e-12)) ** (1 / 3), 0.5, 1.5))
        bendable = min(0.4 * self.sharpest / max(turn, 1e-9), 0.6 * self.stretch / max(stretch, 1e-9))
        return float(min(self.longest, length * min(ease, max(0.5, bendable))))


@dataclass(frozen=True)
class Accepted:
    """An orbit that a family has come to, in scales renewed there: tangent, bend of the family through the last."""

    curve: Curve
    solution: Solution
    whole: np.ndarray
    bend: np.ndarray


@dataclass(frozen=True)
class Ahead:
    """A point as predicted and corrected a `length` after `start`, in the scales there: its orbit, its tangent, the
    angle to that before, the relative change of the period, how far off the prediction was; and the `next` length.
    """

    start: Unknowns
    length: float
    solution: Solution
    whole: np.ndarray
    turn: float
    stretch: float
    missed: float
    next: float
    accepted: Accepted | None = None
    """how it stands, where that is known"""
    fits: bool = True
    """False where its mesh is stale or may be far too fine, which the driver must see to"""


class Blocks:
    """Points of a family, many in a call; each is what it would be by itself, whatever block it is in."""

    def __init__(self, curve: Curve, advance: Advance, pacing: Pacing) -> None:
        self._advance, self._pacing, self._maps = advance, pacing, _maps(curve)
        self._ahead: list[Ahead] = []
        self._count = FEWEST

    @classmethod
    def of(cls, curve: Curve, pacing: Pacing) -> Blocks | None:
        """Those of a curve; None where points are made one by one."""
        advance = _compiled(curve)
        return None if advance is None else cls(curve, advance, pacing)

    def next(self, curve: Curve, start: tuple[Unknowns, np.ndarray, np.ndarray], length: float) -> Ahead | None:
        """The point a length after a place with its tangent and bend; None where the driver must see to it."""
        if not (self._ahead and self._ahead[0].start is start[0] and self._ahead[0].length == length):
            count = FEWEST if self._ahead else self._count
            self._ahead = self._made(curve, start, length, count)
            self._count = min(2 * count, MOST) if len(self._ahead) == count else FEWEST
        return self._ahead.pop(0) if self._ahead else None

    def _made(
        self, curve: Curve, start: tuple[Unknowns, np.ndarray, np.ndarray], length: float, count: int
    ) -> list[Ahead]:
        w, whole, bend = start
        if w.vector.size > SMALL:
            return []
        standing, passage = _rows(w, count)
        for rows, row in zip(standing, (w.vector, whole, bend, _packed(curve.scales)), strict=False):
            rows[0] = row
        standing[5][0] = length
        made = self._advance(_frame(curve, w, self._pacing, self._maps), standing, passage)
        ahead, before = [], w
        for k in range(made):
            raw, turn, stretch, missed = passage[0][k], *map(float, passage[7][k, :3])
            accepted = _accepted(curve, w, standing, passage, k)
            solution, fits = replace(accepted.solution, jacobian=passage[6][k]), bool(passage[7][k, 6])
            where = before, float(standing[5][k, 0])
            after = float(standing[5][k + 1, 0])
            ahead.append(Ahead(*where, solution, raw, turn, stretch, missed, after, accepted, fits))
            before = solution.place
        return ahead

    def accepted(self, curve: Curve, before: Unknowns, solution: Solution, whole: np.ndarray) -> Accepted | None:
        """An orbit with its tangent as it stands after another; None where it cannot be said."""
        w, marched = solution.place, solution.marched or solution.place
        if w.vector.size > SMALL:
            return None
        standing, passage = _rows(w, 1)
        earlier = before if w.displacement(before) is not None else w
        standing[0][0], standing[0][1], standing[3][0] = earlier.vector, w.vector, _packed(curve.scales)
        passage[0][0], passage[1][0] = whole, marched.vector
        made = self._advance(_frame(curve, w, self._pacing, self._maps), standing, passage, known=True)
        return _accepted(curve, w, standing, passage, 0) if made else None


def _packed(scales: Scales) -> np.ndarray:
    return np.concatenate([scales.states, [scales.period], scales.free, scales.largest, scales.lowest, scales.highest,
                           scales.least])  # fmt: skip


def _rows(w: Unknowns, count: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """What stands at a point and before `count` others, and what is met on the way to each (see `advance.c`)."""
    (segments, d), f, n, cut = w.nodes.shape, w.free.size, w.vector.size, w.nodes.size
    standing = [(n,), (n,), (n,), (2 * d + 1 + 4 * f,), (cut,), (1,)]
    passage = [(n,), (n,), (segments, d), (segments, d, d), (segments, d, n - cut), (w.mesh.size, d), (n - 1, n), (7,)]
    return [np.zeros((count + 1, *shape)) for shape in standing], [np.empty((count, *shape)) for shape in passage]


def _accepted(
    curve: Curve, start: Unknowns, standing: Sequence[np.ndarray], passage: Sequence[np.ndarray], k: int
) -> Accepted:
    w, whole, bend, packed, normals, _ = (rows[k + 1] for rows in standing)
    _, marched, ends, phi, columns, states, jacobian, facts = (rows[k] for rows in passage)
    size, f = curve.equations.size, start.free.size
    own, (period,), *others = np.split(packed, np.cumsum([size, 1, f, size, f, f]))
    place = start.at(w)
    if _timed(curve):
        row = (len(start.nodes) - 1) * size + len(curve.equations.boundary[0])
        jacobian = jacobian.copy()
        jacobian[row, : place.nodes.size] = normals
    path = Varied(ends, phi, columns, states, float(facts[5]))
    solution = Solution(place, path, jacobian, float(facts[3]), float(facts[4]), start.at(marched))
    return Accepted(replace(curve, scales=Scales(own, float(period), *others)), solution, whole, bend)


def _timed(curve: Curve) -> bool:
    """Whether a phase fixes the time."""
    return not (curve.equations.symmetry.reverses or curve.equations.model.forced)


def _compiled(curve: Curve) -> Advance | None:
    """The compiled blocks of a curve, None where there are none."""
    p, march, symmetry = curve.equations, curve.equations.march, curve.equations.symmetry
    if p.gridded or march.wide or p.links or curve.test or curve.degenerate or not isinstance(march, March):
        return None
    if symmetry.relative or symmetry.generators(p.model) or np.isnan(curve.constant).any():
        return None
    return advance_of(march.field, march.integrand, p.stated(curve.conditions), EFFORT)


def _maps(curve: Curve) -> np.ndarray:
    """The affine maps (k x d x d + 1, the shift last as a row of its own) that make the whole motion of its part."""
    symmetry, size = curve.equations.symmetry, curve.equations.size
    maps = [(np.eye(size), np.zeros(size))]
    if symmetry.reverses:
        maps.append(symmetry.about(curve.constant)[1])
    if symmetry.forward is not None:
        matrix, moved = symmetry.displaced(curve.constant)
        maps += [(matrix @ other, matrix @ shift + moved) for other, shift in maps]
    return np.array([np.concatenate([matrix.ravel(), moved]) for matrix, moved in maps])


def _frame(curve: Curve, w: Unknowns, pacing: Pacing, maps: np.ndarray) -> Frame:
    p, (first, last) = curve.equations, curve.equations.boundary
    return Frame(
        segments=len(w.nodes), steps=w.steps, closing=len(first), phase=int(_timed(curve)),
        images=len(maps), forced=int(p.model.forced), first_order=int(p.model.rates is not None), mesh=w.mesh,
        first=first, last=last, aimed=p.aimed(curve.constant), maps=maps, lengths=curve.shares,
        angular=p.model.angular, values=[condition.value for condition in curve.conditions], units=curve.units,
        ready=CORRECTOR.newton_ready, floor=CORRECTOR.newton_floor, contraction=0.1, stall=0.5,
        iterations=CORRECTOR.most_newton, sharpest=pacing.sharpest, stretch=pacing.stretch,
        longest=pacing.longest, prediction=pacing.prediction, stale=MESH.stale, allowed=STEP_ERROR, spare=MESH.spare,
        sampled=MESH.sampled, steepest=MESH.steepest, least_share=LEAST_SHARE, still=STILL, unfelt=UNFELT,
        stepped=CORRECTOR.unmoved,
    )  # fmt: skip
