"""Guesses of driven motions: the periodic response of the linearised equations."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError
from orbitfinder.integrate.equations import driven_rest
from orbitfinder.loops.problem import Guess
from orbitfinder.mechanics.model import Model

SAMPLES, LEAST = 128, 1e-12
"""Equal times over a period; share of the drive's largest harmonic below which others are round-off"""


def linear_response(model: Model) -> Guess:
    """Guess of a driven motion: the periodic solution of x' = f(t, 0) + (df/dx)(0, 0) x.

    Each harmonic of the drive is answered by (i k omega - df/dx)^-1 times it. The period is the drive's. Raises
    `InputError` for a system that is not driven, and where nothing damps what the drive is in resonance with.
    """
    if model.forcing_period is None:
        raise InputError("guess.linear: this system is not driven; give mode and amplitude, or state and period")
    period = model.driving_period
    times = period * np.linspace(0.0, 1.0, SAMPLES + 1)
    drive, slopes = driven_rest(model, times[:-1])
    drive = np.fft.rfft(drive, axis=0)
    sizes, one = np.abs(drive).max(axis=1), sparse.identity(drive.shape[1], format="csc")
    answer = np.zeros_like(drive)
    for k in np.flatnonzero(sizes > LEAST * nonzero(sizes.max(initial=0.0))):
        try:
            answer[k] = splu(2j * np.pi / period * k * one - slopes).solve(drive[k])
        except RuntimeError:
            raise InputError(
                f"guess.linear: harmonic {k} of the drive is in resonance and nothing damps it; give another frequency"
            ) from None
    states = np.fft.irfft(answer, SAMPLES, axis=0)
    states = np.vstack([states, states[:1]])
    return Guess(states[0], period, times, states)
