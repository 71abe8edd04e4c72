"""What the theorem solves: unknowns and equations of an orbit of a given symmetry, square in every case.

| symmetry | horizon | first node | conditions at the end | besides |
|---|---|---|---|---|
| none | T | x (2n) | x = x_0 + whole turns (2n) | section, energy; unfolding s |
| reflection | T/2 | x (2n) | x = shift - x_0 (2n) | section, energy; unfolding s |
| brake | T/2 | q (n), v = 0 | v = 0 (n) | energy |
| reversal | T/2 | v (n), q = k pi | q = k' pi (n) | energy |
| brake+reflection | T/4 | q (n), v = 0 | q = k pi (n) | energy |

Unknowns: the first node's free components, the other nodes (2n each), s where it is used, and the
segments' duration tau = T / (parts N). Equations: N - 1 times continuity (2n), then as above.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from orbitfinder.proof.balls import Vector, arb

PARTS = {"none": 1, "reflection": 2, "brake": 2, "reversal": 2, "brake+reflection": 4}


@dataclass(frozen=True)
class Formulation:
    """A symmetry's boundary conditions for n coordinates in N segments.

    `start` (n integers) are the multiples of pi at which q is held at the first node (reversal);
    `target` (n integers) the multiples of pi in the conditions at the end; `turns` (n integers) the
    whole turns of a period.
    """

    symmetry: str
    size: int
    segments: int
    start: tuple[int, ...]
    target: tuple[int, ...]
    turns: tuple[int, ...]

    @property
    def parts(self) -> int:
        """The period in multiples of the horizon."""
        return PARTS[self.symmetry]

    @property
    def unfolded(self) -> bool:
        """True when the equations need the unfolding parameter to be square."""
        return self.symmetry in ("none", "reflection")

    @property
    def free(self) -> range:
        """Components of the first node that are unknowns."""
        n = self.size
        if self.unfolded:
            return range(2 * n)
        return range(n, 2 * n) if self.symmetry == "reversal" else range(n)

    @property
    def ends(self) -> range:
        """Components of the last state that conditions are put on."""
        n = self.size
        if self.unfolded:
            return range(2 * n)
        return range(n, 2 * n) if self.symmetry == "brake" else range(n)

    @property
    def mirror(self) -> int:
        """Sign with which the first node enters the conditions at the end."""
        return {"none": -1, "reflection": 1}.get(self.symmetry, 0)

    @property
    def unknowns(self) -> int:
        """Number of unknowns, and of equations."""
        return len(self.free) + 2 * self.size * (self.segments - 1) + 1 + int(self.unfolded)

    def constant(self, component: int) -> Any:
        """Multiple of pi in the condition on a component of the last state, as a ball."""
        return arb.pi() * self.target[component] if component < self.size else arb(0)

    def nodes(self, unknowns: Vector) -> list[Vector]:
        """The extended states z (2n + 2) at the nodes from the unknowns."""
        n, count = self.size, len(self.free)
        tail = [unknowns[-2] if self.unfolded else arb(0), unknowns[-1]]
        first = [arb.pi() * k for k in self.start] + [arb(0)] * n
        for place, value in zip(self.free, unknowns[:count], strict=True):
            first[place] = value
        rest = [unknowns[count + 2 * n * k : count + 2 * n * (k + 1)] for k in range(self.segments - 1)]
        return [[*node, *tail] for node in (first, *rest)]

    def unknowns_of(self, nodes: np.ndarray, duration: float) -> list[float]:
        """The unknowns of float nodes (N x 2n) and a segment's duration (s)."""
        head = [float(nodes[0, i]) for i in self.free]
        return [*head, *map(float, nodes[1:].ravel()), *([0.0] if self.unfolded else []), float(duration)]


def image(formulation: Formulation, fraction: Any) -> tuple[Any, Any]:
    """The time in the horizon (0..1) at which the state at a fraction (0..1, exact) of the period is found.

    Returns that time and a function from the state there to the state wanted, by the symmetries
    x(-t) = (q, -v) (brake), (2 q_0 - q, v) (reversal), x(t + T/2) = shift - x(t) (reflection).
    """
    n, symmetry, pi = formulation.size, formulation.symmetry, arb.pi()
    target = formulation.target

    def mirrored(x: Vector, places: int, rates: int, shift: list[int]) -> Vector:
        return [places * a + pi * k for a, k in zip(x[:n], shift, strict=True)] + [rates * a for a in x[n:]]

    if symmetry == "none":
        return fraction, lambda x: x
    if symmetry == "reflection":
        if fraction < 0.5:
            return 2 * fraction, lambda x: x
        return 2 * fraction - 1, lambda x: mirrored(x, -1, -1, list(target))
    if symmetry == "brake":
        if fraction <= 0.5:
            return 2 * fraction, lambda x: x
        return 2 - 2 * fraction, lambda x: mirrored(x, 1, -1, [0] * n)
    if symmetry == "reversal":
        if fraction <= 0.5:
            return 2 * fraction, lambda x: x
        shift = [2 * k + 2 * w for k, w in zip(formulation.start, formulation.turns, strict=True)]
        return 2 - 2 * fraction, lambda x: mirrored(x, -1, 1, shift)
    centre = [2 * k for k in target]
    if fraction > 0.5:
        time, inner = image(formulation, 1 - fraction)
        return time, lambda x: mirrored(inner(x), 1, -1, [0] * n)
    if fraction <= 0.25:
        return 4 * fraction, lambda x: x
    return 2 - 4 * fraction, lambda x: mirrored(x, -1, 1, centre)
