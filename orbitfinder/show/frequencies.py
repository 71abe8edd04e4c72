"""Pictures of frequency maps: frequencies against each other, and where motions begin, coloured by diffusion."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from orbitfinder.errors import InputError, closest
from orbitfinder.mechanics.model import Model, wrapped
from orbitfinder.show.style import dress, new_figure, save_png
from orbitfinder.show.svg import axis
from orbitfinder.structures.frequencies import FrequencyMap

LEAST = -12.0
"""Decimal logarithm of the diffusion below which all have one colour"""


def draw_frequencies(
    found: FrequencyMap, model: Model, path: str | Path, *, axes: Sequence[str] | None = None, name: str = "frequencies"
) -> Path:
    """Draw a frequency map as PNG, its starts in two components (`axes`). Raises `InputError`."""
    names = tuple(axes) if axes is not None else tuple(model.state_names[k] for k in model.planes[0])
    for unknown in names:
        if unknown not in model.state_names:
            known = ", ".join(model.state_names)
            raise InputError(
                f"axes: unknown component {unknown!r}{closest(unknown, model.state_names)}; this system has {known}"
            )
    across, up = (model.state_names.index(component) for component in names)
    figure = new_figure(10.0, 4.6, name, f"frequencies over {0.5 * found.duration:.6g} s, twice")
    places, plane = figure.subplots(1, 2)
    with np.errstate(divide="ignore"):
        colours = np.maximum(np.log10(found.diffusion), LEAST)
    starts = wrapped(found.starts, model.angular)
    drawn = places.scatter(starts[:, across], starts[:, up], c=colours, cmap="viridis", vmin=LEAST, vmax=0.0, s=16)
    dress(places, axis(model, across), axis(model, up))
    pair = found.frequencies[:, :2] if found.frequencies.shape[1] > 1 else None
    first, second = pair.T if pair is not None else (starts[:, across], found.frequencies[:, 0])
    plane.scatter(first, second, c=colours, cmap="viridis", vmin=LEAST, vmax=0.0, s=16)
    dress(plane, "first frequency (rad/s)" if pair is not None else axis(model, across),
          "second frequency (rad/s)" if pair is not None else "frequency (rad/s)")  # fmt: skip
    figure.colorbar(drawn, ax=[places, plane], label="decimal logarithm of the diffusion")
    return save_png(figure, Path(path))
