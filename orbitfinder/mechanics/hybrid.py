"""Hybrid systems: smooth modes, guards that end them, resets that begin the next.

All modes share one state x (d), its names and the parameters p; what a mode does not use stands still in it. Time does
not occur: a forcing is a clock among the states. In mode m the motion is that of its Model until a transition's guard
g(x, p) crosses 0 in its direction where `allowed` is positive; then x+ = R(x-, p).

Source: R. Goebel, R. Sanfelice, A. Teel, "Hybrid dynamical systems", IEEE Control Systems 29 (2009) 28-93; of impacts
B. Brogliato, Nonsmooth Mechanics (2016), section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder._runtime.notebook import brief
from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.controls import Limits, with_controls
from orbitfinder.mechanics.factorise import LinearBalances, eliminated
from orbitfinder.mechanics.first_order import Named, in_symbols
from orbitfinder.mechanics.model import PART_OF, Model, altered, inputs_of
from orbitfinder.records.orbit import SHARE
from orbitfinder.records.reading import Table

Expression = Callable[[Named, Named], Any]
"""(x, p) -> an expression of the state and the parameters, which have names: x.theta, p.slope"""


def changed(state: Named, /, **values: Any) -> Any:
    """The state with some of its components changed, by name."""
    for name in values:
        state[name]
    return ca.vertcat(*(values.get(name, state[name]) for name in state.names))


@dataclass(frozen=True)
class Transition:
    """From one mode to another where a guard crosses 0.

    Each expression is a function (x, p) of state and parameters by name; a built system has CasADi functions in their
    place.

    Args:
        name: by which the cycle names it.
        source: the mode that it ends.
        target: the mode that it begins.
        guard: what crosses 0.
        reset: gives the state after; the state itself if None.
        direction: -1 where the guard falls, +1 where it rises.
        allowed: crossings at which it is not positive are no events.
        ignored: why not; printed with every certificate.
        impulse: the normal impulse, which must not be negative.
        lost: the energy lost, J.
        advance: where the origin of what is drawn goes, (down, right) in m: of a walker its next foothold.
        slope: the guard's gradient (1 x d); made when the system is built.

    Examples:
        >>> touch = of.Transition("touch", "air", "ground", lambda x, p: x.y, direction=-1)
        >>> touch.source, touch.target
        ('air', 'ground')
    """

    __repr__ = brief("name", "source", "target")

    name: str
    source: str
    target: str
    guard: Any
    reset: Any = None
    direction: int = -1
    allowed: Any = None
    ignored: str = ""
    impulse: Any = None
    lost: Any = None
    advance: Any = None
    slope: Any = None


@dataclass(frozen=True)
class Mode:
    """A smooth mode of a hybrid system.

    Args:
        name: by which transitions name it.
        model: its equations.
        holds: expressions (x, p) that must not become negative in it, by name: a contact force, a height.

    Examples:
        >>> fall = of.ode(lambda t, x, p: [x.v, -9.8], ["y", "v"])
        >>> of.Mode("air", fall, {"height": lambda x, p: x.y})
        Mode(name='air')
    """

    __repr__ = brief("name")

    name: str
    model: Model
    holds: Table = None  # type: ignore[assignment]


@dataclass(frozen=True)
class Hybrid:
    """What makes a Model hybrid: its modes, its transitions, and the transitions of one period in their order.

    The cycle begins in the `source` of its first transition; arc k is the motion before transition k. An empty one is
    that of the guess's motion.
    """

    __repr__ = brief("cycle")

    modes: tuple[Mode, ...]
    transitions: tuple[Transition, ...]
    cycle: tuple[str, ...]
    given: tuple[tuple[Mode, ...], tuple[Transition, ...], tuple[str, ...]] = ((), (), ())
    """modes, transitions and what is conserved, as they were given"""
    ground: Any = None
    """(x, p) -> what the machine stands on or hits, a polyline (down, right; 2 x k, m); once built, of the modes' p"""

    def mode(self, name: str) -> Mode:
        """A mode by its name."""
        return next(mode for mode in self.modes if mode.name == name)

    def transition(self, name: str) -> Transition:
        """A transition by its name; `InputError` names the known ones."""
        transition = next((transition for transition in self.transitions if transition.name == name), None)
        if transition is None:
            known = [transition.name for transition in self.transitions]
            raise InputError(f"cycle: unknown transition {name!r}{closest(name, known)}; it has {', '.join(known)}")
        return transition

    def leaving(self, mode: str) -> tuple[Transition, ...]:
        """The transitions that end a mode."""
        return tuple(transition for transition in self.transitions if transition.source == mode)

    @property
    def first(self) -> Mode:
        """The mode in which a motion begins."""
        return self.mode(self.transition(self.cycle[0]).source) if self.cycle else self.modes[0]

    @property
    def arcs(self) -> tuple[tuple[Mode, Transition], ...]:
        """The modes of one period with the transitions that end them."""
        course = [self.transition(name) for name in self.cycle]
        return tuple((self.mode(transition.source), transition) for transition in course)

    def part(self, parts: int) -> tuple[tuple[Mode, Transition], ...]:
        """The arcs of the first of so many equal parts of a period."""
        return self.arcs[: len(self.cycle) // parts]

    @property
    def ignored(self) -> tuple[str, ...]:
        """What guards ignore on purpose."""
        return tuple(f"{each.name}: {each.ignored}" for each in self.transitions if each.allowed is not None)


@dataclass(frozen=True)
class Impact:
    """An impact of a mechanism: M (v+ - v-) = J^T P with J v+ = -e J v-, J the contact's Jacobian.

    Each is a function (x, p): `gap` (the first contact's), `after` (x+), `impulse` (P of the first, positive
    where it pushes), `lost` (energy, J).
    """

    __repr__ = brief()

    gap: Expression
    after: Expression
    impulse: Expression
    lost: Expression


def impact(model: Model, contact: Expression, restitution: float | Expression | Sequence[float] = 0.0) -> Impact:
    """The impact of a mechanism at contacts: M (v+ - v-) = J^T P with J v+ = -e J v-, J the contacts' Jacobian.

    Args:
        model: of coordinates and velocities.
        contact: (x, p) -> gaps in m, the first along the normal, others held (no slip).
        restitution: e of each row: 0 is plastic, 1 elastic; a number, one each or a function (x, p).

    Returns:
        `gap`, `after`, `impulse` and `lost` for a Transition, each a function (x, p).

    Raises:
        InputError: for gaps that depend on velocities or on no coordinate.

    Examples:
        >>> import casadi as ca
        >>> bob = of.chain(1)
        >>> wall = of.impact(bob, lambda x, p: 0.3 - ca.sin(x.theta1), 1.0)
        >>> hit = of.Transition("hit", "swing", "swing", wall.gap, wall.after, impulse=wall.impulse)
        >>> of.hybrid({"swing": bob}, [hit], ["hit"], conserved=["energy"]).conservative
        True
    """
    if model.constraint is not None or model.rates is not None:
        raise InputError("impact: needs a system of coordinates and velocities with a mass matrix; write the reset")

    n = model.degrees_of_freedom
    x, p, velocity = ca.SX.sym("x", 2 * n), ca.SX.sym("p", len(model.parameter_names)), ca.SX.sym("v", n)
    here = Named.of(model.state_names, x), Named.of(model.parameter_names, p)
    with in_symbols("contact"):
        gaps = ca.vertcat(*_listed(contact(*here)))
    wanted = restitution(*here) if callable(restitution) else restitution
    e = ca.vertcat(*wanted) if isinstance(wanted, Sequence) else ca.repmat(ca.SX(wanted), gaps.numel(), 1)
    if e.is_constant() and not np.all(np.isfinite(ca.DM(e).full())):
        raise InputError(f"restitution: must be finite, got {restitution}; 0 is plastic, 1 elastic")
    if ca.which_depends(gaps, x[n:]) != [False] * n or not ca.jacobian(gaps, x[:n]).nnz():
        raise InputError("contact: gaps are functions of the coordinates, and of no velocity; give the distance in m")
    if e.numel() != gaps.numel():
        raise InputError(f"restitution: {e.numel()} numbers for {gaps.numel()} contacts; give one, or one each")
    mass = ca.hessian(model.kinetic(x[:n], velocity, p), velocity)[0]
    jacobian = ca.jacobian(gaps, x[:n])
    balances = LinearBalances(mass, -mass @ x[n:], jacobian.T, jacobian, -e * (jacobian @ x[n:]))
    after = eliminated(balances, [x, p], True)(x, p)
    lost = model.kinetic(x[:n], x[n:], p) - model.kinetic(x[:n], after[:n], p)
    whole = ca.Function("impact", [x, p], [gaps[0], ca.vertcat(x[:n], after[:n]), after[n], lost])
    return Impact(*(lambda x, p, k=k: whole(ca.vertcat(*x), ca.vertcat(*p))[k] for k in range(4)))  # type: ignore[misc]


def _listed(value: Any) -> list[Any]:
    return list(value) if isinstance(value, (list, tuple)) else [value]


def hybrid(
    modes: Mapping[str, Model] | Sequence[Mode],
    transitions: Sequence[Transition],
    cycle: Sequence[str] | None = None,
    *,
    conserved: Sequence[str] = (),
    system: Table | None = None,
    ground: Expression | None = None,
    controls: Sequence[str] = (),
    limits: Limits | None = None,
) -> Model:
    """The Model of a hybrid system: smooth modes, and transitions between them.

    Its parameters are those of the modes and, for each arc but the last, its share of the period (`share_1`, ...),
    which solvers find.

    Args:
        modes: by name, or as Modes; all with the same states and parameters. The motion begins in the first.
        transitions: what ends a mode and begins the next.
        cycle: names of the transitions of one period, in order; None: those of the guess's motion.
        conserved: names of invariants of all modes that the resets keep too.
        system: a description from which files rebuild the Model.
        ground: (x, p) -> what it stands on or hits, a polyline (2 x k, m); drawn only.
        controls: parameters that may vary in time, beside the controls of a mode.
        limits: of the controls, as for `of.lagrange`.

    Returns:
        A Model.

    Raises:
        InputError: where modes differ in states or parameters, or the cycle does not fit together.

    Examples:
        >>> level = {"energy": lambda x, p: x.v**2 / 2 + 9.8 * x.y}
        >>> fall = of.ode(lambda t, x, p: [x.v, -9.8], ["y", "v"], invariants=level)
        >>> bounce = of.Transition("bounce", "air", "air", lambda x, p: x.y, lambda x, p: [x.y, -x.v])
        >>> ball = of.hybrid({"air": fall}, [bounce], ["bounce"], conserved=["energy"])
        >>> hop = of.find_orbit(of.Problem(ball, of.Guess([0.0, 4.9], 1.0), pin=of.pin(energy=12.005)))
        >>> round(hop.period, 9), hop.certificate.passed
        (1.0, True)

    See Also:
        `of.impact` makes guard and reset of a mechanism that hits something.
    """
    named = tuple(Mode(name, model) for name, model in modes.items()) if isinstance(modes, Mapping) else tuple(modes)
    _check_modes(named)
    named = tuple(replace(mode, model=_conserving(mode, conserved)) for mode in named)
    first = named[0].model
    for name in (name for name in first.parameter_names if name.startswith(SHARE)):
        raise InputError(f"modes: a parameter {name!r} is the share of an arc in the period; choose another name")
    cycle = tuple(cycle or ())
    parts = Hybrid(named, tuple(transitions), cycle)
    _check_cycle(parts)
    count = max(1, len(cycle))
    names = (*first.parameter_names, *(f"{SHARE}{k + 1}" for k in range(count - 1)))
    values = np.concatenate([first.parameter_values, np.full(count - 1, 1.0 / count)])
    begins = parts.first.model
    whole = altered(begins, parameter_names=names, parameter_values=values)
    drawn = None
    if ground is not None:
        x, p = ca.SX.sym("x", len(first.state_names)), ca.SX.sym("p", len(first.parameter_names))
        heights = ground(Named.of(first.state_names, x), Named.of(first.parameter_names, p))
        drawn = ca.Function("ground", [x, p], [ca.densify(ca.SX(heights))])
    built = Hybrid(
        tuple(_mode(mode, whole) for mode in named), tuple(_transition(each, whole) for each in transitions), cycle,
        (named, tuple(transitions), tuple(conserved)), drawn,
    )  # fmt: skip
    words = {key: told for key, told in first.system.items() if key == "units"}
    model = altered(
        built.first.model, parameter_names=names, parameter_values=values, hybrid=built,
        system=words | dict(system or {"kind": "custom"}),
    )  # fmt: skip
    named_too = dict.fromkeys([*controls, *(name for mode in named for name in mode.model.controls)])
    given = {name: pair for mode in named for name, pair in mode.model.limits.items()}
    return with_controls(model, tuple(named_too), given | dict(limits or {}))


def with_cycle(model: Model, cycle: Sequence[str]) -> Model:
    """The same hybrid system at the same values of its parameters, its orbits going through another cycle.

    Raises `InputError` for a system that is not hybrid, or a cycle that it cannot go through.
    """
    if model.smooth:
        raise InputError("cycle: the system is not hybrid, its motion has no events; leave the cycle out")
    if tuple(cycle) == model.cycle:
        return model
    modes, transitions, conserved = model.hybrid.given
    made = hybrid(modes, transitions, cycle, conserved=conserved, system=dict(model.system) | {"cycle": list(cycle)})
    kept = len(modes[0].model.parameter_names)
    numbers = np.append(model.parameter_values[:kept], made.parameter_values[kept:])
    built = replace(made.hybrid, ground=model.hybrid.ground)
    controls = {"controls": model.controls, "limits": model.limits}
    return altered(made, parameter_values=numbers, hybrid=at_numbers(built, numbers), **controls)  # type: ignore[arg-type]


def as_recorded(model: Model, system: Table) -> Model:
    """The same system, a hybrid one with the cycle that the description of an orbit names."""
    return with_cycle(model, system["cycle"]) if not model.smooth and "cycle" in system else model


def section_of(model: Model, transition: Transition) -> ca.Function:
    """(x-, p) -> x+ after a transition; what must be as it is there, its guard and what is conserved at x+; and the
    derivatives of both by x-."""
    symbol = ca.SX.sym if all(each.is_a("SXFunction") for each in (transition.guard, transition.reset)) else ca.MX.sym
    x, p, n = symbol("x", len(model.state_names)), symbol("p", len(model.parameter_names)), model.degrees_of_freedom
    after = transition.reset(x, p)
    held = ca.vertcat(transition.guard(x, p), *(each.value(after[:n], after[n:], p) for each in model.invariants))
    slopes = [ca.densify(ca.jacobian(each, x)) for each in (after, held)]
    return ca.Function("section", [x, p], [after, held, *slopes])


def repeated(model: Model, times: int) -> Model:
    """The same system, the cycle of a hybrid one gone through so many times."""
    return model if model.smooth else with_cycle(model, model.cycle * times)


def _conserving(mode: Mode, names: Sequence[str]) -> Model:
    """The mode's Model with those invariants only that the whole cycle keeps."""
    invariants = {invariant.name: invariant for invariant in mode.model.invariants}
    for name in names:
        if name not in invariants:
            raise InputError(
                f"conserved: mode {mode.name} does not conserve {name!r}{closest(name, invariants)}; it conserves "
                f"{', '.join(invariants) or 'nothing'}"
            )
    return altered(mode.model, invariants=tuple(invariants[name] for name in names))


def at_numbers(parts: Hybrid | None, numbers: np.ndarray) -> Hybrid | None:
    """The same modes at other values of the parameters."""
    if parts is None:
        return None
    modes = (replace(mode, model=altered(mode.model, parameter_values=numbers)) for mode in parts.modes)
    return replace(parts, modes=tuple(modes))


def saltation(before: Model, transition: Transition, after: Model | None) -> ca.Function:
    """(x-, p) -> S = DR + (f+ - DR f-) grad g / (grad g . f-) of a transition between two modes; without the one after
    it f+ = 0, and deviations after the event, whenever it was, come from those before it at a time."""
    x, p = ca.MX.sym("x", len(before.state_names)), ca.MX.sym("p", len(before.parameter_names))
    reset, slope, late = transition.reset(x, p), transition.slope(x, p), before.rate(0.0, x, p)
    by_x = ca.jacobian(reset, x)
    turn = (0.0 if after is None else after.rate(0.0, reset, p)) - by_x @ late
    return ca.Function("saltation", [x, p], [ca.densify(by_x + turn @ slope / (slope @ late))])


def freed(model: Model, free: tuple[str, ...], parts: int = 1) -> tuple[str, ...]:
    """Freed parameters, and of a hybrid system the shares of all arcs but the last in the first of so many `parts`."""
    count = 0 if model.smooth else len(model.hybrid.part(parts)) - 1
    shares = (f"{SHARE}{k + 1}" for k in range(count))
    return (*free, *(name for name in shares if name not in free))


def share(model: Model, arc: int, p: Any, parts: int = 1) -> Any:
    """The share of the period that an arc of the first of so many equal `parts` of it takes; a smooth one is an arc."""
    if model.smooth:
        return 1 / parts
    count, first = len(model.hybrid.part(parts)), len(model.parameter_names) - (len(model.cycle) - 1)
    shares = p[first : first + count - 1]
    return shares[arc] if arc < count - 1 else 1 / parts - ca.sum1(shares) if count > 1 else 1 / parts


def _mode(mode: Mode, whole: Model) -> Mode:
    """A mode whose functions take the whole system's parameters."""
    kept = len(mode.model.parameter_names)
    model = altered(
        widened(mode.model, len(whole.parameter_names), kept),
        parameter_names=whole.parameter_names,
        parameter_values=whole.parameter_values,
    )
    told = f"mode {mode.name}: holds"
    held = {name: _number("holds", holds, model, f"{told} {name!r}") for name, holds in (mode.holds or {}).items()}
    return Mode(mode.name, model, held)


def widened(model: Model, count: int, kept: int) -> Model:
    """A Model whose functions take `count` parameters and use the first `kept`."""
    if count == kept:
        return model

    def wide(function: ca.Function | None) -> ca.Function | None:
        if function is None:
            return None
        symbols = inputs_of(function)
        more = type(symbols[0]).sym("p", count)
        return ca.Function(function.name(), [*symbols[:-1], more], function.call([*symbols[:-1], more[:kept]]))

    fields = {name: getattr(model, name) for name in PART_OF}
    functions = {name: wide(value) for name, value in fields.items() if isinstance(value, ca.Function)}
    invariants = tuple(
        replace(each, **{name: wide(getattr(each, name)) for name in ("value", "unfolding", "generator")})  # type: ignore[arg-type]
        for each in model.invariants
    )
    return altered(model, **functions, invariants=invariants)  # type: ignore[arg-type]


def _transition(transition: Transition, model: Model) -> Transition:
    told = f"transition {transition.name}"
    guard = _number("guard", transition.guard, model, f"{told}: guard")
    reset = _function("reset", transition.reset or (lambda x, _: ca.vertcat(*x)), model, f"{told}: reset")
    if not guard.jac_sparsity(0, 0).nnz():
        raise InputError(f"{told}: guard does not change with the state and is never crossed; name a state")
    size = len(model.state_names)
    if reset.size_out(0) != (size, 1):
        raise InputError(f"{told}: reset gives {reset.numel_out(0)} numbers for {size} states; give all")
    made = dict[str, Any]()
    for name in ("allowed", "impulse", "lost", "advance"):
        given, kind = getattr(transition, name), _function if name == "advance" else _number
        made[name] = None if given is None else kind(name, given, model, f"{told}: {name}")
    return replace(transition, guard=guard, reset=reset, slope=gradient(guard), **made)  # type: ignore[arg-type]


def gradient(guard: ca.Function) -> ca.Function:
    """Its derivative (1 x d) by the state, a function of (x, p) too."""
    x, p = (guard.sx_in if guard.is_a("SXFunction") else guard.mx_in)()
    return ca.Function("slope", [x, p], [ca.densify(ca.jacobian(guard(x, p), x))])


def _function(name: str, expression: Expression, model: Model, told: str) -> ca.Function:
    """A CasADi function of (x, p), of SX where it can be: its derivatives are then cheapest; `told` to the user."""

    def made(symbol: Any) -> ca.Function:
        x, p = symbol("x", len(model.state_names)), symbol("p", len(model.parameter_names))
        own = [name for name in model.parameter_names if not name.startswith(SHARE)]
        value = expression(Named.of(model.state_names, x), Named.of(own, p))
        return ca.Function(name, [x, p], [ca.densify(type(x)(ca.vertcat(*_listed(value))))])

    if isinstance(expression, ca.Function):
        return expression
    with in_symbols(told):
        try:
            return made(model.symbol)
        except NotImplementedError:  # it calls functions of matrices
            return made(ca.MX.sym)


def _number(name: str, expression: Expression, model: Model, told: str) -> ca.Function:
    """The same of what is a single number."""
    function = _function(name, expression, model, told)
    if function.numel_out(0) != 1:
        raise InputError(f"{told} gives {function.numel_out(0)} numbers; give one")
    return function


def _check_modes(modes: Sequence[Mode]) -> None:
    if not modes:
        raise InputError("modes: none given; give at least one, {name: Model}")
    _check_once("modes", [mode.name for mode in modes])
    first = modes[0].model
    for mode in modes:
        if mode.holds is not None and not isinstance(mode.holds, Mapping):
            raise InputError(f"modes: holds of {mode.name}: expected names with a function each, got {mode.holds!r}")
        if not mode.model.smooth:
            raise InputError(f"modes: {mode.name} is a hybrid system itself; give its modes and transitions")
        if mode.model.state_names != first.state_names:
            raise InputError(
                f"modes: {mode.name} has states {', '.join(mode.model.state_names)}, {modes[0].name} has "
                f"{', '.join(first.state_names)}; give all modes the same, what a mode does not use stands still"
            )
        if mode.model.parameter_names != first.parameter_names or not np.array_equal(
            mode.model.parameter_values, first.parameter_values
        ):
            raise InputError(f"modes: {mode.name} and {modes[0].name} differ in parameters; give all modes the same")
        if mode.model.forced or (mode.model.rates or mode.model.acceleration).jac_sparsity(0, 0).nnz():
            raise InputError(f"modes: {mode.name} depends on time; make the clock a state (an angle with a rate of 1)")


def _check_once(what: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{what}: {name!r} names two of them; give each its own name")


def _check_cycle(parts: Hybrid) -> None:
    names = [mode.name for mode in parts.modes]
    for each in parts.transitions:
        if not isinstance(each, Transition):
            raise InputError(f"transitions: expected a list, each a Transition, got {each!r}")
    _check_once("transitions", [transition.name for transition in parts.transitions])
    for transition in parts.transitions:
        told = f"transition {transition.name}"
        for which in (transition.source, transition.target):
            if which not in names:
                raise InputError(f"{told}: unknown mode {which!r}{closest(which, names)}")
        if transition.direction not in (-1, 1):
            raise InputError(f"{told}: direction must be -1 (falling) or 1 (rising), got {transition.direction}")
        if transition.allowed is not None and not transition.ignored:
            raise InputError(f"{told}: ignored must say in words what `allowed` leaves out on purpose")
    course = [parts.transition(name) for name in parts.cycle]
    for before, following in zip(course, [*course[1:], *course[:1]], strict=True):
        if before.target != following.source:
            raise InputError(
                f"cycle: {before.name} leads to {before.target}, {following.name} starts from {following.source}; they "
                "do not follow each other"
            )
