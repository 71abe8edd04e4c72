"""The evidence of a certificate: a motion and its variations by equations that did not find it, and what they say.

The finder integrates accelerations with CVODES (under constraints: a model's own balances with Baumgarte terms);
here it is DOP853 at its tightest, without unfolding or stabilisation, on equations that follow from the energies:

- Hamilton's equations, derived by automatic differentiation;
- the same under constraints, in the link angles where there are any (both by `mechanics.canonical`);
- of a first-order system the rates as they are given, which is all there is to know of it;
- for long chains Lagrange's equations in closed form. Their momenta (1300 kg m^2/s at 100 links,
  which the velocities depend on through the inverse of a matrix of condition 5e4) lose digits: the first mode of 100
  links at 1 rad closes to 1.2e-10 in Hamilton's equations and to 9e-13 here. Only the monodromy is taken to canonical
  coordinates, at its two ends.

Lengths, momenta and the time are measured in extents of the motion, so that the answer does not depend on the units.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from itertools import combinations, pairwise

import numpy as np
from scipy.integrate import simpson, trapezoid

from orbitfinder._runtime.sizes import EPSILON, nonzero, relative
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import (
    SECOND,
    STEPS_PER_PERIOD,
    TIGHTEST,
    ReferenceSettings,
    Trace,
    integrate,
    integrate_in,
)
from orbitfinder.integrate.equations import accelerations, hamilton, invariant_gradients
from orbitfinder.integrate.extended import FIRST, QUADRUPLE, ROUND_OFF, Extended, extended
from orbitfinder.integrate.field import VectorField, expect, rates_of, vector_field
from orbitfinder.integrate.idas import DaeSettings, simulate_dae
from orbitfinder.loops.symmetry import Involution, Symmetry, involutions, off_centre, symplectic, with_mirrors
from orbitfinder.mechanics.constrained import tangent_basis
from orbitfinder.mechanics.kind import system_kind, with_parameters
from orbitfinder.mechanics.model import Model, altered, constraint_of, energies
from orbitfinder.mechanics.scales import Acts, acting, acting_in, extents, extents_of, masses_of, snapped
from orbitfinder.orbits.closure import LARGEST_SCALE, Closure, closes, distance, gap, regrown, shift, still
from orbitfinder.orbits.closure import ROUND_OFF as GAPS
from orbitfinder.orbits.floquet import Floquet, analyse, complement, generated, symplectic_unit
from orbitfinder.orbits.product import lost, product

SAMPLES = 512
"""Intervals at which the certifying integration is inspected."""
PIECES = 16
"""State-transition matrices in a period, where an error may be made that is carried to the end"""
GROWN = 1e-11
"""A motion from its start alone closes to this, in extents, or its linearisation is not that of the orbit; pieces of
another one join to as much, relative to the most that any of them makes of an error"""
VARIED = ReferenceSettings(relative_tolerance=1e-13, absolute_tolerance=1e-14)
COARSER = ReferenceSettings(relative_tolerance=1e-12, absolute_tolerance=1e-13)
"""For the state-transition matrices: of orbits with multipliers of 5e5, 1e-12 leaves the trivial ones wrong by 2e-8;
and for what they may be wrong by"""
ROUGH = ReferenceSettings(relative_tolerance=1e-10, absolute_tolerance=1e-13)
"""For the extents of the motion, before there are any."""
CLOSED, KEPT = 1e-12, 1e-8
"""Gap, of an A of 1, and loss of what is kept above which an orbit is refused, or is known in long double"""
KNOWN = 1e-6
"""Share of a component's size below which its changes are no unit to integrate in: they are round-off, nearly"""
HAMILTON, GIVEN = "Hamilton's equations", "the rates as given"
DOUBTFUL, FALSE, MOST, ROUNDED, SPREAD = 1e-10, 1e-5, 16, 64 * EPSILON, 1e8
"""A true orbit that is no nearer is sought by what else its equations keep, of states of so many numbers, and, nearer
than the second, in long double; relative error of what they keep; condition of a state-transition matrix from which on
its determinant is that of its parts"""
TIED = 1e-9
"""Share of the period by which times of events may differ"""


StatesAt = Callable[[np.ndarray], np.ndarray]
"""Increasing times (k, s) since a piece of a motion began -> its states (k x d)"""


@dataclass(frozen=True)
class Motion:
    """What a formulation finds: a motion in coordinates y = (q, p) (m numbers) and its state-transition matrices.

    `states` (k x 2n) are those of the model at `times`, `path` (k x m) the same in y, `masses` (m / 2) the
    diagonal of its mass matrix (none: each component of y by itself), `constraints` (r x m) the gradients of what y is
    held to, `rate` y' at the start, `trace` the steps of the integration, `begins` (k x m) where each piece whose
    transition there is began: of an unstable orbit that is `path` to fewer digits.
    """

    times: np.ndarray
    states: np.ndarray
    path: np.ndarray
    transitions: Sequence[np.ndarray]
    action: float
    rate: np.ndarray
    gradients: np.ndarray
    directions: np.ndarray
    masses: np.ndarray
    turns: np.ndarray
    trace: Trace
    formulation: str = HAMILTON
    constraints: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    begins: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    rates: VectorField | None = None
    """the field of y"""
    reach: np.ndarray | None = None
    """of a stiff first-order motion its least and largest y (2 x m), which no equal times see"""
    ended: np.ndarray | None = None
    """the gradients where `transitions` end; none where that is not told"""
    missed: np.ndarray | None = None
    """y at the end less y at the start, where both are known in long double or better, as `transitions` are then"""
    precise: float = EPSILON
    """relative error that its integration makes"""
    varied: Sequence[Trace] = ()
    """the steps of DOP853 along each piece, of the motion and a variation (2 m numbers), in double precision alone"""
    through: np.ndarray | None = None
    """Phi over half the period and over the period (2 x m x m) where products of `transitions` are not as precise"""

    def reaching(self, path: np.ndarray) -> np.ndarray:
        """A path (k x m), as far as the motion goes."""
        return path if self.reach is None else np.vstack([path, self.reach])


class Hamiltonian:
    """Hamilton's equations of a Model in y = (q, p) (m numbers), under constraints in as few as it offers.

    Parameters left `free` have the model's values, or those that were `put` last: one set of equations for all of them.
    """

    def __init__(self, model: Model, free: tuple[str, ...] = ()) -> None:
        self.model, self.equations, self.free = model, hamilton(model, free), free
        self.coordinates = self.equations.coordinates
        self._values = model.values_of(free)
        self._given = [self._values] if free else []
        self.field = vector_field(self.equations.field, *self._given)
        self.variational = vector_field(self.equations.variational, *self._given)

    def put(self, values: np.ndarray) -> None:
        """Give the free parameters (k) these values."""
        self._values[:] = values

    def start(self, state: np.ndarray) -> np.ndarray:
        """(q, momentum) of a state (2n) of the model."""
        q, v = self._halves(state)
        return np.concatenate([q, self.equations.momentum(q, v, *self._given).full().ravel()])

    def masses(self, state: np.ndarray) -> np.ndarray:
        """Diagonal (m / 2) of the mass matrix at (q, v) or (q, momentum)."""
        return masses_of(lambda q, v: self.coordinates.kinetic(q, v, *self._given), state)

    def _halves(self, state: np.ndarray) -> list[np.ndarray]:
        """q and v, empty of a first-order system, of a state of the model."""
        return np.split(state[self.coordinates.chosen], [self.coordinates.size])

    def states(self, path: np.ndarray) -> np.ndarray:
        """States of the model (k x 2n); dH/dp, the first half of the field, is the velocity."""
        if self.model.rates is not None:
            return path
        places, lift = path[:, : self.coordinates.size], self.coordinates.lift
        rates = self.field.many(np.zeros(len(path)), path)[:, : self.coordinates.size]  # type: ignore[attr-defined]
        if lift is None:
            return np.hstack([places, rates])
        return np.asarray(lift(places.T, rates.T, *self._given).full().T)

    def ended(self, path: np.ndarray) -> np.ndarray:
        """Gradients of the invariants where a path (k x m) ends."""
        return self.frame(self.states(path[-1:])[0], path[-1])[0]

    def frame(self, state: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gradients of the invariants, symmetry directions (the flow first) and gradients of the constraints at y."""
        model, flow = self.model, self.field(0.0, start)
        tangent = self.equations.tangent(start, *self._given).full()
        if model.rates is not None:
            directions = np.vstack([*([] if model.forced else [flow]), generated(model, state)])
            return invariant_gradients(model)(state).full(), directions, tangent
        free = None
        if model.forces is not None:
            unforced = hamilton(altered(model, forces=None), self.free).field
            free = unforced(0.0, start, *self._given).full().ravel()
        lift = self.equations.lift(*self._halves(state), *self._given).full()
        return *canonical_frame(model, state, flow, lift, free), tangent


def canonical_frame(
    model: Model, state: np.ndarray, flow: np.ndarray, lift: np.ndarray, free: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the invariants and the symmetry directions (flow, unless forced, first) in canonical coordinates.

    `lift` (2n x 2n) takes directions there from (q, v), `flow` is there already and `free` the flow without forces.
    Each gradient comes from the direction that it generates without forces: X = J grad I, so grad I = -J X (and, under
    constraints, a sum of theirs; in link angles the energy is the only invariant looked at).
    """
    turns, commuting = (
        generated(model, state, each) @ lift.T if len(lift) == state.size else np.zeros((0, flow.size))
        for each in (False, True)
    )
    conserved = np.vstack([*([flow if free is None else free] if model.conservative else []), turns])
    half = flow.size // 2
    directions = np.vstack([*([] if model.forced else [flow]), commuting])
    return np.hstack([-conserved[:, half:], conserved[:, :half]]), directions


def canonical_motion(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    moments: np.ndarray,
    settings: ReferenceSettings,
    varied: ReferenceSettings = VARIED,
    longer: bool = False,
) -> Motion:
    """The `Motion` of a state (2n) at `moments` (from 0 to the period) by Hamilton's equations, in `longer` numbers
    where double precision does not come through."""
    equations = Hamiltonian(model)
    by, through = (extended(each) if longer else None for each in (equations.field, equations.variational))
    chosen, start = equations.coordinates.chosen, equations.start(state)
    first_order = model.rates is not None
    masses = np.zeros(0) if first_order else equations.masses(state[chosen])
    units = units_of(equations.field, start, masses, period, model.angular, by)
    if by is None:
        path = integrate_in(
            units, equations.field, start, moments, settings, period / STEPS_PER_PERIOD, traces := list[Trace]()
        )
    else:
        sums = by.along(units, start, moments, equations.field.free)
        path, traces = sums[:, 0].astype(float), [_traced(equations.field, by, units, sums, moments)]
    half = start.size // 2
    if equations.field.stiff:  # nor does the interpreter follow its variations
        expect(equations.equations.variational, None, stiff=True)
    varying = list[Trace]()
    transitions, nodes, action = _pieces(equations, start[None], units, period, through or varied, varying)
    if not first_order:  # a gap dq adds p.dq: however large p is, the action of a small orbit is not that round-off
        missed = nodes[-1] - start - shift(turns[chosen[: masses.size]], start.size)
        action -= float(nodes[-1, half:] @ missed[:half])
    gradients, directions, constraints = equations.frame(state, start)
    ended = equations.ended(nodes)
    own, reach = turns[chosen[: equations.coordinates.size]], None
    if first_order and equations.field.stiff:
        reach = np.array([traces[0].states.min(axis=0), traces[0].states.max(axis=0)]) * units
    return Motion(
        moments, equations.states(path), path, transitions, action, equations.field(0.0, start), gradients, directions,
        masses, own, drifting(traces[0], own, units), GIVEN if first_order else HAMILTON, constraints,
        nodes[:-1], equations.field, reach, ended, varied=varying,
    )  # fmt: skip


def drifting(trace: Trace, turns: np.ndarray, units: np.ndarray) -> Trace:
    """A trace in `units` (m) that knows how far its coordinates go on in a period."""
    return replace(trace, drift=shift(turns, units.size) / units)


def units_of(
    field: VectorField, start: np.ndarray, masses: np.ndarray, period: float, angular: np.ndarray | None = None,
    by: Extended | None = None,
) -> np.ndarray:  # fmt: skip
    """Extents (m) of the motion in y = (q, p) from a start, by a quick integration or in more digits.

    That one is measured in a first guess of them, |y| + T |y'| + T^2 |y''| at the start.
    """
    rate, nudge = field(0.0, start), 1e-4 * period
    turned = np.abs(field(nudge, start + nudge * rate) - rate) * (period / nudge)
    first = np.abs(start) + period * np.abs(rate) + period * np.where(np.isfinite(turned), turned, 0.0)
    if not np.all(np.isfinite(first) & (first < 1e100)):
        return np.ones(start.size)

    def rates(states: np.ndarray) -> np.ndarray:
        return np.array([field(0.0, state) for state in states])

    units = in_momenta(first, masses, period, angular, acting(rates, start[None]))
    times = np.linspace(0.0, period, 65)
    if by is None:
        path = integrate_in(units, field, start, times, ROUGH)
    else:
        path = by.along(units, start, times, getattr(field, "free", None))[:, 0].astype(float)
    return known_in(path, masses, period, angular, acting(rates, path))


def known_in(path: np.ndarray, masses: np.ndarray, period: float, angular: np.ndarray | None, acts: Acts) -> np.ndarray:
    """`in_momenta` of a motion (k x m), nothing near the round-off of what it is measured from."""
    units = in_momenta(np.ptp(path, axis=0), masses, period, angular, acts)
    return np.asarray(np.maximum(units, KNOWN * np.abs(path).max(axis=0)))


def in_momenta(
    moved: np.ndarray, masses: np.ndarray, period: float, angular: np.ndarray | None, acts: Acts
) -> np.ndarray:
    """`extents` in (q, p) of what moved so far in (q, p); without masses, of a first-order system, `alone`."""
    weights = np.append(np.ones(moved.size - masses.size), masses)
    found = extents(moved / nonzero(weights), masses, period, angular, acts)
    return np.asarray(np.where(weights > 0, weights, 1.0) * found)


def _pieces(
    equations: Hamiltonian, starts: np.ndarray, units: np.ndarray, period: float, varied: ReferenceSettings | Extended,
    traces: list[Trace] | None = None,
) -> tuple[list[np.ndarray], np.ndarray, float]:  # fmt: skip
    """State-transition matrices (m x m) of equal pieces of a period that begin at `starts` (or, if there is one, each
    where the one before ended), their ends with the first start, and the action."""
    nodes, action, half = [starts[0]], 0.0, starts.shape[1] // 2
    first_order, variational = equations.model.rates is not None, equations.variational
    work = float(units @ units) / period if first_order else float(units[:half] @ units[half:]) or 1.0
    pieces = []
    for k in range(PIECES):
        begin, span = starts[k] if len(starts) > 1 else nodes[-1], period * np.array([k, k + 1]) / PIECES
        end, piece, done = varied_end(variational, begin, span, units, work, varied, traces)
        pieces.append(piece)
        nodes.append(end)
        action += done
    return pieces, np.array(nodes, float), action


def varied_end(
    field: VectorField, start: np.ndarray, span: np.ndarray, units: np.ndarray, work: float,
    settings: ReferenceSettings | Extended, traces: list[Trace] | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:  # fmt: skip
    """Where a motion (m) ends, its state-transition matrix (m x m) and its action, by the field of all three, measured
    in units (m) and in `work`; matrices to all of several times (k x m x m). `traces` get the steps of DOP853 along the
    motion and one of its variations."""
    measures = np.concatenate([units, (units[:, None] / units).ravel("F"), [work]])
    begin, size = np.concatenate([start, np.eye(start.size).ravel(), [0.0]]), start.size
    if isinstance(settings, Extended):
        rows = settings.along(measures, begin, span, getattr(field, "free", None), FIRST)[:, 0]
    elif traces is None:
        rows = integrate_in(measures, field, begin, span, settings)
    else:  # by steps so short that four of them make a curve
        longest, steps = np.ptp(span) / 8, list[Trace]()
        rows = integrate_in(measures, field, begin, np.linspace(span[0], span[-1], 3), settings, longest, steps)[::2]
        traces.append(_with_a_variation(steps[0], size))
    through = rows[1:, size:-1].reshape(-1, size, size).swapaxes(1, 2)
    return rows[-1, :size], through if len(span) > 2 else through[0], float(rows[-1, -1])


def _with_a_variation(trace: Trace, size: int) -> Trace:
    """The steps of a motion (m) with one of its variations, of those of all."""
    direction = np.random.default_rng(0).normal(size=size)
    ahead = trace.states[:, size:-1].reshape(-1, size, size).swapaxes(1, 2) @ (direction / np.linalg.norm(direction))

    def rates(times: np.ndarray, rows: np.ndarray) -> np.ndarray:
        every = np.zeros((len(rows), trace.states.shape[1]))
        every[:, : 2 * size] = rows
        return trace.rates(times, every)[:, : 2 * size]

    return Trace(trace.moments, np.hstack([trace.states[:, :size], ahead]), rates, trace.together)


def evenly(period: float) -> np.ndarray:
    """The times (SAMPLES + 1) at which a motion is inspected."""
    return np.linspace(0.0, period, SAMPLES + 1)


CHECKED = replace(TIGHTEST, max_evaluations=100_000)
"""Ten times what a tame period needs at the finest of `LONGEST_STEPS`."""
PIECE_STEPS = 40
"""A piece between two nodes is integrated in at least so many steps."""
LONGEST_STEPS = (np.inf, 1 / 400, 1 / 1600)
"""Longest steps of the check, in periods, each tried only when the one before says that the orbit does not close."""


@dataclass(frozen=True)
class Tour:
    """A loop gone round once: `pieces` (m x m each, in extents) of its linearisation, and what is trivial in it.

    `gradients` and `directions` (k x m) leave `size` multipliers; `basis` (m x r) spans what constraints leave. The
    pieces make up the root map, of which the monodromy is the power `root`: half a period and back to the start where
    the orbit repeats itself there. `divergence()` is by how much the integrated divergence misses the sum of the
    logarithms of all multipliers, and how well that is known.
    """

    closes: Closure
    pieces: Sequence[np.ndarray]
    gradients: np.ndarray
    directions: np.ndarray
    conservative: bool
    units: np.ndarray
    basis: np.ndarray
    root: int = 1
    divergence: Callable[[], tuple[float, float]] = lambda: (0.0, 0.0)
    motion: tuple[np.ndarray, np.ndarray] = (np.zeros(0), np.zeros((0, 0)))
    """times (k) and states (k x d) of the period"""
    bases: Sequence[np.ndarray] = ()
    """of what is not trivial (m x r each) where pieces begin; none where they are not known"""
    ended: np.ndarray | None = None
    """the gradients where the pieces end, if that is known"""
    monodromy: np.ndarray | None = None
    """the product of the pieces where these do not hold it"""

    def map(self) -> np.ndarray:
        """The root map without trivial multipliers (r x r)."""
        return multiplied(self.factors())

    def multipliers(self, noise: np.random.Generator | None = None, share: float = 0.0) -> np.ndarray:
        """Its eigenvalues (r), each piece with an error that is a `share` of its norm: factor by factor where the
        product has lost them."""
        factors = self.factors(noise, share)
        values = np.linalg.eigvals(multiplied(factors))
        if len(factors) > 1 and lost(np.abs(values), np.array(factors)):
            values = product(factors).values
        return values.astype(complex)

    def factors(self, noise: np.random.Generator | None = None, share: float = 0.0) -> list[np.ndarray]:
        """That map in factors, of one piece each between `bases`."""
        pieces, bases = self.pieces, self.bases or (self._start,)
        if noise is not None:
            pieces = [each + share * np.linalg.norm(each, 2) * noise.normal(size=each.shape) for each in pieces]
        pieces = pieces if self.bases else [multiplied(pieces) if self.monodromy is None else self.monodromy]
        ways = pairwise([*bases[: len(pieces)], bases[0]])
        return [(after.T @ piece @ before).astype(float) for piece, (before, after) in zip(pieces, ways, strict=True)]

    def inner(self) -> np.ndarray:
        """The root map with trivial multipliers, on what constraints leave."""
        through = multiplied(self.pieces) if self.monodromy is None else self.monodromy
        return np.asarray(self.basis.T @ through @ self.basis)

    @property
    def _start(self) -> np.ndarray:
        """The basis at the start."""
        return _basis(self.gradients, self.directions, self.basis)

    @property
    def trivial(self) -> float:
        """How far the map is from keeping the flow and the gradients of the invariants, relative to its size.

        The gradients where it ends are kept by any motion: of an unstable one that closes to its errors, which grow,
        those at the start differ from them by more than the map is wrong. That it closes is seen in the flow.
        """
        inner, gradients, directions = self.inner(), self.gradients @ self.basis, self.directions @ self.basis
        ended = gradients if self.ended is None else self.ended @ self.basis
        lost = (
            relative(directions @ inner.T - directions, directions),
            relative(ended @ inner - gradients, gradients),
        )
        return max(lost) / max(1.0, float(np.abs(inner).max()))

    @property
    def asymplectic(self) -> float:
        """|Phi^T J Phi - J| on what constraints leave, relative to J in extents of the motion and to Phi squared."""
        inner, form = self.inner(), self._form(self.basis)
        off = float(np.abs(inner.T @ form @ inner - form).max()) / float(np.abs(form).max())
        return off / max(1.0, float(np.abs(inner).max())) ** 2

    def _form(self, basis: np.ndarray) -> np.ndarray:
        """J in extents, on what a basis (columns) spans."""
        return np.asarray(basis.T @ (self.units[:, None] * symplectic_unit(self.units.size // 2) * self.units) @ basis)

    def krein(self, multipliers: np.ndarray) -> list[tuple[int, bool]]:
        """Krein signatures of multipliers of a canonical system's whole period, each with whether it can be told."""
        if not self.conservative or not multipliers.size:
            return [(0, False)] * multipliers.size
        form = self._form(self._start)
        values, vectors = np.linalg.eig(np.linalg.matrix_power(self.map(), self.root))
        found = []
        for mu in multipliers:
            k = int(np.argmin(np.abs(values - mu)))
            size = float((1j * vectors[:, k].conj() @ form @ vectors[:, k]).real) / float(np.linalg.norm(form, 2))
            away = min(float(np.abs(np.delete(values, k) - mu).min(initial=np.inf)), abs(mu.imag))
            on_circle = bool(abs(abs(mu) - 1.0) < 1e-6)
            found.append((int(np.sign(size)) if on_circle else 0, away > 1e-4 and (abs(size) > 1e-6 or not on_circle)))
        return found


@dataclass(frozen=True)
class Recomputed:
    """A motion from a state for a period, by an integrator that did not find it: what is asked of every kind.

    `times` (k, s) and `states` (k x d) of the model with their `extents` (d), the loop that they make, its largest gap
    (`closure`) and action in the model's units, the energy (J) at the start, the multipliers.
    """

    times: np.ndarray
    states: np.ndarray
    extents: np.ndarray
    tour: Tour
    closure: float
    action: float
    energy: float
    floquet: Floquet

    @property
    def closes(self) -> Closure:
        """The gap in extents."""
        return self.tour.closes


def off_motion(
    pieces: Iterable[tuple[float, float, StatesAt]], times: np.ndarray, samples: np.ndarray, units: np.ndarray,
    period: float, thinned: bool = False,
) -> float:  # fmt: skip
    """How far recorded samples (k x d) are off a motion at their times (k, that of an event once or twice), in units.

    `pieces`: when each begins, how long it lasts and its states. Infinite for what are not samples of one period, of
    which those that are `thinned` may lack the last.
    """
    edge = TIED * period
    if times.size < 2 or samples.shape != (times.size, units.size) or not np.all(np.isfinite(samples)):
        return np.inf
    steps, left = np.diff(times), period - times[-1]
    if times[0] != 0.0 or not np.all(steps >= 0) or not -edge <= left <= (steps.max() if thinned else edge):
        return np.inf
    far = np.full(times.size, np.inf)
    for begin, lasts, path in pieces:
        own = (times >= begin - edge) & (times <= begin + lasts + edge)
        since = np.clip(times[own] - begin, 0.0, lasts)
        moments = np.unique(np.append(since, 0.0))
        states = path(moments)[np.searchsorted(moments, since)]
        far[own] = np.minimum(far[own], np.abs((states - samples[own]) / units).max(axis=1))
    return float(far.max())


@dataclass(frozen=True)
class Evidence(Recomputed):
    """What the second integrator on the second formulation says of a state and a period, at equally spaced times.

    `exchanged` is the energy (J) that `drift` is relative to, `growth` the largest |S^-1 Phi(t, s) S| of all s < t,
    `varied` what an error that Phi takes up under way grows to in it (the largest |Phi(T, t)| |Phi(t, 0)|) and `norm`
    |Phi(T, 0)|, both so scaled, `motion` also at further moments that were asked for.
    """

    drift: float
    exchanged: float
    growth: float
    varied: float
    norm: float
    motion: Motion


def gather(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    moments: Sequence[float] | np.ndarray = (),
    settings: ReferenceSettings = TIGHTEST,
    doubts: Callable[[Floquet], bool] = lambda _: False,
) -> Evidence:
    """The `Evidence` of a state (2n) and a period (s), the motion's states at further `moments` with it, in long double
    also where there are `doubts` about nothing but the multipliers."""
    motion_of = system_kind(model.system).motion(model) or canonical_motion
    given = model, state, period, turns, np.unique(np.append(evenly(period), moments)), settings
    plain = motion_of is canonical_motion and np.size(state) <= MOST
    try:
        motion = motion_of(*given)
    except IntegrationError:
        if not plain or extended(Hamiltonian(model).field) is None:
            raise
        motion = canonical_motion(*given, longer=True)
    at = np.searchsorted(motion.times, evenly(period))

    def looped() -> tuple[np.ndarray, np.ndarray, Tour]:
        path = motion.path[at]
        moved = np.ptp(motion.reaching(path), axis=0)
        units = in_momenta(moved, motion.masses, period, None, acting_in(model, path))
        return motion.states[at], units, _looped(model, motion, units, path, period)

    states, units, loop = looped()
    plain = plain and units.size <= MOST
    for quadruple in (False, True):
        if not (plain and _doubtful(loop, motion.precise, doubts)):
            break
        with suppress(IntegrationError):
            sharp, before = _sharpened(model, motion, units, quadruple), loop.closes.distance
            if sharp is not motion:
                motion = sharp
                states, units, loop = looped()
                if max(10 * DOUBTFUL, before / 2) < loop.closes.distance < np.inf:  # which is no round-off
                    break
    kinetic, potential = energies(model, states)
    total = kinetic + potential
    exchanged = nonzero(max(float(np.ptp(potential)) + float(kinetic.max()), 1e-3 * float(np.abs(potential).max())))
    if model.rates is not None:
        exchanged = _variable(model, states, loop.units)
    return Evidence(
        times=motion.times[at],
        states=states,
        extents=extents_of(model, motion.reaching(states), period),
        tour=loop,
        closure=gap(np.asarray(state, float), states[-1], turns),
        action=motion.action,
        energy=float(total[0]),
        floquet=analyse(loop.map(), conservative=loop.conservative),
        drift=float(np.abs(total - total[0]).max()) / exchanged,
        exchanged=exchanged,
        growth=_growth(loop.pieces),
        varied=regrown(loop.pieces),
        norm=float(np.linalg.norm(multiplied(loop.pieces) if loop.monodromy is None else loop.monodromy)),
        motion=motion,
    )


def _growth(pieces: Sequence[np.ndarray]) -> float:
    """The largest |Phi(t, s)| between the ends of any two pieces (m x m each)."""
    largest, wholes = 1.0, np.empty((0, *pieces[0].shape))
    for piece in pieces:  # from the start of each piece so far to the end of this
        wholes = piece @ np.concatenate([wholes, np.eye(len(piece))[None]])
        largest = float(np.maximum(largest, np.linalg.norm(wholes, axis=(1, 2)).max()))
    return largest


def _looped(model: Model, motion: Motion, units: np.ndarray, path: np.ndarray, period: float) -> Tour:
    """The `Tour` of a motion of which a path (k x m) was looked at, in `units` (m)."""
    pieces, rate = in_extents(motion.transitions, units), None if model.forced else motion.rate * period / units
    ends = path[-1] - path[0] if motion.missed is None else motion.missed
    missed = (ends - shift(motion.turns, units.size)) / units
    if model.rates is not None and motion.rates is not None and (idle := still(path)).any():
        each = rates_of(motion.rates)[0](np.linspace(0.0, period, len(path)), path) / units
        missed = np.where(idle, trapezoid(each, dx=period / (len(path) - 1), axis=0), missed)
    basis = tangent_basis(motion.constraints * units) if motion.constraints.size else np.eye(units.size)
    kept, whole = motion.gradients * units, basis.size == units.size**2
    through = None if motion.through is None else in_extents(motion.through, units)[1]
    closing = closes(missed, pieces, path / units, rate, kept, basis, motion.precise, through)
    if closing.distance > DOUBTFUL and motion.rates is not None and whole and units.size <= MOST:
        more = np.vstack([kept, _conserved(motion.rates, path, units, period)])
        again = closes(missed, pieces, path / units, rate, more, None, motion.precise, through)
        closing = replace(closing, distance=again.distance)
        if closing.distance > DOUBTFUL and rate is not None:
            with suppress(IntegrationError):
                closing = replace(closing, distance=min(closing.distance, _symmetric(model, motion, units)))
    ended = None if motion.ended is None else motion.ended * units
    along = motion.directions / units
    through = None if through is None else through.astype(float)
    return Tour(closing, pieces, kept, along, symplectic(model), units, basis, ended=ended, monodromy=through)


def _doubtful(loop: Tour, precise: float, doubts: Callable[[Floquet], bool]) -> bool:
    """Whether round-off may be all that is wrong with a motion, or with its multipliers, of an integration that is as
    precise."""
    gap, grown = loop.closes.worst
    lost = precise * regrown(loop.pieces)  # by round-off, of Phi, and maybe the gap
    if loop.closes.distance >= FALSE and not KEPT < lost > loop.closes.gap / GAPS:
        return False
    if loop.closes.distance > DOUBTFUL or gap > CLOSED * min(grown, LARGEST_SCALE) or loop.trivial > KEPT:
        return True
    own = analyse(loop.map(), loop.conservative)
    return (precise == EPSILON or own.pair_defect > KEPT) and doubts(own)


def _sharpened(model: Model, motion: Motion, units: np.ndarray, quadruple: bool) -> Motion:
    """A motion with its states, end and transitions in long double or quadruple precision, if that can be had."""
    equations, period = Hamiltonian(model), float(motion.times[-1])
    if equations.field.stiff:
        return motion
    wide, plain = extended(equations.variational), extended(equations.field, quadruple)
    deep = extended(equations.variational, True) if quadruple else wide
    if wide is None or plain is None or deep is None:
        return motion
    sums = plain.along(units, motion.path[0], motion.times, equations.field.free)
    path, missed = sums[:, 0].astype(float), (sums[-1] - sums[0]).sum(axis=0).astype(float)
    trace = drifting(_traced(equations.field, plain, units, sums, motion.times), motion.turns, units)
    at = np.searchsorted(motion.times, evenly(period)[:: SAMPLES // PIECES])
    pieces, _, action = _pieces(equations, sums[at, 0], units, period, wide)
    through = None
    if quadruple:  # past encounters errors grow and shrink again by more than pieces hold
        halves = period * np.array([0.0, 0.5, 1.0])
        through = varied_end(equations.variational, sums[0, 0], halves, units, 1.0, deep)[1]
    return replace(
        motion, transitions=pieces, missed=missed, path=path, states=equations.states(path), action=action, trace=trace,
        precise=QUADRUPLE if quadruple else ROUND_OFF, through=through,
        ended=equations.ended(path), varied=(),
    )  # fmt: skip


def _traced(field: VectorField, by: Extended, units: np.ndarray, sums: np.ndarray, times: np.ndarray) -> Trace:
    """The steps of DOP853 beside a motion that is known in more digits at its times (k, sums: k x 2 x m), from each of
    these to the next."""
    traces, path = list[Trace](), sums[:, 0].astype(float)
    for start, (begin, end) in zip(path, pairwise(times), strict=False):
        integrate_in(units, field, start, np.array([begin, (begin + end) / 2, end]), TIGHTEST, np.inf, traces)

    def retaken(moments: np.ndarray) -> float:
        k = int(np.searchsorted(times, moments[0], side="right")) - 1
        steps = np.unique([times[k], *moments, times[k + 1]])
        ends = by.along(units, sums[k], steps, getattr(field, "free", None))
        return float((np.abs((ends[-1] - sums[k + 1]).sum(axis=0)) / np.maximum(units, np.abs(path[k + 1]))).max())

    moments = np.append(np.concatenate([each.moments[:-1] for each in traces]), times[-1])
    states = np.vstack([*(each.states[:-1] for each in traces), path[-1] / units])
    return replace(traces[0], moments=moments, states=states, retaken=retaken)


def _conserved(field: VectorField, path: np.ndarray, units: np.ndarray, period: float) -> np.ndarray:
    """Gradients (k x m, in extents) at the start of a motion of what nobody need declare: linear and quadratic
    functions that the rates near it conserve to round-off, such as a parameter that is a state, or a clock's radius."""
    i, j = np.triu_indices(units.size)
    rows = beside(path, 3 * (i.size + units.size))
    each = rates_of(field)[0](np.random.default_rng(1).uniform(0.0, period, len(rows)), rows) / units
    away = (rows - path[0]) / units
    terms = np.hstack([each, each[:, i] * away[:, j] + away[:, i] * each[:, j]])
    terms = terms[np.isfinite(terms).all(axis=1)]
    if len(terms) < 2 * terms.shape[1]:
        return np.zeros((0, units.size))
    sizes = np.linalg.norm(terms, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    _, singular, known = np.linalg.svd(terms / sizes, full_matrices=False)
    _, share, gradients = np.linalg.svd(known[singular <= ROUNDED * singular[0], : units.size])
    return gradients[: share.size][share > KNOWN] / sizes[: units.size]


def _symmetric(model: Model, motion: Motion, units: np.ndarray) -> float:
    """The least `distance` in what symmetries that run time backwards ask of the start and of the end of a part of a
    motion, where it passes a fixed set.

    The equations have them to round-off; orbits that do are isolated where others come in families, or nearly do.
    """
    n, period, field = model.angular.size, float(motion.times[-1]), vector_field(accelerations(model))
    rows, many, least = beside(motion.states), rates_of(field)[0], np.inf
    here = many(moments := np.zeros(len(rows)), rows)

    def has(each: Involution) -> bool:
        apart = many(moments, rows @ each.matrix(n).T) - each.sense * here @ each.matrix(n).T
        return bool(np.all(np.abs(apart) <= ROUNDED * np.abs(here).max(axis=0)))

    own = [*filter(has, involutions(with_mirrors(model)))]
    back, forth = ([each for each in own if each.sense == sense] for sense in (-1, 1))
    forth += [last.after(first) for last, first in combinations(back, 2) if not (last.order or first.order)]
    off = {each: float(np.abs(off_centre(each, motion.states[:1], model.angular)).max()) for each in back}
    equations = Hamiltonian(model)
    for begin in sorted(back, key=lambda each: off[each]):
        again = motion
        if motion.precise == EPSILON or off[begin] > ROUNDED * np.abs(motion.states).max():
            start = _centred(begin, motion, field, model)
            again = canonical_motion(model, start, period, motion.turns, evenly(period), TIGHTEST)
        for symmetry in (Symmetry((begin, *more), model.rates is not None) for more in ((), *zip(forth))):
            at = np.searchsorted(again.times, evenly(period)[: SAMPLES // symmetry.parts + 1])
            path, pieces = again.path[at], again.transitions[: PIECES // symmetry.parts]
            (first, last), pieces = symmetry.rows(n), in_extents(pieces, units)
            constant = symmetry.constants(model.angular, path[0], path[-1], motion.turns)
            sizes = ((np.abs(first) + np.abs(last)) * units).max(axis=1)[:, None]
            missed = (first @ path[0] + last @ path[-1] - constant) / sizes[:, 0]
            whole = in_extents(again.through, units)[0] if again.through is not None and symmetry.parts == 2 else None
            through = multiplied(pieces) if whole is None else whole.astype(float)
            if np.abs(missed).max() > FALSE * max(1.0, float(np.linalg.norm(through))):
                continue
            late = through @ (again.rate / units) * period / symmetry.parts
            asked = np.hstack([first * units / sizes, last * units / sizes])
            ended = equations.ended(path)
            same = np.hstack([-again.gradients, ended]) * np.tile(units, 2)  # what rows ask of both ends and is kept
            told = np.linalg.lstsq(asked.T, same.T)[0]
            told = told[:, np.linalg.norm(asked.T @ told - same.T, axis=0) <= KNOWN * np.linalg.norm(same, axis=1)]
            frame = complement(told.T, told.T)
            first, last = np.split(frame.T @ asked, 2, axis=1)
            apart = distance(frame.T @ missed, (first, last), pieces, path / units, late, again.precise, whole)
            least = min(least, apart[0])
            if least <= DOUBTFUL:
                return least
    return least


def _centred(begin: Involution, motion: Motion, field: VectorField, model: Model) -> np.ndarray:
    """The state (d) of a motion where it is nearest to the fixed set of an involution."""
    states, period, angles = motion.states, float(motion.times[-1]), model.angular
    size, step = np.maximum(extents_of(model, states, period), KNOWN * np.abs(states).max(axis=0)), KNOWN * period
    k = int(np.abs(off_centre(begin, states[1:], angles)).max(axis=1).argmin())
    x, since = states[k + 1], float(motion.times[k + 1] - motion.times[k])
    for _ in range(5):
        off, after = off_centre(begin, np.array([x, x + step * field(0.0, x)]), angles)
        nearer = since - step * float(off @ (after - off)) / nonzero(float((after - off) @ (after - off)))
        since = min(max(nearer, step), period)  # where nothing moves it is anywhere
        x = integrate_in(size, field, states[k], np.array([0.0, since]))[-1]
    return np.asarray(x)


def beside(states: np.ndarray, count: int = 24) -> np.ndarray:
    """Seeded states (k x d) about a motion."""
    random = np.random.default_rng(0)
    rows = states[random.integers(0, len(states), count)]
    return np.asarray(rows + 0.3 * nonzero(np.ptp(states, axis=0)).clip(KNOWN) * random.normal(size=rows.shape))


def in_extents(matrices: Iterable[np.ndarray], units: np.ndarray) -> list[np.ndarray]:
    """State-transition matrices (m x m each) between states that are measured in `units` (m)."""
    return [matrix * units / units[:, None] for matrix in matrices]


def _variable(model: Model, states: np.ndarray, units: np.ndarray) -> float:
    """How much a first-order system's energy varies about a motion (k x d), |grad E| in its extents; nan without one.

    What is exchanged in it cannot be told: it is one expression.
    """
    which = next((k for k, one in enumerate(model.invariants) if one.generator is None), None)
    if which is None:
        return np.nan
    gradients = invariant_gradients(model)
    return max(float(np.abs(gradients(state).full()[which]) @ units) for state in states[:: SAMPLES // 16])


def multiplied(pieces: Iterable[np.ndarray]) -> np.ndarray:
    """Phi over all of some pieces (m x m each)."""
    return reduce(lambda done, piece: piece @ done, pieces).astype(float)


def _basis(gradients: np.ndarray, directions: np.ndarray, within: np.ndarray) -> np.ndarray:
    """A basis (m x r) of what is neither across a level set nor along a direction (k x m each), `within` (m x b)."""
    return np.asarray(within @ complement(gradients @ within, directions @ within))


def tour(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    forward: Involution | None = None,
    beside: tuple[np.ndarray, np.ndarray] | None = None,
    varied: ReferenceSettings = VARIED,
) -> Tour:
    """The `Tour` of a state (d) and a period of a smooth Model, of an orbit that is its own image by `forward` after
    half a period.

    Where errors grow, what is known of the motion `beside` it (k times from 0 to 1, k x d states) and found to be one
    by this integrator says what the state alone cannot.
    """
    own = system_kind(model.system).motion(model)
    given = model, state, period, turns, evenly(period), TIGHTEST
    motion = own(*given) if own else canonical_motion(*given, varied)
    acts = acting_in(model, motion.path)
    units = known_in(motion.reaching(motion.path), motion.masses, period, model.angular, acts)
    loop = _looped(model, motion, units, motion.path, period)
    if own is None:
        equations = Hamiltonian(model)
        if beside is not None and loop.closes.gap > GROWN:
            told, joins = _beside(equations, motion, units, *beside, varied)
            if joins.gap <= GROWN * joins.amplification:
                motion, loop = told, replace(loop, closes=joins)
        frames = map(equations.frame, equations.states(motion.begins), motion.begins)
        bases = [_basis(kept * units, along / units, tangent_basis(held * units)) for kept, along, held in frames]
        loop = replace(loop, divergence=partial(_divergence, equations, motion, units), bases=bases)
    pieces, root = in_extents(motion.transitions, units), 1
    if forward is not None:
        n, root = motion.turns.size, 2
        places = forward.places(n) * (units[None, :n] / units[:n, None])
        half = places if n == units.size else np.kron(np.eye(2), forward.places(n)) * units[None, :] / units[:, None]
        pieces = pieces[: len(pieces) // 2]
        pieces[-1] = half @ pieces[-1]
    return replace(loop, pieces=pieces, root=root, motion=(motion.times, motion.states))


def _beside(
    equations: Hamiltonian, motion: Motion, units: np.ndarray, times: np.ndarray, states: np.ndarray,
    varied: ReferenceSettings,
) -> tuple[Motion, Closure]:  # fmt: skip
    """The motion in pieces that begin at `states` (k x 2n; k `times` from 0 to 1) of the same orbit, and how well they
    join, the last and the first too: their largest gap and the most that a piece makes of an error.

    From its start alone an unstable orbit is known to fewer and fewer digits, and so is its linearisation.
    """
    each = SAMPLES // PIECES
    edges = motion.times[::each]
    period, begins, path = float(edges[-1]), [], []
    for k, now in enumerate(edges[:-1]):
        near = int(np.searchsorted(times * period, now, side="right")) - 1
        span = np.array([times[near] * period, now])
        begins.append(integrate_in(units, equations.field, equations.start(states[near]), span, VARIED)[-1])
        inside = motion.times[k * each : (k + 1) * each + 1]
        path.append(integrate_in(units, equations.field, begins[-1], inside, VARIED)[:each])
    pieces, nodes, _ = _pieces(equations, np.array(begins), units, period, varied)
    first = begins[0] + shift(motion.turns, units.size)
    apart = float(np.abs((nodes[1:] - [*begins[1:], first]) / units).max())
    largest = max(float(np.linalg.norm(piece)) for piece in in_extents(pieces, units))
    whole = np.vstack([*path, first])
    told = replace(motion, transitions=pieces, begins=np.array(begins), path=whole, states=equations.states(whole))
    return told, Closure(apart, largest, apart, (apart, largest), apart)


def _divergence(equations: Hamiltonian, motion: Motion, units: np.ndarray) -> tuple[float, float]:
    """By how much the divergence integrated along a motion misses sum log |det| of its pieces, and an error bar."""
    size, missed, refined, known = motion.path.shape[1], 0.0, 0.0, 0.0
    unit, edges = np.append(np.eye(size).ravel(), 0.0), motion.times[:: SAMPLES // PIECES]
    for k, begin in enumerate(motion.begins):
        try:
            volume, off, _ = _volume(equations, begin, edges[k : k + 2], units)
        except IntegrationError:  # stiff between two nodes: what the matrix itself says, known by its condition
            piece = motion.transitions[k]
            volume = float(np.linalg.slogdet(piece)[1])
            if not np.isfinite(volume):
                raise
            off = VARIED.relative_tolerance * float(np.linalg.cond(piece * units / units[:, None]))
        missed, known = missed + volume, known + off
        if not symplectic(equations.model):
            times = np.linspace(edges[k], edges[k + 1], SAMPLES // PIECES + 1)
            path = integrate_in(units, equations.field, begin, times, VARIED)
            rows = equations.variational.many(times, np.hstack([path, np.tile(unit, (times.size, 1))]))  # type: ignore[attr-defined]
            traces = rows[:, size:-1].reshape(-1, size, size).trace(axis1=1, axis2=2)
            fine, coarse = (float(simpson(traces[::by], x=times[::by])) for by in (1, 2))
            missed, refined = missed - fine, refined + fine - coarse
            known += 1e-10 * float(trapezoid(np.abs(traces), times))
    return abs(missed), abs(refined) + known


def _volume(
    equations: Hamiltonian, begin: np.ndarray, span: np.ndarray, units: np.ndarray, halvings: int = 16
) -> tuple[float, float, np.ndarray]:
    """log |det| of a state-transition matrix, by factors of which none has lost its least singular value to the
    largest; what it is known to; and where the motion (m) ends."""
    end, piece, _ = varied_end(equations.variational, begin, span, units, float(units @ units), VARIED)
    spread = float(np.linalg.cond(in_extents([piece], units)[0]))
    if spread < SPREAD or not halvings:
        return float(np.linalg.slogdet(piece)[1]), VARIED.relative_tolerance * spread, end
    first, off, middle = _volume(equations, begin, np.array([span[0], span.mean()]), units, halvings - 1)
    last, more, end = _volume(equations, middle, np.array([span.mean(), span[1]]), units, halvings - 1)
    return first + last, off + more, end


def second_closure(
    model: Model, state: np.ndarray, period: float, turns: np.ndarray, units: np.ndarray, precise: float = EPSILON
) -> float:  # fmt: skip
    """Closure in `units` (2n) of the accelerations themselves at a second tolerance, or as precise as that: other
    equations, other steps.

    Under a forcing the next period is gone through: what the forces do in the first one only does not come back.
    """
    field, begin = vector_field(accelerations(model)), period if model.forced else 0.0
    span = np.array([begin, begin + period])
    if precise < EPSILON and (by := extended(field, precise < ROUND_OFF)):
        return gap(state, by.end(units, state, span, field.free), turns, units)
    try:
        return gap(state, integrate_in(units, field, state, span, SECOND)[-1], turns, units)
    except IntegrationError:
        return np.inf


def native_closure(model: Model, state: np.ndarray, period: float, turns: np.ndarray, units: np.ndarray) -> float:
    """Closure in `units` (2n) by IDAS on the native DAE; infinite where it cannot integrate."""
    settings = DaeSettings(relative_tolerance=1e-13, absolute_tolerance=1e-13)
    try:
        motion = simulate_dae(model, state, period, 2, settings)
    except (IntegrationError, InputError):
        return np.inf
    return gap(motion.states[0], motion.states[-1], turns, units)


def constraint_defect(model: Model, state: np.ndarray, units: np.ndarray) -> float:
    """Largest |phi| and |J v| of a state (2n), relative to its lengths and to the rates' extents, `units` (2n)."""
    constraint, n, p = constraint_of(model), model.degrees_of_freedom, model.parameter_values
    q, v = state[:n], state[n:]
    phi, rate = constraint.phi(q, p).full(), constraint.rate(q, v, p).full()
    length = float(np.abs(q[~model.angular]).max(initial=0.0)) or 1.0
    fastest = float(np.abs(constraint.jacobian(q, p).full()).max() * units[n:].max())
    return max(float(np.abs(phi).max()) / length, float(np.abs(rate).max()) / fastest)


class ClosureCheck:
    """The closure of orbits by independent means, at the model's parameters or at freed ones.

    Hamilton's equations, derived from the energies alone, or those that a system's kind has of its own, by SciPy's
    adaptive DOP853 at its tightest; of orbits that may be stiff in as many evaluations as a certificate takes.
    """

    def __init__(self, model: Model, stiff: bool = False) -> None:
        self._model, self._at = model, dict[str, float]()
        self._equations = _equations(model)
        self._settings = TIGHTEST if stiff else CHECKED

    def __call__(
        self,
        state: np.ndarray,
        period: float,
        turns: np.ndarray,
        allowed: float = 0.0,
        free: Mapping[str, float] | None = None,
        units: np.ndarray | float = 1.0,
    ) -> float:
        """The largest gap round the loop of an orbit, in `units` (2n); `allowed` is what will be asked of it."""
        found = np.inf
        for longest in LONGEST_STEPS:
            found = gap(state, self._end(state, period, longest, free, units), turns, units)
            if found <= 0.5 * allowed:
                break
        return found

    def ends(
        self,
        nodes: np.ndarray,
        durations: np.ndarray,
        free: Mapping[str, float] | None = None,
        units: np.ndarray | float = 1.0,
    ) -> np.ndarray:
        """Where each piece of an orbit ends (N x 2n) that begins at a node (N x 2n) and lasts so long (s)."""
        edges = np.append(0.0, np.cumsum(durations)) * self._model.forced
        pieces = zip(nodes, durations, edges[:-1], strict=True)
        return np.stack(
            [self._end(node, duration, 1 / PIECE_STEPS, free, units, now) for node, duration, now in pieces]
        )

    def _end(
        self,
        state: np.ndarray,
        duration: float,
        longest: float,
        free: Mapping[str, float] | None,
        units: np.ndarray | float,
        now: float = 0.0,
    ) -> np.ndarray:
        """(q, v) after a time from `now`, by steps no longer than a share of it, in powers of 256 near the `units`."""
        free = free or {}
        if system_kind(self._model.system).reread:  # chains and linkages are made anew with them
            if self._at != dict(free):
                self._at, self._equations = dict(free), _equations(with_parameters(self._model, free))
        else:
            assert isinstance(self._equations, Hamiltonian)
            if self._equations.free != tuple(free):
                self._equations = Hamiltonian(self._model, tuple(free))
            self._equations.put(np.array(list(free.values())))
        span = np.array([now, now + duration])
        if not isinstance(self._equations, Hamiltonian):
            sizes = snapped(np.broadcast_to(units, state.shape))
            path = integrate_in(sizes, self._equations, state, span, self._settings, longest * duration)
            return np.asarray(path[-1])
        start = self._equations.start(state)
        sizes = snapped(np.broadcast_to(units, state.shape)[self._equations.coordinates.chosen])
        if np.all(sizes == 1.0):
            path = integrate(self._equations.field, start, span, self._settings, longest * duration)
        else:
            if self._model.rates is None:
                sizes[start.size // 2 :] *= snapped(self._equations.masses(start))
            path = integrate_in(sizes, self._equations.field, start, span, self._settings, longest * duration)
        return np.asarray(self._equations.states(path[-1:])[0])


def _equations(model: Model) -> Hamiltonian | VectorField:
    """Hamilton's equations of a Model, or the field of its own state that its kind has."""
    return system_kind(model.system).field(model) or Hamiltonian(model)
