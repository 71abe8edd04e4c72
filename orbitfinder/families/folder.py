"""Follow a family, in memory or into a folder, where it is resumed when an earlier run was stopped."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from orbitfinder._runtime import interrupt, limit, locks
from orbitfinder.errors import InputError, LimitError, plural
from orbitfinder.families.branches import Branch
from orbitfinder.families.changes import checked_cycle
from orbitfinder.families.codimension_two import Critical
from orbitfinder.families.follow import follow
from orbitfinder.families.handover import handed_over
from orbitfinder.families.members import batch_certified, certified
from orbitfinder.families.point import FamilySettings
from orbitfinder.families.run import Run, first_point, in_scales
from orbitfinder.families.start import Start, as_problem, begin, curve_of, entry_of, method_of, unknown_parameters
from orbitfinder.families.verified import checked
from orbitfinder.integrate.equations import prepare
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.continued import Curve
from orbitfinder.loops.problem import Problem
from orbitfinder.loops.symmetry import turned
from orbitfinder.loops.watch import Number, as_recorded, check_stop, watches
from orbitfinder.mechanics.kind import build_model, check_reachable, system_kind
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.hybrid import closure_check
from orbitfinder.orbits.method import named
from orbitfinder.records.codec import plain
from orbitfinder.records.family import (
    CLOSURE,
    FORMAT,
    JOURNAL,
    VERSION,
    Batch,
    Family,
    FamilyPoint,
    Journal,
    append,
    assemble,
    number_of,
    reached,
    read_journal,
    save_family,
)
from orbitfinder.records.journal import begin_journal, refuse_other
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import parted
from orbitfinder.records.registry import load_orbit

EFFORT = 1.0
"""Seconds of interpreted integration in the checks of a family of moderate length, for `compiled`."""

Progress = Callable[[Batch], None]
Asked = tuple[int, float | None, tuple[float, ...]]
"""A direction, the value at which to stop, the values at which points are wanted"""
Origin = str | Path | Orbit | Problem | Start | Branch


@one_thread()
def follow_family(
    origin: Origin,
    parameter: str | None = None,
    *,
    until: float | None = None,
    at: Sequence[float] = (),
    settings: FamilySettings | None = None,
    out: str | Path | None = None,
    name: str | None = None,
    points: int | None = None,
    model: Model | None = None,
    progress: Progress | None = None,
    watch: Mapping[str, str | Number] | None = None,
    stop: Mapping[str, float] | None = None,
    between: tuple[float, float] | None = None,
) -> Family:
    """Follow the family of an orbit in a parameter.

    Each point is an Orbit whose closure was checked by the second integrator; folds, branch points, doublings, tori,
    resonances and changes of stability are located on the way.

    Args:
        origin: an Orbit, the path of an orbit.json, a Problem, or a branch from `of.switch_branch`.
        parameter: energy | period | a state component | a physical parameter; the energy unless said, or the physical
            parameter of the family that a branch leaves.
        until: value of the parameter to stop at.
        at: values at which points are computed exactly.
        settings: steps, directions, events.
        out: a folder: everything goes to OUT/<name>/family.json and family.npz, and OUT/<name>/family.jsonl is
            resumed when the same was asked before.
        name: of the family; a branch start needs one there.
        points: the most in each direction, those of the settings if None.
        model: needed only for a system that no file describes.
        progress: called with each point and event.
        watch: numbers of each orbit by name, those of the Problem if None: text of states, parameters, max(), min() and
            mean() over the motion, such as "max(x)", amplitude(x, k) and phase(x, k) of its k-th harmonic, or a
            function of times (k, s), states (k x d) and parameters by name. A function gets the motion at 960 equal
            times at least, to the fourth order of their distance; max(), min() and mean() of a text are those of the
            motion on its own mesh and between its instants.
        stop: values of watched numbers at which the family ends.
        between: two values of the parameter, at either of which it ends.

    Returns:
        A Family: points, events, and why it ended.

    Raises:
        InputError: for an origin or a parameter that cannot be followed.
        ConvergenceError: when the origin is no orbit.

    Examples:
        >>> found = of.follow_family(orbit, until=-17.0, at=[-17.5], points=20)
        >>> [round(one.period, 6) for one in found.points if abs(one.value + 17.5) < 1e-12]
        [1.183808]
        >>> wide = of.follow_family(orbit, watch={"swing": "max(theta1) - min(theta1)"}, stop={"swing": 1.25})
        >>> round(float(wide.values("swing")[-1]), 12), wide.ends[-1].reason
        (1.25, 'reached swing = 1.25')

    See Also:
        `of.switch_branch` at its events, `of.follow_curve` in two parameters, `of.load_family`.
    """
    origin = _origin(origin)
    settings = replace(settings or FamilySettings(), parameter=_chosen(parameter, settings, origin))
    settings = settings if points is None else replace(settings, points=points)
    label = name or str(getattr(origin, "name", ""))
    if out is not None and not label:
        raise InputError("name: missing; a family that starts from a branch needs a name")
    folder = None if out is None else Path(out) / label
    _check_goals(origin, model, settings.parameter, until, at)
    watch, stop = _watched(origin, watch), stop or {}
    check_stop(stop, watch)
    request, source = _request(origin, settings, at, watch)
    by = (settings.method or method_of(origin)) if isinstance(origin, Orbit | Problem) else None
    if by and (follow_by := named(by).follow):  # where no march does
        asked, wanted = (request, source), (until, at, bool(stop or between))
        return follow_by(as_problem(cast(Any, origin), model), settings, wanted, label, folder, asked, watch, progress)
    with locks.alone_in(folder):
        journal = None if folder is None else _kept(folder, request)
        born = origin.event.parameter if isinstance(origin, Branch) and isinstance(origin.number, int) else None
        if journal is None:
            start = _started(origin, settings, model)
            curve = replace(start.curve, watch=watches(watch, start.curve.equations.model))
            start = replace(start, curve=curve)
            journal = Journal(_header(label, start, settings, request, source), ())
            if folder is not None:
                begin_journal(folder / JOURNAL, plain(journal.header))
        else:
            assert folder is not None
            curve = curve_of(journal.header["curve"], _model_of(origin, journal, model), settings)
            curve = replace(curve, watch=watches(watch, curve.equations.model))
            if isinstance(origin, Branch):  # with what else vanishes along a curve of bifurcations
                curve = replace(curve, test=origin.start.curve.test, degenerate=origin.start.curve.degenerate)
            if not journal.sealed and settings.certify:
                _check_again(journal, curve, folder)
        goals, away = (until, tuple(map(float, at))), int(journal.header.get("away", 1))
        curve, check = in_scales(curve, journal.origin), _independent(curve, settings)
        runs = [
            Run(curve, settings, sign, journal.origin, check, value, exact, stop, between or ())
            for sign, value, exact in directions(journal.origin.value, settings, goals, away, born)
        ]
        if folder is not None:
            journal = _reopened(folder, journal, {run.direction: run.goals for run in runs})
        return _finish(folder, journal, curve, settings, runs, progress)


def _origin(given: Any) -> Any:
    """What a family starts from, of a file its orbit. `InputError` says of others what makes an origin of them."""
    if not isinstance(given, Origin):
        made = {"Family": "give one of its points, or a branch: switch_branch(family, event)"}
        remedy = made.get(type(given).__name__, "give an Orbit, its file, a Problem, or what switch_branch gives")
        raise InputError(f"origin: a {type(given).__name__}; {remedy}")
    if not isinstance(given, (str, Path)):
        return given
    if parted(given)[0].suffix in (".toml", ".py"):
        raise InputError(f"origin: {given} is a problem file; give its Problem: load_problem({str(given)!r})")
    return load_orbit(given)


def _check_goals(origin: Any, model: Model | None, parameter: str, until: float | None, at: Sequence[float]) -> None:
    """`InputError` for ends and values that no orbit of the family can have."""
    if until is None and not len(at):
        return
    start = _start_of(origin)
    known = start.curve.equations.model if start else model or getattr(origin, "model", None)
    if known is None:
        with contextlib.suppress(InputError):  # which is told where it is begun
            known = build_model(origin.system)
    if known:
        check_reachable(known, parameter, {"until": () if until is None else (until,), "at": at})


def _kept(folder: Path, request: Mapping[str, Any]) -> Journal | None:
    """The journal of a request in a folder, if any; that of another is refused where it has more than a start.

    A journal that does not say of which system it is was asked by its start alone.
    """
    if (journal := read_journal(folder)) is None:
        return None
    known = {"system": request["system"], **journal.header.get("request", {}), "until": None}
    if known == {**request, "until": None}:
        return journal
    if journal.batches:
        refuse_other(folder / JOURNAL, known, {**request, "until": None})
    return None


def _chosen(parameter: str | None, settings: FamilySettings | None, origin: Any) -> str:
    """The parameter that is asked for, by name or by settings other than usual, else the origin's own."""
    usual = FamilySettings().parameter
    told = settings.parameter if settings else usual
    if parameter and told not in (usual, parameter):
        raise InputError(f"parameter: {parameter!r} beside settings with {told!r}; give it in one place")
    return parameter or (told if told != usual else parameter_of(origin))


def parameter_of(origin: Any) -> str:
    """What a family is followed in when nothing is said: the physical parameter that its start has freed, or energy; of
    a curve in two parameters the first."""
    start = _start_of(origin)
    if start and isinstance(start.curve.test, Critical):
        return start.curve.test.parameters[0]
    return start.curve.equations.parameter if start else "energy"


def _start_of(origin: Any) -> Start | None:
    """The start that an origin is or has."""
    start = origin.start if isinstance(origin, Branch) else origin
    return start if isinstance(start, Start) else None


def _watched(origin: Any, watch: Mapping[str, str | Number] | None) -> Mapping[str, str | Number]:
    """What is watched: as given, or else of a Problem what it states, of a branch what its family's file states."""
    if watch is not None:
        return watch
    if start := _start_of(origin):
        known = start.curve.watch.items()
        return {name: number.entry if isinstance(number.entry, str) else number.of for name, number in known}
    return getattr(origin, "watch", {})


def _independent(curve: Curve, settings: FamilySettings) -> ClosureCheck | None:
    """What the family's orbits are checked with, its equations compiled where that pays for a dozen certificates."""
    if not settings.certify:
        return None
    model = curve.equations.model
    if model.smooth:
        prepare(model, EFFORT)
        if curve.equations.physical and not system_kind(model.system).reread:
            prepare(model, EFFORT, curve.equations.physical)
    return closure_check(model, curve.equations.by.stiff)


def _check_again(journal: Journal, curve: Curve, folder: Path) -> None:
    """`InputError` unless every point of a journal without digests still closes, by independent means."""
    check = closure_check(curve.equations.model, curve.equations.by.stiff)
    for point in (journal.origin, *(p for batch in journal.batches for p in batch.points)):
        allowed = CLOSURE * max(1.0, float(np.abs(point.floquet_multipliers).max(initial=1.0)))
        turns = turned(curve.equations.model, np.array(curve.turns), point.shift)
        closure = check(point.state, point.period, turns, allowed, point.free)
        if not closure <= allowed:
            raise InputError(
                f"{folder / JOURNAL}: the point at {journal.header['parameter']} {point.value:.9g} closes only to "
                f"{closure:.2g}; the file was edited or damaged, delete it to start again"
            )


def _started(origin: Any, settings: FamilySettings, model: Model | None) -> Start:
    start = _start_of(origin)
    if start is None:
        start = begin(origin, settings, model=model)
        checked_cycle(start.curve, start.solution)
        return start
    free, _ = unknown_parameters(start.curve.equations.model, settings)
    if start.curve.test is None and free != start.curve.equations.physical:
        raise InputError(
            f"parameter: {settings.parameter!r} on a branch of a family in {parameter_of(start)}; leave it out, or "
            "continue one of the branch's orbits (FAMILY.json#K) in it"
        )
    return start


def _model_of(origin: Any, journal: Journal, model: Model | None) -> Model:
    """The model that the journal's curve is made of: a linkage's is the minimal one that was chosen then."""
    if start := _start_of(origin):
        return start.curve.equations.model
    model = model or (origin.model if isinstance(origin, Problem) else None)
    system = journal.header["system"]
    if model is None or "independent" in system or dict(model.system) != system:
        return build_model(system)
    return model


def _reopened(folder: Path, journal: Journal, stops: Mapping[int, Sequence[tuple[str, float]]]) -> Journal:
    """The journal as far as it leads to where each direction shall stop, which may be farther than before.

    `InputError` where that would leave points of it out.
    """
    kept, last = [], dict[int, FamilyPoint].fromkeys(stops, journal.origin)
    for batch in journal.batches:
        side, goals = batch.direction, stops.get(batch.direction, [])
        met = [point for point in batch.points if point.role != "at"]
        there = batch.end is not None and batch.end.reason in [reached(*goal) for goal in goals]
        passed = side in last and any(
            (number_of(last[side], name) - value) * (number_of(member, name) - value) <= 0
            for name, value in goals for many in (met, batch.events) for member in many
        )  # fmt: skip
        ended = batch.end is not None and batch.end.facts.asked
        if batch.points and (side not in last or (passed and not there)):
            beyond = f"points at {batch.points[-1].value:.9g}"
            wanted = " or ".join(f"{name} = {value:.9g}" for name, value in goals) or "none that way"
            refuse_other(folder / JOURNAL, {"until": beyond}, {"until": wanted})
        if side not in last or ((ended or passed) and not there):
            last.pop(side, None)  # and what comes after it in this direction
            continue
        kept.append(batch)
        last[side] = [last[side], *met][-1]
    if len(kept) == len(journal.batches):
        return journal
    begin_journal(folder / JOURNAL, plain(journal.header), map(plain, kept))
    return replace(journal, batches=tuple(kept))


def _request(
    origin: Any, settings: FamilySettings, at: Sequence[float], watch: Mapping[str, str | Number]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """What decides whether a journal answers the same question; the number of points and where it ends may differ.

    And what the family was started from, for its file.
    """
    head: Any
    source, system = {"name": getattr(origin, "name", "")}, {}
    if title := getattr(origin, "title", ""):
        source["title"] = title
    if isinstance(origin, Branch):
        if title:  # which is that of the family, or of the equilibria, that it leaves
            source["title"] = f"{title}, branch at {'event ' * isinstance(origin.number, int)}{origin.number}"
        head, kind = origin.described(), "branch"
        source = source | head
        del source["name"]
    elif isinstance(origin, Start):
        head, kind = origin.solution.place.head.tolist(), "start"
    elif isinstance(origin, Orbit):
        head, kind, system = [*origin.state.tolist(), origin.period], "orbit", dict(origin.system)
    else:
        guess, system = origin.guess, dict(origin.model.system)
        head, kind = [*map(float, guess.state), float(guess.period), plain(origin.pin), origin.symmetry], "problem"
    chosen = {key: value for key, value in plain(settings).items() if key != "points" and value is not None}
    more = {"watch": {name: as_recorded(number) for name, number in watch.items()}} if watch else {}
    request = {
        "origin": plain(head),
        "system": plain(system),
        "settings": chosen,
        "at": [float(value) for value in at],
        **more,
    }
    return request, {"kind": kind, **source}


def _header(
    name: str, start: Start, settings: FamilySettings, request: dict[str, Any], source: dict[str, Any]
) -> dict[str, Any]:
    """The first line of a journal: the family's first point and what rebuilds its curve."""
    curve = start.curve
    origin = first_point(start, settings, _independent(curve, settings))
    header: dict[str, Any] = plain({
        "format": FORMAT, "version": VERSION, "name": name, "system": dict(curve.equations.model.system),
        "parameter": settings.parameter, "request": request, "origin": plain(origin), "source": source,
        "away": 1 if np.sum(curve.weights * origin.tangent * start.direction) > 0 else -1,
        "curve": entry_of(curve) | ({"method_reason": start.why} if start.why else {}),
    })  # fmt: skip
    return header


def directions(
    start: float,
    settings: FamilySettings,
    goals: tuple[float | None, tuple[float, ...]],
    away: int = 1,
    born: float | None = None,
) -> Iterator[Asked]:
    """(direction, stop, exact values) of every run that is wanted: as set, or from "both" towards the goals.

    A branch whose first point is already beyond where it shall stop goes back towards where it was `born`.
    """  # fmt: skip
    until, at = goals
    if settings.directions == "away" and until is not None and born is not None:
        if (until - born) * (until - start) < 0:
            away = -away
        elif (until - start) * (start - born) < 0:
            logging.getLogger(__name__).warning(
                "until: %r lies behind the branch, which is born at %s %.9g and begins at %.9g",
                until, settings.parameter, born, start,
            )  # fmt: skip
    if settings.directions != "both" or (until is None and not at):
        signs = {"both": (1, -1), "forward": (1,), "backward": (-1,), "away": (away,)}.get(settings.directions)
        if signs is None:
            raise InputError(f"directions: must be both, forward, backward or away, got {settings.directions!r}")
        yield from ((sign, until, at) for sign in signs)
        return
    for sign in (1, -1):
        wanted = [value for value in at if sign * (value - start) > 0]
        if until is not None and sign * (until - start) > 0:
            inside = tuple(value for value in wanted if sign * (until - value) > 0)
            yield sign, until, inside
        elif wanted and until is None:
            last = max(wanted, key=lambda value: sign * value)
            yield sign, last, tuple(value for value in wanted if value != last)


def _finish(
    folder: Path | None,
    journal: Journal,
    curve: Curve,
    settings: FamilySettings,
    runs: Sequence[Run],
    progress: Progress | None,
) -> Family:
    """Follow what is left in each direction, journalling every step where there is a folder."""
    batches = list(journal.batches)

    def so_far() -> Family:
        return assemble(replace(journal, batches=tuple(batches)))

    waiting = list(runs)
    while waiting:
        run = waiting.pop(0)
        done, end = journal.steps(run.direction), journal.end(run.direction)
        if end is not None and not (end.facts.lengthened and len(done) < settings.points):
            continue
        if any(batch.end is not None and batch.end.facts.closed for batch in batches):
            break  # a closed family has one direction
        last = done[-1][0] if done else journal.origin
        try:
            for batch in follow(run, done):
                reached = [point for point in batch.points if point.role == "step"][-1:]
                step = abs(reached[0].arclength - last.arclength) if reached else last.step
                batch, last = checked(curve, batch, step, settings.parameter, last), (*reached, last)[0]
                batch = batch_certified(curve, batch) if settings.certify else batch
                known = replace(journal, batches=tuple(batches)) if batch.end else None
                if known and (other := handed_over(folder, known, run, batch.end, last)):
                    journal, curve = other
                    batches, check = list(journal.batches), _independent(curve, settings)
                    waiting = [
                        replace(each, curve=curve, origin=journal.origin, check=check) for each in (run, *waiting)
                    ]
                    break
                if folder is not None:
                    append(folder, batch)
                    kept = f"{plural(len(batches) + 1, 'step')} kept in {folder}"
                    limit.note(f"{kept}; the same command goes on from there")
                batches.append(batch)
                if progress:
                    progress(batch)
                # steps between two rewritings of family.json while a family grows
                if folder is not None and len(batches) % 50 == 0:
                    save_family(so_far(), folder)
        except (LimitError, KeyboardInterrupt):
            if folder is not None:
                with interrupt.held_back():
                    save_family(so_far(), folder)
            raise
    family = so_far()
    if settings.certify:
        first, *rest = family.points
        ends = (certified(curve, first), *rest[:-1], *(certified(curve, point) for point in rest[-1:]))
        family = replace(family, points=ends)
    if folder is not None:
        save_family(family, folder)
    return family
