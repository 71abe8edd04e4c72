"""Animations: real time, whole periods, no jump at the loop, small files."""

import numpy as np
import pytest

from orbitfinder.errors import InputError
from orbitfinder.show.animate import AnimationSettings, Clip, loop_frames, save_animation, simulation_clip


def swinging(count: int = 20) -> Clip:
    angles = 0.8 * np.cos(2 * np.pi * np.arange(count) / count)
    points = np.stack([[[0.0, np.cos(a)], [0.0, np.sin(a)]] for a in angles])
    return Clip(points, 25, "a title that is far too long for the little room above the picture", 10, loops=True)


@pytest.mark.parametrize("period", [0.798, 1.6553, 2.9252, 17.3])
def test_loops_are_whole_periods_in_real_time(period: float) -> None:
    """The loop lasts a whole number of periods to within half a frame and at least two seconds."""
    settings = AnimationSettings()
    periods, frames = loop_frames(period, settings)
    assert periods == int(periods) and periods >= 1
    assert abs(frames / settings.rate - periods * period) <= 0.5 / settings.rate + 1e-12
    assert periods * period >= settings.shortest


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
