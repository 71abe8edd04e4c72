"""Every record that is shipped, verified again: the atlas, families with their events and ends, the galleries.

Each record goes through `orbitfinder verify FILE --json`, as a user would ask it, in processes of their own (the six of
problems/published that programs describe by the same certificate): every row
of results/atlas (`FILE.sqlite#K`), every point of results/families (`family.json#K`), and of each family its events and
ends (`family.json`), the orbits of results/orbits, results/report and results/gallery, and those of the documentation
(docs/gallery/orbits: chains, control, examples, hybrid, mechanisms, published orbits, robots). What is done is in a
journal outside the repository: interrupted, the same command goes on; what was verified by other code, or of another
file, is verified again. Writes results/validation/verified.md: counts by kind, and all that fail with cause, apart by
whether errors grow there by less than 1e6 (A of the certificate, which ends there). Exit 1 if anything else fails.

    python -m benchmarks.verify_all                        in two processes
    python -m benchmarks.verify_all --sample 100           so many, drawn from all kinds; prints what all would take
    python -m benchmarks.verify_all --only hybrid control  some kinds; the page is not written
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from orbitfinder.atlas.store import Atlas

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "results" / "validation" / "verified.md"
JOURNAL = Path(tempfile.gettempdir()) / "orbitfinder-verify-all.jsonl"
READABLE = 1e6
"""Amplification from which on a certificate asks no more of double precision: its A is never larger"""
TOGETHER = 12
"""Records of one file that one process verifies"""
LONGEST = 900.0
"""Seconds that one record may take: a chain of 100 links, the events of a family"""
PROGRAMS = ROOT / "problems" / "published"
"""Where the systems are whose equations no file describes, each by a program named like its record"""
BY_PROGRAM = """
import json, sys
from orbitfinder.orbits.certify import certify
from orbitfinder.problemfile.read import load_problem
from orbitfinder.records.certificate import certificate_to_document
from orbitfinder.records.registry import load_orbit
found = certify(load_orbit(sys.argv[1]), load_problem(sys.argv[2], True).model)
print(json.dumps({"results": [certificate_to_document(found)]}))
"""


@dataclass(frozen=True)
class Job:
    """One record: its kind, and the argument of `verify`."""

    kind: str
    record: str

    @property
    def file(self) -> Path:
        """The file that it is in."""
        return ROOT / self.record.partition("#")[0]


@dataclass(frozen=True)
class Verdict:
    """What `verify` says of a record; `scale` is A, nan where there is no certificate; `seal`: of code and file."""

    kind: str
    record: str
    seal: str
    passed: bool
    scale: float
    cause: str
    seconds: float


def jobs() -> list[Job]:
    """Every record, in the order of its files."""
    found = []
    for file in sorted((ROOT / "results" / "atlas").glob("*.sqlite")):
        with Atlas(file) as atlas:
            found += [Job("atlas", f"{relative(file)}#{row.id}") for row in atlas.rows()]
    for file in sorted((ROOT / "results" / "families").glob("*/family.json")):
        found.append(Job("events and ends of families", relative(file)))
        count = len(json.loads(file.read_text(encoding="utf-8"))["points"])
        found += [Job("points of families", f"{relative(file)}#{k}") for k in range(count)]
    for kind, pattern in (
        ("report", "results/orbits/*/orbit.json"), ("report", "results/report/orbits/*/orbit.json"),
        ("gallery", "results/gallery/*/orbit.json"),
    ):  # fmt: skip
        found += [Job(kind, relative(file)) for file in sorted(ROOT.glob(pattern))]
    for file in sorted((ROOT / "docs" / "gallery" / "orbits").glob("*.json")):
        found.append(Job(file.name.partition("-")[0], relative(file)))
    return found


def relative(file: Path) -> str:
    """A path as it is written in the page and the journal."""
    return file.relative_to(ROOT).as_posix()


@cache
def code() -> str:
    """The digest of the package's sources."""
    made = hashlib.sha256()
    for file in sorted((ROOT / "orbitfinder").rglob("*.py")):
        made.update(relative(file).encode() + file.read_bytes())
    return made.hexdigest()


@cache
def seal(file: Path) -> str:
    """What a verdict holds for: this code, this file and the arrays beside it."""
    beside = file.with_suffix(".npz")
    parts = [code().encode(), file.read_bytes(), beside.read_bytes() if beside.exists() else b""]
    return hashlib.sha256(b"".join(hashlib.sha256(one).digest() for one in parts)).hexdigest()[:16]


def asked(records: Iterable[str], limit: float) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of `verify`; code -1 when it was ended."""
    environment = os.environ | {"PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    records = list(records)
    program = PROGRAMS / f"{Path(records[0]).stem.partition('-')[2]}.py"
    line = [sys.executable, "-m", "orbitfinder", "verify", *records, "--json"]
    if len(records) == 1 and program.exists():
        line = [sys.executable, "-c", BY_PROGRAM, *records, str(program)]
    try:
        done = subprocess.run(line, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return -1, "", f"ended after {limit:g} s"
    return done.returncode, done.stdout, done.stderr


def verified(group: list[Job]) -> list[Verdict]:
    """The verdicts of records of one file; each by itself when they cannot be had together."""
    began = time.monotonic()
    status, out, errors = asked([job.record for job in group], LONGEST * len(group))
    spent = (time.monotonic() - began) / len(group)
    results = certificates(out) if status in (0, 1) else []
    if len(group) > 1 and len(results) != len(group):
        return [verdict for job in group for verdict in verified([job])]
    if len(group) == 1 and len(results) != 1:  # a family's events, a refusal, or no answer
        job, failures = group[0], [one for one in results if not one["passed"]]
        cause = "; ".join(map(failed, failures)) or last(errors)
        fine = status == 0
        return [Verdict(job.kind, job.record, seal(job.file), fine, np.nan, "" if fine else cause, spent)]
    return [
        Verdict(job.kind, job.record, seal(job.file), one["passed"], scale_of(one), failed(one), spent)
        for job, one in zip(group, results, strict=True)
    ]


def certificates(out: str) -> list[dict]:
    """The results in what `verify --json` prints."""
    try:
        return json.loads(out)["results"]
    except (ValueError, KeyError, TypeError):
        return []


def scale_of(result: dict) -> float:
    """The amplification of a certificate."""
    return float(result["scale"]) if result.get("scale") is not None else np.nan


def failed(result: dict) -> str:
    """The failed checks with what was found and asked."""
    wrong = [one for one in result.get("checks", []) if not one["passed"]]
    return ", ".join(f"{one['name']} {number(one['value'])} of {number(one['tolerance'])}" for one in wrong)


def number(value: object) -> str:
    """Short."""
    return "inf" if value is None else f"{value:.2g}" if isinstance(value, (int, float)) else str(value)


def last(errors: str) -> str:
    """The last line of a message, without paths of this machine."""
    lines = [line for line in errors.strip().splitlines() if line.strip()]
    return re.sub(rf"{re.escape(str(ROOT))}/?", "", lines[-1])[:300] if lines else "no message"


# ---- the journal -----------------------------------------------------------------------------------


def read(journal: Path) -> dict[str, Verdict]:
    """What is known by this code of files as they are now; a line that was cut short is left out."""
    found = {}
    for line in journal.read_text(encoding="utf-8").splitlines() if journal.exists() else []:
        try:
            one = Verdict(**json.loads(line))
        except (ValueError, TypeError):
            continue
        file = ROOT / one.record.partition("#")[0]
        if file.exists() and one.seal == seal(file):
            found[one.record] = one
    return found


def groups(wanted: Iterable[Job]) -> Iterator[list[Job]]:
    """Members of one file together, a few at a time; whole files alone."""
    held: list[Job] = []
    for job in wanted:
        alone = "#" not in job.record
        if held and (alone or job.file != held[0].file or len(held) == TOGETHER):
            yield held
            held = []
        if alone:
            yield [job]
        else:
            held.append(job)
    if held:
        yield held


def run(wanted: list[Job], journal: Path, workers: int) -> dict[str, Verdict]:
    """Verify what is not in the journal yet, each verdict written as soon as it is there."""
    known = read(journal)
    left = [job for job in wanted if job.record not in known]
    lock, began, done = threading.Lock(), time.monotonic(), 0
    journal.parent.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(workers) as pool, journal.open("a", encoding="utf-8") as file:
        for future in as_completed([pool.submit(verified, group) for group in groups(left)]):
            with lock:
                for one in future.result():
                    known[one.record] = one
                    file.write(json.dumps(asdict(one)) + "\n")
                    done += 1
                file.flush()
                spent = time.monotonic() - began
                rest = spent / done * (len(left) - done)
                print(f"{done} of {len(left)}, {spent:.0f} s, some {rest:.0f} s more", file=sys.stderr, flush=True)
    return {job.record: known[job.record] for job in wanted}


def sampled(every: list[Job], count: int, seed: int) -> list[Job]:
    """So many records, of each kind its share and at least two."""
    random, chosen = np.random.default_rng(seed), []
    kinds = {job.kind: [k for k, other in enumerate(every) if other.kind == job.kind] for job in every}
    for members in kinds.values():
        size = min(len(members), max(2, round(count * len(members) / len(every))))
        chosen += list(random.choice(members, size, replace=False))
    return [every[k] for k in sorted(chosen)]


# ---- the page --------------------------------------------------------------------------------------


def table(verdicts: Iterable[Verdict]) -> list[str]:
    """Counts by kind."""
    verdicts = list(verdicts)
    lines = [
        "| kind | records | verified | fail, A < 1e6 | fail, A >= 1e6 | no certificate | seconds |",
        "|---|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(one.kind for one in verdicts):
        lines.append(row(kind, [one for one in verdicts if one.kind == kind]))
    return [*lines, row("**all**", verdicts)]


def row(kind: str, verdicts: list[Verdict]) -> str:
    """One line of the table."""
    counts = [sum(classed(one) == name for one in verdicts) for name in ("verified", "small", "large", "none")]
    spent = sum(one.seconds for one in verdicts)
    return f"| {kind} | {len(verdicts)} | {' | '.join(map(str, counts))} | {spent:.0f} |"


def classed(one: Verdict) -> str:
    """verified, or why it counts where: by A, or without a certificate (a refusal, events)."""
    if one.passed:
        return "verified"
    return "none" if np.isnan(one.scale) else "small" if one.scale < READABLE else "large"


HEADINGS = {
    "small": "Fail although errors grow by less than 1e6",
    "none": "Fail without a certificate: events and ends, refusals",
    "large": "Fail where errors grow by 1e6 or more",
}


def page(verdicts: list[Verdict]) -> str:
    """results/validation/verified.md."""
    lines = [
        "# Every shipped record, verified again\n",
        "Written by `python -m benchmarks.verify_all`: `orbitfinder verify` on every row of results/atlas, every point "
        "of results/families and the events and ends of each family, every orbit of results/orbits, results/report and "
        "results/gallery, and every one of the documentation's galleries. A is what errors grow by on the way, as the "
        "certificate says, which counts no further than 1e6.\n",
        *table(verdicts),
    ]
    for name, heading in HEADINGS.items():
        wrong = [one for one in verdicts if classed(one) == name]
        if wrong:
            lines += ["", f"## {heading}", "", "| record | A | what fails |", "|---|---|---|"]
            lines += [f"| {one.record} | {one.scale:.2g} | {one.cause.replace('|', '/')} |" for one in wrong]
    return "\n".join(lines) + "\n"


def main() -> int:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    said = f"default: {JOURNAL.name} in the temporary folder"
    parser.add_argument("--journal", type=Path, default=JOURNAL, help=said)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", nargs="+", default=None, metavar="KIND")
    parser.add_argument("--sample", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=PAGE)
    chosen = parser.parse_args()
    if ROOT in chosen.journal.resolve().parents:
        parser.error(f"--journal {chosen.journal}: is inside the repository; give a file elsewhere")
    every = jobs()
    kinds = dict.fromkeys(job.kind for job in every)
    if unknown := [kind for kind in chosen.only or () if kind not in kinds]:
        parser.error(f"--only {unknown[0]!r}: no such kind; there are {', '.join(map(repr, kinds))}")
    wanted = [job for job in every if not chosen.only or job.kind in chosen.only]
    if chosen.sample:
        wanted = sampled(wanted, chosen.sample, chosen.seed)
    verdicts = list(run(wanted, chosen.journal, chosen.workers).values())
    print("\n".join(table(verdicts)))
    for one in verdicts:
        if not one.passed:
            print(f"{one.record}: A {one.scale:.2g}: {one.cause}")
    if chosen.sample:
        counts = {kind: sum(job.kind == kind for job in every) for kind in dict.fromkeys(one.kind for one in verdicts)}
        means = {kind: np.mean([one.seconds for one in verdicts if one.kind == kind]) for kind in counts}
        total = sum(counts[kind] * means[kind] for kind in counts)
        print(f"all {sum(counts.values())} records: some {total:.0f} s of one process; {chosen.workers} are used")
    elif not chosen.only:
        chosen.out.write_text(page(verdicts), encoding="utf-8")
        print(chosen.out)
    return int(any(not one.passed and classed(one) != "large" for one in verdicts))


if __name__ == "__main__":
    sys.exit(main())
