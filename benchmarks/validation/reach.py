"""How far AUTO-07p continued the pendulums' families, and how far ours in results/families go."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.validation.comparison import Comparison, Section
from benchmarks.validation.reference_orbits import read_json

NAMES = {"tri1": "triple-1", "tri2": "triple-2", "quad1": "quadruple-mode-2", "quad2": "quadruple-mode-3"}
"""AUTO run -> family of ours: runs of normal modes have the mode's name, the quadruple orbits lie on such families."""
GRAVITY = 9.8


def section(data: Path, families: Path) -> Section:
    """Highest energy of each family against AUTO's; a shorter one of ours fails, with the reason of its end."""
    entries = read_json(data / "auto_reach.json")["families"]
    source = (
        "Reference file auto_reach.json: AUTO-07p with the unfolding added by hand, 900 points at most. Highest energy "
        "above hanging (J); the difference is what ours lacks. AUTO's collocation does not impose the symmetry of a "
        "family and may pass to another one at a symmetry-breaking branch point, so its reach can be that of two "
        "families. Ours are those of results/families."
    )
    title = "Reach of AUTO-07p along families"
    if not families.is_dir():
        return Section(title, source, (), f"there is no {families}")
    highest: dict[str, float] = {}
    for entry in entries:
        run = str(entry["family"]).rpartition("_")[0]
        name = NAMES.get(run, run)
        highest[name] = max(highest.get(name, 0.0), float(entry["energy_above_hanging"][1]))
    return Section(title, source, tuple(_row(name, energy, families / name) for name, energy in highest.items()))


def _row(name: str, auto: float, folder: Path) -> Comparison:
    if not (folder / "family.json").is_file():
        return Comparison(name, repr(auto), "none", float("nan"), 0.0, "not computed")
    family = read_json(folder / "family.json")
    places = [*family["points"], *family["events"]]  # a fold lies beyond the points on both sides of it
    ours = max(place["energy"] for place in places) + GRAVITY * _links(family) ** 2 / 2
    ends = ", ".join(end["kind"] for end in family["ends"])
    return Comparison(name, repr(auto), f"{ours:.9f}", min(0.0, ours - auto), 0.0, f"ours ends: {ends}")


def _links(family: Mapping[str, Any]) -> int:
    return int(family["system"]["links"])
