"""Where the first equilibria come from: a state near one, a simulation to rest, or all of a box.

In a box, from one seeded start after another, the zeros of G(z) prod_k (1 + 1 / |z - z_k|^2) are looked for, z_k those
that are known (deflation). Source: P. E. Farrell, A. Birkisson, S. W. Funke, SIAM J. Sci. Comput. 37 (2015) A2026.
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.integrate import BDF

from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError, closest
from orbitfinder.families.equilibrium import Equilibrium
from orbitfinder.families.rest_problem import (
    NOISE,
    AtRest,
    Judge,
    Stacked,
    regular,
    spectrum,
    state_sizes,
    without_noise,
)
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.jets import Jets, at_rest
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.newton import Settings, equilibrium

NEAR = Settings(floor=1e-14, round_off=1e-9, converged=1e-9, most_evaluations=40, farthest=1e3)
ANYWHERE = replace(NEAR, longest=1.0, patience=12, progress=0.9)
"""Newton's whole steps near a state, and in a box, where none is longer than half its sides"""
SAME, ZERO, MOST, FARTHEST, REST = 1e-6, 1e-12, 30, 20_000, 1e-3
"""Equilibria nearer than this in sizes of a box are the same, components are 0; from a start so many are looked for.
Evaluations of rates in a simulation to rest, whose steps are as long as the motion's own times allow, and the share of
its tolerance that a last step moves it by"""


def refuse_moving(model: Model, parameter: str) -> None:
    """`InputError` for a system that cannot rest."""
    what = "depends on time" if model.forced else "jumps" if not model.smooth else ""
    if what:
        raise InputError(f"model: {what}, so that it has no equilibria; give an autonomous, smooth system, or continue "
                         "its orbits")  # fmt: skip
    if parameter not in model.parameter_names:
        known = model.parameter_names
        raise InputError(f"parameter: unknown {parameter!r}{closest(parameter, known)}; this system has "
                         f"{', '.join(known[:20]) or 'none'}")  # fmt: skip


def first_equilibrium(
    model: Model, state: np.ndarray, parameter: str, span: float | None = None
) -> tuple[AtRest, np.ndarray]:
    """The problem about the equilibrium near a state, or where a simulation from there comes to rest, and its z.

    Raises `ConvergenceError`.
    """
    for simulated in (False, True):
        start = _rested(model, state) if simulated else state
        jets = at_rest(model, (parameter,), start)
        value, ways = model.values_of([parameter]), None if span is None else np.array([span])
        problem = regular(jets, start, value, ways, state)
        problem = problem.seen(np.concatenate([state, np.zeros(jets.extra)]), value)
        z = _newton(problem, start, value)
        if z is not None:
            z = np.where(np.abs(z) <= NOISE * problem.z_sizes, 0.0, without_noise(problem, z, value))
            there = at_rest(model, (parameter,), z[: jets.size])
            jets = jets if jets.unfolded == there.unfolded else there
            problem = regular(jets, z[: jets.size], value, ways, state)
            if not z.any():  # the start alone has sizes
                problem = problem.seen(np.concatenate([state, z[jets.size :]]), value)
            return problem, z
    raise ConvergenceError("no equilibrium: Newton's method finds none near the state, and a simulation from there "
                           "does not come to rest; give a state nearer to one")  # fmt: skip


def _newton(
    problem: AtRest, state: np.ndarray, value: np.ndarray, known: Sequence[np.ndarray] = (), settings: Settings = NEAR
) -> np.ndarray | None:
    """z at rest near a state, none of those that are known; None where whole steps do not lead to it."""
    z = np.concatenate([state, np.zeros(problem.jets.extra)])

    def linearised(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        try:
            rows, slopes, _ = problem.scaled(z, value)
        except UNSOLVED:
            return np.full(z.size, np.nan), np.eye(z.size)
        slopes = slopes / problem.z_sizes
        for other in known:
            away = _apart(problem, z, other)
            size = float(away @ away)
            slopes -= np.outer(rows, 2 * away / problem.z_sizes / (size + size**2))
        return rows, slopes

    root = equilibrium(linearised, z, problem.z_sizes, settings)
    left = float(np.abs(linearised(root.w)[0]).max())  # steps are 0 where slopes are, too
    return root.w if root.converged and left <= settings.converged else None


def _apart(problem: AtRest, z: np.ndarray, other: np.ndarray) -> np.ndarray:
    """How far z is from another in sizes, of angles the short way round."""
    away, angles = z - other, np.flatnonzero(problem.jets.model.angular)
    away[angles] -= 2 * np.pi * np.round(away[angles] / (2 * np.pi))
    return np.asarray(away / problem.z_sizes)


def _rested(model: Model, state: np.ndarray) -> np.ndarray:
    """Where a motion has come to rest by steps of BDF, with 0 for what is 0 to its tolerance; the state itself where it
    cannot be integrated or becomes faster. Its steps grow without bound at rest and leave the first integrals behind
    (their Jacobian is of differences), so that they end where a step moves it by far less than the tolerance."""
    values, least = model.parameter_values, 1e-9 * state_sizes(model, np.abs(state))
    with np.errstate(all="ignore"), contextlib.suppress(ValueError, ArithmeticError):
        path = BDF(lambda _, x: model.rate(0.0, x, values).full().ravel(), 0.0, state, np.inf, rtol=1e-6, atol=least)
        while path.status == "running" and path.nfev < FARTHEST:
            path.step()
            if (np.abs(path.fun(path.t, path.y)) * path.step_size <= REST * least).all():
                break
        before, after = (np.abs(path.fun(0.0, x) / least).max() for x in (state, path.y))
        return np.where(np.abs(path.y) <= least, 0.0, path.y) if after < before else state
    return state


@one_thread()
def find_equilibria(
    model: Model, box: Mapping[str, Sequence[float]], parameter: str | None = None, starts: int = 100, seed: int = 0
) -> list[Equilibrium]:
    """Equilibria in a box of states, from seeded starts: those that were met, which proves no completeness.

    Args:
        model: the system.
        box: from where to where, of each component; of mechanics of each coordinate.
        parameter: what they are to be followed in, whose value they have; the system's first without one.
        starts: how many, drawn evenly; from each those are looked for that are not known yet.
        seed: of the starts.

    Returns:
        Those in the box, certified, in order of their components.

    Raises:
        InputError: for a system that cannot rest, and for a box that is none.

    Examples:
        >>> wells = of.ode(lambda t, x, p: [p[0] + x[0] - x[0] ** 3], ["x"], parameters={"r": 0.0})
        >>> [round(float(rest.state[0]), 12) for rest in of.find_equilibria(wells, {"x": (-2.0, 2.0)})]
        [-1.0, 0.0, 1.0]
    """
    parameter = parameter or (model.parameter_names or ("",))[0]
    refuse_moving(model, parameter)
    if starts < 1:
        raise InputError(f"starts: must be at least 1, got {starts}; take 100")
    low, high = _sides(model, box)
    centre, value = (low + high) / 2, model.values_of([parameter])
    jets = at_rest(model, (parameter,), centre) if model.rates is None else Jets(model, (parameter,))
    problem, random, judge = regular(jets, centre, value), np.random.default_rng(seed), Judge(model, (parameter,))
    sizes = problem.z_sizes.copy()
    sizes[: low.size] = np.where(high > low, (high - low) / 2, sizes[: low.size])
    problem, known, there = replace(problem, z_sizes=sizes), list[np.ndarray](), list[Equilibrium]()
    middle = np.pad(centre, (0, jets.extra))
    for start in random.uniform(low, high, (starts, low.size)):
        for tried in range(MOST):  # first as if none were known
            z = _newton(problem, start, value, known if tried else (), ANYWHERE)
            fresh = z is not None and all(np.abs(_apart(problem, z, other)).max() > SAME for other in known)
            if z is not None and fresh:
                known.append(z)
            elif tried:
                break
    for z in known:
        away = (_apart(problem, z, middle) * sizes)[: low.size]
        if (np.abs(away) <= (1 + SAME) * sizes[: low.size]).all():
            z = np.concatenate([centre + away, z[low.size :]])
            z = without_noise(problem, np.where(np.abs(z) <= ZERO * sizes, 0.0, z), value)
            own = regular(jets, z[: low.size], value)
            there.append(judge.record(own, z, value, 0.0, spectrum(own, Stacked(np.append(z, value)))))
    return sorted(there, key=lambda rest: tuple(rest.state))


def _sides(model: Model, box: Mapping[str, Sequence[float]]) -> tuple[np.ndarray, np.ndarray]:
    """The least and the largest state of a box, rates of mechanics 0; `InputError` where it is none."""
    names = model.coordinates
    for name, sides in box.items():
        if name not in names:
            raise InputError(f"box: unknown {name!r}{closest(name, names)}; this system has {', '.join(names)}")
        if len(sides) != 2 or not -np.inf < sides[0] < sides[1] < np.inf:
            raise InputError(f"box: {name} from {sides!r}; give a number and a larger one")
    if missing := [name for name in names if name not in box]:
        raise InputError(f"box: {', '.join(missing)} missing; say from where to where of each component")
    low, high = np.array([box[name] for name in names], float).T
    return np.pad(low, (0, len(model.state_names) - low.size)), np.pad(high, (0, len(model.state_names) - high.size))
