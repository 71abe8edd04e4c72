"""The unfolded, rescaled vector field of a Model as programs, and the power series of its flow.

    q' = tau v,    v' = tau (a(q, v) + s u(q, v)),    s' = tau' = 0,    0 <= time <= 1

with tau the duration (s) of a segment and s the unfolding parameter. Both are components of the
extended state z = (q, v, s, tau) (size d + 2, d = 2n), so that one integrator gives the derivatives with
respect to everything that the theorem varies. Of a first-order system q is the whole state (d = n), v is empty and
q' = tau (f(q) + s grad I(q)); the programs' results are then all of the rates, and none where v makes half of them.
Of a driven system q is the whole state and the time, q' = tau (f(t, x), 1). Under constraints phi(q) = 0, a is what
M a + h = J^T lambda and J a + Jdot v = 0 give, without stabilisation: phi = 0 and J v = 0 then stay so, with s too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError
from orbitfinder.mechanics.factorise import LinearBalances, solve_positive_definite, written_out
from orbitfinder.mechanics.lagrange import mass_matrix_and_bias
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import Vector, arb, arb_mat, decimal, dense, exact, fmpq
from orbitfinder.proof.invariance import Multiple, drive
from orbitfinder.proof.program import ScalarProgram, derived, program
from orbitfinder.proof.series import BALLS, Recurrence, coefficients, listed, outputs, recurrence, whole_series

NUMERICAL = (
    "system: its equations are solved numerically inside the graph (many coordinates, linkages), "
    "which ball arithmetic cannot follow; only systems with closed-form accelerations can be proved"
)


@dataclass(frozen=True)
class Programs:
    """What a proof evaluates, as programs in (q, v, s, p): accelerations or rates, their Jacobian, energy, mass matrix.

    `jacobian` has two results, a + s u (n) and its derivatives (n x d+1) by (q, v, s); `energy` has E (1) and its
    gradient (d), None where nothing is conserved; `mass` is M = d2T/dv2 (n x n), None there and of first-order systems.
    """

    rates: ScalarProgram
    jacobian: ScalarProgram
    energy: ScalarProgram | None
    mass: ScalarProgram | None
    clock: Multiple | None = None
    """the frequency of what drives it (rad/s), of a driven system"""
    closure: ScalarProgram | None = None
    """phi and J v (2m), their gradients (2m x d), of a system under constraints"""

    @property
    def all(self) -> tuple[ScalarProgram, ...]:
        """Those that whole turns of angles must leave as they are."""
        return tuple(code for code in (self.rates, self.energy, self.closure) if code is not None)


def programs(model: Model, constrained: bool = False) -> Programs:
    """The programs of a Model, `constrained` where it may be. `InputError` says what cannot be proved."""
    check_provable(model, constrained)
    n = model.degrees_of_freedom
    if model.forced:
        return _driven(model)
    q, v, s = ca.SX.sym("q", n), ca.SX.sym("v", len(model.state_names) - n), ca.SX.sym("s")
    p = ca.SX.sym("p", len(model.parameter_values))
    if model.rates is not None:
        return _alone(model, model.rates, q, v, s, p)
    unfoldings = [invariant.unfolding for invariant in model.invariants]
    graphs = [model.acceleration if model.constraint is None else model.constraint.phi, model.kinetic, model.potential,
              *unfoldings]  # fmt: skip
    if not all(graph.is_a("SXFunction") for graph in graphs):
        raise InputError(NUMERICAL)
    inputs, x = [q, v, s, p], ca.vertcat(q, v)
    source, accelerations = _accelerations(model, q, v, p)
    energy, mass, push, closure = None, None, ca.SX(n, 1), None
    if model.constraint is not None:
        closure = derived(
            "closure", inputs, model.constraint.phi(q, p), sloped(x, lambda e: ca.vertcat(e, ca.jtimes(e, q, v)))
        )
    for invariant in model.invariants:
        push = s * invariant.unfolding(q, v, p)
        code = program(invariant.unfolding)
        places = {value: (argument, entry) for value, argument, entry in code.inputs}
        if [places.get(code.outputs[0].get(i, -1)) for i in range(n)] != [(1, i) for i in range(n)]:
            raise InputError("invariants: the energy's unfolding is not the velocity; the theorem needs a + s v")
        energy = derived("energy", inputs, invariant.value(q, v, p), lambda exact: [exact, ca.gradient(exact, x)])
        mass = derived("mass", inputs, model.kinetic(q, v, p), lambda exact: [ca.hessian(exact, v)[0]])
    rates, slopes = with_slopes("accelerations", inputs, source, ca.vertcat(x, s), lambda e: accelerations(e) + push)
    return Programs(rates, slopes, energy, mass, closure=closure)


def _accelerations(model: Model, q: ca.SX, v: ca.SX, p: ca.SX) -> tuple[ca.SX, Callable[[ca.SX], ca.SX]]:
    """What the accelerations (n) are made of, and how: of energies where a model conserves what these say, and is made
    of them as Lagrange has it, so that it does so to the last digit; else as they stand in the graph."""
    bent = ca.SX(0) if model.gyroscopic is None else model.gyroscopic(q, v, p)
    energies = ca.vertcat(model.kinetic(q, v, p) + bent, model.potential(q, p))
    if model.constraint is not None:
        return _first_kind(model, energies, q, v, p)
    given = model.acceleration(0.0, q, v, p)

    def lagrange(both: ca.SX) -> ca.SX:
        matrix, bias = mass_matrix_and_bias(both[0], both[1], q, v)
        return solve_positive_definite(matrix, -bias)

    if not model.invariants or _graph(given, q, v, p) != _graph(lagrange(energies), q, v, p):
        return given, lambda exact: exact
    return energies, lagrange


def _first_kind(model: Model, energies: ca.SX, q: ca.SX, v: ca.SX, p: ca.SX) -> tuple[ca.SX, Callable[[ca.SX], ca.SX]]:
    """The same under constraints, as Lagrange's equations of the first kind."""
    assert model.constraint is not None
    phi, n = model.constraint.phi(q, p), q.numel()
    forces = ca.SX(n, 1) if model.forces is None else model.forces(0.0, q, v, p)

    def accelerations(exact: ca.SX) -> ca.SX:
        rows, acting = exact[2 : 2 + phi.numel()], None if model.forces is None else exact[2 + phi.numel() :]
        matrix, bias = mass_matrix_and_bias(exact[0], exact[1], q, v, acting)
        return written_out(LinearBalances.held(matrix, bias, rows, q, v))[0]

    if ca.sprank(ca.hessian(energies[0], v)[0]) < n:
        raise InputError("system: some coordinates move no mass, and proofs under constraints need accelerations from "
                         "the mass matrix; give each body its mass and inertia")  # fmt: skip
    return ca.densify(ca.vertcat(energies, phi, forces)), accelerations


def _graph(expression: ca.SX, *inputs: ca.SX) -> ScalarProgram:
    return program(ca.Function("graph", inputs, [expression]))


def with_slopes(
    name: str, inputs: list[ca.SX], source: ca.SX, by: ca.SX, made: Callable[[ca.SX], ca.SX] = lambda exact: exact
) -> tuple[ScalarProgram, ScalarProgram]:
    """The programs of rates made of a source, and of these with their derivatives."""
    both = derived(f"{name}_and_jacobian", inputs, source, sloped(by, made))
    return derived(name, inputs, source, lambda exact: [made(exact)]), both


def sloped(by: ca.SX, made: Callable[[ca.SX], ca.SX] = lambda exact: exact) -> Callable[[ca.SX], list[ca.SX]]:
    """What is made of a source, and its derivatives, as `derived` takes them."""

    def results(exact: ca.SX) -> list[ca.SX]:
        value = made(exact)
        return [value, ca.jacobian(value, by)]

    return results


def _alone(model: Model, rates: ca.Function, x: ca.SX, v: ca.SX, s: ca.SX, p: ca.SX) -> Programs:
    """The programs of a first-order system: f + s grad H where f is J grad H on the graph, else f alone."""
    inputs, rate, by = [x, v, s, p], rates(0.0, x, p), ca.vertcat(x, s)
    if not model.hamiltonian:
        return Programs(*with_slopes("rates", inputs, rate, by), None, None)
    total, half = model.invariants[0].value(x, v, p), x.numel() // 2

    def turned(slope: ca.SX) -> ca.SX:
        return ca.densify(ca.vertcat(slope[half:], -slope[:half]))

    def unfolded(exact: ca.SX) -> ca.SX:
        slope = ca.gradient(exact, x)
        return turned(slope) + s * slope

    if _graph(rate, *inputs) != _graph(turned(ca.gradient(total, x)), *inputs):
        raise InputError("system: its rates are not Hamilton's of its energy on their graph; use hamiltonian(...)")
    energy = derived("energy", inputs, total, lambda exact: [exact, ca.gradient(exact, x)])
    return Programs(*with_slopes("rates", inputs, total, by, unfolded), energy, None)


def _driven(model: Model) -> Programs:
    """The programs of a driven system with the time as its last component; the graph says when its drive repeats."""
    y, v, s = ca.SX.sym("y", len(model.state_names) + 1), ca.SX.sym("v", 0), ca.SX.sym("s")
    p = ca.SX.sym("p", len(model.parameter_values))
    if not model.scalar:
        raise InputError(NUMERICAL)
    rate = ca.vertcat(model.rate(y[-1], y[:-1], p), 1.0)
    rates, slopes = with_slopes("driven", [y, v, s, p], rate, ca.vertcat(y, s))
    clock = drive(rates, y.numel() - 1)
    if clock is None:
        raise InputError(
            "system: when its drive repeats cannot be read off its equations; a theorem needs time in sines and "
            "cosines of multiples of one frequency alone"
        )
    return Programs(rates, slopes, None, None, clock)


def check_provable(model: Model, constrained: bool = False) -> None:
    """`InputError` unless the theorem covers the Model: the energy its only integral, or without any."""
    if not model.smooth:
        raise InputError("system: of systems with events only orbits are proved; this theorem is about smooth flows")
    if model.constraint is not None and (model.forced or not constrained):
        raise InputError(
            "system: under constraints only orbits of what nothing drives are proved, no parts nor events of families; "
            "prove orbits of it, without motors or motions, by themselves"
        )
    if "independent" in model.system:
        raise InputError(
            "independent: the other coordinates follow from iterations or arcs of cosines, which theorems are not "
            "about; find the orbit without it: where nothing drives it, it is proved in all coordinates"
        )
    if not model.invariants:
        return
    names = ", ".join(invariant.name for invariant in model.invariants)
    if not model.canonical or not model.conservative:
        raise InputError(
            f"system: that it conserves {names} is declared and not how it is made, which the theorem needs; describe "
            "it by hamiltonian(...) or lagrange(...)"
        )
    if len(model.invariants) != 1:
        raise InputError(
            f"system: it conserves {names}; the theorem unfolds the energy alone, so give the system gravity "
            "or remove the other symmetry"
        )


@dataclass(frozen=True)
class Field:
    """The field with its parameters filled in, at the precision in force when it was made."""

    size: int
    """n, degrees of freedom, of a first-order or a driven system d"""
    dimension: int
    """d, components of the state"""
    plain: Recurrence
    varied: Recurrence
    energy_program: ScalarProgram | None
    mass_program: ScalarProgram | None
    parameters: Vector
    frequency: Any = None
    """of what drives it (rad/s)"""
    symplectic: bool = False
    """whether what drives it is the gradient of a potential, so that multipliers are in pairs mu, 1/mu"""
    closure_program: ScalarProgram | None = None

    def states(self, z: Sequence[Any], order: int) -> list[Vector]:
        """Series of (q, v) (d lists of order + 1 balls) of the solution through z (d + 2)."""
        return self.solution(z, order).states

    def solution(self, z: Sequence[Any], order: int) -> Jet:
        """The series through z with those of the program's values."""
        return Jet(self, z, order)

    def rates(self, z: Sequence[Any]) -> Vector:
        """The field at z: z' (d + 2)."""
        states = self.states(z, 1)
        return [series[1] for series in states] + [arb(0), arb(0)]

    def energy(self, z: Sequence[Any]) -> tuple[Any, Vector]:
        """Energy (J) and its gradient (d) at z, of a Model that conserves it."""
        assert self.energy_program is not None
        value, slope = self.energy_program.run(self._arguments(z), BALLS)
        return value[0], [slope.get(i, arb(0)) for i in range(self.dimension)]

    def closure(self, z: Sequence[Any]) -> tuple[Vector, Any]:
        """phi and J v (2m) at z, their gradients (2m x d), of a system under constraints."""
        assert self.closure_program is not None
        values, slopes = self.closure_program.run(self._arguments(z), BALLS)
        return [values[i] for i in range(len(values))], dense(slopes, len(values), self.dimension)

    def mass(self, z: Sequence[Any]) -> Any:
        """Mass matrix M(q) (n x n) at z, of a mechanical system."""
        assert self.mass_program is not None
        n, entries = self.size, self.mass_program.run(self._arguments(z), BALLS)[0]
        return dense(entries, n, n)

    def _arguments(self, z: Sequence[Any]) -> list[Any]:
        n, d = self.size, self.dimension
        return [z[:n], z[n:d], [z[d]], self.parameters]


def make_field(model: Model, codes: Programs | None = None, given: Mapping[int, Any] | None = None) -> Field:
    """The field of a Model, parameters read as the decimals they are written as, but balls where they are `given`."""
    codes = codes or programs(model)
    parameters = [(given or {}).get(k, decimal(float(value))) for k, value in enumerate(model.parameter_values)]
    constants = {3: parameters}
    size, whole, plain, frequency = (
        model.degrees_of_freedom,
        len(model.state_names),
        recurrence(codes.rates, constants),
        None,
    )
    if (clock := codes.clock) is not None:
        size = whole = whole + 1
        frequency = arb(fmpq(clock.factor.numerator, clock.factor.denominator))
        frequency = abs(frequency if clock.value is None else frequency * plain.fixed[clock.value])
    varied = recurrence(codes.jacobian, constants)
    turned = frequency is not None and gradient_forces(model, constants)
    return Field(size, whole, plain, varied, codes.energy, codes.mass, parameters, frequency, turned, codes.closure)


def gradient_forces(model: Model, constants: Mapping[int, Sequence[Any]]) -> bool:
    """True when the forces Q(t, q, v, p) of a mechanical system are a potential's gradient on their graph: no v in
    them, and dQ/dq symmetric; by Lagrange's equations the flow in (q, dT/dv) is then Hamilton's."""
    if model.rates is not None or model.forces is None or not model.forces.is_a("SXFunction"):
        return False
    n = model.degrees_of_freedom
    t, q, v, p = ca.SX.sym("t"), ca.SX.sym("q", n), ca.SX.sym("v", n), ca.SX.sym("p", len(model.parameter_values))
    given, x = [t, q, v, p], ca.vertcat(q, v)
    slopes = derived("slopes", given, model.forces(*given), lambda exact: [ca.jacobian(exact, x)])
    code = recurrence(slopes, constants)
    places = {
        entry: value for entry, value in code.outputs[0].items() if not (value in code.fixed and code.fixed[value] == 0)
    }
    return all(entry < n * n and places.get(entry % n * n + entry // n) == value for entry, value in places.items())


class Jet:
    """The series of one solution: q_{k+1} = tau v_k / (k+1), v_{k+1} = tau a_k / (k+1).

    `states` (d lists) has orders 0..order, `values` (of the program) 0..order - 1.
    """

    def __init__(self, field: Field, z: Sequence[Any], order: int) -> None:
        n, d = field.size, field.dimension
        self.n, self.order, self.z, self.code = n, order, z, field.plain
        self.unfolding, self.tau = z[d], z[d + 1]
        self.states = [[value] for value in z[:d]]

        def variables(k: int, accelerations: list[Vector]) -> Vector:
            if k:
                self._grow(k, accelerations)
            beyond = arb(0) if k else self.unfolding
            return [
                beyond if argument == 2 else self.states[entry + n * argument][k]
                for _, argument, entry in self.code.variables
            ]

        self.values = coefficients(self.code, order - 1, variables)
        first = self.results()[0]
        self._grow(order, [first.get(i, [arb(0)] * order) for i in range(n)])

    def results(self) -> list[dict[int, Vector]]:
        """Series of the program's results (0..order - 1)."""
        return outputs(self.code, self.values)

    def arguments(self, code: Recurrence, states: Sequence[Sequence[Any]], unfolding: Any, zero: Any) -> list[Any]:
        """What `code.variables` are where the state is `states`, `zero` what s has beyond its constant."""
        return [
            [unfolding, *zero] if argument == 2 else states[entry + self.n * argument]
            for _, argument, entry in code.variables
        ]

    def transitions(self, code: Recurrence) -> list[Any]:
        """Series (order + 1 matrices, d+2 square) of dz(t)/dz by the Jacobian's program."""
        n, d, order, size = self.n, len(self.states), self.order, len(self.states) + 2
        given = self.arguments(code, self.states, self.unfolding, [])
        values, slopes = (
            {k: listed(x, order - 1) for k, x in result.items()}
            for result in outputs(code, whole_series(code, order - 1, given)[0])
        )
        rates = rate_series(n, self.states, values, order)
        blocks = transition_series(n, self.tau, rates, slope_series(n, d, slopes, order))
        last = [arb(0)] * (size - 1) + [arb(1)]
        return [
            arb_mat(size, size, matrix.entries() + (last if k == 0 else [arb(0)] * size))
            for k, matrix in enumerate(blocks)
        ]

    def _grow(self, k: int, accelerations: list[Vector]) -> None:
        """Coefficients of order k of the state from those of order k - 1 of the accelerations."""
        n, factor = self.n, self.tau / k
        for i in range(len(self.states) - n):
            self.states[i].append(factor * self.states[n + i][k - 1])
        for series, rate in zip(self.states[-n:], accelerations, strict=True):
            series.append(factor * rate[k - 1])


def rate_series(n: int, states: Sequence[Vector], accelerations: Mapping[int, Vector], order: int) -> list[Vector]:
    """Series of the field (d lists of `order`): of the velocities those of the state."""
    zero = [arb(0)] * order
    return [*(series[:order] for series in states[n:]), *(accelerations.get(i, zero) for i in range(n))]


def transition_series(n: int, tau: Any, rates: Sequence[Vector], slopes: Sequence[Any]) -> list[Any]:
    """Coefficients (d+1 x d+2, the last row that of s) of dz(t)/dz from those of the field and of its Jacobian.

    V' = tau (A V) + f e_tau^T with A = d(v, a)/d(q, v, s), V(0) = 1.
    """
    d = len(rates)
    size, blocks = d + 2, [exact(np.eye(d + 1, d + 2))]
    for k in range(len(slopes)):
        lower = sum((slopes[j] * blocks[k - j] for j in range(1, k + 1)), slopes[0] * blocks[k])
        factor, upper = tau / (k + 1), blocks[k].entries()[n * size : d * size]
        rows = [factor * x for x in upper] + [factor * x for x in lower.entries()]
        for i in range(d):
            rows[i * size + size - 1] += rates[i][k] / (k + 1)
        blocks.append(arb_mat(d + 1, size, rows + [arb(0)] * size))
    return blocks


def slope_series(n: int, d: int, jacobian: dict[int, Vector], order: int) -> list[Any]:
    """Coefficients 0..order - 1 of d(a + s u)/d(q, v, s) as matrices (n x d+1)."""
    zero = [arb(0)] * order
    columns = [jacobian.get(i + n * j, zero) for i in range(n) for j in range(d + 1)]
    return [arb_mat(n, d + 1, [slope[k] for slope in columns]) for k in range(order)]
