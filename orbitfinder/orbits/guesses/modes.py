"""Starting points that need no search: where a system rests, and the linear normal modes about it.

With L(theta, mu) = V(theta) + mu.phi(theta): an equilibrium under constraints has grad L = 0 and phi = 0.
Source: J. Nocedal, S. J. Wright, Numerical Optimization, section 18.1 (the reduced Hessian).

To every imaginary pair of eigenvalues i w of an equilibrium of a conservative system, of which no
other is an integer multiple, belongs a family of periodic orbits whose period tends to 2 pi / w and
whose shape to the linear mode (A. M. Lyapunov, 1907; K. R. Meyer, D. C. Offin, Introduction to
Hamiltonian Dynamical Systems and the N-Body Problem (2017), section 9.2); a pair that crosses the imaginary axis
as a parameter changes gives birth to a cycle likewise (E. Hopf, 1942). Under constraints the small motions
are those of Z^T (d2L/dtheta2) Z u = w^2 Z^T M Z u, Z a basis of the null space of J.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import root

from orbitfinder._runtime import limit
from orbitfinder.errors import InputError, plural
from orbitfinder.integrate.equations import at_rest, linearised, under_constraints
from orbitfinder.loops.problem import Guess, Problem
from orbitfinder.loops.symmetry import QUARTER, declared
from orbitfinder.mechanics import newton
from orbitfinder.mechanics.constrained import tangent_basis
from orbitfinder.mechanics.kind import loops_of, system_kind
from orbitfinder.mechanics.model import Model, counted, vector_field, wrapped
from orbitfinder.mechanics.scales import given_or, snapped

FLAT = 1e-4
"""Slope (J per rad or m) at which a descent has reached a minimum; only its energy is asked for."""
SHORT = replace(newton.RESTING, longest=0.3, cutoff=1e-15)
"""How an equilibrium under constraints is found, whose forces have units of their own; steps in rad or m"""


def equilibria(model: Model) -> list[np.ndarray]:
    """The 2^n equilibria of a chain, every link hanging or upright, hanging first. Raises `InputError`."""
    if not system_kind(model.system).pendulum:
        raise InputError("equilibria: known in advance for chains only; give the equilibrium's coordinates")
    return [np.pi * np.array(choice, float) for choice in product((0, 1), repeat=model.degrees_of_freedom)]


def resting_place(model: Model, energy: float) -> np.ndarray:
    """Coordinates (n) of an equilibrium below an energy (J): the one near q = 0, which may be a barrier, or a minimum.

    Raises `InputError` when there is none.
    """
    potential, place = _potential(model), equilibrium(model)
    if energy <= potential(place):
        place = min([place, *minima(model)], key=potential)
    lowest = potential(place)
    if energy <= lowest:
        shown = 0.0 if abs(lowest) < FLAT * abs(energy) else lowest
        raise InputError(f"energy: {energy:.9g} J is not above {shown:.9g} J, the system at rest; give a larger energy")
    return place


def minima(model: Model) -> list[np.ndarray]:
    """Coordinates (n each) of minima of the potential, met going down from places about q = 0."""
    reach, random = np.where(model.angular, np.pi, 2.0 * given_or(model, 1.0)), np.random.default_rng(0)
    ends = [newton.descended(_potential(model), reach * random.uniform(-1, 1, reach.size)) for _ in range(16)]
    # a potential without a floor leads away from every minimum
    return [q for q, _, slope in ends if np.all(np.abs(q) < 4 * reach) and slope < FLAT]


def _potential(model: Model) -> Callable[[np.ndarray], float]:
    """V(q) (J) at the model's own parameters."""
    return lambda q: float(model.potential(q, model.parameter_values))


def equilibrium(model: Model) -> np.ndarray:
    """Coordinates (n) of the minimum of the potential nearest to q = 0, of a mechanism to its pose."""
    n, units = model.degrees_of_freedom, given_or(model, 1.0)
    pose = model.system.get("pose", {})
    from_here = np.array([pose.get(name, 0.0) for name in model.state_names[:n]])

    def potential(q: np.ndarray) -> float:
        return own(from_here + units * q)

    zero, own = np.zeros(n), _potential(model)
    changes = [potential(sign * unit) - potential(zero) for unit in np.eye(n) for sign in (-1, 1)]
    work = float(snapped(np.abs(np.nan_to_num(changes, nan=0.0, posinf=0.0, neginf=0.0)).max()))  # a power of 256
    slopes = [potential(1e-6 * unit) - potential(-1e-6 * unit) for unit in np.eye(n)]
    if np.abs(slopes).max() < 1e-11 * max(work, abs(potential(zero))):
        return from_here
    lowest = newton.descended(lambda q: potential(q) / work, zero, method="BFGS", options={"gtol": 1e-11})[0]
    accelerations = linearised(model)
    rest = newton.equilibrium(lambda q: accelerations(q, zero)[:2], from_here + units * lowest, units)
    return rest.w if rest.converged else from_here + units * lowest


def linkage_equilibrium(model: Model, guess: Sequence[float] | np.ndarray | None = None) -> np.ndarray:
    """Link angles (n, rad) of an equilibrium: the stationary point near `guess`, or the lowest one found.

    Without a guess the potential is minimised on the constraint from some two dozen assemblies. Of a mechanism with
    loops they are its coordinates, and it is minimised from the pose alone. Raises `InputError` when Newton's method
    finds none.
    """
    starts, found = loops_of(model.system).starts(model, guess), []
    if guess is not None:
        return _stationary(model, starts[0])
    if len(starts) == 1:
        return _stationary(model, _descended(model, starts[0]))
    for start in starts:
        with suppress(InputError):
            q = _stationary(model, _descended(model, start))
            found.append((float(under_constraints(model).potential(q)), q))
    if not found:
        raise InputError("linkage: no equilibrium found; give angles near one as guess=")
    q = min(found, key=lambda entry: entry[0])[1]
    return wrapped(q, np.ones(q.size, bool))


def stationary_terms(model: Model, theta: np.ndarray) -> tuple[np.ndarray, ...]:
    """(grad L, phi) for the mu of least |grad L|, J, d2L/dtheta2 and M at link angles (n)."""
    rest = under_constraints(model)
    if theta.shape != (rest.size,):
        raise InputError(f"equilibrium: {plural(theta.size, 'angle')} for {rest.size} bars; give one per bar")
    slope, jacobian, gap = (part.full() for part in rest.first(theta))
    forces = np.linalg.lstsq(jacobian.T, -slope, rcond=None)[0]
    residual = np.vstack([slope + jacobian.T @ forces, gap]).ravel()
    return residual, jacobian, rest.second(theta, forces).full(), rest.mass(theta).full()


def _stationary(model: Model, start: np.ndarray) -> np.ndarray:
    """Newton's method on grad L = 0, phi = 0."""

    def linearised(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residual, jacobian, hessian, _ = stationary_terms(model, theta)
        corner = np.zeros((len(jacobian), len(jacobian)))
        return residual, np.block([[hessian, jacobian.T], [jacobian, corner]])

    solution = newton.equilibrium(linearised, start, settings=SHORT)
    if not solution.converged:
        near = np.array2string(start, precision=4)
        raise InputError(f"{model.system.get('kind')}: no equilibrium found near {near}; give other angles")
    loops_of(model.system).check(model, solution.w)
    return solution.w


def _descended(model: Model, start: np.ndarray) -> np.ndarray:
    """Near a minimum of the potential on the constraint, by SLSQP."""
    rest = under_constraints(model)
    closure = {
        "type": "eq", "fun": lambda x: rest.first(x)[2].full().ravel(), "jac": lambda x: rest.first(x)[1].full()
    }  # fmt: skip
    return newton.descended(
        lambda x: float(rest.potential(x)), start, jac=lambda x: rest.first(x)[0].full().ravel(), method="SLSQP",
        constraints=[closure], options={"ftol": 1e-10, "maxiter": 200},
    )[0]  # fmt: skip


OSCILLATES = 1e-12
"""Squared frequencies beyond this, relative to the largest, are of modes that oscillate."""


def normal_modes(
    model: Model, equilibrium: Sequence[float] | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies (n, rad^2/s^2, slowest first) and shapes (n x n, one per column).

    K u = w^2 M u with M = d2T/dv2 and K = d2V/dq2 at the equilibrium (default: q = 0, hanging; of a mechanism the one
    nearest to its pose).
    Source: Goldstein, Classical Mechanics, section 6.2.
    """
    n = model.degrees_of_freedom
    if model.rates is not None:
        raise InputError(
            "a first-order system has no masses; give mode, amplitude and equilibrium, or a state and a period"
        )
    if model.constraint is not None:
        return linkage_modes(model, equilibrium)
    place = _place(model, equilibrium)
    if place.shape != (n,):
        raise InputError(f"equilibrium: shape {place.shape} for {n} coordinates; give one number each, without rates")
    column, columns = at_rest(model), []
    for unit in np.eye(n):
        limit.check()
        columns.append([part.full().ravel() for part in column(place, unit)])
    m, k, force = (np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
    if not all(np.all(np.isfinite(part)) for part in (m, k, force)):
        raise InputError(
            f"guess.mode: the energies have no second derivatives at {place.tolist()}, or not in double precision; "
            "give the coordinates of an equilibrium, or a state and a period"
        )
    units = given_or(model, 1.0)
    stiff = np.abs(k * units[:, None] * units).max()
    if np.abs(force * units[:, None]).max() > 1e-9 * max(float(stiff), float(snapped(stiff))):
        raise InputError(f"guess.mode: {place.tolist()} is not an equilibrium; give the coordinates of one")
    try:
        squared, shapes = eigh(k, m)
    except np.linalg.LinAlgError as error:
        raise InputError(f"guess.mode: no modes at {place.tolist()} ({error}); give a state and a period") from error
    return np.asarray(squared), np.asarray(shapes)


def _place(model: Model, given: Sequence[float] | np.ndarray | None) -> np.ndarray:
    """The equilibrium given; else q = 0, of a mechanism the nearest to its pose, under constraints the lowest."""
    if given is not None:
        return np.asarray(given, float)
    if model.constraint is not None:
        return linkage_equilibrium(model)
    return equilibrium(model) if system_kind(model.system).drawn else np.zeros(model.degrees_of_freedom)


def normal_mode(
    model: Model, mode: int, amplitude: float, equilibrium: Sequence[float] | np.ndarray | None = None
) -> Guess:
    """Guess on a linear normal mode: `mode` counts from 1, slowest first; largest deviation `amplitude` (rad or m).

    The motion starts at rest at its turning point; that of a gyroscopic system (a rotating frame), whose modes count
    among those that oscillate, where a symmetry that the model declares has its instant. Of a first-order system the
    modes are the pairs of complex eigenvalues at the equilibrium that Newton's method finds from `equilibrium`. Raises
    `InputError` when there is no such mode or when the equilibrium is unstable in it.
    """
    n = model.degrees_of_freedom
    if not (np.isfinite(amplitude) and amplitude > 0):
        raise InputError(f"guess.amplitude: must be positive and finite, got {amplitude}; give an angle in rad")
    if model.rates is not None:
        # a turn of the ellipse x* + a Re(u exp(i w t)) that a pair of eigenvalues goes round
        place, values, vectors = first_order_modes(model, np.zeros(n) if equilibrium is None else equilibrium)
        pairs = f"{plural(values.size, 'pair')} of complex eigenvalues"
        _check_mode(mode, values.size, f"the equilibrium at {place.tolist()} has {pairs}")
        shape, frequency = vectors[:, mode - 1], float(values[mode - 1].imag)
        shape = amplitude * shape / shape[np.abs(shape).argmax()]
        times = np.linspace(0.0, 2 * np.pi / frequency, 65)
        states = place + np.real(np.exp(1j * frequency * times)[:, None] * shape)
        return Guess(states[0], float(times[-1]), times, states)
    if model.constraint is not None:
        return linkage_mode(model, mode, amplitude, equilibrium)
    if model.gyroscopic is not None and model.conservative:
        return _gyroscopic_mode(model, mode, amplitude, np.zeros(n) if equilibrium is None else equilibrium)
    moved, period = _swung(_place(model, equilibrium), *normal_modes(model, equilibrium), mode, amplitude)
    return Guess(np.concatenate([moved, np.zeros(n)]), period)


def _swung(
    place: np.ndarray, squared: np.ndarray, shapes: np.ndarray, mode: int, amplitude: float
) -> tuple[np.ndarray, float]:
    """The turning point (n) of a mode about a place, and its period. Raises `InputError`."""
    _check_mode(mode, squared.size, f"this system has {plural(squared.size, 'normal mode')}")
    chosen = float(squared[mode - 1])
    if mode - 1 not in oscillating(squared):
        raise InputError(
            f"guess.mode: mode {mode} does not oscillate (squared frequency {chosen:.3g}); "
            "give a state and a period, or use gravity so that the system hangs"
        )
    shape = shapes[:, mode - 1]
    return place + amplitude * shape / shape[np.abs(shape).argmax()], float(2 * np.pi / np.sqrt(chosen))


def _check_mode(mode: int, count: int, there: str, name: str = "guess.mode") -> None:
    if isinstance(mode, bool) or not 1 <= mode <= count:
        raise InputError(f"{name}: must be between 1 and {count}, got {mode}; {there}")


def first_order_modes(
    model: Model, equilibrium: Sequence[float] | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The equilibrium (d) of a first-order system near a state, its eigenvalues r + i w with w > 0 and their vectors.

    The slowest first; w (rad/s) is the mode's frequency and r its growth. Raises `InputError`.
    """
    place = np.asarray(equilibrium, float)
    if place.shape != (model.degrees_of_freedom,):
        raise InputError(f"equilibrium: shape {place.shape} for {counted(model)}; give one number each")
    if model.forced:
        raise InputError("guess.mode: a forced system does not rest; give a state, its forcing has the period")
    field = vector_field(model)  # not `accelerations`, which a search has compiled without derivatives
    slope = field.jacobian()

    def rates(x: np.ndarray) -> np.ndarray:
        return np.asarray(field(0.0, x, [], []).full().ravel())

    def slopes(x: np.ndarray) -> np.ndarray:
        return np.asarray(slope(0.0, x, [], [], 0)[1].full())

    rest = root(rates, place, jac=slopes, tol=1e-14).x  # a trust region comes to equilibria that Newton's leaps miss
    matrix, left = slopes(rest), rates(rest)
    size = np.abs(matrix) @ np.maximum(np.abs(rest), np.abs(rest - place))
    if not np.all(np.abs(left) <= 1e-10 * np.maximum(size, size.max())):  # relative to what the rates are made of
        raise InputError(f"guess.equilibrium: none is found from {place.tolist()}; give a state nearer to it")
    values, vectors = np.linalg.eig(matrix)
    turning = np.flatnonzero(values.imag > np.sqrt(OSCILLATES) * np.abs(values).max(initial=0.0))
    turning = turning[np.argsort(values[turning].imag)]
    return rest, values[turning], vectors[:, turning]


def rest_near(model: Model, place: Sequence[float] | np.ndarray) -> np.ndarray:
    """Coordinates (n) of the equilibrium that Newton's method finds from a place. Raises `InputError`."""
    if model.rates is not None:
        return first_order_modes(model, place)[0]
    if model.constraint is not None:
        return linkage_equilibrium(model, place)
    start, slopes = np.asarray(place, float), linearised(model)
    if start.shape != (model.degrees_of_freedom,):
        raise InputError(f"guess.equilibrium: shape {start.shape} for {model.degrees_of_freedom} coordinates")
    size = max(1.0, newton.largest(start))
    solution = newton.equilibrium(lambda q: slopes(q, np.zeros(q.size))[:2], start, size)
    if solution.converged:
        return solution.w
    raise InputError(f"guess.equilibrium: no equilibrium found from {start.tolist()}; give a place nearer to one")


def gyroscopic_modes(model: Model, equilibrium: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angular frequencies (k, rad/s, slowest first) and shapes (2n x k, complex) of the small oscillations.

    x' = A x with A from the accelerations' slopes, x = (q, v); each pair +-i w of eigenvalues is a mode whose motions
    are the real parts of shape exp(i w t). Source: L. Meirovitch, Methods of Analytical Dynamics (1970), section 6.
    """
    n = equilibrium.size
    force, stiffness, turning = linearised(model)(equilibrium, np.zeros(n))
    matrix = np.block([[np.zeros((n, n)), np.eye(n)], [stiffness, turning]])
    if not np.all(np.isfinite(matrix)) or np.abs(force).max() > 1e-9 * float(np.abs(matrix).max()):
        raise InputError(f"guess.mode: {equilibrium.tolist()} is not an equilibrium; give the coordinates of one")
    values, shapes = np.linalg.eig(matrix)
    kept = np.flatnonzero((values.imag > 0) & (np.abs(values.real) < 1e-8 * np.abs(values).max()))
    kept = kept[np.argsort(values.imag[kept])]
    return values.imag[kept], shapes[:, kept]


def _gyroscopic_mode(model: Model, mode: int, amplitude: float, equilibrium: Sequence[float] | np.ndarray) -> Guess:
    place = np.asarray(equilibrium, float)
    frequencies, shapes = gyroscopic_modes(model, place)
    _check_mode(mode, frequencies.size, f"{frequencies.size} modes oscillate at {place.tolist()}")
    shape = shapes[:, mode - 1]
    shape = shape / shape[np.abs(shape[: place.size]).argmax()]  # the largest coordinate is largest at the start,
    for symmetry in declared(model):
        gaps = symmetry.matrix(place.size) @ shape - shape  # or else a mirrored motion starts on its mirror
        if symmetry.sense < 0 and np.abs(gaps).max() > 1e-9:
            away = gaps[np.abs(gaps).argmax()]
            turned = shape * 1j * abs(away) / away
            if np.abs(symmetry.matrix(place.size) @ turned.real - turned.real).max() < 1e-9:
                shape = turned * np.sign(turned.real[: place.size][np.abs(turned.real[: place.size]).argmax()])
                break
    return Guess(np.concatenate([place, 0 * place]) + amplitude * shape.real, 2 * np.pi / float(frequencies[mode - 1]))


def oscillating(squared: np.ndarray) -> np.ndarray:
    """Positions of the modes that oscillate among the squared frequencies of all."""
    return np.flatnonzero(squared > OSCILLATES * np.abs(squared).max(initial=0.0))


def mode_problem(
    model: Model,
    mode: int,
    amplitude: float | None = None,
    equilibrium: Sequence[float] | np.ndarray | None = None,
    name: str | None = None,
) -> Problem:
    """The Problem that starts the family of a mode, in the quarter-period formulation.

    `mode` counts the oscillating modes of the equilibrium from 1, slowest first; without an `amplitude` it is 0.02 rad,
    or 0.02 of the length given. Raises `InputError`.
    """
    amplitude = 0.02 * float(given_or(model, 1.0).max()) if amplitude is None else amplitude
    swinging = oscillating(normal_modes(model, equilibrium)[0])
    modes = f"{plural(swinging.size, 'oscillating mode')} out of {model.degrees_of_freedom}"
    _check_mode(mode, swinging.size, f"this equilibrium has {modes}", "mode")
    guess = normal_mode(model, int(swinging[mode - 1]) + 1, amplitude, equilibrium)
    return Problem(model, guess, symmetry=QUARTER.name, name=name or f"mode-{mode}")


def linkage_modes(
    model: Model, equilibrium: Sequence[float] | np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Squared angular frequencies (n - 2, rad^2/s^2, slowest first) and shapes (n x n-2) in the link angles."""
    theta = _place(model, equilibrium)
    _, jacobian, hessian, mass = stationary_terms(model, theta)
    basis = tangent_basis(jacobian)
    try:
        squared, shapes = eigh(basis.T @ hessian @ basis, basis.T @ mass @ basis)
    except ValueError as error:  # no numbers, or a motion that moves no mass (LinAlgError)
        raise InputError(f"guess.mode: no modes at {theta.tolist()} ({error}); give a state and a period") from error
    return np.asarray(squared), np.asarray(basis @ shapes)


def linkage_mode(
    model: Model, mode: int, amplitude: float, equilibrium: Sequence[float] | np.ndarray | None = None
) -> Guess:
    """Guess on a linear normal mode, at rest at its turning point: `mode` from 1, largest angle `amplitude` (rad)."""
    theta = _place(model, equilibrium)
    if not (np.isfinite(amplitude) and amplitude != 0):
        raise InputError(f"guess.amplitude: must be finite and not 0, got {amplitude}; give an angle in rad")
    moved, period = _swung(theta, *linkage_modes(model, theta), mode, amplitude)
    return Guess(loops_of(model.system).state(model, near=moved), period)
