"""The `[guess]` table of a problem file as a Guess: a state, modes, a simulation, a linkage's angles, a CSV file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError, plural
from orbitfinder.guesses.modes import linkage_equilibrium, linkage_mode, normal_mode
from orbitfinder.guesses.returns import first_return, normal_mode_sum, recurrences
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.chain import maximal_states
from orbitfinder.mechanics.linkage import assemble, dimensions, linkage_rates, linkage_state
from orbitfinder.mechanics.model import Model
from orbitfinder.problemfile.schema import GuessTable
from orbitfinder.records.reading import file_bytes


def guess_from_table(given: GuessTable, model: Model, folder: Path) -> Guess:
    """The starting point that a table stands for; `folder` is where its CSV file may be."""
    if model.constraint is not None and model.system.get("kind") == "linkage":
        return _linkage_guess(given, model, folder)
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


def _linkage_guess(given: GuessTable, model: Model, folder: Path) -> Guess:
    """The starting point of a linkage that a table stands for; a period left out is the first return."""
    if given.csv is not None:
        return read_trajectory(folder, given.csv, len(model.state_names))
    if given.mode is not None:
        if not isinstance(given.mode, int) or not isinstance(given.amplitude, float):
            raise InputError("guess.mode: a linkage takes one mode with one amplitude; give numbers, not lists")
        near = None if given.equilibrium is None else _angles(model, given.equilibrium)
        found = linkage_mode(model, given.mode, given.amplitude, linkage_equilibrium(model, near))
        return found if given.period is None else Guess(found.state, given.period)
    state = _assembled(given, model) if given.angles is not None else _state(model, given.state or [])
    return Guess(state, given.period or first_return(model, state, given.duration or 20.0))


def _angles(model: Model, angles: list[float]) -> np.ndarray:
    bars = dimensions(model)[0].size
    if len(angles) != bars:
        raise InputError(f"guess.equilibrium: {plural(len(angles), 'angle')} for {bars} bars; give one per bar")
    return np.asarray(angles, float)


def _assembled(given: GuessTable, model: Model) -> np.ndarray:
    theta = assemble(model, given.angles or {}, branch=given.branch)
    return linkage_state(model, theta, linkage_rates(model, theta, given.rates) if given.rates else None)


def _state(model: Model, state: list[float]) -> np.ndarray:
    """A state as given, or lifted from link angles and rates."""
    numbers = np.asarray(state, float)
    return maximal_states(model, numbers) if numbers.size == 2 * (model.degrees_of_freedom // 3) else numbers


def read_trajectory(folder: Path, name: str, size: int) -> Guess:
    """A Guess from a CSV file in `folder` (or below it): columns t, then `size` states; its time span is the period."""
    try:
        base = folder.resolve()
        source = (base / name).resolve()
    except (OSError, ValueError, RuntimeError) as error:  # a NUL in the name, links that go round in a circle
        raise InputError(f"guess.csv: {name!r} is no usable path ({error}); put the file beside") from error
    if not source.is_relative_to(base):
        raise InputError(f"guess.csv: {name!r} lies outside the problem file's folder; put the file beside it")
    try:
        lines = file_bytes(source, "CSV file").decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"guess.csv: {name!r} is not UTF-8 text; save it as plain CSV") from error
    except InputError as error:
        raise InputError(f"guess.csv: {error}") from error
    table = _numbers(name, lines, size)
    times = table[:, 0] - table[0, 0]
    return Guess(table[0, 1:].copy(), float(times[-1]), times, table[:, 1:])


def _numbers(name: str, lines: list[str], size: int) -> np.ndarray:
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        try:
            row = [float(entry) for entry in line.split(",")]
        except ValueError as error:
            if number == 1:
                continue
            raise InputError(f"guess.csv: {name!r} line {number}: {error}; give numbers separated by commas") from error
        if len(row) != size + 1:
            raise InputError(
                f"guess.csv: {name!r} line {number}: {plural(len(row), 'column')}; give {size + 1} (t, then states)"
            )
        rows.append(row)
    table = np.asarray(rows, float)
    if len(rows) < 2:
        raise InputError(
            f"guess.csv: {name!r} has {plural(len(rows), 'row')} of numbers; give one period with at least 2"
        )
    if not np.all(np.isfinite(table)):
        raise InputError(f"guess.csv: {name!r} must be finite; replace NaN and infinity by numbers")
    if np.any(np.diff(table[:, 0]) <= 0):
        raise InputError(f"guess.csv: {name!r}: times must increase from row to row; sort them")
    return table
