"""The motion of an orbit of a family over its whole period, and what a user watches of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.march import divided
from orbitfinder.loops.continued import Curve, Solution
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.mesh import arc_mesh, arc_states
from orbitfinder.loops.watch import numbers, unsure

SAMPLES = 512
WATCHED = 960
"""Intervals of a period in which a watched motion is known at least"""
STEP = 3e-5
"""Half of a central difference of a watched number, in the metric: its error and round-off are both some 1e-10"""
ROUGH, ROUND_OFF = 1e-9, 2e-15
"""By a motion so much off, relative, it is seen what a number makes of errors; and how large those are"""


def full_samples(curve: Curve, solution: Solution, count: int = SAMPLES) -> tuple[np.ndarray, np.ndarray]:
    """Times (s) and states at equal times over the whole period, unfolded by the formulation's symmetry."""
    p, place = curve.equations, solution.place
    if p.links:
        # at an event the state after it
        arcs = p.links.count
        ends, pieces = place.period * np.append(0.0, np.cumsum(p.links.shares(place.free))), []
        times = np.linspace(0.0, place.period, count + 1)
        for k, (begin, end) in enumerate(pairwise(ends)):
            states, mesh = arc_states(solution, arcs, k), arc_mesh(place, arcs, k)
            slopes = p.march.arcs[k].rates(states, place.tail) * place.period / arcs
            own = times[(times >= begin) & ((times < end) if k < arcs - 1 else (times <= place.period))]
            pieces.append(CubicHermiteSpline(mesh, states, slopes)((own - begin) / (end - begin)))
        return times, np.vstack(pieces)
    if march := p.gridded:
        shares, key = np.linspace(0.0, 1.0, count + 1), f"samples, {count}"
        if key not in solution.kept:  # asked for of every point and of the one after it
            solution.kept[key] = march.sampled(place.nodes, place.mesh, place.tail, shares)
        return shares * place.period, solution.kept[key].copy()
    times = np.linspace(0.0, place.period, count + 1)
    return times, whole_motion(curve, solution, count)(times)


def whole_motion(curve: Curve, solution: Solution, count: int = SAMPLES) -> CubicHermiteSpline:
    """States over the whole period (s) of a smooth orbit that is not collocated, known at so many instants at least."""
    p, place = curve.equations, solution.place
    each = -(-count // len(place.nodes))
    if each > place.steps:
        mesh = np.concatenate([[0.0], *[np.linspace(a, b, each + 1)[1:] for a, b in pairwise(place.edges)]])
        states = p.march.states(place.nodes, mesh, place.tail)
    else:  # what took so many steps is not known from fewer
        mesh, states = place.mesh, solution.march.states
    mesh, states = p.symmetry.whole(mesh, states, curve.constant)
    moments = mesh * place.period
    slopes = p.march.rates(states, place.tail, moments)
    if not np.all(np.isfinite(slopes)):
        raise IntegrationError("the motion is not finite between its nodes")
    return CubicHermiteSpline(moments, states, slopes)


def rates_along(curve: Curve, solution: Solution) -> np.ndarray:
    """dx/dt (M + 1 x d) at the mesh, kept with the orbit."""
    if "rates" not in solution.kept:
        place, march = solution.place, curve.equations.march
        solution.kept["rates"] = march.rates(solution.march.states, place.tail, place.mesh * place.period)
    rates: np.ndarray = solution.kept["rates"]
    return rates


def interpolated(mesh: np.ndarray, states: np.ndarray, slopes: np.ndarray, moments: np.ndarray) -> np.ndarray:
    """SciPy's `CubicHermiteSpline` at moments (k x d), of few in a fifth of its time."""
    lengths, chords = (mesh[1:] - mesh[:-1])[:, None], states[1:] - states[:-1]
    early, late = lengths * slopes[:-1], lengths * slopes[1:]
    before = mesh[1:-1].searchsorted(moments, side="right")
    shares = ((moments - mesh[before]) / lengths[before, 0])[:, None]
    cubics = np.stack([early + late - 2 * chords, 3 * chords - 2 * early - late, early, states[:-1]], axis=1)[before]
    return np.asarray(((cubics[:, 0] * shares + cubics[:, 1]) * shares + cubics[:, 2]) * shares + cubics[:, 3])


def watched(curve: Curve, solution: Solution) -> dict[str, float]:
    """The watched numbers of an orbit, kept with it. Raises `ConvergenceError` where one is not finite."""
    known: dict[str, float] = solution.kept.setdefault("watched", {})  # apart from what else is kept, of any name
    if not curve.watch.keys() <= known.keys():
        known.update(_read(curve, solution, numbers))
    return {name: known[name] for name in curve.watch}


def rises(curve: Curve, solution: Solution, whole: np.ndarray) -> dict[str, float]:
    """The derivatives of the watched numbers along a direction over w."""
    sides = (replace(solution, place=solution.place.moved(step * whole), kept={}) for step in (-STEP, STEP))
    before, after = (watched(curve, side) for side in sides)
    return {name: (after[name] - before[name]) / (2 * STEP) for name in curve.watch}


def noise(curve: Curve, solution: Solution) -> dict[str, float]:
    """What round-off makes of these derivatives."""
    wrong = _read(curve, solution, partial(unsure, share=ROUGH))
    return {name: ROUND_OFF / ROUGH * error / STEP for name, error in wrong.items()}


def _read(curve: Curve, solution: Solution, how: Callable[..., dict[str, float]]) -> dict[str, float]:
    """By name, of texts on the graded motion and of a user's functions at equal times."""
    place, links, read = solution.place, bool(curve.equations.links), dict[str, float]()
    for named in (True, False):
        watch = {name: number for name, number in curve.watch.items() if named == isinstance(number.entry, str)}
        if watch:
            even = None if named or links else max(WATCHED, (place.steps + 1) * len(place.nodes))
            motion = full_samples(curve, solution, even) if even else graded(curve, solution)
            read |= how(watch, *motion, parameters_at(curve, place))
    return read


def parameters_at(curve: Curve, w: Unknowns) -> dict[str, float]:
    """All physical parameters by name."""
    return curve.equations.model.named_parameters | dict(zip(curve.equations.free, map(float, w.free), strict=True))


def graded(curve: Curve, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a period as dense as its mesh, at `WATCHED` intervals at least; of a hybrid orbit events
    twice."""
    p, w = curve.equations, solution.place
    mesh = divided(w.mesh, 2 * max(2, int(np.ceil(WATCHED * p.symmetry.fraction / (2 * w.mesh.size - 2)))))
    if not p.links:
        mesh, states = p.symmetry.whole(mesh, p.march.arcs[0].sampled(w.nodes, w.mesh, w.tail, mesh), curve.constant)
        return mesh * w.period, states
    arcs, w = p.links.count, w.on(mesh)
    solution, steps = replace(solution, place=w, march=p.varied(w, states=True)), (w.mesh.size - 1) // arcs
    ends = w.period * np.append(0.0, np.cumsum(p.links.shares(w.free)))
    meshes = [w.mesh[k * steps : (k + 1) * steps + 1] for k in range(arcs)]
    shares = [(mesh - mesh[0]) / np.ptp(mesh) for mesh in meshes]
    times = np.concatenate([(1 - s) * a + s * b for s, (a, b) in zip(shares, pairwise(ends), strict=True)])
    return times, np.vstack([arc_states(solution, arcs, k) for k in range(arcs)])
