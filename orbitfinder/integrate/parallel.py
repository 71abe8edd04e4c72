"""Steps of all segments, and functions at many places, on as many processors as there are.

CasADi lets go of Python's lock while it evaluates; functions are built by the calling thread alone. Every lane has
memory of its own, and what it computes does not depend on how many lanes there are.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import casadi as ca
import numpy as np

from orbitfinder._runtime import PROCESSORS
from orbitfinder.errors import InputError, shortened
from orbitfinder.integrate.evaluate import Buffered

if not (asked := os.environ.get(PROCESSORS, "").strip() or str(os.cpu_count() or 1)).isdecimal():
    raise InputError(f"{PROCESSORS}: must be a whole number, got {shortened(repr(asked))}; set one, or unset it")
LANES = max(1, min(4, int(asked[:9])))
CHUNK = 64
"""Columns that are evaluated in one call where they do not depend on each other"""
WORTH = 8000.0
"""Operations of a lane, in components times Runge-Kutta stages, that are worth handing them to a thread"""
INTERPRETED = 8.0
"""How many times longer they take interpreted"""
STAGES = 12


FEW = 16
"""Up to so many columns are evaluated by a map of their own size"""


class Lanes:
    """The marches and evaluations of one owner; one thread at a time, for they have one work space each.

    `alone` keeps them on one processor, where the others have work already.
    """

    def __init__(self, alone: bool = False) -> None:
        self.alone = alone
        self._along = lru_cache(maxsize=256)(_along)
        self._across = lru_cache(maxsize=64)(_across)
        self._single = lru_cache(maxsize=64)(Buffered)

    def called(self, function: ca.Function, *arguments: np.ndarray | float) -> list[np.ndarray]:
        """A function at one place, its outputs as CasADi has them (rows x columns)."""
        return [value.T for value in self._single(function)(*arguments)]

    def marched(self, step: ca.Function, starts: np.ndarray, parameters: np.ndarray, path: bool) -> np.ndarray:
        """Every step's result (M x ...), segment after segment; without `path` the last of each segment (N x ...).

        `starts` (N x ...) of the segments, `parameters` (M x ...) of the steps.
        """
        count, steps = len(starts), len(parameters) // len(starts)
        lanes = 1 if self.alone else _lanes(step, count, steps * STAGES)
        if lanes == 1:
            return self._along(step, steps, count, path, 0)(starts, parameters)[0]
        edges = np.arange(lanes + 1) * count // lanes
        runs = [self._along(step, steps, int(edges[k + 1] - edges[k]), path, k) for k in range(lanes)]

        def run(lane: int) -> list[np.ndarray]:
            begin, end = edges[lane : lane + 2]
            return [runs[lane](starts[begin:end], parameters[begin * steps : end * steps])[0]]

        return np.concatenate(_shared(run, lanes, lanes))

    def evaluated(self, function: ca.Function, stages: int, *arguments: np.ndarray) -> np.ndarray:
        """A function of so many stages at k places (k x ..., the same for all 1 x ...).

        Many of them in chunks, so that one map serves every k.
        """
        count, width = max(map(len, arguments)), CHUNK
        if count <= FEW:
            return self._across(function, count, 0)(*arguments)[0]
        begins = range(0, count, width)
        lanes = 1 if self.alone else _lanes(function, len(begins), width * stages)
        maps = [self._across(function, width, lane) for lane in range(lanes)]

        def filled(lane: int) -> list[np.ndarray]:
            values = []
            for begin in begins[lane::lanes]:
                rows = np.minimum(np.arange(begin, begin + width), count - 1)
                chunk = (argument if len(argument) == 1 else argument[rows] for argument in arguments)
                values.append(maps[lane](*chunk)[0])
            return values

        return np.concatenate(_shared(filled, lanes, len(begins)))[:count]


def _along(step: ca.Function, steps: int, segments: int, path: bool, _lane: int) -> Buffered:
    """All steps of some segments in one call, for one lane."""
    if steps > 1:
        step = step.mapaccum("march", steps) if path else step.fold(steps)
    return Buffered(step if segments == 1 else step.map(segments))


def _across(function: ca.Function, width: int, _lane: int) -> Buffered:
    return Buffered(function.map(width))


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, LANES - 1), thread_name_prefix="orbitfinder-lane")


def _lanes(function: ca.Function, pieces: int, evaluations: int) -> int:
    """How many lanes so many pieces of work are shared between."""
    work = evaluations * function.size1_out(0) * (1.0 if function.class_name() == "External" else INTERPRETED)
    return min(LANES, pieces) if work >= WORTH else 1


def _shared(task: Callable[[int], list[np.ndarray]], lanes: int, pieces: int) -> list[np.ndarray]:
    """The pieces in order, piece k being computed in lane k modulo `lanes`."""
    if lanes == 1:
        return task(0)
    others = [_pool().submit(task, lane) for lane in range(1, lanes)]
    results = [task(0), *(other.result() for other in others)]
    return [results[k % lanes][k // lanes] for k in range(pieces)]
