"""A family as every picture draws it: what its axes are, where points and events lie, how each kind of event looks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from orbitfinder.errors import OrbitfinderError
from orbitfinder.families.members import response
from orbitfinder.mechanics.kind import build_model
from orbitfinder.records.family import Event, Family


@dataclass(frozen=True)
class Mark:
    """How a kind of event is drawn: Matplotlib's marker with its size (points), Plotly's symbol with its size (pixels),
    the colour of figures (none of them a family's) and the number of the page's, whether it is hollow, carries
    its number and a line through the stability indices, and is so common that of many some are left out."""

    marker: str
    symbol: str
    colour: str = "#000000"
    series: int = 1
    size: float = 5.5
    pixels: int = 10
    hollow: bool = False
    numbered: bool = False
    lined: bool = False
    common: bool = False
    verdict: bool = False
    """where the stability changes; what happens there as well is named beside it"""


LOOKS = {
    "fold": Mark("v", "triangle-down", "#7B3294", pixels=11),
    "turn": Mark("1", "triangle-left", "#C2A5CF", pixels=9),
    "extremum": Mark("2", "triangle-right", "#E7298A", pixels=9),
    "branch_point": Mark("o", "circle-open", series=2, pixels=12, hollow=True, numbered=True, lined=True),
    "period_doubling": Mark("s", "square", "#B2182B", series=3, pixels=9, numbered=True, lined=True),
    "torus": Mark("P", "cross", "#01665E", series=4),
    "resonance": Mark(".", "circle", "#8C8C8C", series=4, size=3.5, pixels=7, common=True),
    "collision": Mark("x", "x", "#8C510A", pixels=9, lined=True),
    # the verdict changes where something else happens as well
    "stability_change": Mark("D", "diamond", "#4D4D4D", series=5, size=9.0, hollow=True, verdict=True),
    "grazing": Mark("*", "star"),
    "cycle_change": Mark("X", "hourglass", series=3),
    "holds": Mark("X", "bowtie", series=3),
    "cusp": Mark("^", "triangle-up", series=3, pixels=11),
    "isola_centre": Mark("h", "hexagon", series=4),
    "transcritical": Mark("d", "diamond-tall", series=2, pixels=11),
    "strong_resonance": Mark("p", "pentagon", series=2),
    "fold_doubling": Mark("D", "diamond-wide", series=5, pixels=11),
    "fold_torus": Mark("<", "triangle-left", series=4),
    "doubling_torus": Mark(">", "triangle-right", series=4),
    "degenerate_doubling": Mark("H", "hexagon2", series=3),
}
"""Of every kind of event that families know"""


def mark_of(event: Event) -> Mark:
    """How an event is drawn; one of a kind that nobody knows as a star."""
    return LOOKS.get(event.kind, Mark("*", "star"))


@dataclass(frozen=True)
class Diagram:
    """A family as a curve: what its axes are called (across, up), and the `places` (k x 2) of its points and then of
    its events."""

    family: Family
    names: tuple[str, str]
    places: np.ndarray

    @property
    def points(self) -> np.ndarray:
        """Where its points are."""
        return self.places[: len(self.family.points)]

    @property
    def events(self) -> np.ndarray:
        """Where its events are."""
        return self.places[len(self.family.points) :]

    @property
    def stretches(self) -> list[tuple[bool, np.ndarray]]:
        """Stretches (k x 2) that are stable or not, which meet where the stability changes."""
        points = self.family.points
        stable = [point.stability != "unstable" for point in points]
        cuts = [k for k in range(1, len(points)) if stable[k] != stable[k - 1]]
        stretches = [(stable[k], self.points[max(k - 1, 0) : end]) for k, end in pairwise([0, *cuts, len(points)])]
        for number, k in enumerate(cuts):
            for event, place in zip(self.family.events, self.events, strict=True):
                between = points[k - 1].arclength <= event.arclength <= points[k].arclength
                if mark_of(event).verdict and between:
                    stretches[number] = (stable[k - 1], np.vstack([stretches[number][1], place]))
                    stretches[number + 1] = (stable[k], np.vstack([place, stretches[number + 1][1][1:]]))
        return stretches


def frequencies(family: Family) -> np.ndarray:
    """1 / period of its points and then of its events."""
    return np.array([1 / member.period for member in family.members])


def diagram_of(family: Family) -> Diagram:
    """Frequency against energy, or against the parameter where the energy hardly changes; of what dissipates the
    amplitude against the parameter; of a curve of bifurcations its second parameter against its first."""
    if len(family.parameters) > 1:
        return Diagram(family, family.parameters[:2], family.places)  # type: ignore[arg-type]
    try:
        moved, sizes = response(family, build_model(family.system))
    except OrbitfinderError:
        moved, sizes = "", np.zeros(0)
    by_energy = family.by_energy and not moved
    levels = np.nan_to_num([member.energy for member in family.members])
    along, across = (levels, "energy (J)") if by_energy else (family.places[:, 0], family.parameter)
    up = (sizes, f"amplitude of {moved}") if moved else (frequencies(family), "frequency (1/s)")
    return Diagram(family, (across, up[1]), np.column_stack([along, up[0]]))
