"""The closure of a family's orbits by independent means: another formulation, another integrator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from orbitfinder.integrate.dop853 import TIGHTEST, integrate
from orbitfinder.integrate.dop853 import vector_field as numpy_field
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.mechanics.hamilton import canonical
from orbitfinder.mechanics.model import Model

CHECKED = replace(TIGHTEST, max_evaluations=100_000)
"""Ten times what a tame period needs at the finest of `LONGEST_STEPS`."""
PIECE_STEPS = 40
"""A piece between two nodes is integrated in at least so many steps."""
LONGEST_STEPS = (np.inf, 1 / 400, 1 / 1600)
"""Longest steps of the check, in periods, each tried only when the one before says that the orbit does not close."""


class ClosureCheck:
    """The closure of orbits by independent means, at the model's parameters or at freed ones.

    Hamilton's equations, derived from the energies alone, by SciPy's adaptive DOP853 at its tightest.
    """

    def __init__(self, model: Model) -> None:
        self._model, self._at = model, dict[str, float]()
        self._field, self._momentum = _hamiltonian(model)

    def __call__(
        self,
        state: np.ndarray,
        period: float,
        turns: np.ndarray,
        allowed: float = 0.0,
        free: Mapping[str, float] | None = None,
        units: np.ndarray | float = 1.0,
    ) -> float:
        """The largest gap round the loop of an orbit, in `units` (2n); `allowed` is what will be asked of it."""
        n, gap = state.size // 2, np.inf
        for longest in LONGEST_STEPS:
            end = self._end(state, period, longest, free)
            moved = np.concatenate([end[:n] - state[:n] - 2 * np.pi * turns, end[n:] - state[n:]])
            gap = float(np.abs(moved / units).max())
            if gap <= 0.5 * allowed:
                break
        return gap

    def ends(self, nodes: np.ndarray, durations: np.ndarray, free: Mapping[str, float] | None = None) -> np.ndarray:
        """Where each piece of an orbit ends (N x 2n) that begins at a node (N x 2n) and lasts so long (s)."""
        pieces = zip(nodes, durations, strict=True)
        return np.stack([self._end(node, duration, 1 / PIECE_STEPS, free) for node, duration in pieces])

    def _end(self, state: np.ndarray, duration: float, longest: float, free: Mapping[str, float] | None) -> np.ndarray:
        """(q, v) after a time, by steps no longer than a share of it."""
        if self._at != dict(free or {}):
            self._at = dict(free or {})
            self._field, self._momentum = _hamiltonian(with_parameters(self._model, self._at))
        n = state.size // 2
        start = np.concatenate([state[:n], self._momentum(state[:n], state[n:]).full().ravel()])
        end = integrate(self._field, start, np.array([0.0, duration]), CHECKED, longest * duration)[-1]
        return np.concatenate([end[:n], self._field(0.0, end)[:n]])


def closure_check(model: Model) -> ClosureCheck:
    """The independent check of a model's orbits."""
    return ClosureCheck(model)


def _hamiltonian(model: Model) -> tuple[Any, Any]:
    equations = canonical(model)
    return numpy_field(equations.field), equations.momentum
