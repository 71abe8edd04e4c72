"""What the enclosed monodromy proves about linear stability."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from orbitfinder.proof.balls import arb


@dataclass(frozen=True)
class Stability:
    """Enclosed reduced multipliers (balls of complex numbers) and the verdict with its reason.

    `verdict` is "linearly stable" (every multiplier simple and on the unit circle), "unstable" (one
    is off it) or "open".
    """

    verdict: str
    reason: str
    multipliers: list[Any]


def stability(reduced: Any) -> Stability:
    """The verdict on a reduced monodromy (2n - 2 square).

    The reduced matrix is real and preserves a symplectic form, so with mu also conj(mu), 1/mu and
    1/conj(mu) are multipliers. An enclosure that holds one multiplier and meets the mirror images
    1/conj(.) of no enclosure but its own therefore has it on the unit circle. Source: V. I. Arnold,
    Mathematical Methods of Classical Mechanics, section 42.
    """
    if reduced.nrows() == 0:
        return Stability("linearly stable", "one degree of freedom: no multiplier besides the two at 1", [])
    try:
        found = list(reduced.eig(algorithm="rump"))
    except (ValueError, ZeroDivisionError):
        return Stability("open", "two multipliers could not be separated", [])
    found.sort(key=lambda one: (-round(float(abs(one).mid()), 6), float(one.imag.mid())))
    largest = abs(found[0])
    if largest > 1:
        return Stability("unstable", f"a multiplier of absolute value {_text(largest)} is off the unit circle", found)
    for k, one in enumerate(found):
        mirrored = 1 / one.conjugate()
        for j, other in enumerate(found):
            if j != k and mirrored.overlaps(other):
                return Stability("open", "a multiplier could be one of a pair just off the unit circle", found)
    return Stability("linearly stable", "every multiplier is simple and on the unit circle", found)


def _text(ball: Any) -> str:
    return str(arb(ball).str(12))
