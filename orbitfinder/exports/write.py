"""Orbits written for other programs: what there is, and the two plainest, CSV and C99."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.exports.auto import auto_files
from orbitfinder.exports.source import JULIA, C, Source, c_number, c_numbers, samples_of, source_of, straight_line
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.records.orbit import Orbit, refuse_controlled
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
        size=len(model.state_names),
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
    """Write an orbit for another program.

    Args:
        orbit: what to write.
        to: csv | auto | julia | c.
        folder: where.
        model: needed only for systems that no file describes.

    Returns:
        The paths.

    Raises:
        InputError: for an unknown program and equations that it has no words for.

    Examples:
        >>> [path.name for path in of.export_orbit(orbit, "csv", ".")]
        ['fast-swing.csv']
    """
    if to not in FORMATS:
        raise InputError(f"to: unknown format {to!r}; use one of {', '.join(FORMATS)}")
    if to != "csv":
        refuse_controlled(orbit, "to")
    model = model or build_model(orbit.system)
    if model.hybrid is not None and to != "csv":
        raise InputError(f"to: {to} files know no events, and this system is hybrid; use csv")
    files = FORMATS[to](orbit, model)
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        write_atomically(target / name, text.encode())
    return [target / name for name in files]


# --------------------------------------------------------------------------------------------------
# A Julia file for users of BifurcationKit.jl: right-hand side, parameters, the orbit as a guess.
# Its syntax is checked against a grammar and its arithmetic through the same emitter in Python and C; no
# Julia was at hand to run it. The calls in its comment are those of BifurcationKit's own tutorials.


UNFOLDING = "unfolding"
SAMPLES = 201
"""Columns of the orbit that the file carries."""

FILE = """{heading}
#
# Plain Julia without packages: include it, then
#   {module}.rhs!(du, u, par, t)   right-hand side, u = ({states})
#   {module}.par                   parameters; {unfolding_note}
#   {module}.period, .u0           the orbit: minimal period (s) and state at t = 0
#   {module}.times, .orbit         one period, a state per column
#
# With BifurcationKit.jl 0.4 or newer and OrdinaryDiffEq.jl the orbit starts a branch by collocation:
#   using BifurcationKit, OrdinaryDiffEq
#   include("{file}"); using .{module}: rhs!, par, u0, period
#   prob = BifurcationProblem(rhs!, u0, par, (@optic _.{varied}))
#   sol = solve(ODEProblem(rhs!, u0, (0.0, period), par), Vern9(); abstol = 1e-13, reltol = 1e-13)
#   coll, guess = generate_ci_problem(PeriodicOrbitOCollProblem(60, 4), prob, sol, period)
#   branch = continuation(coll, guess, PALC(), ContinuationPar(p_min = {low}, p_max = {high}))
module {module}

const par = ({parameters},)
const period = {period}
const u0 = [{u0}]

function rhs!(du, u, par, t = 0.0)
    s = ({unfoldings})
    p = values(par)
    w = similar(du, {work})
{body}
    return du
end

const times = [{times}]
const orbit = [
{columns}
]'

end
"""


def julia_file(source: Source) -> str:
    """The text of NAME.jl: one module that needs no package."""
    lines, work = straight_line(source.rate, JULIA, ["(t,)", "u", "s", "p"], ["du"])
    names, count = [*source.model.parameter_names], len(source.model.invariants)
    unfoldings = [UNFOLDING] if count < 2 else [f"{UNFOLDING}{k + 1}" for k in range(count)]
    if count == 0:
        lines += [f"du[{i + 1}] += par.{UNFOLDING} * u[{i + 1}]" for i in source.rates]
    values = [*map(float, source.model.parameter_values), *([0.0] * len(unfoldings))]
    start = 0.0 if count or not names else values[0]
    places = np.unique(np.linspace(0, len(source.times) - 1, SAMPLES).round().astype(int))
    return FILE.format(
        heading="\n".join(f"# {line}" for line in source.heading),
        module=_module(source),
        file=f"{source.identifier}.jl",
        states=", ".join(source.model.state_names),
        unfolding_note=f"{UNFOLDING} is a fictitious damping, 0 on orbits of the system",
        varied=unfoldings[0] if count or not names else names[0],
        low=c_number(start - 1.0),
        high=c_number(start + 1.0),
        parameters=", ".join(f"{k} = {c_number(v)}" for k, v in zip([*names, *unfoldings], values, strict=True)),
        period=c_number(source.orbit.period),
        u0=c_numbers(source.orbit.state),
        unfoldings="".join(f"par.{name}, " for name in unfoldings),
        work=work,
        body="\n".join(f"    {line}" for line in lines),
        times=c_numbers(source.times[places]),
        columns="\n".join("    " + " ".join(map(c_number, row)) for row in source.samples[places]),
    )


def _module(source: Source) -> str:
    word = source.identifier
    return f"{word[0].upper()}{word[1:]}"
