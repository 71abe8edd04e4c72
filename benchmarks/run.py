"""Every benchmark by one command, in a quarter of an hour, and one page over their results.

Each part is a script of its own that writes its page and pictures; a part that fails or is missing is named and the
others go on. Run it on a quiet machine: all parts take turns with their peers, but only quiet makes times repeat.

    python benchmarks/run.py                      writes results/benchmarks/README.md and the parts' pages
    python benchmarks/run.py --only warm cost     only these parts; the page still shows the others' last results
"""

from __future__ import annotations

import argparse
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from machine import load, processor, said_by, versions

HERE = Path(__file__).parent
ROOT = HERE.parent
OUT = ROOT / "results" / "benchmarks"


@dataclass(frozen=True)
class Part:
    """A script, its arguments, the page that it writes, and after how many seconds it is ended."""

    name: str
    heading: str
    arguments: tuple[str, ...] = ()
    limit: float = 300.0

    @property
    def script(self) -> Path:
        """Where it is."""
        return HERE / f"{self.name}.py"

    @property
    def page(self) -> Path:
        """What it writes."""
        return OUT / f"{self.name}.md"


PARTS = (
    Part("warm", "Warm refinement of the four report orbits, against AUTO-07p, heyoka, scipy and Octave", limit=480.0),
    Part("refine", "The same from nothing: `find_orbit` against the script by hand"),
    Part("families", "Continuation: cost of a point, against AUTO-07p", limit=600.0),
    Part("resonance", "Duffing's resonance curve: cost of a point, against AUTO-07p", limit=120.0),
    Part("curves", "Curves in two parameters: cost of a point, against AUTO-07p", limit=120.0),
    Part("search", "Search: distinct orbits in a minute, against the loop by hand"),
    Part("breakdown", "Where the time of one refinement goes"),
    Part("cost", "Evaluating chains: time and memory against the number of links"),
    Part("derivation", "Deriving chains: time and operations against the number of links"),
)
ELSEWHERE = {
    "road": "Equilibria and cycles that AUTO's users know, by shooting and by collocation: `python benchmarks/road.py`",
    "first_order": "First-order systems by Newton's method over DOP853 alone: `python benchmarks/first_order.py`",
    "long_chains": "Normal modes of long chains: `python benchmarks/long_chains.py`, longer than this command runs",
    "large": "Large systems by shooting, against an earlier checkout: `python benchmarks/large.py --before FOLDER`",
    "balance": "Large driven systems by harmonic balance: `python benchmarks/balance.py --pyharm PYTHON`",
    "earlier": "Times against an earlier checkout's: `python benchmarks/earlier.py --against COMMIT`",
    "control": "Controlled motions beside rockit: `python benchmarks/control.py`",
    "maps": "Maps of a parameter plane, bifurcation diagrams by brute force: `python benchmarks/maps.py`",
    "sweep": "Parameter studies, orbits a second of a core: `python benchmarks/sweep.py`",
    "search_wide": "A wider search, against an earlier checkout: `python benchmarks/search.py --against COMMIT`",
    "search_memory": "Memory of a search of 100,000 starts: `python benchmarks/search.py --memory 100000`",
    "hybrid_search": "Searches of hybrid systems, against a scan by brute force: `python benchmarks/hybrid_search.py`",
    "hybrid": "Walking machines, against a script by hand and a second program: `python benchmarks/hybrid.py`",
}

PRINTED = {
    "mechanisms": "What trees of bodies cost, to 240 of them: `python benchmarks/mechanisms.py`, half a minute",
    "robots": "Modes of the compliant seven-joint arm: `python benchmarks/robots.py`, half a minute",
    "variational": "Marches with variations, against an earlier checkout: `python benchmarks/variational.py`",
}
"""Scripts that print a table and write no page"""


def run(part: Part) -> str:
    """Run one part; what to say of it."""
    if not part.script.exists():
        return "not run: no such script"
    began, before = time.monotonic(), part.page.stat().st_mtime if part.page.exists() else 0.0
    process = subprocess.Popen(
        [sys.executable, str(part.script), *part.arguments], cwd=ROOT, text=True, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        said = process.communicate(timeout=part.limit)[1]
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)  # with the processes that the part started
        process.communicate()
        return f"ended after {part.limit:g} s; the page shows an earlier run"
    written = part.page.exists() and part.page.stat().st_mtime > before
    if not written:
        last = (said.strip().splitlines() or ["no message"])[-1]
        return f"failed ({last[:200]}); the page shows an earlier run"
    missed = "" if process.returncode == 0 else ", something wanted was missed (see there)"
    return f"{time.monotonic() - began:.0f} s{missed}"


def quoted(page: Path) -> list[str]:
    """The tables, pictures and verdicts of a part's page, without its heading and introduction."""
    lines = page.read_text(encoding="utf-8").splitlines()
    first = next((k for k, line in enumerate(lines) if line.startswith("|")), len(lines))
    kept = ["#" + line if line.startswith("#") else line for line in lines[first:]]
    return ["\n".join(kept).strip()]


def standing(page: Path) -> dict[str, str]:
    """What the page says of each part, which a run of other parts leaves as it is."""
    text = page.read_text(encoding="utf-8") if page.exists() else ""
    rows = dict(re.findall(r"^\| (.+?) \| (.+?) \|", text, re.MULTILINE))
    return {part.name: rows[part.heading] for part in PARTS if part.heading in rows}


def measured_on(page: Path) -> list[str]:
    """The machine and the versions that the page names, which a run of some parts leaves as they are."""
    lines = page.read_text(encoding="utf-8").splitlines() if page.exists() else []
    return lines[4 : lines.index("", 4)] if len(lines) > 4 else []


def assembled(said: dict[str, str], previous: list[str]) -> str:
    """The page over all parts."""
    lines = [
        "# Benchmarks", "",
        "`python benchmarks/run.py`; every number here is written by the scripts in `benchmarks/`, one page each; some "
        "print a table alone.", "",
        *previous, "",
        "| part | last run by this command | page |", "|---|---|---|",
    ]  # fmt: skip
    for part in PARTS:
        link = f"[{part.page.name}]({part.page.name})" if part.page.exists() else "missing"
        lines.append(f"| {part.heading} | {said.get(part.name, 'not run this time')} | {link} |")
    for name, heading in ELSEWHERE.items():
        if (OUT / f"{name}.md").exists():
            lines.append(f"| {heading} | | [{name}.md]({name}.md) |")
    lines += [f"| {heading} | | printed |" for heading in PRINTED.values()]
    for part in PARTS:
        if part.page.exists():
            lines += ["", f"## {part.heading}", "", *quoted(part.page)]
    return "\n".join(lines) + "\n"


def conditions(before: str) -> list[str]:
    """The machine and the versions."""
    programs = [said_by("octave", "--version"), said_by("gfortran", "--version"), auto_version()]
    return [
        f"{processor()}. {before} before, {load()} after (a quiet machine has less than 1 before).",
        f"{versions('heyoka')}, {', '.join(one for one in programs if one)}.",
    ]


def auto_version() -> str:
    """AUTO-07p does not print its version; its package does."""
    found = said_by("dpkg-query", "-W", "-f", "AUTO-07p ${Version}", "auto-07p")
    return found or ("AUTO-07p" if Path(os.environ.get("AUTO_DIR", "/usr/lib/auto-07p")).exists() else "")


def main() -> int:
    names = [part.name for part in PARTS]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=names, default=names)
    chosen = parser.parse_args().only
    OUT.mkdir(parents=True, exist_ok=True)
    before, said = load(), standing(OUT / "README.md")
    for part in PARTS:
        if part.name in chosen:
            print(f"{part.name} ...", file=sys.stderr, flush=True)
            said[part.name] = run(part)
            print(f"{part.name}: {said[part.name]}", file=sys.stderr, flush=True)
    known = measured_on(OUT / "README.md") if chosen != names else []
    (OUT / "README.md").write_text(assembled(said, known or conditions(before)), encoding="utf-8")
    print(OUT.relative_to(ROOT) / "README.md")
    return 1 if any(said[name].startswith(("failed", "ended")) for name in chosen) else 0


if __name__ == "__main__":
    sys.exit(main())
