"""Animations: real time, whole periods, no jump at the loop, small files."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.records.registry import load_orbit
from orbitfinder.show.animate import (
    VIDEO,
    AnimationSettings,
    Clip,
    draw_frames,
    loop_frames,
    orbit_clip,
    save_animation,
    settings_for,
    simulation_clip,
    smooth,
)
from orbitfinder.show.html import motions

ROOT = Path(__file__).parents[1]


def swinging(count: int = 20) -> Clip:
    angles = 0.8 * np.cos(2 * np.pi * np.arange(count) / count)
    points = np.stack([[[0.0, np.cos(a)], [0.0, np.sin(a)]] for a in angles])
    return Clip(points, 25, "a title that is far too long for the little room above the picture", 10, loops=True)


def test_what_is_flat_has_a_flat_picture_and_the_clock_its_own_unit() -> None:
    flat = Clip(np.tile([[[0.0, 0.1], [-1.0, 1.0]]], (2, 1, 1)), 25, "carts", 1, loops=True)
    (picture, _) = draw_frames(flat)
    assert picture.size == (576, 144 + 26)
    clip = orbit_clip(load_orbit(ROOT / "results/gallery/lorenz/orbit.json"), settings=AnimationSettings(periods=1))
    assert clip.unit == ""


@pytest.mark.parametrize("period", [0.798, 1.6553, 2.9252, 17.3])
def test_loops_are_whole_periods_in_real_time(period: float) -> None:
    """The loop lasts a whole number of periods to within half a frame and at least two seconds."""
    settings = AnimationSettings()
    periods, frames = loop_frames(period, settings)
    assert periods == int(periods) and periods >= 1
    assert abs(frames / settings.rate - periods * period) <= 0.5 / settings.rate + 1e-12
    assert periods * period >= settings.shortest
    assert loop_frames(period, AnimationSettings(periods=3)) == (3, round(3 * period * settings.rate))


def test_gif_has_constant_frame_rate_and_loops(tmp_path) -> None:
    """Every frame of the file lasts 1 / rate, it repeats for ever, and it is small."""
    from PIL import Image

    path = save_animation(swinging(), tmp_path / "clip.gif")
    with Image.open(path) as picture:
        assert picture.n_frames == 20
        assert picture.info["loop"] == 0
        durations = []
        for k in range(picture.n_frames):
            picture.seek(k)
            durations.append(picture.info["duration"])
    assert set(durations) == {40}
    assert path.stat().st_size < 200_000
    assert sorted(tmp_path.iterdir()) == [path]


def test_white_stays_white(tmp_path) -> None:
    """The palette does not tint the background of any frame."""
    from PIL import Image

    with Image.open(save_animation(swinging(), tmp_path / "clip.gif")) as picture:
        for k in range(picture.n_frames):
            picture.seek(k)
            assert picture.convert("RGB").getpixel((1, 100)) == (255, 255, 255)


def test_no_jump_at_the_loop() -> None:
    """The last frame is as near to the first as any two neighbours are."""
    tips = swinging().points[:, :, -1]
    steps = np.linalg.norm(np.roll(tips, -1, axis=0) - tips, axis=1)
    assert steps[-1] <= steps.max()


@pytest.mark.parametrize(("name", "loops"), [("spherical-pendulum", True), ("pendulum-on-moving-cart", False)])
def test_relative_orbits_go_on_where_they_have_led(name, loops) -> None:
    """No chord: every step is one of the motion; what turns goes on until it is where it was, what drifts drifts."""
    clip = orbit_clip(load_orbit(ROOT / "results" / "gallery" / name / "orbit.json"))
    steps = np.abs(np.diff(clip.points, axis=0, append=clip.points[:1] if loops else clip.points[-1:])).max(axis=(1, 2))
    assert clip.loops is loops and steps.max() < 1.5 * np.quantile(steps, 0.95)


def test_simulations_are_resampled_to_the_frame_rate() -> None:
    """A uniform motion sampled coarsely keeps its speed at the clip's rate."""
    times = np.linspace(0.0, 2.0, 11)
    points = np.stack([[[0.0, 1.0], [0.0, t]] for t in times])
    clip = simulation_clip(times, points, "run")
    assert np.allclose(np.diff(clip.points[:, 1, 1]), 1 / clip.rate)


def test_unknown_format_is_refused(tmp_path) -> None:
    """A suffix that nothing can write is named with what can."""
    with pytest.raises(InputError, match=r"\.avi.*\.gif or \.mp4"):
        save_animation(swinging(), tmp_path / "clip.avi")


def test_mp4_needs_its_extra_or_writes(tmp_path) -> None:
    """With the extra an MP4 is written, without it the message names the extra."""
    try:
        import imageio_ffmpeg  # noqa: F401
    except ImportError:
        with pytest.raises(InputError, match="mp4"):
            save_animation(swinging(), tmp_path / "clip.mp4")
    else:
        assert save_animation(swinging(), tmp_path / "clip.mp4").stat().st_size > 1000


def test_simulations_pass_into_their_beginning() -> None:
    """The last frame is as near to the first as neighbours are, and the first is whole."""
    times = np.linspace(0.0, 2.0, 51)
    points = np.stack([[[0.0, np.cos(t)], [0.0, np.sin(t)]] for t in times])
    settings = AnimationSettings(pixels=96, supersampling=1)
    frames = [
        np.asarray(one.convert("L"), float) for one in draw_frames(simulation_clip(times, points, "run"), settings)
    ]
    steps = [np.abs(other - one).mean() for one, other in itertools.pairwise(frames)]
    assert np.abs(frames[-1] - frames[0]).mean() <= max(steps)
    cut = draw_frames(simulation_clip(times, points, "run"), AnimationSettings(pixels=96, supersampling=1, fade=0.0))
    assert np.abs(np.asarray(cut[-1].convert("L"), float) - frames[0]).mean() > max(steps)


def test_what_suits_a_file_and_what_was_chosen(tmp_path) -> None:
    """Video is large and fluent, a GIF small; a GIF's rate is told where it cannot be."""
    assert settings_for(tmp_path / "a.mp4") == VIDEO and (VIDEO.pixels, VIDEO.rate) == (1080, 60)
    assert settings_for(tmp_path / "a.gif", pixels=None, slow=4.0) == AnimationSettings(slow=4.0)
    with pytest.raises(InputError, match=r"rate: a GIF .*not 60.*10, 20, 25, 50"):
        settings_for(tmp_path / "a.gif", rate=60)


def test_slow_motion_has_more_frames_and_dark_paper_is_dark() -> None:
    """Four times slower is four times as many frames; no paper is white in the dark."""
    times, points = np.linspace(0.0, 1.0, 11), np.zeros((11, 2, 2))
    fast, slow = (simulation_clip(times, points, "run", AnimationSettings(slow=k)) for k in (1.0, 4.0))
    assert len(slow.points) == 4 * len(fast.points)
    assert max(draw_frames(fast, AnimationSettings(pixels=64, dark=True))[0].convert("RGB").getpixel((1, 60))) < 40


def test_paths_are_smooth_and_go_through_the_frames() -> None:
    """Between the points of a circle the path stays on it, where straight lines cut its corners."""
    turn = np.linspace(0.0, 2 * np.pi, 13)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    path = smooth(circle)
    np.testing.assert_allclose(path[::5], circle, atol=1e-14)
    assert np.abs(np.hypot(*path.T) - 1.0).max() < 0.01 < 1.0 - np.cos(np.pi / 12)


def test_a_robot_is_filmed_by_its_solids_within_the_picture() -> None:
    """Paper all round, surfaces in several shades of light in it, and bodies of the ground in another colour."""
    orbit = load_orbit(ROOT / "docs" / "gallery" / "orbits" / "robots-a1-leg.json")
    small = AnimationSettings(pixels=120, rate=25, periods=1, slow=2.0, supersampling=1)
    clip = orbit_clip(orbit, settings=small)
    picture = np.asarray(draw_frames(clip, small)[0].convert("RGB"), int)[9:]  # below the heading
    paper = (picture == 255).all(axis=2)
    assert paper[:, [0, -1]].all() and paper[[0, -1]].all() and 0.1 < 1 - paper.mean() < 0.5
    blue = picture[picture[:, :, 2] > picture[:, :, 0] + 40]
    grey = picture[~paper & (np.ptp(picture, axis=2) < 8)]
    assert len(np.unique(blue, axis=0)) > 4 and len(np.unique(grey, axis=0)) > 2
    assert len(blue) > 650 and len(grey) > 300  # the hip is before the trunk
    triangles = [corners[faces] for corners, faces in clip.solids]
    assert all(np.ptp(each, axis=1).max() <= 0.6 for each in triangles)  # small ones hide each other rightly
    assert motions(orbit)[0].count('stroke-width="3"') == 3  # where only lines are drawn, each link
