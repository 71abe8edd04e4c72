"""Feedback that makes an unstable orbit real: gains by the periodic Riccati equation, and what says that they hold it.

    u = u*(tau) - K(tau) (x - x*(tau)),    K = R^-1 B^T P,    tau: where the orbit is nearest to x, or the clock

P is that of deviations across the flow (`orbits.transverse`), so that a controller without a clock lets the motion
choose its phase and holds everything else, the energy too. What is claimed is measured by something else: the
multipliers of the nonlinear closed loop, integrated with its variations from the controller's own numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import casadi as ca
import numpy as np
from scipy.linalg import eig
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime import __version__
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.control.basin import disturbed
from orbitfinder.control.controller import Controller
from orbitfinder.control.export import law_of
from orbitfinder.control.riccati import periodic
from orbitfinder.control.strikes import left
from orbitfinder.control.transverse import EFFORT, STEPS, Reference, authority
from orbitfinder.errors import InputError, closest
from orbitfinder.integrate.march import March, uniform
from orbitfinder.mechanics.controls import TORQUE, Limits, checked_limits
from orbitfinder.mechanics.kind import build_model, system_kind
from orbitfinder.mechanics.model import Model, vector_field
from orbitfinder.mechanics.scales import extents_of
from orbitfinder.orbits.closure import shift
from orbitfinder.orbits.measure import versions
from orbitfinder.records.certificate import Certificate, Check, at_most
from orbitfinder.records.orbit import Orbit

LEAST_NODES = 256


@dataclass(frozen=True)
class Required:
    """What is asked of a controller before it is called one."""

    interpolated: float = 1e-5
    """relative error of the spline through every other node, that through all has a 64th; or 4096 nodes"""
    margin: float = 1e-6
    """how far inside the unit circle the multipliers are"""
    alike: float = 1e-8
    """difference of well-conditioned multipliers between linear design and nonlinear closed loop"""
    closed: float = 1e-8
    """gap, in extents, between what it takes for the orbit and the motion of its model from node to node"""
    kick: float = 0.01
    """size, in extents, of disturbances that the simulation of a hybrid closed loop brings back"""
    kicks: int = 2
    recorded: float = 1e-6
    """difference of recorded multipliers of the closed loop from those computed again"""


REQUIRED = Required()

Weight = float | Sequence[float] | Sequence[Sequence[float]] | np.ndarray | None


def stabilise(
    orbit: Orbit,
    actuators: Sequence[str] | None = None,
    Q: Weight = None,
    R: Weight = None,
    *,
    limits: Limits | float | None = None,
    clock: bool | None = None,
    model: Model | None = None,
) -> Controller:
    """A certified Controller that holds a motion on an orbit by motors at joints.

    Gains come from the periodic Riccati equation across the flow; the certificate integrates the nonlinear closed
    loop. The cost is the integral of dy.Q dy + w.R w, dy deviations in extents of the orbit and w controls in what
    would move the state by that in a radian of the period.

    Args:
        orbit: to be held.
        actuators: parameters of its Model; None: the Model's controls, or of a chain or linkage without motors the
            one joint whose motor has most authority.
        Q: a number, a diagonal or a matrix; 1 unless said.
        R: the same of the controls.
        limits: greatest magnitude of all controls, or of each, or lowest and highest, by name.
        clock: whether the controller keeps time too (always for forced systems).
        model: needed only for systems that no file describes.

    Returns:
        A Controller.

    Raises:
        InputError: also for what the actuators cannot hold, with the reason.
        ConvergenceError: where the Riccati equation has no periodic solution.

    Examples:
        >>> held = of.stabilise(swing, ["torque1"])
        >>> held.stabilised, held.actuators
        (True, ('torque1',))

    See Also:
        `of.basin` measures from how far it comes back, `of.export_controller` writes it in C and Python.
    """
    plant = _plant(orbit, model, actuators)
    forced = plant.candidates.forced
    if forced and clock is False:
        raise InputError("clock: False for a forced system, whose phase is the time; leave clock out")
    trial = reference_of(orbit, plant.candidates, plant.names, forced or bool(clock))
    powers = {name: authority(trial.reach([name]), trial.period)[0] for name in trial.names}
    chosen = plant.chosen or (max(powers, key=lambda name: powers[name]),)
    _check_authority(trial, chosen, powers)
    driven = plant.candidates
    if plant.added:  # with the motors of these names alone
        joints = [int(name.removeprefix(TORQUE)) for name in chosen]
        driven = build_model({**orbit.system, "motors": joints})
    given = dict.fromkeys(chosen, limits) if isinstance(limits, (int, float)) else limits or {}
    bounds = {name: driven.limits[name] for name in chosen if name in driven.limits} | checked_limits(given, chosen)
    weights = _weight("Q", Q, trial.units.size), _weight("R", R, len(chosen))
    count = LEAST_NODES
    while True:  # so many nodes that a spline through half of them meets the others
        made = _regulated(orbit, reference_of(orbit, driven, chosen, trial.clock, count, trial), *weights)
        if _interpolates(made) or 2 * count > 4096:
            break
        count *= 2
    made = replace(made, limits=bounds, authority=powers)
    for name, (low, high) in bounds.items():
        own = made.inputs[:, made.actuators.index(name)]
        if np.any((own <= low) | (own >= high)):
            raise InputError(
                f"limits.{name}: the orbit itself takes {own.min():.6g} to {own.max():.6g}, which leaves nothing to "
                f"correct within {low:.6g} and {high:.6g}; widen them"
            )
    return verified(made, driven)


@dataclass(frozen=True)
class _Plant:
    """The Model with everything that might act, by `names`; what shall act, () where the best is to be found."""

    candidates: Model
    names: tuple[str, ...]
    chosen: tuple[str, ...]
    added: bool
    """True where the motors are not the orbit's own"""


def _plant(orbit: Orbit, model: Model | None, actuators: Sequence[str] | None) -> _Plant:
    """What may act on the motion; `InputError` for orbits that are not held yet, and for what does not act."""
    own = model or build_model(orbit.system)
    if len(own.cycle) > 1:
        raise InputError(
            f"{orbit.name}: {len(own.cycle)} events in a period ({', '.join(own.cycle)}); feedback is for motions with "
            "at most 1 so far, as a walker's step; give such an orbit"
        )
    if getattr(orbit, "control", None):
        raise InputError(
            f"{orbit.name}: a controlled motion, whose control changes along it; feedback is for motions without so far"
        )
    if orbit.shift:
        moved = ", ".join(orbit.shift)
        raise InputError(
            f"{orbit.name}: a relative orbit, which does not come back in {moved}; stabilise one that closes"
        )
    if isinstance(actuators, str):
        raise InputError(f"actuators: must be a list of names, got {actuators!r}; give [{actuators!r}]")
    wanted, able = tuple(actuators or ()), own
    if not own.controls and (joints := system_kind(orbit.system).joints(own.system)):
        able = build_model({**orbit.system, "motors": list(range(1, joints + 1))})
    for name in wanted:
        if name not in able.parameter_names or wanted.count(name) > 1:
            known = able.controls or able.parameter_names
            raise InputError(
                f"actuators: {name!r} is none of the parameters, or is named twice{closest(name, known)}; this system "
                f"has {', '.join(known[:12])}"
            )
    names = tuple(dict.fromkeys([*able.controls, *wanted]))
    if not names:
        raise InputError(
            "actuators: nothing acts on this system; name a parameter that may vary in time (actuators=['force']), or "
            "give the Model controls"
        )
    return _Plant(able, names, wanted or own.controls, able is not own)


def reference_of(
    orbit: Orbit,
    model: Model,
    names: Sequence[str],
    clock: bool,
    least: int = LEAST_NODES,
    like: Reference | None = None,
) -> Reference:
    """The orbit at `least` or more equal times over its period, an even number, each from the nearest recorded state;
    measured in units of its own, or of a former one."""
    smooth, times, base = model.smooth, orbit.times, orbit.nodes
    if smooth and len(orbit.samples) > 2 and np.allclose(np.diff(times), times[-1] / (times.size - 1), 1e-6, 0.0):
        base = orbit.samples[:-1]
    steps = -(-least // len(base))
    steps += steps * len(base) % 2
    field = vector_field(model, ())
    march = March(field, model.forced, effort=EFFORT)
    states = march.states(base, uniform(1.0, len(base), steps), np.array([orbit.period]))
    states[::steps] = [*base, base[0] + shift(orbit.winding, base.shape[1]) if smooth else states[-1]]
    units = extents_of(model, states, orbit.period) if like is None else like.units
    return Reference(model, tuple(names), orbit.period, states, units, clock)


def _check_authority(reference: Reference, chosen: Sequence[str], powers: Mapping[str, float]) -> None:
    """`InputError` where the chosen actuators do not reach a deviation that does not decay, naming what does."""
    together, multiplier = authority(reference.reach(chosen), reference.period)
    if together > 0:
        return
    able = [name for name, power in powers.items() if power > 0]
    remedy = f"{' and '.join(able)} can, each alone" if able else "none of this system can alone; give several"
    raise InputError(
        f"actuators: {' and '.join(chosen)} cannot hold this orbit: the deviation of multiplier {_number(multiplier)} "
        f"is out of reach (controllability Gramian over a period); {remedy}"
    )


def _number(value: complex) -> str:
    return f"{value.real:.6g}" if abs(value.imag) < 1e-9 else f"{value.real:.6g}{value.imag:+.6g}i"


def _weight(name: str, given: Weight, size: int) -> np.ndarray:
    """A symmetric weight (size x size) from a number, a diagonal or a matrix; R must be positive, Q not negative."""
    weight = np.asarray(1.0 if given is None else given, float)
    matrix = weight * np.eye(size) if weight.ndim == 0 else np.diag(weight) if weight.ndim == 1 else weight
    good = matrix.shape == (size, size) and np.all(np.isfinite(matrix)) and np.allclose(matrix, matrix.T)
    least = float(np.linalg.eigvalsh(matrix).min()) if good else -1.0
    if not good or least < 0 or (name == "R" and least <= 0):
        wanted = "positive definite" if name == "R" else "symmetric and not negative"
        raise InputError(
            f"{name}: must be a number, {size} numbers or a {size} x {size} matrix, {wanted}; got {given!r}"
        )
    return (matrix + matrix.T) / 2


def _regulated(orbit: Orbit, reference: Reference, weight: np.ndarray, ease: np.ndarray) -> Controller:
    """K = R^-1 B^T E P E^T at every node, in the model's units."""
    inverse, units = np.linalg.inv(ease), reference.control_units
    regulator = periodic(reference.pieces(weight, inverse))
    by_control = np.take(reference.slopes[1], range(len(reference.states)), axis=0, mode="wrap") * units
    lifted = reference.bases @ regulator.solutions[: len(by_control)] @ reference.bases.transpose(0, 2, 1)
    gains = units[:, None] * (inverse @ by_control.transpose(0, 2, 1) @ lifted) / reference.units
    if reference.model.smooth:
        gains[-1] = gains[0]
    count, angles = len(gains), np.zeros(reference.units.size)
    angles[: reference.model.angular.size] = reference.model.angular
    return Controller(
        name=orbit.name, system=reference.model.system, actuators=reference.names, period=reference.period,
        clock=reference.clock, units=reference.units, angles=angles, states=reference.states,
        inputs=np.tile(reference.inputs, (count, 1)), gains=gains.reshape(count, -1), limits={},
        weight_state=weight, weight_control=ease, control_units=units,
        open_loop=_sorted(np.linalg.eigvals(reference.reach().transition)),
        predicted=_sorted(np.linalg.eigvals(regulator.monodromy)), multipliers=np.zeros(0, complex), authority={},
        provenance={
            "orbitfinder": __version__, **versions(),
            "orbit": {"name": orbit.name, "period": orbit.period, "record": orbit.record},
        }, event="".join(reference.model.cycle), title=orbit.title,
    )  # fmt: skip


def _sorted(multipliers: np.ndarray) -> np.ndarray:
    return np.asarray(
        sorted(multipliers.astype(complex), key=lambda multiplier: (-abs(multiplier), multiplier.imag)), complex
    )


def _interpolates(controller: Controller) -> bool:
    """True when the spline through every other node meets the nodes between."""
    thin = replace(controller, **{name: getattr(controller, name)[::2] for name in ("states", "inputs", "gains")})
    odd = np.arange(1, len(controller.states), 2)
    values = law_of(thin).at(odd * (controller.period / (len(controller.states) - 1)))
    rows = np.hstack([controller.states, controller.inputs, controller.gains])
    sizes = np.concatenate(
        [controller.units, controller.control_units, np.tile(controller.units, len(controller.actuators))]
    )
    d, m = controller.units.size, len(controller.actuators)
    errors = np.abs(values - rows[odd])
    gains = controller.gains.reshape(len(rows), m, d) * controller.units
    tallest = np.repeat(np.abs(gains).max(axis=(0, 2)), d)
    errors[:, : d + m] /= sizes[: d + m]
    errors[:, d + m :] *= sizes[d + m :] / nonzero(tallest)
    return bool(errors.max() <= REQUIRED.interpolated)


def verified(controller: Controller, model: Model | None = None) -> Controller:
    """The controller with the multipliers of its nonlinear closed loop, and the certificate that they decide.

    They come from the controller's tables and the Model alone: the closed loop is integrated over the period with its
    variations, and the multiplier 1 of its phase is divided out. Raises `InputError` or `IntegrationError`.
    """
    model = model or build_model(controller.system)
    nodes, count = controller.states[:-1], len(controller.states) - 1
    march = March(closed_loop(controller, model), forced=True, effort=EFFORT)
    varied = march.varied(nodes, uniform(1.0, count, STEPS), np.array([controller.period]))
    monodromy = reduce(lambda before, after: after @ before, varied.transitions)
    units = extents_of(model, controller.states, controller.period)  # its own could hide any gap
    ends = controller.states[[0, -1]]
    around, early = _round(model, ends[1])
    around -= ends[0]
    around[controller.angles > 0] -= 2 * np.pi * np.round(around[controller.angles > 0] / (2 * np.pi))
    missed = np.vstack([varied.ends - controller.states[1:], around, early])
    gap = float(np.abs(missed / np.minimum(units, controller.units)).max())
    own = Reference(model, controller.actuators, controller.period, ends, controller.units, controller.clock)
    across, scaled = own.bases[0], monodromy * controller.units / controller.units[:, None]
    reduced = across.T @ (scaled if own.jump is None else own.jump @ scaled) @ across
    multipliers, left, right = eig(reduced, left=True, right=True)
    sharp = np.abs(np.einsum("ik,ik->k", left.conj(), right))  # 1 / condition
    checks = (
        at_most("reference", gap, REQUIRED.closed, "round the orbit, node by node, a motion of the model"),
        at_most("multipliers", float(np.abs(multipliers).max()), 1 - REQUIRED.margin,
                 "largest modulus, of the nonlinear closed loop"),
        at_most("agreement", _apart(multipliers, controller.predicted, sharp), REQUIRED.alike,
                 "of the multipliers with the linear design, over their condition"),
    )  # fmt: skip
    made = replace(controller, multipliers=_sorted(multipliers))
    return replace(made, certificate=Certificate(checks if model.smooth else (*checks, _brought_back(made, model))))


def _brought_back(controller: Controller, model: Model) -> Check:
    """What the automaton, simulated with the law within its limits, leaves of kicks, by their size."""
    largest = float(np.abs(controller.multipliers).max())
    count = int(np.ceil(np.log(1e-3) / np.log(np.clip(largest, 0.03, 0.5))))
    kicks = disturbed(controller, model, np.full(REQUIRED.kicks, REQUIRED.kick), 0)
    worst = float(left(controller, model, *kicks, count).max()) / REQUIRED.kick if largest < 1 else np.inf
    told = f"of {REQUIRED.kicks} kicks of {REQUIRED.kick:g} extents, simulated for {count} events: what is left"
    return at_most("automaton", worst, controller.near(count), told)


def _round(model: Model, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the next period begins, after the event of a hybrid one; and how far the last state is from its guard."""
    if model.smooth:
        return last.copy(), np.zeros(last.size)
    mode, transition = model.arcs[0]
    p = model.parameter_values
    rate = mode.model.rate(0.0, last, p).full().ravel()
    early = float(transition.guard(last, p)) / float(transition.slope(last, p) @ rate)
    return transition.reset(last, p).full().ravel(), early * rate


def certify_controller(controller: Controller, model: Model | None = None) -> Certificate:
    """The certificate of a controller, from its tables and the Model alone, beside what its record claims."""
    again = verified(controller, model)
    assert again.certificate is not None
    claimed = controller.multipliers
    away = np.abs(again.multipliers - claimed).max() if claimed.shape == again.multipliers.shape else np.inf
    said = at_most("recorded_multipliers", float(away), REQUIRED.recorded, "recorded - recomputed, of the closed loop")
    return Certificate((*again.certificate.checks, said))


def _apart(multipliers: np.ndarray, predicted: np.ndarray, sharp: np.ndarray) -> float:
    """The largest difference of multipliers, paired, each times the inverse of its condition."""
    if multipliers.size != predicted.size:
        return np.inf
    apart = np.abs(multipliers[:, None] - predicted) * sharp[:, None]
    return float(apart[linear_sum_assignment(apart)].max())


def closed_loop(controller: Controller, model: Model) -> ca.Function:
    """f(t, x, s, free) of the nonlinear closed loop near its orbit, the place a Newton step from t, without limits."""
    d, m, law = controller.units.size, len(controller.actuators), law_of(controller)
    knots = np.arange(-5, law.count + 6) * (controller.period / law.count)
    t, x = ca.MX.sym("t"), ca.MX.sym("x", d)

    def table(place: ca.MX) -> ca.MX:
        return ca.bspline(place, ca.DM(law.spline.ravel()), [list(knots)], [5], law.spline.shape[1], {})

    units, tau = ca.DM(controller.units), t
    if not controller.clock:
        guess = table(t)[:d]
        slope = ca.jacobian(guess, t) / units
        tau = t + ca.dot(slope, (x - guess) / units) / ca.sumsqr(slope)
    values = table(tau)
    gains = ca.reshape(values[d + m :], d, m).T
    u = values[d : d + m] - gains @ (x - values[:d])
    none = ca.MX.sym("none", 0)
    rate = vector_field(model, controller.actuators)(t, x, none, u)
    return ca.Function("closed_loop", [t, x, none, ca.MX.sym("free", 0)], [rate])
