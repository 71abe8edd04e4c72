"""Orbits over a rectangle of a plane of two parameters, each continued from its neighbour, many beside each other.

A pixel's orbit is predicted by a polynomial through the last ones of a row or column that leads to it, and corrected.
What does not converge is tried again in shorter steps, and then from each other side on which an orbit is known.
Pixels do not depend on how many are marched together, nor on who does it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from orbitfinder._runtime import limit
from orbitfinder._runtime.cluster import home
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.motion import graded
from orbitfinder.families.plane import BLANK, DIVERGED, ELSEWHERE, ENDLESS, RESTING, UNTRIED
from orbitfinder.families.point import FamilySettings, extents
from orbitfinder.families.stability import spectrum
from orbitfinder.families.start import curve_of
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.extent import extent
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import Curve, Solution, correct_each
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.watch import range_of
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.floquet import STABILITIES
from orbitfinder.orbits.refine import STANDSTILL
from orbitfinder.records.codec import plain

BEHIND, TRIES, FAR, SIDES = 4, (1, 4, 16), 0.1, ((0, -1), (0, 1), (-1, 0), (1, 0))
"""Orbits behind a pixel that a prediction goes by, at most; steps in which it is reached from its neighbour, try after
try; a node or period farther than this from what was predicted, relative to the motion, is another orbit's; where
neighbours are, in the order in which they are asked"""
Place = tuple[np.ndarray, Unknowns]
"""Values of the two parameters, and the orbit there"""


@dataclass(frozen=True)
class PixelBlock:
    """A rectangle of pixels: unknowns (R x C x w) with what was read off each orbit (R x C x 3 + n: its largest
    multiplier, the number of its verdict, amplitudes), `blank` (R x C, see `plane.BLANK`) and from which `SIDES` each
    was tried (R x C, bits)."""

    vectors: np.ndarray
    numbers: np.ndarray
    blank: np.ndarray
    tried: np.ndarray

    @classmethod
    def empty(cls, shape: tuple[int, int], width: int, numbers: int) -> PixelBlock:
        """One without orbits."""
        blank, tried = np.full(shape, UNTRIED), np.zeros(shape, int)
        return cls(np.zeros((*shape, width)), np.zeros((*shape, numbers)), blank, tried)

    def part(self, rows: slice, columns: slice) -> PixelBlock:
        """A copy of a part."""
        return PixelBlock(*(array[rows, columns].copy() for array in vars(self).values()))

    def frontier(self) -> np.ndarray:
        """For each pixel without an orbit the sides (R x C x 4) on which an orbit is known and was not tried from."""
        known = np.pad(self.blank == 0, 1)
        r, c = self.blank.shape
        near = np.stack([known[1 + i : 1 + i + r, 1 + j : 1 + j + c] for i, j in SIDES], axis=2)
        fresh = (self.tried[..., None] >> np.arange(len(SIDES)) & 1) == 0
        return np.asarray(near & fresh & (self.blank != 0)[..., None])

    def matrix(self, rows: slice, columns: slice, before: PixelBlock) -> np.ndarray:
        """What of a part has changed, a row a pixel: its row and column, `blank`, `tried`, vector, numbers."""
        changed = np.zeros(self.blank.shape, bool)
        changed[rows, columns] = ((self.tried != before.tried) | (self.blank != before.blank))[rows, columns]
        i, j = np.nonzero(changed)
        return np.column_stack([i, j, self.blank[i, j], self.tried[i, j], self.vectors[i, j], self.numbers[i, j]])

    def fill(self, matrix: np.ndarray) -> None:
        """Write such rows back. Raises `ValueError`."""
        least, most = np.zeros(4), [*np.array(self.blank.shape) - 1, len(BLANK) - 1, 2 ** len(SIDES) - 1]
        if not np.all((matrix[:, :4] >= least) & (matrix[:, :4] <= most)) or np.isnan(matrix).any():
            raise ValueError(f"a pixel outside {self.blank.shape[0]} x {self.blank.shape[1]}, or no number")
        (i, j, blank, tried), rest = matrix[:, :4].astype(int).T, matrix[:, 4:]
        self.blank[i, j], self.tried[i, j] = blank, tried
        self.vectors[i, j], self.numbers[i, j] = np.split(rest, [self.vectors.shape[2]], axis=1)


class ParameterPlane:
    """A family in a plane of two parameters: its curve, the mesh of its orbits, values across (C) and up (R)."""

    def __init__(
        self, curve: Curve, parameters: tuple[str, str], axes: tuple[np.ndarray, np.ndarray], mesh: np.ndarray,
        shape: tuple[int, int], entry: Mapping[str, Any],
    ) -> None:  # fmt: skip
        self.curve, self.parameters, self.axes, self.mesh, self.shape = curve, parameters, axes, mesh, shape
        self.entry = entry
        self._pins = [pinned(curve.equations, name, 0.0) for name in parameters]
        self._spans = np.array([nonzero(float(np.ptp(axis))) for axis in axes])

    @cached_property
    def place(self) -> Unknowns:
        """Unknowns of the orbits' size."""
        return self.curve.equations.unknowns(np.zeros(self.shape), 1.0, self.mesh)

    def unknowns(self, vector: np.ndarray, values: np.ndarray) -> Unknowns:
        """The unknowns of a vector, with the parameters of these values."""
        vector, free = vector.copy(), self.curve.equations.free
        for name, value in zip(self.parameters, values, strict=True):
            if name in free:
                vector[vector.size - len(free) + free.index(name)] = value
        return self.place.at(vector)

    def corrected(self, guesses: Sequence[Unknowns], values: np.ndarray) -> list[Solution | int]:
        """The orbits near guesses at values (k x 2) of the parameters; where there is none, why."""
        both = [[replace(pin, value=float(x)) for pin, x in zip(self._pins, value, strict=True)] for value in values]
        curves = [replace(self.curve, conditions=(*self.curve.conditions, first)) for first, _ in both]
        made: list[Solution | int] = []
        for guess, result in zip(guesses, correct_each(curves, guesses, [aim for _, aim in both], np.inf), strict=True):
            if isinstance(result, IntegrationError):
                made.append(ENDLESS)
            elif isinstance(result, ConvergenceError):
                made.append(DIVERGED)
            else:
                states = result.march.states
                still = np.ptp(states, axis=0).max() <= STANDSTILL * np.abs(states).max()
                moved = np.abs(result.place.nodes - guess.nodes).max(axis=0) / nonzero(extents(self.curve, states))
                near = max(moved.max(), abs(result.place.period / guess.period - 1.0)) <= FAR
                made.append(RESTING if still else result if near else ELSEWHERE)
        return made

    def reached(
        self, ways: Sequence[Sequence[Place]], targets: np.ndarray, tries: Sequence[int] = TRIES
    ) -> list[Solution | int]:
        """Orbits at values (k x 2), each from the last ones of a way to it; where there is none, why."""
        made: list[Solution | int] = [UNTRIED] * len(ways)
        for steps in tries:
            left = [k for k, result in enumerate(made) if isinstance(result, int) and result != RESTING]
            going = {k: list(ways[k] if steps == 1 else ways[k][-1:]) for k in left}
            begun = {k: ways[k][-1][0] for k in left}
            for step in range(1, steps + 1):
                goals = {k: begun[k] + step / steps * (targets[k] - begun[k]) for k in going}
                if not goals:
                    break
                goals = {k: targets[k] for k in goals} if step == steps else goals
                guesses = [self._predicted(going[k], goal) for k, goal in goals.items()]
                for k, result in zip(list(goals), self.corrected(guesses, np.array(list(goals.values()))), strict=True):
                    made[k] = result
                    if isinstance(result, int):
                        del going[k]
                    else:
                        going[k] = [*going[k], (goals[k], result.place)][-BEHIND:]
        return made

    def _predicted(self, way: Sequence[Place], goal: np.ndarray) -> Unknowns:
        """The polynomial through the last orbits of a straight way at values on it."""
        places = np.array([values for values, _ in way]) / self._spans
        start, end = places[-1], goal / self._spans
        along = (places - start) @ (end - start) / nonzero(float((end - start) @ (end - start)))
        weights = [np.prod([(1.0 - b) / (a - b) for b in np.delete(along, k)]) for k, a in enumerate(along)]
        return self.unknowns(np.asarray(weights) @ np.array([w.vector for _, w in way]), goal)

    def numbers(self, solutions: Sequence[Solution]) -> list[np.ndarray | int]:
        """Largest multiplier (re, im), verdict, amplitudes (n) of orbits; why not where there are none."""
        read: list[np.ndarray | int] = []
        for solution, sizes in zip(solutions, self._amplitudes(solutions), strict=True):
            try:
                floquet = spectrum(self.curve, solution).floquet
            except ConvergenceError:  # a multiplier beyond the numbers
                read.append(ENDLESS)
                continue
            first = complex(*floquet.multipliers[:1])
            read.append(np.array([first.real, first.imag, STABILITIES.index(floquet.stability), *sizes]))
        return read

    def _amplitudes(self, solutions: Sequence[Solution]) -> np.ndarray:
        """Half the range of each coordinate (k x n) over the whole period."""
        p = self.curve.equations
        n = p.model.degrees_of_freedom
        if p.links or p.gridded or not solutions:
            every = [graded(self.curve, solution) for solution in solutions]
            return np.array([np.ptp(range_of(times, states[:, :n]), axis=0) / 2 for times, states in every])
        both = [p.symmetry.whole(s.place.mesh, s.march.states, self.curve.constant) for s in solutions]
        times = np.array([s.place.period * mesh for s, (mesh, _) in zip(solutions, both, strict=True)])
        states = np.array([path for _, path in both])
        tails = np.repeat([s.place.tail for s in solutions], times.shape[1], axis=0)
        rates = p.march.rates(states.reshape(-1, p.size), tails, times.ravel()).reshape(states.shape)
        return np.asarray(np.ptp(extent(times, states[..., :n], rates[..., :n]), axis=1) / 2)

    def flood(self, block: PixelBlock, rows: slice, columns: slice, origin: tuple[int, int]) -> None:
        """Fill a part of a block, whose first pixel is the plane's `origin`, from the orbits beside it that are known,
        until nothing is left to try."""
        inside = np.zeros(block.blank.shape, bool)
        inside[rows, columns] = True
        while True:
            limit.check()
            sides = block.frontier() & inside[..., None]
            pixels = np.argwhere(sides.any(axis=2))
            if not len(pixels):
                return
            ways = []
            for pixel in pixels:
                open_sides = np.flatnonzero(sides[*pixel])
                every = [list(self._behind(block, pixel, int(side), origin)) for side in open_sides]
                best = max(range(len(every)), key=lambda k: len(every[k]))
                block.tried[*pixel] |= 1 << int(open_sides[best])
                ways.append(every[best][::-1])
            targets = np.array([self._values(pixel, origin) for pixel in pixels])
            self._take(block, pixels, self.reached(ways, targets))

    def _take(self, block: PixelBlock, pixels: np.ndarray, results: Sequence[Solution | int]) -> None:
        solved = [result for result in results if isinstance(result, Solution)]
        read = iter(self.numbers(solved))
        for pixel, result in zip(pixels, results, strict=True):
            numbers = result if isinstance(result, int) else next(read)
            if isinstance(result, Solution) and isinstance(numbers, np.ndarray):
                block.blank[*pixel], block.vectors[*pixel], block.numbers[*pixel] = 0, result.place.vector, numbers
            else:
                block.blank[*pixel] = numbers

    def seed(self, block: PixelBlock, pixel: tuple[int, int], start: Place) -> None:
        """Put the orbit at the pixel of a whole block that a way from a first orbit leads to."""
        target = self._values(np.array(pixel), (0, 0))
        result = self.reached([[start]], target[None], (1, 4, 16, 64))
        self._take(block, np.array([pixel]), result)

    def _values(self, pixel: np.ndarray, origin: tuple[int, int]) -> np.ndarray:
        return np.array([self.axes[0][pixel[1] + origin[1]], self.axes[1][pixel[0] + origin[0]]])

    def _behind(self, block: PixelBlock, pixel: np.ndarray, side: int, origin: tuple[int, int]) -> Iterator[Place]:
        """The orbits next to a pixel on a side, the nearest first."""
        for steps in range(1, BEHIND + 1):
            there = pixel + steps * np.array(SIDES[side])
            if np.any(there < 0) or np.any(there >= block.blank.shape) or block.blank[*there]:
                return
            values = self._values(there, origin)
            yield values, self.unknowns(block.vectors[*there], values)


def described(
    system: Mapping[str, Any], folder: str | None, entry: Mapping[str, Any], parameters: tuple[str, str],
    axes: tuple[np.ndarray, np.ndarray], mesh: np.ndarray, segments: int,
) -> str:  # fmt: skip
    """A plane as text that travels to another process; `entry` is that of its curve, of so many segments."""
    return json.dumps(plain({"system": system, "folder": folder, "curve": entry, "parameters": parameters,
                             "axes": axes, "mesh": mesh, "segments": segments}))  # fmt: skip


def plane_of(text: str, model: Model | None = None) -> ParameterPlane:
    """The plane of such a text."""
    known = json.loads(text)
    folder, parameters = known["folder"], tuple(known["parameters"])
    model = model or build_model(known["system"], home(folder))
    curve = curve_of(known["curve"], model, FamilySettings(parameter=parameters[0]))
    axes, shape = [np.array(axis) for axis in known["axes"]], (known["segments"], curve.equations.size)
    return ParameterPlane(curve, parameters, (axes[0], axes[1]), np.array(known["mesh"]), shape, known["curve"])


_prepared = lru_cache(maxsize=2)(plane_of)


@one_thread()
def flooded(
    plane: ParameterPlane | str, block: PixelBlock, origin: tuple[int, int], rows: slice, columns: slice
) -> np.ndarray:
    """What filling a part of a block, cut out of a plane at an `origin`, changes: rows of `PixelBlock.matrix`."""
    before = block.part(slice(None), slice(None))
    (_prepared(plane) if isinstance(plane, str) else plane).flood(block, rows, columns, origin)
    matrix = block.matrix(rows, columns, before)
    matrix[:, :2] += origin
    return matrix
