"""Which symmetry an orbit has, read off its samples, and whether a model has the one that is asked for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.constrained import allowed_velocities
from orbitfinder.mechanics.model import Model

RECOGNITION = 1e-6
"""A symmetry holds when its defect is below this, relative to the motion's extent."""
MIRROR = 1e-5
"""Largest harmonic of the motion that breaks the mirror about a turning instant, relative to the largest rate."""


def recognise(times: np.ndarray, states: np.ndarray, angles: np.ndarray) -> str:
    """none | brake | reflection | brake+reflection | reversal, from states (k+1 x 2n) at equal times over T.

    Brake: at some instant all rates vanish and the motion runs back, q(t0 + t) = q(t0 - t).
    Reflection: x(t + T/2) = -x(t), angles modulo 2 pi. Reversal (running orbits, mostly): at some
    instant all coordinates are at 0 (angles at 0 or pi) and q(t0 + t) = -q(t0 - t). Source for all
    as symmetries of reversible systems: J. S. W. Lamb, J. A. G. Roberts, Physica D 112 (1998) 1-39.
    """
    names = [name for name, holds in (
        ("brake", is_brake(times, states)), ("reflection", is_reflection(states, angles))
    ) if holds]  # fmt: skip
    if not names and is_reversal(times, states, angles):
        names = ["reversal"]
    return "+".join(names) or "none"


def is_reflection(states: np.ndarray, angles: np.ndarray) -> bool:
    """x(t + T/2) = -x(t) for every sample."""
    half = (len(states) - 1) // 2
    n = states.shape[1] // 2
    total = states[half : 2 * half] + states[:half]
    total[:, :n] = np.where(angles, _wrapped(total[:, :n]), total[:, :n])
    extent = np.ptp(states, axis=0)
    scale = np.concatenate([np.full(n, extent[:n].max()), np.full(n, extent[n:].max())])
    return bool(np.all(np.abs(total) <= RECOGNITION * np.maximum(scale, 1e-300)))


def is_brake(times: np.ndarray, states: np.ndarray) -> bool:
    """Some instant at which every rate is zero and about which the motion runs back."""
    n = states.shape[1] // 2
    rates = states[:, n:]

    def defect(x: np.ndarray) -> np.ndarray:
        return np.asarray(x[:, n:])

    moments = _crossings(times, states, int(np.abs(rates).max(axis=0).argmax()) + n, 0.0)
    # the spline's rates are good to about the fourth power of the sampling interval
    allowed = 10 * RECOGNITION * float(np.abs(rates).max())
    return _mirrored(times, states, moments, defect, allowed, 1.0)


def is_reversal(times: np.ndarray, states: np.ndarray, angles: np.ndarray) -> bool:
    """Some instant at which every coordinate is 0 (angles: 0 or pi) and about which q is odd."""
    n = states.shape[1] // 2
    extent = np.ptp(states[:, :n], axis=0)

    def defect(x: np.ndarray) -> np.ndarray:
        return np.where(angles, _wrapped(2 * x[:, :n]) / 2, x[:, :n])

    leading = int(extent.argmax())
    levels = [0.0]
    if angles[leading]:
        halves = states[:, leading] / np.pi
        levels = list(np.arange(np.floor(halves.min()), halves.max() + 1) * np.pi)
    moments = [_crossings(times, states, leading, level) for level in levels]
    allowed = 10 * RECOGNITION * float(extent.max())
    return _mirrored(times, states, np.concatenate(moments), defect, allowed, -1.0)


def _wrapped(angle: np.ndarray) -> np.ndarray:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _crossings(times: np.ndarray, states: np.ndarray, component: int, level: float) -> np.ndarray:
    """Instants at which one component (its spline through the samples) is at a level, and the samples' own."""
    from scipy.interpolate import CubicHermiteSpline, PPoly

    n = states.shape[1] // 2
    spline = CubicHermiteSpline(times, states[:, component % n], states[:, n + component % n])
    chosen: PPoly = spline.derivative() if component >= n else spline
    roots = PPoly(chosen.c, chosen.x).solve(level, extrapolate=False)
    return np.concatenate([roots[np.isfinite(roots)], times])


def _mirrored(
    times: np.ndarray,
    states: np.ndarray,
    moments: np.ndarray,
    defect: Callable[[np.ndarray], np.ndarray],
    allowed: float,
    sign: float,
) -> bool:
    """True when at some moment the defect is within `allowed` and rates satisfy v(t0 + t) = -sign v(t0 - t)."""
    from scipy.interpolate import CubicHermiteSpline

    n = states.shape[1] // 2
    spline = CubicHermiteSpline(times, states[:, :n], states[:, n:])
    rates = spline.derivative()
    there = np.hstack([spline(moments), rates(moments)])
    defects = np.abs(defect(there)).max(axis=1)
    if not defects.size or defects.min() > allowed:
        return False
    centre = moments[int(defects.argmin())]
    # v odd (even) about the centre: Fourier coefficients there are imaginary (real); exact for periodic samples
    harmonics = np.fft.rfft(states[:-1, n:], axis=0) * (2.0 / (len(states) - 1))
    phases = np.exp(2j * np.pi * np.arange(len(harmonics)) * centre / times[-1])[:, None]
    broken = (harmonics * phases).real if sign > 0 else (harmonics * phases).imag
    return bool(np.abs(broken).max() <= MIRROR * np.abs(states[:, n:]).max())


def time_dependent(model: Model) -> bool:
    """True when the accelerations contain time explicitly."""
    return bool(model.acceleration.jac_sparsity(0, 0).nnz())


def check_symmetry(model: Model, state: np.ndarray, symmetry: str, cycles: int = 0) -> None:
    """`InputError` when the equations lack a symmetry that is asked for, tried at states around one (2n).

    Brake needs a(-t, q, -v) = a(t, q, v); reflection needs a(t + T/2, -q, -v) = -a(t, q, v), where
    T is `cycles` periods of the forcing; reversal needs a(-t, -q, v) = -a(t, q, v).
    """
    if model.constraint is not None and symmetry not in ("none", "brake"):
        raise InputError(
            f"symmetry: {symmetry!r} cannot be imposed in redundant coordinates, where x -> -x moves the joints; "
            "use symmetry = 'brake' or 'none' (symmetric orbits are recognised)"
        )
    half = 0.0
    if model.forcing_period is not None:
        half = cycles * float(model.forcing_period(model.parameter_values)) / 2
    film = "running the film backwards"
    for name, places, rates, shift, meaning in (
        ("brake", 1, -1, 0.0, film),
        ("reflection", -1, -1, half, "x -> -x"),
        ("reversal", -1, 1, 0.0, f"{film} in a mirror"),
    ):
        if name in symmetry and _broken(model, state, (places, rates, shift)):
            raise InputError(
                f"symmetry: this system's equations change under {meaning}, so {symmetry!r} cannot be imposed; "
                "use symmetry = 'none' (symmetric orbits are recognised)"
            )


def _broken(model: Model, state: np.ndarray, signs: tuple[int, int, float]) -> bool:
    places, rates, shift = signs
    random = np.random.default_rng(0)
    q, v = np.split(np.asarray(state, float), 2)
    direction = -1.0 if places != rates else 1.0
    for _ in range(4):
        place, rate = q + random.normal(0, 0.3, q.size), v + random.normal(0, 0.3 + np.abs(v).max(), v.size)
        if model.constraint is not None:  # off the constraints the stabilisation is damped
            basis = allowed_velocities(model, q)
            place, rate = q, basis @ (basis.T @ rate)
        t = float(random.uniform(0, 1 + 2 * shift))
        here = places * model.acceleration(t, place, rate, model.parameter_values).full()
        there = model.acceleration(direction * t + shift, places * place, rates * rate, model.parameter_values).full()
        if np.all(np.isfinite(here - there)) and np.abs(there - here).max() > 1e-8 * max(1.0, np.abs(here).max()):
            return True
    return False
