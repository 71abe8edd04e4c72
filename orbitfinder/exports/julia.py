"""Orbits written for users of BifurcationKit.jl: right-hand side, parameters, the orbit as a guess.

The file's syntax is checked against a grammar and its arithmetic through the same emitter in Python and C; no
Julia was at hand to run it. The calls in its comment are those of BifurcationKit's own tutorials.
"""

from __future__ import annotations

import numpy as np

from orbitfinder._runtime.inert import inert
from orbitfinder.exports.source import JULIA, Source, c_number, c_numbers, straight_line


def julia_files(source: Source) -> dict[str, str]:
    """NAME.jl and its text: one module that needs no package, the orbit in at most 201 columns."""
    lines, work = straight_line(source.rate, JULIA, ["(t,)", "u", "s", "p"], ["du"])
    names, count, word = [*source.model.parameter_names], len(source.model.invariants), source.identifier
    unfoldings = ["unfolding"] if count < 2 else [f"unfolding{k + 1}" for k in range(count)]
    if count == 0:
        lines += [f"du[{i + 1}] += par.unfolding * u[{i + 1}]" for i in source.rates]
    values = [*map(float, source.model.parameter_values), *([0.0] * len(unfoldings))]
    start = 0.0 if count or not names else values[0]
    places = np.unique(np.linspace(0, len(source.times) - 1, 201).round().astype(int))
    low, high = c_number(start - 1.0), c_number(start + 1.0)
    heading = "\n".join(f"# {line}" for line in source.heading)
    module, varied = f"{word[0].upper()}{word[1:]}", unfoldings[0] if count or not names else names[0]
    parameters = ", ".join(f"{k} = {c_number(v)}" for k, v in zip([*names, *unfoldings], values, strict=True))
    body = "\n".join(f"    {line}" for line in lines)
    columns = "\n".join("    " + " ".join(map(c_number, row)) for row in source.samples[places])
    text = f"""{heading}
#
# Plain Julia without packages: include it, then
#   {module}.rhs!(du, u, par, t)   right-hand side, u = ({inert(", ".join(source.model.state_names), "comment")})
#   {module}.par                   parameters; unfolding is a fictitious damping, 0 on orbits of the system
#   {module}.period, .u0           the orbit: minimal period (s) and state at t = 0
#   {module}.times, .orbit         one period, a state per column
#
# With BifurcationKit.jl 0.4 or newer and OrdinaryDiffEq.jl the orbit starts a branch by collocation:
#   using BifurcationKit, OrdinaryDiffEq
#   include("{word}.jl"); using .{module}: rhs!, par, u0, period
#   prob = BifurcationProblem(rhs!, u0, par, (@optic _.{varied}))
#   sol = solve(ODEProblem(rhs!, u0, (0.0, period), par), Vern9(); abstol = 1e-13, reltol = 1e-13)
#   coll, guess = generate_ci_problem(PeriodicOrbitOCollProblem(60, 4), prob, sol, period)
#   branch = continuation(coll, guess, PALC(), ContinuationPar(p_min = {low}, p_max = {high}))
module {module}

const par = ({parameters},)
const period = {c_number(source.orbit.period)}
const u0 = [{c_numbers(source.orbit.state)}]

function rhs!(du, u, par, t = 0.0)
    s = ({"".join(f"par.{name}, " for name in unfoldings)})
    p = values(par)
    w = similar(du, {work})
{body}
    return du
end

const times = [{c_numbers(source.times[places])}]
const orbit = [
{columns}
]'

end
"""
    return {f"{word}.jl": text}
