"""Orbits written in C99: the right-hand side that needs only <math.h>, with the orbit's numbers."""

from __future__ import annotations

from orbitfinder._runtime.inert import inert
from orbitfinder.exports.source import C, Source, c_number, c_numbers, straight_line


def c_files(source: Source) -> dict[str, str]:
    """NAME.c and its text."""
    lines, work = straight_line(source.rate, C, ["t", "x", "s", "p"], ["dx"])
    model, word = source.model, source.identifier
    heading, body = "\n   ".join(source.heading), "\n".join(f"  {line}" for line in lines)
    sizes = len(model.state_names), len(model.parameter_names), len(model.invariants)
    text = f"""/* {heading} */
#include <math.h>

enum {{ {word}_states = {sizes[0]}, {word}_parameters = {sizes[1]}, {word}_unfoldings = {sizes[2]} }};

/* {inert(", ".join(model.parameter_names), "comment") or "no parameters"} */
const double {word}_p[] = {{{c_numbers(model.parameter_values) or "0.0"}}};
/* {inert(", ".join(model.state_names), "comment")} at t = 0 */
const double {word}_x0[] = {{{c_numbers(source.orbit.state)}}};
const double {word}_period = {c_number(source.orbit.period)};

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
    return {f"{word}.c": text}
