"""How far a motion may be pushed off its orbit for a controller to bring it back, and what that takes: by simulation.

The controller is the one that is exported, sampled: it measures the state, with noise where asked, finds its place on
the orbit and holds the controls, within their limits, until the next sample. All disturbed motions go side by side by
the eighth-order march. They are seeded: directions are uniform on the sphere, in extents of the orbit, their places on
it uniform in time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from orbitfinder._runtime import limit
from orbitfinder.errors import InputError
from orbitfinder.exports.controller import law_of
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.parallel import STAGES, Lanes
from orbitfinder.integrate.rk8 import step_of
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.constrained import constraint_rows, tangent_basis
from orbitfinder.mechanics.model import Model, constraint_of, vector_field
from orbitfinder.mechanics.newton import closed, least_norm
from orbitfinder.records.controller import Basin, Controller, Returned

SIZES = (0.01, 0.03, 0.1, 0.3)
NEAR, HALF = 0.01, 0.5
"""A motion has returned when it stays within this share of its disturbance; the most that may be granted it"""
SLACK = 10.0
"""times what the largest multiplier leaves of a disturbance, where that is more"""
LOST = 100.0
"""Extents off the orbit beyond which a motion is given up"""
EFFORT = 30.0
"""Seconds of interpreted simulation, for `compiled`"""


@dataclass(frozen=True)
class Run:
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
    sizes: Sequence[float] = SIZES,
    disturbances: int = 50,
    periods: int = 100,
    *,
    noise: float = 0.0,
    rate: int = 200,
    seed: int = 0,
    model: Model | None = None,
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
    base, last = controller.inputs[0], periods * rate - rate
    peak, power = np.zeros((len(pushed), base.size)), np.zeros((len(pushed), base.size))
    far, floor = np.zeros(len(pushed)), 0.0
    for k, (_, own, controls, distance) in enumerate(_simulated(controller, model, plan)):
        effort = controls - own
        peak, power = np.maximum(peak, np.abs(effort)), power + np.where(np.isinf(distance)[:, None], 0.0, effort) ** 2
        floor = max(floor, float(distance[-1]))
        far = np.maximum(far, distance) if k >= last else far
    near = float(np.clip(SLACK * np.abs(controller.multipliers).max() ** (periods - 1), NEAR, HALF))
    back = far <= near * pushed + 3 * floor
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
) -> Run:
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
        A Run: times, states, controls, distance from the orbit.

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
    found = [(x[0], u[0], float(r[0])) for x, _, u, r in _simulated(controller, model, plan)]
    times = np.arange(len(found)) * (controller.period / rate)
    return Run(times, *(np.array(part) for part in zip(*found, strict=True)))


def _check(sizes: Sequence[float], disturbances: int, periods: int, noise: float, rate: int) -> None:
    """`InputError` for numbers that no simulation can be made of."""
    if not len(sizes) or not all(np.isfinite(one) and one > 0 for one in sizes):
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
        directions = np.array([e @ (e.T @ one) for e, one in zip(bases, directions, strict=True)])
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


@np.errstate(over="ignore", invalid="ignore")  # what is lost is put back and counted
def _simulated(
    controller: Controller, model: Model, plan: _Plan
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """At each sample: states (k x d), u* and u (k x m each), distances (k) in extents, infinite of what is lost."""
    law, random = law_of(controller), np.random.default_rng([plan.seed, 1])
    span, x, clock = controller.period / plan.rate, plan.states, plan.times
    tau, lost = (clock if law.clock else law.start(x)), np.zeros(len(x), bool)
    step, lanes = plant_step(model, controller.actuators), Lanes()
    for _ in range(plan.periods * plan.rate):
        limit.check()
        measured = x + plan.noise * controller.units * random.normal(size=x.shape) if plan.noise else x
        u, tau = law(measured, clock if law.clock else tau)
        wanted = law.at(tau)[:, : law.size + law.controls]
        gap = np.sqrt(law.gap(x, wanted[:, : law.size]) ** 2 @ (1 / controller.units**2))
        lost |= ~(gap <= LOST)
        yield x, wanted[:, law.size :], u, np.where(lost, np.inf, gap)
        z, p = np.column_stack([clock, x]), np.column_stack([np.full(len(x), span), u])
        x = lanes.evaluated(step, STAGES, z, p)[:, 1:]
        x = np.where((lost | ~np.isfinite(x).all(axis=1))[:, None], law.rows[0, : law.size], x)
        clock, tau = clock + span, tau + span


def plant_step(model: Model, names: Sequence[str]) -> ca.Function:
    """One Runge-Kutta step of z = (t, x) with p = (h, u)."""
    return compiled(step_of(vector_field(model, names)), effort=EFFORT)
