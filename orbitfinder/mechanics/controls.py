"""Controls: physical parameters that may vary in time, such as the torque of a motor, and the forces they exert.

A control u is an entry of p, so that the field is f(t, x, p) as ever and df/du comes by differentiation. At the values
that a Model has of its own (0 unless said) it is the mechanism without motors, with everything that it conserves;
`actuated` is the same Model for motions along which controls act: what they break is no longer an invariant.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.model import Model, altered, inputs_of

TORQUE = "torque"
"""Name of a motor's torque (N m), followed by the number of its joint"""
BROKEN = 1e-9
"""Rate of an invariant, relative to the terms that it is the sum of, above which controls break it."""

Limits = Mapping[str, float | Sequence[float]]
"""of each control the greatest magnitude, or (lowest, highest)"""


def with_controls(model: Model, names: Sequence[str], limits: Limits | None = None) -> Model:
    """The Model with these physical parameters as its controls, within `limits`. Raises `InputError`."""
    checked_controls(names, model.parameter_names)
    return altered(model, controls=tuple(names), limits=checked_limits(limits or {}, names))


def checked_controls(names: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """Names of controls, each a physical parameter and none twice; `InputError` otherwise."""
    if isinstance(names, str):
        raise InputError(f"controls: must be a list of names, got {names!r}; give [{names!r}]")
    for name in names:
        if name not in known:
            listed = ", ".join(known[:12]) or "none"
            raise InputError(f"controls: {name!r} is no physical parameter{closest(name, known)}; known are {listed}")
        if list(names).count(name) > 1:
            raise InputError(f"controls: {name!r} is named twice; name it once")
    return tuple(names)


def checked_limits(limits: Limits, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    """(lowest, highest) of each control that has limits; `InputError` for what is none."""
    numbers = {}
    for name, given in limits.items():
        if name not in names:
            raise InputError(f"limits: {name!r} is no control{closest(name, names)}; controls are {', '.join(names)}")
        try:
            pair = np.array([-given, given] if isinstance(given, (int, float)) else given, float)  # type: ignore[operator]
        except (TypeError, ValueError):
            pair = np.array([])
        if pair.shape != (2,) or np.any(np.isnan(pair)) or not pair[0] < pair[1]:
            raise InputError(f"limits.{name}: must be a positive number or [lowest, highest], got {given!r}")
        numbers[name] = (float(pair[0]), float(pair[1]))
    return numbers


def checked_motors(motors: Sequence[int], joints: int) -> list[int]:
    """Numbers of the joints that have motors, 1 to `joints`, none twice; `InputError` otherwise."""
    given: list[Any] = [motors] if isinstance(motors, int | str) else list(motors)
    for number in given:
        whole = isinstance(number, (int, np.integer)) and not isinstance(number, bool)
        if not whole or not 1 <= number <= joints or given.count(number) > 1:
            raise InputError(f"motors: {number!r} in {given}; give different joints from 1 (at the ground) to {joints}")
    return [*map(int, given)]


def divided(forces: Any, p: Any, names: Sequence[str], known: Sequence[str], values: Sequence[float]) -> Any:
    """Generalized forces as (those at the controls' own values or None, what controls add or None)."""
    if forces is None or not names:
        return forces, None
    places = [list(known).index(name) for name in checked_controls(names, known)]
    if not ca.depends_on(ca.SX(forces), p[places]):
        return forces, None
    still = ca.substitute(ca.SX(forces), p[places], ca.SX(ca.DM([values[k] for k in places])))
    passive = None if ca.simplify(still).is_zero() else still
    return passive, ca.SX(forces) if passive is None else forces - still


def check_constant(model: Model, names: Iterable[str]) -> None:
    """`InputError` for a motor's torque among parameters that are to have one value all the time."""
    for name in names:
        if model.actuation is not None and name in model.controls:
            raise InputError(f"{name}: is a control and varies in time; free or fix another parameter")


def actuated(model: Model) -> Model:
    """The Model for motions along which its controls act: with their forces, without the invariants they break; itself
    where it is that already."""
    if not model.controls or not model.smooth:
        return model
    forces, drive = model.forces, model.actuation
    if drive is not None and forces is not None:
        inputs = inputs_of(drive)
        drive = ca.Function("forces", inputs, [forces(*inputs) + drive(*inputs)])
    kept = tuple(invariant for invariant, broken in zip(model.invariants, _broken(model), strict=True) if not broken)
    if drive is None and len(kept) == len(model.invariants) and not model.hamiltonian:
        return model
    return altered(model, forces=drive or forces, actuation=None, invariants=kept, hamiltonian=False)


def _broken(model: Model) -> list[bool]:
    """Which invariants change under some constant control, or with it, at seeded states and values of it."""
    if not model.invariants:
        return []
    n, places = model.degrees_of_freedom, [model.parameter_index(name) for name in model.controls]
    x, p = ca.MX.sym("x", len(model.state_names)), ca.MX.sym("p", len(model.parameter_names))
    rate = model.rate(ca.DM(0.0), x, p)
    rows = []
    for invariant in model.invariants:
        level = invariant.value(x[:n], x[n:], p)
        slope, other = ca.gradient(level, x), ca.gradient(level, p)[places]
        change = ca.vertcat(ca.dot(slope, rate), ca.norm_1(other))
        rows.append(ca.vertcat(change, ca.dot(ca.fabs(slope), ca.fabs(rate))))
    function, random = ca.Function("rates", [x, p], rows), np.random.default_rng(0)
    varying = np.zeros(len(rows), bool)
    for _ in range(4):
        values = model.parameter_values.copy()
        values[places] += random.normal(size=len(places)) * max(1.0, float(np.abs(values).max()))
        results = function(random.normal(size=x.numel()), values)
        for k, each in enumerate(results if isinstance(results, (tuple, list)) else [results]):
            change, by_control, size = each.full().ravel()
            varying[k] |= bool(abs(change) > BROKEN * size or by_control > 0)
    return [bool(varies) for varies in varying]
