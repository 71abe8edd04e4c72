"""Many digits of an orbit: Newton at high precision, and the interval Newton theorem round the result."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from orbitfinder.errors import InputError, IntegrationError, plural
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import Vector, arb, decimal, precision, radius
from orbitfinder.proof.enclosure import Settings
from orbitfinder.proof.field import programs
from orbitfinder.proof.formulation import approach
from orbitfinder.proof.krawczyk import krawczyk, solve
from orbitfinder.proof.theorem import (
    NotProved,
    Progress,
    check_symmetries,
    chosen_symmetry,
    make_equations,
    provable_model,
    unknowns_at,
)
from orbitfinder.records.orbit import Orbit

MOST_DIGITS = 250
GUARD = 8
"""digits carried beyond those asked for"""


@dataclass(frozen=True)
class Refined:
    """An orbit to many digits: its period (s) and first node (2n) as balls.

    `enclosed` is True when exactly one orbit lies in the balls, False when they are only Newton's limit.
    `phase` is the fraction of the period by which the recorded state comes after the first node.
    """

    digits: int
    enclosed: bool
    reason: str
    symmetry: str
    energy: Any
    period: Any
    state: Vector
    phase: Fraction
    settings: Settings
    wall_time: float


def settings_for(digits: int, order: int | None = None, bits: int | None = None) -> Settings:
    """Order, precision and tolerance that reach so many digits.

    The order that costs least grows as -ln(tolerance) / 2: A. Jorba, M. Zou, Experimental
    Mathematics 14 (2005) 99-117, section 3.
    """
    if not 1 <= digits <= MOST_DIGITS:
        raise InputError(f"digits: must be from 1 to {MOST_DIGITS}, got {digits}; 50 are plenty for most purposes")
    wanted = digits + GUARD
    least = math.ceil(wanted * math.log2(10)) + 40
    if bits is not None and bits < least:
        raise InputError(f"bits: {digits} digits need at least {least}, got {bits}; leave it out")
    if order is not None and not 4 <= order <= 2000:
        raise InputError(f"order: must be from 4 to 2000, got {order}; leave it out")
    return Settings(order or max(20, math.ceil(wanted * math.log(10) / 2)), bits or least, 10.0**-wanted)


def refine(
    orbit: Orbit, settings: Settings, digits: int, model: Model | None = None,
    symmetry: str | None = None, enclose: bool = True, progress: Progress | None = None,
) -> Refined:  # fmt: skip
    """An orbit refined at its recorded energy, read as the decimal that it is written as."""
    began, say = time.perf_counter(), progress or (lambda line: None)
    with precision(settings.bits):
        model = model or provable_model(orbit)
        codes = programs(model)
        chosen = chosen_symmetry(orbit, model, codes, symmetry)
        start = approach(model, orbit, chosen, None)
        equations = make_equations(model, codes, start, decimal(orbit.energy))
        rough = solve(equations, unknowns_at(start), Settings(), 1e-20)[0]
        centre, rounds = solve(equations, rough, settings, 10.0 ** -(digits + GUARD // 2))
        say(f"Newton settled in {plural(rounds, 'iteration')} at {settings.bits} bits, order {settings.order}")
        image, reason = centre, "not asked for"
        if enclose:
            try:
                check_symmetries(codes, start, model)
                box = [x + arb(0, 10.0 ** -max(digits - GUARD, 8)) for x in centre]
                found = krawczyk(equations, box, settings)
                image, reason = (found.image, "") if found.proved else (centre, f"contraction {found.contraction:.3g}")
            except (IntegrationError, NotProved, ZeroDivisionError) as error:
                reason = str(error)
        if enclose and not reason and radius(image) > 10.0**-digits:
            reason = f"the enclosure is only good to {radius(image):.1g}"
        form = start.formulation
        node = form.nodes(image)[0]
        return Refined(
            digits, enclose and not reason, reason, chosen.name, equations.energy,
            node[-1] * form.segments * form.parts, node[: 2 * form.size],
            Fraction(start.phase), settings, time.perf_counter() - began,
        )  # fmt: skip
