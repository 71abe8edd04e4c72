"""Orbits under constraints phi(q) = 0: which coordinates close an orbit, and that the others then close too.

The acceleration keeps phi = 0 and J v = 0, so a motion that begins there stays there; of its end it is enough that the
independent coordinates and rates come back. Source: R. A. Wehage, E. J. Haug, Journal of Mechanical Design 104 (1982)
247-255.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
from scipy.linalg import qr

from orbitfinder.errors import InputError
from orbitfinder.loops.symmetry import BRAKE, NONE
from orbitfinder.mechanics.constrained import RANK_TOLERANCE
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import arb, arb_mat, floats
from orbitfinder.proof.enclosure import TaylorSettings
from orbitfinder.proof.field import Field, Programs, make_field
from orbitfinder.proof.formulation import Approach
from orbitfinder.proof.krawczyk import TheoremEquations, flow
from orbitfinder.proof.trajectory import Trajectory
from orbitfinder.records.orbit import Orbit

AJAR = "constraints: where the orbit closes, the coordinates that are not compared could be elsewhere (a dead point)"


def closable(orbit: Orbit, model: Model, codes: Programs, asked: str | None) -> str:
    """The name of the symmetry to be used, brake or none. `InputError` for others, and where constraints repeat."""
    if asked not in (None, NONE.name, BRAKE.name):
        raise InputError(
            f"symmetry: under constraints it is {BRAKE.name} or {NONE.name} in proofs, got {asked!r}; leave it out"
        )
    if orbit.state.size == len(model.state_names):
        slopes = _slopes(make_field(model, codes), [*map(arb, orbit.state.tolist()), arb(0), arb(1)])
        sizes = np.linalg.svd(slopes, compute_uv=False)
        if not sizes[-1] > RANK_TOLERANCE * sizes[0]:
            raise InputError(
                f"constraints: {int(np.sum(sizes > RANK_TOLERANCE * sizes[0]))} of {len(sizes)} are independent at the "
                "recorded state, so that accelerations do not follow; leave out those that repeat others (redundant = "
                "'drop' of a mechanism), or, at a change point, prove an orbit that does not pass it"
            )
    return asked or (BRAKE.name if BRAKE.name in orbit.symmetry.split("+") else NONE.name)


def closing(model: Model, codes: Programs, start: Approach) -> Approach:
    """The same with the coordinates (m) that constraints best make of the others where the orbit closes."""
    if codes.closure is None:
        return start
    form, field = start.formulation, make_field(model, codes)
    place = [*map(arb, start.nodes[-1].tolist()), arb(0), arb(start.duration)]
    rough = TaylorSettings(bits=64, tolerance=1e-14, order=14)
    end = flow(TheoremEquations(field, form, None), place, rough, vary=False)[0]
    slopes = _slopes(field, [*end, *place[-2:]])
    chosen = sorted(qr(slopes, mode="r", pivoting=True)[1][: len(slopes)].tolist())
    return replace(start, formulation=replace(form, dependent=tuple(chosen)))


def _slopes(field: Field, z: Sequence[Any]) -> np.ndarray:
    """J (m x n) at z."""
    slopes = floats(field.closure(z)[1])
    return slopes[: len(slopes) // 2, : field.size]


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
