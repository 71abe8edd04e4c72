"""heyoka: Taylor integrator with variational equations, Newton's method on single shooting.

Set up as its documentation advises for systems of this size (`compact_mode`); without it the variational integrator
of three links does not finish compiling within minutes. The equations are ours, operation by operation, the O(n)
elimination included. Newton's method is given the same economy as ours: once the residual is below 1e-5 the plain
integrator evaluates it and the Jacobian stays; that is faster than the variational integrator throughout.
"""

from __future__ import annotations

import time
from typing import Any

import casadi as ca
import numpy as np

import orbitfinder as of
from peers.task import Answer, Task, Unavailable

KEEP = 1e-5
"""Residual below which the Jacobian is kept."""


class Taylor:
    """Both integrators of one number of links, compiled, and Newton's method with them."""

    def __init__(self, links: int) -> None:
        try:
            import heyoka as hy
        except ImportError:
            raise Unavailable("heyoka is not installed") from None
        began, model = time.perf_counter(), of.chain(links)
        x = ca.SX.sym("x", 2 * links)
        q, v, p = x[:links], x[links:], model.parameter_values
        field = ca.Function("field", [x], [ca.vertcat(v, model.acceleration(0, q, v, p))])
        total = model.kinetic(q, v, p) + model.potential(q, p)
        self.energy = ca.Function("energy", [x], [total, ca.gradient(total, x)])
        self.field = field
        variables = hy.make_vars(*(f"x{k}" for k in range(2 * links)))
        equations = list(zip(variables, expressions(hy, field, variables), strict=True))
        self.plain = hy.taylor_adaptive(equations, [0.0] * 2 * links, compact_mode=True)
        varied = hy.var_ode_sys(equations, args=hy.var_args.vars)
        self.varied = hy.taylor_adaptive(varied, [0.0] * 2 * links, compact_mode=True)
        self.build_seconds = time.perf_counter() - began

    def refine(self, task: Task) -> Answer:
        """Newton's method on {closure, phase, energy} in {state, period} until it stops improving."""
        began = time.perf_counter()
        size, x, period = task.state.size, task.state.copy(), task.period
        wanted = float(self.energy(x)[0])
        direction = self._rates(x) / np.linalg.norm(self._rates(x))
        best, found, inverse = np.inf, (x, period), np.zeros((0, 0))
        for _ in range(12):
            if best > KEEP:
                end, jacobian = self._varied(x, period)
            else:
                end, jacobian = self._plain(x, period), None
            energy, gradient = self.energy(x)
            rows = np.concatenate([end - x, [direction @ (x - task.state), float(energy) - wanted]])
            reached = float(np.abs(rows).max())
            if reached < best:
                found = (x, period)
            if reached < 1e-14 or reached > 0.5 * best:
                break
            best = reached
            if jacobian is not None:
                closing = np.column_stack([jacobian - np.eye(size), self._rates(end)])
                last = np.vstack([np.append(direction, 0.0), np.append(gradient.full().ravel(), 0.0)])
                inverse = np.linalg.pinv(np.vstack([closing, last]))
            change = -inverse @ rows
            x, period = x + change[:size], period + float(change[size])
        return Answer(time.perf_counter() - began, *found)

    def _rates(self, x: np.ndarray) -> np.ndarray:
        return self.field(x).full().ravel()

    def _plain(self, x: np.ndarray, period: float) -> np.ndarray:
        self.plain.time, self.plain.state[:] = 0.0, x
        self.plain.propagate_until(period)
        return self.plain.state.copy()

    def _varied(self, x: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
        size = x.size
        self.varied.time, self.varied.state[:size] = 0.0, x
        self.varied.state[size:] = np.eye(size).ravel()
        self.varied.propagate_until(period)
        return self.varied.state[:size].copy(), self.varied.state[size:].reshape(size, size).copy()


def expressions(hy: Any, function: ca.Function, inputs: list[Any]) -> list[Any]:
    """A CasADi scalar function as heyoka expressions, operation by operation."""
    names = {getattr(ca, name): name.removeprefix("OP_") for name in dir(ca) if name.startswith("OP_")}
    apply = {
        "ADD": lambda a, b: a + b, "SUB": lambda a, b: a - b, "MUL": lambda a, b: a * b, "DIV": lambda a, b: a / b,
        "NEG": lambda a: -a, "SIN": hy.sin, "COS": hy.cos, "SQ": lambda a: a * a, "TWICE": lambda a: 2.0 * a,
        "INV": lambda a: 1.0 / a, "ASSIGN": lambda a: a,
    }  # fmt: skip
    work: dict[int, Any] = {}
    found: dict[int, Any] = {}
    for k in range(function.n_instructions()):
        name, read = names[function.instruction_id(k)], function.instruction_input(k)
        write = function.instruction_output(k)
        if name == "INPUT":
            work[write[0]] = inputs[read[1]]
        elif name == "OUTPUT":
            found[write[1]] = work[read[0]]
        elif name == "CONST":
            work[write[0]] = hy.expression(function.instruction_constant(k))
        else:
            work[write[0]] = apply[name](*(work[one] for one in read))
    return [found[k] for k in range(function.size1_out(0))]
