"""How many .ode files of a folder are read, and whether their rates are XPPAUT's; writes a table of counts.

A file counts as read where at most `period` or `time` is missing. Its rates at XPPAUT's own initial state are compared
with one step of Euler's method by Debian's `xppaut -silent`, which prints eight digits. Nothing of the files is kept.

    python benchmarks/xppaut_files.py NAME=FOLDER ... [--page FILE] [--list]

The folders are clones of public repositories, of which NAME says which and at which commit.
"""

from __future__ import annotations

import argparse
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np

import orbitfinder as of
from orbitfinder.errors import InputError
from orbitfinder.mechanics.model import Model

STEPS = (1e7, 1e3, 1e-1)
"""Steps of the comparison: the first that XPPAUT survives tells most digits of the rates"""
DIGITS = 2e-5
HEAD = [
    "| files of | | read | of these with a period or a time | refused | compared | equal | others |",
    "|---|---|---|---|---|---|---|---|",
]


def read(path: Path) -> tuple[Model | None, str]:
    """The Model of a file, at time 0 where a time is missing, and how it was had or why not."""
    try:
        return of.from_xpp(path), "read"
    except InputError as error:
        said = str(error)
    if "time = " in said:
        try:
            return of.from_xpp(path, time=0.0), "time"
        except InputError as error:
            said = str(error)
    told = re.sub(r"^.*?\.ode: (line \d+: (?:'.*?'|\".*?\"|.*?\.\.\.): )?", "", said)
    return None, re.sub(r"^\S+ is a parameter", "a parameter", told).partition(";")[0][:70]


def stepped(path: Path, size: int, step: float) -> tuple[np.ndarray, np.ndarray] | None:
    """XPPAUT's initial state and the rates there (both d), by one step; None where it makes none."""
    lines = []
    for line in path.read_text(encoding="latin-1").splitlines():
        if re.match(r"\s*d[a-z]*\s*$", line, re.IGNORECASE):
            break
        if not re.match(r"@|\s*(set|options?|o|global|only) ", line, re.IGNORECASE):
            lines.append(line)
    lines += [f"@ meth=euler,dt={step},total={step},bound=1e300,maxstor=10000,trans=0,t0=0,njmp=1", "done", ""]
    with tempfile.TemporaryDirectory() as folder:
        for beside in path.parent.iterdir():  # tables
            if beside.is_file() and beside.suffix != ".ode" and beside.stat().st_size < 200_000:
                shutil.copy(beside, folder)
        (Path(folder) / "a.ode").write_text("\n".join(lines), encoding="latin-1")
        try:
            subprocess.run(["xppaut", "a.ode", "-silent"], cwd=folder, capture_output=True, timeout=60, check=False)
            rows = np.loadtxt(Path(folder) / "output.dat", ndmin=2)
        except (subprocess.TimeoutExpired, OSError, ValueError):
            return None
    if len(rows) < 2:
        return None
    return rows[0, 1 : size + 1], (rows[1, 1 : size + 1] - rows[0, 1 : size + 1]) / step


def equal(path: Path, model: Model) -> bool | None:
    """Whether the rates are XPPAUT's, None where it makes none (or none that is finite)."""
    for step in STEPS:
        made = stepped(path, len(model.state_names), step)
        if made is not None and np.isfinite(made[1]).all():
            state, wanted = made
            own = np.array(model.landmarks["init"])  # to all digits, where XPPAUT read the same
            state = np.where(np.isclose(own, state, rtol=1e-6, atol=1e-12), own, state)
            smooth = model if model.smooth else model.hybrid.modes[0].model
            rates = smooth.rates(0.0, state, smooth.parameter_values).full().ravel()
            scale = np.abs(rates) + np.abs(state) / step * 1e-2 + 1e-12 * np.abs(rates).max()
            if not np.isfinite(rates).all():
                return None
            return bool((np.abs(rates - wanted) <= DIGITS * scale).all())
    return None


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", metavar="NAME=FOLDER")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--list", action="store_true", help="each file that is refused, or whose rates are others")
    chosen = parser.parse_args()
    rows, reasons, total = [], Counter[str](), np.zeros(6, int)
    for name, _, folder in (each.partition("=") for each in chosen.folders):
        counts = Counter[str]()
        for path in sorted(Path(folder).rglob("*.ode")):
            counts["files"] += 1
            model, how = read(path)
            if model is None:
                reasons[how] += 1
                same = None
            else:
                counts["read"] += 1
                counts["timed"] += how == "time"
                same = equal(path, model) if shutil.which("xppaut") else None
                counts["compared"] += same is not None
                counts["equal"] += same is True
            if chosen.list and (model is None or same is False):
                print(path.relative_to(folder), how if model is None else "OTHER RATES", file=sys.stderr)
        numbers = [counts[key] for key in ("files", "read", "timed", "compared", "equal")]
        total += [*numbers, counts["compared"] - counts["equal"]]
        rows.append((name, numbers))
    rows.append(("**all**", total.tolist()[:5]))
    lines = HEAD + [
        f"| {name} | {n} | {had} ({had / max(n, 1):.0%}) | {timed} | {n - had} | {tried} | {same} | {tried - same} |"
        for name, (n, had, timed, tried, same) in rows
    ]
    why = [f"- {count}: {reason}" for reason, count in reasons.most_common()]
    text = "\n".join(["# XPPAUT files of public repositories", "", *(__doc__ or "").split("\n\n")[1].splitlines(), "",
                      *lines, "", "Why files are refused:", "", *why, ""])  # fmt: skip
    if chosen.page:
        chosen.page.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
