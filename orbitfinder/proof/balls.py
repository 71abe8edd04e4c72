"""Arb balls: how floats, decimals, boxes and matrices become ball numbers, and back.

A ball [m +- r] stands for every real number in it. Arb (python-flint) rounds every operation
outwards: F. Johansson, "Arb: efficient arbitrary-precision midpoint-radius interval arithmetic",
IEEE Transactions on Computers 66 (2017) 1281-1292.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from orbitfinder._runtime import __version__
from orbitfinder.errors import InputError


class _Missing:
    """Stands for python-flint, and for each of its names, where it is not installed or old: says so when it is used."""

    __version__ = "none"

    def __init__(self, why: str) -> None:
        self.why = why

    def __getattr__(self, name: str) -> _Missing:
        if name.startswith("__"):
            raise AttributeError(name)
        return self() if name == "ctx" else self

    def __call__(self, *_: Any) -> _Missing:
        raise InputError(
            f"proofs need python-flint (ball arithmetic), which is {self.why}; "
            "install orbitfinder with its extra 'proof': pip install 'orbitfinder[proof]'"
        )


try:
    import flint

    if not hasattr(flint.arb_poly, "truncate"):
        flint = _Missing(f"{flint.__version__}, older than 0.8")
except ImportError:  # pragma: no cover - depends on what is installed
    flint = _Missing("not installed")

arb, arb_mat, arb_poly, arb_series, fmpq = flint.arb, flint.arb_mat, flint.arb_poly, flint.arb_series, flint.fmpq
acb, acb_mat = flint.acb, flint.acb_mat
FLINT = flint.__version__
Vector = list[Any]
"""ball numbers, one per component"""


@contextlib.contextmanager
def _setting(name: str, value: int) -> Iterator[None]:
    """One of Arb's settings, restored afterwards."""
    before = getattr(flint.ctx, name)
    setattr(flint.ctx, name, value)
    try:
        yield
    finally:
        setattr(flint.ctx, name, before)


precision = partial(_setting, "prec")
"""Arb's working precision in bits"""
truncated = partial(_setting, "cap")
"""The length beyond which Arb cuts power series off"""


def why_not(error: Exception) -> str:
    """Why a proof ended, in a sentence; Arb's own errors have none."""
    if type(error) in (ZeroDivisionError, ValueError):
        return "a divisor may be 0, or a matrix singular, within its balls; give more bits, or shorter segments"
    return str(error)


def decimal(number: float) -> Any:
    """The ball of what a float is written as: 9.8 is 49/5, not the double nearest to it."""
    if not np.isfinite(number):
        raise InputError(f"a proof needs finite numbers, got {number}; compute the orbit again")
    text = f"{float(number)!r}e0" if "e" not in repr(float(number)) else repr(float(number))
    mantissa, exponent = text.split("e")
    whole, _, places = mantissa.partition(".")
    shift = int(exponent) - len(places)
    digits = int(whole + places)
    return arb(fmpq(digits * 10 ** max(shift, 0), 10 ** max(-shift, 0)))


def between(low: Any, high: Any) -> Any:
    """The ball that contains [low, high]."""
    return arb(low).union(arb(high))


def up_to(h: Any) -> Any:
    """The ball that contains [0, h] (or [h, 0])."""
    return arb(0).union(h)


def midpoints(vector: Iterable[Any]) -> Vector:
    """Exact centres of balls."""
    return [x.mid() for x in vector]


def magnitude(vector: Iterable[Any]) -> float:
    """A float at least as large as every |x| (NaN balls give infinity)."""
    return max((_above(abs(x).upper()) for x in vector), default=0.0)


def radius(vector: Iterable[Any]) -> float:
    """A float at least as large as every radius."""
    return max((_above(arb(x.rad()).upper()) for x in vector), default=0.0)


def _above(x: Any) -> float:
    """A float not below a ball."""
    if not x.is_finite():
        return np.inf
    return float(np.nextafter(float(x.upper()), np.inf))


def inside(outer: Sequence[Any], inner: Sequence[Any]) -> bool:
    """True when every inner ball lies in the interior of its outer one."""
    return all(y.is_finite() and x.contains_interior(y) for x, y in zip(outer, inner, strict=True))


def column(vector: Sequence[Any]) -> Any:
    """A column matrix of balls."""
    return arb_mat(len(vector), 1, list(vector))


def exact(matrix: np.ndarray) -> Any:
    """A matrix of balls that are exactly these floats."""
    rows, columns = matrix.shape
    return arb_mat(rows, columns, matrix.ravel().tolist())


def floats(matrix: Any) -> np.ndarray:
    """Centres of a matrix of balls, rounded to floats."""
    return np.array([float(x.mid()) for x in matrix.entries()]).reshape(matrix.nrows(), matrix.ncols())


def block(matrix: Any, rows: int, first: int, last: int) -> Any:
    """The first `rows` rows and columns first..last of a matrix."""
    width, values = matrix.ncols(), matrix.entries()
    return arb_mat(rows, last - first, [x for i in range(rows) for x in values[i * width + first : i * width + last]])


def dense(entries: Mapping[int, Any], rows: int, columns: int) -> Any:
    """A matrix of balls from its column-major entries, what is absent 0."""
    return arb_mat(rows, columns, [entries.get(i + rows * j, arb(0)) for i in range(rows) for j in range(columns)])


def eigenvalues(matrix: Any) -> tuple[list[Any], bool]:
    """Balls that hold all eigenvalues, and whether each holds a single eigenvalue. Raises `ValueError`."""
    try:
        return list(matrix.eig(algorithm="rump")), True
    except ValueError:
        return list(acb_mat(matrix).eig(multiple=True, algorithm="rump")), False


class Versioned:
    """A record of a proof: it says what it was made by."""

    @property
    def versions(self) -> dict[str, str]:
        """What it was made by."""
        return {"orbitfinder": __version__, "python-flint": FLINT}

    @property
    def kept(self: Any) -> bool:
        """Whether it is worth a file."""
        return bool(self.proved)

    @property
    def lines(self: Any) -> list[str]:
        """Whether it is proved, and line by line what, or why not."""
        if not self.proved:
            return [f"not proved: {self.reason}"]
        return [f"proved in {self.wall_time:.1f} s", *(f"  {name:<12}{said}" for name, said in self.words)]


def identity(size: int) -> Any:
    """The unit matrix."""
    return exact(np.eye(size))


def radii(matrix: Any) -> np.ndarray:
    """Upper bounds of the radii of a matrix of balls."""
    return np.array([_above(arb(x.rad()).upper()) for x in matrix.entries()]).reshape(matrix.nrows(), matrix.ncols())
