"""Sizes to divide by: what guards a quotient against a size of 0, said once."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

EPSILON = float(np.finfo(float).eps)
"""Relative round-off of a number"""
LEAST = 1e-300
"""What stands for a size that is 0, beside which every difference is large and no difference is none"""

Sizes = TypeVar("Sizes", float, np.ndarray)


def nonzero(sizes: Sizes) -> Sizes:
    """Sizes, none of them 0."""
    return np.asarray(np.maximum(sizes, LEAST)) if isinstance(sizes, np.ndarray) else max(float(sizes), LEAST)


def size_of(values: float | np.ndarray) -> float:
    """The largest of values without their signs, not 0."""
    return nonzero(float(np.abs(values).max(initial=0.0)))


def relative(difference: float | np.ndarray, values: float | np.ndarray) -> float:
    """The largest difference from values, relative to the largest of them."""
    return float(np.abs(difference).max(initial=0.0)) / size_of(values)
