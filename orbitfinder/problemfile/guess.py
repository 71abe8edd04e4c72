"""The `[guess]` table of a problem file as a Guess."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.guesses.modes import normal_mode
from orbitfinder.guesses.returns import normal_mode_sum, recurrences
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.model import Model
from orbitfinder.problemfile.guess_linkage import linkage_guess
from orbitfinder.problemfile.schema import GuessTable
from orbitfinder.problemfile.trajectory import read_trajectory


def guess_from_table(given: GuessTable, model: Model, folder: Path) -> Guess:
    """The starting point that a table stands for; `folder` is where its CSV file may be."""
    if model.native is not None and model.system.get("kind") == "linkage":
        return linkage_guess(given, model, folder)
    linkage_keys = [key for key in ("angles", "branch", "rates", "equilibrium") if getattr(given, key) is not None]
    if linkage_keys:
        raise InputError(f"guess.{linkage_keys[0]}: is for linkages only; give state and period, mode or csv")
    if given.csv is not None:
        return read_trajectory(folder, given.csv, len(model.state_names))
    if given.mode is not None and given.amplitude is not None:
        if isinstance(given.mode, int) and isinstance(given.amplitude, float):
            return normal_mode(model, given.mode, given.amplitude)
        modes = given.mode if isinstance(given.mode, list) else [given.mode]
        sizes = given.amplitude if isinstance(given.amplitude, list) else [given.amplitude]
        return normal_mode_sum(model, modes, sizes)
    state = np.asarray(given.state, float)
    if given.duration is None:
        return Guess(state, float(given.period or 0.0))
    found = recurrences(model, state, given.duration, 1)
    if not found:
        raise InputError(
            f"guess.duration: the motion never came back near itself in {given.duration:g} s; simulate longer"
        )
    return found[0].guess
