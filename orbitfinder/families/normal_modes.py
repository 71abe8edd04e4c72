"""Families born at an equilibrium: its linear normal modes, by Lyapunov's centre theorem.

To every imaginary pair of eigenvalues i w of an equilibrium of a conservative system, of which no
other is an integer multiple, belongs a family of periodic orbits whose period tends to 2 pi / w and
whose shape to the linear mode (A. M. Lyapunov, 1907; K. R. Meyer, D. C. Offin, Introduction to
Hamiltonian Dynamical Systems and the N-Body Problem (2017), section 9.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.guesses import modes as guesses
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.symmetry import QUARTER
from orbitfinder.mechanics.model import Model

AMPLITUDE = 0.02
"""Largest deviation (rad or m) at which a family is begun, unless said otherwise."""


@dataclass(frozen=True)
class NormalModes:
    """Linear modes of an equilibrium: squared frequencies (n, rad^2/s^2, rising) and shapes (n x n, columns)."""

    equilibrium: np.ndarray
    squared: np.ndarray
    shapes: np.ndarray

    @property
    def centres(self) -> tuple[int, ...]:
        """Positions of the modes that oscillate."""
        return tuple(int(k) for k in np.flatnonzero(self.squared > 1e-12 * np.abs(self.squared).max(initial=0.0)))

    @property
    def frequencies(self) -> np.ndarray:
        """Angular frequencies (rad/s) of the modes that oscillate, slowest first."""
        return np.sqrt(self.squared[list(self.centres)])

    @property
    def resonant(self) -> tuple[tuple[int, int], ...]:
        """Pairs (i, j) of oscillating modes, from 1, with w_j an integer multiple of w_i: the theorem's exception."""
        w = self.frequencies
        ratios = [(i, j, w[j] / w[i]) for i in range(w.size) for j in range(w.size) if i != j]
        return tuple((i + 1, j + 1) for i, j, ratio in ratios if ratio > 0.5 and abs(ratio - round(ratio)) < 1e-9)


def equilibria(model: Model) -> list[np.ndarray]:
    """The 2^n equilibria of a chain, every link hanging or upright, hanging first. Raises `InputError`."""
    if model.system.get("kind") != "chain":
        raise InputError("equilibria: known in advance for chains only; give the equilibrium's coordinates")
    return [np.pi * np.array(choice, float) for choice in product((0, 1), repeat=model.degrees_of_freedom)]


def normal_modes(model: Model, equilibrium: Sequence[float] | np.ndarray | None = None) -> NormalModes:
    """Linear modes of an equilibrium (default: q = 0). Raises `InputError` where the forces do not vanish."""
    place = np.zeros(model.degrees_of_freedom) if equilibrium is None else np.asarray(equilibrium, float)
    squared, shapes = guesses.normal_modes(model, place)
    return NormalModes(place, np.asarray(squared), np.asarray(shapes))


def mode_problem(
    model: Model,
    mode: int,
    amplitude: float = AMPLITUDE,
    equilibrium: Sequence[float] | np.ndarray | None = None,
    name: str | None = None,
) -> Problem:
    """The Problem that starts the family of a mode, in the quarter-period formulation.

    `mode` counts the oscillating modes of the equilibrium from 1, slowest first. Raises `InputError`.
    """
    modes = normal_modes(model, equilibrium)
    if isinstance(mode, bool) or not 1 <= mode <= len(modes.centres):
        raise InputError(
            f"mode: must be between 1 and {len(modes.centres)}, got {mode}; this equilibrium has "
            f"{len(modes.centres)} oscillating modes out of {model.degrees_of_freedom}"
        )
    guess = guesses.normal_mode(model, modes.centres[mode - 1] + 1, amplitude, equilibrium)
    return Problem(model, guess, symmetry=QUARTER.name, name=name or f"mode-{mode}")
