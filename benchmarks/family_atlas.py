"""Write results/families: every family by the command that its entry in README.md gives.

Sizes are kept small: one line of JSON and figures in few colours, without the nodes.

    python benchmarks/family_atlas.py                all of it, some minutes
    python benchmarks/family_atlas.py --only NAME    one entry again (and what it is switched from)
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from orbitfinder.records.family import Family, load_family
from orbitfinder.show.plot import frequency_energy
from orbitfinder.show.style import save_png

ROOT = Path(__file__).parents[1]
HERE = ROOT / "results" / "families"
REPORT = {
    "triple-1": ("triple-1", -38.35109857464619, 1.655), "triple-2": ("triple-2", -36.1205384037786, 2.925),
    "quadruple-1": ("quadruple-mode-2", -77.9365603703212, 1.411),
    "quadruple-2": ("quadruple-mode-3", -78.31380643132762, 0.798),
}  # fmt: skip
"""Each orbit of the report: the family that it is on, its energy (J) and roughly its period (s), which tells it from
the orbit of equal energy beyond the family's fold."""
COLOURS = 255


@dataclass(frozen=True)
class Entry:
    """A family of the atlas: name, the arguments of `orbitfinder continue`, what a reader should know."""

    name: str
    arguments: str
    text: str
    source: str = ""


def mode(links: str, number: int, options: str, text: str) -> Entry:
    """The family of a normal mode, from small amplitudes."""
    name = f"{links}-mode-{number}"
    return Entry(name, f"problems/families/{name}.toml --direction forward {options}", text)


TOP = "--points 600"
SWINGS = "--points 600 --at"
ENTRIES = (
    mode("triple", 1, TOP, """The slow swing of the triple pendulum, all links nearly in line. It ends at the fully
upright saddle, 88.2 J above hanging."""),
    mode("triple", 2, TOP, """The second mode, the last link against the first two. Its reflection breaks at the first
branch point: the family of the report's triple-1 leaves there."""),
    mode("triple", 3, TOP, """The fast mode, neighbouring links against each other. Where its multipliers are +-i a
family of four times its period leaves: that of the report's triple-2."""),
    Entry("triple-1", "{out}/triple-mode-2/family.json --switch 2 --at -38.35109857464619 --points 600",
          """The branch that breaks the reflection of the second mode and keeps its rest points. The report's first
triple orbit is on it, on the way down to the fold in energy.""", "triple-mode-2"),
    Entry("triple-2", "{out}/triple-mode-3/family.json --switch 1 --branch 2 --at -36.1205384037786 --points 300",
          """A period-quadrupled branch of the third mode, odd in time instead of coming to rest. The report's second
triple orbit, which swings like a single pendulum, is on it.""", "triple-mode-3"),
    mode("quadruple", 1, TOP, """The slow swing of the quadruple pendulum. Near 1 J above hanging it is in 7:1 resonance
with the fourth mode, and the family from the equilibrium turns away there. Going straight over that avoided crossing
leads to a closed family between -77.4508 and -39.9080 J, which is recognised when it comes back to itself."""),
    Entry("quadruple-mode-1-resolved", "problems/families/quadruple-mode-1.toml --direction forward --resolve 2e-4 "
          "--name quadruple-mode-1-resolved " + TOP, """The same start followed through the 7:1 resonance: the curve
that truly belongs to the equilibrium. It goes on to the fully upright saddle."""),
    mode("quadruple", 2, SWINGS + " -77.9365603703212", """The second mode; the report's first quadruple orbit is a
small motion on it."""),
    mode("quadruple", 3, SWINGS + " -78.31380643132762", """The third mode; the report's second quadruple orbit is a
small motion on it."""),
    mode("quadruple", 4, TOP, """The fast mode, neighbouring links against each other. Modes 2 to 4 end at the fully
upright saddle, 156.8 J above hanging."""),
    Entry("five-bar-slow", "problems/families/five-bar-slow.toml --points 85", """A five-bar under gravity, slow mode,
in minimal coordinates; the family folds at -8 J and comes back unstable."""),
    Entry("five-bar-fast", "problems/families/five-bar-fast.toml --points 150", "The same five-bar, fast mode."),
    Entry("five-bar-length", "problems/families/five-bar-length.toml --parameter length3 --until 2.2",
          """The slow mode at one energy while the length of a bar varies, the loop closed anew at every length."""),
    Entry("henon-heiles-straight", "problems/families/henon-heiles-straight.toml --points 100", """The straight line of
Hénon-Heiles up to the saddle at E = 1/6, with its cascade of stability changes."""),
    Entry("henon-heiles-curved", "problems/families/henon-heiles-curved.toml --points 25", """A curved brake
orbit of Hénon-Heiles; beyond E = 1/6 it goes on among escaping motions."""),
    Entry("henon-heiles-loop", "problems/families/henon-heiles-loop.toml --points 25",
          "A loop of Hénon-Heiles."),
)  # fmt: skip


def main() -> None:
    """Compute what is asked for, then write the page about all that is there."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=None, help="a name; none computes nothing and writes the page again")
    only = parser.parse_args().only
    with tempfile.TemporaryDirectory() as name:
        out = Path(name)
        wanted = {only, *(entry.source for entry in ENTRIES if entry.name == only)} if only else None
        for entry in ENTRIES:
            if wanted is None or entry.name in wanted:
                computed(entry, out)
    (HERE / "README.md").write_text(page(), encoding="utf-8")


def command(entry: Entry, out: str) -> str:
    """The arguments of `orbitfinder` as one line."""
    naming = f" --name {entry.name}" if entry.source else ""
    return f"continue {entry.arguments.format(out=out)}{naming} --out {out}"


def computed(entry: Entry, out: Path) -> None:
    """Run one command and keep what is small: family.json in one line, figures in few colours."""
    arguments = shlex.split(command(entry, str(out)))
    print(entry.name, flush=True)
    subprocess.run([sys.executable, "-m", "orbitfinder", *arguments], cwd=ROOT, check=True, stderr=subprocess.DEVNULL)
    folder = HERE / entry.name
    folder.mkdir(exist_ok=True)
    document = json.loads((out / entry.name / "family.json").read_text(encoding="utf-8"))
    text = json.dumps(document, separators=(",", ":"))
    (folder / "family.json").write_text(text + "\n", encoding="utf-8")
    for path in (out / entry.name).glob("*.png"):
        fewer_colours(path, folder / path.name)


def fewer_colours(path: Path, target: Path) -> None:
    """A figure as a palette PNG, a quarter of its size."""
    with Image.open(path) as image:
        image.convert("RGB").quantize(COLOURS, method=Image.Quantize.MEDIANCUT).save(target, optimize=True)


def page() -> str:
    """README.md: overviews, then an entry for every family that is here."""
    families = {entry.name: load_family(HERE / entry.name / "family.json") for entry in ENTRIES
                if (HERE / entry.name / "family.json").is_file()}  # fmt: skip
    for links in ("triple", "quadruple"):
        shown = [family for name, family in families.items() if name.startswith(links)]
        marks = {name: exact(families[home], *where) for name, (home, *where) in REPORT.items()
                 if name.startswith(links) and home in families}  # fmt: skip
        save_png(frequency_energy(shown, marks, title=f"Families of the {links} pendulum"), HERE / f"{links}.png")
        fewer_colours(HERE / f"{links}.png", HERE / f"{links}.png")
    entries = [described(entry, families[entry.name]) for entry in ENTRIES if entry.name in families]
    head = HEAD.format(rows="\n".join(report_rows(families)), overview="\n".join(overview(families)))
    return head + "\n".join(entries)


HEAD = """# Families of periodic orbits

Every point of these curves is a periodic orbit that closes, by an independent integrator on Hamilton's equations, to
1e-11 of its extents times what errors grow by on the way; where they grow more than 1000 times each shooting node
also leads to the next one within 1e-11 times the growth in between (`defect`), without which such a closure would say
little. The ends, and the orbits of the report, have the full certificate. Multipliers near
the saddles are found factor by factor, with an estimated error (`multiplier_errors` of the normal modes). Solid lines
are stable, dashed ones unstable. Energies are absolute, potential zero at the fixed joint: the triple pendulum hangs at
-44.1 J, the quadruple one at -78.4 J. Written by `python benchmarks/family_atlas.py`; `families/` in the commands
stands for any folder. The nodes beside each family.json (family.npz) are left out here; the same commands write them.

![Triple pendulum](triple.png)
![Quadruple pendulum](quadruple.png)

## Where the report's four orbits are

| orbit | energy (J) | period (s) | family | how it is reached |
|---|---|---|---|---|
{rows}

## All families

| family | symmetry | orbits | energies (J) | periods (s) | events | ends |
|---|---|---|---|---|---|---|
{overview}

"""
HOW = {
    "triple-1": "switch at event 2 of triple-mode-2, where its reflection breaks",
    "triple-2": "switch at event 1 of triple-mode-3, multipliers at +-i, to the branch of reversal symmetry",
    "quadruple-1": "on the normal mode itself", "quadruple-2": "on the normal mode itself",
}  # fmt: skip


def exact(family: Family, level: float, near: float) -> tuple[float, float]:
    """(energy, period) of the orbit at an energy that was asked for, with a period near the given one."""
    point = min(family.points, key=lambda one: abs(one.energy - level) + 1e-3 * abs(one.period - near))
    return point.energy, point.period


def report_rows(families: dict[str, Family]) -> list[str]:
    """The table of the report's orbits."""
    rows = []
    for name, (home, level, near) in REPORT.items():
        if home in families:
            energy, period = exact(families[home], level, near)
            rows.append(f"| {name} | {energy:.9f} | {period:.13f} | {home} | {HOW[name]} |")
    return rows


def overview(families: dict[str, Family]) -> list[str]:
    """One row a family."""
    rows = []
    for name, family in families.items():
        levels, periods = family.values("energy"), family.values("period")
        ends = ", ".join(end.kind for end in family.ends)
        rows.append(
            f"| [{name}](#{name}) | {family.points[0].symmetry} | {len(family.points)} | {levels.min():.6g} to "
            f"{levels.max():.6g} | {periods.min():.5g} to {periods.max():.5g} | {len(family.events)} | {ends} |"
        )
    return rows


def described(entry: Entry, family: Family) -> str:
    """Heading, prose, command, ends, events and figures of one family."""
    ends = "\n".join(f"- {end.kind}: {end.reason}" for end in family.ends)
    main_events = [(k, event) for k, event in enumerate(family.events) if event.kind not in ("resonance",)]
    others = len(family.events) - len(main_events)
    rows = "\n".join(
        f"| {k} | {event.kind.replace('_', ' ')} {event.detail} | {event.energy:.9g} | {event.period:.9g} |"
        for k, event in main_events[:40]
    )
    more = f" (the first 40 of {len(main_events)})" if len(main_events) > 40 else ""
    figures = " ".join(
        f"![{path.stem}]({entry.name}/{path.name})" for path in sorted((HERE / entry.name).glob("*.png"))
    )
    table = f"| index | event | energy (J) | period (s) |\n|---|---|---|---|\n{rows}\n" if rows else ""
    return f"""## {entry.name}

{entry.text}

    orbitfinder {command(entry, "families")}

Ends:

{ends}

Events{more}, and {others} resonances of order 3 to 6 in family.json:

{table}
{figures}
"""


if __name__ == "__main__":
    main()
