"""What an objective, a constraint or a phase condition may speak of: the unknowns of a Problem by name.

Shooting hands `Variables` to callables that a user supplies; nobody else needs the order of the
decision vector.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, closest
from orbitfinder.loops.conditions import quantity
from orbitfinder.loops.symmetry import Symmetry
from orbitfinder.mechanics.model import Model


@dataclass(frozen=True)
class Variables:
    """The unknowns of a shooting problem as CasADi symbols.

    `nodes` and `ends` (N of 2n each) are the states at the start and the end of each segment,
    `period` is T in s, `free` the freed physical parameters by name, `parameters` all of them.
    `variables["theta1"]` is a state component at t = 0; `["period"]`, `["energy"]`, invariants and
    physical parameters are found by name too.
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
    """makes the segments' state-transition matrices, first to last"""

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
    """lower <= expression(variables) <= upper; an equation (one to be counted for each row) when the two agree.

    `rows` is the length of the expression.
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
