"""Which symmetry an orbit has, read off its samples."""

from __future__ import annotations

import numpy as np

RECOGNITION = 1e-6
"""A symmetry holds when its defect is below this, relative to the motion's extent."""


def recognise(times: np.ndarray, states: np.ndarray, angles: np.ndarray) -> str:
    """none | brake | reflection | brake+reflection, from states (k+1 x 2n) at equal times over T.

    Brake: all rates vanish together at some instant (twice a period, by time reversal).
    Reflection: x(t + T/2) = -x(t), angles modulo 2 pi. Source for both as symmetries of
    reversible systems: J. S. W. Lamb, J. A. G. Roberts, Physica D 112 (1998) 1-39.
    """
    names = [name for name, holds in (
        ("brake", is_brake(times, states)), ("reflection", is_reflection(states, angles))
    ) if holds]  # fmt: skip
    return "+".join(names) or "none"


def is_reflection(states: np.ndarray, angles: np.ndarray) -> bool:
    """x(t + T/2) = -x(t) for every sample."""
    half = (len(states) - 1) // 2
    n = states.shape[1] // 2
    total = states[half : 2 * half] + states[:half]
    shifted = total[:, :n]
    total[:, :n] = np.where(angles, (shifted + np.pi) % (2 * np.pi) - np.pi, shifted)
    extent = np.ptp(states, axis=0)
    scale = np.concatenate([np.full(n, extent[:n].max()), np.full(n, extent[n:].max())])
    return bool(np.all(np.abs(total) <= RECOGNITION * np.maximum(scale, 1e-300)))


def is_brake(times: np.ndarray, states: np.ndarray) -> bool:
    """Some instant at which every rate is zero, between samples if need be."""
    from scipy.interpolate import CubicHermiteSpline, PPoly

    n = states.shape[1] // 2
    spline = CubicHermiteSpline(times, states[:, :n], states[:, n:])
    rates: PPoly = spline.derivative()
    fastest = float(np.abs(states[:, n:]).max())
    leading = int(np.abs(states[:, n:]).max(axis=0).argmax())
    zeros = PPoly(rates.c[:, :, leading], rates.x).roots(extrapolate=False)
    zeros = zeros[np.isfinite(zeros)]
    instants = np.concatenate([zeros, times])
    slowest = np.abs(rates(instants)).max(axis=1).min()
    # the spline's rates are good to about the fourth power of the sampling interval
    return bool(slowest <= 10 * RECOGNITION * fastest)
