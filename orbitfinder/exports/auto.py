"""Files that AUTO-07p loads: equations, constants and the orbit as starting data.

A conservative system gets AUTO's usual remedy, the fictitious damping s v with s = PAR(1) free and
PAR(11) the period: s stays at round-off and the family is followed (Muñoz-Almaraz, Freire, Galán,
Doedel, Vanderbauwhede, "Continuation of periodic orbits in conservative and Hamiltonian systems").
With more first integrals than the energy the loop is stated as a boundary-value problem (IPS = 4), with
a further unfolding and a phase condition for each symmetry, for which IPS = 2 has no room.
A forcing of period P becomes autonomous through an oscillator (c, s) -> (cos, sin)(2 pi t / P) whose
unit circle attracts: c' = c - w s - c (c^2 + s^2), s' = s + w c - s (c^2 + s^2), t = atan2(s, c) / w.
"""

from __future__ import annotations

import re

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.exports.source import FORTRAN, Source, dense_states, fortran_number, straight_line
from orbitfinder.loops.symmetry import turned
from orbitfinder.records.orbit import level

UNFOLDING, ENERGY, PERIOD, FIRST = 1, 2, 11, 15
"""Places in PAR: the first unfolding, the energy (for output), the period (AUTO's rule), physical parameters."""
MORE = 3
"""Place in PAR of the second unfolding; further ones follow it."""
MOST = 1 + PERIOD - MORE
"""First integrals whose unfoldings find a place below the period."""
ROWS = 2001
"""Rows of the .dat file; AUTO interpolates linearly between them before its first correction."""


def auto_files(source: Source) -> dict[str, str]:
    """The three files of an AUTO run, by name. Raises `InputError` for what AUTO's IPS = 2 cannot state."""
    if len(source.model.invariants) > MOST:
        raise InputError(f"to: more than {MOST} first integrals have no place in AUTO's PAR; use julia or c")
    if source.model.forced and source.model.invariants:
        raise InputError("to: a forced system that keeps a momentum is not covered for AUTO; use julia or c")
    # a line of t and the states for each of `ROWS` equal times over one period
    rows = "".join(" ".join(map(repr, row)) + "\n" for row in np.column_stack(_with_clock(source)).tolist())
    word = source.identifier
    return {f"{word}.f90": equations(source), f"c.{word}": constants(source), f"{word}.dat": rows}


def equations(source: Source) -> str:
    """The equations file: FUNC, STPNT with the parameters of the orbit, PVLS with the energy."""
    legend = (
        f"PAR({UNFOLDING}): the unfolding s, a fictitious damping that is 0 on orbits; PAR({PERIOD}): period",
        f"PAR({ENERGY}): energy (output); physical parameters from PAR({FIRST}) on",
    )
    comments = "".join(f"! {line}\n" for line in [*source.heading, *legend])
    rest = "subroutine FOPT\nend subroutine FOPT\n"
    return "\n".join([comments, _func(source), _stpnt(source), _pvls(source), _boundary(source), rest])


def unfolding_places(source: Source) -> list[int]:
    """Where in PAR the unfolding of each first integral is; one for the system without any."""
    return [UNFOLDING, *range(MORE, MORE + len(source.model.invariants) - 1)]


def _symmetries(source: Source) -> list[ca.Function]:
    """Generators of the symmetries besides time translation: each needs a phase condition of its own."""
    return [invariant.generator for invariant in source.model.invariants if invariant.generator is not None]


def _boundary(source: Source) -> str:
    """Closure and phase conditions (the integral of generator(old).(new - old)) where AUTO's own do not suffice."""
    if not _symmetries(source):
        return "subroutine BCND\nend subroutine BCND\n\nsubroutine ICND\nend subroutine ICND\n"
    n, size, lines, work = source.model.degrees_of_freedom, len(source.model.state_names), [], 1
    x, p = ca.SX.sym("x", size), ca.SX.sym("p", len(source.model.parameter_names))
    for k, generator in enumerate(_symmetries(source), start=2):
        along = ca.Function("along", [x, p], [generator(x[:n], x[n:], p)])
        body, extent = straight_line(along, FORTRAN, ["x", "p"], ["along"])
        work = max(work, extent)
        lines += [*body, f"FI({k}) = dot_product(along, U - UOLD)"]
    turned_by = turned(source.model, np.array(source.orbit.winding), source.orbit.shift)
    turns = [2 * np.pi * float(k) for k in turned_by] + [0.0] * (size - n)
    loop = [f"FB({i}) = U1({i}) - U0({i}) - ({fortran_number(turn)})" for i, turn in enumerate(turns, start=1)]
    return f"""subroutine BCND(NDIM, PAR, ICP, NBC, U0, U1, FB, IJAC, DBC)
  implicit none
  integer, intent(in) :: NDIM, ICP(*), NBC, IJAC
  double precision, intent(in) :: PAR(*), U0(NDIM), U1(NDIM)
  double precision, intent(out) :: FB(NBC)
  double precision, intent(inout) :: DBC(NBC, *)
{_parameters_in_par(loop)}
end subroutine BCND

subroutine ICND(NDIM, PAR, ICP, NINT, U, UOLD, UDOT, UPOLD, FI, IJAC, DINT)
  implicit none
  integer, intent(in) :: NDIM, ICP(*), NINT, IJAC
  double precision, intent(in) :: PAR(*), U(NDIM), UOLD(NDIM), UDOT(NDIM), UPOLD(NDIM)
  double precision, intent(out) :: FI(NINT)
  double precision, intent(inout) :: DINT(NINT, *)
  double precision :: w({work}), x({size}), along({size})
  x = UOLD
  FI(1) = dot_product(UPOLD, U - UOLD)
{_parameters_in_par(lines)}
end subroutine ICND
"""


def _parameters_in_par(lines: list[str]) -> str:
    """The lines indented, with p(k) read from PAR, where AUTO may vary it."""
    moved = [re.sub(r"\bp\((\d+)\)", lambda match: f"PAR({FIRST - 1 + int(match.group(1))})", line) for line in lines]
    return "\n".join(f"  {line}" for line in moved)


def _func(source: Source) -> str:
    model, size = source.model, len(source.model.state_names)
    lines, work = straight_line(source.rate, FORTRAN, ["t", "U", "s", "p"], ["F"])
    places = unfolding_places(source)
    before, after = ["t(1) = 0.0d0", *(f"s({k}) = PAR({place})" for k, place in enumerate(places, start=1))], []
    if model.forced:
        clock, extent = straight_line(model.forcing_period, FORTRAN, ["p"], ["forcing"])
        work = max(work, extent)
        before += [*clock, f"rate = {fortran_number(2 * np.pi)} / forcing(1)"]
        c, s = (f"U({k})" for k in (size + 1, size + 2))
        before += [f"t(1) = atan2({s}, {c}) / rate"]
        circle = f"(1.0d0 - {c} * {c} - {s} * {s})"
        after += [f"F({size + 1}) = {c} * {circle} - rate * {s}", f"F({size + 2}) = {s} * {circle} + rate * {c}"]
    if not model.invariants:  # s must act on something to be a parameter
        after += [f"F({i + 1}) = F({i + 1}) + s(1) * U({i + 1})" for i in source.rates]
    if _symmetries(source):  # IPS = 4 does not scale time
        after += [f"F = PAR({PERIOD}) * F"]
    return f"""subroutine FUNC(NDIM, U, ICP, PAR, IJAC, F, DFDU, DFDP)
  implicit none
  integer, intent(in) :: NDIM, ICP(*), IJAC
  double precision, intent(in) :: U(NDIM), PAR(*)
  double precision, intent(out) :: F(NDIM)
  double precision, intent(inout) :: DFDU(NDIM, NDIM), DFDP(NDIM, *)
  double precision :: w({work}), t(1), s({len(places)}), forcing(1), rate
{_parameters_in_par([*before, *lines, *after])}
end subroutine FUNC
"""


def _stpnt(source: Source) -> str:
    energy = level(source.orbit.energy)
    values = dict.fromkeys(unfolding_places(source), 0.0) | {ENERGY: energy, PERIOD: source.orbit.period}
    values |= enumerate(map(float, source.model.parameter_values), FIRST)
    lines = [f"PAR({place}) = {fortran_number(value)}" for place, value in values.items()]
    lines += [f"U({i + 1}) = {fortran_number(value)}" for i, value in enumerate(_with_clock(source)[1][0])]
    body = "\n".join(f"  {line}" for line in lines)
    return f"""subroutine STPNT(NDIM, U, PAR, T)
  implicit none
  integer, intent(in) :: NDIM
  double precision, intent(inout) :: U(NDIM), PAR(*)
  double precision, intent(in) :: T
{body}
end subroutine STPNT
"""


def _pvls(source: Source) -> str:
    lines, work = straight_line(source.energy, FORTRAN, ["x", "p"], ["e"])
    size = len(source.model.state_names)
    return f"""subroutine PVLS(NDIM, U, PAR)
  implicit none
  integer, intent(in) :: NDIM
  double precision, intent(in) :: U(NDIM)
  double precision, intent(inout) :: PAR(*)
  double precision, external :: GETP
  double precision :: w({work}), x({size}), e(1)
  integer :: i
  do i = 1, {size}
    x(i) = GETP('BV0', i, U)
  end do
{_parameters_in_par(lines)}
  PAR({ENERGY}) = e(1)
end subroutine PVLS
"""


def constants(source: Source) -> str:
    """The constants file: 20 steps along the family, or in the first parameter of a system without one."""
    model = source.model
    varied = UNFOLDING if model.invariants or not model.parameter_names else FIRST
    names = {UNFOLDING: "unfolding", ENERGY: "energy", PERIOD: "period"}
    more = unfolding_places(source)[1:]
    names |= {place: f"unfolding{k}" for k, place in enumerate(more, start=2)}
    names |= enumerate((f"{name}_" if name in names.values() else name for name in model.parameter_names), FIRST)
    clock = ["clock_cos", "clock_sin"] if model.forced else []
    states = [*model.state_names, *clock]
    loop = (4, len(states), 1 + len(_symmetries(source))) if _symmetries(source) else (2, 0, 0)
    intervals = 50 if source.orbit.certificate is None or source.orbit.certificate.scale < 100 else 100
    folds = int(varied != UNFOLDING)  # the unfolding is 0 all along a family, no fold in it means anything
    return f"""NDIM = {len(states)}, IPS = {loop[0]}, IRS = 0, ILP = {folds}
ICP = [{", ".join(map(str, (varied, PERIOD, *more, ENERGY)))}]
NTST = {intervals}, NCOL = 4, IAD = 3, ISP = 2, ISW = 1, IPLT = 0, NBC = {loop[1]}, NINT = {loop[2]}
NMX = 20, NPR = 20, MXBF = 0, IID = 2, ITMX = 8, ITNW = 7, NWTN = 3, JAC = 0
EPSL = 1e-9, EPSU = 1e-9, EPSS = 1e-7
DS = 0.01, DSMIN = 1e-06, DSMAX = 0.1, IADS = 1
NPAR = {max(36, FIRST + len(model.parameter_names))}, THL = {{}}, THU = {{}}
unames = {{{", ".join(f"{k}: '{name}'" for k, name in enumerate(states, start=1))}}}
parnames = {{{", ".join(f"{k}: '{name}'" for k, name in sorted(names.items()))}}}
dat = '{source.identifier}'
"""


def _with_clock(source: Source) -> tuple[np.ndarray, np.ndarray]:
    """Dense times and states, those of the added oscillator included."""
    times, states = dense_states(source, ROWS)
    if _symmetries(source):
        return times / source.orbit.period, states
    if source.model.forcing_period is not None:
        turn = 2 * np.pi * times / source.model.driving_period
        states = np.column_stack([states, np.cos(turn), np.sin(turn)])
    return times, states
