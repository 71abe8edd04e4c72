"""Our own times, and their ratios to an earlier checkout's.

    python benchmarks/earlier.py                                      this checkout's times
    python benchmarks/earlier.py --against CHECKOUT|COMMIT            beside another's, as ratios
    python benchmarks/earlier.py --only torus 'refine triple-1' ...   these rows
    python benchmarks/earlier.py --json                               the same as one JSON document

Each row is done by two processes that stay, one a checkout, in turns: both do this file's work with the package of
their own checkout. Times are processor times, the least of so many turns (turns.py), each the mean over a fifth of a
second where once is shorter. "latency" is another: two new processes a turn, with empty caches, the compiler included,
to the first point of a family; what counts there is the difference.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from peers.task import NAMES, Unavailable, tasks
from tori import NOBLE, PROBLEM
from turns import Run, arguments, conditions, followed, in_turns, known, processor_time, progress, publish

import orbitfinder as of

ROOT = Path(__file__).parents[1]
REPEATS, LEAST, LIMIT = 3, 0.2, 300.0
"""Turns, seconds that a time is a mean over at least, and s after which a first point is given up"""
SLOPE = 0.009
"""rad, of the simplest walker"""
LATENCY = 0.6
"""s that the first point of a family may come later than in the other checkout"""
Work = Callable[[], int]
"""Does it once; among how many its time is shared out"""


@dataclass(frozen=True)
class Row:
    """A work by the function that prepares it, the ratio that is wanted, whether functions are compiled."""

    prepare: Callable[[], Work]
    wanted: float
    compiled: bool = True


def refining(name: str) -> Work:
    """A warm refinement from the printed digits."""
    task = next(one for one in tasks() if one.name == name)
    refiner, guess = of.Refiner(task.problem), of.Guess(task.state, task.period)
    return partial(once, refiner.refine, guess)


def certifying(name: str) -> Work:
    return partial(once, of.certify, report(name))


def finding() -> Work:
    """From the printed digits to a certified orbit, all four."""
    problems = [task.problem for task in tasks()]

    def work() -> int:
        if not all(orbit.certificate and orbit.certificate.passed for orbit in map(of.find_orbit, problems)):
            raise Unavailable("not certified")
        return 1

    return work


def family(origin: Callable[[], Any], parameter: str = "energy", until: float | None = None, **settings: Any) -> Work:
    """Points of a family."""
    begun = origin()
    return lambda: len(followed(begun, parameter, until=until, **settings)[1].points)


def problem(name: str) -> of.Problem:
    return of.load_problem(ROOT / "problems" / f"{name}.toml")


def report(name: str) -> of.Orbit:
    return of.load_orbit(ROOT / "results" / "orbits" / name / "orbit.json")


def gait() -> of.Problem:
    """The long gait of the simplest walker, of period 3.9 s, to two digits."""
    return of.Problem(of.systems.simplest_walker(SLOPE), of.Guess([0.20, 0.40, -0.20, -0.02], 3.9))


def walker() -> of.Orbit:
    return of.find_orbit(gait())


def torus() -> Work:
    """The noble torus around the double pendulum's fast mode."""
    orbit = of.find_orbit(replace(of.load_problem(PROBLEM), pin=of.pin(energy=-17.0)))
    return partial(once, of.torus, orbit, NOBLE)


def searching(starts: int, longest: float) -> Work:
    """The first starts of a search of the triple pendulum for periods up to the longest (s)."""
    model = of.chain(3)

    def work() -> int:
        with tempfile.TemporaryDirectory() as folder:
            of.search(model, -30.0, (0.5, longest), Path(folder) / "a.sqlite", starts=starts, workers=0)
        return 1

    return work


def once(do: Callable[..., Any], *given: Any) -> int:
    do(*given)
    return 1


EACH_WAY: dict[str, Any] = {"points": 40, "certify": False}
ROWS: dict[str, Row] = {
    **{f"refine {name}": Row(partial(refining, name), 0.4) for name in NAMES},
    **{f"certificate {name}": Row(partial(certifying, name), 0.25) for name in NAMES},
    "find and certify all four": Row(finding, 0.5),
    **{f"family {name}, 40 points each way": Row(partial(family, partial(report, name), **EACH_WAY), 0.12)
       for name in ("triple-2", "quadruple-2")},
    "walker's family in slope": Row(partial(family, walker, "slope", points=40), 0.25),
    "torus": Row(torus, 0.25),
    "triple mode 2, 60 points forward": Row(
        partial(family, partial(problem, "families/triple-mode-2"), points=60, directions="forward"), 1.5),
    "Duffing's resonance": Row(
        partial(family, partial(problem, "families/duffing-resonance"), "frequency", 2.5), 1.5),
    "search, first 300 starts": Row(partial(searching, 300, 6.0), 0.25),
    "search to 10 s, first 150 starts": Row(partial(searching, 150, 10.0), 0.33),
    "refine triple-1, interpreted": Row(partial(refining, "triple-1"), 1.05, compiled=False),
    "family triple-2, interpreted": Row(partial(family, partial(report, "triple-2"), points=10, certify=False), 1.05,
                                        compiled=False),
}  # fmt: skip


# ---- in the process of a checkout ------------------------------------------------------------------


def serve(name: str) -> None:
    """Do a row's work once for every line on stdin, and say the seconds that it took."""
    own()
    work = ROWS[name].prepare()
    for _ in sys.stdin:
        began, count = processor_time(), 0
        while count == 0 or processor_time() - began < LEAST:
            shared = work()
            count += 1
        print(json.dumps([(processor_time() - began) / count / shared, shared]), flush=True)


class First(Exception):
    """The first point is there."""


def own() -> None:
    """`SystemExit` unless the package is that of the checkout asked for, not one that is installed."""
    checkout = Path(os.environ["PYTHONPATH"])
    if not Path(of.__file__).is_relative_to(checkout):
        raise SystemExit(f"{checkout.name}: no checkout of orbitfinder")


def first_point() -> None:
    """Say wall and processor seconds, compilers included, to the first point of a three-link family."""

    def stop(_: object) -> None:
        raise First

    own()
    started = problem("families/triple-mode-2")
    began, used = time.perf_counter(), processor_time() + processor_time(children=True)
    with suppress(First):
        of.follow_family(started, "energy", progress=stop)
    used = processor_time() + processor_time(children=True) - used
    print(json.dumps([used, time.perf_counter() - began]))


# ---- from outside ----------------------------------------------------------------------------------


def command(checkout: Path, *words: str, compiled: bool = True, **more: str) -> dict[str, Any]:
    """What runs this file in another process, with the package of a checkout."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
    environment |= more | ({} if compiled else {"ORBITFINDER_COMPILE": "off"})
    return {"args": [sys.executable, str(Path(__file__)), *words], "env": environment, "text": True}


def last_words(said: str) -> Unavailable:
    return Unavailable((said.strip().splitlines() or ["no message"])[-1])


@contextmanager
def worker(checkout: Path, name: str) -> Iterator[Callable[[], tuple[float, int]]]:
    """A process that does a row's work whenever it is called; (s, points)."""
    with (
        tempfile.TemporaryFile("w+") as said,
        subprocess.Popen(**command(checkout, "--serve", name, compiled=ROWS[name].compiled), stdin=subprocess.PIPE,
                         stdout=subprocess.PIPE, stderr=said) as doing,
    ):  # fmt: skip

        def ask() -> tuple[float, int]:
            assert doing.stdin and doing.stdout
            answer = ""
            with suppress(BrokenPipeError):
                print(file=doing.stdin, flush=True)
                answer = doing.stdout.readline()
            if not answer:
                said.seek(0)
                raise last_words(said.read())
            seconds, points = json.loads(answer)
            return seconds, points

        try:
            yield ask
        finally:
            doing.kill()


def latency(checkout: Path) -> tuple[float, float]:
    """(processor, wall) seconds to the first point in a new process with an empty cache."""
    with tempfile.TemporaryDirectory() as cache:
        asked = command(checkout, "--first-point", ORBITFINDER_CACHE=cache)
        done = subprocess.run(**asked, capture_output=True, timeout=LIMIT)
    if done.returncode:
        raise last_words(done.stderr)
    used, passed = json.loads(done.stdout)
    return used, passed


@contextmanager
def checkout_of(target: str) -> Iterator[Path]:
    """A folder as it is, or a commit in a folder that is gone afterwards."""
    if Path(target).is_dir():
        yield Path(target).resolve()
        return
    with tempfile.TemporaryDirectory() as name:
        packed = subprocess.run(["git", "-C", str(ROOT), "archive", target], capture_output=True)
        if packed.returncode:
            raise SystemExit(f"{target}: neither a folder nor a commit: {packed.stderr.decode().strip()}")
        subprocess.run(["tar", "-x", "-C", name], input=packed.stdout, check=True)
        yield Path(name)


def measured(name: str, checkouts: Mapping[str, Path], repeats: int) -> dict[str, Any]:
    """A row: what every checkout takes, their ratio and what is wanted of it."""
    with ExitStack() as open_:
        if name == "latency":
            methods: dict[str, Any] = {who: partial(latency, where) for who, where in checkouts.items()}
        else:
            methods = {who: open_.enter_context(worker(where, name)) for who, where in checkouts.items()}
        taken = in_turns(methods, range(repeats))
    runs = {who: Run(failed=str(one)) if isinstance(one, Unavailable) else
            Run(seconds=one[0], detail=f"wall {one[1]:.2f} s") if name == "latency" else
            Run(seconds=one[0], points=int(one[1])) for who, one in taken.items()}  # fmt: skip
    ours, theirs = runs["ours"].seconds, runs.get("earlier", Run()).seconds
    kind, value, wanted = "ratio", ours / theirs, ROWS[name].wanted if name in ROWS else LATENCY
    if name == "latency":
        kind, value = "difference", ours - theirs
    return {"row": name, **runs, kind: value, "wanted": wanted, "met": value <= wanted if "earlier" in runs else None}


def line(row: Mapping[str, Any]) -> str:
    """A row of the table."""
    ours, theirs = row["ours"], row.get("earlier", Run())
    value, unit = (row["difference"], " s") if "difference" in row else (row["ratio"], "")
    counts = f"{ours.points} / {theirs.points}" if "earlier" in row else str(ours.points)
    met = {True: "yes", False: "no", None: ""}[row["met"]]
    said = "; ".join(one.detail or one.failed for one in (ours, theirs) if one.detail or one.failed)
    times = f"{ours.told} | {theirs.told} | {known(value, '.2f')}{unit} | {row['wanted']:g}{unit}"
    return f"| {row['row']} | {times} | {met} | {counts} | {said} |"


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--against", metavar="CHECKOUT|COMMIT")
    parser.add_argument("--only", nargs="+", metavar="ROW", choices=[*ROWS, "latency"], default=[*ROWS, "latency"])
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument("--serve", help="(for itself)")
    parser.add_argument("--first-point", action="store_true", help="(for itself)")
    chosen = parser.parse_args()
    if chosen.serve or chosen.first_point:
        serve(chosen.serve) if chosen.serve else first_point()
        return
    with ExitStack() as open_:
        checkouts = {"ours": ROOT}
        if chosen.against:
            checkouts["earlier"] = open_.enter_context(checkout_of(chosen.against))
        rows = []
        for name in chosen.only:
            rows.append(measured(name, checkouts, chosen.repeats))
            progress(line(rows[-1]))
    before = chosen.out / "earlier.md"
    kept = before.read_text(encoding="utf-8") if before.is_file() else ""
    publish("earlier", page(rows, chosen.repeats, kept), rows, chosen)
    raise SystemExit(any(row["met"] is False for row in rows))


def page(rows: list[dict[str, Any]], repeats: int, before: str = "") -> str:
    """The report of a run, with what the page before it says of other rows."""
    names, now = [*ROWS, "latency"], {row["row"]: line(row) for row in rows}
    known = {text.split("|")[1].strip(): text for text in before.splitlines() if text.startswith("| ")}
    known = {name: known[name] for name in names if name in known and name not in now}
    lines = "\n".join((known | now)[name] for name in names if name in known | now)
    told = f"Of this run: {', '.join(now)}; the other rows are of runs before it.\n\n" if known else ""
    return f"""# Times against an earlier checkout's

Written by `python benchmarks/earlier.py --against CHECKOUT`; processor times, of a family a point, the least of
{repeats} turns; "latency" is to the first point with an empty cache, compilers included.

| | ms | earlier, ms | ratio | wanted | met | points | |
|---|---|---|---|---|---|---|---|
{lines}

{told}{conditions()}.
"""


if __name__ == "__main__":
    main()
