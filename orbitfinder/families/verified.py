"""What is said of a family, checked: its events as they are met, and again from a file alone, with its ends and what a
point claims of the family."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from orbitfinder._runtime import interrupt
from orbitfinder._runtime.arguments import check
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.continuation.tests import levelled
from orbitfinder.errors import ConvergenceError, IntegrationError, plural
from orbitfinder.families.checks import ALIKE, Probe, Refuted, Sides, check_known
from orbitfinder.families.codimension_two import Critical
from orbitfinder.families.ends import (
    MEETING,
    SHRINKING,
    beside_shifts,
    changing,
    explosion,
    passed_again,
    self_excited,
    singularity,
)
from orbitfinder.families.entries import kind_of
from orbitfinder.families.minimal import dead_point
from orbitfinder.families.point import FamilySettings, extents, growth, parameter_value, unknowns_of
from orbitfinder.families.rest import can_rest, rest_of
from orbitfinder.families.run import portrait
from orbitfinder.families.saddles import (
    SLOW,
    held_up,
    homoclinic_limit,
    noise_of,
    saddle_node_limit,
    slowness,
    told_apart,
)
from orbitfinder.families.stability import spectrum
from orbitfinder.families.start import by_series, curve_in
from orbitfinder.integrate.equations import hamilton
from orbitfinder.integrate.field import vector_field
from orbitfinder.integrate.jets import at_rest
from orbitfinder.integrate.march import uniform
from orbitfinder.loops.condensed import Jacobian
from orbitfinder.loops.continued import (
    Curve,
    Solution,
    advanced,
    at_place,
    begun,
    correct,
    crossed,
    oriented,
    plane,
    scaled,
    tangent,
)
from orbitfinder.loops.mesh import fitted
from orbitfinder.loops.symmetry import named as symmetry_named
from orbitfinder.loops.symmetry import turned
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.model import energy as total_energy
from orbitfinder.mechanics.newton import equilibrium
from orbitfinder.orbits.evidence import gather, tour
from orbitfinder.orbits.floquet import judged
from orbitfinder.orbits.hybrid import PATIENCE, cycle_from
from orbitfinder.orbits.method import named
from orbitfinder.records.certificate import Certificate, Check, at_least, at_most, equal, refused, skipped
from orbitfinder.records.ends import end_fault
from orbitfinder.records.family import (
    AGAIN,
    AVOIDED,
    CLOSURE,
    DECIDED,
    UNKNOWN,
    Batch,
    End,
    Event,
    Family,
    FamilyPoint,
    Reading,
    number_of,
    reverted,
)
from orbitfinder.records.orbit import incomputable
from orbitfinder.records.reading import read_as

ROUNDED = 1e-12
"""Relative error of a number that follows from the state"""
SAME_STEP = 1e-6
"""... or this share of how much it changes in the step, if that is more"""
GROWN, SHARPER = 1.5, 1e-4
"""A family that ends homoclinic has a period this many times its shortest; recorded error bars are at least this share
of those found from an event's state alone, with which errors grow"""
SETTLED = 1e-6
"""Equilibria and eigenvalues at such an end are known to this, relative"""
SHARES = ((3e-3, 0), (3e-4, 0), (5e-2, 1), (2e-1, 1), (5e-1, 1), (1.0, 1))
"""How far the orbits on both sides are, in steps of the family, and whether there are others twice as far: the nearer
ones where two events share a step, the farthest where a parameter hardly moves beyond its round-off, as in a canard"""
STEPS = 480
"""Steps of a period on which an orbit is marched of which the nodes are not known"""


def reading(curve: Curve, event: Event, along: np.ndarray, step: float, parameter: str = "") -> Reading:
    """What the check of an event says; `along` (head) is the way the family goes there, `step` the arclength of a step,
    `parameter` what it is followed in.

    Raises `ConvergenceError` where it is not known well enough, `Refuted` where its definition is contradicted.
    """
    kind = kind_of(event.kind)
    if kind.second == (curve.test is None):
        raise ConvergenceError(f"a {event.kind} has no check on such a family")
    solution = settled_on(curve, event)
    curve = curve.measured(solution)
    whole = _heading(curve, solution, along)
    here, sides, said = Probe(curve, solution), None, Exception()
    slope = None if curve.test is not None or crossed(curve, solution) else solution.jacobian
    for share, outer in SHARES:
        try:
            shares = step * share * np.array([-2, -1, 0, 1, 2] if outer else [-1, 0, 1])
            looks = [Probe(curve, _corrected(curve, solution, whole, d, 0.5 * step, slope)) for d in shares]
            before, middle, after = looks[outer : len(looks) - outer]
            far = looks[:: len(looks) - 1] if outer else ()
            tried = Sides(before, here, middle, after, share * step, step, far, parameter, share == SHARES[-1][0])
            result = kind.check(tried, event)
            check(f"EventKind {event.kind!r}, check", "Reading", result)
        except (ConvergenceError, IntegrationError) as error:
            said = said if isinstance(said, Refuted) else error
            continue
        sides = tried
        if result.passed:
            break
    if sides is None:
        raise said
    if sides.outer and not (result.passed or sides.farthest):  # nothing farther could be corrected
        sides = replace(sides, farthest=True)
        result = kind.check(sides, event)
    return replace(result, criticality=kind.side(sides, event)) if result.passed else result


def _corrected(
    curve: Curve, solution: Solution, whole: np.ndarray, d: float, reach: float, slope: Jacobian | None
) -> Solution:
    """The orbit so much arclength from another; where its `slope` does not lead there, by the orbit's own."""
    given = curve, advanced(solution.place, whole, d), plane(curve, solution.place, whole, d), solution.place, reach
    try:
        return correct(*given, slope)
    except ConvergenceError:
        return correct(*given)


def settled_on(curve: Curve, event: Event | FamilyPoint) -> Solution:
    """The orbit of a point or event on the mesh that it was found on, or on one made for it from its state alone."""
    if event.mesh.size:
        return at_place(curve, unknowns_of(curve, event))
    arcs = curve.equations.links.count if curve.equations.links else 1
    mesh = uniform(curve.equations.symmetry.fraction, arcs, STEPS // arcs)
    nodes = event.state[None]
    if arcs > 1:  # where its arcs begin (arcs x d)
        model = with_parameters(curve.equations.model, event.free)
        nodes = np.array([arc.states[0] for arc in cycle_from(model, event.state, longest=PATIENCE * event.period)])
    return at_place(curve, fitted(curve, unknowns_of(curve, replace(event, shooting_nodes=nodes, mesh=mesh))))


def _heading(curve: Curve, solution: Solution, along: np.ndarray) -> np.ndarray:
    """The family's direction (over w) at an orbit: where another one crosses there, the nearest to `along` (head)."""
    if curve.test is not None:
        return tangent(curve, solution, along)
    matrix, units = scaled(curve, solution)
    _, sizes, rows = np.linalg.svd(matrix)
    # singular value, relative to the next, below which the rows leave two directions
    crossed = sizes[-1] < 1e-4 * sizes[-2:][0]
    left = units * rows[-2 if crossed else -1 :]
    sizes = np.concatenate([curve.scales.states, [curve.scales.period], curve.scales.free])
    heads = np.array([solution.place.head_of(direction) / sizes for direction in left])
    whole = np.linalg.lstsq(heads.T, along / sizes, rcond=None)[0] @ left
    return np.asarray(whole / np.sqrt(curve.scales.metric(solution.place) @ whole**2))


def checked(curve: Curve, batch: Batch, step: float, parameter: str, before: FamilyPoint | None = None) -> Batch:
    """A step of a family, after the point `before`, with those of its events that are what they are called; the log
    says what the others are: none, or unknown where no check decides or the stability is another on the two sides."""
    verdicts = [point.stability for point in (before, *batch.points) if point and point.stability in DECIDED]
    changes = 0 < verdicts.count("unstable") < len(verdicts)
    kept, undecided = list[Event](), list[str]()
    for event in batch.events:
        try:
            read = reading(curve, event, event.tangent, step, parameter)
            if read.passed:
                kept.append(replace(event, check=read))
                continue
            none, what = abs(read.value) > read.error, f"{read.value:.2g} where {read.error:.2g} is known"
        except (ConvergenceError, IntegrationError) as error:
            none, what = isinstance(error, Refuted), str(error)
        word, verdict = event.kind.replace("_", " "), "none" if none and not changes else "unknown"
        said = f"a{'n' * (word[0] in 'ei')} {word} was seen at {event.parameter:.12g} and is {verdict}: {what}"
        logging.getLogger(__name__).warning(said)
        undecided += [said] * (not none)
    return replace(batch, events=tuple(kept), undecided=tuple(undecided))


def verified(family: Family, model: Model) -> Iterator[tuple[str, Check]]:
    """Every event, every end and every watched number of a family in words, each with its check made again.

    Raises `InputError`.
    """
    if by_series(family.curve) and (again := named(str(family.curve["method"])).verify):
        yield from again(family, model)
        return
    # in the scales of the orbit that it began with
    curve, k = family_curve(family, model), int(np.argmin(np.abs(family.values("arclength"))))
    along = _head(family.points[k]) - _head(family.points[k - 1 if k else -1])
    curve = begun(curve, settled_on(curve, family.points[k]), along if along.any() else np.ones(along.size))[0]
    yield from verdicts(family, partial(_again, curve), range(len(family.points)))
    for k, event in enumerate(family.events):
        interrupt.check()
        yield f"event {k}, {family.parameter} {event.parameter:.12g}", _event(family, curve, event)
    for k, end in enumerate(family.ends):
        first = k == 0 and (len(family.ends) > 1 or family.points[-1].arclength == 0)
        at = family.points[0 if first else -1]
        try:
            if fault := end_fault(end, (event.kind for event in family.events)):
                raise ConvergenceError(f"{fault}; {AGAIN}")
            with np.errstate(all="ignore"):  # what overflows is no number, and fails its check
                known = SOLVED.get(end.kind, _happened)(family, curve, end, at)
        except (ConvergenceError, IntegrationError, ValueError, LookupError, TypeError, ArithmeticError) as error:
            known = refused(end.kind, error, np.nan)
        yield f"end {k}", known
    for name in dict.fromkeys(name for point in family.points for name in point.watch):
        yield f"watch.{name} of {plural(len(family.points), 'orbit')}", _column(family, curve, name)


def verdicts(family: Family, again: Callable[[FamilyPoint], str], some: Collection[int]) -> Iterator[tuple[str, Check]]:
    """The verdicts on stability of some points made `again`, and whether they change where events say so. Of a curve of
    special points, whose multiplier is on the circle, neither events nor what is marginal tell."""
    points, wrong, critical = family.points, "", "test" in family.curve
    for k in some:
        interrupt.check()
        try:
            word = again(points[k])
        except (ConvergenceError, IntegrationError) as error:
            word = str(error)
        if word != points[k].stability and not (critical and "marginal" in (word, points[k].stability)):
            wrong = f"point {k} is recorded as {points[k].stability}, computed: {word}"
            break
    yield f"stability of {plural(len(some), 'orbit')}", equal("verdicts", bool(wrong), 0.0, wrong)
    changes = Counter(event.index for event in family.events if kind_of(event.kind).verdict)
    for k, pair in enumerate(pairwise(point.stability for point in points)):
        known = not critical and not {"marginal", "undecided"} & {*pair}
        if known and pair.count("unstable") % 2 != changes[k] % 2:
            said = f"{pair[0]} and then {pair[1]}, with {plural(changes[k], 'stability change')} between them"
            yield f"points {k} and {k + 1}", (refused if changes[k] else skipped)("changes", said)


def _again(curve: Curve, point: FamilyPoint) -> str:
    """The verdict on a point by its nodes, or the recorded one where errors grow by too much for any."""
    solution = settled_on(curve, point)
    about = spectrum(curve, solution)
    lost = growth(curve, solution, about, extents(curve, solution.march.states)) > UNKNOWN
    return point.stability if lost else about.stability


def _column(family: Family, curve: Curve, name: str) -> Check:
    """A watched number of all orbits that are known well enough, where it is most wrong."""
    worst = at_most("watch", 0.0, 0.0)
    for k, one in enumerate(family.points):
        interrupt.check()
        known = _watch(curve, one, name)
        if one.scale > UNKNOWN and np.isnan(known.value) and name in curve.watch:  # nothing is known of its motion
            continue
        if not known.passed or known.value * worst.tolerance >= worst.value * known.tolerance:
            worst = replace(known, note=known.note or f"at point {k}")
        if not known.passed:
            break
    return worst


def _watch(curve: Curve, member: FamilyPoint | Event, name: str) -> Check:
    """A watched number of an orbit as recorded, against the motion gone round."""
    try:
        check_known(curve, name)
        look = Probe(curve, settled_on(curve, member))
        off, allowed = abs(look.watched[name] - member.watch.get(name, np.nan)), look.unsure[name]
    except (ConvergenceError, IntegrationError) as error:
        return refused("watch", error, np.nan)
    note = "" if off <= allowed else f"watch.{name} is {look.watched[name]:.15g}, recorded {member.watch.get(name)}"
    return at_most("watch", off, allowed, note)


def family_curve(family: Family, model: Model) -> Curve:
    """The curve that a family follows, with the test that it keeps."""
    curve = curve_in(family, model)
    if "test" not in family.curve:
        return curve
    return replace(curve, test=read_as(Critical, family.curve["test"], "curve.test", AGAIN))


def _event(family: Family, curve: Curve, event: Event) -> Check:
    try:
        before, after = _neighbours(family, event)
        here = Probe(curve, settled_on(curve, _alone(event)))  # whose numbers are those of its state
        for name, value, moved in ((family.parameter, event.parameter, after.value - before.value),
                                   ("energy", event.energy, after.energy - before.energy)):  # fmt: skip
            there = here.value(name)
            if np.isfinite(there) and abs(there - value) > ROUNDED * abs(there) + SAME_STEP * abs(moved):
                raise ConvergenceError(f"{name} is {there:.15g} there, recorded {value:.15g}")
        if event.symmetry != curve.equations.symmetry.name:
            raise ConvergenceError(f"symmetry {event.symmetry} is not the family's")
        for name in {**family.curve.get("watch", {}), **event.watch}:
            if not (known := _watch(curve, _alone(event), name)).passed:
                raise ConvergenceError(known.note)
        along, old = _head(after) - _head(before), event.check
        event, along = reverted(event), along if event.arclength >= 0 else -along  # as it was followed
        if event.gap is not None and curve.test is None:  # avoided: crossed or followed, as it says, from its own side
            members = (before, event, after)[:: 1 if event.arclength >= 0 else -1]
            orbits = [settled_on(curve, _alone(each)) for each in members]
            first, middle, last = (oriented(curve, each, tangent(curve, each, along)) for each in orbits)
            if first != middle:
                raise ConvergenceError("the orbit is the other family's")
            if event.detail != AVOIDED[first != last]:
                raise ConvergenceError(f"it was {AVOIDED[first != last]}")
        step = after.arclength - before.arclength
        read = partial(reading, curve, along=along, step=step, parameter=family.parameter)
        try:
            again = read(_alone(event))
        except (ConvergenceError, IntegrationError):
            if not event.mesh.size:
                raise
            again = Reading(np.nan, np.nan, False)
        if not again.passed and event.mesh.size and np.array_equal(event.state, event.shooting_nodes[0]):
            again = read(event)  # of an orbit that is lost from its start alone what its nodes say, which join
        if old is not None and not (old.passed and abs(old.value - again.value) <= old.error + again.error):
            raise ConvergenceError(f"recorded as {old.value:.3g} +- {old.error:.1g}, found {again.value:.3g}")
        if old is not None and old.criticality and old.criticality != again.criticality:
            raise ConvergenceError(f"recorded as {old.criticality}, found {again.criticality or 'neither'}")
        sharper = _too_sharp(event, again)
        if sharper and event.mesh.size:  # by its nodes it is known better than by its state alone
            sharper = _too_sharp(event, read(event))
        if sharper:
            raise ConvergenceError(sharper)
    except (ConvergenceError, IntegrationError) as error:
        return refused(event.kind, error, np.nan)
    return at_most(event.kind, abs(again.value), again.error, event.detail, again.passed)


def _too_sharp(event: Event, again: Reading) -> str:
    """What is wrong with the error bars of an event read again, or nothing."""
    read = again.error, event.check.error if event.check else None
    for now, told in (read, (again.parameter_error, event.error), (again.period_error, event.period_error)):
        if now is not None and told is not None and not told >= SHARPER * now:
            return f"an error bar is recorded as {told:.1g}, found {now:.1g}"
    return ""


def _alone(member: Any) -> Any:
    """A point or event as its state says it, without what a file beside it says."""
    nothing = np.zeros(0)
    return replace(member, shooting_nodes=nothing.reshape(0, 0), mesh=nothing, tangent=nothing)


def _head(member: FamilyPoint) -> np.ndarray:
    return np.array([*member.state, member.period, *member.free.values()])


def _neighbours(family: Family, event: Event) -> tuple[FamilyPoint, FamilyPoint]:
    """The points between which an event is."""
    k = min(max(event.index, 0), len(family.points) - 2)
    if k < 0 or abs(event.index - k) > 1:  # it may be beyond the last one, where the family ends
        raise ConvergenceError(f"there is no step {event.index} in which it could be")
    before, after = family.points[k], family.points[k + 1]
    if event.index == k and not before.arclength <= event.arclength <= after.arclength:
        raise ConvergenceError(f"arclength {event.arclength:.9g} is not in step {event.index}")
    return before, after


def _steps(family: Family, at: FamilyPoint) -> list[FamilyPoint]:
    """The steps from a family's first orbit to the point at which it ends, in this order."""
    side = float(np.sign(at.arclength))
    members = [point for point in family.points if point.role == "step" and side * point.arclength >= 0]
    return sorted(members, key=lambda point: side * point.arclength) if side else [at]


def _happened(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """An event of the end's kind is at the last point or beyond."""
    if not curve.equations.links and curve.test is None:
        raise ConvergenceError(f"a family of smooth motions in a parameter does not end in {end.kind}")
    there = [(event.kind, event.arclength * at.arclength >= at.arclength**2) for event in family.events]
    if (end.kind, True) in there:
        return equal(end.kind, 0.0, 0.0, "its event is recorded")
    return skipped(end.kind, "its event is not recorded")


def _limited(family: Family, _: Curve, end: End, at: FamilyPoint) -> Check:
    """There are as many steps as its sentence says."""
    return at_least(end.kind, len(_steps(family, at)) - 1, int(end.reason.partition(" ")[0]), end.reason)


def _failed(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The last orbit has nothing of what a family ends in otherwise."""
    orbit, model = settled_on(curve, at), curve.equations.model
    share, shortest = slowness(curve, orbit)[0], min(point.period for point in _steps(family, at))
    dead = dead_point(model, orbit.march.states, at.free)
    if dead and at.period < FamilySettings.longest_period * shortest:
        raise ConvergenceError(f"{dead}, where families end in a dead point")
    if at.period > SLOW.grown * shortest and share > SLOW.grown_share:
        if not model.forced and held_up(curve, orbit):
            raise ConvergenceError("its period has grown beside a saddle, where families end homoclinic")
    elif not self_excited(curve) and (met := singularity(curve, orbit, end.reason)):
        raise ConvergenceError(met.reason)
    return skipped(end.kind, f"a step that failed is not tried again ({end.reason})")


def _singular(_: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The motion is somewhere so much faster than elsewhere, and its coordinates do not end there."""
    orbit = settled_on(curve, at)
    dead = dead_point(curve.equations.model, orbit.march.states, at.free)
    return equal(end.kind, bool(dead) or singularity(curve, orbit, "") is None, 0.0, end.reason)


def _dead(_: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The coordinates of a mechanism end where the orbit goes."""
    states = settled_on(curve, at).march.states
    return equal(end.kind, not dead_point(curve.equations.model, states, at.free), 0.0, end.reason)


def _canard(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """Orbits change along the last steps, and the parameter hardly does, by what is said."""
    if not self_excited(curve):
        raise ConvergenceError("a family of motions that keep an energy, or are driven, has no canard")
    steps = _steps(family, at)
    first, width = explosion(np.array([point.value for point in steps]))
    rows = [[point.period, *portrait(curve, settled_on(curve, point))[-point.state.size :]] for point in steps[first:]]
    if len(rows) < MEETING.fewest or changing(np.array(rows)) < SHRINKING.explosion:
        raise ConvergenceError("the last orbits at this parameter are too few, or alike")
    told, known = np.array([end.parameter, end.period, end.error]), np.array([at.value, at.period, width])
    rounded = np.array([abs(at.value), at.period, abs(at.value) + width])
    return at_most(end.kind, (np.abs(told - known) / rounded).max(), ROUNDED, "parameter, period, width")


def _returned(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The last step passes an earlier orbit of the family again, as where the family was closed."""
    steps = _steps(family, at)
    first, last = (settled_on(curve, point) for point in steps[-2:])
    numbers = np.array([[point.period, *point.free.values(), point.action] for point in steps])
    gaps = (numbers - numbers[-2]) / nonzero(np.ptp(numbers, axis=0))
    square = nonzero(float(gaps[-1] @ gaps[-1]))
    shares = gaps @ gaps[-1] / square
    aside = ((gaps - shares[:, None] * gaps[-1]) ** 2).sum(axis=1)
    near = (np.abs(shares - 0.5) <= 0.5 + SAME_STEP) & (aside <= square)
    for k in np.flatnonzero(near[: -MEETING.fewest]):
        if passed_again(curve, first, last, portrait(curve, settled_on(curve, steps[k]))):
            return equal(end.kind, 0.0, 0.0, f"step {k} is passed again")
    raise ConvergenceError("its last step passes no earlier orbit again")


def _steady(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The orbits, beside what they shift by, have become smaller."""
    if not (relative := curve.equations.symmetry.relative):
        raise ConvergenceError("the family's orbits shift in nothing")
    paths = [beside_shifts(settled_on(curve, point).march.states, relative) for point in _steps(family, at)[-2:]]
    sizes = [float((np.ptp(path, axis=0) / extents(curve, paths[0])).max()) for path in paths]
    return at_most(end.kind, sizes[-1] / sizes[0], 1.0, "extent over that of the orbit before", len(sizes) > 1)


def _target(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The first or the last orbit has what was asked for."""
    wanted = float(end.reason.rpartition("=")[2]) if end.parameter is None else float(end.parameter)
    if (number := end.reason.removeprefix("reached ").rpartition(" = ")[0]) in at.watch:
        return replace(_watch(curve, replace(at, watch={number: wanted}), number), name=end.kind)
    off = abs(number_of(at, family.parameter) - wanted)
    size = max(abs(wanted), float(np.abs(family.values("value")).max()))
    return at_most(end.kind, off, ROUNDED * size, end.reason, number == family.parameter)


def _blown_up(node: bool, many: bool, family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The period has grown; what orbits come near are equilibria (a saddle-`node`, or `many`) with these eigenvalues
    at the parameter, to which the family's own orbits go."""
    grown, orbit = at.period / float(family.values("period").min()), settled_on(curve, at)
    if not end.saddles and not held_up(curve, orbit):
        raise ConvergenceError("the orbit is slowest near no saddle that it passes")
    states = [np.array(saddle["state"], float) for saddle in end.saddles or ()]
    apart = len(told_apart(curve, orbit, [(state, np.zeros(0)) for state in states]))
    if (end.saddles is None) != (end.parameter is None):
        raise ConvergenceError("saddles, parameter: neither is there without the other")
    if end.saddles is not None and min(apart, 2) != 1 + many:
        raise ConvergenceError(f"saddles: {apart} different ones, which no {end.kind} end has")
    off, free = [GROWN / grown], dict(at.free)
    if node and family.parameter not in free:
        raise ConvergenceError(f"in its {family.parameter} no family ends where equilibria are born")
    if states:
        value, error, period = (float(getattr(end, name)) for name in ("parameter", "error", "period"))
        off.append(abs(period / at.period - 1.0) / ROUNDED)
        limit = _limit(node, family, curve, end, at)
        off += [abs(limit[0] - value) / (limit[1] + error), 0.0 if node else SHARPER * limit[1] / nonzero(error)]
        free |= {name: value for name in free if name == family.parameter}
    for saddle in end.saddles or ():
        x, moving, rest, slopes = _at_rest(with_parameters(curve.equations.model, free), np.array(saddle["state"]))
        told = np.array(saddle["eigenvalues"]) @ [1, 1j]
        gaps = np.abs(np.linalg.eigvals(slopes)[:, None] - told)
        off += [moving / SETTLED, float(np.abs(rest - x).max()) / (SETTLED * max(1.0, float(np.abs(x).max()))),
                float(gaps[linear_sum_assignment(gaps)].max()) / (SETTLED * float(np.abs(told).max()))]  # fmt: skip
    return at_most(end.kind, np.max(off), 1.0, "of the period's growth, the saddles and the parameter, the most wrong")


def _limit(node: bool, family: Family, curve: Curve, end: End, at: FamilyPoint) -> tuple[float, float]:
    """The parameter to which a family's own orbits go, and its error; of an energy that of the saddle."""
    orbit, name, saddles = settled_on(curve, at), family.parameter, end.saddles or ()
    if name not in at.free:
        there = replace(orbit.place, nodes=np.array(saddles[0]["state"], float)[None])
        value = parameter_value(curve, there, name)
        return value, ROUNDED * max(abs(value), abs(at.value))
    step = 1 if at is family.points[-1] else -1
    periods, values = family.values("period")[::step], family.values("value")[::step]
    known = [np.array(saddle["eigenvalues"]) @ [1, 1j] for saddle in saddles]
    noise = noise_of(curve, orbit, name)
    limit = saddle_node_limit(periods, values, noise) if node else homoclinic_limit(periods, values, known, noise)
    return limit[:2]


def _at_rest(model: Model, state: np.ndarray) -> tuple[np.ndarray, float, np.ndarray, np.ndarray]:
    """A state in the coordinates of canonical equations, without its velocities, the largest of these, the equilibrium
    near it, and the slopes of the rates there."""
    equations = hamilton(model)
    variational, y, moving = vector_field(equations.variational), state[equations.coordinates.chosen], 0.0
    if model.rates is None:
        moving = float(np.abs(y[equations.coordinates.size :]).max())
        y[equations.coordinates.size :] = 0.0

    def linearised(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        varied = variational(0.0, np.concatenate([y, np.eye(y.size).ravel(), [0.0]]))
        return varied[: y.size], varied[y.size : -1].reshape(y.size, y.size, order="F")

    rest = equilibrium(linearised, y, max(1.0, float(np.abs(y).max()))).w
    return y, moving, rest, linearised(rest)[1]


def _rest(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The equilibrium that orbits shrink to has a linear oscillation of their period."""
    if abs(at.action) > min(abs(point.action) for point in _steps(family, at)[-MEETING.fewest :]):
        raise ConvergenceError("the orbits do not shrink")
    value, period = end.parameter, end.period
    free = dict(at.free) | ({family.parameter: value} if value is not None and family.parameter in at.free else {})
    model, there = (with_parameters(curve.equations.model, values) for values in (free, at.free))
    states = gather(there, at.state, at.period, turned(model, np.array(curve.turns), at.shift)).states
    y, _, rest, slopes = _at_rest(model, 0.5 * (states.max(axis=0) + states.min(axis=0)))
    if model.rates is not None and model.invariants:  # those that change there keep the values of the orbit
        jets = at_rest(model, (), rest)
        kept, z = jets.kept_at(states[0]), np.append(rest, np.zeros(jets.extra))

        def held(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            whole = jets.first(z, np.zeros(0), kept)
            return whole[0], whole[1:].T

        slopes = held(equilibrium(held, z, max(1.0, float(np.abs(y).max()))).w)[1][: y.size, : y.size]
    turning = np.abs(np.linalg.eigvals(slopes).imag)
    # an orbit beside an equilibrium has the period of its linear oscillation to this share
    wanted, allowed = (period, 1e-6) if period is not None else (at.period, 1e-2)
    off = float(np.abs(turning * wanted / (2 * np.pi) - 1.0).min())
    if value is not None and can_rest(curve):
        still, error = rest_of(curve, settled_on(curve, at), family.parameter), float(end.error or 0.0)
        if still is None or not abs(still.value - value) <= error + still.error + ROUNDED * abs(value):
            what = "no oscillation" if still is None else f"an oscillation at {family.parameter} {still.value:.15g}"
            raise ConvergenceError(f"there is {what}, recorded is {value:.15g}")
        if not error >= SHARPER * still.error:
            raise ConvergenceError(f"an error bar is recorded as {error:.1g}, and is {still.error:.1g}")
    return at_most(end.kind, off, allowed, "period over that of the linear oscillation, less 1")


def _joined(family: Family, curve: Curve, end: End, at: FamilyPoint) -> Check:
    """The orbit of the family that is joined closes, the family's period is so many of its own, and so many times round
    a multiplier is +1, beside what is trivial: there is where another family leaves."""
    if end.joined is None:
        if curve.equations.links:
            return skipped(end.kind, "of hybrid orbits the family that is joined is not recorded")
        raise ConvergenceError(f"joined: missing, the family that is joined; {AGAIN}")
    joined: Mapping[str, Any] = end.joined
    model = with_parameters(curve.equations.model, joined.get("free", {}))
    state, period, turns = np.array(joined["state"], float), float(joined["period"]), np.array(joined["winding"])
    whole_period, times = float(end.period or period), round(float(end.period or period) / period)
    if fault := incomputable(np.append(state, turns), min(period, whole_period)):
        raise ConvergenceError(f"joined.{fault}")
    if not abs(whole_period / at.period - 1) < 0.5:
        raise ConvergenceError(f"period: {whole_period:.9g}, of the family's last orbit {at.period:.9g}")
    symmetry_named(joined["symmetry"], model)
    numbers = {"energy": total_energy(model, state), "period": whole_period, **joined.get("free", {})}
    for told, name in ((end.parameter, family.parameter), (joined.get("energy"), "energy")):
        value = numbers.get(name, np.nan)
        if told is not None and not abs(value - told) <= ROUNDED * abs(value) + float(end.error or 0.0):
            raise ConvergenceError(f"{name} is {value:.15g} of the orbit that is joined, recorded {told:.15g}")
    lap = tour(model, state, period, turned(model, turns, joined.get("shift", {})))
    values = lap.multipliers() ** times
    roots = judged(values).indices if lap.conservative else values
    off = abs(levelled(roots, 2.0 if lap.conservative else 1.0))
    gap, apart = lap.closes.gap / (CLOSURE * lap.closes.amplification), abs(times * period / whole_period - 1)
    return at_most(end.kind, max(off, apart), ALIKE, end.reason, gap <= 1.0)


SOLVED: dict[str, Callable[[Family, Curve, End, FamilyPoint], Check]] = {
    "target": _target, "equilibrium": _rest, "hopf": _rest, "merged": _joined,
    "homoclinic": partial(_blown_up, False, False), "heteroclinic": partial(_blown_up, False, True),
    "saddle-node": partial(_blown_up, True, False),
    "returned": _returned, "point limit": _limited, "relative equilibrium": _steady, "canard": _canard,
    "singularity": _singular, "dead point": _dead, "step underflow": _failed,
}  # fmt: skip
"""The checks of what is met at an end, by its kind; other kinds are those of events"""


def point_checks(family: Family, number: int, certificate: Certificate, model: Model) -> Certificate:
    """The certificate of a point of a family, with checks of what it claims besides an orbit."""
    point = family.points[number]
    if not family.curve:
        return certificate
    if by_series(family.curve):
        off = abs(point.value - point.free.get(family.parameter, np.nan))
        return Certificate((*certificate.checks, at_most("value", off, 0.0, f"of {family.parameter}")),
                           certificate.scale, certificate.closure)  # fmt: skip
    curve = family_curve(family, model)
    look = Probe(curve, settled_on(curve, point))
    value = look.value(family.parameter)
    off = abs(point.value - value) / abs(value) if value else abs(point.value)
    root = 1 if curve.equations.symmetry.forward is None else 2
    checks = [
        at_most("value", off, ROUNDED, f"of {family.parameter}"),
        equal("root", point.root, root, "of the map that indices are of"),
        *(replace(_watch(curve, point, name), name=f"watch.{name}") for name in point.watch),
    ]
    grown = growth(curve, look.solution, spectrum(curve, look.solution), extents(curve, look.solution.march.states))
    if grown <= UNKNOWN:  # whatever the record says of that
        try:
            about, apart, here = look.about, np.inf, point.indices
            wanted = about.roots if about.conservative else np.zeros(0)
            if wanted.shape == here.shape:
                gaps = np.abs(here[:, None] - wanted) / np.maximum(1.0, np.abs(wanted))
                apart = float(gaps[linear_sum_assignment(gaps)].max(initial=0.0))
            checks.append(at_most("indices", apart, ALIKE + 1e-12 * grown, "recorded - recomputed, relative"))
            signs = look.tour.krein(point.floquet_multipliers)
            own = point.krein or (0,) * len(signs)  # none are recorded of a gait
            alike = len(signs) == len(own) and all(a == b or not sure for (a, sure), b in zip(signs, own, strict=True))
            checks.append(equal("krein", not alike, 0.0, "signatures of multipliers on the unit circle"))
        except (ConvergenceError, IntegrationError) as error:
            checks.append(refused("indices", error))
    return Certificate((*certificate.checks, *checks), certificate.scale, certificate.closure)
