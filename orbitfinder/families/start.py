"""Where a family starts: from a Problem, an Orbit or a guess to a corrected place on a curve."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import UNSOLVED, ConvergenceError, InputError, IntegrationError, closest
from orbitfinder.families.minimal import minimal_problem
from orbitfinder.families.motion import SAMPLES, full_samples, whole_motion
from orbitfinder.families.point import FamilySettings, parameter_value
from orbitfinder.integrate.march import March, rounded, uniform
from orbitfinder.loops.conditions import QUANTITIES, Pin, clock, conserved, followed, measured, pinned, quantities
from orbitfinder.loops.continued import Curve, Solution, begun, correct, kernel, make_curve, tangent
from orbitfinder.loops.loop import Condition, Equations, Unknowns
from orbitfinder.loops.mesh import carried, fitted, settled
from orbitfinder.loops.problem import Guess, Problem, at_forcing_period, clocked
from orbitfinder.loops.scales import Scales
from orbitfinder.loops.symmetry import (
    NONE,
    Symmetry,
    knowing,
    momenta_of,
    moved,
    named,
    off_centre,
    recognise,
    related,
    shifting,
    shifts_of,
    symmetries_of,
)
from orbitfinder.loops.watch import watches
from orbitfinder.mechanics.kind import build_model, system_kind, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import lengths
from orbitfinder.orbits import method
from orbitfinder.orbits.find import find_orbit
from orbitfinder.orbits.hybrid import first_unknowns
from orbitfinder.orbits.shoot import natural_pin
from orbitfinder.records.family import AGAIN, Family, FamilyPoint
from orbitfinder.records.orbit import Orbit, refuse_controlled
from orbitfinder.records.reading import read_as

LOOKS = (40, 160, 640)
"""... in one segment, to see where a motion goes"""
COVERED = 1e-5
"""A guess goes round its orbit several times where it comes back to its start within this share of its extents"""


@dataclass(frozen=True)
class Start:
    """A curve in the scales of an orbit on it, and a direction along it (over the head)."""

    curve: Curve
    solution: Solution
    direction: np.ndarray
    why: str = ""
    """why it is by collocation, where that was not asked for"""


def begin(
    origin: Problem | Orbit, settings: FamilySettings | None = None, symmetry: str = "auto", model: Model | None = None
) -> Start:
    """The family through an orbit or through the solution of a Problem; a linkage's in minimal coordinates.

    `symmetry` "auto" recognises the orbit's own and uses the shortest horizon it allows; a name
    insists on that formulation. `model` is the orbit's where no file describes it. Raises `InputError`,
    `ConvergenceError`, `IntegrationError`.
    """
    settings = settings or FamilySettings()
    problem = as_problem(origin, model)
    if not problem.model.smooth:  # all events of the cycle are watched
        problem, symmetry = replace(problem, symmetry=NONE.name), NONE.name
    if settings.certify:
        for work in system_kind(problem.model.system).works(problem.model):
            work.begin()
    by = settings.method or problem.method
    free, held = unknown_parameters(problem.model, settings, momenta_of(problem.boundary, problem.model))
    by_momentum = bool(problem.relative) and settings.parameter in momenta_of(problem.boundary, problem.model)
    if (free and families_in(problem.model)) or by_momentum:
        return _freed(begin(problem, replace(settings, parameter="energy"), symmetry), free, held, settings.parameter)
    if settings.beside:
        return _freed(begin(problem, replace(settings, beside=""), symmetry), free, held, settings.parameter)
    if by and method.named(by).begin:
        return _start(problem, free, by)
    wanted = problem.symmetry if symmetry == "auto" else symmetry
    base = replace(problem, symmetry=NONE.name) if wanted != problem.symmetry else problem
    chosen = bool(problem.free or problem.constraints) or problem.objective != "nearest" or problem.forcing_cycles > 1
    start = (_found_first if chosen else _tried)(base, free)
    if start.curve.equations.gridded:
        return start
    if symmetry == "auto" and not problem.relative:
        wanted = symmetry_of(start.curve, start.solution)
    return reformulated(start, related(named(wanted, problem.model), problem.model, problem.relative))


def _tried(problem: Problem, free: tuple[str, ...]) -> Start:
    """Newton from the guess itself over its least period, or else from the orbit that the guess leads to."""
    try:
        start = _start(problem, free)
    except UNSOLVED:
        return _found_first(problem, free)
    place, covers = start.solution.place, 1 if problem.boundary.maps else cover_of(start.curve, start.solution)
    if covers == 1:
        return start
    state, turns = place.nodes[0], tuple(int(k) // covers for k in start.curve.turns)
    pins = natural_pin(problem, state) if problem.model.conservative else problem.pin
    return _start(replace(problem, guess=Guess(state, place.period / covers), pin=pins, winding=turns), free)


def cover_of(curve: Curve, solution: Solution) -> int:
    """How many times an orbit goes round a shorter one."""
    if curve.equations.links or curve.equations.model.forced:
        return 1
    motion = whole_motion(curve, solution)
    (begin, end), extents = motion(motion.x[[0, -1]]), nonzero(np.ptp(motion(motion.x), axis=0))
    parts = np.arange(30, 1, -1)  # a guess may go round its orbit so many times
    turns = 2 * np.pi * np.round((end - begin) / (2 * np.pi * parts[:, None]))
    gaps = np.abs(motion(motion.x[-1] / parts) - begin - turns)
    return int(parts[(gaps < COVERED * extents).all(axis=1)].max(initial=1))


def _found_first(problem: Problem, free: tuple[str, ...]) -> Start:
    """From the orbit that `find_orbit` finds, at the values it gives to parameters that the Problem frees."""
    orbit = find_orbit(problem)
    model = with_parameters(problem.model, orbit.provenance.get("free", {})) if problem.free else problem.model
    problem = as_problem(orbit, model)
    return _start(problem, free, problem.method)


def as_problem(origin: Problem | Orbit, model: Model | None = None) -> Problem:
    """The Problem whose solution an orbit is, in minimal coordinates."""
    refuse_controlled(origin, "continue")
    if isinstance(origin, Problem):
        return minimal_problem(origin)
    model = knowing(model or build_model(origin.system), origin.symmetry)
    model = with_parameters(model, getattr(origin, "free", {}))  # a family's orbit is at its own values
    energy = next(iter(ungenerated(model)), None)
    by = method_of(origin)
    along = (origin.times, origin.samples) if by and origin.times.size else (None, None)
    if by and isinstance(origin, FamilyPoint) and origin.mesh.size == len(origin.shooting_nodes) + 1:
        along = origin.mesh * origin.period, np.vstack([origin.shooting_nodes, origin.shooting_nodes[:1]])
    problem = Problem(
        model, Guess(origin.state, origin.period, *along), (Pin(energy, origin.energy),) if energy else (),
        winding=origin.winding, name=origin.name, relative=tuple(origin.shift), method=by,
    )  # fmt: skip
    held = [pin for pin in natural_pin(problem, origin.state) if pin.name in momenta_of(problem.boundary, model)]
    return minimal_problem(replace(problem, pin=(*problem.pin, *held)) if held else problem)


def method_of(origin: Problem | Orbit) -> str | None:
    """The method that an origin asks for, was found by or is followed by unasked, where families begin by it."""
    known = {} if isinstance(origin, Problem) else {**getattr(origin, "curve", {}), **origin.provenance}
    by = origin.method or method.follower(origin) if isinstance(origin, Problem) else known.get("method")
    return by if by and method.begins(by) else None


def unknown_parameters(
    model: Model, settings: FamilySettings, momenta: tuple[str, ...] = ()
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """(freed physical parameters, names of what is held) for a continuation parameter. Raises `InputError`.

    `momenta` of the coordinates that orbits are relative in are held, or one of them is followed and the energy held.
    Others are not: an orbit closes for one value of each, at which nothing drifts.
    """
    name, families, alone = settings.parameter, families_in(model), {*ungenerated(model)} - {"energy"}
    if name in families:
        return (), tuple(each for each in ("energy", *momenta) if each != name) if name in momenta else momenta
    if name in followed(model) and name not in alone:
        raise InputError(
            f"parameter: orbits of this system do not come in families by {name}; continue in a physical parameter"
            f" ({', '.join(model.parameter_names[:20]) or 'it has none'})"
        )
    if name in quantities(model) and name not in alone:
        raise InputError(
            f"parameter: {name} is not the same wherever on an orbit t = 0 is, which a family chooses; pin it in the "
            "problem, and continue in the energy or a physical parameter"
        )
    if name not in model.parameter_names:
        known = [*families, *model.parameter_names]
        raise InputError(f"parameter: unknown {name!r}{closest(name, known)}; use one of {', '.join(known[:20])}")
    if settings.beside:
        known = [each for each in model.parameter_names if each != name]
        why = "" if settings.beside in known else f"use one of {', '.join(known[:20]) or 'none'}"
        why = "its forcing has the period" if model.forced else why
        if why := "this system keeps its energy; use hold" if families else why:
            raise InputError(f"beside: {settings.beside!r}: {why}")
        return (name, settings.beside), ("period", *momenta)
    if not families:
        return (name,), momenta
    holds = [each for kind in QUANTITIES.values() if kind.held for each in kind.names(model)]
    if settings.hold not in holds:
        raise InputError(f"hold: must be {' or '.join(holds)}, got {settings.hold!r}")
    return (name,), (settings.hold, *momenta)


def families_in(model: Model) -> list[str]:
    """What the orbits of one system come in families by: the energy, the period, momenta; nothing where no energy is
    kept."""
    alone = {*ungenerated(model)} - {"energy"}
    return [each for each in followed(model) if each not in alone] if model.conservative else []


def _freed(base: Start, free: tuple[str, ...], held: tuple[str, ...], name: str) -> Start:
    """The same orbit on the curve on which a parameter of this name varies and what is held keeps its value."""
    p = base.curve.equations
    curve, place = released(base.curve, base.solution.place, Equations.of(p.model, p.symmetry, free, p.by), held)
    return corrected(curve, place, _own_aim(curve, place, name))


def released(old: Curve, place: Unknowns, equations: Equations, held: tuple[str, ...]) -> tuple[Curve, Unknowns]:
    """The curve of other equations through an orbit of a curve, and its unknowns there."""
    known, unfolding = dict(zip(old.equations.free, place.free, strict=True)), np.zeros(equations.march.unfolding)
    numbers = [known.get(name, value) for name, value in zip(equations.free, equations.numbers, strict=True)]
    unfolding = place.unfolding if place.unfolding.size == unfolding.size else unfolding
    place = replace(place, unfolding=unfolding, free=np.array(numbers))
    return replace(curve_at(equations, place, held), constant=old.constant), place


def _start(problem: Problem, free: tuple[str, ...], by: str | None = None) -> Start:
    """From the guess by shooting, or from the orbit on the mesh of a method. Raises `InputError` where that is not for
    it."""
    begin = method.method_of(problem, by)[1].begin if by else None
    if begin:
        problem = at_forcing_period(problem)
        equations, place = begin(problem, free)
    else:
        equations, guess, steps = Equations.of(problem.model, problem.boundary, free), problem.guess, March.first_steps
        mesh = uniform(equations.symmetry.fraction, 1, int(steps * equations.symmetry.fraction))
        place = equations.unknowns(guess.start[None], guess.period, mesh)
        if equations.links:
            place = first_unknowns(equations, guess, 1, rounded(steps / equations.links.count))
        equations.march.ahead()
    momenta, pins = momenta_of(problem.boundary, problem.model), [] if free else list(problem.pin)
    curve = curve_at(equations, place, momenta, problem.turns, {held.name: held.value for held in problem.pin})
    pin = next((one for one in pins if one.name not in momenta), None)
    aim = pinned(equations, pin.name, pin.value) if pin else _own_aim(curve, place)
    return corrected(curve, place, aim, place if begin else None)


def curve_at(
    equations: Equations,
    place: Unknowns,
    held: tuple[str, ...] = (),
    turns: np.ndarray | None = None,
    given: Mapping[str, float] | None = None,
) -> Curve:
    """The curve with its boundary constant and held values, those not `given`, taken at a place near it.

    The constants are multiples of pi: a symmetric motion may be symmetric about an upright link.
    """
    model, symmetry = equations.model, equations.symmetry
    alone = ungenerated(model)[1:]
    steps, states = _looked_at(equations, place)
    end, given = equations.links.after(-1, states[-1], place.free), given or {}
    constant = symmetry.constants(np.asarray(model.angles), place.nodes[0], end, None if symmetry.maps else turns)
    cycles = model.forcing_cycles(place.period, float(equations.quantities_at(place)[0][-1]))
    numbers = {name: given[name] if name in given else measured(equations, place, name) for name in (*held, *alone)}
    fixed = clock(equations, cycles) + tuple(pinned(equations, name, value) for name, value in numbers.items())
    unit, states = lengths(model, states), symmetry.whole(steps, states, constant)[1]
    return make_curve(equations, constant, place, fixed, unit, states)


def ungenerated(model: Model) -> tuple[str, ...]:
    """The invariants that no symmetry belongs to, by name: the energy, of a free top its momentum too.

    Each is a parameter of the family; all but the first, in which it is followed, are held.
    """
    return tuple(invariant.name for invariant in model.invariants if invariant.generator is None)


def _looked_at(equations: Equations, place: Unknowns) -> tuple[np.ndarray, np.ndarray]:
    """A mesh over a place and the states on it, by as few steps as reach its end: near a pole 40 are too few."""
    if equations.gridded:
        return place.mesh, equations.varied(place, states=True).states
    for count in LOOKS:
        try:
            steps = uniform(equations.symmetry.fraction, len(place.nodes), count)
            return steps, equations.march.states(place.nodes, steps, place.tail)
        except IntegrationError:
            if count == LOOKS[-1]:
                raise
    raise AssertionError("unreachable")


def by_series(entry: Mapping[str, Any]) -> bool:
    """Whether a family is known by its series alone, and no equations of shooting stand beside it."""
    return "method" in entry and "constant" not in entry


def curve_of(entry: Mapping[str, Any], model: Model, settings: FamilySettings) -> Curve:
    """The very curve that the `curve` entry of a journal or family.json stands for."""
    if by_series(entry):
        raise InputError(f"curve: {entry['method']} of many coordinates knows no branches and curves; follow the "
                         "family by another method")  # fmt: skip
    known = read_as(CurveEntry, entry, "curve", "continue the family again")
    model = knowing(model, known.symmetry)
    if known.symmetry not in symmetries_of(model):
        raise InputError(f"curve: unknown symmetry {known.symmetry!r}; continue the family again")
    unknown_parameters(model, settings)
    for name in known.free:
        model.parameter_index(name)
    if not set(known.relative) <= set(shifts_of(model)):
        raise InputError(f"curve.relative: {list(known.relative)} is not of this system; continue the family again")
    symmetry = related(named(known.symmetry, model), model, known.relative)
    march = method.named(known.method or method.SHOOTING).march
    equations = Equations.of(model, symmetry, known.free, march)
    wanted = equations.size, equations.size + 1 + len(known.free)
    if (known.constant.shape, known.weights.shape) != (wanted[:1], wanted[1:]) or not np.all(known.weights > 0):
        raise InputError("curve: constant or weights do not fit the system; continue the family again")
    if not np.all(np.abs(known.constant) < 1e15):  # whole turns are counted
        raise InputError(f"curve.constant: {known.constant.max():g} is no turn; continue the family again")
    if not all(0 <= k < len(model.invariants) for k, _ in known.held):
        raise InputError(f"curve.held: {list(known.held)} of {len(model.invariants)} invariants; continue again")
    names = [number.name for number in model.invariants]
    conditions = clock(equations, known.cycles) + tuple(conserved(value, names[k], k) for k, value in known.held)
    others = {"period": known.period} if known.period is not None else {}
    conditions += tuple(pinned(equations, name, value) for name, value in (others | dict(known.pins)).items())
    scales = Scales.head(known.weights, equations.size)
    watch = watches({name: number for name, number in known.watch.items() if isinstance(number, str)}, model)
    curve = Curve(equations, known.constant, conditions, weights=known.weights, scales=scales, watch=watch)
    if len(known.winding) == len(curve.turns) and known.winding != curve.turns:
        raise InputError(f"curve.winding: {list(known.winding)}, of its constant {list(curve.turns)}; {AGAIN}")
    return curve


def curve_in(family: Family, model: Model) -> Curve:
    """The curve that a family follows. Raises `InputError` where its file does not say."""
    if not family.curve:
        raise InputError(f"{family.name}: curve: missing, an older orbitfinder wrote this family; continue it again")
    return curve_of(family.curve, model, FamilySettings(parameter=family.parameter))


def entry_of(curve: Curve) -> dict[str, Any]:
    """What `curve_of` rebuilds a curve from (`CurveEntry`), its turns, and the test of a curve of bifurcations."""
    p, pins = curve.equations, {kept.name: kept.value for kept in curve.kept}
    names, period = [number.name for number in p.model.invariants], pins.pop("period", None)
    held = [[names.index(name), pins.pop(name)] for name in list(pins) if name in names]
    watch = {name: number.entry for name, number in curve.watch.items()}
    relative = list(shifting(p.symmetry, p.model))
    known = {"symmetry": p.symmetry.name, "free": list(p.free), "constant": curve.constant, "winding": curve.turns,
             "weights": curve.weights, "held": held, "period": period}  # fmt: skip
    more = {"method": p.method, "cycles": curve.cycles, "relative": relative, "watch": watch, "test": curve.test,
            "pins": pins}  # fmt: skip
    return known | {name: value for name, value in more.items() if value}


@dataclass(frozen=True)
class CurveEntry:
    """The `curve` of a journal or family.json: what a `Curve` is rebuilt from."""

    symmetry: str
    free: tuple[str, ...]
    constant: np.ndarray
    held: tuple[tuple[int, float], ...]
    weights: np.ndarray
    period: float | None
    winding: tuple[int, ...] = ()
    """whole turns in a period, which its constant has too; not in older files"""
    cycles: int = 0
    """periods of the forcing in one period, 0 without a forcing"""
    relative: tuple[str, ...] = ()
    """cyclic coordinates along which the orbits come back shifted"""
    watch: Mapping[str, Any] = field(default_factory=dict)
    """the texts of watched numbers by name, of functions their names"""
    pins: Mapping[str, float] = field(default_factory=dict)
    """what else the family keeps, by name"""
    method: str = ""
    """how its orbits are integrated, where that is not by shooting"""
    method_reason: str = ""
    """why, where it was not asked for"""


def _own_aim(curve: Curve, place: Unknowns, name: str = "") -> Condition:
    """The parameter of a name, the first freed one or else the energy, at the value that it has at a place."""
    name = name or curve.equations.parameter
    return pinned(curve.equations, name, parameter_value(curve, place, name))


def corrected(
    curve: Curve, place: Unknowns, aim: Condition, reference: Unknowns | None = None, reach: float = 10.0
) -> Start:
    """Correct a first guess, on successively better meshes unless it has the one of its `reference`."""
    tried, failure = np.zeros(0), None
    for several in (False, True):
        on = fitted(curve, place, several) if reference is None else place
        if np.array_equal(on.mesh, tried):
            break
        try:
            solution, failure = correct(curve, on, aim, reference, reach), None
            break
        except UNSOLVED as error:
            tried, failure = on.mesh, error
    if failure is not None:
        raise ConvergenceError(f"no orbit to start the family from: {failure}; find and certify one first") from failure
    place = on
    toward = place.joined(np.zeros(place.nodes.shape[1]), float(not place.free.size), 0.0, np.ones(place.free.size))
    whole = tangent(curve, solution, toward) if curve.equations.gridded else kernel(curve, solution)
    solution, place = settled(curve, solution, whole), solution.place
    curve, whole = begun(curve, solution, carried(curve, place, whole, solution.place))
    return Start(curve, solution, solution.place.head_of(whole))


def symmetry_of(curve: Curve, solution: Solution) -> str:
    """The symmetry that an orbit and its equations have, whatever formulation it was found in.

    A motion may be more symmetric than its system, such as one along a line beside which nothing is even: its
    variations then do not repeat after a part of the period. Equations are tried along it and as far as it may grow.
    """
    if len(curve.equations.symmetry.maps) > 1:
        return curve.equations.symmetry.name
    times, states = full_samples(curve, solution, 4 * SAMPLES)  # of several turns, if it branched off a resonance
    model = curve.equations.model
    seen = symmetries_of(model)[recognise(times, states, model)]
    candidates = [one for one, _ in seen.narrower()]
    if not model.conservative:  # symmetries that reverse time need no dissipation
        candidates = [replace(seen, maps=(seen.forward,))] if seen.forward else []
    models = (model, moved(model, curve.equations.free))
    w, middle, sizes = solution.place, states.mean(axis=0), curve.sizes(solution)
    rates = partial(curve.equations.march.rates, tail=w.tail)
    wide = np.vstack([middle + share * (states[:: 4 * SAMPLES // 120] - middle) for share in (0.5, 1.0, 2.0, 4.0)])
    kept = (each.name for each in candidates
            if all(each.held_by(m, states[0], curve.cycles) for m in models)
            and each.lost_beside(rates, wide, sizes, w.period / 2) is None)  # fmt: skip
    return next(kept, NONE.name)


def _symmetric_instant(curve: Curve, motion: CubicHermiteSpline, symmetry: Symmetry) -> float:
    """When a motion is nearest to the fixed set that the horizon starts in, of all times that it comes near."""
    model, involution, times = curve.equations.model, symmetry.maps[0], motion.x
    size = motion.c.shape[-1]
    clock = clocked(model, times[-1] / (2 * np.pi)) / np.tile(curve.shares, size // curve.shares.size)
    rows = symmetry.rows(model.degrees_of_freedom)[0][: size // 2]

    def away(instants: np.ndarray) -> np.ndarray:
        return off_centre(involution, motion(instants % times[-1]) * clock, model.angles)

    sizes = np.abs(away(times[:-1])).max(axis=1)
    near = times[:-1][(sizes <= np.roll(sizes, 1)) & (sizes <= np.roll(sizes, -1))]
    speeds = (motion(near, 1) * clock) @ rows.T
    instants = near - (away(near) * speeds).sum(axis=1) / nonzero((speeds**2).sum(axis=1))
    return float(instants[np.abs(away(instants)).max(axis=1).argmin()])


def return_gaps(curve: Curve, states: np.ndarray, parts: int) -> np.ndarray:
    """The largest |x(t + T / parts) - x(t)| (2n) of states at equal times over a period T, but for whole turns of what
    runs round: a motion may pass its start twice nearly alike. Between events, where it jumps, that of t = 0."""
    low, share = divmod((len(states) - 1) / parts, 1.0)
    gone = states[-1] - states[0]
    on = np.vstack([states, states[1:] + gone, states[1:2] + 2 * gone])[int(low) :][: len(states) + 1]
    turns = 2 * np.pi * np.round(gone / (2 * np.pi * parts))
    gaps = np.abs(on[:-1] + share * np.diff(on, axis=0) - states - turns)
    return np.asarray(gaps[curve.equations.links.comparable].max(axis=0))


def reformulated(start: Start, symmetry: Symmetry) -> Start:
    """The same orbit in the formulation of another symmetry, started at a brake instant where that needs one."""
    old, place, march = start.curve, start.solution.place, start.curve.equations.march
    if symmetry == old.equations.symmetry:
        return start
    model, fraction = old.equations.model, symmetry.fraction
    times, states = full_samples(old, start.solution, 4 * SAMPLES)
    tail = np.concatenate([[times[-1]], np.zeros(march.unfolding), old.equations.numbers])
    motion = CubicHermiteSpline(times, states, march.rates(states, tail, times))
    parts = max(1, round(len(place.nodes) * fraction))  # more than one where it is too unstable for one
    begin = _symmetric_instant(old, motion, symmetry) if symmetry.reverses else 0.0
    laps, instants = np.divmod(begin + place.period * fraction * np.arange(parts) / parts, place.period)
    nodes = motion(instants) + (laps - laps[0])[:, None] * (motion(place.period) - motion(0.0))
    if symmetry.reverses:
        first = symmetry.rows(model.degrees_of_freedom)[0][: nodes.shape[1] // 2]
        nodes[0] -= np.linalg.pinv(first) @ off_centre(symmetry.maps[0], nodes[:1], model.angles)[0]
    equations = Equations.of(model, symmetry, old.equations.free)
    fresh = equations.unknowns(nodes, place.period, np.zeros(0), place.free)
    curve = replace(curve_at(equations, fresh), conditions=old.conditions, weights=old.weights)
    most = max(March.first_steps, (place.mesh.size - 1) / old.equations.symmetry.fraction)  # of several turns, more
    steps = max(8, int(most * fraction / len(fresh.nodes)))
    fresh = replace(fresh, mesh=uniform(equations.symmetry.fraction, len(fresh.nodes), steps))
    return corrected(curve, fresh, _own_aim(old, place))
