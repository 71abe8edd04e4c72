"""The controls of a controlled orbit over its period, for other programs: feed-forward in C99 and in Python."""

from __future__ import annotations

import json

import numpy as np

from orbitfinder._runtime import __version__
from orbitfinder._runtime.inert import inert
from orbitfinder.exports.source import c_number, c_numbers, word_of
from orbitfinder.loops.control import basis_of, pieces
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import Orbit


def control_files(orbit: Orbit, model: Model) -> dict[str, str]:
    """NAME_control.c and NAME_control.py of a controlled orbit, and their texts."""
    del model
    assert orbit.control is not None
    entry, word, series = orbit.control, word_of(orbit.name), basis_of(orbit.control).degree < 0
    whole = np.array([0.0, orbit.period]), np.array(entry["coefficients"], float)[None]
    edges, table = whole if series else pieces(entry, orbit.period)
    meaning = "the mean, then cosine and sine of each harmonic of the period" if series else (
        "the powers of the share s of the piece")  # fmt: skip
    lines = [inert(line, "comment") for line in (
        f"Controls {', '.join(entry['names'])} of {orbit.name!r} (period {orbit.period!r} s), without feedback.",
        f"Written by orbitfinder {__version__}.",
        f"Of each piece and control: {meaning}.",
    )]  # fmt: skip
    return {f"{word}_control.c": _c(word, lines, edges, table, series),
            f"{word}_control.py": _python(lines, edges, table, series)}  # fmt: skip


def _c(word: str, lines: list[str], edges: np.ndarray, table: np.ndarray, series: bool) -> str:
    count, terms = table.shape[1:]
    body = (
        f"""u[j] = c[0];
    for (i = 1; i < {terms}; i += 2)
      u[j] += c[i] * cos({np.pi!r} * (i + 1) * s) + c[i + 1] * sin({np.pi!r} * (i + 1) * s);"""
        if series
        else f"""u[j] = 0.0;
    for (i = {terms - 1}; i >= 0; i--) u[j] = u[j] * s + c[i];"""
    )
    rows = ",\n".join(f"  {{{', '.join(f'{{{c_numbers(row)}}}' for row in piece)}}}" for piece in table)
    heading = "\n   ".join(lines)
    return f"""/* {heading} */
#include <math.h>

enum {{ {word}_controls = {count}, {word}_pieces = {len(table)} }};

const double {word}_period = {c_number(edges[-1])};
static const double {word}_begins[{len(edges)}] = {{{c_numbers(edges)}}};
static const double {word}_table[{len(table)}][{count}][{terms}] = {{
{rows}
}};

/* The controls u at t seconds after the period began. */
void {word}_control(double t, double *u)
{{
  double tau = fmod(t, {word}_period), s;
  int i, j, k = 0;
  if (tau < 0) tau += {word}_period;
  while (k + 1 < {word}_pieces && tau >= {word}_begins[k + 1]) k++;
  s = (tau - {word}_begins[k]) / ({word}_begins[k + 1] - {word}_begins[k]);
  for (j = 0; j < {word}_controls; j++) {{
    const double *c = {word}_table[k][j];
    {body}
  }}
}}
"""


def _python(lines: list[str], edges: np.ndarray, table: np.ndarray, series: bool) -> str:
    body = (
        """[
        c[0]
        + sum(
            c[i] * math.cos(math.pi * (i + 1) * s) + c[i + 1] * math.sin(math.pi * (i + 1) * s)
            for i in range(1, len(c), 2)
        )
        for c in TABLE[k]
    ]"""
        if series
        else "[sum(a * s**i for i, a in enumerate(c)) for c in TABLE[k]]"
    )
    heading = "".join(f"# {line}\n" for line in lines)
    return f'''{heading}
import math
import sys

BEGINS = [{c_numbers(edges)}]
TABLE = {json.dumps(table.tolist())}


def control(t):
    """The controls at t seconds after the period began."""
    tau, k = math.fmod(t, BEGINS[-1]), 0
    tau += BEGINS[-1] * (tau < 0)
    while k + 1 < len(TABLE) and tau >= BEGINS[k + 1]:
        k += 1
    s = (tau - BEGINS[k]) / (BEGINS[k + 1] - BEGINS[k])
    return {body}


if __name__ == "__main__":
    try:
        (time,) = map(float, sys.argv[1:])
    except ValueError:
        sys.exit(f"usage: {{sys.argv[0]}} seconds-after-the-period-began")
    print(*map(repr, control(time)))
'''
