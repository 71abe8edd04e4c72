"""Small self-contained SVG pictures that move by themselves: no script, no network, a few kilobytes.

Motion is declared (SMIL `animate`), so that a picture moves in a notebook, in a saved page and in a file.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from orbitfinder._runtime.inert import inert
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.families.registry import Look
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import given_units, unit_names, units
from orbitfinder.show.diagram import Diagram, mark_of
from orbitfinder.show.scene import Scene, evenly, extent, outlines

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""M. Okabe, K. Ito, Color Universal Design (2008), without the yellow that vanishes on white."""
SIZE = 220
"""Pixels on a side."""
BODY, TIP = COLOURS[0], COLOURS[1]
WIDTH, HEIGHT = 380, 250
"""Pixels of a family's diagram"""
LEFT, BELOW, AROUND = 66, 38, 12
"""Pixels of the margins of what has axes"""
LETTER = 6.2
"""Pixels of a digit of the numbers on axes"""


def picture(content: str, label: str, width: int = SIZE, height: int = SIZE) -> str:
    """An SVG element with an accessible name; its lines take the colour of the text around it."""
    return (
        f'<svg role="img" aria-label="{inert(label)}" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" style="max-width:100%;height:auto">{content}</svg>'
    )


def fitted(points: np.ndarray, size: int = SIZE, around: np.ndarray | None = None) -> np.ndarray:
    """Positions (..., 2) of x to the right and y up as pixels of a square, equal scales, centred as `around` is."""
    flat = (points if around is None else around).reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    scale = (size - 2 * 14.0) / max(float((high - low).max()), 1e-12)
    return np.asarray(size / 2 + (points - (low + high) / 2) * scale * np.array([1.0, -1.0]))


@dataclass(frozen=True)
class Axes:
    """Two axes with numbers: the range (low and high, 2 each, across and up), what they are, and the picture's size."""

    low: np.ndarray
    high: np.ndarray
    names: tuple[str, str]
    width: int = SIZE + LEFT - BELOW
    height: int = SIZE

    def place(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 2) of the plane as pixels."""
        room = np.array([self.width - LEFT - AROUND, self.height - BELOW - AROUND])
        share = (points - self.low) / nonzero(self.high - self.low)
        return np.asarray([LEFT, self.height - BELOW] + share * room * [1, -1])

    @property
    def frame(self) -> str:
        """Both axes, their numbers as many as there is room for, and their names."""
        bottom, right = self.height - BELOW, self.width - AROUND
        marks, words = [f"M {LEFT} {AROUND} V {bottom} H {right}"], []
        numbers = [ticks(self.low[k], self.high[k], most) for k, most in ((0, 6), (1, max(3, self.height // 36)))]
        wide = LETTER * max(len(text) for _, text in numbers[0]) + 8
        if wide * len(numbers[0]) > right - LEFT:
            numbers[0] = ticks(self.low[0], self.high[0], max(2, int((right - LEFT) / wide)))
        for at, text in numbers[0]:
            x = self.place(np.array([at, self.low[1]]))[0]
            marks.append(f"M {x:.1f} {bottom} v 4")
            words.append(_word(min(x, self.width - LETTER * len(text) / 2), bottom + 15, text))
        for at, text in numbers[1]:
            y = self.place(np.array([self.low[0], at]))[1]
            marks.append(f"M {LEFT} {y:.1f} h -4")
            words.append(_word(LEFT - 7, y + 3.5, text, "end"))
        lines = f'<path d="{" ".join(marks)}" fill="none" stroke="currentColor" stroke-opacity=".5"/>'
        names = [_word((LEFT + right) / 2, bottom + 31, self.names[0])]
        turned = f' transform="rotate(-90 11 {(bottom + AROUND) / 2:.1f})"'
        return lines + "".join([*words, *names, _word(11, (bottom + AROUND) / 2, self.names[1], more=turned)])


def label(name: str) -> str:
    """A coordinate's name for an axis of a figure: theta3 with its subscript, others as they are."""
    return re.sub(r"^theta(\d+)$", r"$\\theta_{\1}$", name)


def greek(name: str) -> str:
    """The same in plain text."""
    numbered = re.fullmatch(r"theta(\d*)", name)
    return (
        "\N{GREEK SMALL LETTER THETA}" + numbered.group(1).translate({ord("0") + k: 0x2080 + k for k in range(10)})
        if numbered
        else name
    )


def axis(model: Model, i: int, written: Callable[[str], str] = label) -> str:
    """A component's name for an axis, with its unit where that is known."""
    n = model.degrees_of_freedom
    name, unit, time = written(model.state_names[i % n]), unit_names(model)[i % n], units(model.system)["time"]
    if i >= n:
        name, unit = f"rate of {name}", f"{unit}/{time}" if unit and time else ""
    gap = "\N{NO-BREAK SPACE}" if model.state_names[i] in given_units(model.system) else " "  # stays, see `worded`
    return f"{name}{gap}({unit})" if unit else name


def ticks(low: float, high: float, most: int) -> list[tuple[float, str]]:
    """Round numbers from low to high, at most `most` and where possible two, and how they are written."""
    span = nonzero(high - low)
    for power in (np.floor(np.log10(span)) + k for k in (-1, 0, 1)):
        for step in (factor * 10.0**power for factor in (1, 2, 5)):
            first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
            if last - first + 1 <= most:
                some = np.arange(first, last + 1) * step
                return [(x, _rounded(x, step).replace("-", "\N{MINUS SIGN}")) for x in map(float, some)]
    return [(float(low), f"{low:.4g}")]


def _rounded(number: float, step: float) -> str:
    """A multiple of a step with the digits that tell it from the next."""
    digits = int(-np.floor(np.log10(step) + 1e-9))
    if abs(number) < 1e7 and digits <= 4:
        return f"{number + 0.0:.{max(0, digits)}f}"
    return f"{number:.{max(1, digits + 1 + int(np.floor(np.log10(max(abs(number), step)) + 1e-9)))}g}"


def ranged(points: np.ndarray, share: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest (2 each) of points (k x 2), with some room; what does not change gets some."""
    low, high = points.min(axis=0), points.max(axis=0)
    room = np.maximum(share * (high - low), np.where(high - low > 1e-9 * np.abs(points).max(), 0.0, 0.02))
    return low - room, high + room


def _word(x: float, y: float, said: str, anchor: str = "middle", more: str = "") -> str:
    """A text in the size of axes."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="11" fill="currentColor"{more}>'
        f"{inert(said)}</text>"
    )


def path(points: np.ndarray) -> str:
    """The `points` attribute of a polyline (k x 2)."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


def frames_of(samples: np.ndarray, joints: int) -> np.ndarray:
    """Indices of the samples (first and last included) that are drawn, fewer for many joints."""
    most = max(12, min(60, 150_000 // (12 * joints)))  # bytes of motion in a picture, 12 a joint
    return np.array(evenly(len(samples), most + 1))


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


def moving_mechanism(scene: Scene, label: str, around: np.ndarray | None = None) -> str:
    """A mechanism through one period, the path of its end behind it, on its ground; the scale is that of the points
    `around` (k x 2 x j), where several pictures share it."""
    positions, duration = scene.points, scene.period
    around = positions if around is None else around
    window, size = _upright(around), extent(around)
    places = fitted(_upright(positions), around=window)
    below = "" if scene.ground is None else path(fitted(_upright(scene.ground[0]), around=window))
    shown = frames_of(positions, sum(line.shape[1] for _, line in outlines(positions[0], scene.strokes, size)))
    moving = zip(*(outlines(positions[k], scene.strokes, size) for k in shown), strict=True)
    lines = list[str]()
    for frames in moving:
        each = [fitted(_upright(line), around=window) for _, line in frames]
        still = max(float(np.abs(frame - each[0]).max()) for frame in each) < 0.05
        moves = "" if still else motion("points", [path(frame) for frame in each], duration)
        lines.append(f'<polyline points="{path(each[0])}" {LOOKS[frames[0][0]]}>{moves}</polyline>')
    trace = path(places[:: max(1, len(places) // 200), -1])
    fixed = np.ptp(places, axis=0).max(axis=1) < 0.5
    joints = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="currentColor"/>' for x, y in places[0][fixed])
    floor = f'<polyline points="{below}" fill="none" stroke="currentColor" stroke-opacity=".6"/>' if below else ""
    return picture(
        f'{floor}<polyline points="{trace}" fill="none" stroke="{TIP}" stroke-opacity=".45"/>'
        f"{''.join(lines)}{joints}{'' if fixed[-1] else dot(places[shown, -1], duration)}",
        label,
    )


def _upright(points: np.ndarray) -> np.ndarray:
    """Points (..., 2 x m) of x down and y right as (..., m x 2), right and up."""
    return np.stack([points[..., 1, :], -points[..., 0, :]], axis=-1)


LOOKS = {
    **dict.fromkeys(
        ("rod", "bone"), f'fill="none" stroke="{BODY}" stroke-width="3" stroke-linejoin="round" stroke-linecap="round"'
    ),
    "spring": 'fill="none" stroke="currentColor" stroke-opacity=".7" stroke-width="1.2"',
    "disc": f'fill="none" stroke="{BODY}" stroke-width="1.5"',
    "slider": f'fill="{BODY}"',
    "ground": 'fill="currentColor"',
}
"""How each kind of stroke is drawn"""


def moving_portrait(
    places: np.ndarray,
    duration: float,
    names: tuple[str, str],
    cuts: Sequence[int] = (),
    around: tuple[np.ndarray, np.ndarray] | None = None,
    marks: Sequence[tuple[str, np.ndarray]] = (),
) -> str:
    """One component against another over one period (k x 2, `names` across and up), with a dot that moves in time.

    Dashed across the `cuts`, the samples that come right after a jump (k: from the last to the first). `around`: the
    range of the axes, where several portraits share it. `marks` are named places (2).
    """
    axes = Axes(*(around or ranged(places)), names)
    drawn_at = axes.place(places)
    beside = [j % len(places) for k in cuts for j in (k - 1, k)]
    kept = np.unique([*np.linspace(0, len(places) - 1, 240).round().astype(int), *beside])
    whole = np.split(kept, np.searchsorted(kept, cuts))
    drawn = [(drawn_at[part], "") for part in whole if part.size]
    drawn += [(drawn_at[[k - 1, k % len(places)]], ' stroke-opacity=".6" stroke-dasharray="3 3"') for k in cuts]
    lines = "".join(
        f'<polyline points="{path(line)}" fill="none" stroke="{BODY}" stroke-width="1.5"{dashed}/>'
        for line, dashed in drawn
    )
    for name, (x, y) in [(name, axes.place(place)) for name, place in marks]:
        lines += f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="currentColor"/>{_word(x + 5, y - 5, name, "start")}'
    moving = dot(drawn_at[frames_of(drawn_at, 1)], duration)
    return picture(f"{axes.frame}{lines}{moving}", f"{names[1]} against {names[0]}", axes.width, axes.height)


def curves(lines: Sequence[tuple[str, np.ndarray]], across: str, up: str) -> str:
    """Named curves (k x 2 each) in colours of their own, each with its name at the right."""
    axes = Axes(*ranged(np.vstack([line for _, line in lines])), (across, up), WIDTH, HEIGHT)
    drawn, colours = [axes.frame], (*COLOURS[:6], "currentColor")
    for k, (name, points) in enumerate(lines):
        colour = colours[k % len(colours)]
        drawn.append(f'<polyline points="{path(axes.place(points))}" fill="none" stroke="{colour}"/>')
        x, y = WIDTH - AROUND - 4, AROUND + 12 * (k + 1)
        drawn.append(f'<text x="{x}" y="{y}" text-anchor="end" font-size="11" fill="{colour}">{inert(name)}</text>')
    return picture("".join(drawn), f"{up} over {across}", WIDTH, HEIGHT)


def unit_circle(multipliers: np.ndarray, label: str) -> str:
    """Multipliers in the plane beside the unit circle; those further out sit on the rim, hollow."""
    reach, size = 1.6, 150
    inside = np.abs(multipliers) <= reach
    drawn = np.where(inside, multipliers, reach * multipliers / nonzero(np.abs(multipliers)))
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


def plane_of(drawn: Diagram) -> Axes:
    """The axes of a family's diagram: the range of its points."""
    return Axes(*ranged(drawn.points), drawn.names, WIDTH, HEIGHT)


def diagram(drawn: Diagram) -> str:
    """The curve of a family: solid where stable, dashed where not, a dot that names itself at each event."""
    marks = [(f"{event.kind.replace('_', ' ')} at {event.parameter:.6g} {event.detail}", place, mark_of(event))
             for event, place in zip(drawn.family.events, drawn.events, strict=True)]  # fmt: skip
    said = " against ".join(drawn.names[::-1]) + (" of the family" if len(drawn.family.parameters) < 2 else "")
    return drawn_curve(plane_of(drawn), drawn.stretches, marks, said)


def drawn_curve(
    axes: Axes, stretches: Sequence[tuple[bool | None, np.ndarray]], marks: Sequence[tuple[str, np.ndarray, Look]],
    said: str,
) -> str:  # fmt: skip
    """A curve in stretches (k x 2) that are stable or not, and named marks on it."""
    lines = [axes.frame]
    for stable, run in stretches:
        dash = "" if stable else ' stroke-dasharray="5 4"'
        line = path(axes.place(run))
        lines.append(f'<polyline points="{line}" fill="none" stroke="{COLOURS[0]}" stroke-width="2"{dash}/>')
    lines += [glyph(look, axes.place(point), name) for name, point, look in marks]
    return picture("".join(lines), said, WIDTH, HEIGHT)


SHAPES = {
    "s": "M-4-4H4V4H-4Z", "D": "M0-6L6 0L0 6L-6 0Z", "d": "M0-6L4 0L0 6L-4 0Z", "^": "M0-5L5 4H-5Z",
    "v": "M0 5L5-4H-5Z", "<": "M-5 0L4-5V5Z", ">": "M5 0L-4-5V5Z", "P": "M-5 0H5M0-5V5", "x": "M-4-4L4 4M-4 4L4-4",
    "X": "M-4-4L4 4M-4 4L4-4", ".": "M-2.5 0a2.5 2.5 0 1 0 5 0a2.5 2.5 0 1 0-5 0", "*": "M0-6V6M-5-3L5 3M-5 3L5-3",
}  # fmt: skip
"""Markers as paths; any other is a disc"""


def glyph(look: Look, place: np.ndarray, name: str) -> str:
    """A mark of an event as pages without script have it, with its name."""
    shape = SHAPES.get(look.marker, "M-4 0a4 4 0 1 0 8 0a4 4 0 1 0-8 0")
    colour = "currentColor" if look.colour == "#000000" else look.colour
    open_ = look.hollow or not re.search("[Za]", shape)
    where = f'transform="translate({place[0]:.1f} {place[1]:.1f})" stroke="{colour}" stroke-width="1.5"'
    return f'<path d="{shape}" {where} fill="{"none" if open_ else colour}"><title>{inert(name)}</title></path>'


def key(looks: Mapping[str, Look]) -> str:
    """What marks are called, beside each."""
    drawn = {name: picture(glyph(look, np.full(2, 7.0), name), name, 14, 14) for name, look in looks.items()}
    return " &ensp; ".join(f"{mark} {inert(name)}" for name, mark in drawn.items())
