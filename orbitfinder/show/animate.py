"""Moving pictures of planar mechanisms: GIF by Pillow, MP4 through the optional extra `mp4`.

Frames come at a constant rate in real time over a whole number of periods, so that the last frame
is followed by the first without a jump.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageColor, ImageDraw, ImageFont
from scipy.interpolate import CubicSpline

from orbitfinder._runtime.notebook import brief
from orbitfinder._runtime.sizes import nonzero
from orbitfinder.errors import InputError
from orbitfinder.families.members import whole
from orbitfinder.mechanics.kind import build_model
from orbitfinder.mechanics.lagrange import ISOMETRIC
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanics.scales import units
from orbitfinder.mechanisms.shapes import Solid, undescribed
from orbitfinder.orbits.course import course_of
from orbitfinder.records.orbit import Orbit
from orbitfinder.records.reading import write_atomically
from orbitfinder.show.facts import with_unit
from orbitfinder.show.scene import (
    BRUSHES,
    Scene,
    box,
    cuts_of,
    extent,
    filled,
    outlines,
    positions_at,
    rounds_of,
    solids_of,
    tip,
)
from orbitfinder.show.svg import COLOURS


@dataclass(frozen=True)
class AnimationSettings:
    """Size, rate and length of an animation."""

    pixels: int = 360
    rate: int = 25
    """frames per second; GIF counts time in hundredths of a second, so use a divisor of 100"""
    shortest: float = 2.0
    """s of motion at least, by repeating the period"""
    most_periods: int = 6
    periods: int | None = None
    """so many, where it is asked for"""
    steps: int = 4
    """footholds at least of what walks"""
    trace: float = 1.0
    """length of the tip's trace in units of the period or, for a simulation, in s"""
    supersampling: int = 3
    slow: float = 1.0
    """how many times slower than real time"""
    dark: bool = False
    fade: float = 0.6
    """s in which what does not repeat passes into its beginning"""


MOST_FRAMES, FLAT = 600, 0.25
"""Of an animation that goes on until what comes back turned is where it was; how low over its width a picture is at
least, and what moves where it is made so wide"""
VIDEO = AnimationSettings(pixels=1080, rate=60, supersampling=2)
"""What suits an .mp4, which is small at any size"""


@dataclass(frozen=True, repr=False)
class Clip(Scene):
    """A Scene to film: `points` (frames x 2 x k, x down and y right, m) and how long a frame lasts."""

    __repr__ = brief("title", "points", "rate")

    rate: int
    title: str
    trace: int
    """frames of the tip's path drawn behind it"""
    closed: bool = False
    """True when the last point is a fixed joint too (a linkage)"""
    slow: float = 1.0
    """how many times slower than real time"""
    space: np.ndarray | None = None
    """points in space (frames x 3 x k), where bodies have"""
    solids: Sequence[Solid] = ()
    unit: str = "s"
    """of its time, "" where the equations carry none"""


def loop_frames(period: float, settings: AnimationSettings) -> tuple[int, int]:
    """Periods and frames of a seamless loop: few periods whose rate is near to real time (0.2 % buys one less)."""
    if settings.periods is not None:
        return settings.periods, max(2, round(settings.periods * period * settings.rate))
    least = max(1, int(np.ceil(settings.shortest / period)))
    candidates = range(least, max(least, settings.most_periods) + 1)

    def error(count: int) -> float:
        exact = count * period * settings.rate
        return abs(round(exact) - exact) / exact + 0.002 * count

    best = min(candidates, key=error)
    return best, max(2, round(best * period * settings.rate))


def orbit_clip(orbit: Orbit, model: Model | None = None, settings: AnimationSettings | None = None) -> Clip:
    """A seamless clip of an orbit.

    Made of its dense samples; without them it is integrated again. Of a first-order system it is its state that
    moves, in the plane of two components.

    Args:
        orbit: what moves.
        model: needed only for systems that no file describes.
        settings: frames, length, size.

    Returns:
        A Clip for `of.save_animation`.

    Raises:
        InputError: for a system without positions that cannot be drawn.

    Examples:
        >>> of.orbit_clip(orbit).title
        'fast-swing'
    """
    settings = settings or AnimationSettings()
    model = model or build_model(orbit.system)
    if model.points is None and model.rates is None:
        raise InputError(f"{orbit.name}: this system declares no points to draw; pass points= when you build it")
    orbit = whole(orbit, model)
    course = course_of(orbit, model)
    lasts = settings.slow * orbit.period
    periods, frames = loop_frames(lasts, settings)
    if course.walks and settings.periods is None:
        steps = pairwise([*course.pieces, course.pieces[0]])
        landed = sum(np.any(piece.origin != after.origin) for piece, after in steps)
        periods = max(periods, -(-settings.steps // max(int(landed), 1)))
        frames = round(periods * lasts * settings.rate)
    if course.gained.any() and settings.periods is None:  # it comes back turned: so often that it is where it was
        rounds = rounds_of(model, course, max(settings.most_periods, MOST_FRAMES // round(lasts * settings.rate)))
        periods, frames = (rounds, round(rounds * lasts * settings.rate)) if rounds > periods else (periods, frames)
    there = positions_at(model, course, np.array([0.0, periods * orbit.period]))
    returns = np.abs(there[1] - there[0]).max() < 0.02 * extent(positions_at(model, course, course.pieces[0].times))
    moments = np.arange(frames) * (periods * orbit.period / frames)
    trace = min(frames, round(settings.trace * lasts * settings.rate))
    shown = portrait(model, course.states(moments)) if model.points is None else course.positions(moments)
    ground = course.grounds(moments) if model.points is not None else None
    solids = [_finer(undescribed(entry)) for entries in solids_of(model.system).values() for entry in entries]
    return Clip(shown, settings.rate, orbit.title or orbit.name, trace, loops=bool(returns and not course.walks),
                ground=ground, cuts=cuts_of(course, moments), strokes=model.strokes, slow=settings.slow,
                space=positions_at(model, course, moments) if solids else None, solids=solids,
                unit=units(orbit.system)["time"])  # fmt: skip


def _finer(solid: Solid) -> Solid:
    """A solid (corners as shares of its box) whose long edges are halved: small triangles hide each other rightly."""
    corners, faces = solid
    for _ in range(3):
        a, b, c = (corners[faces[:, k]] for k in range(3))
        long = np.abs(np.stack([b - a, c - b, a - c])).max(axis=(0, 2)) > 0.6
        cut, middle = faces[long], [(corners[faces[long, k]] + corners[faces[long, k - 2]]) / 2 for k in range(3)]
        if not len(cut):
            break
        ab, bc, ca = (len(corners) + len(cut) * k + np.arange(len(cut)) for k in range(3))
        a, b, c = cut.T
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        corners = np.vstack([corners, *middle])
        faces = np.vstack([faces[~long], *(np.stack(part, axis=1) for part in parts)])
    return corners, faces


def portrait(model: Model, states: np.ndarray) -> np.ndarray:
    """Positions (k x 2 x 1) of a first-order state (k x d) in the first of its planes, each component in its extent."""
    across, up = model.planes[0]
    shown = states[:, [up, across]] * [-1.0, 1.0]
    return np.asarray((shown / nonzero(np.ptp(shown, axis=0)))[:, :, None])


def simulation_clip(
    times: np.ndarray, points: np.ndarray, title: str, settings: AnimationSettings | None = None, closed: bool = False
) -> Clip:
    """A clip of a simulation, linearly resampled to the frame rate.

    Args:
        times: s (k).
        points: positions (k x 2 x m; x down, y right, m), as from `of.positions`.
        title: below the picture.
        settings: frames, length, size.
        closed: whether the polyline is closed.

    Returns:
        A Clip for `of.save_animation`.

    Raises:
        InputError: where sizes differ.

    Examples:
        >>> motion = of.simulate(pendulum, [1.0, 0.5, 0.0, 0.0], 1.0)
        >>> of.simulation_clip(motion.times, of.positions(pendulum, motion.states), "falling").title
        'falling'
    """
    settings = settings or AnimationSettings()
    moments = np.arange(0.0, times[-1], 1.0 / (settings.slow * settings.rate))
    flat = points.reshape(len(points), -1)
    frames = np.stack([np.interp(moments, times, column) for column in flat.T], axis=1)
    shaped = frames.reshape(-1, *points.shape[1:])
    trace = round(settings.trace * settings.slow * settings.rate)
    return Clip(shaped, settings.rate, title, trace, loops=False, closed=closed, slow=settings.slow)


def draw_frames(clip: Clip, settings: AnimationSettings | None = None) -> list[Any]:
    """The frames as Pillow images with one common palette."""
    settings = settings or AnimationSettings()
    # the colours drawn, shaded towards the paper, so that Pillow keeps its own
    paper, *drawn, _ = (ImageColor.getrgb(colour) for colour in _colours(settings.dark).values())
    entries, shades = list(paper), 10  # steps from the paper to each colour: what smooth edges need
    for colour in drawn:
        for k in range(1, shades + 1):
            entries += [round(base + (part - base) * k / shades) for base, part in zip(paper, colour, strict=True)]
    palette = Image.new("P", (1, 1))
    palette.putpalette(entries)
    return [picture.quantize(palette=palette, dither=0) for picture in _pictures(clip, settings)]


def _pictures(clip: Clip, settings: AnimationSettings) -> Iterator[Any]:
    """The frames in full colours, one after the other; what does not repeat passes into its beginning."""
    view = _View.around(filled(clip.points, clip.strokes), settings, clip.ground is not None and not clip.loops)
    count = len(clip.points)
    fading = 0 if clip.loops else min(count // 2, round(settings.fade * clip.rate))
    first, end = None, tip(clip.points)
    for k in range(count):
        back = [(k - j) % count if clip.loops else max(0, k - j) for j in range(clip.trace, -1, -1)]
        trails = [smooth(clip.points[frames, :, end]) for frames in _unbroken(back, clip.cuts)]
        picture = _draw(clip, k, trails, view, settings.dark)
        first = first or picture
        left = count - k
        yield picture if left > fading else Image.blend(first, picture, left / (fading + 1))


def smooth(path: np.ndarray, finer: int = 5) -> np.ndarray:
    """A path (k x 2) through the same points without corners, by cubic splines."""
    if len(path) < 4:
        return path
    places = np.arange(len(path))
    return np.asarray(CubicSpline(places, path)(np.linspace(0.0, len(path) - 1.0, finer * (len(path) - 1) + 1)))


def _unbroken(frames: list[int], cuts: tuple[int, ...]) -> list[list[int]]:
    """Frames in a row, parted where one of the cuts lies."""
    parts: list[list[int]] = [[]]
    for k in frames:
        if k in cuts and parts[-1]:
            parts.append([])
        parts[-1].append(k)
    return parts


INKS = {
    "paper": ("#FFFFFF", "#14161A"), "body": (COLOURS[0], "#56B4E9"), "pin": (COLOURS[1], "#F28E4B"),
    "trace": ("#F0B48A", "#8A4B21"), "ink": ("#000000", "#F2F2F2"), "faint": ("#555555", "#AAAAAA"),
}  # fmt: skip
"""What is drawn in which colour, on a light and on a dark page"""


def _colours(dark: bool) -> dict[str, str]:
    return {name: pair[dark] for name, pair in INKS.items()}


@dataclass(frozen=True)
class _View:
    """Metres to pixels: a square around everything that ever moves, with room for the title."""

    centre: np.ndarray
    scale: float
    pixels: int
    factor: int
    height: int
    header: int
    unit: float
    """pixels of what is one pixel in the usual size"""

    @staticmethod
    def around(points: np.ndarray, settings: AnimationSettings, wide: bool = False) -> _View:
        low, high = box(points)
        down, right = np.maximum(high - low, 1e-9)
        pixels, span = settings.pixels, max(float(down), float(right))
        unit = pixels / AnimationSettings.pixels  # lines of the usual size are as thick as they say
        more = (settings.supersampling, pixels, round(26 * unit), unit)
        if not wide and down > FLAT * right:
            return _View((low + high) / 2, 0.88 * pixels / span, pixels, *more)
        pixels = round(1.6 * pixels)
        scale = 0.9 * min(pixels / right, settings.pixels / down)
        height = round(max(scale * down + 0.12 * pixels, FLAT * pixels))
        return _View((low + high) / 2, scale, pixels, more[0], height, *more[2:])

    def place(self, points: np.ndarray) -> list[tuple[float, float]]:
        """Pixels of (2 x k) positions, supersampled."""
        across = self.pixels / 2 + (points[1] - self.centre[1]) * self.scale
        down = self.header + self.height / 2 + (points[0] - self.centre[0]) * self.scale
        return [(float(x) * self.factor, float(y) * self.factor) for x, y in zip(across, down, strict=True)]


def _draw(clip: Clip, frame: int, trails: list[np.ndarray], view: _View, dark: bool) -> Any:
    size, colours = (view.pixels, view.height + view.header), _colours(dark)
    image = Image.new("RGB", (size[0] * view.factor, size[1] * view.factor), colours["paper"])
    pen, unit = ImageDraw.Draw(image), view.unit * view.factor
    where = view.place(clip.points[frame])
    many = len(where) > 20
    if clip.ground is not None:
        pen.line(view.place(clip.ground[frame]), fill=colours["ink"], width=round(2 * unit), joint="curve")
    for trail in [] if clip.closed else trails:
        pen.line(view.place(trail.T), fill=colours["trace"], width=round(2 * unit), joint="curve")
    if clip.strokes:
        _strokes(pen, clip, frame, view, colours)
    else:
        pen.line(where, fill=colours["body"], width=round((2 if many else 4) * unit), joint="curve")
        for x, y in [] if many else where[1:]:
            _dot(pen, x, y, 4 * unit, colours["pin"])
        for x, y in [where[0], *([where[-1]] if clip.closed else [])]:  # a lone particle is no pivot
            _dot(pen, x, y, 5 * unit, colours["ink" if len(where) > 1 else "pin"])
    image = image.resize(size, Image.Resampling.LANCZOS)
    _headed(ImageDraw.Draw(image), clip, frame, view, colours)
    return image


def _headed(pen: Any, clip: Clip, frame: int, view: _View, colours: Mapping[str, str]) -> None:
    """Title and time; a long title is written smaller, and cut where that does not suffice."""
    edge, room = round(8 * view.unit), view.pixels - round(70 * view.unit)
    title = clip.title if clip.slow == 1.0 else f"{clip.title}, {clip.slow:g} times slower"
    fonts = [ImageFont.load_default(size * view.unit) for size in (12, 11, 10, 9, 8)]
    font = next((font for font in fonts if pen.textlength(title, font=font) <= room), fonts[-1])
    if pen.textlength(title, font=font) > room:
        while title and pen.textlength(title + "...", font=font) > room:
            title = title[:-1]
        title = title.rstrip() + "..."
    pen.text((edge, round(6 * view.unit)), title, fill=colours["ink"], font=font)
    time = with_unit(f"{frame / clip.rate / clip.slow:.2f}", clip.unit)
    pen.text((view.pixels - edge, round(6 * view.unit)), time, fill=colours["faint"], font=fonts[0], anchor="ra")


def _solids(pen: Any, clip: Clip, frame: int, view: _View, colours: Mapping[str, str]) -> None:
    """Triangles of solids from the farthest to the nearest, the paler the more light from above the left shoulder."""
    assert clip.space is not None
    placed, shades, inks = list[np.ndarray](), list[np.ndarray](), list[np.ndarray]()
    paper, body, held = (np.array(ImageColor.getrgb(colours[name])) for name in ("paper", "body", "ink"))
    eye = np.vstack([ISOMETRIC, np.cross(*ISOMETRIC) / np.linalg.norm(ISOMETRIC[0])])  # down, right, towards the eye
    strokes = [at for kind, at in clip.strokes if BRUSHES[kind].boxed]
    for (corners, faces), chosen in zip(clip.solids, strokes, strict=False):
        seen = eye @ clip.space[frame][:, list(chosen)]
        triangles = (seen[:, 0] + corners @ (seen[:, 1:] - seen[:, :1]).T)[faces]
        normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        normals /= nonzero(np.linalg.norm(normals, axis=1, keepdims=True))
        lit = np.maximum(0.0, np.where(normals[:, 2] < 0, -1, 1) * (normals @ [-0.56, -0.42, 0.714]))
        still = not np.ptp(clip.space[:, :, list(chosen)], axis=0).any()
        placed, shades = [*placed, triangles], [*shades, (0.4 if still else 0.0) + (0.3 if still else 0.6) * lit]
        inks.append(np.broadcast_to(held if still else body, (len(faces), 3)))
    triangles, shade, ink = np.concatenate(placed), np.concatenate(shades)[:, None], np.concatenate(inks)
    mixed = np.rint(ink + shade * (paper - ink)).astype(int).tolist()
    dots = view.place(triangles[:, :, :2].reshape(-1, 2).T)
    for k in triangles[:, :, 2].mean(axis=1).argsort().tolist():
        pen.polygon(dots[3 * k : 3 * k + 3], fill=tuple(mixed[k]))


def _strokes(pen: Any, clip: Clip, frame: int, view: _View, colours: Mapping[str, str]) -> None:
    """Rods with pins at their ends, springs and discs as thin lines, sliders and the ground filled."""
    unit = view.unit * view.factor
    if clip.solids:
        _solids(pen, clip, frame, view, colours)
    for kind, line in outlines(clip.points[frame], clip.strokes, 0.88 * view.pixels / view.scale):
        if clip.solids and BRUSHES[kind].covered:
            continue
        where, brush = view.place(line), BRUSHES[kind]
        if brush.filled:
            pen.polygon(where, fill=colours[{"ground": "ink", "slider": "pin"}[kind]])
            continue
        pen.line(where, fill=colours["body"], width=round(4 * brush.thick * unit), joint="curve")
        for x, y in where if brush.pinned else []:
            _dot(pen, x, y, 3 * unit, colours["pin"])


def _dot(pen: Any, x: float, y: float, radius: float, colour: str) -> None:
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)


SUFFIXES = (".gif", ".mp4")


def check_suffix(path: Path) -> None:
    """`InputError` unless pictures that move can be written under this name."""
    if path.suffix not in SUFFIXES:
        raise InputError(
            f"{path}: cannot write {path.suffix or 'a file without suffix'}; use {' or '.join(SUFFIXES)} (or, in the "
            "command, name a folder)"
        )


def settings_for(path: Path, **chosen: Any) -> AnimationSettings:
    """What suits the kind of file, with what was chosen (what is None was not). Raises `InputError`."""
    usual = VIDEO if path.suffix == ".mp4" else AnimationSettings()
    settings = replace(usual, **{name: value for name, value in chosen.items() if value is not None})
    if path.suffix == ".gif" and 100 % settings.rate:
        whole = ", ".join(str(rate) for rate in range(10, 51) if 100 % rate == 0)
        raise InputError(f"rate: a GIF counts hundredths of a second, not {settings.rate} a second; use one of {whole}")
    return settings


def save_animation(clip: Clip, path: str | Path, settings: AnimationSettings | None = None) -> Path:
    """Write a clip as a GIF, or as an MP4 where the extra `[mp4]` is installed.

    Args:
        clip: from `of.orbit_clip` or `of.simulation_clip`.
        path: ends in .gif or .mp4.
        settings: size and rate, as the clip was made.

    Returns:
        The path.

    Raises:
        InputError: for another ending, and where it cannot be written.

    Examples:
        >>> of.save_animation(of.orbit_clip(orbit), "swing.gif").name
        'swing.gif'
    """
    target = Path(path)
    check_suffix(target)
    if target.suffix == ".mp4":
        return _save_mp4(_pictures(clip, settings or replace(VIDEO, rate=clip.rate)), target, clip.rate)
    frames = draw_frames(clip, settings)
    buffer = io.BytesIO()
    options = {"loop": 0, "disposal": 1, "optimize": False}
    frames[0].save(buffer, "GIF", save_all=True, append_images=frames[1:], duration=round(1000 / clip.rate), **options)
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, buffer.getvalue())
    return target


def _save_mp4(frames: Iterator[Any], target: Path, rate: int) -> Path:
    """H.264 through imageio-ffmpeg, which brings its own encoder."""
    try:
        import imageio_ffmpeg  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise InputError(f"{target}: MP4 needs the extra: pip install 'orbitfinder[mp4]', or write a .gif") from error
    target.parent.mkdir(parents=True, exist_ok=True)
    first = next(frames)
    size = tuple(2 * (side // 2) for side in first.size)
    temporary = target.with_name(f".{target.name}.part.mp4")
    writer = imageio_ffmpeg.write_frames(str(temporary), size, fps=rate, macro_block_size=2)
    try:
        writer.send(None)
        for frame in chain((first,), frames):
            writer.send(frame.crop((0, 0, *size)).tobytes())
        writer.close()
        temporary.replace(target)
    finally:
        temporary.unlink(missing_ok=True)
    return target
