"""What the speed rows share: what a time is, methods that take turns, and how rows are told.

A time is processor time, the least of several turns: load from elsewhere only ever adds to it. That of a family is the
whole call of `of.follow_family` in a warm process, after which period, multipliers and stability of every point have
been read before the clock stops; a peer's is its program's from start to end, with one thread. A turn is one run of
every method, so that all of them meet the machine as it is then.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import machine
from peers.task import Unavailable

import orbitfinder as of

OUT = Path(__file__).parents[1] / "results" / "benchmarks"


@dataclass(frozen=True, kw_only=True)
class Run:
    """A method's least time (s a point), its points, the worst closure of them, what else is told; or why it failed."""

    seconds: float = math.nan
    points: int = 0
    closure: float = math.nan
    detail: str = ""
    failed: str = ""

    @property
    def told(self) -> str:
        """Its time in ms a point, or that it failed; nothing where nobody asked."""
        return "failed" if self.failed else known(1e3 * self.seconds, ".3g")


def known(number: float, form: str) -> str:
    """A number in words, "" where there is none."""
    return "" if math.isnan(number) else f"{number:{form}}"


def processor_time(children: bool = False) -> float:
    """Seconds that this process, or its children that have ended, have used."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN if children else resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def followed(origin: Any, parameter: str, *, until: float | None = None, **settings: Any) -> tuple[float, of.Family]:
    """Seconds of a whole call of `of.follow_family`, its points read, and the family; settings are the usual ones but
    for those given."""
    chosen = of.FamilySettings(**settings) if settings else None
    began = processor_time()
    family = of.follow_family(origin, parameter, until=until, settings=chosen)
    read = [(point.period, point.floquet_multipliers, point.stability) for point in family.points]
    return (processor_time() - began) / len(read), family


def in_turns(
    methods: Mapping[str, Callable[[], tuple[float, Any]]], repeats: Iterable[int]
) -> dict[str, tuple[float, Any] | Unavailable]:
    """The least seconds of every method and what came of its last turn; or why it failed, and it takes no more turns.

    The first turn, in which functions are built, is not counted.
    """
    found: dict[str, tuple[float, Any] | Unavailable] = {}
    for turn in (-1, *repeats):
        for name, method in methods.items():
            before = found.get(name)
            if isinstance(before, Unavailable):
                continue
            try:
                seconds, given = method()
            except Exception as error:  # a row that fails is a row
                failure = error if isinstance(error, Unavailable) else Unavailable(f"{type(error).__name__}: {error}")
                found[name] = failure
                continue
            least = seconds if turn <= 0 or before is None else min(seconds, before[0])
            found[name] = least, given
    return found


def failing(failure: Unavailable) -> tuple[float, Any]:
    """A method that failed before its first turn."""
    raise failure


def arguments(description: str | None) -> argparse.ArgumentParser:
    """What every such script takes."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the rows as one JSON document; no page is written")
    parser.add_argument("--out", type=Path, default=OUT, help="folder of the page")
    return parser


def publish(name: str, text: str, rows: Sequence[Mapping[str, Any]], chosen: argparse.Namespace) -> None:
    """The page NAME.md and on the screen, or the rows as JSON."""
    if chosen.json:
        print(json.dumps({"benchmark": name, "rows": plain(list(rows)), "conditions": conditions()}, indent=1))
        return
    print(text)
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / f"{name}.md").write_text(text, encoding="utf-8")


def progress(text: str) -> None:
    """A line on stderr."""
    print(text, file=sys.stderr, flush=True)


def conditions() -> str:
    """The machine and the versions."""
    return f"{machine.processor()}; {machine.versions()}; {machine.load()}"


def plain(value: Any) -> Any:
    """For JSON, which knows no NaN."""
    if isinstance(value, Run):
        return plain(asdict(value))
    if isinstance(value, Mapping):
        return {key: plain(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
