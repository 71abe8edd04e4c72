"""Whether an event is what it is called: its definition at its orbit and at one on each side of it.

All three are gone round by the certificate's integrator and formulation (`orbits.evidence.tour`). What is read there is
regular where the event is: the product of level - root over all roots, which are stability indices kappa = mu + 1/mu
where multipliers come in pairs (mu itself moves like a square root there), else multipliers; the squared distance of
two indices; the product of a pair less 1; what is extremal; a margin of a hybrid cycle. It must vanish at the event, to
`SHARP` of a step, and change its sign across it; a kind may ask for more. Which check is whose stands in `entries`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from orbitfinder._runtime.arguments import check
from orbitfinder._runtime.sizes import EPSILON, nonzero
from orbitfinder.continuation.tests import discriminant, index_levels, levelled, multiplier_levels, unit_pair
from orbitfinder.errors import ConvergenceError, IntegrationError
from orbitfinder.families.changes import margins_called
from orbitfinder.families.codimension_two import Critical, is_centre
from orbitfinder.families.doubling import bending, born
from orbitfinder.families.motion import parameters_at
from orbitfinder.families.point import extents, freed, parameter_value, shift_at
from orbitfinder.families.registry import KINDS
from orbitfinder.integrate.dop853 import TIGHTEST, ReferenceSettings
from orbitfinder.loops.condensed import CUTOFF
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import CORRECTOR, Curve, Solution, avoided_crossing, correct, crossed, plane
from orbitfinder.loops.loop import ROUND_OFF
from orbitfinder.loops.symmetry import turned
from orbitfinder.loops.watch import arcs, numbers, unsure
from orbitfinder.mechanics.kind import with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.evidence import COARSER, VARIED, ClosureCheck, Tour, tour
from orbitfinder.orbits.floquet import ERROR_FLOOR, judged, outside
from orbitfinder.orbits.hybrid import hybrid_tour, retraced
from orbitfinder.records.family import BECOMES, CLOSURE, UNKNOWN, Event, Reading

SHARP, SAME_GAP = 1e-5, 1e-2
"""An event is this near to where its definition holds, in steps of the family; an avoided crossing, whose place is that
of a metric, in shares of its gap"""
DOUBTFUL = 4e-5
"""... and what is read there is known this well"""
DRAWS, SAFETY = 3, 10.0
"""Errors of the size of the integration's with which the map is read again, and what their largest is multiplied by"""
TOLERANCES = VARIED, COARSER, ReferenceSettings(relative_tolerance=1e-11, absolute_tolerance=1e-12)
"""At which variations are integrated, one after the other: where rates are 0 / 0, as Hodgkin and Huxley's are at two
voltages, their round-off may leave no step that is short enough for the first"""
ALIKE = 1e-6
"""Multipliers nearer than this are one"""
WIDER, SURE = 8, 64.0
"""How often a parameter's turn is looked for half as far again, up to 25 times as far, and the round-offs by which it
turns: in the steepest canards it is off by up to 13"""

Measure = Callable[["Probe"], float]


class Refuted(ConvergenceError):
    """An event is not what it is called, and not only unknown."""


@dataclass(frozen=True)
class MapRoots:
    """The multipliers of a root map (as of `Spectrum`), each of which is a root that bifurcations are read from."""

    root_multipliers: np.ndarray
    root: int
    unit: ClassVar[float] = 1.0
    """the root of a multiplier that is 1"""
    conservative: ClassVar[bool] = False

    @cached_property
    def roots(self) -> np.ndarray:
        """What bifurcations are read from."""
        return self.root_multipliers

    @property
    def indices(self) -> np.ndarray:
        """The same by their name in `Spectrum`."""
        return self.roots

    @property
    def sizes(self) -> np.ndarray:
        """How far out each root is, `unit` on the unit circle."""
        return np.asarray(np.abs(self.roots))

    @property
    def pair(self) -> tuple[float, float]:
        """Product and sum of the two that leave the unit circle together; nan where none do."""
        return unit_pair(self.roots)[:2]

    @property
    def others(self) -> Sequence[Measure]:
        """What vanishes beside levels of single roots where the verdict changes."""
        return [_pair] if np.any(np.abs(self.roots.imag) > ALIKE) else []

    def levels(self, most: int) -> Iterable[tuple[float, str, str, int, complex]]:
        """Those at which bifurcations are, of resonances up to this order."""
        del most
        return multiplier_levels(self.root)


class PairedRoots(MapRoots):
    """The same of reciprocal pairs, whose roots are stability indices."""

    unit, conservative = 2.0, True

    @cached_property
    def roots(self) -> np.ndarray:
        """The indices."""
        return judged(self.root_multipliers).indices

    @property
    def sizes(self) -> np.ndarray:
        """How far out each index is."""
        return 2.0 + outside(self.roots)

    @property
    def pair(self) -> tuple[float, float]:
        """Two pairs leave the unit circle by their indices."""
        return np.nan, np.nan

    @property
    def others(self) -> Sequence[Measure]:
        """Two indices meet."""
        return [_meeting] if self.roots.size > 1 else []

    def levels(self, most: int) -> Iterable[tuple[float, str, str, int, complex]]:
        """Those of indices."""
        return index_levels(self.root, most)


@dataclass(frozen=True)
class Probe:
    """An orbit of a family and what the certificate's integrator reads there."""

    curve: Curve
    solution: Solution

    @cached_property
    def tour(self) -> Tour:
        """The loop gone round. Raises `ConvergenceError` where it is not known well enough."""
        lap = self._gone[0]
        if not lap.closes.amplification <= UNKNOWN or not lap.closes.gap <= CLOSURE * lap.closes.amplification:
            raise ConvergenceError(
                f"the orbit closes to {lap.closes.gap:.2g} where errors grow {lap.closes.amplification:.3g} times, "
                "which is too little to tell multipliers"
            )
        return lap

    @cached_property
    def _gone(self) -> tuple[Tour, ReferenceSettings]:
        """The same, and at which of `TOLERANCES`: at the first at which a step can be made."""
        if self.curve.equations.links:
            return hybrid_tour(*self._start), TOLERANCES[-1]
        for settings in TOLERANCES[:-1]:
            with suppress(IntegrationError):
                return self._round(settings), settings
        return self._round(TOLERANCES[-1]), TOLERANCES[-1]

    @property
    def _start(self) -> tuple[Model, np.ndarray, float, np.ndarray]:
        """Model, state, period and whole turns."""
        p, w = self.curve.equations, self.solution.place
        turns = turned(p.model, np.array(self.curve.turns), shift_at(self.curve, w))
        return with_parameters(p.model, freed(self.curve, w)), w.nodes[0], w.period, turns

    def _round(self, varied: ReferenceSettings) -> Tour:
        p, w = self.curve.equations, self.solution.place
        states, still = self.solution.march.states, self.solution.stepped < CORRECTOR.unmoved
        states = states if still else p.march.states(w.nodes, w.mesh, w.tail)  # those of before the last step
        beside = p.symmetry.whole(w.mesh, states, self.curve.constant)
        return tour(*self._start, p.symmetry.forward, beside, varied)

    @cached_property
    def about(self) -> MapRoots:
        """What is read off the root map."""
        return self._read(self.tour.multipliers())

    @cached_property
    def doubted(self) -> list[MapRoots]:
        """The same of maps as wrong as the integration may be. Raises `ConvergenceError` where they are more so."""
        missed, known = self.tour.divergence()
        if not missed <= known + ALIKE:
            raise ConvergenceError(f"its multipliers miss the divergence of the flow by exp({missed:.2g})")
        random = np.random.default_rng(0)
        return [self._read(self.tour.multipliers(random, self._gone[1].relative_tolerance)) for _ in range(DRAWS)]

    @cached_property
    def coarser(self) -> MapRoots:
        """The same at ten times the tolerance, which is off by more than the map is."""
        settings = self._gone[1]
        coarser = ReferenceSettings(10 * settings.relative_tolerance, 10 * settings.absolute_tolerance)
        return self._read(self._round(coarser).multipliers())

    def _read(self, values: np.ndarray) -> MapRoots:
        return (PairedRoots if self.tour.conservative else MapRoots)(values, self.tour.root)

    @property
    def multipliers(self) -> np.ndarray:
        """The non-trivial multipliers of the period; `about.root_multipliers` are those of the root map."""
        return np.asarray(self.about.root_multipliers**self.about.root)

    @property
    def unstable(self) -> bool:
        """Whether a multiplier is outside the unit circle."""
        return judged(self.about.root_multipliers, self.about.conservative).stability == "unstable"

    def beyond(self, level: float) -> bool:
        """The same where a root passes a level, however near to it that root still is: beyond is beyond."""
        roots, nearest = self.about.roots, int(np.argmin(np.abs(self.about.roots - level)))
        outside = np.delete(self.about.sizes, nearest) > abs(level) + ERROR_FLOOR
        return bool((roots[nearest].real - level) * np.sign(level) > 0 or np.any(outside))

    def value(self, name: str) -> float:
        """The energy, the period, a momentum, a parameter, or a watched number of the motion gone round."""
        if name in self.curve.watch:
            return self.watched[name]
        return parameter_value(self.curve, self.solution.place, name)

    @cached_property
    def watched(self) -> dict[str, float]:
        """The watched numbers of the motion gone round."""
        return self._numbers(*self.tour.motion)

    @cached_property
    def unsure(self) -> dict[str, float]:
        """How well they are known: by motions as wrong as an orbit may be, and with half as many samples."""
        times, states = self.tour.motion
        few = np.concatenate([np.union1d(range(arc.start, arc.stop, 2), arc.stop - 1) for arc in arcs(times)])
        parameters, half = parameters_at(self.curve, self.solution.place), self._numbers(times[few], states[few])
        wrong = unsure(self.curve.watch, times, states, parameters, CLOSURE + self.tour.closes.gap)
        return {name: abs(half[name] - value) + SAFETY * wrong[name] for name, value in self.watched.items()}

    def _numbers(self, times: np.ndarray, states: np.ndarray) -> dict[str, float]:
        return numbers(self.curve.watch, times, states, parameters_at(self.curve, self.solution.place))


@dataclass(frozen=True)
class Sides:
    """The orbit of an event with one on each side, so far `apart` along the family, whose steps are `step` long.

    `middle` is the event's orbit corrected as those on the sides are, so that its quantities compare with theirs.
    """

    before: Probe
    here: Probe
    middle: Probe
    after: Probe
    apart: float
    step: float
    outer: Sequence[Probe] = ()
    """the orbits twice as far on both sides, where a parabola through the nearer ones is not enough"""
    parameter: str = ""
    """what the family is followed in"""
    farthest: bool = False
    """whether none are farther"""

    def zero(self, measure: Measure, sharp: bool = True, within: float = SHARP) -> Reading:
        """What a measure says: it is to vanish here, `within` so much of a step, and to change its sign, if it is
        `sharp` to tell where."""
        low, value, high = measure(self.before), measure(self.here), measure(self.after)
        check("Sides.zero, value of its measure", "float", value)
        slope = abs(high - low) * self.step / (2 * self.apart)
        noise, most = 0.0, DOUBTFUL * slope if sharp else min(abs(low), abs(high))
        if self.here.__dict__.get("tour"):
            doubted = [_as(self.here, about) for about in self.here.doubted]
            noise = max(SAFETY * abs(measure(each) - value) for each in doubted)
            if noise > most and not self.here.curve.equations.links:  # told by how far all other readings of it are
                again = (_as(self.here, self.here.coarser), self.middle, *doubted)
                noise = max(abs(measure(each) - value) for each in again)
        sure = low * high < 0 and noise <= most
        error = noise + within * slope
        # one that is not here is somewhere between the two where the sign changes
        read = Reading(value, max(error, abs(value) * (low * high < 0)), bool(sure and abs(value) <= error))
        return self._barred(read, (abs(value) + noise) * self.step / nonzero(slope))

    def _barred(self, read: Reading, off: float) -> Reading:
        """What was read with error bars of the parameter and the period, the event being so much arclength `off`.

        At a fold the parameter is stationary, and all that is left of it is what the orbit itself is off.
        """
        if not (read.passed and self.across.size):
            return read
        curve, w = self.here.curve, self.here.solution.place
        off += float(np.sqrt(curve.scales.metric(w) @ self.across**2))
        bars = []
        for name in (self.parameter or curve.equations.parameter, "period"):
            low, middle, high = self.values(name)
            slope, bend = (high - low) / (2 * self.apart), (high - 2 * middle + low) / self.apart**2
            of_orbit = np.abs(curve.slopes(w, (pinned(curve.equations, name, middle),))[0]) @ self.across
            bars.append(float(of_orbit + abs(slope) * off + 0.5 * abs(bend) * off**2 + ROUND_OFF * abs(middle)))
        return replace(read, parameter_error=bars[0], period_error=bars[1])

    @cached_property
    def across(self) -> np.ndarray:
        """How far the event's orbit (over w) may be off in the plane normal to the family; empty where nothing says.

        |J^-1| (|r| + e), J the Jacobian of all rows, r what they are by the certificate's integrator and e the errors
        of that. Where another family crosses J has no inverse along it, nor has the event moved by what is off there.
        """
        curve, solution = self.here.curve, self.here.solution
        p, w = curve.equations, solution.place
        along = self.before.solution.place.displacement(self.after.solution.place)
        if p.links or curve.test is not None or along is None:
            return np.zeros(0)
        aim, columns = plane(curve, w, along), curve.scales.columns(w)
        states, durations = solution.march.states, np.diff(w.edges) * w.period
        try:
            ends = ClosureCheck(p.model, p.by.stiff).ends(w.nodes, durations, freed(curve, w), extents(curve, states))
        except IntegrationError:
            return np.zeros(0)
        matrix = np.vstack([solution.matrix, curve.slopes(w, (aim,))]) * columns
        sizes = nonzero(np.linalg.norm(matrix, axis=1))
        left, values, right = np.linalg.svd(matrix / sizes[:, None])
        count = int((values > CUTOFF * values[0]).sum()) - self.crossed
        inverse = columns[:, None] * (right[:count].T / values[:count]) @ left[:, :count].T / sizes
        missed = [curve.through(w).rows(w, ends + error, aim) for error in (0.0, TIGHTEST.relative_tolerance * ends)]
        return np.asarray(np.abs(inverse) @ (np.abs(missed[0]) + np.abs(missed[1] - missed[0])))

    @cached_property
    def crossed(self) -> bool:
        """Whether another family crosses at the event."""
        return crossed(self.here.curve, self.here.solution)

    def values(self, name: str) -> tuple[float, float, float]:
        """A quantity before, at and after the event."""
        return self.before.value(name), self.middle.value(name), self.after.value(name)

    def turning(self, name: str) -> Reading:
        """How far from where a quantity is extremal, in steps.

        It is known as well as on both sides, if the orbit is the family's and closes: how far one is from another of
        the same parameter says nothing where that turns.
        """
        low, middle, high = self.values(name)
        bent, size = high - 2 * middle + low, max(abs(low), abs(high))
        own, *beside = (probe.tour.closes for probe in (self.here, self.before, self.after))
        known = own.gap / own.amplification + max(closes.across for closes in beside)
        off = size * (4 * EPSILON + known) + abs(self.here.value(name) - middle)
        if not (low - middle) * (high - middle) > 0:
            return Reading(1.0, SHARP, False)
        scale = self.apart / (self.step * abs(bent))
        rise, noise = 0.5 * (high - low), off * scale
        if self.outer:
            first, last = (probe.value(name) for probe in self.outer)
            rise, noise = (8 * (high - low) - (last - first)) / 12, 1.5 * noise
        value = -rise * scale * float(np.sign(bent))
        error = noise + SHARP
        read = Reading(float(value), float(error), bool(abs(value) <= error and noise <= DOUBTFUL))
        return self._barred(read, (abs(value) + noise) * self.step)

    def turns(self, name: str, rounded: float = 8.0) -> bool:
        """Whether a quantity is, beyond so many round-offs, on one side of what it is here on both sides."""
        low, middle, high = self.values(name)
        known = rounded * EPSILON * abs(middle)
        return bool(min(low - middle, high - middle) > known or max(low - middle, high - middle) < -known)

    def passes(self, name: str) -> bool:
        """Whether a quantity goes on, beyond round-off."""
        low, middle, high = self.values(name)
        known = 8 * EPSILON * abs(middle)
        return bool((low - middle) * (middle - high) > 0 and min(abs(low - middle), abs(high - middle)) > known)

    def wider(self) -> Sides:
        """The same with orbits half as far again on both sides. Raises `ConvergenceError`, `IntegrationError`."""
        curve, w, ends = self.here.curve, self.middle.solution.place, []
        for near in (self.before, self.after):
            way = near.solution.place.vector - w.vector
            far = w.moved(1.5 * way)
            ends.append(Probe(curve, correct(curve, far, plane(curve, far, way), far, 0.5 * self.apart)))
        return replace(self, before=ends[0], after=ends[1], outer=(), apart=1.5 * self.apart)


def _as(look: Probe, about: MapRoots) -> Probe:
    """The same orbit with another map."""
    other = replace(look)
    other.__dict__["about"] = about
    return other


def _level(level: float) -> Measure:
    return lambda look: levelled(look.about.roots, level)


def check_passage(sides: Sides, event: Event) -> Reading:
    """A root at the level that the recorded multiplier stands for, of this kind and order and no other."""
    return sides.zero(_level(_passed(sides, event)))


def _passed(sides: Sides, event: Event) -> float:
    told = event.kind, event.detail, event.order
    known = sides.here.about.levels(min(max(event.order, 3), 100))
    levels = [level for level, *kind, mu in known if tuple(kind) == told and abs(mu - event.multiplier) < ALIKE]
    if not levels:
        raise Refuted(f"its multiplier {event.multiplier:.6g} and order {event.order} are of another kind")
    return levels[0]


def check_crossing(sides: Sides, event: Event) -> Reading:
    """The same, and another family leads through it: one of half the period where its multiplier is -1."""
    level = _passed(sides, event)
    if event.multiplier.real > 0 and sides.turns(sides.here.curve.equations.parameter):
        raise Refuted("the family turns there, so that nothing else leads through it")
    if event.multiplier.real > 0 and not (sides.here.about.conservative or sides.crossed):
        raise Refuted("no other family leads through it")
    return sides.zero(_level(level))


def check_fold(sides: Sides, event: Event) -> Reading:
    """A multiplier at +1, and the parameter turns."""
    if event.detail not in ("energy", *sides.here.curve.equations.physical):
        raise Refuted(f"{event.detail or 'nothing'} is no parameter that folds")
    return _turned(sides, event.detail)


def _turned(sides: Sides, parameter: str) -> Reading:
    """A root at the level of mu = 1, which is sharp by the turn of a parameter if not by itself.

    Where the parameter hardly moves beyond its round-off, as in a canard, it is by itself, and the parameter turns: as
    is seen, or as no other family crosses there. (The rows of a loop then have full rank, so that a multiplier that
    passes +1 takes the derivative of the parameter through 0.)
    """
    level = _level(sides.here.about.unit)
    passage = sides.zero(level, sharp=False)
    if passage.passed and (turn := sides.turning(parameter)).passed:  # the nearer of their bars: both bound where it is
        names = ("parameter_error", "period_error")
        bars = {name: [getattr(each, name) for each in (passage, turn)] for name in names}
        return replace(passage, **{name: min(pair) for name, pair in bars.items() if None not in pair})
    passage = sides.zero(level, within=DOUBTFUL)
    still = sides.farthest and not (sides.here.about.conservative or sides.crossed or sides.passes(parameter))
    return replace(passage, passed=passage.passed and (still or sides.turns(parameter, SURE)))


def fold_side(sides: Sides, event: Event) -> str:
    """Whether the two orbits of a fold are at larger values of its parameter (supercritical) or at smaller ones.

    Source: P. Glendinning, Stability, Instability and Chaos (1994), section 8.2.
    """
    with suppress(ConvergenceError, IntegrationError):
        for _ in range(WIDER * (not sides.here.about.conservative)):
            if sides.turns(event.detail, SURE):
                low, middle, high = sides.values(event.detail)
                return "supercritical" if low + high > 2 * middle else "subcritical"
            sides = sides.wider()
    return ""


def birth_side(sides: Sides, event: Event) -> str:
    """To which side the doubled orbit or the torus is born (`doubling.born`)."""
    return born(sides.here.curve, sides.here.solution, event.multiplier)


def check_turn(sides: Sides, event: Event) -> Reading:
    """The period, or a momentum, is extremal."""
    model = sides.here.curve.equations.model
    momenta = (invariant.name for invariant in model.invariants)
    if event.detail not in ("period", *sides.here.curve.equations.physical, *momenta):
        raise Refuted(f"{event.detail or 'nothing'} is not known to turn")
    return sides.turning(event.detail)


def check_watched(sides: Sides, event: Event) -> Reading:
    """A watched number is extremal."""
    check_known(sides.here.curve, event.detail)
    return sides.turning(event.detail)


def check_known(curve: Curve, name: str) -> None:
    """`ConvergenceError` for a number that no file says how to compute."""
    if name not in curve.watch:
        raise ConvergenceError(f"watch.{name} is not known; state it as text, a function of Python goes into no file")


def _pair(look: Probe) -> float:
    return look.about.pair[0] - 1.0


def check_torus(sides: Sides, event: Event) -> Reading:
    """A complex pair on the unit circle."""
    if not abs(sum_ := sides.here.about.pair[1]) < 2.0:
        raise Refuted("no complex pair of multipliers is on the unit circle")
    if abs(sum_ - 2 * event.multiplier.real) > ALIKE or (event.detail, event.order) != ("", 0):
        raise ConvergenceError(f"the pair on the unit circle is not {event.multiplier:.6g}")
    return sides.zero(_pair)


def _meeting(look: Probe) -> float:
    return discriminant(look.about.roots) / (1.0 + float(np.abs(look.about.roots).min()) ** 2)


def check_collision(sides: Sides, event: Event) -> Reading:
    """Two stability indices are one, real on one side and complex on the other."""
    if (event.detail, event.order) != ("", 1) or not sides.here.about.conservative:
        raise Refuted("two stability indices do not meet there")
    return sides.zero(_meeting)


def check_avoided(sides: Sides, event: Event) -> Reading:
    """Another family is nearest there, across a gap of the recorded width."""
    gap, near = event.gap or 0.0, None
    sides.here.tour  # noqa: B018
    with suppress(np.linalg.LinAlgError):
        near = avoided_crossing(sides.here.curve, sides.here.solution, 2 * gap)
    if near is None or not gap or abs(near.gap - gap) > SAME_GAP * near.gap:
        raise Refuted(f"no two families avoid each other there across a gap of {gap:.6g}")
    known = SAME_GAP * near.gap
    read = sides.zero(lambda look: float(near.place(look.solution.place)[1]), within=known / sides.step)
    return sides._barred(read, known)


def check_stability(sides: Sides, event: Event) -> Reading:
    """What makes a verdict change is at 0, and the verdict is another on the two sides.

    Beside a fold the multipliers may leave the unit circle by less than any verdict asks for: on which side of its
    level the root is that passes it tells there what the orbits are.
    """
    about = sides.here.about
    known = [(sides.zero(_level(level)), level) for level in (about.unit, -about.unit)]
    known.append((_turned(sides, sides.here.curve.equations.parameter), about.unit))
    known += [(sides.zero(measure), 0.0) for measure in about.others]
    nearest, level = min(known, key=lambda pair: (not pair[0].passed, abs(pair[0].value)))
    looks, told = (sides.before, sides.after), dict(zip(BECOMES, [(True, False), (False, True)], strict=True))
    verdicts = [tuple(probe.unstable for probe in looks), tuple(probe.beyond(level) for probe in looks if level)]
    if told.get(event.detail) not in verdicts:
        raise Refuted("the orbits on its two sides are as stable or unstable as each other")
    return nearest


def check_margin(sides: Sides, event: Event) -> Reading:
    """A margin of a hybrid cycle, along the arcs as the automaton integrates them."""

    def every(look: Probe) -> dict[tuple[int, str, str], float]:
        known = margins_called(look.curve, retraced(look.curve.equations, look.solution), event)
        return {key: margin.value for key, margin in known.items()}

    here = every(sides.here) if sides.here.curve.equations.links else {}
    if not here:
        raise ConvergenceError(f"{event.detail} is nowhere near")
    key = min(here, key=lambda which: abs(here[which]))
    return sides.zero(lambda look: every(look).get(key, np.nan))


def check_second(sides: Sides, event: Event) -> Reading:
    """On a curve of bifurcations in two parameters, what else vanishes."""
    critical = sides.here.curve.test
    assert isinstance(critical, Critical)
    for test in critical.followed.tests(critical, sides.here.about):  # type: ignore[arg-type]
        told = (test.kind, test.detail, test.order) == (event.kind, event.detail, event.order)
        if told and abs(test.multiplier - event.multiplier) < ALIKE:
            return sides.zero(test.measure)  # type: ignore[arg-type]
    raise Refuted("nothing of this kind happens along such a curve")


def check_bending(sides: Sides, _: Event) -> Reading:
    """On a curve of doublings in two parameters, where the doubled orbit is born to neither side."""
    return sides.zero(lambda look: bending(look.curve, look.solution))


def _folds_of(sides: Sides) -> tuple[str, str]:
    """The two parameters of a curve of folds."""
    test = sides.here.curve.test
    assert isinstance(test, Critical)
    if not KINDS[test.kind].extremal:
        raise Refuted("no curve of folds turns there")
    return test.parameters


def check_extremal(centre: bool, sides: Sides, event: Event) -> Reading:
    """On a curve of folds in two parameters, where the one that folds turns."""
    curve = sides.here.curve
    if event.detail not in _folds_of(sides):
        raise Refuted("no curve of folds turns there")
    low, middle, high = sides.values(event.detail)
    if is_centre(curve, sides.here.solution.place, event.detail, low + high - 2 * middle) != centre:
        raise Refuted("the surface of orbits is bent the other way")
    return sides.turning(event.detail)


def check_cusp(sides: Sides, _: Event) -> Reading:
    """Where a curve of folds stops in the plane of its parameters: it turns in one direction, and has none across."""
    names, model = _folds_of(sides), sides.here.curve.equations.physical
    sizes = np.array([sides.here.curve.scales.free[model.index(name)] if name in model else 1.0 for name in names])
    low, middle, high = np.array([sides.values(name) for name in names]).T / sizes
    bent, across = high - 2 * middle + low, high - low
    scale = sides.apart / (sides.step * nonzero(float(np.linalg.norm(bent))))
    along = bent / nonzero(float(np.linalg.norm(bent)))
    value, aside = -0.5 * float(across @ along) * scale, across - (across @ along) * along
    probes = (sides.before, sides.here, sides.after)
    known = 4 * EPSILON + max(probe.tour.closes.across for probe in probes)
    error = SHARP + float(np.abs([low, high]).max()) * known * scale
    # a cusp goes this little across the direction in which it turns, relative to its bend
    straight = 0.5 * float(np.linalg.norm(aside)) * scale < 0.03
    return Reading(value, error, bool(abs(value) <= error < DOUBTFUL and straight))
