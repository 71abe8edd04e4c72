"""Configurations and velocities of a linkage from a part of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.constrained import RANK_TOLERANCE, ConstrainedModel
from orbitfinder.mechanics.linkage import (
    REACH_TOLERANCE,
    check_regular,
    closure_jacobian,
    dimensions,
)

NEWTON_STEPS = 50
CLOSURE_TOLERANCE = 1e-13
"""|closure| over the perimeter at which an assembly counts as exact"""


def assemble(
    model: ConstrainedModel,
    known: Mapping[str, float],
    branch: int | None = None,
    guess: Sequence[float] | np.ndarray | None = None,
) -> np.ndarray:
    """All angles (n, rad) of a linkage from some, e.g. `assemble(fourbar, {"theta1": 0.3}, branch=+1)`.

    Closure: sum l_i (cos theta_i, sin theta_i) = ground. With n - 2 known angles the two others
    follow from the intersection of two circles, and `branch` is the sign of sin(theta_j - theta_i),
    i < j the unknown bars (default +1, or the one nearer to `guess`). With fewer, the nearest
    configuration to `guess` (n, rad) is found by Gauss-Newton. Raises `InputError` when the rest
    cannot reach, or at a change-point.
    """
    lengths, ground = dimensions(model)
    fixed = _by_index(known, "theta", lengths.size)
    if len(fixed) > lengths.size - 2:
        raise InputError(
            f"assemble: {len(fixed)} angles given, but {lengths.size} bars have {lengths.size - 2} degrees of freedom; "
            f"give at most {lengths.size - 2}"
        )
    start = None if guess is None else np.asarray(guess, float)
    if start is not None and (start.shape != (lengths.size,) or not np.all(np.isfinite(start))):
        raise InputError(f"guess: need {lengths.size} finite angles in rad, got {guess!r}")
    if branch is not None and branch not in (1, -1):
        raise InputError(f"branch: must be +1 or -1, the sign of sin(theta_j - theta_i), got {branch!r}")
    if len(fixed) == lengths.size - 2:
        theta = _dyad(lengths, ground, fixed, branch, start)
    elif start is None:
        raise InputError(
            f"assemble: {len(fixed)} angles given for {lengths.size - 2} degrees of freedom; give more, or guess="
        )
    else:
        theta = _nearest(lengths, ground, fixed, start)
    check_regular(lengths, theta)
    return theta


def linkage_rates(model: ConstrainedModel, theta: np.ndarray, known: Mapping[str, float]) -> np.ndarray:
    """All rates (n, rad/s) from n - 2 of them, e.g. `{"theta1dot": 2.0}`; a four-bar needs one.

    sum l_i n_i thetadot_i = 0. Raises `InputError` at a change-point, or at a dead point of the
    given bars (the two others in line), where another bar's rate must be given.
    """
    lengths, _ = dimensions(model)
    angles = np.asarray(theta, float)
    given = _by_index(known, "theta", lengths.size, "dot")
    if len(given) != lengths.size - 2:
        raise InputError(
            f"linkage_rates: {len(given)} rates given for {lengths.size - 2} degrees of freedom; give exactly that many"
        )
    check_regular(lengths, angles)
    jacobian = closure_jacobian(lengths, angles)
    rest = [i for i in range(lengths.size) if i not in given]
    values = np.linalg.svd(jacobian[:, rest], compute_uv=False)
    if values[-1] < RANK_TOLERANCE * values[0]:
        raise InputError(
            f"linkage_rates: dead point, bars {rest[0] + 1} and {rest[1] + 1} are in line, so the rates of the others "
            f"do not determine theirs; give theta{rest[0] + 1}dot or theta{rest[1] + 1}dot instead"
        )
    rates = np.zeros(lengths.size)
    for i, rate in given.items():
        rates[i] = rate
    rates[rest] = np.linalg.solve(jacobian[:, rest], -jacobian @ rates)
    return rates


def _by_index(known: Mapping[str, float], stem: str, count: int, suffix: str = "") -> dict[int, float]:
    names = {f"{stem}{i + 1}{suffix}": i for i in range(count)}
    for name, value in known.items():
        if name not in names:
            raise InputError(f"{name}: unknown; this linkage has {', '.join(names)}")
        if not np.isfinite(value):
            raise InputError(f"{name}: must be finite, got {value!r}")
    return {names[name]: float(value) for name, value in known.items()}


def _dyad(
    lengths: np.ndarray, ground: np.ndarray, fixed: Mapping[int, float], branch: int | None, guess: np.ndarray | None
) -> np.ndarray:
    """The last two bars i < j as two sides of a triangle whose third side is the gap left by the others.

    gap = l_i e_i + l_j e_j, so the angle at i is arccos((D^2 + l_i^2 - l_j^2) / (2 D l_i)).
    """
    theta = np.zeros(lengths.size)
    gap = np.array(ground)
    for k, angle in fixed.items():
        theta[k] = angle
        gap -= lengths[k] * np.array([np.cos(angle), np.sin(angle)])
    i, j = (k for k in range(lengths.size) if k not in fixed)
    distance = float(np.hypot(*gap))
    _check_reach(lengths, fixed, (i, j), distance)
    heading = np.arctan2(gap[1], gap[0])
    cosine = (distance**2 + lengths[i] ** 2 - lengths[j] ** 2) / (2 * distance * lengths[i])
    opening = np.arccos(np.clip(cosine, -1.0, 1.0))
    solutions = {}
    for sign in (1, -1):
        solution = theta.copy()
        solution[i] = heading - sign * opening
        elbow = gap - lengths[i] * np.array([np.cos(solution[i]), np.sin(solution[i])])
        solution[j] = np.arctan2(elbow[1], elbow[0])
        solutions[sign] = solution if guess is None else _wound(solution, guess, (i, j))
    if branch is not None or guess is None:
        return solutions[branch or 1]
    return min(solutions.values(), key=lambda solution: float(np.linalg.norm(solution - guess)))


def _wound(theta: np.ndarray, guess: np.ndarray, which: tuple[int, int]) -> np.ndarray:
    """The two computed angles moved by whole turns to within pi of the guess's."""
    result = theta.copy()
    for k in which:
        result[k] += 2 * np.pi * np.round((guess[k] - theta[k]) / (2 * np.pi))
    return result


def _check_reach(lengths: np.ndarray, fixed: Mapping[int, float], pair: tuple[int, int], distance: float) -> None:
    """`InputError` unless |l_i - l_j| <= distance <= l_i + l_j, both with a margin for round-off."""
    i, j = pair
    longest, shortest = lengths[i] + lengths[j], abs(lengths[i] - lengths[j])
    margin = REACH_TOLERANCE * longest
    given = ", ".join(f"theta{k + 1} = {angle:.6g}" for k, angle in fixed.items()) or "no angle given"
    if shortest - margin <= distance <= longest + margin and distance > 0:
        return
    if distance > longest:
        rule = f"at most {longest:.6g} m = length{i + 1} + length{j + 1}"
    else:
        rule = f"at least {shortest:.6g} m = |length{i + 1} - length{j + 1}|"
    raise InputError(
        f"linkage: cannot be assembled at {given}: bars {i + 1} and {j + 1} would have to span {distance:.6g} m, "
        f"but they span {rule} (triangle inequality); give other angles or other lengths"
    )


def _nearest(lengths: np.ndarray, ground: np.ndarray, fixed: Mapping[int, float], guess: np.ndarray) -> np.ndarray:
    """Closure by Gauss-Newton with least-norm steps in the angles that are not fixed."""
    theta, loose = guess.copy(), [k for k in range(lengths.size) if k not in fixed]
    for k, angle in fixed.items():
        theta[k] = angle
    scale = lengths.sum()
    gap = np.inf
    for _ in range(NEWTON_STEPS):
        residual = np.array([np.cos(theta), np.sin(theta)]) @ lengths - ground
        gap = float(np.hypot(*residual))
        if gap <= CLOSURE_TOLERANCE * scale:
            return theta
        step = np.linalg.lstsq(closure_jacobian(lengths, theta)[:, loose], -residual, rcond=None)[0]
        theta[loose] += step * min(1.0, 0.5 / max(np.abs(step).max(), 1e-300))
    raise InputError(
        f"linkage: cannot be assembled near guess = {np.array2string(guess, precision=6)}: a gap of {gap:.3g} m "
        f"is left after {NEWTON_STEPS} Gauss-Newton steps; give another guess or fewer fixed angles"
    )
