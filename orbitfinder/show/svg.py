"""Small self-contained SVG pictures that move by themselves: no script, no network, a few kilobytes.

Motion is declared (SMIL `animate`), so that a picture moves in a notebook, in a saved page and in a file.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from orbitfinder.records.family import Event, Family, FamilyPoint

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""M. Okabe, K. Ito, Color Universal Design (2008), without the yellow that vanishes on white."""
SIZE = 220
"""Pixels on a side."""
MARGIN = 14.0
FRAMES = 60
LARGEST = 150_000
"""Bytes of motion in one picture; mechanisms of many joints get fewer frames."""
BODY, TIP = COLOURS[0], COLOURS[1]
WIDTH, HEIGHT, LEFT, BELOW, AROUND = 380, 240, 52, 38, 12
"""Pixels of a family's diagram, and of its margins"""


def picture(content: str, label: str, width: int = SIZE, height: int = SIZE) -> str:
    """An SVG element with an accessible name; its lines take the colour of the text around it."""
    return (
        f'<svg role="img" aria-label="{escape(label, quote=True)}" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" style="max-width:100%;height:auto">{content}</svg>'
    )


def fitted(points: np.ndarray, size: int = SIZE, around: np.ndarray | None = None) -> np.ndarray:
    """Positions (..., 2) of x to the right and y up as pixels of a square, equal scales, centred as `around` is."""
    flat = (points if around is None else around).reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = (size - 2 * MARGIN) / max(float((high - low).max()), 1e-12)
    return np.asarray(size / 2 + (points - (low + high) / 2) * scale * np.array([1.0, -1.0]))


def stretched(points: np.ndarray, size: int = SIZE) -> np.ndarray:
    """The same with each axis filling the square."""
    low, room = points.min(axis=0), size - 2 * MARGIN
    share = (points - low) / np.maximum(np.ptp(points, axis=0), 1e-12)
    return np.asarray([MARGIN, size - MARGIN] + room * share * [1, -1])


def path(points: np.ndarray) -> str:
    """The `points` attribute of a polyline (k x 2)."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def frames_of(samples: np.ndarray, joints: int) -> np.ndarray:
    """Indices of the samples (first and last included) that are drawn, fewer for many joints."""
    most = max(12, min(FRAMES, LARGEST // (12 * joints)))
    return np.unique(np.linspace(0, len(samples) - 1, most + 1).round().astype(int))


def motion(attribute: str, values: Sequence[str], duration: float) -> str:
    """An endless animation of an attribute through `values`, in `duration` s."""
    return (
        f'<animate attributeName="{attribute}" dur="{duration:.6g}s" repeatCount="indefinite" '
        f'values="{";".join(values)}"/>'
    )


def dot(places: np.ndarray, duration: float) -> str:
    """A disc that moves through `places` (k x 2) in `duration` s."""
    moves = [motion(name, [f"{x:.1f}" for x in places[:, k]], duration) for k, name in enumerate(("cx", "cy"))]
    return f'<circle cx="{places[0][0]:.1f}" cy="{places[0][1]:.1f}" r="4" fill="{TIP}">{"".join(moves)}</circle>'


def moving_mechanism(positions: np.ndarray, duration: float, label: str, ground: np.ndarray | None = None) -> str:
    """A polyline through one period: `positions` (k x 2 x m; x down, y right), the path of its end behind it, and what
    it stands on (2 x g)."""
    places = np.stack([positions[:, 1, :], -positions[:, 0, :]], axis=-1)
    floor = np.zeros((0, 2)) if ground is None else fitted(ground[::-1].T * [1, -1], around=places)
    places = fitted(places)
    shown = places[frames_of(places, places.shape[1])]
    tip = places[:: max(1, len(places) // 200), -1]
    fixed = np.ptp(places, axis=0).max(axis=1) < 0.5
    joints = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="currentColor"/>' for x, y in places[0][fixed])
    below = f'<polyline points="{path(floor)}" fill="none" stroke="currentColor" stroke-opacity=".6"/>'
    return picture(
        f"{below if len(floor) else ''}"
        f'<polyline points="{path(tip)}" fill="none" stroke="{TIP}" stroke-opacity=".45"/>'
        f'<polyline points="{path(shown[0])}" fill="none" stroke="{BODY}" stroke-width="3" stroke-linejoin="round">'
        f"{motion('points', [path(one) for one in shown], duration)}</polyline>{joints}"
        f"{'' if fixed[-1] else dot(shown[:, -1], duration)}",
        label,
    )


def moving_portrait(
    coordinate: np.ndarray, rate: np.ndarray, duration: float, label: str, cuts: Sequence[int] = ()
) -> str:
    """Rate against coordinate over one period (k each), with a dot that moves in time; dashed across the `cuts`, the
    samples that come right after a jump (k: from the last to the first)."""
    places = stretched(np.column_stack([coordinate, rate]))
    beside = [j % len(places) for k in cuts for j in (k - 1, k)]
    kept = np.unique([*np.linspace(0, len(places) - 1, 240).round().astype(int), *beside])
    whole = np.split(kept, np.searchsorted(kept, cuts))
    drawn = [(places[one], "") for one in whole if one.size]
    drawn += [(places[[k - 1, k % len(places)]], ' stroke-opacity=".6" stroke-dasharray="3 3"') for k in cuts]
    words = f'<text x="{SIZE / 2}" y="{SIZE - 3}" text-anchor="middle" font-size="10" fill="currentColor">'
    lines = "".join(
        f'<polyline points="{path(line)}" fill="none" stroke="{BODY}" stroke-width="1.5"{dashed}/>'
        for line, dashed in drawn
    )
    return picture(
        f"{lines}{dot(places[frames_of(places, 1)], duration)}{words}{escape(label)}</text>",
        label,
    )


def unit_circle(multipliers: np.ndarray, label: str, size: int = 150) -> str:
    """Multipliers in the plane beside the unit circle; those further out sit on the rim, hollow."""
    reach = 1.6
    inside = np.abs(multipliers) <= reach
    drawn = np.where(inside, multipliers, reach * multipliers / np.maximum(np.abs(multipliers), 1e-300))
    scale, half = (size / 2 - 8) / reach, size / 2
    dots = "".join(
        f'<circle cx="{half + z.real * scale:.1f}" cy="{half - z.imag * scale:.1f}" r="3.5" stroke="{TIP}" '
        f'fill="{TIP if near else "none"}"/>'
        for z, near in zip(drawn, inside, strict=True)
    )
    axes = (
        f'<path d="M 4 {half} H {size - 4} M {half} 4 V {size - 4}" stroke="currentColor" stroke-opacity=".25"/>'
        f'<circle cx="{half}" cy="{half}" r="{scale:.1f}" fill="none" stroke="currentColor" stroke-opacity=".6"/>'
    )
    return picture(axes + dots, label, size, size)


def runs(points: Sequence[FamilyPoint]) -> list[tuple[bool, list[FamilyPoint]]]:
    """Maximal stretches of points with the same verdict (stable or not), each joined to the next."""
    found: list[tuple[bool, list[FamilyPoint]]] = []
    for point in points:
        stable = point.stability != "unstable"
        if not found or found[-1][0] != stable:
            joined = [found[-1][1][-1]] if found else []
            found.append((stable, joined))
        found[-1][1].append(point)
    return found


def diagram(family: Family) -> str:
    """Frequency against energy, or the second parameter of a curve of bifurcations against its first.

    Solid where stable, dashed where not, a dot that names itself at each event.
    """
    if not family.points:
        return ""
    names, places = family.parameters, family.places
    if len(names) < 2:
        names = ("energy (J)", "frequency (1/s)")
        places = np.column_stack([
            [*family.values("energy"), *(one.energy for one in family.events)],
            [*(1 / family.values("period")), *(1 / one.period for one in family.events)],
        ])  # fmt: skip
    at = dict(zip(map(id, (*family.points, *family.events)), places, strict=True))
    low, span = (
        places[: len(family.points)].min(axis=0),
        np.maximum(np.ptp(places[: len(family.points)], axis=0), 1e-12),
    )
    room = np.array([WIDTH - LEFT - AROUND, HEIGHT - BELOW - AROUND])

    def place(*some: FamilyPoint | Event) -> np.ndarray:
        share = (np.array([at[id(one)] for one in some]) - low) / span
        return np.asarray([LEFT, HEIGHT - BELOW] + share * room * [1, -1])

    lines = []
    for stable, run in runs(family.points):
        dash = "" if stable else ' stroke-dasharray="5 4"'
        lines.append(
            f'<polyline points="{path(place(*run))}" fill="none" stroke="{COLOURS[0]}" stroke-width="2"{dash}/>'
        )
    for event in family.events:
        ((x, y),) = place(event)
        name = escape(f"{event.kind.replace('_', ' ')} at {event.parameter:.6g} {event.detail}")
        lines.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{COLOURS[1]}"><title>{name}</title></circle>')
    said = "frequency against energy of the family" if len(family.parameters) < 2 else " against ".join(names[::-1])
    return picture("".join([_frame(low, span, names), *lines]), escape(said), WIDTH, HEIGHT)


def _frame(low: object, span: object, names: Sequence[str]) -> str:
    """Axes with the range at their ends and what they are."""
    start, width = np.asarray(low, float), np.asarray(span, float)
    bottom, right = HEIGHT - BELOW, WIDTH - AROUND

    def text(x: float, y: float, said: str, anchor: str, more: str = "") -> str:
        return f'<text x="{x}" y="{y}" text-anchor="{anchor}" font-size="11" fill="currentColor"{more}>{said}</text>'

    return "".join([
        f'<path d="M {LEFT} {AROUND} V {bottom} H {right}" fill="none" stroke="currentColor" stroke-opacity=".5"/>',
        text(LEFT, bottom + 15, f"{start[0]:.4g}", "start"),
        text(right, bottom + 15, f"{start[0] + width[0]:.4g}", "end"),
        text((LEFT + right) / 2, bottom + 30, escape(names[0]), "middle"),
        text(LEFT - 5, bottom, f"{start[1]:.3g}", "end"),
        text(LEFT - 5, AROUND + 10, f"{start[1] + width[1]:.3g}", "end"),
        text(12, bottom / 2, escape(names[1]), "middle", f' transform="rotate(-90 12 {bottom / 2})"'),
    ])  # fmt: skip
