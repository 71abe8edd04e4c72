"""Symmetries that nobody declares: mirrors in some of the coordinates, run with the film backwards.

With signs s (n, each 1 or -1) R(q, v) = (s q, -s v) reverses the motion when a(s q, -s v) = s a(q, v). What starts
in the fixed set of R (q = 0 where s = -1, v = 0 where s = 1) and returns to it after T / 2 is periodic. Source:
J. S. W. Lamb, J. A. G. Roberts, Physica D 112 (1998) 1-39, section 3.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from orbitfinder.mechanics.model import Model

MOST_COORDINATES = 8
TRIES = 4
AGREEMENT = 1e-9
"""Accelerations there and in the mirror differ by less than this, relative."""


def mirrors(model: Model) -> tuple[np.ndarray, ...]:
    """Signs (n) of the reversing mirrors of a Model; those of all or of no coordinates have names, and are left out."""
    n = model.degrees_of_freedom
    if n > MOST_COORDINATES:
        return ()
    random = np.random.default_rng(0)
    states = random.normal(0, 1.0, (TRIES, 2, n)) + np.array([np.ones(n), np.zeros(n)])
    candidates = (np.array(signs, float) for signs in product((1, -1), repeat=n) if len(set(signs)) > 1)
    return tuple(signs for signs in candidates if reverses(model, signs, states))


def reverses(model: Model, signs: np.ndarray, states: np.ndarray) -> bool:
    """True when the equations keep their form at some states (k x 2 x n)."""

    def acceleration(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return np.asarray(model.acceleration(0.0, q, v, model.parameter_values).full().ravel())

    for q, v in states:
        here, there = signs * acceleration(q, v), acceleration(signs * q, -signs * v)
        if not np.abs(there - here).max() <= AGREEMENT * np.abs(here).max():
            return False
    return True


def named(model: Model, signs: np.ndarray) -> str:
    """A mirror in words: the coordinates that change their sign."""
    changed = [name for name, sign in zip(model.state_names, signs, strict=False) if sign < 0]
    return ", ".join(f"{name} -> -{name}" for name in changed)


def off_section(signs: np.ndarray, states: np.ndarray, angles: np.ndarray, rate: float) -> np.ndarray:
    """How far states (k x 2n) are from the fixed set of a mirror (rad or m), with rates (1/s) in units of `rate`.

    An angle may be at any multiple of a half turn.
    """
    q, v = np.split(states, 2, axis=1)
    folded = np.where(angles, (q + np.pi / 2) % np.pi - np.pi / 2, q)
    return np.asarray(np.where(signs < 0, np.abs(folded), np.abs(v) / rate).max(axis=1))
