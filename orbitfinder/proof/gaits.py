"""Orbits with impacts proved: Krawczyk's operator on arcs of the flow that end where a guard is zero.

With phi the flow of an arc's mode, g the guard and R the reset of the transition that ends it, the unknowns are the
first states x_k and the durations tau_k of the arcs of a period, and the equations

    g_k(phi_tau_k(x_k)) = 0,    R_k(phi_tau_k(x_k)) = x_{k+1},    x_K = x_0.

A zero is a motion of the automaton if no guard fires before (`GuardedCycle.fault`), and its multipliers are those of
the product of DR (1 - f Dg / Dg f) Phi. Source of that matrix: M. A. Aizerman, F. R. Gantmakher, Quarterly Journal of
Mechanics and Applied Mathematics 11 (1958) 385-398.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca

from orbitfinder.errors import InputError, plural
from orbitfinder.loops.symmetry import ALONE
from orbitfinder.mechanics.hybrid import Mode, Transition
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import (
    Vector,
    arb,
    arb_mat,
    between,
    block,
    column,
    decimal,
    dense,
    exact,
    floats,
    identity,
    inside,
    midpoints,
)
from orbitfinder.proof.enclosure import TaylorSettings, Tube, cloud, integrate
from orbitfinder.proof.field import Field, make_field, sloped, with_slopes
from orbitfinder.proof.formulation import Formulation
from orbitfinder.proof.krawczyk import (
    MOST_ITERATIONS,
    ROUGH,
    Krawczyk,
    TheoremEquations,
    approximate_inverse,
    contracted,
    corrected,
    flow,
)
from orbitfinder.proof.program import ScalarProgram, derived
from orbitfinder.proof.series import BALLS, recurrence
from orbitfinder.proof.trajectory import PIECES, Stability, stability
from orbitfinder.records.orbit import SHARE, Orbit


@dataclass(frozen=True)
class Passed:
    """An arc of the motion from a box: its end from the centre and from the box (d each), derivatives, steps."""

    centre: Vector
    end: Vector
    derivatives: Any
    steps: list[Tube]


class GuardedArc:
    """A mode of an automaton with the transition that ends it, as programs in the state and the parameters."""

    def __init__(
        self, mode: Mode, transition: Transition, leaving: Sequence[Transition], given: Mapping[int, Any] | None = None
    ) -> None:
        self.mode, self.transition, self.leaving = mode, transition, tuple(leaving)
        self.field = make_field(mode.model, None, given)
        d, p = len(mode.model.state_names), ca.SX.sym("p", len(mode.model.parameter_values))
        x, self.size = ca.SX.sym("x", d), d

        def with_slopes(function: Any) -> ScalarProgram:
            value = ca.densify(function(x, p))
            return derived("event", [x, p], value, sloped(x))

        self.guards = {each.name: with_slopes(each.guard) for each in self.leaving}
        self.allowed = {each.name: with_slopes(each.allowed) for each in self.leaving if each.allowed is not None}
        self.reset = with_slopes(transition.reset if transition.reset is not None else lambda x, p: x)
        self.holds = {name: with_slopes(function) for name, function in (mode.holds or {}).items()}
        if transition.impulse is not None:
            self.impulse = with_slopes(transition.impulse)
        form = Formulation(ALONE, d, 1, (0,) * d, (0,) * d, conserved=False)
        self.equations = TheoremEquations(self.field, form, None)

    def value(self, code: ScalarProgram, x: Vector) -> tuple[Vector, Any]:
        """An event's function of the state and its slopes."""
        rows, slopes = code.run([x, self.field.parameters], BALLS)
        return [rows[i] for i in range(len(rows))], dense(slopes, len(rows), self.size)

    def rate(self, x: Vector) -> Any:
        """The field at a state, a column."""
        return arb_mat([[value] for value in self.field.rates([*x, arb(0), arb(1)])[: self.size]])

    def passed(self, box: Vector, centre: Vector, settings: TaylorSettings) -> Passed:
        """The motion from a box (x, tau) about its centre."""
        node, point = ([*part[:-1], arb(0), part[-1]] for part in (box, centre))
        end, steps = integrate(self.field, cloud(node, point), settings)
        return Passed(end.point[: self.size], end.hull[: self.size], end.derivatives, steps)

    def slopes(self, end: Vector, derivatives: Any) -> Any:
        """Of guard and reset at the end (1 + d), by (x, tau)."""
        d, values = self.size, derivatives.entries()
        moved = arb_mat([[*values[i * (d + 2) : i * (d + 2) + d], values[i * (d + 2) + d + 1]] for i in range(d)])
        guard, reset = (self.value(code, end)[1] for code in (self.guards[self.transition.name], self.reset))
        return arb_mat([*(guard * moved).tolist(), *(reset * moved).tolist()])

    def rows(self, end: Vector) -> Vector:
        """The guard and the state after the reset."""
        return [*self.value(self.guards[self.transition.name], end)[0], *self.value(self.reset, end)[0]]


@dataclass(frozen=True)
class GuardedCycle:
    """The arcs of a period and what is solved for them."""

    arcs: tuple[GuardedArc, ...]

    @cached_property
    def size(self) -> int:
        """Unknowns of an arc."""
        return self.arcs[0].size + 1

    def parts(self, unknowns: Vector) -> list[Vector]:
        """(x, tau) of each arc."""
        return [unknowns[k * self.size : (k + 1) * self.size] for k in range(len(self.arcs))]

    def residual(self, unknowns: Vector, ends: Sequence[Vector]) -> Vector:
        """F from the arcs' ends."""
        parts, rows = self.parts(unknowns), list[Any]()
        for k, (arc, end) in enumerate(zip(self.arcs, ends, strict=True)):
            guard, *after = arc.rows(end)
            rows += [guard, *(a - b for a, b in zip(after, parts[(k + 1) % len(parts)], strict=False))]
        return rows

    def jacobian(self, ends: Sequence[Vector], derivatives: Sequence[Any]) -> Any:
        """DF from the arcs' ends over a box and their derivatives."""
        size, count = self.size, len(self.arcs)
        rows = [[arb(0)] * (size * count) for _ in range(size * count)]
        for k, (arc, end, matrix) in enumerate(zip(self.arcs, ends, derivatives, strict=True)):
            for i, line in enumerate(arc.slopes(end, matrix).tolist()):
                for j, value in enumerate(line):
                    rows[k * size + i][k * size + j] += value
                if i:
                    rows[k * size + i][(k + 1) % count * size + i - 1] -= 1
        return arb_mat(rows)

    def solved(self, start: Vector, settings: TaylorSettings, target: float) -> Vector:
        """Unknowns whose last correction is below a target. Raises `ConvergenceError`."""

        def step(here: Vector) -> Any:
            passed = [flow(arc.equations, [*part[:-1], arb(0), part[-1]], settings, vary=True)
                      for arc, part in zip(self.arcs, self.parts(here), strict=True)]  # fmt: skip
            values = self.residual(here, [end for end, _ in passed])
            slopes = floats(self.jacobian([end for end, _ in passed], [matrix for _, matrix in passed]))
            return exact(approximate_inverse(slopes)) * column(midpoints(values))

        return corrected(step, start, target, "orbit")

    def krawczyk(self, box: Vector, settings: TaylorSettings) -> tuple[Krawczyk, list[Passed]]:
        """The operator over a box, and the arcs from it."""
        centre = midpoints(box)
        passed = [
            arc.passed(part, point, settings)
            for arc, part, point in zip(self.arcs, self.parts(box), self.parts(centre), strict=True)
        ]  # fmt: skip
        values = self.residual(centre, [each.centre for each in passed])
        slopes = self.jacobian([each.end for each in passed], [each.derivatives for each in passed])
        image, contraction = contracted(values, slopes, box)
        return Krawczyk(image, box, contraction, inside(box, image), []), passed

    def returns(self, passed: Sequence[Passed]) -> list[Any]:
        """Of each arc, how the state after its event varies with its first."""
        maps, d = list[Any](), self.size - 1
        for arc, each in zip(self.arcs, passed, strict=True):
            guard, reset = (arc.value(code, each.end)[1] for code in (arc.guards[arc.transition.name], arc.reset))
            rate, moved = arc.rate(each.end), block(each.derivatives, d, 0, d)
            maps.append(reset * (moved - rate * (guard * moved) / (guard * rate)[0, 0]))
        return maps

    def monodromy(self, passed: Sequence[Passed]) -> Any:
        """Of the states after the last event, over a period."""
        total = identity(self.size - 1)
        for matrix in self.returns(passed):
            total = matrix * total
        return total

    def verdict(self, passed: Sequence[Passed]) -> Stability:
        """By all multipliers, the 0 of what a reset forgets among them."""
        return stability(self.monodromy(passed), conserved=False)

    def fault(self, passed: Sequence[Passed]) -> str:
        """Why the arcs could be no motion of the automaton: an event before the end, or a force that pulls; "" if they
        are."""
        return next(filter(None, map(_fault, self.arcs, passed)), "")

    def shorter(self, parts: Sequence[Vector]) -> int:
        """How many arcs could make a shorter period; 0 if none."""
        names = [arc.transition.name for arc in self.arcs]
        for k in range(1, len(names)):
            same = len(names) % k == 0 and names == names[k:] + names[:k]
            if same and all(a.overlaps(b) for a, b in zip(parts[0][:-1], parts[k][:-1], strict=True)):
                return k
        return 0


def _fault(arc: GuardedArc, passed: Passed) -> str:
    """See `GuardedCycle.fault`: in each piece of each step a guard is not 0, or not allowed, or goes the other way; in
    the last ones that of the end goes through 0 in its direction, which it can do but once."""
    ending = False
    if not passed.steps[0].constants[-1] > 0:
        return f"the arc before {arc.transition.name} could last no time"
    for step in passed.steps:
        for k in range(PIECES):
            h = arb(step.h)
            x = step.at(between(h * k / PIECES, h * (k + 1) / PIECES))[: arc.size]
            for name, code in arc.holds.items():
                if not arc.value(code, x)[0][0] > 0:
                    return f"{name} could become negative before {arc.transition.name}"
            for each in arc.leaving:
                (value,), slope = arc.value(arc.guards[each.name], x)
                rising = each.direction * (slope * arc.rate(x))[0, 0]  # how fast it goes in its direction there
                allowed = arb(1) if each.allowed is None else arc.value(arc.allowed[each.name], x)[0][0]
                quiet = value > 0 or value < 0 or allowed < 0 or rising < 0
                if each.name == arc.transition.name and (ending or not quiet):
                    ending = True
                    if not (rising > 0 and allowed > 0):
                        return f"the guard of {each.name} could be 0 before the end of its arc"
                elif not quiet:
                    return f"{each.name} could happen before {arc.transition.name}"
    if arc.transition.impulse is not None and not arc.value(arc.impulse, passed.end)[0][0] > 0:
        return f"the impulse of {arc.transition.name} could pull"
    return "" if ending else f"the guard of {arc.transition.name} is not 0 at the end of its arc"


class TwistedArc(GuardedArc):
    """An arc of (x, y, p), y what the return map varies x by and p a parameter, an unknown."""

    def __init__(self, mode: Mode, transition: Transition, parameter: int) -> None:  # not GuardedArc's: other programs
        self.mode, self.transition = mode, transition
        model, d = mode.model, len(mode.model.state_names)
        self.size = 2 * d + 1
        state, none, s = ca.SX.sym("X", self.size), ca.SX.sym("v", 0), ca.SX.sym("s")
        p, x, y = ca.SX.sym("p", len(model.parameter_values)), state[:d], state[d : 2 * d]
        values = ca.vertcat(*(state[-1] if k == parameter else p[k] for k in range(p.numel())))
        rate, guard = ca.densify(model.rate(0.0, x, values)), transition.guard(x, values)
        reset = x if transition.reset is None else ca.densify(transition.reset(x, values))

        def struck(exact: ca.SX) -> ca.SX:
            after, slope, pace = exact[:d], ca.jacobian(exact[d], x), exact[d + 1 :]
            held = y - pace * (slope @ y) / (slope @ pace)
            return ca.vertcat(after, ca.jtimes(after, x, held), state[-1])

        plain, slopes = with_slopes(
            "twisted", [state, none, s, p], rate, ca.vertcat(state, s),
            lambda exact: ca.vertcat(exact, ca.jtimes(exact, x, y), 0),
        )  # fmt: skip
        parameters = [decimal(float(value)) for value in model.parameter_values]
        fixed = {3: parameters}
        self.field = Field(
            self.size, self.size, recurrence(plain, fixed), recurrence(slopes, fixed), None, None, parameters
        )  # fmt: skip
        inputs, whole = [state, p], ca.vertcat(reset, guard, rate)
        self.guards = {transition.name: derived("guard", inputs, guard, sloped(state))}
        self.reset = derived("reset", inputs, whole, sloped(state, struck))
        form = Formulation(ALONE, self.size, 1, (0,) * self.size, (0,) * self.size, conserved=False)
        self.equations = TheoremEquations(self.field, form, None)


@dataclass(frozen=True)
class TwistedCycle(GuardedCycle):
    """The arcs of a period at whose end y is turned round: -1 is a multiplier. `unit` (d) is c of c.y = 1."""

    unit: tuple[float, ...] = ()

    def residual(self, unknowns: Vector, ends: Sequence[Vector]) -> Vector:
        """F from the arcs' ends."""
        rows, d = super().residual(unknowns, ends), len(self.unit)
        first = len(rows) - self.size + 1 + d
        for i in range(d):
            rows[first + i] += 2 * unknowns[d + i]
        rows[-1] = sum((c * y for c, y in zip(self.unit, unknowns[d : 2 * d], strict=True)), arb(-1))
        return rows

    def jacobian(self, ends: Sequence[Vector], derivatives: Sequence[Any]) -> Any:
        """DF from the arcs' ends over a box and their derivatives."""
        rows, d = super().jacobian(ends, derivatives).tolist(), len(self.unit)
        first = len(rows) - self.size + 1 + d
        for i in range(d):
            rows[first + i][d + i] += 2
        rows[-1] = [arb(0)] * len(rows)
        rows[-1][d : 2 * d] = list(map(arb, self.unit))
        return arb_mat(rows)


def twisted(model: Model, parameter: str, unit: Sequence[float]) -> TwistedCycle:
    """The arcs of a model's cycle, varied."""
    assert model.hybrid is not None
    index = model.parameter_index(parameter)
    return TwistedCycle(
        tuple(TwistedArc(mode, transition, index) for mode, transition in model.hybrid.arcs), tuple(unit)
    )  # fmt: skip


def course(model: Model, given: Mapping[int, Any] | None = None) -> GuardedCycle:
    """The arcs of a model's cycle, some parameters `given` as balls. `InputError` says what cannot be proved."""
    hybrid = model.hybrid
    assert hybrid is not None
    if any(each.model.constraint is not None for each in hybrid.modes):
        raise InputError("system: modes under constraints cannot be proved yet; give minimal coordinates")
    if model.invariants:
        names = ", ".join(invariant.name for invariant in model.invariants)
        raise InputError(f"system: it conserves {names} through its events; orbits with events are proved where "
                         "nothing is conserved")  # fmt: skip
    return GuardedCycle(
        tuple(GuardedArc(mode, transition, hybrid.leaving(mode.name), given) for mode, transition in hybrid.arcs)
    )


def begun(orbit: Orbit, course: GuardedCycle) -> Vector:
    """The recorded orbit as unknowns: by the flow from its first state, each arc to where its guard is 0."""
    free, count = dict(orbit.provenance.get("free", {})), len(course.arcs)
    shares = [float(free.get(f"{SHARE}{k + 1}", 1.0 / count)) for k in range(count - 1)]
    x, unknowns = [arb(float(number)) for number in orbit.state], list[Any]()
    if len(x) != course.size - 1:
        raise InputError(f"state: {plural(len(x), 'number')}, the system has {course.size - 1}; find the orbit again")
    settings = TaylorSettings(bits=64, tolerance=1e-14, order=14)
    for arc, share in zip(course.arcs, [*shares, 1.0 - sum(shares)], strict=True):
        tau, guard = arb(share * orbit.period), arc.guards[arc.transition.name]
        for _ in range(MOST_ITERATIONS):
            end = flow(arc.equations, [*x, arb(0), tau], settings, vary=False)[0]
            (value,), slope = arc.value(guard, end)
            step = (value / (slope * arc.rate(end))[0, 0]).mid()
            tau = (tau - step).mid()
            if not abs(step) > ROUGH * tau:
                break
        unknowns += [*x, tau]
        x = midpoints(arc.value(arc.reset, end)[0])
    return unknowns
