"""Frequency maps: the fundamental frequencies of many motions, in the first and in the second half of a time.

A regular motion is a sum of lines, x(t) = sum a_k e^(i w_k t), whose frequencies are whole combinations of a few: those
of its torus. They are the same in both halves; those of a chaotic motion change, and how much is its diffusion. A line
is a maximum of |integral x(t) e^(-i w t) chi(t) dt|, chi = a power of Hann's window, that of Newton's method from the
largest value of the fast Fourier transform; lines that are found are subtracted before the next is looked for.

Source: J. Laskar, "Frequency analysis for multi-dimensional systems. Global dynamics and diffusion", Physica D 67
(1993) 257-281.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.mechanics.model import Model, check_states
from orbitfinder.structures.crossings import Crossings, Plane
from orbitfinder.structures.sections import Surface

LINES = 6
"""Lines looked for in each coordinate"""
LEAST = 20
"""Turns that half of the time takes at least"""


@dataclass(frozen=True)
class FrequencyMap(Shown):
    """Frequencies of motions in two halves of a time; `diffusion` is how much they change (k).

    They are a basis: each is the strongest line that is no whole combination of those before it.

    Args:
        starts: where the motions begin (k x d).
        duration: s.
        frequencies: in the first half, rad/s (k x n); nan where a motion leaves, and where it has fewer.
        later: in the second half, rad/s (k x n).

    Examples:
        >>> moving = of.FrequencyMap(np.zeros((1, 4)), 10.0, np.array([[2.0, 5.0]]), np.array([[2.0, 5.1]]))
        >>> moving.diffusion.round(3)
        array([0.02])
    """

    __repr__ = brief("frequencies", "diffusion")

    starts: np.ndarray
    duration: float
    frequencies: np.ndarray
    later: np.ndarray

    @property
    def diffusion(self) -> np.ndarray:
        """The largest change of a frequency (k) from half to half, relative to the largest frequency."""
        change = np.where(np.isnan(self.frequencies), 0.0, np.abs(self.later - self.frequencies)).max(axis=1)
        size = np.nan_to_num(np.abs(self.frequencies)).max(axis=1)
        return np.where(size > 0, change / nonzero(size), np.nan)


@one_thread()
def frequency_map(model: Model, starts: Any, duration: float) -> FrequencyMap:
    """The fundamental frequencies of motions, in the first and in the second half of a time.

    Where they differ a motion is chaotic (J. Laskar, Physica D 67, 1993).

    Args:
        model: the system.
        starts: states (k x d), or a section's `starts`.
        duration: s; half of it should be some hundred turns.

    Returns:
        A FrequencyMap; nan where a motion leaves.

    Raises:
        InputError: for states of another length and a duration that is too short.

    Examples:
        >>> mapped = of.frequency_map(pendulum, [[0.1, 0.1, 0.0, 0.0]], 200.0)
        >>> mapped.frequencies.shape, bool(mapped.diffusion[0] < 1e-4)
        ((1, 2), True)
    """
    if not model.smooth or model.constraint is not None:
        what = "hybrid systems jump" if not model.smooth else "take the minimal model of this one"
        raise InputError(f"model: frequencies are those of smooth motions in minimal coordinates; {what}")
    begins = check_states(model, np.atleast_2d(np.asarray(starts, float)))
    if not (np.isfinite(duration) and duration > 0):
        raise InputError(f"duration: must be positive, got {duration}; give some hundred turns of a motion")
    path, step = _halves(Surface(model, Plane(0), (0, 0), {}).motions, begins, duration)
    count, n = max(1, len(model.state_names) // 2), model.degrees_of_freedom
    halves = np.full((2, len(begins), n, 2, LINES), np.nan)
    well = np.flatnonzero(np.isfinite(path).all(axis=(0, 2, 3)))
    width = max(1, 4_000_000 // (LINES * path.shape[2] * 2 * n))
    for part in np.split(well, range(width, well.size, width)) if well.size else ():
        signals = _signals(model, path[:, part])
        halves[:, part, : signals.shape[2]] = np.stack(_lines(signals, step), axis=3)
    known = (2 * np.pi / model.driving_period,) if model.forced else ()
    chosen = np.full((2, len(begins), count), np.nan)
    for k in well:
        chosen[:, k] = _basis(halves[:, k], known, count, 4 * np.pi / duration)
    slowest = np.abs(chosen[0, well, 0]).min(initial=np.inf) * 0.5 * duration / (2 * np.pi)
    if slowest < LEAST:
        raise InputError(
            f"duration: {duration:.6g} is too short, half of it is {slowest:.3g} turns of one of the motions; give at "
            f"least {LEAST / max(slowest, 1.0) * duration:.3g}"
        )
    return FrequencyMap(begins, float(duration), chosen[0], chosen[1])


def _halves(motions: Crossings, starts: np.ndarray, duration: float) -> tuple[np.ndarray, float]:
    """States (2 x k x m x d) at equal times of both halves, as many as the fastest motion asks for, and their step."""
    taken = np.zeros(len(starts))

    def counted(which: np.ndarray, *_: np.ndarray) -> None:
        taken[which] += 1

    first = duration / 16  # shows how fast motions are
    clock = Plane(-1, 0.0, 0, first)
    tried = motions.passing(clock, starts, 1, longest=2 * first, tolerance=1e-13, path=counted)
    steps = taken[tried.complete].max(initial=0.0)
    if not steps:
        raise InputError("starts: all motions leave; start where they stay, or ask for a shorter duration")
    half = int(np.ceil(0.25 * steps * 16))  # a turn takes some 30 steps
    step = 0.5 * duration / half
    path = motions.sampled(starts, step, 2 * half, tolerance=1e-13)
    return np.stack([path[:, : half + 1], path[:, half:]]), step


def _signals(model: Model, path: np.ndarray) -> np.ndarray:
    """What is analysed (2 x k x n x m) of states (2 x k x m x d): q - i q' of each coordinate (or p), both by their
    size; e^(i q) of an angle that goes round; single components where they do not come in pairs."""
    n, signals = model.degrees_of_freedom, []
    paired = model.rates is None or model.hamiltonian
    for i, j in model.planes if paired else [(i, i) for i in range(n)]:
        value, rate = (_measured(path[..., k]) for k in (i, j))
        signal = value - 1j * rate if paired else value + 0j
        if i < n and model.angular[i]:
            around = np.abs(path[..., -1, i] - path[..., 0, i]) > 4 * np.pi
            signal = np.where(around[..., None], np.exp(1j * path[..., i]), signal)
        signals.append(signal)
    return np.stack(signals, axis=2)


def _measured(values: np.ndarray) -> np.ndarray:
    """Values (... x m) without their mean, in units of their size."""
    weights = _window(values.shape[-1])
    away = values - (values @ weights)[..., None] / weights.sum()
    return np.asarray(away / nonzero(np.sqrt(away**2 @ weights / weights.sum()))[..., None])


def _window(count: int) -> np.ndarray:
    # of Hann's window: a line at m times the resolution disturbs another as m^-7
    return (1 - np.cos(2 * np.pi * np.arange(count) / (count - 1))) ** 3


def _lines(signals: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies and sizes (... x LINES) of the strongest lines of signals (... x m), one after another."""
    flat = signals.reshape(-1, signals.shape[-1])
    times = step * (np.arange(flat.shape[1]) - 0.5 * (flat.shape[1] - 1))
    weights, left = _window(times.size), flat
    values, waves = np.zeros((len(flat), 0)), np.zeros((len(flat), 0, times.size), complex)
    for _ in range(LINES):
        coarse = np.abs(np.fft.fft(left * weights, axis=1)).argmax(axis=1)
        near = 2 * np.pi * np.fft.fftfreq(times.size, step)[coarse]
        values = np.column_stack([values, _peak(left * weights, times, near)])
        waves = np.concatenate([waves, np.exp(1j * values[:, -1:] * times)[:, None]], axis=1)
        sizes, left = _fitted(flat, waves, weights)
    for k in range(LINES):  # each again, with all the others subtracted
        alone = left + sizes[:, k, None] * waves[:, k]
        values[:, k] = _peak(alone * weights, times, values[:, k])
        waves[:, k] = np.exp(1j * values[:, k, None] * times)
        sizes, left = _fitted(flat, waves, weights)
    shape = (*signals.shape[:-1], LINES)
    return values.reshape(shape), np.abs(sizes).reshape(shape)


def _fitted(flat: np.ndarray, waves: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The complex sizes of waves (b x l x m) that fit signals (b x m) best, and what is left of these."""
    weighted = waves.conj() * weights
    gram = weighted @ waves.transpose(0, 2, 1)
    gram += 1e-14 * weights.sum() * np.eye(gram.shape[1])
    sizes = np.linalg.solve(gram, weighted @ flat[:, :, None])[:, :, 0]
    return sizes, flat - (sizes[:, None] @ waves)[:, 0]


def _peak(windowed: np.ndarray, times: np.ndarray, near: np.ndarray) -> np.ndarray:
    """The frequencies (b) near given ones at which the Fourier integrals of windowed signals (b x m) are largest."""
    bound, values, span = np.pi / (times[-1] - times[0]), near.copy(), np.stack([times**0, -1j * times, -(times**2)])
    for _ in range(8):
        value, slope, bend = span @ (windowed * np.exp(-1j * values[:, None] * times)).T
        rise = np.real(slope * value.conj())
        turn = np.abs(slope) ** 2 + np.real(bend * value.conj())
        with np.errstate(all="ignore"):
            change = np.where(turn < 0, -rise / turn, bound * np.sign(rise))
        values = values + np.clip(np.nan_to_num(change), -bound, bound)
    return values


def _basis(lines: np.ndarray, known: tuple[float, ...], count: int, resolution: float) -> np.ndarray:
    """Frequencies (2 x count) in both halves by their lines (2 x n x 2 x LINES): strongest of each coordinate first."""
    (values, sizes), later = lines[0].transpose(1, 0, 2), lines[1, :, 0].ravel()
    values, sizes = values[np.isfinite(values[:, 0])], sizes[np.isfinite(values[:, 0])]
    rest = np.argsort(-sizes[:, 1:].ravel())
    order = np.concatenate([values[:, 0], values[:, 1:].ravel()[rest]])
    strong = np.concatenate([sizes[:, 0], sizes[:, 1:].ravel()[rest]]) > 1e-6 * sizes.max()  # fainter ones are none
    basis, chosen = list(known), np.full((2, count), np.nan)
    for value in order[strong]:
        k = len(basis) - len(known)
        if k == count:
            break
        whole = np.array(list(product(range(-8, 9), repeat=len(basis)))) @ np.array(basis)
        if np.abs(value - whole).min() > 0.1 * resolution:  # nearer to a combination, it is no new one
            basis.append(float(value))
            chosen[:, k] = value, later[np.nanargmin(np.abs(later - value))]
    return chosen


def frequency_table(frequencies: FrequencyMap, model: Model) -> str:
    """A frequency map as CSV: starts, frequencies in both halves (rad/s), diffusion."""
    count = frequencies.frequencies.shape[1]
    heads = [*model.state_names, *(f"w{k + 1}" for k in range(count)), *(f"w{k + 1}_later" for k in range(count))]
    rows = np.column_stack([frequencies.starts, frequencies.frequencies, frequencies.later, frequencies.diffusion])
    return "\n".join([",".join([*heads, "diffusion"]), *(",".join(map(repr, row)) for row in rows.tolist()), ""])
