"""What is asked of an orbit besides closing: pins, ranges, constraints of the unknowns by name, and the rows they make.

`QUANTITIES` has each kind of thing that a pin, a range, a family's parameter and `variables[...]` may name: its names,
its expression, its row, and why it cannot be pinned. Another kind is an entry more (`tests/test_toy_condition.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import Registry, check, check_fields, shown
from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, closest
from orbitfinder.loops.loop import Condition, Equations, Unknowns, levels
from orbitfinder.loops.symmetry import Symmetry
from orbitfinder.mechanics.kind import restricted, system_kind
from orbitfinder.mechanics.model import Model, constraint_of


@dataclass(frozen=True)
class Pin:
    """One prescribed number: `energy` (J), `period` (s), another invariant, a state component at t = 0, a parameter."""

    name: str
    value: float


def pin(**quantities: float) -> tuple[Pin, ...]:
    """What a Problem holds fixed, by name.

    Of energy, period, invariants and state components one pin selects one orbit of a family; more than one is right
    only with freed physical parameters or further invariants, and `Problem.count()` says so.

    Args:
        **quantities: energy in J, period in s, a state component at t = 0, an invariant, or a physical parameter
            (that is then its value), each with its number.

    Returns:
        The pins, for `Problem(pin=...)`.

    Raises:
        InputError: for what is no finite number, and without any.

    Examples:
        >>> [one.name for one in of.pin(energy=-11.0, gravity=3.7)]
        ['energy', 'gravity']
    """
    pins = tuple(Pin(name, float(value)) for name, value in quantities.items())
    for one in pins:
        if not np.isfinite(one.value):
            raise InputError(f"pin: {one.name} must be finite, got {one.value}; give a number")
        if one.name == "period" and one.value <= 0:
            raise InputError(f"pin: period must be positive, got {one.value:g}; give the period in s")
    return pins


def constrained_brake_rows(model: Model, start: Any, end: Any, parameters: Any, basis: np.ndarray) -> Any:
    """The rows (2n) of a brake orbit under m constraints: v(0), phi(q(0)), B^T v(T/2).

    `basis` B (n x n-m) spans the velocities that the constraints allow at the guess's far rest; on the manifold
    J v = 0 says the rest.
    """
    n = start.numel() // 2
    return ca.vertcat(start[n:], constraint_of(model).phi(start[:n], parameters), basis.T @ end[n:])


def quantities(model: Model) -> list[str]:
    """What pins may name beside physical parameters."""
    return [name for kind, each in QUANTITIES.items() if kind != PARAMETER for name in each.named(model)]


def followed(model: Model) -> list[str]:
    """What a family may be followed in beside physical parameters."""
    return [name for kind in QUANTITIES.values() if kind.followed for name in kind.named(model)]


def kind_of(model: Model, name: str, where: str = "pin", more: Sequence[str] = ()) -> Quantity:
    """The kind of what a name stands for; `InputError` where that is no quantity of this model, nor one `more`."""
    kind = next((kind for kind in QUANTITIES.values() if name in kind.named(model)), None)
    if kind is None or (kind is QUANTITIES[PARAMETER] and name not in more):
        known = list(dict.fromkeys([*quantities(model), *more]))
        raise InputError(f"{where}: unknown quantity {name!r}{closest(name, known)}; use one of {', '.join(known)}")
    return kind


def is_parameter(model: Model, name: str) -> bool:
    """True for the name of a physical parameter that names nothing else."""
    return name in model.parameter_names and name not in quantities(model)


def check_pin(problem: Any, asked: Pin) -> None:
    """`InputError` when a pin names nothing of this problem's model or a value that it cannot have."""
    kind = kind_of(problem.model, asked.name, more=problem.model.parameter_names)
    why = kind.refused(problem, asked)
    check(f"Quantity of {asked.name!r}, refused", "str | None", why, "; return why, or '' where it may be pinned")
    if not why and kind.row is None and problem.control is not None:
        why = f"{asked.name} is not of controlled motions, whose costate does not know it; ask for it in a task"
    if why:
        raise InputError(f"pin: {why}")


def pinned(equations: Equations, name: str, value: float) -> Condition:
    """The condition that a quantity or a freed parameter has a value."""
    kind = QUANTITIES[PARAMETER] if name in equations.free else kind_of(equations.model, name, more=equations.free)
    if kind.row is not None:
        row = kind.row(equations, name, value)
        check(f"Quantity of {name!r}, row", "Condition", row)
        return row
    return expressed(value, name, lambda variables: kind.expression(variables, name))


def measured(equations: Equations, w: Unknowns, name: str) -> float:
    """What a quantity or a freed parameter is at w."""
    if name in equations.free:
        return float(w.free[equations.free.index(name)])
    if (key := ("measured", name)) not in equations.derived:
        equations.derived[key] = pinned(equations, name, 0.0)
    return float(equations.derived[key].at(equations, w))


def lowest_energy(model: Model) -> float | None:
    """The minimum of the potential energy in J where it is known in closed form, else None.

    Each coordinate of a chain enters V as -c_i cos theta_i, so the minimum is at 0 or pi each.
    """
    if not system_kind(model.system).pendulum:
        return None
    total, n, values = 0.0, model.degrees_of_freedom, model.parameter_values
    rest = float(model.potential(np.zeros(n), values))
    for turned in np.pi * np.eye(n):
        total += min(0.0, float(model.potential(turned, values)) - rest)
    return rest + total


@dataclass(frozen=True)
class Variables:
    """The unknowns of a shooting problem as CasADi symbols: what objectives and constraints are written in.

    `variables["theta1"]` is a state component at t = 0; `["period"]`, `["energy"]`, invariants and physical
    parameters are found by name too. `start`, `rate` and `acceleration` are those at t = 0, `monodromy` is Phi(T) (2n
    x 2n).

    Args:
        model: the system.
        symmetry: whose boundary condition closes the loop.
        nodes: states at the start of each segment (N of 2n).
        ends: states at the end of each segment (N of 2n).
        period: T in s.
        free: freed physical parameters by name.
        parameters: all physical parameters (k).
        transitions: gives the state-transition matrices of the segments.

    Examples:
        >>> at_rest = of.Constraint(lambda variables: variables["theta1dot"], name="first link at rest")
        >>> found = of.find_orbit(of.Problem(pendulum, guess, constraints=(at_rest,)))
        >>> bool(abs(found.state[2]) < 1e-9)
        True
    """

    __repr__ = brief("model", "period", "free")

    model: Model
    symmetry: Symmetry
    nodes: tuple[ca.MX, ...]
    ends: tuple[ca.MX, ...]
    period: ca.MX
    free: Mapping[str, ca.MX]
    parameters: ca.MX
    transitions: Callable[[], list[ca.MX]]

    @property
    def start(self) -> ca.MX:
        """The state (2n) at t = 0."""
        return self.nodes[0]

    def __getitem__(self, name: str) -> ca.MX:
        """A quantity by name; `InputError` names the known ones."""
        if name in self.model.parameter_names:
            return self.parameters[self.model.parameter_index(name)]
        return kind_of(self.model, name, "variables").expression(self, name)

    @property
    def rate(self) -> ca.MX:
        """x' (d) at t = 0."""
        return self.model.rate(0.0, self.start, self.parameters)

    @property
    def acceleration(self) -> ca.MX:
        """a(0, q, v, p) (n) at t = 0."""
        n = self.model.degrees_of_freedom
        return self.model.acceleration(0.0, self.start[:n], self.start[n:], self.parameters)

    @property
    def monodromy(self) -> ca.MX:
        """Phi(T) (2n x 2n), whose derivatives come from second-order variational equations.

        Over a symmetric part of the period it follows from that of the part.
        """
        part = ca.MX.eye(self.start.numel())
        for transition in self.transitions():
            part = transition @ part
        root, power = self.symmetry.root(
            part,
            lambda other: ca.solve(part, other),
            part.size1(),
            made=lambda matrix: ca.MX(ca.sparsify(ca.DM(matrix))),
        )
        return root @ root if power == 2 else root


def variables_of(
    equations: Equations,
    nodes: Sequence[ca.MX],
    period: ca.MX,
    free: ca.MX,
    ends: Sequence[ca.MX] = (),
    transitions: Callable[[], list[ca.MX]] | None = None,
) -> Variables:
    """The unknowns of a loop by name; without `transitions` what needs them is refused."""

    def none() -> list[ca.MX]:
        raise InputError("monodromy: is not known where a pin is stated; ask for it in constraints or an objective")

    named = {name: free[k] for k, name in enumerate(equations.physical)}
    model, parameters = equations.model, equations.model.parameters(equations.free, free)
    return Variables(
        model, equations.symmetry, tuple(nodes), tuple(ends), period, named, parameters, transitions or none
    )


Expression = Callable[[Variables], Any]
"""From the unknowns to a CasADi expression (or a number)."""


@dataclass(frozen=True)
class Constraint:
    """lowest <= expression(variables) <= highest; an equation, one to be counted for each row, when the two agree.

    Args:
        expression: function of `of.Variables` that makes a CasADi expression.
        lower: its least value, in its own units.
        upper: its greatest value.
        rows: its length.
        name: for messages.

    Examples:
        >>> reach = of.Constraint(lambda v: v["length1"] + v["length2"], 1.8, 2.2, name="reach")
        >>> reach.equation
        False
    """

    expression: Expression
    lower: float = 0.0
    upper: float = 0.0
    rows: int = 1
    name: str = "constraint"

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def equation(self) -> bool:
        """True when it leaves no room."""
        return self.lower == self.upper

    def value(self, variables: Variables) -> ca.MX:
        """The expression as a column; `InputError` when it has another length than announced."""
        rows = ca.vec(ca.MX(self.expression(variables)))
        if rows.numel() != self.rows:
            raise InputError(f"constraints: {self.name} has {rows.numel()} rows, announced {self.rows}; set rows=")
        return rows


def hyperplane(value: float, normal: np.ndarray, name: str = "") -> Condition:
    """The condition `normal`.(x(0), T, free), or .w, = `value`."""
    return Condition(
        name,
        value,
        lambda _, w: float(w.over(normal) @ w.vector),
        lambda _, w: w.over(normal),
        lambda _, nodes, period, free: ca.sparsify(ca.DM(normal)).T @ ca.vertcat(nodes[0], period, free),
    )


def conserved(value: float, name: str, number: int) -> Condition:
    """The condition that one of the `levels` has a value at t = 0."""

    def slope(equations: Equations, w: Unknowns) -> np.ndarray:
        _, by_state, by_free = equations.quantities_at(w)
        return w.spread(np.concatenate([by_state[number], [0.0], by_free[number]]))

    return Condition(
        name, value, lambda equations, w: float(equations.quantities_at(w)[0][number]), slope,
        lambda equations, nodes, _, free: levels(
            equations.model, nodes[0], equations.model.parameters(equations.free, free)
        )[number],
    )  # fmt: skip


def clock(equations: Equations, cycles: int) -> tuple[Condition, ...]:
    """The condition that a motion lasts so many periods of the forcing; none where nothing is forced."""
    if not equations.model.forced:
        return ()
    period, beat = _unknown(equations, "period", 0.0), conserved(0.0, "", -1)
    return (
        Condition(
            "forcing period",
            0.0,
            lambda *at: period.at(*at) - cycles * beat.at(*at),
            lambda *at: period.slope(*at) - cycles * beat.slope(*at),
            lambda *at: period.expression(*at) - float(cycles) * beat.expression(*at),
            cycles,
        ),
    )


def expressed(value: float, name: str, expression: Expression) -> Condition:
    """The condition that an expression of `Variables`, known by its name, has a value; its derivatives are CasADi's."""

    def stated(*where: Any) -> ca.MX:
        made = ca.MX(expression(variables_of(*where)))
        if made.numel() != 1:
            raise InputError(f"pin: {name} is {made.numel()} numbers; hold each by a name of its own")
        return made

    def both(equations: Equations, w: Unknowns) -> np.ndarray:
        if (key := (name, len(w.nodes))) not in equations.derived:
            nodes, (period, unfolding, free) = w.symbols()
            parts, made = [*nodes, period, unfolding, free], stated(equations, nodes, period, free)
            rows = ca.horzcat(made, ca.densify(ca.jacobian(made, ca.vertcat(*parts))))
            equations.derived[key] = ca.Function("expressed", parts, [rows])
        return np.asarray(equations.derived[key](*w.nodes, w.period, w.unfolding, w.free)).ravel()

    return Condition(name, value, lambda *where: float(both(*where)[0]), lambda *where: both(*where)[1:], stated)


@dataclass(frozen=True)
class Quantity:
    """A kind of what pins, ranges, families' parameters and `variables[...]` may name.

    Args:
        names: of a model, those that it has.
        value: (variables, name) -> the expression of CasADi.
        row: (equations, name, value) -> the condition that it has that value; None: the expression's.
        refused: (problem, pin) -> why it cannot be pinned there, with a remedy; "" where it can.
        followed: whether a family may be followed in it, wherever on an orbit t = 0 is.
        held: whether a family in a physical parameter may keep it, as the energy.
    """

    names: Callable[[Model], Sequence[str]]
    value: Callable[[Variables, str], Any]
    row: Callable[[Equations, str, float], Condition] | None = None
    refused: Callable[[Any, Pin], str] = lambda *_: ""
    followed: bool = False
    held: bool = False

    def named(self, model: Model) -> Sequence[str]:
        """The names of a model; `TypeError` for what is no list, as a text, whose letters would be names."""
        names = self.names(model)
        if isinstance(names, str) or not isinstance(names, Sequence):
            (entry,) = (name for name, each in QUANTITIES.items() if each is self)
            what = f"the text {names!r}" if isinstance(names, str) else shown(names)
            raise TypeError(f"Quantity.names: returned {what}; return a list of names, ['...'], for {entry!r}")
        return names

    def expression(self, variables: Variables, name: str) -> Any:
        """Its value. Raises `InputError` for what CasADi does not know."""
        value = self.value(variables, name)
        check(f"Quantity of {name!r}, value", "ca.MX", value, "; write it in what `of.Variables` has")
        return value


def _level(variables: Variables, name: str) -> Any:
    """An invariant, or the energy."""
    return levels(variables.model, variables.start, variables.parameters)[_number(variables.model, name)]


def _number(model: Model, name: str) -> int:
    return (*(invariant.name for invariant in model.invariants), "energy").index(name)


def _kept(equations: Equations, name: str, value: float) -> Condition:
    """The row of a level."""
    return conserved(value, name, _number(equations.model, name))


def _unknown(equations: Equations, name: str, value: float) -> Condition:
    """The row of what is an unknown itself."""
    size, known = equations.size, ("period", *equations.free)
    normal = np.zeros(size + len(known))
    normal[size + known.index(name) if name in known else equations.model.state_index(name)] = 1.0
    return hyperplane(value, normal, name)


def _energy_refused(problem: Any, asked: Pin) -> str:
    floor = lowest_energy(problem.model)
    if floor is not None and asked.value <= floor:
        return (
            f"energy {asked.value:.9g} J cannot be reached, the lowest energy of this system is {floor:.9g} J (at "
            "rest); give a larger energy (potential zero at the fixed joint)"
        )
    if not problem.model.conservative:
        return (
            "energy is not conserved by this system; leave the pin out, or free a parameter and pin the period or a "
            "state component"
        )
    return ""


def _period_refused(problem: Any, _: Pin) -> str:
    if problem.model.forcing_period is None:
        return ""
    clock = problem.model.driving_period
    return (
        f"the forcing prescribes the period, a multiple of {clock:.9g} s (guess.period chooses which, now "
        f"{problem.forcing_cycles}); leave period out"
    )


def _state_refused(problem: Any, asked: Pin) -> str:
    n, symmetry = problem.model.degrees_of_freedom, problem.boundary
    if asked.name not in problem.model.state_names[:n] or not symmetry.held(n)[problem.model.state_index(asked.name)]:
        return ""
    return (
        f"{asked.name} is a multiple of pi, or 0, where a {symmetry.name} orbit starts; pin its rate, the energy or "
        "the period"
    )


def _phase(_: Variables, name: str) -> Any:
    raise InputError(f'{name}: is of a harmonic, which method = "balance" knows; ask for that')


PARAMETER, PHASE = "a physical parameter", "phase_"
QUANTITIES = Registry(Quantity, {
    "the energy": Quantity(
        lambda _: ("energy",),
        _level,
        _kept,
        _energy_refused,
        followed=True,
        held=True,
    ),
    "the period": Quantity(
        lambda _: ("period",),
        lambda variables, _: variables.period,
        _unknown,
        _period_refused,
        followed=True,
        held=True,
    ),
    "Jacobi's constant": Quantity(
        lambda model: ("jacobi",) * restricted(model.system),
        lambda variables, _: -2 * _level(variables, "energy"),
        refused=_energy_refused,
        followed=True,
        held=True,
    ),
    "an invariant": Quantity(
        lambda model: [invariant.name for invariant in model.invariants],
        _level,
        _kept,
        followed=True,
    ),
    "a state component at t = 0": Quantity(
        lambda model: model.state_names,
        lambda variables, name: variables.start[variables.model.state_index(name)],
        _unknown,
        _state_refused,
        followed=True,
    ),
    "the phase of a coordinate of a driven motion": Quantity(
        lambda model: [PHASE + name for name in model.state_names[: model.degrees_of_freedom * model.forced]],
        _phase,
    ),
    PARAMETER: Quantity(
        lambda model: model.parameter_names,
        lambda variables, name: variables.parameters[variables.model.parameter_index(name)],
        _unknown,
    ),
})  # fmt: skip
"""What may be named, by its kind; where a name is of two, the first is meant. A phase (rad) is that of a coordinate's
first harmonic, amplitude cos(2 pi t / T + phase)"""


def check_bounds(model: Model, bounds: Mapping[str, Any], free: tuple[str, ...], pinned: tuple[str, ...]) -> None:
    """`InputError` about ranges: an unknown, fixed or pinned quantity, or two numbers in the wrong order."""
    for name, given in bounds.items():
        if name in model.parameter_names and name not in free:
            raise InputError(f"bounds: {name} is not free to change; add it to free, or leave its bounds out")
        kind_of(model, name, "bounds", free)
        if name in pinned:
            raise InputError(f"bounds: {name} is pinned already; leave out one of the two")
        pair = np.asarray(given, float)
        if pair.shape != (2,) or np.any(np.isnan(pair)) or not pair[0] < pair[1]:
            raise InputError(f"bounds: {name} must be [smallest, largest], smallest below largest, got {given}")
        if name == "period" and not (pair[0] > 0 and np.isfinite(pair[1])):
            raise InputError(f"bounds: period must be positive and finite, got {given}; give two times in s")
        if name == "period" and model.forced:
            raise InputError("bounds: the forcing prescribes the period; leave period out")
