"""What was asked of a record, number by number, and the verdict: checks are judged here alone."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.records.codec import Filed, Unknown, entries_of
from orbitfinder.records.reading import Entries, typed

AT_MOST, AT_LEAST, EQUAL = "\N{LESS-THAN OR EQUAL TO}", "\N{GREATER-THAN OR EQUAL TO}", ""
"""What a check may ask of its number and its tolerance; EQUAL where only yes or no was asked, whose tolerance is 0"""


@dataclass(frozen=True)
class Check(Shown):
    """A question asked of an orbit: its number, the number allowed, the answer."""

    _sparse = ("asked",)

    name: str
    value: Unknown
    tolerance: float
    passed: bool
    note: str = ""
    asked: str = ""
    """`AT_LEAST` where no finite number shows it"""

    @property
    def sense(self) -> str:
        """`AT_MOST`, `AT_LEAST` or `EQUAL`: mostly from number and answer alone, with which it cannot disagree."""
        if self.asked or not self.tolerance:
            return self.asked or EQUAL
        return AT_LEAST if (self.value > self.tolerance if self.passed else self.value < self.tolerance) else AT_MOST

    @property
    def skipped(self) -> bool:
        """Whether nothing was asked."""
        return self.passed and math.isnan(self.value)

    def _check(self) -> None:
        if self.asked not in ("", AT_LEAST):
            raise ValueError(f"asked: expected {AT_LEAST!r} or nothing, got {self.asked[:60]!a}")


def at_most(name: str, value: Any, tolerance: float, note: str = "", also: bool = True) -> Check:
    """The check that a number is no larger than what is allowed, and that something else holds too."""
    return Check(name, float(value), float(tolerance), bool(value <= tolerance and also), note)


def at_least(name: str, value: Any, tolerance: float, note: str = "") -> Check:
    """The check that a number is no smaller than what is wanted."""
    asked = "" if math.isfinite(value) else AT_LEAST
    return Check(name, float(value), float(tolerance), bool(value >= tolerance), note, asked)


def equal(name: str, value: float, wanted: float, note: str = "") -> Check:
    """The check that a number is what is wanted."""
    return Check(name, float(value), float(wanted), bool(value == wanted), note)


def same(name: str, recorded: str, computed: str) -> Check:
    """The check that a record's word is what was computed."""
    note = "as recorded" if recorded == computed else f"recorded {recorded[:60]}, found {computed[:60]}"
    return equal(name, recorded != computed, 0.0, note)


def refused(name: str, why: object, value: float = float("inf"), tolerance: float = 0.0) -> Check:
    """The check that fails because there is no number, or none that could be allowed."""
    return Check(name, value, tolerance, False, str(why))


def skipped(name: str, why: object) -> Check:
    """What stands for a check that a record does not allow: it fails nothing, and says so."""
    return Check(name, float("nan"), 0.0, True, f"not checked: {why}")


@dataclass(frozen=True)
class Certificate(Shown):
    """Every check of an orbit; `passed` only when all of them did, `failures` names the others.

    Args:
        checks: name, number, what is allowed and a note of each.
        scale: A, how many times round-off grows until the end of the period, at most 1e6: what tolerances were
            multiplied by.
        closure: the largest component of the gap round the loop, in the model's units.
        period_error: by how much the true orbit's period may differ from the recorded one, at the same energy where
            there is one (s): from the gap and from what round-off can add; 0 where the period is prescribed.

    Examples:
        >>> certificate = of.certify(orbit)
        >>> [check.name for check in certificate.checks][:3]
        ['closure', 'distance', 'second_closure']
    """

    __repr__ = brief("passed", "failures", "closure")
    _entries = ("passed", "scale", "closure", "period_error", "checks")

    checks: tuple[Check, ...]
    scale: float = 1.0
    closure: Unknown = float("nan")
    period_error: Unknown = float("nan")

    @property
    def passed(self) -> bool:
        """True when every check passed."""
        return all(check.passed for check in self.checks)

    @property
    def failures(self) -> tuple[str, ...]:
        """Names of the checks that failed."""
        return tuple(check.name for check in self.checks if not check.passed)


def certified(record: Any) -> bool:
    """Whether a record has a certificate, and it passed."""
    return record.certificate is not None and bool(record.certificate.passed)


def certificate_to_document(certificate: Certificate | None) -> Entries:
    """The `certificate` entry of a file."""
    return {"passed": False, "scale": 1.0, "checks": []} if certificate is None else entries_of(certificate)


def certificate_of(entry: Any, where: str) -> Certificate | None:
    """The certificate of an entry, None where nothing was checked. Raises `ValueError`."""
    certificate: Certificate = typed(Certificate, entry or {"checks": []}, where)
    return certificate if certificate.checks else None


Certified = Annotated[Certificate | None, Filed(certificate_to_document, certificate_of)]
"""A certificate, if there is one"""
