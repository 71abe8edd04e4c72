"""Where searches of controlled motions start, and what each leads to: an optimum of the program of a problem.

The nodes are unknowns of that program, so that it can begin at any closed loop, a motion or not. Strategies:

    loop      a random loop of three harmonics through the pins, its rates its own, under the guessed controls
    push      the motion from near the guess under random controls
    near      the motion from near the guess under the guessed controls

Loops are about as large as the guess's motion, or a radian; the period is drawn from the range wanted.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orbitfinder.control.find import find_controlled
from orbitfinder.control.program import Program
from orbitfinder.errors import ConvergenceError, InputError
from orbitfinder.loops.conditions import pin
from orbitfinder.loops.control import Control, Task
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.scales import control_sizes
from orbitfinder.mechanics.model import Model, vector_field
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.records.codec import plain
from orbitfinder.records.orbit import Orbit

TURNS, STATED, KEPT = (
    ("loop", "push", "loop", "near"),
    ("symmetry", "winding", "tolerance", "relative", "bounds"),
    ("method", "iterations", "steps", "optimum", "pin"),
)
"""Strategies in the order of their turns, of hybrid systems, whose arcs no loop has, without loops; of a problem what a
search states beside its guess, pins and control; of an orbit what it says of how it came about, beside its start"""


def statement(problem: Problem) -> dict[str, Any]:
    """What a search asks of controlled motions, as plain values that travel. Raises `InputError`."""
    if problem.control is None:
        raise InputError("problem: has no control; give its model, energies and periods, or Problem(..., control=...)")
    if problem.free:
        raise InputError(f"search: frees no parameter yet, this problem {problem.free[0]!r}; give its values as "
                         "parameters, of which every combination is searched")  # fmt: skip
    if problem.model.invariants:
        names = ", ".join(invariant.name for invariant in problem.model.invariants)
        raise InputError(f"search: not of controlled motions that conserve something ({names}); use find_orbit")
    given = problem.guess
    return plain({  # type: ignore[no-any-return]
        "guess": {"state": given.state, "period": given.period, "times": given.times, "states": given.states},
        "pin": {held.name: held.value for held in problem.pin},
        "control": vars(problem.control) | {"tasks": [vars(task) for task in problem.control.tasks]},
        **{name: getattr(problem, name) for name in STATED},
    })  # fmt: skip


def problem_of(model: Model, asked: Mapping[str, Any]) -> Problem:
    """The Problem that a statement is of."""
    guess = {name: None if value is None else np.array(value) for name, value in asked["guess"].items()}
    tasks = tuple(Task(**task) for task in asked["control"]["tasks"])
    several: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in asked.items()}
    bounds = {name: (low, high) for name, (low, high) in asked["bounds"].items()}
    return Problem(
        model, Guess(**guess | {"period": asked["guess"]["period"]}), pin(**asked["pin"]),
        control=Control(**asked["control"] | {"tasks": tasks}), bounds=bounds,
        **{name: several[name] for name in STATED if name != "bounds"},
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Controlled:
    """The problem whose optima of these periods (s) are looked for, what its guess moves through (extents, d), and how
    strong a control is that bends that (m)."""

    problem: Problem
    periods: tuple[float, float]
    program: Program
    extents: np.ndarray
    strengths: np.ndarray

    @classmethod
    def of(cls, problem: Problem, periods: tuple[float, float]) -> Controlled:
        """Raises `InputError` for what starts cannot be made of."""
        control, model = problem.control, problem.model
        assert control is not None
        held = next((pin.value for pin in problem.pin if pin.name == "period"), None)
        if held is not None and not periods[0] <= held <= periods[1]:
            within = f"{periods[0]:g} to {periods[1]:g} s"
            raise InputError(f"search.period: {within}, but the period is pinned at {held:g} s; widen it")
        if held is None and model.smooth:
            wide = {"period": (periods[0] / 1.15, periods[1] * 1.15)}  # so that none stops at an end of the range
            problem = replace(problem, bounds=wide | dict(problem.bounds))
        program = Program(problem, control, 1)
        w, _ = program.guessed()
        if len(program.loop(w).normals) > (control.shape == "fourier"):
            raise InputError("search: the intervals of these controls begin at t = 0, which may be anywhere on a "
                             "motion; pin a component of the state, or use control.shape = 'fourier'")  # fmt: skip
        extents = extents_of(model, w.nodes, w.period)
        extents = np.where(np.isfinite(extents) & (extents > 0), extents, 1.0)
        field, idle = vector_field(program.parts.mode(0), model.controls), np.zeros(len(model.controls))

        def rate(u: np.ndarray) -> np.ndarray:
            return np.asarray(field(0.0, w.nodes[0], [], u).full().ravel() / extents)

        bent = np.array([np.abs(rate(unit) - rate(idle)).max() for unit in np.eye(idle.size)])
        return cls(problem, periods, program, extents, control_sizes(bent, w.period, 0.0))

    @property
    def strategies(self) -> tuple[str, ...]:
        """Those that the system has."""
        return TURNS if self.problem.model.smooth else tuple(name for name in TURNS if name != "loop")

    def drawn(self, strategy: str, random: np.random.Generator) -> Problem:
        """The problem with another guess."""
        problem, held = self.problem, {pin.name: pin.value for pin in self.problem.pin}
        assert problem.control is not None
        drawn = float(np.exp(random.uniform(*np.log(self.periods))))
        period = held.get("period", drawn)
        if strategy == "loop":
            return replace(problem, guess=self._loop(period, held, random))
        moved = random.normal(size=self.extents.size) * random.uniform(0.0, 0.5) * self.extents
        state = problem.guess.start + moved
        names = problem.model.state_names
        state = np.array([held.get(name, float(x)) for name, x in zip(names, state, strict=True)])
        guess, control = Guess(state, period), problem.control
        if strategy == "push":
            control = replace(control, guess={**control.guess, **self._pushed(random)})
        return replace(problem, guess=guess, control=control)

    def _loop(self, period: float, held: Mapping[str, float], random: np.random.Generator) -> Guess:
        """A loop with states (k x d) at equal times; of a mechanical system its rates are those of its coordinates."""
        model, count = self.problem.model, 32 * self.program.parts.basis.whole
        shares = np.linspace(0.0, 1.0, count + 1)
        mirrored = bool(self.problem.boundary.maps)
        orders = np.array([1, 3, 5] if mirrored else [1, 2, 3])
        angles = 2 * np.pi * shares[:, None] * orders
        constant = np.full((count + 1, 1), 0.0 if mirrored else 1.0)
        shapes = np.hstack([constant, np.cos(angles), np.sin(angles)])
        turning = 2 * np.pi * orders / period
        rates = np.hstack([0 * constant, -turning * np.sin(angles), turning * np.cos(angles)])
        sizes = np.where(np.arange(3) == random.integers(3), 1.0, 0.3 / orders)  # any of them may lead
        weights = np.concatenate([[0.5], sizes, sizes])
        n, size = model.degrees_of_freedom, self.extents.size
        columns = np.zeros((count + 1, size))
        for i in range(n):
            most = max(self.extents[i], 1.0) if model.angular[i] else self.extents[i]
            parts = weights * most * random.uniform() * random.normal(size=weights.size)
            whole = 2 * np.pi * self.problem.turns[i]
            both = [(i, shapes, whole * shares), *([(n + i, rates, np.full(count + 1, whole / period))] * (n < size))]
            for k, basis, more in both:  # the least change that brings it through the pins, whose rows are orthogonal
                if (name := model.state_names[k]) in held:
                    parts += basis[0] * (held[name] - more[0] - basis[0] @ parts) / (basis[0] @ basis[0])
            for k, basis, more in both:
                columns[:, k] = basis @ parts + more
        return Guess(columns[0], period, period * shares, columns)

    def _pushed(self, random: np.random.Generator) -> dict[str, list[float]]:
        """Random coefficients of every control, within its limits."""
        model, count, pushed = self.problem.model, self.program.parts.basis.whole, {}
        for name, size in zip(model.controls, self.strengths, strict=True):
            limits = model.limits.get(name, (-np.inf, np.inf))
            pushed[name] = np.clip(size * random.uniform() * random.normal(size=count), *limits).tolist()
        return pushed

    def orbit(self, problem: Problem) -> tuple[Orbit, Model]:
        """The optimum near the guess of a problem, without certificate. Raises `ConvergenceError`."""
        with np.errstate(all="ignore"):  # of what the checks reject
            orbit, model = find_controlled(problem, SolveSettings(), None, 0.0)
        assert orbit.control is not None
        shares = [float(share) for share in orbit.control["shares"].values()]
        if min(*shares, 1.0 - sum(shares), 1.0) < 1e-6:
            raise ConvergenceError("an arc lasts no time")
        if not self.periods[0] <= orbit.period <= self.periods[1]:
            raise ConvergenceError("period outside the range")
        said = {name: orbit.provenance[name] for name in KEPT if name in orbit.provenance}
        cycle = {} if model.smooth else {"cycle": list(model.cycle)}
        return replace(orbit, provenance=said, system={**orbit.system, **cycle}), model
