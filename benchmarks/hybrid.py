"""Walking machines: warm refinement against a script by hand, families against smooth ones, a second program's numbers.

The script by hand is plain NumPy and SciPy (`hybrid_gaits.py`): `solve_ivp` with events and `least_squares` on the
return map. Both start from the same guesses, and the methods take turns; processor time, medians.

    python benchmarks/hybrid.py             writes results/benchmarks/hybrid.md, in about two minutes
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from earlier import SLOPE, gait
from hybrid_gaits import compass, doubling, simplest
from machine import load, processor, versions

import orbitfinder as of
from orbitfinder.integrate.march import March

ROOT = Path(__file__).parents[1]
REPEATS = 15
FASTER, IN_EQUATIONS, FAMILY = 50.0, 1e-3, 3.0
"""What is wanted: times faster than by hand, s of processor time in the equations, times a smooth family's point"""


@dataclass(frozen=True)
class Speed:
    """Processor times (s) of a refinement: whole, inside marches, by hand; of a point of a family and a smooth one."""

    ours: float
    equations: float
    by_hand: float
    point: float
    smooth: float
    differ: float


def spent(task: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time of a call (s), and what it gives."""
    began = time.process_time()
    found = task()
    return time.process_time() - began, found


class Clocked:
    """The processor time inside marches while this is open."""

    def __enter__(self) -> Clocked:
        self.total, self._kept = 0.0, {name: getattr(March, name) for name in ("ends", "varied", "states")}
        for name, method in self._kept.items():
            setattr(March, name, self._timed(method))
        return self

    def __exit__(self, *_: object) -> None:
        for name, method in self._kept.items():
            setattr(March, name, method)

    def _timed(self, method: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **named: Any) -> Any:
            took, found = spent(lambda: method(*arguments, **named))
            self.total += took
            return found

        return timed


def refinements(repeats: int) -> tuple[float, float, float, float]:
    """Medians over guesses a hundredth off: ours, ours in the equations, by hand; the largest difference of states."""
    random, walker = np.random.default_rng(0), simplest(SLOPE)
    refiner = of.Refiner(gait())
    first = refiner.refine()
    ours, equations, hand, differ = [], [], [], 0.0
    for _ in range(repeats):
        state = first.state * (1 + 0.01 * random.uniform(-1, 1, 4))
        guess = of.Guess(state, first.period * (1 + 0.01 * random.uniform(-1, 1)))
        refiner.refine(guess)
        took, found = spent(lambda guess=guess: refiner.refine(guess))
        ours.append(took)
        with Clocked() as clock:
            refiner.refine(guess)
        equations.append(clock.total)
        took, (there, _) = spent(lambda state=state: walker.orbit(state))
        hand.append(took)
        differ = max(differ, float(np.abs(there - found.state).max()))
    return *(float(np.median(one)) for one in (ours, equations, hand)), differ  # type: ignore[return-value]


def point_times() -> tuple[float, float]:
    """Median wall time (s) of a point of the walker's family in slope, and of a double pendulum's in energy."""
    walker = of.find_orbit(gait())
    settings = of.FamilySettings(longest_step=0.02, directions="forward", points=60)
    pendulum = of.find_orbit(of.Problem(of.chain(2), of.guesses.normal_mode(of.chain(2), 1, 0.2), of.pin(theta1=0.2)))
    found = []
    for orbit, parameter in ((walker, "slope"), (pendulum, "energy")):
        of.follow_family(orbit, parameter, settings=settings)  # compiles
        family = of.follow_family(orbit, parameter, settings=settings)
        found.append(float(np.median([one.wall_time for one in family.points if one.wall_time])))
    return found[0], found[1]


def second_program() -> list[tuple[str, float, float]]:
    """(what, ours, the second program's) of the compass gait: period, multipliers at 3 degrees, first doubling."""
    slope = float(np.deg2rad(3.0))
    guess = of.Guess([0.22, -0.32, -1.09, -0.38], 0.73)
    orbit = of.find_orbit(of.Problem(of.systems.compass_gait(slope=slope), guess))
    walker = compass(slope)
    state, period = walker.orbit(np.asarray(guess.state))
    theirs = walker.multipliers(state)
    ours = orbit.floquet_multipliers[np.argsort(-np.abs(orbit.floquet_multipliers))]
    family = of.follow_family(orbit, "slope", until=float(np.deg2rad(4.6)))
    first = next(one for one in family.events if one.kind == "period_doubling")
    place, _ = doubling(compass, state, (float(np.deg2rad(4.3)), float(np.deg2rad(4.5))))
    rows = [("period, s", orbit.period, period)]
    rows += [(f"multiplier {k + 1}, modulus", float(abs(ours[k])), float(abs(theirs[k]))) for k in range(3)]
    rows.append(("multiplier 1, real part", float(ours[0].real), float(theirs[0].real)))
    return [*rows, ("first period doubling, degrees", float(np.rad2deg(first.parameter)), float(np.rad2deg(place)))]


def report(speed: Speed, rows: list[tuple[str, float, float]], repeats: int) -> str:
    """The page."""
    ratio, points = speed.by_hand / speed.ours, speed.point / speed.smooth
    met = {True: "met", False: "missed"}
    lines = [
        "# Walking machines", "",
        "`python benchmarks/hybrid.py`; every number on this page is written by that script.", "",
        f"{processor()}; {versions()}; {load()}.", "",
        f"The simplest walker's long gait at slope {SLOPE}, from {repeats} guesses a hundredth off; processor time,",
        "medians, the methods taking turns. By hand: `solve_ivp` (DOP853, 1e-13, events) and `least_squares` on the",
        "return map, `benchmarks/hybrid_gaits.py`.", "",
        "| | ms |", "|---|---|",
        f"| warm refinement | {1e3 * speed.ours:.2f} |",
        f"| of that in the equations | {1e3 * speed.equations:.2f} |",
        f"| by hand | {1e3 * speed.by_hand:.0f} |",
        f"| point of the walker's family in slope (wall, closure checked) | {1e3 * speed.point:.2f} |",
        f"| point of a double pendulum's family in energy | {1e3 * speed.smooth:.2f} |", "",
        f"States found by both differ by at most {speed.differ:.1e}.", "",
        f"Wanted: in the equations at most {1e3 * IN_EQUATIONS:g} ms ({met[speed.equations <= IN_EQUATIONS]}),",
        f"at least {FASTER:g} times faster than by hand (measured {ratio:.0f}, {met[ratio >= FASTER]}),",
        f"a point in at most {FAMILY:g} times a smooth family's (measured {points:.2f}, {met[points <= FAMILY]}).",
        "", "## A second program", "",
        "The compass gait (3 degrees, hip mass 10 kg) by the plain program, its impact from angular momentum.", "",
        "| | orbitfinder | second program | difference |", "|---|---|---|---|",
        *(f"| {name} | {ours:.12g} | {theirs:.12g} | {abs(ours - theirs):.1e} |" for name, ours, theirs in rows), "",
    ]  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Measure and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=REPEATS)
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    given = parser.parse_args()
    ours, equations, by_hand, differ = refinements(given.repeats)
    point, smooth = point_times()
    speed = Speed(ours, equations, by_hand, point, smooth, differ)
    text = report(speed, second_program(), given.repeats)
    (given.out / "hybrid.md").write_text(text, encoding="utf-8")
    print(text, file=sys.stdout)


if __name__ == "__main__":
    main()
