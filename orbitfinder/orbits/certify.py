"""Is it true? What `evidence` recomputed about an orbit, and what its record claims, check by check."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import gcd

import numpy as np
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime.sizes import LEAST, nonzero, relative, size_of
from orbitfinder.errors import ConvergenceError, InputError, IntegrationError
from orbitfinder.integrate.dop853 import rates_of, vector_field
from orbitfinder.integrate.equations import accelerations, invariant_gradients
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.symmetry import NONE, beside, knowing, recognise, shifts_of, symmetries_of, symplectic, turned
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.hybrid import as_recorded
from orbitfinder.mechanics.model import Invariant, Model, counted, energy, wrapped
from orbitfinder.mechanics.scales import extents
from orbitfinder.orbits.between import early_return, overlooked
from orbitfinder.orbits.closure import EPSILON, LARGEST_SCALE, ROUND_OFF, Closure, between, shift, shift_along
from orbitfinder.orbits.control import ControlledEvidence, gather_controlled
from orbitfinder.orbits.evidence import VARIED, Evidence, constraint_defect, gather, native_closure, second_closure
from orbitfinder.orbits.floquet import Floquet
from orbitfinder.orbits.hybrid import (
    HybridEvidence,
    gather_hybrid,
    held,
    off_motion,
    repeats,
    second_gap,
    turned_further,
    unseen,
)
from orbitfinder.orbits.reduction import reduction
from orbitfinder.records.family import FamilyPoint
from orbitfinder.records.orbit import SHIFT, Certificate, Check, Orbit, digest, orbit_to_document

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
MEETING = 1e-4
"""How near to each other mu and 1 / mu are where their sum is known better than they are"""
TRIED = 12
"""States about the motion at which the equations are compared."""
EXACT = 1e-10
"""Relative difference of the accelerations between two moments that should be alike."""
DRIFT = 1e-9
"""Drift of an invariant along the motion, relative to how much it varies about it."""
ROUNDED = 64 * float(np.finfo(float).eps)
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

    closure: float = 1e-12
    distance: float = 1e-9
    second_closure: float = 1e-9
    energy_drift: float = 1e-11
    cover: float = 1e-6
    motion: float = 1e-6
    trivial: float = 1e-8
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
    """An orbit, with the multipliers recomputed here where they are `better` known, and its certificate."""
    whole = _turns(orbit, model)
    turns = turned(model, whole, orbit.shift)
    if not (np.all(np.isfinite(orbit.state)) and np.isfinite(orbit.period) and orbit.period > 0):
        return orbit, Certificate((Check("finite", float("nan"), 0.0, False, "state or period is not a number"),))
    special = _controlled_certificate if orbit.control is not None else _hybrid_certificate
    if orbit.control is not None or model.hybrid is not None:
        return orbit, special(orbit, model, whole, allowed)
    pictured = _pictured(orbit)
    apart = beside(whole, [shifts_of(model)[name].direction for name in orbit.shift])
    moments = np.concatenate([times for _, times, _, _ in pictured])
    try:
        evidence = gather(model, orbit.state, orbit.period, turns, moments)
        second = second_closure(model, orbit.state, orbit.period, turns, evidence.extents)
    except IntegrationError as error:
        return orbit, Certificate((Check("integration", float("inf"), 0.0, False, str(error)),))
    orbit = _better_known(orbit, evidence.floquet) if better else orbit
    found, scale = evidence.closes, min(evidence.closes.amplification, LARGEST_SCALE)
    asked = min(orbit.tolerance, allowed.closure)
    # near a saddle errors grow between any two instants; Phi takes up more than what it is at the end
    passing = ROUND_OFF * EPSILON * min(evidence.growth, LARGEST_GROWTH)
    taken = ROUND_OFF * EPSILON * min(evidence.varied / evidence.norm, LARGEST_SCALE**2)
    kept = max(allowed.trivial, passing, taken)
    near = _Nearby(model, evidence.times, evidence.states, evidence.extents)
    checks = [
        _closure_check(found, asked, f"DOP853 on {evidence.formulation}; "),
        _at_most("distance", found.distance, allowed.distance, "of the true orbit, in extents of the motion"),
        _at_most("second_closure", second, allowed.second_closure * scale, "DOP853 at a second tolerance"),
        _at_most("energy_drift", evidence.drift, allowed.energy_drift + found.gap, "relative to the energy exchanged")
        if model.conservative
        else None,
        _forcing_check(orbit, model),
        *_premises(near, whole, orbit.shift),
        _minimal_period(near, apart, allowed.cover, evidence),
        _resolution(evidence),
        _at_least("not_equilibrium", _extent(evidence.states, model), allowed.motion, _moving(model, orbit)),
        _at_most("trivial_multipliers", evidence.trivial, kept, "flow and gradients are kept")
        if model.invariants or not model.forced
        else None,
        _at_most("symplectic", evidence.symplectic, max(allowed.symplectic, kept), "Phi^T J Phi = J")
        if model.canonical
        else None,
        _at_most(
            "unfolding", orbit.period * max(map(abs, orbit.unfolding), default=0.0), allowed.unfolding + 10 * found.gap,
            "back at 0, per period",
        )
        if model.invariants or any(orbit.unfolding)
        else None,
        *_constraint_checks(orbit, model, allowed, scale, evidence),
        *_record_checks(orbit, evidence, model, replace(allowed, multipliers=max(allowed.multipliers, passing)), scale),
        *_picture_checks(pictured, evidence.reached, evidence),
        *_expected_checks(orbit, model),
    ]  # fmt: skip
    return orbit, Certificate(tuple(check for check in checks if check), scale, evidence.closure)


def _better_known(orbit: Orbit, found: Floquet) -> Orbit:
    """The orbit with multipliers whose pairs are reciprocal ten times better, if they agree to what the worse claim."""
    known = orbit.pair_defect > BADLY and PAIRED * found.pair_defect < orbit.pair_defect
    if not known or not _multiplier_distance(orbit, found) <= orbit.pair_defect:
        return orbit
    return replace(
        orbit, floquet_multipliers=found.multipliers, pair_defect=found.pair_defect, stability=found.stability
    )


def _closure_check(found: Closure, asked: float, note: str = "") -> Check:
    """The gap of the worst part of the state, by its own A."""
    gap, grown = found.worst
    note += f"{gap / (EPSILON * grown):.2g} round-offs grown {grown:.3g} times"
    return _at_most("closure", gap, asked * min(grown, LARGEST_SCALE), note)


def _model_of(orbit: Orbit, model: Model | None) -> Model:
    """The orbit's Model, of a hybrid one without a cycle that with the record's."""
    return as_recorded(model or build_model(orbit.system), orbit.system)


def _hybrid_certificate(orbit: Orbit, model: Model, whole: np.ndarray, allowed: Tolerances) -> Certificate:
    """The certificate of a hybrid orbit: its automaton simulated, all guards watched, from the state alone."""
    assert model.hybrid is not None
    turns = turned(model, whole, orbit.shift)
    try:
        evidence = gather_hybrid(model, orbit.state, orbit.period, turns)
        second = second_gap(model, orbit.state, orbit.period, turns, evidence.extents)
    except (ConvergenceError, IntegrationError) as error:
        return Certificate((Check("events", float("inf"), 0.0, False, str(error)),))
    found, scale = evidence.closes, min(evidence.closes.amplification, LARGEST_SCALE)
    asked, lasted = min(orbit.tolerance, allowed.closure), abs(evidence.period / orbit.period - 1)
    events = ", ".join(str(arc.ended_by) for arc in evidence.arcs)
    reached = np.array([arc.after for arc in evidence.arcs])
    checks = [
        Check("events", 0.0, 0.0, True, f"as simulated by DOP853, all guards watched: {events}"),
        _closure_check(found, asked),
        _at_most("distance", found.distance, allowed.distance, "of the true orbit, in extents of the motion"),
        _at_most("second_closure", second, allowed.second_closure * scale, "DOP853 at a second tolerance"),
        _at_most("recorded_period", lasted, asked * scale, "time of the last event / recorded period - 1"),
        _at_most("energy_drift", evidence.drift, allowed.energy_drift + found.gap, "in arcs without forces"),
        _at_most("energy_balance", evidence.balance, allowed.energy_drift + found.gap, "energy lost in impacts"),
        _cycle_check(evidence, turns, reached, max(allowed.cover, TOLD_APART * found.gap)),
        _at_least("not_equilibrium", _extent(evidence.states, model), allowed.motion, "extent of the motion"),
        _hybrid_resolution(model, evidence),
        _at_least("transversal", evidence.transversal, allowed.transversal, "least rate of a guard, relative"),
        _at_least("decided", evidence.decided, allowed.transversal, "least |allowed| at a crossing, relative")
        if np.isfinite(evidence.decided)
        else None,
        *(_at_least(f"holds: {name}", least, -allowed.holds, "least value along the motion") for name, least in
          held(evidence.arcs)),
        _at_most("trivial_multipliers", evidence.trivial, allowed.trivial, "flow and gradients are kept"),
        _at_most("unfolding", orbit.period * max(map(abs, orbit.unfolding), default=0.0),
                 allowed.unfolding + 10 * found.gap, "back at 0, per period") if any(orbit.unfolding) else None,
        *_hybrid_record_checks(orbit, evidence, model, turns, allowed, scale),
        *_expected_checks(orbit, model),
        *_hybrid_premises(orbit, model, evidence),
        *_hybrid_pictures(orbit, model, evidence),
        *(Check("ignored", 0.0, 0.0, True, text) for text in model.hybrid.ignored),
    ]  # fmt: skip
    return Certificate(tuple(check for check in checks if check), scale, evidence.closure)


def _controlled_certificate(orbit: Orbit, model: Model, turns: np.ndarray, allowed: Tolerances) -> Certificate:
    """The certificate of a controlled orbit: its motion, cost and costate, from state, period and control alone."""
    assert orbit.control is not None
    try:
        found = gather_controlled(
            model, orbit.state, orbit.period, turns, orbit.control, orbit.symmetry, tuple(orbit.shift),
            (orbit.times, orbit.samples) if orbit.samples.size or orbit.times.size else None,
        )  # fmt: skip
    except IntegrationError as error:
        return Certificate((Check("integration", float("inf"), 0.0, False, str(error)),))
    scale = min(found.closes.amplification, LARGEST_SCALE)
    asked, recorded = min(orbit.tolerance, allowed.closure), orbit.control.get("cost", np.nan)
    room = allowed.record + 10 * found.closes.gap
    pair = f"H varies by {found.drift:.2g}; 0 at the optimum over all controls, of any form"
    checks = [
        _closure_check(found.closes, asked, "DOP853, the recorded control; "),
        _at_most("distance", found.closes.distance, allowed.distance, "of the true orbit and control, in extents"),
        _at_most("second_closure", found.second, allowed.second_closure * scale, "DOP853 at a second tolerance"),
        _at_least("not_equilibrium", _extent(found.states, model), allowed.motion, "extent of the motion"),
        _covered(found, turns, max(allowed.cover, TOLD_APART * found.closes.gap)),
        _at_most("resolution", found.unseen[0], RESOLVED,
                 f"change by what lies between steps; looks {found.unseen[1]:.1e} of a segment or less apart"),
        *(_task_check(name, value, allowed) for name, value in found.tasks.items()),
        *(_at_most(f"event: {name}", miss, allowed.distance, "miss of its guard, in periods") for name, miss, _ in
          found.events),
        *(_at_most(f"earlier: {name}", early, 0.0, "crossings of its guard before") for name, _, early in found.events),
        *(_at_least(f"holds: {name}", least, -allowed.holds, "least value along the motion") for name, least in
          found.held),
        _at_most("cost", abs(recorded - found.cost) / found.cost_size, room, RECORDED),
        _at_most("stationarity", found.stationarity, allowed.stationarity,
                 f"the costate, gradients and multipliers' signs; worst: {found.worst}"),
        _at_most("phase_multiplier", found.phase, allowed.stationarity if orbit.control["shape"] == "fourier" else
                 allowed.between, "what fixing the phase costs, relative") if orbit.control["normals"] else None,
        Check("continuous_optimum", found.pointwise, 0.0, True, f"largest |H_u| in instants, relative, and {pair}"),
        Check("optimum", 0.0, 0.0, True, "local: that nothing else costs less is not shown"),
        *_controlled_record_checks(orbit, found, model, allowed, scale),
        *_expected_checks(orbit, model),
    ]  # fmt: skip
    return Certificate(tuple(check for check in checks if check), scale, found.closure)


def _task_check(name: str, value: float, allowed: Tolerances) -> Check:
    """How far a task is violated, relative; what holds always is asked for at points and looked at between them."""
    between = name.endswith((" always", " within limits"))
    note = "largest violation, also between the points at which it was asked for" if between else "violation"
    return _at_most(f"task: {name}", value, allowed.between if between else allowed.distance, note)


def _covered(found: ControlledEvidence, turns: np.ndarray, tolerance: float) -> Check | None:
    """The motion does not come back at all times after a part of its period."""
    if found.events:
        return None
    nodes, away = found.nodes, {}
    for k in range(2, len(nodes) + 1):
        if len(nodes) % k == 0 and not np.any(turns % k):
            moved = np.roll(nodes, -(len(nodes) // k), axis=0)[: len(nodes) - len(nodes) // k]
            part = np.concatenate([2 * np.pi * turns / k, np.zeros(nodes.shape[1] - turns.size)])
            away[k] = float(np.abs((moved - nodes[: len(moved)] - part) / found.extents).max())
    if not away:
        return None
    least = min(away, key=lambda k: away[k])
    return _at_least("minimal_period", away[least], tolerance, f"least distance, after 1/{least} of the period")


def _controlled_record_checks(
    orbit: Orbit, found: ControlledEvidence, model: Model, allowed: Tolerances, scale: float
) -> list[Check]:
    """What the record of a controlled orbit claims against what was recomputed."""
    assert orbit.control is not None
    size, room = float(found.extents.max()), allowed.record + 10 * found.closes.gap
    own, level = {name: list(pair) for name, pair in model.limits.items()}, energy(model, orbit.state)
    far = (
        np.inf if orbit.nodes.shape != found.nodes.shape else np.abs((orbit.nodes - found.nodes) / found.extents).max()
    )
    checks = [
        _at_most("action", relative(orbit.action - found.action, found.action), room, RECORDED),
        _at_most("energy", relative(orbit.energy - level, level), allowed.record, RECORDED)
        if np.isfinite(level) or np.isfinite(orbit.energy)
        else None,
        _at_most("recorded_closure", abs(orbit.closure - found.closure) / size, allowed.closure * scale, RECORDED),
        _at_most("floquet_multipliers", _multiplier_distance(orbit, found.floquet), allowed.multipliers, "relative"),
        _same("stability", orbit.stability, found.floquet.stability),
        _at_most("symmetry", found.symmetry, allowed.distance, f"{orbit.symmetry}: off it, in extents of the motion")
        if orbit.symmetry != NONE.name
        else None,
        _at_most("nodes", far, NODES_OFF * max(scale, 1.0), "off the recomputed motion"),
        _at_most("costate", _costate_off(orbit, found), allowed.stationarity, f"{RECORDED}, with the multipliers"),
        _at_most("limits", 0.0 if not own or own == orbit.control["limits"] else 1.0, 0.0, "those of the system"),
        _at_most("unfolding", orbit.period * max(map(abs, orbit.unfolding)), allowed.unfolding, "back at 0")
        if any(orbit.unfolding)
        else None,
    ]  # fmt: skip
    if orbit.samples.size or orbit.times.size:
        room = min(max(SAMPLES_OFF, 1e-12 * found.closes.amplification), LARGEST_PICTURE)
        checks.append(_at_most("samples", found.off, room, "off the recomputed motion"))
    if orbit.record is not None:
        checks.append(_same("record", orbit.record, digest(orbit_to_document(orbit))))
    return [check for check in checks if check]


def _costate_off(orbit: Orbit, found: ControlledEvidence) -> float:
    """How far the recorded costate and multipliers are from those found again, relative to the cost and the largest."""
    assert orbit.control is not None
    claimed, told = np.array(orbit.control.get("costate", []), float), orbit.control.get("multipliers", {})
    if claimed.shape != found.costate.shape or set(told) != set(found.multipliers):
        return np.inf
    largest = max([found.cost_size, *map(abs, found.multipliers.values())])
    apart = [abs(told[name] - one) / largest for name, one in found.multipliers.items()]
    return float(max([*np.abs((claimed - found.costate) * found.extents) / found.cost_size, *apart]))


def _hybrid_premises(orbit: Orbit, model: Model, evidence: HybridEvidence) -> Iterator[Check]:
    """What turns is an angle, and modes, guards and resets are the same where all has moved on as in some periods."""
    turns, along = np.asarray(orbit.winding), orbit.shift
    names = ", ".join(model.state_names[k] for k in np.flatnonzero(turns))
    for k in np.flatnonzero(turns * ~model.angular):
        note = f"{model.state_names[k]} turns and is not an angle"
        yield Check("winding", float(abs(turns[k])), 0.0, False, note)
    ways = ("winding", turns, names, "turned"), ("cyclic", turned(model, 0 * turns, along), ", ".join(along), "shifted")
    for name, gone, known, how in ways:
        if known:
            by = shift(gone, evidence.extents.size)
            found = max(turned_further(model, evidence.arcs, k * by) for k in TURNS[1:5])
            yield _at_most(name, found, EXACT, f"modes, guards and resets with {known} {how} on")


def _hybrid_resolution(model: Model, evidence: HybridEvidence) -> Check:
    """No feature of the modes' equations, and no crossing of a guard, between two steps of the simulation."""
    found, width, crossed = unseen(model, evidence)
    note = f"change by what lies between steps; looks {width:.1e} of an arc or less apart"
    if crossed:
        found, note = 1.0, f"the guard of {crossed} is crossed where the simulation saw nothing"
    return _at_most("resolution", found, RESOLVED, note)


def _hybrid_pictures(orbit: Orbit, model: Model, evidence: HybridEvidence) -> Iterator[Check]:
    """Nodes and dense samples lie on the motion, as well as errors of the state allow."""
    room = min(max(SAMPLES_OFF, 1e-12 * evidence.closes.amplification), LARGEST_PICTURE)
    zero = orbit.nodes.shape == orbit.state[None].shape
    nodes = float(np.abs((orbit.nodes - orbit.state) / evidence.extents).max()) if zero else np.inf
    yield _at_most("nodes", nodes, NODES_OFF, "the first is the state")
    if orbit.samples.size or orbit.times.size:
        away = off_motion(model, evidence.arcs, orbit.times, orbit.samples, evidence.extents)
        yield _at_most("samples", away, room, "off the recomputed motion")


def _cycle_check(evidence: HybridEvidence, turns: np.ndarray, reached: np.ndarray, tolerance: float) -> Check | None:
    """The recorded cycle is gone through once: no earlier event brings the motion back to its beginning."""
    arcs, units = evidence.arcs, evidence.extents
    names = [arc.ended_by for arc in arcs]
    count = len(names)
    shorter = [k for k in range(1, count) if count % k == 0 and names[:k] * (count // k) == names]
    if not shorter:
        return None
    turned = 2 * np.pi * np.array(shorter)[:, None] / count * turns
    back = reached[np.array(shorter) - 1] - arcs[0].states[0]
    back[:, : turned.shape[1]] -= turned
    far = np.abs(back / units).max(axis=1)
    return _at_least("minimal_cycle", far.min(), tolerance, f"nearest early return after {shorter[int(far.argmin())]}")


def _hybrid_record_checks(
    orbit: Orbit, evidence: HybridEvidence, model: Model, turns: np.ndarray, allowed: Tolerances, scale: float
) -> list[Check]:
    """What the record of a hybrid orbit claims against what was recomputed."""
    found = energy(model, orbit.state)
    energetic = np.isfinite(found) or np.isfinite(orbit.energy)
    level = relative(orbit.energy - found, found) if energetic else None
    checks = _claims(orbit, evidence, allowed, scale, level, nonzero(abs(evidence.action)))
    had = repeats(model, orbit.symmetry, evidence, turns)
    checks.append(_same("symmetry", orbit.symmetry, orbit.symmetry if had else NONE.name))
    if orbit.pair_defect != evidence.floquet.pair_defect:
        off = abs(orbit.pair_defect - evidence.floquet.pair_defect)
        checks.append(_at_most("pair_defect", off, allowed.multipliers, RECORDED))
    if orbit.record is not None:
        checks.append(_same("record", orbit.record, digest(orbit_to_document(orbit))))
    return checks


def _claims(
    orbit: Orbit, evidence: Evidence | HybridEvidence, allowed: Tolerances, scale: float, off: float | None, bulk: float
) -> list[Check]:
    """What a record claims of its motion, its energy, if any, being off by so much; actions are beside `bulk`.

    A family's closure is relative, and by an integration over told durations, or one that stops where it is enough.
    """
    closure, held = abs(orbit.closure - evidence.closure) / float(evidence.extents.max()), allowed.closure
    if isinstance(orbit, FamilyPoint):
        closure, held = abs(orbit.closure - evidence.closes.gap), orbit.tolerance
    room = allowed.record + 10 * evidence.closes.gap
    return [
        *([] if off is None else [_at_most("energy", off, allowed.record, RECORDED)]),
        _at_most("action", abs(orbit.action - evidence.action) / bulk, room, RECORDED),
        _at_most("recorded_closure", closure, min(orbit.tolerance, held) * scale, RECORDED),
        _at_most("floquet_multipliers", _multiplier_distance(orbit, evidence.floquet), allowed.multipliers, "relative"),
        _same("stability", orbit.stability, evidence.floquet.stability),
    ]


def _turns(orbit: Orbit, model: Model) -> np.ndarray:
    """Whole turns (n) of the coordinates. Raises `InputError` where the record contradicts its system."""
    if (orbit.state.size, len(orbit.winding)) != (len(model.state_names), model.degrees_of_freedom):
        sizes = f"{orbit.state.size} numbers and {len(orbit.winding)} turns for {counted(model)}"
        raise InputError(f"state: {sizes}; the record contradicts its system, run the problem again")
    if any(abs(k) > MOST_TURNS for k in orbit.winding):
        raise InputError(f"winding: more than {MOST_TURNS} turns in a period; run the problem again")
    return np.asarray(orbit.winding, int)


def _at_most(name: str, value: float, tolerance: float, note: str = "") -> Check:
    return Check(name, float(value), float(tolerance), bool(value <= tolerance), note)


def _at_least(name: str, value: float, tolerance: float, note: str = "") -> Check:
    return Check(name, float(value), float(tolerance), bool(value >= tolerance), note)


def _constraint_checks(
    orbit: Orbit, model: Model, allowed: Tolerances, scale: float, evidence: Evidence
) -> list[Check]:
    """The state on the constraints and, by IDAS on the native DAE, back where it was after a period."""
    if model.constraint is None:
        return []
    defect = constraint_defect(model, orbit.state, evidence.extents)
    turns = turned(model, np.asarray(orbit.winding), orbit.shift)
    returned = native_closure(model, orbit.state, orbit.period, turns, evidence.extents)
    return [
        _at_most("constraint", defect, allowed.constraint, "largest |phi|, |J v| of the state, relative"),
        _at_most("native_closure", returned, allowed.native_closure * scale, "IDAS on the native DAE"),
    ]


def _moving(model: Model, orbit: Orbit) -> str:
    """The note of what moves."""
    more = "" if orbit.shift else reduction(model, orbit)
    return "extent of the motion" + (f"; a {more}" if more else "")


def _extent(states: np.ndarray, model: Model) -> float:
    """Extent of the coordinates, of angles or of others, relative to their size."""
    n = model.degrees_of_freedom
    places, angular = states[:, :n], model.angular
    groups = [places[:, angular], places[:, ~angular]]
    return max(float(np.ptp(group, axis=0).max() / size_of(group)) for group in groups if group.size)


def _forcing_check(orbit: Orbit, model: Model) -> Check | None:
    """The period of a forced motion is a whole multiple of the forcing's."""
    if model.forcing_period is None:
        return None
    cycles = model.forcing_cycles(orbit.period)
    wanted = cycles * float(model.forcing_period(model.parameter_values))
    return _at_most("forcing_period", abs(orbit.period / wanted - 1), 1e-14, f"period / {cycles} forcing periods - 1")


def _minimal_period(near: _Nearby, apart: np.ndarray, tolerance: float, evidence: Evidence) -> Check | None:
    """The motion, and what forces it, do not come back before the period is over."""
    if gcd(*(int(k) for k in np.rint(apart))) == 1:
        return None
    found, lag = early_return(evidence.trace, apart, near.forced_alike if near.model.forced else None)
    both = " of motion and forcing" if near.model.forced and found < tolerance else ""
    note = "no early return" if lag is None else f"nearest early return{both} after T/{near.period / lag:.6g}"
    return _at_least("minimal_period", found, max(tolerance, TOLD_APART * evidence.closes.gap), note)


def _resolution(evidence: Evidence) -> Check:
    """No feature of the equations between two steps of the integration changes where it ends."""
    try:
        found, width, count = overlooked(evidence.trace)
    except IntegrationError as error:
        return Check("resolution", float("inf"), RESOLVED, False, str(error))
    note = f"change by what lies between steps; {count} looks, each {width:.1e} of the motion or less from the next"
    return _at_most("resolution", found, RESOLVED, note)


Picture = tuple[str, np.ndarray, np.ndarray, float]


def _pictured(orbit: Orbit) -> list[Picture]:
    """What the record shows of the motion: name, times, states, share of the extents that they may be off."""
    found: list[Picture] = []
    size, period = orbit.state.size, orbit.period
    count = len(orbit.nodes)
    if orbit.nodes.shape == (count, size) and count:
        found.append(("nodes", np.arange(count) * (period / count), orbit.nodes, NODES_OFF))
    else:
        found.append(("nodes", np.zeros(1), np.full((1, size), np.nan), NODES_OFF))
    if orbit.samples.size or orbit.times.size:
        times = orbit.times
        sound = orbit.samples.shape == (times.size, size) and times.size > 1 and np.all(np.diff(times) > 0)
        if sound and times[0] == 0.0 and abs(times[-1] / period - 1) <= 1e-12:
            found.append(("samples", np.minimum(times, period), orbit.samples, SAMPLES_OFF))
        else:
            found.append(("samples", np.zeros(1), np.full((1, size), np.nan), SAMPLES_OFF))
    return found


def return_distances(times: np.ndarray, states: np.ndarray, angles: np.ndarray, covers: Sequence[int]) -> list[float]:
    """Distance of x(T/k) from x(0) for each k, angles modulo 2 pi, relative to the motion's extent: a first look.

    States between samples come from a periodic spline of the deviation; the certificate integrates to T/k.
    """
    there = between(times, states, angles.size, times[-1] / np.asarray(covers, float))
    masses = np.ones(angles.size if angles.size < states.shape[1] else 0)
    units = extents(np.ptp(states, axis=0), masses, float(times[-1]), angles)
    return [float(one) for one in np.abs(wrapped(there - states[0], angles) / units).max(axis=1)]


def _picture_checks(pictured: Sequence[Picture], reached: np.ndarray, evidence: Evidence) -> list[Check]:
    """Nodes and dense samples lie on the motion, as well as errors of the state allow."""
    checks, begin = [], 0
    for name, times, states, share in pictured:
        moved = np.abs((reached[begin : begin + len(times)] - states) / evidence.extents).max()
        room = min(max(share, 1e-12 * evidence.growth), LARGEST_PICTURE)
        checks.append(_at_most(name, moved if np.isfinite(moved) else np.inf, room, "off the recomputed motion"))
        begin += len(times)
    return checks


def _record_checks(orbit: Orbit, evidence: Evidence, model: Model, allowed: Tolerances, scale: float) -> list[Check]:
    """What the record claims against what was recomputed; catches a file edited by hand."""
    bulk = max(abs(evidence.action), 1e-3 * evidence.exchanged * orbit.period)
    if model.hamiltonian:  # momenta far from 0 cancel round the loop
        half = orbit.state.size // 2
        bulk = max(bulk, float(np.abs(evidence.states[:, half:]).max(axis=0) @ evidence.extents[:half]))
    energetic = np.isfinite(orbit.energy) or np.isfinite(evidence.energy)
    level = abs(orbit.energy - evidence.energy) / evidence.exchanged if energetic else None
    checks = _claims(orbit, evidence, allowed, scale, level, bulk)
    checks.append(_same_symmetry(orbit, evidence, model))
    # mu and 1/mu of a matrix that takes up a few relative errors of the integration under way: |Phi| times what they
    # grow to
    paired, known = symplectic(model), PAIRED * VARIED.relative_tolerance * evidence.varied * evidence.norm
    pairs = max(allowed.trivial, min(known, LARGEST_DEFECT)) if paired else 0.0
    defect = max(evidence.floquet.pair_defect, abs(orbit.pair_defect))
    if paired or defect:
        checks.append(_at_most("pair_defect", defect, pairs, "reciprocal pairs, as recorded and as found"))
    if orbit.shift:
        ends, turns = (evidence.states[0], evidence.states[-1]), np.asarray(orbit.winding)
        there = shift_along(model, orbit.shift, *ends, turns)
        off = max(abs(there[name] - by) for name, by in orbit.shift.items()) / float(evidence.extents.max())
        held = orbit.tolerance if isinstance(orbit, FamilyPoint) else min(orbit.tolerance, allowed.closure)
        checks.append(_at_most("shift", off, held * scale, "recorded - recomputed, in extents of the motion"))
    if orbit.record is not None:
        checks.append(_same("record", orbit.record, digest(orbit_to_document(orbit))))
    return checks


def _same(name: str, recorded: str, found: str) -> Check:
    note = "as recorded" if recorded == found else f"recorded {recorded[:60]}, found {found[:60]}"
    return Check(name, 0.0 if recorded == found else 1.0, 0.0, recorded == found, note)


def _same_symmetry(orbit: Orbit, evidence: Evidence, model: Model) -> Check:
    """The recorded symmetry is the one found; of what a model declares, a record from before may say nothing.

    A family's point claims the symmetry of its formulation only, and may have more.
    """
    model = knowing(model, orbit.symmetry)
    names = [
        recognise(evidence.times, evidence.states, model, own=own)
        for own in (True, False)[: 1 + bool(model.symmetries)]
    ]
    known = symmetries_of(model)
    if isinstance(orbit, FamilyPoint) and orbit.symmetry in known:
        had = {one for name in names for one in (*known[name].maps, *known[name].both)}
        names += [orbit.symmetry] * (set(known[orbit.symmetry].maps) <= had)
    return _same("symmetry", orbit.symmetry, orbit.symmetry if orbit.symmetry in names else names[0])


def _multiplier_distance(orbit: Orbit, floquet: Floquet) -> float:
    """Largest relative distance between recorded and recomputed multipliers, matched one to one.

    Where mu and 1 / mu meet, at +1 and -1, both are known to the square root of what their sum is known to: there the
    sum is compared, of which mu - 1 / mu is the derivative, relative to `MEETING`.
    """
    recorded, found = orbit.floquet_multipliers, floquet.multipliers
    if recorded.shape != found.shape:
        return float("inf")
    if not found.size:
        return 0.0
    largest = np.abs(found).max()
    apart = np.abs(recorded[:, None] - found[None, :])
    split = np.abs(found - 1.0 / np.where(found == 0, LEAST, found))[None, :]
    distance = apart / np.maximum(1.0, np.abs(found))[None, :] * np.minimum(1.0, (split + apart) / MEETING)
    rows, columns = linear_sum_assignment(np.minimum(distance, 1e6 * max(1.0, largest)))
    return float(distance[rows, columns].max())


def _expected_checks(orbit: Orbit, model: Model) -> list[Check]:
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
        checks.append(_at_most(f"expected_{name}", abs(found - value), tolerance, f"against {value!r}"))
    return checks


def _premises(near: _Nearby, turns: np.ndarray, along: Mapping[str, float]) -> list[Check]:
    """What a certificate would otherwise take on trust: that the system is what its description says.

    A period declared for the forcing, the absence of time, angles that turn, cyclic coordinates and invariants are
    tried on the equations themselves, at seeded states about the motion.
    """
    smooth = [near.smooth()] if near.model.forced else []  # where nothing else tries the variations: no flow is kept
    return [near.time_dependence(), *smooth, *near.windings(turns), *near.shifts(along), *near.invariants()]


class _Nearby:
    """Seeded moments and states about a motion, and the accelerations (rates of first order) there in extents."""

    def __init__(self, model: Model, times: np.ndarray, states: np.ndarray, units: np.ndarray) -> None:
        random = np.random.default_rng(0)
        self.model, self.period, self.many = model, float(times[-1]), rates_of(vector_field(accelerations(model)))[0]
        self.times, self.along, self.units = times, states, units
        self.rows = states[random.integers(0, len(states), TRIED)]
        if model.constraint is None:  # off the constraints a motion has no meaning
            self.rows = self.rows + 0.1 * units * random.normal(size=self.rows.shape)
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
            return _at_most("time_dependence", 0.0, EXACT, "equations of motion at other times")
        wait = self.period if clock is None else float(clock(self.model.parameter_values))
        parts = (np.arange(PARTS) + random.uniform(0.0, 1.0, PARTS)) / PARTS * wait
        rows, found = self.along[random.integers(0, len(self.along), PARTS)], 0.0
        here = self._accelerations(parts, rows)
        for k in range(1, LATER + 1):
            by = k * wait if clock else (k - random.uniform(0.0, 0.9, PARTS)) * wait
            found = max(found, self._differ(self._accelerations(parts + by, rows), here))
        note = f"equations of motion at {PARTS} parts of {LATER} later periods{' of the forcing' * (clock is not None)}"
        return _at_most("time_dependence", found, EXACT, note)

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
        return _at_most("smooth", found, JUMP, "largest jump of the equations along the motion; of.hybrid knows jumps")

    def windings(self, turns: np.ndarray) -> Iterator[Check]:
        """A coordinate that turns is an angle, and the equations are the same where all have turned as they do in some
        periods."""
        for k in np.flatnonzero(turns * ~self.model.angular):
            note = f"{self.model.state_names[k]} turns and is not an angle"
            yield Check("winding", float(abs(turns[k])), 0.0, False, note)
        if not np.any(turns):
            return
        by, moments = shift(turns, self.units.size), np.append(self.moments, self.times)
        rows = np.vstack([self.rows, self.along])
        here = self._accelerations(moments, rows)
        found = max(self._differ(self._accelerations(moments, rows + k * by), here) for k in TURNS)
        names = ", ".join(self.model.state_names[k] for k in np.flatnonzero(turns))
        yield _at_most("winding", found, EXACT, f"equations of motion with {names} {TURNS[0]} to {TURNS[-1]} times on")

    def shifts(self, along: Mapping[str, float]) -> Iterator[Check]:
        """The equations are the same further along what a relative orbit shifts in, by any amount."""
        known, n = shifts_of(self.model), self.model.degrees_of_freedom
        for name, amount in along.items():
            by = np.random.default_rng(1).uniform(0.1, 1.0, (TRIED, 1)) * (abs(amount) + self.units[:n].max())
            moved = np.hstack([by * known[name].direction, np.zeros((TRIED, self.units.size - n))])
            there = self._accelerations(self.moments, self.rows + moved)
            here = self._accelerations(self.moments, self.rows)
            note = f"equations of motion further along {name}, which {known[name].momentum} is held for"
            yield _at_most("cyclic", self._differ(there, here), EXACT, note)

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
            yield _at_most(f"invariant_{one.name}", drift, DRIFT, "drift along the motion beyond round-off")

    def _constants(self, one: Invariant, states: np.ndarray) -> np.ndarray:
        """An invariant's values (k) at states (k x 2n)."""
        return self.model.along(one.value, *np.split(states.T, [self.model.degrees_of_freedom])).ravel()
