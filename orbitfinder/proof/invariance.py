"""Symmetries of the equations proved on their graph: parities and whole turns, operation by operation.

No numbers are sampled: each operation maps the parities of its operands to that of its result (the
sine of an odd value is odd, a product of two odd values even), so an answer "yes" is a proof.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import gcd, lcm

import numpy as np

from orbitfinder.loops.symmetry import ALONE, NONE, Symmetry
from orbitfinder.proof.program import ScalarProgram

EVEN, ODD, NEITHER, BOTH = 1, -1, 0, 2
"""BOTH is the parity of zero"""


def parities(code: ScalarProgram, signs: dict[int, list[int]]) -> list[dict[int, int]]:
    """Parities of each result's entries when entry i of every argument k is multiplied by signs[k][i] (1 or -1)."""
    value: list[int] = [EVEN] * code.size
    for target, argument, entry in code.inputs:
        value[target] = signs[argument][entry] if argument in signs else EVEN
    for target, number in code.constants:
        value[target] = EVEN if number else BOTH
    numbers = dict(code.constants)
    for name, target, a, b in code.operations:
        value[target] = _parity(name, value[a], value[b] if b >= 0 else EVEN, numbers.get(b))
    return [{entry: value[place] for entry, place in result.items()} for result in code.outputs]


def _parity(name: str, a: int, b: int, exponent: float | None) -> int:
    if name in ("add", "sub"):
        return b if a == BOTH else a if b in (a, BOTH) else NEITHER
    if name in ("mul", "div"):
        return BOTH if BOTH in (a, b) else a * b
    if name == "pow":
        whole = exponent is not None and float(exponent).is_integer()
        return a ** abs(int(exponent or 0)) if whole else EVEN if a == b == EVEN else NEITHER
    if name in ("sin", "neg"):
        return a
    if name in ("cos", "sq"):
        return EVEN if a != NEITHER else NEITHER
    return EVEN if a in (EVEN, BOTH) else NEITHER


def has_symmetry(
    rates: ScalarProgram, energy: ScalarProgram | None, symmetry: Symmetry, n: int, senses: Sequence[int] = (1,)
) -> bool:
    """True when the accelerations a(q, v, s) of n coordinates (and the energy) provably have a symmetry of orbits.

    a(P q, sense P v, sense s) = P a(q, v, s), and E(P q, sense P v) = E(q, v) of maps of these senses. Of rates f(q, s)
    alone f(P q, sense s) = sense P f(q, s). Arguments are numbered q, v, s = 0, 1, 2.
    """
    for mirror in symmetry.maps:
        places = [round(sign) for sign in np.diag(mirror.places(n))]
        signs = {0: places, 1: [mirror.sense * sign for sign in places], 2: [mirror.sense]}
        image = [mirror.sense * sign for sign in places] if mirror.first_order else places
        if mirror.order or any(parity not in (image[i], BOTH) for i, parity in parities(rates, signs)[0].items()):
            return False
        if energy and mirror.sense in senses and not {*parities(energy, signs)[0].values()} <= {EVEN, BOTH}:
            return False
    return True


def usable_symmetry(rates: ScalarProgram, energy: ScalarProgram | None, symmetry: Symmetry, n: int) -> Symmetry:
    """The recorded symmetry, or the part of it that the equations provably have; none when it is no part.

    A motion can look symmetric where its equations are not (x -> -x together with another reflection).
    """
    candidates = (symmetry, *(replace(symmetry, maps=(mirror,)) for mirror in symmetry.maps))
    usable = (candidate for candidate in candidates if has_symmetry(rates, energy, candidate, n))
    return next(usable, ALONE if symmetry.first_order else NONE)


def turns_leave(code: ScalarProgram, angles: Sequence[bool], halves: Collection[int] = ()) -> bool:
    """True when the first result provably does not change as angles (argument 0) make whole turns, and these in
    `halves` together half a turn.

    Followed are whole-numbered combinations of angles; only through a sine or a cosine does one of
    them become invariant.
    """
    combination: list[dict[int, int] | None] = [{} for _ in range(code.size)]
    for target, argument, entry in code.inputs:
        combination[target] = {entry: 1} if argument == 0 and angles[entry] else {}
    numbers = dict(code.constants)
    for name, target, a, b in code.operations:
        combination[target] = _turned(name, combination[a], combination[b] if b >= 0 else {}, numbers, (a, b))
        if name in ("sin", "cos") and sum((combination[a] or {}).get(i, 0) for i in halves) % 2:
            combination[target] = None
    return all(combination[place] == {} for place in code.outputs[0].values())


def _turned(
    name: str, a: dict[int, int] | None, b: dict[int, int] | None, numbers: dict[int, float], places: tuple[int, int]
) -> dict[int, int] | None:
    """Multiples of each angle in a result, {} for an invariant one, None when nothing can be said."""
    if a is None or b is None:
        return None
    if (not a and not b) or name in ("sin", "cos"):
        return {}
    if name in ("add", "sub", "neg"):
        sign = 1 if name == "add" else -1
        left = a if name != "neg" else {key: -count for key, count in a.items()}
        total = {key: left.get(key, 0) + sign * b.get(key, 0) for key in {*left, *b}}
        return {key: count for key, count in total.items() if count}
    if name == "mul":
        for counts, other in ((a, places[1]), (b, places[0])):
            factor = numbers.get(other)
            if counts and factor is not None and float(factor).is_integer():
                return {key: int(factor) * count for key, count in counts.items()}
    return None


# The period of a drive. Followed is v(t + T) - v(t) = rate T of each value v: nothing for what depends on numbers and
# parameters alone, or on the state; a sine or a cosine of a value that grows like that is periodic.


@dataclass(frozen=True)
class Multiple:
    """A rational multiple of a value (its number in the program) that depends on parameters alone; of 1 where None."""

    factor: Fraction = Fraction(0)
    value: int | None = None

    def times(self, other: Multiple) -> Multiple | None:
        """The product, where a factor is a number."""
        if self.value is not None and other.value is not None:
            return None
        return Multiple(self.factor * other.factor, other.value if self.value is None else self.value)


def drive(code: ScalarProgram, clock: int) -> Multiple | None:
    """The angular frequency w of a drive: entry `clock` of argument 0 is time, and results do not change with 2 pi / w.

    None where that does not follow from the graph: time enters only in sines and cosines of multiples of it.
    """
    numbers: list[Multiple | None] = [None] * code.size
    rates: list[Multiple] = [Multiple()] * code.size
    met: list[Multiple] = []
    for target, number in code.constants:
        numbers[target] = Multiple(Fraction(number))
    first: dict[int, int] = {}
    for target, argument, entry in code.inputs:
        if argument == 3:
            numbers[target] = Multiple(Fraction(1), first.setdefault(entry, target))
        elif (argument, entry) == (0, clock):
            rates[target] = Multiple(Fraction(1))
    for name, target, a, b in code.operations:
        numbers[target] = _number(name, target, numbers[a], Multiple(Fraction(1)) if b < 0 else numbers[b])
        rate = _rate(name, (rates[a], Multiple() if b < 0 else rates[b]), (numbers[a], None if b < 0 else numbers[b]))
        if rate is None:
            return None
        if name in ("sin", "cos"):
            met += [rates[a]] if rates[a].factor else []
        else:
            rates[target] = rate
    unlike = len({rate.value for rate in met}) != 1
    if unlike or any(rates[place].factor for result in code.outputs for place in result.values()):
        return None
    common = lcm(*(rate.factor.denominator for rate in met))
    return Multiple(Fraction(gcd(*(abs(int(rate.factor * common)) for rate in met)), common), met[0].value)


def _number(name: str, target: int, a: Multiple | None, b: Multiple | None) -> Multiple | None:
    """What a value that depends on parameters alone is, None of others."""
    if a is None or b is None:
        return None
    if name == "mul" and (product := a.times(b)) is not None:
        return product
    if name == "div" and b.value is None and b.factor:
        return Multiple(a.factor / b.factor, a.value)
    return Multiple(-a.factor, a.value) if name == "neg" else Multiple(Fraction(1), target)


def _rate(name: str, rates: tuple[Multiple, Multiple], numbers: tuple[Multiple | None, ...]) -> Multiple | None:
    """How fast a value grows with time on the average, None where that is not said."""
    a, b = rates
    if not (a.factor or b.factor) or name in ("sin", "cos"):
        return Multiple()
    if name in ("add", "sub", "neg"):
        other = Multiple(-b.factor, b.value) if name == "sub" else b
        if name == "neg":
            return Multiple(-a.factor, a.value)
        if not (a.factor and b.factor):
            return a if a.factor else other
        return Multiple(a.factor + other.factor, a.value) if a.value == b.value else None
    for mine, number in ((a, numbers[1]), (b, numbers[0])):
        if mine.factor and number is not None and name == "mul":
            return mine.times(number)
    if name == "div" and a.factor and (divisor := numbers[1]) is not None and divisor.value is None and divisor.factor:
        return Multiple(a.factor / divisor.factor, a.value)
    return None
