"""What the unknowns and the rows of a loop are measured in, and how far apart two motions are: the one definition.

    <a, b> = sum_k m_k a_k . S^-2 b_k + a_T b_T / T^2 + sum_p a_p b_p / p_s^2

over all nodes k, m_k the share of the period that a node stands for. S are the extents of the whole motion, divided by
sqrt(8) so that a harmonic motion has the length 1 in each of its components: those of a mechanical system shared by all
its coordinates, each in its length, and by all their rates; of a first-order system each component has its own. A
family renews them at every orbit that it accepts, but none falls below a tenth of the largest that it has had; p_s is
the largest of the parameter's value, its range in the family, and where it begins at 0 the change that moves the motion
by a tenth of its size. Nothing here has a unit of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.loops.condensed import Linearised
from orbitfinder.loops.loop import Loop, Unknowns
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import LEAST_SHARE, WIDE, alone, snapped

UNMOVED, UNFELT = 1e-6, 1e-9
"""A direction of unit length that moves the motion by less than the first does not move it. Parameters that change the
rows by less than the second, and components that move by less of their largest value, do so by round-off"""


@dataclass(frozen=True)
class Scales:
    """Sizes of a state (d), the period, freed parameters (f); `largest` (d), `lowest`, `highest` (f) of a family."""

    states: np.ndarray
    period: float
    free: np.ndarray
    largest: np.ndarray
    lowest: np.ndarray
    highest: np.ndarray
    least: np.ndarray
    """what a parameter is measured in at least (f), which began at 0"""

    @classmethod
    def of(cls, sizes: np.ndarray, w: Unknowns, free: np.ndarray) -> Scales:
        """Those at a motion's unknowns, whose states are of given `sizes` (d) and parameters of `free` (f)."""
        return cls(sizes, w.period, free, sizes, w.free, w.free, np.zeros(w.free.size))

    @classmethod
    def head(cls, weights: np.ndarray, size: int) -> Scales:
        """Those that weights of a head (x(0), T, free) stand for, of states of `size` d."""
        units, none = 1.0 / np.sqrt(weights), np.zeros(weights.size - size - 1)
        return cls(units[:size], float(units[size]), units[size + 1 :], units[:size], none, none, none)

    def renewed(self, sizes: np.ndarray, w: Unknowns) -> Scales:
        """The same at the next motion of a family, whose extents are `sizes` (d)."""
        largest = np.maximum(self.largest, sizes)
        lowest, highest = np.minimum(self.lowest, w.free), np.maximum(self.highest, w.free)
        free = np.maximum(np.maximum(np.abs(w.free), highest - lowest), self.least)
        free = np.where(free > 0.0, free, self.free)
        return replace(
            self, states=np.maximum(sizes, LEAST_SHARE * largest), period=w.period, free=free, largest=largest,
            lowest=lowest, highest=highest,
        )  # fmt: skip

    def begun(self, w: Unknowns, whole: np.ndarray, zero: np.ndarray, felt: np.ndarray) -> Scales:
        """The same for parameters (f) that are at `zero`, told by the family's direction over w at its first motion, or
        where that leaves a parameter alone by how much the rows change with its present size: `felt` (f)."""
        moved = whole[: w.nodes.size].reshape(w.nodes.shape) / self.states
        way = float(np.sqrt(w.shares @ (moved**2).sum(axis=1)))
        changes = np.abs(whole[whole.size - w.free.size :])
        enough = LEAST_SHARE * changes / way if way > UNMOVED else self.free
        told = (felt <= EPSILON) | (enough * felt > UNFELT * self.free)  # one that acts by its square is not felt at 0
        enough = np.where(told, enough, self.free / nonzero(felt))
        least = np.where(zero, enough, 0.0)
        return replace(self, free=np.where(zero, least, self.free), least=least)

    def columns(self, w: Unknowns) -> np.ndarray:
        """What every unknown of w is measured in; an unfolding in 1/T."""
        return w.joined(self.states, self.period, 1.0 / self.period, self.free)

    def metric(self, w: Unknowns) -> np.ndarray:
        """The weights of <a, b> over w: 0 of an unfolding. Kept with w, and not to be written to."""
        known: tuple[Any, np.ndarray] | None = w.__dict__.get("metric")
        if known is not None and known[0] is self:
            return known[1]
        weights = self.columns(w) ** -2.0
        nodes = weights[: w.nodes.size].reshape(w.nodes.shape)
        nodes *= w.shares[:, None]
        weights[w.nodes.size + 1 : weights.size - w.free.size] = 0.0
        w.__dict__["metric"] = self, weights
        return weights


@dataclass(frozen=True)
class Measures:
    """What the unknowns of a loop are measured in, a vector over w, and its rows: in what a unit of those changes."""

    columns: np.ndarray
    rows: np.ndarray
    even: bool = False
    """whether all are 1"""

    @classmethod
    def plain(cls, loop: Loop, w: Unknowns) -> Measures:
        """1 of everything."""
        return cls(np.ones(w.vector.size), np.ones(loop.size(w)), True)

    @classmethod
    def of(cls, loop: Loop, w: Unknowns, columns: np.ndarray, slopes: np.ndarray | None = None) -> Measures:
        """Those of a loop at w, rows of aims last; `slopes` of conditions and aims, by default of conditions alone."""
        unit, (first, last), normals = columns[: loop.equations.size], loop.equations.boundary, loop.normals
        boundary = np.maximum(np.abs(first) * unit, np.abs(last) * unit).max(axis=1)
        phases = np.linalg.norm(normals * columns[: normals.shape[1]], axis=1)
        slopes = loop.slopes(w, loop.conditions) if slopes is None else slopes
        named, aims = np.split(np.linalg.norm(slopes * columns, axis=1), [len(loop.conditions)])
        nodes, guards = np.tile(unit, len(w.nodes) - 1), loop.equations.links.units(w, unit)
        return cls(columns, nonzero(np.concatenate([nodes, boundary, phases, named, guards, aims])))

    @classmethod
    def rounded(cls, loop: Loop, w: Unknowns, state: Sequence[float]) -> Measures:
        """The same in powers of 256, so that no digit is lost, near those of a `state` (d), empty where that is all 1.

        A condition is then measured in 1 unless a unit of the unknowns changes it by far more or less; a machine's,
        whose steps are damped by the norm of all rows, in powers of 2.
        """
        size, node, clock = w.nodes.shape[1], np.asarray(state, float), 1.0
        if node.size:
            clock = float(snapped(w.period / (2 * np.pi)))
        else:
            changes, node = np.square(loop.slopes(w, loop.conditions)).sum(axis=1), np.ones(size)
            if np.all((changes > 1 / WIDE) & (changes < WIDE)):
                return cls.plain(loop, w)
        measures = cls.of(loop, w, w.joined(node, clock, 1.0 / clock, snapped(np.abs(w.free))))
        ends = (len(w.nodes) - 1) * size + np.array([0, size + len(loop.normals)])
        defects, closing, named = np.split(measures.rows, ends)
        rounded = snapped(named, 2.0 if loop.equations.links else WIDE)
        return cls(measures.columns, np.concatenate([defects, snapped(closing), rounded]))

    def matrix(self, jacobian: np.ndarray) -> np.ndarray:
        """The derivatives of the first of the rows, measured."""
        return np.asarray(jacobian * self.columns / self.rows[: len(jacobian), None])

    def linearised(self, system: Linearised) -> Linearised:
        """A linearised loop, measured."""
        if self.even:
            return system
        (count, size, _), inner = system.transitions.shape, system.inner
        state, tail = self.columns[:size], self.columns[count * size :]
        closing, guards = np.split(self.rows[(count - 1) * size :, None], [len(system.tail)])
        if inner is not None:
            inner = inner[0], inner[1] * state / guards, inner[2] * tail / guards
        return Linearised(
            system.transitions * state / state[:, None],
            system.columns * tail / state[:, None],
            system.first * self.columns[: system.first.shape[1]] / closing,
            system.last * state / closing,
            system.tail * tail / closing,
            inner,
        )


def floored(sizes: np.ndarray) -> np.ndarray:
    """Sizes, none of them below a share of the largest or 0."""
    return nonzero(np.maximum(sizes, 1e-3 * sizes.max()))


def control_sizes(strength: np.ndarray, period: float, unused: float = 1.0) -> np.ndarray:
    """Of controls (m) that accelerate by their `strength` (m) in extents, what changes a state by these in a radian of
    the period; a size that is `unused` of those that do not act."""
    acts = strength > 0
    return np.where(acts, 2 * np.pi / period / np.where(acts, strength, 1.0), unused)


HARMONIC = 8.0**0.5
"""The extent of a harmonic motion in its root mean squares."""


def sizes(model: Model, lengths: np.ndarray, states: np.ndarray, period: float) -> np.ndarray:
    """The sizes S (d) of a motion (k x d) over its whole period, none of them 0.

    `lengths` (n) are those of its coordinates, relative to each other. Where those of a mechanical system hardly move,
    or their rates hardly change, a tenth of what the others say at the pace T / 2 pi.
    """
    moved = np.ptp(states, axis=0) / HARMONIC
    if model.rates is not None:
        far = np.abs(states).max(axis=0)
        still = moved < UNFELT * far  # at round-off, which says nothing of how it changes along a family
        return np.asarray(np.where(still, far, alone(np.where(still, 0.0, moved) / lengths, model.angular) * lengths))
    clock, n = period / (2 * np.pi), lengths.size
    far, fast = (float((part / lengths).max(initial=0.0)) for part in (moved[:n], moved[n:]))
    far, fast = max(far, LEAST_SHARE * fast * clock), max(fast, LEAST_SHARE * far / clock)
    if not (np.isfinite(far) and far > 0.0):
        far, fast = 1.0, 1.0 / clock
    return np.concatenate([far * lengths, fast * lengths])
