"""The least and greatest values of motions between their samples."""

from __future__ import annotations

import numpy as np

from orbitfinder._runtime.sizes import nonzero


def extent(times: np.ndarray, states: np.ndarray, rates: np.ndarray | None = None) -> np.ndarray:
    """Least and greatest values (... x 2 x d) of motions without jumps, between their samples too.

    In each step the cubic through states and rates tells where a component turns. There the polynomial p of degree 7
    through states and rates of the four nearest samples, or through the eight nearest states, is evaluated, and its
    extremum is a Newton step from there: p - p'^2 / (2 p''). The error is of the order h^8 of the steps, and h^7
    without rates.

    Args:
        times: instants (... x m + 1), increasing, of equal or unequal steps.
        states: values at these instants (... x m + 1 x d).
        rates: time derivatives of the states there (... x m + 1 x d), if they are known.
    """
    every = np.arange(times.shape[-1])
    slopes = _near(times, states, None, every, np.zeros(1))[1] if rates is None else rates
    lengths, chord = np.diff(times)[..., None], np.diff(states, axis=-2)
    begin, end = lengths * slopes[..., :-1, :], lengths * slopes[..., 1:, :]
    a, b = begin + end - 2 * chord, 3 * chord - 2 * begin - end
    with np.errstate(invalid="ignore", divide="ignore"):
        root = np.sqrt(b * b - 3 * a * begin)
        shares = [np.nan_to_num(begin / (-b + sign * root)).clip(0.0, 1.0) for sign in (-1.0, 1.0)]
    values = [states]
    for share in shares:
        turns = (share > 0) & (share < 1)
        at = np.flatnonzero(np.moveaxis(turns, -2, 0).reshape(len(every) - 1, -1).any(axis=1))
        later, turns = (share * lengths)[..., at, :], turns[..., at, :]
        value, slope, bend = _near(times, states, rates, at, later)
        inside = turns & (2 * np.abs(slope) < np.abs(bend) * lengths[..., at, :])
        values.append(value - np.where(inside, slope * slope / np.where(inside, 2 * bend, 1.0), 0.0))
    both = np.concatenate(values, axis=-2)
    return np.stack([both.min(axis=-2), both.max(axis=-2)], axis=-2)


def _near(
    times: np.ndarray, states: np.ndarray, rates: np.ndarray | None, at: np.ndarray, later: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values, slopes and second derivatives (... x k x d) of polynomials through the nearest samples, so long
    `later` than the samples `at` (k), by Newton's divided differences."""
    count = min(8 if rates is None else 4, times.shape[-1])
    nearest = np.clip(at - (count - 1) // 2, 0, times.shape[-1] - count)[:, None] + np.arange(count)
    moments, f = times[..., nearest] - times[..., at, None], states[..., nearest, :]
    unit = nonzero(np.ptp(moments, axis=-1))[..., None]
    z, x = moments / unit, later / unit
    if rates is not None:
        z, f = np.repeat(z, 2, axis=-1), np.repeat(f, 2, axis=-2)
    leading = [f[..., 0, :]]
    for order in range(1, z.shape[-1]):
        gaps = (z[..., order:] - z[..., :-order])[..., None]
        f = np.diff(f, axis=-2) / np.where(gaps > 0, gaps, 1.0)
        if rates is not None and order == 1:
            f[..., ::2, :] = rates[..., nearest, :] * unit[..., None]
        leading.append(f[..., 0, :])
    value = slope = bend = np.zeros_like(states[..., at, :])
    for k in reversed(range(len(leading))):
        away = x - z[..., k, None]
        bend, slope, value = bend * away + 2 * slope, slope * away + value, value * away + leading[k]
    return value, slope / unit, bend / unit**2
