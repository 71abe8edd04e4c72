"""The exception tree: everything orbitfinder raises on purpose derives from `OrbitfinderError`."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

import numpy as np


class OrbitfinderError(Exception):
    """Base class; its message is a sentence that a person can act on."""


class InputError(OrbitfinderError, ValueError):
    """What the user gave is not usable (command line: exit code 2); its message starts with what it is about."""

    @property
    def field(self) -> str:
        """What the message is about: the argument, key or file before its first colon."""
        return str(self).partition(":")[0]


class CountError(InputError):
    """Equations and unknowns do not match; the message carries the count and the reason."""


class IntegrationError(OrbitfinderError):
    """An integrator gave up: where (segment, time in s, state) and why.

    `segment` is the 0-based index of the shooting segment, or None outside shooting.
    """

    def __init__(
        self,
        reason: str,
        *,
        segment: int | None = None,
        time: float | None = None,
        state: np.ndarray | None = None,
    ) -> None:
        self.reason, self.segment, self.time, self.state = reason, segment, time, state
        where = [] if segment is None else [f"segment {segment}"]
        if time is not None:
            where.append(f"t = {time:.6g} s")
        if state is not None:
            where.append("state at its start " + np.array2string(np.asarray(state), precision=6))
        super().__init__(f"integration failed ({', '.join(where) or 'unknown place'}): {reason}")


class ConvergenceError(OrbitfinderError):
    """The solver ended without an orbit; the message says which defect and what to try."""


class DomainError(ConvergenceError):
    """The equations are not defined there: a division by 0, the logarithm or root of a negative number, an overflow."""

    digits = 0.5
    """share of the digits of a shortest step that is left there: a root ends in half of them"""


class Hint(UserWarning):
    """Something that is allowed and yet looks like a slip."""


class LimitError(OrbitfinderError):
    """A time limit was reached; the message says which and how far the work had come."""


UNSOLVED = ConvergenceError, IntegrationError
"""What an attempt at a solution may end with where there is none"""
FAILURES = InputError, *UNSOLVED
"""What a computation may end with, but for its time limit"""


def shortened(value: object, limit: int = 60) -> str:
    """The text of a value in a message, cut where it is longer than `limit`."""
    text = str(value)
    return text if len(text) <= limit else text[: limit - 3] + "..."


def closest(name: str, known: Iterable[str]) -> str:
    """ ", did you mean 'x'?" when a known name is near a misspelt name, else an empty string."""
    near = difflib.get_close_matches(str(name), list(known), n=1, cutoff=0.5)
    return f", did you mean {near[0]!r}?" if near else ""


def plural(count: int, noun: str) -> str:
    """A count and what is counted, for messages: `1 orbit`, `2 orbits`, `3 families`."""
    many = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}es" if noun.endswith("s") else f"{noun}s"
    return f"{count} {noun if count == 1 else many}"
