"""What the built-in systems are made of: checked numbers as symbols, and the description that rebuilds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.lagrange import Symbols

MODULE = "orbitfinder.systems"


@dataclass(frozen=True)
class Ingredients:
    """Symbols of a system: coordinates q, velocities v, time t and parameters by name with their values."""

    q: ca.SX
    v: ca.SX
    t: ca.SX
    values: Mapping[str, float]
    parameters: ca.SX

    def __getitem__(self, name: str) -> Any:
        """The symbol of one parameter."""
        return self.parameters[list(self.values).index(name)]

    def symbols(self, forcing_period: Any = None) -> Symbols:
        """The same for `lagrange`."""
        names, values = tuple(self.values), tuple(self.values.values())
        return Symbols(self.q, self.v, self.parameters, names, values, self.t, forcing_period)

    def described(self, function: str, **fixed: Any) -> dict[str, Any]:
        """The `system` entry of a file from which this system is rebuilt."""
        return {"kind": "python", "module": MODULE, "function": function, "arguments": {**fixed, **self.values}}


def ingredients(
    count: int, positive: Mapping[str, float] | None = None, signed: Mapping[str, float] | None = None
) -> Ingredients:
    """Symbols for `count` coordinates and these parameters; `InputError` for a number that cannot be meant."""
    values: dict[str, float] = {}
    for name, value in {**(positive or {}), **(signed or {})}.items():
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not np.isfinite(value):
            raise InputError(f"system.arguments.{name}: must be a finite number, got {value!r}; check the value")
        if name in (positive or {}) and value <= 0:
            raise InputError(f"system.arguments.{name}: must be positive, got {value!r}; check the sign and the unit")
        values[name] = float(value)
    return Ingredients(
        ca.SX.sym("q", count), ca.SX.sym("v", count), ca.SX.sym("t"), values, ca.SX.sym("p", len(values))
    )


def whole(name: str, value: int, most: int) -> int:
    """A count between 1 and `most`, or `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= most:
        raise InputError(f"system.arguments.{name}: must be a whole number from 1 to {most}, got {value!r}")
    return value
