"""The least and greatest values of motions between their samples."""

from __future__ import annotations

import numpy as np

from orbitfinder._runtime.sizes import nonzero


def extent(times: np.ndarray, states: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Least and greatest values (... x 2 x d) of motions without jumps, between their samples too.

    Where a component turns within a step, Newton's method finds where p' is 0, of the polynomial p of degree 7 through
    states and rates of the four nearest samples (Hermite). The error is of the order h^8 of the steps.

    Args:
        times: instants (... x m + 1), increasing, of equal or unequal steps.
        states: values at these instants (... x m + 1 x d).
        rates: time derivatives of the states there (... x m + 1 x d).
    """
    begin, end, lengths = rates[..., :-1, :], rates[..., 1:, :], np.diff(times)[..., None]
    turns = begin * end < 0
    at = np.flatnonzero(np.moveaxis(turns, -2, 0).reshape(turns.shape[-2], -1).any(axis=1))
    with np.errstate(invalid="ignore", divide="ignore"):  # of what does not turn there
        later = (lengths * begin / (begin - end))[..., at, :]
        for _ in range(3):
            value, slope, bend = _near(times, states, rates, at, later)
            later = (later - slope / bend).clip(0.0, lengths[..., at, :])
    both = np.concatenate([states, np.where(turns[..., at, :], value, states[..., at, :])], axis=-2)
    return np.stack([both.min(axis=-2), both.max(axis=-2)], axis=-2)


def _near(
    times: np.ndarray, states: np.ndarray, rates: np.ndarray, at: np.ndarray, later: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, slopes and second derivatives (... x k x d) of polynomials through the nearest samples, so long
    `later` than the samples `at` (k), by Newton's divided differences."""
    count = min(4, times.shape[-1])
    nearest = np.clip(at - 1, 0, times.shape[-1] - count)[:, None] + np.arange(count)
    moments = times[..., nearest] - times[..., at, None]
    unit = nonzero(np.ptp(moments, axis=-1))[..., None]
    z, f, x = np.repeat(moments / unit, 2, axis=-1), np.repeat(states[..., nearest, :], 2, axis=-2), later / unit
    leading = [f[..., 0, :]]
    for order in range(1, 2 * count):
        gaps = (z[..., order:] - z[..., :-order])[..., None]
        f = np.diff(f, axis=-2) / np.where(gaps > 0, gaps, 1.0)
        if order == 1:
            f[..., ::2, :] = rates[..., nearest, :] * unit[..., None]
        leading.append(f[..., 0, :])
    value = slope = bend = np.zeros_like(x)
    for k in reversed(range(2 * count)):
        away = x - z[..., k, None]
        bend, slope, value = bend * away + 2 * slope, slope * away + value, value * away + leading[k]
    return value, slope / unit, bend / unit**2
