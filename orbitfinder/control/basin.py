"""How far a motion may be pushed off its orbit for a controller to bring it back, and what that takes: by simulation.

The controller is the one that is exported, sampled: it measures the state, with noise where asked, finds its place on
the orbit and holds the controls, within their limits, until the next sample. All disturbed motions go side by side by
the eighth-order march. They are seeded: directions are uniform on the sphere, in extents of the orbit, their places on
it uniform in time.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

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
    request = {"controller": tried, "sizes": [*map(float, sizes)], "disturbances": disturbances, "rate": rate,
               "noise": float(noise), "seed": seed}  # fmt: skip

    def now() -> list[np.ndarray]:
        """What the next period needs of the one before it."""
        return [trial.states, trial.times, trial.places, trial.lost, far, most, peak, power]

    begin = 0, np.column_stack(now())

    def read(entry: Mapping[str, Any]) -> tuple[int, np.ndarray]:
        return int(entry["period"]), unpacked(entry["motions"], begin[1].shape[1])

    with checkpoints(path, request, read) as journal:
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
    left = np.abs(controller.multipliers).max() ** (periods - 1)  # of a disturbance, by the largest multiplier
    near = float(np.clip(10.0 * left, 0.01, 0.5))  # a motion has returned that stays within this share of it
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
    for _ in range(periods * rate):
        state = trial.states[0]
        _, controls, distance = trial.sample()
        samples.append((state, controls[0], float(distance[0])))
    times = np.arange(len(samples)) * (controller.period / rate)
    return Recovery(times, *(np.array(part) for part in zip(*samples, strict=True)))


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
        self._step, self._lanes = plant_step(model, controller.actuators), Lanes()

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
        z, p = np.column_stack([self.times, x]), np.column_stack([np.full(len(x), self.span), u])
        x = self._lanes.evaluated(self._step, STAGES, z, p)[:, 1:]
        gone = self.lost | ~np.isfinite(x).all(axis=1)
        self.states = np.where(gone[:, None], law.rows[0, : law.size], x)
        self.times, self.places = self.times + self.span, tau + self.span
        return wanted[:, law.size :], u, np.where(self.lost, np.inf, gap)


def plant_step(model: Model, names: Sequence[str]) -> ca.Function:
    """One Runge-Kutta step of z = (t, x) with p = (h, u)."""
    return compiled(step_of(vector_field(model, names)), effort=30.0)
