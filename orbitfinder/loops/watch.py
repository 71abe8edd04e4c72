"""A number of an orbit of a user's own: text such as "max(x) - min(x)", or a function of its motion.

A motion is times (k, s), whole period, and states (k x d) there; where a hybrid one jumps, its time stands twice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np
from scipy.integrate import simpson
from scipy.interpolate import BSpline, make_interp_spline

from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.integrate.extent import extent
from orbitfinder.loops.control import named
from orbitfinder.mechanics.expression import expression
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import FamilyPoint

Number = Callable[[np.ndarray, np.ndarray, Mapping[str, float]], float]
"""What makes a number of times, states and parameters by name"""
DRAWS = 3


@dataclass(frozen=True)
class Watch:
    """A watched number, and the `entry` by which files know it: its text, or the name of a function."""

    entry: Any
    of: Number


def watches(given: Mapping[str, str | Number], model: Model) -> dict[str, Watch]:
    """What is watched, by name. Raises `InputError` for what is no number of a motion of this model."""
    taken = {*model.state_names, *model.parameter_names, *(field.name for field in fields(FamilyPoint))}
    watched = {}
    for name, number in given.items():
        if not name.isidentifier() or name in taken:
            raise InputError(f"watch.{name}: no name for a number, or one that orbits have already; choose another")
        watched[name] = Watch(
            as_recorded(number), number if callable(number) else _stated(number, model, f"watch.{name}")
        )
    return watched


def as_recorded(given: str | Number) -> Any:
    """What files say of a number: its text, or the name of the function."""
    if not callable(given):
        return given
    return {"function": f"{given.__module__}.{getattr(given, '__qualname__', type(given).__name__)}"}


def check_stop(stop: Mapping[str, float], watch: Mapping[str, Any]) -> None:
    """`InputError` for values of what is not watched, and for what is no number."""
    for name, value in stop.items():
        if name not in watch:
            known = ", ".join(watch) or "nothing; give watch"
            raise InputError(f"stop.{name}: not watched{closest(name, watch)}; watched is {known}")
        if not isinstance(value, (int, float)) or not np.isfinite(value):
            raise InputError(f"stop.{name}: must be a finite number, got {value!r}; give one that the family reaches")


def numbers(
    watch: Mapping[str, Watch], times: np.ndarray, states: np.ndarray, parameters: Mapping[str, float]
) -> dict[str, float]:
    """The watched numbers of a motion. Raises `ConvergenceError` where one is not finite."""
    values = {name: float(number.of(times, states, parameters)) for name, number in watch.items()}
    for name, value in values.items():
        if not np.isfinite(value):
            raise ConvergenceError(f"watch.{name}: {value} there, and no finite number")
    return values


def unsure(
    watch: Mapping[str, Watch], times: np.ndarray, states: np.ndarray, parameters: Mapping[str, float], share: float
) -> dict[str, float]:
    """What errors of such a share of a motion's sizes make of its numbers, the most in some draws."""
    known, spread = numbers(watch, times, states, parameters), dict.fromkeys(watch, 0.0)
    random, wrong = np.random.default_rng(0), share * np.abs(states).max(axis=0)
    for _ in range(DRAWS):
        noise = wrong * (random.normal(size=states.shape) + random.normal(size=states.shape[1]))
        other = numbers(watch, times, states + noise, parameters)
        spread = {name: max(most, abs(other[name] - known[name])) for name, most in spread.items()}
    return spread


def arcs(times: np.ndarray) -> list[slice]:
    """The parts of a motion between its jumps."""
    cuts = [0, *np.flatnonzero(np.diff(times) == 0) + 1, len(times)]
    return [slice(a, b) for a, b in pairwise(cuts)]


def _stated(text: str, model: Model, where: str) -> Number:
    """The number of a text in which max(), min(), mean(), amplitude() and phase() are over the motion."""
    x, p, period = ca.SX.sym("x", len(model.state_names)), ca.SX.sym("p", len(model.parameter_names)), ca.SX.sym("T")
    reductions = []

    def over(reduce: Callable[[np.ndarray, np.ndarray], float]) -> Callable[[Any], Any]:
        def reduced(inner: Any) -> Any:
            reductions.append((reduce, inner, ca.SX.sym("r")))
            return reductions[-1][2]

        return reduced

    def harmonic(part: Callable[[complex], Any]) -> Callable[[Any, Any], Any]:
        def reduced(inner: Any, order: Any) -> Any:
            if not isinstance(order, float) or order < 1 or order % 1:
                raise InputError(f"{where}: {text!r}: harmonics are 1, 2, ...; give that number last")
            return over(lambda t, y: float(part(_harmonic(t, y, int(order)))))(inner)

        setattr(reduced, "count", 2)  # noqa: B010 - which no type of a function has
        return reduced

    calls: dict[str, Callable[..., Any]] = {
        "min": over(lambda t, y: range_of(t, y[:, None])[0, 0]), "amplitude": harmonic(abs),
        "max": over(lambda t, y: range_of(t, y[:, None])[1, 0]), "phase": harmonic(np.angle), "mean": over(mean),
    }  # fmt: skip
    outer = ca.SX(expression(text, named(model, x, p, period), where, calls))
    if ca.depends_on(outer, x):
        raise InputError(f"{where}: {text!r} varies along an orbit; put what does into max(), min(), mean(), "
                         "amplitude() or phase()")  # fmt: skip
    known = ca.vertcat(ca.SX(0, 1), *(symbol for _, _, symbol in reductions))
    given = [x, p, period, known]
    inner = [ca.Function("inner", given, [inside]) for _, inside, _ in reductions]
    last = ca.Function("outer", given, [outer])

    def of(times: np.ndarray, states: np.ndarray, parameters: Mapping[str, float]) -> float:
        values = np.zeros(len(reductions))
        about = np.array([parameters[name] for name in model.parameter_names]), times[-1] - times[0]
        for k, (reduce, _, _) in enumerate(reductions):  # each may be in terms of those before it
            values[k] = reduce(times, inner[k](states.T, *about, values).full().ravel())
        return float(last(states[0], *about, values))

    return of


def range_of(times: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Least and greatest values (2 x d) of a motion, between its samples too."""
    parts = [(times[arc], states[arc]) for arc in arcs(times)]
    both = np.array([extent(t, x, _spline(t, x)(t, nu=1)) for t, x in parts])
    return np.array([both[:, 0].min(axis=0), both[:, 1].max(axis=0)])


def _spline(times: np.ndarray, values: np.ndarray) -> BSpline:
    return make_interp_spline(times, values, min(7, times.size - 1))


def mean(times: np.ndarray, values: np.ndarray) -> float:
    """The mean over the period: of equal steps to the fourth order, or to any order of periodic values; of graded ones
    by splines of degree 7."""
    total = 0.0
    for arc in arcs(times):
        t, own = times[arc], values[arc]
        equal = np.ptp(np.diff(t)) < 1e-12 * np.ptp(t)
        total += simpson(own, x=t) if equal else _spline(t, own).integrate(t[0], t[-1])
    return float(total / (times[-1] - times[0]))


def _harmonic(times: np.ndarray, values: np.ndarray, order: int) -> complex:
    """c of the harmonic Re(c e^(2 pi i order t / T)) = |c| cos(2 pi order t / T + arg c)."""
    turn = 2 * np.pi * order * (times - times[0]) / (times[-1] - times[0])
    return 2 * complex(mean(times, values * np.cos(turn)), -mean(times, values * np.sin(turn)))
