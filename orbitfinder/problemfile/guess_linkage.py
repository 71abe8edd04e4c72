"""The `[guess]` table of a linkage: some angles and rates by assembly, a mode, a state or a trajectory."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.guesses.equilibria import linkage_equilibrium
from orbitfinder.guesses.modes import linkage_mode
from orbitfinder.guesses.returns import first_return
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.assembly import assemble, linkage_rates
from orbitfinder.mechanics.constrained import ConstrainedModel
from orbitfinder.mechanics.linkage import dimensions, linkage_state
from orbitfinder.mechanics.maximal import maximal_states
from orbitfinder.mechanics.model import Model
from orbitfinder.problemfile.schema import GuessTable
from orbitfinder.problemfile.trajectory import read_trajectory


def linkage_guess(given: GuessTable, model: Model, folder: Path) -> Guess:
    """The starting point of a linkage that a table stands for; a period left out is the first return."""
    native = model.native
    assert native is not None
    if given.csv is not None:
        return read_trajectory(folder, given.csv, len(model.state_names))
    if given.mode is not None:
        if not isinstance(given.mode, int) or not isinstance(given.amplitude, float):
            raise InputError("guess.mode: a linkage takes one mode with one amplitude; give numbers, not lists")
        near = None if given.equilibrium is None else _angles(native, given.equilibrium)
        found = linkage_mode(native, given.mode, given.amplitude, linkage_equilibrium(native, near))
        return found if given.period is None else Guess(found.state, given.period)
    state = _assembled(given, native) if given.angles is not None else _state(native, given.state or [])
    return Guess(state, given.period or first_return(native, state, given.duration or 20.0))


def _angles(native: ConstrainedModel, angles: list[float]) -> np.ndarray:
    bars = dimensions(native)[0].size
    if len(angles) != bars:
        raise InputError(f"guess.equilibrium: {len(angles)} angles for {bars} bars; give one per bar")
    return np.asarray(angles, float)


def _assembled(given: GuessTable, native: ConstrainedModel) -> np.ndarray:
    theta = assemble(native, given.angles or {}, branch=given.branch)
    return linkage_state(native, theta, linkage_rates(native, theta, given.rates) if given.rates else None)


def _state(native: ConstrainedModel, state: list[float]) -> np.ndarray:
    """A state as given, or lifted from link angles and rates."""
    numbers = np.asarray(state, float)
    return maximal_states(native, numbers) if numbers.size == 2 * (native.coordinates // 3) else numbers
