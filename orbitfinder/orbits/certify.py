"""Is it true? What `evidence` recomputed about an orbit, and what its record claims, check by check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import gcd
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime.rooms import filled
from orbitfinder._runtime.sizes import EPSILON, LEAST, nonzero, size_of
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.automaton import Arc
from orbitfinder.integrate.compiled import available
from orbitfinder.integrate.dop853 import integrate_in
from orbitfinder.integrate.equations import accelerations, invariant_gradients
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.integrate.field import rates_of, vector_field
from orbitfinder.loops.symmetry import NONE, beside, knowing, recognise, shifts_of, symmetries_of, symplectic, turned
from orbitfinder.mechanics.hybrid import as_recorded
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Invariant, Model, between, counted, energies, wrapped
from orbitfinder.mechanics.scales import extents
from orbitfinder.orbits.between import early_return, unresolved
from orbitfinder.orbits.closure import LARGEST_SCALE, ROUND_OFF, shift, shift_along
from orbitfinder.orbits.evidence import (
    CLOSED,
    KEPT,
    VARIED,
    Evidence,
    Recomputed,
    constraint_defect,
    gather,
    native_closure,
    off_motion,
    second_closure,
)
from orbitfinder.orbits.floquet import Floquet, verdict
from orbitfinder.orbits.hill import MOST_MODES
from orbitfinder.orbits.hybrid import (
    HybridEvidence,
    gather_hybrid,
    held,
    paths,
    repeats,
    second_gap,
    turned_further,
    unseen,
)
from orbitfinder.orbits.implicit import SMALL, STEPS, gathered, suits
from orbitfinder.orbits.reduction import reduction
from orbitfinder.records.certificate import Certificate, Check, at_least, at_most, equal, refused, same
from orbitfinder.records.codec import entries_of
from orbitfinder.records.family import FamilyPoint
from orbitfinder.records.orbit import DIGESTED, SHIFT, Orbit, digest, incomputable, orbit_to_document
from orbitfinder.records.reading import bounded

MOST_TURNS = 10**6
"""Whole turns in a period that are still believed"""
NODES_OFF, SAMPLES_OFF, LARGEST_PICTURE = 1e-9, 1e-6, 1e-3
"""Shares of the extents that recorded nodes and samples may be off the motion, and that growing errors may excuse"""
LARGEST_GROWTH = 1e10
"""Growth of errors between any two instants that may excuse recorded multipliers"""
PAIRED, LARGEST_DEFECT = 10.0, 0.1
"""Relative errors of the integration in the product of two reciprocal multipliers; and what excuses no more"""
BADLY = 1e-9
"""Multipliers whose products are as far from 1 as this are looked at for better ones"""
RECORDED = "recorded - recomputed, relative"
KNOWN, LEAST_KNOWN = 10.0, 1e-6
"""Times that an orbit of a stiff structure may be off what other steps say of its end, by round-off of its forces; how
badly that may be known"""
MEETING = 1e-4
"""How near to each other mu and 1 / mu are where their sum is known better than they are"""
TRIED = 12
"""States about the motion at which the equations are compared."""
EXACT = 1e-10
"""Relative difference of the accelerations between two moments that should be alike."""
DRIFT = 1e-9
"""Drift of an invariant along the motion, relative to how much it varies about it."""
ROUNDED = 64 * EPSILON
"""Relative error of an invariant's value."""
STEEPEST, HALVINGS, BESIDE, JUMP = 32, 30, 1e-6, 1e-4
"""Pairs of samples between which a jump is looked for, halvings of their time, how far beside the motion (in extents)
it must be seen too, its size"""
TOLD_APART = 10.0
"""A motion comes back no nearer than so many times what it closes to, or it cannot be told from one that returns"""
RESOLVED = 1e-10
"""Extents by which features between two steps may change the end of the motion"""
LATER, PARTS = 32, 256
"""Periods of the forcing after which the equations are compared again, at so many moments in each."""
TURNS = (-2, -1, 1, 2, 3, 4, 5, 6, 7, 8)
"""Whole turns of a running motion after which the equations are compared again"""


@dataclass(frozen=True)
class Tolerances:
    """What each check allows, in extents of the motion; closure and its kin are multiplied by the certificate's scale.

    A record's own `tolerance` may ask for a smaller closure than this, not for a larger one.
    """

    closure: float = CLOSED
    distance: float = 1e-9
    second_closure: float = 1e-9
    energy_drift: float = 1e-11
    cover: float = 1e-6
    motion: float = 1e-6
    trivial: float = KEPT
    symplectic: float = 1e-8
    unfolding: float = 1e-9
    record: float = 1e-10
    constraint: float = 1e-11
    native_closure: float = 1e-7
    multipliers: float = 1e-6
    transversal: float = 1e-4
    holds: float = 1e-9
    stationarity: float = 1e-6
    between: float = 1e-3


@one_thread()
def certify(orbit: Orbit, model: Model | None = None, tolerances: Tolerances | None = None) -> Certificate:
    """The certificate of an orbit, from its state and period alone.

    Everything is computed again by another integrator on another formulation. The gap round the loop, in extents of
    the motion, is required to be below 1e-12 A (or the record's tolerance if that is smaller) with A = max over t of
    |S^-1 Phi(T, t) S|, what round-off can do, capped at 1e6; and the true orbit to be within 1e-9 of the motion.

    Args:
        orbit: what is claimed.
        model: needed only for systems that no file describes.
        tolerances: what is allowed; the defaults are what files are judged by.

    Returns:
        A Certificate: every check with its number and what is allowed.

    Raises:
        InputError: where the system cannot be rebuilt.

    Examples:
        >>> of.certify(orbit).passed
        True
        >>> from dataclasses import replace
        >>> of.certify(replace(orbit, period=1.001 * orbit.period)).failures
        ('closure', 'distance', 'second_closure', ...)

    See Also:
        `of.prove` for a theorem in place of a measurement.
    """
    return _judged(orbit, _model_of(orbit, model), tolerances or Tolerances())[1]


@one_thread()
def certified(orbit: Orbit, model: Model) -> Orbit:
    """The orbit with its certificate and the closure found there, and its multipliers where they are better known."""
    orbit, certificate = _judged(orbit, _model_of(orbit, model), Tolerances(), better=True)
    closure = certificate.closure if np.isfinite(certificate.closure) else orbit.closure
    return replace(orbit, certificate=certificate, closure=closure)


def _judged(orbit: Orbit, model: Model, allowed: Tolerances, better: bool = False) -> tuple[Orbit, Certificate]:
    """An orbit, with multipliers and symmetry as recomputed here where they are `better` known, and its certificate."""
    turns = _turns(orbit, model)
    turned(model, turns, orbit.shift)
    if fault := _malformed(orbit):
        return orbit, Certificate((refused("finite", fault, np.nan),))
    verifier = verifier_of(orbit, model)
    if fault := incomputable(orbit.state, orbit.period):
        return orbit, Certificate((refused(verifier.missing, f"{fault}; find the orbit again"),))
    try:
        with np.errstate(all="ignore"):  # what overflows is no number, and fails its check
            seen, second = verifier.gather(orbit, model, turns)
    except (ConvergenceError, IntegrationError, np.linalg.LinAlgError) as error:
        return orbit, Certificate((refused(verifier.missing, error),))
    if better and isinstance(seen, Evidence):
        symmetry, again = _symmetry_of(orbit, seen, model), seen.floquet
        # multipliers whose pairs are reciprocal ten times better, if they agree to what the worse claim
        sharper = orbit.pair_defect > BADLY and PAIRED * again.pair_defect < orbit.pair_defect
        if sharper and _multiplier_distance(orbit, again) <= orbit.pair_defect:
            orbit = replace(
                orbit, floquet_multipliers=again.multipliers, pair_defect=again.pair_defect, stability=again.stability
            )
        if symmetry != NONE.name:
            orbit = replace(orbit, symmetry=symmetry)
    trial = Trial(orbit, model, turns, allowed, seen, second)
    checks, late = tuple(check for check in verifier.checks(trial) if check), seen.closes.period_error * orbit.period
    return orbit, Certificate(checks, trial.scale, seen.closure, late)


def _malformed(orbit: Orbit) -> str:
    """What is wrong with the first of a record's numbers that is none; "" where all are."""
    looked_at = {*DIGESTED, "shift", "control"} - {"system", "expected"}
    claims = {name: value for name, value in entries_of(orbit, Orbit).items() if name in looked_at}
    try:
        bounded(claims, "record", "find the orbit again")
    except InputError as error:
        return str(error)
    return "" if orbit.period > 0 else f"record: period: {orbit.period:g} is no period; find the orbit again"


@dataclass(frozen=True)
class Verifier:
    """A way to go through an orbit again, and what is then asked of it."""

    suits: Callable[[Orbit, Model], bool]
    """(orbit, model) -> whether it is for this one"""
    gather: Callable[[Orbit, Model, np.ndarray], tuple[Recomputed, float]]
    """(orbit, model, turns (n)) -> what another integrator says of its state and period alone, and its closure at a
    second tolerance; raises `ConvergenceError`, `IntegrationError`"""
    checks: Callable[[Any], Iterator[Check | None]]
    """(`Trial`) -> the checks"""
    missing: str = "integration"
    """the check that fails where there is no such motion"""
    shown: Callable[[Orbit, Model], tuple[np.ndarray, np.ndarray]] | None = None
    """(orbit, model) -> times and states of its period by the record alone, where the Model alone moves otherwise"""


def verifier_of(orbit: Orbit, model: Model) -> Verifier:
    """The `Verifier` of an orbit: the latest entry that suits it."""
    filled("verifiers")
    return next(verifier for verifier in reversed(VERIFIERS.values()) if verifier.suits(orbit, model))


def shown(orbit: Orbit, model: Model) -> tuple[np.ndarray, np.ndarray] | None:
    """Times (k, s) and states (k x d) of a period: an orbit's samples, else those that its record makes; None where the
    motion from its nodes is that."""
    if len(orbit.samples) > 1:
        return orbit.times, orbit.samples
    make = verifier_of(orbit, model).shown
    return None if make is None else make(orbit, model)


def _through_impacts(orbit: Orbit, model: Model, turns: np.ndarray) -> tuple[HybridEvidence, float]:
    given = model, orbit.state, orbit.period, turned(model, turns, orbit.shift)
    impacting = gather_hybrid(*given)
    return impacting, second_gap(*given, impacting.extents)


def _smoothly(orbit: Orbit, model: Model, turns: np.ndarray) -> tuple[Evidence, float]:
    given = model, orbit.state, orbit.period, turned(model, turns, orbit.shift)
    moments = np.concatenate([times for _, times, _, _ in _pictured(orbit)])
    smooth = gather(*given, moments, doubts=lambda seen: _multiplier_distance(orbit, seen) > Tolerances.multipliers)
    second, scale = second_closure(*given, smooth.extents), min(smooth.closes.amplification, LARGEST_SCALE)
    if second > Tolerances.second_closure * scale:  # by round-off, maybe
        second = second_closure(*given, smooth.extents, smooth.motion.precise)
    return smooth, second


def _model_of(orbit: Orbit, model: Model | None) -> Model:
    """The orbit's Model, of a hybrid one without a cycle that with the record's."""
    return as_recorded(model or build_model(orbit.system), orbit.system)


class Trial:
    """A record beside the motion that was recomputed, by whatever kind of integrator, and the checks of every kind.

    `turns` (n) are whole, `second` is the closure at a second tolerance; tolerances of closure and its kin are
    multiplied by `scale`, `asked` is the closure that is asked for, by the record if that is smaller, `room` what
    numbers may be off that follow from the whole motion.
    """

    def __init__(
        self, orbit: Orbit, model: Model, turns: np.ndarray, allowed: Tolerances, seen: Any, second: float
    ) -> None:
        self.orbit, self.model, self.turns = orbit, model, turns
        self.allowed, self.seen, self.second = allowed, seen, second
        self.gap = seen.closes.gap
        self.scale = min(seen.closes.amplification, LARGEST_SCALE)
        self.asked = min(orbit.tolerance, allowed.closure)
        self.room = allowed.record + 10 * self.gap

    def closing(
        self, note: str = "", of: str = "orbit, in extents of the motion", second: str = "DOP853 at a second tolerance",
        known: float = 0.0,
    ) -> Iterator[Check]:  # fmt: skip
        """The gap of the worst part of the state, by its own A; how near the true orbit is, or as the end is `known`;
        another tolerance."""
        gap, grown = self.seen.closes.worst
        note += f"{gap / (EPSILON * grown):.2g} round-offs grown {grown:.3g} times"
        yield at_most("closure", gap, self.asked * min(grown, LARGEST_SCALE), note)
        apart = max(self.seen.closes.distance, self.seen.closes.late)
        yield at_most("distance", apart, max(self.allowed.distance, known), f"of the true {of}")
        tolerance = self.allowed.second_closure * self.scale
        yield at_most("second_closure", self.second, tolerance, second)

    def moving(self, note: str = "extent of the motion") -> Check:
        """Extent of the coordinates, of angles or of others, relative to their size."""
        places, angular = self.seen.states[:, : self.model.degrees_of_freedom], self.model.angular
        groups = [places[:, angular], places[:, ~angular]]
        extent = max(float(np.ptp(group, axis=0).max() / size_of(group)) for group in groups if group.size)
        return at_least("not_equilibrium", extent, self.allowed.motion, note)

    def apart(self, name: str, least: float, note: str, gap: float = 0.0) -> Check:
        """What comes back early is farther away than what must be told apart, and than the gap, or that of what says so
        if it is larger."""
        return at_least(name, least, max(self.allowed.cover, TOLD_APART * max(self.gap, gap)), note)

    def unfolding(self, room: float, note: str = "back at 0, per period", always: bool = False) -> Check | None:
        """The unfolding parameters, where there are any."""
        largest = self.orbit.period * max(map(abs, self.orbit.unfolding), default=0.0)
        return at_most("unfolding", largest, self.allowed.unfolding + room, note) if largest or always else None

    def number(self, name: str, size: float, room: float | None = None) -> Check:
        """A recorded number against the one recomputed, relative to a size."""
        off = abs(getattr(self.orbit, name) - getattr(self.seen, name)) / size
        return at_most(name, off, self.allowed.record if room is None else room, RECORDED)

    def energy(self, size: float) -> Check | None:
        """The recorded energy, where there is one."""
        known = np.isfinite(self.orbit.energy) or np.isfinite(self.seen.energy)
        return self.number("energy", size) if known else None

    def linear(self, room: float) -> Iterator[Check]:
        """The recorded closure, multipliers and stability."""
        off, held = abs(self.orbit.closure - self.seen.closure) / float(self.seen.extents.max()), self.asked
        if isinstance(self.orbit, FamilyPoint):  # relative, and by an integration that stops where it is enough
            off, held = abs(self.orbit.closure - self.gap), self.orbit.tolerance
        yield at_most("recorded_closure", off, held * self.scale, RECORDED)
        yield at_most("floquet_multipliers", _multiplier_distance(self.orbit, self.seen.floquet), room, "relative")
        defect = abs(self.orbit.pair_defect - self.seen.floquet.pair_defect)
        if defect and not isinstance(self.seen, Evidence):  # which asks for reciprocal pairs
            yield at_most("pair_defect", defect, self.allowed.multipliers, RECORDED)
        yield same("stability", self.orbit.stability, _undecided(self.orbit, self.model) or self.seen.floquet.stability)

    def record(self) -> Check | None:
        """The digest of the file."""
        claimed = self.orbit.record
        return None if claimed is None else same("record", claimed, digest(orbit_to_document(self.orbit)))

    def shown(self, name: str, off: np.ndarray | float, share: float, growth: np.ndarray | float) -> Check:
        """Recorded states lie on the motion, to a share of its extents or as well as errors of the state allow, where
        `off` is each component's (d) with what errors of its own grow to."""
        lost = np.where(np.isfinite(off), off, np.inf)
        room = np.clip(1e-12 * np.asarray(growth), share, LARGEST_PICTURE)
        worst = (lost * (share / room)).argmax()
        return at_most(name, float(lost.flat[worst]), float(room.flat[worst]), "off the recomputed motion")

    def windings(self, off: Callable[[np.ndarray], float], note: str) -> Iterator[Check]:
        """A coordinate that turns is an angle, and all is the same where all have turned as they do in some periods."""
        for k in np.flatnonzero(self.turns * ~self.model.angular):
            name = self.model.state_names[k]
            yield refused("winding", f"{name} turns and is not an angle", float(abs(self.turns[k])))
        if np.any(self.turns):
            names = ", ".join(self.model.state_names[k] for k in np.flatnonzero(self.turns))
            yield at_most("winding", off(shift(self.turns, self.seen.extents.size)), EXACT, note.format(names))


def between_steps(found: float, width: float, of: str) -> Check:
    """What features narrower than the steps change (in extents); `of` what the width of the looks is a share of."""
    note = f"change by what lies between steps; looks {width:.1e} of {of} or less apart"
    return at_most("resolution", found, RESOLVED, note)


def _smooth_checks(trial: Trial) -> Iterator[Check | None]:
    """The checks of a smooth orbit: its motion by other equations and another integrator, from state and period."""
    seen: Evidence = trial.seen
    orbit, model, allowed, gap = trial.orbit, trial.model, trial.allowed, seen.closes.gap
    # near a saddle errors grow between any two instants; Phi takes up more than what it is at the end
    passing = ROUND_OFF * EPSILON * min(seen.growth, LARGEST_GROWTH)
    taken = ROUND_OFF * EPSILON * min(seen.varied / nonzero(seen.norm), LARGEST_SCALE**2)
    still = float(np.abs(seen.motion.path / seen.tour.units).min(axis=0).max())  # steps are taken to shares of it
    rough = PAIRED * VARIED.relative_tolerance * still * seen.varied / nonzero(seen.norm)
    kept = max(allowed.trivial, passing, taken, min(rough, allowed.multipliers))
    near, moving = Nearby(model, seen), "" if orbit.shift else reduction(model, orbit)
    by = "DOP853" if seen.motion.missed is None else "extrapolation in long double or better"
    said = "orbit, in extents of the motion"
    if seen.motion.missed is None and seen.closes.distance > allowed.distance and not available()[0]:
        said += "; long double, which may tell more, needs a C compiler"
    yield from trial.closing(f"{by} on {seen.motion.formulation}; ", said)
    if model.conservative:
        yield at_most("energy_drift", seen.drift, allowed.energy_drift + gap, "relative to the energy exchanged")
    yield forcing_check(orbit, model)
    yield near.time_dependence()
    if model.forced:  # where nothing else tries the variations: no flow is kept
        yield near.smooth()
    turning = f"equations of motion with {{}} {TURNS[0]} to {TURNS[-1]} times on"
    yield from trial.windings(near.turned_further, turning)
    yield from near.shifts(orbit.shift)
    yield from near.invariants()
    yield _minimal_period(trial, near, seen)
    yield _resolution(seen)
    yield trial.moving("extent of the motion" + (f"; a {moving}" if moving else ""))
    if model.invariants or not model.forced:
        yield at_most("trivial_multipliers", seen.tour.trivial, kept, "flow and gradients are kept")
    if model.canonical:
        yield at_most("symplectic", seen.tour.asymplectic, max(allowed.symplectic, kept), "Phi^T J Phi = J")
    yield trial.unfolding(10 * gap, always=bool(model.invariants))
    if model.constraint is not None:  # and by IDAS on the native DAE
        units, gone = seen.extents, turned(model, trial.turns, orbit.shift)
        defect = constraint_defect(model, orbit.state, units)
        yield at_most("constraint", defect, allowed.constraint, "largest |phi|, |J v| of the state, relative")
        returned = native_closure(model, orbit.state, orbit.period, gone, units)
        yield at_most("native_closure", returned, allowed.native_closure * trial.scale, "IDAS on the native DAE")
    yield from _record_checks(trial, seen, max(allowed.multipliers, passing))
    errors = seen.growth * np.maximum(np.abs(seen.states).max(axis=0) / seen.extents, 1.0)  # of what hardly moves
    for name, times, states, share in _pictured(orbit):
        there = seen.motion.states[np.searchsorted(seen.motion.times, times)]
        yield trial.shown(name, np.abs((there - states) / seen.extents).max(axis=0), share, errors)
    yield from expected_checks(orbit, model)


def _large_checks(trial: Trial) -> Iterator[Check | None]:
    """The checks of a structure of many coordinates: its motion by implicit steps, from state and period."""
    seen, orbit, model = trial.seen, trial.orbit, trial.model
    known = min(KNOWN * trial.second, LEAST_KNOWN)
    yield from trial.closing("Gauss' steps on the accelerations; ", second="by fewer steps, elsewhere", known=known)
    yield forcing_check(orbit, model)
    near, gap = Nearby(model, seen), seen.closes.gap
    yield near.time_dependence()
    yield from near.invariants()
    yield trial.moving()
    waves = np.fft.rfft(seen.states[:-1], axis=0) / (len(seen.states) - 1)

    def at(times: np.ndarray) -> np.ndarray:
        turn = 2j * np.pi / orbit.period * np.outer(times, np.arange(len(waves)))
        return np.asarray((2 * np.exp(turn) @ waves - waves[0]).real)

    cycles = model.forcing_cycles(orbit.period) if model.forced else 0
    if parts := [k for k in range(2, STEPS) if cycles % k == 0]:
        back = np.abs((at(orbit.period / np.array(parts)) - seen.states[0]) / seen.extents).max(axis=1)
        yield trial.apart("minimal_period", back.min(), f"nearest early return after T/{parts[back.argmin()]}")
    kinetic, potential = energies(model, seen.states)
    size, total = size_of(kinetic.max() + np.ptp(potential)), kinetic + potential
    if model.conservative:
        shaken = seen.states * (1 + EPSILON * np.random.default_rng(0).uniform(-4, 4, seen.states.shape))
        rounded = 4 * float(np.abs(sum(energies(model, shaken)) - total).max()) / size  # of what is stiff
        yield at_most("energy_drift", np.ptp(total) / size, trial.allowed.energy_drift + gap + rounded,
                      "relative to the energy exchanged")  # fmt: skip
        yield at_most("trivial_multipliers", seen.tour.trivial, trial.allowed.trivial, "flow and gradients are kept")
        yield trial.unfolding(10 * gap, always=True)
    yield trial.energy(size)
    yield trial.number("action", size_of(max(abs(seen.action), 1e-3 * size * orbit.period)), trial.room)
    yield from trial.linear(trial.allowed.multipliers)
    yield same("symmetry", orbit.symmetry, _symmetry_of(orbit, seen, model))
    yield trial.record()
    for name, times, states, share in _pictured(orbit):
        yield trial.shown(name, np.abs((at(times) - states) / seen.extents).max(), share, 1.0)
    yield from expected_checks(orbit, model)


def _hybrid_checks(trial: Trial) -> Iterator[Check | None]:
    """The checks of a hybrid orbit: its automaton simulated, all guards watched, from the state alone."""
    seen: HybridEvidence = trial.seen
    orbit, model, allowed, gap = trial.orbit, trial.model, trial.allowed, seen.closes.gap
    lasted = abs(seen.period / orbit.period - 1)
    events = [str(arc.ended_by) for arc in seen.arcs]
    ignored = "".join(f"; ignored: {text}" for text in model.hybrid.ignored)
    yield equal("events", events != list(model.cycle), 0.0,
                f"as simulated by DOP853, all guards watched: {', '.join(events)}{ignored}")  # fmt: skip
    yield from trial.closing()
    yield at_most("recorded_period", lasted, trial.asked * trial.scale, "time of the last event / recorded period - 1")
    yield at_most("energy_drift", seen.drift, allowed.energy_drift + gap, "in arcs without forces")
    yield at_most("energy_balance", seen.balance, allowed.energy_drift + gap, "energy lost in impacts")
    yield _minimal_cycle(trial, seen.arcs)
    yield trial.moving()
    found, width, crossed = unseen(model, seen)
    missed = f"the guard of {crossed} is crossed where the simulation saw nothing"
    yield at_most("resolution", 1.0, RESOLVED, missed) if crossed else between_steps(found, width, "an arc")
    yield at_least("transversal", seen.transversal, allowed.transversal, "least rate of a guard, relative")
    if np.isfinite(seen.decided):
        yield at_least("decided", seen.decided, allowed.transversal, "least |allowed| at a crossing, relative")
    yield from holding(held(seen.arcs), allowed)
    yield at_most("trivial_multipliers", seen.tour.trivial, allowed.trivial, "flow and gradients are kept")
    yield trial.unfolding(10 * gap)
    yield trial.energy(size_of(seen.energy))
    yield trial.number("action", size_of(seen.action), trial.room)
    yield from trial.linear(allowed.multipliers)
    had = repeats(model, orbit.symmetry, seen, turned(model, trial.turns, orbit.shift))
    yield same("symmetry", orbit.symmetry, orbit.symmetry if had else NONE.name)
    yield trial.record()
    yield from expected_checks(orbit, model)

    def moved_on(by: np.ndarray) -> float:
        return max(turned_further(model, seen.arcs, k * by) for k in TURNS[1:5])

    yield from trial.windings(moved_on, "modes, guards and resets with {} turned on")
    if orbit.shift:
        by = shift(turned(model, 0 * trial.turns, orbit.shift), seen.extents.size)
        note = f"modes, guards and resets with {', '.join(orbit.shift)} shifted on"
        yield at_most("cyclic", moved_on(by), EXACT, note)
    single = orbit.nodes.shape == orbit.state[None].shape
    nodes = float(np.abs((orbit.nodes - orbit.state) / seen.extents).max()) if single else np.inf
    yield at_most("nodes", nodes, NODES_OFF, "the first is the state")
    if orbit.samples.size or orbit.times.size:
        off = off_motion(paths(model, seen.arcs), orbit.times, orbit.samples, seen.extents, seen.period)
        yield trial.shown("samples", off, SAMPLES_OFF, seen.closes.amplification)


def holding(least: Iterable[tuple[str, float]], allowed: Tolerances) -> Iterator[Check]:
    """What must not be negative along a motion."""
    for name, value in least:
        yield at_least(f"holds: {name}", value, -allowed.holds, "least value along the motion")


def _minimal_cycle(trial: Trial, arcs: Sequence[Arc]) -> Check | None:
    """The recorded cycle is gone through once: no earlier event brings the motion back to its beginning."""
    names = [arc.ended_by for arc in arcs]
    count = len(names)
    shorter = [k for k in range(1, count) if count % k == 0 and names[:k] * (count // k) == names]
    if not shorter:
        return None
    gone = turned(trial.model, trial.turns, trial.orbit.shift)
    back = np.array([arcs[k - 1].after for k in shorter]) - trial.orbit.state
    back[:, : gone.size] -= 2 * np.pi * np.array(shorter)[:, None] / count * gone
    far = np.abs(back / trial.seen.extents).max(axis=1)
    return trial.apart("minimal_cycle", far.min(), f"nearest early return after {shorter[int(far.argmin())]}")


def _turns(orbit: Orbit, model: Model) -> np.ndarray:
    """Whole turns (n) of the coordinates. Raises `InputError` where the record contradicts its system."""
    if (orbit.state.size, len(orbit.winding)) != (len(model.state_names), model.degrees_of_freedom):
        sizes = f"{orbit.state.size} numbers and {len(orbit.winding)} turns for {counted(model)}"
        raise InputError(f"state: {sizes}; the record contradicts its system, run the problem again")
    if any(abs(k) > MOST_TURNS for k in orbit.winding):
        raise InputError(f"winding: more than {MOST_TURNS} turns in a period; run the problem again")
    return np.asarray(orbit.winding, int)


def forcing_check(orbit: Orbit, model: Model) -> Check | None:
    """The period of a forced motion is a whole multiple of the forcing's."""
    if model.forcing_period is None:
        return None
    cycles = model.forcing_cycles(orbit.period)
    wanted = cycles * model.driving_period
    return at_most("forcing_period", abs(orbit.period / wanted - 1), 1e-14, f"period / {cycles} forcing periods - 1")


def _minimal_period(trial: Trial, near: Nearby, seen: Evidence) -> Check | None:
    """The motion, and what forces it, do not come back before the period is over."""
    forced, shifts = near.model.forced, shifts_of(near.model)
    apart = beside(trial.turns, [shifts[name].direction for name in trial.orbit.shift])
    if gcd(*(int(k) for k in np.rint(apart))) == 1:
        return None
    found, lag = early_return(seen.motion.trace, apart, near.forced_alike if forced else None)
    both = " of motion and forcing" if forced and found < trial.allowed.cover else ""
    note = "no early return" if lag is None else f"nearest early return{both} after T/{near.period / lag:.6g}"
    trace = seen.motion.trace  # of double precision
    own = float(np.abs(trace.states[-1] - trace.states[0] - trace.drift).max())
    return trial.apart("minimal_period", found, note, own)


def _resolution(evidence: Evidence) -> Check:
    """No feature of the equations between two steps of the integration changes where it ends."""
    try:
        found, width, count = unresolved(evidence.motion.trace, evidence.motion.varied)
    except IntegrationError as error:
        return refused("resolution", error, tolerance=RESOLVED)
    note = f"change by what lies between steps; {count} looks, each {width:.1e} of the motion or less from the next"
    return at_most("resolution", found, RESOLVED, note)


Picture = tuple[str, np.ndarray, np.ndarray, float]


def _pictured(orbit: Orbit) -> list[Picture]:
    """What the record shows of the motion: name, times, states, share of the extents that they may be off."""
    size, period, count, times = orbit.state.size, orbit.period, len(orbit.nodes), orbit.times
    unfit = np.zeros(1), np.full((1, size), np.nan)
    even = np.arange(count) * (period / max(count, 1)), orbit.nodes
    found = [("nodes", *(even if count and orbit.nodes.shape == (count, size) else unfit), NODES_OFF)]
    if orbit.samples.size or times.size:
        sound = orbit.samples.shape == (times.size, size) and times.size > 1 and np.all(np.diff(times) > 0)
        whole = sound and times[0] == 0.0 and abs(times[-1] / period - 1) <= 1e-12
        found.append(("samples", *((np.minimum(times, period), orbit.samples) if whole else unfit), SAMPLES_OFF))
    return found


def return_distances(times: np.ndarray, states: np.ndarray, angles: np.ndarray, covers: Sequence[int]) -> list[float]:
    """Distance of x(T/k) from x(0) for each k, angles modulo 2 pi, relative to the motion's extent: a first look.

    States between samples come from a periodic spline of the deviation; the certificate integrates to T/k.
    """
    there = between(times, states, angles.size, times[-1] / np.asarray(covers, float))
    masses = np.ones(angles.size if angles.size < states.shape[1] else 0)
    units = extents(np.ptp(states, axis=0), masses, float(times[-1]), angles)
    return [float(one) for one in np.abs(wrapped(there - states[0], angles) / units).max(axis=1)]


def _record_checks(trial: Trial, seen: Evidence, multipliers: float) -> Iterator[Check | None]:
    """What the record claims against what was recomputed; catches a file edited by hand."""
    orbit, model = trial.orbit, trial.model
    bulk = max(abs(seen.action), 1e-3 * seen.exchanged * orbit.period)
    if model.hamiltonian:  # momenta far from 0 cancel round the loop
        half = orbit.state.size // 2
        bulk = max(bulk, float(np.abs(seen.states[:, half:]).max(axis=0) @ seen.extents[:half]))
    yield trial.energy(seen.exchanged)
    yield trial.number("action", bulk, trial.room)
    yield from trial.linear(multipliers)
    yield same("symmetry", orbit.symmetry, _symmetry_of(orbit, seen, model))
    # mu and 1/mu of a matrix that takes up a few relative errors of the integration under way: |Phi| times what they
    # grow to
    paired, known = symplectic(model), PAIRED * VARIED.relative_tolerance * seen.varied * seen.norm
    pairs = max(trial.allowed.trivial, min(known, LARGEST_DEFECT)) if paired else 0.0
    defect = max(seen.floquet.pair_defect, abs(orbit.pair_defect))
    if paired or defect:
        yield at_most("pair_defect", defect, pairs, "reciprocal pairs, as recorded and as found")
    if orbit.shift:
        there = shift_along(model, orbit.shift, seen.states[0], seen.states[-1], trial.turns)
        off = max(abs(there[name] - by) for name, by in orbit.shift.items()) / float(seen.extents.max())
        held = orbit.tolerance if isinstance(orbit, FamilyPoint) else trial.asked
        yield at_most("shift", off, held * trial.scale, "recorded - recomputed, in extents of the motion")
    yield trial.record()


def _symmetry_of(orbit: Orbit, evidence: Recomputed, model: Model) -> str:
    """The recorded symmetry if it is found, else what is; of a declared one a record from before may say nothing.

    Fast motions pass their centre between samples: before a symmetry is denied, more of them are looked at. A family's
    point claims the symmetry of its formulation only, and may have more.
    """
    model = knowing(model, orbit.symmetry)

    def recognised(times: np.ndarray, states: np.ndarray) -> list[str]:
        return [recognise(times, states, model, own=own) for own in (True, False)[: 1 + bool(model.symmetries)]]

    names, known = recognised(evidence.times, evidence.states), symmetries_of(model)
    if orbit.symmetry not in names and isinstance(evidence, Evidence):
        times = np.linspace(0.0, orbit.period, 4 * evidence.times.size - 3)
        field = vector_field(accelerations(model))
        names += recognised(times, integrate_in(evidence.extents, field, orbit.state, times))
    if isinstance(orbit, FamilyPoint) and orbit.symmetry in known:
        had = {one for name in names for one in (*known[name].maps, *known[name].both)}
        names += [orbit.symmetry] * (set(known[orbit.symmetry].maps) <= had)
    return orbit.symmetry if orbit.symmetry in names else names[0]


def _undecided(orbit: Orbit, model: Model) -> str:
    """The verdict on a point of a dissipative family whose recorded error bars decide, and where none is claimed, of
    many coordinates; else ""."""
    if orbit.stability == "undecided" and orbit.floquet_multipliers.size < orbit.state.size - 2 * (not model.forced):
        return orbit.stability
    if not isinstance(orbit, FamilyPoint) or orbit.multiplier_errors.shape != orbit.floquet_multipliers.shape:
        return ""
    if symplectic(model):
        return ""
    told = verdict(orbit.floquet_multipliers, orbit.multiplier_errors)
    return told if told == "marginal" == orbit.stability else ""


def _multiplier_distance(orbit: Orbit, floquet: Floquet) -> float:
    """Largest relative distance between recorded and recomputed multipliers, matched one to one.

    Of many coordinates few may be recorded, of stiff ones none.

    Where mu and 1 / mu meet, at +1 and -1, both are known to the square root of what their sum is known to: there the
    sum is compared, of which mu - 1 / mu is the derivative, relative to `MEETING`.
    """
    recorded, found = orbit.floquet_multipliers, floquet.multipliers
    if recorded.size != found.size and not (recorded.size < found.size and orbit.state.size > 2 * SMALL):
        return np.inf if recorded.size or orbit.stability != "undecided" else 0.0
    if not recorded.size:
        return 0.0
    largest = np.abs(found).max()
    apart = np.abs(recorded[:, None] - found[None, :])
    split = np.abs(found - 1.0 / np.where(found == 0, LEAST, found))[None, :]
    distance = apart / np.maximum(1.0, np.abs(found))[None, :] * np.minimum(1.0, (split + apart) / MEETING)
    rows, columns = linear_sum_assignment(np.minimum(distance, 1e6 * max(1.0, largest)))
    return float(distance[rows, columns].max())


def expected_checks(orbit: Orbit, model: Model) -> list[Check]:
    """Numbers known from elsewhere: of the orbit, or of physical parameters that were free."""
    checks = []
    for name, (value, tolerance) in orbit.expected.items():
        if name in ("period", "energy", "action"):
            found = getattr(orbit, name)
        elif name.removeprefix(SHIFT) in orbit.shift and name.startswith(SHIFT):
            found = orbit.shift[name.removeprefix(SHIFT)]
        elif name in model.parameter_names:
            found = model.parameter_values[model.parameter_index(name)]
        else:
            raise InputError(
                f"expected: unknown quantity {name!r}; use period, energy, action, a physical parameter, or "
                f"{SHIFT}NAME of a relative orbit"
            )
        checks.append(at_most(f"expected_{name}", abs(found - value), tolerance, f"against {value!r}"))
    return checks


class Nearby:
    """Seeded moments and states about a motion, and the accelerations (rates of first order) there in extents.

    What a certificate would otherwise take on trust, that the system is what its description says, is tried on the
    equations themselves: a period declared for the forcing, the absence of time, angles that turn, cyclic coordinates,
    invariants.
    """

    def __init__(self, model: Model, seen: Recomputed) -> None:
        random, period = np.random.default_rng(0), float(seen.times[-1])
        self.model, self.period, self.many = model, period, rates_of(vector_field(accelerations(model)))[0]
        self.times, self.along, self.units = seen.times, seen.states, seen.extents
        self.rows = self.along[random.integers(0, len(self.along), TRIED)]
        if model.constraint is None:  # off the constraints a motion has no meaning
            self.rows = self.rows + 0.1 * self.units * random.normal(size=self.rows.shape)
        self.moments = np.append(0.0, random.uniform(0.0, self.period, TRIED - 1))

    def _accelerations(self, moments: np.ndarray, rows: np.ndarray) -> np.ndarray:
        found = self.many(moments, rows)[:, -self.model.degrees_of_freedom :]
        return np.asarray(found * self.period / self.units[-self.model.degrees_of_freedom :])

    @staticmethod
    def _differ(there: np.ndarray, here: np.ndarray) -> float:
        """Largest relative difference of accelerations, where both are finite."""
        known = np.isfinite(here) & np.isfinite(there)
        size = max(1.0, float(np.abs(here[known]).max(initial=0.0)))
        return float(np.abs(there - here)[known].max(initial=0.0)) / size

    def forced_alike(self, lag: float) -> float:
        """The largest relative difference of the equations along the motion some time later."""
        return self._differ(*(self._accelerations(self.times + by, self.along) for by in (lag, 0.0)))

    def time_dependence(self) -> Check:
        """The equations some and many periods of the forcing later, at equal parts of it; without a forcing, at any
        time."""
        clock, random = self.model.forcing_period, np.random.default_rng(1)
        function = self.model.rates or self.model.acceleration
        if clock is None and not function.jac_sparsity(0, 0).nnz():  # the time is not in the equations
            return at_most("time_dependence", 0.0, EXACT, "equations of motion at other times")
        wait = self.period if clock is None else float(clock(self.model.parameter_values))
        parts = (np.arange(PARTS) + random.uniform(0.0, 1.0, PARTS)) / PARTS * wait
        rows, found = self.along[random.integers(0, len(self.along), PARTS)], 0.0
        here = self._accelerations(parts, rows)
        for k in range(1, LATER + 1):
            by = k * wait if clock else (k - random.uniform(0.0, 0.9, PARTS)) * wait
            found = max(found, self._differ(self._accelerations(parts + by, rows), here))
        note = f"equations of motion at {PARTS} parts of {LATER} later periods{' of the forcing' * (clock is not None)}"
        return at_most("time_dependence", found, EXACT, note)

    def smooth(self) -> Check:
        """The equations do not jump where the motion comes: variations know nothing of what a jump does to them.

        Chords between samples are halved towards their larger difference; a jump at a time of its own, the same
        for all states, is none.
        """
        rates = self._accelerations(self.times, self.along)
        most = np.sort(np.argsort(np.abs(np.diff(rates, axis=0)).max(axis=1))[-STEEPEST:])
        (t, later), (x, there) = ((one[most], one[most + 1]) for one in (self.times, self.along))
        begin, end = rates[most], rates[most + 1]
        for _ in range(HALVINGS):
            moment, between = (t + later) / 2, (x + there) / 2
            middle = self._accelerations(moment, between)
            left = np.abs(middle - begin).max(axis=1) >= np.abs(end - middle).max(axis=1)
            column = left[:, None]
            t, later = np.where(left, t, moment), np.where(left, moment, later)
            x, there = np.where(column, x, between), np.where(column, between, there)
            begin, end = np.where(column, begin, middle), np.where(column, middle, end)
        aside = BESIDE * self.units * np.random.default_rng(2).choice([-1.0, 1.0], self.units.size)
        jumped = np.abs(end - begin).max(axis=1) > JUMP * max(1.0, float(np.abs(begin).max()))
        apart = np.abs(self._accelerations(t, x + aside) - self._accelerations(t, x - aside)).max(axis=1)
        found = float(apart[jumped].max(initial=0.0)) / max(1.0, float(np.abs(begin).max()))
        return at_most("smooth", found, JUMP, "largest jump of the equations along the motion; of.hybrid knows jumps")

    def turned_further(self, turn: np.ndarray) -> float:
        """The largest relative difference of the equations some of a `turn` (d) further."""
        moments, rows = np.append(self.moments, self.times), np.vstack([self.rows, self.along])
        here = self._accelerations(moments, rows)
        return max(self._differ(self._accelerations(moments, rows + k * turn), here) for k in TURNS)

    def shifts(self, along: Mapping[str, float]) -> Iterator[Check]:
        """The equations are the same further along what a relative orbit shifts in, by any amount."""
        known, n = shifts_of(self.model), self.model.degrees_of_freedom
        for name, amount in along.items():
            by = np.random.default_rng(1).uniform(0.1, 1.0, (TRIED, 1)) * (abs(amount) + self.units[:n].max())
            moved = np.hstack([by * known[name].direction, np.zeros((TRIED, self.units.size - n))])
            there = self._accelerations(self.moments, self.rows + moved)
            here = self._accelerations(self.moments, self.rows)
            note = f"equations of motion further along {name}, which {known[name].momentum} is held for"
            yield at_most("cyclic", self._differ(there, here), EXACT, note)

    def invariants(self) -> Iterator[Check]:
        """Each declared invariant is constant along the motion, as far as its value and its arguments are known.

        Across constraints its slope is their force: a bar's length kept to round-off leaves energy that small motions
        do not have.
        """
        for k, one in enumerate(self.model.invariants):
            values = self._constants(one, self.along[:: max(1, len(self.along) // 64)])
            varied = self._constants(one, self.along[:1] + self.units * (self.rows - self.rows.mean(axis=0) + 1e-3))
            varied = varied[np.isfinite(varied)]  # beside the motion there may be none, as of a logarithm
            size = size_of(varied - values[0])
            lost = ROUNDED * float(np.abs([*values, *varied]).max())
            if np.ptp(values) - lost > DRIFT * size:
                slopes = invariant_gradients(self.model)(self.along[0]).full()[k]
                lost += ROUNDED * float(np.abs(slopes) @ np.abs(self.along[0]))
            drift = max(float(np.ptp(values)) - lost, 0.0) / size
            yield at_most(f"invariant_{one.name}", drift, DRIFT, "drift along the motion beyond round-off")

    def _constants(self, one: Invariant, states: np.ndarray) -> np.ndarray:
        """An invariant's values (k) at states (k x 2n)."""
        return self.model.along(one.value, *np.split(states.T, [self.model.degrees_of_freedom])).ravel()


VERIFIERS = {
    "smooth": Verifier(lambda orbit, model: True, _smoothly, _smooth_checks),
    "large": Verifier(
        lambda orbit, model: suits(model, orbit.floquet_multipliers.size) and not any(orbit.winding),
        lambda orbit, model, _: gathered(
            model,
            orbit.state,
            orbit.period,
            not orbit.floquet_multipliers.size and model.degrees_of_freedom > MOST_MODES,
        ),
        _large_checks,
    ),
    "impacts": Verifier(lambda orbit, model: not model.smooth, _through_impacts, _hybrid_checks, "events"),
}
"""Every kind of motion by its name; others may join (`verifier_of` asks them all)"""
