"""The numbers of paper.md, read from the pages of results/ that state them.

    python paper/numbers.py            writes them into paper.md
    python paper/numbers.py --check    exit 1 when paper.md says otherwise

Every claim is a phrase of the paper with a gap for each number; a phrase that the paper lacks is an error, so that no
number is left behind when the text changes.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import sqlite3
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAPER = ROOT / "paper" / "paper.md"
RESULTS = ROOT / "results"
PEERS = ("AUTO-07p's demos", "BifurcationKit's", "COCO's", "heyoka's notebook", "CAPD's", "UPOsHam's")
"""How the sections of the validation page begin that hold other programs' own examples."""
GAP = r"([-+.\de]*\d)"


def page(name: str) -> str:
    """A page of results/."""
    return (RESULTS / name).read_text(encoding="utf-8")


def table(text: str, header: str) -> list[dict[str, str]]:
    """The rows of the first table of a page whose header begins so, by column."""
    lines = iter(text.splitlines())
    names = cells(next(line for line in lines if line.startswith(header)))
    next(lines)
    found = []
    for line in lines:
        if not line.startswith("|"):
            break
        found.append(dict(zip(names, cells(line), strict=True)))
    return found


def cells(line: str) -> list[str]:
    """The cells of a line of a table."""
    return [one.strip() for one in line.strip().strip("|").split("|")]


def validation() -> tuple[str, str, str]:
    """Rows of the validation page, those that pass, and those of other programs' own examples."""
    text = page("validation/README.md")
    found = re.search(r"\*\*(\d+) of (\d+) rows pass\.\*\*", text)
    if found is None:
        raise ValueError("results/validation/README.md: no count of rows; run python -m benchmarks.validation")
    rows = table(text, "| section |")
    peers = sum(int(row["rows"]) for row in rows if row["section"].startswith(PEERS))
    return found[2], found[1], str(peers)


def atlas() -> tuple[str, str]:
    """Orbits and systems of the shipped atlas."""
    files = sorted((RESULTS / "atlas").glob("*.sqlite"))
    counts = []
    for path in files:
        with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True)) as store:
            counts.append(int(store.execute("select count(*) from orbits").fetchone()[0]))
    return f"{sum(counts)}", str(len(files))


def proofs() -> str:
    """Proof records that are shipped."""
    return str(len(list((RESULTS / "proofs").glob("*.json"))))


def warm() -> tuple[str, ...]:
    """Milliseconds of a warm refinement, times of AUTO and of heyoka over ours, worst closure of ours."""
    rows = table(page("benchmarks/warm.md"), "| orbit | method |")
    ours = [row for row in rows if row["method"] == "orbitfinder"]
    times = [float(row["median"].removesuffix(" ms")) for row in ours]
    ratios = [
        [float(row["times ours"]) for row in rows if row["method"].startswith(one)] for one in ("AUTO-07p", "heyoka")
    ]
    spans = [f"{end(values):.1f}" for values in (times, *ratios) for end in (min, max)]
    return (*spans, f"{max(float(row['closure']) for row in ours):.1e}")


def families() -> tuple[str, str]:
    """Least and greatest cost of a point on a family over AUTO's, closures checked, without events."""
    values = [float(row["ours / AUTO"]) for row in table(page("benchmarks/families.md"), "| family |")]
    return f"{min(values):.2f}", f"{max(values):.2f}"


def search() -> tuple[str, str]:
    """Distinct orbits of a search of a minute, ours and by hand."""
    found = {row["method"]: row["distinct orbits"] for row in table(page("benchmarks/search.md"), "| method |")}
    return found["orbitfinder, certified"], found["by hand"]


def claims() -> Iterator[tuple[str, tuple[str, ...]]]:
    """Phrases of the paper with {} for each number, and the numbers."""
    rows, passed, peers = validation()
    yield "Of {} comparisons with numbers from outside, {} agree", (rows, passed)
    yield "{} of them are other programs' own examples", (peers,)
    yield "A catalogue of {} certified orbits of {} systems is shipped, and {} proofs", (*atlas(), proofs())
    fast, slow, *ratios, closure = warm()
    yield (
        "takes {} to {} ms on one core, {} to {} times less than AUTO-07p and {} to {} times less",
        (fast, slow, *ratios),
    )
    yield "at a closure of at most {}.", (closure,)
    yield "A point of a family costs {} to {} times AUTO's", families()
    yield "{} distinct certified orbits were found at one energy, where a script of SciPy's solvers found {}.", search()


def pattern(phrase: str) -> re.Pattern[str]:
    """A phrase as it stands in the paper, however its lines are broken."""
    parts = [r"\s+".join(map(re.escape, re.split(r"\s+", part))) for part in phrase.split("{}")]
    return re.compile(GAP.join(parts))


def filled(text: str) -> str:
    """The paper with every number as the pages have it. Raises `ValueError` for a phrase that is not there once."""
    for phrase, numbers in claims():
        found = list(pattern(phrase).finditer(text))
        if len(found) != 1:
            raise ValueError(f"paper.md has the phrase {phrase!r} {len(found)} times; change it here or there")
        for k, number in reversed(list(enumerate(numbers, 1))):
            text = text[: found[0].start(k)] + number + text[found[0].end(k) :]
    return text


def main() -> None:
    """Fill in or check."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="change nothing, exit 1 when a number is out of date")
    text = PAPER.read_text(encoding="utf-8")
    wanted = filled(text)
    if parser.parse_args().check:
        sys.exit("paper.md: numbers are out of date; run python paper/numbers.py" if wanted != text else 0)
    PAPER.write_text(wanted, encoding="utf-8")


if __name__ == "__main__":
    main()
