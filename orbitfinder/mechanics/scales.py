"""What motions of a system are measured in: the one place for its lengths and its time.

Angles are measured in rad. Other coordinates may be told in anything, so they are measured in lengths of the motion,
each in proportion to what carries the same kinetic energy at the same pace,

    m_i L_i^2 = m_j L_j^2        m the diagonal of the mass matrix, L = 1 for angles,

so that a slider beside a crank, or a charge beside a plate, counts as much as what it moves with. Rates are
measured in lengths over tau = T / 2 pi. Whoever divides by these divides by exactly 1 where a system is of order one:
what is within a factor of 16 counts as equal, and the rest are powers of two, which cost no digits.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from orbitfinder.mechanics.model import Model

ALIKE = 16.0
"""Lengths that differ by less than this factor are measured alike."""


def snapped(values: np.ndarray | float, base: float = ALIKE**2) -> np.ndarray:
    """The powers of a base nearest to positive values, 1 for all others."""
    given = np.asarray(values, float)
    known = np.isfinite(given) & (given > 0)
    powers = np.round(np.log(np.where(known, given, 1.0)) / np.log(base))
    return np.asarray(base**powers)


def masses_of(kinetic: Callable[..., Any], state: np.ndarray, model: Model | None = None) -> np.ndarray:
    """Diagonal (n) of the mass matrix at a state (2n): twice the kinetic energy of each unit velocity."""
    n = state.size // 2
    given = [] if model is None else [model.parameter_values]
    return np.array([2.0 * float(kinetic(state[:n], unit, *given)) for unit in np.eye(n)])


def proportions(model: Model, state: np.ndarray) -> np.ndarray:
    """L_i (n) of the coordinates, in rad where there are angles, else relative to that of the heaviest coordinate.

    What the user gives (`model.scales`) replaces what the mass matrix says.
    """
    if model.angular.all():
        return np.ones(model.degrees_of_freedom)
    masses = masses_of(model.kinetic, state, model)
    known = np.isfinite(masses) & (masses > 0)
    turning = model.angular & known
    reference = masses[turning if turning.any() else known].max(initial=0.0)
    ratios = np.sqrt(np.where(known, reference / np.where(known, masses, 1.0), 1.0))
    ratios = np.where((ratios < 1 / ALIKE) | (ratios > ALIKE), snapped(ratios, 2.0), 1.0)
    return np.where(model.angular, 1.0, ratios)


def lengths(model: Model, states: np.ndarray) -> np.ndarray:
    """What coordinates (n) are measured in along a motion (k x 2n): its largest extent where there are no angles."""
    parts, n = proportions(model, states[0]), model.degrees_of_freedom
    if model.angular.any():
        return parts
    return parts * max(float((np.ptp(states[:, :n], axis=0) / parts).max()), 1e-300)


def units_of(model: Model, states: np.ndarray, period: float) -> tuple[float, ...]:
    """What a state (2n) is integrated in: powers of 256 near the lengths and the time of a motion (k x 2n); () is 1.

    Lengths are max(|q|, |v| tau), tau = T / 2 pi, the largest over all angles and over all others, or |a| tau^2 where
    that is 0.
    """
    clock, n = period / (2 * np.pi), model.degrees_of_freedom
    if model.constraint is not None:  # integrated by IDAS, in its own coordinates
        return ()
    largest = np.abs(states).max(axis=0)
    found = np.maximum(largest[:n], largest[n:] * clock)
    turning = model.angular
    for group in (turning, ~turning):
        size = found[group].max(initial=0.0)
        if group.any() and not size > 0:
            a = model.acceleration(0.0, states[0, :n], states[0, n:], model.parameter_values).full().ravel()
            size = (np.abs(np.nan_to_num(a)) * clock**2)[group].max()
        found[group] = size
    found = snapped(found)
    units = np.concatenate([found, found / snapped(clock)])
    return () if np.all(units == 1.0) else tuple(float(one) for one in units)
