"""What the theorem solves: unknowns and equations of an orbit of a given symmetry, square in every case.

| symmetry | horizon | first node | conditions at the end | besides |
|---|---|---|---|---|
| none | T | x (2n) | x = x_0 + whole turns (2n) | section, energy; unfolding s |
| reflection | T/2 | x (2n) | x = shift - x_0 (2n) | section, energy; unfolding s |
| brake | T/2 | q (n), v = 0 | v = 0 (n) | energy |
| reversal | T/2 | v (n), q = k pi | q = k' pi (n) | energy |
| brake+reflection | T/4 | q (n), v = 0 | q = k pi (n) | energy |

A first-order system has its whole state (d components) where a mechanical one has (q, v), and the brake and declared
reversals hold those that they flip. Where it conserves nothing, without the rows of the energy and without s, there are
no such reversals: the section alone fixes an orbit. Of a driven system the time is the last component of the state, 0
at the first node and the drive's k periods at the end, which takes the section's place.

Under m constraints phi(q) = 0 the first node satisfies phi = 0 and J v = 0 (with v = 0 phi = 0 alone), and m
coordinates and their rates, which follow from the others, are left out of the conditions at the end.

Unknowns: the first node's free components, the other nodes (2n each), s where it is used, and the
segments' duration tau = T / (parts N). Equations: N - 1 times continuity (2n), then as above.

These are the loop's unknowns (`loops.loop.Unknowns`) without the components that its boundary rows hold at the
start: a ball is a float with a radius, and no float is k pi, so that in a box of all of w the held rows would be solved
to a radius, and the theorem be about an orbit that is symmetric up to that. Left out, they are exact. The rows'
matrices, what they hold, and how the whole follows from a part are read from `loops.symmetry`.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from orbitfinder.errors import InputError, IntegrationError, plural
from orbitfinder.integrate.dop853 import SECOND, integrate
from orbitfinder.integrate.equations import accelerations
from orbitfinder.integrate.field import vector_field
from orbitfinder.loops.symmetry import Symmetry, off_centre
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import Vector, arb
from orbitfinder.records.orbit import Orbit


@dataclass(frozen=True)
class Formulation:
    """A symmetry's boundary conditions for n coordinates in N segments.

    `constants` (d integers) are those of the symmetry's boundary rows in multiples of pi; `turns` (n integers) the
    whole turns of a period; `conserved` says that the energy is held. `drive` is the duration (s, a ball) of the
    periods of a drive that the orbit takes. `dependent` are coordinates (m) that constraints make of the others.
    """

    symmetry: Symmetry
    size: int
    segments: int
    constants: tuple[int, ...]
    turns: tuple[int, ...]
    conserved: bool = True
    drive: Any = None
    dependent: tuple[int, ...] = ()

    @property
    def dimension(self) -> int:
        """d, components of the state, the time of a driven system among them."""
        return self.components + int(self.drive is not None)

    @property
    def components(self) -> int:
        """The same without the time."""
        return self.size if self.symmetry.first_order else 2 * self.size

    @property
    def sectioned(self) -> bool:
        """True when a section fixes the phase: neither a reversal nor a drive does."""
        return not self.symmetry.reverses and self.drive is None

    @property
    def parts(self) -> int:
        """The period in multiples of the horizon."""
        return self.symmetry.parts

    @property
    def unfolded(self) -> bool:
        """True when the equations need the unfolding parameter to be square."""
        return self.conserved and not self.symmetry.reverses

    @property
    def square(self) -> bool:
        """True when there are as many equations as unknowns: a reversal may hold too many components, or too few."""
        ends = len(self.ends) + self.closures
        equations = self.dimension * (self.segments - 1) + ends + int(self.sectioned) + int(self.conserved)
        return equations == self.unknowns

    @property
    def closures(self) -> int:
        """Rows of phi and J v that are asked of the first node."""
        return len(self.dependent) * (1 if self.symmetry.reverses else 2)

    @property
    def free(self) -> tuple[int, ...]:
        """Components of the first node that are unknowns."""
        return tuple(np.flatnonzero(~self.symmetry.held(self.size)).tolist())

    @property
    def ends(self) -> tuple[int, ...]:
        """Components of the last state that conditions are put on."""
        return tuple(i for i in self._ends if i % self.size not in self.dependent)

    @property
    def _ends(self) -> tuple[int, ...]:
        """The same without constraints."""
        ends = np.nonzero(self.symmetry.rows(self.size)[1])[1].tolist()
        return (*ends, *range(self.components, self.dimension))

    @property
    def shifts(self) -> dict[int, int]:
        """The half turns that are asked of a component, at either end, where any are."""
        places = (*np.flatnonzero(self.symmetry.held(self.size)), *self._ends)
        return {int(i): k for i, k in zip(places, self.constants, strict=False) if k}

    @property
    def mirror(self) -> tuple[int, ...]:
        """Signs (d) with which the first node's components enter the conditions at the end."""
        if self.symmetry.reverses:
            return (0,) * self.dimension
        signs = (int(sign) for sign in np.diag(self.symmetry.rows(self.size)[0]))
        return (*signs, *[0] * (self.dimension - self.components))

    @property
    def unknowns(self) -> int:
        """Number of unknowns, and of equations."""
        return len(self.free) + self.dimension * (self.segments - 1) + 1 + int(self.unfolded)

    @property
    def targets(self) -> list[Any]:
        """What the components `ends` of the last state are to be, as balls."""
        if self.drive is not None:
            return [arb.pi() * k for k in self.constants] + [self.drive]
        constants = zip(self._ends, self.constants[-len(self._ends) :], strict=True)
        return [arb.pi() * k for i, k in constants if i in self.ends]

    def nodes(self, unknowns: Vector) -> list[Vector]:
        """The extended states z (d + 2) at the nodes from the unknowns."""
        d, count = self.dimension, len(self.free)
        tail = [unknowns[-2] if self.unfolded else arb(0), unknowns[-1]]
        first = [arb(0)] * d
        for component, k in zip(np.flatnonzero(self.symmetry.held(self.size)), self.constants, strict=False):
            first[component] = arb.pi() * k
        for place, value in zip(self.free, unknowns[:count], strict=True):
            first[place] = value
        rest = [unknowns[count + d * k : count + d * (k + 1)] for k in range(self.segments - 1)]
        return [[*node, *tail] for node in (first, *rest)]

    def unknowns_of(self, nodes: np.ndarray, duration: float) -> list[float]:
        """The unknowns of float nodes (N x d) and a segment's duration (s)."""
        head = [float(nodes[0, i]) for i in self.free]
        return [*head, *map(float, nodes[1:].ravel()), *([0.0] if self.unfolded else []), float(duration)]


def image(formulation: Formulation, fraction: Any) -> tuple[Any, Any]:
    """The time in the horizon (0..1) at which the state at a fraction (0..1, exact) of the period is found.

    Returns that time and a function from the state there to the state wanted, by the symmetry's maps.
    """
    symmetry, constants = formulation.symmetry, np.asarray(formulation.constants, float)

    def mapped(inner: Any, matrix: np.ndarray, moved: np.ndarray) -> Any:
        signs, multiples = ([round(value) for value in values] for values in (np.diag(matrix), moved))
        return lambda x: [sign * a + arb.pi() * k for sign, a, k in zip(signs, inner(x), multiples, strict=True)]

    half = fraction - Fraction(1, 2)
    if symmetry.forward is not None and half >= 0:
        time, inner = image(formulation, half)
        return time, mapped(inner, *symmetry.displaced(constants))
    time = fraction * formulation.parts
    if not symmetry.reverses or time <= 1:
        return time, lambda x: x
    return 2 - time, mapped(lambda x: x, *symmetry.about(constants)[1])


SCAN = 2000
"""Instants of a period at which a symmetric one is looked for"""


@dataclass(frozen=True)
class Approach:
    """Where the proof starts: the formulation, float nodes (N x d), a segment's duration (s), and the
    fraction of the period by which the recorded state comes after the first node, where that is known.
    """

    formulation: Formulation
    nodes: np.ndarray
    duration: float
    phase: float | None
    flow: np.ndarray
    """the field (d) at the first node"""


def approach(
    model: Model, orbit: Orbit, symmetry: Symmetry, segments: int | None, phase: float | None = None,
    frequency: Any = None, begun: tuple[np.ndarray, float] | None = None,
) -> Approach:  # fmt: skip
    """Nodes of the orbit in a formulation, by DOP853 from the recorded state; `phase`: which symmetric instant.

    `frequency` (rad/s, a ball) is that of what drives the system; `begun` as in `Options`.
    """
    n, period = model.degrees_of_freedom, orbit.period
    if orbit.state.size != len(model.state_names) or len(orbit.winding) != n:
        raise InputError(
            f"state: {plural(orbit.state.size, 'number')} for {plural(n, 'coordinate')}; run the problem again"
        )
    if orbit.shift:
        raise InputError(
            f"shift: {', '.join(orbit.shift)} is found with the orbit, and proofs are of orbits that come back; give "
            "one that closes after whole turns (find.winding)"
        )
    if not (np.all(np.isfinite(orbit.state)) and np.isfinite(period) and period > 0):
        raise InputError("state: state or period is not a usable number; run the problem again")
    angles, begin, turns = np.asarray(model.angles), 0.0, tuple(map(int, orbit.winding))
    if begun is not None and begun[0].shape[1] == orbit.state.size and symmetry.reverses and symmetry.forward is None:
        nodes, period = begun
        constants = symmetry.constants(angles, nodes[0], turns=turns) / np.pi
        form = Formulation(symmetry, n, len(nodes), tuple(map(round, constants)), turns, bool(model.invariants))
        return Approach(form, nodes, period / symmetry.parts / len(nodes), None, np.zeros(nodes.shape[1]))
    field = vector_field(accelerations(model))
    if symmetry.reverses:
        times = np.linspace(0.0, period, SCAN + 1)
        begin = symmetric_instant(field, times, integrate(field, orbit.state, times, SECOND), symmetry, angles, phase)
    parts, largest = symmetry.parts, float(np.abs(orbit.floquet_multipliers).max(initial=1.0))
    # so many that none stretches by much more than 30 times
    count = segments or 4 + int(np.log(max(largest, 1.0)) / np.log(30.0) / parts)
    grid = begin + np.linspace(0.0, period / parts, count + 1)
    path = integrate(field, orbit.state, np.concatenate([[0.0], grid]) if begin > 0 else grid, SECOND)[-count - 1 :]
    constants = symmetry.constants(angles, path[0], path[-1], orbit.winding) / np.pi
    nodes, flow, drive = path[:-1], field(0.0, path[0]), None
    if frequency is not None:
        cycles = max(1, round(period * float(frequency.mid()) / (2 * np.pi)))
        drive = 2 * cycles * arb.pi() / frequency
        nodes, flow = np.column_stack([nodes, grid[:-1]]), np.append(flow, 1.0)
    form = Formulation(symmetry, n, count, tuple(map(round, constants)), turns, bool(model.invariants), drive)
    return Approach(form, nodes, period / parts / count, (-begin / period) % 1.0, flow)


def symmetric_instant(
    field: object, times: np.ndarray, states: np.ndarray, symmetry: Symmetry, angles: np.ndarray,
    phase: float | None = None,
) -> float:  # fmt: skip
    """The time (s) at which the horizon of a reversal may start, a rest (brake) for example.

    There are two, half a period apart and equal but for round-off: a `phase` (see `Approach`) says which.
    """

    def distance(x: np.ndarray) -> float:
        return float(np.sum(off_centre(symmetry.maps[0], x[None], angles) ** 2))

    wanted = (k for k in range(SCAN) if phase is None or abs((k / SCAN + phase + 0.5) % 1.0 - 0.5) <= 0.25)
    best = min(wanted, key=lambda k: distance(states[k]))
    first = max(best - 1, 0)

    def at(time: float) -> float:
        if time <= times[first]:
            return distance(states[first])
        return distance(integrate(field, states[first], np.array([times[first], time]), SECOND)[-1])  # type: ignore[arg-type]

    try:
        least = minimize_scalar(
            at, bounds=(times[first], times[best + 1]), method="bounded", options={"xatol": 1e-9 * times[-1]}
        )
    except IntegrationError:
        return float(times[best])
    return float(least.x) if least.fun < distance(states[best]) else float(times[best])
