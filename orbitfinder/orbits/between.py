"""What the steps of a certifying integration say beyond its end: early returns, and what lies between two steps."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import gcd

import numpy as np

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.dop853 import Trace, integrate

Rates = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Times (k) and states (k x d) -> their rates"""
WITHIN = 4
"""Looks at the cubic between two steps for the nearest return"""
NEARBY, SAME, POLISHED = 1e-2, 1e-5, 6
"""Extents within which a return is polished, and within which the whole motion is compared with itself; steps of the
polish"""
AGAIN = 1e-9
"""Share of the period within which a return is where it began"""
ALONG = 64
"""Moments at which a motion is compared with itself a return later"""
LOOKS, ONE_BY_ONE, MOST_LOOKS, USUAL = 40, 2, 2**16, 16
"""Looks for each step of the integration, where rates come one by one, and at most; of a state of more numbers than
so many as many fewer, which take as long, but never fewer than the second"""
SUSPECT = 1e-6
"""Rates this far off the smooth curve through four steps, relative to the largest, have their steps taken again"""
RETAKEN, FINER = 16, 4
"""Steps that are taken again at most, and steps of the integrator between two looks there"""
TOGETHER = 30
"""Steps whose looks are computed at once"""
CLOSER, BEYOND = 513, 1e-9
"""Looks at a guard where it is not on its curve, and by what share of its largest height it is beyond 0"""


def early_return(trace: Trace, turned: np.ndarray, also: Callable[[float], float] | None) -> tuple[float, float | None]:
    """How near a closed motion is to itself a time t < T later, in extents, and that time (None: it does not return).

    t is where |x(b + t) - x(b) - t drift / T| has a minimum, b the moment of its fastest motion; where whole turns
    `turned` (n) are left, a prime part of T that divides them all. `also(t)` is asked where the motion is the same.
    """
    period, turns = float(trace.moments[-1]), gcd(*(abs(int(k)) for k in np.rint(turned)))
    if turns:
        lags = period / np.array(primes(turns), float)
        far = np.zeros(lags.size)
    else:
        lags, far = _returns(trace)
    for k in np.flatnonzero(far <= SAME):
        moments = np.linspace(0.0, period, ALONG, endpoint=False)
        over = moments + lags[k] >= period
        there = trace.at(np.where(over, moments + lags[k] - period, moments + lags[k])) + over[:, None] * trace.drift
        apart = float(np.abs(there - trace.at(moments) - lags[k] / period * trace.drift).max())
        far[k] = max(far[k], apart, also(lags[k]) if also else 0.0)
    if not far.size:
        return float(np.ptp(trace.states - trace.moments[:, None] / period * trace.drift, axis=0).max()), None
    return float(far.min()), float(lags[far <= max(far.min(), 0.1 * SAME)].min())


def primes(number: int) -> list[int]:
    """The prime factors of a positive number, each once."""
    found, k = [], 2
    while k * k <= number:
        if number % k == 0:
            found.append(k)
            while number % k == 0:
                number //= k
        k += 1
    return [*found, number] if number > 1 else found


def _returns(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Times (k) after which a motion is nearest to where it was fastest, and how near (k); below 1e-2 polished."""
    times, y, period = trace.moments, trace.states, float(trace.moments[-1])
    rates = trace.rates(times, y)
    begin = int(np.abs(rates - trace.drift / period).max(axis=1).argmax())
    span, s = np.diff(times)[:, None, None], (np.arange(WITHIN) / WITHIN)[None, :, None]
    gap, left, right = (y[1:] - y[:-1])[:, None], span * rates[:-1, None], span * rates[1:, None]
    curve = y[:-1, None] + s * (left + s * (3 * gap - 2 * left - right + s * (left + right - 2 * gap)))
    curve = np.roll(curve.reshape(-1, y.shape[1]), -begin * WITHIN, axis=0)
    lags = np.roll((times[:-1, None] + span[:, :, 0] * s[:, :, 0]).ravel(), -begin * WITHIN) - times[begin]
    off = curve - y[begin] - lags[:, None] / period * trace.drift
    far, pace = np.linalg.norm(off, axis=1), np.linalg.norm(np.diff(off, axis=0), axis=1)
    k = np.flatnonzero((far[1:-1] < far[:-2]) & (far[1:-1] <= far[2:])) + 1
    near = far[k] <= 2 * NEARBY + np.maximum(pace[k - 1], pace[k])
    others, k = k[~near], k[near]
    room = np.maximum(np.abs(lags[k] - lags[k - 1]), np.abs(lags[(k + 1) % lags.size] - lags[k])) % period
    first = lag = lags[k]
    for _ in range(POLISHED if k.size else 0):
        moments = (times[begin] + lag) % period
        there = trace.at(moments)
        rate = trace.rates(moments, there) - trace.drift / period
        away = there - y[begin] - (moments - times[begin])[:, None] / period * trace.drift
        step = (away * rate).sum(axis=1) / nonzero((rate * rate).sum(axis=1))
        lag = np.clip(lag - step, first - room, first + room)
    polished = np.abs(away).max(axis=1) if k.size else np.zeros(0)
    lag = lag % period
    own = (lag > AGAIN * period) & (lag < (1 - AGAIN) * period)  # a motion that does not close has minima at its seam
    return np.append(lag[own], lags[others] % period), np.append(polished[own], np.abs(off[others]).max(axis=1))


def overlooked(
    traces: Iterable[Trace], looks: int = LOOKS, size: int | None = None, apart: float = 0.0
) -> tuple[float, float, int]:  # fmt: skip
    """What features of the rates that are narrower than a step change, in extents; the widest gap between two looks, in
    extents and periods, and their number.

    Rates are looked at, at equal distances along the motion (of its first `size` numbers, so far `apart` or so many
    `looks` for each step) from a seeded start, and compared with those of the curve through the values and rates of
    four steps. Where they differ, the step is taken again by far shorter ones.
    """
    suspects, widest, count = list[tuple[float, Trace, int, float, float, float]](), 0.0, 0
    for trace in traces:
        times, y = trace.moments, trace.states
        if len(times) < 4:
            continue
        moments, step, width = _looks(trace, looks, size, apart)
        slopes = trace.rates(times, y)
        off = trace.strayed(slopes, step, moments)
        if off is None:
            between, rates = curve(times, y, slopes, step, moments)
            with np.errstate(all="ignore"):
                off = np.abs(trace.rates(moments, between) - rates).max(axis=1)
            off = np.where(np.isfinite(off), off, np.inf)
        suspect = off > SUSPECT * max(float(np.abs(slopes).max()), 1.0 / float(times[-1]))
        for k in np.unique(step[suspect]).tolist():
            own, near = moments[suspect & (step == k)], float(np.diff(moments[step == k], append=times[k + 1]).max())
            worst = float(off[suspect & (step == k)].max())
            suspects.append((worst, trace, k, max(own[0] - near, times[k]), min(own[-1] + near, times[k + 1]), near))
        widest, count = max(widest, width), count + moments.size
    suspects.sort(key=lambda each: -each[0])
    own = (_retaken(trace, k, begin, end, near / FINER) for _, trace, k, begin, end, near in suspects[:RETAKEN])
    changed = sum(own, 0.0)
    return changed, widest if count else 1.0, count


def unresolved(motion: Trace, varied: Sequence[Trace]) -> tuple[float, float, int]:
    """The same of a motion and of one of its variations, whose rates take as long as those of all."""
    changed, width, count = overlooked([motion])
    if not varied:
        return changed, width, count
    size = varied[0].states.shape[1] // 2
    beside = overlooked(varied, ONE_BY_ONE, size, width * max(1.0, size**2 / USUAL))
    return changed + beside[0], max(width, beside[1]), count + beside[2]


def _looks(
    trace: Trace, looks: int, size: int | None = None, apart: float = 0.0
) -> tuple[np.ndarray, np.ndarray, float]:  # fmt: skip
    """Moments (m) at equal distances along a motion, the steps in which they lie, and that distance."""
    times, period = trace.moments, float(trace.moments[-1])
    each = np.maximum(np.abs(np.diff(trace.states[:, :size], axis=0)).max(axis=1), np.diff(times) / period)
    way = np.append(0.0, np.cumsum(each))
    most = max(MOST_LOOKS * USUAL // max(USUAL, trace.states.shape[1]), ONE_BY_ONE * len(times))
    wanted = max(looks * len(times), int(np.ceil(way[-1] / apart)) if apart else 0)
    count = min(wanted if trace.together else ONE_BY_ONE * len(times), most, MOST_LOOKS)
    places = (np.arange(count) + np.random.default_rng(0).uniform()) * (way[-1] / count)
    step = np.minimum(np.searchsorted(way, places, side="right") - 1, len(each) - 1)
    return times[step] + (places - way[step]) / each[step] * (times[step + 1] - times[step]), step, way[-1] / count


def risen(
    trace: Trace,
    height: Callable[[np.ndarray], np.ndarray],
    climb: Callable[[np.ndarray], np.ndarray],
    looks: int,
) -> np.ndarray:
    """States (k x n) beyond a guard whose height (m, of states m x n) rises through 0 on the way, for however short;
    `climb` is the rate of the height.

    Looked for as what `overlooked` looks for, closer where the height is not on its curve through four steps.
    """
    times, y = trace.moments, trace.states
    if len(times) < 4:
        return y[:0]
    moments, step, _ = _looks(trace, looks)
    slopes, nodes = trace.rates(times, y), height(y)
    known, size = curve(times, nodes[:, None], climb(y)[:, None], step, moments)[0][:, 0], np.abs(nodes).max()
    off = np.abs(height(curve(times, y, slopes, step, moments)[0]) - known)
    worst = np.argsort(-off)[:RETAKEN]
    near = np.gradient(moments)[worst]
    closer = [np.linspace(m - w, m + w, CLOSER) for m, w in zip(moments[worst], near, strict=True)]
    closer = [one for one, far in zip(closer, off[worst], strict=True) if far > SUSPECT * size]
    moments = np.unique(np.clip(np.concatenate([moments, *closer]), 0.0, times[-1]))
    step = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 2)
    states = curve(times, y, slopes, step, moments)[0]
    above = height(states)
    return np.asarray(states[1:][(above[:-1] < 0) & (above[1:] > BEYOND * size)])


def _retaken(trace: Trace, k: int, begin: float, end: float, longest: float) -> float:
    """How far the end of step k moves, in extents or what is larger of the states' own sizes, to which steps are taken,
    when short ones are from `begin` to `end`."""
    if trace.retaken is not None:
        return trace.retaken(np.linspace(begin, end, int(np.ceil((end - begin) / longest)) + 1))
    edges = [(trace.moments[k], begin, np.inf), (begin, end, longest), (end, trace.moments[k + 1], np.inf)]
    now = trace.states[k]
    for low, high, most in edges:
        if high - low > 4 * np.spacing(high):
            try:
                now = integrate(lambda t, x: trace.rates(np.array([t]), x[None])[0], now, np.array([low, high]),
                                longest_step=most)[-1]  # fmt: skip
            except IntegrationError:
                return np.inf
    there = trace.states[k + 1]
    return float((np.abs(now - there) / np.maximum(1.0, np.abs(there))).max())


def curve(
    times: np.ndarray, values: np.ndarray, slopes: np.ndarray, step: np.ndarray, moments: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes (m x d) at increasing moments (m), each within a `step`, of the polynomials of degree seven
    through the values and slopes (k x d) at the four times about it."""
    looked, step = np.unique(step, return_inverse=True)  # of a stiff motion few steps are
    first = np.clip(looked - 1, 0, len(times) - 4)[:, None] + np.repeat(np.arange(4), 2)
    z, table, found = times[first], values[first], [values[first[:, 0]]]
    for order in range(1, 8):
        gap = (z[:, order:] - z[:, :-order])[:, :, None]
        known = slopes[first[:, 1:]] if order == 1 else 0.0
        table = np.where(gap > 0, np.diff(table, axis=1) / np.where(gap > 0, gap, 1.0), known)
        found.append(table[:, 0])
    counts, found = np.bincount(step, minlength=len(first)), [one.T.copy() for one in found]
    begins, states = np.append(0, np.cumsum(counts)), np.empty((2, values.shape[1], len(moments)))
    for low in range(0, len(first), TOGETHER):  # as much as stays in the cache
        part = slice(low, low + TOGETHER)
        own = slice(begins[low], begins[min(low + TOGETHER, len(first))])
        value, *lower = (np.repeat(one[:, part], counts[part], axis=1) for one in reversed(found))
        slope = np.zeros_like(value)
        for order, one in zip(range(6, -1, -1), lower, strict=True):  # rows of all moments: long loops
            ahead = moments[own] - np.repeat(z[part, order], counts[part])
            slope *= ahead
            slope += value
            value *= ahead
            value += one
        states[:, :, own] = value, slope
    return states[0].T, states[1].T
