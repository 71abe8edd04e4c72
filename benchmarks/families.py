"""Cost of a family's points: orbitfinder against AUTO-07p on the same equations, without and with events.

Protocol. From the same first orbit orbitfinder takes POINTS points with its own steps, which ends at some energy; AUTO
goes to that energy in as many points, with its own steps too (peers/auto_family.py), on the coarsest mesh that closes
as asked for; "coarse" is the first of the meshes. A time is that of the whole run divided by its points (turns.py):
`of.follow_family` from the first orbit in its formulation, with the second integrator's closure of every point and, for
comparison, without it. Closures of both are judged by one integration: DOP853 at its tightest on Hamilton's equations,
divided by max(1, largest multiplier); ours, in extents of the motion, are held besides to LEAST max(1, A / GROWN), A
what errors grow by.

    python benchmarks/families.py             writes results/benchmarks/families.md
    python benchmarks/families.py --quick     three families, 20 points
    python benchmarks/families.py --json      prints the rows instead

All methods take three turns while there is time: each family has its share of what is left of --limit seconds, and once
that is used its methods take no further one. All families and meshes are measured either way.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from peers.auto_family import AutoFamily
from peers.program import needed
from peers.task import Unavailable
from turns import Run, arguments, conditions, failing, followed, in_turns, progress, publish

import orbitfinder as of
from orbitfinder.families.start import Start, begin
from orbitfinder.mechanics.model import Model
from orbitfinder.mechanisms.chain import chain
from orbitfinder.orbits.evidence import ClosureCheck
from orbitfinder.orbits.guesses.modes import mode_problem
from orbitfinder.records.family import FamilyPoint

POINTS = 40
REPEATS = 3
LIMIT = 300.0
"""Seconds after which methods take no further turn; `run.py` gives 600"""
MESHES = ((50, 4), (100, 4), (200, 4), (100, 7))
"""(NTST, NCOL) that AUTO is tried with; the cheapest one whose closures are as asked for is its time."""
CLOSURE = 1e-11
LEAST, GROWN = 1e-12, 1e3
PLAIN, EVENTS = "plain", "events"
METHODS = {"ours": {}, "ours uncertified": {"certify": False}}
"""Settings that are not the usual ones"""


@dataclass(frozen=True)
class Case:
    """A family: links, linear mode, amplitude of the first orbit (rad) and the formulation it is followed in; the
    shares of AUTO's time that are wanted without and with events."""

    links: int
    mode: int
    amplitude: float
    symmetry: str

    @property
    def name(self) -> str:
        """In words."""
        return f"{('', '', 'double', 'triple', 'quadruple')[self.links]} mode {self.mode}, {self.symmetry}"

    @property
    def wanted(self) -> dict[str, float]:
        """Without and with events."""
        if self.symmetry != "none":
            return {PLAIN: 0.1, EVENTS: 0.06}
        return {PLAIN: 0.5 if (self.links, self.mode) == (3, 1) else 0.25, EVENTS: 0.15}


CASES = (
    *(Case(3, mode, 0.3, "brake+reflection") for mode in (1, 2, 3)),
    *(Case(4, mode, 0.3, "brake+reflection") for mode in (1, 2, 3, 4)),
    Case(3, 2, 0.3, "brake"),
    *(Case(3, mode, 0.3, "none") for mode in (1, 2, 3)),
    *(Case(4, mode, 0.3, "none") for mode in (2, 3, 4)),
)


@dataclass
class Repeats:
    """How many turns there are: `REPEATS` until the share of the time is used, at least one."""

    until: float
    taken: list[int] = field(default_factory=list)

    def __iter__(self) -> Iterator[int]:
        count = 0
        while count == 0 or (count < REPEATS and time.monotonic() < self.until):
            yield count
            count += 1
        self.taken.append(count)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--limit", type=float, default=LIMIT)
    chosen = parser.parse_args()
    needed()
    cases, points = (CASES, POINTS) if not chosen.quick else ((CASES[1], CASES[4], CASES[-4]), 20)
    rows, fewest, end = [], REPEATS, time.monotonic() + chosen.limit
    for k, case in enumerate(cases):
        now = time.monotonic()
        repeats = Repeats(now + (end - now) / (len(cases) - k))
        rows.append(measured(case, points, repeats))
        fewest = min(fewest, *repeats.taken)
        progress(line(rows[-1]))
    publish("families", page(rows, fewest), rows, chosen)


def measured(case: Case, points: int, repeats: Iterable[int]) -> dict[str, Any]:
    """Every method on one family."""
    start = begin(mode_problem(chain(case.links), case.mode, case.amplitude), symmetry=case.symmetry)
    asked = {"points": points, "directions": "forward"}
    methods: dict[str, Any] = {
        f"{name}, {kind}": partial(followed, start, "energy", events=kind == EVENTS, **asked, **settings)
        for name, settings in METHODS.items() for kind in (PLAIN, EVENTS)
    }  # fmt: skip
    peer, meshes = None, {}
    with tempfile.TemporaryDirectory() as folder:
        family = followed(start, "energy", events=False, certify=False, **asked)[1]
        try:
            peer = AutoFamily(Path(folder), start)
            coarse = peer.stepping(MESHES[0], len(family.points), max(point.energy for point in family.points))
            fine = peer.finest(coarse, MESHES, CLOSURE)
            chosen = {"AUTO coarse": coarse, f"AUTO, {PLAIN}": fine, f"AUTO, {EVENTS}": replace(fine, events=True)}
            methods |= {name: partial(peer.go, one) for name, one in chosen.items()}
            meshes = {name: "x".join(map(str, one.mesh)) for name, one in chosen.items()}
        except Unavailable as failure:
            methods |= dict.fromkeys(("AUTO coarse", f"AUTO, {PLAIN}", f"AUTO, {EVENTS}"), partial(failing, failure))
        taken = in_turns(methods, repeats)
    runs = {name: told(one, start, peer, meshes.get(name, "")) for name, one in taken.items()}
    ratios = {f"{name}, {kind}": runs[f"{name}, {kind}"].seconds / runs[f"AUTO, {kind}"].seconds
              for name in METHODS for kind in (PLAIN, EVENTS)}  # fmt: skip
    given = taken[f"ours, {EVENTS}"]
    excess = np.nan if isinstance(given, Unavailable) else beyond(start.curve.equations.model, given[1].points)
    met = excess <= 1.0 and all(ratios[f"ours, {kind}"] <= wanted for kind, wanted in case.wanted.items())
    return {"family": case.name, "runs": runs, "ratios": ratios, "closure_over_wanted": excess, "wanted": case.wanted,
            "met": bool(met)}  # fmt: skip


def told(one: Any, start: Start, peer: AutoFamily | None, mesh: str) -> Run:
    """A method's row, its closures judged."""
    if isinstance(one, Unavailable):
        return Run(failed=str(one))
    seconds, given = one
    if isinstance(given, of.Family):
        energies = [point.energy for point in given.points]
        closure = judged(start.curve.equations.model, given.points)
    else:
        assert peer is not None
        energies, closure = list(peer.energies(given)), peer.closure(given)
    span = f"{energies[0]:.1f} to {max(energies):.1f} J"
    return Run(seconds=seconds, points=len(energies), closure=closure, detail=f"{mesh} {span}".strip())


def beyond(model: Model, points: Iterable[FamilyPoint]) -> float:
    """The worst closure, relative to the extents of the motion, over what is allowed of it."""
    return max(
        gap(model, point, np.ptp(of.simulate(model, point.state, point.period).states, axis=0))
        / (LEAST * max(1.0, point.scale / GROWN))
        for point in points
    )


def judged(model: Model, points: Iterable[FamilyPoint]) -> float:
    """Worst closure over max(1, largest multiplier)."""
    return max(gap(model, point) / point.scale for point in points)


def gap(model: Model, point: FamilyPoint, units: np.ndarray | float = 1.0) -> float:
    """Of an orbit round its loop."""
    return ClosureCheck(model)(point.state, point.period, np.zeros(model.degrees_of_freedom), 1e-15, units=units)


# ---- the page --------------------------------------------------------------------------------------

COLUMNS = (f"ours, {PLAIN}", f"ours uncertified, {PLAIN}", f"AUTO, {PLAIN}", "AUTO coarse", f"ours, {EVENTS}",
           f"ours uncertified, {EVENTS}", f"AUTO, {EVENTS}")  # fmt: skip


def line(row: dict[str, Any]) -> str:
    """One row of the table."""
    runs, ratios = row["runs"], row["ratios"]
    shown = (f"ours, {PLAIN}", f"AUTO, {PLAIN}", "AUTO coarse")
    cells = [
        row["family"], *(runs[name].told for name in COLUMNS),
        *(f"{ratios[name]:.2f}" for name in ratios), *(f"{runs[name].closure:.0e}" for name in shown),
        f"{row['closure_over_wanted']:.2g}", " / ".join(str(runs[name].points) for name in shown[:2]),
        *(runs[name].failed or runs[name].detail for name in shown[:2]), "yes" if row["met"] else "no",
    ]  # fmt: skip
    return f"| {' | '.join(cells)} |"


HEADER = ("family", "without events", "uncertified", "AUTO", "AUTO coarse", "with events", "uncertified",
          "AUTO with events", "ours / AUTO", "with events", "uncertified / AUTO", "with events", "closure", "AUTO's",
          "AUTO's coarse", "closure / wanted", "points / AUTO's", "energies", "AUTO's mesh and energies",
          "met")  # fmt: skip


def page(rows: list[dict[str, Any]], fewest: int) -> str:
    """The report of a run."""
    turns = f"{REPEATS}" if fewest == REPEATS else f"{fewest} to {REPEATS}"
    return f"""# Cost of a point on a family

Written by `python benchmarks/families.py`; processor times in ms a point, the least of {turns} turns, multipliers and
stability included; "uncertified" without the second integrator. Both go from the same first orbit over the same
energies in about the same number of points, with their own steps. Closures are the worst, divided by max(1, largest
multiplier). Wanted: at most 0.1 of AUTO's time without events and 0.06 with them where a symmetry is used, 0.25 (0.5 of
the triple pendulum's first mode) and 0.15 in the general formulation; closures at most {LEAST:g} max(1, A / {GROWN:g}).

| {" | ".join(HEADER)} |
{"|---" * len(HEADER)}|
{chr(10).join(map(line, rows))}

AUTO with NTST x NCOL of {", ".join(f"{intervals} x {order}" for intervals, order in MESHES)}: the first that closes to
{CLOSURE:g}, or else the last; "coarse" is the first of them. ISP = 1 and ILP = 0, with events ISP = 2 and ILP = 1;
EPSL = EPSU = 1e-12; one thread. {conditions()}.
"""


if __name__ == "__main__":
    main()
