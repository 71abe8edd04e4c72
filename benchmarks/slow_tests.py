"""What the tests cost: the slow ones in parts, with a journal and a page; and the quick ones against their budget.

Each file's slow tests are run by themselves, in one process, one file after the other. Every run is a line of
`slow_tests.jsonl`, and the table in docs/explanation/testing.md is written from it: seconds, result, and the commit on
which the file last passed. With `--budget` those run that have waited longest, as many as the seconds allow; one that
takes longer than what is left is ended, which is in the journal and is no failure.

    python benchmarks/slow_tests.py [FILE ...] [--limit SECONDS]     all files with slow tests, unless some are named
    python benchmarks/slow_tests.py --budget SECONDS                 a part of them
    python benchmarks/slow_tests.py --over TIMES      what `pytest --times TIMES` measured above its budget
    python benchmarks/slow_tests.py --mark TIMES      write what it measured above a second into tests/budget.toml
"""

from __future__ import annotations

import argparse
import json
import math
import os
import re
import signal
import statistics
import subprocess
import sys
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from machine import load, processor

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "explanation" / "testing.md"
JOURNAL = Path(__file__).with_suffix(".jsonl")
BUDGET = ROOT / "tests" / "budget.toml"
BEGIN, END = "<!-- slow tests: benchmarks/slow_tests.py -->", "<!-- end of slow tests -->"
HEAD = ["| file | slow tests | seconds | the longest | result | last passed on |", "|---|---|---|---|---|---|"]
LIMIT, ENDED = 3600.0, "ended"
QUICK, MARGIN, COLD = 1.0, 2.0, 3.0
"""A test or shared fixture above so many processor seconds is slow or stands in the budget. It fails the check above so
many times its seconds and so many more, since the first that needs a march compiles it, each times what this machine
takes where the budget's took one."""
ENOUGH = 10
"""So many entries that were measured say how fast this machine is: the median of what they took for what they may"""
MOST, ALTOGETHER = 60, 150.0
"""The budget's entries and processor seconds at most"""


def pytest(*arguments: str, limit: float = LIMIT) -> str:
    """What pytest prints, "" when it was ended."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg"}
    line = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "-n", "0", "-q", "-m", "slow", *arguments]
    with subprocess.Popen(
        line, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        start_new_session=True,
    ) as process:  # fmt: skip
        try:
            return process.communicate(timeout=limit)[0]
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)  # with all that the tests started
            return ""


def collected() -> Counter[str]:
    """How many slow tests each file has."""
    return Counter(re.findall(r"^tests/(\w+\.py)::", pytest("--collect-only"), re.MULTILINE))


def commit() -> str:
    """The commit that is checked out, with a + where the package or its tests differ from it."""

    def git(*words: str) -> str:
        return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False).stdout.strip()

    return git("rev-parse", "--short=8", "HEAD") + "+" * bool(git("status", "--short", "orbitfinder", "tests"))


def measured(file: str, count: int, limit: float) -> dict[str, Any]:
    """A line of the journal: seconds with fixtures, the longest test, and the result."""
    printed = pytest(f"tests/{file}", "--durations=0", "--durations-min=0", limit=limit)
    entry = read(printed) if printed else {"seconds": round(limit), "longest": "", "result": ENDED, "passed": False}
    kernels = os.environ.get("OPENBLAS_CORETYPE", "")
    return {"file": file, "tests": count, "commit": commit(), "kernels": kernels, **entry}


def read(printed: str) -> dict[str, Any]:
    """The same by what pytest printed."""
    spent: Counter[str] = Counter()
    for seconds, name in re.findall(r"^([\d.]+)s +(?:call|setup|teardown) +\S+?::(\S+)", printed, re.MULTILINE):
        spent[name] += float(seconds)  # type: ignore[assignment]
    name, longest = spent.most_common(1)[0] if spent else ("", 0.0)
    last = re.findall(r"^=*\s*((?:\d+ \w+,? ?)+) in ", printed, re.MULTILINE)
    result = re.sub(r",? *\d+ (deselected|warnings?)", "", last[-1]).strip(", ") if last else "no summary"
    passed = bool(last) and not re.search(r"\bfailed|error", result)
    return {
        "seconds": round(sum(spent.values())), "longest": f"{name} {longest:.0f} s", "result": result, "passed": passed,
        "failed": re.findall(r"^(?:FAILED|ERROR) \S+?::(\S+)", printed, re.MULTILINE),
    }  # fmt: skip


def entries() -> list[dict[str, Any]]:
    """The lines of the journal."""
    return [json.loads(line) for line in JOURNAL.read_text(encoding="utf-8").splitlines()] if JOURNAL.exists() else []


def table(counts: Mapping[str, int], journal: Iterable[Mapping[str, Any]]) -> list[str]:
    """A row per file: its last run, unless the file has more or fewer tests by now, and the last that passed."""
    runs = {entry["file"]: entry for entry in journal}
    passed = {entry["file"]: entry["commit"] for entry in journal if entry["passed"]}
    lines = list(HEAD)
    for file, count in sorted(counts.items()):
        last, since = runs.get(file, {"tests": None}), passed.get(file, "")
        fresh = f"{last['seconds']} | {last['longest']} | {last['result']}" if last["tests"] == count else "not run | |"
        lines.append(f"| {file} | {count} | {fresh} | {since} |")
    return lines


def waiting(counts: Mapping[str, int], journal: Iterable[Mapping[str, Any]], budget: float) -> list[str]:
    """The files to run within so many seconds: those that never passed, then those whose last pass is oldest."""
    seconds = {entry["file"]: entry["seconds"] * (1 + (entry["result"] == ENDED)) for entry in journal}
    order = {entry["file"]: k for k, entry in enumerate(journal) if entry["passed"]}
    chosen = list[str]()
    for file in sorted(counts, key=lambda file: (order.get(file, -1), file)):
        expected = seconds.get(file, 2.0 * counts[file])
        if expected <= budget:
            chosen.append(file)
            budget -= expected
    return chosen


def replaced(text: str, rows: Iterable[str]) -> str:
    """The page with other rows in its table."""
    before, _, rest = text.partition(BEGIN)
    return "\n".join([before + BEGIN, *rows, END + rest.partition(END)[2]])


def over(times: Mapping[str, float], budget: Mapping[str, Any]) -> list[str]:
    """Sentences on what took longer than it may, and on a budget that is larger than it may be."""
    quick = {entry["name"]: entry["seconds"] for entry in budget["quick"]}
    ratios = [times[name] / seconds for name, seconds in quick.items() if name in times]
    pace = max(1.0, statistics.median(ratios)) if len(ratios) >= ENOUGH else 1.0
    found = [
        f"{name}: {seconds:.1f} s of processor time, allowed are {quick.get(name, QUICK):g} s"
        + f" where all take {pace:.1f} times as long" * (pace > 1)
        for name, seconds in times.items()
        if seconds > pace * (MARGIN * quick.get(name, QUICK) + COLD)
    ]
    if len(quick) > MOST or sum(quick.values()) > ALTOGETHER:
        found.append(
            f"tests/budget.toml: {len(quick)} entries, {sum(quick.values()):g} s; at most {MOST}, {ALTOGETHER:g} s"
        )
    return found


def marked(measured: Mapping[str, Any], budget: Mapping[str, Any]) -> list[str]:
    """The tests that are slow: those listed, those above a second, and all that use a shared fixture above it.

    Where all parameters of a test are slow, the test is listed without them.
    """
    quick = {entry["name"] for entry in budget["quick"]}
    dear = {name for name, seconds in measured["seconds"].items() if seconds > QUICK and name not in quick}
    slow = {
        test
        for test, fixtures in measured["uses"].items()
        if (test in dear or dear & set(fixtures)) and test not in quick
    }
    every = Counter(test.partition("[")[0] for test in measured["uses"])
    found = Counter(test.partition("[")[0] for test in slow)
    return sorted({*budget["slow"], *(t if found[f := t.partition("[")[0]] < every[f] else f for t in slow)})


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="*")
    parser.add_argument("--limit", type=float, default=LIMIT)
    parser.add_argument("--budget", type=float)
    parser.add_argument("--over", type=Path, metavar="TIMES")
    parser.add_argument("--mark", type=Path, metavar="TIMES")
    chosen = parser.parse_args()
    if times := chosen.over or chosen.mark:
        budget, spent = tomllib.loads(BUDGET.read_text(encoding="utf-8")), json.loads(times.read_text(encoding="utf-8"))
        if chosen.over:
            sentences = over(spent["seconds"], budget)
            print("\n".join(sentences) or "every quick test is within its budget")
            return int(bool(sentences))
        lines = "".join(f"  {json.dumps(name)},\n" for name in marked(spent, budget))
        text = re.sub(
            r"^slow = \[\n.*?^\]",
            lambda _: f"slow = [\n{lines}]",
            BUDGET.read_text(encoding="utf-8"),
            flags=re.M | re.S,
        )
        BUDGET.write_text(text, encoding="utf-8")
        return 0
    counts = collected()
    wanted = [Path(file).name for file in chosen.files] or sorted(counts)
    if unknown := [file for file in wanted if file not in counts]:
        parser.error(f"{unknown[0]}: has no slow tests; there are {', '.join(sorted(counts))}")
    if chosen.budget is not None:
        wanted = waiting(counts, entries(), chosen.budget)
    failed, began = False, time.monotonic()
    for file in wanted:
        left = math.inf if chosen.budget is None else chosen.budget - (time.monotonic() - began)
        if left <= 0:
            break
        entry = measured(file, counts[file], min(chosen.limit, left))
        failed |= not entry["passed"] and (chosen.budget is None or entry["result"] != ENDED)
        with JOURNAL.open("a", encoding="utf-8") as journal:
            journal.write(json.dumps(entry) + "\n")
        rows = table(counts, entries())
        print(next(row for row in rows if row.startswith(f"| {file} ")), flush=True)
        PAGE.write_text(replaced(PAGE.read_text(encoding="utf-8"), rows), encoding="utf-8")
    print(f"{processor()}, {load()}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
