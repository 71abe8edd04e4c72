"""Is it true? What `evidence` recomputed about an orbit, and what its record claims, check by check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orbitfinder.errors import InputError, IntegrationError
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model
from orbitfinder.onethread import one_thread
from orbitfinder.periodic.evidence import SAMPLES as SAMPLES
from orbitfinder.periodic.evidence import Evidence as Evidence
from orbitfinder.periodic.evidence import gap as gap
from orbitfinder.periodic.evidence import gather as gather
from orbitfinder.periodic.evidence import is_long as is_long
from orbitfinder.periodic.floquet import Floquet
from orbitfinder.periodic.hamilton import accelerations
from orbitfinder.periodic.orbit import Certificate, Check, Orbit, digest, orbit_to_document
from orbitfinder.periodic.symmetry import recognise
from orbitfinder.reference import SECOND, TIGHTEST, integrate, vector_field

LARGEST_SCALE = 1e6
"""Tolerances grow with the largest multiplier up to this factor; beyond, closure would mean nothing."""
LARGEST_COVER = 30
"""A recorded period is tested for being up to this many times the true one."""


@dataclass(frozen=True)
class Tolerances:
    """What each check allows; closure and its kin are multiplied by the certificate's scale."""

    largest_closure: float = 1e-6
    """whatever tolerance a record asks for, no gap beyond this is a closure"""
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

    The closure is required to be below `orbit.tolerance` times max(1, largest multiplier) (at most
    1e6), which is what double precision can hold. `model` is needed for systems that no file describes.
    """
    allowed = tolerances or Tolerances()
    model = model or build_model(orbit.system)
    turns = np.asarray(orbit.winding, int)
    if (orbit.state.size, turns.size) != (2 * model.degrees_of_freedom, model.degrees_of_freedom):
        sizes = f"{orbit.state.size} numbers and {turns.size} turns for {model.degrees_of_freedom} coordinates"
        raise InputError(f"state: {sizes}; the record contradicts its system, run the problem again")
    if not (np.all(np.isfinite(orbit.state)) and np.isfinite(orbit.period) and orbit.period > 0):
        return Certificate((Check("finite", float("nan"), 0.0, False, "state or period is not a number"),))
    try:
        evidence = gather(model, orbit.state, orbit.period, turns)
        second = _second_closure(model, orbit, turns)
    except IntegrationError as error:
        return Certificate((Check("integration", float("inf"), 0.0, False, str(error)),))
    scale = min(max(1.0, float(np.abs(evidence.floquet.multipliers).max(initial=1.0))), LARGEST_SCALE)
    bound = min(orbit.tolerance, allowed.largest_closure)
    checks = [
        _at_most("closure", evidence.closure, bound * scale, f"DOP853 on {evidence.formulation}"),
        _at_most("second_closure", second, allowed.second_closure * scale, "DOP853 at a second tolerance"),
        _at_most("energy_drift", evidence.drift, allowed.energy_drift * scale, "relative to the energy exchanged")
        if model.conservative
        else None,
        _forcing_check(orbit, model),
        _minimal_period(orbit, evidence, model, allowed.cover),
        _at_least("not_equilibrium", _motion(evidence), allowed.motion, "extent of the motion"),
        _at_most("trivial_multipliers", evidence.trivial, allowed.trivial, "flow and energy gradient are kept")
        if model.invariants or not model.forced
        else None,
        _at_most("symplectic", evidence.symplectic, allowed.symplectic, "Phi^T J Phi = J")
        if model.forces is None
        else None,
        _at_most("unfolding", max(map(abs, orbit.unfolding), default=0.0), allowed.unfolding * scale, "back at 0")
        if model.invariants
        else None,
        *_constraint_checks(orbit, model, allowed, scale),
        *_record_checks(orbit, evidence, model, allowed, scale),
        *_expected_checks(orbit, model),
    ]
    return Certificate(tuple(check for check in checks if check), scale)


def _at_most(name: str, value: float, tolerance: float, note: str = "") -> Check:
    return Check(name, float(value), float(tolerance), bool(value <= tolerance), note)


def _at_least(name: str, value: float, tolerance: float, note: str = "") -> Check:
    return Check(name, float(value), float(tolerance), bool(value >= tolerance), note)


def _second_closure(model: Model, orbit: Orbit, turns: np.ndarray) -> float:
    """Closure of the accelerations themselves at a second tolerance: other equations, other steps."""
    field = vector_field(accelerations(model))
    ends = integrate(field, orbit.state, np.array([0.0, orbit.period]), SECOND)
    return gap(ends[0], ends[-1], turns)


def _constraint_checks(orbit: Orbit, model: Model, allowed: Tolerances, scale: float) -> list[Check]:
    """The state on the constraints and, by IDAS on the native DAE, back where it was after a period."""
    if model.native is None:
        return []
    from orbitfinder.periodic.dae_evidence import constraint_defect, native_closure

    defect = constraint_defect(model, orbit.state)
    returned = native_closure(model, orbit.state, orbit.period, np.asarray(orbit.winding, int))
    return [
        _at_most("constraint", defect, allowed.constraint, "largest |phi|, |J v| of the state"),
        _at_most("native_closure", returned, allowed.native_closure * scale, "IDAS on the native DAE"),
    ]


def _motion(evidence: Evidence) -> float:
    return float(np.ptp(evidence.states, axis=0).max())


def _forcing_check(orbit: Orbit, model: Model) -> Check | None:
    """The period of a forced motion is a whole multiple of the forcing's."""
    if model.forcing_period is None:
        return None
    cycles = model.forcing_cycles(orbit.period)
    wanted = cycles * float(model.forcing_period(model.parameter_values))
    return _at_most("forcing_period", abs(orbit.period / wanted - 1), 1e-14, f"period / {cycles} forcing periods - 1")


def _minimal_period(orbit: Orbit, evidence: Evidence, model: Model, tolerance: float) -> Check | None:
    """The smallest distance between x(T/k) and x(0), k = 2, 3, ..., relative to the motion's extent.

    A forced motion can have a shorter period only where T/k is a multiple of the forcing's.
    """
    cycles = model.forcing_cycles(orbit.period)
    covers = [k for k in range(2, LARGEST_COVER + 1) if cycles % k == 0]
    if not covers:
        return None
    distance, cover = closest_return(evidence.times, evidence.states, np.asarray(model.angles), covers)
    return _at_least("minimal_period", distance, tolerance, f"nearest early return at T/{cover}")


def closest_return(
    times: np.ndarray, states: np.ndarray, angles: np.ndarray, covers: Sequence[int] = range(2, LARGEST_COVER + 1)
) -> tuple[float, int]:
    """Relative distance of x(T/k) from x(0), angles modulo 2 pi, at its smallest over k; and that k."""
    return min(zip(return_distances(times, states, angles, covers), covers, strict=True))


def return_distances(
    times: np.ndarray, states: np.ndarray, angles: np.ndarray, covers: Sequence[int]
) -> list[float]:
    """Distance of x(T/k) from x(0) for each k, angles modulo 2 pi, relative to the motion's extent.

    States between samples come from a periodic spline of the deviation, good to about 1e-9.
    """
    from scipy.interpolate import CubicHermiteSpline

    n = states.shape[1] // 2
    spline = CubicHermiteSpline(times, states[:, :n], states[:, n:])
    extent = np.maximum(np.ptp(states, axis=0).max(), 1e-300)
    moments = times[-1] / np.asarray(covers, float)
    position = spline(moments) - states[0, :n]
    position = np.where(angles, (position + np.pi) % (2 * np.pi) - np.pi, position)
    rate = spline(moments, 1) - states[0, n:]
    return [float(one) for one in np.abs(np.hstack([position, rate])).max(axis=1) / extent]


def _record_checks(
    orbit: Orbit, evidence: Evidence, model: Model, allowed: Tolerances, scale: float
) -> list[Check]:
    """What the record claims against what was recomputed; catches a file edited by hand."""
    size = max(1.0, abs(evidence.energy))
    bulk = max(1.0, abs(evidence.action))
    bound = min(orbit.tolerance, allowed.largest_closure)
    checks = [
        _at_most("energy", abs(orbit.energy - evidence.energy) / size, allowed.record, "recorded - recomputed"),
        _at_most("action", abs(orbit.action - evidence.action) / bulk, allowed.record * scale, "recorded - recomputed"),
        _at_most("recorded_closure", abs(orbit.closure - evidence.closure), bound * scale, "recorded - recomputed"),
        _at_most("floquet_multipliers", _multiplier_distance(orbit, evidence.floquet), allowed.multipliers, "relative"),
        _same("stability", orbit.stability, evidence.floquet.stability),
        _same("symmetry", orbit.symmetry, recognise(evidence.times, evidence.states, np.asarray(model.angles))),
    ]
    if model.conservative:
        defect = evidence.floquet.pair_defect
        # mu and 1/mu of a matrix of norm about mu, known to the integration's relative error: mu^2 of that
        bound = max(allowed.trivial, TIGHTEST.relative_tolerance * scale**2)
        checks.append(_at_most("pair_defect", defect, bound, "reciprocal pairs"))
    if orbit.record is not None:
        checks.append(_same("record", orbit.record, digest(orbit_to_document(orbit))))
    return checks


def _same(name: str, recorded: str, found: str) -> Check:
    note = "as recorded" if recorded == found else f"recorded {recorded[:60]}, found {found[:60]}"
    return Check(name, 0.0 if recorded == found else 1.0, 0.0, recorded == found, note)


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
