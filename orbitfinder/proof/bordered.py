"""Folds, doublings and branch points of families, proved as regular zeros of their bordered systems.

Beside the orbit x stands a solution y of the variational equations that closes as well, or up to a sign:

    x' = f(x, p),    y' = (df/dx) y + sigma u(x) + delta f(x),    p' = sigma' = delta' = 0,

p the parameter, an unknown; delta how the period changes; sigma unfolds the energy as s does (see `field`). This is a
further system of first order to the integrator, and Krawczyk's operator shows that its zero is regular: what follows
about the family is in docs/proof.md. Sources: G. Moore, A. Spence, SIAM J. Numer. Anal. 17 (1980) 567-576;
M. G. Crandall, P. H. Rabinowitz, J. Funct. Anal. 8 (1971) 321-340.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from operator import eq
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from orbitfinder.errors import InputError, plural
from orbitfinder.loops.symmetry import named
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.proof.balls import (
    Vector,
    Versioned,
    arb,
    column,
    decimal,
    exact,
    floats,
    identity,
    midpoints,
    precision,
    radius,
    why_not,
)
from orbitfinder.proof.enclosure import TaylorSettings
from orbitfinder.proof.field import Field, Programs, make_field, programs
from orbitfinder.proof.formulation import Formulation, approach
from orbitfinder.proof.gaits import begun, course, twisted
from orbitfinder.proof.invariance import has_symmetry
from orbitfinder.proof.krawczyk import (
    TheoremEquations,
    approximate_inverse,
    arcs_over,
    flow,
    jacobian,
    krawczyk,
    norm,
    solve,
)
from orbitfinder.proof.program import bound, graphs
from orbitfinder.proof.record import (
    DIGITS,
    MARGIN,
    Same,
    bounding,
    contradictions,
    done_again,
    enclosure,
    holds,
    in_digits,
    timed,
)
from orbitfinder.proof.series import recurrence
from orbitfinder.proof.theorem import (
    CENTRE,
    UNPROVED,
    NotProved,
    Options,
    Progress,
    Proving,
    certain,
    check_graph,
    check_motion,
    checked,
    chosen_options,
    chosen_symmetry,
    enclosed,
    frequency,
    provable_model,
    refuse,
    silent,
)
from orbitfinder.proof.trajectory import horizon, minimal_period, positive_mass
from orbitfinder.records.codec import Codec, plain
from orbitfinder.records.family import Event, Family, load_family
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import Table


def twists(kind: str, reverses: bool) -> list[tuple[int, int]]:
    """How y may be twisted at events of a kind, with a reversal or without; none of a kind that is not proved."""
    turned = [(1, -1), (-1, 1)] if reverses else [(-1, -1)]
    both = [(-1, -1), *turned] if reverses else turned
    return {"fold": [(1, 1)], "period_doubling": turned, "branch_point": both}.get(kind, [])


@dataclass(frozen=True)
class TwistedFormulation(Formulation):
    """The conditions of an orbit and of what it is varied by, y.

    A `twist` of (1, 1) closes y as x closes. Without a reversal (-1, -1) is the opposite sign; with it each sign tells
    whether y has the reversal about that end of the horizon, or is turned round by it. The state is (x, y, constants),
    and the drive's phase, where there is one; constants are the `parameter`, sigma and delta.
    """

    twist: tuple[int, int] = (1, 1)
    parameter: bool = False
    integral: bool = False
    """whether an energy is conserved; `conserved` says that a row has it"""

    @property
    def same(self) -> bool:
        """True when y closes as x does, so that the period may change with it."""
        return self.twist == (1, 1)

    @property
    def carried(self) -> bool:
        """True when y = f closes, which a section excludes."""
        return self.drive is None and self.twist == ((-1, -1) if self.symmetry.reverses else (1, 1))

    @property
    def constants_at(self) -> dict[str, int]:
        """Where the constants stand."""
        wanted = {"p": self.parameter, "sigma": self.carried and self.integral,
                  "delta": self.same and self.drive is None}  # fmt: skip
        return {name: 2 * self.components + k for k, name in enumerate(name for name in wanted if wanted[name])}

    @property
    def dimension(self) -> int:
        """Components of x, y, constants and the phase."""
        return 2 * self.components + len(self.constants_at) + int(self.drive is not None)

    @property
    def unfolded(self) -> bool:
        """True when x needs the unfolding parameter s."""
        return self.integral and not self.symmetry.reverses

    @property
    def varied(self) -> tuple[int, ...]:
        """Components of the state that are linear: y, sigma, delta."""
        own = [place for name, place in self.constants_at.items() if name != "p"]
        return (*range(self.components, 2 * self.components), *own)

    @property
    def free(self) -> tuple[int, ...]:
        """Components of the first node that are unknowns."""
        own, m = super().free, self.components
        other = tuple(i for i in range(m) if i not in own) if self.symmetry.reverses and self.twist[0] < 0 else own
        return (*own, *(m + i for i in other), *self.constants_at.values())

    @property
    def ends(self) -> tuple[int, ...]:
        """Components of the last state that conditions are put on."""
        m = self.components
        own = tuple(i for i in super().ends if i < m)
        other = tuple(i for i in range(m) if i not in own) if self.symmetry.reverses and self.twist[1] < 0 else own
        return (*own, *(m + i for i in other), *range(2 * m + len(self.constants_at), self.dimension))

    @property
    def mirror(self) -> tuple[int, ...]:
        """Signs with which the first node's components enter the conditions at the end."""
        own = super().mirror[: self.components]
        return (*own, *(self.twist[0] * sign for sign in own), *[0] * (self.dimension - 2 * len(own)))

    @property
    def targets(self) -> list[Any]:
        """What the components `ends` of the last state are to be: y is to be 0."""
        own = [arb.pi() * k for k in self.constants[-self.held_at_the_end :]]
        zeros = len(self.ends) - len(own) - int(self.drive is not None)
        return [*own, *[arb(0)] * zeros, *([] if self.drive is None else [self.drive])]

    @property
    def held_at_the_end(self) -> int:
        """How many components of x conditions are put on at the end."""
        return sum(i < self.components for i in self.ends)

    @property
    def square(self) -> bool:
        """True when there are as many equations as unknowns."""
        sections = int(self.sectioned) + int(self.carried) + 1
        equations = self.dimension * (self.segments - 1) + len(self.ends) + sections + int(self.conserved)
        return equations == self.unknowns

    @property
    def kind(self) -> str:
        """What happens where y closes like this."""
        if self.same:
            return "fold"
        doubles = not self.symmetry.maps or (self.symmetry.forward is None and self.twist[0] != self.twist[1])
        return "period_doubling" if doubles else "branch_point"


def bordered_field(model: Model, codes: Programs, form: TwistedFormulation, parameter: str, energy_row: bool) -> Field:
    """The field of (x, y, constants, phase), and of a fold in the energy dE y as its energy."""
    m, size = form.components, form.dimension
    state, none, s = ca.SX.sym("X", size), ca.SX.sym("v", 0), ca.SX.sym("s")
    p = ca.SX.sym("p", len(model.parameter_values))
    x, y, at = state[:m], state[m : 2 * m], form.constants_at
    values, numbers = [p[k] for k in range(p.numel())], list[tuple[ca.SX, float]]()
    if "p" in at:
        values[model.parameter_index(parameter)] = state[at["p"]]
    q, v = (x, none) if codes.mass is None and form.symmetry.first_order else (x[: form.size], x[form.size :])
    turning = ca.SX(1)
    if codes.clock is not None:  # the phase goes round with the drive, whatever its frequency is
        if codes.clock.value is not None:  # the frequency times its denominator, a graph of the parameters
            plain_field, place = make_field(model, codes), codes.clock.value
            unused, only = [ca.SX(0)] * plain_field.dimension, replace(codes.rates, outputs=({0: place},))
            value = only.run([unused, unused, unused, values], graphs(numbers))[0][0]
            turning = codes.clock.factor.numerator * (value if plain_field.plain.fixed[place] > 0 else -value)
        q, v = ca.vertcat(x, state[-1] / turning), none
    rates = codes.rates.run([_entries(q), _entries(v), [s], values], graphs(numbers))[0]
    count = q.numel() if v.numel() == 0 else form.size
    rate = ca.vertcat(v, *[rates.get(i, ca.SX(0)) for i in range(count)])[:m]
    along = ca.jtimes(rate, x, y)
    if "sigma" in at:
        along += state[at["sigma"]] * ca.jacobian(rate, s)
    if "delta" in at:
        along += state[at["delta"]] * rate
    whole = ca.vertcat(rate, along, ca.SX.zeros(len(at)), *([] if codes.clock is None else [turning]))
    inputs = [state, none, s, p]
    slopes = bound("bordered", inputs, [whole, ca.jacobian(whole, ca.vertcat(state, s))], numbers)
    plain = bound("bordered", inputs, [whole], numbers)
    energy = None
    if energy_row and codes.energy is not None:
        gradient = codes.energy.run([_entries(q), _entries(v), [s], values], graphs(numbers))[1]
        total = ca.dot(ca.vertcat(*[gradient.get(i, ca.SX(0)) for i in range(m)]), y)
        energy = bound("energy", inputs, [total, ca.densify(ca.gradient(total, state))], numbers)
    parameters = [decimal(float(value)) for value in model.parameter_values]
    constants = {3: parameters}
    return Field(size, size, recurrence(plain, constants), recurrence(slopes, constants), energy, None, parameters)


def _entries(graph: Any) -> list[Any]:
    return [graph[k] for k in range(graph.numel())]


# --------------------------------------------------------------------------------------------------
# The record, which says which equations are solved and where, and what is proved of their zero.


@dataclass(frozen=True)
class BorderedRecord(Versioned):
    """An event-proof.json: a single zero of the bordered system within `radius` of `centre` (exact floats).

    `twist` says how y closes (see `TwistedFormulation`), `cycles` how many of a drive's periods it takes; sections are
    normal to `flow`, which may be any vector, and y has the length of the centre's along it. Balls are {"value":
    decimal, "radius": float}: `value` of the family's parameter, `energy` (J), `period` (s), `state`; `tangent` is y at
    the first node, `side` where the orbits of a fold are: at "larger" or "smaller" values.
    """

    _entries = (..., "wall_time", "versions")

    name: str
    system: Table
    parameter: str
    kind: str
    symmetry: str
    segments: int
    constants: tuple[int, ...]
    turns: tuple[int, ...]
    cycles: int
    twist: tuple[int, int]
    flow: tuple[float, ...]
    centre: tuple[float, ...]
    radius: float
    order: int = TaylorSettings.order
    bits: int = TaylorSettings.bits
    tolerance: float = TaylorSettings.tolerance
    proved: bool = False
    reason: str = ""
    contraction: float = np.nan
    value: Table = field(default_factory=dict)
    energy: Table | None = None
    period: Table = field(default_factory=dict)
    state: tuple[Table, ...] = ()
    tangent: tuple[Table, ...] = ()
    side: str = ""
    wall_time: float = 0.0

    @property
    def start(self) -> Vector:
        """The centre in balls without a radius."""
        return [*map(arb, self.centre)]

    @property
    def box(self) -> Vector:
        """The centre in balls of the radius."""
        return [arb(c, self.radius) for c in self.centre]

    @property
    def words(self) -> list[tuple[str, str]]:
        """What is proved, line by line."""
        at, period = (in_digits(ball) for ball in (self.value, self.period))
        follows = {
            "fold": f"two orbits near this at each {self.side} value and none at values on the other side",
            "period_doubling": "the family goes on at both sides, and orbits of twice the period branch off",
            "branch_point": "the family goes on at both sides, and orbits of less symmetry branch off",
        }
        return [
            ("event", f"{self.kind.replace('_', ' ')} at {self.parameter} = {at}"),
            ("box", f"a single zero of the bordered system within {self.radius:.2g} of the nodes"),
            ("period", f"{period} s, minimal"),
            ("follows", follows[self.kind]),
            ("contraction", f"{self.contraction:.2g} (order {self.order}, {self.bits} bits)"),
        ]

    @property
    def settings(self) -> TaylorSettings:
        """The integrator's."""
        return TaylorSettings(self.order, self.bits, self.tolerance)


events = Codec(BorderedRecord, "event-proof", "`orbitfinder prove --event`", "prove the event again", sealed=True)


@dataclass
class _EventProof:
    """An event being proved: the equations that a record states, of the orbit alone (`plain`) and bordered."""

    about: BorderedRecord
    model: Model
    say: Progress

    def __post_init__(self) -> None:
        about, model = self.about, self.model
        self.codes = codes = programs(model)
        symmetry = named(about.symmetry, model)
        integral = bool(model.invariants)
        if (about.parameter == "energy") != integral:
            raise InputError(
                f"parameter: {about.parameter}: events are proved in the energy of systems that conserve it, in a "
                "parameter of others; continue the family in that"
            )
        self.base = make_field(model, codes)
        drive = None if codes.clock is None else 2 * about.cycles * arb.pi() / self.base.frequency
        given = (symmetry, model.degrees_of_freedom, about.segments, about.constants, about.turns)
        self.plain = Formulation(*given, integral, drive)
        check_graph(codes, self.plain, model)
        fold, phase = about.twist == (1, 1), drive
        if codes.clock is not None and codes.clock.value is not None:  # what it is after so many of the drive's periods
            phase = 2 * about.cycles * codes.clock.factor.denominator * arb.pi()
        self.form = TwistedFormulation(*given, integral and fold, phase, (), about.twist, not integral, integral)
        if not self.form.square:
            raise NotProved(f"{symmetry.name} leaves not as many equations as unknowns here; use none")
        fits = symmetry.reverses or len({*about.twist}) == 1
        fits &= (len(about.constants), len(about.turns)) == (self.form.components, model.degrees_of_freedom)
        if about.centre and not (
            fits and (len(about.centre), len(about.flow)) == (self.form.unknowns, self.form.components)
        ):
            raise InputError(
                f"centre: {about.twist} and {len(about.centre)} numbers do not fit the system; {events.again}"
            )
        self.equations = TheoremEquations(
            bordered_field(model, codes, self.form, about.parameter, integral and fold), self.form,
            arb(0) if integral and fold else None, self.sections() if about.centre else [],
        )  # fmt: skip

    def sections(self) -> list[tuple[Any, Any]]:
        """The hyperplanes through the centre: across the flow of x, and of y, as they are wanted, and across y."""
        form, m = self.form, self.form.components
        node = np.array([float(x.mid()) for x in form.nodes(self.about.start)[0]])
        own, other, first = np.zeros((3, form.dimension))
        own[:m] = other[m : 2 * m] = self.about.flow
        first[m : 2 * m] = node[m : 2 * m]
        wanted = ((self.plain.sectioned, node, own), (form.carried, 0 * own, other), (True, first, first))
        return [(a[: len(own)].tolist(), w.tolist()) for asked, a, w in wanted if asked]

    def along(self, unknowns: Vector) -> tuple[TheoremEquations, Vector]:
        """The equations of the orbit alone, at a parameter and energy of the bordered ones, and its unknowns."""
        nodes, m, given = self.form.nodes(unknowns), self.form.components, {}
        if (at := self.form.constants_at.get("p")) is not None:
            given = {self.model.parameter_index(self.about.parameter): nodes[0][at]}
        here, plain = make_field(self.model, self.codes, given), self.plain
        if plain.drive is not None:
            plain = replace(plain, drive=2 * self.about.cycles * arb.pi() / here.frequency)
        times = [[plain.drive * k / self.about.segments] if plain.drive is not None else [] for k in range(len(nodes))]
        rows = [[*node[:m], *time] for node, time in zip(nodes, times, strict=True)]
        own = [rows[0][i] for i in plain.free] + [value for row in rows[1:] for value in row]
        own += [*([unknowns[-2]] if plain.unfolded else []), unknowns[-1]]
        size = m + int(plain.drive is not None)
        cuts = [(a[:size], w[:size]) for a, w in self.equations.sections[: int(plain.sectioned)]]
        level = here.energy([*rows[0], arb(0), arb(1)])[0] if plain.conserved else None
        return TheoremEquations(here, plain, level, cuts), own

    def begun(self, nodes: np.ndarray, duration: float, flow_there: np.ndarray, value: float) -> float:
        """Set centre and sections from nodes of the orbit (N x m): y is what the rows nearly send to 0.

        Returns how near, relative to the next singular value.
        """
        form, m = self.form, self.form.components
        rows = np.zeros((len(nodes), form.dimension))
        rows[:, :m] = nodes
        if form.parameter:
            rows[:, form.constants_at["p"]] = value
        if form.drive is not None:
            rows[:, -1] = float(form.drive.mid()) * np.arange(len(nodes)) / len(nodes)
        whole = np.array(form.unknowns_of(rows, duration))
        self.about = replace(self.about, centre=tuple(whole.tolist()), flow=tuple(flow_there[:m].tolist()))
        unknowns, here = self.about.start, replace(self.equations, sections=self.sections())
        ends = [flow(here, node, self.about.settings, vary=True)[1] for node in form.nodes(unknowns)]
        free, rest = list(form.free), form.dimension * np.arange(len(nodes) - 1)[:, None] + form.varied
        linear = [*(free.index(i) for i in form.varied if i in free), *(len(free) + rest.ravel())]
        slopes = np.delete(floats(jacobian(here, unknowns, ends)), form.unknowns - 1 - int(form.conserved), axis=0)
        _, sizes, directions = np.linalg.svd(slopes[:, linear])
        first = [k for k, i in enumerate(form.free) if m <= i < 2 * m]
        whole[linear] = directions[-1]
        whole[linear] /= np.linalg.norm(whole[first])
        self.centred(whole.tolist())
        return float(sizes[-1] / sizes[-2])

    def centred(self, unknowns: Sequence[Any]) -> None:
        """Another centre, through which the sections go."""
        self.about = replace(self.about, centre=tuple(map(float, unknowns)))
        self.equations = replace(self.equations, sections=self.sections())

    def solved(self) -> None:
        """Move the centre to the zero, and take the largest box about it in which the operator shows that it is alone.
        Raises `NotProved`, `ConvergenceError`, `IntegrationError`."""
        settings = self.about.settings
        self.centred(solve(self.equations, self.about.start, settings, CENTRE)[0])
        contracted = enclosed(lambda box: krawczyk(self.equations, box, settings), self.about.start, self.say)
        self.about = replace(self.about, radius=radius(contracted.box))

    def side(self, slopes: Any, box: Vector) -> str:
        """At which values the orbits of a fold are, by the sign of the parameter's second derivative along the family.

        The solution of DG w = e, e 1 in a row of y, moves x along y by alpha, and that of a row of x moves p by c: the
        derivative is 1 / alpha for the row of the energy, else -c / alpha for the two rows of a component.
        """
        form = self.form
        free, rows = list(form.free), [form.dimension * (form.segments - 1) + k for k in range(len(form.ends))]
        own = [free.index(i) for i in range(form.components) if i in free]
        moved = max(own, key=lambda k: abs(float(box[k + len(own)].mid())))

        def answer(row: int) -> Vector:
            unit = [arb(int(k == row)) for k in range(form.unknowns)]
            return list(slopes.solve(column(unit), algorithm="precond").entries())

        def alpha(row: int) -> Any:
            return answer(row)[moved] / box[moved + len(own)]

        if form.conserved:
            bend = 1 / alpha(form.unknowns - 1)
        else:
            count = form.held_at_the_end
            chosen = max(range(count), key=lambda k: abs(float(alpha(rows[count + k]).mid())))
            bend = -answer(rows[chosen])[free.index(form.constants_at["p"])] / alpha(rows[count + chosen])
        if not (bend > 0 or bend < 0):
            raise NotProved("at which values the orbits of the fold are could not be told")
        return "larger" if bend > 0 else "smaller"

    def concluded(self, margin: float = MARGIN, digits: int = DIGITS) -> BorderedRecord:
        """What the record says of its box, proved. Raises `NotProved`."""
        about, form, settings = self.about, self.form, self.about.settings
        first, again, box = certain(lambda box: krawczyk(self.equations, box, settings), about.box)
        plain, own = self.along(box)
        arcs = arcs_over(plain, own, midpoints(own), settings)
        path = horizon(plain, own, arcs)
        check_motion(path, self.model, "the state", "the orbit")
        if "sigma" in form.constants_at and not (
            (self.model.hamiltonian or positive_mass(path))
            and has_symmetry(self.codes.rates, self.codes.energy, form.symmetry, form.size, (1, -1))
        ):
            raise NotProved("what varies the orbit could not be shown to keep the energy")
        minimal, _, reason = minimal_period(path, self.model.angles)
        if not minimal:
            raise NotProved(f"the period could be a multiple of a smaller period: {reason}")
        if not form.same and not invertible(jacobian(plain, own, [arc[1] for arc in arcs])):
            raise NotProved("the orbits of the family could not be shown to go on to other values of its parameter")
        node = form.nodes(box)[0]
        side = (
            self.side(jacobian(self.equations, first.image, [arc[1] for arc in again.arcs]), box) if form.same else ""
        )
        value = path.field.energy(path.first)[0] if plain.formulation.conserved else node[form.constants_at["p"]]
        said = [enclosure(ball, digits, margin) for ball in (value, path.period)]
        state, tangent = (
            tuple(enclosure(ball, digits, margin) for ball in node[k : k + form.components])
            for k in (0, form.components)
        )
        return replace(
            about, proved=True, kind=form.kind, contraction=first.contraction, value=said[0], period=said[1],
            state=state, tangent=tangent, side=side, energy=said[0] if plain.formulation.conserved else None,
        )  # fmt: skip


@dataclass
class _GaitEventProof:
    """A doubling of orbits with events being proved: y is turned round by the return map."""

    about: BorderedRecord
    model: Model
    say: Progress

    def __post_init__(self) -> None:
        about, d = self.about, len(self.model.state_names)
        if {about.kind, *about.twist} != {"period_doubling", -1}:
            raise InputError(
                f"--event: of orbits with events doublings are proved, got a {about.kind.replace('_', ' ')}"
            )
        course(self.model)
        self.arcs = twisted(self.model, about.parameter, about.flow or [0.0] * d)
        if about.centre and (len(about.centre), len(about.flow)) != (len(self.arcs.arcs) * self.arcs.size, d):
            raise InputError(f"centre: {len(about.centre)} numbers do not fit the system; {events.again}")

    def begun(self, orbit: Orbit, value: float) -> float:
        """Set the centre from an orbit: y is what the return map nearly turns round. Returns how nearly."""
        plain = course(self.model)
        nodes = plain.parts(plain.solved(begun(orbit, plain), self.about.settings, CENTRE))
        passed = [arc.passed(node, node, self.about.settings) for arc, node in zip(plain.arcs, nodes, strict=True)]
        values, vectors = np.linalg.eig(floats(plain.monodromy(passed)))
        k = int(np.argmin(np.abs(values + 1)))
        y, unknowns = vectors[:, k].real, list[Any]()
        unit = y / (y @ y)
        for node, matrix in zip(nodes, plain.returns(passed), strict=True):
            unknowns += [*node[:-1], *y.tolist(), value, node[-1]]
            y = floats(matrix) @ y
        self.about = replace(self.about, centre=tuple(map(float, unknowns)), flow=tuple(unit.tolist()))
        self.arcs = replace(self.arcs, unit=self.about.flow)
        return float(abs(values[k] + 1))

    def solved(self) -> None:
        """See `_EventProof`."""
        settings, start = self.about.settings, self.about.start
        centre = self.arcs.solved(start, settings, CENTRE)
        self.about = replace(self.about, centre=tuple(map(float, centre)))
        contracted = enclosed(lambda box: self.arcs.krawczyk(box, settings)[0], self.about.start, self.say)
        self.about = replace(self.about, radius=radius(contracted.box))

    def concluded(self, margin: float = MARGIN, digits: int = DIGITS) -> BorderedRecord:
        """See `_EventProof`."""
        about, settings = self.about, self.about.settings
        first, _, whole = certain(lambda box: self.arcs.krawczyk(box, settings)[0], about.box)
        parts = self.arcs.parts(whole)
        value, d = parts[0][-2], len(about.flow)
        plain = course(self.model, {self.model.parameter_index(about.parameter): value})
        box = [number for part in parts for number in (*part[:d], part[-1])]
        passed = plain.krawczyk(box, settings)[1]
        if fault := plain.fault(passed):
            raise NotProved(fault)
        if fewer := plain.shorter(plain.parts(box)):
            raise NotProved(f"the orbit could close after {plural(fewer, 'arc')}")
        slopes = plain.jacobian([each.end for each in passed], [each.derivatives for each in passed])
        if not invertible(slopes):
            raise NotProved("the orbits of the family could not be shown to go on to other values of its parameter")
        period = sum((part[-1] for part in parts), arb(0))
        said = [enclosure(ball, digits, margin) for ball in (value, period)]
        state, tangent = (tuple(enclosure(ball, digits, margin) for ball in parts[0][k : k + d]) for k in (0, d))
        return replace(
            about, proved=True, contraction=first.contraction, value=said[0], period=said[1], state=state,
            tangent=tangent,
        )  # fmt: skip


def invertible(slopes: Any) -> bool:
    """True when every matrix of balls is regular."""
    return norm(identity(slopes.nrows()) - exact(approximate_inverse(floats(slopes))) * slopes) < 1


def prove_event(
    family: Family, number: int, model: Model | None = None, options: Options | None = None,
    progress: Progress | None = None,
) -> BorderedRecord:  # fmt: skip
    """The proof of an event of a family (counted from 0), or the reason why there is none. Raises `InputError`."""
    began, say = time.perf_counter(), progress or silent
    options = options or Options(order=24, tolerance=1e-19)  # an event is asked for to many digits
    if not 0 <= number < len(family.events):
        raise InputError(f"--event: the family has {plural(len(family.events), 'event')}, counted from 0, got {number}")
    event = family.events[number]
    if not twists(event.kind, True):
        raise InputError(
            f"--event: {number} is a {event.kind.replace('_', ' ')}; give a fold, a doubling or a branch point, or "
            "prove a part of the family, --from A --to B, whose resonances are proved too"
        )
    point = family.points[event.index]
    model = with_parameters(model or provable_model(point), event.free)
    if not model.smooth:
        return timed(_prove_doubling(family, event, model, options, say), began)
    codes = programs(model)
    with precision(options.bits):
        orbit = replace(point, state=event.state, period=event.period)
        symmetry = chosen_symmetry(orbit, model, codes, options.symmetry)
        start = approach(model, orbit, symmetry, options.segments, frequency=frequency(model, codes))
        form = start.formulation
        about = BorderedRecord(
            family.name, model.system, family.parameter, event.kind, form.symmetry.name, form.segments, form.constants,
            form.turns, 0 if form.drive is None else model.forcing_cycles(event.period), (1, 1), (), (), 0.0,
            options.order, options.bits, options.tolerance,
        )  # fmt: skip
        try:
            ways = twists(event.kind, symmetry.reverses)
            runs = [_EventProof(replace(about, twist=twist), model, say) for twist in ways]
            nodes, flow_there = start.nodes[:, : form.components], start.flow
            near = [run.begun(nodes, start.duration, flow_there, event.parameter) for run in runs]
            run = runs[int(np.argmin(near))]
            say(f"what varies the orbit closes to {min(near):.2g}")
            run.solved()
            proof = run.concluded()
            apart = abs(float(proof.value["value"]) - event.parameter)
            if {proof.kind: apart <= options.nearness} != {event.kind: True}:
                near_by = f"a {proof.kind} is {apart:.3g} away from it"
                raise NotProved(f"no such event within {options.nearness:g} of the record; {near_by}")
        except UNPROVED as error:
            proof = replace(about, reason=why_not(error))
    return timed(proof, began)


def _prove_doubling(family: Family, event: Event, model: Model, options: Options, say: Progress) -> BorderedRecord:
    """See `prove_event`, of orbits with events."""
    orbit = replace(family.points[event.index], state=event.state, period=event.period)
    about = BorderedRecord(
        family.name, model.system, family.parameter, event.kind, "none", len(model.cycle), (), (), 0, (-1, -1), (), (),
        0.0, options.order, options.bits, options.tolerance,
    )  # fmt: skip
    with precision(options.bits):
        run = _GaitEventProof(about, model, say)
        try:
            say(f"what varies the orbit is turned round to {run.begun(orbit, event.parameter):.2g}")
            run.solved()
            proof = run.concluded()
            apart = abs(float(proof.value["value"]) - event.parameter)
            if not apart <= options.nearness:
                raise NotProved(f"no such event within {options.nearness:g} of the record; it is {apart:.3g} away")
        except UNPROVED as error:
            return replace(about, reason=why_not(error))
    return proof


def proving(asked: Table) -> Proving:
    """How the event of a family is proved that is asked for. Raises `InputError`."""
    number, options = asked["event"], chosen_options(asked, order=24, tolerance=1e-19)
    refuse(asked, "is for orbits; a single event is proved here", *vars(options), "event")
    return Proving(
        lambda family, model, say: prove_event(family, number, model, options, say), events.document, events,
        "--event: give a single FAMILY.json", load_family, file=f"event-{number}-proof.json", part=f": event {number}",
    )  # fmt: skip


def read_event(path: Path) -> BorderedRecord:
    """An event-proof.json. Raises `InputError`."""
    record = events.load(path)
    checked(Options(record.order, record.bits, record.tolerance, segments=record.segments))
    signs, numbers = {*record.twist} <= {1, -1}, (*record.centre, *record.flow, record.radius)
    if not (signs and record.radius > 0 and np.all(np.isfinite(numbers))):
        raise InputError(f"{path}: twist, centre, flow or radius: no usable numbers; {events.again}")
    return record


def replayed_event(
    record: BorderedRecord, model: Model | None = None, progress: Progress | None = None
) -> BorderedRecord:  # fmt: skip
    """A recorded proof done again from its centre, balls without a margin. Raises `InputError`."""
    with precision(record.bits):
        model, say = model or build_model(dict(record.system)), progress or silent
        proof = _EventProof if model.smooth else _GaitEventProof
        return done_again(record, lambda: proof(record, model, say).concluded(1.0, 2 * DIGITS))


def false_claims(record: BorderedRecord, fresh: BorderedRecord) -> list[str]:
    """Every claim of a recorded proof that the proof done again does not bear out."""
    if not fresh.proved:
        return [fresh.reason]
    compared: dict[str, Same] = {"proved": eq, "kind": eq, "side": eq, "contraction": bounding}
    compared |= dict.fromkeys(("value", "energy", "period", "state", "tangent"), holds)
    return list(contradictions(plain(record), plain(fresh), compared).values())


def replay(path: Path, trusted: Path | None, progress: Progress) -> tuple[BorderedRecord, list[str], str]:
    """The proof in an event-proof.json done again (see `Kind.replay`)."""
    record = read_event(path)
    fresh = replayed_event(record, build_model(dict(record.system), trusted), progress)
    return fresh, false_claims(record, fresh), fresh.kind.replace("_", " ")
