"""What a notebook shows of an Orbit, a Certificate, a Family or an Atlas: a little HTML that moves.

Everything is inline: no script, no style sheet, no network. Names and titles are escaped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np

from orbitfinder._runtime.inert import inert
from orbitfinder._runtime.notebook import Shown, facts
from orbitfinder.atlas.store import Atlas
from orbitfinder.control.optimum import Optima
from orbitfinder.errors import FAILURES, plural
from orbitfinder.families.equilibrium import Equilibria
from orbitfinder.families.members import STEADY
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.loops.problem import Count, Problem
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.model import Model, between, positions
from orbitfinder.mechanics.scales import unit_names, worded
from orbitfinder.orbits.certify import shown
from orbitfinder.orbits.course import Course, course, sampled
from orbitfinder.orbits.simulate import Simulation
from orbitfinder.orbits.sweep import Sweep
from orbitfinder.records.certificate import Certificate
from orbitfinder.records.family import Family, FamilyPoint
from orbitfinder.records.orbit import Orbit
from orbitfinder.show.diagram import diagram_of, entitled, mark_of
from orbitfinder.show.facts import conserves, has_path, numbers, sides, verdict_of
from orbitfinder.show.rest import names_of, rest_svg
from orbitfinder.show.scene import Scene, cuts_of, equal_times, evenly, landmarks
from orbitfinder.show.svg import (
    axis,
    curves,
    diagram,
    greek,
    key,
    moving_mechanism,
    moving_portrait,
    ranged,
    unit_circle,
)
from orbitfinder.structures.torus import Tori

SAMPLES = 121
"""Points of one period where an object carries no dense samples."""
EVENLY = 480
"""Points of a period of a hybrid orbit, whose samples are not at equal times."""
MOST, LISTED = 12, 24
"""Names of parameters and orbits of an atlas, and rows of other tables, that are shown"""
ROW = "display:flex;flex-wrap:wrap;gap:16px;align-items:center"
CELL = "text-align:left;padding:1px 10px 1px 0;font-variant-numeric:tabular-nums"


def html(value: Any) -> str | None:
    """HTML of one of ours; None for anything else, and for a drawing that fails (the plain text remains)."""
    maker = next((make for kind, make in MAKERS.items() if isinstance(value, kind)), None)
    if maker is None:
        return None
    try:
        return worded(
            maker(value), getattr(value, "system", None) or getattr(getattr(value, "model", None), "system", {})
        )
    except FAILURES:
        return None


def plain_html(value: Shown, rows: Sequence[tuple[str, str]] = (), pictures: Sequence[str] = ()) -> str:
    """What its one line names as a table, with more rows, and pictures before it."""
    body = f'<div style="{ROW}">{"".join(pictures)}{table([*facts(value), *rows])}</div>'
    return f"<div>{heading(type(value).__name__)}{body}</div>"


def model_html(model: Model) -> str:
    """What a Model describes: its coordinates and parameters by name and unit, and what is conserved."""
    names = [axis(model, k, greek) for k in range(len(unit_names(model)))]
    parameters = [f"{name} = {value:.9g}" for name, value in model.named_parameters.items()]
    kept = ", ".join(invariant.name for invariant in model.invariants) or "nothing"
    rows = [
        ("coordinates" if model.rates is None else "states", ", ".join(names[:MOST])),
        ("parameters", ", ".join(parameters[:MOST]) + (", ..." if len(parameters) > MOST else "")),
        ("conserved", kept),
    ]
    told = {"controls": ", ".join(model.controls), "cycle": " > ".join(model.cycle)}
    rows += [(name, text) for name, text in told.items() if text]
    kind = str(model.system.get("function") or model.system.get("kind", "")).replace("_", " ")
    return f"<div>{heading(f'Model {kind}'.strip())}{table(rows)}</div>"


def problem_html(problem: Problem) -> str:
    """What is asked, with the guess as a picture."""
    model, guess = problem.model, problem.guess
    pictures = []
    state = guess.start
    if model.points is not None and model.constraint is None and state.size == len(model.state_names):
        pose = positions(model, np.stack([state, state]))
        pictures = [moving_mechanism(Scene(pose, strokes=model.strokes, period=guess.period), "the guess")]
    return plain_html(problem, [("count", str(problem.count()))], pictures)


def count_html(count: Count) -> str:
    """Equations beside unknowns."""
    rows = [
        [(what, str(number)) for what, number in side.items() if number] for side in (count.equations, count.unknowns)
    ]
    beside = [(*left, *other) for left, other in zip_longest(*rows, fillvalue=("", ""))]
    said = "as many equations as unknowns" if count.freedom == 0 else f"{count.freedom} more unknowns than equations"
    return f"<div>{heading('Count', said)}{table(beside, ('equations', '', 'unknowns', ''))}</div>"


def simulation_html(run: Simulation) -> str:
    """What moved, each component over time."""
    names = [greek(name) for name in run.state_names[: max(1, len(run.state_names) // 2)]]
    kept = evenly(len(run.times), 400)
    lines = [(name, np.column_stack([run.times, run.states[:, k]])[kept]) for k, name in enumerate(names[:6])]
    rows = [("duration", f"{run.times[-1]:.6g} s"), ("samples", str(len(run.times)))]
    if np.isfinite(run.energy[0]):
        rows.append(("energy drift" if run.conserved else "energy change", f"{run.change:.2g} J"))
    body = f'<div style="{ROW}">{curves(lines, "time (s)", "coordinates")}{table(rows)}</div>'
    return f"<div>{heading('Simulation')}{body}</div>"


def sweep_html(sweep: Sweep) -> str:
    """A row for each value."""
    rows = []
    for row in sweep.rows:
        solved = ("", "") if row.orbit is None else (f"{row.orbit.period:.10g}", row.orbit.stability)
        values = (f"{row.values[name]:.9g}" for name in sweep.parameters)
        rows.append((*values, *solved, "yes" if row.certified else "no", row.reason))
    return _listed("Sweep", "row", rows, (*sweep.parameters, "period (s)", "stability", "certified", "why not"))


def equilibria_html(equilibria: Equilibria) -> str:
    """Their curve, what happens on it, and what its one line names."""
    rows = [(event.words, f"{equilibria.parameter} = {event.parameter:.9g}") for event in equilibria.events]
    return plain_html(equilibria, rows, [rest_svg(equilibria, names_of(equilibria))])


def optima_html(optima: Optima) -> str:
    """Parameter, cost and period of each controlled orbit."""
    told = zip(optima.points, optima.values, optima.costs, strict=True)
    rows = [(f"{value:.9g}", f"{cost:.9g}", f"{orbit.period:.10g}", orbit.stability) for orbit, value, cost in told]
    return _listed("Optima", "orbit", rows, (optima.parameter, "cost", "period (s)", "stability"), optima.end)


def tori_html(tori: Tori) -> str:
    """Rotation, period and energy of each torus."""
    rows = [(f"{torus.rotation:.9g}", f"{torus.period:.9g}", f"{torus.energy:.9g}") for torus in tori.tori]
    return _listed(f"Tori {tori.name}", "torus", rows, ("rotation (turns)", "period (s)", "energy (J)"), tori.end)


def _listed(what: str, noun: str, rows: Sequence[Sequence[str]], head: Sequence[str], below: str = "") -> str:
    """A table of the first rows, and how many there are."""
    many = f"{len(rows)} tori" if noun == "torus" and len(rows) != 1 else plural(len(rows), noun)
    title = f"{what}: {many}" + (f", the first {LISTED}" if len(rows) > LISTED else "")
    return f"<div>{heading(title, below)}{table(rows[:LISTED], head)}</div>"


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of texts, escaped."""
    top = "".join(f'<th style="{CELL}">{inert(name)}</th>' for name in head)
    cells = ("".join(f'<td style="{CELL}">{inert(text)}</td>' for text in row) for row in rows)
    body = "".join(f"<tr>{row}</tr>" for row in cells)
    return f"<table>{f'<tr>{top}</tr>' if top else ''}{body}</table>"


def heading(title: str, below: str = "") -> str:
    """A bold line and a plain one."""
    return f"<div><b>{inert(title)}</b>{f'<br>{inert(below)}' if below else ''}</div>"


def orbit_html(orbit: Orbit) -> str:
    """Mechanism and phase portrait moving in real time, multipliers, and the numbers."""
    drawable = len(orbit.samples) > 1 or np.abs(orbit.floquet_multipliers).max(initial=0.0) < STEADY
    pictures = "".join(motions(orbit)) if drawable else ""
    body = f'<div style="{ROW}">{pictures}{circle(orbit)}{table(numbers(orbit))}</div>'
    return f"<div>{heading(orbit.title or orbit.name, orbit.source)}{body}</div>"


def circle(orbit: Orbit) -> str:
    """The multipliers beside the unit circle."""
    return unit_circle(orbit.floquet_multipliers, "Floquet multipliers and the unit circle")


def motions(orbit: Orbit, model: Model | None = None) -> list[str]:
    """Mechanism (where one is declared) or path from two sides, and phase portrait of a period; `model` of a system
    that no file describes, nothing without it."""
    known = period_of(orbit, model)
    if known is None:
        return []
    model, seen = known
    views = views_of(model, seen) if has_path(model) else []
    if not views and model.points is not None:
        views = [mechanism(scene_of(model, seen))]
    return views if len(views) > 1 else [*views, Portrait(model, seen).svg()]


def views_of(model: Model, seen: Course) -> list[str]:
    """The path of what moves in a plane, or from above and from the side of what moves in space, in equal scales, and
    what is marked near it."""
    low, high, pairs = sides(_smooth(seen)[:, : len(model.planes)])
    drawn, middle, room = [], (low + high) / 2, 0.56 * float((high - low).max())
    for pair in pairs[:2]:
        view, chosen = Portrait(model, seen, pair), list(pair)
        around = middle[chosen] - room, middle[chosen] + room
        marks = [(name, np.array(place)[chosen]) for name, place, _ in landmarks(model)
                 if (np.abs(np.array(place)[: len(low)] - middle) < room).all()]  # fmt: skip
        drawn.append(view.svg(around, marks))
    return drawn


def period_of(orbit: Orbit, model: Model | None = None) -> tuple[Model, Course] | None:
    """The Model and the motion of an orbit; None for a system that no file describes and no `model` is."""
    try:
        model = model or build_model(orbit.system)
        return model, course(model, *_period(orbit, model), orbit.winding)
    except FAILURES:
        return None


def scene_of(model: Model, seen: Course) -> Scene:
    """What is drawn of a mechanism over a period."""
    moments = equal_times(seen.period, EVENLY)
    points = seen.positions(moments) if seen.jumps else positions(model, _smooth(seen))
    return Scene(points, strokes=model.strokes, ground=seen.grounds(moments[:1]), period=seen.period)


def mechanism(scene: Scene, around: np.ndarray | None = None) -> str:
    """The mechanism over a period, in the scale of the points `around` or its own."""
    return moving_mechanism(scene, f"the mechanism over {scene.period:.4g} s", around)


class Portrait:
    """Two components of a period against each other: those given, or the coordinate that moves most and its rate."""

    def __init__(self, model: Model, seen: Course, plane: tuple[int, int] | None = None) -> None:
        states = seen.states(equal_times(seen.period, EVENLY)) if seen.jumps else _smooth(seen)
        moved = np.ptp(states, axis=0)
        jumping = seen.jumps and model.rates is not None  # a clock among the states would turn most
        most = model.planes[0] if jumping else max(model.planes, key=lambda pair: moved[pair[0]])
        self.plane = across, up = plane or most
        self.period, self.places = seen.period, states[:, [across, up]]
        last = len(states) - bool(seen.turned[[across, up]].any())  # after a turn the first is somewhere else
        self.cuts = [k for k in dict.fromkeys(cuts_of(seen, equal_times(seen.period, EVENLY))) if 0 < k <= last]
        self.names = axis(model, across, greek), axis(model, up, greek)

    @property
    def extent(self) -> float:
        """What its component across changes by."""
        return float(np.ptp(self.places[:, 0]))

    def svg(
        self, around: tuple[np.ndarray, np.ndarray] | None = None, marks: Sequence[tuple[str, np.ndarray]] = ()
    ) -> str:
        """The picture, with a dot that moves, and named places."""
        return moving_portrait(self.places, self.period, self.names, self.cuts, around, marks)


def _smooth(seen: Course) -> np.ndarray:
    """States over a period without jumps, its end included, at as many times as curves need."""
    (piece,) = seen.pieces
    if len(piece.times) >= EVENLY // 2:
        return piece.states
    return between(piece.times, piece.states, piece.model.degrees_of_freedom, np.linspace(0.0, seen.period, EVENLY + 1))


def range_of(portraits: Sequence[Portrait]) -> tuple[np.ndarray, np.ndarray]:
    """The axes that several portraits share."""
    return ranged(np.vstack([portrait.places for portrait in portraits]))


def _period(orbit: Orbit, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Times and states over a period, integrated from the state where none are recorded."""
    if (given := shown(orbit, model)) is not None:
        return given
    if not model.smooth:
        return sampled(model, orbit.state, orbit.period)
    return np.linspace(0.0, orbit.period, SAMPLES), sample(build_flow(model), orbit.state, orbit.period, SAMPLES)


def certificate_html(certificate: Certificate) -> str:
    """Every check with its number, what is allowed and its note."""
    rows = []
    for check in certificate.checks:
        sense, yes = check.sense, "yes" if check.passed else "no"
        numbers = (f"{check.value:.2e}", f"{sense} {check.tolerance:.2e}") if sense else (yes, "yes")
        rows.append((check.name, *numbers, "passed" if check.passed else "FAILED", check.note))
    scale = f"closure tolerances scaled by {certificate.scale:.3g}"
    checks = table(rows, ("check", "value", "asked", "result", "note"))
    return f"<div>{heading(f'Certificate: {verdict_of(certificate)}', scale)}{checks}</div>"


def family_html(family: Family) -> str:
    """Frequency against energy with stability and events, and three of its orbits moving."""
    counts: dict[str, int] = {}
    for event in family.events:
        counts[event.kind.replace("_", " ")] = counts.get(event.kind.replace("_", " "), 0) + 1
    events = ", ".join(plural(count, kind) for kind, count in counts.items()) or "none"
    ends = [(f"end {k + 1}", f"{end.kind}: {end.reason}") for k, end in enumerate(family.ends)]
    rows = [("orbits", str(len(family.points))), ("parameter", family.parameter), ("events", events), *ends]
    steady = [point for point in family.points if point.scale < STEADY]
    places = sorted({0, len(steady) // 2, len(steady) - 1}) if steady else []
    shown = _members([steady[place] for place in places], "" if family.unit else family.parameter)
    curve = diagram(diagram_of(family)) if family.points else ""
    kinds = key({event.kind.replace("_", " "): mark_of(event) for event in family.events})
    body = f'<div style="{ROW}"><div>{curve}<br>{kinds}</div>{table(rows)}</div><div style="{ROW}">{shown}</div>'
    title = entitled(family)
    named = (title, f"family {family.name}") if title != family.name else (f"Family {family.name}",)
    return f"<div>{heading(*named)}{body}</div>"


def _members(points: Sequence[FamilyPoint], parameter: str) -> str:
    """The mechanism of some orbits of a family in one scale, their numbers below; nothing where none is declared."""
    known = [(point, period_of(point)) for point in points]
    scenes = [(point, scene_of(*told)) for point, told in known if told is not None and told[0].points is not None]
    if not scenes:
        return ""
    around = np.concatenate([scene.points for _, scene in scenes])
    parts = []
    for point, scene in scenes:
        value = f"{parameter} = {point.value:.6g}" if parameter else f"E = {point.energy:.6g} J"
        below = f"{inert(value)}, T = {point.period:.5g} s<br>{inert(point.stability)}"
        parts.append(f"<div>{mechanism(scene, around)}<br>{below}</div>")
    return "".join(parts)


def atlas_html(atlas: Atlas) -> str:
    """How many orbits, the first of them in a table, the first three moving."""
    rows, energy = atlas.rows(), conserves(atlas)
    listed = [
        (str(row.id), *([f"{row.energy:.8g}"] if energy else []), f"{row.period:.10g}", row.symmetry, row.stability,
         f"{row.instability:.4g}")
        for row in rows[:MOST]
    ]  # fmt: skip
    steady = [atlas.orbit(row.id) for row in [row for row in rows if row.instability < STEADY][:3]]
    moving = "".join(picture for orbit in steady for picture in motions(orbit))
    head = ("id", *(["energy (J)"] if energy else []), "period (s)", "symmetry", "stability", "largest multiplier")
    more = f"the first {MOST} by {'energy and ' if energy else ''}period" if len(rows) > MOST else ""
    title = heading(f"Atlas {atlas.path.name}: {plural(len(rows), 'orbit')}", more)
    return f'<div>{title}{table(listed, head)}<div style="{ROW}">{moving}</div></div>'


MAKERS: dict[type, Callable[[Any], str]] = {
    Orbit: orbit_html, Certificate: certificate_html, Family: family_html, Atlas: atlas_html, Model: model_html,
    Problem: problem_html, Count: count_html, Simulation: simulation_html, Sweep: sweep_html,
    Optima: optima_html, Tori: tori_html, Equilibria: equilibria_html, Shown: plain_html,
}  # fmt: skip
"""By class: what draws it; the last takes what is none of the others"""
