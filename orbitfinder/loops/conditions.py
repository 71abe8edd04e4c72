"""What a user asks of an orbit besides closing: pins, ranges, constraints of the unknowns by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, closest
from orbitfinder.loops.symmetry import Symmetry
from orbitfinder.mechanics.kind import system_kind
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


def quantity(model: Model, name: str, state: Any, period: Any, parameters: Any) -> Any:
    """What pins and bounds name: the period, an invariant, the energy, a state component at t = 0, a parameter."""
    n = model.degrees_of_freedom
    if name == "period":
        return period
    for invariant in model.invariants:
        if invariant.name == name:
            return invariant.value(state[:n], state[n:], parameters)
    if name == "energy":
        return model.kinetic(state[:n], state[n:], parameters) + model.potential(state[:n], parameters)
    if name in model.parameter_names and name not in model.state_names:
        return parameters[model.parameter_index(name)]
    return state[model.state_index(name)]


def quantities(model: Model) -> list[str]:
    """What pins may name beside physical parameters."""
    return ["energy", "period", *(one.name for one in model.invariants), *model.state_names]


def is_parameter(model: Model, name: str) -> bool:
    """True for the name of a physical parameter that names nothing else."""
    return name in model.parameter_names and name not in quantities(model)


def check_pin(model: Model, one: Pin) -> None:
    """`InputError` when a pin names nothing of this model or an energy that it cannot have."""
    known = [*quantities(model), *model.parameter_names]
    if one.name not in known:
        names = ", ".join(dict.fromkeys(known))
        raise InputError(f"pin: unknown quantity {one.name!r}{closest(one.name, known)}; use one of {names}")
    floor = lowest_energy(model)
    if one.name == "energy" and floor is not None and one.value <= floor:
        raise InputError(
            f"pin: energy {one.value:.9g} J cannot be reached, the lowest energy of this system is "
            f"{floor:.9g} J (at rest); give a larger energy (potential zero at the fixed joint)"
        )


def lowest_energy(model: Model) -> float | None:
    """The minimum of the potential energy in J where it is known in closed form, else None.

    Each coordinate of a chain enters V as -c_i cos theta_i, so the minimum is at 0 or pi each.
    """
    if not system_kind(model.system).pendulum:
        return None
    total = 0.0
    n = model.degrees_of_freedom
    values = model.parameter_values
    rest = float(model.potential(np.zeros(n), values))
    for i in range(n):
        turned = np.zeros(n)
        turned[i] = np.pi
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
        check_quantity(self.model, name, "variables")
        return quantity(self.model, name, self.start, self.period, self.parameters)

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
        for one in self.transitions():
            part = one @ part
        root, power = self.symmetry.root(
            part, lambda other: ca.solve(part, other), part.size1(), made=lambda one: ca.MX(ca.sparsify(ca.DM(one)))
        )
        return root @ root if power == 2 else root


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
        found = ca.vec(ca.MX(self.expression(variables)))
        if found.numel() != self.rows:
            raise InputError(f"constraints: {self.name} has {found.numel()} rows, announced {self.rows}; set rows=")
        return found


def check_constraint(one: Constraint) -> None:
    """`InputError` for bounds that contradict each other."""
    if np.isnan(one.lower) or np.isnan(one.upper) or one.lower > one.upper or one.rows < 1:
        raise InputError(
            f"constraints: {one.name} asks for {one.lower} <= expression <= {one.upper} in {one.rows} rows; give "
            "lower <= upper and at least one row"
        )


def check_quantity(model: Model, name: str, where: str, more: tuple[str, ...] = ()) -> None:
    """`InputError` when `name` is no quantity of this model."""
    known = list(dict.fromkeys(["period", "energy", *(i.name for i in model.invariants), *more, *model.state_names]))
    if name not in known:
        raise InputError(f"{where}: unknown quantity {name!r}{closest(name, known)}; use one of {', '.join(known)}")


def check_bounds(model: Model, bounds: Mapping[str, Any], free: tuple[str, ...], pinned: tuple[str, ...]) -> None:
    """`InputError` about ranges: an unknown, fixed or pinned quantity, or two numbers in the wrong order."""
    for name, given in bounds.items():
        if name in model.parameter_names and name not in free:
            raise InputError(f"bounds: {name} is not free to change; add it to free, or leave its bounds out")
        check_quantity(model, name, "bounds", free)
        if name in pinned:
            raise InputError(f"bounds: {name} is pinned already; leave out one of the two")
        pair = np.asarray(given, float)
        if pair.shape != (2,) or np.any(np.isnan(pair)) or not pair[0] < pair[1]:
            raise InputError(f"bounds: {name} must be [smallest, largest], smallest below largest, got {given}")
        if name == "period" and not (pair[0] > 0 and np.isfinite(pair[1])):
            raise InputError(f"bounds: period must be positive and finite, got {given}; give two times in s")
        if name == "period" and model.forced:
            raise InputError("bounds: the forcing prescribes the period; leave period out")
