"""Make results/atlas: a search for each system, compacted, with proofs, tables, figures, README and data sheet.

An orbit whose certificate, computed again, has less than a factor `MARGIN` in hand is left out, so that the rest passes
on processors that round differently.

    python benchmarks/shipped_atlas.py                   takes about an hour of one quiet processor
    python benchmarks/shipped_atlas.py --finished DIR    from atlases that the same searches have made in DIR
    python benchmarks/shipped_atlas.py --finished results/atlas --proofs 0    tables and pages again
"""

from __future__ import annotations

import argparse
import json
import re
import sqlite3
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import atlas_checks
import numpy as np
from matplotlib.figure import Figure
from prove_atlas import cost

import orbitfinder as of
from orbitfinder.atlas.export import FIELDS, STATE, exported
from orbitfinder.atlas.report import summarise, total
from orbitfinder.atlas.store import AtlasRow
from orbitfinder.loops.symmetry import SYMMETRIES
from orbitfinder.mechanics.model import Model, positions
from orbitfinder.proof.record import entry
from orbitfinder.proof.theorem import Options, prove
from orbitfinder.records.certificate import AT_MOST
from orbitfinder.records.reading import write_atomically
from orbitfinder.show.plot import save_atlas_figures
from orbitfinder.show.style import new_figure, save_png
from orbitfinder.show.svg import COLOURS

ROOT = Path(__file__).parents[1]
PLACE = ROOT / "results" / "atlas"
SI, FREE = "SI units", "the equations' own units"


@dataclass(frozen=True)
class Entry:
    """A system of the data set: atlas, in words, problem file, starts at each energy, units, other options."""

    name: str
    words: str
    file: str
    starts: int
    units: str
    options: tuple[str, ...] = ("--shard", "1/1", "--workers", "0")

    def command(self, folder: str) -> list[str]:
        """The search that made it. A shard continues no orbit from one energy to another."""
        return [
            "orbitfinder", "search", f"problems/{self.file}.toml", "--starts", str(self.starts), *self.options,
            "--atlas", f"{folder}/{self.name}.sqlite",
        ]  # fmt: skip


ENTRIES = (
    Entry("triple", "triple pendulum", "search/triple-three-energies", 4600, SI, ("--workers", "2")),
    Entry("quadruple", "quadruple pendulum", "search/quadruple", 4000, SI, ("--workers", "2")),
    Entry("double", "double pendulum", "search/double-atlas", 500, SI),
    Entry("coupled-oscillators", "two springs coupled at fourth order", "search/coupled-oscillators-atlas", 400, FREE),
    Entry("cart-chain", "Fermi-Pasta-Ulam chain of three carts", "search/cart-chain-atlas", 200, FREE),
    Entry("henon-heiles", "Hénon-Heiles system", "search/henon-heiles-atlas", 400, FREE),
    Entry("spring-pendulum", "swinging spring", "search/spring-pendulum-atlas", 150, SI),
    Entry("lorenz", "Lorenz attractor (first order)", "search/lorenz-atlas", 1500, FREE),
    Entry("rossler", "Rössler's attractor (first order)", "search/rossler-atlas", 150, FREE),
    Entry("impact-oscillator", "forced oscillator with a stop (hybrid)", "search/impact-oscillator-atlas", 60, FREE),
)
HYBRID = ("impact-oscillator",)
"""Of hybrid systems nothing is proved."""
PAGES = {"README.md": ("counts", "commands", "twelve"), "DATASHEET.md": ("counts", "shells", "fields", "checks")}
"""Pages, and the marks in them between which tables are written."""
PICTURED = ("triple", "quadruple")
MARGIN = 2.0
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
    row: AtlasRow


def compacted(source: Path, target: Path) -> None:
    """A copy without free pages and without a write-ahead log, readable from a folder that cannot be written."""
    target.unlink(missing_ok=True)
    with sqlite3.connect(source) as connection:  # another process may be at it
        connection.execute("VACUUM INTO ?", [str(target)])
    connection.close()
    with of.Atlas(target) as atlas:
        close, system = [row.id for row in atlas.rows() if narrow(of.certify(atlas.orbit(row.id)))], atlas.system
    with sqlite3.connect(target, isolation_level=None) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
        for number in close:
            reason = f"not shipped: certificate within a factor {MARGIN:g} of a bound"
            connection.execute(
                "UPDATE starts SET outcome = 'failed', reason = ?, orbit = NULL WHERE orbit = ?", [reason, number]
            )
            connection.execute("DELETE FROM orbits WHERE id = ?", [number])
    connection.close()
    with of.Atlas(target, system, write=True) as atlas:  # brings files of older versions to this one
        for row in atlas.rows():
            if not row.signature:
                atlas.describe(row.id)
    print(f"{target.name}: {len(close)} orbits left out", file=sys.stderr)


def packed(target: Path) -> None:
    """The file without free pages and without a write-ahead log."""
    with sqlite3.connect(target, isolation_level=None) as connection:
        connection.execute("PRAGMA journal_mode = DELETE")
        connection.execute("VACUUM")
    connection.close()


def prove_some(file: Path, count: int, records: Path) -> None:
    """Give an atlas the proofs recorded in `records`, then those of its quickest orbits until it has `count`."""
    with of.Atlas(file) as atlas:
        system, rows = atlas.system, [row for row in atlas.rows() if not row.proof]
        documents = {row.id: atlas.document(row.id) for row in rows}
    known = {one["record"]: one["proof"] for one in (json.loads(path.read_text()) for path in records.glob("*.json"))}
    with of.Atlas(file, system, write=True) as atlas:
        for number, document in documents.items():
            if document["record"] in known:
                atlas.describe(number, known[document["record"]])
        wanted = count - sum(bool(row.proof) for row in atlas.rows())
        chosen = [row for row in sorted(rows, key=lambda row: cost(documents[row.id])) if not atlas.row(row.id).proof]
        for row in chosen[: max(0, wanted)]:
            orbit = atlas.orbit(row.id)
            proof = entry(prove(orbit, options=Options(symmetry=None if orbit.symmetry in SYMMETRIES else "none")))
            if proof["proved"]:
                atlas.describe(row.id, proof)


def narrow(certificate: of.Certificate) -> bool:
    """True when a check fails, or one that sets an upper bound passed with less than `MARGIN` in hand."""
    return not certificate.passed or any(
        check.sense == AT_MOST and check.value * MARGIN > check.tolerance for check in certificate.checks
    )


def least(rows: list[AtlasRow], taken: set[int], key, wanted=lambda row: True) -> AtlasRow:
    """The untaken row with the least key."""
    row = min((row for row in rows if wanted(row) and row.id not in taken), key=key)
    taken.add(row.id)
    return row


def twelve(triple: list[AtlasRow], quadruple: list[AtlasRow]) -> list[Pick]:
    def rate(row: AtlasRow) -> float:
        return float(np.log(row.instability) / row.period)

    def unstable(row: AtlasRow) -> bool:
        return row.stability == "unstable"

    def asymmetric(row: AtlasRow) -> bool:
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


def energies_of(name: str, atlas: of.Atlas) -> list[str]:
    """A line of the data sheet for each energy of an atlas: orbits, and the estimate of how many there are."""
    summary, lines = summarise(atlas), []
    for energy in sorted({one.energy for one in summary.strata}):
        here = [one for one in summary.strata if one.energy == energy]
        rows = [row for row in atlas.rows() if abs(row.energy - energy) <= 1e-6 * max(1.0, abs(energy))]
        least, error = total(here)
        once, hits = sum(one.once for one in here), sum(one.hits for one in here)
        made = "SELECT count(*) FROM starts JOIN searches ON searches.id = search WHERE searches.energy = ?"
        ((starts,),) = atlas.select([int], made, [energy])
        shell = f"{energy:g}" if atlas.model.invariants else "any"
        lines.append(
            f"| {name} | {shell} | {len(rows)} | {len(kinds(rows))} | {least:.0f} ± {error:.0f} | "
            f"{1 - once / max(hits, 1):.0%} | {starts} | {min(row.period for row in rows):.2f} to "
            f"{max(row.period for row in rows):.2f} |"
        )
    return lines


def kinds(rows: Sequence[AtlasRow]) -> set[tuple[int, ...]]:
    """What differs in energy, period or action: orbits of equal numbers are, but for chance, images of each other."""
    return {
        tuple(round(np.arcsinh(value) * 1e5) for value in (row.energy, row.period, abs(row.action))) for row in rows
    }


def counts(atlases: dict[str, of.Atlas]) -> str:
    """The table of the systems."""
    lines = [
        "| atlas | system | units | energies | orbits | up to images | stable | unstable | proved | starts |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    sums = np.zeros(7, int)
    for one in ENTRIES:
        atlas = atlases[one.name]
        rows, summary = atlas.rows(), summarise(atlas)
        shells = len({stratum.energy for stratum in summary.strata})
        stable = sum(row.stability in ("elliptic", "asymptotically stable") for row in rows)
        numbers = [shells, len(rows), len(kinds(rows)), stable, sum(row.stability == "unstable" for row in rows),
                   sum(bool(row.proof) for row in rows), summary.starts]  # fmt: skip
        sums += numbers
        lines.append(f"| {one.name} | {one.words} | {one.units} | " + " | ".join(map(str, numbers)) + " |")
    return "\n".join([*lines, f"| all | {len(ENTRIES)} systems | | " + " | ".join(map(str, sums)) + " |"])


def tables(atlases: dict[str, of.Atlas]) -> dict[str, str]:
    """The generated parts of the data sheet by the names of their marks."""
    head = "| atlas | energy | orbits | up to images | at least | coverage | starts | periods |\n" + "|---" * 8 + "|"
    shells = [line for one in ENTRIES for line in energies_of(one.name, atlases[one.name])]
    states = ", ".join(f"{one.name}: `{' '.join(atlases[one.name].model.state_names)}`" for one in ENTRIES)
    fields = [f"| `{name}` | {unit or '-'} | {escaped(text)} |" for name, (unit, text) in FIELDS.items()]
    fields.insert(list(FIELDS).index("strategy"), f"| components | {STATE[0]} | {STATE[1]} |")
    return {
        "counts": counts(atlases),
        "shells": "\n".join([head, *shells]),
        "fields": "\n".join(["| column | unit | meaning |", "|---|---|---|", *fields]) + f"\n\nComponents: {states}.",
        "commands": "\n".join(["```sh", *(" ".join(one.command("results/atlas")) for one in ENTRIES), "```"]),
    }


def escaped(text: str) -> str:
    """Text in a table, whose columns are parted by bars."""
    return text.replace("|", r"\|")


def filled(text: str, parts: dict[str, str]) -> str:
    """A page with the text between `<!-- NAME -->` and `<!-- end -->` replaced."""
    for name, part in parts.items():
        pattern = rf"(<!-- {name} -->\n).*?(<!-- end -->)"
        text, count = re.subn(
            pattern, lambda found, part=part: found[1] + part + "\n" + found[2], text, flags=re.DOTALL
        )
        assert count == 1, name
    return text


def pictures(atlases: dict[str, of.Atlas], picks: list[Pick]) -> str:
    """Twelve orbits, and how the two atlases that have pictures were searched."""
    lines = ["Blue: path of the tip. Grey: the links at equal times.", ""]
    for name in PICTURED:
        lines += [f"![{name} pendulum]({name}-interesting.png)", ""]
    lines += ["| pendulum | why | id | energy (J) | period (s) | symmetry | stability | largest multiplier |",
              "|---|---|---|---|---|---|---|---|"]  # fmt: skip
    for pick in picks:
        row = pick.row
        lines.append(
            f"| {pick.name} | {pick.why} | {row.id} | {row.energy:.6g} | {row.period:.9f} | {row.symmetry} | "
            f"{row.stability} | {row.instability:.4g} |"
        )
    for name in PICTURED:
        summary = summarise(atlases[name])
        lines += ["", f"## How the {name} pendulum was searched", "",
                  f"{summary.starts} starts, {summary.hits} hits, {summary.seconds:.0f} s of processor time "
                  "(on a busy machine).", "",
                  "| strategy | starts | hits | new | processor time, s |", "|---|---|---|---|---|"]  # fmt: skip
        lines += [f"| {y.strategy} | {y.starts} | {y.hits} | {y.new} | {y.seconds:.0f} |" for y in summary.yields]
        lines += ["", *(f"![{text}]({name}/{file})" for file, text in FIGURES.items())]
    return "\n".join(lines)


def finish(name: str, source: Path, proofs: int) -> None:
    """The shipped files of one system from the atlas that its search has made."""
    target, compact = PLACE / f"{name}.sqlite", PLACE / f"{name}.compact"
    compacted(source, compact)
    compact.replace(target)
    prove_some(target, proofs, ROOT / "results" / "proofs")
    packed(target)
    with of.Atlas(target) as atlas:
        write_atomically(PLACE / f"{name}.parquet", exported(atlas, "parquet"))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--finished", type=Path, help="folder with atlases that the searches have made")
    parser.add_argument("--only", nargs="*", help="these atlases alone; the pages count all that are there")
    parser.add_argument("--proofs", type=int, default=12, help="orbits of each system to be proved")
    arguments = parser.parse_args()
    PLACE.mkdir(parents=True, exist_ok=True)
    for one in ENTRIES:
        if arguments.only is not None and one.name not in arguments.only:
            continue
        if not arguments.finished:
            subprocess.run(one.command(str(PLACE)), cwd=ROOT, check=True)
        finish(
            one.name, (arguments.finished or PLACE) / f"{one.name}.sqlite", arguments.proofs * (one.name not in HYBRID)
        )
    atlases = {one.name: of.Atlas(PLACE / f"{one.name}.sqlite") for one in ENTRIES}
    picks = twelve(*(atlases[name].rows() for name in PICTURED))
    for name in PICTURED if arguments.only is None else ():
        sheet(name, atlases[name], [pick for pick in picks if pick.name == name], PLACE)
        save_atlas_figures(atlases[name], PLACE / name)
    parts = tables(atlases) | {"twelve": pictures(atlases, picks)}
    parts["checks"] = "\n".join(["```text", *atlas_checks.report(PLACE, atlas_checks.SIDE), "```"])
    for page, names in PAGES.items():
        (PLACE / page).write_text(filled((PLACE / page).read_text(), {name: parts[name] for name in names}))
    count = sum(len(atlas) for atlas in atlases.values())
    size = sum(path.stat().st_size for path in PLACE.iterdir() if path.suffix in (".sqlite", ".parquet"))
    print(f"{PLACE}: {count} orbits, {size / 1e6:.1f} MB")
    return 0 if count >= 3000 else 1


if __name__ == "__main__":
    sys.exit(main())
