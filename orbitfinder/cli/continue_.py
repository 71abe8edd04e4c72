"""The command `continue`: a family of orbits from an orbit or a problem, with live progress."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

import orbitfinder as of
from orbitfinder._runtime import interrupt
from orbitfinder._runtime.keeping import kept
from orbitfinder.cli.console import Display, Report, display, way_left
from orbitfinder.cli.equilibria import followed_rest
from orbitfinder.cli.jobs import folder_of, model_of, named_orbits, whole_family
from orbitfinder.cli.options import FILES, FINITE, NUMBERS, finish, next_step, numbers, option, picked, text, usual
from orbitfinder.errors import InputError, plural
from orbitfinder.records.certificate import certified
from orbitfinder.records.ends import stuck
from orbitfinder.records.family import Batch, Event, number_of, reverted
from orbitfinder.records.reading import Entries, Table
from orbitfinder.records.registry import held, member

if TYPE_CHECKING:
    from orbitfinder.families.branches import Branch

    Origin = of.Orbit | of.Problem | Branch | partial[of.Equilibria]
    Modelled = tuple[Origin, of.Model | None]


class Switch(click.ParamType):  # type: ignore[type-arg]
    """The index of an event, or the end at which another family is joined."""

    name = "event"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int | str:
        """The index as a number."""
        if isinstance(value, str) and not value.isdecimal() and value not in ("start", "end"):
            self.fail(f"{value!r} is neither the index of an event nor start nor end", param, ctx)
        return value if value in ("start", "end") else int(value)


@click.command(name="continue")
@click.argument("file", type=FILES, metavar="FILE|ORBIT.json|FAMILY.json|EQUILIBRIA.json")
@option("parameter", "energy, period or a physical parameter.  [default: energy, or a branch's own]")
@option("until", "Stop when the parameter reaches this value.", kind=FINITE)
@option("at", "Compute points exactly at these values of the parameter.", "", NUMBERS, metavar="V,V,...")
@option("stop", "End where a number that the problem's [watch] names is V.", multiple=True, metavar="NAME=V")
@option("points", "Points each way.", 300, (1, 1_000_000))
@option(
    "direction",
    "Both ways, the parameter growing or falling, or away from a branch's birth.  [default: both, or away]",
    kind=("both", "forward", "backward", "away"),
)
@option("switch event", "Switch at the event with this index, or to the family that is joined at that end.",
        kind=Switch(), metavar="EVENT|start|end")  # fmt: skip
@option("curve", "Follow the event with this index in two parameters.", kind=(0,), metavar="EVENT")
@option("parameters", "The two parameters of --curve.", metavar="A,B")
@option("branch", "Which of the branches there.", 1, (1,))
@option("resolve", "Follow avoided crossings as wide as this, and go straight over narrower ones.  [default: 0.1]",
        kind=click.FloatRange(1e-6, 0.5), metavar="ARCLENGTH")  # fmt: skip
@option("method", "shooting, collocation (stiff) or balance (driven).  [default: as its orbit was found]",
        metavar="METHOD")  # fmt: skip
@option(
    "beside", "A second parameter that varies so that the period stays, of a system without an energy.", metavar="B"
)
@option("name", "Name of the family; the problem's, orbit's or branch's when left out.")
@usual("Folder for DIR/<name>/family.json.", "families", figures="Draw the family.", compiled=True,
       trust="Execute Python problem files and modules; only what you have read.")  # fmt: skip
def continue_(file: Path, parameter: str | None, at: tuple[float, ...], points: int, out: Path, **chosen: Any) -> None:
    """Follow the family of orbits through an ORBIT.json, the orbit of a problem FILE, or from an event of a FAMILY.json
    a branch (--switch), or the event itself in two parameters (--curve); --switch start|end goes on along the family
    that is joined at that end. From a Hopf point of an EQUILIBRIA.json --switch follows the cycles that are born there,
    with start|end the normal mode --branch about that equilibrium of a system with an energy; --curve follows a fold or
    a Hopf point in two parameters.

    Both ways along the family unless --until, --at or --direction say where to go; a branch away from its birth.
    Folds, branch points, period doublings, tori, resonances, collisions and stability changes are located. A run
    that was killed goes on where it stopped when the same command is given again. Of a problem with [control] the
    family of its optima is followed, round turning points: --parameter is a pin, a physical parameter, one of the
    control's numbers, "task K" or "limit NAME".

    \b
    Examples:
      orbitfinder continue problems/families/triple-mode-2.toml --until -3
      orbitfinder continue orbits/triple-1/orbit.json --at -38,-37,-36 --out families
      orbitfinder continue problems/control/maintained-oscillator.toml --parameter damping --until 0.1
      orbitfinder continue families/triple-mode-2/family.json --switch 10 --until -36
      orbitfinder continue equilibria/brusselator/equilibria.json --switch 0
      orbitfinder continue equilibria/brusselator/equilibria.json --curve 0 --parameters feed,rate
      orbitfinder continue families/duffing-resonance/family.json --curve 0 --parameters force,frequency
    """
    directions = chosen["direction"] or ("away" if isinstance(chosen["event"], int) else "both")
    more: Entries = {"beside": chosen["beside"] or ""}
    more |= {} if chosen["resolve"] is None else {"narrowest": chosen["resolve"]}
    with display(f"{file}: reading") as shown:
        from orbitfinder.families.branches import left_at
        from orbitfinder.families.equilibria import RestBranch
        from orbitfinder.families.folder import parameter_of

        _asked_where(file, chosen, shown)
        settings = of.FamilySettings(directions=directions, points=points, method=chosen["method"], **more)
        if chosen["curve"] is None and chosen["parameters"] is None:
            origin, model = origin_of(file, chosen["trust"], chosen["event"], chosen["branch"])
        else:
            origin, model = curve_of(file, parameter, chosen), None
        family, places = None, list[int]()
        if isinstance(origin, (RestBranch, partial)):
            told = followed_rest(origin, parameter, chosen["until"], at, points, out, chosen["name"], shown,
                                 chosen["figures"])  # fmt: skip
            return finish("equilibria", told[1], told[2])
        if getattr(origin, "guess", None) is None or getattr(origin, "control", None) is None:
            parameter = parameter or parameter_of(origin)
            name, steps = folder_of(out, chosen["name"] or origin.name, *NAMED).name, list[Batch]()
            family = of.follow_family(
                origin, parameter, until=chosen["until"], at=at, settings=settings, out=out, name=name,
                model=model, progress=_reporter(shown, name, parameter, points, chosen["until"], steps),
                stop=dict(map(_stop, chosen["stop"])),
            )  # fmt: skip
            if not steps and len(family.points) > 1:
                shown.say(READ.format(folder=out / name))
            places = left_at(family)
            _listed(family, places, shown)
    if family is None:
        _optima(origin, parameter, at, points, out, chosen)
        return
    folder = out / family.name
    written = of.save_figures(family, folder, model_in(origin, model, family)) if chosen["figures"] else []
    text(f"{folder / 'family.json'}: {family.counts}")
    for line in family.unknown:
        text(f"  {line}")
    for end in family.ends:
        text(f"  ended: {end.kind} ({end.reason})")
    for k in (asked := reached(family, at)):
        point = family.points[k]
        value = with_unit(point.value, family.parameter, family.system)
        where = f"{family.parameter} {value}: {folder / 'family.json'}#{k}"
        lasts = _lasting(point.period, family.system, 9)
        text(f"  {where}, period {lasts}, {point.stability}, symmetry {point.symmetry}")
    if written:
        text(f"  and {plural(len(written), 'figure')}")
    if places:
        next_step("continue", folder / "family.json", "--switch", places[0])
    else:
        next_step("page", folder, "-o site")
    document = summary(family) | {"at": asked, "written": [folder / "family.json", *written]}
    finish("continue", document, not stuck(family) and not family.unknown)


READ = (
    "{folder}: this family was finished there before, and is read, not followed; to follow it anew, as after a change "
    "of code, give another --out or delete the folder"
)
"""What is said where there was nothing left to do"""
NAMED = ("name", "give another --name")
"""Where a name that cannot be a folder's comes from, and what to do about it"""


def reached(family: of.Family, values: Sequence[float]) -> list[int]:
    """The numbers of the points at which the parameter has any of the values that were asked for."""
    near = 1e-9 * max((abs(point.value) for point in family.points), default=0.0)
    return [k for k, point in enumerate(family.points) if any(abs(point.value - value) <= near for value in values)]


MOST_LISTED, LAST_EVENTS = 20, 6
"""Events that are listed at the end with their indices, and that the live panel shows"""


def _listed(family: of.Family, places: list[int], shown: Display, most: int = MOST_LISTED) -> None:
    """The events that branches leave at, with the numbers that --switch takes."""
    for k in places[:most]:
        shown.say(f"--switch {k}: {event_words(family.events[k], family.parameter, family.system)}")
    if len(places) > most:
        shown.say(f"and {len(places) - most} more, up to --switch {places[-1]}")


def _asked_where(file: Path, chosen: Table, shown: Display) -> None:
    """`InputError` for a family without --switch, the events that it takes listed before."""
    if any(chosen[name] is not None for name in ("event", "curve", "parameters")) or not whole_family(file):
        return
    from orbitfinder.families.branches import counted, left_at

    family = of.load_family(file)
    places = left_at(family)
    _listed(family, places, shown, len(places))
    raise InputError(f"--switch: missing; give the event to leave {family.name} at: {counted(places) or 'none'}")


def event_words(event: Event, parameter: str, system: Table) -> str:
    """An event in words: kind, where with its error bar, period."""
    kind = f"{event.kind} {event.detail}".replace("_", " ").strip()
    known = "" if event.error is None else f" (+- {event.error:.1g})"
    value, period = with_unit(event.parameter, parameter, system), _lasting(event.period, system, 6)
    return f"{kind} at {parameter} {value}{known}, period {period}"


def _lasting(time: float, system: Table, digits: int) -> str:
    from orbitfinder.mechanics.scales import lasting  # which loads CasADi

    return lasting(time, system, digits)


def with_unit(value: float, parameter: str, system: Table) -> str:
    """A value of a family's parameter, with its unit where that is known."""
    from orbitfinder.mechanics.scales import measured

    return measured(value, {"period": "time"}.get(parameter, parameter), system)


def _optima(
    problem: Any, parameter: str | None, values: tuple[float, ...], points: int, out: Path, chosen: Table
) -> None:
    """The family of optima of a controlled problem."""
    if parameter is None or (chosen["until"] is None and not values):
        raise InputError("--parameter: of a controlled problem say along what, and how far: --parameter NAME --until V")
    for name in ("direction", "resolve", "stop"):
        if chosen[name]:
            raise InputError(f"--{name}: not for controlled problems; --until and --at say where to go")
    folder = folder_of(out, chosen["name"] or problem.name, *NAMED)
    target = folder / "optima.json"
    until = chosen["until"]
    left = way_left(len(values), None, 0.0) if until is None else way_left(points, until)
    with display(f"{problem.name}: along {parameter}") as shown, kept(target, of.save_optima):

        def report(value: float, orbit: of.Orbit) -> None:
            cost = float((orbit.control or {})["cost"])
            words = f"{parameter} {value:.9g}, cost {cost:.9g}, period {orbit.period:.9g} s, {orbit.stability}"
            shown.say(words + left(value))

        optima = of.follow_optima(
            problem, parameter, values, until=chosen["until"], points=points, progress=report, name=folder.name, out=out
        )
        written = [of.save_optima(optima, target)]
    written += [of.save_optima_figure(optima, folder)] if chosen["figures"] else []
    text(f"{written[0]}: {optima.counts}")
    for change in optima.changes:
        text(f"  {change.kind} at {parameter} {change.value:.12g}, cost {change.cost:.9g}: {change.detail}")
    text(f"  ended: {optima.end}")
    (told,) = picked([optima], "values costs descents changes end")
    document = {"name": folder.name, "parameter": parameter, **told, "written": written}
    finish("continue", document, all(map(certified, optima.points)))


def summary(family: of.Family) -> Entries:
    """What `--json` says of a family; its points are in family.json."""
    events = [
        {"kind": event.kind, "detail": event.detail, family.parameter: event.parameter, "period": event.period,
         "error": event.error, "period_error": event.period_error, "certified": event.certified}
        | {name: number_of(event, name) for name in family.parameters[1:]}
        for event in family.events
    ]  # fmt: skip
    return {
        "name": family.name, "parameter": family.parameter, "parameters": list(family.parameters),
        "points": len(family.points),
        "certified": sum(point.certified for point in family.points), "events": events, "unknown": family.unknown,
        "ends": [{k: v for k, v in vars(end).items() if v is not None and k != "joined"} for end in family.ends],
    }  # fmt: skip


def _stop(given: str) -> tuple[str, float]:
    """Name and value of a watched number; `InputError` for what is not NAME=VALUE."""
    name, mark, value = given.partition("=")
    if not mark or len(numbers(value, "--stop")) != 1:
        raise InputError(f"--stop: {given!r} is not NAME=VALUE; give one number, such as peak=2.0")
    return name.strip(), numbers(value, "--stop")[0]


def origin_of(file: Path, trust: bool, switch: int | str | None = None, branch: int = 1) -> Modelled:
    """The Orbit of an orbit.json or FILE#K, the Branch of a family.json, or the Problem of a file, with its model."""
    if file.suffix != ".json" and member(file)[1] is None:
        if switch is not None:
            raise InputError("--switch: goes with a family.json; continue the problem first, then switch there")
        return of.load_problem(file, trust), None
    if whole_family(file):
        return _branch_of(file, trust, switch, branch), None
    from orbitfinder.families.equilibrium import EQUILIBRIA

    if switch is not None and held(file)[0] == EQUILIBRIA:
        return of.switch_branch(file, switch, branch, model=model_of(of.load_equilibria(file), file, trust)), None
    if switch is not None:
        raise InputError(f"--switch: {file} is not a family.json, nor an equilibria.json; give the file that the "
                         "event is in")  # fmt: skip
    ((_, orbit, model),) = named_orbits([file], trust, pictured=False)
    return orbit, model


def curve_of(file: Path, parameter: str | None, chosen: Table) -> Branch | partial[of.Equilibria]:
    """The start of a curve of bifurcations from a family.json, or what follows the curve from an equilibria.json.

    `InputError` for options that do not go together.
    """
    from orbitfinder.families.curves import curve_start
    from orbitfinder.families.equilibrium import EQUILIBRIA

    resting = held(file)[0] == EQUILIBRIA
    if not (resting or whole_family(file)):
        raise InputError(f"--curve: {file} is not a family.json, nor an equilibria.json; give the file that the event "
                         "is in")  # fmt: skip
    if chosen["curve"] is None or chosen["parameters"] is None:
        missing, given = ("--curve", "--parameters") if chosen["curve"] is None else ("--parameters", "--curve")
        raise InputError(f"{missing}: missing beside {given}; give --curve EVENT --parameters A,B")
    if parameter is not None or chosen["event"] is not None:
        raise InputError("--curve: goes without --parameter and --switch; name the two parameters in --parameters A,B")
    names = tuple(part.strip() for part in chosen["parameters"].split(",") if part.strip())
    if resting:
        rest = of.load_equilibria(file)
        name = chosen["name"] or f"{rest.name}-{chosen['curve']}-{'-'.join(names)}"
        model = model_of(rest, file, chosen["trust"])
        return partial(cast(Any, of.follow_curve), rest, chosen["curve"], names, name=name, model=model)
    family = of.load_family(file)
    return curve_start(family, chosen["curve"], names, model=model_of(family, file, chosen["trust"]))


def _branch_of(file: Path, trust: bool, switch: int | str | None, branch: int) -> Branch:
    from orbitfinder.families.entries import SWITCHABLE

    family = of.load_family(file)
    if switch is None:
        raise InputError(f"{file}: a whole family; give one orbit of it, such as {file}#0")
    known = isinstance(switch, str) or (0 <= switch < len(family.events) and family.events[switch].kind in SWITCHABLE)
    try:
        leaving: Branch = of.switch_branch(file, switch, branch, model=model_of(family, file, trust))
        return leaving
    except InputError as error:
        if known:
            raise
        raise InputError(f"{error}; orbitfinder continue {file} lists them") from error


def model_in(origin: Origin, model: of.Model | None, family: of.Family) -> of.Model:
    """The model that a family's points belong to: a linkage's is minimal."""
    from orbitfinder.families.branches import Branch
    from orbitfinder.mechanics.kind import build_model

    if isinstance(origin, Branch):
        return origin.start.curve.equations.model
    known = model or getattr(origin, "model", None)
    return known if known is not None and known.constraint is None else build_model(family.system)


def _reporter(
    shown: Display, name: str, parameter: str, most: int, until: float | None, steps: list[Batch]
) -> Callable[[Batch], None]:
    """A live panel with the last events, or, without a terminal, a line an event and a line every ten points; `steps`
    grows by each that is taken."""
    began, seen, events, system = time.monotonic(), [0], list[Event](), dict[str, Any]()
    left = way_left(most, until, 0.0)  # each way has so many at most

    def report(batch: Batch) -> None:
        interrupt.check()
        steps.append(batch)
        seen[0] += len(batch.points)
        fresh = [*map(reverted, batch.events)]
        events.extend(fresh)
        system.update(*(point.system for point in batch.points[:1]))
        for event in () if shown.live else fresh:
            shown.say(event_words(event, parameter, system))
        if not batch.points:
            return
        point, elapsed = batch.points[-1], time.monotonic() - began
        value = with_unit(point.value, parameter, system)
        told = f"{elapsed:.1f} s elapsed{left(*(each.value for each in batch.points))}"
        if shown.live:
            ordered = sorted(events, key=attrgetter("arclength"))  # as they are numbered in family.json
            rows = [
                ("points", f"{seen[0]}, at most {most} each way"),
                (parameter, value + ("" if until is None else f" on the way to {with_unit(until, parameter, system)}")),
                ("period", _lasting(point.period, system, 9)), ("stability", point.stability),
                ("step", f"{point.step:.2g}"), ("time", told), ("events", str(len(events))),
            ]  # fmt: skip
            last = [
                f"{ordered.index(late):>3}  {event_words(late, parameter, system)}" for late in events[-LAST_EVENTS:]
            ]
            shown.show(Report(name, rows, last))
        elif seen[0] % 10 < len(batch.points):
            shown.say(
                f"{plural(seen[0], 'point')}, {parameter} {point.value:.6g}, "
                f"period {_lasting(point.period, system, 6)}, "
                f"step {point.step:.2g}, {point.stability}, {told}"
            )

    return report
