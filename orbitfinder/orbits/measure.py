"""From the solver's nodes to an Orbit: the whole period, its multipliers, action and symmetry."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.integrate import trapezoid

from orbitfinder.integrate.cvodes import Flow, transition
from orbitfinder.loops.polish import end_of, graded_end, least_steps, segment, tail_of
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.shooting import boundary_constants
from orbitfinder.loops.symmetry import recognise
from orbitfinder.mechanics.constrained import tangent_space
from orbitfinder.mechanics.model import Model, energies
from orbitfinder.mechanics.model import energy as total_energy
from orbitfinder.orbits.evidence import gap
from orbitfinder.orbits.floquet import Floquet, analyse, reduce_monodromy
from orbitfinder.records.orbit import Orbit

RESOLVED = 1e-6
"""Relative difference that every other sample may make to the action: with all of them it is then some 1e-12"""


def measure(problem: Problem, flow: Flow, nodes: np.ndarray, period: float, unfolding: np.ndarray) -> Orbit:
    """An Orbit (without certificate) from converged node states over the problem's horizon."""
    model = problem.model
    whole = full_period(problem, flow, nodes, period)
    times, states = dense(flow, whole, period)
    floquet = multipliers(model, flow, whole, period)
    end = end_of(flow, whole[0], (0.0, period), tail_of(flow), least_steps(1))
    return Orbit(
        name=problem.name,
        title=problem.title,
        source=problem.source,
        system=model.system,
        state=whole[0],
        period=period,
        energy=total_energy(model, whole[0]),
        action=loop_action(model, flow, whole, times, states),
        closure=gap(whole[0], end, problem.turns),
        symmetry=recognise(times, states, model),
        winding=tuple(int(k) for k in problem.turns),
        floquet_multipliers=floquet.multipliers,
        pair_defect=floquet.pair_defect,
        stability=floquet.stability,
        unfolding=tuple(float(s) for s in unfolding),
        nodes=whole,
        times=times,
        samples=states,
        tolerance=problem.tolerance,
        expected=problem.expected,
    )


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
    n, count = model.degrees_of_freedom, len(nodes)
    monodromy = np.eye(2 * n)
    for k, node in enumerate(nodes):
        monodromy = transition(flow, node, period / count, k * period / count)[1] @ monodromy
    gradients, directions = frame(model, flow, nodes[0])
    if flow.units:
        units = np.asarray(flow.units)
        monodromy = monodromy * units / units[:, None]
        gradients, directions = gradients * units, directions / units
    if model.constraint is not None:
        basis = tangent_space(model, nodes[0])
        monodromy, gradients, directions = basis.T @ monodromy @ basis, gradients @ basis, directions @ basis
    return analyse(reduce_monodromy(monodromy, gradients, directions), conservative=model.conservative)


def frame(model: Model, flow: Flow, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants (k x 2n) and symmetry directions, the flow first, in (q, v)."""
    import casadi as ca

    n = model.degrees_of_freedom
    x, p = ca.MX.sym("x", 2 * n), ca.DM(model.parameter_values)
    free = ca.DM(tail_of(flow)[len(flow.unfolded) :])
    rate = flow.field(0.0, state, ca.DM.zeros(len(flow.unfolded)), free).full().ravel()
    rows, directions = [], [] if model.forced else [rate]
    for one in model.invariants:
        gradient = ca.Function("gradient", [x], [ca.gradient(one.value(x[:n], x[n:], p), x)])
        rows.append(gradient(state).full().ravel())
        if one.generator is not None:
            directions.append(one.generator(state[:n], state[n:], p).full().ravel())
    return np.asarray(rows).reshape(len(rows), 2 * n), np.asarray(directions).reshape(len(directions), 2 * n)


def loop_action(model: Model, flow: Flow, nodes: np.ndarray, times: np.ndarray, states: np.ndarray) -> float:
    """The action from equal times, where half of them tell the same; else integrated on from each node (N x 2n)."""
    found = action(model, times, states)
    if abs(found - action(model, times[::2], states[::2])) <= RESOLVED * abs(found):
        return found
    field, duration = action_field(model, flow), times[-1] / len(nodes)
    ends = [
        graded_end(field, np.append(node, 0.0), (k * duration, (k + 1) * duration), tail_of(flow))
        for k, node in enumerate(nodes)
    ]
    return found if any(end is None for end in ends) else float(sum(end[-1] for end in ends if end is not None))


def action_field(model: Model, flow: Flow) -> Any:
    """The flow's field with the action as a last state: (x, S)' = (f, 2 T + G)."""
    import casadi as ca

    n, p = model.degrees_of_freedom, ca.DM(model.parameter_values)
    inputs = [ca.MX.sym("t"), ca.MX.sym("z", 2 * n + 1), ca.MX.sym("s", flow.field.size1_in(2)),
              ca.MX.sym("free", flow.field.size1_in(3))]  # fmt: skip
    t, z, s, free = inputs
    rate = 2.0 * model.kinetic(z[:n], z[n:-1], p)
    if model.gyroscopic is not None:
        rate += model.gyroscopic(z[:n], z[n:-1], p)
    return ca.Function("action_field", inputs, [ca.vertcat(flow.field(t, z[:-1], s, free), rate)])


def action(model: Model, times: np.ndarray, states: np.ndarray) -> float:
    """Integral of momentum.dq over the loop, = integral of 2 T + G dt, G the gyroscopic term (linear in v).

    The trapezoidal rule on equally spaced samples of a periodic function converges exponentially
    (L. N. Trefethen, J. A. C. Weideman, SIAM Review 56 (2014) 385-458).
    """
    kinetic, _ = energies(model, states)
    rate = 2.0 * kinetic
    if model.gyroscopic is not None:
        q, v = np.split(np.asarray(states).T, 2)
        count = len(states)
        rate += model.gyroscopic.map(count)(q, v, np.tile(model.parameter_values[:, None], (1, count))).full().ravel()
    return float(trapezoid(rate, times))
