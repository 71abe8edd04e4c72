"""Does a search of a minute find every orbit of at most three cycles? Against a scan of the section by brute force.

The scan is plain NumPy: a grid over the section, the return map of all its points at once, Newton's method from every
point, each orbit once. The impact oscillator between two impacts is linear and has a closed form; the compass gait is
stepped by Runge and Kutta's method, and its gaits are then closed again by `hybrid_gaits.py` (SciPy, 1e-13).

    python benchmarks/hybrid_search.py      writes results/benchmarks/hybrid_search.md, in about six minutes
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from hybrid_gaits import compass
from machine import load, processor, versions

import orbitfinder as of
from orbitfinder.atlas.store import Atlas
from orbitfinder.problemfile.read import ProblemFile, load_problem_file

ROOT = Path(__file__).parents[1]
CYCLES = 3
SAME = 1e-6
"""States and periods that agree to this, relative to 1, are one orbit's."""


@dataclass(frozen=True)
class Found:
    """An orbit of the scan: states (k x m) where it passes the section, period (s), largest |multiplier|."""

    passes: np.ndarray
    period: float
    instability: float


class Map(Protocol):
    """A return map z -> (z', time) of all columns of z (m x k) at once, nan where there is none; `box` is scanned."""

    box: np.ndarray
    angles: np.ndarray

    def __call__(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The map."""
        ...


class Oscillator:
    """x'' + c x' + x = F cos(f), f' = w, from x = 0 at speed v < 0 and phase f to the next impact, v+ = -e v-."""

    box, angles = np.array([[-1.5, 0.0], [0.0, 2 * np.pi]]), np.array([False, True])
    looks, longest = 60, 15.0

    def __init__(self, damping: float = 0.1, frequency: float = 2.7, force: float = 1.0, e: float = 0.7) -> None:
        self.c, self.w, self.e, self.ring = damping, frequency, e, np.sqrt(1 - damping**2 / 4)
        size = (1 - frequency**2) ** 2 + (damping * frequency) ** 2
        self.even, self.odd = force * (1 - frequency**2) / size, force * damping * frequency / size

    def motion(self, t: np.ndarray | float, v: np.ndarray, f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """x and x' after t, by the forced solution and the ringing that it leaves."""
        fade = np.exp(-self.c * t / 2)
        pulse = fade * np.sin(self.ring * t) / self.ring
        step = fade * np.cos(self.ring * t) + self.c / 2 * pulse

        def forced(f: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            return self.even * np.cos(f) + self.odd * np.sin(f), self.w * (self.odd * np.cos(f) - self.even * np.sin(f))

        (x0, v0), (x, u) = forced(f), forced(f + self.w * t)
        return x - x0 * step + (v - v0) * pulse, u + x0 * pulse + (v - v0) * (step - self.c * pulse)

    def __call__(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The first time at which x rises through 0, bracketed by looks and halved to round-off."""
        v, f = z
        dt, after, waiting = 2 * np.pi / self.w / self.looks, np.full(v.size, np.nan), np.flatnonzero(v < 0)
        for k in range(1, int(self.longest / dt)):
            if not waiting.size:
                break
            over = self.motion(k * dt, v[waiting], f[waiting])[0] > 0
            after[waiting[over]] = k * dt
            waiting = waiting[~over]
        before = np.maximum(after - dt, 1e-9)
        for _ in range(12):
            middle = (before + after) / 2
            over = self.motion(middle, v, f)[0] > 0
            before, after = np.where(over, before, middle), np.where(over, middle, after)
        latest = after
        for _ in range(4):
            x, u = self.motion(after, v, f)
            after = np.clip(after - x / u, before, latest)
        return np.array([-self.e * self.motion(after, v, f)[1], f + self.w * after]), after


class Compass:
    """Stance angle and both rates of the compass gait after a strike, to those after the next (A. Goswami et al.)."""

    box, angles = np.array([[0.0, 0.5], [-3.0, 0.0], [-4.0, 4.0]]), np.zeros(3, bool)
    step, longest = 0.01, 1.6

    def __init__(self, slope: float = 0.08, m: float = 5.0, hip: float = 10.0, g: float = 9.81) -> None:
        a = b = 0.5
        self.slope, self.stands, self.couples, self.swings = slope, m * a**2 + (hip + m) * (a + b) ** 2, m * b, m * b**2
        self.pull, self.weight = (m * a + (hip + m) * (a + b)) * g, m * b * g
        self.heavy, self.light = (hip * (a + b) ** 2 + 2 * m * a * (a + b)), m * a * b
        self.b, self.m = b, m

    def rate(self, x: np.ndarray) -> np.ndarray:
        """x' of states (4 x k)."""
        s, n, u, w = x
        between, across = self.couples * np.cos(s - n), self.couples * np.sin(s - n)
        first = across * w**2 + self.pull * np.sin(s)
        second = -across * u**2 - self.weight * np.sin(n)
        size = self.stands * self.swings - between**2
        return np.array([
            u, w, (self.swings * first + between * second) / size, (between * first + self.stands * second) / size
        ])  # fmt: skip

    def moved(self, x: np.ndarray, dt: np.ndarray | float) -> np.ndarray:
        """One step of Runge and Kutta's."""
        one = self.rate(x)
        two = self.rate(x + dt / 2 * one)
        three = self.rate(x + dt / 2 * two)
        four = self.rate(x + dt * three)
        return x + dt / 6 * (one + 2 * two + 2 * three + four)

    def height(self, x: np.ndarray) -> np.ndarray:
        """0 where the swing foot is on the ground."""
        return np.asarray(x[0] + x[1] + 2 * self.slope)

    def __call__(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Steps until the swing foot comes down ahead, then Newton's method on the last one's length."""
        x = np.array([z[0], -z[0] - 2 * self.slope, z[1], z[2]])
        end, spent, waiting = np.full(x.shape, np.nan), np.full(x.shape[1], np.nan), np.arange(x.shape[1])
        for k in range(int(self.longest / self.step)):
            if not waiting.size:
                break
            after = self.moved(x, self.step)
            low = (self.height(x) > 0) & (self.height(after) <= 0) & (after[1] > after[0]) & (k > 0)
            if low.any():
                begin, part = x[:, low], np.full(low.sum(), self.step / 2)
                for _ in range(6):
                    there = self.moved(begin, part)
                    part = part - self.height(there) / (there[2] + there[3])
                end[:, waiting[low]], spent[waiting[low]] = self.moved(begin, part), k * self.step + part
            kept = ~low & (np.abs(after[0]) < np.pi / 2) & (np.abs(after[1]) < np.pi)
            x, waiting = after[:, kept], waiting[kept]
        return self.struck(end), spent

    def struck(self, x: np.ndarray) -> np.ndarray:
        """After the strike: momentum about the new foot, and of the new swing leg about the hip, are kept."""
        s, n, u, w = x
        lever = np.cos(s - n)
        whole = (self.heavy * lever - self.light) * u - self.light * w
        swing = -self.light * u
        # [[stands - couples cos, swings - couples cos], [-couples cos, swings]] (new stance, new swing)
        p, q, r = self.stands - self.couples * lever, self.swings - self.couples * lever, -self.couples * lever
        size = p * self.swings - q * r
        return np.array([n, (self.swings * whole - q * swing) / size, (p * swing - r * whole) / size])


def composed(once: Map, z: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The map `count` times, and the time that it takes."""
    total = np.zeros(z.shape[1])
    for _ in range(count):
        z, spent = once(z)
        total = total + spent
    return z, total


def gap(once: Map, z: np.ndarray, count: int) -> np.ndarray:
    """How far each point is from coming back, angles to the nearest turn."""
    away = composed(once, z, count)[0] - z
    return np.where(once.angles[:, None], (away + np.pi) % (2 * np.pi) - np.pi, away)


def slopes(once: Map, z: np.ndarray, count: int, width: float = 1e-6) -> tuple[np.ndarray, np.ndarray]:
    """The gap (m x k), and d gap / d z (k x m x m) by central differences, all in one go."""
    m = len(z)
    moves = np.vstack([np.zeros((1, m)), width * np.eye(m), -width * np.eye(m)])
    whole = gap(once, (z[:, None] + moves.T[:, :, None]).reshape(m, -1), count).reshape(m, 2 * m + 1, -1)
    return whole[:, 0], np.transpose((whole[:, 1 : m + 1] - whole[:, m + 1 :]) / (2 * width), (2, 0, 1))


def scanned(once: Map, count: int, size: int, rounds: int = 14) -> list[Found]:
    """Every orbit of `count` passes to which Newton's method leads from a grid of `size` points an axis."""
    edges = [low + (high - low) * (np.arange(size) + 0.5) / size for low, high in once.box]
    z = np.array(np.meshgrid(*edges)).reshape(len(edges), -1)
    span = np.ptp(once.box, axis=1)[:, None]
    for _ in range(rounds):
        off, by = slopes(once, z, count)
        good = np.all(np.isfinite(off), axis=0) & np.all(np.isfinite(by), axis=(1, 2))
        z, off, by = z[:, good], off[:, good], by[good]
        by = by + 1e-14 * np.eye(len(z))
        move = -np.linalg.solve(by, off.T[..., None])[..., 0].T
        z = z + move / np.maximum(1.0, np.abs(move / span).max(axis=0) / 0.1)
        inside = np.all((z > once.box[:, :1] - span) & (z < once.box[:, 1:] + span), axis=0)
        z = z[:, inside]
    closed = np.abs(gap(once, z, count)).max(axis=0, initial=0.0) < 1e-9
    found = list[Found]()
    for point in z[:, closed].T:
        one = orbit(once, point, count)
        if not (one is None or any(same(once, one, other) for other in found)):
            found.append(one)
    return found


def orbit(once: Map, point: np.ndarray, count: int) -> Found | None:
    """The orbit of a fixed point; None where it has fewer passes."""
    passes, z, period = [], point[:, None], 0.0
    for _ in range(count):
        passes.append(z[:, 0])
        z, spent = once(z)
        period += float(spent[0])
    away = [np.abs(turned(once, one - point)).max() for one in passes[1:]]
    if min(away, default=1.0) < SAME:
        return None
    whole = slopes(once, point[:, None], count)[1][0] + np.eye(len(point))
    return Found(np.array(passes), period, float(np.abs(np.linalg.eigvals(whole)).max()))


def turned(once: Map, away: np.ndarray) -> np.ndarray:
    """Differences, of angles to the nearest turn."""
    return np.where(once.angles, (away + np.pi) % (2 * np.pi) - np.pi, away)


def same(once: Map, one: Found, other: Found) -> bool:
    """Whether two orbits of the same number of passes are one."""
    near = min(float(np.abs(turned(once, one.passes[0] - place)).max()) for place in other.passes)
    return abs(one.period - other.period) < SAME and near < SAME


def searched(loaded: ProblemFile, budget: float, path: Path) -> tuple[list[of.Orbit], int, float]:
    """The orbits of a search, its starts, and the seconds that it took."""
    table, began = loaded.document["search"], time.monotonic()
    found = of.search(
        loaded.model, None, tuple(table["period"]), path, budget=budget, section=table["section"],
        cycles=table["cycles"],
    )  # fmt: skip
    with Atlas(path) as atlas:
        return [atlas.orbit(row.id) for row in atlas.rows()], found.summary.starts, time.monotonic() - began


def met(once: Map, chosen: Callable[[np.ndarray], np.ndarray], one: Found, orbits: list[of.Orbit]) -> of.Orbit | None:
    """The orbit of the search that is one of the scan's."""
    for orbit in orbits:
        near = min(float(np.abs(turned(once, chosen(orbit.state) - place)).max()) for place in one.passes)
        if abs(orbit.period - one.period) < SAME and near < SAME:
            return orbit
    return None


@dataclass(frozen=True)
class Machine:
    """A problem file, the map of its section, the grid, what of a state is on the section, and a closer look."""

    name: str
    once: Map
    size: int
    chosen: Callable[[np.ndarray], np.ndarray]
    closer: Callable[[Found], Found]


def walked(one: Found, slope: float = 0.08) -> Found:
    """A compass gait closed again by SciPy's integrator with events."""
    s, u, w = one.passes[0]
    walker = compass(slope)
    state, period = walker.orbit(np.array([s, -s - 2 * slope, u, w]), len(one.passes))
    passes, x = [], state
    for _ in one.passes:
        passes.append(x[[0, 2, 3]])
        x, _ = walker.step(x)
    largest = float(np.abs(walker.multipliers(state, len(one.passes))).max())
    return Found(np.array(passes), period, largest)


def machines() -> tuple[Machine, ...]:
    """Those that are compared."""
    return (
        Machine("impact-oscillator", Oscillator(), 48, lambda x: x[1:], lambda one: one),
        Machine("compass-gait", Compass(), 12, lambda x: x[[0, 2, 3]], walked),
    )


def compared(one: Machine, budget: float, folder: Path) -> tuple[list[str], bool]:
    """The lines about a machine, and whether the search has found all that the scan has."""
    began = time.monotonic()
    low, high = (loaded := load_problem_file(ROOT / "problems" / "search" / f"{one.name}.toml")).search or (0, 0)
    with np.errstate(all="ignore"):
        known = [each for count in range(1, CYCLES + 1) for each in scanned(one.once, count, one.size)]
    known = [one.closer(each) for each in known]
    known = sorted((each for each in known if low <= each.period <= high), key=lambda each: each.period)
    spent = time.monotonic() - began
    orbits, starts, seconds = searched(loaded, budget, folder / f"{one.name}.sqlite")
    rows, mine = list[str](), [met(one.once, one.chosen, each, orbits) for each in known]
    for each, found in zip(known, mine, strict=True):
        said = "missed" if found is None else f"{abs(found.period - each.period):.1e}"
        stable = "stable" if each.instability < 1 else "unstable"
        rows.append(f"| {len(each.passes)} | {each.period:.12g} | {each.instability:.6f}, {stable} | {said} |")
    more = [orbit for orbit in orbits if not any(orbit is found for found in mine)]
    hits = sum(found is not None for found in mine)
    others = f"; beyond the scan: {', '.join(f'{orbit.period:.9g} s' for orbit in more)}" if more else ""
    return [
        f"## {one.name}", "",
        f"Scan: {one.size}^{len(one.once.box)} points for each of 1, 2 and 3 cycles, {spent:.0f} s. Search: "
        f"`problems/search/{one.name}.toml`, {starts} starts in {seconds:.0f} s on 2 processes, {len(orbits)} orbits, "
        f"each certified: {hits} of the {len(known)} of the scan{others}.", "",
        "| cycles | period of the scan, s | largest multiplier | period of the search differs by |",
        "|---|---|---|---|", *rows, "",
    ], hits == len(known) and bool(known)  # fmt: skip


def main() -> int:
    """Scan, search, compare, write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--budget", type=float, default=60.0, help="seconds of each search")
    parser.add_argument("--out", type=Path, default=ROOT / "results" / "benchmarks")
    given = parser.parse_args()
    lines, complete = list[str](), True
    with tempfile.TemporaryDirectory() as folder:
        for one in machines():
            part, all_met = compared(one, given.budget, Path(folder))
            lines, complete = [*lines, *part], complete and all_met
    text = "\n".join([
        "# Searches of hybrid systems", "",
        "`python benchmarks/hybrid_search.py`; every number on this page is written by that script.", "",
        f"{processor()}; {versions()}; {load()}.", "",
        f"Wanted: a search of {given.budget:g} s finds every orbit of at most {CYCLES} cycles that a scan of the "
        f"section by brute force finds ({'met' if complete else 'missed'}).", "",
        *lines,
    ])  # fmt: skip
    (given.out / "hybrid_search.md").write_text(text, encoding="utf-8")
    print(text, file=sys.stdout)
    return 0 if complete else 1


if __name__ == "__main__":
    sys.exit(main())
