"""What a notebook shows of an Orbit, a Certificate, a Family or an Atlas: a little HTML that moves.

Everything is inline: no script, no style sheet, no network. Names and titles are escaped.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape
from typing import Any

import numpy as np

from orbitfinder.atlas.store import Atlas
from orbitfinder.errors import OrbitfinderError, plural
from orbitfinder.families.members import STEADY
from orbitfinder.integrate.cvodes import build_flow, sample
from orbitfinder.mechanics.catalogue import build_model
from orbitfinder.mechanics.model import Model, positions
from orbitfinder.orbits.course import course, sampled
from orbitfinder.records.family import Family, FamilyPoint
from orbitfinder.records.orbit import Certificate, Orbit, asked
from orbitfinder.show.svg import diagram, moving_mechanism, moving_portrait, unit_circle

SAMPLES = 121
"""Points of one period where an object carries no dense samples."""
EVENLY = 481
"""Points of a period of a hybrid orbit, whose samples are not at equal times."""
ROWS = 12
"""Orbits of an atlas in its table."""
ROW = "display:flex;flex-wrap:wrap;gap:16px;align-items:center"
CELL = "text-align:left;padding:1px 10px 1px 0;font-variant-numeric:tabular-nums"


def html(value: Any) -> str | None:
    """HTML of one of ours; None for anything else, and for a drawing that fails (the plain text remains)."""
    makers: dict[type, Callable[[Any], str]]
    makers = {Orbit: orbit_html, Certificate: certificate_html, Family: family_html, Atlas: atlas_html}
    maker = next((one for kind, one in makers.items() if isinstance(value, kind)), None)
    if maker is None:
        return None
    try:
        return maker(value)
    except OrbitfinderError:
        return None


def table(rows: Iterable[Sequence[str]], head: Sequence[str] = ()) -> str:
    """A table of texts, escaped."""
    top = "".join(f'<th style="{CELL}">{escape(one)}</th>' for one in head)
    body = "".join("<tr>" + "".join(f'<td style="{CELL}">{escape(one)}</td>' for one in row) + "</tr>" for row in rows)
    return f"<table>{f'<tr>{top}</tr>' if top else ''}{body}</table>"


def heading(title: str, below: str = "") -> str:
    """A bold line and a plain one."""
    return f"<div><b>{escape(title)}</b>{f'<br>{escape(below)}' if below else ''}</div>"


def orbit_html(orbit: Orbit) -> str:
    """Mechanism and phase portrait moving in real time, multipliers, and the numbers."""
    certificate = orbit.certificate
    verdict = "no certificate" if certificate is None else verdict_of(certificate)
    if certificate is not None and orbit.record is not None:
        verdict = f"as its file has it, not checked here: {verdict}"
    sizes = np.abs(orbit.floquet_multipliers)
    largest = f"{sizes.max():.6g}" if sizes.size else "none but the trivial ones"
    energy = f"{orbit.energy:.12g} J" if np.isfinite(orbit.energy) else "none is conserved"
    rows = [
        ("period", f"{orbit.period:.12g} s"), ("energy", energy),
        ("closure", f"{orbit.closure:.1e}"), ("stability", orbit.stability), ("symmetry", orbit.symmetry),
        ("largest multiplier", largest), ("certificate", verdict),
    ]  # fmt: skip
    circle = unit_circle(orbit.floquet_multipliers, "Floquet multipliers and the unit circle")
    drawable = len(orbit.samples) > 1 or sizes.max(initial=0.0) < STEADY
    pictures = "".join(motions(orbit)) if drawable else ""
    body = f'<div style="{ROW}">{pictures}{circle}{table(rows)}</div>'
    return f"<div>{heading(orbit.title or orbit.name, orbit.source)}{body}</div>"


def motions(orbit: Orbit) -> list[str]:
    """Mechanism (where one is declared) and phase portrait of a period; nothing for a system that no file describes."""
    try:
        model = build_model(orbit.system)
        seen = course(model, *_period(orbit, model), orbit.winding)
    except OrbitfinderError:
        return []
    moments = np.linspace(0.0, seen.period, EVENLY)[:-1]
    states = seen.states(moments) if seen.jumps else seen.samples
    moved, period = np.ptp(states, axis=0), orbit.period
    jumping = seen.jumps and model.rates is not None  # a clock among the states would turn most
    across, up = model.planes[0] if jumping else max(model.planes, key=lambda pair: moved[pair[0]])
    name = model.state_names[across]
    against = f"rate of {name}" if model.rates is None else model.state_names[up]
    after = np.searchsorted(moments, [at for at, _ in seen.events])
    most = len(moments) - bool(seen.turned[[across, up]].any())  # after a turn the first is somewhere else
    cuts = [int(k) for k in dict.fromkeys(after) if 0 < k <= most]
    parts = [moving_portrait(states[:, across], states[:, up], period, f"{against} against {name}", cuts)]
    if model.points is not None:
        shown = seen.positions(moments) if seen.jumps else positions(model, states)
        lines = seen.grounds(moments[:1])
        ground = None if lines is None else lines[0]
        parts.insert(0, moving_mechanism(shown, period, f"the mechanism over {period:.4g} s", ground))
    return parts


def _period(orbit: Orbit, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Times and states over a period, integrated from the state where none are recorded."""
    if len(orbit.samples) > 1:
        return orbit.times, orbit.samples
    if model.hybrid is not None:
        return sampled(model, orbit.state, orbit.period)
    return np.linspace(0.0, orbit.period, SAMPLES), sample(build_flow(model), orbit.state, orbit.period, SAMPLES)


def verdict_of(certificate: Certificate) -> str:
    """passed, or the checks that failed."""
    count = len(certificate.checks)
    return f"passed, {plural(count, 'check')}" if certificate.passed else f"FAILED: {', '.join(certificate.failures)}"


def certificate_html(certificate: Certificate) -> str:
    """Every check with its number, what is allowed and its note."""
    rows = []
    for one in certificate.checks:
        sense, yes = asked(one.name, one.tolerance), "yes" if one.passed else "no"
        numbers = (f"{one.value:.2e}", f"{sense} {one.tolerance:.2e}") if sense else (yes, "yes")
        rows.append((one.name, *numbers, "passed" if one.passed else "FAILED", one.note))
    scale = f"closure tolerances scaled by {certificate.scale:.3g}"
    checks = table(rows, ("check", "value", "asked", "result", "note"))
    return f"<div>{heading(f'Certificate: {verdict_of(certificate)}', scale)}{checks}</div>"


def family_html(family: Family) -> str:
    """Frequency against energy with stability and events, and three of its orbits moving."""
    counts: dict[str, int] = {}
    for event in family.events:
        counts[event.kind.replace("_", " ")] = counts.get(event.kind.replace("_", " "), 0) + 1
    events = ", ".join(f"{count} {kind}" for kind, count in counts.items()) or "none"
    ends = [(f"end {k + 1}", f"{end.kind}: {end.reason}") for k, end in enumerate(family.ends)]
    rows = [("orbits", str(len(family.points))), ("parameter", family.parameter), ("events", events), *ends]
    steady = [point for point in family.points if point.scale < STEADY]
    places = sorted({0, len(steady) // 2, len(steady) - 1}) if steady else []
    shown = "".join(_member(steady[place]) for place in places)
    body = f'<div style="{ROW}">{diagram(family)}{table(rows)}</div><div style="{ROW}">{shown}</div>'
    return f"<div>{heading(f'Family {family.name}')}{body}</div>"


def _member(point: FamilyPoint) -> str:
    """The mechanism of one orbit of a family; nothing where none is declared."""
    pictures = motions(point)
    if len(pictures) < 2:
        return ""
    text = f"E = {point.energy:.6g} J, T = {point.period:.5g} s, {point.stability}"
    return f"<div>{pictures[0]}<br>{escape(text)}</div>"


def atlas_html(atlas: Atlas) -> str:
    """How many orbits, the first of them in a table, the first three moving."""
    rows = atlas.rows()
    numbers = [
        (str(row.id), f"{row.energy:.8g}", f"{row.period:.10g}", row.symmetry, row.stability, f"{row.instability:.4g}")
        for row in rows[:ROWS]
    ]
    steady = [atlas.orbit(row.id) for row in [row for row in rows if row.instability < STEADY][:3]]
    moving = "".join(picture for one in steady for picture in motions(one))
    head = ("id", "energy (J)", "period (s)", "symmetry", "stability", "largest multiplier")
    more = f"the first {ROWS} by energy and period" if len(rows) > ROWS else ""
    title = heading(f"Atlas {atlas.path.name}: {plural(len(rows), 'orbit')}", more)
    return f'<div>{title}{table(numbers, head)}<div style="{ROW}">{moving}</div></div>'
