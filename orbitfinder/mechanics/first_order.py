"""First-order systems x' = f(t, x, p) and Hamilton's equations, from Python functions of CasADi symbols."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from itertools import count
from re import sub
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.arguments import checked
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.conserved import VANISHES, discrepancy, linear_invariants
from orbitfinder.mechanics.controls import Limits, with_controls
from orbitfinder.mechanics.lagrange import mirrors, strangers
from orbitfinder.mechanics.model import Dynamics, Invariant, Mechanics, Model, Structure, altered, finite_number
from orbitfinder.mechanics.scales import NEUTRAL, with_units

Field = Callable[[Any, "Named", "Named"], Any]
"""(t, x, p) -> x'"""
Scalar = Callable[["Named", "Named"], Any]
"""(x, p) -> a number"""
TAKEN = ("energy", "period")


class Named(tuple[Any, ...]):
    """Symbols in order, which are found by their names too: x[0], x["V"], x.V, and V, m = x."""

    names: tuple[str, ...]

    @classmethod
    def of(cls, names: Sequence[str], column: Any) -> Named:
        """The entries of a column of symbols under these names."""
        made = cls(column[i] for i in range(len(names)))
        made.names = tuple(names)
        return made

    def __getitem__(self, key: Any) -> Any:
        """An entry by its number or its name."""
        if isinstance(key, str):
            if key not in self.names:
                known = ", ".join(self.names) or "none"
                raise InputError(f"field: unknown name {key!r}{closest(key, self.names)}; known are {known}")
            key = self.names.index(key)
        return super().__getitem__(key)

    def __getattr__(self, name: str) -> Any:
        """An entry by its name."""
        if name.startswith("__") or name == "names":
            raise AttributeError(name)
        return self[name]


@contextmanager
def in_symbols(name: str) -> Iterator[None]:
    """Where a function of the user's is called with symbols: what goes wrong in it is an `InputError` of that name."""
    try:
        yield
    except InputError as error:
        raise InputError(sub("^field(?=: unknown name)", name, str(error))) from error
    except (TypeError, IndexError, NotImplementedError, AttributeError, RuntimeError) as error:
        said = sub(r"^.*\.cpp:\d+: ", "", (str(error).strip() or type(error).__name__).splitlines()[0]).rstrip(".")
        hint = (
            "casadi.if_else takes the place of an if" if "truth value" in said else "write it with casadi's functions"
        )
        raise InputError(
            f"{name}: cannot be made of CasADi symbols ({said}); {hint}, and check its arguments"
        ) from error


@checked
def ode(
    field: Field,
    states: Sequence[str],
    parameters: Mapping[str, float] | None = None,
    *,
    invariants: Mapping[str, Scalar] | Sequence[Invariant] = (),
    angles: Sequence[str] = (),
    forcing_period: Callable[[Named], Any] | float | None = None,
    symmetries: Mapping[str, tuple[int, Mapping[str, int]]] | None = None,
    system: Mapping[str, Any] | None = None,
    points: Callable[[Named, Named], Any] | None = None,
    controls: Sequence[str] = (),
    limits: Limits | None = None,
    units: Mapping[str, str] | None = None,
    find_invariants: bool = True,
) -> Model:
    """The Model of a first-order system x' = f(t, x, p).

    Args:
        field: function (t, x, p) that makes the components of x' of CasADi symbols; x and p have the names of
            `states` and of `parameters`: `x.V`, `x[0]`, `p.sigma`.
        states: names of the components (d).
        parameters: physical parameters with their values.
        invariants: first integrals {name: I(x, p)}, each checked by `of.find_orbit`. An orbit is unfolded by x' = f +
            s grad I, and the first of them is the energy that files and atlases speak of.
        angles: components that may turn.
        forcing_period: of an explicit dependence on time, a number or a function of the parameters.
        symmetries: {name: (sense of time, {component: -1})}.
        system: a description from which files rebuild the Model.
        points: function (x, p) of positions (down, right; 2 x k, m) that pictures join by lines.
        controls: parameters that may vary in time.
        limits: of the controls: greatest magnitude, or lowest and highest, by name.
        units: words for time, length, mass, angle, or a state or parameter by name ("ms", "mV"); nothing is converted.
        find_invariants: whether linear ones, c.x with c.f = 0 for all t, x and p, are searched for; their names are
            total_1, ...

    Returns:
        A Model with `rates`; its velocities are empty.

    Raises:
        InputError: for a field that gives another number of components or uses unknown names.

    Examples:
        >>> clock = of.ode(lambda t, x, p: [x.v, p.mu * (1 - x.u**2) * x.v - x.u], ["u", "v"], {"mu": 1.0})
        >>> cycle = of.find_orbit(of.Problem(clock, of.Guess([2.0, 0.0], 6.7)))
        >>> round(cycle.period, 9)
        6.663286859

    See Also:
        `of.hamiltonian` for Hamilton's equations, `of.lagrange` for mechanics.
    """
    values = _parameters(parameters)
    symbols = _Symbols(states, values)
    with in_symbols("field"):
        rates = field(symbols.t, symbols.x, symbols.p)
        parts = ca.vertsplit(ca.vec(rates)) if isinstance(rates, ca.SX) else list(rates)
    if len(parts) != len(symbols.names):
        raise InputError(f"field: {len(parts)} rates for {len(symbols.names)} states; give one each, in their order")
    rate = ca.vertcat(*(_scalar(f"field: {name}", part) for name, part in zip(symbols.names, parts, strict=True)))
    _check_rates(rate, symbols, forcing_period)
    integrals = invariants
    if isinstance(integrals, Mapping):
        integrals = [symbols.invariant(name, _expression(name, scalar, symbols)) for name, scalar in integrals.items()]
    taken = [*states, *values, *(each.name for each in integrals)]
    free = (name for k in count(1) if (name := f"total_{k}") not in taken)
    for row in linear_invariants([symbols.t, symbols.column, symbols.numbers], rate) if find_invariants else ():
        total = symbols.invariant(name := next(free), ca.dot(ca.DM(row), symbols.column))
        with suppress(InputError):  # of a sum of others
            _check_independent([*integrals, total], symbols)
            integrals = [*integrals, total]
            terms = (state if k == 1 else f"{k}*{state}" for k, state in zip(row, states, strict=True) if k)
            text = " + ".join(terms).replace("+ -", "- ")
            system = system and {**system, "invariants": {**system.get("invariants", {}), name: text}}
    made = with_controls(_model(rate, symbols, integrals, angles, forcing_period, symmetries, system), controls, limits)
    made = with_units(made, units)
    return made if points is None else altered(made, points=symbols.positions(points))


@checked
def hamiltonian(
    energy: Callable[..., Any],
    coordinates: Sequence[str],
    momenta: Sequence[str],
    parameters: Mapping[str, float] | None = None,
    *,
    invariants: Mapping[str, Scalar] | None = None,
    angles: Sequence[str] = (),
    forcing_period: Callable[[Named], Any] | float | None = None,
    symmetries: Mapping[str, tuple[int, Mapping[str, int]]] | None = None,
    system: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
) -> Model:
    """The Model of Hamilton's equations q' = dH/dp, p' = -dH/dq, with the state x = (q, p).

    H is an invariant, as are the given ones that commute with it: each is unfolded by grad I and belongs to the
    symmetry J grad I. Source: V. I. Arnold, Mathematical Methods of Classical Mechanics, section 38.

    Args:
        energy: function (x, c) that makes H of the coordinates and momenta, x, and the parameters, c, both by name;
            of a forced system (t, x, c).
        coordinates: names of q (n).
        momenta: names of p (n).
        parameters: physical parameters with their values.
        invariants: further first integrals {name: I(x, c)} that commute with H.
        angles: components that may turn.
        forcing_period: of an explicit dependence on time, a number or a function of the parameters.
        symmetries: {name: (sense of time, {component: -1})}.
        system: a description from which files rebuild the Model.
        units: words for time, length, mass, angle, or a state or parameter by name ("ms", "mV"); nothing is converted.

    Returns:
        A Model with `rates`, `hamiltonian` true.

    Raises:
        InputError: for an energy that is no scalar or uses unknown names.

    Examples:
        >>> well = of.hamiltonian(lambda x, c: x.p**2 / 2 + x.q**4 / 4, ["q"], ["p"])
        >>> of.energy(well, [1.0, 0.0])
        0.25
    """
    if len(coordinates) != len(momenta) or not coordinates:
        raise InputError(f"momenta: {len(momenta)} names for {len(coordinates)} coordinates; give one each")
    symbols = _Symbols([*coordinates, *momenta], _parameters(parameters))
    given = (symbols.x, symbols.p) if forcing_period is None else (symbols.t, symbols.x, symbols.p)
    with in_symbols("energy"):
        level = _scalar("energy", energy(*given))
    rate = symbols.turned(level)
    _check_rates(rate, symbols, forcing_period)
    integrals = [] if forcing_period is not None else [symbols.invariant("energy", level)]
    for name, scalar in (invariants or {}).items():
        expression = _expression(name, scalar, symbols)
        terms, turns = (ca.gradient(expression, symbols.column) * rate).T, name in (system or {}).get("symmetries", {})
        at = [symbols.t, symbols.column, symbols.numbers]
        if off := discrepancy(at, terms, [*symbols.values.values()], 0.1 * turns):
            raise InputError(f"{'symmetries' if turns else 'invariants'}: {name!r} is not conserved, it changes at the "
                             f"rate {off}; correct it, or leave it out")  # fmt: skip
        integrals.append(symbols.invariant(name, expression, symbols.turned(expression)))
    return with_units(_model(rate, symbols, integrals, angles, forcing_period, symmetries, system, level), units)


class _Symbols:
    """The symbols t, x (d), p (k) that a system is written in, and an empty v."""

    def __init__(self, states: Sequence[str], values: Mapping[str, float]) -> None:
        self.names, self.values = tuple(states), dict(values)
        if not self.names or isinstance(states, str):
            raise InputError("states: give the names of the components, such as ('x', 'y', 'z')")
        everything = [*self.names, *self.values, *TAKEN]
        twice = sorted({name for name in everything if everything.count(name) > 1})
        if twice:
            listed = ", ".join(map(repr, twice))
            raise InputError(f"states, parameters: {listed} would name two things (energy and period are taken)")
        self.t, self.column, self.v = ca.SX.sym("t"), ca.SX.sym("x", len(self.names)), ca.SX.sym("v", 0)
        self.numbers = ca.SX.sym("p", len(self.values))
        self.x, self.p = Named.of(self.names, self.column), Named.of(tuple(self.values), self.numbers)

    def turned(self, expression: ca.SX) -> ca.SX:
        """J grad of an expression in (q, p): the motion that it generates."""
        slope, half = ca.gradient(expression, self.column), len(self.names) // 2
        return ca.densify(ca.vertcat(slope[half:], -slope[:half]))

    def function(self, name: str, expression: ca.SX, *, timed: bool = False) -> ca.Function:
        """(q, v, p) -> an expression, or (t, q, v, p) -> it."""
        inputs = [self.column, self.v, self.numbers]
        return ca.Function(name, [self.t, *inputs] if timed else inputs, [expression])

    def positions(self, points: Callable[[Named, Named], Any]) -> ca.Function:
        """(x, p) -> what is drawn. Raises `InputError`."""
        places = ca.SX(points(self.x, self.p))
        if places.shape[0] != 2:
            raise InputError(f"points: shape {places.shape}; give (down, right) in m of each point, 2 x k")
        return ca.Function("points", [self.column, self.numbers], [ca.densify(places)])

    def invariant(self, name: str, expression: ca.SX, generator: ca.SX | None = None) -> Invariant:
        """A first integral, unfolded by its gradient."""
        slope = ca.densify(ca.gradient(expression, self.column))
        return Invariant(
            name,
            self.function("value", expression),
            self.function("unfolding", slope),
            None if generator is None else self.function("generator", generator),
            ca.is_linear(expression, self.column),
        )

    def foreign(self, expression: ca.SX) -> str:
        """Names of what an expression depends on beside t, x and p, joined."""
        return ", ".join(strangers(expression, [self.t, self.column, self.numbers]))


def _model(
    rate: ca.SX,
    symbols: _Symbols,
    invariants: Iterable[Invariant],
    angles: Sequence[str],
    forcing_period: Any,
    symmetries: Mapping[str, tuple[int, Mapping[str, int]]] | None,
    system: Mapping[str, Any] | None,
    level: ca.SX | None = None,
) -> Model:
    """The Model of checked rates; `level` is the Hamiltonian that they come from, if they do."""
    if strange := [name for name in angles if name not in symbols.names]:
        raise InputError(f"angles: {strange[0]!r} is no component{closest(strange[0], symbols.names)}")
    invariants = tuple(invariants)
    _check_independent(invariants, symbols)
    first = next((invariant for invariant in invariants if invariant.generator is None), None)
    energy = ca.SX(np.nan) if first is None else first.value(symbols.column, symbols.v, symbols.numbers)
    if level is not None:
        energy = ca.substitute(level, symbols.t, ca.SX(0))
    clock = None
    if forcing_period is not None:
        period = _scalar("forcing_period", forcing_period(symbols.p) if callable(forcing_period) else forcing_period)
        if ca.depends_on(period, ca.vertcat(symbols.t, symbols.column)) or symbols.foreign(period):
            raise InputError("forcing_period: may depend on the parameters only")
        clock = ca.Function("forcing_period", [symbols.numbers], [period])
    return Model(
        dict(system or {"kind": "custom", "units": NEUTRAL}),
        Dynamics(
            symbols.names, tuple(symbols.values), np.array(list(symbols.values.values()), float),
            symbols.function("acceleration", ca.SX(0, 1), timed=True),
            ca.Function("rates", [symbols.t, symbols.column, symbols.numbers], [ca.densify(rate)]), level is not None,
            clock,
        ),
        Mechanics(
            symbols.function("kinetic", ca.SX(0)),
            ca.Function("potential", [symbols.column, symbols.numbers], [energy]),
        ),
        Structure(
            invariants, mirrors(symmetries or {}, symbols.names), tuple(name in angles for name in symbols.names)
        ),
    )  # fmt: skip


def _parameters(given: Mapping[str, float] | None) -> dict[str, float]:
    return {name: finite_number(f"parameters.{name}", value) for name, value in (given or {}).items()}


def _scalar(name: str, value: Any) -> ca.SX:
    try:
        expression = ca.SX(value)
    except (NotImplementedError, TypeError) as error:
        raise InputError(f"{name}: expected an expression of CasADi symbols, got {type(value).__name__}") from error
    if expression.numel() != 1:
        raise InputError(f"{name}: expected one number, got shape {expression.shape}")
    return expression


def _expression(name: str, scalar: Scalar, symbols: _Symbols) -> ca.SX:
    """An invariant's expression. Raises `InputError`."""
    if name in (*symbols.names, *symbols.values, "period"):
        raise InputError(f"invariants: {name!r} names something else too; give another name")
    with in_symbols(f"invariants: {name}"):
        value = _scalar(f"invariants: {name}", scalar(symbols.x, symbols.p))
    if stray := symbols.foreign(value):
        raise InputError(f"invariants: {name} depends on {stray}; it may depend on x and p only")
    return value


def _check_rates(rate: ca.SX, symbols: _Symbols, forcing_period: Any) -> None:
    if stray := symbols.foreign(rate):
        raise InputError(f"field: depends on {stray}; it may depend on t, x and p only")
    if forcing_period is None and ca.depends_on(rate, symbols.t):
        raise InputError("field: depends on time; give the period of that, forcing_period=")


def _check_independent(invariants: Sequence[Invariant], symbols: _Symbols) -> None:
    """`InputError` where an invariant is a function of those before it: at no seeded state a gradient of its own."""
    random, values = np.random.default_rng(0), np.array(list(symbols.values.values()), float)
    inputs = (symbols.column, symbols.v, symbols.numbers)
    rows = [ca.gradient(invariant.value(*inputs), symbols.column) for invariant in invariants]
    slopes = ca.Function("slopes", inputs[::2], [ca.densify(ca.horzcat(ca.SX(len(symbols.names), 0), *rows))])
    matrices = [slopes(x, values).full() for x in random.normal(size=(4, len(symbols.names)))]
    units = []  # components, then gradients, of size 1: whatever units both have
    for each in filter(lambda each: np.all(np.isfinite(each)), matrices):
        rows = each / nonzero(np.abs(each).max(axis=1, initial=0.0, keepdims=True))
        units.append(rows / nonzero(np.linalg.norm(rows, axis=0)))
    for k, invariant in enumerate(invariants, start=1):
        if units and all(np.linalg.matrix_rank(each[:, :k], VANISHES) < k for each in units):
            before = f"a function of {', '.join(each.name for each in invariants[: k - 1])}" if k > 1 else "a constant"
            raise InputError(f"invariants: {invariant.name!r} is {before} and says nothing more; leave it out")
