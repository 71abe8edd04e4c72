"""Curves of bifurcations: an event of a family followed while two parameters vary.

Its orbits keep the family's equations, with one parameter more free and one row more, a test function of the
multipliers (`codimension_two.Critical`); they are followed, journalled and certified as those of any family.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from orbitfinder.errors import ConvergenceError, InputError, closest
from orbitfinder.families.branches import Branch, described, opened, with_nodes
from orbitfinder.families.codimension_two import Critical
from orbitfinder.families.entries import FOLLOWED, KINDS
from orbitfinder.families.equilibria import PACE
from orbitfinder.families.equilibrium import EQUILIBRIA, Equilibria, Equilibrium, RestEvent, load_equilibria
from orbitfinder.families.folder import Progress, follow_family, parameter_of
from orbitfinder.families.point import FamilySettings, parameter_value, unknowns_of
from orbitfinder.families.rest_curves import follow_rest_curve
from orbitfinder.families.start import by_series, corrected, curve_of, released
from orbitfinder.integrate.evaluate import one_thread
from orbitfinder.loops.conditions import pinned
from orbitfinder.loops.continued import TESTED, Curve, at_place, scaled
from orbitfinder.loops.loop import Unknowns
from orbitfinder.loops.symmetry import momenta_of
from orbitfinder.mechanics.kind import build_model, with_parameters
from orbitfinder.mechanics.model import Model
from orbitfinder.records.family import Event, Family
from orbitfinder.records.registry import held


@one_thread()
def follow_curve(
    family: Family | Equilibria | str | Path,
    event: int | Event | RestEvent,
    parameters: Sequence[str],
    *,
    until: float | None = None,
    at: Sequence[float] = (),
    settings: FamilySettings | None = None,
    out: str | Path | None = None,
    name: str | None = None,
    points: int | None = None,
    model: Model | None = None,
    progress: Progress | Callable[[Equilibrium], None] | None = None,
) -> Family | Equilibria:
    """The curve along which an event of a family, or of equilibria, happens while two parameters vary.

    Its points are at the bifurcation, its events points of codimension two (cusps, strong resonances, ...).

    Args:
        family: a Family, Equilibria, or the file of either.
        event: one of its events, or its number, from 0.
        parameters: the two that vary: physical ones, in a conservative system also energy or period in place of one.
        until: value of the first parameter to stop at.
        at: values of the first at which points are computed exactly.
        settings: steps, directions; of equilibria only how many points.
        out: a folder to write to, as for `of.follow_family`.
        name: of the curve.
        points: the most in each direction.
        model: needed only for a system that no file describes.
        progress: called with each point and event.

    Returns:
        A Family, or Equilibria, whose `parameters` are two and whose `places` are their values.

    Raises:
        InputError: for an event or parameters that no curve belongs to.
        ConvergenceError: when it does not start.

    Examples:
        >>> driven = of.systems.forced_duffing(frequency=1.4)
        >>> low = of.find_orbit(of.Problem(driven, of.Guess([-0.4, 0.0], 4.48799), name="low"))
        >>> resonance = of.follow_family(low, "frequency", until=1.1, points=80)
        >>> fold = resonance.events[0]
        >>> curve = of.follow_curve(resonance, fold, ("force", "frequency"), points=2)
        >>> curve.parameters, fold.kind, round(fold.parameter, 8)
        (('force', 'frequency'), 'fold', 1.77971952)
    """
    if isinstance(family, Equilibria) or (not isinstance(family, Family) and held(family)[0] == EQUILIBRIA):
        rest = family if isinstance(family, Equilibria) else load_equilibria(family)
        model, most = model or build_model(rest.system), settings.points if settings else PACE.points
        most = most if points is None else points
        names, chosen = both_parameters(model, parameters, ()), cast(int | RestEvent, event)
        return follow_rest_curve(rest, chosen, names, until, at, most, out, name, model, cast(Any, progress))
    if isinstance(event, RestEvent):
        raise InputError(f"event: a {event.kind} of equilibria; give the equilibria that it is of")
    start = curve_start(family, event, parameters, settings, model)
    return follow_family(
        start, parameter_of(start), until=until, at=at, settings=settings, out=out, name=name, points=points,
        model=model, progress=cast(Any, progress),
    )  # fmt: skip


def curve_start(
    family: Family | str | Path,
    event: int | Event,
    parameters: Sequence[str],
    settings: FamilySettings | None = None,
    model: Model | None = None,
) -> Branch:
    """The start of the curve of an event in two parameters, named <family>-<event>-<first>-<second>."""
    family, number, where = opened(family, event)
    chosen = _event(family, number, where)
    settings = replace(settings or FamilySettings(), parameter=family.parameter)
    base = curve_of(family.curve, model or build_model(family.system), settings)
    names = both_parameters(base.equations.model, parameters)
    hold = _hold(base, family, chosen, names)
    curve, place = _released(base, chosen, names, hold)
    solution = at_place(curve, place)
    sizes = np.linalg.svd(scaled(curve, solution)[0])[1]
    test = Critical(chosen.kind, names, chosen.detail, chosen.order, chosen.multiplier)
    if margin := test.followed.margin:
        test = replace(test, margin=margin(curve, solution, chosen))
    # a singular value of the equations below this, relative to the next, is a rank lost at a branch point
    curve = replace(curve, test=test, degenerate=bool(sizes[-1] < 1e-6 * sizes[-2]), watch=base.watch)
    if KINDS[test.kind].crosses and test.multiplier.real > 0 and not curve.degenerate:
        raise InputError(
            f"event: the branch point {described(family, number)} lasts only while nothing disturbs it, and one of "
            f"{' and '.join(names)} does: folds leave from there; choose parameters that keep the symmetry"
        )
    # change of a test, in units of the metric, below which neither parameter moves the bifurcation: that of round-off
    if np.linalg.norm(scaled(curve, at_place(curve, place))[0][-1]) * TESTED < 1e-7:
        raise InputError(
            f"parameters: the {described(family, number)} happens whatever {' and '.join(names)} are; give a "
            f"parameter that moves it, as {family.parameter} does"
        )
    held = names[0] if names[0] != family.parameter else names[1]
    aim = pinned(curve.equations, held, parameter_value(curve, place, held))
    try:
        start = corrected(curve, place, aim)
    except ConvergenceError as error:
        lasting = "; it need not persist where nothing keeps its symmetry" if curve.degenerate else ""
        raise ConvergenceError(f"event {number} of {family.name} ({chosen.kind}): {error}{lasting}") from error
    if refused := test.followed.refused(start.curve, start.solution):
        raise ConvergenceError(f"event {number} of {family.name}: {refused}; continue the family again")
    name, title = f"{family.name}-{number}-{'-'.join(names)}", family.source.get("title", "")
    return Branch(start, family.name, chosen, number, 0, name, title)


def curves_through(family: Family) -> list[int]:
    """The numbers of the events that curves in two parameters lead through, none of a family in series alone."""
    if "test" in family.curve or by_series(family.curve):
        return []
    return [k for k, event in enumerate(family.events) if _followed(event) and not _no_bifurcation(family, event)]


def _followed(event: Event) -> bool:
    return event.kind in FOLLOWED and not event.detail.startswith("at ")


def _no_bifurcation(family: Family, event: Event) -> bool:
    """Whether no multiplier is at +1 where something is extremal: a period, or anything where that is held."""
    return KINDS[event.kind].extremal and (event.detail == "period" or family.curve.get("period") is not None)


def _event(family: Family, event: int, where: str) -> Event:
    """The event of a number, or that one. `InputError` lists those that can be followed."""
    if "test" in family.curve:
        raise InputError(f"{where}: is a curve in two parameters itself; give the family that it was started from")
    known = curves_through(family)
    listed = "; ".join(described(family, k) for k in known)
    choice = f"choose one of {listed}" if listed else "this family has none that a curve leads through"
    if not 0 <= event < len(family.events):
        raise InputError(f"event: {where} has no event {event}; {choice}")
    chosen = family.events[event]
    if not _followed(chosen):
        raise InputError(f"event: no curve leads through event {event} ({chosen.kind}); {choice}")
    return with_nodes(chosen, where, "follow its event")


def both_parameters(model: Model, names: Sequence[str], own: tuple[str, ...] = ("energy", "period")) -> tuple[str, str]:
    """The two names. `InputError` unless they are two different ones, at least one of them physical."""
    if len(names) != 2:
        raise InputError(f"parameters: two names are needed, got {len(names)} ({', '.join(names)}); give a,b")
    first, second = names
    own = own if model.conservative else ()
    known = [*own, *model.parameter_names]
    for name in names:
        if name not in known:
            raise InputError(f"parameters: unknown {name!r}{closest(name, known)}; use two of {', '.join(known[:20])}")
    if first == second:
        raise InputError(f"parameters: {first!r} twice; give two different ones of {', '.join(known[:20])}")
    if {first, second} == {*own}:
        raise InputError(
            "parameters: energy and period are the family's own, of one orbit one follows from the other; give one of "
            f"them and a physical parameter ({', '.join(model.parameter_names[:20]) or 'this system has none'})"
        )
    return first, second


def _hold(base: Curve, family: Family, event: Event, names: tuple[str, str]) -> tuple[str, ...]:
    """What keeps its value along a conservative system's curve. `InputError` for folds that are no bifurcations."""
    held_period = family.curve.get("period") is not None
    if _no_bifurcation(family, event):
        raise InputError(
            f"event: at a fold of the {event.detail}{' at a fixed period' if held_period else ''} no multiplier is at "
            "+1, it is no bifurcation; choose a fold of the energy, or continue the family with the energy held"
        )
    model = base.equations.model
    if not model.conservative:
        return ()
    momenta = momenta_of(base.equations.symmetry, model)
    both = all(name in model.parameter_names for name in names)
    return (*(("period" if held_period else "energy",) if both else ()), *momenta)


def _released(base: Curve, event: Event, names: tuple[str, str], held: tuple[str, ...]) -> tuple[Curve, Unknowns]:
    """The family's curve with both parameters free, other freed ones fixed where they are, and the event's place."""
    old, model = base.equations, base.equations.model
    free = tuple(name for name in names if name in model.parameter_names)
    fixed = {name: event.free[name] for name in old.physical if name not in free}
    equations = replace(old, model=with_parameters(model, fixed), free=free, alone=True)
    return released(base, unknowns_of(base, event), equations, held)
