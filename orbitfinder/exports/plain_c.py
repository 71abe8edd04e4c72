"""The right-hand side in plain C99 that needs only <math.h>, with the orbit's numbers."""

from __future__ import annotations

import numpy as np

from orbitfinder.exports.source import Source
from orbitfinder.exports.straightline import C, c_number, straight_line

FILE = """{heading}
#include <math.h>

enum {{ {word}_states = {size}, {word}_parameters = {count}, {word}_unfoldings = {unfolded} }};

/* {parameter_names} */
const double {word}_p[] = {p};
/* {state_names} at t = 0 */
const double {word}_x0[] = {x0};
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


def c_file(source: Source) -> str:
    """The text of NAME.c."""
    lines, work = straight_line(source.rate, C, ["t", "x", "s", "p"], ["dx"])
    model = source.model
    return FILE.format(
        heading="/* " + "\n   ".join(source.heading) + " */",
        word=source.identifier,
        size=2 * model.degrees_of_freedom,
        count=len(model.parameter_names),
        unfolded=len(model.invariants),
        parameter_names=", ".join(model.parameter_names) or "no parameters",
        state_names=", ".join(model.state_names),
        p=_array(model.parameter_values) if len(model.parameter_values) else "{0.0}",
        x0=_array(source.orbit.state),
        period=c_number(source.orbit.period),
        work=work,
        body="\n".join(f"  {line}" for line in lines),
    )


def _array(values: np.ndarray) -> str:
    return "{" + ", ".join(map(c_number, values)) + "}"
