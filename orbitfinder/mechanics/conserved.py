"""Linear invariants c.x of first-order systems: the left null space of the rates, c.f(t, x, p) = 0 for all t, x and p.

The graph of f is evaluated at seeded points of the integers modulo a prime, where sums, products, quotients and whole
powers are exact; any other function, an exponential or a minimum, has a value there that depends on its arguments
alone. What vanishes at such points is an identity of the equations, but for a probability below 1e-30. Sources: J. T.
Schwartz, J. ACM 27 (1980) 701-717; P. S. Wang, Proc. SYMSAC (1981) 212-217, for rational numbers from residues.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from fractions import Fraction
from math import isfinite, lcm
from random import Random
from typing import Any

import casadi as ca
import numpy as np

PRIME, SPARE, MOST, LARGEST = 2**127 - 1, 3, 100, 2**40
"""Points in a row that say nothing new; components of the largest system that is searched; numerators and denominators
of a solution"""
DECIMAL, ROUND_OFF, VANISHES = 10**6, 1e-15, 1e-9
"""A number of the equations stands for a fraction of such a denominator to its round-off, else for its decimals; whole
powers are at most so large; a sum that is below this share of its terms is 0"""


def linear_invariants(inputs: Sequence[ca.SX], rate: ca.SX) -> list[list[int]]:
    """The integers c (k of d), without common divisors, that span all c with c.f = 0, f (d) a rate in (t, x, p).

    None of more than `MOST` components.
    """
    size, pivots, spare, random = rate.numel(), dict[int, list[int]](), SPARE, Random(0)
    if size > MOST:
        return []
    exact: dict[int, Any] = {
        ca.OP_ADD: operator.add, ca.OP_SUB: operator.sub, ca.OP_MUL: operator.mul, ca.OP_SQ: operator.mul,
        ca.OP_TWICE: operator.add, ca.OP_NEG: lambda a, _: -a, ca.OP_POW: _power, ca.OP_CONSTPOW: _power,
        ca.OP_INV: lambda a, _: _power(a, PRIME - 1), ca.OP_DIV: lambda a, b: a * _power(b, PRIME - 1),
        ca.OP_IF_ELSE_ZERO: lambda a, b: hash((a,)) * b,
    }  # fmt: skip
    rates = ca.Function("rates", inputs, [ca.densify(rate)])
    parts = rates.instruction_id, rates.instruction_input, rates.instruction_output
    steps = [[part(k) for part in parts] for k in range(rates.n_instructions())]
    constants = ((k, rates.instruction_constant(k)) for k, step in enumerate(steps) if step[0] == ca.OP_CONST)
    numbers = {k: _residue(number) for k, number in constants if isfinite(number)}
    while spare:
        work, row = dict[int, int](), [0] * size
        for k, (code, given, made) in enumerate(steps):
            if code == ca.OP_OUTPUT:
                row[made[1]] = work[given[0]]
            elif code in (ca.OP_INPUT, ca.OP_CONST, ca.OP_CALL):  # what another function gives may be anything
                work |= {each: numbers[k] if k in numbers else random.randrange(PRIME) for each in made}
            else:
                a, b = work[given[0]], work[given[-1]]  # of one operand twice the same
                work[made[0]] = (exact[code](a, b) if code in exact else hash((code, a, b))) % PRIME
        for column, other in pivots.items():
            if factor := row[column]:
                row = [(a - factor * b) % PRIME for a, b in zip(row, other, strict=True)]
        if any(row):
            column = max(k for k in range(size) if row[k])
            inverse = pow(row[column], -1, PRIME)
            pivots[column] = [a * inverse % PRIME for a in row]
        else:
            spare -= 1
    rows = list[list[int]]()
    for free in {*range(size)} - pivots.keys():
        c = [int(k == free) for k in range(size)]
        for column, row in reversed(pivots.items()):
            c[column] = -sum(map(operator.mul, row, c)) % PRIME
        scale = lcm(*(Fraction(each, PRIME).limit_denominator(LARGEST).denominator for each in c))
        row = [(each * scale + LARGEST) % PRIME - LARGEST for each in c]
        rows += [row] if max(map(abs, row)) < LARGEST else []
    return rows


def discrepancy(inputs: Sequence[Any], terms: Any, values: Any, near: float = 0.1) -> str:
    """How far the terms (m x k) of some row are from adding up to 0, in words; "" where that is round-off.

    They are tried at seeded inputs, every other time at positive ones, and at `values` of the last, the parameters, and
    at others that differ by multiples of the share `near`.
    """
    sums = ca.Function("sums", inputs, [ca.horzcat(ca.fabs(ca.sum2(terms)), ca.sum2(ca.fabs(terms)))])
    random, numbers, said = np.random.default_rng(0), np.asarray(values, float), "numbers that are nowhere finite"
    for k in range(8):
        given = [0.5 ** (k // 2) * random.normal(size=each.numel()) ** (1 + k % 2) for each in inputs[:-1]]
        off, size = sums(*given, numbers + near * k * np.where(numbers, numbers, 1.0)).full().T
        if np.any(wrong := off > VANISHES * size):
            return f"{off[wrong].max():.3g} of terms as large as {size[wrong].max():.3g}"
        said = "" if np.isfinite(off).all() else said
    return said


def _power(base: int, exponent: int) -> int:
    signed = exponent if exponent < DECIMAL else exponent - PRIME
    return pow(base, signed % (PRIME - 1), PRIME) if abs(signed) < DECIMAL else hash((base, exponent))


def _residue(number: float) -> int:
    """The residue of what a number of the equations stands for."""
    simple = Fraction(number).limit_denominator(DECIMAL)
    meant = simple if abs(float(simple) - number) <= ROUND_OFF * abs(number) else Fraction(repr(number))
    return meant.numerator * pow(meant.denominator, -1, PRIME) % PRIME
