"""A family as one SVG: frequency against energy, stability by line style, events marked."""

from __future__ import annotations

from html import escape

import numpy as np

from orbitfinder.records.family import Family
from orbitfinder.show.family_plot import runs
from orbitfinder.show.style import COLOURS
from orbitfinder.show.svg import path, picture

WIDTH, HEIGHT, LEFT, BELOW, AROUND = 380, 240, 52, 38, 12


def diagram(family: Family) -> str:
    """Solid where stable, dashed where not, a dot with its name (on hovering) at each event."""
    if not family.points:
        return ""
    across, up = family.values("energy"), 1 / family.values("period")
    low, span = np.array([across.min(), up.min()]), np.maximum([np.ptp(across), np.ptp(up)], 1e-12)
    room = np.array([WIDTH - LEFT - AROUND, HEIGHT - BELOW - AROUND])

    def place(energy: np.ndarray, frequency: np.ndarray) -> np.ndarray:
        share = (np.column_stack([energy, frequency]) - low) / span
        return np.asarray([LEFT, HEIGHT - BELOW] + share * room * [1, -1])

    lines = []
    for stable, run in runs(family.points):
        curve = place(np.array([p.energy for p in run]), np.array([1 / p.period for p in run]))
        dash = "" if stable else ' stroke-dasharray="5 4"'
        lines.append(f'<polyline points="{path(curve)}" fill="none" stroke="{COLOURS[0]}" stroke-width="2"{dash}/>')
    for event in family.events:
        ((x, y),) = place(np.array([event.energy]), np.array([1 / event.period]))
        name = escape(f"{event.kind.replace('_', ' ')} at {event.parameter:.6g} {event.detail}")
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{COLOURS[1]}"><title>{name}</title></circle>')
    return picture("".join([_frame(low, span), *lines]), "frequency against energy of the family", WIDTH, HEIGHT)


def _frame(low: object, span: object) -> str:
    """Axes with the range at their ends and what they are."""
    start, width = np.asarray(low, float), np.asarray(span, float)
    bottom, right = HEIGHT - BELOW, WIDTH - AROUND

    def text(x: float, y: float, said: str, anchor: str, more: str = "") -> str:
        return f'<text x="{x}" y="{y}" text-anchor="{anchor}" font-size="11" fill="currentColor"{more}>{said}</text>'

    return "".join([
        f'<path d="M {LEFT} {AROUND} V {bottom} H {right}" fill="none" stroke="currentColor" stroke-opacity=".5"/>',
        text(LEFT, bottom + 15, f"{start[0]:.4g}", "start"),
        text(right, bottom + 15, f"{start[0] + width[0]:.4g}", "end"),
        text((LEFT + right) / 2, bottom + 30, "energy (J)", "middle"),
        text(LEFT - 5, bottom, f"{start[1]:.3g}", "end"),
        text(LEFT - 5, AROUND + 10, f"{start[1] + width[1]:.3g}", "end"),
        text(12, bottom / 2, "frequency (1/s)", "middle", f' transform="rotate(-90 12 {bottom / 2})"'),
    ])  # fmt: skip
