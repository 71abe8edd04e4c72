"""Orbits written for other programs: what there is, and the two plainest, CSV and C99."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.exports.auto import auto_files
from orbitfinder.exports.julia import julia_file
from orbitfinder.exports.source import C, Source, c_number, c_numbers, samples_of, source_of, straight_line
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import write_atomically

C_FILE = """{heading}
#include <math.h>

enum {{ {word}_states = {size}, {word}_parameters = {count}, {word}_unfoldings = {unfolded} }};

/* {parameter_names} */
const double {word}_p[] = {{{p}}};
/* {state_names} at t = 0 */
const double {word}_x0[] = {{{x0}}};
const double {word}_period = {period};

/* dx/dt at time t. s: the fictitious damping that unfolds each first integral, 0 for the system itself
   (not read when there is none); p: physical parameters. */
void {word}_rhs(double t_, const double *x, const double *s, const double *p, double *dx)
{{
  const double t[1] = {{t_}};
  double w[{work}];
  (void)t; (void)s; (void)p;
{body}
}}
"""


def csv_text(state_names: Sequence[str], times: np.ndarray, states: np.ndarray) -> str:
    """A header line, then t (s) and the states; digits that round-trip, as `[guess] csv = ...` reads them back."""
    rows = np.column_stack([times, states]).tolist()
    return "\n".join([",".join(["t", *state_names]), *(",".join(map(repr, row)) for row in rows)]) + "\n"


def c_file(source: Source) -> str:
    """The text of NAME.c: the right-hand side in C99 that needs only <math.h>, with the orbit's numbers."""
    lines, work = straight_line(source.rate, C, ["t", "x", "s", "p"], ["dx"])
    model = source.model
    return C_FILE.format(
        heading="/* " + "\n   ".join(source.heading) + " */",
        word=source.identifier,
        size=2 * model.degrees_of_freedom,
        count=len(model.parameter_names),
        unfolded=len(model.invariants),
        parameter_names=", ".join(model.parameter_names) or "no parameters",
        state_names=", ".join(model.state_names),
        p=c_numbers(model.parameter_values) or "0.0",
        x0=c_numbers(source.orbit.state),
        period=c_number(source.orbit.period),
        work=work,
        body="\n".join(f"  {line}" for line in lines),
    )


def csv_file(orbit: Orbit, model: Model) -> dict[str, str]:
    """NAME.csv: the samples of an orbit of any system."""
    return {f"{orbit.name}.csv": csv_text(model.state_names, *samples_of(orbit, model))}


def _program(write: Callable[[Source], dict[str, str]]) -> Callable[[Orbit, Model], dict[str, str]]:
    """The files that take the equations too."""
    return lambda orbit, model: write(source_of(orbit, model))


FORMATS: dict[str, Callable[[Orbit, Model], dict[str, str]]] = {
    "csv": csv_file,
    "auto": _program(auto_files),
    "julia": _program(lambda source: {f"{source.identifier}.jl": julia_file(source)}),
    "c": _program(lambda source: {f"{source.identifier}.c": c_file(source)}),
}


def export_orbit(orbit: Orbit, to: str, folder: str | Path, model: Model | None = None) -> list[Path]:
    """Write an orbit for `to` (csv | auto | julia | c) into a folder; returns the paths.

    `model` is needed only for systems that no file describes. Raises `InputError`.
    """
    if to not in FORMATS:
        raise InputError(f"to: unknown format {to!r}; use one of {', '.join(FORMATS)}")
    files = FORMATS[to](orbit, model or build_model(orbit.system))
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_atomically(target / name, text.encode())
    return [target / name for name in files]
