"""How long a newcomer waits in the studio: from the command to a first certified orbit, along a family, for Cancel.

A browser is driven as by hand: the command is given, its page opens, a joint is dragged, the most promising close
return is searched for, its family is followed and slid along, a search is cancelled. Seconds of the clock, and of
processor time of the server and its processes, which a busy machine does not lengthen. The middle of several runs.

    python benchmarks/studio.py            writes results/benchmarks/studio.md, in about two minutes
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from machine import load, processor, versions

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests"))
from studio_browser import Server, Tab, children  # noqa: E402  what the tests drive the page with

RUNS = 3
WANTED = {"first certified orbit": 10.0, "an orbit further along a family": 0.05, "Cancel": 0.5}
"""Seconds at most, on a quiet machine"""
TICKS = os.sysconf("SC_CLK_TCK")


def processor_seconds(process: int) -> float:
    """What a process and those that it started have used, those that have ended included."""
    found = 0.0
    for one in (process, *children(process)):
        fields = Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()
        found += sum(map(int, fields[11:15])) / TICKS
    return found


def run(folder: Path) -> dict[str, tuple[float, float]]:
    """Seconds of the clock and of processor time, by what they are of."""
    found: dict[str, tuple[float, float]] = {}
    tab = Tab(None, folder / "profile")
    began, server = time.monotonic(), Server(folder)
    number = server.process.pid
    try:
        found["the address is printed"] = time.monotonic() - began, processor_seconds(number)
        tab.open(server.address)
        found["the mechanism moves"] = time.monotonic() - began, processor_seconds(number)
        tab.turn(2, 0.5 * np.sqrt(2.0))
        tab.click("find")
        tab.said("certified")
        found["first certified orbit"] = time.monotonic() - began, processor_seconds(number)
        start, used = time.monotonic(), processor_seconds(number)
        tab.click("follow")
        tab.said("closed orbits")
        found["a family of 40 orbits each way"] = time.monotonic() - start, processor_seconds(number) - used
        used, times = processor_seconds(number), tab.slid()
        share = (processor_seconds(number) - used) / len(times)
        found["an orbit further along a family"] = float(np.median(times)) / 1e3, share
        tab.click("branch")
        tab.said("looking|found")
        time.sleep(1.0)
        start, used = time.monotonic(), processor_seconds(number)
        tab.click("cancel")
        tab.said("Stopped", 10.0)
        found["Cancel"] = time.monotonic() - start, float("nan")
    finally:
        tab.driver.quit()
        server.end(signal.SIGKILL)
        server.log.close()
    return found


def table(runs: list[dict[str, tuple[float, float]]]) -> list[str]:
    """The middle of all runs as rows of a table."""
    rows = ["| what | s | of processor time | at most, s |", "|---|---|---|---|"]
    for name in runs[0]:
        clock, used = (float(np.median([one[name][k] for one in runs])) for k in (0, 1))
        asked = f"{WANTED[name]:g}" if name in WANTED else ""
        rows.append(f"| {name} | {clock:.3g} | {'' if np.isnan(used) else f'{used:.3g}'} | {asked} |")
    return rows


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    given = parser.parse_args()
    before, runs = load(), []
    for _ in range(given.runs):
        with tempfile.TemporaryDirectory() as folder:
            runs.append(run(Path(folder)))
    lines = [
        "# How long a newcomer waits in the studio", "", f"{processor()}, {versions('nicegui', 'selenium')}, {before}.",
        "", "A double pendulum, a browser driven as by hand; the middle of "
        f"{given.runs} runs. Times from the command `orbitfinder studio` in the first three rows.", "", *table(runs),
        "", "Made by `python benchmarks/studio.py`.",
    ]  # fmt: skip
    given.out.mkdir(parents=True, exist_ok=True)
    (given.out / "studio.md").write_text("\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
