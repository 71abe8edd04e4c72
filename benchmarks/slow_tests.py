"""How long each file's slow tests take, and whether they pass: the table in docs/explanation/testing.md.

Each file is run by itself, in one process, one after the other; a file that was not run keeps its row, and a new one
says "not measured". Run all on the final code of a release.

    python benchmarks/slow_tests.py [FILE ...] [--limit SECONDS]     all files with slow tests, unless some are named
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from machine import load, processor

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "explanation" / "testing.md"
BEGIN, END = "<!-- slow tests: benchmarks/slow_tests.py -->", "<!-- end of slow tests -->"
HEAD = ["| file | slow tests | seconds | the longest | result |", "|---|---|---|---|---|"]
LIMIT = 3600.0


def pytest(*arguments: str, limit: float = LIMIT) -> str:
    """What pytest prints, "" when it was ended."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    line = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-n", "0", "-q", "-m", "slow", *arguments]
    try:
        done = subprocess.run(line, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return ""
    return done.stdout


def collected() -> Counter[str]:
    """How many slow tests each file has."""
    return Counter(re.findall(r"^tests/(\w+\.py)::", pytest("--collect-only"), re.MULTILINE))


def measured(file: str, count: int, limit: float) -> str:
    """A row: seconds with fixtures, the longest test, and what came out."""
    printed = pytest(f"tests/{file}", "--durations=0", "--durations-min=0", limit=limit)
    if not printed:
        return f"| {file} | {count} | more than {limit:.0f} | | ended |"
    return read(file, count, printed)


def read(file: str, count: int, printed: str) -> str:
    """The row by what pytest printed."""
    spent: Counter[str] = Counter()
    for seconds, name in re.findall(r"^([\d.]+)s +(?:call|setup|teardown) +\S+?::(\S+)", printed, re.MULTILINE):
        spent[name] += float(seconds)  # type: ignore[assignment]
    name, longest = spent.most_common(1)[0] if spent else ("", 0.0)
    last = re.findall(r"^=*\s*((?:\d+ \w+,? ?)+) in ", printed, re.MULTILINE)
    result = re.sub(r",? *\d+ (deselected|warnings?)", "", last[-1]).strip(", ") if last else "no summary"
    return f"| {file} | {count} | {sum(spent.values()):.0f} | {name} {longest:.0f} s | {result} |"


def table(counts: Mapping[str, int], rows: Mapping[str, str]) -> list[str]:
    """A row of each file; where there is none, or the file has more or fewer tests by now, that it was not measured."""
    lines = list(HEAD)
    for file, count in sorted(counts.items()):
        known = rows.get(file, "")
        fresh = known.startswith(f"| {file} | {count} |")
        lines.append(known if fresh else f"| {file} | {count} | not measured | | |")
    return lines


def kept(text: str) -> tuple[str, dict[str, str], str]:
    """The page before the table, its rows by file, and the page after it."""
    before, _, rest = text.partition(BEGIN)
    inside, _, after = rest.partition(END)
    rows = {row.split("|")[1].strip(): row for row in inside.splitlines() if row.startswith("| test_")}
    return before, rows, after


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--limit", type=float, default=LIMIT)
    chosen = parser.parse_args()
    counts = collected()
    wanted = [Path(file).name for file in chosen.files] or sorted(counts)
    if unknown := [file for file in wanted if file not in counts]:
        parser.error(f"{unknown[0]}: has no slow tests; there are {', '.join(sorted(counts))}")
    failed = False
    for file in wanted:
        row = measured(file, counts[file], chosen.limit)
        failed |= "failed" in row or "error" in row or "ended" in row
        print(row, flush=True)
        before, rows, after = kept(PAGE.read_text(encoding="utf-8"))
        lines = table(counts, rows | {file: row})
        PAGE.write_text("\n".join([before + BEGIN, *lines, END + after]), encoding="utf-8")
    print(f"{processor()}, {load()}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
