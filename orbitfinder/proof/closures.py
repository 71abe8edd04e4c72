"""Orbits under constraints phi(q) = 0: which coordinates close an orbit, and that the others then close too.

The acceleration keeps phi = 0 and J v = 0, so a motion that begins there stays there; of its end it is enough that the
independent coordinates and rates come back. Source: R. A. Wehage, E. J. Haug, Journal of Mechanical Design 104 (1982)
247-255.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

from scipy.linalg import qr

from orbitfinder.errors import InputError
from orbitfinder.loops.symmetry import BRAKE, NONE
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import arb, arb_mat, floats
from orbitfinder.proof.enclosure import TaylorSettings
from orbitfinder.proof.field import Programs, make_field
from orbitfinder.proof.formulation import Approach
from orbitfinder.proof.krawczyk import TheoremEquations, flow
from orbitfinder.proof.trajectory import Trajectory

AJAR = "constraints: where the orbit closes, the coordinates that are not compared could be elsewhere (a dead point)"


def closable(recorded: str, asked: str | None) -> str:
    """The name of the symmetry to be used, brake or none. Raises `InputError`."""
    if asked not in (None, NONE.name, BRAKE.name):
        raise InputError(
            f"symmetry: under constraints it is {BRAKE.name} or {NONE.name} in proofs, got {asked!r}; leave it out"
        )
    return asked or (BRAKE.name if BRAKE.name in recorded.split("+") else NONE.name)


def closing(model: Model, codes: Programs, start: Approach) -> Approach:
    """The same with the coordinates (m) that constraints best make of the others where the orbit closes."""
    if codes.closure is None:
        return start
    form, field = start.formulation, make_field(model, codes)
    place = [*map(arb, start.nodes[-1].tolist()), arb(0), arb(start.duration)]
    rough = TaylorSettings(bits=64, tolerance=1e-14, order=14)
    end = flow(TheoremEquations(field, form, None), place, rough, vary=False)[0]
    slopes = floats(field.closure([*end, *place[-2:]])[1])
    slopes = slopes[: len(slopes) // 2, : form.size]
    chosen = sorted(int(k) for k in qr(slopes, mode="r", pivoting=True)[1][: len(slopes)])
    return replace(start, formulation=replace(form, dependent=tuple(chosen)))


def comes_back(path: Trajectory) -> bool:
    """True when under constraints the `dependent` coordinates and rates at the end follow from the others there.

    phi and J v are 0 at both ends, whole turns apart, and the slopes of phi by `dependent` coordinates are regular on a
    box that holds both places; then phi(q) = phi(q') with equal independent coordinates gives q = q' (mean values, row
    by row), and J v = J v' gives v = v'.
    """
    form, n = path.formulation, path.formulation.size
    if not form.dependent:
        return True
    place = path.state(Fraction(1, form.parts))[:n]
    if not form.symmetry.reverses:
        moved = [x - 2 * arb.pi() * k for x, k in zip(place, form.turns, strict=True)]
        place = [x.union(y) for x, y in zip(moved, path.first, strict=False)]
    slopes = path.field.closure([*place, *[arb(0)] * (n + 2)])[1].tolist()[: len(form.dependent)]
    try:
        arb_mat([[row[k] for k in form.dependent] for row in slopes]).inv()
    except ZeroDivisionError:
        return False
    return True
