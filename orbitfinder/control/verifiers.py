"""Is a controlled orbit one? Its motion, cost and costate again, for the table of verifiers that `certify` asks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from orbitfinder._runtime.sizes import size_of
from orbitfinder.control.find import ControlledEvidence, controlled_samples, gather_controlled
from orbitfinder.loops.symmetry import NONE
from orbitfinder.mechanics.model import Model, altered
from orbitfinder.orbits.certify import (
    NODES_OFF,
    RECORDED,
    SAMPLES_OFF,
    VERIFIERS,
    Nearby,
    Trial,
    Verifier,
    between_steps,
    expected_checks,
    forcing_check,
    holding,
)
from orbitfinder.records.certificate import Check, at_most
from orbitfinder.records.orbit import Orbit


def _gathered(orbit: Orbit, model: Model, turns: np.ndarray) -> tuple[ControlledEvidence, float]:
    assert orbit.control is not None
    shown = (orbit.times, orbit.samples) if orbit.samples.size or orbit.times.size else None
    driven = gather_controlled(
        model, orbit.state, orbit.period, turns, orbit.control, orbit.symmetry, tuple(orbit.shift), shown
    )
    return driven, driven.second


def _checks(trial: Trial) -> Iterator[Check | None]:
    """The checks of a controlled orbit: its motion, cost and costate, from state, period and control alone."""
    seen: ControlledEvidence = trial.seen
    orbit, model, allowed, fit = trial.orbit, trial.model, trial.allowed, seen.fit
    assert orbit.control is not None
    yield from trial.closing("DOP853, the recorded control; ", "orbit and control, in extents")
    if model.forced:
        # at controls within the recorded ones: at 0 a forcing may have no part in the equations
        values, coefficients = model.parameter_values.copy(), np.array(orbit.control["coefficients"], float)
        places = [model.parameter_index(name) for name in orbit.control["names"]]
        values[places] = coefficients.min(axis=1) + 0.618 * np.ptp(coefficients, axis=1)
        near = Nearby(altered(model, parameter_values=values), seen)
        yield from (forcing_check(orbit, model), near.time_dependence(), near.smooth())
    yield trial.moving()
    yield _covered(trial, seen)
    yield between_steps(*seen.unseen, "a segment")
    for name, value in fit.violations.items():
        # what holds always is asked for at points and looked at between them
        between = name.endswith((" always", " within limits"))
        note = "largest violation, also between the points at which it was asked for" if between else "violation"
        yield at_most(f"task: {name}", value, allowed.between if between else allowed.distance, note)
    for name, miss, _ in seen.events:
        wrong = "" if np.isfinite(miss) else "; it is crossed the other way than its direction says, or not allowed"
        yield at_most(f"event: {name}", miss, allowed.distance, f"miss of its guard, in periods{wrong}")
    for name, _, early in seen.events:
        yield at_most(f"earlier: {name}", early, 0.0, "crossings of its guard before")
    yield from holding(seen.held, allowed)
    yield at_most("cost", abs(orbit.control.get("cost", np.nan) - fit.cost) / fit.size, trial.room, RECORDED)
    varies = "" if model.forced else f", and H varies by {fit.drift:.2g}"
    yield at_most(
        "stationarity", fit.left, allowed.stationarity,
        f"the costate, gradients and multipliers' signs; worst: {fit.worst}; of controls of any form: |H_u| up to "
        f"{fit.pointwise:.2g} in instants, relative{varies}; local: that nothing else costs less is not shown",
    )  # fmt: skip
    if orbit.control["normals"]:
        room = allowed.stationarity if orbit.control["shape"] == "fourier" else allowed.between
        yield at_most("phase_multiplier", fit.phase, room, "what fixing the phase costs, relative")
    yield trial.number("action", size_of(seen.action), trial.room)
    yield trial.energy(size_of(seen.energy))
    yield from trial.linear(allowed.multipliers)
    if orbit.symmetry != NONE.name:
        note = f"{orbit.symmetry}: off it, in extents of the motion"
        yield at_most("symmetry", seen.symmetry, allowed.distance, note)
    alike = orbit.nodes.shape == seen.nodes.shape
    nodes = np.abs((orbit.nodes - seen.nodes) / seen.extents).max() if alike else np.inf
    yield at_most("nodes", nodes, NODES_OFF * max(trial.scale, 1.0), "off the recomputed motion")
    yield at_most("costate", _costate_off(orbit, seen), allowed.stationarity, f"{RECORDED}, with the multipliers")
    own = {name: list(pair) for name, pair in model.limits.items()}
    yield at_most("limits", bool(own) and own != orbit.control["limits"], 0.0, "those of the system")
    yield trial.unfolding(0.0, "back at 0")
    if orbit.samples.size or orbit.times.size:
        yield trial.shown("samples", seen.off, SAMPLES_OFF, seen.closes.amplification)
    yield trial.record()
    yield from expected_checks(orbit, model)


def _covered(trial: Trial, seen: ControlledEvidence) -> Check | None:
    """The motion does not come back at all times after a part of its period."""
    nodes, turns, away = seen.nodes, trial.turns, {}
    for k in range(2, 1 if seen.events else len(nodes) + 1):
        if len(nodes) % k == 0 and not np.any(turns % k):
            moved = np.roll(nodes, -(len(nodes) // k), axis=0)[: len(nodes) - len(nodes) // k]
            part = np.concatenate([2 * np.pi * turns / k, np.zeros(nodes.shape[1] - turns.size)])
            away[k] = float(np.abs((moved - nodes[: len(moved)] - part) / seen.extents).max())
    if not away:
        return None
    least = min(away, key=lambda k: away[k])
    return trial.apart("minimal_period", away[least], f"least distance, after 1/{least} of the period")


def _costate_off(orbit: Orbit, seen: ControlledEvidence) -> float:
    """How far the recorded costate and multipliers are from those found again, relative to the cost and the largest."""
    assert orbit.control is not None
    fit = seen.fit
    claimed, multipliers = np.array(orbit.control.get("costate", []), float), orbit.control.get("multipliers", {})
    if claimed.shape != fit.costate.shape or set(multipliers) != set(fit.multipliers):
        return np.inf
    largest = max([fit.size, *map(abs, fit.multipliers.values())])
    apart = [abs(multipliers[name] - value) / largest for name, value in fit.multipliers.items()]
    return float(max([*np.abs((claimed - fit.costate) * seen.extents) / fit.size, *apart]))


VERIFIERS["controlled"] = Verifier(
    lambda orbit, model: orbit.control is not None, _gathered, _checks, shown=controlled_samples
)
