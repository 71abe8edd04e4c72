"""A system as CasADi functions, mechanical or any x' = f(t, x, p): the only thing the upper floors know of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Generic, Self, TypeVar, overload

import casadi as ca
import numpy as np
from scipy.interpolate import CubicSpline

from orbitfinder._runtime.arguments import check_fields
from orbitfinder._runtime.notebook import Shown, brief
from orbitfinder.errors import InputError

Value = TypeVar("Value")


@dataclass(frozen=True)
class Invariant:
    """A first integral I(q, v, p) with what shooting needs to unfold it.

    Models find their own; give others where you know more. Source: F. J. Muñoz-Almaraz, E. Freire, J. Galán, E.
    Doedel, A. Vanderbauwhede, "Continuation of periodic orbits in conservative and Hamiltonian systems", Physica D
    181 (2003) 1-38.

    Args:
        name: by which it is pinned.
        value: CasADi Function (q, v, p) of the integral; of a first-order system q is the whole state, v is empty.
        unfolding: Function (q, v, p) of the fictitious acceleration u (n) with dI/dt = s (grad_v I).u != 0 along an
            orbit, so that s must return to 0 on any periodic solution; of a first-order system u = grad I is added to
            the rates: dI/dt = s |grad I|^2.
        generator: Function (q, v, p) of the symmetry direction (2n) that the integral belongs to; None for time
            translation (the energy).
        linear: of a first-order system, whether I is linear in the state.

    Examples:
        >>> [one.name for one in of.systems.spherical_pendulum().invariants]
        ['energy', 'momentum_phi']
    """

    __repr__ = brief("name")

    name: str
    value: ca.Function
    unfolding: ca.Function
    generator: ca.Function | None = None
    linear: bool = False


@dataclass(frozen=True)
class Baumgarte:
    """Stabilisation of a constraint: phi'' + 2 alpha phi' + beta^2 phi = 0.

    Args:
        alpha: 1/s, the damping; 0 is off.
        beta: 1/s, the stiffness' root; 0 is off.

    Raises:
        InputError: for a negative or infinite number.

    Examples:
        >>> of.chain_dae(2, baumgarte=of.Baumgarte(5.0, 5.0)).constraint.baumgarte
        Baumgarte(alpha=5.0, beta=5.0)
    """

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
class Dynamics:
    """The equations of motion of a state.

    Args:
        state_names: of the components of x (2n, or d of a first-order system).
        parameter_names: of the physical parameters (k).
        parameter_values: the numbers that go there when a parameter is not freed (k).
        acceleration: a(t, q, v, p) (n).
        rates: of a first-order system x' = rates(t, x, p): q is then its whole state, v and a are empty.
        hamiltonian: whether the rates are Hamilton's, q being (coordinates, momenta), half each.
        forcing_period: (p) -> s, the period of an explicit dependence on time.
        apart: the acceleration again, with its derivatives by q and v, as (t, q, v, p, q0, v0, a0) at q0 = q, v0 = v
            and a0 = a held: M(q0)^-1 of forces that balance a0, say, where M^-1 is many operations on q.
    """

    state_names: tuple[str, ...]
    parameter_names: tuple[str, ...]
    parameter_values: np.ndarray
    acceleration: ca.Function
    rates: ca.Function | None = None
    hamiltonian: bool = False
    forcing_period: ca.Function | None = None
    apart: ca.Function | None = None


@dataclass(frozen=True)
class Mechanics:
    """The energies and forces that equations of motion come from.

    Args:
        kinetic: T(q, v, p), its part quadratic in v where there is a `gyroscopic` one.
        potential: V(q, p); of a first-order system its energy, nan where nothing is conserved.
        forces: generalized, non-conservative Q(t, q, v, p) (n).
        gyroscopic: the part of the Lagrangian that is linear in v, (q, v, p); kinetic + potential is then the Jacobi
            integral v.dL/dv - L.
        constraint: the holonomic constraint with its native DAE.
    """

    kinetic: ca.Function
    potential: ca.Function
    forces: ca.Function | None = None
    gyroscopic: ca.Function | None = None
    constraint: HolonomicConstraint | None = None


USUAL_SYMMETRIES = ("none", "brake", "reflection", "reversal", "brake+reflection")
"""Those that need no declaration by the system"""


@dataclass(frozen=True)
class Structure:
    """What motions keep and repeat.

    Args:
        invariants: first integrals, with what unfolds them.
        symmetries: what orbits may have besides the usual: name, sense of time (1 or -1), sign of each coordinate.
        angles: which coordinates are angles (n).
    """

    invariants: tuple[Invariant, ...] = ()
    symmetries: tuple[tuple[str, int, tuple[int, ...]], ...] = ()
    angles: tuple[bool, ...] = ()


@dataclass(frozen=True)
class Drive:
    """What may be controlled.

    Args:
        controls: physical parameters that may vary in time; all else here holds at their own values, 0 unless said.
        limits: lowest and highest of controls, by name.
        actuation: (t, q, v, p) -> what controls add to the forces (n).
    """

    controls: tuple[str, ...] = ()
    limits: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    actuation: ca.Function | None = None


@dataclass(frozen=True)
class Picture:
    """What is drawn.

    Args:
        points: positions that are drawn (q, p) -> 2 x k; for a chain the joints.
        space: the same in space (q, p) -> 3 x k, x down, y right, z towards the eye; then `points` is a projection.
        centres: centres of mass (q, p) -> 2 x k.
        strokes: what is drawn through which of the points: rod (of one point a mass), spring, ground, slider, disc
            (centre, rim); () is a polyline.
        landmarks: places (n each) that pictures mark and guesses may start from, at the model's own parameter values.
    """

    points: ca.Function | None = None
    space: ca.Function | None = None
    centres: ca.Function | None = None
    strokes: tuple[tuple[str, tuple[int, ...]], ...] = ()
    landmarks: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


class Of(Generic[Value]):
    """A field of a Model's part by its name alone: `model.kinetic` is `model.mechanics.kinetic`."""

    def __init__(self, part: str) -> None:
        self._part = part

    def __set_name__(self, owner: type, name: str) -> None:
        self._name, PART_OF[name] = name, self._part

    @overload
    def __get__(self, model: None, owner: type) -> Self: ...
    @overload
    def __get__(self, model: Any, owner: type) -> Value: ...
    def __get__(self, model: Any, owner: type) -> Self | Value:
        if model is None:
            return self
        value: Value = getattr(getattr(model, self._part), self._name)
        vars(model)[self._name] = value  # next time it is an attribute like any other
        return value


PART_OF: dict[str, str] = {}
"""The part of a Model that has a field"""


@dataclass(frozen=True, init=False)
class Model(Shown):
    """Equations of motion x' = (v, a(t, q, v, p)) of a state x = (q, v), and what belongs to them.

    `of.chain`, `of.linkage`, `of.mechanism`, `of.lagrange`, `of.ode`, ... make one. All functions are CasADi's and
    take the full parameter vector p. SI units, angles in rad; positions have x down, y right. Under a constraint the
    coordinates are redundant and the energies carry no constraint forces: a is what the elimination of the DAE's
    algebraic variables gives, so that x' has the DAE's flow. Fields of the parts are known by their own names too:
    `model.kinetic` is `model.mechanics.kinetic`.

    Args:
        system: plain description from which files rebuild it.
        dynamics: the equations of motion, names and numbers of what stands in them.
        mechanics: energies, forces, constraint.
        structure: invariants, symmetries, which coordinates are angles.
        hybrid: modes, transitions and the cycle of a hybrid system.
        drive: controls with their limits.
        picture: what is drawn.
        scales: sizes to measure in: of coordinates by name, of all that are no angles by "length", of parameters.
        **fields: of the parts by their own names, `kinetic=...`; they go before.

    Examples:
        >>> pendulum.degrees_of_freedom, pendulum.conservative, pendulum.parameter_names[:3]
        (2, True, ('length1', 'length2', 'mass1'))
        >>> pendulum.acceleration(0, [0.1, 0.2], [0, 0], pendulum.parameter_values)
        DM([...])
    """

    __repr__ = brief("system", "state_names")

    system: Mapping[str, Any]
    dynamics: Dynamics
    mechanics: Mechanics
    structure: Structure
    hybrid: Any
    drive: Drive
    picture: Picture
    scales: Mapping[str, float]

    state_names = Of[tuple[str, ...]]("dynamics")
    parameter_names = Of[tuple[str, ...]]("dynamics")
    parameter_values = Of[np.ndarray]("dynamics")
    acceleration = Of[ca.Function]("dynamics")
    rates = Of[ca.Function | None]("dynamics")
    hamiltonian = Of[bool]("dynamics")
    forcing_period = Of[ca.Function | None]("dynamics")
    apart = Of[ca.Function | None]("dynamics")
    kinetic = Of[ca.Function]("mechanics")
    potential = Of[ca.Function]("mechanics")
    forces = Of[ca.Function | None]("mechanics")
    gyroscopic = Of[ca.Function | None]("mechanics")
    constraint = Of[HolonomicConstraint | None]("mechanics")
    invariants = Of[tuple[Invariant, ...]]("structure")
    symmetries = Of[tuple[tuple[str, int, tuple[int, ...]], ...]]("structure")
    angles = Of[tuple[bool, ...]]("structure")
    controls = Of[tuple[str, ...]]("drive")
    limits = Of[Mapping[str, tuple[float, float]]]("drive")
    actuation = Of[ca.Function | None]("drive")
    points = Of[ca.Function | None]("picture")
    space = Of[ca.Function | None]("picture")
    centres = Of[ca.Function | None]("picture")
    strokes = Of[tuple[tuple[str, tuple[int, ...]], ...]]("picture")
    landmarks = Of[Mapping[str, tuple[float, ...]]]("picture")

    def __init__(
        self, system: Mapping[str, Any], dynamics: Dynamics | None = None, mechanics: Mechanics | None = None,
        structure: Structure | None = None, hybrid: Any = None, drive: Drive | None = None,
        picture: Picture | None = None, scales: Mapping[str, float] | None = None, **fields: Any,
    ) -> None:  # fmt: skip
        """The parts, and fields of parts by their own names, which go before."""
        if unknown := [name for name in fields if name not in PART_OF]:
            raise TypeError(f"Model() has no field {unknown[0]!r}; it has {', '.join(PART_OF)}")
        parts = dynamics, mechanics, structure, drive, picture
        vars(self).update(system=system, hybrid=hybrid, scales=scales or {})
        for kind, part in zip((Dynamics, Mechanics, Structure, Drive, Picture), parts, strict=True):
            name = kind.__name__.lower()
            own = {key: value for key, value in fields.items() if PART_OF[key] == name}
            vars(self)[name] = kind(**own) if part is None else replace(part, **own) if own else part  # type: ignore[type-var]

    @property
    def conservative(self) -> bool:
        """True when an energy is among the invariants (the one that belongs to time translation)."""
        return any(one.generator is None for one in self.invariants)

    @property
    def dissipative(self) -> bool:
        """True when nothing is conserved, or linear invariants of a first-order system alone: where these are held,
        equilibria and cycles are those of a system that conserves nothing.
        """
        return all(each.linear for each in self.invariants if each.generator is None)

    @property
    def smooth(self) -> bool:
        """True when motions do not jump: there are no modes with guards and resets."""
        return self.hybrid is None

    @property
    def cycle(self) -> tuple[str, ...]:
        """The transitions of one period, in their order; none of a smooth system."""
        return () if self.hybrid is None else self.hybrid.cycle

    @property
    def arcs(self) -> tuple[Any, ...]:
        """Mode and transition of each arc of the cycle; none of a smooth system."""
        return () if self.hybrid is None else self.hybrid.arcs

    @property
    def forced(self) -> bool:
        """True when the equations depend on time explicitly."""
        return self.forcing_period is not None

    @property
    def driving_period(self) -> float:
        """The period (s) of an explicit dependence on time, by the model's own parameters; only of what is `forced`."""
        return float(self.forcing_period(self.parameter_values))  # type: ignore[misc]

    @property
    def degrees_of_freedom(self) -> int:
        """n, the number of generalized coordinates; of a first-order system, of all components of the state."""
        return len(self.state_names) // (2 if self.rates is None else 1)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of the generalized coordinates (n), the first of the state's components."""
        return self.state_names[: self.degrees_of_freedom]

    @property
    def canonical(self) -> bool:
        """True when the equations are Hamilton's by construction: no forces act, or the rates are those of an H."""
        return self.forces is None if self.rates is None else self.hamiltonian

    @property
    def scalar(self) -> bool:
        """True when the equations are graphs of scalars (SX) and not of matrices (MX)."""
        return bool((self.rates or self.acceleration).is_a("SXFunction"))

    @property
    def symbol(self) -> Any:
        """What makes symbols for its equations: `SX.sym` of scalars, else `MX.sym`."""
        return symbol_of(self.rates or self.acceleration)

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

    def forcing_cycles(self, period: float, beat: float | None = None) -> int:
        """Periods of the forcing, its own or `beat`, in `period` (s), to the nearest and at least 1; 0 for an
        autonomous model."""
        if self.forcing_period is None:
            return 0
        return max(1, round(period / (self.driving_period if beat is None else beat)))

    def check_clock(self, name: str, numbers: Sequence[float] | np.ndarray) -> None:
        """`InputError` for values of a physical parameter at which the forcing has no period."""
        if self.forcing_period is None or name not in self.parameter_names:
            return
        for number in numbers:
            clock = float(self.forcing_period(self.parameters([name], ca.DM([number]))))
            if not 0 < clock < np.inf:
                raise InputError(f"{name}: at {number:g} the period of the forcing is {clock:g} s; give values where "
                                 "it is positive")  # fmt: skip

    def parameters(self, free: Sequence[str] = (), symbols: Any = None) -> Any:
        """The vector p with the parameters named in `free` replaced by the entries of `symbols`."""
        values = type(symbols)(ca.DM(self.parameter_values)) if free else ca.DM(self.parameter_values)
        for position, name in enumerate(free):
            values[self.parameter_index(name)] = symbols[position]
        return values

    def along(self, function: ca.Function, *columns: np.ndarray) -> np.ndarray:
        """A function of (..., p) at k columns of its other arguments, p the model's own: k blocks of columns."""
        return np.asarray(function(*columns, self.parameter_values).full())  # one column serves for all

    def parameter_index(self, name: str) -> int:
        """Position of a physical parameter; `InputError` names the known ones."""
        if name not in self.parameter_names:
            known = ", ".join(self.parameter_names[:12])
            raise InputError(f"free: unknown physical parameter {name!r}; this system has {known}")
        return self.parameter_names.index(name)

    def value(self, name: str) -> float:
        """The model's own value of a physical parameter; `InputError` names the known ones."""
        return float(self.parameter_values[self.parameter_index(name)])

    @property
    def named_parameters(self) -> dict[str, float]:
        """The model's own values of all physical parameters by name."""
        return dict(zip(self.parameter_names, map(float, self.parameter_values), strict=True))

    def values_of(self, names: Sequence[str]) -> np.ndarray:
        """A copy of the values of physical parameters by name."""
        return self.parameter_values[[self.parameter_index(name) for name in names]]

    def state_index(self, name: str) -> int:
        """Position of a state component; `InputError` names the known ones."""
        if name not in self.state_names:
            known = ", ".join(self.state_names)
            raise InputError(f"unknown state component {name!r}; this system has {known}")
        return self.state_names.index(name)


def finite_number(where: str, value: Any) -> float:
    """The number that stands at some place, or `InputError`."""
    known = isinstance(value, (int, float, np.floating, np.integer)) and not isinstance(value, bool)
    if not known or not np.isfinite(value):
        raise InputError(f"{where}: must be a finite number, got {value!r}; check the value")
    return float(value)


def symbol_of(function: ca.Function) -> Any:
    """What makes symbols of the kind that a function is stated in: `SX.sym` or `MX.sym`."""
    return ca.SX.sym if function.is_a("SXFunction") else ca.MX.sym


def inputs_of(function: ca.Function) -> list[Any]:
    """New symbols for what a function is given, of the kind that it is stated in."""
    return function.sx_in() if function.is_a("SXFunction") else function.mx_in()  # type: ignore[no-any-return]


def altered(model: Model, **changes: Any) -> Model:
    """The Model with some fields changed, those of its parts by their own names; as `dataclasses.replace`."""
    return replace(model, **changes)


def images(model: Model, sense: int, places: Any, at: Sequence[Any], shift: Any = 0.0) -> Any:
    """Rates x' or accelerations where (t, x, p) or (t, q, v, p) goes with t -> sense t + shift, q -> P q, and minus
    what those of `at` become: n x 2 with rows that add up to 0 where the equations have that symmetry."""
    field, (t, *state, p) = model.rates or model.acceleration, at
    image = (sense**k * places @ each for k, each in enumerate(state))
    return ca.horzcat(field(sense * t + shift, *image, p), -(sense ** len(state)) * places @ field(*at))


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
    symbol = model.symbol
    t, x = symbol("t"), symbol("x", len(model.state_names))
    s, chosen = symbol("s", len(unfolded)), symbol("free", len(free))
    parameters = model.parameters(free, chosen)
    last = model.acceleration(t, x[:n], x[n:], parameters) if model.rates is None else model.rates(t, x, parameters)
    for k, invariant in enumerate(unfolded):
        last += s[k] * invariant.unfolding(x[:n], x[n:], parameters)
    return ca.Function("field", [t, x, s, chosen], [last if model.rates is not None else ca.vertcat(x[n:], last)])


def field_apart(model: Model, free: Sequence[str] = (), unfolded: Sequence[Invariant] = ()) -> ca.Function | None:
    """`vector_field` by what stands `apart`, as a function of (t, x, s, free, x0, rate0); None where nothing does."""
    if model.apart is None or not model.apart.is_a("SXFunction"):
        return None
    n, (t, s, chosen) = model.degrees_of_freedom, map(ca.SX.sym, ("t", "s", "free"), (1, len(unfolded), len(free)))
    x, here, rate = (ca.SX.sym(name, 2 * n) for name in ("x", "x0", "rate0"))
    parameters, held, added = model.parameters(free, chosen), rate[n:], ca.SX(n, 1)
    for k, invariant in enumerate(unfolded):
        added += s[k] * invariant.unfolding(x[:n], x[n:], parameters)
        held -= s[k] * invariant.unfolding(here[:n], here[n:], parameters)
    last = added + model.apart(t, x[:n], x[n:], parameters, here[:n], here[n:], held)
    return ca.Function("apart", [t, x, s, chosen, here, rate], [ca.densify(ca.vertcat(x[n:], last))])


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
    if not np.any(angles):
        return np.asarray(gaps, float)
    left = np.array(gaps, float)
    part = left[..., : len(angles)]
    np.subtract(part, 2 * np.pi * np.floor(part / (2 * np.pi) + 0.5), out=part, where=np.asarray(angles, bool))
    return left


def between(times: np.ndarray, states: np.ndarray, n: int, moments: np.ndarray | float) -> np.ndarray:
    """States at moments from dense samples (k x d), by cubics; n of the components are coordinates, others rates."""
    if n == states.shape[1]:
        return np.asarray(CubicSpline(times, states)(moments))
    moments = np.asarray(moments, float)
    before = np.clip(np.searchsorted(times, moments, side="right") - 1, 0, len(times) - 2)
    ahead, step = (moments - times[before])[..., None], (times[before + 1] - times[before])[..., None]
    (place, first), last = (states[before, :n], states[before, n:]), states[before + 1, n:]
    mean = (states[before + 1, :n] - place) / step
    square, cube = (3 * mean - 2 * first - last) / step, (first + last - 2 * mean) / step**2
    there = ((cube * ahead + square) * ahead + first) * ahead + place
    return np.concatenate([there, (3 * cube * ahead + 2 * square) * ahead + first], axis=-1)


def energy(model: Model, state: np.ndarray) -> float:
    """Total energy of one state; along a family and in files it is this number.

    Args:
        model: the system.
        state: coordinates, then velocities (2n).

    Returns:
        E = T(q, v) + V(q) in J; nan where none exists.

    Raises:
        InputError: for a state of another length.

    Examples:
        >>> round(of.energy(pendulum, [0.1, 0.2, 0.0, 0.0]), 6)
        -19.428887

    See Also:
        `of.energies` for both parts along a motion.
    """
    x, n, p = check_state(model, state), model.degrees_of_freedom, model.parameter_values
    return float(model.kinetic(x[:n], x[n:], p)) + float(model.potential(x[:n], p))


def energies(model: Model, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic and potential energy along a motion.

    Args:
        model: the system.
        states: one state a row (k x 2n).

    Returns:
        Two arrays (k) in J.

    Raises:
        InputError: for states of another length.

    Examples:
        >>> kinetic, potential = of.energies(pendulum, orbit.samples)
        >>> bool(np.ptp(kinetic + potential) < 1e-10)
        True

    See Also:
        `of.energy` of one state.
    """
    x, n = check_states(model, states).T, model.degrees_of_freedom
    return model.along(model.kinetic, x[:n], x[n:]).ravel(), model.along(model.potential, x[:n]).ravel()


def positions(model: Model, states: np.ndarray, which: str = "points") -> np.ndarray:
    """Where joints or centres of mass are along a motion.

    Args:
        model: the system.
        states: one state a row (k x 2n).
        which: "points", what is drawn, the same in "space", or "centres" of mass.

    Returns:
        Positions (k, 2, m) in m, x down, y right; in space (k, 3, m), z towards the eye.

    Raises:
        InputError: for states of another length, and for a system without positions.

    Examples:
        >>> of.positions(pendulum, np.zeros((1, 4)))[0]
        array([[0., 1., 2.],
               [0., 0., 0.]])
    """
    if which not in ("points", "space", "centres"):
        raise InputError(f"which: must be 'points', 'space' or 'centres', got {which!r}")
    function: ca.Function | None = getattr(model, which)
    if function is None:
        raise InputError(f"this system declares no {which}; pass {which}= when you build it")
    rows = check_states(model, states)
    flat = model.along(function, rows.T[: model.degrees_of_freedom])
    return flat.reshape(len(flat), len(rows), -1).transpose(1, 0, 2)
