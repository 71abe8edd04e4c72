"""How far a motion may be pushed off its orbit for a controller to bring it back, and what that takes: by simulation.

The controller is the one that is exported, sampled: it measures the state, with noise where asked, finds its place on
the orbit and holds the controls, within their limits, until the next sample. All disturbed motions go side by side by
the eighth-order march. They are seeded: directions are uniform on the sphere, in extents of the orbit, their places on
it uniform in time. Of a hybrid system the guard of the period's event is watched from sample to sample; a motion whose
mode does not hold, or that another event ends, is lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.control.controller import CODEC, Basin, Controller, Returned
from orbitfinder.control.export import law_of
from orbitfinder.errors import InputError
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.parallel import STAGES, Lanes
from orbitfinder.integrate.rk8 import step_of
from orbitfinder.mechanics.constrained import constraint_rows, tangent_basis
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, constraint_of, vector_field
from orbitfinder.mechanics.newton import closed, least_norm
from orbitfinder.records.codec import plain
from orbitfinder.records.journal import checkpoints, fill, packed, unpacked
from orbitfinder.records.reading import content_digest


@dataclass(frozen=True)
class Recovery:
    """A disturbed motion: times (k, s), states (k x d), controls (k x m) held from each, distance (k) in extents."""

    times: np.ndarray
    states: np.ndarray
    controls: np.ndarray
    distance: np.ndarray


@dataclass(frozen=True)
class _Plan:
    """Where motions begin (k x d), at which times (k), and how they are simulated."""

    states: np.ndarray
    times: np.ndarray
    periods: int
    rate: int
    noise: float
    seed: int


def basin(
    controller: Controller,
    sizes: Sequence[float] = (0.01, 0.03, 0.1, 0.3),
    disturbances: int = 50,
    periods: int = 100,
    *,
    noise: float = 0.0,
    rate: int = 200,
    seed: int = 0,
    model: Model | None = None,
    out: str | Path | None = None,
) -> Controller:
    """From how far a controller brings the motion back, by simulation.

    Args:
        controller: to be tried.
        sizes: of the disturbances, in extents of the orbit.
        disturbances: how many of each size.
        periods: how long each is followed.
        noise: standard deviation of measurements, in extents.
        rate: samples of a period.
        seed: the same gives the same.
        model: needed only for systems that no file describes.
        out: a folder: OUT/<name>/controller.jsonl keeps how far the motions have come, and what was asked before goes
            on from there, also for more periods.

    Returns:
        The Controller with its `basin`.

    Raises:
        InputError: for numbers that cannot be.

    Examples:
        >>> tried = of.basin(controller, sizes=[0.1], disturbances=2, periods=10)
        >>> tried.basin.rows[0].returned
        2
    """
    model = model or build_model(controller.system)
    _check(sizes, disturbances, periods, noise, rate)
    pushed = np.append(np.repeat(np.asarray(sizes, float), disturbances), 0.0)  # the last one sees noise alone
    plan = _Plan(*disturbed(controller, model, pushed, seed), periods, rate, noise, seed)
    trial = _Trial(controller, model, plan)
    far, most = np.zeros((2, len(pushed)))  # in this period, in all
    peak, power = np.zeros((2, len(pushed), len(controller.actuators)))
    path = None if out is None else Path(out) / controller.name / "controller.jsonl"
    tried = content_digest(CODEC.document(replace(controller, basin=None)))
    request = {"sizes": [*map(float, sizes)], "disturbances": disturbances, "rate": rate, "noise": float(noise),
               "seed": seed, "limits": plain(controller.limits), "controller": tried}  # fmt: skip

    def now() -> list[np.ndarray]:
        """What the next period needs of the one before it."""
        return [trial.states, trial.times, trial.places, trial.lost, far, most, peak, power]

    begin = 0, np.column_stack(now())
    width = begin[1].shape[1]
    with checkpoints(path, request, lambda entry: (int(entry["period"]), unpacked(entry["motions"], width))) as journal:
        known = [line for line in journal.known if line[0] <= periods]
        done, motions = max(known, key=lambda line: line[0], default=begin)
        fill(now(), motions)
        trial.pass_over(done * rate)
        for period in range(done + 1, periods + 1):
            far[:] = 0.0
            for _ in range(rate):
                own, controls, distance = trial.sample()
                np.maximum(peak, np.abs(controls - own), out=peak)
                power += np.where(np.isinf(distance)[:, None], 0.0, controls - own) ** 2
                np.maximum(far, distance, out=far)
            np.maximum(most, far, out=most)
            if period % -(-periods // 25) == 0 or period == periods:
                journal.add({"period": period, "motions": packed(np.column_stack(now()))})
    near = controller.near(periods - 1)  # a motion has returned that stays within this share of a disturbance
    back = far <= near * pushed + 3 * most[-1]
    rows = []
    for k, size in enumerate(sizes):
        chosen = slice(k * disturbances, (k + 1) * disturbances)
        home = back[chosen]
        strongest = peak[chosen][home].max(axis=0, initial=0.0)
        mean = np.sqrt(power[chosen][home].sum(axis=0) / max(1, periods * rate * int(home.sum())))
        rows.append(Returned(float(size), disturbances, int(home.sum()), strongest, mean))
    return replace(controller, basin=Basin(tuple(rows), periods, rate, noise, seed, near))


def recovery(
    controller: Controller,
    size: float,
    periods: int = 4,
    *,
    noise: float = 0.0,
    rate: int = 200,
    seed: int = 0,
    model: Model | None = None,
) -> Recovery:
    """One disturbed motion under a controller, sample by sample.

    Args:
        controller: to be tried.
        size: of the disturbance, in extents of the orbit.
        periods: how long it is followed.
        noise: standard deviation of measurements, in extents.
        rate: samples of a period.
        seed: of the disturbance.
        model: needed only for systems that no file describes.

    Returns:
        A Recovery: times, states, controls, distance from the orbit.

    Raises:
        InputError: for numbers that cannot be.

    Examples:
        >>> run = of.recovery(controller, 0.1, periods=4, rate=50)
        >>> bool(run.distance[-1] < run.distance[0])
        True
    """
    model = model or build_model(controller.system)
    _check([size], 1, periods, noise, rate)
    plan = _Plan(*disturbed(controller, model, np.array([size]), seed), periods, rate, noise, seed)
    trial, samples = _Trial(controller, model, plan), list[tuple[np.ndarray, np.ndarray, float]]()
    times = list[float]()
    for _ in range(periods * rate):
        times.append(float(trial.elapsed[0]))
        state = trial.states[0]
        _, controls, distance = trial.sample()
        samples.append((state, controls[0], float(distance[0])))
    return Recovery(np.array(times), *(np.array(part) for part in zip(*samples, strict=True)))


def _check(sizes: Sequence[float], disturbances: int, periods: int, noise: float, rate: int) -> None:
    """`InputError` for numbers that no simulation can be made of."""
    if not len(sizes) or not all(np.isfinite(size) and size > 0 for size in sizes):
        raise InputError(f"sizes: must be positive numbers, in extents of the orbit, got {list(sizes)}")
    for name, value in {"disturbances": disturbances, "periods": periods}.items():
        if value < 1:
            raise InputError(f"{name}: must be at least 1, got {value}")
    if rate < 8:
        raise InputError(f"rate: must be at least 8 samples a period, got {rate}")
    if not (np.isfinite(noise) and noise >= 0):
        raise InputError(f"noise: must be 0 or more, in extents of the orbit, got {noise}")


def disturbed(controller: Controller, model: Model, sizes: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """States (k x d) pushed off the orbit by so many extents in seeded directions, and their places (k) on it."""
    random = np.random.default_rng(seed)
    places = random.uniform(0.0, controller.period, sizes.size)
    directions = random.normal(size=(sizes.size, controller.units.size))
    if not model.smooth:
        law, watch = law_of(controller), _Watch(model, controller.actuators, controller)
        for _ in range(1000):  # drawn again where it is beyond the guard of an event that has not come yet
            lengths = np.linalg.norm(directions, axis=1, keepdims=True)
            on = law.at(places)
            pushed = on[:, : law.size] + sizes[:, None] * directions / lengths * controller.units
            beyond = watch.crossed(pushed, on[:, law.size : law.size + law.controls], sizes > 0).any(axis=1)
            if not beyond.any():
                break
            places[beyond] = random.uniform(0.0, controller.period, int(beyond.sum()))
            directions[beyond] = random.normal(size=(int(beyond.sum()), law.size))
        return pushed, places
    on = law_of(controller).at(places)[:, : controller.units.size]
    if model.constraint is not None:
        level = constraint_rows(model)
        bases = [tangent_basis(level(x).full() * controller.units) for x in on]
        directions = np.array([e @ (e.T @ direction) for e, direction in zip(bases, directions, strict=True)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    pushed = on + sizes[:, None] * directions * controller.units
    if model.constraint is not None:
        pushed = np.array([_assembled(model, x) for x in pushed])
    return pushed, places


class _Watch:
    """The events that end the only mode of a hybrid Model's period, and what holds in it, at many states at once."""

    def __init__(self, model: Model, names: Sequence[str], controller: Controller) -> None:
        mode, transition = model.arcs[0]
        leaving = (transition, *(each for each in model.hybrid.leaving(mode.name) if each is not transition))
        x, u = ca.MX.sym("x", len(model.state_names)), ca.MX.sym("u", len(names))
        p, self.count = model.parameters(names, u), len(leaving)
        heights = [each.direction * each.guard(x, p) for each in leaving]
        counts = [1.0 if each.allowed is None else each.allowed(x, p) for each in leaving]
        held = ca.vertcat(*heights, *counts, *(hold(x, p) for hold in mode.holds.values()))
        both = map(ca.densify, (held, transition.reset(x, p)))
        self._seen, self._reset = (ca.Function("watch", [x, u], [values]) for values in both)
        self._lanes = Lanes()
        own = self.seen(controller.states, controller.inputs)[:, 2 * self.count :]
        self._least = -1e-9 * np.abs(own).max(axis=0)

    def seen(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Heights of all guards (below 0 before they are crossed), whether they count, what holds (k x ...)."""
        return self._lanes.evaluated(self._seen, 1, x, u)

    def crossed(self, x: np.ndarray, u: np.ndarray, before: np.ndarray) -> np.ndarray:
        """Which guards (k x e) are beyond 0 where they were not `before`, and count."""
        seen, e = self.seen(x, u), self.count
        return before.reshape(len(x), -1) & (seen[:, :e] >= 0) & (seen[:, e : 2 * e] > 0)

    def breaks(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Where (k) something does not hold."""
        return np.asarray(np.any(self.seen(x, u)[:, 2 * self.count :] < self._least, axis=1))

    def after(
        self, step: Callable[[np.ndarray], np.ndarray], u: np.ndarray, span: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """How long (k) motions go on before the event within a step of so many seconds, and the states after it."""
        spans = np.zeros(len(u)), np.full(len(u), span)
        heights = [self.seen(step(each), u)[:, 0] for each in spans]
        for _ in range(6):  # secant steps from both ends of what is nearly a line
            rise, moved = heights[1] - heights[0], spans[1] - spans[0]
            back = np.divide(heights[1] * moved, rise, out=np.zeros(len(u)), where=rise != 0.0)
            spans = spans[1], np.clip(spans[1] - back, 0.0, span)
            heights = [heights[1], self.seen(step(spans[1]), u)[:, 0]]
        return spans[1], self._lanes.evaluated(self._reset, 1, step(spans[1]), u)


def _assembled(model: Model, state: np.ndarray) -> np.ndarray:
    """The state with phi = 0 and J v = 0 that is near to this one."""
    n, p, constraint = model.degrees_of_freedom, model.parameter_values, constraint_of(model)
    v = state[n:]
    q = closed(lambda q: (constraint.phi(q, p).full().ravel(), constraint.jacobian(q, p).full()), state[:n]).w
    slopes, rates = constraint.jacobian(q, p).full(), constraint.rate(q, v, p).full().ravel()
    return np.concatenate([q, v + least_norm(slopes, rates)])


class _Trial:
    """Disturbed motions under a controller, side by side: `states` (k x d), `times`, `places` on the orbit, which are
    `lost` (k each)."""

    def __init__(self, controller: Controller, model: Model, plan: _Plan) -> None:
        self.law, self.plan, self.units = law_of(controller), plan, controller.units
        self.span, self.random = controller.period / plan.rate, np.random.default_rng([plan.seed, 1])
        self.states, self.times, self.lost = plan.states.copy(), plan.times.copy(), np.zeros(len(plan.states), bool)
        self.places = self.times.copy() if self.law.clock else self.law.start(self.states)
        self._step = compiled(step_of(vector_field(model, controller.actuators)), effort=30.0)
        self._lanes = Lanes()
        self._watch = None if model.smooth else _Watch(model, controller.actuators, controller)
        self.elapsed = np.zeros(len(plan.states))

    def pass_over(self, samples: int) -> None:
        """Draw the noise of samples that are known."""
        for _ in range(samples if self.plan.noise else 0):
            self.random.normal(size=self.states.shape)

    @np.errstate(over="ignore", invalid="ignore")  # what is lost is put back and counted
    def sample(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """u* and u (k x m each), distances (k) in extents, infinite of what is lost; then all go on for a sample."""
        limit.check()
        law, x, plan = self.law, self.states, self.plan
        measured = x + plan.noise * self.units * self.random.normal(size=x.shape) if plan.noise else x
        u, tau = law(measured, self.times if law.clock else self.places)
        wanted = law.at(tau)[:, : law.size + law.controls]
        gap = np.sqrt(law.gap(x, wanted[:, : law.size]) ** 2 @ (1 / self.units**2))
        self.lost = self.lost | ~(gap <= 100.0)  # extents off the orbit: given up
        spans, every = np.full(len(x), self.span), np.arange(len(x))

        def after(spans: np.ndarray, rows: np.ndarray) -> np.ndarray:
            z, p = np.column_stack([self.times, x])[rows], np.column_stack([spans, u[rows]])
            return self._lanes.evaluated(self._step, STAGES, z, p)[:, 1:]

        ends = after(spans, every)
        self.times, self.places = self.times + self.span, tau + self.span
        if self._watch is not None:
            crossed = self._watch.crossed(ends, u, self._watch.seen(x, u)[:, : self._watch.count] < 0)
            self.lost = self.lost | self._watch.breaks(x, u) | crossed[:, 1:].any(axis=1)
            if (struck := np.flatnonzero(crossed[:, 0])).size:
                spans[struck], ends[struck] = self._watch.after(partial(after, rows=struck), u[struck], self.span)
                self.times[struck] = self.places[struck] = 0.0
        gone = self.lost | ~np.isfinite(ends).all(axis=1)
        self.states, self.elapsed = np.where(gone[:, None], law.rows[0, : law.size], ends), self.elapsed + spans
        return wanted[:, law.size :], u, np.where(self.lost, np.inf, gap)
