"""A system as CasADi functions, mechanical or any x' = f(t, x, p): the only thing the upper floors know of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError


@dataclass(frozen=True)
class Invariant:
    """A first integral I(q, v, p) with what shooting needs to unfold it.

    `value(q, v, p)` is the integral; `unfolding(q, v, p)` is the fictitious acceleration u (n)
    with dI/dt = s (grad_v I).u != 0 along an orbit, so that s must return to 0 on any periodic
    solution; `generator(q, v, p)` is the symmetry direction (2n) that the integral belongs to,
    or None for time translation (the energy). Of a first-order system q is the whole state, v is empty and
    u = grad I is added to the rates: dI/dt = s |grad I|^2.

    Source: F. J. Muñoz-Almaraz, E. Freire, J. Galán, E. Doedel, A. Vanderbauwhede, "Continuation
    of periodic orbits in conservative and Hamiltonian systems", Physica D 181 (2003) 1-38.
    """

    __repr__ = brief("name")

    name: str
    value: ca.Function
    unfolding: ca.Function
    generator: ca.Function | None = None


@dataclass(frozen=True)
class Baumgarte:
    """Stabilisation phi'' + 2 alpha phi' + beta^2 phi = 0, both in 1/s; zero is off."""

    alpha: float = 0.0
    beta: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True)
class HolonomicConstraint:
    """Constraints phi(q, p) = 0 (m) on redundant coordinates q (n), and the index-1 DAE that they make:

        M(q) a + h(t, q, v) = J(q)^T lambda,      J a + Jdot v + 2 alpha J v + beta^2 phi = 0.

    `rate(q, v, p)` = J v; `acceleration(q, v, a, p)` = J a + Jdot v (m); `jacobian(q, p)` = J (m x n);
    `balances(t, q, v, a, lambda, p)` = M a + h - J^T lambda (n); `algebraic(t, q, v, p)` = (a, lambda) by
    elimination, Baumgarte terms included; `force_names` are those of lambda. `lift(angles, rates, p)` is the
    state (2n) of a chain or linkage from its link angles and rates.
    """

    __repr__ = brief("force_names", "baumgarte")

    phi: ca.Function
    rate: ca.Function
    acceleration: ca.Function
    jacobian: ca.Function
    balances: ca.Function
    algebraic: ca.Function
    force_names: tuple[str, ...]
    baumgarte: Baumgarte
    lift: ca.Function | None = None

    def residual(self, t: Any, x: Any, z: Any, p: Any) -> Any:
        """The n + m algebraic equations of the DAE in z = (a, lambda), Baumgarte terms included."""
        n = self.phi.size1_in(0)
        q, v, a = x[:n], x[n:], z[:n]
        alpha, beta = self.baumgarte.alpha, self.baumgarte.beta
        rows = self.acceleration(q, v, a, p) + 2 * alpha * self.rate(q, v, p) + beta**2 * self.phi(q, p)
        return ca.vertcat(self.balances(t, q, v, a, z[n:], p), rows)


@dataclass(frozen=True)
class Model(Shown):
    """Equations of motion x' = (v, a(t, q, v, p)) of a state x = (q, v), and what belongs to them.

    A first-order system has `rates(t, q, p)` = q' instead: q is its whole state, v and a are empty, its energy is the
    `potential`, nan where nothing is conserved; `hamiltonian` says that q is (coordinates, momenta), half each, and
    its rates are Hamilton's equations.

    All functions take the full parameter vector p; `parameter_values` are the numbers that go
    there when a parameter is not freed. The state is x = (q, v), SI units, angles in rad.

    `acceleration(t, q, v, p)` (n), `kinetic(q, v, p)`, `potential(q, p)`, `forces(t, q, v, p)`
    (generalized, non-conservative, n) and `points(q, p)` (2 x k, drawn as one polyline; for a
    chain the joints), `centres(q, p)` (2 x links, centres of mass). Positions have x down, y right.

    `gyroscopic(q, v, p)` is the part of the Lagrangian that is linear in v; `kinetic` is then its
    quadratic part and `potential` minus the rest, so that kinetic + potential is the Jacobi
    integral v.dL/dv - L. `forcing_period(p)` (s) is the period of an explicit dependence on time.
    Under a `constraint` the coordinates are redundant and the energies carry no constraint forces: a is what the
    elimination of the DAE's algebraic variables gives, so that x' has the DAE's flow.
    """

    __repr__ = brief("system", "state_names")

    system: Mapping[str, Any]
    state_names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    parameter_values: np.ndarray
    acceleration: ca.Function
    kinetic: ca.Function
    potential: ca.Function
    forces: ca.Function | None = None
    invariants: tuple[Invariant, ...] = ()
    angles: tuple[bool, ...] = ()
    points: ca.Function | None = None
    centres: ca.Function | None = None
    gyroscopic: ca.Function | None = None
    forcing_period: ca.Function | None = None
    symmetries: tuple[tuple[str, int, tuple[int, ...]], ...] = ()
    """what orbits may have besides the usual: name, sense of time (1 or -1), sign of each coordinate"""
    landmarks: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """places (n each) that pictures mark and guesses may start from, at the model's own parameter values"""
    constraint: HolonomicConstraint | None = None
    hybrid: Any = None
    """modes, transitions and the cycle of a hybrid system, see `mechanics.hybrid`"""
    rates: ca.Function | None = None
    hamiltonian: bool = False
    strokes: tuple[tuple[str, tuple[int, ...]], ...] = ()
    """what is drawn through which of the points: rod (of one point a mass), spring, ground, slider, disc (centre,
    rim); () is a polyline"""
    scales: Mapping[str, float] = field(default_factory=dict)
    """sizes to measure in: of coordinates by name, of all that are no angles by "length", of physical parameters"""
    controls: tuple[str, ...] = ()
    """physical parameters that may vary in time; everything else here holds at their own values, 0 unless said"""
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """lowest and highest of controls"""
    actuation: ca.Function | None = None
    """(t, q, v, p) -> what controls add to the forces (n); see `mechanics.controls.actuated`"""

    @property
    def conservative(self) -> bool:
        """True when an energy is among the invariants (the one that belongs to time translation)."""
        return any(one.generator is None for one in self.invariants)

    @property
    def forced(self) -> bool:
        """True when the equations depend on time explicitly."""
        return self.forcing_period is not None

    @property
    def degrees_of_freedom(self) -> int:
        """n, the number of generalized coordinates; of a first-order system, of all components of the state."""
        return len(self.state_names) // (2 if self.rates is None else 1)

    @property
    def canonical(self) -> bool:
        """True when the equations are Hamilton's by construction: no forces act, or the rates are those of an H."""
        return self.forces is None if self.rates is None else self.hamiltonian

    @property
    def scalar(self) -> bool:
        """True when the equations are graphs of scalars (SX) and not of matrices (MX)."""
        return bool((self.rates or self.acceleration).is_a("SXFunction"))

    def rate(self, t: Any, x: Any, p: Any) -> Any:
        """x' (d) at a time and a state (d)."""
        if self.rates is not None:
            return self.rates(t, x, p)
        n = self.degrees_of_freedom
        return ca.vertcat(x[n:], self.acceleration(t, x[:n], x[n:], p))

    def action_rate(self, t: Any, x: Any, p: Any) -> Any:
        """What the action of a loop is the integral of: momentum.q', = 2 T + G; of other first-order systems |x'|^2."""
        n = self.degrees_of_freedom
        if self.rates is not None:
            rate = self.rates(t, x, p)
            return ca.dot(x[n // 2 :], rate[: n // 2]) if self.hamiltonian else ca.sumsqr(rate)
        found = 2.0 * self.kinetic(x[:n], x[n:], p)
        return found if self.gyroscopic is None else found + self.gyroscopic(x[:n], x[n:], p)

    @property
    def angular(self) -> np.ndarray:
        """Which coordinates (n) are angles, none where the model does not say."""
        return np.asarray(self.angles or (False,) * self.degrees_of_freedom, bool)

    @property
    def planes(self) -> tuple[tuple[int, int], ...]:
        """Components of a state that portraits draw against each other, across and up: each coordinate and its rate,
        or momentum; of other first-order systems every two.
        """
        half = len(self.state_names) // 2
        if self.rates is None or self.hamiltonian:
            return tuple((i, half + i) for i in range(half))
        return tuple(combinations(range(self.degrees_of_freedom), 2)) or ((0, 0),)

    def forcing_cycles(self, period: float) -> int:
        """Periods of the forcing in `period` (s), to the nearest and at least 1; 0 for an autonomous model."""
        if self.forcing_period is None:
            return 0
        return max(1, round(period / float(self.forcing_period(self.parameter_values))))

    def parameters(self, free: Sequence[str] = (), symbols: Any = None) -> Any:
        """The vector p with the parameters named in `free` replaced by the entries of `symbols`."""
        values = type(symbols)(ca.DM(self.parameter_values)) if free else ca.DM(self.parameter_values)
        for position, name in enumerate(free):
            values[self.parameter_index(name)] = symbols[position]
        return values

    def along(self, function: ca.Function, *columns: np.ndarray) -> np.ndarray:
        """A function of (..., p) at k columns of its other arguments, p the model's own: k blocks of columns."""
        count = columns[0].shape[1]
        values = np.tile(self.parameter_values[:, None], (1, count))
        return np.asarray(function.map(count)(*columns, values).full())

    def parameter_index(self, name: str) -> int:
        """Position of a physical parameter; `InputError` names the known ones."""
        if name not in self.parameter_names:
            known = ", ".join(self.parameter_names[:12])
            raise InputError(f"free: unknown physical parameter {name!r}; this system has {known}")
        return self.parameter_names.index(name)

    def state_index(self, name: str) -> int:
        """Position of a state component; `InputError` names the known ones."""
        if name not in self.state_names:
            known = ", ".join(self.state_names)
            raise InputError(f"unknown state component {name!r}; this system has {known}")
        return self.state_names.index(name)


def constraint_of(model: Model) -> HolonomicConstraint:
    """The constraint of a Model; `InputError` without one."""
    if model.constraint is None:
        raise InputError(
            "model: has no constraints; linkage(...), chain_dae(...) and constrained(...) make one with them"
        )
    return model.constraint


def vector_field(model: Model, free: Sequence[str] = (), unfolded: Sequence[Invariant] = ()) -> ca.Function:
    """The state-space field f(t, x, s, free) = (v, a(t, q, v, p) + sum_k s_k u_k(q, v, p)) of a Model.

    Of a first-order system it is the rates + sum_k s_k grad I_k.
    """
    n = model.degrees_of_freedom
    symbol: Any = ca.SX.sym if model.scalar else ca.MX.sym
    t, x = symbol("t"), symbol("x", len(model.state_names))
    s, chosen = symbol("s", len(unfolded)), symbol("free", len(free))
    parameters = model.parameters(free, chosen)
    last = model.acceleration(t, x[:n], x[n:], parameters) if model.rates is None else model.rates(t, x, parameters)
    for k, invariant in enumerate(unfolded):
        last += s[k] * invariant.unfolding(x[:n], x[n:], parameters)
    return ca.Function("field", [t, x, s, chosen], [last if model.rates is not None else ca.vertcat(x[n:], last)])


def check_state(model: Model, state: Any) -> np.ndarray:
    """One state (2n) as floats; `InputError` for another size."""
    found = np.atleast_1d(np.squeeze(np.asarray(state, float)))
    if found.shape != (len(model.state_names),):
        raise InputError(_missized("state", f"{found.size} numbers", model, ""))
    return found


def check_states(model: Model, states: Any) -> np.ndarray:
    """States (k x 2n) as floats; `InputError` for another shape."""
    found = np.asarray(states, float)
    if found.ndim != 2 or found.shape[1] != len(model.state_names):
        raise InputError(_missized("states", f"shape {found.shape}", model, "rows of "))
    return found


def _missized(name: str, found: str, model: Model, what: str) -> str:
    size = len(model.state_names)
    return f"{name}: {found} for {counted(model)}; give {what}{size} numbers ({', '.join(model.state_names)})"


def counted(model: Model) -> str:
    """How many coordinates a Model has, or components a first-order state, for messages."""
    what = "coordinates" if model.rates is None else "components of the state"
    return f"{model.degrees_of_freedom} {what}"


def wrapped(gaps: np.ndarray, angles: Sequence[bool] | np.ndarray) -> np.ndarray:
    """Differences of states (... x 2n) or of coordinates, the first of which are `angles`, these in [-pi, pi)."""
    turning = np.zeros(gaps.shape[-1], bool)
    turning[: len(angles)] = angles
    return np.where(turning, (gaps + np.pi) % (2 * np.pi) - np.pi, gaps)


def energy(model: Model, state: np.ndarray) -> float:
    """Total energy E = T(q, v) + V(q) of one state (2n), in J; nan where none exists. Raises `InputError`."""
    x, n, p = check_state(model, state), model.degrees_of_freedom, model.parameter_values
    return float(model.kinetic(x[:n], x[n:], p)) + float(model.potential(x[:n], p))


def energies(model: Model, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic and potential energy (two arrays of k) along states (k x 2n), in J. Raises `InputError`."""
    x, n = check_states(model, states).T, model.degrees_of_freedom
    return model.along(model.kinetic, x[:n], x[n:]).ravel(), model.along(model.potential, x[:n]).ravel()


def positions(model: Model, states: np.ndarray, which: str = "points") -> np.ndarray:
    """Joint (`points`) or centre-of-mass (`centres`) positions along states (k x 2n): (k, 2, m), m."""
    if which not in ("points", "centres"):
        raise InputError(f"which: must be 'points' or 'centres', got {which!r}")
    function = model.points if which == "points" else model.centres
    if function is None:
        raise InputError(f"this system declares no {which}; pass {which}= when you build it")
    rows = check_states(model, states)
    flat = model.along(function, rows.T[: model.degrees_of_freedom])
    return flat.reshape(2, len(rows), -1).transpose(1, 0, 2)
