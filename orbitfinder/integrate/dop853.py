"""The second integrator: Hairer's own DOP853 as SciPy ships it, at its tightest, on any CasADi vector field.

It shares nothing with CVODES: another method (explicit Runge-Kutta of order 8 after Hairer,
Norsett and Wanner, Solving Ordinary Differential Equations I, section II.10), another code; nor with
`runge_kutta`, whose steps are fixed and made by CasADi. `scipy.integrate.ode` steps in C (Fortran before
SciPy 1.17), four times faster than SciPy's DOP853 class steps in Python. Of a `CompiledField` that much is asked of
the same steps, with the same bits, are taken by `dop853.c`.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import DOP853, ode

from orbitfinder._runtime import limit
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.field import CompiledField, Steps, VectorField, rates_of, scaled


@dataclass(frozen=True)
class ReferenceSettings:
    """Tolerances of DOP853, the relative one near 100 machine epsilons, below which round-off steers the steps."""

    relative_tolerance: float = 2.3e-14
    absolute_tolerance: float = 1e-15
    max_evaluations: int = 1_000_000


STEPS_PER_PERIOD = 400
"""A period in at least this many steps: on triple 2 the closure falls from 5e-13 (400) to 1e-13."""
EVALUATIONS_PER_STEP = 12

TIGHTEST = ReferenceSettings()
SECOND = ReferenceSettings(relative_tolerance=1e-12, absolute_tolerance=1e-13)
FAILURES = {-2: "too many evaluations", -3: "the step size becomes too small", -4: "the equations are probably stiff"}


@dataclass(frozen=True)
class Trace:
    """The accepted steps of an integration: moments (k), states (k x n), and rates f(t, y) of rows of states.

    `drift` (n) is how far a closed motion goes on in a period.
    """

    moments: np.ndarray
    states: np.ndarray
    rates: Callable[[np.ndarray, np.ndarray], np.ndarray]
    together: bool
    """whether rates of many states come from one call"""
    drift: np.ndarray | float = 0.0
    field: CompiledField | None = None
    """of which the rates are, where it may be compiled"""
    retaken: Callable[[np.ndarray], float] | None = None
    """moments within a step -> how far the motion, known in more digits, moves when its steps end at these too"""

    def at(self, times: np.ndarray) -> np.ndarray:
        """States at times from the first moment to the last, each by a step of DOP853 from that before."""
        times = np.asarray(times, float)
        before = np.searchsorted(self.moments, times, side="right") - 1
        starts, states, spans = self.moments[before], self.states[before], times - self.moments[before]
        if self.field is not None and (ends := self.field.stepped(starts, states, spans)) is not None:
            return ends
        across, stages = spans[:, None], [self.rates(starts, states)]  # summed in the order of `dop853.c`
        for share, row in zip(DOP853.C[1:], DOP853.A[1:], strict=True):
            stages.append(self.rates(starts + share * spans, states + across * _weighted(row, stages)))
        return np.asarray(states + across * _weighted(DOP853.B, stages))

    def strayed(self, slopes: np.ndarray, step: np.ndarray, moments: np.ndarray) -> np.ndarray | None:
        """How far rates at moments (m), each within a `step`, are off the curve through the states and these slopes
        (k x n), where that is compiled."""
        return None if self.field is None else self.field.strayed(self.moments, self.states, slopes, step, moments)


@dataclass
class _Steps:
    """What DOP853 calls: the field, and a list of its accepted steps. The first exception is kept for later.

    SciPy's C code goes on with an exception pending, so none may leave a callback.
    """

    function: VectorField
    moments: list[float] = field(default_factory=list)
    states: list[np.ndarray] = field(default_factory=list)
    errors: list[BaseException] = field(default_factory=list)
    unchecked: int = 0
    """evaluations before the limit of time is looked at again"""

    def failed(self, error: BaseException, t: float, y: np.ndarray) -> np.ndarray:
        """NaN from now on, or DOP853 would try a shorter step."""
        self.errors.append(error)
        self.function = _nowhere
        return _nowhere(t, y)

    def check(self) -> None:
        """Look at the limit of time, once in a step or so."""
        limit.check()
        self.unchecked = EVALUATIONS_PER_STEP

    def accepted(self, t: float, y: np.ndarray) -> int:
        """Note a step; -1 ends the integration."""
        self.moments.append(t)
        self.states.append(y.copy())
        return -1 if self.errors else 0


@np.errstate(over="ignore", invalid="ignore")  # what is not finite is raised
def integrate(
    field: VectorField,
    state: np.ndarray,
    times: np.ndarray,
    settings: ReferenceSettings = TIGHTEST,
    longest_step: float = np.inf,
    traces: list[Trace] | None = None,
) -> np.ndarray:
    """States (k x n) at increasing `times` (k > 2 for its `traces`, the first is the start), by DOP853.

    `longest_step` (s) buys digits that the smallest sensible relative tolerance does not give.

    Raises `IntegrationError` when the step size underflows or the state is not finite.
    """
    times, start = np.asarray(times, float), np.asarray(state, float)
    if not np.all(np.isfinite(start)):
        raise IntegrationError("the start is not finite", time=float(times[0]), state=start)
    if times[-1] == times[0]:
        return np.repeat(start[None], times.size, axis=0)
    if not np.all(np.abs(field(float(times[0]), start)) < 1e100):  # also where the state is NaN
        raise IntegrationError("the equations of motion overflow there", time=float(times[0]), state=start)
    steps = _stepped(field, start, times, settings, longest_step)
    if steps.code < 0:
        raise IntegrationError(FAILURES.get(steps.code, f"DOP853 returned {steps.code}"), time=steps.time, state=start)
    own = field if isinstance(field, CompiledField) else None
    trace = Trace(steps.moments, steps.states, *rates_of(field), field=own)
    inner = trace.at(times[1:-1]) if times.size > 2 else np.zeros((0, start.size))
    if traces is not None:
        traces.append(trace)
    states = np.vstack([start, inner, steps.state])
    if not np.all(np.isfinite(states)):
        raise IntegrationError("the state is not finite", time=float(times[-1]), state=start)
    return states


def integrate_in(
    units: np.ndarray,
    field: VectorField,
    start: np.ndarray,
    times: np.ndarray,
    settings: ReferenceSettings = TIGHTEST,
    longest_step: float = np.inf,
    traces: list[Trace] | None = None,
) -> np.ndarray:
    """`integrate` with the components measured in `units`, in its traces too; states in their own."""
    return np.asarray(integrate(scaled(field, units), start / units, times, settings, longest_step, traces) * units)


def _stepped(
    field: VectorField, start: np.ndarray, times: np.ndarray, settings: ReferenceSettings, longest: float
) -> Steps:
    """The steps to the last time, noted where states between are wanted: compiled, or SciPy's."""
    # DOP853 adds up its steps: multiples of the clock's resolution add up exactly, others drift by 6e-14 in 800
    tick = float(np.spacing(np.abs(times[[0, -1]]).max()))
    span, noted = (float(times[0]), float(times[-1])), times.size > 2
    at_most = max(1, settings.max_evaluations // EVALUATIONS_PER_STEP)
    tolerances = settings.relative_tolerance, settings.absolute_tolerance
    given = start, tolerances, float(np.floor(min(longest, span[1] - span[0]) / tick) * tick), at_most, noted
    if isinstance(field, CompiledField):
        return field.integrated(span, *given, lambda: _interpreted(field.rate, span, *given))
    return _interpreted(field, span, *given)


def _interpreted(
    rate: VectorField, span: tuple[float, float], start: np.ndarray, tolerances: tuple[float, float],
    longest: float, most: int, noted: bool,
) -> Steps:  # fmt: skip
    """The same by SciPy's DOP853, which calls a function of Python."""
    solver: Any = ode(_rate).set_integrator(
        "dop853", rtol=tolerances[0], atol=tolerances[1], nsteps=most, max_step=longest
    )
    steps = _Steps(rate)
    if noted:
        solver.set_solout(steps.accepted)
    if solver._integrator._solout.__func__.__code__.co_argcount == 3:  # (self, x, y) since SciPy 1.17
        solver._integrator._solout = _accepted
    solver.set_initial_value(start, span[0])
    outer = getattr(_under_way, "steps", None)
    _under_way.steps = steps
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # SciPy's, of failures: they are raised here
            end = solver.integrate(span[1])
        if steps.errors:
            raise _root(steps.errors[0])
        code = 1 if solver.successful() else int(solver.get_return_code())
        return Steps(
            code, float(solver.t), np.asarray(end), np.array(steps.moments), np.reshape(steps.states, (-1, start.size))
        )
    except ValueError as error:  # an interrupt between two callbacks
        raise _root(error) from None
    finally:
        _under_way.steps = outer
        vars(steps).clear()  # the field, 0.1 MB and more of steps, whoever still has it


_under_way = threading.local()
"""The `_Steps` of this thread's integration: SciPy 1.17 never lets go of what it has called, so it calls these"""


def _rate(t: float, y: np.ndarray) -> np.ndarray:
    steps: _Steps = _under_way.steps
    try:
        steps.unchecked -= 1
        if steps.unchecked < 0:
            steps.check()
        return steps.function(t, y)
    except BaseException as error:
        return steps.failed(error, t, y)


def _accepted(t: float, y: np.ndarray) -> int:
    return _under_way.steps.accepted(t, y)  # type: ignore[no-any-return]


def _nowhere(_: float, y: np.ndarray) -> np.ndarray:
    return np.full(y.shape, np.nan)


def _root(error: BaseException) -> BaseException:
    """The exception that C code wrapped in others, if it did."""
    while isinstance(error, (ValueError, SystemError)) and error.__cause__ is not None:
        error = error.__cause__
    return error


def _weighted(row: np.ndarray, stages: list[np.ndarray]) -> Any:
    return sum(weight * stage for weight, stage in zip(row, stages, strict=False) if weight)
