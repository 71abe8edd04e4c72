"""Make results/atlas: two searches, compacted, with figures and a page about the twelve most interesting orbits.

An orbit whose certificate has less than a factor `MARGIN` in hand is left out, so that the rest passes on processors
that round differently.

    python benchmarks/shipped_atlas.py                   takes about ten minutes on two quiet processors
    python benchmarks/shipped_atlas.py --finished DIR    from atlases that the same searches have made in DIR
"""

from __future__ import annotations

import argparse
import sqlite3
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import orbitfinder as of
from orbitfinder.atlas.report import summarise
from orbitfinder.atlas.store import Row
from orbitfinder.mechanics.model import Model, positions
from orbitfinder.show.plot import save_atlas_figures
from orbitfinder.show.style import new_figure, save_png
from orbitfinder.show.svg import COLOURS

ROOT = Path(__file__).parents[1]
PLACE = ROOT / "results" / "atlas"
SEARCHES = (("triple", "triple-three-energies.toml", 4600), ("quadruple", "quadruple.toml", 4000))
MARGIN = 2.0
LOWER_BOUNDS = ("minimal_period", "not_equilibrium")
FIGURES = {
    "atlas_energy_period.png": "energy, period and stability",
    "atlas_instability.png": "how fast neighbours leave",
    "atlas_discovery.png": "orbits found against processor time, and Chao's estimate of how many there are",
}


@dataclass(frozen=True)
class Pick:
    """One of the twelve: why, in which atlas, which orbit."""

    why: str
    name: str
    row: Row


def command(name: str, file: str, starts: int, folder: str) -> list[str]:
    return [
        "orbitfinder", "search", f"problems/search/{file}", "--starts", str(starts), "--workers", "2",
        "--atlas", f"{folder}/{name}.sqlite",
    ]  # fmt: skip


def compacted(source: Path, target: Path) -> None:
    """A copy without free pages and without a write-ahead log, readable from a folder that cannot be written."""
    target.unlink(missing_ok=True)
    with sqlite3.connect(source) as connection:
        connection.execute("VACUUM INTO ?", [str(target)])
    connection.close()
    with of.Atlas(target) as atlas:
        close = [row.id for row in atlas.rows() if narrow(atlas.document(row.id))]
    with sqlite3.connect(target, isolation_level=None) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
        for number in close:
            reason = f"not shipped: certificate within a factor {MARGIN:g} of a bound"
            connection.execute(
                "UPDATE starts SET outcome = 'failed', reason = ?, orbit = NULL WHERE orbit = ?", [reason, number]
            )
            connection.execute("DELETE FROM orbits WHERE id = ?", [number])
        connection.execute("VACUUM")
    connection.close()
    print(f"{target.name}: {len(close)} orbits left out", file=sys.stderr)


def narrow(document: dict) -> bool:
    """True when a check passed with less than `MARGIN` in hand."""
    return any(
        check["tolerance"] > 0 and check["name"] not in LOWER_BOUNDS and check["value"] * MARGIN > check["tolerance"]
        for check in document["certificate"]["checks"]
    )


def least(rows: list[Row], taken: set[int], key, wanted=lambda row: True) -> Row:
    """The untaken row with the least key."""
    row = min((row for row in rows if wanted(row) and row.id not in taken), key=key)
    taken.add(row.id)
    return row


def twelve(triple: list[Row], quadruple: list[Row]) -> list[Pick]:
    def rate(row: Row) -> float:
        return float(np.log(row.instability) / row.period)

    def unstable(row: Row) -> bool:
        return row.stability == "unstable"

    def asymmetric(row: Row) -> bool:
        return row.symmetry == "none"

    found = []
    for name, rows in (("triple", triple), ("quadruple", quadruple)):
        taken: set[int] = set()
        top = max(row.energy for row in rows)
        high = [row for row in rows if row.energy > top - 1e-6]
        wishes = [
            ("longest elliptic", rows, lambda row: -row.period, lambda row: row.stability == "elliptic"),
            ("least unstable of the unstable", high, rate, unstable),
            ("most unstable", rows, lambda row: -row.instability, unstable),
            ("longest with every symmetry", high, lambda row: -row.period, lambda row: "brake+" in row.symmetry),
            ("shortest", rows, lambda row: row.period, lambda row: True),
            ("calmest without symmetry", rows, rate, asymmetric),
        ]
        for why, among, key, wanted in wishes:
            if any(wanted(row) and row.id not in taken for row in among):
                found.append(Pick(why, name, least(among, taken, key, wanted)))
    return found


def contact_sheet(model: Model, loops: list[tuple[np.ndarray, str]], across: int = 4) -> Figure:
    """Orbits side by side: path of the last point, and the mechanism at equal times, paler as it was earlier.

    `loops` are states (k x 2n) at equal times over one period, with a caption each.
    """
    rows = -(-len(loops) // across)
    figure = new_figure(2.9 * across, 3.1 * rows, "")
    grid = figure.subplots(rows, across, squeeze=False)
    for axes in grid.ravel()[len(loops) :]:
        axes.axis("off")
    for axes, (loop, caption) in zip(grid.ravel(), loops, strict=False):
        places = positions(model, loop)
        for k in range(0, len(loop), max(1, len(loop) // 14)):
            shade = 0.15 + 0.35 * k / len(loop)
            axes.plot(places[k, 1], -places[k, 0], color="0.2", alpha=shade, linewidth=1.0)
        closed = np.vstack([places[:, :, -1], places[:1, :, -1]])
        axes.plot(closed[:, 1], -closed[:, 0], color=COLOURS[0], linewidth=1.4)
        axes.plot(places[0, 1, 0], -places[0, 0, 0], "o", color="black", markersize=3)
        axes.set_aspect("equal")
        axes.margins(0.06)
        axes.axis("off")
        axes.set_title(caption, fontsize=8)
    return figure


def sheet(name: str, atlas: of.Atlas, picks: list[Pick], folder: Path) -> Path:
    loops = [
        (atlas.signature(pick.row.id).loop, f"{pick.why}\norbit {pick.row.id}, {pick.row.period:.3f} s")
        for pick in picks
    ]
    return save_png(contact_sheet(atlas.model, loops, across=3), folder / f"{name}-interesting.png")


def page(atlases: dict[str, of.Atlas], picks: list[Pick], folder: Path) -> str:
    total = sum(len(atlas) for atlas in atlases.values())
    lines = [
        "# The shipped atlas",
        "",
        f"{total} distinct certified periodic orbits of the triple pendulum at three energies and of the quadruple at "
        "one, and the record of the starts that found them. Uniform rods of 1 m and 1 kg; energies have their zero at "
        "the fixed joint (hanging at rest: -44.1 J and -78.4 J). Made by",
        "",
        "```sh",
        *(" ".join(command(*one, "results/atlas")) for one in SEARCHES),
        "python benchmarks/shipped_atlas.py --finished results/atlas     # compacts them, draws, writes this page",
        "```",
        "",
        "Every orbit passes `orbitfinder verify` (`python -m pytest -m slow tests/test_atlas_shipped.py`). Look with",
        "`orbitfinder atlas list results/atlas/triple.sqlite --stability elliptic`, take one out with",
        "`orbitfinder atlas show results/atlas/triple.sqlite ID --json > orbit.json`.",
        "",
        "| atlas | energy (J) | orbits | elliptic | unstable | periods (s) | symmetries |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, atlas in atlases.items():
        rows = atlas.rows()
        for energy in sorted({round(row.energy, 6) for row in rows}):
            here = [row for row in rows if abs(row.energy - energy) < 1e-5]
            kinds, symmetries = Counter(r.stability for r in here), Counter(r.symmetry for r in here)
            lines.append(
                f"| {name} | {energy:g} | {len(here)} | {kinds['elliptic']} | {kinds['unstable']} | "
                f"{min(r.period for r in here):.2f} to {max(r.period for r in here):.2f} | "
                + ", ".join(f"{count} {kind}" for kind, count in symmetries.most_common()) + " |"
            )  # fmt: skip
    lines += ["", "## Twelve of them", "", "Blue: path of the tip. Grey: the links at equal times.", ""]
    for name in atlases:
        lines += [f"![{name} pendulum]({name}-interesting.png)", ""]
    lines += ["| pendulum | why | id | energy (J) | period (s) | symmetry | stability | largest multiplier |",
              "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for pick in picks:
        row = pick.row
        lines.append(
            f"| {pick.name} | {pick.why} | {row.id} | {row.energy:.6g} | {row.period:.9f} | {row.symmetry} | "
            f"{row.stability} | {row.instability:.4g} |"
        )
    for name, atlas in atlases.items():
        summary = summarise(atlas)
        lines += ["", f"## How the {name} pendulum was searched", "",
                  f"{summary.starts} starts, {summary.hits} hits, {summary.seconds:.0f} s of processor time "
                  "(on a busy machine).", "",
                  "| strategy | starts | hits | new | processor time, s |", "|---|---|---|---|---|"]  # fmt: skip
        lines += [f"| {y.strategy} | {y.starts} | {y.hits} | {y.new} | {y.seconds:.0f} |" for y in summary.yields]
        lines += ["", *(f"![{text}]({name}/{file})" for file, text in FIGURES.items())]
    return "\n".join([*lines, ""])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--finished", type=Path, help="folder with atlases that the searches have made")
    arguments = parser.parse_args()
    PLACE.mkdir(parents=True, exist_ok=True)
    for name, file, starts in SEARCHES:
        source = (arguments.finished or PLACE) / f"{name}.sqlite"
        if not arguments.finished:
            subprocess.run(command(name, file, starts, str(PLACE)), cwd=ROOT, check=True)
        compact = PLACE / f"{name}.compact"
        compacted(source, compact)
        compact.replace(PLACE / f"{name}.sqlite")
    atlases = {name: of.Atlas(PLACE / f"{name}.sqlite") for name, _, _ in SEARCHES}
    picks = twelve(*(atlas.rows() for atlas in atlases.values()))
    for name, atlas in atlases.items():
        sheet(name, atlas, [pick for pick in picks if pick.name == name], PLACE)
        save_atlas_figures(atlas, PLACE / name)
    (PLACE / "README.md").write_text(page(atlases, picks, PLACE))
    total = sum(len(atlas) for atlas in atlases.values())
    print(f"{PLACE}: {total} orbits, {sum(p.stat().st_size for p in PLACE.glob('*.sqlite')) / 1e6:.1f} MB")
    return 0 if total >= 500 else 1


if __name__ == "__main__":
    sys.exit(main())
