"""A Problem: a Model, a guess and the conditions that single out one orbit, counted before solving."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from orbitfinder._runtime.arguments import check, check_fields
from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import CountError, InputError, closest
from orbitfinder.integrate.automaton import Automaton, recognised
from orbitfinder.integrate.idas import check_consistent
from orbitfinder.loops.conditions import (
    Constraint,
    Expression,
    Pin,
    check_bounds,
    check_pin,
    clock,
    is_parameter,
    pinned,
)
from orbitfinder.loops.control import Control
from orbitfinder.loops.loop import Equations, Loop, Unknowns
from orbitfinder.loops.symmetry import Shift, Symmetry, beside, knowing, named, related, shifts_of
from orbitfinder.loops.watch import Number, watches
from orbitfinder.mechanics.constrained import maximal_states
from orbitfinder.mechanics.controls import actuated, check_constant
from orbitfinder.mechanics.hybrid import with_cycle
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model, counted
from orbitfinder.mechanics.scales import proportions, surroundings

CLOSURE_TOLERANCE = 1e-12
"""Largest gap round the loop that a certificate accepts, times max(1, largest multiplier)."""
PEAKS = ("max_amplitude", "min_peak_rate")
"""Objectives about the largest value along the orbit of one coordinate or its rate."""
OBJECTIVES = ("nearest", "min_instability", *PEAKS)
LARGEST_TOLERANCE = 1e-6
"""A looser closure than this is not called one, whatever a problem or a file asks for."""


@dataclass(frozen=True)
class Guess(Shown):
    """A starting point: state and period, optionally a whole trajectory.

    Args:
        state: at t = 0 (2n; d of a first-order system).
        period: T in s.
        times: of a trajectory (k, from 0 to T; at events twice, or not); else the start is simulated from `state`.
        states: of that trajectory (k x 2n).
        free: where freed physical parameters start, by name; otherwise at the model's own values.

    Raises:
        InputError: for a period that is not positive and finite, and where sizes differ.

    Examples:
        >>> of.Guess([0.3, 0.4, 0.0, 0.0], 1.9)
        Guess(state=[0.3, 0.4, 0, 0], period=1.9)

    See Also:
        `of.guesses.normal_mode`, `of.guesses.close_returns` and `of.guesses.recurrences` make good ones.
    """

    __repr__ = brief("state", "period", "times")

    state: Any
    period: float
    times: np.ndarray | None = None
    states: np.ndarray | None = None
    free: Mapping[str, float] = field(default_factory=dict)

    @property
    def trajectory(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Times and states, where it has both."""
        return None if self.times is None or self.states is None else (np.asarray(self.times), np.asarray(self.states))

    @property
    def start(self) -> np.ndarray:
        """The state as numbers (2n; d of a first-order system)."""
        return np.asarray(self.state, float)

    def __post_init__(self) -> None:
        check("guess.state", "Sequence[float]", self.state)
        check("guess.period", "float", self.period)
        check_fields(self)
        if not np.isfinite(self.period) or self.period <= 0:
            raise InputError(f"guess.period: must be positive and finite, got {self.period}; give a period in s")


@dataclass(frozen=True)
class Count(Shown):
    """Equations against unknowns of a Problem, by name."""

    equations: Mapping[str, int]
    unknowns: Mapping[str, int]

    @property
    def freedom(self) -> int:
        """Unknowns minus equations: 0 is square, positive leaves room for an objective."""
        return sum(self.unknowns.values()) - sum(self.equations.values())

    def __repr__(self) -> str:
        """One line."""
        return f"Count({self})"

    def __str__(self) -> str:
        def listed(parts: Mapping[str, int]) -> str:
            return " + ".join(f"{number} {name}" for name, number in parts.items() if number)

        return (
            f"{sum(self.equations.values())} equations ({listed(self.equations)}) "
            f"in {sum(self.unknowns.values())} unknowns ({listed(self.unknowns)})"
        )


@dataclass(frozen=True)
class Problem(Shown):
    """What to find: an orbit of a model near a guess, and what is held fixed.

    Of a chain or linkage as a DAE, the guess's state and the winding may be given for its links instead of its
    coordinates. What the count of equations leaves free is chosen by `objective`.

    Args:
        model: the system.
        guess: where to start.
        pin: what is held fixed, from `of.pin`; () takes the orbit nearest to the guess.
        symmetry: none | brake | reflection | reversal | brake+reflection, or one that the model declares or, called
            mirror (mirror-x where there are several), has: signs of coordinates with time reversed.
        winding: whole turns of each coordinate in one period (n); those of the guess if None.
        segments: shooting intervals of the horizon; None: chosen from the instability of the guess.
        tolerance: the closure that the certificate asks for, in extents of the motion.
        free: physical parameters the solver may change (one that is pinned and not free has that value).
        expected: numbers that the result must agree with, {"period": (value, tolerance)}.
        name: of the orbit, a word for files.
        title: one line for people.
        source: where the numbers come from.
        objective: "nearest" to the guess, "min_instability", "max_amplitude" or "min_peak_rate", or a callable that
            makes a CasADi expression of `of.Variables` (a vector r stands for |r|^2 / 2).
        coordinate: of which amplitude or rate are meant; default the one that moves most.
        bounds: ranges (lowest, highest) of the period, invariants, freed parameters and state components at t = 0.
        constraints: any other equations and inequalities.
        phase_condition: an expression to be 0 at t = 0 instead of the hyperplane through the guess.
        relative: cyclic coordinates (or conserved momenta of other shifts) along which the orbit need not come back.
        control: how the model's controls vary in time, and at what cost: `of.find_orbit` then finds the motion that
            costs least.
        watch: numbers of each orbit of its family by name (see `of.follow_family`).
        method: shooting | collocation | balance (of driven and free motions); None: by a measured stiffness.

    Raises:
        InputError: for names that the model has not and values that cannot be; the count is checked when it is
            solved.

    Examples:
        >>> brake = of.Problem(pendulum, guess, pin=of.pin(period=1.2), symmetry="brake", free=("length2",))
        >>> brake.count().freedom
        1

    See Also:
        `of.load_problem` reads one from a file; `of.find_orbit` solves it.
    """

    __repr__ = brief("name", "model", "guess", "pin", "symmetry", "free")

    model: Model
    guess: Guess
    pin: tuple[Pin, ...] = ()
    symmetry: str = "none"
    winding: tuple[int, ...] | None = None
    segments: int | None = None
    tolerance: float = CLOSURE_TOLERANCE
    free: tuple[str, ...] = ()
    expected: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    name: str = "orbit"
    title: str = ""
    source: str = ""
    objective: str | Expression = "nearest"
    coordinate: str | None = None
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    constraints: tuple[Constraint, ...] = ()
    phase_condition: Expression | None = None
    relative: tuple[str, ...] = ()
    control: Control | None = None
    watch: Mapping[str, str | Number] = field(default_factory=dict)
    method: str | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.control is not None:
            self._actuate()
        object.__setattr__(self, "model", knowing(self.model, self.symmetry))
        if self.model.constraint is not None and self.model.constraint.lift is not None:
            links = self.model.degrees_of_freedom // 3
            if np.size(self.guess.state) == 2 * links:  # angles and rates become those of the redundant coordinates
                state = maximal_states(self.model, self.guess.start)
                object.__setattr__(self, "guess", replace(self.guess, state=state))
            if self.winding is not None and len(self.winding) == links:
                object.__setattr__(self, "winding", tuple(k for turn in self.winding for k in (0, 0, turn)))
        # guessed values of freed parameters, and pins of others, become the model's
        check_guessed(self.guess, self.free)
        pinned = {pin.name: pin.value for pin in self.pin if is_parameter(self.model, pin.name)}
        fixed = pinned.keys() - set(self.free)
        values = {name: float(value) for name, value in self.guess.free.items()} | pinned
        if values:
            object.__setattr__(self, "model", with_parameters(self.model, values))
            object.__setattr__(self, "guess", replace(self.guess, free={}))
            object.__setattr__(self, "pin", tuple(pin for pin in self.pin if pin.name not in fixed))
        if not self.model.smooth:
            _check_hybrid(self)
            if not self.model.cycle:  # it is that of the guess's motion
                _check_state(self.model, self.guess.start)
                given = self.guess.start, self.guess.period, self.guess.trajectory
                object.__setattr__(self, "model", with_cycle(self.model, recognised(self.model, *given)))
        _check(self)

    def _actuate(self) -> None:
        """The model as its controls act on it. Raises `InputError`."""
        if not self.model.controls:
            raise InputError("control: this system has no controls; give motors or controls to the system")
        if self.model.constraint is not None:
            raise InputError(
                "control: not of systems under constraints; describe the mechanism in minimal coordinates "
                "(of.linkages.minimal_linkage, lagrange)"
            )
        for name in ("objective", "constraints", "phase_condition", "coordinate"):
            if getattr(self, name) not in ("nearest", (), None):
                raise InputError(f"{name}: is for motions without control; give a cost and tasks in the control")
        if taken := sorted(set(self.free) & set(self.model.controls)):
            raise InputError(f"free: {taken[0]!r} is a control and varies in time; leave it out")
        object.__setattr__(self, "model", actuated(self.model))

    @property
    def boundary(self) -> Symmetry:
        """The symmetry as a boundary condition."""
        return related(named(self.symmetry, self.model), self.model, self.relative)

    @property
    def shifts(self) -> tuple[Shift, ...]:
        """The shifts up to which a relative orbit comes back. Raises `InputError`."""
        known = shifts_of(self.model) if self.relative else {}
        return tuple(known[name] for name in self.relative)

    @property
    def forcing_cycles(self) -> int:
        """Periods of the forcing in one period of the orbit: the whole number nearest to the guess's; 0 unforced."""
        return self.model.forcing_cycles(self.guess.period)

    @property
    def turns(self) -> np.ndarray:
        """Whole turns of each coordinate in one period (n)."""
        n = self.model.degrees_of_freedom
        return np.zeros(n, int) if self.winding is None else np.asarray(self.winding, int)

    def count(self, segments: int | None = None) -> Count:
        """Equations and unknowns of the shooting system with this many segments."""
        intervals = segments or self.segments or 1
        size, symmetry = len(self.model.state_names), self.boundary
        unfolded = symmetry.unfolded(self.model)
        arcs = 0 if self.model.smooth else len(self.model.hybrid.part(symmetry.parts))
        others = sum(invariant.generator is not None for invariant in unfolded)
        equations = {
            "defects": size * (intervals - 1),
            "boundary": size - len(self.relative),
            "phase conditions": int(not symmetry.reverses and not self.model.forced and not self.model.hybrid) + others,
            "guards": arcs,
            "forcing period": int(self.model.forced),
            "pins": len(self.pin),
            "constraints": sum(constraint.rows for constraint in self.constraints if constraint.equation),
        }
        unknowns = {
            "node states": size * intervals,
            "period": 1,
            "unfolding": len(unfolded),
            "freed parameters": len(self.free),
            "durations of arcs": max(0, arcs - 1),
        }
        return Count(equations, unknowns)

    def check_count(self) -> Count:
        """The count of a solvable problem; `CountError` with count and reason otherwise."""
        count = self.count()
        if self.control is not None:  # coefficients are many; IPOPT says when they are too few
            return count
        if count.freedom < 0:
            room = len(self.pin) + count.freedom
            isolated = "" if self.model.invariants else " (nothing is conserved, so its orbits stand alone)"
            raise CountError(
                f"pin: over-determined, {count}: {len(self.pin)} pins where the family has room for "
                f"{room}{isolated}; remove {-count.freedom} or free as many physical parameters"
            )
        if self.objective != "nearest":
            if count.freedom == 0 and not self.choice:
                raise CountError(
                    f"objective: nothing is left to choose, {count}; remove a pin, free a physical parameter, or for "
                    "min_instability give the range of periods in bounds to choose among separate orbits"
                )
            return count
        if self.pin and not self.free and not self.constraints and count.freedom > 0:
            names = ", ".join(invariant.name for invariant in self.model.invariants)
            raise CountError(
                f"pin: under-determined, {count}: orbits of this system come in "
                f"{count.freedom + len(self.pin)}-parameter families (invariants: {names}); add "
                f"{count.freedom} pins, or give none for the nearest orbit"
            )
        return count

    @property
    def choice(self) -> bool:
        """True when the least unstable of isolated orbits is asked for, which no solver from one guess can tell."""
        return self.objective == "min_instability" and self.count().freedom == 0 and "period" in self.bounds


def check_guessed(guess: Guess, free: tuple[str, ...]) -> None:
    """`InputError` for guessed values of physical parameters that are not free, or no numbers."""
    for name, value in guess.free.items():
        if name not in free:
            raise InputError(f"guess.free: {name!r} is not free to change; add it to free, or pin it")
        if not np.isfinite(value):
            raise InputError(f"guess.free: {name} must be finite, got {value}; give a number")


def without_choice(problem: Problem) -> Problem:
    """The same Problem with nothing left to choose: no freed parameters, objective, bounds, constraints or pins."""
    return replace(
        problem, free=(), pin=(), objective="nearest", coordinate=None, bounds={}, constraints=(), phase_condition=None
    )


def elsewhere(problem: Problem, guess: Guess, winding: tuple[int, ...] | None) -> Problem:
    """A checked Problem with another guess and winding of the same system, which are not checked."""
    moved = copy(problem)
    for name, value in (("guess", guess), ("winding", winding)):
        object.__setattr__(moved, name, value)
    return moved


def at_forcing_period(problem: Problem) -> Problem:
    """The Problem with its guess's period moved to the multiple of the forcing's that it must have."""
    clock = problem.model.forcing_period
    if clock is None:
        return problem
    period = problem.forcing_cycles * float(clock(problem.model.parameter_values))
    guess = problem.guess
    times = None if guess.times is None else guess.times * (period / guess.period)
    return replace(problem, guess=replace(guess, period=period, times=times))


def _check(problem: Problem) -> None:
    model, state = problem.model, problem.guess.start
    _check_state(model, state)
    _check_relative(problem)
    symmetry = problem.boundary
    _check_winding(problem)
    if problem.segments is not None and problem.segments < 1:
        raise InputError(f"segments: must be at least 1, got {problem.segments}; leave it out for the default")
    if not 0 < problem.tolerance <= LARGEST_TOLERANCE:
        raise InputError(
            f"tolerance: must be positive and at most {LARGEST_TOLERANCE:g}, got {problem.tolerance}; "
            f"the default is {CLOSURE_TOLERANCE:g}"
        )
    for name in problem.free:
        model.parameter_index(name)
    check_constant(model, problem.free)
    if model.constraint is None:  # a linkage's family is followed in other coordinates
        watches(problem.watch, model)
    if not model.conservative:
        _check_forcing(problem)
    for pin in problem.pin:
        check_pin(problem, pin)
    check_bounds(model, problem.bounds, problem.free, tuple(one.name for one in problem.pin))
    for asked in problem.constraints:
        if not asked.lower <= asked.upper or asked.rows < 1:
            raise InputError(
                f"constraints: {asked.name} asks for {asked.lower} <= expression <= {asked.upper} in "
                f"{asked.rows} rows; give lower <= upper and at least one row"
            )
    _check_objective(problem)
    if model.constraint is not None:
        check_consistent(model, state)
    if model.smooth or not symmetry.maps:
        symmetry.check(model, state, problem.forcing_cycles)
    else:
        _check_halves(problem, state)


def _check_state(model: Model, state: np.ndarray) -> None:
    size = len(model.state_names)
    if state.shape != (size,):
        raise InputError(
            f"guess.state: {state.size} numbers for {counted(model)}; give {size} ({', '.join(model.state_names)})"
        )
    if not np.all(np.isfinite(state)):
        raise InputError(f"guess.state: must be finite, got {state.tolist()}; replace NaN and infinity by numbers")


def _check_hybrid(problem: Problem) -> None:
    """`InputError` for what orbits of hybrid systems cannot be asked for, and for a trajectory that is none."""
    for times, states in filter(None, [problem.guess.trajectory]):
        size = len(problem.model.state_names)
        if times.ndim != 1 or times.size < 2 or states.shape != (times.size, size) or not np.all(np.diff(times) >= 0):
            raise InputError(
                f"guess.states: {states.shape} numbers at {times.shape} times; give {size} of a state at each of at "
                "least 2 times, which do not decrease"
            )
    phase = "chooses t = 0, which is after the event that ends a hybrid orbit's cycle: its guard is the phase condition"
    later, controlled = "is not of controlled motions of hybrid systems yet", problem.control is not None
    for name, asked, why in (
        ("phase_condition", problem.phase_condition is not None, phase),
        ("objective", problem.objective in PEAKS, phase),
        ("coordinate", problem.coordinate is not None, phase),
        ("symmetry", controlled and problem.symmetry != "none", later),
        ("relative", controlled and problem.relative, later),
        ("bounds", controlled and problem.bounds, later),
        ("guess.states", controlled and problem.guess.trajectory is not None, later),
    ):
        if asked:
            raise InputError(f"{name}: {why}; leave it out")


def _check_halves(problem: Problem, state: np.ndarray) -> None:
    """`InputError` unless the second half of a hybrid system's cycle is the image of the first, tried near a state."""
    model, symmetry, forward = problem.model, problem.boundary, problem.boundary.forward
    n, cycle, why = model.degrees_of_freedom, ", ".join(model.cycle), ""
    if symmetry.reverses or forward is None:
        why = "runs time backwards, and a reset, after which a hybrid orbit begins, is a map forwards"
    elif len(model.cycle) % 2:
        why = f"takes half of the events to the other half, and the cycle {cycle} has an odd number"
    else:
        lengths, clock = surroundings(model, state[:n])
        units = np.concatenate([lengths, lengths[: state.size - n] / clock])
        rows = state + units * np.random.default_rng(0).normal(0, 0.3, (4, state.size))
        turned = (np.zeros(n), np.ones(n)) if problem.winding is None else (np.asarray(problem.winding) % 2,)
        half = (
            np.append(np.pi * turn * (model.angular & forward.keeps(n)), np.zeros(state.size - n)) for turn in turned
        )
        arcs, automaton = [(mode.name, transition.name) for mode, transition in model.arcs], Automaton(model)
        pairs = list(zip(arcs, arcs[len(arcs) // 2 :], strict=False))
        off = (max(automaton.unlike(*pair, rows, forward.matrix(n), by) for pair in pairs) for by in half)
        if min(off) > LARGEST_TOLERANCE:
            moves = forward.in_words(model.state_names[:n])
            why = f"({moves}) does not take modes, guards and resets of half of the events {cycle} to the other half's"
    if why:
        raise InputError(
            f"symmetry: {symmetry.name!r} {why}; use one that takes the first half of a cycle to the second, or 'none'"
        )


def _check_objective(problem: Problem) -> None:
    named, symmetry = problem.objective, problem.boundary
    if isinstance(named, str) and named not in OBJECTIVES:
        raise InputError(
            f"objective: unknown {named!r}{closest(named, OBJECTIVES)}; use one of {', '.join(OBJECTIVES)}, or in "
            "Python a callable"
        )
    if problem.coordinate is not None:
        n = problem.model.degrees_of_freedom
        if named not in PEAKS:
            raise InputError(f"coordinate: goes with the objectives {' and '.join(PEAKS)}; leave it out")
        if problem.coordinate not in problem.model.state_names[:n]:
            known = ", ".join(problem.model.state_names[:n])
            raise InputError(f"coordinate: unknown {problem.coordinate!r}; this system has {known}")
    if named == PEAKS[1] and problem.model.rates is not None:
        raise InputError(
            "objective: min_peak_rate is about velocities, which a first-order system has not; give a callable"
        )
    phased = not symmetry.reverses and not problem.model.forced
    if not phased and (named == "min_peak_rate" or problem.phase_condition is not None):
        raise InputError(
            f"objective: needs the freedom to choose t = 0, which symmetry = {problem.symmetry!r}"
            f"{' and the forcing do' if problem.model.forced else ' does'} not leave; use symmetry none or reflection"
        )
    if problem.model.forced and named == "max_amplitude":
        raise InputError("objective: max_amplitude needs the freedom to choose t = 0, which a forcing does not leave")


def _check_forcing(problem: Problem) -> None:
    model = problem.model
    if model.forcing_period is None:
        if (model.rates or model.acceleration).jac_sparsity(0, 0).nnz():  # the time is in them
            raise InputError(
                "system: its equations depend on time; declare the period of that, Symbols(..., forcing_period=...)"
            )
        return
    clock = model.driving_period
    if not (np.isfinite(clock) and clock > 0):
        raise InputError(f"forcing_period: must be positive and finite, got {clock}; check the forcing's frequency")


def _check_winding(problem: Problem) -> None:
    if problem.winding is None:
        return
    n = problem.model.degrees_of_freedom
    if len(problem.winding) != n:
        raise InputError(f"winding: {len(problem.winding)} numbers for {n} coordinates; give one per coordinate")
    if any(k and not angle for k, angle in zip(problem.winding, problem.model.angular, strict=True)):
        raise InputError(f"winding: {list(problem.winding)} turns a coordinate that is not an angle; set it to 0")
    turning, forward = problem.boundary.may_turn(n), problem.boundary.forward
    if not problem.model.smooth and forward is not None:  # half of the turns belong to half of the events
        turning = forward.keeps(n)
    if np.any(np.asarray(problem.winding)[~turning]):
        raise InputError(
            f"winding: a {problem.symmetry} orbit comes back, so {list(problem.winding)} cannot hold; "
            "use symmetry = 'none' or 'reversal' for running orbits"
        )


def _check_relative(problem: Problem) -> None:
    """`InputError` unless the orbit may shift along what `relative` names."""
    if not problem.relative:
        return
    model, known = problem.model, shifts_of(problem.model)
    if model.constraint is not None:
        raise InputError("relative: not known in redundant coordinates; describe the system in minimal ones (lagrange)")
    for name in problem.relative:
        if name not in known:
            raise InputError(
                f"relative: {name!r} is no cyclic coordinate{closest(name, known)}; a shift must leave the equations "
                f"as they are and keep a momentum, as that of {', '.join(known) or 'none of this system'} does"
            )
    if len(set(problem.relative)) < len(problem.relative):
        raise InputError(f"relative: {list(problem.relative)} names a coordinate twice; name each once")
    moved = np.any([known[name].direction for name in problem.relative], axis=0)
    if np.any(moved & ~named(problem.symmetry, model).may_turn(moved.size)):
        raise InputError(
            f"relative: a {problem.symmetry} orbit comes back, so nothing shifts; leave relative out, or use "
            "symmetry = 'none'"
        )
    first = [int(np.flatnonzero(known[name].direction)[0]) for name in problem.relative]
    if problem.winding is not None and any(problem.winding[k] for k in first):
        raise InputError(
            f"winding: {list(problem.winding)} turns a coordinate of relative = {list(problem.relative)}, whose shift "
            "is found; set it to 0"
        )


def boundary_constants(problem: Problem, nodes: np.ndarray, end: np.ndarray | None = None) -> np.ndarray:
    """The constants (2n) of the boundary rows that a guess is nearest to: the motion may be symmetric about an upright
    link. Of an orbit that repeats mirrored, about its mean over the part; of a hybrid one by its end."""
    start, turns, forward = nodes[0], problem.winding, problem.boundary.forward
    if not problem.model.smooth and forward is not None and end is not None:
        if turns is None:  # of those that stay in place half a turn is a half of one
            moved = (end - start)[: problem.turns.size]
            turns = tuple(np.where(problem.model.angular, np.round(moved / np.pi), 0.0))
    elif problem.boundary.maps and not problem.boundary.reverses:
        start = end = nodes.mean(axis=0)
    return problem.boundary.constants(problem.model.angular, start, end, turns)


def guessed_nodes(guess: Guess, shares: np.ndarray) -> np.ndarray:
    """Node states (N x 2n) at shares of the period (N), from a guess that has a trajectory."""
    assert guess.times is not None and guess.states is not None
    return np.stack([np.interp(shares * guess.period, guess.times, column) for column in guess.states.T], axis=1)


WINDING_MARGIN = 0.25
"""A motion whose angles end farther than this from whole turns (in turns) runs round in none of them."""


def loop_of(
    problem: Problem, equations: Equations, w: Unknowns, end: np.ndarray | None, pins: Sequence[Pin],
    units: np.ndarray | None = None,
) -> Loop:  # fmt: skip
    """The loop of a Problem at these pins, its phases and displacement as w has them, whose motion ends at `end`.

    `units` are what states (d) are measured in where phases are normal to the motion.
    """
    given = (pinned(equations, pin.name, pin.value) for pin in pins)
    conditions = (*clock(equations, problem.forcing_cycles), *given)
    return Loop(equations, displacement(problem, w, end), conditions, equations.phases(w, units, 1), w.nodes[0])


def displacement(problem: Problem, w: Unknowns, end: np.ndarray | None) -> np.ndarray:
    """The constants of the closing rows: the whole turns that the problem states, else those of the motion."""
    model, n = problem.model, problem.model.degrees_of_freedom
    symmetry = problem.boundary
    if symmetry.maps or problem.winding is not None or end is None:
        return boundary_constants(problem, w.nodes, end)
    turns = whole_turns(model, w.nodes[0], end, symmetry.relative, not model.smooth)
    return np.concatenate([np.zeros(n) if turns is None else 2 * np.pi * turns, np.zeros(w.nodes.shape[1] - n)])


def whole_turns(
    model: Model, start: np.ndarray, end: np.ndarray, relative: Sequence[Sequence[float]], nearest: bool = False
) -> np.ndarray | None:
    """Whole turns of each angle (n) between two states beside a shift along `relative` directions; None when they do
    not come near whole numbers, unless the `nearest` are wanted (of a clock that is among the states)."""
    turned = np.where(model.angular, (end - start)[: model.degrees_of_freedom] / (2 * np.pi), 0.0)
    turned = beside(turned, relative)
    whole = np.round(turned)
    return whole if nearest or np.all(np.abs(turned - whole) <= WINDING_MARGIN) else None


def clocked(model: Model, clock: float, state: np.ndarray | None = None) -> np.ndarray:
    """1 for the coordinates and `clock` (s) for the rates of a state (d): what makes lengths of both.

    With a `state` (d) of a motion they are relative to what its coordinates are measured in.
    """
    n = model.degrees_of_freedom
    units = np.concatenate([np.ones(n), np.full(len(model.state_names) - n, clock)])
    return units if state is None else units / np.resize(proportions(model, state), units.size)


def segments_for(matrix: np.ndarray, units: np.ndarray, growth: float, between: tuple[int, int]) -> int:
    """Segments that share the growth of a state-transition matrix, times `units` (d), so that none has more."""
    grown = max(float(np.linalg.norm(matrix * units[:, None] / units[None, :], 2)), 2.0)
    return min(max(int(np.ceil(np.log(grown) / np.log(growth))), between[0]), between[1])
