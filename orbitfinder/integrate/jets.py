"""The rates of a Model as equations of rest, with their derivatives up to the third.

An autonomous Model rests where G(z, p) = 0, z = (x, s), with E x' = G of a mass matrix E = diag(1, 0):

    f(x, p) + U(x, p) s = 0,     I(x, p) = I_0,     phi(q, p) = 0,  J v = 0.

Where a first integral I makes f = 0 one equation fewer, its unfolding U takes the place and the integral is kept; under
constraints their gradients do, as forces that come out as 0. Source: as for orbits, F. J. Muñoz-Almaraz et al.,
Physica D 181 (2003) 1-38.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from threading import get_ident
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.caches import Kept, Same
from orbitfinder.integrate.equations import hamilton
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.mechanics.model import Invariant, Model

_jets, _canonical = Kept["Jets"](16), Kept[tuple[Buffered, Buffered, np.ndarray]](16)
DEPENDENT = 1e-9
"""Gradients whose smallest singular value is this share of the largest, each of length 1, say the same"""


@dataclass(frozen=True, eq=False)
class Jets:
    """G(z, p) and its derivatives, p the parameters of these names, the others at the model's values.

    Integrals with a generator are unfolded and not kept: a phase is missing of each (`generators`).
    """

    model: Model
    free: tuple[str, ...]
    unfolded: tuple[Invariant, ...] = ()

    @cached_property
    def size(self) -> int:
        """d, the components of a state."""
        return len(self.model.state_names)

    @cached_property
    def extra(self) -> int:
        """How many s there are."""
        constraint = self.model.constraint
        return len(self.unfolded) + (0 if constraint is None else 2 * constraint.phi.size1_out(0))

    @cached_property
    def _stated(self) -> tuple[Any, Any, Any, Any]:
        """z, p, the values that are kept, G."""
        model, n, d = self.model, self.model.degrees_of_freedom, self.size
        symbol = model.symbol
        z, p, kept = symbol("z", d + self.extra), symbol("p", len(self.free)), symbol("kept", len(self.keeping))
        x, s, values = z[:d], z[d:], model.parameters(self.free, p)
        rates, rows = model.rate(0.0, x, values), []
        parts = (x, x[n:], values) if model.rates is not None else (x[:n], x[n:], values)
        for k, invariant in enumerate(self.unfolded):
            push = s[k] * invariant.unfolding(*parts)
            rates += push if model.rates is not None else ca.vertcat(type(z)(n, 1), push)
        rows += [invariant.value(*parts) - kept[k] for k, invariant in enumerate(self.keeping)]
        if model.constraint is not None:
            jacobian, first = model.constraint.jacobian(x[:n], values), len(self.unfolded)
            count = jacobian.size1()
            rates += ca.vertcat(jacobian.T @ s[first : first + count], jacobian.T @ s[first + count :])
            rows += [model.constraint.phi(x[:n], values), jacobian @ x[n:]]
        return z, p, kept, ca.densify(ca.vertcat(rates, *rows))

    @cached_property
    def keeping(self) -> tuple[Invariant, ...]:
        """The integrals that keep a value."""
        return tuple(one for one in self.unfolded if one.generator is None)

    @cached_property
    def first(self) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """(z, p, kept) -> G, and below it the transposes of its slopes in z and in p."""
        z, p, kept, rows = self._stated
        whole = ca.densify(ca.horzcat(rows, ca.jacobian(rows, z), ca.jacobian(rows, p)))
        function = Buffered(ca.Function("first", [z, p, kept], [whole]))
        return lambda z, p, kept: function(z, p, kept)[0]

    @cached_property
    def second(self) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """(z, p, v) -> the slopes of G_z v in (z, p)."""
        z, p, kept, rows = self._stated
        v = type(z).sym("v", z.numel())
        turned = ca.jtimes(rows, z, v)
        function = Buffered(ca.Function("second", [z, p, v, kept], [ca.densify(ca.jacobian(turned, ca.vertcat(z, p)))]))
        return lambda z, p, v: function(z, p, v, 0.0)[0].T

    @cached_property
    def weighted(self) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """(z, p, psi) -> the second derivatives of psi.G in (z, p)."""
        z, p, kept, rows = self._stated
        both, psi = type(z).sym("w", z.numel() + p.numel()), type(z).sym("psi", rows.numel())
        inside = ca.Function("inside", [z, p, kept], [rows])(both[: z.numel()], both[z.numel() :], kept)
        hessian = ca.hessian(ca.dot(psi, inside), both)[0]
        function = Buffered(ca.Function("weighted", [both, psi, kept], [ca.densify(hessian)]))
        return lambda z, p, psi: function(np.concatenate([z, p]), psi, 0.0)[0].T

    @cached_property
    def third(self) -> Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
        """(z, p, u, v) -> the slopes in z of the second derivative of G in z along u and v."""
        z, p, kept, rows = self._stated
        u, v = (type(z).sym(name, z.numel()) for name in "uv")
        turned = ca.jtimes(ca.jtimes(rows, z, u), z, v)
        function = Buffered(ca.Function("third", [z, p, u, v, kept], [ca.densify(ca.jacobian(turned, z))]))
        return lambda z, p, u, v: function(z, p, u, v, 0.0)[0].T

    @cached_property
    def generators(self) -> Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]:
        """(x, p) -> of the integrals that have one: the directions (k x d) of their symmetries, and their gradients."""
        model, n = self.model, self.model.degrees_of_freedom
        moving = [one for one in self.unfolded if one.generator is not None]
        symbol = model.symbol
        x, p = symbol("x", self.size), symbol("p", len(self.free))
        parts = x[:n], x[n:], model.parameters(self.free, p)
        rows = [ca.horzcat(*(ca.densify(one.generator(*parts)) for one in moving if one.generator is not None)),
                ca.horzcat(*(ca.densify(ca.gradient(one.value(*parts), x)) for one in moving))]  # fmt: skip
        if not moving:
            return lambda x, p: (np.zeros((0, self.size)), np.zeros((0, self.size)))
        function = Buffered(ca.Function("generators", [x, p], rows))

        def both(x: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            directions, gradients = function(x, p)
            return directions, gradients

        return both

    def kept_at(self, x: np.ndarray) -> np.ndarray:
        """The values of the integrals that are kept, at a state."""
        n, values = self.model.degrees_of_freedom, self.model.parameter_values
        return np.array([float(one.value(x[:n], x[n:], values)) for one in self.keeping])


def at_rest(model: Model, free: tuple[str, ...], state: np.ndarray) -> Jets:
    """The equations of rest near a state: integrals are unfolded that change along some direction there."""
    chosen: list[Invariant] = []
    n, values, slopes = model.degrees_of_freedom, ca.DM(model.parameter_values), np.zeros((0, state.size))
    sizes = np.where(state == 0.0, 1.0, np.abs(state))
    x = (ca.SX if model.scalar else ca.MX).sym("x", state.size)
    for one in model.invariants:
        if one.generator is None and model.rates is None:
            continue  # an energy does not change to first order where nothing moves
        gradient = ca.Function("slope", [x], [ca.densify(ca.gradient(one.value(x[:n], x[n:], values), x))])
        row, beside = (gradient(x).full().ravel() * sizes for x in (state, 1.1 * state + 0.1 * sizes))
        if not np.linalg.norm(row) > DEPENDENT * np.linalg.norm(beside):
            continue
        rows = np.vstack([slopes, row / np.linalg.norm(row)])
        if np.linalg.svd(rows)[1][-1] > DEPENDENT:
            chosen, slopes = [*chosen, one], rows
    key = Same(model), free, tuple(map(Same, chosen)), get_ident()  # a thread's own: its functions have one work space
    return _jets(key, lambda: Jets(model, free, tuple(chosen)))


def canonical_rates(model: Model, parameters: tuple[str, ...], beside: int) -> tuple[Buffered, Buffered, np.ndarray]:
    """Hamilton's equations along parameters: (x, value) -> y = (q, momentum) and its slopes in x; y and `beside` y for
    each of its components -> the rates of all; which components of a state x are. Of first order, y is the state."""

    def made() -> tuple[Buffered, Buffered, np.ndarray]:
        known = hamilton(model, parameters)
        chosen, k = known.coordinates.chosen, known.coordinates.size
        x, y, p = map(ca.MX.sym, "xyp", (chosen.size, chosen.size, len(parameters)))
        canonical = [ca.vertcat(x[:k], known.momentum(x[:k], x[k:], p)), known.lift(x[:k], x[k:], p)]
        there = Buffered(ca.Function("there", [x, p], [ca.densify(part) for part in canonical]))
        rates = ca.Function("rates", [y, p], [ca.densify(known.field(0.0, y, p))])
        return there, Buffered(rates.map(beside * chosen.size + 1)), chosen

    return _canonical((Same(model), parameters, beside, get_ident()), made)
