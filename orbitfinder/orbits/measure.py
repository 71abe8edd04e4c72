"""From the solver's nodes to an Orbit: the whole period, its multipliers, action and symmetry."""

from __future__ import annotations

import platform
import time
from collections.abc import Sequence
from functools import lru_cache
from importlib.metadata import version
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from orbitfinder._runtime import __version__
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.cvodes import Flow, transition
from orbitfinder.integrate.equations import accelerations, action_rate, invariant_gradients, with_action
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.march import EFFORT, March, Marches, rounded, uniform
from orbitfinder.integrate.rk8 import variational_field
from orbitfinder.loops.ipopt import SolveSettings
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.polish import (
    STEPS_PER_PERIOD,
    end_of,
    graded_end,
    graded_path,
    least_steps,
    path_of,
    tail_of,
)
from orbitfinder.loops.problem import Problem, boundary_constants
from orbitfinder.loops.symmetry import recognise, symplectic, turned
from orbitfinder.mechanics.constrained import constraint_rows, tangent_basis
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import energy as total_energy
from orbitfinder.orbits.closure import gap, shift, shift_along
from orbitfinder.orbits.floquet import Floquet, analyse, generated, reduce_monodromy
from orbitfinder.records.orbit import Orbit

SAMPLES = 256
"""Steps over a period at least, for the loop, its action and its minimal period."""
RESOLVED = 1e-11
"""Relative error of an action by how far it has come with every other and with every fourth sample"""
GRADED = 3
"""Doublings of the fewest steps at which a motion is sampled that no number of equal steps follows"""
STEEP = 1e3
"""Growth of errors in a segment beyond which CVODES' matrix of it has lost the digits that a certificate compares"""


Paths = Sequence[tuple[np.ndarray, bool]]


def whole_period(
    problem: Problem, flow: Flow, march: March | Marches, w: Unknowns, samples: int = SAMPLES
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes of one period from those of w; equal times over it and the states there, to round-off.

    `march` is that of the equations without symmetry, `samples` how many states there are at least.
    """
    whole = whole_unknowns(march, w, full_period(problem, flow, w.nodes, w.period), samples)
    return sampled_period(problem, whole, march.states(whole.nodes, whole.mesh, whole.tail))


def whole_unknowns(march: March | Marches, w: Unknowns, nodes: np.ndarray, samples: int = SAMPLES) -> Unknowns:
    """The unknowns of one period with these nodes, on the mesh at which `whole_period` has states."""
    mesh = uniform(1.0, len(nodes), max(w.steps, rounded(samples / len(nodes))))
    return Unknowns(nodes, w.period, np.zeros(march.unfolding), w.free, mesh)


def sampled_period(problem: Problem, w: Unknowns, states: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `whole_period` gives, of such unknowns and the states (M + 1 x d) that a march from their nodes leads to."""
    nodes = w.nodes
    states[:: w.steps] = [*nodes, states[-1]]  # the node, not the end of the segment before it
    states[-1] = nodes[0] + shift(shift_of(problem, nodes[0], states[-1])[1], nodes.shape[1])
    return nodes, np.linspace(0.0, w.period, len(states)), states


def marched(
    problem: Problem,
    march: March | Marches,
    w: Unknowns,
    whole: tuple[np.ndarray, np.ndarray, np.ndarray],
    action: float,
    units: Sequence[float] = (),
) -> Orbit:
    """The Orbit (without certificate) of what `whole_period` found, by the march that found it.

    `units` (2n) are what its multipliers are measured in, () is 1.
    """
    nodes, times, _ = whole
    mesh, tail = times / times[-1], np.concatenate([[w.period], np.zeros(march.unfolding), w.free])
    transitions, end = march.varied(nodes, mesh, tail).transitions, march.ends(nodes[:1], mesh, tail)[0]
    return composed(problem, w, whole, action, transitions, end, units)


def composed(
    problem: Problem,
    w: Unknowns,
    whole: tuple[np.ndarray, np.ndarray, np.ndarray],
    action: float,
    transitions: np.ndarray,
    end: np.ndarray,
    units: Sequence[float] = (),
) -> Orbit:
    """The same from state-transition matrices (N x 2n x 2n) of its segments and the state (2n) a period later."""
    (nodes, times, states), monodromy = whole, np.eye(len(end))
    for matrix in transitions:
        monodromy = matrix @ monodromy
    floquet = reduced(problem.model, nodes[0], monodromy, units)
    return recorded(problem, w.period, end, nodes, times, states, w.unfolding, action, floquet)


def measure(problem: Problem, flow: Flow, nodes: np.ndarray, period: float, unfolding: np.ndarray) -> Orbit:
    """An Orbit (without certificate) from converged node states over the problem's horizon."""
    model, given = problem.model, [np.shape(part) for part in (nodes, period, unfolding)]
    size = len(model.state_names)
    if [len(shape) for shape in given] != [2, 0, 1] or given[0][1] != size or not period > 0:
        raise InputError(f"measure: expected nodes (N x {size}), a period > 0 (s) and unfolding parameters, "
                         f"got shapes {', '.join(map(str, given))}, period {period}; hand those")  # fmt: skip
    whole = full_period(problem, flow, nodes, period)
    found = paths(flow, whole, period)
    times, states = dense(flow, whole, period, found)
    end = end_of(flow, whole[0], (0.0, period), tail_of(flow), least_steps(1))
    return recorded(
        problem, period, end, whole, times, states, unfolding,
        loop_action(model, flow, whole, times, states, all(enough for _, enough in found)),
        multipliers(model, flow, whole, period, found),
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
    symmetry: str | None = None,
) -> Orbit:
    """The Orbit (without certificate) that begins at the first of its nodes and is at `end` after a period, with a
    symmetry that is known or else looked for."""
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
        symmetry=recognise(times, samples, problem.model) if symmetry is None else symmetry,
        winding=tuple(map(int, problem.turns)),
        floquet_multipliers=floquet.multipliers,
        pair_defect=floquet.pair_defect,
        stability=floquet.stability,
        unfolding=tuple(map(float, unfolding)),
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


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Of what computes; read once, which takes 3 ms."""
    return {name: version(name) for name in ("casadi", "numpy", "scipy")} | {"python": platform.python_version()}


def provenance(problem: Problem, settings: SolveSettings, began: float) -> dict[str, Any]:
    """Versions, tolerances, wall time and guess: enough to repeat the search."""
    return {
        "orbitfinder": __version__,
        **versions(),
        "relative_tolerance": settings.integrator.relative_tolerance,
        "absolute_tolerance": settings.integrator.absolute_tolerance,
        "ipopt_tolerance": settings.ipopt_tolerance,
        "guess": {"state": problem.guess.start.tolist(), "period": float(problem.guess.period)},
        "pin": {one.name: one.value for one in problem.pin},
        "invariants": [one.name for one in problem.model.invariants],
        "wall_time": round(time.perf_counter() - began, 3),
    }


def full_period(problem: Problem, flow: Flow, nodes: np.ndarray, period: float) -> np.ndarray:
    """Nodes at equal times over the whole period from those over the symmetric part of it."""
    symmetry = problem.boundary
    if not symmetry.maps:
        return nodes
    horizon = symmetry.fraction * period
    end = end_of(flow, nodes[-1], (horizon - horizon / len(nodes), horizon), tail_of(flow), STEPS_PER_PERIOD // 16)
    return around(problem, nodes, end)


def around(problem: Problem, nodes: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The same, of a symmetry, where the motion over the part ends at `end`, which says about which centre it is."""
    symmetry = problem.boundary
    if symmetry.reverses:
        constant = boundary_constants(problem, nodes, end)
    else:
        constant = symmetry.constants(problem.model.angular, nodes[0], end, problem.winding)
        matrix, moved = symmetry.displaced(constant)
        end = matrix @ nodes[0] + moved
    return symmetry.whole(np.arange(len(nodes) + 1.0), np.vstack([nodes, end]), constant)[1][:-1]


def dense(flow: Flow, nodes: np.ndarray, period: float, found: Paths | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Equal times over one period and states there, each segment integrated from its node.

    Where equal steps do not follow the motion, past a singularity, graded ones go from each time to the next.
    """
    found, edges = found or paths(flow, nodes, period), np.linspace(0.0, period, len(nodes) + 1)
    # the others have a power of two times as many
    count = min(len(piece) - 1 for piece, _ in found)
    if not all(enough for _, enough in found):
        count = min(count, least_steps(len(nodes)) << GRADED)
    thin = []
    for node, edge, (piece, enough) in zip(nodes, pairwise(edges), found, strict=True):
        graded = None if enough else graded_path(flow, node, np.linspace(*edge, count + 1), tail_of(flow))
        thin.append(piece[:: (len(piece) - 1) // count] if graded is None else graded)
    states = np.vstack([*(piece[:-1] for piece in thin), thin[-1][-1:]])
    return np.linspace(0.0, period, len(states)), states


def paths(flow: Flow, nodes: np.ndarray, period: float) -> Paths:
    """States at equal times in each segment, and whether that many equal steps are enough for them."""
    duration, least, tail = period / len(nodes), least_steps(len(nodes)), tail_of(flow)
    return [path_of(flow, x, (k * duration, (k + 1) * duration), tail, least) for k, x in enumerate(nodes)]


def multipliers(model: Model, flow: Flow, nodes: np.ndarray, period: float, found: Paths | None = None) -> Floquet:
    """Reduced Floquet multipliers by the product of the segments' state-transition matrices."""
    count, monodromy = len(nodes), np.eye(nodes.shape[1])
    for k, node in enumerate(nodes):
        tame = found is None or found[k][1]
        monodromy = _transition(flow, node, (k * period / count, (k + 1) * period / count), tame) @ monodromy
    return reduced(model, nodes[0], monodromy, flow.units)


def reduced(model: Model, state: np.ndarray, monodromy: np.ndarray, units: Sequence[float] = ()) -> Floquet:
    """Floquet multipliers without the trivial ones, from the monodromy at a state; `units` (2n) to measure it in."""
    gradients, directions = frame(model, state)
    if len(units):
        sizes = np.asarray(units)
        monodromy = monodromy * sizes / sizes[:, None]
        gradients, directions = gradients * sizes, directions / sizes
    if model.constraint is not None:
        basis = tangent_basis(constraint_rows(model)(state).full())
        monodromy, gradients, directions = basis.T @ monodromy @ basis, gradients @ basis, directions @ basis
    return analyse(reduce_monodromy(monodromy, gradients, directions), conservative=symplectic(model))


def _transition(flow: Flow, node: np.ndarray, span: tuple[float, float], tame: bool) -> np.ndarray:
    """The state-transition matrix of a segment by CVODES; by graded steps past a singularity and where errors grow."""
    found = transition(flow, node, span[1] - span[0], span[0])[1]
    size, units = node.size, np.asarray(flow.units) if flow.units else np.ones(node.size)
    grown = float(np.linalg.norm(found * units / units[:, None], 2))
    if tame and not grown > STEEP:
        return found
    varied = variational_field(flow.field)
    columns = (varied.size1_in(1) - size) // size
    sizes = np.ones((size, columns)) * grown * units[:, None]
    sizes[:, :size] /= units
    start = np.concatenate([node, np.eye(size, columns).ravel("F")])
    end = graded_end(varied, start, span, tail_of(flow), (*units, *sizes.ravel("F")))
    return found if end is None else end[size:].reshape(size, columns, order="F")[:, :size]


def frame(model: Model, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants (k x 2n) and symmetry directions, the flow first, in (q, v)."""
    rate = accelerations(model)(0.0, state).full().ravel()
    return invariant_gradients(model)(state).full(), np.vstack(
        [*([] if model.forced else [rate]), generated(model, state)]
    )


def loop_action(
    model: Model, flow: Flow, nodes: np.ndarray, times: np.ndarray, states: np.ndarray, tame: bool = True
) -> float:
    """The action from equal times, where half of them tell the same; else integrated on from each node (N x 2n).

    It is integrated too where the motion is not `tame`, past a singularity.
    """
    whole, *fewer = (action(model, times[::by], states[::by]) for by in (1, 2, 4))
    if tame and resolved(whole, *fewer):
        return whole
    field, duration = with_action(model, flow.field), times[-1] / len(nodes)
    units = (*flow.units, nonzero(abs(whole))) if flow.units else ()
    ends = [
        graded_end(field, np.append(node, 0.0), (k * duration, (k + 1) * duration), tail_of(flow), units)
        for k, node in enumerate(nodes)
    ]
    return whole if any(end is None for end in ends) else float(sum(end[-1] for end in ends if end is not None))


def resolved(whole: float, half: float, quarter: float) -> bool:
    """Whether a number is known by all samples that half of them and a quarter tell as they do: each doubling takes at
    least the share of the error away that the last did, of a field that has a kink a power, else far more."""
    last = abs(whole - half)
    return last * min(1.0, last / nonzero(abs(half - quarter))) <= RESOLVED * abs(whole)


def action(model: Model, times: np.ndarray, states: np.ndarray) -> float:
    """Integral over the loop of `Model.action_rate`: of momentum.dq, of general first-order systems of |x'|^2 dt.

    The trapezoidal rule on equally spaced samples of a periodic function converges exponentially
    (L. N. Trefethen, J. A. C. Weideman, SIAM Review 56 (2014) 385-458).
    """
    many = Buffered(action_rate(model).map(len(times)))
    rate = many(times[:, None], np.asarray(states), model.parameter_values[None])[0].ravel()
    return float(trapezoid(rate, times))


def sampled_action(
    model: Model, times: np.ndarray, states: np.ndarray, march: March, every: int
) -> tuple[float, np.ndarray, np.ndarray]:
    """The action from every so many of equal times, or from as many more as tell the same by half of them; these times
    and states."""
    quick = compiled(action_rate(model), effort=EFFORT)  # CasADi's matrices take longer than what is in them
    while True:
        few, path = times[::every].copy(), states[::every].copy()
        rate = march.along(quick, few[:, None], path, model.parameter_values[None]).ravel()
        whole, *fewer = (float(trapezoid(rate[::by], few[::by])) for by in (1, 2, 4))
        if every == 1 or resolved(whole, *fewer):
            return whole, few, path
        every //= 2
