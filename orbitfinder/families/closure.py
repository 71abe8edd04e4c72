"""The closure of a family's orbits by independent means: another formulation, another integrator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from orbitfinder.mechanics.canonical import canonical
from orbitfinder.mechanics.catalogue import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.reference import TIGHTEST, integrate
from orbitfinder.reference import vector_field as numpy_field

CHECKED = replace(TIGHTEST, max_evaluations=100_000)
"""Ten times what a tame period needs at the finest of `LONGEST_STEPS`."""
LONGEST_STEPS = (np.inf, 1 / 400, 1 / 1600)
"""Longest steps of the check, in periods, each tried only when the one before says that the orbit does not close."""


class ClosureCheck(Protocol):
    """The largest gap round the loop of an orbit; `allowed` is what will be asked of it."""

    def __call__(
        self, state: np.ndarray, period: float, turns: np.ndarray, allowed: float = 0.0,
        free: Mapping[str, float] | None = None,
    ) -> float:
        """The gap, in rad and rad/s."""


def closure_check(model: Model) -> ClosureCheck:
    """The closure of orbits by independent means, at the model's parameters or at freed ones.

    Hamilton's equations, derived from the energies alone, by SciPy's adaptive DOP853 at its tightest.
    """
    n = model.degrees_of_freedom
    prepared: list[tuple[dict[str, float], Any, Any]] = [({}, *_hamiltonian(model))]

    def check(
        state: np.ndarray, period: float, turns: np.ndarray, allowed: float = 0.0,
        free: Mapping[str, float] | None = None,
    ) -> float:
        if prepared[0][0] != dict(free or {}):
            prepared[0] = (dict(free or {}), *_hamiltonian(with_parameters(model, free or {})))
        _, field, momentum = prepared[0]
        start, gap = np.concatenate([state[:n], momentum(state[:n], state[n:]).full().ravel()]), np.inf
        for longest in LONGEST_STEPS:
            end = integrate(field, start, np.array([0.0, period]), CHECKED, longest * period)[-1]
            moved = end[:n] - state[:n] - 2 * np.pi * turns
            gap = float(max(np.abs(moved).max(), np.abs(field(0.0, end)[:n] - state[n:]).max()))
            if gap <= 0.5 * allowed:
                break
        return gap

    return check  # type: ignore[return-value]


def _hamiltonian(model: Model) -> tuple[Any, Any]:
    equations = canonical(model)
    return numpy_field(equations.field), equations.momentum
