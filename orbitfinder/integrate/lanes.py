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

from orbitfinder.integrate.buffered import Buffered

LANES = max(1, min(4, os.cpu_count() or 1))
CHUNK = 64
"""Columns that are evaluated in one call where they do not depend on each other"""
WORTH = 8000.0
"""Operations of a lane, in components times Runge-Kutta stages, that are worth handing them to a thread"""
INTERPRETED = 8.0
"""How many times longer they take interpreted"""
STAGES = 12


@lru_cache(maxsize=256)
def _along(step: ca.Function, steps: int, lane: int) -> Buffered:
    """All steps of one segment."""
    return Buffered(step.mapaccum("march", steps) if steps > 1 else step)


@lru_cache(maxsize=64)
def _across(function: ca.Function, lane: int) -> Buffered:
    return Buffered(function.map(CHUNK))


@lru_cache(maxsize=128)
def _single(function: ca.Function) -> Buffered:
    return Buffered(function)


def called(function: ca.Function, *arguments: np.ndarray | float) -> list[np.ndarray]:
    """A function at one place, its outputs as CasADi has them (rows x columns)."""
    return [one.T for one in _single(function)(*arguments)]


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(max(1, LANES - 1), thread_name_prefix="orbitfinder-lane")


def marched(step: ca.Function, starts: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Every step's result (M x ...), segment after segment; `parameters` (M x ...) of each step."""
    count, steps = len(starts), len(parameters) // len(starts)
    lanes = _lanes(step, count, steps * STAGES)
    walks = [_along(step, steps, lane) for lane in range(lanes)]

    def walked(lane: int) -> list[np.ndarray]:
        mine = range(lane, count, lanes)
        return [walks[lane](starts[k], parameters[k * steps : (k + 1) * steps])[0] for k in mine]

    return np.concatenate(_shared(walked, lanes, count))


def evaluated(function: ca.Function, stages: int, *arguments: np.ndarray) -> np.ndarray:
    """A function of so many stages at k places (k x ...), in chunks of equal size, so that one map serves every k."""
    count = len(arguments[0])
    begins = range(0, count, CHUNK)
    lanes = _lanes(function, len(begins), CHUNK * stages)
    maps = [_across(function, lane) for lane in range(lanes)]

    def filled(lane: int) -> list[np.ndarray]:
        found = []
        for begin in begins[lane::lanes]:
            rows = np.minimum(np.arange(begin, begin + CHUNK), count - 1)
            found.append(maps[lane](*(one[rows] for one in arguments))[0])
        return found

    return np.concatenate(_shared(filled, lanes, len(begins)))[:count]


def _lanes(function: ca.Function, pieces: int, evaluations: int) -> int:
    """How many lanes so many pieces of work are shared between."""
    work = evaluations * function.size1_out(0) * (1.0 if function.is_a("External") else INTERPRETED)
    return min(LANES, pieces) if work >= WORTH else 1


def _shared(task: Callable[[int], list[np.ndarray]], lanes: int, pieces: int) -> list[np.ndarray]:
    """The pieces in order, piece k being computed in lane k modulo `lanes`."""
    if lanes == 1:
        return task(0)
    others = [_pool().submit(task, lane) for lane in range(1, lanes)]
    found = [task(0), *(one.result() for one in others)]
    return [found[k % lanes][k // lanes] for k in range(pieces)]
