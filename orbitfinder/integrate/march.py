"""The flow on a mesh: eighth-order Runge-Kutta over all shooting segments, of states or of states and variations.

    x' = f(t, x, s, p),    Y' = df/dx Y + [0 | df/ds | df/dp],    S' = the rate of an integral

A mesh is given in periods, from 0 to the fraction of the period that is integrated, M steps for N segments of M/N steps
each: uniform or graded, so that neighbouring orbits are integrated alike and a segment is one call without Python.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import casadi as ca
import numpy as np

from orbitfinder.errors import IntegrationError
from orbitfinder.integrate.compiled import compiled
from orbitfinder.integrate.lanes.kernel import WIDE, Kernel, kernel, varied_kernel
from orbitfinder.integrate.parallel import STAGES, Lanes
from orbitfinder.integrate.rk8 import slopes_of, step_of, variational_field
from orbitfinder.mechanics.model import inputs_of

EFFORT = 3.0
"""Seconds of interpreted marching in a family of moderate length, for `compiled`."""
LEAST_TOGETHER, MOST_TOGETHER = 5, 16
"""Components of a state for which eight segments pay: a smaller system's time is that of the linear algebra"""
_NOTHING = np.zeros(0)
QUANTUM = 4
"""Numbers of steps are rounded up to a multiple of this, so that few different marches are made."""


Placed = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Nodes (N x d), mesh and tail of a loop"""


@dataclass(frozen=True)
class Varied:
    """One integration of all segments with its derivatives.

    `ends` (N x d), `transitions` (N x d x d), `columns` (N x d x m) by (T, s, free); where they were asked for `states`
    (M + 1 x d) at the mesh; the `integral` over the horizon. `change` is what solving their equations moved last, in
    extents of the motion, of which its square is left. `kept` is what was made of the derivatives and takes long.
    """

    ends: np.ndarray
    transitions: np.ndarray
    columns: np.ndarray
    states: np.ndarray
    integral: float
    change: float = 0.0
    kept: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)


class March:
    """Integrates the segments of a loop; each kind of step is compiled when it is first needed.

    `field(t, x, s, free)` is dx/dt (d), `forced` says whether t matters; `integrand`, of the same arguments, is carried
    along, `apart` is what `lanes.factors` may make variations of. `tail` is (T, s, free) everywhere. Not to be shared
    by threads: its functions have one work space each.
    """

    name: ClassVar[str] = "shooting"
    stiff: ClassVar[bool] = False
    """Its name in the table of methods, and whether what it is for is stiff"""
    first_segments: ClassVar[int] = 1
    first_steps: ClassVar[int] = 160
    """Segments of one period of a guess, before there is an error estimate to go by, and the steps in each"""

    def __init__(
        self,
        field: ca.Function,
        forced: bool = False,
        integrand: ca.Function | None = None,
        alone: bool = False,
        effort: float = EFFORT,
        apart: ca.Function | None = None,
    ) -> None:
        self._apart, self._inverses = apart, alone
        self.field, self.forced, self.integrand, self._effort = field, forced, integrand, effort
        self.size, self.unfolding, self.free = (int(field.size1_in(k)) for k in (1, 2, 3))
        self._lanes, self._kernels = Lanes(alone), dict[bool, Kernel | None]()
        self._steps = dict[tuple[bool, bool], ca.Function]()

    @property
    def arcs(self) -> tuple[March, ...]:
        """The marches of the arcs: itself."""
        return (self,)

    @property
    def columns(self) -> int:
        """Columns of Y: the state's, the unfolding's, the freed parameters'."""
        return self.size + self.unfolding + self.free

    @cached_property
    def _varied(self) -> ca.Function:
        """The field of (x, vec Y, S), in another form where it is interpreted."""
        whole = variational_field(self.field, self.integrand)
        if compiled(step_of(whole), effort=self._effort).class_name() == "External":
            return whole
        return variational_field(self.field, self.integrand, products=True)

    @cached_property
    def _carried(self) -> ca.Function:
        """The field of a state, and where variations are dear of S beside it."""
        if self.integrand is None or not self.wide:
            return self.field
        inputs = inputs_of(self.field)
        added = type(inputs[1]).sym("S", self.integrand.numel_out(0))
        given = [inputs[0], ca.vertcat(inputs[1], added), *inputs[2:]]
        return ca.Function("carried", given, [ca.vertcat(self.field(*inputs), self.integrand(*inputs))])

    def _step(self, varied: bool, error: bool = False) -> ca.Function:
        """A step with variations or without, or its error, compiled at first use."""
        if (varied, error) not in self._steps:
            step = step_of(self._varied if varied else self._carried, error)
            self._steps[varied, error] = compiled(step, effort=self._effort)
        return self._steps[varied, error]

    def build(self) -> None:
        """Derive and compile now what integrates states and derivatives, not at first use."""
        self.ahead()
        assert (self._kernel(False) or self._step(False)) and (self._kernel(True) or self._step(True))

    def _kernel(self, varied: bool, segments: int = 0) -> Kernel | None:
        """What marches in lanes, with variations or without; decided at first use, for good."""
        if varied not in self._kernels:
            self._kernels[varied] = self._compiled(varied, segments == 1)
        return self._kernels[varied]

    def ahead(self) -> None:
        """Have compilers begin beside each other with what integrates states and derivatives, where that takes long."""
        for varied in (False, True) if self.wide and not self._kernels else ():
            self._compiled(varied, False, True)

    def _compiled(self, varied: bool, alone: bool, ahead: bool = False) -> Kernel | None:
        if not varied:
            return kernel(self._carried, self._effort, alone, self._inverses, ahead=ahead)
        how = self._effort, alone, self._apart, self._inverses
        return varied_kernel(self.field, self.integrand, *how, ahead=ahead)

    def ends(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (N x d) at the ends of the segments from their nodes (N x d). Raises `IntegrationError`."""
        return self._reached(nodes, mesh, tail)[:, : self.size]

    def integral(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> float:
        """The integral over the horizon, without variations where they are dear."""
        if not self.wide:
            return self.varied(nodes, mesh, tail).integral
        return float(self._reached(nodes, mesh, tail)[:, self.size :].sum())

    def _reached(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        start = self._begun(nodes, self._clock(nodes, mesh, tail), self._none)
        return _finite(self._marched(False, start, _parameters(mesh, tail), 0)[0], nodes)[:, 1:]

    def _marched(
        self, varied: bool, start: np.ndarray, parameters: np.ndarray, kept: int, loops: int = 1,
        begins: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """The ends (N x ...) of the segments that begin at `start`, and the first `kept` numbers of every step's.

        The segments are those of so many `loops`, one after another, or their steps begin at these numbers (N + 1).
        """
        quick = self._kernel(varied, len(start))
        if quick is not None:
            return quick.marched(start, parameters, kept, begins)
        if begins is not None:
            own = zip(start, np.split(parameters, begins[1:-1]), strict=True)
            each = [self._marched(varied, begun[None], given, kept) for begun, given in own]
            return np.concatenate([end for end, _ in each]), np.concatenate([path for _, path in each])
        step = self._step(varied)
        own = zip(np.split(start, loops), np.split(parameters, loops), strict=True)
        path = np.concatenate([self._lanes.marched(step, *each, bool(kept)) for each in own])
        steps = len(parameters) // len(start) if kept else 1
        return path[steps - 1 :: steps], path[:, :kept]

    @property
    def wide(self) -> bool:
        """Whether columns fill the registers."""
        return self.size * (1 + self.columns) >= WIDE

    @property
    def together(self) -> bool:
        """Whether segments are marched side by side, and there is so much in a step that it pays."""
        return LEAST_TOGETHER <= self.size <= MOST_TOGETHER and self._kernel(True) is not None

    def states(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (M + 1 x d) at the mesh."""
        start = self._begun(nodes, self._clock(nodes, mesh, tail), self._none)
        path = self._marched(False, start, _parameters(mesh, tail), 1 + self.size)[1]
        return np.vstack([nodes[:1], _finite(path, nodes)[:, 1:]])

    def sampled(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, places: np.ndarray) -> np.ndarray:
        """States (k x d) at the places (k, in periods) of a mesh that is finer than the orbit's."""
        del mesh
        return self.states(nodes, places, tail)

    def beside(self, varied: bool, loops: Sequence[Placed], kept: int = 0) -> tuple[np.ndarray, np.ndarray]:
        """Numbers (t, x) or (t, x, vec Y, S) at the ends of all segments of loops on meshes of their own, in one
        call; of every step's the first `kept`. What leaves the numbers stays so."""
        starts, counts = (
            np.concatenate([nodes for nodes, _, _ in loops]),
            np.array([(mesh.size - 1, len(nodes)) for nodes, mesh, _ in loops]),
        )
        clock = np.concatenate([self._clock(*loop) for loop in loops]) if self.forced else 0.0
        start = self._begun(starts, clock, self._unit if varied else self._none)
        parameters = np.repeat([tail for _, _, tail in loops], counts[:, 0], axis=0)
        steps = np.diff(np.concatenate([mesh for _, mesh, _ in loops]))
        parameters[:, 0] *= np.delete(steps, np.cumsum(counts[:-1, 0] + 1) - 1)
        begins = np.zeros(len(start) + 1, np.intp)
        np.cumsum(np.repeat(counts[:, 0] // counts[:, 1], counts[:, 1]), out=begins[1:])
        return self._marched(varied, start, parameters, kept, begins=begins)

    def varied(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, states: bool = False) -> Varied:
        """Ends and their derivatives; with `states` those at the mesh too. Raises `IntegrationError`."""
        return self.varied_each(nodes[None], mesh, tail[None], states)[0]

    def varied_each(self, nodes: np.ndarray, mesh: np.ndarray, tails: np.ndarray, states: bool = False) -> list[Varied]:
        """The same of several loops on one mesh, of nodes (B x N x d) and tails (B x m), beside each other."""
        (loops, count, size), own = nodes.shape, self.columns
        starts, clocks = nodes.reshape(-1, size), [self._clock(nodes[0], mesh, tail) for tail in tails]
        parameters = np.concatenate([_parameters(mesh, tail) for tail in tails])
        start = self._begun(starts, np.concatenate(clocks), self._unit)
        last, path = self._marched(True, start, parameters, 1 + size if states else 0, loops)
        edges = mesh[None, :: (mesh.size - 1) // count]
        ends, transitions, columns = self.derivatives(nodes, _finite(last, starts, loops), edges, tails)
        if states:
            inside = _finite(path, starts, loops)[:, 1:].reshape(loops, -1, size)
            nodes = np.concatenate([nodes[:, :1], inside], axis=1)
        rest = last[:, 1 + size * (1 + own) :].reshape(loops, -1)
        return list(map(Varied, ends, transitions, columns, nodes, [float(each.sum()) for each in rest]))

    def derivatives(
        self, nodes: np.ndarray, last: np.ndarray, edges: np.ndarray, tails: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`ends` (B x N x d), `transitions`, `columns` of loops whose segments, between `edges` (1 or B x N + 1), have
        led to `last` (BN x ...)."""
        (loops, count, size), own = nodes.shape, self.columns
        last = last.reshape(loops, count, -1)
        ends = last[:, :, 1 : 1 + size]
        matrices = last[:, :, 1 + size : 1 + size * (1 + own)].reshape(loops, count, own, size).swapaxes(2, 3)
        transitions = matrices[:, :, :, :size]
        columns = np.empty((loops, count, size, 1 + own - size))
        columns[:, :, :, 0] = self._by_period(nodes, ends, transitions, edges, tails)
        columns[:, :, :, 1:] = matrices[:, :, :, size:]
        return ends, transitions, columns

    def _by_period(
        self, nodes: np.ndarray, ends: np.ndarray, transitions: np.ndarray, edges: np.ndarray, tails: np.ndarray
    ) -> np.ndarray:
        """d(ends)/dT (B x N x d): a segment gets longer and, which a forced system sees, begins later."""
        (loops, count, size), each = nodes.shape, np.repeat(tails, nodes.shape[1], axis=0)
        durations, times = (edges[:, 1:] - edges[:, :-1])[:, :, None], tails[:, :1] * edges
        if not self.forced or not edges[:, :-1].any():
            rates = self.rates(ends.reshape(-1, size), each, times[:, 1:].ravel())
            return np.asarray(rates.reshape(loops, count, size) * durations)
        states, moments = np.concatenate([ends, nodes]), np.concatenate([times[:, 1:], times[:, :-1]])
        rates = self.rates(states.reshape(-1, size), np.concatenate([each, each]), moments.ravel())
        late, early = rates.reshape(2, loops, count, size)
        return np.asarray(late * durations + (late - (transitions @ early[..., None])[..., 0]) * edges[:, :-1, None])

    def slopes(self, x: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """d(dx/dt)/dx (d x d) at a state (d)."""
        return self.linearised(x, tail)[1]

    def linearised(self, x: np.ndarray, tail: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """dx/dt (d) and d(dx/dt)/dx (d x d) at a state (d)."""
        s, free = tail[1 : 1 + self.unfolding], tail[1 + self.unfolding :]
        rate, slopes, *_ = self.at(slopes_of(self.field, self.integrand), 0.0, x, s, free)
        return rate.ravel(), slopes

    def rates(self, states: np.ndarray, tail: np.ndarray, times: np.ndarray | float = 0.0) -> np.ndarray:
        """dx/dt (k x d) at states (k x d), of a tail (m) or one of each (k x m)."""
        quick = self._kernel(False)
        if quick is not None:
            clock = times.ravel() if isinstance(times, np.ndarray) else np.full(len(states), times)
            added = np.tile(self._none, (len(states), 1))
            return quick.rates(clock, np.hstack([states, added]), np.atleast_2d(tail)[:, 1:])[:, : self.size]
        s, free = tail[..., 1 : 1 + self.unfolding], tail[..., 1 + self.unfolding :]
        if len(states) == 1:
            moment = times if isinstance(times, float) else times[0]
            return self.at(self.field, moment, states, s, free)[0].T
        moments = np.reshape(times, (-1, 1))
        return self._lanes.evaluated(self.field, 1, moments, states, np.atleast_2d(s), np.atleast_2d(free))

    def flows(self, states: np.ndarray, tails: np.ndarray) -> np.ndarray:
        """The directions (k x 1 x d) in which time shifts a motion at states (k x d); none (k x 0 x d) where it is
        driven."""
        return np.zeros((len(states), 0, self.size)) if self.forced else self.rates(states, tails)[:, None]

    def growth_errors(self, grown: np.ndarray) -> np.ndarray:
        """The relative error with which a segment lets errors grow exp(z) times, z being given (...); 0 where that is
        not known."""
        return np.zeros_like(grown)

    def along(self, function: ca.Function, *arguments: np.ndarray) -> np.ndarray:
        """Any function at k places (k x ... each)."""
        return self._lanes.evaluated(function, 1, *arguments)

    def at(self, function: ca.Function, *arguments: np.ndarray | float) -> list[np.ndarray]:
        """Any function of one place, its outputs as CasADi has them (rows x columns)."""
        return self._lanes.called(function, *arguments)

    def step_errors(
        self, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray, units: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:
        """Estimated error of each step `asked` for, relative to the size of the motion, measured in `units` (d)."""
        start = self._begun(states[asked], tail[0] * mesh[asked] * self.forced, self._none)
        errors = np.abs(self._errors(False, start, _parameters(mesh, tail)[asked]))[:, : self.size]
        extent = np.abs(states).max(axis=0) / units
        return np.asarray((errors / (units * np.maximum(extent, extent.max() * 1e-2))).max(axis=1))

    def variation_errors(
        self, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray, units: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:
        """Estimated error of the state-transition matrix of each step `asked` for, the state measured in `units` (d).

        A slow motion may carry fast variations, which its own error says nothing of.
        """
        size = self.size
        start = self._begun(states[asked], tail[0] * mesh[asked] * self.forced, self._unit)
        errors = self._errors(True, start, _parameters(mesh, tail)[asked])
        scale = (units[:, None] / units[None, :]).ravel()  # columns first: entry (i, j) stands at j size + i
        return np.asarray((np.abs(errors[:, size : size + size * size]) * scale).max(axis=1))

    def _errors(self, varied: bool, starts: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        quick = self._kernel(varied)
        if quick is not None:
            return quick.errors(starts, parameters)
        return self._lanes.evaluated(self._step(varied, True), STAGES, starts, parameters)

    @cached_property
    def _none(self) -> np.ndarray:
        """S where a segment begins that is marched without variations."""
        return np.zeros(self._carried.size1_in(1) - self.size)

    @cached_property
    def _unit(self) -> np.ndarray:
        """vec Y and S where a segment begins."""
        unit = np.zeros(self.size * self.columns + (self.integrand.numel_out(0) if self.integrand else 0))
        unit[: self.size * self.columns] = np.eye(self.size, self.columns).ravel("F")
        return unit

    def _begun(self, states: np.ndarray, times: np.ndarray | float, varied: np.ndarray = _NOTHING) -> np.ndarray:
        """(t, x, vec Y, S) (k x ...) where steps begin, of states (k x d) at times (k)."""
        size = self.size
        start = np.empty((len(states), 1 + size + varied.size))
        start[:, 0], start[:, 1 : 1 + size], start[:, 1 + size :] = times, states, varied
        return start

    def _clock(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """The times (N) at which the segments begin, 0 where they do not matter."""
        if not self.forced:
            return np.zeros(len(nodes))
        return np.asarray(tail[0] * mesh[: -1 : (mesh.size - 1) // len(nodes)])


class Gridded(March):
    """A march whose segments are single steps, solved side by side, many of them on a mesh that it chooses itself.

    This is a discretisation: what else follows a family asks no more of it, than `March` has and what is here.
    """

    wide = False  # type: ignore[assignment]
    first_segments, first_steps = 40, 1

    def fits(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> bool:
        """Whether a mesh is as fine as it should be, and where it should be, for an orbit of nodes (N x d)."""
        raise NotImplementedError

    def regridded(
        self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, count: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and mesh of the same orbit over `count` segments, 0 for as many as it asks for; begins with them."""
        raise NotImplementedError

    def once(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> Varied:
        """`varied` with states for Newton's method; what is within segments may be changed once, not solved."""
        return self.varied(nodes, mesh, tail, states=True)


class Marches:
    """Marches over arcs one after another, each of an equal share of the segments and of the steps.

    The mesh counts arcs and not time: arc k of K is from k / K to (k + 1) / K. States at the mesh are those that steps
    begin with.
    """

    wide = False

    def __init__(self, arcs: Sequence[March]) -> None:
        self.arcs, first = tuple(arcs), arcs[0]
        self.forced, self.size, self.unfolding, self.free = False, first.size, first.unfolding, first.free

    @property
    def columns(self) -> int:
        """Columns of Y: the state's, the unfolding's, the freed parameters'."""
        return self.arcs[0].columns

    def build(self) -> None:
        """Derive and compile now what integrates states and derivatives, not at first use."""
        for arc in self.arcs:
            arc.build()

    def ahead(self) -> None:
        """Have compilers begin with that, where it takes long."""
        for arc in self.arcs:
            arc.ahead()

    def ends(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (N x d) at the ends of the segments from their nodes (N x d). Raises `IntegrationError`."""
        return np.vstack([arc.ends(own, part, tail) for arc, own, part in self._each(nodes, mesh)])

    def integral(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> float:
        """The integral over the horizon."""
        return self.varied(nodes, mesh, tail).integral

    def states(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
        """States (M + 1 x d) at the mesh."""
        return _one_after_another([arc.states(own, part, tail) for arc, own, part in self._each(nodes, mesh)])

    def varied(self, nodes: np.ndarray, mesh: np.ndarray, tail: np.ndarray, states: bool = False) -> Varied:
        """Ends and their derivatives; with `states` those at the mesh too. Raises `IntegrationError`."""
        return self.varied_each(nodes[None], mesh, tail[None], states)[0]

    def varied_each(self, nodes: np.ndarray, mesh: np.ndarray, tails: np.ndarray, states: bool = False) -> list[Varied]:
        """The same of several loops on one mesh, of nodes (B x N x d) and tails (B x m), beside each other."""
        arcs = [arc.varied_each(own, part, tails, states) for arc, own, part in self._each(nodes, mesh)]
        return [_in_turn(paths, states) for paths in zip(*arcs, strict=True)]

    def rates(self, states: np.ndarray, tail: np.ndarray, times: np.ndarray | float = 0.0) -> np.ndarray:
        """dx/dt (k x d) at states (k x d) that are shared out evenly among the arcs, in periods of its own for each."""
        del times
        each = max(1, len(states) // len(self.arcs))
        cuts = [each * k for k in range(1, len(self.arcs))]
        return np.vstack(
            [arc.rates(own, tail) for arc, own in zip(self.arcs, np.split(states, cuts), strict=True) if len(own)]
        )

    def at(self, function: ca.Function, *arguments: np.ndarray | float) -> list[np.ndarray]:
        """Any function of one place, its outputs as CasADi has them (rows x columns)."""
        return self.arcs[0].at(function, *arguments)

    def step_errors(
        self, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray, units: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:
        """Estimated error of each step `asked` for, relative to the size of the motion."""
        return self._errors("step_errors", states, mesh, tail, units, asked)

    def variation_errors(
        self, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray, units: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:
        """Estimated error of the state-transition matrix of each step `asked` for, the state in `units` (d)."""
        return self._errors("variation_errors", states, mesh, tail, units, asked)

    def _errors(
        self, kind: str, states: np.ndarray, mesh: np.ndarray, tail: np.ndarray, units: np.ndarray, asked: np.ndarray
    ) -> np.ndarray:
        arc = asked * len(self.arcs) // (mesh.size - 1)
        each = [(one, asked[arc == k]) for k, one in enumerate(self.arcs) if np.any(arc == k)]
        return np.concatenate([getattr(one, kind)(states, mesh, tail, units, own) for one, own in each])

    def _each(self, nodes: np.ndarray, mesh: np.ndarray) -> Iterator[tuple[March, np.ndarray, np.ndarray]]:
        count = len(self.arcs)
        steps = (mesh.size - 1) // count
        for k, (arc, own) in enumerate(zip(self.arcs, np.split(nodes, count, axis=-2), strict=True)):
            yield arc, own, mesh[k * steps : (k + 1) * steps + 1]


def _in_turn(paths: Sequence[Varied], states: bool) -> Varied:
    """The integration of one arc after another."""
    ends, transitions, columns = (
        np.concatenate([getattr(path, name) for path in paths]) for name in ("ends", "transitions", "columns")
    )
    along = (_one_after_another if states else np.concatenate)([path.states for path in paths])
    return Varied(ends, transitions, columns, along, sum(path.integral for path in paths))


def _one_after_another(pieces: Sequence[np.ndarray]) -> np.ndarray:
    """States at the mesh from those of each arc; where one ends and the next begins, the beginning."""
    return np.vstack([*(piece[:-1] for piece in pieces), pieces[-1][-1:]])


def uniform(fraction: float, segments: int, steps: int) -> np.ndarray:
    """The mesh of so many segments of so many equal steps over a fraction of the period."""
    return np.linspace(0.0, fraction, segments * steps + 1)


def rounded(steps: float) -> int:
    """A number of steps of at least this many, a multiple of `QUANTUM`."""
    return max(1, int(np.ceil(steps / QUANTUM))) * QUANTUM


def divided(mesh: np.ndarray, times: int) -> np.ndarray:
    """The mesh with every step cut into so many."""
    return np.asarray(np.interp(np.arange(times * (mesh.size - 1) + 1) / times, np.arange(mesh.size), mesh))


def _parameters(mesh: np.ndarray, tail: np.ndarray) -> np.ndarray:
    """(h, s, free) of every step (M x 1 + ...), h in seconds."""
    packed = np.empty((mesh.size - 1, tail.size))
    packed[:] = tail
    packed[:, 0] *= mesh[1:] - mesh[:-1]
    return packed


def _finite(numbers: np.ndarray, nodes: np.ndarray, loops: int = 1) -> np.ndarray:
    """The numbers of all segments of so many loops. Raises `IntegrationError` naming the first that is not finite."""
    if np.isfinite(numbers).all():
        return numbers
    each = len(numbers) // len(nodes)
    segment = int(np.argmin(np.all(np.isfinite(numbers), axis=1))) // each
    own = segment % (len(nodes) // loops)
    raise IntegrationError("the state is not finite", segment=own, state=nodes[segment])
