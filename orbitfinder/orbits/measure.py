"""From the solver's nodes to an Orbit: the whole period, its multipliers, action and symmetry."""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from orbitfinder._runtime import __version__
from orbitfinder.integrate.cvodes import Flow, transition
from orbitfinder.integrate.equations import accelerations, action_rate, invariant_gradients, with_action
from orbitfinder.integrate.march import March, Marches, rounded, uniform
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.polish import end_of, graded_end, least_steps, segment, tail_of
from orbitfinder.loops.problem import Problem, boundary_constants
from orbitfinder.loops.symmetry import recognise, symplectic, turned
from orbitfinder.mechanics.constrained import tangent_space
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import energy as total_energy
from orbitfinder.orbits.closure import gap, shift, shift_along
from orbitfinder.orbits.floquet import Floquet, analyse, generated, reduce_monodromy
from orbitfinder.records.orbit import Orbit

SAMPLES = 256
"""Steps over a period at least, for the loop, its action and its minimal period."""
RESOLVED = 1e-6
"""Relative difference that every other sample may make to the action: with all of them it is then some 1e-12"""


def whole_period(
    problem: Problem, flow: Flow, march: March | Marches, w: Unknowns, samples: int = SAMPLES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of one period from those of w; equal times over it and the states there, to round-off.

    `march` is that of the equations without symmetry, `samples` how many states there are at least.
    """
    nodes = full_period(problem, flow, w.nodes, w.period)
    steps = max(w.steps, rounded(samples / len(nodes)))
    states = march.states(nodes, uniform(1.0, len(nodes), steps), _untouched(march, w))
    states[::steps] = [*nodes, states[-1]]  # the node, not the end of the segment before it
    states[-1] = nodes[0] + shift(shift_of(problem, nodes[0], states[-1])[1], nodes.shape[1])
    return nodes, np.linspace(0.0, w.period, len(states)), states


def marched(
    problem: Problem,
    march: March | Marches,
    w: Unknowns,
    whole: tuple[np.ndarray, np.ndarray, np.ndarray],
    action: float,
) -> Orbit:
    """The Orbit (without certificate) of what `whole_period` found, by the march that found it."""
    nodes, times, states = whole
    mesh, tail, monodromy = times / times[-1], _untouched(march, w), np.eye(len(nodes[0]))
    for matrix in march.varied(nodes, mesh, tail).transitions:
        monodromy = matrix @ monodromy
    end = march.ends(nodes[:1], mesh, tail)[0]
    floquet = reduced(problem.model, nodes[0], monodromy)
    return recorded(problem, w.period, end, nodes, times, states, w.unfolding, action, floquet)


def _untouched(march: March | Marches, w: Unknowns) -> np.ndarray:
    """The parameters (T, s, free) of a flow without unfolding."""
    return np.concatenate([[w.period], np.zeros(march.unfolding), w.free])


def measure(problem: Problem, flow: Flow, nodes: np.ndarray, period: float, unfolding: np.ndarray) -> Orbit:
    """An Orbit (without certificate) from converged node states over the problem's horizon."""
    model = problem.model
    whole = full_period(problem, flow, nodes, period)
    times, states = dense(flow, whole, period)
    end = end_of(flow, whole[0], (0.0, period), tail_of(flow), least_steps(1))
    return recorded(
        problem, period, end, whole, times, states, unfolding,
        loop_action(model, flow, whole, times, states), multipliers(model, flow, whole, period),
    )  # fmt: skip


def recorded(
    problem: Problem,
    period: float,
    end: np.ndarray,
    nodes: np.ndarray,
    times: np.ndarray,
    samples: np.ndarray,
    unfolding: np.ndarray,
    action: float,
    floquet: Floquet,
) -> Orbit:
    """The Orbit (without certificate) that begins at the first of its nodes and is at `end` after a period."""
    shift, turns = shift_of(problem, nodes[0], end)
    return Orbit(
        name=problem.name,
        title=problem.title,
        source=problem.source,
        system=problem.model.system,
        state=nodes[0],
        period=period,
        energy=total_energy(problem.model, nodes[0]),
        action=action,
        closure=gap(nodes[0], end, turns),
        symmetry=recognise(times, samples, problem.model),
        winding=tuple(int(k) for k in problem.turns),
        floquet_multipliers=floquet.multipliers,
        pair_defect=floquet.pair_defect,
        stability=floquet.stability,
        unfolding=tuple(float(s) for s in unfolding),
        nodes=nodes,
        times=times,
        samples=samples,
        tolerance=problem.tolerance,
        expected=problem.expected,
        shift=shift,
    )


def shift_of(problem: Problem, start: np.ndarray, end: np.ndarray) -> tuple[dict[str, float], np.ndarray]:
    """How far a relative orbit from `start` to `end` (2n each, a period apart) shifts, and its turns with that (n)."""
    found = shift_along(problem.model, problem.relative, start, end, problem.turns)
    return found, turned(problem.model, problem.turns, found)


def provenance(problem: Problem, settings: SolveSettings, began: float) -> dict[str, Any]:
    """Versions, tolerances, wall time and guess: enough to repeat the search."""
    return {
        "orbitfinder": __version__,
        **{name: version(name) for name in ("casadi", "numpy", "scipy")},
        "python": platform.python_version(),
        "relative_tolerance": settings.integrator.relative_tolerance,
        "absolute_tolerance": settings.integrator.absolute_tolerance,
        "ipopt_tolerance": settings.ipopt_tolerance,
        "guess": {"state": [float(x) for x in problem.guess.state], "period": float(problem.guess.period)},
        "pin": {one.name: one.value for one in problem.pin},
        "invariants": [one.name for one in problem.model.invariants],
        "wall_time": round(time.perf_counter() - began, 3),
    }


def full_period(problem: Problem, flow: Flow, nodes: np.ndarray, period: float) -> np.ndarray:
    """Nodes at equal times over the whole period from those over the symmetric part of it."""
    symmetry, end = problem.boundary, None
    if not symmetry.maps:
        return nodes
    if symmetry.reverses:
        horizon = symmetry.fraction * period
        end = segment(flow, nodes[-1], (horizon - horizon / len(nodes), horizon), tail_of(flow))[-1]
    constant = boundary_constants(problem, nodes, end)
    if end is None:
        matrix, moved = symmetry.displaced(constant)
        end = matrix @ nodes[0] + moved
    return symmetry.whole(np.arange(len(nodes) + 1.0), np.vstack([nodes, end]), constant)[1][:-1]


def dense(flow: Flow, nodes: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Equal times over one period and states there, each segment integrated from its node."""
    duration, least = period / len(nodes), least_steps(len(nodes))
    pieces = [
        segment(flow, node, (k * duration, (k + 1) * duration), tail_of(flow), least) for k, node in enumerate(nodes)
    ]
    count = min(len(piece) for piece in pieces) - 1  # the others have a power of two times as many
    thin = [piece[:: (len(piece) - 1) // count] for piece in pieces]
    states = np.vstack([*(piece[:-1] for piece in thin), thin[-1][-1:]])
    return np.linspace(0.0, period, len(states)), states


def multipliers(model: Model, flow: Flow, nodes: np.ndarray, period: float) -> Floquet:
    """Reduced Floquet multipliers by the product of the segments' state-transition matrices."""
    count, monodromy = len(nodes), np.eye(nodes.shape[1])
    for k, node in enumerate(nodes):
        monodromy = transition(flow, node, period / count, k * period / count)[1] @ monodromy
    return reduced(model, nodes[0], monodromy, flow.units)


def reduced(model: Model, state: np.ndarray, monodromy: np.ndarray, units: Sequence[float] = ()) -> Floquet:
    """Floquet multipliers without the trivial ones, from the monodromy at a state; `units` (2n) to measure it in."""
    gradients, directions = frame(model, state)
    if len(units):
        sizes = np.asarray(units)
        monodromy = monodromy * sizes / sizes[:, None]
        gradients, directions = gradients * sizes, directions / sizes
    if model.constraint is not None:
        basis = tangent_space(model, state)
        monodromy, gradients, directions = basis.T @ monodromy @ basis, gradients @ basis, directions @ basis
    return analyse(reduce_monodromy(monodromy, gradients, directions), conservative=symplectic(model))


def frame(model: Model, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants (k x 2n) and symmetry directions, the flow first, in (q, v)."""
    rate = accelerations(model)(0.0, state).full().ravel()
    return invariant_gradients(model)(state).full(), np.vstack(
        [*([] if model.forced else [rate]), generated(model, state)]
    )


def loop_action(model: Model, flow: Flow, nodes: np.ndarray, times: np.ndarray, states: np.ndarray) -> float:
    """The action from equal times, where half of them tell the same; else integrated on from each node (N x 2n)."""
    found = action(model, times, states)
    if abs(found - action(model, times[::2], states[::2])) <= RESOLVED * abs(found):
        return found
    field, duration = with_action(model, flow.field), times[-1] / len(nodes)
    ends = [
        graded_end(field, np.append(node, 0.0), (k * duration, (k + 1) * duration), tail_of(flow))
        for k, node in enumerate(nodes)
    ]
    return found if any(end is None for end in ends) else float(sum(end[-1] for end in ends if end is not None))


def action(model: Model, times: np.ndarray, states: np.ndarray) -> float:
    """Integral over the loop of `Model.action_rate`: of momentum.dq, of general first-order systems of |x'|^2 dt.

    The trapezoidal rule on equally spaced samples of a periodic function converges exponentially
    (L. N. Trefethen, J. A. C. Weideman, SIAM Review 56 (2014) 385-458).
    """
    rate = model.along(action_rate(model), times[None], np.asarray(states).T).ravel()
    return float(trapezoid(rate, times))
