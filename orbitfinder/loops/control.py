"""What is asked of a controlled motion: its cost, the form of its controls, tasks and limits.

The controls are sums of basis functions of the phase, u(t) = sum_j c_j b_j(t / T): B-splines of degree 0 (held over
each interval), 1 (linear in between) or 3 (cubic, twice differentiable), or a Fourier series. B-splines repeat with the
period; on the arcs of a hybrid system each arc has its own, with nothing said of where arcs meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.expression import expression
from orbitfinder.mechanics.model import Model
from orbitfinder.records.control import DEGREES, MOST, SHAPES
from orbitfinder.records.reading import Entries, Table

METHODS = ("shooting", "collocation")


@dataclass(frozen=True)
class Task:
    """What a controlled motion must do: lowest <= expression <= highest.

    Args:
        expression: text of states, controls and parameters by name.
        at: a phase of the period (0 to 1), everywhere ("always") or on average over the period ("mean").
        equals: stands for both bounds.
        lowest: in the expression's own units; None for none.
        highest: None for none.

    Raises:
        InputError: without a bound, and for both kinds at once.

    Examples:
        >>> there = of.Task("theta1", at=0.5, equals=-0.9)
        >>> of.Control("torque1**2", tasks=(there, of.Task("theta1dot", highest=4.0))).tasks[0].low
        -0.9
    """

    expression: str
    at: float | str = "always"
    equals: float | None = None
    lowest: float | None = None
    highest: float | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if isinstance(self.at, str) and self.at not in ("always", "mean"):
            raise InputError(f"task.at: must be a phase from 0 to 1, 'always' or 'mean', got {self.at!r}")
        if not isinstance(self.at, str) and not 0 <= self.at < 1:
            raise InputError(f"task.at: must be a phase from 0 to below 1, got {self.at!r}; 0 is the start")
        given = [bound for bound in (self.equals, self.lowest, self.highest) if bound is not None]
        if not given or (self.equals is not None and len(given) > 1) or not np.all(np.isfinite(given)):
            raise InputError(f"task: {self.expression!r} needs equals, or lowest, highest or both, as finite numbers")
        if not self.low <= self.high:
            raise InputError(f"task: {self.expression!r} asks for {self.low} to {self.high}; give lowest <= highest")
        if self.at == "always" and self.equals is not None:
            raise InputError(f"task: {self.expression!r} cannot equal a number always; give lowest and highest")

    @property
    def low(self) -> float:
        """The least value, -inf for none."""
        return self.equals if self.equals is not None else -np.inf if self.lowest is None else self.lowest

    @property
    def high(self) -> float:
        """The largest value, inf for none."""
        return self.equals if self.equals is not None else np.inf if self.highest is None else self.highest


@dataclass(frozen=True)
class Control:
    """How a model's controls are chosen: so that the integral of `cost` over the period, or its mean, is least.

    Costs and tasks are text of states, controls and physical parameters by name (`"torque1**2 + 0.1 * theta1**2"`).
    Controls keep within the model's limits.

    Args:
        cost: what is integrated over the period.
        shape: zero-order, linear, cubic or fourier.
        intervals: of the period (in each arc of a hybrid system).
        harmonics: of a Fourier series.
        average: whether the mean over the period is meant.
        final: added to it, of the state at t = 0, parameters and period.
        tasks: what the motion must do.
        method: shooting or collocation.
        guess: where coefficients start, by control: one number for all of them, or each: of splines in the order
            of time, of a Fourier series constant, cos 1, sin 1, cos 2, sin 2, ... of the phase.
        numbers: that cost and tasks use by name, so that `of.follow_optima` may follow them.

    Raises:
        InputError: for an expression that cannot be read.

    Examples:
        >>> cheap = of.Control("torque1**2", shape="linear", intervals=12)
        >>> held = of.pin(theta1=1.0, theta1dot=0.0, period=1.6)
        >>> fast = of.find_orbit(of.Problem(motor, of.Guess([1.0, 0.0], 1.6), held, control=cheap))
        >>> round(fast.control["cost"], 4), fast.certificate.passed
        (0.4995, True)

    See Also:
        `of.Task`, `of.follow_optima`.
    """

    cost: str
    shape: str = "linear"
    intervals: int = 20
    harmonics: int = 5
    average: bool = False
    final: str = ""
    tasks: tuple[Task, ...] = ()
    method: str = "shooting"
    guess: Table = field(default_factory=dict)
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_fields(self)
        for name, value in self.numbers.items():
            if not name.isidentifier() or name in ("pi", "period"):
                raise InputError(f"control.numbers: {name!r} cannot be a name; use letters, digits and _")
            if isinstance(value, (bool, str)) or not np.isfinite(value):
                raise InputError(f"control.numbers.{name}: must be a finite number, got {value!r}")
        for name, known in (("shape", SHAPES), ("method", METHODS)):
            if (given := getattr(self, name)) not in known:
                raise InputError(f"control.{name}: unknown {given!r}{closest(given, known)}; use {', '.join(known)}")
        for name, least in (("intervals", 2), ("harmonics", 0)):
            if not least <= (given := getattr(self, name)) <= MOST[name]:
                raise InputError(f"control.{name}: must be from {least} to {MOST[name]}, got {given}")
        if self.shape == "fourier" and self.intervals < self.harmonics:
            raise InputError(
                f"control.intervals: {self.intervals} are too few for {self.harmonics} harmonics; give more"
            )


@dataclass(frozen=True)
class Basis:
    """The basis functions of each control over the horizon: `fraction` of the period in smooth systems, else the arcs.

    `intervals` is the number in the whole horizon, in each of `arcs` alike; `odd` is 1 or -1 for each control where the
    motion repeats mirrored after the horizon, with the control the same or reversed, else empty.
    """

    shape: str
    intervals: int
    harmonics: int = 0
    arcs: int = 0
    fraction: float = 1.0
    signs: tuple[int, ...] = ()

    @property
    def degree(self) -> int:
        """Degree of the B-splines, -1 of a Fourier series."""
        return DEGREES.get(self.shape, -1)

    @property
    def local(self) -> int:
        """Basis functions that are not 0 in an interval."""
        return self.degree + 1 if self.degree >= 0 else 1 + 2 * self.harmonics

    @property
    def each(self) -> int:
        """Intervals of an arc."""
        return self.intervals // max(self.arcs, 1)

    @property
    def whole(self) -> int:
        """Coefficients of one control, over the whole period."""
        if self.degree < 0:
            return self.local
        if self.arcs:
            return self.arcs * (self.each + self.degree)
        return round(self.intervals / self.fraction)

    def free(self, control: int) -> np.ndarray:
        """E (whole x free) with c = E c', c' the coefficients of a control that a symmetric motion leaves free."""
        if not self.signs:
            return np.eye(self.whole)
        sign = self.signs[control]
        if self.degree >= 0:
            half = np.eye(self.whole // 2)
            return np.vstack([half, sign * half])
        harmonic = np.concatenate([[0], np.repeat(np.arange(1, self.harmonics + 1), 2)])
        return np.eye(self.whole)[:, harmonic % 2 == (0 if sign > 0 else 1)]

    def picked(self, interval: int) -> np.ndarray:
        """Which coefficients belong to the local basis functions of an interval."""
        if self.degree < 0:
            return np.arange(self.whole)
        if not self.arcs:
            return (interval + np.arange(self.local)) % self.whole
        arc, own = divmod(interval, self.each)
        return arc * (self.each + self.degree) + own + np.arange(self.local)

    def values(self, share: Any, phase: Any) -> list[Any]:
        """The local basis functions at a share (0 to 1) of an interval, which is a phase of the period."""
        if self.degree == 0:
            return [1.0]
        if self.degree == 1:
            return [1 - share, share]
        if self.degree == 3:
            rest = 1 - share
            return [
                rest**3 / 6, (3 * share**3 - 6 * share**2 + 4) / 6, (3 * rest**3 - 6 * rest**2 + 4) / 6, share**3 / 6
            ]  # fmt: skip
        values = [1.0]
        for k in range(1, self.harmonics + 1):
            angle = 2 * np.pi * k * phase
            values += [ca.cos(angle), ca.sin(angle)]
        return values

    def phases(self, interval: int) -> tuple[float, float]:
        """The phase at which an interval begins, and its length; 0 on arcs, whose splines ask for none."""
        return (0.0, 0.0) if self.arcs else (self.fraction * interval / self.intervals, self.fraction / self.intervals)


def basis_of(entry: Table) -> Basis:
    """The basis over a whole period of a record's control."""
    arcs = int(entry.get("arcs", 0))
    count = int(entry["intervals"]) * max(arcs, 1)
    return Basis(str(entry["shape"]), count, int(entry["harmonics"]), arcs)


def history(entry: Table, period: float, looks: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Times (k) and values (k x m) of a record's controls over its period, instants where intervals meet twice."""
    edges = np.concatenate([[0.0], np.cumsum(_parts(entry))])
    times = period * (edges[:-1, None] + np.linspace(0.0, 1.0, looks + 1) * np.diff(edges)[:, None]).ravel()
    return times, controls_at(entry, period, times)


def controls_at(entry: Table, period: float, times: np.ndarray) -> np.ndarray:
    """Values (k x m) of a record's controls at times (k, s) of its period; of a time that stands twice, as at events,
    before and after it."""
    basis, rows, parts = basis_of(entry), np.array(entry["coefficients"], float), _parts(entry)
    edges, looks = np.concatenate([[0.0], np.cumsum(parts)]), times / period + 1e-12
    looks[:-1][np.diff(times) <= 1e-13 * period] -= 2e-12
    values = []
    for moment, k in zip(
        times / period, np.clip(np.searchsorted(edges, looks, "right") - 1, 0, len(parts) - 1), strict=True
    ):
        share = min(max((moment - edges[k]) / parts[k], 0.0), 1.0)
        weights = np.array([float(w) for w in basis.values(share, moment)])
        values.append(rows[:, basis.picked(int(k))] @ weights)
    return np.array(values)


def pieces(entry: Table, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the intervals of a record's splines begin and the last ends (K + 1, s), and the coefficients (K x m x 4) of
    each control's polynomial in the share of an interval."""
    basis, rows, parts = basis_of(entry), np.array(entry["coefficients"], float), _parts(entry)
    shares = np.linspace(0.0, 1.0, 4)
    weights = np.array([[float(w) for w in basis.values(share, 0.0)] for share in shares])
    powers = np.linalg.solve(np.vander(shares, increasing=True), weights)
    made = [(powers @ rows[:, basis.picked(k)].T).T for k in range(len(parts))]
    return period * np.concatenate([[0.0], np.cumsum(parts)]), np.array(made)


def _parts(entry: Table) -> np.ndarray:
    """Of each interval of a record's control its part of the period."""
    basis, shares = basis_of(entry), list(entry.get("shares", {}).values())
    if not basis.arcs:
        return np.full(basis.intervals, 1.0 / basis.intervals)
    return np.repeat([*shares, 1.0 - sum(shares)], basis.each) / basis.each


def named(model: Model, x: Any, p: Any, period: Any = None) -> Entries:
    """What expressions may name: components of the state, physical parameters (controls among them), the period."""
    names = {name: p[k] for k, name in enumerate(model.parameter_names)}
    names |= {name: x[k] for k, name in enumerate(model.state_names)}
    return names if period is None else names | {"period": period}


def stated(
    text: str, model: Model, x: Any, p: Any, where: str, period: Any = None, numbers: Table | None = None
) -> Any:
    """An expression of a motion, which may name `numbers` as well. Raises `InputError`."""
    known, more = named(model, x, p, period), numbers or {}
    if taken := sorted(set(known) & set(more)):
        raise InputError(f"control.numbers: {taken[0]!r} is a name of the system already; choose another")
    return expression(text, known | dict(more), where)
