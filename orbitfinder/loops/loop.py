"""A loop of arcs that must close: its unknowns, its rows and their Jacobian.

The unknowns are w = (nodes, T, s, freed parameters), and only this file knows that order. The rows are

    x_{k+1} - x(end of segment k)         continuity
    P (B0 x_0 + B1 x(end) - c)            the link that closes the loop: the period, or a symmetry of a part of it
    normals (x - reference)               phases: time, and what else shifts an orbit into another
    conditions                            pins, what is held, the aim that picks one orbit of a family

P is 1. A relative orbit comes back up to a shift along k cyclic coordinates, x(T) = x(0) + sum_j d_j g_j: its P leaves
out the k rows that such a shift changes, and d is read off the motion. The count, of m momenta in all: 2n - k rows and
1 + m phases (time, and the shift of each momentum) in 2n + 1 + (1 + m) unknowns (a state, T, and an unfolding of the
energy and of each momentum). 1 + k conditions pick one orbit, such as the energy and the momenta of the k coordinates.

Nothing here integrates (see `integrate.march`) or solves (see `loops.newton`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from threading import get_ident
from typing import Any, Self, cast

import casadi as ca
import numpy as np

from orbitfinder._runtime.caches import Kept, Same
from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.integrate.compiled import mode
from orbitfinder.integrate.evaluate import Buffered
from orbitfinder.integrate.march import Gridded, March, Marches, Varied, divided
from orbitfinder.loops.condensed import Inner, Linearised
from orbitfinder.loops.symmetry import Symmetry, moved, symplectic
from orbitfinder.mechanics.hybrid import Transition, freed, share
from orbitfinder.mechanics.model import Model, field_apart, inputs_of, vector_field
from orbitfinder.records.orbit import SHARE

_marches = Kept[March](16)
_equations = Kept["Equations"](16)
NO_GUARDS = np.zeros(0)
GRAZED, ROUND_OFF = 1e-30, EPSILON
"""A guard's rate at least, by which what grazes it is multiplied; and what a sum is known to, relative to the sizes of
its terms"""


@dataclass(frozen=True)
class Unknowns:
    """w: nodes (N x d) at every M/N-th place of the `mesh` (M + 1, in periods), period, unfolding, freed parameters."""

    nodes: np.ndarray
    period: float
    unfolding: np.ndarray
    free: np.ndarray
    mesh: np.ndarray

    @cached_property
    def head(self) -> np.ndarray:
        """(x(0), T, free): what identifies the orbit, whatever the number of segments."""
        return np.concatenate([self.nodes[0], [self.period], self.free])

    @cached_property
    def tail(self) -> np.ndarray:
        """(T, s, free), the parameters of the flow."""
        return np.concatenate([[self.period], self.unfolding, self.free])

    @property
    def steps(self) -> int:
        """Steps of the mesh in a segment."""
        return (self.mesh.size - 1) // len(self.nodes)

    @property
    def edges(self) -> np.ndarray:
        """Where the segments begin and end (N + 1), in periods."""
        return self.mesh[:: self.steps]

    @cached_property
    def shares(self) -> np.ndarray:
        """The share of the period (N) that each node stands for: half of the segments on its two sides."""
        lengths = np.diff(self.edges) / (self.edges[-1] - self.edges[0])
        return np.asarray(0.5 * (lengths + np.roll(lengths, 1)))

    @cached_property
    def vector(self) -> np.ndarray:
        """w as one vector."""
        return np.concatenate([self.nodes.ravel(), self.tail])

    def at(self, vector: np.ndarray) -> Unknowns:
        """The unknowns that a vector over w stands for."""
        count, size = self.nodes.shape
        cut, last = count * size, vector.size - self.free.size
        nodes = vector[:cut].reshape(count, size)
        w = Unknowns(nodes, float(vector[cut]), vector[cut + 1 : last], vector[last:], self.mesh)
        known = {"shares": self.__dict__["shares"]} if "shares" in self.__dict__ else {}
        w.__dict__.update(vector=vector, tail=vector[cut:], **known)
        return w

    def symbols(self) -> tuple[list[ca.MX], list[ca.MX]]:
        """Symbols of CasADi for the nodes and for T, s and free, which stacked stand for the vector."""
        nodes = [ca.MX.sym("node", self.nodes.shape[1]) for _ in self.nodes]
        tail = zip(("period", "unfolding", "free"), (1, self.unfolding.size, self.free.size), strict=True)
        return nodes, [ca.MX.sym(name, size) for name, size in tail]

    def on(self, mesh: np.ndarray) -> Unknowns:
        """The same on another mesh."""
        w = Unknowns(self.nodes, self.period, self.unfolding, self.free, mesh)
        w.__dict__.update(vector=self.vector, tail=self.tail)  # known already
        return w

    def moved(self, step: np.ndarray) -> Unknowns:
        """w + step."""
        return self.at(self.vector + step)

    def joined(self, node: np.ndarray, period: float, unfolding: float, free: np.ndarray) -> np.ndarray:
        """A vector over w: `node` (d) for each node, one number for all of the unfolding."""
        (count, size), cut = self.nodes.shape, self.nodes.size
        row = np.empty(cut + 1 + self.unfolding.size + self.free.size)
        row[:cut].reshape(count, size)[:], row[cut] = node, period
        row[cut + 1 : row.size - self.free.size], row[row.size - self.free.size :] = unfolding, free
        return row

    def spread(self, head: np.ndarray) -> np.ndarray:
        """A row over w out of a row over the head (x(0), T, free)."""
        count, size = self.nodes.shape
        row = np.zeros(count * size + 1 + self.unfolding.size + self.free.size)
        row[:size] = head[:size]
        row[count * size] = head[size]
        row[row.size - self.free.size :] = head[size + 1 :]
        return row

    def over(self, row: np.ndarray) -> np.ndarray:
        """A row over w: itself, or one over the head spread."""
        return row if row.size == self.vector.size else self.spread(row)

    def head_of(self, whole: np.ndarray) -> np.ndarray:
        """The entries of a vector over w that belong to the head."""
        count, size = self.nodes.shape
        return np.concatenate([whole[:size], [whole[count * size]], whole[whole.size - self.free.size :]])

    def displacement(self, other: Unknowns) -> np.ndarray | None:
        """`other` minus this over w, or None where their segments differ."""
        if self.nodes.shape != other.nodes.shape or not np.array_equal(self.edges, other.edges):
            return None
        return np.asarray(other.vector - self.vector)

    def blended(self, other: Unknowns, share: float) -> Unknowns:
        """The unknowns a share of the way to others, or the nearer of them where their segments differ."""
        moved = self.displacement(other)
        if moved is None:
            return self if share < 0.5 else other
        return self.moved(share * moved)


@dataclass(frozen=True, eq=False)
class Equations:
    """Everything about a loop that depends on the equations alone: built once, used for any number of guesses.

    `quantities(x, free)` gives the `levels`: values, d/dx, d/dfree. `action` says whether the action is integrated with
    the motion, `alone` whether that keeps to one processor, `by` which march does.
    """

    model: Model
    symmetry: Symmetry
    free: tuple[str, ...] = ()
    action: bool = False
    alone: bool = False
    by: type[March] = March
    given: InitVar[March | None] = None
    """what integrates the motion, where it is there already"""
    march: March | Marches = field(init=False)

    @classmethod
    def of(cls, model: Model, symmetry: Symmetry, free: tuple[str, ...] = (), by: type[March] = March) -> Equations:
        """Those of a family: the same ones for a thread that asks again, so that what they derive is derived once."""
        key = Same(model), symmetry, free, by, mode(), get_ident()
        return _equations(key, lambda: cls(model, symmetry, free, action=True, by=by))

    def __post_init__(self, given: March | None) -> None:
        if not self.model.smooth:
            object.__setattr__(self, "free", freed(self.model, self.free, self.symmetry.parts))
            part = self.model.hybrid.part(self.symmetry.parts)
            arcs = [self._marched(arc.model, k) for k, (arc, _) in enumerate(part)]
            object.__setattr__(self, "march", arcs[0] if len(arcs) == 1 else Marches(arcs))
        else:
            object.__setattr__(self, "march", given or self._marched(self.model))

    def _marched(self, model: Model, arc: int | None = None) -> March:
        """What integrates the loop, or one of its arcs in periods of its own: once for loops of a thread that differ in
        their links alone."""
        unfolded = tuple(invariant.name for invariant in self.symmetry.unfolded(model))
        parts = 0 if arc is None else self.symmetry.parts
        key = Same(self.model), self.free, unfolded, self.action, self.alone, self.by, arc, parts, get_ident()
        return _marches((key, mode()), lambda: self._derived(model, arc))

    def _derived(self, model: Model, arc: int | None) -> March:
        unfolded = self.symmetry.unfolded(model)
        flow = vector_field(model, self.free, unfolded)
        inputs, rate = inputs_of(flow), None
        if self.action:
            action = model.action_rate(inputs[0], inputs[1], model.parameters(self.free, inputs[3]))
            rate = ca.Function("action_rate", inputs, [action])
        if arc is not None:
            flow, rate = self._paced(flow, arc), None if rate is None else self._paced(rate, arc)
        elif self.by is March:
            return March(flow, model.forced, rate, self.alone, apart=field_apart(model, self.free, unfolded))
        return self.by(flow, model.forced, rate, self.alone)

    def _paced(self, function: ca.Function, arc: int) -> ca.Function:
        """A rate in arc k of K in the period, of which a period of the mesh lasts K shares of the period."""
        inputs = inputs_of(function)
        parts = self.symmetry.parts
        pace = parts * self.links.count * share(self.model, arc, self.model.parameters(self.free, inputs[3]), parts)
        return ca.Function(function.name(), inputs, [pace * function(*inputs)])

    @property
    def gridded(self) -> Gridded | None:
        """What integrates on a mesh of its own, if anything does: then there are many segments, of a step each."""
        return self.march if isinstance(self.march, Gridded) else None

    @property
    def method(self) -> str:
        """The name of the method of such a mesh; "" by shooting."""
        return self.by.name if self.gridded else ""

    def finer(self, mesh: np.ndarray) -> np.ndarray:
        """A mesh in steps half as long; where the march chooses it, as it is."""
        return mesh if self.gridded else divided(mesh, 2)

    @property
    def plain(self) -> bool:
        """Whether motions do not jump and come back without a shift."""
        return not (self.links or self.symmetry.relative)

    @property
    def can_rest(self) -> bool:
        """Whether motions may shrink to an equilibrium: plain ones that nothing drives."""
        return self.plain and not self.model.forced

    @property
    def parameter(self) -> str:
        """What a family is followed in unless told: the first freed parameter, or the energy."""
        return next(iter(self.physical), "energy")

    @cached_property
    def links(self) -> Links:
        """What leads from each arc of a hybrid system to the next."""
        return Links(self.model, self.free, self.symmetry.parts)

    @property
    def physical(self) -> tuple[str, ...]:
        """The freed parameters that are not durations of arcs."""
        return tuple(name for name in self.free if not name.startswith(SHARE))

    @property
    def size(self) -> int:
        """d, the length of a state."""
        return self.march.size

    @property
    def energy(self) -> int:
        """The number of the energy among the quantities."""
        return len(self.model.invariants)

    @cached_property
    def boundary(self) -> tuple[np.ndarray, np.ndarray]:
        """P B0 and P B1 (r x d)."""
        return self.symmetry.boundary(self.model.degrees_of_freedom)

    @cached_property
    def asked(self) -> np.ndarray | None:
        """P (r x d), None where all rows are asked."""
        return self.symmetry.asked(self.model.degrees_of_freedom)

    def aimed(self, constant: np.ndarray) -> np.ndarray:
        """P c of the boundary rows' constants (d)."""
        return constant if self.asked is None else self.asked @ constant

    @cached_property
    def quantities(self) -> ca.Function:
        """Invariants, energy, forcing period, with their derivatives."""
        x, free = ca.MX.sym("x", len(self.model.state_names)), ca.MX.sym("free", len(self.free))
        values = levels(self.model, x, self.model.parameters(self.free, free))
        return ca.Function("quantities", [x, free], [values, ca.jacobian(values, x), ca.jacobian(values, free)])

    @cached_property
    def momenta(self) -> ca.Function:
        """The Jacobian of (q, momentum) in (q, v) as a function of (x, free)."""
        model, n = self.model, self.model.degrees_of_freedom
        chosen = ca.MX.sym("free", len(self.free))
        if model.rates is not None:  # they are among the components of the state
            return ca.Function("momenta", [ca.MX.sym("x", n), chosen], [ca.densify(ca.MX.eye(n))])
        q, v = ca.MX.sym("q", n), ca.MX.sym("v", n)
        parameters = model.parameters(self.free, chosen)
        momentum = ca.gradient(model.kinetic(q, v, parameters), v)
        if model.gyroscopic is not None:
            momentum += ca.gradient(model.gyroscopic(q, v, parameters), v)
        lower = ca.horzcat(ca.jacobian(momentum, q), ca.jacobian(momentum, v))
        upper = ca.horzcat(ca.MX.eye(n), ca.MX(n, n))
        momenta = ca.Function("momenta_parts", [q, v, chosen], [ca.densify(ca.vertcat(upper, lower))])
        x = ca.MX.sym("x", 2 * n)
        return ca.Function("momenta", [x, chosen], momenta.call([x[:n], x[n:], chosen]))

    @cached_property
    def symplectic(self) -> bool:
        """Whether multipliers come in reciprocal pairs, whatever the freed parameters are."""
        return symplectic(moved(self.model, self.free))

    @cached_property
    def _generators(self) -> tuple[ca.Function, ...]:
        return self.symmetry.generators(self.model)

    def watched(self, function: ca.Function, states: np.ndarray, free: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A guard, or what else is a function (x, p), at states (k x d): its values (k) and slopes (k x d)."""
        key = "watched", id(function)
        if key not in self.derived:
            x, chosen = ca.MX.sym("x", self.size), ca.MX.sym("free", len(self.free))
            value = function(x, self.model.parameters(self.free, chosen))
            rows = ca.densify(ca.vertcat(value, ca.jacobian(value, x).T))
            self.derived[key] = ca.Function("watched", [x, chosen], [rows])
        both = self.march.arcs[0].along(self.derived[key], states, np.atleast_2d(free))
        return both[:, 0], both[:, 1:]

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """What is derived for conditions and guards, so that it is once, and the quantities of the last w."""
        return {}

    @property
    def numbers(self) -> np.ndarray:
        """The model's own values of the freed parameters."""
        return self.model.values_of(self.free)

    def unknowns(self, nodes: np.ndarray, period: float, mesh: np.ndarray, free: np.ndarray | None = None) -> Unknowns:
        """w without unfolding, the freed parameters at their own values."""
        numbers = self.numbers if free is None else free
        return Unknowns(nodes, float(period), np.zeros(self.march.unfolding), numbers, mesh)

    def quantities_at(self, w: Unknowns) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Their values (k) at x(0), their derivatives by the state and by freed parameters; not to be written to."""
        vector, *known = self.derived.get("quantities", (None,))
        if vector is not w.vector:  # asked for row by row, on one mesh after another
            known = self.march.at(self.quantities, w.nodes[0], w.free)
            self.derived["quantities"] = w.vector, *known
        values, slopes, by_free = known
        return values.ravel(), slopes, by_free

    def momentum_slopes(self, x: np.ndarray, free: np.ndarray) -> np.ndarray:
        """The Jacobian (d x d) of (q, momentum) in (q, v) at one state."""
        return self.march.at(self.momenta, x, free)[0]

    def stated(self, conditions: Sequence[Condition]) -> ca.Function:
        """Values and slopes of conditions by (x, T, free); free variables are left where they see more of w."""
        key = "stated", *((condition.name, condition.cycles) for condition in conditions)
        if key not in self.derived:
            x, period, free = ca.MX.sym("x", self.size), ca.MX.sym("T"), ca.MX.sym("free", len(self.free))
            nodes = [x, ca.MX.sym("node", self.size)]
            values = ca.vertcat(*(condition.expression(self, nodes, period, free) for condition in conditions))
            by = [ca.jacobian(values, part) for part in (x, period, free)]
            given, rows = [x, period, free], [ca.densify(values), ca.densify(ca.horzcat(*by))]
            self.derived[key] = ca.Function("conditions", given, rows, {"allow_free": True})
        return cast(ca.Function, self.derived[key])

    def named(
        self, conditions: Sequence[Condition], x: np.ndarray, periods: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The same of conditions (c) that see no more, at states (k x d) and periods (k x 1): k x c, k x c x d + 1."""
        if not conditions:
            return np.zeros((len(x), 0)), np.zeros((len(x), 0, self.size + 1))
        key = "named", *((condition.name, condition.cycles) for condition in conditions)
        if key not in self.derived:
            inputs = self.stated(conditions).mx_in()
            rows = ca.horzcat(*self.stated(conditions)(*inputs))
            self.derived[key] = ca.Function("named", inputs, [ca.vec(rows.T)])
        both = self.march.arcs[0].along(self.derived[key], x, periods, self.numbers[None])
        both = both.reshape(len(x), len(conditions), -1)
        return both[:, :, 0], both[:, :, 1:]

    def varied(self, w: Unknowns, states: bool = False) -> Varied:
        """All segments of w integrated with their derivatives."""
        return self.march.varied(w.nodes, w.mesh, w.tail, states)

    def changed(self, w: Unknowns) -> Varied:
        """`varied` with states for Newton's method, which may change what is within segments once, not solve it."""
        if march := self.gridded:
            return march.once(w.nodes, w.mesh, w.tail)
        return self.varied(w, states=True)

    def varied_each(self, places: Sequence[Unknowns], states: bool = False) -> list[Varied]:
        """The same of several w on one mesh, beside each other."""
        nodes, tails = np.array([w.nodes for w in places]), np.array([w.tail for w in places])
        return self.march.varied_each(nodes, places[0].mesh, tails, states)

    def ends(self, w: Unknowns) -> np.ndarray:
        """The ends (N x d) of all segments of w."""
        return self.march.ends(w.nodes, w.mesh, w.tail)

    def phases(self, w: Unknowns, units: np.ndarray | None = None, count: int | None = None) -> np.ndarray:
        """Normals (k x d, or k x N d) of the hyperplanes through w that fix time and other shifts; guards fix time too.

        Unit normals at x(0), or where states are measured in `units` (d) over all nodes, or so many: the integral
        condition sum_k m_k g_k . S^-2 (x_k - w_k) = 0, g the rates or a shift's generator.
        """
        nodes = w.nodes[:1] if units is None else w.nodes[:count]
        weights = np.ones((1, 1)) if units is None else w.shares[:count, None] / units**2
        sizes = np.ones(nodes.shape) if units is None else np.broadcast_to(units, nodes.shape)
        normals = []
        if not (self.symmetry.reverses or self.model.forced or self.model.hybrid):
            normals.append(self.march.rates(nodes, w.tail))
        n, values = self.model.degrees_of_freedom, self.model.parameter_values
        for generator in self._generators:
            normals.append(np.array([generator(x[:n], x[n:], values).full().ravel() for x in nodes]))
        rows = np.array([(normal * weights).ravel() for normal in normals]).reshape(len(normals), nodes.size)
        return np.asarray(rows / nonzero(np.linalg.norm(rows * sizes.ravel(), axis=1, keepdims=True)))


class Links:
    """The resets x+ = R(x-, p) and guards g(x-, p) at the ends of a hybrid system's arcs, with derivatives.

    None of a smooth one. Of an orbit with a symmetry those of the first of the equal `parts` of its period.
    """

    def __init__(self, model: Model, free: tuple[str, ...], parts: int = 1) -> None:
        arcs = () if model.smooth else model.hybrid.part(parts)
        self.count, self.parts, self.transitions = max(1, len(arcs)), parts, tuple(transition for _, transition in arcs)
        self.comparable = slice(1 if arcs else None)
        """of states at equal times those that a part of the period may repeat: where motions jump, the first alone"""
        self._parts = [Buffered(_link(model, transition, free, True)) for transition in self.transitions]
        self._passes = [Buffered(_link(model, transition, free, False)) for transition in self.transitions]

    def __bool__(self) -> bool:
        return bool(self.transitions)

    def shares(self, free: np.ndarray) -> np.ndarray:
        """The shares of the period that the arcs take (K), from the freed parameters."""
        last = free[free.size - (self.count - 1) :]
        return np.append(last, 1.0 / self.parts - last.sum())

    def repeated(self, free: np.ndarray, times: int, total: float = 1.0) -> np.ndarray:
        """Freed parameters of the cycle gone through so many times; with `total` 0, their changes."""
        if not self:
            return free
        physical, last = np.split(free, [free.size - (self.count - 1)])
        shares = np.append(last, total - last.sum()) / times
        return np.concatenate([physical, np.tile(shares, times)[:-1]])

    def ends(self, segments: int) -> np.ndarray:
        """The numbers of the segments that end arcs."""
        return (np.arange(len(self.transitions)) + 1) * (segments // self.count) - 1

    def units(self, w: Unknowns, unit: np.ndarray) -> np.ndarray:
        """What the guards (K) are measured in, states being measured in `unit` (d)."""
        return np.array([np.linalg.norm(parts[4] * unit) for parts in self.at(w, w.nodes)], float)

    def at(self, w: Unknowns, ends: np.ndarray) -> list[list[np.ndarray]]:
        """(R, g, dR/dx, dR/dfree, dg/dx, dg/dfree) of each arc."""
        places = self.ends(len(ends))
        return [[value.T for value in part(ends[k], w.free)] for part, k in zip(self._parts, places, strict=True)]

    def passed(self, w: Unknowns, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The ends with those of arcs reset, and the guards (K)."""
        if not self.transitions:
            return ends, NO_GUARDS
        after, guards = ends.copy(), np.empty(len(self.transitions))
        for k, (crossed, place) in enumerate(zip(self._passes, self.ends(len(ends)), strict=True)):
            reset, guard = crossed(ends[place], w.free)
            after[place], guards[k] = reset, guard.item()
        return after, guards

    def after(self, arc: int, x: np.ndarray, free: np.ndarray) -> np.ndarray:
        """The state (d) after the event that ends an arc at x; x itself where no event does."""
        return self._passes[arc](x, free)[0].ravel() if self else x

    def varied(self, w: Unknowns, path: Varied) -> tuple[np.ndarray, np.ndarray, Inner]:
        """Transitions and columns through the resets, and the guards' rows (`Linearised.inner`)."""
        transitions, columns, places = path.transitions.copy(), path.columns.copy(), self.ends(len(path.ends))
        slopes, tails, last = [], [], columns.shape[2] - w.free.size
        for k, (_, _, by_x, by_free, guard_by_x, guard_by_free) in zip(places, self.at(w, path.ends), strict=True):
            slopes.append((guard_by_x @ path.transitions[k]).ravel())
            tails.append((guard_by_x @ path.columns[k]).ravel())
            tails[-1][last:] += guard_by_free.ravel()
            transitions[k], columns[k] = by_x @ transitions[k], by_x @ columns[k]
            columns[k][:, last:] += by_free
        return transitions, columns, (places, np.array(slopes), np.array(tails))

    def saltated(self, w: Unknowns, path: Varied, march: March | Marches) -> np.ndarray:
        """The transitions (N x d x d) with each event's own time eliminated, by the rates f before and after it.

        S = DR + (f+ - DR f-) grad g / (grad g . f-). Source: R. Leine, H. Nijmeijer, Dynamics and Bifurcations of
        Non-Smooth Mechanical Systems (2004), section 7.
        """
        if not self:
            return path.transitions
        transitions, ends = path.transitions.copy(), self.ends(len(path.ends))
        shares = self.shares(w.free)[:, None] * self.count  # rates are in arcs' own periods
        early, late = (
            np.vstack([arc.rates(x[None], w.tail) for arc, x in zip(march.arcs, states, strict=True)]) / shares
            for states in (w.nodes[:: len(w.nodes) // self.count], path.ends[ends])
        )
        each = zip(ends, self.at(w, path.ends), late, np.roll(early, -1, axis=0), strict=True)
        for k, (_, _, by_x, _, slope, _), before, after in each:
            rate = (slope @ before).item()  # 0 where the guard is grazed
            turn = np.outer(after - by_x @ before, slope) / (rate if abs(rate) > GRAZED else GRAZED)
            transitions[k] = (by_x + turn) @ transitions[k]
        return transitions


def _link(model: Model, transition: Transition, free: tuple[str, ...], varied: bool) -> ca.Function:
    """(R, g) and, where asked for, their derivatives by state and freed parameters."""
    x, chosen = ca.MX.sym("x", len(model.state_names)), ca.MX.sym("free", len(free))
    p = model.parameters(free, chosen)
    after, guard = transition.reset(x, p), transition.guard(x, p)
    slopes = [ca.jacobian(value, by) for value in (after, guard) for by in (x, chosen)] if varied else []
    return ca.Function("link", [x, chosen], [after, guard, *map(ca.densify, slopes)])


@dataclass(frozen=True, eq=False)
class Condition:
    """One row of a loop: a number of its unknowns that has a `value`. `loops.conditions` makes them.

    What the row is measured in, and what of it may be round-off, follows from its slope.

    Args:
        name: of what it holds, "" of a hyperplane.
        value: what that is to be.
        at: (equations, w) -> what it is.
        slope: (equations, w) -> its derivative over w.
        expression: (equations, nodes, T, free) -> the same in CasADi.
        cycles: of what says how many periods of the forcing the motion lasts, these.
    """

    name: str
    value: float
    at: Callable[[Equations, Unknowns], float]
    slope: Callable[[Equations, Unknowns], np.ndarray]
    expression: Callable[[Equations, Sequence[ca.MX], ca.MX, ca.MX], ca.MX]
    cycles: int = 0


@dataclass(frozen=True, eq=False)
class Loop:
    """One loop: equations, what its link is displaced by (`constant`), phases, conditions."""

    equations: Equations
    constant: np.ndarray
    conditions: tuple[Condition, ...] = ()
    normals: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    reference: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def cycles(self) -> int:
        """Periods of the forcing in one of the orbit, as its clock says; 0 without one."""
        return next((condition.cycles for condition in self.conditions if condition.cycles), 0)

    def through(self, w: Unknowns) -> Self:
        """The same loop with its phases fixed by hyperplanes through w."""
        return replace(self, normals=self.equations.phases(w), reference=w.nodes[0])

    def rows(self, w: Unknowns, ends: np.ndarray, *aims: Condition) -> np.ndarray:
        """The residual, segments ending at `ends` (N x d); those of aims last."""
        first, last = self.equations.boundary
        ends, guards = self.equations.links.passed(w, ends)
        closing = first @ w.nodes[0] + last @ ends[-1] - self.equations.aimed(self.constant)
        away = self.normals @ (w.vector[: self.normals.shape[1]] - self.reference)  # off each phase
        rows = [(ends[:-1] - w.nodes[1:]).ravel(), closing, away]
        named, count = self.values(w, (*self.conditions, *aims)), len(self.conditions)
        return np.concatenate([*rows, named[:count], guards, named[count:]])

    def stated(self, nodes: Sequence[ca.MX], period: ca.MX, free: ca.MX, ends: Sequence[ca.MX]) -> ca.MX:
        """The same rows as an expression of CasADi."""
        first, last = (ca.sparsify(ca.DM(part)) for part in self.equations.boundary)
        links, ends, guards = self.equations.links, list(ends), []
        p = self.equations.model.parameters(self.equations.free, free)
        for transition, place in zip(links.transitions, links.ends(len(ends)), strict=True):
            guards.append(transition.guard(ends[place], p))
            ends[place] = transition.reset(ends[place], p)
        rows = [end - node for end, node in zip(ends, nodes[1:], strict=False)]
        rows.append(first @ nodes[0] + last @ ends[-1] - self.equations.aimed(self.constant))
        rows += [ca.dot(ca.DM(normal), nodes[0] - self.reference) for normal in self.normals]
        rows += [ca.MX(-each.value) + each.expression(self.equations, nodes, period, free) for each in self.conditions]
        return ca.vertcat(*rows, *guards)

    def linearised(self, w: Unknowns, path: Varied) -> Linearised:
        """The derivatives of the rows."""
        first, last = self.equations.boundary
        slopes, size, cut = self.slopes(w, self.conditions), self.equations.size, w.nodes.size
        more, before = len(self.normals) + len(slopes), len(first) + len(self.normals)
        rows = np.zeros((len(first) + more, cut if np.any(slopes[:, size:cut]) else max(size, self.normals.shape[1])))
        rows[: len(first), :size], rows[len(first) : before, : self.normals.shape[1]] = first, self.normals
        rows[before:] = slopes[:, : rows.shape[1]]
        tail, end = np.zeros((len(rows), slopes.shape[1] - cut)), np.zeros((len(rows), size))
        tail[before:], end[: len(first)] = slopes[:, cut:], last
        links, transitions, columns, kept = self.equations.links, path.transitions, path.columns, path.kept
        inner: Inner | None = None
        if links:
            (transitions, columns, inner), kept = links.varied(w, path), {}
        return Linearised(transitions, columns, rows, end, tail, inner, kept)

    def lost(self, w: Unknowns, aims: Sequence[Condition] = (), slopes: np.ndarray | None = None) -> np.ndarray:
        """What of each row near w may be round-off, those of aims last: where an energy is large beside its changes.

        Told for conditions by the sizes of their terms; 0 of all other rows. `slopes` are those of conditions and aims.
        """
        chosen, count = (*self.conditions, *aims), len(self.conditions)
        values = np.abs(np.array([condition.value for condition in chosen]))
        slopes = self.slopes(w, chosen) if slopes is None else slopes
        named = ROUND_OFF * (np.abs(slopes) @ np.abs(w.vector) + 2 * values)
        return np.concatenate(
            [np.zeros(self._unnamed(w)), named[:count], np.zeros(len(self.equations.links.transitions)), named[count:]]
        )

    def size(self, w: Unknowns) -> int:
        """How many rows there are, those of aims not counted."""
        return self._unnamed(w) + len(self.conditions) + len(self.equations.links.transitions)

    def _unnamed(self, w: Unknowns) -> int:
        return (len(w.nodes) - 1) * self.equations.size + len(self.equations.boundary[0]) + len(self.normals)

    def values(self, w: Unknowns, conditions: Sequence[Condition]) -> np.ndarray:
        """The residuals of conditions."""
        return np.array([each.at(self.equations, w) - each.value for each in conditions], float)

    def slopes(self, w: Unknowns, conditions: Sequence[Condition]) -> np.ndarray:
        """Their derivatives by w."""
        slopes = np.zeros((len(conditions), w.vector.size))
        for row, condition in zip(slopes, conditions, strict=True):
            row += condition.slope(self.equations, w)
        return slopes


def beyond(rows: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Rows without what may be round-off, of which no step is better than another."""
    return np.asarray(rows * ~(np.abs(rows) <= lost))


def levels(model: Model, x: Any, parameters: Any) -> Any:
    """The invariants at a state in their order, then the energy, then where there is one the forcing period."""
    q, v = x[: model.degrees_of_freedom], x[model.degrees_of_freedom :]
    values = [invariant.value(q, v, parameters) for invariant in model.invariants]
    values.append(model.kinetic(q, v, parameters) + model.potential(q, parameters))
    if model.forcing_period is not None:
        values.append(model.forcing_period(parameters))
    return ca.vertcat(*values)
