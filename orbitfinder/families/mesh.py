"""The mesh of a family: where the Runge-Kutta steps and the shooting nodes are, moved as the orbit changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from orbitfinder.families.propagate import rates, step_errors
from orbitfinder.families.system import Aim, Curve, Place, Solution, correct

STEP_ERROR = 3e-14
"""Estimated relative error of a Runge-Kutta step on a fresh mesh; the true one is some 100 times smaller."""
COARSE = 200.0
"""A mesh is kept until some step's estimate is this many times as large."""
GROWTH = 30.0
"""Segments are added until each one's state-transition matrix is below this."""
MOST_SEGMENTS = 60


def needs_mesh(curve: Curve, found: Solution) -> bool:
    """Whether the mesh is too coarse, or a segment too unstable, for what is asked of a point."""
    errors = step_errors(curve.propagator, found.march.states, found.place.mesh, found.place.tail)
    growths = _growths(curve, found)
    wanted = _steps_wanted(errors)
    return bool(errors.max() > COARSE * STEP_ERROR or growths.max() > 4 * GROWTH or wanted < 0.5 * errors.size)


def _growths(curve: Curve, found: Solution) -> np.ndarray:
    size = curve.propagator.size
    clock = np.sqrt(curve.weights[:size])
    return np.array([
        np.linalg.norm(block[:, :size] * clock[:, None] / clock[None, :], 2) for block in found.march.sensitivities
    ])  # fmt: skip


def _steps_wanted(errors: np.ndarray) -> float:
    return float(np.sum((errors / STEP_ERROR) ** 0.125))


def remeshed(curve: Curve, found: Solution) -> Place:
    """The place on a mesh that spreads the error estimate evenly, with as many segments as the growth asks for.

    The estimate goes with the eighth power of the step, so (error / allowed)^(1/8) is the number of
    steps that each present step should become. Nodes are interpolated and must be corrected again.
    """
    place, states = found.place, found.march.states
    errors = step_errors(curve.propagator, states, place.mesh, place.tail)
    density = np.maximum((errors / STEP_ERROR) ** 0.125, 0.15)
    growth = float(np.log(np.maximum(_growths(curve, found), 1.5)).sum())
    count = int(np.clip(np.ceil(growth / np.log(GROWTH)), 1, MOST_SEGMENTS))
    each = int(np.ceil(1.1 * density.sum() / count)) + 2
    each += -each % 4  # few distinct sizes, so that compiled marches are used again
    work = np.concatenate([[0.0], np.cumsum(density)])
    mesh = np.interp(np.linspace(0.0, work[-1], count * each + 1), work, place.mesh)
    slopes = rates(curve.propagator, states, place.tail) * place.period
    nodes = CubicHermiteSpline(place.mesh, states, slopes)(mesh[:-1:each])
    return replace(place, nodes=np.vstack([place.nodes[:1], nodes[1:]]), mesh=mesh)


def settled(curve: Curve, found: Solution, normal: np.ndarray) -> Solution:
    """The same orbit on a fitting mesh, held in the hyperplane through it with this normal."""
    for _ in range(4):
        if not needs_mesh(curve, found):
            break
        aim = Aim(float(normal @ found.place.head), normal)
        found = correct(curve, remeshed(curve, found), aim, found.place)
    return found
