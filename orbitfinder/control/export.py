"""A controller for other programs: reference and gains as CSV, and what it does in C99 and in Python with NumPy."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from orbitfinder._runtime import __version__
from orbitfinder._runtime.inert import inert
from orbitfinder.control import law
from orbitfinder.control.controller import Controller
from orbitfinder.control.law import Law
from orbitfinder.errors import InputError
from orbitfinder.exports.source import c_number, c_numbers, word_of
from orbitfinder.exports.write import csv_text
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.records.reading import plain_numbers, write_atomically

TABLE = ("period", "clock", "event", "units", "angles", "states", "inputs", "gains", "actuators", "limits")
"""What of a controller its law needs"""


def law_of(controller: Controller) -> Law:
    """What the controller does, by the very code that its Python export contains."""
    return Law({name: getattr(controller, name) for name in TABLE})


def export_controller(controller: Controller, folder: str | Path, model: Model | None = None) -> list[Path]:
    """Write a controller as gains and programs: NAME_gains.csv, NAME_controller.c and NAME_controller.py.

    Args:
        controller: what to write.
        folder: where.
        model: needed only for systems that no file describes.

    Returns:
        The paths.

    Raises:
        InputError: where they cannot be written.

    Examples:
        >>> [path.name for path in of.export_controller(controller, ".")]
        ['swing_gains.csv', 'swing_controller.c', 'swing_controller.py']
    """
    model = model or build_model(controller.system)
    if not controller.stabilised:
        raise InputError(f"{controller.name}: its certificate does not hold, so it is not exported; stabilise it anew")
    target, word = Path(folder), word_of(controller.name)
    target.mkdir(parents=True, exist_ok=True)
    files = {
        f"{word}_gains.csv": gains_text, f"{word}_controller.c": c_text, f"{word}_controller.py": python_text,
    }  # fmt: skip
    for name, text in files.items():
        write_atomically(target / name, text(controller, model.state_names).encode())
    return [target / name for name in files]


def export_program(controller: Controller, to: str, folder: str | Path, model: Model | None = None) -> list[Path]:
    """What `export --to` writes of a controller: csv, its gains; c, itself in C, with the same in Python."""
    if to not in ("csv", "c"):
        raise InputError(f"to: {to} files hold no controller; use csv for its gains, c for itself in C and Python")
    return [path for path in export_controller(controller, folder, model) if (path.suffix == ".csv") == (to == "csv")]


def gains_text(controller: Controller, states: tuple[str, ...]) -> str:
    """A header line, then t (s), x*, u* and K row after row at each node."""
    names = [*states, *controller.actuators, *(f"K_{u}_{x}" for u in controller.actuators for x in states)]
    times = np.linspace(0.0, controller.period, len(controller.states))
    return csv_text(names, times, np.column_stack([controller.states, controller.inputs, controller.gains]))


def _heading(controller: Controller, states: tuple[str, ...]) -> list[str]:
    since = f" since the last {controller.event}" if controller.event else ""
    kept = f"the time (s){since}, which the controller keeps"
    measured = kept if controller.clock else "its place on the orbit (s)"
    lines = [
        f"Holds {controller.name!r} (period {controller.period!r} s) by {', '.join(controller.actuators)}.",
        f"State: {', '.join(states)}; tau: {measured}.",
        *([f"After every {controller.event} tau begins anew: go on from tau = 0."] if controller.event else []),
        f"Largest multiplier of the nonlinear closed loop: {abs(controller.multipliers).max():.6g}.",
        f"Written by orbitfinder {__version__}.",
    ]
    return [inert(line, "comment") for line in lines]


def python_text(controller: Controller, states: tuple[str, ...]) -> str:
    """The law itself, its table, and a command that prints the controls at a state."""
    source = Path(law.__file__).read_text(encoding="utf-8")
    table = {name: plain_numbers(getattr(controller, name)) for name in TABLE}
    entries = [f'    "{name}": {entry!a},' for name, entry in table.items()]
    comment = "".join(f"# {line}\n" for line in _heading(controller, states))
    return f"{comment}{source}\n\ninf = np.inf\nTABLE = {{\n" + "\n".join(entries) + f"\n}}\n{MAIN}"


MAIN = """
if __name__ == "__main__":
    import sys

    law = Law(TABLE)
    try:
        numbers = [float(word) for word in sys.argv[1:]]
    except ValueError:
        numbers = []
    if len(numbers) not in (law.size, law.size + 1):
        sys.exit(f"usage: {sys.argv[0]} {law.size} numbers of the state [where it is expected, s]")
    x = np.array(numbers[: law.size])
    u, tau = law(x, numbers[law.size] if len(numbers) > law.size else law.start(x)[0])
    print(*map(repr, map(float, u)), repr(float(tau)))
"""

C_FILE = """/* HEADING */
#include <math.h>

enum { WORD_states = SIZE, WORD_controls = COUNT, WORD_nodes = NODES, WORD_row = ROW };

static const double WORD_period = PERIOD;
static const double WORD_units[SIZE] = {UNITS};
static const double WORD_angles[SIZE] = {ANGLES};
static const double WORD_low[COUNT] = {LOW}, WORD_high[COUNT] = {HIGH};
/* coefficients of the periodic spline of degree 5 of (x*, u*, K row after row) */
static const double WORD_spline[NODES + 5][ROW] = {
SPLINE
};
static const double WORD_basis[6][6] = {
  {1, 26, 66, 26, 1, 0}, {-5, -50, 0, 50, 5, 0}, {10, 20, -60, 20, 10, 0},
  {-10, 20, 0, -20, 10, 0}, {5, -20, 30, -20, 5, 0}, {-1, 5, -10, 10, -5, 1}};

/* The place tau in the period. */
static double WORD_within(double tau)
{
  WITHIN
}

/* The first `width` entries of the row at tau, or their derivatives of an order. */
static void WORD_at(double tau, int width, int order, double *row)
{
  const double step = WORD_period / WORD_nodes, where = WORD_within(tau) / step;
  double weight[6];
  int i, j, n, k;
  k = where < WORD_nodes ? (int)where : WORD_nodes - 1;
  for (j = 0; j < 6; j++) {
    double sum = 0.0;
    for (i = 5; i >= order; i--) {
      double factor = 1.0 / 120.0;
      for (n = 0; n < order; n++) factor *= (i - n) / step;
      sum = sum * (where - k) + factor * WORD_basis[i][j];
    }
    weight[j] = sum;
  }
  for (i = 0; i < width; i++) {
    row[i] = 0.0;
    for (j = 0; j < 6; j++) row[i] += weight[j] * WORD_spline[k + j][i];
  }
}

/* x - place, angles within half a turn */
static double WORD_gap(double x, double place, int i)
{
  const double turn = 6.283185307179586;
  return x - place - WORD_angles[i] * turn * round((x - place) / turn);
}

/* The place nearest to x in the neighbourhood of tau. */
static double WORD_follow(const double *x, double tau, int times)
{
  double place[WORD_row], slope[WORD_states], bend[WORD_states];
  while (times--) {
    double steep = 0.0, curved = 0.0, along = 0.0, move;
    int i;
    WORD_at(tau, WORD_states, 0, place);
    WORD_at(tau, WORD_states, 1, slope);
    WORD_at(tau, WORD_states, 2, bend);
    for (i = 0; i < WORD_states; i++) {
      const double apart = WORD_gap(x[i], place[i], i) / (WORD_units[i] * WORD_units[i]);
      steep += slope[i] * slope[i] / (WORD_units[i] * WORD_units[i]);
      curved += bend[i] * apart;
      along += slope[i] * apart;
    }
    move = along / fmax(steep - curved, steep / 2);
    tau += fmin(fmax(move, -WORD_period / 16), WORD_period / 16);
  }
  return WORD_within(tau);
}

/* The place of the orbit that is nearest to a state: where to begin. */
double WORD_start(const double *x)
{
  double row[WORD_row], least = HUGE_VAL, tau = 0.0;
  int i, k;
  for (k = 0; k < WORD_nodes + EVENT; k++) {
    double sum = 0.0;
    WORD_at(k * WORD_period / WORD_nodes, WORD_states, 0, row);
    for (i = 0; i < WORD_states; i++) sum += pow(WORD_gap(x[i], row[i], i) / WORD_units[i], 2);
    if (sum < least) { least = sum; tau = k * WORD_period / WORD_nodes; }
  }
  return WORD_follow(x, tau, 8);
}

/* The controls u at a state x that is expected near tau; returns its place, to which the time that passes is added. */
double WORD_control(const double *x, double tau, double *u)
{
  double row[WORD_row];
  int i, j;
  tau = FOLLOWED;
  WORD_at(tau, WORD_row, 0, row);
  for (j = 0; j < WORD_controls; j++) {
    u[j] = row[WORD_states + j];
    for (i = 0; i < WORD_states; i++)
      u[j] -= row[WORD_states + WORD_controls + j * WORD_states + i] * WORD_gap(x[i], row[i], i);
    u[j] = fmin(fmax(u[j], WORD_low[j]), WORD_high[j]);
  }
  return tau;
}
"""


def c_text(controller: Controller, states: tuple[str, ...]) -> str:
    """The text of NAME_controller.c: C99 that needs only <math.h>."""
    own, word = law_of(controller), word_of(controller.name)
    numbers = {
        "HEADING": "\n   ".join(_heading(controller, states)), "NODES": str(own.count),
        "SIZE": str(own.size), "COUNT": str(own.controls), "ROW": str(own.rows.shape[1]),
        "PERIOD": c_number(own.period), "UNITS": c_numbers(own.units), "ANGLES": c_numbers(own.angles),
        "LOW": _bounds(own.low), "HIGH": _bounds(own.high),
        "SPLINE": ",\n".join(f"  {{{c_numbers(row)}}}" for row in own.spline),
        "FOLLOWED": f"{word}_within(tau)" if own.clock else f"{word}_follow(x, tau, 2)", "EVENT": str(int(own.event)),
        "WITHIN": f"return fmin(fmax(tau, 0.0), {word}_period);" if own.event else
                  f"tau = fmod(tau, {word}_period);\n  return tau < 0 ? tau + {word}_period : tau;",
    }  # fmt: skip
    return re.sub(r"\b[A-Z]+\b", lambda name: numbers.get(name[0], name[0]), C_FILE.replace("WORD", word))


def _bounds(values: np.ndarray) -> str:
    return ", ".join(c_number(x) if np.isfinite(x) else f"{'-' if x < 0 else ''}HUGE_VAL" for x in values)
