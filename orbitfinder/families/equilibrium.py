"""Equilibria as plain numbers, and their file (format "orbitfinder/equilibria")."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.records.codec import Codec, Complexes, Unknown
from orbitfinder.records.family import End, Reading, check_curve
from orbitfinder.records.table import Tabled


@dataclass(frozen=True)
class Equilibrium(Shown):
    """A state x at which x' = f(x, p) = 0.

    Args:
        state: x (d), rates 0.
        value: of the parameter.
        eigenvalues: of the slopes of f (1/s), those that an integral or a constraint makes 0 left out.
        stability: stable | unstable | neutral (all on the imaginary axis, or left of it), real parts compared with the
            error bar of each eigenvalue by its own condition.
        arclength: along the curve.
        residual: largest rate by other equations, in the equilibrium's own sizes and pace.
        certified: whether that, and the eigenvalues from differences of those, agree.
        kind: along a curve in two parameters: fold | hopf | neutral_saddle.
        values: of both parameters there.
        normal_form: "a" of a fold, <p, B(q, q)> / 2 with <q, q> = <p, q> = 1; "l1" of a Hopf point.

    Examples:
        >>> rest = equilibria.points[0]
        >>> rest.stability, rest.certified
        ('stable', True)
    """

    __repr__ = brief("value", "stability", "certified")
    _sparse = ("kind", "values", "normal_form")
    state: np.ndarray
    value: float
    eigenvalues: Complexes
    stability: str
    arclength: float = 0.0
    residual: Unknown = np.nan
    certified: bool = False
    kind: str = ""
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    normal_form: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class RestEvent(Shown):
    """Something that happens between two equilibria, solved for.

    `kind`: fold | branch_point | hopf | neutral_saddle (eigenvalues +-a that cross nothing); along a curve in two
    parameters cusp | bogdanov_takens | generalised_hopf | fold_hopf | double_hopf.

    Args:
        kind: what.
        index: of the point before it.
        arclength: along the curve.
        parameter: value of the parameter.
        error: its error bar.
        state: x (d).
        eigenvalues: there.
        check: the critical eigenvalue by the certificate's integrator: 0 where it is as claimed.
        frequency: of Hopf points, omega in rad/s.
        period: 2 pi / omega.
        period_error: its error bar.
        lyapunov: the first Lyapunov coefficient, <p, q> = <q, q> = 1, divided by 2 omega (Yu. Kuznetsov, Elements of
            Applied Bifurcation Theory (2004), section 5.4).
        lyapunov_error: its error bar.
        criticality: supercritical | subcritical | degenerate, where the coefficient is 0 to its error bar ("" in
            files of earlier versions).
        critical: the eigenvalue that it is told by.
        direction: of branch points the other branch's, over (x, p); of Hopf points Re q and Im q.
        values: of both parameters, along a curve in two.
        errors: their error bars.
        normal_form: of a cusp c of w' = c w^3, of Bogdanov-Takens points a > 0 and b of w'' = a w^2 + b w w'.

    Examples:
        >>> equilibria.events[0].kind, equilibria.events[0].criticality
        ('hopf', 'supercritical')
    """

    __repr__ = brief(
        "kind", "parameter", "error", "frequency", "period", "lyapunov", "lyapunov_error", "criticality", "index"
    )
    _sparse = ("check", "direction", "criticality", "values", "errors", "normal_form")

    kind: str
    index: int
    arclength: float
    parameter: float
    error: float
    state: np.ndarray
    eigenvalues: Complexes
    check: Reading | None = None
    frequency: Unknown = np.nan
    period: Unknown = np.nan
    period_error: Unknown = np.nan
    lyapunov: Unknown = np.nan
    lyapunov_error: Unknown = np.nan
    criticality: str = ""
    critical: complex = 0.0 + 0.0j
    direction: np.ndarray = field(default_factory=lambda: np.zeros(0))
    values: np.ndarray = field(default_factory=lambda: np.zeros(0))
    errors: np.ndarray = field(default_factory=lambda: np.zeros(0))
    normal_form: Mapping[str, float] = field(default_factory=dict)

    @property
    def consistent(self) -> bool:
        """Whether the eigenvalue that it is told by is one of its kind."""
        return self.kind in CRITICAL and CRITICAL[self.kind](self)

    @property
    def words(self) -> str:
        """What happens, for reading."""
        return f"{self.criticality} {self.kind}".strip().replace("_", " ").replace("bogdanov takens", "Bogdanov-Takens")


CRITICAL: dict[str, Callable[[RestEvent], bool]] = {
    "fold": lambda event: event.critical == 0.0,
    "branch_point": lambda event: event.critical == 0.0,
    "hopf": lambda event: event.critical == 1j * event.frequency and event.frequency > 0,
    "neutral_saddle": lambda event: event.critical.imag == 0.0 and event.critical.real > 0,
}
"""Every kind of event, and what its critical eigenvalue is"""


@dataclass(frozen=True)
class Equilibria(Tabled):
    """Equilibria along a parameter, or folds or Hopf points of equilibria along two.

    Args:
        name: a word for files.
        system: plain description that rebuilds the model.
        parameter: what is followed in.
        points: in order.
        events: by arclength.
        ends: why it ends, before the first point and behind the last.
        curve: of a curve in two parameters: the test that vanishes along it, both parameters, the pace of its rates.
        title: what pictures are headed with; the name where it is empty.

    Examples:
        >>> equilibria.parameter, [event.kind for event in equilibria.events], equilibria.ends[-1].kind
        ('rate', ['hopf'], 'target')
    """

    __repr__ = brief("name", "parameter", "points", "events", "ends")
    _sparse = ("curve", "title")
    _tables = "families.table:equilibria_tables"
    name: str
    system: Mapping[str, Any]
    parameter: str
    points: tuple[Equilibrium, ...]
    events: tuple[RestEvent, ...] = ()
    ends: tuple[End, ...] = ()
    curve: Mapping[str, Any] = field(default_factory=dict)
    title: str = ""

    @property
    def parameters(self) -> tuple[str, ...]:
        """What varies: a parameter, or two."""
        return tuple(self.curve.get("parameters", (self.parameter,)))

    @property
    def places(self) -> np.ndarray:
        """Of a curve in two parameters: their values (k x 2) at the points and then at the events."""
        return np.array([*(point.values for point in self.points), *(event.values for event in self.events)])

    @property
    def unknown(self) -> tuple[str, ...]:
        """Between which points the number of growing eigenvalues changes as no event there explains, in sentences."""
        counts = [(k, point, growing(point)) for k, point in enumerate(self.points) if point.stability != "neutral"]
        changes, sentences = {"fold": (-1, 1), "branch_point": (-1, 0, 1), "hopf": (-2, 2)}, list[str]()
        branch = all(point.arclength for point in self.points)  # begins between two, at its parent's branch point
        for (i, before, (least, most)), (j, after, (fewest, greatest)) in pairwise(counts):
            reached = {-1, 0, 1} if branch and before.arclength * after.arclength < 0 else {0}
            for event in self.events:
                if i <= event.index < j:
                    reached = {more + change for more in reached for change in changes.get(event.kind, (0,))}
            if not self.curve and not any(fewest - most <= change <= greatest - least for change in reached):
                sentences.append(
                    f"unknown: the number of growing eigenvalues is {least} at {self.parameter} {before.value:.12g} "
                    f"and {fewest} at {after.value:.12g}, and no event between them explains the change; several may "
                    "cross at once: change another parameter to separate them"
                )
        return tuple(sentences)

    def _check(self) -> None:
        if len({(point.state.shape, point.eigenvalues.shape) for point in self.points}) != 1:
            raise ValueError("points: expected one at least, all of one number of components and eigenvalues")
        check_curve(self.curve)
        shape, size = self.points[0].state.shape, 2 * ("parameters" in self.curve)
        members: tuple[Equilibrium | RestEvent, ...] = (*self.points, *self.events)
        for k, member in enumerate(members):
            where = f"events[{k - len(self.points)}]" if k >= len(self.points) else f"points[{k}]"
            place = member.parameter if isinstance(member, RestEvent) else member.value
            if member.state.shape != shape or np.size(member.values) != size:
                raise ValueError(f"{where}: state or values: {member.state.size} and {np.size(member.values)} numbers "
                                 f"where the curve has {shape[0]} and {size}")  # fmt: skip
            if not max(abs(place), np.abs(member.state).max()) < 1e100:
                raise ValueError(f"{where}: parameter, value or state is beyond 1e+100")


def stability(values: np.ndarray, errors: np.ndarray) -> str:
    """The verdict on eigenvalues with error bars: stable | unstable | neutral."""
    real = values.real
    return "unstable" if (real > errors).any() else "stable" if (real < -errors).all() else "neutral"


def growing(point: Equilibrium) -> tuple[int, int]:
    """How many eigenvalues have positive real parts, at least and at most."""
    if point.stability == "stable":
        return 0, 0
    real, unsure = point.eigenvalues.real, UNDECIDED * float(np.abs(point.eigenvalues).max(initial=0.0))
    return max(1, int((real > unsure).sum())), int((real > -unsure).sum())


EQUILIBRIA, UNDECIDED = "equilibria", 1e-9
"""Their format; a real part below this share of the largest may have either sign, and was 0 in older files"""
CODEC = Codec(Equilibria, EQUILIBRIA, "`orbitfinder equilibria`", "compute the equilibria again")


def save_equilibria(found: Equilibria, path: str | Path) -> Path:
    """Write an equilibria.json.

    Args:
        found: the equilibria.
        path: where.

    Returns:
        The path.

    Raises:
        InputError: where it cannot be written.

    Examples:
        >>> of.save_equilibria(equilibria, "equilibria.json").name
        'equilibria.json'
    """
    return CODEC.save(found, path)


def load_equilibria(path: str | Path) -> Equilibria:
    """Read an equilibria.json.

    Args:
        path: of the file.

    Returns:
        Equilibria.

    Raises:
        InputError: on anything unreadable.

    Examples:
        >>> _ = of.save_equilibria(equilibria, "equilibria.json")
        >>> len(of.load_equilibria("equilibria.json").events)
        1
    """
    return CODEC.load(path)
