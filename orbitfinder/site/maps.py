"""The page of a map: its picture, how many pixels there are of each verdict, and the pixels in a table."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np

from orbitfinder.errors import FAILURES
from orbitfinder.families.plane import BLANK, ParameterMap
from orbitfinder.mechanics.model import Model
from orbitfinder.orbits.floquet import STABILITIES
from orbitfinder.show.maps import map_figure
from orbitfinder.show.scene import evenly
from orbitfinder.site.gather import Gathered


def map_picture(plane: ParameterMap, gathered: Gathered) -> bytes:
    """The figure of `orbitfinder plot` as PNG, the same bytes for the same map."""
    try:
        model: Model | None = gathered.model(plane.system)
    except FAILURES:
        model = None
    figure, buffer = map_figure(plane, model), io.BytesIO()
    figure.savefig(buffer, dpi=120, format="png", metadata={"Software": None})
    return buffer.getvalue()


def map_values(plane: ParameterMap, most: int = 2500) -> dict[str, Any]:
    """What the template of a map's page is filled with; of more pixels `most`, chosen evenly, are in its table."""
    table = plane.own_tables()["points"]
    names = [*plane.parameters, "stability", "blank", "period", "largest_multiplier", "certified"]
    chosen = evenly(plane.blank.size, most)
    return {"plane": plane, "verdicts": list(_verdicts(plane)), "all_pixels": len(chosen) == plane.blank.size,
            "pixels": [[table[name][k] for name in names] for k in chosen]}  # fmt: skip


def _verdicts(plane: ParameterMap) -> Iterator[tuple[str, int, int, int]]:
    """Each verdict, and reason for none, with its pixels, and how many of them are sampled and certified."""
    row, column, sure = plane.sample.astype(int).T.reshape(3, -1)
    for kinds, words, known in ((plane.verdicts, STABILITIES, True), (plane.blank, BLANK, False)):
        for k, word in enumerate(words):
            here = (plane.known == known) & (kinds == k)
            if count := int(here.sum()):
                yield word or "none", count, int(here[row, column].sum()), int(np.sum(sure[here[row, column]]))
