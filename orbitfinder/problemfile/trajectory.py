"""Trajectories in CSV files: columns t, then the 2n states, SI units, one header line allowed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.loops.problem import Guess
from orbitfinder.records.reading import file_bytes


def read_trajectory(folder: Path, name: str, size: int) -> Guess:
    """A Guess from a CSV file in `folder` (or below it) with `size` states; its time span is the period."""
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
            raise InputError(f"guess.csv: {name!r} line {number}: {len(row)} columns; give {size + 1} (t, then states)")
        rows.append(row)
    table = np.asarray(rows, float)
    if len(rows) < 2:
        raise InputError(f"guess.csv: {name!r} has {len(rows)} rows of numbers; give one period with at least 2")
    if not np.all(np.isfinite(table)):
        raise InputError(f"guess.csv: {name!r} must be finite; replace NaN and infinity by numbers")
    if np.any(np.diff(table[:, 0]) <= 0):
        raise InputError(f"guess.csv: {name!r}: times must increase from row to row; sort them")
    return table
