"""Is it true? What `evidence` recomputed about an orbit, and what its record claims, check by check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from orbitfinder._runtime.threads import one_thread
from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.integrate.dop853 import SECOND, TIGHTEST, ReferenceSettings, vector_field
from orbitfinder.loops.symmetry import recognise, symmetries_of
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.chain_evidence import chain_motion
from orbitfinder.orbits.closure import EPSILON, LARGEST_SCALE, ROUND_OFF, extents
from orbitfinder.orbits.dae_evidence import constrained_motion, constraint_defect, native_closure
from orbitfinder.orbits.evidence import (
    VARIED,
    Evidence,
    evenly,
    hamiltonian_motion,
    integrate_in,
    is_long,
    measured,
    relative_gap,
)
from orbitfinder.orbits.floquet import Floquet
from orbitfinder.orbits.hamilton import accelerations
from orbitfinder.orbits.premises import premises
from orbitfinder.records.family import FamilyPoint
from orbitfinder.records.orbit import Certificate, Check, Orbit, digest, orbit_to_document

COVERS = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71, 73, 79, 83, 89, 97, 101)
"""A recorded period is tested for being so many times another: of any multiple, one of its prime factors."""

MOST_TURNS = 10**6
"""Whole turns in a period that are still believed"""
NODES_OFF, SAMPLES_OFF, LARGEST_PICTURE = 1e-9, 1e-6, 1e-3
"""Shares of the extents that recorded nodes and samples may be off the motion, and that growing errors may excuse"""
LARGEST_GROWTH = 1e10
"""Growth of errors between any two instants that may excuse the trivial multipliers"""
RECORDED = "recorded - recomputed, relative"


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


@one_thread()
def certify(orbit: Orbit, model: Model | None = None, tolerances: Tolerances | None = None) -> Certificate:
    """The certificate of an orbit, from its state and period alone.

    The gap round the loop, in extents of the motion, is required to be below 1e-12 A (or the record's tolerance
    if that is smaller) with A = max over t of |S^-1 Phi(T, t) S|, what round-off can do, capped at 1e6; and
    the true orbit to be within 1e-9 of the motion (see `closure`). `model` is needed for systems that no file
    describes.
    """
    allowed = tolerances or Tolerances()
    model = model or build_model(orbit.system)
    turns = _turns(orbit, model)
    if not (np.all(np.isfinite(orbit.state)) and np.isfinite(orbit.period) and orbit.period > 0):
        return Certificate((Check("finite", float("nan"), 0.0, False, "state or period is not a number"),))
    cycles, pictured = model.forcing_cycles(orbit.period), _pictured(orbit)
    covers = [k for k in COVERS if cycles % k == 0 and not np.any(turns % k)]
    shares = _shares(covers)
    moments = np.concatenate([orbit.period * shares.ravel(), *(times for _, times, _, _ in pictured)])
    try:
        evidence = gather(model, orbit.state, orbit.period, turns, moments)
        second = _second_closure(model, orbit, turns, evidence)
    except IntegrationError as error:
        return Certificate((Check("integration", float("inf"), 0.0, False, str(error)),))
    found, scale = evidence.closes, min(evidence.closes.amplification, LARGEST_SCALE)
    bound = min(orbit.tolerance, allowed.closure) * scale
    # near a saddle errors grow between any two instants, and the variations with them
    passing = ROUND_OFF * EPSILON * min(evidence.growth, LARGEST_GROWTH)
    forms = f"DOP853 on {evidence.formulation}; {found.gap / (EPSILON * found.amplification):.2g} round-offs"
    checks = [
        _at_most("closure", found.gap, bound, f"{forms} grown {found.amplification:.3g} times"),
        _at_most("distance", found.distance, allowed.distance, "of the true orbit, in extents of the motion"),
        _at_most("second_closure", second, allowed.second_closure * scale, "DOP853 at a second tolerance"),
        _at_most("energy_drift", evidence.drift, allowed.energy_drift + found.gap, "relative to the energy exchanged")
        if model.conservative
        else None,
        _forcing_check(orbit, model),
        *premises(model, evidence.times, evidence.states, evidence.extents, turns),
        _minimal_period(orbit, covers, allowed.cover, evidence),
        _at_least("not_equilibrium", _motion(evidence, model), allowed.motion, "extent of the motion"),
        _at_most("trivial_multipliers", evidence.trivial, max(allowed.trivial, passing), "flow and gradients are kept")
        if model.invariants or not model.forced
        else None,
        _at_most("symplectic", evidence.symplectic, allowed.symplectic, "Phi^T J Phi = J")
        if model.forces is None
        else None,
        _at_most(
            "unfolding", orbit.period * max(map(abs, orbit.unfolding), default=0.0), allowed.unfolding + 10 * found.gap,
            "back at 0, per period",
        )
        if model.invariants or any(orbit.unfolding)
        else None,
        *_constraint_checks(orbit, model, allowed, scale, evidence),
        *_record_checks(orbit, evidence, model, allowed, scale),
        *_picture_checks(pictured, evidence.reached[shares.size :], evidence),
        *_expected_checks(orbit, model),
    ]  # fmt: skip
    return Certificate(tuple(check for check in checks if check), scale, evidence.closure)


def certified(orbit: Orbit, model: Model) -> Orbit:
    """The orbit with its certificate and the closure found there."""
    certificate = certify(orbit, model)
    closure = certificate.closure if np.isfinite(certificate.closure) else orbit.closure
    return replace(orbit, certificate=certificate, closure=closure)


def gather(
    model: Model,
    state: np.ndarray,
    period: float,
    turns: np.ndarray,
    moments: np.ndarray | None = None,
    settings: ReferenceSettings = TIGHTEST,
) -> Evidence:
    """The `Evidence` of a state (2n) and a period (s), the motion's states at further `moments` with it."""
    formulation = hamiltonian_motion
    if model.constraint is not None:
        formulation = constrained_motion
    elif is_long(model):
        formulation = chain_motion
    wanted = np.zeros(0) if moments is None else np.asarray(moments, float)
    motion = formulation(model, state, period, turns, np.unique(np.append(evenly(period), wanted)), settings)
    return measured(model, motion, state, period, turns, wanted)


def _turns(orbit: Orbit, model: Model) -> np.ndarray:
    """Whole turns (n) of the coordinates. Raises `InputError` where the record contradicts its system."""
    n = model.degrees_of_freedom
    if (orbit.state.size, len(orbit.winding)) != (2 * n, n):
        sizes = f"{orbit.state.size} numbers and {len(orbit.winding)} turns for {n} coordinates"
        raise InputError(f"state: {sizes}; the record contradicts its system, run the problem again")
    if any(abs(k) > MOST_TURNS for k in orbit.winding):
        raise InputError(f"winding: more than {MOST_TURNS} turns in a period; run the problem again")
    return np.asarray(orbit.winding, int)


def _at_most(name: str, value: float, tolerance: float, note: str = "") -> Check:
    return Check(name, float(value), float(tolerance), bool(value <= tolerance), note)


def _at_least(name: str, value: float, tolerance: float, note: str = "") -> Check:
    return Check(name, float(value), float(tolerance), bool(value >= tolerance), note)


def _second_closure(model: Model, orbit: Orbit, turns: np.ndarray, evidence: Evidence) -> float:
    """Closure of the accelerations themselves at a second tolerance: other equations, other steps."""
    field, span = vector_field(accelerations(model)), np.array([0.0, orbit.period])
    ends = integrate_in(evidence.extents, field, orbit.state, span, SECOND)
    return relative_gap(ends[0], ends[-1], turns, evidence.extents)


def _constraint_checks(
    orbit: Orbit, model: Model, allowed: Tolerances, scale: float, evidence: Evidence
) -> list[Check]:
    """The state on the constraints and, by IDAS on the native DAE, back where it was after a period."""
    if model.constraint is None:
        return []
    defect = constraint_defect(model, orbit.state, evidence.extents)
    turns = np.asarray(orbit.winding, int)
    returned = native_closure(model, orbit.state, orbit.period, turns, evidence.extents)
    return [
        _at_most("constraint", defect, allowed.constraint, "largest |phi|, |J v| of the state, relative"),
        _at_most("native_closure", returned, allowed.native_closure * scale, "IDAS on the native DAE"),
    ]


def _motion(evidence: Evidence, model: Model) -> float:
    """Extent of the coordinates, of angles or of others, relative to their size."""
    n = model.degrees_of_freedom
    places, angular = evidence.states[:, :n], np.asarray(model.angles or (False,) * n)
    groups = [places[:, angular], places[:, ~angular]]
    return max(float(np.ptp(group, axis=0).max() / max(np.abs(group).max(), 1e-300)) for group in groups if group.size)


def _forcing_check(orbit: Orbit, model: Model) -> Check | None:
    """The period of a forced motion is a whole multiple of the forcing's."""
    if model.forcing_period is None:
        return None
    cycles = model.forcing_cycles(orbit.period)
    wanted = cycles * float(model.forcing_period(model.parameter_values))
    return _at_most("forcing_period", abs(orbit.period / wanted - 1), 1e-14, f"period / {cycles} forcing periods - 1")


def _shares(covers: Sequence[int]) -> np.ndarray:
    """Shares of the period (covers x 2) at which a motion that goes round k times is back: 1/k and about a half."""
    return np.array([[1 / k, (k // 2) / k] for k in covers]).reshape(-1, 2)


def _minimal_period(orbit: Orbit, covers: Sequence[int], tolerance: float, evidence: Evidence) -> Check | None:
    """The smallest distance between x(T/k), x(j T/k) and x(0), k prime, in extents of the motion.

    Both: a motion that lingers where it starts is near x(0) after T/k without having been anywhere. Shorter
    periods are possible only where the turns, and the periods of a forcing, can be divided by k.
    """
    if not covers:
        return None
    shares = _shares(covers).ravel()
    turned = 2 * np.pi * shares[:, None] * np.asarray(orbit.winding)
    shift = np.hstack([turned, np.zeros(turned.shape)])
    far = np.abs((evidence.reached[: shares.size] - shift - orbit.state) / evidence.extents).max(axis=1)
    found = far.reshape(-1, 2).max(axis=1)
    note = f"nearest early return at T/{covers[int(found.argmin())]}"
    return _at_least("minimal_period", found.min(), tolerance, note)


def distances(state: np.ndarray, reached: np.ndarray, angles: Sequence[bool], units: np.ndarray) -> np.ndarray:
    """Distance of each of the states reached (k x 2n) from a state, in `units`, angles modulo 2 pi."""
    moved = reached - state
    turning = np.append(np.asarray(angles or (False,) * (state.size // 2)), np.zeros(state.size // 2, bool))
    moved = np.where(turning, (moved + np.pi) % (2 * np.pi) - np.pi, moved)
    return np.asarray(np.abs(moved / units).max(axis=1))


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
    from scipy.interpolate import CubicHermiteSpline

    n = states.shape[1] // 2
    spline = CubicHermiteSpline(times, states[:, :n], states[:, n:])
    moments = times[-1] / np.asarray(covers, float)
    there = np.hstack([spline(moments), spline(moments, 1)])
    moved, rushed = np.split(np.ptp(states, axis=0), 2)
    units = np.concatenate(extents(moved, rushed, np.ones(n), float(times[-1])))
    return [float(one) for one in distances(states[0], there, tuple(angles), units)]


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
    closure = abs(orbit.closure - evidence.closure) / float(evidence.extents.max())
    held = min(orbit.tolerance, allowed.closure)
    if isinstance(orbit, FamilyPoint):  # its closure is relative, and by an integration that stops where it is enough
        closure, held = abs(orbit.closure - evidence.closes.gap), orbit.tolerance
    room = allowed.record + 10 * evidence.closes.gap
    checks = [
        _at_most("energy", abs(orbit.energy - evidence.energy) / evidence.exchanged, allowed.record, RECORDED),
        _at_most("action", abs(orbit.action - evidence.action) / bulk, room, RECORDED),
        _at_most("recorded_closure", closure, held * scale, RECORDED),
        _at_most("floquet_multipliers", _multiplier_distance(orbit, evidence.floquet), allowed.multipliers, "relative"),
        _same("stability", orbit.stability, evidence.floquet.stability),
        _same_symmetry(orbit, evidence, model),
    ]
    # mu and 1/mu of a matrix of norm about mu, known to the integration's relative error: mu^2 of that
    pairs = max(allowed.trivial, VARIED.relative_tolerance * scale**2) if model.conservative else 0.0
    defect = max(evidence.floquet.pair_defect, abs(orbit.pair_defect))
    if model.conservative or defect:
        checks.append(_at_most("pair_defect", defect, pairs, "reciprocal pairs, as recorded and as found"))
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
    """Largest relative distance between recorded and recomputed multipliers, matched one to one."""
    from scipy.optimize import linear_sum_assignment

    recorded, found = orbit.floquet_multipliers, floquet.multipliers
    if recorded.shape != found.shape:
        return float("inf")
    if not found.size:
        return 0.0
    largest = np.abs(found).max()
    # a double pair at +-1 is the square root of the monodromy's error away from where it should be
    distance = np.abs(recorded[:, None] - found[None, :]) / np.maximum(1.0, np.abs(found))[None, :]
    rows, columns = linear_sum_assignment(np.minimum(distance, 1e6 * max(1.0, largest)))
    return float(distance[rows, columns].max())


def _expected_checks(orbit: Orbit, model: Model) -> list[Check]:
    """Numbers known from elsewhere: of the orbit, or of physical parameters that were free."""
    checks = []
    for name, (value, tolerance) in orbit.expected.items():
        if name in ("period", "energy", "action"):
            found = getattr(orbit, name)
        elif name in model.parameter_names:
            found = model.parameter_values[model.parameter_index(name)]
        else:
            raise InputError(f"expected: unknown quantity {name!r}; use period, energy, action or a physical parameter")
        checks.append(_at_most(f"expected_{name}", abs(found - value), tolerance, f"against {value!r}"))
    return checks
